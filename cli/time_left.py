"""How long a solve will still take, foretold from what is left: gap against tolerance, simulated time, iterations.

A gap is followed along a straight line: its logarithm against the time where it falls geometrically, against the
logarithm of the time where it falls like a power of it. Simulated time and iterations are followed against the time.
A line through few points says little, and a gap may fall in stairs. So nothing is foretold until what was foretold
before, for a while, agrees with it; and nothing that lies far beyond what has been seen.
"""

import math
from typing import Any

import numpy as np

WINDOW = 3.0  # the line goes through what has happened since this part of the time
LAST = 3  # checks that it goes through at least, and at most where a gap falls geometrically
AGREEMENT = 1.5  # factor between times left, as foretold by now and before, up to which they agree
FARTHEST = 5.0  # times as long as what has been seen
EQUAL = 1e-6  # relative difference of steps that are the same


class TimeLeft:
    """Listens to the reports of a solve (solvers.drive.Report) and foretells its end."""

    def __init__(self) -> None:
        self.seen: list[tuple[float, float]] = []  # (seconds, what is followed)
        self.foretold: list[tuple[float, float]] = []  # (seconds, seconds left at that time)
        self.steps: list[float] = []  # mean length of the steps of a dynamics, at each report

    def look(self, report: Any) -> tuple[float, str] | None:
        """Seconds left and until what; None where that is not known."""
        progress, stop, seconds = report.progress, report.stop, report.seconds
        if seconds <= 0:
            return None
        if progress.time is not None and math.isfinite(stop.duration):
            left = self._follow(seconds, progress.time, stop.duration)
            farthest = math.inf if self._steps_are_equal(progress) else FARTHEST * seconds
            return None if left is None or left > farthest else (left, f"t = {stop.duration:g}")
        if progress.needed is not None:
            left = self._follow(seconds, progress.iteration, progress.needed)
            return None if left is None else (left, "the end")
        gap, aim = float(np.max(report.gap)), stop.tolerance
        if progress.settles_at is not None and progress.settles_more:
            aim = min(aim, progress.settles_at)
        if progress.time is not None or not aim < gap < 1:  # the gap of a dynamics falls when it will
            return None
        follow = self._follow_newton if progress.geometric else self._follow_power
        left = follow(seconds, math.log(gap), math.log(aim))
        return None if left is None or left > FARTHEST * seconds else (left, f"gap {aim:.0e}")

    def _steps_are_equal(self, progress: Any) -> bool:
        """True for a dynamics of fixed step, so far; steps that grow say little of those to come."""
        if progress.iteration > 0:
            self.steps.append(progress.time / progress.iteration)
        return max(self.steps, default=0.0) <= (1 + EQUAL) * min(self.steps, default=0.0)

    def _follow(self, seconds: float, now: float, end: float) -> float | None:
        """What goes on at a steady pace."""
        self.seen.append((seconds, now))
        return self._agreed(seconds, _further(self._lately, end), self._since, 2)

    def _follow_newton(self, seconds: float, now: float, end: float) -> float | None:
        """A logarithm that falls by like amounts, in few checks."""
        self.seen.append((seconds, now))
        return self._agreed(seconds, _further(self.seen[-LAST:], end), self.foretold[-1:], 1)

    def _follow_power(self, seconds: float, now: float, end: float) -> float | None:
        """A logarithm that falls with that of the time."""
        self.seen.append((seconds, now))
        further = _further([(math.log(then), value) for then, value in self._lately], end)
        left = None if further is None else seconds * math.expm1(min(further, 50.0))
        return self._agreed(seconds, left, self._since, 2)

    @property
    def _lately(self) -> list[tuple[float, float]]:
        return [item for item in self.seen if item[0] >= self.seen[-1][0] / WINDOW]

    @property
    def _since(self) -> list[tuple[float, float]]:
        return [item for item in self.foretold if item[0] >= self.seen[-1][0] / 2]

    def _agreed(
        self, seconds: float, left: float | None, before: list[tuple[float, float]], needed: int
    ) -> float | None:
        """The time left, if at least so many that were foretold before agree with it, and all of them do."""
        if left is None:
            return None
        self.foretold.append((seconds, left))
        agree = all(left / AGREEMENT <= then + told - seconds <= left * AGREEMENT for then, told in before)
        if not agree or len(before) < needed:
            return None
        return max(left, seconds - self.seen[-2][0])  # the next check is the first to see an end


def _further(points: list[tuple[float, float]], end: float) -> float | None:
    """How far beyond the last point (x, y) the line through all of them is at `end`; None if it does not lead there."""
    if len(points) < LAST:
        return None
    x, y = np.array(points).T
    x, to_go = x - x.mean(), end - y[-1]
    slope = float(x @ y / (x @ x)) if x.any() else 0.0
    return to_go / slope if slope * to_go > 0 else None
