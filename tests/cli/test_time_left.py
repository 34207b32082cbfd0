"""The time left is foretold from the share of the work that is done, and only where that is known."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_bearings.progress import forecast, share_of
from taichi_bearings.stages import Stage


def reports(seconds, gap=(), time=None, falls_to=0.0, duration=math.inf):
    """What a monitor hears at each check."""
    stop = SimpleNamespace(tolerance=1e-8, duration=duration, seconds=math.inf)
    for number, now in enumerate(seconds):
        progress = SimpleNamespace(
            iteration=number + 1, time=None if time is None else time[number], falls_to=falls_to
        )  # fmt: skip
        worst = np.array([gap[number] if len(gap) else 1.0])
        yield SimpleNamespace(seconds=now, progress=progress, stop=stop, gap=worst, objective=np.ones(1))


def foretold(heard):
    """(seconds, time left) wherever it is known."""
    solving, found = Stage("solving"), []
    for report in heard:
        solving.report = report
        solving.done.append((report.seconds, share_of(report)[0]))
        found.append((report.seconds, forecast(solving)[0]))
    return [(seconds, left) for seconds, left in found if left < math.inf]


def test_a_gap_that_shrinks_by_a_factor_an_iteration():
    """Newton steps of one second; the factors vary as those of the interior-point method do."""
    rng = np.random.default_rng(5)
    seconds, gap = np.arange(21.0), np.exp(-np.append(0, np.cumsum(rng.uniform(1.0, 1.8, 20))))
    end = float(np.interp(-math.log(1e-8), -np.log(gap), seconds))
    shown = [item for item in foretold(reports(seconds, gap, falls_to=math.inf)) if item[0] < end]
    assert len(shown) >= 8
    assert max(max(left / (end - now), (end - now) / left) for now, left in shown if now < 0.95 * end) < 1.5


def test_a_gap_that_may_stand_still_foretells_nothing():
    seconds = 0.1 * 1.12 ** np.arange(60)
    assert foretold(reports(seconds, 1e-3 * seconds**-1.5)) == []
    assert foretold(reports(seconds, np.full(60, 1e-4), falls_to=math.inf)) == []


def test_a_dynamics_goes_by_its_simulated_time_and_without_a_duration_by_nothing():
    seconds, time = np.arange(1.0, 11.0), np.linspace(0.1, 1.0, 10)
    shown = foretold(reports(seconds, time=time, duration=5.0))
    assert [now for now, _ in shown] == [9.0, 10.0]  # less than five times of what has been seen is left
    assert all(left == pytest.approx(50 - now) for now, left in shown)
    assert foretold(reports(seconds, time=time)) == []
    assert foretold(reports(seconds)) == []
