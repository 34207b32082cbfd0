"""The figures and claims of the paper, each computed anew and judged: `bearings reproduce`."""

import importlib
import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.whole_file import refuse_standing, write_text
from taichi_bearings.paper.claims import KINDS, VERDICTS, Claim, Effort
from taichi_bearings.runs.run_directory import writable_folder
from taichi_bearings.stages import each, stage
from taichi_bearings.version import VERSION
from taichi_bearings.words import counted, meant


@dataclass(frozen=True)
class PaperFigure:
    """title, the module of paper/ whose `reproduce(folder, effort)` returns its claims, and the files it writes."""

    title: str
    module: str
    files: tuple[str, ...]

    def reproduce(self, folder: Path, effort: Effort) -> list[Claim]:
        module = importlib.import_module(f"taichi_bearings.paper.{self.module}")
        claims: list[Claim] = module.reproduce(folder, effort)
        return claims


FIGURES = {
    "fig1": PaperFigure(
        "Stationary states of 10x10 discs", "figure_1", ("fig1.png", "fig1.pdf", "fig1.csv", "fig1-samples.csv")
    ),
    "fig2": PaperFigure("Relaxation of a 3x3x3 Coulomb bearing", "figure_2", ("fig2.png", "fig2.pdf", "fig2.csv")),
    "fig3": PaperFigure(
        "A 10x10x10 Coulomb bearing, its slipless network and a path", "figure_3", ("fig3.png", "fig3.pdf", "fig3.csv")
    ),
    "fig4": PaperFigure("The planes that its path goes through", "figure_4", ("fig4.png", "fig4.pdf")),
    "network": PaperFigure(
        "Slipless network and P_min / P_cut from 3x3x3 to 32x32x32",
        "network",
        ("network.png", "network.pdf", "network.csv"),
    ),
}
REPORTS = ("report.json", "report.md")


def choose_figures(names: Sequence[str]) -> list[str]:
    """The figures asked for, each once; all of them if none is named."""
    for name in names:
        if name not in FIGURES:
            raise InputError(f"figure is {name!r}; allowed are {', '.join(FIGURES)}{meant(name, FIGURES)}")
    return list(dict.fromkeys(names)) or list(FIGURES)


def reproduce(
    names: Sequence[str],
    folder: Path,
    effort: Effort,
    force: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Compute the figures, write their files, report.json and report.md into `folder`; returns the report.

    The report is written anew after each figure. Figures that it has already, of the same effort and version, are not
    computed again; with `force` all are. tell : hears a line about each figure that is done.
    Ctrl-C ends it early: what is done is kept, and "missing" names the rest.
    Raises InputError or FileError before anything is computed.
    """
    chosen = choose_figures(names)
    before = {"figures": {}, "missing": []} if force else _standing(folder, effort)
    done = {name: found for name, found in before["figures"].items() if all(map(Path.exists, _files(name, folder)))}
    asked = {*chosen, *before["figures"], *before["missing"]}
    missing = [name for name in FIGURES if name in asked and name not in done]
    unknown = [name for name in missing if name not in (*before["figures"], *before["missing"])]
    refuse_standing([path for name in unknown for path in _files(name, folder)], force)  # they are somebody else's
    interrupted = False
    with writable_folder(folder):
        for name in chosen if force else ():
            (folder / f"{name}.jsonl").unlink(missing_ok=True)  # what an interrupted study has kept
        _write(folder, effort, done, missing)
        try:
            for name in each([name for name in chosen if name in missing], "figure"):
                with stage(name):
                    done[name] = _described(name, FIGURES[name].reproduce(folder, effort))
                missing.remove(name)
                _write(folder, effort, done, missing)
                tell(f"{name}: {_tally(done[name])}")
        except KeyboardInterrupt:
            interrupted = True
    return describe(folder, effort, done, missing) | {"interrupted": interrupted}


def _files(name: str, folder: Path) -> list[Path]:
    return [folder / file for file in FIGURES[name].files]


def _standing(folder: Path, effort: Effort) -> dict[str, Any]:
    """The report that a folder has: figures and those missing. FileError if its effort or version differ."""
    path = folder / "report.json"
    if not path.exists():
        return {"figures": {}, "missing": []}
    ours = {"seed": effort.seed, "samples": effort.samples, "version": VERSION}
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        theirs = {name: report[name] for name in ours}
        figures, missing = dict(report["figures"]), list(report["missing"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(f"{path} already exists and is no report; choose another --out or add --force") from error
    if theirs != ours:
        words = [f"{name} {theirs[name]} instead of {ours[name]}" for name in ours if theirs[name] != ours[name]]
        raise FileError(f"{path} already exists and has {', '.join(words)}; choose another --out or add --force")
    return {"figures": figures, "missing": missing}


def _write(folder: Path, effort: Effort, done: dict[str, Any], missing: Sequence[str]) -> None:
    report = describe(folder, effort, done, missing)
    write_text(folder / "report.json", json.dumps(report, indent=2, allow_nan=False) + "\n")
    write_text(folder / "report.md", table(report))


def _described(name: str, claims: Sequence[Claim]) -> dict[str, Any]:
    """A figure as plain data."""
    return {"title": FIGURES[name].title, "claims": [claim.as_dict() for claim in claims]}


def _tally(figure: dict[str, Any]) -> str:
    """How many claims of a figure have which verdict."""
    found = Counter(claim["verdict"] for claim in figure["claims"])
    return ", ".join(f"{number} {verdict}" for verdict, number in found.items()) or "nothing to judge"


def describe(folder: Path, effort: Effort, done: dict[str, Any], missing: Sequence[str]) -> dict[str, Any]:
    """The report as plain data, figures in the order of FIGURES."""
    figures = {name: done[name] | {"files": list(map(str, _files(name, folder)))} for name in FIGURES if name in done}
    verdicts = Counter(claim["verdict"] for found in figures.values() for claim in found["claims"])
    return {
        "figures": figures,
        "missing": list(missing),
        **{verdict.replace(" ", "_"): verdicts[verdict] for verdict in VERDICTS},
        "seed": effort.seed,
        "samples": effort.samples,
        "files": [str(folder / file) for file in REPORTS],
        "version": VERSION,
    }


def table(report: dict[str, Any]) -> str:
    """The report as Markdown: a table of claims for each figure."""
    parts = [f"# Figures and claims, {counted(report['samples'], 'sample')} from seed {report['seed']}"]
    parts += [f"Not done yet: {', '.join(report['missing'])}."] if report["missing"] else []
    parts += [f"What a claim rests on: {'; '.join(f'**{kind}**: {text}' for kind, text in KINDS.items())}."]
    for name, figure in report["figures"].items():
        rows = [
            f"| {claim['claim']} | **{claim['verdict']}** | {claim['kind']} | {claim['finding']} |"
            for claim in figure["claims"]
        ]
        head = "| claim | verdict | rests on | finding |\n|---|---|---|---|"
        image = f"![{name}]({FIGURES[name].files[0]})"
        parts += [f"## {name}: {figure['title']}", image, "\n".join([head, *rows])]
    return "\n\n".join(parts) + "\n"
