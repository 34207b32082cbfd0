"""What a run costs, told before anything is solved: seconds of its solve, its proof and its files, and memory.

Seconds are those of one core of a common server, memory is the most that the process holds at a time, both good to a
factor of two at most; docs/measurements.md holds them against measured ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, prod
from typing import Any

import numpy as np

from taichi_bearings.memory import NotEnoughMemory, refuse_before
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Bearing
from taichi_bearings.scene.scene import of_lattice
from taichi_bearings.solvers.table import JUDGED_SECONDS, InteriorPoint, MethodOptions
from taichi_bearings.words import counted

PROCESS_BYTES = 190e6  # of an interpreter with this package, SciPy and Taichi started
PROCESS_SECONDS = 2.0  # to start it, and to draw the figures of a run
MOST_TOGETHER = 8  # samples whose factors an interior point holds at a time
# of packings a sphere: bytes of a minimum with contacts along the axes and others, bytes and seconds of a dynamics
ALONG_BYTES, OBLIQUE_BYTES, STEPPED_BYTES, STEP_SECONDS = 15.5e3, 31e3, 6e3, 8e-8
ALONG_FACTOR, OBLIQUE_FACTOR = 2.0, 11.0  # of the time of a lattice with as many spheres


@dataclass(frozen=True)
class Cost:
    """What a run takes.

    method : its name. seconds : in all; None where nobody knows when it ends. step_seconds : of a step of a dynamics,
    None of what makes no steps in time. steps : how many of these it makes, None where they are not fixed. bytes : at
    their most.
    """

    method: str
    seconds: float | None
    step_seconds: float | None
    steps: int | None
    bytes: float

    @property
    def report(self) -> dict[str, Any]:
        """The same by name, for JSON."""
        return {
            "method": self.method,
            "seconds": self.seconds,
            "seconds_per_step": self.step_seconds,
            "steps": self.steps,
            "bytes": self.bytes,
        }


def bytes_of_lattice(
    row: type[MethodOptions], shape: Sequence[int], periodic: Sequence[int] = (), replicas: int = 1
) -> float:
    """The most memory of a process that solves so many samples of a lattice together."""
    each = row.bytes(shape, periodic)
    if row is InteriorPoint and prod(shape) < InteriorPoint.alike_in_a_block:
        return PROCESS_BYTES + each * min(replicas, MOST_TOGETHER) + MethodOptions.bytes(shape) * replicas
    return PROCESS_BYTES + each * replicas


def refuse_too_large(row: type[MethodOptions], scene: Bearing) -> None:
    """NotEnoughMemory where a solve of this scene, its proof and its file need more than there is.

    A scene that stands already is part of what is told, so nothing is refused that fits.
    """
    lattice = of_lattice(scene).lattice
    needed = bytes_of_lattice(row, lattice.shape, lattice.periodic, scene.replicas) - PROCESS_BYTES
    what = f"{row.name} of {counted(lattice.sites * scene.replicas, 'sphere')}"
    if needed == inf:
        raise NotEnoughMemory(f"{what} needs more numbers in one factorisation than can be indexed, 2^31 - 1")
    refuse_before(needed, what)


def cost_of(settings: RunSettings, row: type[MethodOptions], scene: Bearing) -> Cost:
    """What the run of these settings takes. row : its method. scene : as of a runs.run.Job."""
    if (lattice := scene.network.lattice) is None:
        return _of_packings(settings, row, scene)
    shape = settings.shape
    judged = PROCESS_SECONDS + JUDGED_SECONDS[len(shape)] * lattice.sites * settings.replicas
    room = bytes_of_lattice(row, shape, lattice.periodic, settings.replicas)
    step = row.step_seconds(shape)
    if step is None:
        solve = row.seconds(shape, settings.tolerance)
        return Cost(row.name, _limited(settings, judged, solve and solve * settings.replicas), None, None, room)
    steps = _steps(settings, row, scene)
    step *= settings.replicas
    return Cost(row.name, _limited(settings, judged, None if steps is None else steps * step), step, steps, room)


def _limited(settings: RunSettings, beside: float, solve: float | None) -> float | None:
    """Seconds in all of a solve, which a limit on the time may end."""
    most = inf if settings.time_limit is None else settings.time_limit
    least = min(most, inf if solve is None else solve)
    return None if least == inf else beside + least


def _steps(settings: RunSettings, row: type[MethodOptions], scene: Bearing) -> int | None:
    """Steps of a dynamics whose length is fixed; None where it goes on until it is at rest."""
    limit = settings.iterations
    if not row.is_dynamics or settings.duration is None:
        return limit
    from taichi_bearings.solvers.cundall_strack import DEFAULT_STEP, stability_bound

    if (length := settings.values["time_step"]) is None:
        owned = {key: value for key, value in settings.owned if key in row.__dataclass_fields__ and value is not None}
        options: Any = row(**owned)
        bound = stability_bound(of_lattice(scene), scene.minimum_spin_axes, options)
        length = DEFAULT_STEP * (bound if np.isfinite(bound) else 1.0)
    steps = int(np.ceil(settings.duration / length))
    return steps if limit is None else min(steps, limit)


def _of_packings(settings: RunSettings, row: type[MethodOptions], scene: Bearing) -> Cost:
    """Of packings, solved one after the other."""
    network, count = scene.network, scene.replicas
    spheres = network.spheres
    if row.step_seconds((spheres, 1, 1)) is not None and settings.method != "auto":
        steps = settings.iterations
        if row.is_dynamics and settings.duration is not None and (length := settings.values["time_step"]):
            steps = min(int(np.ceil(settings.duration / length)), steps or 2**62)
        step = STEP_SECONDS * spheres
        seconds = _limited(settings, PROCESS_SECONDS, None if steps is None else steps * step * count)
        return Cost(row.name, seconds, step, steps, PROCESS_BYTES + STEPPED_BYTES * spheres)
    along = bool((np.count_nonzero(network.normal, axis=1) == 1).all())
    alike = InteriorPoint.seconds((spheres, 1, 1), settings.tolerance) or 0.0
    seconds = PROCESS_SECONDS + count * alike * (ALONG_FACTOR if along else OBLIQUE_FACTOR)
    room = PROCESS_BYTES + (ALONG_BYTES if along else OBLIQUE_BYTES) * spheres
    return Cost(settings.method, seconds, None, None, room)
