"""What methods prove, one by one and together, against enclosures that share nothing with the package."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_bearings.lattice.grid import friction_by_axis, staggered_forces
from taichi_bearings.proof.certificate import lower_bound
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS
from tests.properties import truths
from tests.properties.answers import answer_of, assert_meet, between, laws_of, methods_of
from tests.properties.scenes import PLANAR, SPHERES, cases, scenes, seeds

SHARES = {  # of the cases: these take longer
    "rigid-limit": 0.15,
    "operator-splitting": 0.3,
    "cundall-strack": 0.4,
    "interior-point": 0.5,
    "gradient-descent": 0.7,
}
STARTS = st.sampled_from(("linear", "random", "zero", "minimum-cut"))


@pytest.mark.parametrize("name", METHODS)
def test_what_a_method_proves_encloses_the_truth(name):
    directions = {"directions": PLANAR} if name == "planar-cut" else {}

    @cases(SHARES.get(name, 1.0))
    @given(scenes(laws_of(name), replicas=(1, 2), **directions), STARTS)
    def holds(scene, start):
        answer = answer_of(scene, name, start=start)
        for replica in range(scene.replicas):
            least = truths.least(scene.sample(replica))
            assert_meet(between(answer, replica=replica), (least.lower, least.upper))

    holds()


@cases(0.15)
@given(scenes())
def test_methods_agree_within_what_they_prove(scene):
    answers = {name: answer_of(scene, name) for name in methods_of(scene)}
    proven = {}
    for name, answer in answers.items():
        for other in answers.values():
            assert_meet(between(answer), between(other))
        if answer.states_proven[0]:
            proven[name] = answer.state
    for states in proven.values():
        for others in proven.values():
            assert (states == others).all()


@cases()
@given(scenes(("coulomb",), directions=PLANAR), st.sampled_from(("planar-cut", "interior-point", "operator-splitting")))
def test_states_are_those_of_the_exact_cuts(scene, name):
    """Planar cuts prove it of every contact, and any method where it calls its states proven."""
    answer, (_, truth) = answer_of(scene, name), truths.cut(scene)
    states = scene.lattice.flat(truth)
    named = np.where(states == truths.SOMETIMES, ContactState.TIED, states)
    assert (answer.state[0] == named)[answer.proven[0]].all()
    assert answer.states_proven[0] or name != "planar-cut"
    ties = (states == truths.SOMETIMES).any()
    if answer.states_proven[0]:
        assert answer.minimum_is_unique == [not ties]
    if "cut_is_unique" in answer.findings:
        assert bool(answer.findings["cut_is_unique"][0]) == (not ties)


@cases(0.5)
@given(scenes(shapes=SPHERES[:5]), STARTS)
def test_no_spins_dissipate_less_than_is_proven(scene, start):
    """The bound of a method against spins that no method made, judged in 80 digits."""
    answer = answer_of(scene)
    spin = initial_spin(scene, start)
    friction = friction_by_axis(answer.friction, scene.lattice)
    samples = truths.samples_of(scene, spin, np.zeros_like(spin), friction)
    assert truths.Laboratory(samples).objective() >= answer.lower_bound[0]


@cases(0.7)
@given(scenes(scale=3), seeds, STARTS, st.sampled_from((0.0, 1e-6, 0.1, 1.0)))
def test_any_spins_and_forces_enclose_the_least_value(scene, seed, start, size):
    """Forces from those of the minimum to any. Spins are the doubles that they are, bounds those of the certificate."""
    rng, axes, least = np.random.default_rng(seed), scene.minimum_spin_axes, truths.least(scene)
    best = staggered_forces(answer_of(scene).friction, scene.lattice, axes)
    felt = scene.lattice.tangential_mask(axes)[:, None]
    force = best + size * rng.normal(size=best.shape) * np.where(felt, np.abs(best).max(), 0.0)
    spin = scene.staggered_spin(initial_spin(scene, start), axes)
    assert lower_bound(scene, force, axes)[0] <= least.upper
    assert scene.objective(spin, axes)[0] * (1 + 1e-12) >= least.lower
