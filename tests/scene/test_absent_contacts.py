"""Coefficients of exactly 0: contacts that are absent, spheres that are cut off."""

import json
from itertools import product

import numpy as np
import pytest
from click.testing import CliRunner
from taichi_bearings_cli.main import bearings
from taichi_bearings_studies.stress.truth import least

import taichi_bearings as tb
from taichi_bearings.errors import InputError
from taichi_bearings.proof.certificate import lower_bound, work_and_bound
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.solvers import METHODS
from tests.scenes import KNOWN_LAWS


def draw(shape, law, absent, seed=3):
    """A scene of which a share of the contacts is absent, and one sphere cut off."""
    rng = np.random.default_rng(seed)
    arrays, middle = [], tuple(n // 2 for n in shape)
    for axis in range(len(shape)):
        values = rng.uniform(0.1, 1.0, tuple(n - (a == axis) for a, n in enumerate(shape)))
        values[rng.uniform(size=values.shape) < absent] = 0.0
        for place in (middle, tuple(n - (a == axis) for a, n in enumerate(middle))):
            if all(i < n for i, n in zip(place, values.shape, strict=True)):
                values[place] = 0.0
        arrays.append(values)
    viscosity = tuple(2 * values for values in arrays) if law == "coulomb-viscous" else ()
    return tb.Scene(tuple(arrays), law, viscosity=viscosity)


def can_be_tried(method, law, shape):
    """The rigid limit takes seconds for a few spheres; its conic steps are those of the interior point."""
    takes_long = method == "rigid-limit" and law != "viscous"
    return not takes_long and not METHODS[method].refusal(draw(shape, law, 0.1))


SHAPES = ((4, 5), (3, 2, 4))
CASES = [case for case in product(METHODS, KNOWN_LAWS, SHAPES) if can_be_tried(*case)]


@pytest.mark.parametrize(("method", "law", "shape"), CASES, ids=str)
def test_absent_contacts_bear_nothing_and_cost_nothing(method, law, shape, needs_f64):
    scene = draw(shape, law, 0.15)
    truth = least(scene)
    found = tb.solve(scene, METHODS[method](), tolerance=1e-5, iterations=50_000, threads=1)
    assert float(truth.upper) == pytest.approx(found.potential, rel=3e-5)
    assert found.lower_bound <= float(truth.upper) * (1 + 1e-13)
    assert found.gap < 3e-5
    for axis, values in enumerate(scene.coefficients):
        assert (found.state[axis][values == 0] == ContactState.DRIVEN).all()
        assert not found.force[axis][values == 0].any()
        assert not found.friction[axis][values == 0].any()


@pytest.mark.parametrize("law", KNOWN_LAWS)
def test_nothing_slips_where_nothing_joins_bottom_and_top(law, needs_f64):
    scene = draw((3, 2, 4), law, 0.0)
    parts = [[values.copy() for values in given] for given in (scene.coefficients, scene.viscosity)]
    for values in (parts[0][2], *parts[1][2:]):
        values[..., 1] = 0.0
    found = tb.solve(tb.Scene(parts[0], law, viscosity=parts[1]), threads=1)
    assert found.status == "certified"
    assert found.potential < 1e-9 * scene.normal_force


def test_a_force_at_an_absent_contact_proves_nothing():
    """One column, its middle contact absent: a force through it would be in balance."""
    column = np.array([[1.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    scene = tb.Scene((np.zeros((1, 4)), column))
    force = scene.lattice.flat([np.zeros((1, 4)), np.where([[True], [False]], 50.0, 0.0) * np.ones((2, 3))])[None, None]
    assert lower_bound(scene, force, (2,))[0] == work_and_bound(scene, force, (2,))[1][0] == 0.0
    assert tb.solve(scene, "operator-splitting", iterations=2000, threads=1).lower_bound == 0.0


def test_all_contacts_absent_is_refused():
    with pytest.raises(InputError, match="at least one must be positive"):
        tb.Scene((np.zeros((2, 3)), np.zeros((3, 2))))


def test_friction_without_viscosity_is_refused():
    with pytest.raises(InputError, match="both must be positive, or both 0"):
        tb.Scene((np.ones((1, 3)), np.ones((2, 2))), "coulomb-viscous", viscosity=(np.ones((1, 3)), np.zeros((2, 2))))


def test_a_run_with_absent_contacts_is_verified_and_analysed(tmp_path, needs_f64):
    scene = draw((4, 5), "coulomb", 0.1)
    np.savez(tmp_path / "mine.npz", x=scene.coefficients[0], y=scene.coefficients[1])
    arguments = [
        "run",
        "--shape",
        "4,5",
        "--coefficients",
        str(tmp_path / "mine.npz"),
        "--out",
        str(tmp_path / "run"),
        "--threads",
        "1",
    ]
    assert CliRunner().invoke(bearings, arguments).exit_code == 0
    found = CliRunner().invoke(bearings, ["verify", str(tmp_path / "run"), "--json"])
    assert found.exit_code == 0, found.output
    assert json.loads(found.output)["power"] == pytest.approx(float(least(scene).upper), rel=1e-12)
    network = tb.analyse(tmp_path / "run")
    assert network.power_minimum_cut == pytest.approx(float(least(scene).upper), rel=1e-12)
