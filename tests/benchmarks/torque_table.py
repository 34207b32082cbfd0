"""How torque goes through certified minima: python -m tests.benchmarks.torque_table

Mean and standard error over samples of the paper's scene, by the interior-point method. `--method` and `--tolerance`
choose another one, whose forces are another admissible choice: what is unique must not change.
"""

import argparse

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.analysis.network import network_of
from taichi_bearings.analysis.torque_flow import saturation, self_stress, torque_flow
from taichi_bearings.lattice.grid import staggered_forces
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS, InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene

SHARES = (0.1, 0.25, 0.5, 0.75, 0.9, 0.99)


def rows(scene, solution, exact):
    """What is measured in a sample, by name. exact : solution whose contact states count."""
    lattice, axes = scene.lattice, scene.minimum_spin_axes
    top = scene.top_spin(axes)
    force, state = staggered_forces(solution.friction, lattice, axes)[:, 0], exact.state[0]
    flow = torque_flow(lattice, force, state, top)
    load = saturation(force, scene.strength * scene.coefficient[0], state)
    stress = int(self_stress(network_of(lattice, state), axes).sum())
    still, moving = len(load), int((state == ContactState.SLIPPING).sum())
    unit = scene.strength * lattice.radius * np.prod(lattice.shape[:-1])
    found = {
        "slipless contacts, share": still / (still + moving),
        "torque of a component / (F_n R columns)": float(flow.total.mean()) / unit,
        "torques of the components, relative difference": float(np.ptp(flow.total) / flow.total.mean()),
        "deviation of the gaps": float(np.abs(flow.through_gap - flow.total[:, None]).max() / flow.total.max()),
        "torque through slipless contacts, share": flow.slipless_share,
        "the same, least and most loaded gap": (
            float((flow.slipless.sum(axis=0) / flow.through_gap.sum(axis=0)).min()),
            float((flow.slipless.sum(axis=0) / flow.through_gap.sum(axis=0)).max()),
        ),
        "mean saturation, slipless": float(load.mean()),
        **{f"saturation, quantile {share:g}": float(np.quantile(load, share)) for share in SHARES},
        "within 1 % of slipping, share": float((load >= 0.99).mean()),
        "within 0.1 % of slipping, share": float((load >= 0.999).mean()),
        "self-stress states": stress,
        "self-stress states a slipless contact": stress / still,
    }
    return {name: np.atleast_1d(value) for name, value in found.items()}


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--shape", default="10x10x10")
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--method", default="interior-point")
    options.add_argument("--tolerance", type=float, default=1e-10)
    options.add_argument("--threads", type=int, default=2)
    given = options.parse_args()
    runtime.start(threads=given.threads)
    shape = tuple(int(n) for n in given.shape.split("x"))
    samples = []
    for seed in range(given.seeds):
        scene = make_scene(shape, seeds=(seed,))
        start = initial_spin(scene, "linear")
        exact = solve(scene, InteriorPoint().build(), start, StopRule(1e-10))
        solution = exact
        if given.method != "interior-point":
            solution = solve(scene, METHODS[given.method]().build(), start, StopRule(given.tolerance))
        samples.append(rows(scene, solution, exact))
    print(f"| {given.shape}, {given.method}, {given.seeds} samples | mean | standard error |\n|---|---|---|")
    for name in samples[0]:
        values = np.stack([sample[name] for sample in samples])
        error = (
            values.std(axis=0, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.full(values[0].shape, np.nan)
        )
        mean, error = (", ".join(f"{v:.4g}" for v in part) for part in (values.mean(axis=0), error))
        print(f"| {name} | {mean} | {error} |", flush=True)


if __name__ == "__main__":
    main()
