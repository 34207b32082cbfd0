"""The study of run time against error as files: CSV, Markdown, figure, and the numbers for `--json`."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from taichi_bearings.files.whole_file import write_csv, write_text
from taichi_bearings.plots.style import save

from ..plots.accuracy import Curve, Panel, draw_accuracy
from ..report import Files, markdown
from .accuracy import Entry, SceneResult

TARGETS = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)  # proven gaps whose times the table lists
COLUMNS = (
    "shape", "law", "seed", "method", "setting", "seconds", "seconds_compile", "power", "lower_bound", "proven_gap",
    "true_error", "reference_gap", "iterations", "status",
)  # fmt: skip


NAMES = ("accuracy.csv", "accuracy.md", "accuracy.png")


def write(files: Files, results: Sequence[SceneResult]) -> None:
    """One row a checkpoint as CSV, the table, and the figure."""
    csv, text, figure = files.paths
    write_csv(csv, COLUMNS, [row for result in results for entry in result.entries for row in _rows(result, entry)])
    write_text(text, table(results))
    save(draw_accuracy([panel(result) for result in results]), figure)


def _rows(result: SceneResult, entry: Entry) -> Iterable[tuple[Any, ...]]:
    """One row a checkpoint, with the columns COLUMNS."""
    scene = result.scene
    shape, gaps, errors = "x".join(map(str, scene.lattice.shape)), result.gaps(entry), result.errors(entry.power)
    for n in range(len(entry.seconds)):
        numbers = (entry.seconds[n], entry.seconds_compile, entry.power[n], entry.lower_bound[n], gaps[n], errors[n])
        yield (
            shape, scene.law.name, scene.seeds[0], entry.method, entry.settings[n], *map(float, numbers),
            result.reference_gap, int(entry.iterations[n]), entry.statuses[n],
        )  # fmt: skip


def table(results: Sequence[SceneResult]) -> str:
    """Markdown: the seconds in which each method proved each gap of TARGETS, and how far it got."""
    titles = ["method", *(f"{target:.0e}" for target in TARGETS), "proven", "error <=", "after", "ended", "compile"]
    parts = []
    for result in results:
        lines = [titles]
        for entry in result.entries:
            best = result.best(entry)
            times = [result.seconds_to(entry, target) for target in TARGETS]
            lines.append([
                entry.name,
                *("–" if time is None else _seconds(time) for time in times),
                f"{result.gaps(entry)[best]:.1e}",
                f"{result.errors(entry.power[best : best + 1])[0]:.1e}",
                _seconds(float(entry.seconds[best])),
                entry.statuses[best],
                _seconds(entry.seconds_compile) if entry.seconds_compile else "–",
            ])  # fmt: skip
        head = f"### {result.label}, seed {result.scene.seeds[0]}\n"
        known = f"The least power is known to a relative {result.reference_gap:.1e}.\n"
        left_out = [f"\nLeft out: {name} ({reason})." for name, reason in result.left_out.items()]
        parts.append("\n".join([head, known, markdown(lines), *left_out]))
    return "\n\n".join(parts) + "\n"


def _seconds(value: float) -> str:
    return f"{value:.3g} s" if value >= 1 else f"{value * 1e3:.3g} ms"


def summarise(result: SceneResult) -> dict[str, Any]:
    """The numbers of one scene for `--json`."""
    entries = []
    for entry in result.entries:
        best = result.best(entry)
        entries.append(
            {
                "method": entry.method,
                "setting": entry.settings[best],
                "status": entry.statuses[best],
                "seconds": float(entry.seconds[best]),
                "seconds_compile": entry.seconds_compile,
                "iterations": int(entry.iterations[best]),
                "power": float(entry.power[best]),
                "lower_bound": float(entry.lower_bound[best]),
                "proven_gap": float(result.gaps(entry)[best]),
                "true_error": float(result.errors(entry.power[best : best + 1])[0]),
                "seconds_to_gap": {f"{target:.0e}": result.seconds_to(entry, target) for target in TARGETS},
            }
        )
    return {
        "shape": list(result.scene.lattice.shape),
        "law": result.scene.law.name,
        "seed": result.scene.seeds[0],
        "reference": result.reference,
        "reference_gap": result.reference_gap,
        "entries": entries,
        "left_out": result.left_out,
    }


def panel(result: SceneResult) -> Panel:
    """What the figure shows of one scene: of each peer only its fastest linear solver, and only runs that got further
    than all shorter ones."""
    curves = []
    for method in dict.fromkeys(entry.method for entry in result.entries):
        entry = fastest(result, [entry for entry in result.entries if entry.method == method])
        gap, shown = result.gaps(entry), np.arange(len(entry.seconds))
        if entry.variant:
            order = np.argsort(entry.seconds)
            shown = order[gap[order] <= np.minimum.accumulate(gap[order])]
        curves.append(Curve(method, entry.name, entry.seconds[shown], result.errors(entry.power[shown]), gap[shown]))
    return Panel(result.label, result.reference_gap, curves)


def fastest(result: SceneResult, entries: Sequence[Entry]) -> Entry:
    """The entry that proves the smallest of the TARGETS that any of them proves, and is the first to do so."""
    for target in reversed(TARGETS):
        times = [(time, n) for n, entry in enumerate(entries) if (time := result.seconds_to(entry, target)) is not None]
        if times:
            return entries[min(times)[1]]
    return entries[0]
