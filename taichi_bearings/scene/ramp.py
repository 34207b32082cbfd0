"""A torque on the top, that is there at once or grows."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.options import REAL

MOST_LOOKS = 100_000  # at a ramp


@dataclass(frozen=True)
class Ramp:
    """Grows linearly from start to stop in the course of a run, force*length, and is looked at after every step."""

    start: float
    stop: float
    step: float

    @classmethod
    def of(cls, given: Any) -> "Ramp":
        """From a number, or from a text start:stop:step; ValueError unless the torque of that grows in size."""
        start, stop, step = map(REAL.read, given.split(":")) if ":" in str(given) else (REAL.read(given),) * 2 + (0.0,)
        rises = start * stop >= 0 and abs(stop) > abs(start) and 0 < step <= abs(stop - start) <= MOST_LOOKS * step
        if not rises and (step or start != stop):
            raise ValueError
        return cls(start, stop, step)

    @property
    def rises(self) -> bool:
        return self.start != self.stop

    @property
    def way(self) -> float:
        """Sign of the torque at its end."""
        return -1.0 if self.stop < 0 else 1.0

    def rate(self, duration: float | None) -> float:
        """Torque over time; 0 if it does not grow."""
        return (self.stop - self.start) / (duration or np.inf)

    def looks(self, duration: float) -> np.ndarray:
        """Simulated times at which the torque has grown by another step; none if it does not grow."""
        if not self.rises:
            return np.zeros(0)
        steps = int(np.floor(abs(self.stop - self.start) / self.step * (1 + 1e-12)))
        return np.asarray(duration * self.step / abs(self.stop - self.start) * np.arange(steps + 1))


def read_torque(given: Any) -> float | str:
    """A torque as it is written down: a number, or start:stop:step; ValueError for anything else."""
    found = Ramp.of(given)
    return f"{found.start!r}:{found.stop!r}:{found.step!r}" if found.rises else found.stop
