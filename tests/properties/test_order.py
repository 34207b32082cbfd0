"""The least value as a function of the coefficients: monotone, concave, additive over what is apart."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from taichi_bearings.solvers import METHODS
from tests.properties.answers import answer_of, assert_meet, between
from tests.properties.scenes import arrays_of, cases, changed, coefficients, scenes, seeds

SHARES = st.sampled_from((0.5, 0.25, 0.125))
POWERS = st.sampled_from((1.0, -1.0, 1e-3, 700.0))
ROUNDING = Fraction(4, 2**53)  # of coefficients that are computed


@cases(0.7)
@given(scenes(), seeds, st.sampled_from((1.0 + 2**-40, 2.0, 1e3)))
def test_more_friction_anywhere_never_lowers_the_least_value(scene, seed, factor):
    """Of one contact, of half of them, of all of one axis."""
    rng = np.random.default_rng(seed)

    def raised(values, axis):
        return np.minimum(
            np.where(rng.random(values.shape) < rng.choice([0.05, 0.5, 1.0]), values * factor, values), 1e15
        )

    below, above = between(answer_of(scene)), between(answer_of(changed(scene, raised)))
    assert below[0] <= above[1]
    assert above[0] <= below[1] * Fraction(factor) * (1 + Fraction(1, 2**50))


def mixed(scene, other, share):
    """Coefficients in between, and the rest of the scene."""
    first, second = arrays_of(scene), arrays_of(other)
    pairs = {name: zip(first[name], second[name], strict=True) for name in first}
    return replace(scene, **{name: tuple(share * a + (1 - share) * b for a, b in of) for name, of in pairs.items()})


@cases(0.7)
@given(st.data(), SHARES)
def test_the_least_value_is_concave_in_the_coefficients(data, share):
    """A minimum of functions that are linear in them."""
    scene = data.draw(scenes(contrast=9))
    drawn = [data.draw(coefficients(scene.lattice, contrast=9)) for _ in scene.law.quantities]
    other = replace(scene, coefficients=drawn[0], viscosity=tuple(drawn[1]) if scene.viscosity else ())
    one, two = (between(answer_of(s))[0] for s in (scene, other))
    least = Fraction(share) * one + (1 - Fraction(share)) * two
    assert least * (1 - ROUNDING) <= between(answer_of(mixed(scene, other, share)))[1]


@cases(0.7)
@given(st.data(), st.sampled_from((1e-15, 1e-6, 1.0)))
def test_what_joins_two_scenes_costs_no_more_than_its_contacts_at_full_slip(data, strength):
    """Side by side: at least both alone, at most both alone and joints slipping by the jump. Weak joints decouple."""
    one = data.draw(scenes(contrast=9, scale=3))
    other = data.draw(scenes((one.law.name,), (one.lattice.shape,), (one.direction,), contrast=9, scale=0))
    arrays, full = {}, Fraction(0)
    slip = Fraction(one.radius) * abs(Fraction(one.spin_top) - Fraction(one.spin_bottom))
    for name, quantity in zip(("coefficients", "viscosity"), one.law.quantities, strict=False):
        left, right = getattr(one, name), getattr(other, name)
        joints = np.full((1, 1, *left[0].shape[2:]), strength)
        arrays[name] = tuple(
            np.concatenate([a, *[joints] * (axis == 0), b], axis=1)
            for axis, (a, b) in enumerate(zip(left, right, strict=True))
        )
        cost = Fraction(one.normal_force) * slip if quantity.is_friction else slip**2
        full += joints[..., 1:-1].size * Fraction(strength) * cost
    together = between(answer_of(replace(one, **arrays)))
    lower, upper = (
        sum(ends)
        for ends in zip(*(between(answer_of(replace(one, **arrays_of(s)))) for s in (one, other)), strict=True)
    )
    assert_meet(together, (lower, upper + full))


@cases()
@given(scenes(("viscous",), contrast=6, scale=3), POWERS, POWERS)
def test_viscous_spins_of_two_drivings_add(scene, top, bottom):
    """Top alone and bottom alone, each with its share: the spins of both together."""
    drivings = ((top, bottom), (top, 0.0), (0.0, bottom))
    both, one, two = (answer_of(replace(scene, spin_top=a, spin_bottom=b)).spin for a, b in drivings)
    np.testing.assert_allclose(both, one + two, rtol=0, atol=1e-9 * max(abs(top), abs(bottom)))


@cases(0.2)
@given(scenes(replicas=(2, 3)), st.sampled_from(tuple(METHODS)))
def test_samples_together_are_the_samples_alone(scene, name):
    """To the last bit where the table of methods says so, else within what is proven."""
    assume(not METHODS[name].refusal(scene))
    together = answer_of(scene, name)
    for replica in range(scene.replicas):
        alone = answer_of(scene.sample(replica), name)
        assert_meet(between(together, replica=replica), between(alone))
        if math.prod(scene.lattice.shape) < METHODS[name].alike_in_a_block:
            assert (together.spin[replica] == alone.spin[0]).all()
            assert together.lower_bound[replica] == alone.lower_bound[0]
