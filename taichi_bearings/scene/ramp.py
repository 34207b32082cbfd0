"""A torque on the top, that is there at once or grows."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.options import REAL, Kind

MOST_LOOKS = 100_000  # at a ramp


@dataclass(frozen=True)
class Ramp:
    """Grows linearly from start to stop in the course of a run, force*length, and is looked at after every step."""

    start: float
    stop: float
    step: float = 0.0

    @classmethod
    def of(cls, given: Any) -> "Ramp":
        """From a number, or from a text start:stop:step; ValueError unless the torque of that grows in size."""
        if ":" not in str(given):
            return cls(REAL.read(given), REAL.read(given))
        start, stop, step = map(REAL.read, given.split(":"))
        if start * stop < 0 or abs(stop) <= abs(start) or not 0 < step <= abs(stop - start) <= MOST_LOOKS * step:
            raise ValueError
        return cls(start, stop, step)

    @property
    def rises(self) -> bool:
        return self.step > 0

    def rate(self, duration: float | None) -> float:
        """Torque over time; 0 if it does not grow."""
        return (self.stop - self.start) / (duration or np.inf)

    def looks(self, duration: float) -> np.ndarray:
        """Simulated times at which the torque has grown by another step; none if it does not grow."""
        if not self.rises:
            return np.zeros(0)
        size = abs(self.stop - self.start)
        return np.asarray(duration * self.step / size * np.arange(np.floor(size / self.step * (1 + 1e-12)) + 1))


def _written(given: Any) -> float | str:
    """A torque as it is kept: a number, or start:stop:step."""
    found = Ramp.of(given)
    return f"{found.start!r}:{found.stop!r}:{found.step!r}" if found.rises else found.stop


TORQUE = Kind(
    _written,
    f"0 or a number of size 1e-15 to 1e15, or START:STOP:STEP as in 0:300:10, of at most {MOST_LOOKS:,} rising steps",
    "TORQUE",
)
