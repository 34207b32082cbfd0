"""How long a solve will still take, foretold from what is left: simulated time, iterations, a gap that falls
geometrically.

Each is followed along the straight line through its last checks; of the gap the logarithm is followed. Nothing is
foretold that lies far beyond what has been seen, and nothing of gaps that fall otherwise or of steps that grow.
"""

import math
from typing import Any

import numpy as np

WINDOW = 3.0  # the line goes through what has happened since this part of the time
LAST = 3  # checks that it goes through at least, and at most where a gap falls
FARTHEST = 5.0  # times as long as what has been seen
EQUAL = 1e-6  # relative difference of steps that are the same


class TimeLeft:
    """Listens to the reports of a solve (solvers.drive.Report) and foretells its end."""

    def __init__(self) -> None:
        self.seen: list[tuple[float, float]] = []  # (seconds, what is followed)
        self.steps: list[float] = []  # mean length of the steps of a dynamics, at each report

    def look(self, report: Any) -> tuple[float, str] | None:
        """Seconds left and until what; None where that is not known."""
        progress, stop, seconds = report.progress, report.stop, report.seconds
        gap, aim = float(np.max(report.gap)), stop.tolerance
        if progress.settles_at is not None and progress.settles_more:
            aim = min(aim, progress.settles_at)
        if progress.time is not None:
            now, end, until = progress.time, stop.duration, f"t = {stop.duration:g}"
        elif progress.needed is not None:
            now, end, until = progress.iteration, progress.needed, "the end"
        elif progress.geometric and aim < gap < 1:
            now, end, until = math.log(gap), math.log(aim), f"gap {aim:.0e}"
        else:
            return None
        self.seen.append((seconds, now))
        if not math.isfinite(end) or not self._steps_are_equal(progress):
            return None
        lately = [item for item in self.seen if item[0] >= seconds / WINDOW]
        left = _further(self.seen[-LAST:] if until.startswith("gap") else lately, end)
        if left is None or (left > FARTHEST * seconds and progress.time is None):
            return None
        return max(left, seconds - self.seen[-2][0]), until  # the next check is the first to see an end

    def _steps_are_equal(self, progress: Any) -> bool:
        """True for a dynamics of fixed step, so far; steps that grow say little of those to come."""
        if progress.time is not None and progress.iteration > 0:
            self.steps.append(progress.time / progress.iteration)
        return max(self.steps, default=0.0) <= (1 + EQUAL) * min(self.steps, default=0.0)


def _further(points: list[tuple[float, float]], end: float) -> float | None:
    """How far beyond the last point (x, y) the line through all of them is at `end`; None if it does not lead there."""
    if len(points) < LAST:
        return None
    x, y = np.array(points).T
    x, to_go = x - x.mean(), end - y[-1]
    slope = float(x @ y / (x @ x)) if x.any() else 0.0
    return to_go / slope if slope * to_go > 0 else None
