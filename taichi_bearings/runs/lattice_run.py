"""Runs of lattices between two planes: the scene that settings describe, the method that solves it, and its answer.

row : as a name, the class of a method in solvers/table.py. A replica is one sample of several in a scene.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taichi_bearings import compiler, runtime
from taichi_bearings.errors import InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.memory import refuse_before
from taichi_bearings.options import options_of
from taichi_bearings.runs.cost import Cost, bytes_of_lattice, cost_of_lattice, refuse_too_large
from taichi_bearings.runs.job import Job, RunKind
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.torque import refuse_driven, under_torque
from taichi_bearings.scene import Bearing, Scene, Solution, Status
from taichi_bearings.scene.array_files import read_coefficients
from taichi_bearings.scene.disorder import Distribution
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.scene import of_lattice
from taichi_bearings.solvers.table import METHODS, MethodOptions, OperatorSplitting, fastest
from taichi_bearings.stages import stage
from taichi_bearings.words import counted

if TYPE_CHECKING:
    from taichi_bearings.solvers.drive import Checkpoints, Monitor
    from taichi_bearings.solvers.method import Method
    from taichi_bearings.solvers.stopping import StopRule

# least samples that a worker gets for the interior point, which steps eight at once and replaces those that are done:
# with more samples, fewer steps are made with less than eight. Small samples together have about so many spheres
BLOCK_SAMPLES, BLOCK_SPHERES = 24, 50_000


def build_scene(settings: RunSettings, seeds: Sequence[int] | None = None) -> Scene:
    """Return the scene on a lattice that the settings describe; its coefficients are drawn or read from a file.

    settings : settings of the run; `replicas` is the number of samples of the scene.
    seeds : the seed of each sample; None for those of the settings.

    Raises InputError for settings of a packing, and for a file that does not fit them.
    """
    if settings.is_packing:
        key = "driven" if settings.packing is None else "packing"
        raise InputError(
            f"{key} is {getattr(settings, key)!r}: only `bearings run` can use that, not this command; leave it out"
        )
    given = {key: getattr(settings, key) for key in Scene.PARAMETERS} | {"law": settings.law}
    if settings.coefficients is None:
        return Scene.of_seeds(settings.shape, settings.seeds if seeds is None else seeds, **settings.drawn, **given)
    file = Path(settings.coefficients)
    given["seeds"] = tuple(settings.seeds)
    coefficients = read_coefficients(file)
    lattice = Lattice.of(coefficients)
    if (shape := lattice.shape) != settings.shape:
        own, asked = ("x".join(map(str, sides)) for sides in (shape, settings.shape))
        raise InputError(f"shape is {asked}, but the coefficients in {file} are of {own} spheres; leave out the shape")
    if lattice.periodic_names != settings.periodic:
        own, asked = (",".join(names) or "none" for names in (lattice.periodic_names, settings.periodic))
        raise InputError(
            f"periodic is {asked}, but the coefficients in {file} are of a lattice where it is {own}; leave periodic "
            "out"
        )
    samples = len(coefficients[0]) if coefficients[0].ndim > len(shape) else 1
    if samples != settings.replicas:
        held = counted(samples, "sample") if samples > 1 else "a single sample"
        raise InputError(f"replicas is {settings.replicas}, but {file} holds {held}; it must be {samples}")
    if "viscosity" in settings.drawn:
        given["viscosity"] = read_coefficients(file, "viscosity", len(shape))
    return Scene(coefficients, **given).read_from(file.name)


def method_row(settings: RunSettings, scene: Scene) -> type[MethodOptions]:
    """Return the class, in the table of methods, of the method that the settings name; for "auto" that of the fastest
    method that certifies its answers to a scene.

    settings : settings of the run.
    scene : what is solved, on a lattice.
    """
    if settings.method == "auto":
        arch = runtime.automatic_arch(settings.precision) if settings.arch == "auto" else settings.arch
        return fastest(scene, settings.tolerance, on_gpu=arch != "cpu")
    return METHODS[settings.method]


@lru_cache(maxsize=4096)
def _row_of(settings: RunSettings) -> type[MethodOptions]:
    """Return the class, in the table of methods, of the method that solves a run on a lattice; raise InputError if it
    cannot solve it.

    settings : settings of the run. Coefficients do not matter for the choice, so all are 1 here.
    """
    Distribution.parse(settings.distribution)
    scene = build_scene(replace(settings, distribution="constant:1"))
    row = method_row(settings, scene)
    if reason := row.refusal(scene):
        raise InputError(reason)
    return row


@dataclass(frozen=True)
class LatticeJob(Job):
    """A run of a lattice whose input has been checked.

    scene : the lattice, with all samples.
    spin : initial spins, (samples R, spheres *N) or (R, *N, 3), 1/time.
    method : the method, ready to begin.
    """

    scene: Scene
    spin: np.ndarray
    method: "Method"

    def solve(
        self, monitors: "Sequence[Monitor]" = (), checkpoints: "Checkpoints | None" = None, **others: object
    ) -> Result:
        """Solve the run on the device that the settings name, and return its result.

        monitors : functions that are called at each check.
        checkpoints : where and how often checkpoints are written, for methods that can go on from one.
        others : not used.
        """
        solution = solve_job(self, monitors, checkpoints)
        return Result(self.settings, solution, self.spin, interrupted=solution.interrupted)

    @property
    def cost(self) -> Cost:
        """The estimated cost of the run: seconds, steps and bytes."""
        return cost_of_lattice(self.settings, type(self.method.options), self.scene)


class LatticeRuns(RunKind):
    """Runs of lattices between two planes: what is known of them from settings alone."""

    what = "lattices"

    def row(self, settings: RunSettings) -> type[MethodOptions]:
        """Return the class, in the table of methods, of the method that solves a run with these settings."""
        return _row_of(replace(settings, seed=0))

    def job(self, settings: RunSettings, strict: bool = True) -> LatticeJob:
        """Return the job that the settings describe, as :class:`RunKind` explains."""
        return self._job(settings, None, strict)

    def job_of_seeds(self, settings: RunSettings, seeds: Sequence[int]) -> LatticeJob:
        """Return the job that solves several samples at once, as :class:`RunKind` explains."""
        return self._job(replace(settings, seed=seeds[0], replicas=len(seeds)), seeds, False)

    def _job(self, settings: RunSettings, seeds: Sequence[int] | None, strict: bool) -> LatticeJob:
        """Return the job that the settings describe.

        settings : settings of the run, with the number of its samples.
        seeds : the seed of each sample; None for those of the settings.
        strict : True to raise InputError for options that neither the method nor the law uses; False to ignore them.
        """
        compiler.name()  # refuses one that is unknown or absent
        spheres = settings.replicas * prod(settings.shape)
        refuse_before(MethodOptions.bytes(settings.shape) * settings.replicas, f"a run of {counted(spheres, 'sphere')}")
        scene = build_scene(settings, seeds)
        return job_of(settings, scene, initial_spin(scene, settings.initial), strict)

    def refuse(self, settings: RunSettings, has_seeds: bool) -> None:
        """Raise InputError for settings of a scene that cannot be solved, as :class:`RunKind` explains."""
        self.row(settings)
        if has_seeds:
            self.refuse_idle_seeds(settings)

    def are_solved_together(self, settings: RunSettings, spheres: int) -> bool:
        """Return True if samples that differ in their seeds can be solved at once, as :class:`RunKind` explains."""
        ends_early = settings.time_limit is not None or getattr(settings, "settle", None) is False
        is_drawn = settings.coefficients is None
        return is_drawn and not ends_early and spheres < self.row(settings).alike_in_a_block

    def samples_at_a_time(self, settings: RunSettings, spheres: int) -> int:
        """Return how many samples a worker should get at a time at least, as :class:`RunKind` explains."""
        block = max(BLOCK_SAMPLES, BLOCK_SPHERES // spheres)
        return block if spheres < self.row(settings).alike_in_a_block else 1

    def seconds(self, settings: RunSettings) -> float | None:
        """Return the estimated seconds to solve one sample with these settings; None where they are not known, as for
        dynamics.
        """
        return self.row(settings).seconds(settings.shape, settings.tolerance)

    def worker_bytes(self, settings: RunSettings, spheres: int, most: int) -> float:
        """Return the estimated memory, bytes, of a worker that solves samples, as :class:`RunKind` explains."""
        periodic = ["xyz".index(name) for name in settings.periodic]
        return bytes_of_lattice(self.row(settings), settings.shape, periodic, most)


LATTICES = LatticeRuns()


def job_of(settings: RunSettings, scene: Scene, spin: np.ndarray, strict: bool = True) -> LatticeJob:
    """Return the job that solves a scene on a lattice as the settings say.

    settings : settings of the run; their scene is not used.
    scene : what is solved.
    spin : initial spins, (samples R, spheres *N) or (R, *N, 3), 1/time.
    strict : True to raise InputError for options that neither the method nor the law uses; False to ignore them.

    InputError is also raised for a scene that the method cannot solve, and for a device that is not here.
    """
    runtime.refuse_absent(settings.arch, settings.precision)
    row = method_row(settings, scene)
    refuse_driven(settings, row)
    settings = settings.fitting(row, strict)
    if reason := row.refusal(scene):
        raise InputError(reason)
    refuse_too_large(row, scene)
    given = {key: getattr(settings, key) for key in options_of(row)}
    method = row(**{key: value for key, value in given.items() if value is not None})
    return LatticeJob(settings, scene, spin, method.build())


# Where the interior point stalls, operator splitting goes on from its spins if the gap is above this: from 1e-13 it
# takes minutes and gains nothing.
SPLITTING_HELPS = 1e-12
MOST_SPLITTINGS = 20_000  # iterations of splitting, some 15 s for small samples; few need more (one needs 104 253)
# Where coefficients differ by a larger ratio than DOUBLE_DECADES, splitting stops after its first iterations unless the
# gap has halved, which it rarely has.
FIRST_SPLITTINGS, DOUBLE_DECADES = 100, 2.0**53


def solve_job(
    job: LatticeJob, monitors: "Sequence[Monitor]" = (), checkpoints: "Checkpoints | None" = None
) -> Solution:
    """Solve a job on a lattice and return the answer; Taichi is started if the method needs it.

    If the method was chosen automatically and the interior point stalled, operator splitting goes on from its spins. A
    torque on the top is evaluated at the end, which may take further solves.

    job : what is solved.
    monitors : functions that are called at each check.
    checkpoints : where and how often checkpoints are written, for a dynamics.
    """
    from taichi_bearings.solvers.drive import solve
    from taichi_bearings.solvers.recording import Recording
    from taichi_bearings.solvers.stopping import StopRule

    settings, method = job.settings, job.method
    if method.options.needs_taichi:
        with stage("starting Taichi"):
            runtime.start(settings.arch, settings.precision, settings.threads)
    stop, recording, threshold = StopRule.of(settings), Recording.of(settings), settings.slip_threshold
    solution = solve(job.scene, method, job.spin, stop, monitors, threshold, recording, checkpoints)
    stalled = solution.method == "interior-point" and solution.status is Status.STALLED and not solution.interrupted
    if settings.method == "auto" and stalled and not OperatorSplitting.refusal(job.scene):
        solution = _finished_by_splitting(solution, stop, partial(solve, monitors=monitors, slip_threshold=threshold))
    if settings.torque is None or solution.interrupted:
        return solution
    free = replace(settings, torque=None)

    def again(bearing: Bearing) -> Solution:
        """Return the answer to another lattice (`bearing`) with the same settings, but with the top moved as imposed
        instead of by a torque.
        """
        scene = of_lattice(bearing)
        return solve_job(LatticeJob(free, scene, initial_spin(scene, "linear"), method.options.build()))

    return under_torque(solution, settings.torque, settings.tolerance, again)


def _finished_by_splitting(solution: Solution, stop: "StopRule", solve: Callable[..., Solution]) -> Solution:
    """Return the answer of an interior point that has stalled, improved by operator splitting from its spins. Samples
    are improved one after another, so that each has the same bits as alone.

    solution : the answer to all samples.
    stop : tolerance, and the most iterations and seconds, of the whole run.
    solve : function that solves a scene by a method from initial spins and ends by a rule, its arguments in this order.
    """
    # `~` also takes a gap that is not-a-number
    for number in np.flatnonzero(~(solution.gap <= max(stop.tolerance, SPLITTING_HELPS))).tolist():
        one, left = solution.sample(number), max(stop.seconds - solution.seconds, 1e-3)
        better, other = _split(one, replace(stop, seconds=left), solve)
        solution = solution.with_sample(number, better, other)
        if solution.interrupted:
            break
    is_reached = (solution.gap <= stop.tolerance).all()
    return replace(solution, status=Status.CERTIFIED) if is_reached else solution


def _split(one: Solution, stop: "StopRule", solve: Callable[..., Solution]) -> tuple[Solution, Solution]:
    """Improve the answer to a sample by operator splitting from its spins. Return the better of both answers, and the
    answer of splitting, with the status STALLED if splitting was given up early.

    one : the answer to the sample.
    stop : tolerance, and the most iterations and seconds.
    solve : function that solves a scene by a method from initial spins and ends by a rule, its arguments in this order.
    """
    acting = one.scene.coefficient[one.scene.coefficient > 0]
    is_wide = bool(acting.max(initial=0.0) > DOUBLE_DECADES * acting.min(initial=np.inf))
    for most in (FIRST_SPLITTINGS, MOST_SPLITTINGS) if is_wide else (MOST_SPLITTINGS,):
        left = replace(stop, iterations=min(stop.iterations, most))
        other = solve(one.scene, OperatorSplitting().build(), one.spin, left)
        better = _better_answer(one, other, stop.tolerance)
        if better.gap.max() <= stop.tolerance or other.interrupted:
            break
        if better.method == one.method and most == FIRST_SPLITTINGS < stop.iterations:
            return better, replace(other, status=Status.STALLED)
    return better, other


def _better_answer(first: Solution, second: Solution, tolerance: float) -> Solution:
    """Return the better of two answers to one sample. First the forces that prove the higher of the two lower bounds
    are put into both. Then the second answer is better if it alone is within the tolerance, or if its gap is less than
    half of the gap of the first.

    first, second : the two answers.
    tolerance : relative gap that was asked for.
    """
    from taichi_bearings.solvers.answer import with_forces_of

    answers = with_forces_of(first, second), with_forces_of(second, first)
    gaps = [float(answer.gap.max()) for answer in answers]
    return answers[gaps[1] <= tolerance < gaps[0] or 2 * gaps[1] < gaps[0]]
