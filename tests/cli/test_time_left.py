"""The time left is foretold from what is left, and only where that is known."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_bearings.time_left import TimeLeft

UNLIMITED = 2**62


def reports(seconds, gap=(), time=None, needed=None, geometric=False, tolerance=1e-8, duration=math.inf):
    """What a monitor hears at each check."""
    stop = SimpleNamespace(tolerance=tolerance, duration=duration, settle=False, iterations=UNLIMITED)
    for number, now in enumerate(seconds):
        progress = SimpleNamespace(
            iteration=number + 1, time=None if time is None else time[number], needed=needed, geometric=geometric,
            settles_at=None, settles_more=False,
        )  # fmt: skip
        worst = np.array([gap[number] if len(gap) else 1.0])
        yield SimpleNamespace(seconds=now, progress=progress, stop=stop, gap=worst)


def foretold(heard):
    """(seconds, time left) wherever it is known."""
    time_left = TimeLeft()
    looks = [(report.seconds, time_left.look(report)) for report in heard]
    return [(seconds, found[0]) for seconds, found in looks if found is not None]


def worst_factor(shown, end):
    return max(max(left / (end - now), (end - now) / left) for now, left in shown if now < 0.95 * end)


def test_a_gap_that_shrinks_by_a_factor_an_iteration():
    """Newton steps of one second; the factors vary as those of the interior-point method do."""
    rng = np.random.default_rng(5)
    seconds, gap = np.arange(21.0), np.exp(-np.append(0, np.cumsum(rng.uniform(1.0, 1.8, 20))))
    end = float(np.interp(-math.log(1e-8), -np.log(gap), seconds))
    shown = [item for item in foretold(reports(seconds, gap, geometric=True)) if item[0] < end]
    assert len(shown) >= 8
    assert worst_factor(shown, end) < 1.5


def test_a_gap_that_falls_like_a_power_of_the_time():
    seconds = 0.1 * 1.12 ** np.arange(60)
    gap = 1e-3 * seconds**-1.5
    end = (1e-3 / 1e-5) ** (1 / 1.5)
    shown = [item for item in foretold(reports(seconds, gap, tolerance=1e-5)) if item[0] < end]
    assert shown
    assert worst_factor(shown, end) < 1.05
    assert all(left <= 5 * now for now, left in shown)


def test_a_gap_that_stands_still_or_jumps_foretells_nothing():
    seconds = 0.1 * 1.12 ** np.arange(60)
    stuck = np.maximum(1e-3 * seconds**-1.5, 1e-4)
    assert all(now < 8 for now, _ in foretold(reports(seconds, stuck, tolerance=1e-5)))
    stairs = 10.0 ** -np.floor(np.arange(60) / 10)
    assert foretold(reports(seconds, stairs, tolerance=1e-20)) == []


def test_a_dynamics_goes_by_its_simulated_time_and_without_a_duration_by_nothing():
    seconds, time = np.arange(1.0, 11.0), np.linspace(0.1, 1.0, 10)
    shown = foretold(reports(seconds, time=time, duration=100.0))
    assert len(shown) >= 5
    assert all(left == pytest.approx(1000 - now) for now, left in shown)
    assert foretold(reports(seconds, np.geomspace(1, 1e-6, 10), time=time)) == []


def test_steps_that_grow_foretell_nothing_of_simulated_time():
    seconds = np.arange(1.0, 11.0)
    assert foretold(reports(seconds, time=1e-3 * 3.0**seconds, duration=1e6)) == []
    nearly = 1e-4 * seconds * (1 + 1e-3 * seconds)  # hours at this pace; a rigid limit takes half a minute
    assert foretold(reports(seconds, time=nearly, duration=5.0)) == []


def test_nothing_ends_before_the_next_check():
    seconds = np.arange(1.0, 9.0)
    shown = foretold(reports(seconds, 10.0**-seconds, geometric=True, tolerance=0.9e-7))
    assert shown[-1] == (7.0, 1.0)


def test_work_of_known_length_goes_by_its_iterations():
    shown = foretold(reports(np.arange(1.0, 9.0), needed=16))
    assert shown[-1][1] == pytest.approx(16 - 8)
