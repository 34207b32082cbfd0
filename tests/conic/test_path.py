"""Newton steps along the central path of a whole sample."""

import numpy as np
import pytest

from taichi_bearings.conic import central_path
from taichi_bearings.conic.central_path import Path
from taichi_bearings.conic.contact_system import lattice_system
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import dissect
from tests.scenes import make_scene


@pytest.mark.parametrize("seed", [4, 6])
def test_refining_a_step_whose_last_corrector_was_rejected_leaves_no_torques(monkeypatch, seed):
    monkeypatch.setattr(central_path, "STEP_TORQUE", 0.0)  # always refined
    monkeypatch.setattr(central_path, "LEAST_GAIN", 0.3)  # and correctors seldom good enough
    scene = make_scene((7, 8, 9), seeds=(seed,))
    system = lattice_system(scene.lattice, (0, 1), np.ones(2))
    path = Path(NewtonMatrix(system, dissect(scene.lattice, (0, 1))))
    friction = system.gather(scene.positive_coefficient, 0)
    path.put(0, Iterate.start(system, np.zeros(system.unknowns), friction, 0.1))
    for _ in range(14):
        assert path.step()[0]
    last = path.iterate(0)
    assert last.gap < 1e-4
    assert last.unbalanced < 1e-9
