"""The structure of a stored run: `bearings analyse`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taichi_bearings.files.analysis_file import write_analysis
from taichi_bearings.files.whole_file import refuse_standing
from taichi_bearings.plots.style import save
from taichi_bearings.runs.analysis import Analysis
from taichi_bearings.runs.run import Run, settings_of
from taichi_bearings.runs.run_directory import writable_folder
from taichi_bearings.runs.run_file import read_run_file
from taichi_bearings.runs.structure_figures import FIGURES, FIGURES_OF_ALL
from taichi_bearings.stages import each, stage


def analyse(
    path: Path,
    out: Path | None = None,
    force: bool = False,
    replica: int = 0,
    threshold: float | None = None,
    figures: bool = True,
) -> dict[str, Any]:
    """Analyse every sample of a stored run, write /analysis and the figures, and return the report.

    path : a run directory or its run.h5. out : folder for analysis.h5 and the figures; default: into the run itself,
    where an earlier analysis is replaced. replica : the sample that is drawn alone. threshold : as of
    :class:`Analysis`.
    Raises InputError or FileError before anything is computed.
    """
    with stage("reading"):
        run = read_run_file(path)
        ended = Run(settings_of(run), run.solution).status
    target = run.path if out is None else out / "analysis.h5"
    paths = [target.parent / f"{name}.png" for name in ((*FIGURES, *FIGURES_OF_ALL) if figures else ())]
    refuse_standing((target, *paths), force or out is None)
    with writable_folder(target.parent):
        found = Analysis(run.solution, [status.value for status in ended], threshold, replica)
        if out is None or force:
            for name in (*FIGURES, *FIGURES_OF_ALL):  # of an earlier analysis; not all need come back
                (target.parent / f"{name}.png").unlink(missing_ok=True)
        with stage("writing"):
            write_analysis(target, found.arrays, _flat(found.report), into_run=out is None)
        files = [target]
        for name in each(found.figures if figures else [], "drawing figure"):
            figure = found.plot(name)
            if figure is not None:
                files.append(target.parent / f"{name}.png")
                save(figure, files[-1])
    return found.report | {"run": str(path), "files": [str(file) for file in files]}


def _flat(report: Mapping[str, Any]) -> dict[str, Any]:
    """What HDF5 can hold as attributes: numbers, texts, and lists of numbers."""
    return {key: value for key, value in report.items() if not isinstance(value, dict) and not _is_nested(value)}


def _is_nested(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(item, (dict, list)) for item in value)
