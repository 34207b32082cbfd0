"""The interior-point method against exact minima, an independent conic formulation, and its own claims."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_bearings.conic import descent, resolution
from taichi_bearings.proof.certificate import lower_bound, relative_gap
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.lattice_run import solve_job
from taichi_bearings.runs.run import prepare
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint, LinearSolver
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene, minima, name_of, scene_of

pytestmark = pytest.mark.usefixtures("needs_f64")


def minimum_of(scene, tolerance=1e-9, start="linear", **options):
    return solve(scene, InteriorPoint(**options).build(), initial_spin(scene, start), StopRule(tolerance))


@pytest.mark.parametrize("entry", minima((3, 3, 3), (5, 5, 5), (10, 10, 10)), ids=name_of)
def test_stored_minima_to_all_their_digits(entry):
    solution = minimum_of(scene_of(entry))
    assert solution.status is Status.CERTIFIED
    assert solution.gap[0] < 1e-10
    assert solution.power[0] == pytest.approx(entry["power_minimum"], rel=1e-12)
    assert solution.states_proven[0]
    slips = solution.slip[solution.state == ContactState.SLIPPING]
    assert len(slips) == entry["slipping"]
    assert slips.min() / 0.5 == pytest.approx(entry["smallest_slip_over_spin_top"], rel=1e-5)
    assert (solution.slip[solution.state == ContactState.SLIPLESS] == 0).all()


ODD = {
    "unequal sides": {"shape": (5, 9, 14)},
    "rotating bottom": {"shape": (6, 4, 7), "spin_bottom": -0.4},
    "general axis": {"shape": (6, 5, 6), "direction": (1, 2, 3)},
    "component along the height": {"shape": (4, 5, 6), "direction": (1, 0, 1)},
    "height of three": {"shape": (7, 6, 3)},
    "two wide": {"shape": (2, 2, 9)},
    "two wide one way": {"shape": (2, 8, 6)},
    "lognormal over six decades": {"shape": (6, 6, 6), "distribution": "lognormal:1,2.3"},
    "bimodal over six decades": {"shape": (6, 6, 6), "distribution": "bimodal:1e-3,1e3,0.5"},
    "all equal": {"shape": (6, 6, 6), "distribution": "constant:0.5"},
    "two dimensions": {"shape": (9, 12)},
    "one component": {"shape": (4, 6, 5), "direction": (1, 0, 0)},
    "tiny units": {"shape": (5, 5, 5), "spin_top": 1e-9, "normal_force": 1e8},
}


def test_settling_once_more_from_closer_by_spoils_nothing():
    """Over four decades rounding leaves ever larger torques the further the path goes."""
    solution = minimum_of(make_scene((3, 3, 8), distribution="bimodal:1,1e4,0.3", seeds=(9, 121)))
    assert (solution.gap < 1e-10).all()


def test_ties_are_settled_to_the_last_digits():
    """Domains between contacts at their limit, near which the path ends with torques of 1e-8 of the friction."""
    scene = make_scene((8, 8, 8), distribution="bimodal:0.1,1,0.5", seeds=(1, 8, 11, 14, 21, 32))
    solution = minimum_of(scene, 1e-14)
    assert solution.status is Status.CERTIFIED, solution.gap
    assert np.isin(solution.state, (ContactState.TIED, ContactState.UNDECIDED)).any(axis=1).sum() >= 5


@pytest.mark.parametrize("odd", ODD.values(), ids=ODD)
def test_odd_scenes_are_certified(odd):
    scene = make_scene(**odd)
    solution = minimum_of(scene, 1e-8)
    assert solution.status is Status.CERTIFIED, solution.gap
    assert (solution.lower_bound <= solution.power * (1 + 1e-12)).all()


@pytest.mark.parametrize("start", ["random", "zero"])
def test_every_start_leads_to_the_same_minimum(start):
    scene = make_scene((5, 6, 7))
    one, other = minimum_of(scene), minimum_of(scene, start=start)
    assert other.power == pytest.approx(one.power, rel=1e-12)
    assert (one.state == other.state).all()


def test_reported_forces_hold_the_spheres_and_prove_the_bound():
    scene = make_scene((6, 6, 6))
    method = InteriorPoint().build()
    solution = solve(scene, method, initial_spin(scene, "linear"), StopRule(1e-10))
    progress = method.progress()
    bound = lower_bound(scene, progress.force, progress.spin_axes)
    assert relative_gap(scene, solution.power, bound)[0] < 1e-9
    assert solution.largest_balance_residual[0] < 1e-9 * scene.normal_force
    friction = scene.normal_force * scene.coefficient
    assert (solution.force <= friction * (1 + 1e-8)).all()
    slipping = solution.state == ContactState.SLIPPING
    assert solution.force[slipping] == pytest.approx(friction[slipping], rel=1e-6)


def test_without_settling_it_stops_at_the_tolerance():
    scene = make_scene((6, 6, 6))
    quick = minimum_of(scene, 1e-4, settle=False)
    assert quick.status is Status.CERTIFIED
    assert 1e-8 < quick.gap[0] < 1e-4
    assert quick.iterations < minimum_of(scene, 1e-4).iterations


@pytest.mark.parametrize("shape", [(10, 10), (5, 4, 6)], ids=str)
def test_with_little_viscosity_it_ends_at_the_minimum_of_friction_alone(shape):
    plain, scene = make_scene(shape), make_scene(shape, "coulomb-viscous", viscosity="uniform:1e-13,1e-12")
    friction, both = minimum_of(plain), minimum_of(scene)
    assert both.status is Status.CERTIFIED
    assert both.objective == pytest.approx(friction.power, rel=1e-12)
    assert both.power == pytest.approx(friction.power, rel=1e-12)
    plain_to_see = (friction.slip == 0) | (friction.slip > 1e-4)
    assert (friction.state == both.state)[plain_to_see & (both.state != ContactState.UNDECIDED)].all()


@pytest.mark.parametrize("shape", [(10, 10), (5, 4, 6)], ids=str)
def test_with_little_friction_it_ends_at_the_minimum_of_viscosity_alone(shape):
    scene = make_scene(shape, "coulomb-viscous", distribution="constant:1e-15")
    damped = Scene(scene.viscosity, "viscous", seeds=scene.seeds)
    expected = solve(damped, LinearSolver().build(), initial_spin(damped, "linear"), StopRule(1e-9))
    both = minimum_of(scene)
    assert both.status is Status.CERTIFIED
    assert 2 * both.objective == pytest.approx(expected.power, rel=1e-10)  # the potential of damping is half its power
    assert both.power == pytest.approx(expected.power, rel=1e-10)
    assert both.spin == pytest.approx(expected.spin, abs=1e-10)


def test_friction_and_viscosity_together_bear_every_force():
    """By hand: along the slip, friction and viscosity * slip; less than friction where nothing slips."""
    scene = make_scene((5, 4, 6), "coulomb-viscous", viscosity="uniform:5,60", radius=0.7)
    solution = minimum_of(scene)
    friction, viscosity = (scene.lattice.flat(values) for values in (scene.coefficients, scene.viscosity))
    friction = scene.normal_force * friction
    slips, rests = solution.state == ContactState.SLIPPING, solution.state == ContactState.SLIPLESS
    assert solution.force[slips] == pytest.approx((friction + viscosity * solution.slip)[slips], rel=1e-7)
    assert (solution.force[rests] < friction[rests] * (1 + 1e-9)).all()
    assert not (solution.state == ContactState.UNDECIDED).any()


def test_auto_goes_on_with_operator_splitting_where_the_path_ends_early():
    """Friction over many decades below a top that turns unevenly is too much for float64 Newton steps."""
    top = (1.0, 1.0, 0.0, 0.05)
    settings = RunSettings(shape=(4, 4, 8), distribution="lognormal:1,4", top=top, seed=1, threads=1)
    solution = solve_job(prepare(settings))
    assert solution.method == "operator-splitting"
    assert solution.status is Status.CERTIFIED
    assert solution.gap[0] <= 1e-8


def test_six_decades_on_a_narrow_lattice_are_certified_by_the_path():
    """Strong contacts count as weaker ones; without that the path ended at a gap of 1e-3."""
    settings = RunSettings(shape=(2, 2, 50), distribution="bimodal:1e-3,1e3,0.5", seed=1, threads=1)
    solution = solve_job(prepare(settings))
    assert solution.method == "interior-point"
    assert solution.gap[0] <= 1e-12


def test_splitting_goes_on_with_those_samples_alone_whose_path_ends_early():
    """A block of eight of these took more than nine minutes, as splitting went on with all until all were certified."""
    settings = RunSettings(shape=(5, 4, 7), distribution="bimodal:1e-6,1,0.3", seed=1, threads=1, tolerance=1e-6)
    alone, block = (solve_job(prepare(replace(settings, seed=s, replicas=n))) for s, n in ((2, 1), (1, 2)))
    assert block.status is Status.CERTIFIED
    assert (block.gap <= 1e-6).all()
    assert np.array_equal(block.sample(1).spin, alone.spin)
    assert np.array_equal(block.sample(1).friction, alone.friction)
    certified_by_the_path = solve_job(prepare(settings))
    assert certified_by_the_path.method == "interior-point"
    assert np.array_equal(block.sample(0).spin, certified_by_the_path.spin)


def test_a_scene_whose_spins_are_all_tied_to_the_planes():
    driving = {"direction": (1e-15, 1e-15, 1), "spin_bottom": -0.3}
    scene = make_scene((4, 4, 4), seeds=(75,), distribution="uniform:1e-14,2e-14", **driving)
    assert minimum_of(scene, 0.5).status is Status.CERTIFIED


def test_a_threshold_of_the_user_only_turns_slipping_contacts_into_slipless_ones():
    scene = make_scene((5, 5, 5), seeds=(1,))
    plain = minimum_of(scene)
    threshold = 0.02
    coarse = solve(
        scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-9), slip_threshold=threshold
    )
    fast = coarse.slip > threshold
    assert (coarse.state[~fast] != ContactState.SLIPPING).all()
    assert (coarse.state[fast] == plain.state[fast]).all()


def test_auto_keeps_a_stalled_answer_that_no_other_method_goes_on_from():
    settings = RunSettings(shape=(3, 3, 4), law="coulomb-viscous", tolerance=1e-18, threads=1)
    solution = solve_job(prepare(settings))
    assert solution.status is Status.STALLED
    assert solution.gap[0] < 1e-8


def test_a_sample_with_slips_of_all_sizes_is_settled():
    """Seed 31 of 16^3: of 3641 slipping contacts 724 seem to stick at the end of the path, and one slips by 1e-17."""
    solution = minimum_of(make_scene((16, 16, 16), seeds=(31,)))
    assert solution.states_proven[0]
    assert (solution.state == ContactState.SLIPPING).sum() == 3641


def test_friction_with_viscosity_is_settled_to_slips_of_all_sizes():
    """Of 16^3 seed 1 a step before the last 4136 contacts seem to slip; 4113 do, one by 7e-15 of the fastest."""
    solution = minimum_of(make_scene((16, 16, 16), law="coulomb-viscous", seeds=(1,)))
    assert solution.states_proven[0]
    assert solution.gap[0] < 3e-15
    slips = solution.slip[solution.state == ContactState.SLIPPING]
    assert (len(slips), slips.min() < 1e-14) == (4113, True)


@pytest.mark.parametrize("viscosity", ["constant:1e-12", "power-law:1e-8,1e2,-1", "uniform:1e5,1e6"])
def test_weak_and_strong_viscosity_beside_friction_are_settled(viscosity):
    """The weakest leaves the states of friction alone."""
    scene = make_scene((5, 6, 5), law="coulomb-viscous", viscosity=viscosity, seeds=(2, 3))
    solution = minimum_of(scene)
    assert solution.states_proven.all()
    assert solution.gap.max() < 5e-15
    if viscosity == "constant:1e-12":
        assert (solution.state == minimum_of(make_scene((5, 6, 5), seeds=(2, 3))).state).all()


def test_contacts_that_only_rounding_lets_slip_are_looked_at_again():
    """From a gap of 2e-11 thirty-three contacts seem to slip by some 1e-16; from closer by they hold."""
    solution = minimum_of(make_scene((10, 10, 10), seeds=(559,)))
    assert solution.states_proven[0]
    slips = solution.slip[solution.state == ContactState.SLIPPING]
    assert (len(slips), slips.min() > 1e-9) == (975, True)


@pytest.mark.parametrize("seed", [110, 350])
def test_contacts_first_taken_to_rest_at_their_limit_slip_where_they_would_have_to_bear_more(seed):
    """They were left at rest with 1.07 times their friction, which proves nothing of any contact."""
    solution = minimum_of(make_scene((12, 12, 12), seeds=(seed,)))
    assert solution.states_proven[0]
    assert solution.gap[0] < 1e-13


def test_states_that_are_not_found_at_first_are_found_further_along_the_path(monkeypatch):
    """Seed 86: two steps later the guess is right. Nothing follows the last decades of the path alone."""

    def never(*_):
        raise AssertionError("the last decades were followed")

    trials, settle = [], resolution.resolve
    monkeypatch.setattr(resolution, "_minimum_along_path", never)
    monkeypatch.setattr(descent, "resolve", lambda *of: trials.append(settle(*of)) or trials[-1])
    solution = minimum_of(Scene.random((10, 10, 10), seed=86))
    assert [bool(found and found.sure) for (found,) in trials] == [False, True]
    assert solution.states_proven[0]


@pytest.mark.parametrize("seed", [40, 53])
def test_paths_of_larger_lattices_begin_where_states_settle(seed):
    """From points with forces the paths of these samples end before their states are known."""
    assert minimum_of(Scene.random((16, 16, 16), seed=seed)).states_proven.all()
