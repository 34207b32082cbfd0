"""When a run ends, and what to call it."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.proof.certificate import relative_gap
from taichi_bearings.scene import Bearing, Progress, Solution, Status

UNLIMITED = 2**62  # iterations


@dataclass(frozen=True)
class StopRule:
    """Stop at a proven relative gap, at rest, or at a limit.

    tolerance : (objective - lower bound) / objective at which every replica counts as done, in (0, 1).
    iterations : limit on iterations of the method.
    seconds : limit on wall time, compilation apart, anew for each call that goes on; infinity for none.
    duration : simulated time after which a dynamics ends, whatever it has reached; infinity to go on until it is done.
    """

    tolerance: float = 1e-8
    iterations: int = 1_000_000
    seconds: float = float("inf")
    duration: float = float("inf")

    @classmethod
    def of(cls, settings: Any) -> "StopRule":
        """As settings of a run say."""
        unlimited = cls.iterations if settings.duration is None else UNLIMITED
        iterations = unlimited if settings.iterations is None else settings.iterations
        seconds, duration = (value or float("inf") for value in (settings.time_limit, settings.duration))
        return cls(settings.tolerance, iterations, seconds, duration)

    def judge(
        self,
        scene: Bearing,
        progress: Progress,
        objective: np.ndarray,
        bound: np.ndarray,
        elapsed: float,
        stalled: bool = False,
    ) -> Status | None:
        """The status if the run should end now, else None. objective, bound : (R,), the best known so far."""
        if not np.isfinite(progress.objective).all():
            return Status.NOT_FINITE
        certified = bool((relative_gap(scene, objective, bound) <= self.tolerance).all())
        ended = progress.iteration >= self.iterations or elapsed >= self.seconds
        in_time = progress.time is not None and self.duration < float("inf")
        finished = progress.time is not None and progress.time >= self.duration * (1 - 1e-9)
        goes_on = not finished if in_time else progress.settles_more and not ended
        if certified and not goes_on:
            return Status.CERTIFIED
        if finished:
            return Status.FINISHED
        if progress.at_rest and not in_time:
            return Status.STATIONARY
        if progress.halted or (stalled and not in_time):
            return Status.STALLED
        if progress.iteration >= self.iterations:
            return Status.STEP_LIMIT
        if elapsed >= self.seconds:
            return Status.TIME_LIMIT
        return None


def ended_as(status: Status, found: Solution, stop: StopRule, is_dynamics: bool) -> Status:
    """How a course ended whose loop had this status: certified where its answer is proven to the tolerance.

    That may be so where the loop knew less: without slip, or by friction that the answer has taken from elsewhere. A
    motion whose duration was not reached, or a course that was interrupted or has lost its numbers, stays what it is.
    Where less is proven than the loop believed, a motion is at rest where next to nothing is left of a power whose
    least value is 0, and of which no bound can be a part.
    """
    cut_short = stop.duration < float("inf") and status in (Status.STEP_LIMIT, Status.TIME_LIMIT)
    stays = cut_short or status in (Status.INTERRUPTED, Status.NOT_FINITE)
    if not stays and bool((found.gap <= stop.tolerance).all()):
        return Status.CERTIFIED
    if status is not Status.CERTIFIED:
        return status
    return Status.STATIONARY if is_dynamics and bool((found.lower_bound == 0).any()) else Status.STALLED
