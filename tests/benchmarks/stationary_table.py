"""Where each dynamics comes to rest, beside the certified minimum: python -m tests.benchmarks.stationary_table

Random spins (or `--start`) to a proven gap of `--tolerance`, by Gear's method, the implicit integrator and the rigid
limit. The minimum is the interior-point method's, which shares with them the certificate only.
"""

import argparse

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.solvers import CundallStrack, ImplicitCundallStrack, InteriorPoint, RigidLimit
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import UNLIMITED, StopRule
from tests.scenes import make_scene

INTEGRATORS = ("gear", "implicit", "rigid-limit")


def method_named(name, stiffer, error_tolerance):
    """A new method of this name, with the paper's stiffness and damping times `stiffer`."""
    if name == "rigid-limit":
        return RigidLimit(error_tolerance=error_tolerance).build()
    integrator = CundallStrack if name == "gear" else ImplicitCundallStrack
    options = {"stiffness": 1e5 * stiffer, "damping": 1e3 * stiffer}
    chosen = {"energy": True} if name == "gear" else {"error_tolerance": error_tolerance}
    return integrator(**options, **chosen).build()


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--shape", default="10x10x10")
    options.add_argument("--seeds", type=int, default=5)
    options.add_argument("--integrators", default=",".join(INTEGRATORS))
    options.add_argument("--tolerance", type=float, default=1e-9)
    options.add_argument("--stiffer", type=float, default=1.0, help="factor on K and A")
    options.add_argument("--error-tolerance", type=float, default=1e-2)
    options.add_argument("--start", choices=STARTS, default="random")
    options.add_argument("--time-limit", type=float, default=120.0, help="seconds for each run")
    options.add_argument("--threads", type=int, default=1)
    given = options.parse_args()
    runtime.start(threads=given.threads)
    shape = tuple(int(n) for n in given.shape.split("x"))
    stop = StopRule(given.tolerance, UNLIMITED, given.time_limit)
    print("| seed | integrator | P / P_min - 1 | proven gap | slips apart | time | steps | energy | status | s |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for seed in range(given.seeds):
        scene = make_scene(shape, seeds=(seed,))
        exact = solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-11))
        for name in given.integrators.split(","):
            method = method_named(name, given.stiffer, given.error_tolerance)
            found = solve(scene, method, initial_spin(scene, given.start), stop)
            apart = np.abs(found.slip - exact.slip).max()
            print(
                f"| {seed} | {name} | {found.power[0] / exact.power[0] - 1:.1e} | {found.gap[0]:.1e} "
                f"| {apart / (scene.lattice.radius * scene.jump):.1e} | {found.history['time'][-1]:.3g} "
                f"| {found.iterations} | {abs(found.history['energy_residual'][-1][0]):.0e} | {found.status.value} "
                f"| {found.seconds:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
