"""One run from its settings: build the scene, solve it, write the run directory.

row : as a name, the class of a method in solvers/table.py. A replica is one sample of several in a scene.
"""

import logging
import secrets
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_bearings import compiler, leaving, runtime
from taichi_bearings.errors import FileError, InputError, WriteError
from taichi_bearings.files.whole_file import write_text
from taichi_bearings.interrupts import awaited
from taichi_bearings.lattice import Lattice
from taichi_bearings.memory import refuse_before
from taichi_bearings.options import options_of
from taichi_bearings.plain_files import real_path
from taichi_bearings.runs.cost import Cost, cost_of, refuse_too_large
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.run_directory import (
    checkpoint_of,
    completed,
    default_run_path,
    in_use,
    read_checkpoint,
    run_directory,
    write_checkpoint,
)
from taichi_bearings.runs.run_file import refuse_scan
from taichi_bearings.runs.settings import RunSettings, parse_toml
from taichi_bearings.runs.torque import refuse_driven, under_torque
from taichi_bearings.runs.writing import draw_figures, publish, self_contained, versions, write_run
from taichi_bearings.scene import Bearing, Scene, Solution, Status
from taichi_bearings.scene.array_files import read_coefficients
from taichi_bearings.scene.disorder import Distribution
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.scene import of_lattice
from taichi_bearings.solvers.recording import SAME_TIME
from taichi_bearings.solvers.table import (
    METHODS,
    MethodOptions,
    OperatorSplitting,
    fastest,
)
from taichi_bearings.stages import stage
from taichi_bearings.words import counted

if TYPE_CHECKING:
    from taichi_bearings.solvers.drive import Checkpoints, Monitor
    from taichi_bearings.solvers.method import Method


def build_scene(settings: RunSettings) -> Scene:
    """Return the scene on a lattice that the settings describe; its coefficients are drawn or read from a file.

    settings : settings of the run; `replicas` is the number of samples of the scene.

    Raises InputError for settings of a packing, and for a file that does not fit them.
    """
    if settings.is_packing:
        key = "driven" if settings.packing is None else "packing"
        raise InputError(
            f"{key} is {getattr(settings, key)!r}: only `bearings run` can use that, not this command; leave it out"
        )
    given = {key: getattr(settings, key) for key in Scene.PARAMETERS} | {"law": settings.law}
    if settings.coefficients is None:
        drawn: dict[str, Any] = {"seed": settings.seed, "replicas": settings.replicas, **settings.drawn}
        return Scene.random(settings.shape, **drawn, **given)
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


def row_of(settings: RunSettings) -> type[MethodOptions]:
    """Return the class of the method that solves a run with these settings.

    Raises InputError for a scene on a lattice that is not possible, or that the method cannot solve. Packings are not
    checked here, but by `packing_of`.
    """
    if settings.is_packing:
        from taichi_bearings.runs.packing_run import method_of_packing

        return method_of_packing(settings)
    return _row_of(replace(settings, seed=0))


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
class Job:
    """A run whose input has been checked and that is ready to be solved.

    settings : what was asked for.
    scene : what is solved, with all samples.
    spin : initial spins, (samples R, spheres *N) or (R, *N, 3), 1/time; None for a packing whose initial spins are
        given by name alone.
    method : the method for a lattice; None for a packing, whose settings name it.
    """

    settings: RunSettings
    scene: Bearing
    spin: np.ndarray | None
    method: "Method | None" = None

    def solve(
        self, monitors: "Sequence[Monitor]" = (), checkpoints: "Checkpoints | None" = None, **others: object
    ) -> Result:
        """Solve the run on the device that the settings name, and return its result.

        monitors : functions that are called at each check.
        checkpoints : where and how often checkpoints are written, for methods that can go on from one.
        others : arguments for packings alone, such as `density`.
        """
        if self.scene.network.lattice is not None:
            solution = solve_job(self, monitors, checkpoints)
            return Result(self.settings, solution, self.spin, interrupted=solution.interrupted)
        from taichi_bearings.runs.packing_run import solve_packings

        return solve_packings(self.settings, self.scene, self.spin, monitors, checkpoints, **others)


def prepare(settings: RunSettings, strict: bool = True) -> Job:
    """Return the job that the settings describe; every input error is raised here, before anything is computed.

    settings : settings of the run.
    strict : True to raise InputError for options that neither the method nor the law uses; False to ignore them, as a
        scan that compares methods does.
    """
    with stage("reading"):
        if settings.is_packing:
            from taichi_bearings.runs.packing_run import fitting, packings_to_solve

            settings = fitting(settings, strict)
            return Job(settings, *packings_to_solve(settings))
        compiler.name()  # refuses one that is unknown or absent
        spheres = settings.replicas * prod(settings.shape)
        refuse_before(MethodOptions.bytes(settings.shape) * settings.replicas, f"a run of {counted(spheres, 'sphere')}")
        scene = build_scene(settings)
        return job_of(settings, scene, initial_spin(scene, settings.initial), strict)


def cost(settings: RunSettings) -> Cost:
    """Return the estimated cost of a run: seconds, steps and bytes. Nothing is solved, but every input error is raised.

    settings : settings of the run.
    """
    job = prepare(settings)
    row = row_of(job.settings) if job.method is None else type(job.method.options)
    return cost_of(job.settings, row, job.scene)


def job_of(settings: RunSettings, scene: Scene, spin: np.ndarray, strict: bool = True) -> Job:
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
    return Job(settings, scene, spin, method.build())


# Where the interior point stalls, operator splitting goes on from its spins if the gap is above this: from 1e-13 it
# takes minutes and gains nothing.
SPLITTING_HELPS = 1e-12
MOST_SPLITTINGS = 20_000  # iterations of splitting, some 15 s for small samples; few need more (one needs 104 253)
# Where coefficients differ by a larger ratio than DOUBLE_DECADES, splitting stops after its first iterations unless the
# gap has halved, which it rarely has.
FIRST_SPLITTINGS, DOUBLE_DECADES = 100, 2.0**53


def solve_job(job: Job, monitors: "Sequence[Monitor]" = (), checkpoints: "Checkpoints | None" = None) -> Solution:
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

    settings, method, spin = job.settings, job.method, job.spin
    assert method is not None  # which a job of a lattice has
    assert spin is not None
    if method.options.needs_taichi:
        with stage("starting Taichi"):
            runtime.start(settings.arch, settings.precision, settings.threads)
    stop, recording = StopRule.of(settings), Recording.of(settings)
    solution = solve(job.scene, method, spin, stop, monitors, settings.slip_threshold, recording, checkpoints)
    stalled = solution.method == "interior-point" and solution.status is Status.STALLED and not solution.interrupted
    if settings.method == "auto" and stalled and not OperatorSplitting.refusal(of_lattice(job.scene)):
        # each on its own, so that it has the same bits alone and beside others; not-a-number is no gap that is small
        for number in np.flatnonzero(~(solution.gap <= max(settings.tolerance, SPLITTING_HELPS))).tolist():
            one, seconds = solution.sample(number), max(stop.seconds - solution.seconds, 1e-3)
            acting = one.scene.coefficient[one.scene.coefficient > 0]
            wide = bool(acting.max(initial=0.0) > DOUBLE_DECADES * acting.min(initial=np.inf))
            for most in (FIRST_SPLITTINGS, MOST_SPLITTINGS) if wide else (MOST_SPLITTINGS,):
                left = StopRule(stop.tolerance, min(stop.iterations, most), seconds)
                other = solve(one.scene, OperatorSplitting().build(), one.spin, left, monitors, settings.slip_threshold)
                better = _better(one, other, settings.tolerance)
                if better.gap.max() <= settings.tolerance or other.interrupted:
                    break
                if better.method == one.method and most == FIRST_SPLITTINGS < stop.iterations:
                    other = replace(other, status=Status.STALLED)
                    break
            solution = solution.with_sample(number, better, other)
            if solution.interrupted:
                break
        if (solution.gap <= settings.tolerance).all():
            solution = replace(solution, status=Status.CERTIFIED)
    if settings.torque is None or solution.interrupted:
        return solution
    free = replace(settings, torque=None)

    def again(bearing: Bearing) -> Solution:
        """Return the answer to another scene with the same settings, but with the top turned as imposed instead of by a
        torque.
        """
        scene = of_lattice(bearing)
        return solve_job(Job(free, scene, initial_spin(scene, "linear"), method.options.build()))

    return under_torque(solution, settings.torque, again)


def _better(first: Solution, second: Solution, tolerance: float) -> Solution:
    """Return the better of two answers to one sample. Both get the forces that prove the higher of their two lower
    bounds. The second answer is returned only if it alone is within the tolerance, or if its gap is less than half of
    the other.

    first, second : the two answers.
    tolerance : relative gap that was asked for.
    """
    from taichi_bearings.solvers.answer import with_forces_of

    answers = with_forces_of(first, second), with_forces_of(second, first)
    gaps = [float(answer.gap.max()) for answer in answers]
    return answers[gaps[1] <= tolerance < gaps[0] or 2 * gaps[1] < gaps[0]]


def run(
    settings: RunSettings,
    out: Path | None = None,
    force: bool = False,
    monitors: "Sequence[Monitor]" = (),
    title: bool = True,
) -> Result:
    """Solve a scene or a packing, write a run directory, and return the result.

    settings : settings of the run.
    out : the run directory. Default: a new one below outputs/.
    force : True to replace a run directory that exists.
    monitors : functions that are called at each check.
    title : True for words above the figures.

    The directory gets run.h5, summary.json, scene.toml, power_histogram.csv and figures. With `checkpoint_every` it
    exists from the start, with a checkpoint from which :func:`resume` continues.

    Raises InputError or FileError before anything is computed or overwritten.
    """
    job = prepare(settings)
    with run_directory(out or default_run_path(), force) as directory:
        if settings.checkpoint_every is None:
            found = replace(job.solve(monitors), path=directory.path, command=command())
            return written_or_rescued(found, partial(publish, directory, found), title)
        stored = self_contained(job.settings, job.scene, job.spin, directory.partial)
        write_text(directory.partial / "scene.toml", stored.to_toml())
        write_checkpoint(directory.partial, stored.to_toml(), versions(), {})
        directory.publish()
        with in_use(directory.path):
            return _solve_with_checkpoints(directory.path, job, stored, None, monitors, title)


def command() -> str:
    """Return the command line of this process, for the record."""
    return " ".join(["bearings", *sys.argv[1:]])


def written_or_rescued(
    found: Result, write: Callable[[], Result], title: bool = True, otherwise: str = "the result is lost"
) -> Result:
    """Write a result and its figures, and return it with the path where it is stored. If the result cannot be written
    to its own path, it goes to a temporary folder; if that fails too, WriteError is raised.

    After an interrupt, now or during the solve, the files are still written, but no figures are drawn.

    found : the result.
    write : function that writes its files and returns it.
    title : True for words above figures.
    otherwise : end of the message if nothing can be written.
    """
    with awaited() as heard:
        found = _rescued(found, write, otherwise)
    try:
        if heard.is_set() or found.interrupted:
            raise KeyboardInterrupt
        with leaving.saying(f"interrupted; the run is in {found.path}"):
            draw_figures(found, title)
    except KeyboardInterrupt:
        return replace(found, interrupted=True)
    return found


def _rescued(found: Result, write: Callable[[], Result], otherwise: str) -> Result:
    """Write a result, into a temporary folder if its own path cannot be written, and return it with its path. Raises
    WriteError if both fail.

    found : the result.
    write : function that writes its files and returns it.
    otherwise : end of the message if nothing can be written.
    """
    try:
        return write()
    except WriteError as error:
        assert found.path is not None
        folder = Path(tempfile.gettempdir()) / f"bearings-{secrets.token_hex(4)}" / found.path.name
        try:
            folder.mkdir(parents=True)
            found = replace(found, path=folder)
            write_run(folder, found)
        except (WriteError, OSError):
            shutil.rmtree(folder.parent, ignore_errors=True)
            spare = folder.parent.parent
            raise WriteError(
                f"{error}, nor could a copy of the result be written into the temporary folder {spare}; {otherwise}"
            ) from None
        logging.getLogger(__name__).warning("bearings: %s; the result is in %s", error, folder)
        return found


CHANGEABLE = (
    "tolerance", "iterations", "time_limit", "duration", "record", "snapshots", "checkpoint_every", "threads",
)  # fmt: skip
"""Settings that may change when a run is resumed."""


def resume(
    path: Path, changes: Mapping[str, object] | None = None, monitors: "Sequence[Monitor]" = (), title: bool = True
) -> Result:
    """Continue a run from its checkpoint, to the same bits as if it had never been stopped, and return the result.

    path : the run directory or its run.h5.
    changes : new values of settings that are named in CHANGEABLE.
    monitors : functions that are called at each check.
    title : True for words above the figures.

    Raises FileError if there is no checkpoint that can be read, InputError for a change that is not possible.
    """
    refuse_scan(path)
    path = path.parent if path.name == "run.h5" else path
    path = path if path.name and not path.is_symlink() else real_path(path)
    checkpoint_of(path)
    changes = dict(changes or {})
    for key in changes:
        if key in RunSettings.keys() and key not in CHANGEABLE:
            raise InputError(f"{key} cannot change when a run is resumed; these can: {', '.join(CHANGEABLE)}")
    with in_use(path):
        scene, arrays = read_checkpoint(path)
        stored = RunSettings.from_mapping(parse_toml(scene) | changes, "the options")
        if stored.checkpoint_every is None:
            raise FileError(f"{checkpoint_of(path)} is damaged or was changed: its scene names no checkpoint_every")
        if "duration" in changes and stored.duration is not None:
            duration, ends = stored.duration, [v for key, v in arrays.items() if key.rpartition("/")[2] == "last_time"]
            reached = float(max(ends, default=0.0))  # by the replica of a packing that is farthest
            if reached > duration * (1 + SAME_TIME):
                raise InputError(
                    f"duration is {duration:g}, but the checkpoint of {path} is at the time {reached:g}; it must be "
                    "longer"
                )
        settings = RunSettings.from_mapping(parse_toml(scene, path) | changes, "the options")
        job = prepare(settings, strict=False)
        return _solve_with_checkpoints(path, job, stored, arrays or None, monitors, title)


def _solve_with_checkpoints(
    path: Path,
    job: Job,
    stored: RunSettings,
    arrays: Mapping[str, np.ndarray] | None,
    monitors: "Sequence[Monitor]",
    title: bool,
) -> Result:
    """Solve a job in a run directory that exists and is locked by this process; write its files and return the result.

    path : the directory.
    job : the run.
    stored : its settings, with the names of files as they are in the directory.
    arrays : the checkpoint to continue from, by name; None to start at the beginning.
    monitors : functions that are called at each check.
    title : True for words above the figures.

    A KeyboardInterrupt that ends the solve has the path of the directory as its message.
    """
    from taichi_bearings.solvers.drive import Checkpoints

    def write(state: Mapping[str, np.ndarray]) -> None:
        """Write a checkpoint into the run directory; log a warning if that fails.

        state : state of the method, arrays by name.
        """
        try:
            write_checkpoint(path, stored.to_toml(), versions(), state)
        except FileError as error:  # a full disk may have room again before the end
            logging.getLogger(__name__).warning("bearings: %s; the run goes on", error)

    every = stored.checkpoint_every or np.inf
    try:
        with leaving.saying(f"interrupted; `bearings run --resume {path}` goes on from the last checkpoint"):
            found = job.solve(monitors, Checkpoints(every, write, arrays))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(str(path)) from None
    found = replace(found, path=path, command=command())

    def complete() -> Result:
        """Write the files of the finished run into its directory, and return the result."""
        with completed(path, _drawn(path)) as folder:
            write_run(folder, found)
        return found

    return written_or_rescued(
        found, complete, title, f"`bearings run --resume {path}` goes on from the last checkpoint"
    )


PICTURES = ("view.html", "run.vtkhdf", "movie.mp4", "movie.gif")  # files that other commands draw into a run directory


def _drawn(path: Path) -> list[str]:
    """Return the names of files in a run directory that show an earlier answer: figures, histograms, films and exports.

    path : the run directory.
    """
    from taichi_bearings.runs.figures import FIGURE_KINDS

    pictures = [f"{name}.{ending}" for name in (*FIGURE_KINDS, "power_histogram") for ending in ("png", "pdf")]
    drawn = [*pictures, "power_histogram.csv", "power_histogram.h5", *PICTURES]
    of_replicas = {f"{Path(name).stem}-replica-*{Path(name).suffix}" for name in drawn}
    return drawn + [file.name for pattern in sorted(of_replicas) for file in path.glob(pattern)]
