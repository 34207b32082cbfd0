"""Times all benchmarks in one way, and writes their reports. What is compared is warmed up and then timed in rounds,
each of which times everything once; the median over the rounds is reported.

So a machine that becomes slower or faster affects everything alike. Wall time is what a user waits for; processor time
is what that would be if no other program shared the machine. A measurement is a row, a dictionary of plain values; a
list in it has one value for each checkpoint of a run. Measurements run in processes of their own, since a process can
have one compiler runtime only. All rows are written as tables, CSV, JSON and figures by the same functions.
"""

import multiprocessing
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from taichi_bearings.errors import BearingsError
from taichi_bearings.files.whole_file import write_csv, write_text
from taichi_bearings.interrupts import unheard_by_children
from taichi_bearings.plots.style import save
from taichi_bearings.stages import each, stage

from ..report import duration, environment, load, markdown, scaled, short

T = TypeVar("T")
Row = dict[str, Any]
Measurements = Iterator[Row | str]  # rows, and sentences on what is left out and why
LONGEST = 2**20  # most repetitions in one call
TEXT = "report.md"
TARGETS = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)  # proven gaps whose times the table lists


@dataclass(frozen=True)
class Times:
    """Seconds that one repetition took, in each round.

    wall : (rounds,) wall time.
    processor : (rounds,) processor time of all threads; None if it is not known.
    """

    wall: np.ndarray
    processor: np.ndarray | None = None

    @property
    def seconds(self) -> float:
        """Median of the wall times."""
        return float(np.median(self.wall))

    def alone(self, threads: int) -> "Times":
        """Return the times that would be measured with no other program on the machine. With one thread that is the
        processor time; with more it cannot be known, and the times are returned as they are.

        threads : number of threads of what was timed.
        """
        return self if threads > 1 or self.processor is None else Times(self.processor)

    @property
    def row(self) -> Row:
        """The columns of a row of the table: median, quickest and slowest wall time, median processor time where it is
        known, all in seconds, and the number of rounds.
        """
        known = {} if self.processor is None else {"seconds_processor": float(np.median(self.processor))}
        ends = {"quickest": float(self.wall.min()), "slowest": float(self.wall.max())}
        return {"seconds": self.seconds, **ends, **known, "rounds": len(self.wall)}

    def over(self, other: "Times") -> float:
        """Return the median over the rounds of the ratio of wall times, these over the `other` ones, measured in the
        same rounds.
        """
        return float(np.median(self.wall / other.wall))


def in_turns(calls: Mapping[str, Callable[[int], T]], rounds: int) -> dict[str, list[T]]:
    """Call all functions once in each of `rounds` rounds, and return by name the list of what they have returned.

    calls : functions that are called with the number of the round, by name.
    """
    found: dict[str, list[T]] = {}
    for number in range(rounds):
        for name, call in calls.items():
            found.setdefault(name, []).append(call(number))
    return found


def timed(calls: Mapping[str, Callable[[int], None]], rounds: int, slice_seconds: float) -> dict[str, Times]:
    """Return the times of some functions by name, each of which is called once in each of `rounds` rounds.

    calls : functions that repeat something as often as their argument says, by name.
    slice_seconds : about how long one call should take; the number of repetitions is chosen so, at least one.
    """
    measured = {name: partial(clocked, call, _repetitions(call, slice_seconds)) for name, call in calls.items()}
    return {name: Times(*np.array(pairs).T) for name, pairs in in_turns(measured, rounds).items()}


def clocked(call: Callable[[int], None], number: int = 1, _: int = 0) -> tuple[float, float]:
    """Return wall and processor time, seconds, of one repetition, as the mean over one call.

    call : function that repeats something as often as its argument says.
    number : how often it is repeated.
    _ : number of the round, not used.
    """
    began, at = time.perf_counter(), time.process_time()
    call(number)
    return (time.perf_counter() - began) / number, (time.process_time() - at) / number


def _repetitions(call: Callable[[int], None], seconds: float) -> int:
    """Return how many repetitions take about so many seconds, at least one. They are tried, which also warms up what is
    measured. The least of three times is used, since a single one could be lengthened by another program.

    call : function that repeats something as often as its argument says.
    seconds : the time wanted.
    """
    call(2)
    number = 2
    while number < LONGEST:
        took = number * min(clocked(call, number)[0] for _ in range(3))
        if took > seconds / 4:
            return max(1, int(number * seconds / took))
        number *= 4
    return number


@dataclass(frozen=True)
class Plan:
    """How much is measured.

    shapes : lattices of the benchmark `kernels`.
    scenes : (shape, law) of the scenes of `methods`, which each method solves for at most `seconds`.
    scanned : lattices of `scans`, and for each the number of samples in a round.
    moved : lattices of `dynamics`.
    grown : spheres along an edge of the cubes of `growth`.
    rounds : how often everything is timed.
    seconds : time limit of a method.
    slice_seconds : about how long a timed call of a kernel takes.
    precisions : precisions of kernels, "f64" or "f32".
    steps : time steps of the dynamics in a round.
    seed : seed of the scenes.
    methods : names of the methods that are measured.
    peers : True if conic solvers are measured, too.
    threads : numbers of threads.
    """

    shapes: tuple[tuple[int, ...], ...]
    scenes: tuple[tuple[tuple[int, ...], str], ...]
    scanned: Mapping[tuple[int, ...], int]
    moved: tuple[tuple[int, ...], ...]
    grown: tuple[int, ...]
    rounds: int
    seconds: float
    slice_seconds: float
    precisions: tuple[str, ...] = ("f64",)
    steps: int = 50
    seed: int = 0
    methods: tuple[str, ...] = ()
    peers: bool = True
    threads: tuple[int, ...] = (1,)


@dataclass(frozen=True)
class Benchmark:
    """One thing that is measured: an entry of the table of benchmarks.

    title : a sentence on it, without a full stop.
    tasks : function that yields, for a plan, the name of each part and a function that yields its rows.
    missing : function that returns which other programs are not installed here, and how to install them, by name.
    faults : function that returns sentences on rows that contradict each other.
    findings : function that returns sentences on what all rows together say.
    figure : function that draws the rows; None for no figure.
    """

    title: str
    tasks: Callable[[Plan], Iterator[tuple[str, Callable[[], Measurements]]]]
    missing: Callable[[], dict[str, str]] = dict
    faults: Callable[[list[Row]], list[str]] = lambda rows: []
    findings: Callable[[list[Row]], list[str]] = lambda rows: []
    figure: Callable[[list[Row]], Any] | None = None


@dataclass
class Report:
    """All that was measured in one call of the benchmark.

    rows : rows (dictionaries of plain values) of each benchmark, by its name.
    notes : sentences on what the rows say, and on what was left out, and why.
    missing : other programs that are not installed here, and how to install them, by name.
    faults : sentences on rows that contradict each other.
    interrupted : True if Ctrl-C ended it early.
    """

    rows: dict[str, list[Row]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    interrupted: bool = False


def measure(chosen: Mapping[str, Benchmark], plan: Plan) -> Report:
    """Measure all chosen benchmarks, and return the report; Ctrl-C ends it and keeps what was measured until then.

    chosen : benchmarks by name.
    plan : sizes and repetitions of the measurements.
    """
    report = Report(missing={name: why for one in chosen.values() for name, why in one.missing().items()})
    tasks = [(name, words, rows) for name, one in chosen.items() for words, rows in one.tasks(plan)]
    try:
        for name, words, rows in each(tasks, "measuring, part"):
            with stage(f"{name} {words}"):
                try:
                    for found in rows():
                        _add_to_report(report, name, found)
                except BearingsError as error:
                    _add_to_report(report, name, f"{name} {words} left out: {error}")
    except KeyboardInterrupt:
        report.interrupted = True
    report.notes = [said for name, found in report.rows.items() for said in chosen[name].findings(found)] + report.notes
    report.faults = [fault for name, found in report.rows.items() for fault in chosen[name].faults(found)]
    return report


def _add_to_report(report: Report, name: str, found: Row | str) -> None:
    """Add to the report what a benchmark has found; a sentence that it has already is not added again.

    report : the report, changed in place.
    name : name of the benchmark.
    found : a row (a dictionary of measured values), or a sentence on what was left out and why.
    """
    if isinstance(found, str):
        report.notes += [] if found in report.notes else [found]
    else:
        report.rows.setdefault(name, []).append(found)


def elsewhere(find: Callable[..., Measurements], *arguments: Any) -> Measurements:
    """Yield the rows that `find(*arguments)` yields in a new process. Raises BearingsError if that process raises one,
    or dies.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with unheard_by_children():
        process = context.Process(target=_serve, args=(theirs, find, arguments))
        process.start()
    theirs.close()
    try:
        while (found := ours.recv()) is not None:
            if isinstance(found, BearingsError):
                raise found
            yield found
    except EOFError:
        raise BearingsError("the process that made the measurement ended without a result") from None
    finally:
        process.kill()


def _serve(pipe: Connection, find: Callable[..., Measurements], arguments: Sequence[Any]) -> None:
    """Send the rows that `find(*arguments)` yields through the pipe, then None; a BearingsError is sent like a row. It
    is run by the process that :func:`elsewhere` starts.
    """
    try:
        for found in find(*arguments):
            pipe.send(found)
    except BearingsError as error:
        pipe.send(error)
    pipe.send(None)


def machine() -> dict[str, Any]:
    """Return facts on the machine by name: hardware, programs, and how many processes want a processor now (`load`)."""
    return {**environment(), "load": load()}


def text(chosen: Mapping[str, Benchmark], report: Report, here: Mapping[str, Any]) -> str:
    """Return the report as a text: the machine, a table and a figure for each benchmark, then what was left out and
    what is missing.

    chosen : benchmarks by name.
    here : the machine, as :func:`machine` returns it.
    """
    parts = [f"{here['processor']}, {here['threads']}; load {here['load']}"]
    for name, rows in report.rows.items():
        parts.append(f"### {name}\n{chosen[name].title}.\n\n{_table(rows)}")
        parts += [f"![{chosen[name].title}]({name}.png)"] if chosen[name].figure else []
    notes = [*report.faults, *report.notes, *(f"Without {name}: {why}" for name, why in report.missing.items())]
    return "\n\n".join([*parts, "\n".join(f"* {note}" for note in notes)] if notes else parts) + "\n"


COLUMNS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "what": ("", str), "shape": ("lattice", lambda shape: "x".join(map(str, shape))), "law": ("law", str),
    "components": ("components", str), "precision": ("precision", str), "threads": ("threads", str),
    "seconds": ("time", duration), "quickest": ("quickest", duration), "slowest": ("slowest", duration),
    "seconds_processor": ("processor", duration), "contact_updates": ("contacts/s", scaled),
    "memory": ("memory", "{:.2g} GB".format), "factorising": ("factorising", "{:.0%}".format),
    "operations": ("operations", "{:.2g}".format), "factor": ("factor", "{:.2g} GB".format),
    "proven": ("proven", "{:.0%}".format), **{f"{gap:.0e}": (f"to {gap:.0e}", duration) for gap in TARGETS},
    "proven_gap": ("gap", "{:.1e}".format), "true_error": ("error <=", "{:.1e}".format),
    "reference_gap": ("known to", "{:.1e}".format), "after": ("after", duration), "status": ("ended", str),
    "seconds_compile": ("compile", duration),
    "ratio": ("this program is", lambda ratio: f"{short(ratio)} times as fast"),
}  # fmt: skip
"""For each key of a row that tables show: the title of the column, and how a value is written."""


def _table(rows: Sequence[Row]) -> str:
    """Return rows as a Markdown table, with all columns of COLUMNS that some of them have; lists are left out."""
    shown = [
        {key: of for key, of in (row | row.get("seconds_to", {})).items() if not isinstance(of, list)} for row in rows
    ]
    columns = [
        [title, *(word(row[key]) if key in row else "" for row in shown)] for key, (title, word) in COLUMNS.items()
    ]
    return markdown(list(zip(*(words for words in columns if any(words[1:])), strict=True)))


def write(folder: Path, chosen: Mapping[str, Benchmark], report: Report, here: Mapping[str, Any]) -> list[Path]:
    """Write the report as text, all numbers of each benchmark as CSV, and its figure if it has one; return the paths.

    folder : where the files go.
    chosen : benchmarks by name.
    here : the machine, as :func:`machine` returns it.
    """
    written = [folder / TEXT]
    write_text(written[0], text(chosen, report, here))
    notes = [f"{name}: {value}" for name, value in here.items()]
    for name, rows in report.rows.items():
        lines = [line for row in rows for line in _csv_lines(row)]
        columns = list(dict.fromkeys(key for line in lines for key in line))
        written.append(folder / f"{name}.csv")
        write_csv(written[-1], columns, [[line.get(key, "") for key in columns] for line in lines], notes)
        draw = chosen[name].figure
        if draw:
            written.append(folder / f"{name}.png")
            save(draw(rows), written[-1])
    return written


def _csv_lines(row: Row) -> Iterator[Row]:
    """Yield the lines of a CSV file that a row of measured values makes, each a dictionary by column: one line, or one
    for each checkpoint of the run if the row has lists. Dictionaries in the row are left out.
    """
    plain = {key: "x".join(map(str, of)) if isinstance(of, tuple) else of for key, of in row.items()}
    lists = {key: of for key, of in plain.items() if isinstance(of, list)}
    shared = {key: "" if of is None else of for key, of in plain.items() if not isinstance(of, (list, dict))}
    for values in zip(*lists.values(), strict=True) if lists else [()]:
        yield shared | dict(zip(lists, values, strict=True))


def as_json(report: Report, here: Mapping[str, Any], files: Sequence[Path]) -> dict[str, Any]:
    """Return the object that `bearings benchmark --json` prints: the machine, the rows of each benchmark by its name,
    notes, contradictions between rows, programs that are not installed, and the files.

    report : all that was measured.
    here : the machine, as :func:`machine` returns it.
    files : paths that were written.
    """
    return {
        "machine": here, **report.rows, "left_out": report.notes,
        "contradictions": report.faults, "peers_missing": report.missing, "interrupted": report.interrupted,
        "files": [str(path) for path in files],
    }  # fmt: skip
