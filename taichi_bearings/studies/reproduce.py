"""The figures and claims of the paper, each computed anew and judged: `bearings reproduce`."""

import importlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.whole_file import write_text
from taichi_bearings.studies.claims import Claim, Effort


@dataclass(frozen=True)
class PaperFigure:
    """title, the module of studies/ whose `reproduce(folder, effort)` returns its claims, and the files it writes."""

    title: str
    module: str
    files: tuple[str, ...]

    def reproduce(self, folder: Path, effort: Effort) -> list[Claim]:
        module = importlib.import_module(f"taichi_bearings.studies.{self.module}")
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
            raise InputError(f"figure is {name!r}; allowed are {', '.join(FIGURES)}")
    return list(dict.fromkeys(names)) or list(FIGURES)


def reproduce(
    names: Sequence[str],
    folder: Path,
    effort: Effort,
    force: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Compute the figures, write their files, report.json and report.md into `folder`; returns the report.

    Raises InputError or FileError before anything is computed.
    """
    chosen = choose_figures(names)
    paths = [folder / file for name in chosen for file in FIGURES[name].files] + [folder / file for file in REPORTS]
    standing = [path for path in paths if path.exists()]
    if standing and not force:
        raise FileError(f"{standing[0]} already exists; choose another --out or add --force")
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        claims = {}
        for name in chosen:
            tell(f"{name}: {FIGURES[name].title} ...")
            claims[name] = FIGURES[name].reproduce(folder, effort)
        report = describe(claims, folder, effort)
        write_text(folder / "report.json", json.dumps(report, indent=2, allow_nan=False) + "\n")
        write_text(folder / "report.md", table(claims, effort))
    except OSError as error:
        raise FileError(f"{folder} cannot be written: {error.strerror or error}") from None
    except KeyboardInterrupt:
        if made and not any(folder.iterdir()):
            folder.rmdir()
        raise
    return report


def describe(claims: dict[str, list[Claim]], folder: Path, effort: Effort) -> dict[str, Any]:
    """The report as plain data."""
    from taichi_bearings import __version__

    listed = [claim for found in claims.values() for claim in found]
    return {
        "figures": {
            name: {
                "title": FIGURES[name].title,
                "claims": [claim.as_dict() for claim in found],
                "files": [str(folder / file) for file in FIGURES[name].files],
            }
            for name, found in claims.items()
        },
        "confirmed": sum(claim.verdict == "confirmed" for claim in listed),
        "refined": sum(claim.verdict == "refined" for claim in listed),
        "refuted": sum(claim.verdict == "refuted" for claim in listed),
        "seed": effort.seed,
        "samples": effort.samples,
        "files": [str(folder / file) for file in REPORTS],
        "version": __version__,
    }


def table(claims: dict[str, list[Claim]], effort: Effort) -> str:
    """The report as Markdown: a table of claims for each figure."""
    parts = []
    for name, found in claims.items():
        rows = [f"| {claim.text} | **{claim.verdict}** | {claim.finding} |" for claim in found]
        image = f"![{name}]({FIGURES[name].files[0]})"
        head = f"## {name}: {FIGURES[name].title}"
        parts.append("\n".join([head, "", image, "", "| claim | verdict | finding |", "|---|---|---|", *rows]))
    return f"# Figures and claims, samples from seed {effort.seed}\n\n" + "\n\n".join(parts) + "\n"
