"""Estimates of what a run costs, made before anything is solved: its time, with proof and files, and its memory.

Seconds are those of one core of a common server; bytes are the most that the process holds at a time. Both may be wrong
by a factor of two; docs/measurements.md compares them with measured ones.

row : as an argument, the class of a method in solvers/table.py, such as `InteriorPoint`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, prod
from typing import Any

import numpy as np

from taichi_bearings.memory import NotEnoughMemory, refuse_before
from taichi_bearings.plain_files import Json
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Bearing, Scene
from taichi_bearings.solvers.packings import method_of
from taichi_bearings.solvers.table import InteriorPoint, MethodOptions
from taichi_bearings.words import counted

PROCESS_BYTES = 190e6  # memory of an interpreter in which this package, SciPy and Taichi are loaded
PROCESS_SECONDS = 2.0  # time to start it, and to draw the figures of a run
MOST_TOGETHER = 8  # number of samples whose matrix factors an interior point holds at a time
# for each sphere of a packing: bytes for a minimum, with normals along the axes and with others; bytes of a dynamics,
# and seconds of one of its steps
ALONG_BYTES, OBLIQUE_BYTES, STEPPED_BYTES, STEP_SECONDS = 15.5e3, 31e3, 6e3, 8e-8
# with oblique normals and more spheres than this, the bytes for each sphere grow as this power of the number of spheres
FILLED_SPHERES, FILLED_POWER = 1000, 0.2
# time of a packing divided by that of a lattice with as many spheres: with normals along the axes, and with others
ALONG_FACTOR, OBLIQUE_FACTOR = 2.0, 8.0
# factors on the time, and in a packing on the bytes, if contact states are not asked for (--no-settle); and the most
# bytes for each sphere of a packing then, as a large matrix is freed before the minimum is judged
UNSETTLED_SECONDS, UNSETTLED_BYTES, MOST_UNSETTLED_BYTES = 0.6, 0.8, 38e3
# spheres beyond which the method of a packing is chosen without a search for motions that make no contact slip
MOST_SEARCHED = 5_000


@dataclass(frozen=True)
class Cost:
    """The estimated cost of a run.

    method : name of the method.
    seconds : time of the whole run; None where it is not known when it ends.
    step_seconds : time of one step of a dynamics or descent; None for other methods.
    steps : number of these steps; None where it is not fixed beforehand.
    bytes : the most memory that the process holds at a time.
    """

    method: str
    seconds: float | None
    step_seconds: float | None
    steps: int | None
    bytes: float

    @property
    def report(self) -> Json:
        """The fields by name, as JSON has them."""
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
    """Return the most memory, in bytes, of a process that solves samples of a lattice together.

    row : class of the method in the table of methods, such as `InteriorPoint`.
    shape : spheres along each axis.
    periodic : numbers of the periodic axes.
    replicas : number of samples.
    """
    each = row.bytes(shape, periodic)
    if row is InteriorPoint and prod(shape) < InteriorPoint.alike_in_a_block:
        return PROCESS_BYTES + each * min(replicas, MOST_TOGETHER) + MethodOptions.bytes(shape) * replicas
    return PROCESS_BYTES + each * replicas


def refuse_too_large(row: type[MethodOptions], scene: Scene) -> None:
    """Raise NotEnoughMemory if a solve on a lattice, with proof and file, needs more memory than is free.

    row : class of the method.
    scene : what is solved. Its coefficients are in memory already, so they are not counted.
    """
    lattice, there = scene.lattice, sum(values.nbytes for values in (*scene.coefficients, *scene.viscosity))
    needed = bytes_of_lattice(row, lattice.shape, lattice.periodic, scene.replicas) - PROCESS_BYTES - there
    what = f"{row.name} of {counted(lattice.sites * scene.replicas, 'sphere')}"
    if needed == inf:
        raise NotEnoughMemory(f"{what} is too large: its matrix factorisation needs more than 2^31 - 1 numbers")
    refuse_before(needed, what)


def cost_of_lattice(settings: RunSettings, row: type[MethodOptions], scene: Scene) -> Cost:
    """Return the estimated cost of a run of a lattice: seconds, steps and bytes.

    settings : settings of the run.
    row : class of its method.
    scene : what it solves, with all samples.
    """
    lattice, shape = scene.lattice, settings.shape
    judged = PROCESS_SECONDS + row.judged_seconds(shape) * settings.replicas
    needed = bytes_of_lattice(row, shape, lattice.periodic, settings.replicas)
    step = row.step_seconds(shape)
    if step is None:
        solve = row.seconds(shape, settings.tolerance)
        if solve is not None and _is_unsettled(settings):
            solve *= UNSETTLED_SECONDS
        return Cost(
            row.name, _seconds_in_all(settings, judged, solve and solve * settings.replicas), None, None, needed
        )
    steps = _steps(settings, row, scene)
    step *= settings.replicas
    return Cost(
        row.name, _seconds_in_all(settings, judged, None if steps is None else steps * step), step, steps, needed
    )


def _is_unsettled(settings: RunSettings) -> bool:
    """Return True if settings ask an interior point for the power alone, not for the states of the contacts.

    settings : settings of the run.
    """
    return dict(settings.owned).get("settle") is False


def _seconds_in_all(settings: RunSettings, others: float, solve: float | None) -> float | None:
    """Return the estimated seconds of a whole run; None if they are not known.

    settings : settings of the run, whose time limit may end the solve sooner.
    others : seconds of everything but the solve.
    solve : seconds of the solve without a time limit; None if not known.
    """
    most = inf if settings.time_limit is None else settings.time_limit
    least = min(most, inf if solve is None else solve)
    return None if least == inf else others + least


def _steps(settings: RunSettings, row: type[MethodOptions], scene: Scene) -> int | None:
    """Return the most steps that a dynamics or a descent on a lattice makes: the limit on the iterations, or the
    duration of a dynamics over the length of a step, whichever is less. None if it continues until it is at rest.

    settings : settings of the run.
    row : class of the method.
    scene : lattice of the run.
    """
    limit = settings.iterations
    if not row.is_dynamics or settings.duration is None:
        return limit
    from taichi_bearings.solvers.cundall_strack import DEFAULT_STEP, stability_bound

    if (length := settings.values["time_step"]) is None:
        owned = {key: value for key, value in settings.owned if key in row.__dataclass_fields__ and value is not None}
        options: Any = row(**owned)
        bound = stability_bound(scene, scene.minimum_spin_axes, options)
        length = DEFAULT_STEP * (bound if np.isfinite(bound) else 1.0)
    steps = int(np.ceil(settings.duration / length))
    return steps if limit is None else min(steps, limit)


def cost_of_packings(settings: RunSettings, row: type[MethodOptions], scene: Bearing) -> Cost:
    """Return the estimated cost of a run of a packing, as if its samples were solved one after the other.

    settings : settings of the run.
    row : class of the method in the table of methods.
    scene : the packing with all samples.
    """
    network, count = scene.network, scene.replicas
    spheres = network.spheres
    if row.step_seconds((spheres, 1, 1)) is not None and settings.method != "auto":
        steps = settings.iterations
        if row.is_dynamics and settings.duration is not None and (length := settings.values["time_step"]):
            in_duration = int(np.ceil(settings.duration / length))
            steps = in_duration if steps is None else min(in_duration, steps)
        step = STEP_SECONDS * spheres
        seconds = _seconds_in_all(settings, PROCESS_SECONDS, None if steps is None else steps * step * count)
        return Cost(row.name, seconds, step, steps, PROCESS_BYTES + STEPPED_BYTES * spheres)
    # the time of a minimum is that of a lattice of so many spheres, times a factor
    along = bool((np.count_nonzero(network.normal, axis=1) == 1).all())
    of_lattice = InteriorPoint.seconds((spheres, 1, 1), settings.tolerance) or 0.0
    settles = not _is_unsettled(settings)
    factor = (ALONG_FACTOR if along else OBLIQUE_FACTOR) * (1.0 if settles else UNSETTLED_SECONDS)
    seconds = PROCESS_SECONDS + count * of_lattice * factor
    needed = PROCESS_BYTES + bytes_of_packing(spheres, along, settles)
    name = method_of(scene, settings.method, looks_for_motions=spheres <= MOST_SEARCHED)
    return Cost(name, seconds, None, None, needed)


def bytes_of_packing(spheres: int, along: bool = False, settles: bool = True) -> float:
    """Return the memory, bytes, that the minimum of one sample of a packing takes beside that of the process.

    spheres : number of spheres.
    along : True if all normals are along the axes.
    settles : True if contact states are asked for.
    """
    each = OBLIQUE_BYTES * float(max(spheres / FILLED_SPHERES, 1.0) ** FILLED_POWER)
    each = ALONG_BYTES if along else each
    return spheres * (each if settles else min(UNSETTLED_BYTES * each, MOST_UNSETTLED_BYTES))
