"""The time left is foretold from the share of the work that is done, and only where that is known."""

import math
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_bearings.progress import Display, forecast, share_of, standing
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import InteriorPoint, OperatorSplitting
from taichi_bearings.stages import Stage
from tests.scenes import make_scene


def reports(seconds, gap=(), time=None, falls_to=0.0, duration=math.inf, falls_as=0.0, on_path=()):
    """What a monitor hears at each check."""
    stop = SimpleNamespace(tolerance=1e-8, duration=duration, seconds=math.inf)
    for number, now in enumerate(seconds):
        progress = SimpleNamespace(
            iteration=number + 1,
            time=None if time is None else time[number],
            falls_to=falls_to,
            falls_as=falls_as,
            gap_of_path=on_path[number] if len(on_path) else None,
        )
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


def test_a_gap_that_shrinks_by_a_power_of_the_iterations():
    """Iterations of one second; the exponent is not quite the one that is believed."""
    seconds = np.append(50.0 * np.arange(1, 7), 300 * (7 / 6) ** np.arange(1, 12))
    for exponent in (1.8, 2.0, 2.3):
        gap = 60.0 * seconds**-exponent
        end = (60.0 / 1e-8) ** (1 / exponent)
        nearly = [(end - now, left) for now, left in foretold(reports(seconds, gap, falls_as=2.0)) if now < end]
        assert all(0.4 < left / truth < 2.5 for truth, left in nearly)
    gap = 1e-8 * (2e3 / seconds) ** 2
    shown = foretold(reports(seconds, gap, falls_as=2.0))
    assert len(shown) >= 8
    assert all(left == pytest.approx(2e3 - now) for now, left in shown if now < 2e3)


@pytest.mark.usefixtures("taichi_runtime")
def test_operator_splitting_foretells_its_end_by_the_fall_of_its_gap():
    """Counted in iterations, which take about the same time: no clock of a shared machine can spoil it."""
    heard, of = [], make_scene((20, 20, 20))
    solve(of, OperatorSplitting().build(), initial_spin(of, "linear"), StopRule(1e-5), [heard.append])
    counted = [replace(report, seconds=float(report.progress.iteration)) for report in heard]
    end = counted[-1].seconds
    shown = [item for item in foretold(counted) if end / 4 <= item[0] < 0.8 * end]  # looks are a sixth of it apart
    assert len(shown) >= 3
    assert all(1 / 2 < left / (end - now) < 2 for now, left in shown)


def test_a_path_tells_how_far_it_is_where_nothing_is_proven_on_the_way():
    seconds = np.arange(6.0)
    heard = list(reports(seconds, np.ones(6), falls_to=1e-8, on_path=10.0**-seconds))
    assert standing(heard[-1]) == "6 iterations, P = 1, gap 1.0e-05"
    stage = Stage("solving", report=heard[-1])
    stage.done = [(report.seconds, share_of(report)[0]) for report in heard]
    assert forecast(stage) == (pytest.approx(3.0), " to gap 1e-08")


def test_what_was_expected_of_work_counts_down_and_then_the_time_is_told():
    display = Display()
    display.begin(Stage("proving", expected=60.0, began=time.perf_counter() - 10))
    assert display.line() in ("proving, 50 s left", "proving, 49 s left")
    display.stages[0].began -= 60
    assert display.line() in ("proving, 70 s so far", "proving, 71 s so far")
    display.stages[0].expected = 0.0
    assert "so far" in display.line()


def test_a_large_lattice_shows_what_is_left_of_its_estimate_until_its_pace_is_known():
    heard = list(reports(np.array([0.0, 60.0]), np.ones(2), falls_to=1e-8))
    stage = Stage("solving", report=heard[-1], expected=300.0)
    stage.done = [(report.seconds, share_of(report)[0]) for report in heard]
    assert forecast(stage) == (240.0, " by an estimate from its size")
    stage.expected = 59.0
    assert forecast(stage)[0] == math.inf


@pytest.mark.usefixtures("taichi_runtime")
def test_the_estimate_of_a_solve_is_that_of_all_its_samples():
    of, method = make_scene((4, 4, 5), seeds=(1, 2, 3)), InteriorPoint().build()
    method.begin(of, initial_spin(of, "linear"))
    assert method.contacts.seconds_to_solve(method.options, 1e-8) == 3 * InteriorPoint.seconds((4, 4, 5), 1e-8)


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
