"""One run from its settings: solve it, write the run directory, and go on with it after an interrupt."""

import secrets
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taichi_bearings import leaving
from taichi_bearings.errors import FileError, InputError, WriteError, warn
from taichi_bearings.files.whole_file import write_text
from taichi_bearings.interrupts import awaited, broken_off
from taichi_bearings.plain_files import real_path
from taichi_bearings.runs.job import Job, RunKind
from taichi_bearings.runs.lattice_run import LATTICES
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
from taichi_bearings.runs.settings import RunSettings, parse_toml, refuse_unloaded
from taichi_bearings.runs.writing import draw_figures, publish, self_contained, versions, write_run
from taichi_bearings.solvers.recording import SAME_TIME
from taichi_bearings.stages import stage

if TYPE_CHECKING:
    from taichi_bearings.solvers.drive import Monitor


def run_kind_of(settings: RunSettings) -> RunKind:
    """Return the kind of runs that settings describe: those of lattices between two planes, or those of packings."""
    if settings.is_packing:
        from taichi_bearings.runs.packing_run import PACKINGS  # and with it much of SciPy

        return PACKINGS
    return LATTICES


def prepare(settings: RunSettings, strict: bool = True) -> Job:
    """Return the job that the settings describe; every input error is raised here, before anything is computed.

    settings : settings of the run.
    strict : True to raise InputError for options that neither the method nor the law uses; False to ignore them, as a
        scan that compares methods does.
    """
    with stage("reading"):
        return run_kind_of(settings).job(settings, strict)


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
    if heard.is_set() or found.interrupted:
        return replace(found, interrupted=True)
    with leaving.saying(f"interrupted; the run is in {found.path}"):
        return replace(found, interrupted=broken_off(partial(draw_figures, found, title)))


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
        warn(f"{error}; the result is in {folder}")
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
        refuse_unloaded(parse_toml(scene), checkpoint_of(path))
        # `stored` names files as in the directory, where they stay; `settings` with their paths, to read them
        stored = RunSettings.from_mapping(parse_toml(scene) | changes, "the options")
        if stored.checkpoint_every is None:
            raise FileError(f"{checkpoint_of(path)} is damaged or was changed: its scene names no checkpoint_every")
        _refuse_passed(path, stored, changes, arrays)
        settings = RunSettings.from_mapping(parse_toml(scene, path) | changes, "the options")
        job = prepare(settings, strict=False)
        return _solve_with_checkpoints(path, job, stored, arrays or None, monitors, title)


def _refuse_passed(
    path: Path, settings: RunSettings, changes: Mapping[str, object], arrays: Mapping[str, np.ndarray]
) -> None:
    """Raise InputError for a new limit of a resumed run that its checkpoint has passed already: the run would end at
    once, and its result be replaced by the state of the checkpoint.

    path : the run directory.
    settings : the settings, with the new ones.
    changes : the new settings, by name.
    arrays : the checkpoint, by name. The samples of a packing have one each, of which the farthest counts.
    """

    def farthest(name: str) -> float:
        """Return the largest of the numbers of this name in the checkpoint, 0 where there is none."""
        return max((float(np.max(of)) for key, of in arrays.items() if key.rpartition("/")[2] == name), default=0.0)

    time, iteration, seconds = farthest("last_time"), farthest("iteration"), farthest("elapsed")
    if "duration" in changes and settings.duration is not None and time > settings.duration * (1 + SAME_TIME):
        said = f"duration is {settings.duration:g}", f"at the time {time:g}; it must be longer"
    elif "iterations" in changes and settings.iterations is not None and iteration > settings.iterations:
        said = f"iterations is {settings.iterations}", f"at iteration {iteration:.0f}; there must be more"
    elif "time_limit" in changes and settings.time_limit is not None and seconds > settings.time_limit:
        said = f"time_limit is {settings.time_limit:g} s", f"reached after {seconds:.3g} s; it must be longer"
    else:
        return
    raise InputError(f"{said[0]}, but the checkpoint of {path} is {said[1]}")


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
            warn(f"{error}; the run goes on")

    every = stored.checkpoint_every or np.inf
    try:
        with leaving.saying(f"interrupted; `bearings run --resume {path}` goes on from the last checkpoint"):
            found = job.solve(monitors, Checkpoints(every, write, arrays))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(str(path)) from None
    found = replace(found, path=path, command=command())

    def complete() -> Result:
        """Write the files of the finished run into its directory, and return the result."""
        with completed(path, _files_of_pictures(path)) as folder:
            write_run(folder, found)
        return found

    return written_or_rescued(
        found, complete, title, f"`bearings run --resume {path}` goes on from the last checkpoint"
    )


PICTURES = ("view.html", "run.vtkhdf", "movie.mp4", "movie.gif")  # files that other commands draw into a run directory


def _files_of_pictures(path: Path) -> list[str]:
    """Return the names of files in a run directory that show an earlier answer: figures, histograms, films and exports.

    path : the run directory.
    """
    from taichi_bearings.runs.figures import FIGURE_KINDS

    pictures = [f"{name}.{ending}" for name in (*FIGURE_KINDS, "power_histogram") for ending in ("png", "pdf")]
    drawn = [*pictures, "power_histogram.csv", "power_histogram.h5", *PICTURES]
    of_replicas = {f"{Path(name).stem}-replica-*{Path(name).suffix}" for name in drawn}
    return drawn + [file.name for pattern in sorted(of_replicas) for file in path.glob(pattern)]
