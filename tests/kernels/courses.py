"""Courses of every method with kernels, to be compared between devices and precisions."""

from unittest.mock import patch

import numpy as np

from taichi_bearings import Packing, runtime, solve
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack, GradientDescent, OperatorSplitting, torque_balance
from tests.scenes import make_scene

METHODS = {
    "gradient-descent": GradientDescent(),
    "plain descent": GradientDescent(momentum=False),
    "cundall-strack": CundallStrack(),
    "with energy": CundallStrack(energy=True),
    "operator-splitting": OperatorSplitting(),
}
PACKINGS = {"descent of a packing": "gradient-descent", "steps of a packing": "cundall-strack"}
ITERATIONS = 200


def course(method: str, law: str, shape: tuple[int, ...], periodic: str = "") -> list[float]:
    """Powers of two samples after 200 iterations, on the device that runs, with work and dissipation if these are kept;
    power and lower bound of a packing."""
    if method in PACKINGS:
        now = runtime.current()
        device = {"arch": now.arch, "precision": now.precision, "threads": now.threads}
        packing = Packing.lattice("bcc", shape, law=law)
        found = solve(packing, PACKINGS[method], iterations=ITERATIONS, progress=False, **device)
        return [found.power, found.lower_bound]
    scene = make_scene(shape, law, seeds=(1, 2), periodic=tuple(periodic))
    spin, solver = initial_spin(scene, "random"), METHODS[method].build()
    with patch.object(torque_balance, "PRODUCT_TYPE", np.float64):  # as on a GPU
        solver.begin(scene, spin)
    for _ in range(2):  # some change their course at a check
        solver.advance(ITERATIONS // 2)
        progress = solver.progress()
    books = [] if progress.energy is None else [progress.energy.injected, progress.energy.dissipated]
    return np.concatenate([progress.objective, *books]).tolist()


def courses(cases) -> list[list[float]]:
    return [course(*case) for case in cases]
