"""What the paper's stiffness, damping and normal force change, as a table: python -m tests.benchmarks.stiffness_table

Cundall-Strack dynamics to a proven gap of `--tolerance`, with the paper's K = 1e5, A = 1e3, F_n = 50 and with ten times
larger and smaller ones, one at a time and all together. The power in units of F_n R omega_T is to be the same minimum.
"""

import argparse
from dataclasses import dataclass, replace

from taichi_bearings import runtime
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.solvers import CundallStrack, ImplicitCundallStrack, InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene


@dataclass(frozen=True)
class Material:
    """K, force / length; A, force * time / length; F_n, force."""

    stiffness: float = 1e5
    damping: float = 1e3
    normal_force: float = 50.0


def materials():
    """The paper's, then each number times 10 and 1/10, then all of them."""
    paper = Material()
    yield paper
    for names in (("stiffness",), ("damping",), ("normal_force",), ("stiffness", "damping", "normal_force")):
        for factor in (10.0, 0.1):
            yield replace(paper, **{name: factor * getattr(paper, name) for name in names})


def table(shape, stop, start, integrator):
    print(f"\n{'x'.join(map(str, shape))}, from {start} spins, {integrator}, to a proven {stop.tolerance:g}\n")
    print("| K | A | F_n | P - P_min | proven gap | simulated time | steps | status | seconds |")
    print("|---|---|---|---|---|---|---|---|---|")
    scene = make_scene(shape, seeds=(0,))
    unit = scene.lattice.radius * scene.jump
    exact = solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-11))
    least = exact.power[0] / (scene.normal_force * unit)
    for material in materials():
        scene = make_scene(shape, seeds=(0,), normal_force=material.normal_force)
        row = CundallStrack if integrator == "gear" else ImplicitCundallStrack
        method = row(stiffness=material.stiffness, damping=material.damping).build()
        found = solve(scene, method, initial_spin(scene, start), stop)
        above = found.power[0] / (material.normal_force * unit) - least
        print(
            f"| {material.stiffness:g} | {material.damping:g} | {material.normal_force:g} | {above:.1e} "
            f"| {found.gap[0]:.1e} | {found.history['time'][-1]:.3g} | {found.iterations:.2e} | {found.status.value} "
            f"| {found.seconds:.1f} |",
            flush=True,
        )
    print(f"\nP_min = {least:.12g} F_n R omega_T, proven within {exact.gap[0]:.1e} of it")


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--shapes", default="3x3x3,10x10x10")
    options.add_argument("--tolerance", type=float, default=1e-5)
    options.add_argument("--start", choices=STARTS, default="random")
    options.add_argument("--integrator", choices=("gear", "implicit"), default="gear")
    options.add_argument("--time-limit", type=float, default=60.0, help="seconds for each run")
    given = options.parse_args()
    runtime.start(threads=1)  # a team could stop to compile another kernel, in the middle of a run
    for shape in given.shapes.split(","):
        table(
            tuple(int(n) for n in shape.split("x")),
            StopRule(given.tolerance, 100_000_000, given.time_limit),
            given.start,
            given.integrator,
        )


if __name__ == "__main__":
    main()
