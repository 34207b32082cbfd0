"""The functions of `taichi_bearings` that solve, read and analyse; the commands of `bearings` use the same code.

import taichi_bearings as tb

scene = tb.Scene.random((10, 10, 10), seed=3, spin_bottom=0.1)
best = tb.solve(scene, tolerance=1e-9)
"""

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.options import SEED, finite_number, options_of
from taichi_bearings.plain_files import Json
from taichi_bearings.progress import displayed
from taichi_bearings.runs.analysis import Analysis
from taichi_bearings.runs.job import Job
from taichi_bearings.runs.lattice_run import job_of
from taichi_bearings.runs.packing_run import PackingJob, fitting, minimises
from taichi_bearings.runs.result import Result as Result
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runtime import available_threads
from taichi_bearings.scans.sample import JobTask, solve_all
from taichi_bearings.scene import Scene as Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.packing import Packing as Packing
from taichi_bearings.solvers import METHODS, MethodOptions
from taichi_bearings.solvers.drive import Monitor, Report
from taichi_bearings.words import meant, shown


@dataclass(frozen=True)
class Check:
    """The argument of a callback at each check of a solve. With R samples `power` and `gap` are arrays (R,).

    Attributes
    ----------
    iteration : int
        Iterations of the method so far.
    seconds : float
        Wall time so far, s.
    time : float or None
        Simulated time of a dynamics, else None.
    power : float or numpy.ndarray
        What the method minimises, energy/time: the power, or for the law coulomb-viscous the dissipation potential.
    gap : float or numpy.ndarray
        Proven relative distance of that from its minimum.
    tolerance : float
        Gap at which the solve ends.
    """

    iteration: int
    seconds: float
    time: float | None
    power: float | np.ndarray
    gap: float | np.ndarray
    tolerance: float


OPTIONS = (
    "torque", "iterations", "time_limit", "duration", "record", "snapshots", "slip_threshold", "arch", "precision",
    "threads",
)  # fmt: skip
"""Further arguments of :func:`solve`: settings of a run that belong neither to a method nor to a scene."""


def solve(
    scene: Scene | Packing,
    method: str | MethodOptions = "auto",
    tolerance: float = 1e-8,
    start: str | np.ndarray = "linear",
    callback: Callable[[Check], bool | None] | None = None,
    *,
    progress: bool = True,
    **options: Any,
) -> Result:
    """Solve a scene or a packing; no file is read or written. Ctrl-C ends the solve with what was reached.

    Parameters
    ----------
    scene : Scene or Packing
        What is solved, with all of its samples.
    method : str or MethodOptions
        "auto", the fastest method that certifies the scene; or the name of a method; or a method with its options, such
        as `CundallStrack(stiffness=1e6)`.
    tolerance : float
        Proven relative gap at which the solve ends.
    start : str or numpy.ndarray
        Initial spins: "linear", "random", "zero", "minimum-cut", a file, or an array like `Result.spin`.
    callback : callable, optional
        Function that takes a :class:`Check`, called at each check; if it returns True the solve ends as by Ctrl-C.
    progress : bool
        Whether a solve that takes longer than a moment shows its progress, on a terminal or in a notebook.
    **options
        Settings of a run: `torque` on the top instead of its spin, force*length, of methods that find minima, which
        adds `yields`, `yield_torque`, `yield_torque_lower_bound` and `amplitude` to `findings`; `iterations` at most;
        `time_limit`, s; of a dynamics `duration`, the simulated time to go on for, and the simulated times `record` of
        the rows of the history and `snapshots` of spins that are kept, as numbers or as "log:start,stop,count";
        `slip_threshold`, length/time, up to which contacts count as slipless; `arch`, "cpu", "cuda", "vulkan", "metal"
        or "auto"; `precision`, "f64" or "f32"; `threads`, 0 for all.

    Returns
    -------
    Result
        The answer, with what is proven of it.

    Raises
    ------
    InputError
        For arguments that are not allowed, or that do not fit each other.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> best = tb.solve(tb.Scene.random((4, 5), seed=3), threads=1)
    >>> best.status, best.lower_bound <= best.power, best.spin.shape
    ('certified', True, (4, 5))
    """
    with displayed(progress):
        monitors = _monitors(callback)
        density = {"density": options.pop("density")} if isinstance(scene, Packing) and "density" in options else {}
        job = _job(scene, method, {"tolerance": tolerance, **options}, start)
        return replace(job.solve(monitors, **density), command="taichi_bearings.solve")


def solve_many(
    scenes: Iterable[Scene | Packing],
    method: str | MethodOptions = "auto",
    tolerance: float = 1e-8,
    start: str | np.ndarray = "linear",
    workers: int = 0,
    **options: object,
) -> Iterator[Result]:
    """Solve scenes or packings in several processes, and yield each answer when it is there, in any order.

    Parameters
    ----------
    scenes : iterable of Scene or Packing
        What is solved. `answer.scene`, or `answer.packing`, is the object that was given, which shows to which scene an
        answer belongs.
    method, tolerance, start
        The method, the relative gap at which a solve ends, and the initial spins, as of :func:`solve`.
    workers : int
        Largest number of processes; 0 for one process for each processor.
    **options
        Settings of a run, as of :func:`solve`; each process has one thread unless `threads` says otherwise.

    Returns
    -------
    iterator of Result
        One answer for each scene.

    Raises
    ------
    InputError
        For arguments that are not allowed, before anything is computed.
    BearingsError
        For the first scene whose solve fails.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> scenes = [tb.Scene.random((3, 4), seed=seed) for seed in (1, 2)]
    >>> sorted(answer.scene.seeds[0] for answer in tb.solve_many(scenes, workers=1))
    [1, 2]
    """
    workers = SEED.named("workers", workers)
    if not isinstance(scenes, Iterable):
        raise InputError(f"scenes is a {type(scenes).__name__}; it must be a list of scenes, as in solve_many([scene])")
    asked = {"tolerance": tolerance, **options}
    tasks = [JobTask(str(number), scene, _job(scene, method, asked, start)) for number, scene in enumerate(scenes)]
    for own in {(type(task.scene.law), task.settings.method) for task in tasks}:
        _refuse_of_script(*own)
    found = solve_all(tasks, min(workers or available_threads(), max(1, len(tasks))))
    return (replace(result, command="taichi_bearings.solve_many") for result in found)


def _refuse_of_script(law: type, method: str) -> None:
    """Raise InputError for a law or a method that worker processes cannot import: one that is defined in the running
    script, or in a module that calls solve_many while it is imported.

    law : class of the contact law.
    method : name of the method.
    """
    for what, name, kind in (("law", law.__name__, law), ("method", method, METHODS.get(method))):
        module = getattr(kind, "__module__", "")
        if module == "__main__":
            raise InputError(
                f"the {what} {name} is defined in the script itself, which the processes of solve_many do not run; "
                "define it in a module of its own, and import that"
            )
        if getattr(getattr(sys.modules.get(module), "__spec__", None), "_initializing", False):
            raise InputError(
                f"the module {module}, which defines the {what} {name}, calls solve_many while it is imported; put the "
                "call under `if __name__ == '__main__'` or into another script"
            )


def analyse(result: Result | str | Path, threshold: float | None = None, sample: int = 0) -> Analysis:
    """Find what the contacts of an answer form: minimum cut, slipless network, rigid domains, bottlenecks and forces.

    Parameters
    ----------
    result : Result, str or Path
        An answer, or the directory or file of a run.
    threshold : float, optional
        Slip speed, length/time, up to which contacts count as slipless. Default: the contact states of the answer.
    sample : int
        Number of the sample that is shown in figures and as `structure`.

    Returns
    -------
    Analysis
        The structure of each sample, with numbers, arrays and figures.

    Raises
    ------
    InputError
        For a threshold that is not positive, a sample that does not exist, or an answer that is not finite.
    FileError
        For a file that cannot be read.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> net = tb.analyse(tb.solve(tb.Scene.random((4, 5), seed=3), threads=1))
    >>> net.spans, net.power_over_cut
    (False, 1.0)
    """
    found = load(result) if isinstance(result, (str, os.PathLike)) else result
    if not isinstance(found, Result):
        raise InputError(f"the result is {shown(found)}; it must be an answer of solve or load, or the path of a run")
    return Analysis(found, None if threshold is None else finite_number("threshold", threshold), sample)


def load(path: str | Path) -> Result:
    """Read the :class:`Result` of a run directory or its run.h5, whatever wrote it.

    Parameters
    ----------
    path : str or Path
        A run directory or its run.h5.

    Returns
    -------
    Result
        The same as was saved, field by field.

    Raises
    ------
    FileError
        If it is missing, damaged or was changed.

    Examples
    --------
    >>> import tempfile
    >>> import taichi_bearings as tb
    >>> best = tb.solve(tb.Scene.random((4, 5), seed=3), threads=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     again = tb.load(best.save(folder + "/run"))
    >>> again.power == best.power
    True
    """
    if not isinstance(path, (str, os.PathLike)):
        raise InputError(f"{shown(path)} is not a path; it must name a run directory or its run.h5")
    return read_run(Path(path))


def _job(
    scene: Scene | Packing, method: str | MethodOptions, options: Mapping[str, object], start: str | np.ndarray
) -> Job:
    """Return the job that solves a scene or a packing, with the settings that `bearings run` has. Initial spins that
    are an array are stored in the job itself, as settings can only name them.

    scene : what is solved.
    method : name of a method, or a method with its options.
    options : other arguments of :func:`solve` by name, `tolerance` included.
    start : initial spins, their name, or the path of a file.

    Raises InputError for arguments that are not allowed.
    """
    if isinstance(scene, Packing):
        settings = RunSettings(packing="run.h5", law=str(scene.law), seed=scene.seed, **_asked(method, options, start))
        strict = isinstance(method, str)  # else all options of the method are given
        if strict and "initial" in settings.given and minimises(settings):
            raise InputError(f"start is given, but method {settings.method} of a packing does not use it; leave it out")
        settings = fitting(settings, strict)
        return PackingJob(settings, scene, None if isinstance(start, str) else initial_spin(scene, start))
    if not isinstance(scene, Scene):
        raise InputError(f"the scene is a {type(scene).__name__}; it must be a taichi_bearings.Scene or a Packing")
    values: Json = {name: getattr(scene, name) for name in Scene.PARAMETERS}
    values |= {"shape": scene.lattice.shape, "law": str(scene.law), "seed": scene.seeds[0], "replicas": scene.replicas}
    if scene.lattice.dimension == 2:
        del values["direction"]  # which has no meaning there
    values |= scene.drawn or {"coefficients": "run.h5"}
    values |= _asked(method, options, start)
    settings = RunSettings.from_mapping(values, "the options")
    return job_of(settings, scene, initial_spin(scene, start, "start"))


def _asked(method: str | MethodOptions, options: Mapping[str, object], start: str | np.ndarray) -> Json:
    """Return the settings of a run, by key, that arguments of :func:`solve` amount to, without those of the scene.

    method : name of a method, or a method with its options.
    options : other arguments by name, `tolerance` included.
    start : initial spins, their name, or the path of a file.

    Raises InputError for an option that does not exist.
    """
    for name in options:
        if name not in ("tolerance", *OPTIONS):
            raise InputError(
                f"{name} is no option of solve, which has {', '.join(OPTIONS)}; "
                "options of a method belong to it, as in CundallStrack(stiffness=1e6)" + meant(name, OPTIONS)
            )
    values = Json()
    if isinstance(method, MethodOptions):
        declared = options_of(method)
        chosen = {name: getattr(method, name) for name in declared}
        values |= {name: value for name, value in chosen.items() if value != declared[name].default}
        method = method.name
    named = start if isinstance(start, str) else "initial_spin.npz"
    return values | {"method": method, "initial": named, **options}


def _monitors(callback: Callable[[Check], bool | None] | None) -> list[Monitor]:
    """Return the callback of a user as a monitor of the solve, in a list; an empty list if there is no callback."""
    if callback is None:
        return []
    if not callable(callback):
        raise InputError(f"callback is {shown(callback)}; it must be a function that takes a Check")

    def plain(values: np.ndarray) -> float | np.ndarray:
        """Return the values of all samples, (samples,), or the number of a single one."""
        return values if len(values) > 1 else float(values[0])

    def monitor(report: Report) -> bool | None:
        """Call the callback with what the report of a check says."""
        progress = report.progress
        reached = plain(report.objective), plain(report.gap)
        return callback(Check(progress.iteration, report.seconds, progress.time, *reached, report.stop.tolerance))

    return [monitor]
