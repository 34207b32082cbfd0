"""Bearing states on both planes against a cone programme in the laboratory frame, with all three components."""

from functools import partial

import clarabel
import numpy as np
import pytest
from scipy import sparse

import taichi_bearings as tb
from taichi_bearings.scene import Scene
from tests.kernels.twins import is_driven, neighbours
from tests.scene.test_driving import STATES

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
solve = partial(tb.solve, threads=1)


def laboratory_minimum(scene):
    """Least Coulomb power: a cone programme over all three components of the spins as one sees them."""
    shape, radius = scene.lattice.shape, scene.lattice.radius
    free = [site for site in np.ndindex(*shape) if not is_driven(site, shape)]
    column = {(site, k): 3 * n + k for n, site in enumerate(free) for k in range(3)}
    spins, cones, cost = len(column), [], []
    for lower, upper, axis in neighbours(shape):
        if is_driven(lower, shape) and is_driven(upper, shape):
            continue
        cost.append(scene.normal_force * scene.coefficients[axis][lower])
        matrix, known = np.zeros((3, spins)), np.zeros(3)
        for site in (lower, upper):  # v = (w_i + w_j) x (R n), but for its sign
            for k in range(3):
                turned = np.cross(np.eye(3)[k], radius * np.eye(3)[axis])
                if is_driven(site, shape):
                    spin, *state = (-1) ** sum(site), *(scene.bottom if site[-1] == 0 else scene.top)
                    known += turned * spin * (state[k] + state[3] * 2 * radius * site[k])
                else:
                    matrix[:, column[site, k]] += turned
        cones.append((np.delete(matrix, axis, axis=0), np.delete(known, axis)))
    rows, right = [], []
    for number, (matrix, known) in enumerate(cones):
        bound = np.zeros((1, len(cones)))
        bound[0, number] = -1.0
        rows += [np.hstack([np.zeros((1, spins)), bound]), np.hstack([-matrix, np.zeros((2, len(cones)))])]
        right += [[0.0], known]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.tol_gap_rel, settings.tol_gap_abs, settings.tol_feas = False, 1e-11, 1e-11, 1e-11
    unknowns = spins + len(cones)
    found = clarabel.DefaultSolver(
        sparse.csc_matrix((unknowns, unknowns)), np.concatenate([np.zeros(spins), cost]),
        sparse.csc_matrix(np.vstack(rows)), np.concatenate(right), [clarabel.SecondOrderConeT(3)] * len(cones),
        settings,
    ).solve()  # fmt: skip
    return found.obj_val


@pytest.mark.parametrize("states", STATES[:4], ids=str)
def test_two_components_are_enough(states):
    """The third one, free in the cone programme, changes nothing."""
    scene = Scene.random((3, 4, 4), seed=8, **states)
    best = solve(scene)
    assert len(scene.minimum_spin_axes) == 2
    assert best.states_proven
    assert best.power == pytest.approx(laboratory_minimum(scene), rel=1e-8)
