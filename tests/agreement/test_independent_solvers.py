"""Agreement with methods that share no code: sparse linear algebra and linear programming."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from taichi_bearings.scene import Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack, GradientDescent
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.kernels.twins import incidence
from tests.scenes import make_scene


def viscous_minimum(scene):
    """Least viscous power: one sparse linear system for each spin component."""
    shape, total = scene.lattice.shape, 0.0
    matrix, where = incidence(shape)
    driven = scene.lattice.is_driven.ravel()
    eta = np.array([scene.coefficients[axis][0][site] for axis, site in where]) * scene.lattice.radius**2
    for slot, component in enumerate(scene.minimum_spin_axes):
        weight = eta * np.array([axis != component for axis, _ in where])
        laplacian = (matrix.T.multiply(weight) @ matrix).tocsr()
        omega = np.zeros(shape)
        omega[..., -1] = scene.top_spin(scene.minimum_spin_axes)[slot]
        omega = omega.ravel()
        right = -laplacian[~driven][:, driven] @ omega[driven]
        omega[~driven] = spsolve(laplacian[~driven][:, ~driven].tocsc(), right)
        total += omega @ (laplacian @ omega)
    return total


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("shape", [(9, 7), (4, 5, 6), (10, 10, 10)])
@pytest.mark.parametrize("momentum", [True, False])
def test_viscous_gradient_descent_equals_a_sparse_solve(shape, momentum):
    scene = make_scene(shape, "viscous")
    method = GradientDescent(momentum=momentum).build()
    solution = solve(scene, method, initial_spin(scene, "random"), StopRule(5e-11))
    assert solution.status is Status.CERTIFIED
    assert solution.power[0] == pytest.approx(viscous_minimum(scene), rel=1e-10)


@pytest.mark.parametrize(
    "driving",
    [{"spin_bottom": 0.7}, {"spin_bottom": -2.0}, {"direction": (1, 0, 0)}, {"direction": (1, -2, 3)}],
)  # fmt: skip
def test_other_drivings_are_certified_by_both_methods_alike(driving, precision):
    scene = make_scene((5, 4, 6), **driving)
    start = initial_spin(scene, "random")
    tolerance = 2e-4 if precision == "f64" else 5e-3  # what the rounding of the spins allows
    descent = solve(scene, GradientDescent().build(), start, StopRule(tolerance, 200_000))
    dynamics = solve(scene, CundallStrack().build(), start, StopRule(2e-3, 200_000))
    assert descent.status is dynamics.status is Status.CERTIFIED
    assert max(descent.lower_bound[0], dynamics.lower_bound[0]) <= min(descent.power[0], dynamics.power[0])
