"""The linear solver of the viscous law: exact answers, independent solvers, contrasts, batches."""

from fractions import Fraction

import numpy as np
import pytest

from taichi_bearings.lattice import Lattice
from taichi_bearings.scene import Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import LinearSolver
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.kernels.twins import is_driven, neighbours
from tests.scenes import make_scene

SHAPES = [(2, 3), (2, 40), (9, 7), (13, 31), (2, 2, 3), (5, 9, 14), (9, 2, 5), (10, 10, 10)]
SIX_DECADES = ["power-law:1e-3,1e3,-1", "bimodal:1e-3,1e3,0.5", "lognormal:1,2.3"]


def solved(scene, start="random", tolerance=1e-12):
    solution = solve(scene, LinearSolver().build(), initial_spin(scene, start), StopRule(tolerance))
    assert solution.status is Status.CERTIFIED
    assert (solution.lower_bound <= solution.power).all()
    return solution


def imbalance(solution):
    """Largest leftover torque over the typical torque of a contact."""
    force = solution.force[solution.force > 0].mean()
    return solution.largest_balance_residual.max() / (solution.scene.lattice.radius * force)


def test_a_component_about_the_height_adds_nothing():
    tilted = solved(make_scene((5, 9, 14), "viscous", direction=(1, 2, 3), spin_bottom=0.4))
    level = solved(make_scene((5, 9, 14), "viscous", direction=(1, 2, 0), spin_bottom=0.4))
    assert tilted.power[0] == pytest.approx(level.power[0] * 5 / 14, rel=1e-13)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_without_disorder_spins_are_linear_in_the_height(shape):
    scene = make_scene(shape, "viscous", distribution="constant:0.3", spin_top=3.0, spin_bottom=-1.0)
    solution = solved(scene)
    assert solution.spin == pytest.approx(initial_spin(scene, "linear"), abs=1e-14)


def columns(layers, sideways):
    """Two columns of discs: layers (2, contacts) damping along each, `sideways` between them."""
    lattice = Lattice((2, layers.shape[1] + 1))
    across = np.full((1, *lattice.contact_shape(0)), sideways)
    return Scene((across, layers[None]), "viscous")


@pytest.mark.parametrize("contacts", [2, 3, 50])
def test_columns_are_resistors_in_series(contacts):
    """Nothing flows sideways between equal columns: each one is a chain, 1/eta add up."""
    eta = np.tile(10.0 ** np.random.default_rng(5).uniform(-3, 3, contacts), (2, 1))
    solution = solved(columns(eta, 0.8))
    assert solution.power[0] == pytest.approx(2 * 0.25 / (1 / eta[0]).sum(), rel=1e-13)


@pytest.mark.parametrize("contacts", [2, 3, 50])
def test_layers_are_resistors_in_parallel_or_not_at_all(contacts):
    """Stiff contacts sideways tie a layer together, so eta add up in it; loose ones leave two chains."""
    eta = np.random.default_rng(6).uniform(0.1, 1.0, (2, contacts))
    tied = 0.25 / (1 / eta.sum(axis=0)).sum()
    apart = (0.25 / (1 / eta).sum(axis=1)).sum()
    assert solved(columns(eta, 1e12)).power[0] == pytest.approx(tied, rel=1e-10)
    assert solved(columns(eta, 1e-12)).power[0] == pytest.approx(apart, rel=1e-10)


def exact_spins(scene):
    """Staggered spins of a small 2D scene by Gauss elimination in fractions, no rounding at all."""
    shape = scene.lattice.shape
    free = [site for site in np.ndindex(*shape) if not is_driven(site, shape)]
    index = {site: n for n, site in enumerate(free)}
    rows = [[Fraction(0)] * (len(free) + 1) for _ in free]
    for low, high, axis in neighbours(shape):
        eta = Fraction(float(scene.coefficients[axis][0][low]))
        for here, there in ((low, high), (high, low)):
            if here in index:
                rows[index[here]][index[here]] += eta
                if there in index:
                    rows[index[here]][index[there]] -= eta
                elif there[-1] > 0:
                    rows[index[here]][-1] += eta * Fraction(scene.spin_top)
    for n, pivot in enumerate(rows):
        rows[n] = [value / pivot[n] for value in pivot]
        for other in range(len(rows)):
            if other != n and rows[other][n]:
                factor = rows[other][n]
                rows[other] = [a - factor * b for a, b in zip(rows[other], rows[n], strict=True)]
    spin = {site: Fraction(scene.spin_top if site[-1] else 0) for site in np.ndindex(*shape) if site not in index}
    return spin | {site: rows[n][-1] for site, n in index.items()}


@pytest.mark.parametrize("distribution", [*SIX_DECADES, "bimodal:1e-5,1e5,0.6"])
def test_six_decades_and_more_are_exact_in_every_contact(distribution):
    """Forces of stiff contacts too, whose spins differ by less than the rounding of the spins themselves."""
    scene = make_scene((4, 6), "viscous", distribution=distribution)
    solution, spin = solved(scene), exact_spins(scene)
    power, forces, largest = Fraction(0), scene.lattice.by_axis(solution.force[0]), solution.force.max()
    for low, high, axis in neighbours(scene.lattice.shape):
        eta = Fraction(float(scene.coefficients[axis][0][low]))
        force = eta * abs(spin[high] - spin[low]) / 2
        power += eta * (spin[high] - spin[low]) ** 2 / 4
        assert forces[axis][low] == pytest.approx(float(force), rel=1e-12, abs=1e-14 * largest)
    assert solution.power[0] == pytest.approx(float(power), rel=1e-14)


@pytest.mark.parametrize("distribution", SIX_DECADES)
@pytest.mark.parametrize("shape", [(60, 50), (11, 12, 13)], ids=str)
def test_six_decades_balance_to_round_off(shape, distribution):
    solution = solved(make_scene(shape, "viscous", distribution=distribution, seeds=(1, 2, 3)))
    assert solution.gap.max() < 1e-13
    assert imbalance(solution) < 1e-12


def test_a_contrast_beyond_float64_ends_stalled_and_still_bounded():
    scene = make_scene((20, 20), "viscous", distribution="bimodal:1e-15,1e15,0.5")
    solution = solve(scene, LinearSolver().build(), initial_spin(scene, "linear"), StopRule(1e-9))
    assert solution.status is Status.STALLED
    assert np.isfinite(solution.power).all()
    assert 0 <= solution.lower_bound[0] <= solution.power[0]
