"""What is being done, how far it is and how long it will take, on one line of a terminal. Silent in a pipe."""

import math
import os
import shutil
import stat
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import Any

import numpy as np
from taichi_bearings_cli import STARTED

from taichi_bearings.stages import Stage, Watch, watched
from taichi_bearings.words import counted

QUIET_SECONDS = 0.4  # seconds until the line appears: what takes no longer needs none
REFRESH = 8  # times a second that the line is written anew
WINDOW = 3.0  # the pace is that since this part of the time
FARTHEST = 5.0  # times as long as what has been seen is foretold at most
LEAST_TOLD = 0.05  # seconds that are worth a word in the sum of times


class TerminalLine:
    """One line on stderr, no longer than the terminal is wide, that is written anew until the end; if it is a terminal.

    line : what it says, asked for at each writing.
    """

    def __init__(self, line: Callable[[], str]) -> None:
        self.line = line
        self.shown = sys.stderr is not None and sys.stderr.isatty()
        self._live: Any = None
        self._ended, self._lock = False, threading.Lock()
        self._timer = threading.Timer(QUIET_SECONDS, self._start)

    def __enter__(self) -> Any:
        if self.shown:
            self._timer.daemon = True
            self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()
        with self._lock:
            self._ended = True
            if self._live is not None:
                self._live.stop()

    def _start(self) -> None:
        from rich.console import Console
        from rich.live import Live
        from rich.spinner import Spinner
        from rich.table import Table
        from rich.text import Text

        spinner = Spinner("dots")

        def whole() -> Table:
            row = Table.grid(padding=(0, 1, 0, 0))
            row.add_row(spinner, Text(self.line(), no_wrap=True, overflow="ellipsis"))
            return row

        with self._lock:
            if not self._ended:
                console = Console(stderr=True)
                self._live = Live(console=console, get_renderable=whole, refresh_per_second=REFRESH, transient=True)
                self._live.start()


class Display(Watch):
    """Listens to the stages of a command: a line of the terminal says what is under way; `times` says where the time
    of the process went."""

    def __init__(self) -> None:
        super().__init__(since=STARTED)
        self._forecasts: dict[int, Forecast] = {}  # of the solves under way, by their stage
        self._context = ExitStack()

    def __enter__(self) -> "Display":
        self._context.enter_context(TerminalLine(self.line))
        self._context.enter_context(watched(self))
        return self

    def __exit__(self, *_: object) -> None:
        self._context.close()

    def hear(self, stage: Stage) -> None:
        if stage.report is not None:
            self._forecasts.setdefault(id(stage), Forecast()).look(stage.report)

    def end(self, old: Stage) -> None:
        super().end(old)
        self._forecasts.pop(id(old), None)

    def line(self) -> str:
        """Stages under way, outermost first, with what is known of them; the innermost one is always timed."""
        now, stages = time.perf_counter(), list(self.stages)
        words = [self._words(stage, now, stage is stages[-1]) for stage in stages]
        return " · ".join(filter(None, words)) or self.between

    def _words(self, stage: Stage, now: float, innermost: bool) -> str:
        if stage.total == 1 and not innermost:
            return ""
        words, forecast = [stage.name], self._forecasts.get(id(stage))
        words[0] += f" {stage.number:,} of {stage.total:,}" if stage.total > 1 else ""
        left = self._of_parts_left(stage, now)
        if forecast is not None and innermost:
            left = forecast.left(now)
        if not left and innermost and now - stage.began >= 1:
            left = f"{duration(now - stage.began)} so far"
        return ", ".join(filter(None, [*words, left, forecast.standing if forecast is not None and innermost else ""]))

    @staticmethod
    def _of_parts_left(stage: Stage, now: float) -> str:
        """Of a stage in parts, of which the first may compile."""
        left = seconds_left(stage.done[1:]) - (now - stage.began - stage.done[-1][0]) if stage.done else math.inf
        return f"{duration(left)} left" if 0 < left < math.inf else ""

    def times(self) -> str:
        """All the time since the process began, and its parts."""
        self.book()
        parts = [f"{name} {seconds:.1f}" for name, seconds in self.seconds.items() if seconds >= LEAST_TOLD]
        return f"{sum(self.seconds.values()):.1f} s: {', '.join(parts)}"


class Forecast:
    """Where a solve stands, and when it ends at the pace of the last two thirds of its time."""

    def __init__(self) -> None:
        self.points: list[tuple[float, float]] = []  # (seconds, share done) at each report
        self.told_at, self.left_then, self.until = 0.0, math.inf, ""
        self.standing = ""

    def look(self, report: Any) -> None:
        """Hear a report of a solve (solvers.drive.Report)."""
        progress, seconds = report.progress, report.seconds
        share, until = share_of(report)
        self.points.append((seconds, share))
        left = seconds_left([point for point in self.points if point[0] >= seconds / WINDOW])
        if left > FARTHEST * seconds:
            left = math.inf
        limit = report.stop.seconds - seconds
        self.left_then, self.until = (left, until) if left < limit else (limit, "the time limit")
        self.told_at = time.perf_counter()
        words = [counted(progress.iteration, "iteration")]
        words += [f"t = {progress.time:.3g}"] if progress.time is not None else []
        words += [f"P = {float(np.mean(report.objective)):.8g}", f"gap {float(np.max(report.gap)):.1e}"]
        self.standing = ", ".join(words)

    def left(self, now: float) -> str:
        """Time left and until what, where that is known and not over."""
        left = self.left_then - (now - self.told_at)
        return f"{duration(left)} left to {self.until}" if 0 < left < math.inf else ""


def share_of(report: Any) -> tuple[float, str]:
    """How much of a solve is done, and what ends it; not-a-number where that says nothing of the time.

    The gap of some methods falls by like factors in like times; that of others, and of a dynamics, when it will.
    """
    progress, stop = report.progress, report.stop
    if progress.time is not None:
        return progress.time / stop.duration, f"t = {stop.duration:g}"
    if progress.needed is not None:
        return progress.iteration / max(progress.needed, 1), "the end"
    gap, aim = float(np.max(report.gap)), stop.tolerance
    if progress.settles_at is not None and progress.settles_more:
        aim = min(aim, progress.settles_at)
    known = progress.geometric and 0 < aim < gap < 1
    return (math.log(gap) / math.log(aim) if known else math.nan), f"gap {aim:.0e}"


def seconds_left(points: Sequence[tuple[float, float]]) -> float:
    """Time left from (seconds, share of the work that was done then) on, at their pace; infinite if it is not known."""
    if len(points) < 3:
        return math.inf
    (began, before), (seconds, share) = points[0], points[-1]
    return (1 - share) * (seconds - began) / (share - before) if share > before else math.inf


def duration(seconds: float) -> str:
    """Seconds for people."""
    if seconds < 100:
        return f"{max(seconds, 0):.0f} s"
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


def in_lines(text: str, err: bool = False) -> str:
    """A report as it is printed: on a terminal lines that are too long for it are broken between words, and what
    follows is indented."""
    stream = sys.stderr if err else sys.stdout  # None where it is closed
    if stream is None or not stream.isatty():
        return text
    look: Any = {"break_long_words": False, "break_on_hyphens": False, "replace_whitespace": False}
    width = shutil.get_terminal_size().columns
    indents = [" " * (len(line) - len(line.lstrip()) + 4) for line in text.splitlines()]
    lines = zip(text.splitlines(), indents, strict=True)
    return "\n".join(textwrap.fill(line, width, subsequent_indent=indent, **look) for line, indent in lines)


HEARTBEAT = 30.0  # seconds between two lines in a log file


class ScanDisplay(TerminalLine):
    """A monitor for scan(): a live line if stderr is a terminal, one line now and then if it is a log file."""

    def __init__(self) -> None:
        self.progress: Any = None
        super().__init__(lambda: "reading" if self.progress is None else describe_scan(self.progress, samples=True))
        self.is_logged, self.told = False, time.monotonic()
        with suppress(OSError, ValueError, AttributeError):  # the log of a batch queue is a regular file
            self.is_logged = stat.S_ISREG(os.fstat(sys.stderr.fileno()).st_mode)

    def __call__(self, progress: Any) -> None:
        self.progress = progress
        if self.is_logged and time.monotonic() - self.told >= HEARTBEAT:
            self.told = time.monotonic()
            stamp = time.strftime("%Y-%m-%d %H:%M:%S")
            print(f"{stamp}  {describe_scan(progress)}", file=sys.stderr, flush=True)


def describe_scan(progress: Any, samples: bool = False) -> str:
    """Where a scan stands, in one line. samples : what is being solved too."""
    words = [f"{progress.done:,} of {progress.total:,} samples"]
    words += [f"{progress.failed:,} failed"] if progress.failed else []
    words += [f"{progress.rate:.3g}/s"] if progress.rate else []
    left = progress.seconds_left
    if progress.done + progress.failed == progress.total:
        return "  ".join([*words, "writing"])
    words += [f"{duration(left)} left"] if left is not None else []
    if samples and progress.running:
        words.append("now " + "; ".join(sample.label for sample in progress.running[:2]))
        words += [f"and {len(progress.running) - 2} more"] if len(progress.running) > 2 else []
    return "  ".join(words)
