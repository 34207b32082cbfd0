"""The front door: scenes, answers and what they are made of, with or without files. `bearings` calls the same.

import taichi_bearings as tb

scene = tb.Scene.random((10, 10, 10), seed=3, spin_bottom=0.1)
best = tb.solve(scene, tolerance=1e-9)
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.lattice.grid import friction_by_axis
from taichi_bearings.options import SEED, finite_number, options_of
from taichi_bearings.progress import displayed
from taichi_bearings.quantities import CONTACTS, FINDINGS, SAMPLES, SPHERES, Quantity
from taichi_bearings.read_only import read_only
from taichi_bearings.runs import run as runs
from taichi_bearings.runs.analysis import Analysis
from taichi_bearings.runs.packing_run import fitting, minimises
from taichi_bearings.runs.run_directory import run_directory
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.solved import Run
from taichi_bearings.runtime import available_threads
from taichi_bearings.scans.sample import JobTask, solve_all
from taichi_bearings.scene import Scene, Snapshots
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.packing import Packing
from taichi_bearings.solvers import MethodOptions
from taichi_bearings.solvers.drive import Report
from taichi_bearings.words import html_table, listed, meant, shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taichi_bearings.plots.page import Page


@dataclass(frozen=True)
class Check:
    """What a callback is told at each check of a solve. A number, or with several samples (R,), where R is named.

    iteration : of the method. seconds : wall time so far. time : simulated time of a dynamics, else None.
    power : R, what the method brings down, energy/time (for "coulomb-viscous" its potential).
    gap : R, proven relative distance to the least value. tolerance : of the gap, at which the solve is done.
    """

    iteration: int
    seconds: float
    time: float | None
    power: Any
    gap: Any
    tolerance: float


OfSamples = Any
"""A number or word, or with several samples an array or list with one each, (R,)."""
OfContacts = Any
"""Of a lattice an array an axis, x, y(, z), of the shapes of `Scene.coefficients`, of a packing one of its E contacts;
with several samples with a leading axis R."""


TABLED = (
    "seed", "status", "proof", "power", "lower_bound", "gap", "slipping", "slipless", "tied", "undecided",
    "driven_power",
)  # fmt: skip


class Result:
    """An answer: what was solved, how it ended, and spins, slips and forces with what is proven of them.

    It is the same whether it was solved just now or read from a file. A single sample has numbers and arrays without an
    axis of replicas. Of several samples, (R,) are arrays with one number each, and every array has a leading axis R;
    `result[0]` is one of them alone, and `for one in result` goes through all. N is the lattice, such as (nx, ny, nz),
    or the number of spheres of a packing. What lies on contacts is a tuple with an array an axis, x, y(, z), of the
    shapes of `scene.coefficients`, and of packings one array (E,); of these, contacts between driven spheres, or
    without coefficient, are left out of `power`.
    """

    def __init__(self, run: Run) -> None:
        self._run = run

    scene = property(
        lambda self: self._run.solution.scene,
        doc="The :class:`Scene` or :class:`Packing` that was solved, with all samples.",
    )
    packing = property(
        lambda self: self._run.solution.scene.sample(0) if self._run.is_packing else None,
        doc="The :class:`Packing` that was solved, of several samples the first; None of lattices.",
    )
    settings = property(
        lambda self: self._run.settings.given,
        doc="Options that differ from their defaults, by name as in `bearings run`: how to solve the scene again.",
    )
    path = property(lambda self: self._run.path, doc="Directory or file of the run; None if it is in none.")
    method: str
    status: OfSamples
    power: OfSamples
    lower_bound: OfSamples
    gap: OfSamples
    contacts: OfSamples
    slipping: OfSamples
    slipless: OfSamples
    tied: OfSamples
    undecided: OfSamples
    unproven: OfSamples
    minimum_is_unique: OfSamples
    states_proven: OfSamples
    slip_threshold: float
    largest_balance_residual: OfSamples
    iterations: int
    seconds: float
    seconds_compile: float
    spin: np.ndarray
    spin_rounding: np.ndarray
    slip: OfContacts
    power_per_contact: OfContacts
    force: OfContacts
    state: OfContacts
    proof: OfSamples
    driven_power: OfSamples
    slipless_motions: OfSamples
    time: OfSamples
    reached = property(
        lambda self: all(status.reached for status in self._run.status), doc="True if what was asked for was reached."
    )

    @property
    def potential(self) -> OfSamples:
        """What the stationary state minimises, energy/time; (R,). The power, but for the law coulomb-viscous."""
        return self._of_samples(self._run.solution.objective)

    findings = property(
        lambda self: {name: self._of_samples(values) for name, values in self._run.solution.findings.items()},
        doc="What else the method has found, by name; numbers, (R,).",
    )
    warnings = property(
        lambda self: self._run.summary["warnings"],
        doc="Warnings, sentences with a number; an empty list if there is none.",
    )
    summary = property(lambda self: self._run.summary, doc="All numbers by name, as `bearings run --json` prints them.")

    @property
    def friction(self) -> OfContacts:
        """Force on the upper sphere of each contact, laboratory frame, force; an array (*contacts, 3) an axis, in 2D
        (*contacts), its component along z x n. Of packings that on the second sphere, (E, 3), of discs (E,). The lower
        bound follows from it."""
        found = self._of_samples(self._run.solution.friction)
        return found if self._run.is_packing else read_only(friction_by_axis(found, self.scene.lattice))

    @property
    def history(self) -> dict[str, np.ndarray]:
        """The trajectory to the answer: columns (checks,); of several samples (R, checks), but for these three.

        iteration. seconds : wall time, s. time : simulated time of a dynamics. power, lower_bound : energy/time.
        largest_balance_residual : force * length. slipping : contacts. kinetic_energy, spring_energy, injected_energy,
        dissipated_energy : energy; energy_residual : relative; of a dynamics that keeps an energy balance.
        """
        columns = self._run.solution.history.items()
        return {name: values if values.ndim == 1 else self._of_samples(values.T) for name, values in columns}

    @property
    def snapshots(self) -> Snapshots | None:
        """Spins of a dynamics at the times asked for, if any: `time` (S,) and `spin` (S, *N), in 3D (S, *N, 3),
        1/time; of several samples (R, S, ...)."""
        kept = self._run.solution.snapshots
        return None if kept is None else Snapshots(kept.time.T, self._of_samples(np.moveaxis(kept.spin, 1, 0)))

    def _of_samples(self, values: Any) -> Any:
        """The values of all samples, (R, ...), as users meet them; what is one for all stays."""
        if self._run.solution.scene.replicas > 1 or not isinstance(values, (np.ndarray, list)):
            return values
        return values.item() if isinstance(values, np.ndarray) and values.ndim == 1 else values[0]

    def __len__(self) -> int:
        return self._run.solution.scene.replicas

    def __getitem__(self, number: int) -> "Result":
        """One of the samples as if it had been solved alone."""
        samples = len(self)
        if not -samples <= number < samples:
            raise IndexError(f"sample {number} of {samples}")
        return self if samples == 1 else Result(self._run.sample(number % samples))

    def __iter__(self) -> Iterator["Result"]:
        return (self[number] for number in range(len(self)))

    def __repr__(self) -> str:
        what = self.packing or f"{'x'.join(map(str, self.scene.lattice.shape))} {self.scene.law}"
        words = f"<Result {what}, {self.method}"
        if len(self) > 1:
            done = sum(status.reached for status in self._run.status)
            return f"{words}: {len(self)} samples, {done} reached, gap at most {self.gap.max():.1e}>"
        return f"{words}: {self.status}, P = {self.power:.12g}, gap {self.gap:.1e}, {self.seconds:.2g} s>"

    def _repr_html_(self) -> str:
        """A table for notebooks, a row a sample."""
        columns = {name: listed(found) for name in TABLED if (found := self.summary.get(name)) is not None}
        return html_table(repr(self), zip(*columns.values(), strict=True), list(columns))

    def plot(
        self, kind: str = "spins", sample: int = 0, time: float | None = None, page: "Page | None" = None
    ) -> "Figure":
        """A figure, which notebooks show and `.savefig("a.pdf")` writes; no setting of matplotlib is changed.

        kind : "spins", "power", "history", "energy", or one of `bearings analyse`: "domains", "network".
        sample : which of several. time : of the snapshot whose spins are drawn. page : how it is printed, a
            `taichi_bearings.plots.page.Page` with width, planes and view.
        """
        from taichi_bearings.plots.page import PAGE
        from taichi_bearings.runs.figures import draw_figure  # and with it matplotlib, which nothing else needs

        return draw_figure(kind, self._run.solution, sample, time, self._run.settings.slip_threshold, page or PAGE)

    def save(self, path: str | Path, force: bool = False) -> Path:
        """Write what `bearings run` writes into a new directory, which is returned; :func:`load` reads it.

        force : replace a run directory that stands there. FileError if something does, or if it cannot be written.
        """
        if not force and os.path.lexists(path):
            raise FileError(f"{path} already exists; save into another directory, or with force=True")
        with run_directory(Path(path), force) as directory:
            self._run = runs.publish(directory, replace(self._run, spin=self._run.start))
            runs.draw_figures(self._run)
        assert self._run.path is not None
        return self._run.path


def _described(row: Quantity) -> str:
    unit = "" if row.unit == "1" else f", {row.unit}"
    return f"{row.text[0].upper()}{row.text[1:]}{unit}."


def _of_samples(row: Quantity) -> property:
    """A number or word of each sample."""
    return property(lambda result: result._of_samples(row.of(result._run.answered)), doc=_described(row))


def _of_contacts(row: Quantity) -> property:
    """An array an axis, or one of a packing; none where nothing is known."""

    def found(result: Result) -> OfContacts:
        values = row.of(result._run.solution)
        if values is None:
            return ()
        values = result._of_samples(values)
        return values if result._run.is_packing else result.scene.lattice.by_axis(values)

    return property(found, doc=f"{_described(row)[:-1]}; of lattices an array an axis.")


def _of_findings(row: Quantity) -> property:
    """A number or word of each sample; None where there is none."""
    return property(lambda result: result.findings.get(row.name), doc=_described(row))


for _name in Result.__annotations__.keys() & SAMPLES.keys():
    setattr(Result, _name, _of_samples(SAMPLES[_name]))
for _name in Result.__annotations__.keys() & FINDINGS.keys():
    setattr(Result, _name, _of_findings(FINDINGS[_name]))
for _name, _row in SPHERES.items():  # of each sphere: N, or (*N, 3); zeros, too, of which files have none
    _found = partial(lambda name, result: result._of_samples(getattr(result._run.solution, name)), _name)
    setattr(Result, _name, property(_found, doc=_described(_row)))
for _name, _row in CONTACTS.items():
    setattr(Result, "power_per_contact" if _name == "power" else _name, _of_contacts(_row))

OPTIONS = (
    "torque", "iterations", "time_limit", "duration", "record", "snapshots", "slip_threshold", "arch", "precision",
    "threads",
)  # fmt: skip
"""What :func:`solve` takes beside its own arguments: settings of a run that belong to no method and no scene."""


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
    """Solve a scene or a packing; no file is read or written.

    method : "auto", the fastest one that certifies the scene, or another name, or a method with its options, such as
        `CundallStrack(stiffness=1e6)`.
    tolerance : proven relative gap at which it is done.
    start : spins to start from: "linear", "random", "zero", "minimum-cut", the name of a file, or an array like
        `Result.spin`.
    callback : hears of each :class:`Check`; where it returns True the solve ends with what was reached, as by Ctrl-C.
    progress : show on a terminal or below the cell of a notebook how far it is, while it takes longer than a moment.
    options : `torque` on the top instead of its spin, force*length, for what finds minima; adds
        `yields`, `yield_torque`, `yield_torque_lower_bound` and `amplitude` to `findings`; `iterations` at most;
        `time_limit`, s; of a dynamics `duration`, the simulated time to go on for, and the simulated times `record` of
        the rows of the history and `snapshots` of spins that are kept, as numbers or as "log:start,stop,count";
        `slip_threshold`, length/time, up to which contacts count as slipless; `arch`, "cpu", "cuda", "vulkan", "metal"
        or "auto"; `precision`, "f64" or "f32"; `threads`, 0 for all.

    Ctrl-C ends the solve with what was reached. Raises InputError for what cannot be.
    """
    with displayed(progress):
        if callback is not None and not callable(callback):
            raise InputError(f"callback is {shown(callback)}; it must be a function that takes a Check")
        monitors = [] if callback is None else [_monitor(callback)]
        density = {"density": options.pop("density")} if isinstance(scene, Packing) and "density" in options else {}
        job = _job(scene, method, {"tolerance": tolerance, **options}, start)
        if isinstance(scene, Packing) and monitors and minimises(job.settings):
            raise InputError(f"callback is given, but method {job.settings.method} of a packing does not use it")
        return Result(replace(job.solve(monitors, **density), command="taichi_bearings.solve"))


def solve_many(
    scenes: Iterable[Scene | Packing],
    method: str | MethodOptions = "auto",
    tolerance: float = 1e-8,
    start: str | np.ndarray = "linear",
    workers: int = 0,
    **options: Any,
) -> Iterator[Result]:
    """Solve scenes or packings in processes of their own; gives the answers as they come, in whatever order.

    `answer.scene`, or `answer.packing`, is the very one that was given, which tells them apart. The other arguments are
    those of :func:`solve`; each process has one thread unless `threads` says otherwise.
    workers : processes at most; 0 for one a processor.

    Raises InputError before anything is computed, and BearingsError for the first scene that has no answer.
    """
    workers = SEED.named("workers", workers)
    if not isinstance(scenes, Iterable):
        raise InputError(f"scenes is a {type(scenes).__name__}; it must be scenes, as in solve_many([scene])")
    asked = {"tolerance": tolerance, **options}
    tasks = [JobTask(str(number), scene, _job(scene, method, asked, start)) for number, scene in enumerate(scenes)]
    found = solve_all(tasks, min(workers or available_threads(), max(1, len(tasks))))
    return (Result(replace(run, command="taichi_bearings.solve_many")) for run in found)


def analyse(result: Result | str | Path, threshold: float | None = None, sample: int = 0) -> Analysis:
    """An :class:`Analysis` of an answer, or of a run in a file: minimum cut, slipless network, rigid domains,
    bottlenecks and forces.

    threshold : slip speed, length/time, up to which contacts count as slipless. Default: the contact states of the run.
    sample : the one of several that is shown in figures and as `structure`.
    """
    found = load(result) if isinstance(result, (str, os.PathLike)) else result
    if not isinstance(found, Result):
        raise InputError(f"the result is {shown(found)}; it must be an answer of solve or load, or the path of a run")
    return Analysis(found._run, None if threshold is None else finite_number("threshold", threshold), sample)


def load(path: str | Path) -> Result:
    """The :class:`Result` of a run directory or its run.h5, whatever wrote it.

    FileError if it is missing, damaged or was changed.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise InputError(f"{shown(path)} is not a path; it must name a run directory or its run.h5")
    return Result(read_run(Path(path)))


def _job(
    scene: Scene | Packing, method: str | MethodOptions, options: Mapping[str, Any], start: str | np.ndarray
) -> runs.Job:
    """What solves this scene, with the settings of `bearings run`; InputError for what cannot be. Spins to start from
    that are an array lie beside the settings."""
    if isinstance(scene, Packing):
        settings = RunSettings(packing="run.h5", law=str(scene.law), seed=scene.seed, **_asked(method, options, start))
        strict = isinstance(method, str)  # else all options of the method are given
        if strict and "initial" in settings.given and minimises(settings):
            raise InputError(f"start is given, but method {settings.method} of a packing does not use it")
        settings = fitting(settings, strict)
        return runs.Job(settings, scene, None if isinstance(start, str) else start)
    if not isinstance(scene, Scene):
        raise InputError(f"the scene is a {type(scene).__name__}; it must be a taichi_bearings.Scene or a Packing")
    values: dict[str, Any] = {name: getattr(scene, name) for name in Scene.PARAMETERS}
    values |= {"shape": scene.lattice.shape, "law": str(scene.law), "seed": scene.seeds[0], "replicas": scene.replicas}
    if scene.lattice.dimension == 2:
        del values["direction"]  # which has no meaning there
    values |= scene.drawn or {"coefficients": "run.h5"}
    values |= _asked(method, options, start)
    settings = RunSettings.from_mapping(values, "the options")
    return runs.job_of(settings, scene, initial_spin(scene, start, "start"))


def _asked(method: str | MethodOptions, options: Mapping[str, Any], start: str | np.ndarray) -> dict[str, Any]:
    """What is asked for of any bearing, by key."""
    for name in options:
        if name not in ("tolerance", *OPTIONS):
            raise InputError(
                f"{name} is no option of solve, which has {', '.join(OPTIONS)}; "
                "options of a method belong to it, as in CundallStrack(stiffness=1e6)" + meant(name, OPTIONS)
            )
    values = dict[str, Any]()
    if isinstance(method, MethodOptions):
        declared = options_of(method)
        chosen = {name: getattr(method, name) for name in declared}
        values |= {name: value for name, value in chosen.items() if value != declared[name].default}
        method = method.name
    named = start if isinstance(start, str) else "initial_spin.npz"
    return values | {"method": method, "initial": named, **options}


def _monitor(callback: Callable[[Check], bool | None]) -> Callable[[Report], bool | None]:
    """A callback of a user as the loop knows it."""

    def plain(values: np.ndarray) -> Any:
        return values if len(values) > 1 else float(values[0])

    def monitor(report: Report) -> bool | None:
        progress = report.progress
        reached = plain(report.objective), plain(report.gap)
        return callback(Check(progress.iteration, report.seconds, progress.time, *reached, report.stop.tolerance))

    return monitor
