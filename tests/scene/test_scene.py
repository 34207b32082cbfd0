"""What a scene is made of, and the distributions of its coefficients."""

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.errors import InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.scene import Scene
from taichi_bearings.scene.disorder import Distribution, draw_coefficients
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from tests.packing.twins import pair
from tests.scenes import make_scene


@pytest.mark.parametrize("bad", [np.nan, np.inf, -0.3, 1e-16])
def test_bad_coefficients_are_named(bad):
    scene = make_scene((3, 4, 5))
    broken = [c.copy() for c in scene.coefficients]
    broken[1][0, 2, 1, 3] = bad
    with pytest.raises(InputError, match=r"at \[2, 1, 3\] along y is not allowed"):
        Scene(tuple(broken))


def test_coefficients_of_another_shape_are_refused():
    x, y, z = (values[0] for values in make_scene((3, 4, 5)).coefficients)
    with pytest.raises(InputError, match=r"along z have shape \(4, 3, 4\); this lattice needs \(3, 4, 4\)"):
        Scene((x, y, z.swapaxes(0, 1)))


def test_coefficients_along_x_and_y_that_are_exchanged_are_recognised():
    x, y = (values[0] for values in make_scene((3, 5)).coefficients)
    with pytest.raises(InputError, match=r"this lattice needs \(4, 3\); x and y may be exchanged"):
        Scene((y, x))
    x, y, z = (values[0] for values in make_scene((3, 4, 5)).coefficients)
    with pytest.raises(InputError, match="x and y may be exchanged"):
        Scene((y, x, z))
    with pytest.raises(InputError) as told:
        Scene((x, y, z.swapaxes(0, 1)))
    assert "exchanged" not in str(told.value)


def test_only_frustrated_components_are_carried():
    assert make_scene((3, 3, 4)).minimum_spin_axes == (0, 1)
    assert make_scene((3, 3, 4), direction=(1, 0, 0)).minimum_spin_axes == (0,)
    assert make_scene((3, 3, 4), direction=(1, 2, 3)).minimum_spin_axes == (0, 1)
    assert make_scene((3, 3, 4), direction=(0, 0, 1)).minimum_spin_axes == (0,)
    assert make_scene((3, 4)).minimum_spin_axes == (2,)


@pytest.mark.parametrize("shape", [(4, 5), (3, 4, 5)])
@pytest.mark.parametrize("start", STARTS)
def test_every_start_survives_the_change_of_frame_and_obeys_the_driving(shape, start):
    scene = make_scene(shape, spin_bottom=0.3)
    axes = scene.lattice.all_spin_axes
    staggered = scene.staggered_spin(initial_spin(scene, start), axes)
    again = scene.staggered_spin(scene.laboratory_spin(staggered, axes), axes)
    assert (again == staggered).all()
    assert not staggered[..., 0].any()
    assert (staggered[..., -1] == scene.top_spin(axes)[:, None]).all()


def test_random_starts_do_not_touch_the_disorder_and_follow_the_seed():
    first, second = make_scene((3, 4, 5), seeds=(8,)), make_scene((3, 4, 5), seeds=(8, 9))
    assert (initial_spin(first, "random")[0] == initial_spin(second, "random")[0]).all()
    assert (first.coefficient[0] == second.coefficient[0]).all()


def test_a_scene_owns_what_it_is_given():
    """A buffer that is filled anew, or its last value made impossible, changes no scene; nor can a scene be changed."""
    given = [np.full((3, 5), 0.4), np.full((4, 4), 0.4)]
    scenes = [Scene(given), Scene(given, law="coulomb-viscous", viscosity=given)]
    start = np.zeros((4, 5))
    spin = initial_spin(scenes[0], start)
    for values in (*given, start):
        values[:] = -1.0
    for values in (*scenes[0].coefficients, *scenes[1].viscosity, scenes[0].coefficient):
        assert (values == 0.4).all()
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0
    assert not spin.any()


def test_a_faint_part_of_the_direction_has_a_finite_power(needs_f64):
    """Slips of 1e-80 of the largest at contacts of 1e-15 to 1e15, whose squares no float holds."""
    extreme = lambda rng, shape: 10.0 ** rng.uniform(-15, 15, shape)  # noqa: E731
    scene = Scene.random((3, 3, 4), 3, extreme, law="coulomb-viscous", viscosity=extreme, direction=(1, 1e-80, 0))
    best = tb.solve(scene, threads=1)
    assert best.lower_bound <= best.potential < np.inf
    assert 0 < best.power < np.inf
    assert 0 <= best.gap <= 1


def test_the_seed_convention_is_one_uniform_draw_an_axis():
    rng = np.random.default_rng(12)
    expected = [rng.uniform(0.1, 1.0, shape) for shape in ((2, 4, 5), (3, 3, 5), (3, 4, 4))]
    drawn = draw_coefficients(Lattice((3, 4, 5)), Distribution.parse("uniform:0.1,1.0"), 12)
    assert all((a == b).all() for a, b in zip(drawn, expected, strict=True))


@pytest.mark.parametrize(
    ("text", "mean"),
    [
        ("uniform:0.1,1.0", 0.55),
        ("lognormal:0.5,0.3", 0.5 * np.exp(0.045)),
        ("power-law:0.1,1.0,-1", 0.9 / np.log(10)),
        ("power-law:0.1,1.0,2", 3 / 4 * (1 - 1e-4) / (1 - 1e-3)),
        ("bimodal:0.1,0.9,0.25", 0.3),
        ("constant:0.4", 0.4),
    ],
)
def test_distributions_have_their_mean(text, mean):
    values = Distribution.parse(text)(np.random.default_rng(3), (200_000,))
    assert values.mean() == pytest.approx(mean, abs=5 * values.std() / np.sqrt(len(values)) + 1e-12)
    assert (values > 0).all()
    assert str(Distribution.parse(str(Distribution.parse(text)))) == str(Distribution.parse(text))


@pytest.mark.parametrize(
    "text",
    ["gauss:0,1", "uniform:1", "uniform:a,b", "uniform:-1,1", "uniform:0,1", "uniform:2,1", "constant:nan",
     "bimodal:0.1,1,1.5", "lognormal:1,-1", "uniform", "constant:inf"],
)  # fmt: skip
def test_nonsense_distributions_are_refused(text):
    with pytest.raises(InputError):
        Distribution.parse(text)


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("shape", [(4, 4, 5), (5, 6)], ids=str)
def test_a_lattice_and_the_packing_of_its_kind_start_alike(shape, start):
    """By strides and bearing states, and by a list of contacts and conjugate gradients: free spheres turn alike."""
    scene, packing = pair(shape, 3, spin_bottom=0.25, **({"direction": (0.6, 0.8, 0.0)} if len(shape) == 3 else {}))
    spins = [initial_spin(one, start)[0].reshape(packing.spin.shape) for one in (scene, packing)]
    free = packing.driven < 0
    assert spins[0][free] == pytest.approx(spins[1][free], abs=1e-9)
    assert (np.ptp(spins[0][free]) > 0) == (start != "zero")


@pytest.mark.parametrize("text", [
    "lognormal:0.4,0.8", "lognormal:1e-3,12", "power-law:0.1,1,-0.3", "power-law:0.1,1,-1", "power-law:1e-3,1e3,-3",
    "power-law:0.1,1,-1.001", "power-law:0.5,2,6", "uniform:0.1,1", "bimodal:0.1,1,0.5", "constant:0.3",
])  # fmt: skip
def test_how_far_machines_may_differ_in_what_a_seed_draws(text):
    """Another machine rounds exponentials and powers otherwise; here they are computed to 64 bits and then rounded."""
    source, shape, wide = Distribution.parse(text), (20_000,), np.longdouble
    name, (a, b, *more) = source.name, (*map(wide, source.parameters), None)
    level = np.random.default_rng(5).uniform(0.0, 1.0, shape)
    if name == "lognormal":
        other = a * np.exp(b * np.random.default_rng(5).standard_normal(shape))
    elif name == "power-law" and more[0] == -1:
        other = a * (b / a) ** level
    elif name == "power-law":
        low, high = (float(end ** (more[0] + 1)) for end in (a, b))
        other = (low + (high - low) * level) ** (1 / (more[0] + 1))
    else:
        other = source(np.random.default_rng(5), shape)
    drawn = source(np.random.default_rng(5), shape)
    difference = np.abs(np.asarray(other, np.float64) / drawn - 1).max()
    assert difference <= source.rounding
    assert difference == 0 or source.rounding > 0
    if np.finfo(wide).eps < np.finfo(float).eps:  # elsewhere nothing is computed more precisely
        assert difference > 0 or source.rounding == 0
