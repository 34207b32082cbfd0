"""The structure of a stored run: `bearings analyse`."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import Structure
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.analysis_file import write_analysis
from taichi_bearings.files.run_file import AXES, StoredRun, read_run_file
from taichi_bearings.plots.style import save
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.run import scene_with, settings_of
from taichi_bearings.runs.run_directory import writable_folder
from taichi_bearings.runs.structure_figures import FIGURES, FIGURES_OF_ALL
from taichi_bearings.runs.structure_report import findings_of, numbers_of
from taichi_bearings.scene import Scene
from taichi_bearings.stages import alike, each, stage


def scene_of(run: StoredRun, replica: int) -> Scene:
    """One sample of a stored run as a scene."""
    settings = settings_of(run)
    parts = (tuple(values[replica][None] for values in sets) for sets in (run.coefficient, run.viscosity))
    return scene_with(settings, (settings.seed + replica,), *parts)


def structure_of(run: StoredRun, replica: int, threshold: float | None = None) -> Structure:
    """One sample of a stored run, ready to be looked at.

    threshold : slip speed up to which contacts count as slipless, whatever the run says. Default: the run's own states.
    """
    scene, proven = scene_of(run, replica), bool(_states_proven(run)[replica])
    slip, state = (tuple(values[replica] for values in sets) for sets in (run.slip, run.state))
    if threshold is not None:
        proven = False
        state = tuple(
            np.where(
                was == ContactState.DRIVEN,
                was,
                np.where(speed > threshold, ContactState.SLIPPING, ContactState.SLIPLESS),
            ).astype(np.uint8)
            for speed, was in zip(slip, state, strict=True)
        )
    _check_arrays(run, scene)
    power, bound = (float(np.atleast_1d(run.attribute(key))[replica]) for key in ("power", "lower_bound"))
    friction = None if run.friction is None else tuple(values[replica] for values in run.friction)
    unique = _minimum_is_unique(run)[replica] if threshold is None else None
    return Structure(scene, run.spin[replica], slip, state, power, bound, friction, proven, unique)


def _check_arrays(run: StoredRun, scene: Scene) -> None:
    """FileError if spins or slips have another shape than the scene, or are not finite."""
    spin_shape = scene.lattice.shape if scene.lattice.dimension == 2 else (*scene.lattice.shape, 3)
    wanted = [("spin", run.spin, spin_shape)]
    wanted += [
        (f"slip along {AXES[axis]}", run.slip[axis], scene.lattice.contact_shape(axis)) for axis in range(len(run.slip))
    ]
    for name, values, shape in wanted:
        if values.shape[1:] != tuple(shape) or not np.isfinite(values).all():
            raise FileError(f"{name} in {run.path} is damaged: it must hold finite numbers of shape {tuple(shape)}")


def draw(name: str, run: StoredRun, replica: int) -> Figure:
    """One figure of a sample of a run, or of all its samples; InputError if there is nothing to show."""
    if name in FIGURES_OF_ALL:
        return FIGURES_OF_ALL[name]([structure_of(run, number).bottlenecks.loads for number in range(len(run.spin))])
    figure = FIGURES[name](structure_of(run, replica))
    if figure is None:
        raise InputError(f"{run.path} has nothing for {name} to show: it holds no friction forces of the Coulomb law")
    return figure


def analyse(
    path: Path,
    out: Path | None = None,
    force: bool = False,
    replica: int = 0,
    threshold: float | None = None,
    figures: bool = True,
) -> dict[str, Any]:
    """Analyse every sample of a run, write /analysis and the figures, and return the report.

    path : a run directory or its run.h5. out : folder for analysis.h5 and the figures; default: into the run itself,
    where an earlier analysis is replaced. replica : the sample that is drawn alone. threshold : as in
    :func:`structure_of`.
    Raises InputError or FileError before anything is computed.
    """
    if threshold is not None and not 0 < threshold < np.inf:
        raise InputError(f"threshold is {threshold}; it must be a positive, finite slip speed")
    with stage("reading"):
        run = read_run_file(path)
    samples = len(run.spin)
    if not 0 <= replica < samples:
        raise InputError(f"replica is {replica}; {path} has {samples}, counted from 0")
    target = run.path if out is None else out / "analysis.h5"
    names = [*FIGURES, *(FIGURES_OF_ALL if samples > 1 else ())] if figures else []
    paths = {name: target.parent / f"{name}.png" for name in names}
    standing = [file for file in (target, *paths.values()) if file.exists()] if out is not None else []
    if standing and not force:
        raise FileError(f"{standing[0]} already exists; choose another --out or add --force")
    with writable_folder(target.parent):
        began = time.perf_counter()
        numbers, findings, loads = [], [], []
        for number in each(range(samples), "analysing sample" if samples > 1 else "analysing", alike):
            structure = structure_of(run, number, threshold)
            if number == replica:
                drawn = structure
            numbers.append(numbers_of(structure))
            findings.append(findings_of(structure))
            loads.append(structure.bottlenecks.loads)
        report = _report(run, numbers, threshold) | {"seconds": time.perf_counter() - began}
        if out is None or force:
            for name in (*FIGURES, *FIGURES_OF_ALL):  # of an earlier analysis; not all need come back
                (target.parent / f"{name}.png").unlink(missing_ok=True)
        with stage("writing"):
            write_analysis(target, findings, _flat(report), into_run=out is None)
        files = [target]
        for name, file in each(list(paths.items()), "drawing figure"):
            figure = FIGURES_OF_ALL[name](loads) if name in FIGURES_OF_ALL else FIGURES[name](drawn)
            if figure is not None:
                save(figure, file)
                files.append(file)
    return report | {"run": str(path), "files": [str(file) for file in files]}


def _report(run: StoredRun, numbers: Sequence[Mapping[str, Any]], threshold: float | None) -> dict[str, Any]:
    """Numbers of all samples; with several of them lists, one entry a sample."""
    from taichi_bearings import __version__

    together = {key: [sample[key] for sample in numbers] for key in numbers[0]}
    return {
        **(together if len(numbers) > 1 else numbers[0]),
        "threshold": float(run.attribute("slip_threshold")) if threshold is None else threshold,
        "states": _origin_of_states(run) if threshold is None else "threshold",
        "status": np.asarray(run.attribute("status")).tolist(),
        **{key: run.attribute(key) for key in ("method", "law", "contacts", "spin_top", "spin_bottom")},
        "shape": list(run.shape),
        "version": __version__,
    }


def _origin_of_states(run: StoredRun) -> str:
    """How the contacts were classified: proven, or decided by slip and friction together."""
    return "proven" if _states_proven(run).all() else "decided"


def _states_proven(run: StoredRun) -> np.ndarray:
    """For each sample whether its contact states are proven."""
    return np.broadcast_to(run.attributes.get("states_proven", False), len(run.spin)).astype(bool)


def _minimum_is_unique(run: StoredRun) -> list[bool | None]:
    """For each sample, None if the run does not know."""
    told = np.broadcast_to(run.attributes.get("minimum_is_unique", np.nan), len(run.spin)).tolist()
    return [None if value == "" or value != value else bool(value) for value in told]


def _flat(report: Mapping[str, Any]) -> dict[str, Any]:
    """What HDF5 can hold as attributes: numbers, texts, and lists of numbers."""
    return {key: value for key, value in report.items() if not isinstance(value, dict) and not _is_nested(value)}


def _is_nested(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(item, (dict, list)) for item in value)
