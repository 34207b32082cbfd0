"""Progress of a run on a terminal: rate, time left, power and gap. Silent in a pipe."""

import math
import sys
from typing import Any

import numpy as np


class TerminalProgress:
    """A monitor for solve(): one line on stderr that is rewritten at every check, if stderr is a terminal."""

    def __init__(self) -> None:
        self.shown = sys.stderr is not None and sys.stderr.isatty()
        self.checks: list[tuple[float, float]] = []  # (seconds, worst gap)
        self.first: tuple[float, int] | None = None
        self._status: Any = None

    def __enter__(self) -> "TerminalProgress":
        if self.shown:
            from rich.console import Console

            self._status = Console(stderr=True).status("compiling kernels")
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def __call__(self, report: Any) -> None:
        if not self.shown:
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
        words.append(f"{_duration(left)} left" if math.isfinite(left) else "time left unknown")
        self._status.update("  ".join(words))

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


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{max(seconds, 0):.0f} s"
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
