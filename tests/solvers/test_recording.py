"""What a dynamics writes down: times as asked for, energy balances that close and mean what they say, resuming."""

import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack
from taichi_bearings.solvers.drive import Checkpoints, solve
from taichi_bearings.solvers.recording import Recording, parse_times
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene

UNRECORDED = ("seconds",)  # columns that differ from run to run


def run(scene, options=None, start="random", stop=None, recording=None, checkpoints=None):
    method = (options or CundallStrack(energy=True)).build()
    spin = initial_spin(scene, start)
    return solve(scene, method, spin, stop or StopRule(1e-6), (), None, recording, checkpoints)


@pytest.mark.parametrize(
    ("text", "times"),
    [("0.3,0.1", [0.1, 0.3]), ("linear:0,2,5", [0, 0.5, 1, 1.5, 2]), ("log:0.01,1,3", [0.01, 0.1, 1]), ("0", [0])],
)
def test_times_are_read(text, times):
    np.testing.assert_allclose(parse_times(text), times, rtol=1e-14)


@pytest.mark.parametrize(
    "text", ["", "a", "linear:0,1", "linear:1,0,5", "log:0,1,5", "log:1,2,2.5", "-1", "nan", "odd:0,1,2"]
)
def test_other_times_are_refused(text):
    with pytest.raises((ValueError, KeyError)):
        parse_times(text)


def test_rows_and_snapshots_come_at_the_first_step_that_reaches_a_time():
    scene = make_scene((3, 4, 5))
    wanted = Recording(parse_times("log:1e-4,3e-2,7"), parse_times("0,0.011"))
    solution = run(scene, stop=StopRule(duration=0.03), recording=wanted)
    h = solution.history["time"][-2] / solution.history["iteration"][-2]
    late = solution.history["time"] - wanted.history
    assert (late > -1e-9 * wanted.history).all()
    assert (late < h).all()
    assert solution.snapshots.time[0] == 0
    assert 0 <= solution.snapshots.time[1] - 0.011 < h
    np.testing.assert_array_equal(solution.snapshots.spin[0], scene.laboratory_spin(
        scene.staggered_spin(initial_spin(scene, "random"), (0, 1, 2)), (0, 1, 2)))  # fmt: skip
    assert solution.history["time"][-1] == 0.03
    # the state at a time does not depend on what is written down
    alone = run(scene, stop=StopRule(duration=float(solution.snapshots.time[1])))
    np.testing.assert_array_equal(alone.spin, solution.snapshots.spin[1])
    assert solution.status is Status.FINISHED


def test_a_duration_goes_on_after_the_gap_has_closed():
    scene = make_scene((3, 4))
    until_certified = run(scene, stop=StopRule(1e-3))
    beyond = 2 * until_certified.history["time"][-1]
    solution = run(scene, stop=StopRule(1e-3, duration=beyond))
    assert solution.status is Status.CERTIFIED
    assert solution.history["time"][-1] == pytest.approx(beyond, rel=1e-3)


def test_a_limit_before_the_duration_is_told_whatever_the_gap():
    scene = make_scene((3, 4))
    steps = run(scene, stop=StopRule(1e-3)).iterations
    solution = run(scene, stop=StopRule(1e-3, iterations=2 * steps, duration=1e9))
    assert (solution.gap <= 1e-3).all()
    assert solution.status is Status.STEP_LIMIT
    assert Result(RunSettings(tolerance=1e-3, duration=1e9), solution).numbers["status"] == "step-limit"


def test_a_time_limit_counts_anew_for_a_run_that_goes_on():
    scene, written = make_scene((4, 5)), []
    stop = StopRule(1e-3, iterations=2**62, seconds=0.2, duration=1e9)
    first = run(scene, stop=stop, checkpoints=Checkpoints(1e9, written.append))
    second = run(scene, stop=stop, checkpoints=Checkpoints(1e9, written.append, written[-1]))
    assert first.status is second.status is Status.TIME_LIMIT
    assert second.iterations > 1.2 * first.iterations


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("shape", [(4, 5), (3, 3, 3)])
def test_energy_balance_of_a_run_to_rest_close(shape):
    scene = make_scene(shape, spin_bottom=0.2, seeds=(1, 2))
    solution = run(scene, stop=StopRule(1e-7, 200_000))
    history, free = solution.history, ~scene.lattice.is_driven
    assert (np.abs(history["energy_residual"][-1]) < 2e-6).all()
    assert (np.diff(history["dissipated_energy"], axis=0) > 0).all()
    assert (history["spring_energy"][1:] > 0).all()
    inertia = 0.125 if len(shape) == 2 else 0.1  # m R^2 / 2 and 2 m R^2 / 5 with m = 1, R = 1 / 2
    squares = (solution.spin[:, free] ** 2).reshape(2, -1).sum(axis=1)
    np.testing.assert_allclose(history["kinetic_energy"][-1], inertia / 2 * squares, rtol=1e-12)


@pytest.mark.usefixtures("needs_f64")
def test_at_rest_the_drive_does_the_work_that_friction_takes():
    scene = make_scene((3, 3, 4))
    h = run(scene, stop=StopRule(1e-9, 400_000)).history
    assert h["lower_bound"][-1] == pytest.approx(h["power"][-1], rel=1e-6)
    for account in ("injected_energy", "dissipated_energy"):
        rate = (h[account][-1] - h[account][-2]) / (h["time"][-1] - h["time"][-2])
        assert rate == pytest.approx(h["power"][-1], rel=1e-5)


@pytest.mark.usefixtures("needs_f64")
def test_viscous_dissipation_is_the_integral_of_the_power():
    """Paper Eq. 4 integrated by Simpson's rule over recorded times: nothing of the energy balance goes into it."""
    scene = make_scene((4, 5), "viscous")
    options = CundallStrack(time_step=1e-4, energy=True, gear_order=3)
    solution = run(scene, options, "linear", StopRule(duration=0.1), Recording(parse_times("linear:0,0.1,1001")))
    power, time = solution.history["power"][:, 0], solution.history["time"]
    h = time[1] - time[0]
    np.testing.assert_allclose(np.diff(time), h, rtol=1e-6)
    integral = h / 3 * (power[0] + power[-1] + 4 * power[1:-1:2].sum() + 2 * power[2:-1:2].sum())
    assert solution.history["dissipated_energy"][-1] == pytest.approx(integral, rel=1e-7)


@pytest.mark.parametrize(
    ("shape", "law", "order"), [((3, 4), "coulomb", 5), ((3, 2, 4), "coulomb", 2), ((3, 4), "viscous", 4)]
)
def test_any_checkpoint_leads_to_the_same_bits(shape, law, order):
    scene = make_scene(shape, law)
    options = CundallStrack(gear_order=order, energy=True)
    recording = Recording(snapshots=parse_times("log:1e-3,1,10"))
    stop = StopRule(1e-5, 60_000)
    written = []
    whole = run(scene, options, stop=stop, recording=recording, checkpoints=Checkpoints(0.0, written.append))
    assert len(written) > 5
    rng = np.random.default_rng(5)
    for number in (0, *rng.integers(1, len(written), 3), len(written) - 1):
        ignored = Checkpoints(np.inf, lambda arrays: None, written[number])
        again = run(scene, options, stop=stop, recording=recording, checkpoints=ignored)
        assert (again.status, again.iterations) == (whole.status, whole.iterations)
        np.testing.assert_array_equal(again.spin, whole.spin)
        np.testing.assert_array_equal(again.force, whole.force)
        np.testing.assert_array_equal(again.snapshots.spin, whole.snapshots.spin)
        for name in set(whole.history) - set(UNRECORDED):
            np.testing.assert_array_equal(again.history[name], whole.history[name])


def test_a_checkpoint_of_another_time_step_is_refused():
    scene = make_scene((3, 4))
    written = []
    run(scene, stop=StopRule(1e-5, 500), checkpoints=Checkpoints(0.0, written.append))
    other = CundallStrack(energy=True, time_step=1e-6)
    with pytest.raises(InputError, match="time_step"):
        run(scene, other, checkpoints=Checkpoints(1.0, written.append, written[0]))
