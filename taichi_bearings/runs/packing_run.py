"""Runs of packings: the packing that settings describe, and its answer by the method that they name.

A replica is one sample of several that differ in their coefficients alone. Minima are found without initial spins;
dynamics and descents step from these.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings import leaving, runtime
from taichi_bearings.errors import DeviceError, InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.options import options_of
from taichi_bearings.proof.contact_state import by_threshold, decided, what_is_proven
from taichi_bearings.runs.cost import (
    MOST_TOGETHER,
    OBLIQUE_FACTOR,
    PROCESS_BYTES,
    Cost,
    bytes_of_packing,
    cost_of_packings,
)
from taichi_bearings.runs.job import Job, RunKind
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.settings import OF_SIDES, SIZES, RunSettings
from taichi_bearings.runs.torque import refuse_driven, under_torque
from taichi_bearings.scene import Bearing, Solution, Status
from taichi_bearings.scene.array_files import read_coefficients
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.scene.packing import Packing
from taichi_bearings.scene.readers.found import TOLERANCE, Sides, completed
from taichi_bearings.solvers.packings import MOST_IN_GROUP, groups_of_samples, least_power, some_of
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import METHODS, InteriorPoint, MethodOptions, row_of_packing
from taichi_bearings.words import counted, shown

if TYPE_CHECKING:
    from taichi_bearings.solvers.drive import Checkpoints, Monitor

TWICE = {"distribution": "friction", "viscosity": "viscosity", **{name: name for name in SIZES}}
"""Options, and the arrays of a file that make them superfluous: only one of the two may be given."""
COEFFICIENTS = ("friction", "viscosity")  # arrays of a packing, in the order of the coefficients of a law
AXES_OF_PACKINGS = {"center": 2, "contact": 2, "normal": 2}  # axes of an array of one sample; other arrays have one


BLOCK_SECONDS = 30.0  # estimated time of the samples of packings that a worker gets at a time; a kill loses this work
BESIDE_BYTES = 10e3  # bytes for each sphere of each further sample of a packing that is solved at the same time


class PackingJob(Job):
    """A run of a packing whose input has been checked."""

    def solve(
        self, monitors: "Sequence[Monitor]" = (), checkpoints: "Checkpoints | None" = None, **others: object
    ) -> Result:
        """Solve the run on the device that the settings name, and return its result.

        monitors : functions that are called at each check.
        checkpoints : where and how often checkpoints are written, for methods that can go on from one.
        others : `density` of the spheres, mass / length^D, for dynamics.
        """
        return solve_packings(self.settings, self.scene, self.spin, monitors, checkpoints, **others)

    @property
    def cost(self) -> Cost:
        """The estimated cost of the run: seconds, steps and bytes."""
        return cost_of_packings(self.settings, method_of_packing(self.settings), self.scene)


class PackingRuns(RunKind):
    """Runs of packings: what is known of them from settings alone. The packing is one from a file, or a lattice whose
    driven bodies are no planes.
    """

    what = "packings"

    def row(self, settings: RunSettings) -> type[MethodOptions]:
        """Return the class, in the table of methods, of the method that solves a run with these settings."""
        return method_of_packing(settings)

    def job(self, settings: RunSettings, strict: bool = True) -> PackingJob:
        """Return the job that the settings describe, as :class:`RunKind` explains."""
        settings = fitting(settings, strict)
        return PackingJob(settings, *packings_to_solve(settings))

    def job_of_seeds(self, settings: RunSettings, seeds: Sequence[int]) -> PackingJob:
        """Return the job that solves several samples at once, as :class:`RunKind` explains; the file is read once."""
        settings = fitting(settings, strict=False)
        if len(seeds) == 1:
            return PackingJob(settings, *packings_to_solve(settings))
        return PackingJob(replace(settings, replicas=len(seeds)), packing_of(settings, seeds=seeds), None)

    def refuse(self, settings: RunSettings, has_seeds: bool) -> None:
        """Raise InputError for settings of a packing that cannot be solved, as :class:`RunKind` explains."""
        settings = fitting(settings, strict=False)
        packing_of(settings)
        if has_seeds:
            self.refuse_idle_seeds(settings)

    def are_solved_together(self, settings: RunSettings, spheres: int) -> bool:
        """Return True if samples that differ in their seeds can be solved at once, as :class:`RunKind` explains."""
        is_drawn = settings.coefficients is None and settings.initial in STARTS
        return is_drawn and settings.time_limit is None and are_solved_together(settings, spheres)

    def samples_at_a_time(self, settings: RunSettings, spheres: int) -> int:
        """Return how many samples a worker should get at a time (see :class:`RunKind`): as many as are solved together,
        but not more than take BLOCK_SECONDS.
        """
        if not are_solved_together(settings, spheres):
            return 1
        of_lattice = InteriorPoint.seconds((spheres, 1, 1), settings.tolerance) or 0.0
        return min(MOST_IN_GROUP, int(BLOCK_SECONDS / (OBLIQUE_FACTOR * of_lattice)))

    def seconds(self, settings: RunSettings) -> None:
        """Return None whatever the settings: it is not known beforehand how long a packing takes."""

    def worker_bytes(self, settings: RunSettings, spheres: int, most: int) -> float:
        """Return the estimated memory, bytes, of a worker that solves samples, as :class:`RunKind` explains."""
        others = min(self.samples_at_a_time(settings, spheres), MOST_TOGETHER) - 1
        return PROCESS_BYTES + bytes_of_packing(spheres) + BESIDE_BYTES * others * spheres

    def complete_file(self, settings: RunSettings) -> str | None:
        """Return the name of the file that has all coefficients, as :class:`RunKind` explains; None if it is gone."""
        if settings.packing is None:
            return settings.coefficients
        if not Path(settings.packing).is_file():
            return None
        return settings.packing if _has_all(settings, Packing.read(settings.packing, settings.contacts)) else None


PACKINGS = PackingRuns()


def packings_to_solve(settings: RunSettings) -> tuple[Packing, np.ndarray | None]:
    """Return the packing that settings describe, with all its samples, and its initial spins if the settings name a
    file for them, else None. The spins are (samples R, spheres N, 3), of discs (R, N); 1/time.

    settings : settings of the run.

    Raises InputError or FileError for a file that does not fit.
    """
    packing, named = packing_of(settings), settings.initial
    if named in STARTS or not Path(named).exists():
        return packing, None
    return packing, initial_spin(packing, named)


def solve_packings(
    settings: RunSettings,
    scene: Bearing,
    start: np.ndarray | None,
    monitors: "Sequence[Monitor]" = (),
    checkpoints: "Checkpoints | None" = None,
    **others: object,
) -> Result:
    """Solve all samples of a packing, each as if it were alone, and return the result.

    settings : settings of the run.
    scene : the packing, with all samples.
    start : initial spins, (samples R, spheres N, 3), of discs (R, N), 1/time; None to take those that the settings
        name.
    monitors : functions that are called at each check.
    checkpoints : where and how often checkpoints are written, and the one to continue from; None for none.
    others : `density` of the spheres, mass / length^D, for dynamics.

    After Ctrl-C the result holds the samples that were begun. With checkpoints, from which the others can be solved
    later, KeyboardInterrupt is raised instead, unless all samples were begun.
    """
    count, found, is_interrupted = scene.replicas, list[Solution](), False
    # Steps from initial spins: all samples in one call; after an interrupt the answer has those that were begun.
    if not minimises(settings) and settings.torque is None:
        solution = solved_packing(settings, scene, start, monitors=monitors, checkpoints=checkpoints, **others)
        if (reached := solution.scene.replicas) < count:
            settings, start = replace(settings, replicas=reached), None if start is None else start[:reached]
        return Result(settings, solution, start, interrupted=solution.interrupted)
    # Minima, or findings on a torque: one block of samples after the other.
    of_samples = [None] * count if checkpoints is None else checkpoints.of_each(count)
    for begin, end in _blocks(settings, scene):
        first = None if start is None else start[begin:end]
        block = some_of(scene, begin, end)
        of_block = {"monitors": monitors, "checkpoints": of_samples[begin], **others}
        try:
            with leaving.saving() if found else nullcontext():
                solved = solved_packing(settings, block, start=first, **of_block)
            found += [solved.sample(number) for number in range(end - begin)]
        except KeyboardInterrupt:
            if not found:
                raise
        if is_interrupted := len(found) < end or found[-1].interrupted or found[-1].status is Status.INTERRUPTED:
            if len(found) < count and checkpoints is not None:
                raise KeyboardInterrupt
            settings, start = replace(settings, replicas=len(found)), None if start is None else start[: len(found)]
            break
    whole = replace(Solution.joined(found, scene.first(len(found))), interrupted=is_interrupted)
    return Result(settings, whole, start, interrupted=is_interrupted)


def _blocks(settings: RunSettings, scene: Bearing) -> Iterator[tuple[int, int]]:
    """Yield pairs (first number, number after the last) of samples that are solved together.

    settings : settings of the run.
    scene : the packing with all samples.
    """
    if are_solved_together(settings, scene.network.spheres):
        yield from groups_of_samples(scene)
    else:
        yield from ((number, number + 1) for number in range(scene.replicas))


def are_solved_together(settings: RunSettings, spheres: int) -> bool:
    """Return True if samples of a packing are solved together, each with the same bits as alone.

    settings : settings of the run.
    spheres : number of spheres of the packing.
    """
    return minimises(settings) and settings.torque is None and spheres < InteriorPoint.alike_in_a_block


def minimises(settings: RunSettings) -> bool:
    """Return True if the method finds the minimum of a packing directly, without initial spins; False if it makes steps
    from them.

    settings : settings of the run.

    Raises InputError for a method that packings do not have.
    """
    return row_of_packing(settings.method) is None


def method_of_packing(settings: RunSettings) -> type[MethodOptions]:
    """Return the class, in the table of methods, of the method that solves a packing; for "auto" that of the interior
    point.

    settings : settings of the run.
    """
    return row_of_packing(settings.method) or METHODS.get(settings.method, InteriorPoint)


def fitting(settings: RunSettings, strict: bool = True) -> RunSettings:
    """Return the settings without those that the packing, its method or its law does not use.

    settings : settings of the run.
    strict : True to raise InputError for the first such setting instead. InputError is also raised for a torque
        together with the spins that it replaces.
    """
    refuse_driven(settings, method_of_packing(settings))
    return settings.fitting(method_of_packing(settings), strict)


def packing_of(
    settings: RunSettings, found: Mapping[str, Any] | None = None, seeds: Sequence[int] | None = None
) -> Packing:
    """Return the packing that the settings describe, with one sample for each seed.

    It is read from a file and completed by values and draws of the settings; or, without a file, it is a lattice whose
    driven bodies are not planes.

    settings : settings of the run.
    found : the arrays of the file by name, if they were read already.
    seeds : the seed of each sample; each is the one that the settings with this seed alone describe. None for the seeds
        of the settings, one for each replica.
    """
    seeds = settings.seeds if seeds is None else seeds
    if settings.packing is None:
        return Packing.together([_lattice_as_packing(replace(settings, seed=seed)) for seed in seeds])
    found = Packing.read(settings.packing, settings.contacts) if found is None else found
    _refuse_twice(settings, found)
    if settings.has_table:
        sides = Sides(settings.spin_bottom, settings.spin_top, settings.direction)
        share = TOLERANCE if settings.touching is None else settings.touching
        found = completed({"radius": settings.radius, **found}, share, sides)
    # Arrays of the file with one axis more than usual hold several samples.
    axes = {name: np.ndim(values) - AXES_OF_PACKINGS.get(name, 1) for name, values in found.items()}
    axes["spin"] = np.ndim(found["spin"]) - (1 if np.shape(found["center"])[-1:] == (2,) else 2)
    samples = {len(values) for name, values in found.items() if axes[name] == 1} or {settings.replicas}
    if samples != {settings.replicas}:
        held = counted(samples.pop(), "sample")
        raise InputError(
            f"replicas is {settings.replicas}, but {settings.packing} holds {held}; leave replicas out or give that "
            "number"
        )
    draws_nothing = settings.initial != "random" and _has_all(settings, found)
    if settings.replicas > 1 and 1 not in axes.values() and draws_nothing:
        raise InputError(
            f"replicas is {settings.replicas}, but {settings.packing} holds all coefficients, so nothing is drawn; "
            "leave out replicas, or friction from the file"
        )
    others = {key: getattr(settings, key) for key in ("law", *SIZES)} | settings.drawn
    return Packing.together(
        [
            Packing(**{**others, "seed": seed, **{n: v[number] if axes[n] == 1 else v for n, v in found.items()}})
            for number, seed in enumerate(seeds)
        ]
    )


def _refuse_twice(settings: RunSettings, found: Mapping[str, object]) -> None:
    """Raise InputError if an option gives a value that the file of the packing has, too.

    settings : settings of the run.
    found : the arrays of the file by name.
    """
    pairs = list(TWICE.items())
    pairs += [(key, "spin") for key in OF_SIDES] if settings.has_table else []
    for key, name in pairs:
        if key in settings.given and name in found:
            value = shown(settings.given[key])
            raise InputError(f"{key} is {value}, but {settings.packing} holds {name}; leave one of the two out")


def _has_all(settings: RunSettings, found: Mapping[str, object]) -> bool:
    """Return True if the file of a packing has every coefficient, so that none is drawn.

    settings : settings of the run; their law says which coefficients a contact has.
    found : the arrays of the file by name.
    """
    return set(COEFFICIENTS[: len(settings.drawn)]) <= found.keys()


def _lattice_as_packing(settings: RunSettings) -> Packing:
    """Return a square or cubic lattice as a packing, with the coefficients that a scene with these settings has."""
    names = ("periodic", "seed", "law", "driven", "spin_top", "spin_bottom", "top", "bottom", *SIZES)
    others = {key: getattr(settings, key) for key in names} | settings.drawn
    if len(settings.shape) == 3:
        others["direction"] = settings.direction
    if settings.coefficients is not None:
        file = Path(settings.coefficients)
        groups = ("coefficient", "viscosity")[: len(settings.drawn)]
        for name, group in zip(COEFFICIENTS, groups, strict=False):
            found = read_coefficients(file, group, len(settings.shape))
            if Lattice.of(found).shape != settings.shape or found[0].ndim > len(settings.shape):
                sides = " x ".join(map(str, settings.shape))
                raise InputError(
                    f"coefficients is {settings.coefficients!r}, whose arrays do not fit: they must hold a single "
                    f"sample of a lattice of {sides} spheres; the array along x has the shape {found[0].shape}"
                )
            others[name] = np.concatenate([part.ravel() for part in found])
    return Packing.lattice("cubic" if len(settings.shape) == 3 else "square", settings.shape, **others)


ON_DEVICE = ("arch", "precision", "threads")  # settings of the device


def solved_packing(settings: RunSettings, packing: Bearing, start: np.ndarray | None = None, **others: Any) -> Solution:
    """Return the answer for all samples of a packing by the method that the settings name.

    settings : settings of the run.
    packing : the samples that are solved; other settings that describe a packing are not used.
    start : initial spins, (samples R, spheres N, 3), of discs (R, N), 1/time; None to take those that the settings
        name. A method that minimises directly uses none.
    others : `monitors`, functions that are called at each check; `checkpoints`, where and how often they are written,
        and the one to continue from; and, for dynamics alone, `density` of the spheres, mass / length^D.
    """
    row, given = row_of_packing(settings.method), settings.given
    device = {key: given[key] for key in ON_DEVICE if key in given}
    if row is None:  # the minimum is found directly, on the CPU
        if device.get("arch", "cpu") not in ("cpu", "auto"):
            raise DeviceError("the least power of a packing can only be found on the CPU; use --arch cpu")
        if threads := device.get("threads"):
            runtime.start(threads=threads)
        if "density" in others:
            raise InputError(
                f"density is given, but method {settings.method} of a packing does not use it; only dynamics do"
            )
        options = dict(settings.owned)
        found = least_power(packing, settings.method, StopRule.of(settings), options=options, **others)
    else:  # a dynamics or a descent makes steps from initial spins
        method = row(**{key: value for key in options_of(row) if (value := getattr(settings, key)) is not None})
        if device:
            runtime.start(**device)
        first = settings.initial if start is None else start
        found = _solved_by_steps(packing, method, first, settings, **others)
    if settings.torque is not None and found.status is not Status.INTERRUPTED and not found.interrupted:
        free = replace(settings, torque=None, slip_threshold=None)
        alone = {name: others[name] for name in others if name == "density"}  # checkpoints are of the first solve
        found = under_torque(
            found, settings.torque, settings.tolerance, lambda other: solved_packing(free, other, **alone)
        )
    if (threshold := settings.slip_threshold) is None:
        return found
    by_slip, known = by_threshold(found.slip, found.state, threshold), what_is_proven(found.state, found.proven)
    state, proven = decided(by_slip, known, describes_motion=True)
    return replace(found, state=state, proven=proven, slip_threshold=threshold)


def _solved_by_steps(
    packing: Bearing,
    options: MethodOptions,
    start: str | np.ndarray,
    settings: RunSettings,
    density: ArrayLike | None = None,
    monitors: "Sequence[Monitor]" = (),
    checkpoints: "Checkpoints | None" = None,
) -> Solution:
    """Return the answer for all samples of a packing by a dynamics or a descent.

    packing : what is solved.
    options : the method with its options.
    start : initial spins, (samples R, spheres N, 3), of discs (R, N), 1/time; or their name, such as "linear", or the
        path of a file.
    settings : settings of the run.
    density : density of the spheres, mass / length^D, for dynamics alone, from which their inertia follows.
    monitors : functions that are called at each check.
    checkpoints : where and how often checkpoints are written, and the one to continue from; None for none.
    """
    from taichi_bearings.solvers.drive import solve  # and with it Taichi's kernels
    from taichi_bearings.solvers.dynamics import Dynamics
    from taichi_bearings.solvers.recording import Recording

    method = options.build()
    if isinstance(method, Dynamics):
        method.density = density
    elif density is not None:
        raise InputError(f"density is given, but method {options.name} does not use it; only dynamics do")
    spin = initial_spin(packing, start, "start")
    return solve(packing, method, spin, StopRule.of(settings), monitors, None, Recording.of(settings), checkpoints)
