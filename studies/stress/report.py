"""Runs all cells of stress (a method, a sample, one extreme value) and reports them: a journal that loses nothing,
CSV, a table, maps, and numbers.

A *line* is a dictionary on a finished cell, as :meth:`.cells.Judge.row` returns it. A cell is *red* if its answer is
wrong without saying so, or if it crashed.
"""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from taichi_bearings.errors import FileError
from taichi_bearings.files.scan_journal import Journal, read_journal
from taichi_bearings.files.whole_file import write_csv, write_text
from taichi_bearings.plots.style import SUPERSCRIPTS, in_our_style, new_figure, save
from taichi_bearings.runs.run_directory import writable_folder
from taichi_bearings.scans.engine import LocalEngine, Outcome
from taichi_bearings.stages import alike, each
from taichi_bearings.version import VERSION

from .axes import AXES, Axis, Cell, Row
from .cells import CRASH, OUTCOMES, RIGHT, WRONG, Judge, solve_cells

Line = dict[str, Any]
START_UP = 60.0  # seconds that a worker may take to start, to compile and to prove, in addition to twice the time limit
JOURNAL = "cells.jsonl"
UNREADABLE = (LookupError, TypeError, ValueError, AttributeError, ArithmeticError)
"""Errors at a record that another program has written; its cell is solved again."""
COLOURS = {"right": "#8fce9b", "not reached": "#f3d98a", "refused": "#c9d3e0", "wrong": "#d62728", "crash": "#222222"}
NOTHING = "#ffffff"  # colour of a cell that was not tried


@contextmanager
def open_sweep(folder: Path, cells: Sequence[Cell]) -> Iterator["Sweep"]:
    """Open the report in a folder, to solve and judge these cells; no other process can write there meanwhile.

    folder : of the report; a new or empty one starts a report, and one with a report is continued.
    cells : all cells that the report should have.

    Raises FileError if another process works there, or the folder holds something else.
    """
    names = {file.name for file in folder.iterdir() if file.name[0] != "."} if folder.is_dir() else set()
    if names and JOURNAL not in names:
        raise FileError(f"{folder} is not empty and holds no stress report; choose another --out")
    with writable_folder(folder):
        yield Sweep(folder, cells)


class Sweep:
    """The cells (a method, a sample, one extreme value) of a stress report in a folder. Cells that the journal in the
    folder has from this version of the program are only judged again, the others are solved.

    lines : for each finished cell by its key, its line of the report.
    """

    def __init__(self, folder: Path, cells: Sequence[Cell]) -> None:
        """Read the journal of the folder, and judge those of the cells again that it has from this version of the
        program.

        folder : folder of the report.
        cells : all cells that the report should have.
        """
        self.folder, self.cells, self.judge = folder, {cell.key: cell for cell in cells}, Judge()
        known = read_journal(folder / JOURNAL)
        solved = [cell for cell in cells if known.get(cell.key, {}).get("version") == VERSION]
        self.lines = dict[str, Line]()
        for cell in each(solved, "judging cell", alike):
            with suppress(*UNREADABLE):
                self.lines[cell.key] = self.judge.row(cell, known[cell.key])

    def run(self, workers: int, say: Callable[[str], None] = lambda line: None) -> bool:
        """Solve the cells that are missing, by worker processes; return False if Ctrl-C ended that early.

        workers : number of processes.
        say : function that is called with a line of text on each cell whose answer is wrong, or that crashed.
        """

        def take(outcomes: Sequence[Outcome]) -> None:
            """Judge cells that workers have finished, and append what was found (`outcomes`) to the journal."""
            for outcome in outcomes:
                cell = outcome.unit[0]
                crash = {"key": cell.key, "version": VERSION, "crash": outcome.reason}
                record = outcome.records[0] if outcome.records else crash
                line = self.lines[cell.key] = self.judge.row(cell, record)
                journal.append([record])
                if line["outcome"] in (WRONG, CRASH):
                    say(f"{line['outcome']}: {cell.key}: {line['reason']}")

        missing = [cell for key, cell in self.cells.items() if key not in self.lines]
        engine = LocalEngine(solve_cells, workers, lambda unit: START_UP + 2 * unit[0].most_seconds)
        with Journal(self.folder / JOURNAL) as journal, closing(engine):
            try:
                for cell in each(missing, "cell", alike):
                    while not engine.can_take_unit:
                        take(engine.collect(0.2))
                    engine.submit((cell,))
                while engine.running:
                    take(engine.collect(0.2))
            except KeyboardInterrupt:
                return False
        return True

    @property
    def rows(self) -> list[Line]:
        """The finished cells, in the order of the report."""
        order = {name: number for number, name in enumerate(AXES)}
        return sorted(
            (self.lines[key] for key in self.cells if key in self.lines), key=lambda line: order[line["axis"]]
        )

    @property
    def red(self) -> list[Line]:
        """Finished cells whose answer is wrong without saying so, and those that crashed. A cell is one extreme value
        of a parameter for one method, law and device.
        """
        return [line for line in self.rows if line["outcome"] in (WRONG, CRASH)]

    def write(self) -> list[Path]:
        """Write all files but the journal (CSV, summary, maps), and return their paths."""
        rows, paths = self.rows, [self.folder / name for name in ("stress.csv", "summary.json")]
        columns = [name for name in rows[0] if name != "key"] if rows else ["axis"]
        write_csv(paths[0], columns, ([line[name] for name in columns] for line in rows))
        write_text(paths[1], json.dumps(self.summary(), indent=1, allow_nan=False) + "\n")
        for axis in dict.fromkeys(line["axis"] for line in rows):
            figure = draw_outcomes(AXES[axis], [line for line in rows if line["axis"] == axis])
            for ending in (".png", ".pdf"):
                paths.append(self.folder / f"{axis}{ending}")
                save(figure, paths[-1])
        return paths

    def summary(self) -> dict[str, Any]:
        """Return the numbers of the report by name: numbers of cells by outcome, the largest relative error of a right
        answer, how exactly answers scale with the units, and the cells whose answer is wrong without saying so or that
        crashed (`red`). A cell is one extreme value of a parameter for one method, law and device.
        """
        rows = self.rows
        counts = Counter(line["outcome"] for line in rows)
        return {
            "version": VERSION, "cells": len(self.cells), "done": len(rows),
            "outcomes": {outcome: counts[outcome] for outcome in OUTCOMES},
            "largest_error_of_right": max((x["error"] or 0.0 for x in rows if x["outcome"] == RIGHT), default=0.0),
            "scaling": scaling(rows),
            "red": [{key: line[key] for key in ("key", "outcome", "reason")} for line in self.red],
        }  # fmt: skip


def _row_in_words(line: Line) -> str:
    """Return in words the method, law, dimension, device and precision of a finished cell, from its line of the
    report.
    """
    return str(Row(*(line[key] for key in ("method", "law", "dimension", "arch", "precision"))))


def _error_in_words(line: Line) -> str:
    """Return the relative error in a line of the report as a power of ten; "exact" below the rounding of doubles, ""
    without an error.
    """
    error = line["error"]
    if error is None:
        return ""
    return "exact" if error < 1e-16 else f"10{str(round(math.log10(error))).translate(SUPERSCRIPTS)}"


def scaling(rows: Sequence[Line]) -> dict[str, Any]:
    """Return how exactly right answers scale with the units, by method and precision. Each power in other units is
    compared with the power in plain units times the ratio of the units.

    rows : finished cells.

    returns : for each, the number of powers compared (`of`), the number of those that are equal bit for bit (`exact`),
        and the largest relative `deviation`.
    """
    found: dict[str, list[float]] = {}
    scaled = [line for line in rows if line["axis"].endswith("-scale") and line["outcome"] == RIGHT]
    plain = {(line["axis"], _row_in_words(line)): line["objective"] for line in scaled if line["value"] == "1"}
    for line in scaled:
        before = plain.get((line["axis"], _row_in_words(line)))
        if line["value"] != "1" and before:
            deviation = abs(line["objective"] / line["unit"] / before - 1)
            found.setdefault(f"{line['method']} {line['precision']}", []).append(deviation)
    return {name: {"exact": of.count(0), "of": len(of), "deviation": max(of)} for name, of in found.items()}


def lines_of(summary: Mapping[str, Any]) -> list[str]:
    """Return the summary in words, as a list of lines."""
    words = [f"{number} {outcome}" for outcome, number in summary["outcomes"].items()]
    found = [
        f"{summary['done']} of {summary['cells']} cells (a value, method, law and precision each): "
        f"{', '.join(words)}; not "
        "reached means that the run says so itself"
    ]
    for method, of in summary["scaling"].items():
        exact, cells, deviation = (of[key] for key in ("exact", "of", "deviation"))
        found.append(
            f"  {method}, the same samples in other units: {exact} of {cells} powers are the same to the last bit, the "
            f"others differ by at most a relative {deviation:.1e}"
        )
    return found


@in_our_style
def draw_outcomes(axis: Axis, lines: Sequence[Line]) -> Figure:
    """Draw a map of one axis: the outcome of each cell as a colour, with its relative error as a power of ten.

    axis : the parameter that is varied; its values are the columns, in order.
    lines : finished cells of the axis; each method, law, dimension, device and precision among them has a row.
    """
    tried, rows = {line["value"] for line in lines}, sorted(dict.fromkeys(map(_row_in_words, lines)))
    columns = [name for name in axis.columns if name in tried]
    kinds = list(COLOURS)
    codes = np.full((len(rows), len(columns)), len(kinds))
    figure = new_figure(2.3 + 0.42 * len(columns), 1.1 + 0.19 * len(rows))
    axes = figure.add_subplot()
    for line in lines:
        i, j, outcome = rows.index(_row_in_words(line)), columns.index(line["value"]), line["outcome"]
        codes[i, j] = kinds.index(outcome)
        colour = "white" if outcome in (WRONG, CRASH) else "black"
        axes.text(j, i, _error_in_words(line), ha="center", va="center", fontsize=7, color=colour)
    colours = ListedColormap([*COLOURS.values(), NOTHING])
    look: Any = {"cmap": colours, "vmin": -0.5, "vmax": len(kinds) + 0.5, "edgecolors": "white", "lw": 1}
    axes.pcolormesh(np.arange(len(columns) + 1) - 0.5, np.arange(len(rows) + 1) - 0.5, codes, **look)
    slanted: dict[str, Any] = {"rotation": 30, "ha": "right"} if max(map(len, columns)) > 6 else {}
    axes.set_xticks(range(len(columns)), columns, **slanted)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.invert_yaxis()
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_xlabel(axis.title)
    figure.supxlabel("in each cell: relative error of the power", fontsize=7)
    used = [kind for number, kind in enumerate(kinds) if (codes == number).any()]
    handles = [Patch(color=COLOURS[kind], label=kind) for kind in used]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(used))
    return figure
