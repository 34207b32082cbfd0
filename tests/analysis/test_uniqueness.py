"""Whether a minimum is the only one: by hand, by ties, and against other minima found by moving along what is free."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_bearings.analysis.structure import structures_of
from taichi_bearings.contact_state import ContactState
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.interior_point import InteriorPoint
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene


def structure(shape, **options):
    scene = make_scene(shape, **options)
    return structures_of(solve(scene, InteriorPoint(), initial_spin(scene, "linear"), StopRule(1e-10)))[0]


pytestmark = pytest.mark.usefixtures("taichi_runtime", "double_precision")


@pytest.fixture(scope="module")
def double_precision(precision):
    if precision != "f64":
        pytest.skip("a statement about minima in double precision")


@pytest.mark.parametrize("seed", [4711, 8, 15])
@pytest.mark.parametrize("shape", [(3, 3, 3), (4, 5, 6), (6, 7)], ids=str)
def test_random_friction_has_one_minimum(shape, seed):
    found = structure(shape, seeds=(seed,))
    assert found.uniqueness.unique
    assert found.uniqueness.conditions >= found.uniqueness.unknowns


@pytest.mark.parametrize("shape", [(5, 6), (3, 3, 5)], ids=str)
def test_equal_friction_ties(shape):
    """Any level of the layers between bottom and top has the same power, and the interior point lies between them."""
    found = structure(shape, distribution="constant:0.5")
    assert found.uniqueness.unknowns > 0
    assert not found.uniqueness.unique


def test_planes_that_are_apart_and_tie_are_told_though_others_do_not():
    scene = make_scene((3, 4, 5), direction=(1, 0, 0))
    solved = solve(scene, InteriorPoint(), initial_spin(scene, "linear"), StopRule(1e-10))
    assert structures_of(solved)[0].uniqueness.unique
    for axis in (1, 2):
        scene.coefficient[axis][:, 1] = 0.3
    tied = solve(scene, InteriorPoint(), initial_spin(scene, "linear"), StopRule(1e-10))
    assert not structures_of(tied)[0].uniqueness.unique


def test_a_layer_that_turns_about_the_height_changes_no_slip():
    """It is none of the spins that are unique: the driving does not need it."""
    found = structure((3, 4, 5), seeds=(3,))
    assert found.uniqueness.unique
    every = found.scene.lattice.all_spin_axes
    spins = found.scene.staggered_spin(found.spin[None], every)
    spins[2, ..., 2] += 0.7
    assert found.scene.power(spins, every) == pytest.approx([found.power], rel=1e-13)


def test_a_slip_threshold_says_nothing_of_it():
    found = structure((5, 6), distribution="constant:0.5")
    still = tuple(np.where(state == ContactState.SLIPPING, ContactState.SLIPLESS, state) for state in found.state)
    assert replace(found, state=still).uniqueness.unique  # which is false: they are not states of a minimum
    assert replace(found, state=still, states_proven=False).uniqueness is None


def test_it_is_that_of_the_conditions_of_all_spheres():
    """A dense matrix with an unknown for each sphere and rows for slipless contacts too, in place of domains."""
    found = structure((4, 3, 6), seeds=(3,))
    scene, spins = found.scene, found.staggered
    number = np.full((2, *scene.lattice.shape), -1)
    number[..., 1:-1] = np.arange(number[..., 1:-1].size).reshape(number[..., 1:-1].shape)
    ties, slips = [], []
    for axis, state in enumerate(found.state):
        for place in np.argwhere(state < 2):
            ends = [tuple(place), tuple(place + np.eye(3, dtype=int)[axis])]
            parts = [k for k in (0, 1) if k != axis]
            jump = np.array([spins[(k, *ends[1])] - spins[(k, *ends[0])] for k in parts])
            if state[tuple(place)] == 0:
                fixed = np.eye(len(parts))
            elif len(parts) == 2:
                fixed = np.array([[-jump[1], jump[0]]]) / np.hypot(*jump)
            else:
                continue
            for condition in fixed:
                row = np.zeros(number.max() + 1)
                for k, weight in zip(parts, condition, strict=True):
                    for end, sign in zip(ends, (-1, 1), strict=True):
                        if number[(k, *end)] >= 0:
                            row[number[(k, *end)]] += sign * weight
                (ties if state[tuple(place)] == 0 else slips).append(row)
    rank = np.linalg.matrix_rank(np.array(ties + slips), tol=1e-6)
    assert (rank == number.max() + 1) == found.uniqueness.unique
    alike = np.linalg.pinv(np.array(ties)) @ np.array(ties)  # projects on what the ties rule out
    domains = {tuple(np.flatnonzero(column.round(6))) for column in np.eye(len(alike)) - alike} - {()}
    condition = np.stack([np.array(slips)[:, domain].sum(axis=1) for domain in domains], axis=1)
    assert condition.shape == (found.uniqueness.conditions, found.uniqueness.unknowns)
    assert found.uniqueness.least_eigenvalue == pytest.approx(np.linalg.eigvalsh(condition.T @ condition)[0])
    assert found.uniqueness.least_eigenvalue > 1e-6
