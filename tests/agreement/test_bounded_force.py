"""A law of one's own whose force has a largest value, beyond which its conjugate is infinite."""

import numpy as np
import pytest
from scipy.optimize import minimize

from taichi_bearings.compiler import ti
from taichi_bearings.errors import InputError
from taichi_bearings.kernels.contact import FORCES, length
from taichi_bearings.proof.certificate import lower_bound
from taichi_bearings.scene import Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.law import LAWS, Law, Quantity
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import METHODS, fastest
from tests.own_laws import FAST, Bounded, bounded_force

NAME = "bounded"


def law_of(kind=Bounded, unit="force", **others):
    return kind(NAME, (Quantity("friction", unit),), **{"minimises": "potential", **others})


@pytest.fixture(autouse=True)
def table(monkeypatch):
    monkeypatch.setitem(LAWS, NAME, law_of())
    monkeypatch.setitem(FORCES, NAME, bounded_force)


def least_potential(scene, strength=1.0):
    """Least potential of discs, and its spins, in the laboratory frame, from the formula of the law alone."""
    along_x, along_y = (strength * values.reshape(values.shape[-2:]) for values in scene.coefficients)
    spin, radius = np.zeros(scene.lattice.shape), scene.lattice.radius
    spin[:, -1] = scene.spin_top * (1 - 2 * ((np.arange(len(spin)) + spin.shape[1] - 1) % 2))

    def potential(free):
        spin[:, 1:-1] = free.reshape(spin[:, 1:-1].shape)
        total, slope = 0.0, np.zeros_like(spin)
        for limit, lower, upper in (
            (along_x[:, 1:-1], np.s_[:-1, 1:-1], np.s_[1:, 1:-1]),
            (along_y, np.s_[:, :-1], np.s_[:, 1:]),
        ):
            slip = radius * (spin[lower] + spin[upper])
            speed = np.abs(slip)
            total += float((limit * np.where(speed < FAST, speed**2 / (2 * FAST), speed - FAST / 2)).sum())
            force = radius * limit * np.clip(slip / FAST, -1, 1)
            slope[lower] += force
            slope[upper] += force
        return total, slope[:, 1:-1].ravel()

    options = {"gtol": 1e-12, "ftol": 0, "maxiter": 9999}
    found = minimize(potential, np.zeros(spin[:, 1:-1].size), jac=True, method="L-BFGS-B", options=options)
    spin[:, 1:-1] = found.x.reshape(spin[:, 1:-1].shape)
    return found.fun, spin


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("method", ["gradient-descent", "cundall-strack"])
@pytest.mark.parametrize("shape", [(4, 5), (4, 4, 4)], ids=str)
def test_it_is_certified_although_balanced_forces_exceed_the_largest_by_rounding(method, shape):
    scene = Scene.random(shape, seed=1, law=NAME, replicas=2)
    found = solve(scene, METHODS[method]().build(), initial_spin(scene, "linear"), StopRule(1e-6))
    assert found.status is Status.CERTIFIED
    assert (found.gap <= 1e-6).all()
    if len(shape) == 2:
        least = [least_potential(scene.sample(number))[0] for number in range(2)]
        assert found.objective == pytest.approx(least, rel=2e-6)
        assert (found.lower_bound <= np.array(least) * (1 + 1e-9)).all()


@pytest.mark.parametrize("unit", ["force", "1"])
def test_no_forces_prove_more_than_the_least_potential(unit):
    """Also where the coefficient is a friction: forces below it have a price, as the law says."""
    scene, rng = Scene.random((4, 5), seed=1, law=law_of(unit=unit)), np.random.default_rng(3)
    least, minimum = least_potential(scene, scene.strength if unit == "1" else 1.0)
    best = 0.0
    for noise in (0.0, 1e-9, 1e-3, 0.1) * 8:
        spin = minimum + noise * rng.standard_normal((1, 4, 5))
        difference = scene.differences(scene.staggered_spin(spin, (2,)), (2,))
        size = scene.law.force(scene.material, scene.lattice.radius * np.abs(difference[0]))
        force = np.sign(difference) * size * rng.choice([0.5, 1.0, 1 + 1e-15, 2.0])
        bound = lower_bound(scene, force, (2,))[0]
        assert np.isfinite(bound)
        assert bound <= least * (1 + 1e-12)
        best = max(best, bound)
    assert best > (1 - 1e-6) * least


def limited(fast):
    """A law that is bounded beyond the speed `fast`, and its force on the device."""

    class Limited(Bounded):
        def force(self, of, slip):
            return of[0] * np.minimum(slip / fast, 1.0)

        def potential(self, of, slip):
            return of[0] * np.where(slip < fast, slip**2 / (2 * fast), slip - fast / 2)

        def conjugate(self, of, force):
            return super().conjugate(of, force) * fast / FAST

        def steepest(self, of, slip):
            return of[0] / fast

    @ti.func
    def force(difference: ti.template(), coefficients: ti.template(), radius):
        scale = coefficients[0] * radius / ti.max(radius * length(difference), fast)
        return [scale * d for d in ti.static(difference)]

    return Limited(NAME, (Quantity("friction", "force"),), minimises="potential"), force


@pytest.mark.parametrize("fast", [0.2, FAST, 0.02])
def test_a_function_that_makes_forces_serves_several_values_in_one_process(fast, monkeypatch):
    law, force = limited(fast)
    monkeypatch.setitem(LAWS, NAME, law)
    monkeypatch.setitem(FORCES, NAME, force)
    scene = Scene.random((4, 5), seed=1, law=NAME)
    found = solve(scene, METHODS["gradient-descent"]().build(), initial_spin(scene, "linear"), StopRule(1e-3))
    assert found.status is Status.CERTIFIED
    monkeypatch.setitem(FORCES, NAME, limited(2 * fast)[1])
    with pytest.raises(InputError, match="both must be the same"):
        solve(scene, METHODS["gradient-descent"]().build(), initial_spin(scene, "linear"), StopRule(1e-3))


class Free(Bounded):
    """Forces beyond the largest one cost no more than that: balanced forces would prove too much."""

    def conjugate(self, of, force):
        return np.where(force <= of[0], super().conjugate(of, force), of[0] * FAST / 2)


class Unknown(Bounded):
    def conjugate(self, of, force):
        return np.where(force <= of[0], super().conjugate(of, force), np.nan)


WRONG = {
    r"must be at least f \* v for an f beyond the largest force\(v\), too": {"kind": Free},
    "must be a number for any force, or infinite beyond the largest one": {"kind": Unknown},
    "minimises its potential, so its `share` must be 1, not 2": {"share": 2.0},
    "minimises 'energy'; it must be 'power' or 'potential'": {"minimises": "energy"},
}


@pytest.mark.parametrize("sentence", WRONG)
def test_a_wrong_conjugate_or_share_is_refused(sentence):
    Scene.random((3, 4), law=law_of())
    with pytest.raises(InputError, match=sentence):
        Scene.random((3, 4), law=law_of(**WRONG[sentence]))


class Unsloped(Bounded):
    steepest = Law.steepest


REFUSED = {
    "gradient-descent takes it if it defines `steepest`": {"kind": Unsloped},
    'its friction has the unit "1" of friction, which none of our methods takes': {"unit": "1"},
}


@pytest.mark.parametrize("why", REFUSED)
def test_a_named_method_refuses_a_law_for_the_reason_that_auto_gives(why):
    scene = Scene.random((3, 4), law=law_of(**REFUSED[why]))
    assert METHODS["gradient-descent"].refusal(scene).endswith(f"; {why}")
    with pytest.raises(InputError, match=why):
        fastest(scene, 1e-6, on_gpu=False)
    assert METHODS["linear-solver"].refusal(scene).endswith("; it solves viscous")
