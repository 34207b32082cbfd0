"""Contact states that are proven are those of every minimum, by a truth in 140 digits."""

from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest
from taichi_bearings_studies.stress import truth

from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.solution import SLIPLESS, SLIPPING, TIED, UNDECIDED
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.proof.laboratory import by_axis
from tests.proof.samples import Samples, samples_of
from tests.scenes import make_scene
from tests.stress import minima
from tests.stress.minima import EITHER, least_of_all

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")

# shape, options, method; is all to be proven? None: it need not be, but nothing false may be
SCENES = [
    ((3, 3, 4), {"seeds": (1,)}, "interior-point", True),
    ((2, 4, 4), {"seeds": (17,), "spin_bottom": -0.4, "direction": (1, 2, -1)}, "interior-point", True),
    ((3, 2, 4), {"seeds": (5,), "distribution": "lognormal:0.5,2.0"}, "interior-point", True),
    ((5, 5), {"seeds": (3,)}, "planar-cut", True),
    ((3, 3, 4), {"seeds": (3,), "direction": (0, 1, 0)}, "planar-cut", True),
    # proofs that the first version got wrong: contacts said to hold join both planes, nearly collinear slips, ties
    (
        (2, 2, 3),
        {"seeds": (7,), "distribution": "power-law:1e-3,1e3,-1", "direction": (1, 1e-8, 0)},
        "interior-point",
        True,
    ),
    (
        (3, 3, 3),
        {"seeds": (3,), "distribution": "bimodal:0.1,1,0.5", "direction": (1, 1e-6, 0)},
        "interior-point",
        None,
    ),
    ((3, 3, 3), {"seeds": (6,), "distribution": "bimodal:1e-3,1e3,0.5"}, "interior-point", None),
    ((3, 3, 3), {"seeds": (35,), "distribution": "bimodal:1e-3,1e3,0.5"}, "interior-point", None),
    ((3, 2, 3), {"seeds": (25,), "distribution": "bimodal:1e-9,1e9,0.5"}, "interior-point", None),
    ((2, 2, 5), {"seeds": (312656,), "distribution": "bimodal:1.0,2.0,0.5"}, "interior-point", None),
    ((3, 3, 3), {"seeds": (4,), "distribution": "constant:1.0"}, "interior-point", False),
    ((4, 4), {"seeds": (4,), "distribution": "constant:0.3"}, "planar-cut", True),
    ((5, 4), {"seeds": (2,), "distribution": "bimodal:0.25,1,0.5"}, "planar-cut", None),
]


def minimum(shape, options, method):
    scene = make_scene(shape, **options)
    return solve(scene, METHODS[method]().build(), initial_spin(scene, "linear"), StopRule(1e-10))


@pytest.mark.parametrize(("shape", "options", "method", "wanted"), SCENES, ids=str)
def test_no_state_is_proven_that_is_not_so(shape, options, method, wanted):
    solution = minimum(shape, options, method)
    scene, states = solution.scene, samples_of(solution).judgement.states[0]
    exact = least_of_all(scene)
    for proven, found in zip(scene.lattice.by_axis(states.known), exact.state, strict=True):
        assert (found[proven == SLIPPING] == truth.SLIPPING).all()
        assert np.isin(found[proven == SLIPLESS], (truth.SLIPLESS, minima.DRIVEN)).all()
        assert (found[proven == TIED] == EITHER).all()
    everything = (states.known != UNDECIDED).all()
    assert everything == wanted if wanted is not None else True
    assert states.unique is (False if (states.known == TIED).any() else True if everything else None)
    assert bool(solution.states_proven[0]) == everything
    assert Decimal(float(solution.lower_bound[0])) <= exact.upper
    assert float(exact.lower) <= float(solution.power[0]) * (1 + 3e-16)


# of friction with damping: shape, options; is all to be proven?
DAMPED = [
    ((3, 3, 4), {"seeds": (1,)}, True),
    ((5, 5), {"seeds": (3,), "viscosity": "uniform:5,60"}, True),
    ((3, 3, 4), {"seeds": (3,), "direction": (0, 1, 0), "viscosity": "constant:10"}, True),
    ((2, 4, 4), {"seeds": (17,), "spin_bottom": 1 - 1e-10, "direction": (1, 2, -1)}, True),
    ((2, 3, 4), {"seeds": (5,), "periodic": ("x",)}, True),
    ((3, 3, 4), {"seeds": (2,), "top": (1.0, 0.5, -0.3, 0.2)}, True),
    ((3, 4, 4), {"seeds": (0,), "distribution": "lognormal:1,1"}, True),
    ((3, 3, 4), {"seeds": (4,), "distribution": "bimodal:1,2,0.5", "viscosity": "constant:1"}, None),
    ((3, 3, 3), {"seeds": (6,), "distribution": "bimodal:1e-3,1e3,0.5", "viscosity": "lognormal:1,8"}, None),
    ((3, 2, 3), {"seeds": (25,), "distribution": "constant:1.0", "viscosity": "constant:1e-8"}, None),
]


@pytest.mark.parametrize(("shape", "options", "wanted"), DAMPED, ids=str)
def test_of_damped_contacts_those_at_rest_are_proven_too(shape, options, wanted):
    solution = minimum(shape, {"law": "coulomb-viscous", "viscosity": "uniform:0.1,1.0", **options}, "interior-point")
    scene, proven = solution.scene, samples_of(solution).judgement.states[0].known
    found, acts = scene.lattice.flat(truth.least(scene).state), ~scene.idle[0]
    for state, name in ((SLIPPING, truth.SLIPPING), (SLIPLESS, truth.SLIPLESS)):
        assert (found[acts & (proven == state)] == name).all()
    everything = bool((proven != UNDECIDED).all())
    assert everything == wanted if wanted is not None else True
    assert bool(solution.states_proven[0]) == everything


def test_all_damped_contacts_of_a_thousand_spheres_are_proven():
    options = {"law": "coulomb-viscous", "seeds": (0,), "direction": (1, 1, 0)}
    assert minimum((10, 10, 10), options, "interior-point").states_proven[0]


def test_damped_contacts_lose_the_proof_of_rest_where_it_is_none():
    """By forces that leave no room, or are out of balance by more than others can bear."""
    samples = samples_of(minimum((3, 3, 4), {"seeds": (1,), "law": "coulomb-viscous"}, "interior-point"))
    assert all_proven(samples)
    state = by_axis(samples, samples.judgement.states[0].known)[2]
    holds = tuple(np.argwhere(state == SLIPLESS)[3])
    for share in (0.5, 0.999):
        friction = [f.copy() for f in samples.friction]
        friction[2][(0, *holds)] += share * samples.normal_force * samples.coefficient[2][(0, *holds)]
        judged = replace(samples, friction=tuple(friction)).judgement
        assert not (judged.states[0].known == SLIPLESS)[judged.acts[0]].any()


@pytest.fixture(scope="module")
def sample():
    solution = minimum((3, 3, 4), {"seeds": (1,)}, "interior-point")
    assert solution.states_proven[0]
    return samples_of(solution), solution.scene.lattice.by_axis(solution.state[0])


def all_proven(samples):
    return (samples.judgement.states[0].known != UNDECIDED).all()


def test_a_spin_that_is_off_loses_the_proof(sample):
    samples, _ = sample
    assert all_proven(samples)
    for change in (1e-3, 1e-9, 1e-13):
        spin = samples.spin.copy()
        spin[0, 1, 2, 1, 0] += change
        assert not all_proven(replace(samples, spin=spin))
    rounding = samples.spin_rounding.copy()
    rounding[0, 1, 2, 1, 0] += 1e-20  # contacts said to hold then slip
    assert not all_proven(replace(samples, spin_rounding=rounding))


def test_friction_that_is_out_of_balance_loses_the_proof(sample):
    """One contact that holds bears more: by less than others have room for that can be mended, by more it cannot."""
    samples, state = sample
    holds = tuple(np.argwhere(state[2] == SLIPLESS)[3])
    for share, proven in ((1e-12, True), (0.9, False)):
        friction = [f.copy() for f in samples.friction]
        limit = samples.normal_force * samples.coefficient[2][(0, *holds)]
        friction[2][(0, *holds)] += share * limit * np.array([1.0, 1.0, 0.0])
        assert all_proven(replace(samples, friction=tuple(friction))) == proven


@pytest.mark.parametrize("spoiled", [(), (0,), (3,), (1, 4)], ids=str)
def test_samples_proven_together_are_those_proven_alone(spoiled):
    """At once if all can be, and one that cannot be proven takes no other one with it."""
    samples = samples_of(minimum((3, 3, 4), {"seeds": range(5)}, "interior-point"))
    spin, friction = samples.spin.copy(), tuple(f.copy() for f in samples.friction)
    for r in spoiled[:1]:
        spin[r, 1, 2, 1, 0] += 1e-9
    for r in spoiled[1:]:
        friction[2][r, 1, 1, 1] = 0.0
    samples = replace(samples, spin=spin, friction=friction)
    together = samples.judgement.states
    alone = [samples.judgement.one(r).states[0] for r in range(5)]
    for r, (one, other) in enumerate(zip(together, alone, strict=True)):
        assert (one.known == other.known).all()
        assert (one.unique, one.reason) == (other.unique, other.reason)
        assert (one.unique is None) == (r in spoiled)


def test_other_coefficients_lose_the_proof(sample):
    samples, state = sample
    slips = tuple(np.argwhere(state[2] == SLIPPING)[2])
    coefficient = [c.copy() for c in samples.coefficient]
    coefficient[2][(0, *slips)] *= 1.0 + 1e-4
    assert not all_proven(replace(samples, coefficient=tuple(coefficient)))


def test_contacts_without_slip_cannot_join_the_planes(sample):
    samples, _ = sample
    spin, rounding = samples.spin.copy(), samples.spin_rounding.copy()
    sign = samples.sublattice[1, 1, :, None]
    spin[0, 1, 1, :, 0] = sign[:, 0] * spin[0, 1, 1, 0, 0] * samples.sublattice[1, 1, 0]
    rounding[0, 1, 1, :, 0] = 0.0
    spin[0, :, :, -1] = 0.0  # as if the top stood still, too
    rounding[0, :, :, -1] = 0.0
    spin[0], rounding[0] = 0.0, 0.0
    states = replace(samples, spin=spin, spin_rounding=rounding).judgement.states[0]
    assert states.unique is None
    assert "join" in states.reason


def by_hand(x, y, friction_x, friction_y, spin, top=1.0, bottom=0.0):
    """Two columns of three discs, unit normal force, radius 1/2."""
    arrays = [np.array([values], dtype=float) for values in (x, y, friction_x, friction_y, spin)]
    return Samples(
        (2, 3), "coulomb", tuple(arrays[:2]), top, bottom, (1.0, 1.0, 0.0), 1.0, 0.5, arrays[4],
        np.zeros_like(arrays[4]), tuple(arrays[2:4]),
    )  # fmt: skip


def test_friction_that_proves_no_bound_proves_no_states():
    """It acts the wrong way: the work of the planes is negative, and so leaves more room on a cut than the power."""
    samples = by_hand([[3, 0.1, 0.1]], [[3, 3], [3, 1]], [[-3, 0, -0.1]], [[0, -3], [-3, -1]], [[0, 0, 1], [0, 0, -1]])
    judgement = samples.judgement
    assert judgement.lower_bound[0] == 0
    states = judgement.states[0]
    assert states.unique is None
    assert np.isin(states.known, (UNDECIDED, SLIPLESS)).all()
    exact = least_of_all(Scene(samples.coefficient, normal_force=1.0))
    for proven, found in zip(by_axis(samples, states.known), exact.state, strict=True):
        assert np.isin(found[proven == SLIPLESS], (truth.SLIPLESS, minima.DRIVEN)).all()


def test_a_driven_plane_turns_as_one_whatever_the_file_says_of_its_spheres():
    even = by_hand([[1, 1, 1]], [[1, 2], [2, 1]], [[0, 0, 0]], [[0, 0], [0, 0]], [[0, 0, 1], [0, 0, -1]])
    spin = even.spin.copy()
    spin[0, 1, 2] = 0.0  # as if it stood still
    assert replace(even, spin=spin).judgement.power[0] == even.judgement.power[0]


def test_viscous_contacts_slip_where_the_gap_allows_nothing_else():
    solution = minimum((4, 5, 4), {"law": "viscous"}, "linear-solver")
    lattice = solution.scene.lattice
    proven = samples_of(solution).judgement.states[0].known
    assert (proven == np.where(lattice.between_driven, SLIPLESS, SLIPPING)).all()


def test_absent_contacts_that_slip_are_judged_without_a_word():
    """They have no stiffness, and nothing can be divided by it; warnings are errors here."""
    rng, whole = np.random.default_rng(16), make_scene((4, 3, 3), seeds=(16,), direction=(1e-9, 1.0, 0.0))
    coefficient = [values.copy() for values in whole.coefficients]
    for _ in range(4):
        some = coefficient[rng.integers(3)][0]
        some[tuple(rng.integers(size) for size in some.shape)] = 0.0
    scene = Scene(tuple(coefficient), direction=whole.direction)
    answer = solve(scene, METHODS["interior-point"]().build(), initial_spin(scene, "linear"), StopRule(1e-10))
    assert float(answer.lower_bound[0]) <= float(answer.power[0])
