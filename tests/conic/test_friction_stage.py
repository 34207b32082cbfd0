"""Spheres held by springs that friction limits, against a general minimiser."""

import numpy as np
import pytest
from scipy.optimize import minimize

from taichi_bearings.conic.contact_system import lattice_system
from taichi_bearings.conic.friction_stage import Friction, FrictionStage
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import dissect
from tests.scenes import make_scene


@pytest.mark.parametrize("inertia", [7.0, 0.07])  # by conjugate gradients, and by a factorisation
def test_a_stage_ends_at_the_minimum_of_its_function(inertia, needs_f64):
    """Of inertia |x - base|^2 / 2 + sum of huber(trial force) / resistance."""
    scene = make_scene((2, 2, 4), seeds=(9,))
    axes, radius = scene.minimum_spin_axes, scene.lattice.radius
    system = lattice_system(scene.lattice, axes, scene.top_spin(axes))
    limit = (scene.strength * scene.positive_coefficient[:, system.contact])[0]
    matrix = NewtonMatrix(system, dissect(scene.lattice, axes))
    rng = np.random.default_rng(1)
    base = rng.uniform(-1, 1, system.unknowns)
    start = rng.uniform(-20, 20, system.offset.shape)
    stage = FrictionStage(system, matrix, radius, 1.0, float(limit.max()))
    end = stage.solve(Friction(limit, np.full_like(limit, 80.0), inertia), base, start, base)
    assert (stage.factorisations > 0) == (inertia < 1)

    def function(x):
        size = np.linalg.norm(start + 80.0 * radius * system.differences(x), axis=0)
        huber = np.where(size > limit, limit * size - limit**2 / 2, size**2 / 2)
        return inertia / 2 * float((x - base) @ (x - base)) + float(huber.sum()) / 80.0

    general = minimize(function, base, method="BFGS", options={"gtol": 1e-6})
    assert function(end.spins) <= general.fun + 1e-9
    assert end.spins == pytest.approx(general.x, abs=1e-4)
    assert 0 < int(end.slips.sum()) < scene.lattice.contacts
