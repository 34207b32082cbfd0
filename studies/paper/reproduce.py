"""Computes the figures and claims of the paper anew and judges them: `bearings reproduce`.

A study is a module with a function `study(folder, effort)`. It makes its samples, as many as the effort says, and
returns their tables, the figure and the values that its claims use (:class:`.samples.StudyResult`); finished samples
are kept in the folder until the study ends. The sentences, limits and rules of its claims stand in claims/FIGURE.toml.
"""

import importlib
import json
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from matplotlib.figure import Figure

from taichi_bearings import runtime
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.whole_file import refuse_standing, write_text
from taichi_bearings.plain_files import read_json, read_whole
from taichi_bearings.plots.style import save
from taichi_bearings.runs.run_directory import writable_folder
from taichi_bearings.stages import each, stage
from taichi_bearings.version import VERSION
from taichi_bearings.words import meant

from ..report import environment
from .claims import VERDICTS, Claim, Effort, claims_of
from .page import page


@dataclass(frozen=True)
class PaperFigure:
    """One figure, with the claims about it.

    name : name by which users ask for it; the names of its files begin with it.
    title : what it shows.
    module : the module of this folder whose function `study` finds its numbers; MODULE.FUNCTION for another function.
    seconds : rough times in full and in the quick form, on two cores.
    shown : a sentence on the samples that the figure shows.
    tables : ends of the names of its CSV files.
    asked : True for a question beyond the paper, which is computed only if the user names it.
    samples_of : name of the figure whose samples it uses; "" for its own.
    """

    name: str
    title: str
    module: str
    seconds: tuple[float, float]
    shown: str = "All samples."
    tables: tuple[str, ...] = (".csv",)
    asked: bool = False
    samples_of: str = ""

    @property
    def files(self) -> tuple[str, ...]:
        """Names of all files of the figure: pictures and tables."""
        return tuple(f"{self.name}{ending}" for ending in (".png", ".pdf", *self.tables))

    def reproduce(self, folder: Path, effort: Effort, title: bool = True) -> list[Claim]:
        """Compute the figure, write its pictures and tables into the folder, and return its claims with their
        verdicts.

        effort : first seed, number of samples, and whether it is the quick form.
        title : False leaves out titles: panels have their letters alone.
        """
        runtime.start("cpu", "f64")
        module, _, function = self.module.partition(".")
        found = getattr(importlib.import_module(f".{module}", __package__), function or "study")(folder, effort)
        for ending in self.tables:
            found.tables[ending].write(folder / f"{self.name}{ending}")
        with stage("drawing"):
            drawn = found.draw(SimpleNamespace(**found.named))
            figure = drawn if title else _untitled(drawn)
            for ending in (".png", ".pdf"):
                save(figure, folder / f"{self.name}{ending}")
        claims = claims_of(self.name, found.named)
        self.forget(folder)
        return claims

    def forget(self, folder: Path) -> None:
        """Delete the journals with finished samples that a study, perhaps interrupted, has left in the folder."""
        for ending in JOURNALS:
            (folder / f"{self.samples_of or self.name}{ending}").unlink(missing_ok=True)


def _untitled(figure: Figure) -> Figure:
    """Remove the title of a figure, which is changed in place, and return the figure; of titles of panels that begin
    with a letter such as (a) this letter alone is left.
    """
    figure.suptitle("")
    for axes in figure.axes:
        if axes.get_title().startswith("("):
            axes.title.set_text(axes.get_title().partition(" ")[0])
    return figure


FIGURES = {
    figure.name: figure
    for figure in (
        PaperFigure("fig1", "Stationary states of 10x10 discs", "figure_1", (24, 8),
                    "(a, b) the first seed whose cut is not level; (c) all samples.", (".csv", "-samples.csv")),
        PaperFigure("fig2", "Relaxation of a 3x3x3 Coulomb bearing", "figure_2", (40, 35),
                    "Of the samples that are followed the first whose minimum is below its minimum cut."),
        PaperFigure("fig3", "A 10x10x10 Coulomb bearing, its slipless network and a path", "figure_3", (16, 10),
                    "The first seed whose slipless contacts join bottom and top."),
        PaperFigure("fig4", "The planes that its path goes through", "figure_3.planes", (4, 4),
                    "The sample of fig3.", (), samples_of="fig3"),
        PaperFigure("supplement", "Power of the contacts of 32x32x32 spheres: descent and certified minimum",
                    "supplement", (600, 60), "The first seed."),
        PaperFigure("network", "Slipless network and P_min / P_cut from 3x3x3 to 32x32x32", "network", (500, 15)),
        PaperFigure("distributions", "Other distributions of the friction coefficients",
                    "variants.distributions", (190, 10)),
        PaperFigure("drivings", "Other imposed bearing states", "variants.drivings", (40, 20)),
        PaperFigure("parameters", "Stiffness K, damping A and normal force F_n", "parameters", (60, 50),
                    "The first seed; claims are about all samples."),
        PaperFigure("exponents", "Minimum cuts of discs as directed polymers", "exponents", (1200, 25), asked=True),
        PaperFigure("surfaces", "Cut surfaces and minima of spheres, by size", "surfaces", (1100, 60), "All samples.",
                    (".csv", "-minima.csv"), asked=True),
        PaperFigure("odd-loops", "How many odd contacts stop a bearing of discs", "odd_loops", (4500, 20), asked=True),
        PaperFigure("yield", "The torques that a bearing holds", "yield_surface", (700, 60), asked=True),
        PaperFigure("limits", "What of the picture survives in large samples", "limits", (2600, 120), "All samples.",
                    (".csv", "-limits.csv"), asked=True),
    )
}  # fmt: skip
MOST_PICTURE = 2**26  # most bytes of a picture in the page
REPORTS = ("report.html", "report.json")
JOURNALS = (".jsonl", "-cuts.jsonl")  # ends of the names of the files in which studies keep finished samples


def choose_figures(names: Sequence[str]) -> list[str]:
    """Return the names of the figures to compute, each once; those of the paper and its supplement if the user names
    none. Raises InputError for an unknown name.
    """
    for name in names:
        if name not in FIGURES:
            raise InputError(f"figure is {name!r}; allowed are {', '.join(FIGURES)}{meant(name, FIGURES)}")
    return list(dict.fromkeys(names)) or [name for name, figure in FIGURES.items() if not figure.asked]


def reproduce(
    names: Sequence[str],
    folder: Path,
    effort: Effort,
    force: bool = False,
    tell: Callable[[str], None] = lambda _: None,
    title: bool = True,
) -> dict[str, Any]:
    """Compute figures, write their files and the report, as HTML and JSON, into `folder`; return the report as plain
    data.

    The report is written anew after each figure. Figures that it has already, of the same effort and version, are not
    computed again. Ctrl-C ends it early: finished figures are kept, and `missing` in the report names the others.

    names : figures to compute; empty for all of the paper and its supplement.
    effort : first seed, number of samples, and whether it is the quick form.
    force : compute the figures again, and replace files that exist.
    tell : function that is called with a line of text about each finished figure.
    title : False leaves titles out of the figures.

    Raises InputError or FileError before anything is computed.
    """
    chosen = choose_figures(names)
    before = {"figures": {}, "missing": []} if force else _earlier_report(folder, effort)
    done = {name: found for name, found in before["figures"].items() if all(map(Path.exists, _files(name, folder)))}
    asked = {*chosen, *before["figures"], *before["missing"]}
    missing = [name for name in FIGURES if name in asked and name not in done]
    unknown = [name for name in missing if name not in (*before["figures"], *before["missing"])]
    refuse_standing([path for name in unknown for path in _files(name, folder)], force)  # no report here names them
    expected, interrupted = (lambda name: FIGURES[name].seconds[effort.quick]), False
    with writable_folder(folder):
        for name in chosen if force else ():
            FIGURES[name].forget(folder)
        _write(folder, effort, done, missing)
        try:
            for name in each([name for name in chosen if name in missing], "figure", expected):
                with stage(name):
                    done[name] = _computed(name, folder, effort, title)
                missing.remove(name)
                _write(folder, effort, done, missing)
                tell(f"{name}: {_tally(done[name])}")
        except KeyboardInterrupt:
            interrupted = True
    return describe(folder, effort, done, missing) | {"interrupted": interrupted}


def _files(name: str, folder: Path) -> list[Path]:
    """Return the paths of all files of the figure `name` in a folder, whether they exist or not."""
    return [folder / file for file in FIGURES[name].files]


def _earlier_report(folder: Path, effort: Effort) -> dict[str, Any]:
    """Return what the report in a folder has: `figures`, its finished figures as plain data by name, and `missing`,
    the names of others that were asked for; both empty without a report.

    effort : the effort that is asked for now.

    Raises FileError if the report is of another effort or version, or cannot be read.
    """
    path = folder / "report.json"
    if not path.exists():
        return {"figures": {}, "missing": []}
    ours = {"seed": effort.seed, "samples": effort.samples, "quick": effort.quick, "version": VERSION}
    try:
        report = read_json(path)
        differ = [f"{name} {report[name]} instead of {ours[name]}" for name in ours if report[name] != ours[name]]
        figures, missing = dict(report["figures"]), list(report["missing"])
        known = bool(differ) or {*figures, *missing} <= FIGURES.keys()
        if not differ:
            page(describe(folder, effort, figures, missing), {})  # raises an error if the report lacks anything
    except (FileError, ValueError, LookupError, TypeError, AttributeError):
        known = False
    if not known:
        raise FileError(f"{path} is not a report that can be continued; choose another --out or add --force")
    if differ:
        others = ", ".join(differ)
        raise FileError(
            f"{path} is a report with other settings ({others}); choose another --out, or --force to overwrite it"
        )
    return {"figures": figures, "missing": missing}


def _write(folder: Path, effort: Effort, done: dict[str, Any], missing: Sequence[str]) -> None:
    """Write report.json and report.html into the folder of the figures.

    folder : where figures and reports are.
    effort : first seed, number of samples, and whether this is the quick form.
    done : finished figures as plain data, by name.
    missing : names of those that are not done yet.
    """
    report = describe(folder, effort, done, missing)
    write_text(folder / "report.json", json.dumps(report, indent=2, allow_nan=False) + "\n")
    pictures = {name: _files(name, folder)[0] for name in done}
    found = {name: read_whole(path, MOST_PICTURE) for name, path in pictures.items() if path.exists()}
    write_text(folder / "report.html", page(report, found))


def _computed(name: str, folder: Path, effort: Effort, title: bool) -> dict[str, Any]:
    """Compute one figure of the paper and return a summary for JSON: title, what is shown, claims with their verdicts,
    files, wall and processor seconds.

    name : name of the figure.
    folder : folder in which its files are written.
    effort : seed, number of samples, and whether the quick version is asked for.
    title : True to put titles above figures.
    """
    began, processor = time.perf_counter(), time.process_time()
    claims = FIGURES[name].reproduce(folder, effort, title)
    return {
        "title": FIGURES[name].title,
        "shown": FIGURES[name].shown,
        "claims": [claim.as_dict() for claim in claims],
        "seconds": round(time.perf_counter() - began, 1),
        "seconds_processor": round(time.process_time() - processor, 1),
    }


def _tally(figure: dict[str, Any]) -> str:
    """Return in words how many claims of a figure have which verdict.

    figure : the figure as plain data, with its `claims`.
    """
    found = Counter(claim["verdict"] for claim in figure["claims"])
    return ", ".join(f"{number} {verdict}" for verdict, number in found.items()) or "nothing to judge"


def describe(folder: Path, effort: Effort, done: dict[str, Any], missing: Sequence[str]) -> dict[str, Any]:
    """Return the report as plain data, figures in the order of FIGURES.

    folder : where figures and reports are.
    effort : first seed, number of samples, and whether this is the quick form.
    done : finished figures as plain data, by name.
    missing : names of those that are not done yet.
    """
    figures = {name: done[name] | {"files": list(map(str, _files(name, folder)))} for name in FIGURES if name in done}
    verdicts = Counter(claim["verdict"] for found in figures.values() for claim in found["claims"])
    return {
        "figures": figures,
        "missing": list(missing),
        **{verdict.replace(" ", "_"): verdicts[verdict] for verdict in VERDICTS},
        "seed": effort.seed,
        "samples": effort.samples,
        "quick": effort.quick,
        "command": _command([*figures, *missing], effort),
        "environment": environment(),
        "files": [str(folder / file) for file in REPORTS],
        "version": VERSION,
    }


def _command(names: Sequence[str], effort: Effort) -> str:
    """Return the command line that computes the same figures with the same numbers again.

    names : names of the figures, keys of FIGURES.
    effort : first seed, number of samples, and whether it is the quick form.
    """
    asked = [] if set(names) == set(choose_figures(())) else [name for name in FIGURES if name in names]
    quick = ["--quick"] if effort.quick else []
    return " ".join(
        ["bearings", "reproduce", *asked, *quick, "--seed", str(effort.seed), "--samples", str(effort.samples)]
    )
