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
            if progress.iteration > 0:  # steps that grow say little of those to come
                self.steps.append(progress.time / progress.iteration)
            equal = max(self.steps, default=0.0) <= (1 + EQUAL) * min(self.steps, default=0.0)
            farthest = math.inf if equal else FARTHEST * seconds
            return None if left is None or left > farthest else (left, f"t = {stop.duration:g}")
        if progress.needed is not None:
            left = self._follow(seconds, progress.iteration, progress.needed)
            return None if left is None else (left, "the end")
        gap, aim = float(np.max(report.gap)), stop.tolerance
        if progress.settles_at is not None and progress.settles_more:
            aim = min(aim, progress.settles_at)
        if progress.time is not None or not aim < gap < 1:  # the gap of a dynamics falls when it will
            return None
        left = self._follow(seconds, math.log(gap), math.log(aim), "newton" if progress.geometric else "power")
        return None if left is None or left > FARTHEST * seconds else (left, f"gap {aim:.0e}")

    def _follow(self, seconds: float, now: float, end: float, pace: str = "steady") -> float | None:
        """The time left, if all that was foretold lately, once or twice at least, agrees with it.

        pace : of what is followed, "steady"; "newton", a logarithm that falls by like amounts, in few checks; or
        "power", one that falls with the logarithm of the time.
        """
        self.seen.append((seconds, now))
        lately = [item for item in self.seen if item[0] >= seconds / WINDOW]
        before, needed = [item for item in self.foretold if item[0] >= seconds / 2], 2
        if pace == "newton":
            lately, before, needed = self.seen[-LAST:], self.foretold[-1:], 1
        if pace == "power":
            lately = [(math.log(then), value) for then, value in lately]
        left = _further(lately, end)
        if left is None:
            return None
        left = seconds * math.expm1(min(left, 50.0)) if pace == "power" else left
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
