"""Times of things that are compared: warmed up, in turns, each many times; the median is what counts.

A drift of the machine meets all alike that way. Wall time says what a user waits for, processor time what is left of it
where other programs share the machine. What was measured is a Row, as the table, the CSV and the JSON show it.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from typing import Any, TypeVar

import numpy as np

from .. import report

T = TypeVar("T")
LONGEST = 2**20  # repetitions in one call
PARTS = {
    "memory": "bandwidth by working set",
    "kernels": "sweeps, steps and iterations",
    "methods": "one sample to a proven gap, beside conic solvers",
    "scans": "samples a second, beside conic solvers",
    "dynamics": "time steps, beside LAMMPS and YADE",
}


@dataclass(frozen=True, kw_only=True)
class Row:
    """One thing measured. What a part does not know is None.

    part : of PARTS. what : the kernel, the method, the peer. seconds : of one sweep, step, solve or sample, the median;
    quickest, slowest : of the rounds; seconds_processor : of all threads. seconds_compile : to get ready at first, what
    getting ready takes anyway left out. contact_updates : a second.
    bytes, operations, roots : of one, as counted. bandwidth : bytes a second, of these. bandwidth_here : what the
    machine delivers from a working set of the same size, in the same rounds; operations_here, roots_here : what it
    reckons with at most, a second. roof : share of the speed that memory,
    operations and roots allow. limit : which of them. ratio : how many times as fast as this ours is.
    bytes_per_sphere : of the fields, or of all memory. gap : proven. proven : share of samples with all states proven.
    load : of the machine when the row was done.
    """

    part: str
    what: str
    shape: tuple[int, ...] | None = None
    law: str | None = None
    components: int | None = None
    precision: str = "f64"
    threads: int | None = None
    seconds: float
    quickest: float | None = None
    slowest: float | None = None
    seconds_processor: float | None = None
    seconds_compile: float | None = None
    rounds: int | None = None
    contact_updates: float | None = None
    working_set: float | None = None
    bytes: float | None = None
    operations: float | None = None
    roots: float | None = None
    passes: int | None = None
    bandwidth: float | None = None
    bandwidth_here: float | None = None
    operations_here: float | None = None
    roots_here: float | None = None
    roof: float | None = None
    limit: str | None = None
    ratio: float | None = None
    bytes_per_sphere: float | None = None
    iterations: int | None = None
    gap: float | None = None
    status: str | None = None
    samples: int | None = None
    proven: float | None = None
    load: float | None = field(default_factory=report.load)

    @property
    def size(self) -> str:
        return "x".join(map(str, self.shape)) if self.shape else ""

    def known(self) -> dict[str, Any]:
        """For JSON: what is known."""
        return {name: value for name, value in asdict(self).items() if value is not None}


COLUMNS = tuple(column.name for column in fields(Row))


@dataclass(frozen=True)
class Times:
    """Seconds of one of many, (rounds,) in their order: the wall's, and the processor's of all threads if known."""

    each: np.ndarray
    processor: np.ndarray | None = None

    @classmethod
    def of(cls, pairs: Sequence[tuple[float, float]]) -> "Times":
        """Of wall and processor time of each round."""
        wall, processor = np.array(pairs).T
        return cls(wall, processor)

    @property
    def seconds(self) -> float:
        return float(np.median(self.each))

    @property
    def columns(self) -> dict[str, Any]:
        """Those of a Row."""
        return {
            "seconds": self.seconds,
            "quickest": float(self.each.min()),
            "slowest": float(self.each.max()),
            "seconds_processor": None if self.processor is None else float(np.median(self.processor)),
            "rounds": len(self.each),
        }


def in_turns(
    calls: Mapping[str, Callable[[int], T]], rounds: int, again: Callable[[T], bool] = lambda first: True
) -> dict[str, list[T]]:
    """What each call, which hears the number of the round, gives in every round, in turns with the others.

    again : whether a call whose first answer is this one is made in the later rounds too.
    """
    found: dict[str, list[T]] = {}
    for turn in range(rounds):
        for name, call in calls.items():
            if turn == 0 or again(found[name][0]):
                found.setdefault(name, []).append(call(turn))
    return found


def timed(calls: Mapping[str, Callable[[int], None]], rounds: int, slice_seconds: float) -> dict[str, Times]:
    """Time each call, which repeats something a number of times, `rounds` times in turns with the others.

    slice_seconds : what one call should take about, unless a single repetition takes longer.
    """
    clocked = {name: partial(_clocked, call, _enough(call, slice_seconds)) for name, call in calls.items()}
    return {name: Times.of(pairs) for name, pairs in in_turns(clocked, rounds).items()}


def _clocked(call: Callable[[int], None], number: int, _: int = 0) -> tuple[float, float]:
    """Wall and processor time of one of so many repetitions."""
    began, at = time.perf_counter(), time.process_time()
    call(number)
    return (time.perf_counter() - began) / number, (time.process_time() - at) / number


def _enough(call: Callable[[int], None], seconds: float) -> int:
    """Repetitions that take about so long; finding out warms up. A single time could be that of another program."""
    call(2)
    number = 2
    while number < LONGEST:
        took = number * min(_clocked(call, number)[0] for _ in range(3))
        if took > seconds / 4:
            return max(1, int(number * seconds / took))
        number *= 4
    return number
