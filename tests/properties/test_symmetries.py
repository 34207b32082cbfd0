"""Scenes that are the same but for units, axes and signs have the same answer; to the last bit where nothing rounds."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from taichi_bearings.solvers import METHODS
from tests.properties.answers import answer_of, assert_meet, between, laws_of
from tests.properties.scenes import SPHERES, arrays_of, cases, changed, scenes

EVERY = st.sampled_from(tuple(METHODS))
POWERS = st.integers(-20, 20).map(lambda power: 2.0**power)
FACTORS = st.sampled_from((3.0, 0.1, 1e-7, 7e5))
UNITS = ("friction", "normal force", "radius", "spins")


def scaled(scene, unit, factor):
    """The scene in another unit, and the powers of that factor in its objective and in its spins; viscosities are made
    to keep the share of friction and viscosity."""
    beside = {"friction": factor, "normal force": factor, "radius": 1 / factor, "spins": 1 / factor}[unit]
    objective = {"friction": 1, "normal force": 1, "radius": 1, "spins": 1}[unit]
    share = factor if unit == "friction" else 1.0
    if scene.law.name == "viscous":
        beside, objective = 1.0, {"friction": 1, "normal force": 0, "radius": 2, "spins": 2}[unit]
    factors = {"coefficients": share, "viscosity": beside}
    arrays = {name: tuple(values * factors[name] for values in of) for name, of in arrays_of(scene).items()}
    assume(all(part.min() >= 1e-15 and part.max() <= 1e15 for of in arrays.values() for part in of))
    driven = factor if unit == "spins" else 1.0
    changes = {
        "normal_force": scene.normal_force * (factor if unit == "normal force" else 1.0),
        "radius": scene.radius * (factor if unit == "radius" else 1.0),
        "spin_top": scene.spin_top * driven,
        "spin_bottom": scene.spin_bottom * driven,
    }
    return replace(scene, **arrays, **changes), objective, driven


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", [name for name, row in METHODS.items() if not row.is_dynamics])
def test_powers_of_two_of_a_unit_change_no_bit(name, unit):
    @cases(0.15)
    @given(scenes(laws_of(name), contrast=6, scale=3), POWERS)
    def holds(scene, factor):
        assume(not METHODS[name].refusal(scene))
        other, power, spin = scaled(scene, unit, factor)
        one, two = (answer_of(s, name) for s in (scene, other))
        assert two.objective[0] == one.objective[0] * factor**power
        assert two.lower_bound[0] == one.lower_bound[0] * factor**power
        assert (two.spin == one.spin * spin).all()
        assert (one.state == two.state).all()

    holds()


@cases(0.7)
@given(scenes(scale=3), st.sampled_from(UNITS), FACTORS)
def test_any_factor_of_a_unit_scales_the_least_value(scene, unit, factor):
    """The factor is that of the numbers as they are rounded: a jump is the difference of two; coefficients and all
    others are off by half a unit in the last place."""
    other, power, _ = scaled(scene, unit, factor)
    exact = jump_of(other) / jump_of(scene) if unit == "spins" else Fraction(factor)
    lower, upper = between(answer_of(scene), exact**power)
    rounding = Fraction(8, 2**53)
    assert_meet((lower * (1 - rounding), upper * (1 + rounding)), between(answer_of(other)))


def jump_of(scene):
    return Fraction(scene.spin_top) - Fraction(scene.spin_bottom)


def flipped(axis):
    def mirrored(scene):
        return changed(scene, lambda values, _: np.flip(values, 1 + axis))

    return mirrored


def turned_over(scene):
    """Top and bottom exchanged."""
    upside_down = flipped(scene.lattice.height_axis)(scene)
    return replace(upside_down, spin_top=scene.spin_bottom, spin_bottom=scene.spin_top)


def with_axes_exchanged(scene):
    """x and y: the spins, which are axial, too."""
    if scene.lattice.dimension == 2:
        return flipped(0)(scene)
    named = arrays_of(scene).items()
    arrays = {name: tuple(of[a].swapaxes(1, 2) for a in (1, 0, 2)) if of else () for name, of in named}
    x, y, z = scene.direction
    return replace(scene, **arrays, direction=(y, x, z))


def negated(scene):
    """Both sublattices exchanged."""
    return replace(scene, spin_top=-scene.spin_top, spin_bottom=-scene.spin_bottom)


def with_other_axis(scene):
    return replace(scene, direction=tuple(-part for part in scene.direction))


SYMMETRIES = {
    "mirrored along x": flipped(0),
    "mirrored along y or the height": turned_over,
    "axes exchanged": with_axes_exchanged,
    "sublattices exchanged": negated,
    "axis of rotation backwards": with_other_axis,
}


@cases(0.7)
@given(scenes(replicas=(1, 2)), st.sampled_from(tuple(SYMMETRIES)), EVERY)
def test_symmetries_change_no_least_value(scene, name, method):
    """The images are solved by any method, with proofs that need not be tight."""
    assume(not METHODS[method].refusal(scene))
    image = SYMMETRIES[name](scene)
    one, two = answer_of(scene), answer_of(image, None if METHODS[method].refusal(image) else method)
    for replica in range(scene.replicas):
        assert_meet(between(one, replica=replica), between(two, replica=replica))


@cases(0.4)
@given(scenes(), EVERY)
def test_signs_of_all_spins_change_no_bit(scene, method):
    assume(not METHODS[method].refusal(scene))
    one, two, three = (answer_of(s, method) for s in (scene, negated(scene), with_other_axis(scene)))
    for other in (two,) if scene.lattice.dimension == 2 else (two, three):
        assert (other.objective == one.objective).all()
        assert (other.lower_bound == one.lower_bound).all()
        assert (other.spin == -one.spin).all()


@cases()
@given(scenes(shapes=SPHERES), st.integers(0, 2**32 - 1))
def test_the_power_of_any_spins_has_the_symmetries(scene, seed):
    """Of whatever spins, with the image of the spins: to rounding."""
    axes = (0, 1, 2)
    spin = np.random.default_rng(seed).standard_normal((3, 1, *scene.lattice.shape)) * scene.jump
    power = scene.power(spin, axes)[0]
    if scene.law.minimises == "power":
        assert scene.power(2 * spin, axes)[0] == 2**scene.law.share * power
    assert flipped(0)(scene).power(np.flip(spin, 2), axes)[0] == pytest.approx(power, rel=1e-13)
    swapped = with_axes_exchanged(scene).power(spin[[1, 0, 2]].swapaxes(2, 3), axes)[0]
    assert swapped == pytest.approx(power, rel=1e-13)
    for k in axes:  # a bearing state of the component k
        moved = spin.copy()
        moved[k] += scene.jump * np.moveaxis(np.arange(scene.lattice.shape[k]).reshape(-1, 1, 1, 1), 0, 1 + k)[0]
        assert scene.power(moved, axes)[0] == pytest.approx(power, rel=1e-12)
