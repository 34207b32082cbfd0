"""When a run ends, and with which status."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from taichi_bearings.proof.certificate import relative_gap
from taichi_bearings.scene import Bearing, Progress, Solution, Status

UNLIMITED = 2**62  # iterations


class Limits(Protocol):
    """The settings of a run that say when it ends, as `StopRule` has them; None where nothing is asked for."""

    @property
    def tolerance(self) -> float:
        """Relative gap at which the run is done."""

    @property
    def iterations(self) -> int | None:
        """Limit on iterations."""

    @property
    def time_limit(self) -> float | None:
        """Limit on wall time, seconds."""

    @property
    def duration(self) -> float | None:
        """Simulated time after which a dynamics ends."""


@dataclass(frozen=True)
class StopRule:
    """When a run stops: at a proven relative gap, at rest, or at a limit.

    tolerance : (objective - lower bound) / objective at which every sample counts as done, in (0, 1).
    iterations : limit on iterations of the method.
    seconds : limit on wall time without compilation, infinity for none; a resumed run has the whole limit again.
    duration : simulated time after which a dynamics ends, whatever it has reached; infinity to run until it is done.
    """

    tolerance: float = 1e-8
    iterations: int = 1_000_000
    seconds: float = float("inf")
    duration: float = float("inf")

    @classmethod
    def of(cls, settings: Limits) -> "StopRule":
        """Return the rule that the settings of a run ask for: `tolerance`, `iterations`, `time_limit` and `duration`.

        A run with a duration has no limit of steps unless one is given.
        """
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
        """Return the status with which the run should end now, or None if it should go on.

        scene : what is solved.
        progress : the state now.
        objective, bound : (R samples,), the best objective and the best lower bound so far.
        elapsed : seconds of wall time in this call.
        stalled : True if the method makes no more progress.
        """
        if not np.isfinite(progress.objective).all():
            return Status.NOT_FINITE
        certified = bool((relative_gap(scene, objective, bound) <= self.tolerance).all())
        ended = progress.iteration >= self.iterations or elapsed >= self.seconds
        in_time = progress.time is not None and self.duration < float("inf")
        finished = progress.time is not None and progress.time >= self.duration * (1 - 1e-9)  # but for rounding
        # a run with a duration goes on until then; a minimisation may go on to settle contact states
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


def reported_status(status: Status, gap: float, is_restricted: bool, tolerance: float, has_duration: bool) -> Status:
    """Return the status of an answer, or of one of its samples, from the status with which its loop ended: CERTIFIED if
    the proven gap is within the tolerance, however the run ended.

    If the lower bound is not proven of all spins, the answer is RESTRICTED in place of CERTIFIED, or it keeps the
    status of a dynamics that has come to rest or has reached the simulated time that was asked for. A dynamics that a
    limit or an interrupt has ended before that time keeps its status, whatever its gap.

    status : status with which the loop ended.
    gap : the largest gap of the samples.
    is_restricted : True if the lower bound of a sample is not proven of all spins.
    tolerance : the gap that was asked for.
    has_duration : True if a simulated time was asked for.
    """
    cut_short = has_duration and status in (Status.STEP_LIMIT, Status.TIME_LIMIT, Status.INTERRUPTED)
    if not gap <= tolerance or cut_short:
        return status
    if not is_restricted:
        return Status.CERTIFIED
    if status in (Status.STATIONARY, Status.FINISHED):
        return status
    return Status.FINISHED if has_duration else Status.RESTRICTED


def ended_as(status: Status, found: Solution, stop: StopRule, is_dynamics: bool) -> Status:
    """Return the status of an answer, from the status with which its loop ended and from what its proof has shown.

    An answer may be certified even where the loop knew less. If the loop was certified but the proof shows less, the
    answer is STALLED; or STATIONARY, for a dynamics with a lower bound of 0, for which no relative gap can be small.

    status : status of the loop.
    found : the answer with its proven gap.
    stop : the rule with the tolerance.
    is_dynamics : True if the method is a dynamics.
    """
    gap, is_restricted = float(np.max(found.gap)), bool(found.is_restricted.any())
    if gap <= stop.tolerance or status is not Status.CERTIFIED:
        return reported_status(status, gap, is_restricted, stop.tolerance, stop.duration < float("inf"))
    return Status.STATIONARY if is_dynamics and bool((found.lower_bound == 0).any()) else Status.STALLED
