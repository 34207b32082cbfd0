"""The time left is foretold from the simulated time of a dynamics that is done, and only where that is known."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_bearings.progress import Forecast


def reports(seconds, time=None, duration=math.inf):
    """What a monitor hears at each check."""
    stop = SimpleNamespace(duration=duration, seconds=math.inf)
    for number, now in enumerate(seconds):
        progress = SimpleNamespace(iteration=number + 1, time=None if time is None else time[number])
        yield SimpleNamespace(seconds=now, progress=progress, stop=stop, gap=np.ones(1), objective=np.ones(1))


def foretold(heard):
    """(seconds, time left) wherever it is known."""
    forecast, found = Forecast(), []
    for report in heard:
        forecast.look(report)
        found.append((report.seconds, forecast.left_then))
    return [(seconds, left) for seconds, left in found if left < math.inf]


def test_a_dynamics_goes_by_its_simulated_time_and_without_a_duration_by_nothing():
    seconds, time = np.arange(1.0, 11.0), np.linspace(0.1, 1.0, 10)
    shown = foretold(reports(seconds, time=time, duration=5.0))
    assert [now for now, _ in shown] == [9.0, 10.0]  # less than five times of what has been seen is left
    assert all(left == pytest.approx(50 - now) for now, left in shown)
    assert foretold(reports(seconds, time=time)) == []
    assert foretold(reports(seconds)) == []
