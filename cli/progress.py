"""Progress of a run or a scan on a terminal: rate, time left, what is being done. Silent in a pipe."""

import math
import os
import stat
import sys
import time
from typing import Any

import numpy as np


class TerminalStatus:
    """One line on stderr that says what is being done, if stderr is a terminal: ``with TerminalStatus() as tell``.

    first : what it says until it is told something else.
    """

    def __init__(self, first: str = "reading") -> None:
        self.first = first
        self.shown = sys.stderr is not None and sys.stderr.isatty()
        self._status: Any = None

    def __enter__(self) -> "TerminalStatus":
        if self.shown:
            from rich.console import Console

            self._status = Console(stderr=True).status(self.first)
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def __call__(self, text: str) -> None:
        if self._status is not None:
            self._status.update(text)


class TerminalProgress:
    """A monitor for solve(): one line on stderr that is rewritten at every check, if stderr is a terminal."""

    def __init__(self) -> None:
        self.status = TerminalStatus("compiling kernels")
        self.checks: list[tuple[float, float]] = []  # (seconds, worst gap)
        self.first: tuple[float, int] | None = None

    def __enter__(self) -> "TerminalProgress":
        self.status.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.status.__exit__()

    def __call__(self, report: Any) -> None:
        if not self.status.shown:
            return
        progress = report.progress
        if self.first is None:
            self.first = (report.seconds, progress.iteration)
        worst = float(np.max(report.gap))
        self.checks.append((report.seconds, worst))
        rate = (progress.iteration - self.first[1]) / max(report.seconds - self.first[0], 1e-9)
        words = [f"{progress.iteration:,} iterations", f"{rate:,.0f}/s"]
        words += [f"t = {progress.time:.3g}"] if progress.time is not None else []
        words += [f"P = {float(np.mean(report.power)):.8g}", f"gap {worst:.1e}"]
        left = self._seconds_left(report.stop.tolerance)
        if rate > 0 and math.isfinite(rate):
            left = min(left, (report.stop.iterations - progress.iteration) / rate)
        left = min(left, report.stop.seconds - report.seconds)
        if math.isfinite(report.stop.duration):  # goes on for that long, whatever the gap
            left = self._seconds_to(report.stop.duration, progress.time, report.seconds)
        words.append(f"{duration(left)} left" if math.isfinite(left) else "time left unknown")
        self.status("  ".join(words))

    def _seconds_to(self, duration: float, time: float, seconds: float) -> float:
        """Wall time to the end of the simulated time, at the pace so far."""
        return seconds * (duration - time) / time if time > 0 else math.inf

    def _seconds_left(self, tolerance: float) -> float:
        """Extrapolate the gap as a power of the time over the second half of the run."""
        now, gap = self.checks[-1]
        earlier = next(((s, g) for s, g in self.checks if s >= now / 2), None)
        if earlier is None or earlier[0] >= now or not 0 < gap < earlier[1] or gap <= tolerance:
            return math.inf
        slope = math.log(earlier[1] / gap) / math.log(now / earlier[0])
        exponent = math.log(gap / tolerance) / slope
        return now * (math.exp(exponent) - 1) if exponent < 50 else math.inf


def duration(seconds: float) -> str:
    """Seconds for people."""
    if seconds < 100:
        return f"{max(seconds, 0):.0f} s"
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


HEARTBEAT = 30.0  # seconds between two lines in a log file


class ScanDisplay:
    """A monitor for scan(): a live line if stderr is a terminal, one line now and then if it is a log file.

    heartbeat : seconds between two lines, wherever stderr goes; 0 for none. Default: 30 in a file, none in a pipe.
    """

    def __init__(self, heartbeat: float | None = None) -> None:
        self.status = TerminalStatus()
        self.every = (HEARTBEAT if _is_file(sys.stderr) else 0.0) if heartbeat is None else heartbeat
        self.told = time.monotonic()

    def __enter__(self) -> "ScanDisplay":
        self.status.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.status.__exit__()

    def __call__(self, progress: Any) -> None:
        if self.status.shown:
            self.status(describe_scan(progress, samples=True))
        if self.every and time.monotonic() - self.told >= self.every:
            self.told = time.monotonic()
            stamp = time.strftime("%Y-%m-%d %H:%M:%S")
            print(f"{stamp}  {describe_scan(progress)}", file=sys.stderr, flush=True)


def describe_scan(progress: Any, samples: bool = False) -> str:
    """Where a scan stands, in one line. samples : what is being solved too."""
    words = [f"{progress.done:,} of {progress.total:,} samples"]
    words += [f"{progress.failed:,} failed"] if progress.failed else []
    words += [f"{progress.rate:.3g}/s"] if progress.rate else []
    left = progress.seconds_left
    words.append(f"{duration(left)} left" if left is not None else "time left unknown")
    if samples and progress.running:
        words.append("now " + "; ".join(sample.label for sample in progress.running[:2]))
        words += [f"and {len(progress.running) - 2} more"] if len(progress.running) > 2 else []
    return "  ".join(words)


def _is_file(stream: Any) -> bool:
    """True if a stream goes into a regular file, such as the log of a batch queue."""
    try:
        return stat.S_ISREG(os.fstat(stream.fileno()).st_mode)
    except (OSError, ValueError, AttributeError):
        return False
