"""What is being done right now: stages within stages, each named where its work begins.

`with stage("drawing")` stands around work that takes long, `for seed in each(seeds, "sample")` where there is much of a
kind. Who wants to know, as a terminal does, is the `listener`. Where nobody listens, in another thread or process too,
a stage is nothing.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, TypeVar

Item = TypeVar("Item")


@dataclass
class Stage:
    """Some work under way. name : what it is, as in "drawing". began : by time.perf_counter().

    number, total : which part of how many is under way; 0 where there are none.
    done : (seconds since it began, share of the work that was done then) at the start of each part, if that is known.
    report : what the work itself tells of where it stands, if it does. expected : seconds that it takes as far as
    anybody can tell beforehand; 0 where nobody can.
    """

    name: str
    number: int = 0
    total: int = 0
    began: float = field(default_factory=time.perf_counter)
    done: list[tuple[float, float]] = field(default_factory=list)
    report: Any = None
    expected: float = 0.0

    def tell(self, report: Any) -> None:
        """Let whoever listens know where this stage stands."""
        self.report = report
        if who := listener.get():
            who.hear(self)


@dataclass(frozen=True)
class Step:
    """Where a descent stands that nothing but its gap ends.

    iteration : steps so far. power, gap : reached by them. aim : gap at which it ends, to which the gap falls by like
    factors in like times.
    """

    iteration: int
    power: float
    gap: float
    aim: float


listener: ContextVar[Any] = ContextVar("listener", default=None)
"""What hears of all stages, or None: `begin` and `end` of each, and `hear` whenever one tells where it stands."""


@contextmanager
def stage(name: str, expected: float = 0.0) -> Iterator[Stage]:
    """The work inside is called `name`. expected : see :class:`Stage`."""
    new, who = Stage(name, expected=expected), listener.get()
    if who:
        who.begin(new)
    try:
        yield new
    finally:
        if who:
            who.end(new)


def each(items: Sequence[Item], name: str, work: Callable[[Item], float] | None = None) -> Iterator[Item]:
    """The items one after another; the stage says which of how many is under way.

    work : of an item, in any unit, where that is roughly known; `alike` where all take the same.
    """
    shares = [] if work is None else [work(item) for item in items]
    with stage(name) as under_way:
        under_way.total = len(items)
        for number, item in enumerate(items):
            under_way.number = number + 1
            if shares:
                done = sum(shares[:number]) / sum(shares)
                under_way.done.append((time.perf_counter() - under_way.began, done))
            under_way.tell(None)
            yield item


def alike(_: object) -> float:
    """The work of each of many that take about the same time."""
    return 1.0
