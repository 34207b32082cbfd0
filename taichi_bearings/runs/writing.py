"""Writes the files of a run directory and its figures; `runs/run_layout.py` knows the data sets of its run.h5."""

import contextlib
import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taichi_bearings import compiler
from taichi_bearings.errors import FileError, WriteError, printable, warn
from taichi_bearings.files.whole_file import write_arrays, write_text
from taichi_bearings.runs.run_directory import RunDirectory
from taichi_bearings.runs.run_layout import write_run_file
from taichi_bearings.runs.settings import DRIVING_KEYS, OF_DRIVEN, SIZES, RunSettings
from taichi_bearings.scene import Bearing, Scene
from taichi_bearings.scene.array_files import short_name
from taichi_bearings.scene.initial_spins import STARTS
from taichi_bearings.scene.solution import stacked
from taichi_bearings.stages import stage

if TYPE_CHECKING:
    from taichi_bearings.runs.result import Result

# settings of a packing that are left out of its stored scene, as the arrays in run.h5 have their effect
LED_TO_ARRAYS = {"distribution", "viscosity", *SIZES, *OF_DRIVEN}


@cache  # each checkpoint has them
def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that results depend on, by name."""
    import platform
    from importlib.metadata import version

    found = {name: version(name) for name in (compiler.name(), "numpy", "scipy", "h5py")}
    return {"python": platform.python_version(), **found}


def self_contained(
    settings: RunSettings, scene: Bearing, spin: np.ndarray | None, folder: Path, name: str = "run.h5"
) -> RunSettings:
    """Return settings that name only files in the run directory itself, so that it can be moved and run again. Arrays
    of other files are written into it.

    settings : settings of the run, which may name files elsewhere.
    scene : what is solved.
    spin : initial spins, (samples R, spheres *N) or (R, *N, 3), 1/time; written unless the settings have a name for
        them, such as "linear". None if only this name is known.
    folder : the run directory, to which the files are written.
    name : name of the file that the caller writes with coefficients or packing. With checkpoints they get a file of
        their own now, as the run may be resumed before there is a run.h5.
    """
    with_file, one = settings.checkpoint_every is not None, scene.replicas == 1
    # of a lattice coefficients are written if they were given, of a packing all arrays
    if isinstance(scene, Scene):
        if settings.coefficients is not None:
            name = "coefficients.npz" if with_file else name
            settings = replace(settings, coefficients=name)
            parts = [(kind, scene.lattice.by_axis(v[0] if one else v)) for kind, v in scene.named_coefficients.items()]
            arrays = {short_name(f"{kind}/{axis}"): v for kind, of in parts for axis, v in zip("xyz", of, strict=False)}
            if with_file:
                write_arrays(folder / name, arrays)
    else:
        kept = {key: value for key, value in settings.given.items() if key not in LED_TO_ARRAYS}
        name = "packing.npz" if with_file else name
        if with_file:
            found = stacked([scene.sample(number).arrays() for number in range(scene.replicas)])
            write_arrays(folder / name, {n: v[0] if one else v for n, v in found.items()})
        settings = RunSettings(**{**kept, "packing": name})
    if spin is not None and settings.initial not in STARTS:
        write_arrays(folder / "initial_spin.npz", {"spin": spin[0] if one else spin})
        settings = replace(settings, initial="initial_spin.npz")
    return settings


def publish(directory: RunDirectory, found: "Result") -> "Result":
    """Write a result into a new run directory, give the directory its name, and return the result with that path.

    directory : the run directory, which is being written under a hidden name.
    found : the result.
    """
    found = replace(found, path=directory.path)
    write_run(directory.partial, found)
    directory.publish()
    return found


def write_run(folder: Path, found: "Result") -> None:
    """Write all files of a run except its figures: run.h5, summary.json, scene.toml and the histogram.

    folder : the directory.
    found : the result.
    """
    from taichi_bearings.files.histogram_file import write_table

    with stage("writing"):
        stored = self_contained(found.asked, found.scene, found.given_start, folder)
        write_state(folder / "run.h5", found, stored)
        write_text(folder / "scene.toml", stored.to_toml())
        full = found.summary | {"settings": found.asked.described, "versions": versions()}
        write_text(folder / "summary.json", json.dumps(full, indent=2, allow_nan=False) + "\n")
    with _unless_full():
        write_table(folder / "power_histogram.csv", {None: found.histogram})


def write_state(file: Path, found: "Result", stored: RunSettings) -> None:
    """Write a result in the layout of run.h5.

    file : path of the file.
    found : the result.
    stored : settings by which it can be solved again, with names of files relative to that of the file.
    """
    origin = {"command": found.command, "scene": stored.to_toml()}
    numbers = {key: value for key, value in found.summary.items() if key not in DRIVING_KEYS}  # which the scene holds
    write_run_file(file, found.solution, numbers | origin | versions())


@contextlib.contextmanager
def _unless_full() -> Iterator[None]:
    """Context that turns a WriteError, such as on a full disk, into a warning, as the files written before suffice."""
    try:
        yield
    except WriteError as error:
        warn(f"{error}; the run is kept without it")


@contextlib.contextmanager
def _unless_undrawable() -> Iterator[None]:
    """Context in which errors of drawing become a warning, such as when matplotlib cannot be loaded. FileError and
    MemoryError are raised as they are.
    """
    try:
        yield
    except (FileError, MemoryError):
        raise
    except Exception as error:
        said = f"{type(error).__name__}: {printable(str(error))}"
        warn(f"no figures, matplotlib says: {said}; the run is kept without them")


def draw_figures(found: "Result", title: bool = True) -> None:
    """Draw the figures of a run into its directory, unless its settings ask for none.

    found : the result of the run.
    title : whether figures have words above them.
    """
    if found.asked.figures != "all":
        return
    with _unless_full(), _unless_undrawable(), stage("drawing"):
        from taichi_bearings.plots.curves import courses_of, draw_histogram, draw_history
        from taichi_bearings.plots.page import Page
        from taichi_bearings.plots.style import describe, save

        assert found.path is not None
        page = Page(title=title)
        save(draw_histogram(found.histogram, page, [describe(found.scene, None)]), found.path / "power_histogram.png")
        if courses_of(found.solution):
            save(draw_history(found.solution, page), found.path / "history.png")
