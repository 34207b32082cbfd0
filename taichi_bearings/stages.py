"""Says what is being done right now: stages within stages, each named where its work begins.

`with stage("drawing")` stands around work that takes long, `for seed in each(seeds, "sample")` where there are many
equal parts. Whoever shows progress, such as a terminal, is the `listener`. Without a listener, as in another thread or
process, a stage does nothing.
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
    """Some work under way, of which progress can be shown.

    name : what it is, as in "drawing".
    number, total : which part of how many is under way; 0 where there are none.
    began : when it began, by time.perf_counter().
    done : (seconds since it began, share of the work that was done then) at the start of each part, if that is known.
    report : what the work says of where it stands: a `Step` or a solvers.drive.Report; None if it says nothing.
    expected : seconds that it is estimated to take; 0 if unknown.
    """

    name: str
    number: int = 0
    total: int = 0
    began: float = field(default_factory=time.perf_counter)
    done: list[tuple[float, float]] = field(default_factory=list)
    report: Any = None
    expected: float = 0.0

    def tell(self, report: object) -> None:
        """Store a report on how far this stage is, and notify the listener.

        report : the new value of the attribute `report`.
        """
        self.report = report
        if who := listener.get():
            who.hear(self)


listener: ContextVar[Any] = ContextVar("listener", default=None)
"""Hears of all stages, or is None; its methods are `begin` and `end` of a stage, and `hear` of a report."""


@contextmanager
def stage(name: str, expected: float = 0.0) -> Iterator[Stage]:
    """Name the work inside the block, so that its progress can be shown. The block gets the new :class:`Stage`.

    name : what the work is, as in "drawing".
    expected : seconds that it is estimated to take; 0 if unknown.
    """
    new, who = Stage(name, expected=expected), listener.get()
    if who:
        who.begin(new)
    try:
        yield new
    finally:
        if who:
            who.end(new)
        new.report = None  # its arrays may be large, and callers may still hold the stage


def each(items: Sequence[Item], name: str, work: Callable[[Item], float] | None = None) -> Iterator[Item]:
    """Yield the items one after another; progress shows which of how many is under way.

    items : the items.
    name : what an item is, in the singular.
    work : function that returns the work of an item, in any unit, where that is roughly known; `alike` where all take
        the same; None where it is unknown.
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
    """Return 1, as the work of each of many items that take about the same time.

    _ : the item, which does not matter.
    """
    return 1.0
