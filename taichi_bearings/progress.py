"""Shows what is being done, how far it is and how long it will take, on one line.

The line stands in a terminal, or below the cell of a notebook; in a pipe there is none.
"""

import math
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from importlib import import_module
from typing import Any

import numpy as np

from taichi_bearings.stages import Stage, listener
from taichi_bearings.words import counted

BETWEEN = "loading"  # name of the time outside all stages
QUIET_SECONDS = 0.4  # seconds until the line appears: what takes no longer needs none
REFRESH, REFRESH_NOTEBOOK = 8, 3  # times a second that the line is written anew
WINDOW = 3.0  # the pace is measured without the first third of the time, in which kernels may be compiled
FARTHEST = 5.0  # no time left is shown that is more than so many times the time so far
LEAST_LISTED = 0.05  # seconds that are listed in the sum of times


def in_notebook() -> bool:
    """Return True if a kernel of Jupyter runs this, and shows what it displays."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")


def is_seen() -> bool:
    """Return True if there is a notebook or a terminal that shows a line."""
    return in_notebook() or (sys.stderr is not None and sys.stderr.isatty())


class TerminalLine:
    """One line on stderr, if that is a terminal, that is written anew until the context ends.

    It is no longer than the terminal is wide. In a notebook it is a line below the cell, empty in the end.

    line : function that returns the text, called at each writing.
    """

    def __init__(self, line: Callable[[], str]) -> None:
        """Prepare to show a `line`; nothing is shown yet."""
        self.line, self._over = line, threading.Event()
        self._thread = threading.Thread(target=self._show, daemon=True)

    def __enter__(self) -> Any:
        """Begin to show the line, in a thread, if anybody sees it."""
        if is_seen():
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop showing the line, and wait for the thread that writes it."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def _show(self) -> None:
        """Show the line, in a thread, until the context ends."""
        if self._over.wait(QUIET_SECONDS):
            return
        if in_notebook():
            display = import_module("IPython.display").display
            handle = display({"text/plain": self.line()}, raw=True, display_id=True)
            while not self._over.wait(1 / REFRESH_NOTEBOOK):
                handle.update({"text/plain": self.line()}, raw=True)
            handle.update({"text/plain": ""}, raw=True)
        else:
            with _line_on_terminal(self.line):
                self._over.wait()


def _line_on_terminal(line: Callable[[], str]) -> Any:
    """Return a context that shows the line on a terminal.

    line : function that returns the text, called at each writing.
    """
    from rich.console import Console
    from rich.live import Live
    from rich.spinner import Spinner
    from rich.table import Table
    from rich.text import Text

    spinner = Spinner("dots")

    def whole() -> Table:
        """Return a turning sign and the text, as one row."""
        row = Table.grid(padding=(0, 1, 0, 0))
        row.add_row(spinner, Text(line(), no_wrap=True, overflow="ellipsis"))
        return row

    return Live(
        console=Console(stderr=True),
        get_renderable=whole,
        refresh_per_second=REFRESH,
        transient=True,
        redirect_stdout=sys.stdout is not None and sys.stdout.isatty(),  # what goes into a pipe or a file stays there
    )


class Display:
    """Listens to the stages of some work: shows on a line what is under way, and measures where the time goes.

    stages : stages under way, the outermost first.
    seconds : wall time by name, without that of stages inside, in the order in which they first began.
    """

    def __init__(self, since: float | None = None) -> None:
        """Prepare to listen; nothing is measured or shown yet.

        since : time at which the measured time begins, by time.perf_counter(); None for now.
        """
        # `_since`: time up to which `seconds` counts; `_context`: ends the line and the listening
        self.stages, self.seconds = list[Stage](), {BETWEEN: 0.0}
        self._since = time.perf_counter() if since is None else since
        self._context = ExitStack()

    def __enter__(self) -> "Display":
        """Show the line, and listen to stages."""
        self._context.enter_context(TerminalLine(self.line))
        self._context.callback(listener.reset, listener.set(self))
        return self

    def __exit__(self, *_: object) -> None:
        """End the line, and listen no more."""
        self._context.close()

    def begin(self, new: Stage) -> None:
        """Note that the stage `new` begins."""
        self.book()
        self.stages.append(new)
        self.seconds.setdefault(new.name, 0.0)

    def end(self, old: Stage) -> None:
        """Note that the stage `old` ends, and with it all stages inside it."""
        self.book()
        del self.stages[self.stages.index(old) :]

    def book(self) -> None:
        """Add the time since the last change of stages to the stage that is under way, the innermost one."""
        now = time.perf_counter()
        self.seconds[self.stages[-1].name if self.stages else BETWEEN] += now - self._since
        self._since = now

    def hear(self, stage: Stage) -> None:
        """Note when a stage reports how far it is.

        stage : the stage of work, with its report.
        """
        if stage.report is not None:
            stage.done.append((time.perf_counter() - stage.began, share_of(stage.report)[0]))

    def line(self) -> str:
        """Return the text of the line: the stages under way, outermost first, with what is known of each. The innermost
        one always shows a time."""
        now, stages, lines = time.perf_counter(), list(self.stages), list[str]()
        for stage in stages:
            is_innermost = stage is stages[-1]
            if stage.total == 1 and not is_innermost:
                continue
            words = [stage.name + (f" {stage.number:,} of {stage.total:,}" if stage.total > 1 else "")]
            if is_innermost or stage.report is None:
                left, until = forecast(stage)
                left -= now - stage.began - (stage.done[-1][0] if stage.done else 0.0)
                if 0 < left < math.inf:
                    words.append(f"{duration(left)} left{until}")
                elif is_innermost and now - stage.began >= 1:
                    words.append(f"{duration(now - stage.began)} so far")
                words += [] if stage.report is None else [standing(stage.report)]
            lines.append(", ".join(words))
        return " · ".join(lines) or BETWEEN

    def times(self) -> str:
        """Return a text with the seconds since the display began, in all and by stage, such as "3.1 s: solving 2.9"."""
        self.book()
        parts = [f"{name} {seconds:.1f}" for name, seconds in self.seconds.items() if seconds >= LEAST_LISTED]
        return f"{sum(self.seconds.values()):.1f} s: {', '.join(parts)}"


def displayed(wanted: bool = True) -> AbstractContextManager[Any]:
    """Return a context that shows how far the work inside is, if that is wanted and seen, and not shown already."""
    return Display() if wanted and is_seen() and listener.get() is None else nullcontext()


def standing(report: Any) -> str:
    """Return in words how far a solve is: iterations, simulated time, power and gap.

    report : what the solve says at a check, a solvers.drive.Report.
    """
    progress = report.progress
    words = [counted(progress.iteration, "iteration")]
    words += [f"t = {progress.time:.3g}"] if progress.time is not None else []
    return ", ".join([*words, f"P = {float(np.mean(report.objective)):.8g}", f"gap {gap_of(report):.1e}"])


def gap_of(report: Any) -> float:
    """Return the largest relative gap of all samples so far. If nothing is proven during a solve, as for packings, it
    is the gap of the interior-point method on its central path, which is no proof.

    report : what the solve says at a check, a solvers.drive.Report.
    """
    on_path = report.progress.gap_of_path
    return float(np.max(report.gap)) if on_path is None else on_path


def forecast(stage: Stage) -> tuple[float, str]:
    """Return the seconds that were left when a stage of work last reported, infinite if unknown, and words to follow
    this time: what it leads to, such as " to gap 1e-08" or " to the time limit", or how it was estimated.

    stage : the stage of work.

    The pace is that of the last two thirds of the stage's time, as kernels may be compiled in the first third. Where no
    pace is known, or it leaves more than FARTHEST times the time so far, the expected time of the stage is used.
    """
    seconds, report = (stage.done[-1][0] if stage.done else 0.0), stage.report
    left = seconds_left([point for point in stage.done if point[0] >= seconds / WINDOW])  # the first part may compile
    if report is None:
        return (stage.expected if stage.expected and not stage.done else left), ""
    until, limit = f" to {share_of(report)[1]}", report.stop.seconds - report.seconds
    if left > FARTHEST * seconds:
        left, until = stage.expected - seconds, " by an estimate from its size"
        left = left if left > 0 else math.inf
    return (left, until) if left < limit else (limit, " to the time limit")


def share_of(report: Any) -> tuple[float, str]:
    """Return the share of a solve that is done, from 0 to 1, not-a-number if unknown, and in words what will end it.

    report : what the solve says at a check, a solvers.drive.Report. Its `progress` has the simulated time of a
        dynamics, and how the gap of other methods falls: as iteration^-k with k = `falls_as`, if that is not 0, else by
        equal factors in equal times, to `falls_to`. Its `stop` has the duration and the tolerance.
    """
    gap = gap_of(report)
    progress, stop = report.progress, report.stop
    if progress.time is not None:
        return progress.time / stop.duration, f"t = {stop.duration:g}"
    if progress.falls_as:
        share = (stop.tolerance / gap) ** (1 / progress.falls_as) if gap > stop.tolerance else math.nan
        return share, f"gap {stop.tolerance:.0e}"
    aim = min(stop.tolerance, progress.falls_to)
    return _by_decades(gap, aim), f"gap {aim:.0e}"


def _by_decades(gap: float, aim: float) -> float:
    """Return the share of a solve that is done if the gap falls by equal factors in equal times, from 1 to `aim`;
    not-a-number where that is not known."""
    return math.log(gap) / math.log(aim) if 0 < aim < gap < 1 else math.nan


def seconds_left(points: Sequence[tuple[float, float]]) -> float:
    """Return the seconds left after the last of some points, at the pace of these points; infinite if it is not known.

    points : pairs of a time in seconds and the share of the work that was done then.
    """
    if len(points) < 3:
        return math.inf
    (began, before), (seconds, share) = points[0], points[-1]
    return (1 - share) * (seconds - began) / (share - before) if share > before else math.inf


def duration(seconds: float) -> str:
    """Return seconds in words.

    seconds : a time, 0 or more.
    """
    if seconds < 100:
        return f"{max(seconds, 0):.0f} s"
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
