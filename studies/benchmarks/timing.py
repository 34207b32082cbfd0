"""Times of things that are compared: warmed up, in turns, each many times; the median is what counts.

A drift of the machine meets all alike that way. Wall time says what a user waits for, processor time what is left of it
where other programs share the machine.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

LONGEST = 2**20  # repetitions in one call


@dataclass(frozen=True)
class Times:
    """Seconds of one of many: the median of the rounds, the quickest and the slowest; the processor's, all threads.

    each : (rounds,), in the order of the rounds.
    """

    seconds: float
    quickest: float
    slowest: float
    processor: float
    each: np.ndarray

    @classmethod
    def of(cls, wall: list[float], processor: list[float]) -> "Times":
        each = np.array(wall)
        return cls(float(np.median(each)), float(each.min()), float(each.max()), float(np.median(processor)), each)


def timed(calls: Mapping[str, Callable[[int], None]], rounds: int, slice_seconds: float) -> dict[str, Times]:
    """Time each call, which repeats something a number of times, `rounds` times in turns with the others.

    slice_seconds : what one call should take about, unless a single repetition takes longer.
    """
    number = {name: _enough(call, slice_seconds) for name, call in calls.items()}
    wall: dict[str, list[float]] = {name: [] for name in calls}
    processor: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            began, at = time.perf_counter(), time.process_time()
            call(number[name])
            wall[name].append((time.perf_counter() - began) / number[name])
            processor[name].append((time.process_time() - at) / number[name])
    return {name: Times.of(wall[name], processor[name]) for name in calls}


def _enough(call: Callable[[int], None], seconds: float) -> int:
    """Repetitions that take about so long; finding out warms up. A single time could be that of another program."""
    call(2)
    number = 2
    while number < LONGEST:
        took = min(_seconds(call, number) for _ in range(3))
        if took > seconds / 4:
            return max(1, int(number * seconds / took))
        number *= 4
    return number


def _seconds(call: Callable[[int], None], number: int) -> float:
    began = time.perf_counter()
    call(number)
    return time.perf_counter() - began
