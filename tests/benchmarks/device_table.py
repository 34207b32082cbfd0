"""Agreement of every kernel on a device with the CPU in double precision.

Usage: python -m tests.benchmarks.device_table vulkan

One row for each method, law and dimension: relative difference of the power after 200 iterations from random spins, in
double and in single precision. What a device cannot do is left out, in words.
"""

import json
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.fields import Fields, make_layout
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers import CundallStrack, GradientDescent, OperatorSplitting, torque_balance
from tests.scenes import make_scene

METHODS = {
    "gradient-descent": GradientDescent(),
    "plain descent": GradientDescent(momentum=False),
    "cundall-strack": CundallStrack(),
    "with energy": CundallStrack(energy=True),
    "operator-splitting": OperatorSplitting(),
}
ITERATIONS = 200


def course(method: str, law: str, shape: tuple[int, ...], periodic: str = "") -> list[float]:
    """Powers of two samples after 200 iterations, on the device that runs; work and dissipation too, if kept."""
    scene = make_scene(shape, law, seeds=(1, 2), periodic=tuple(periodic))
    spin, solver = initial_spin(scene, "random"), METHODS[method].build()
    fields = Fields(make_layout(scene.replicas, shape, scene.lattice.periodic), solver.plan(scene, spin))
    with patch.object(torque_balance, "PRODUCT_TYPE", np.float64):  # as on a GPU
        solver.begin(scene, spin, fields)
    for _ in range(2):  # some change their course at a check
        solver.advance(ITERATIONS // 2)
        progress = solver.progress()
    books = [] if progress.energy is None else [progress.energy.injected, progress.energy.dissipated]
    return np.concatenate([progress.objective, *books]).tolist()


def courses(cases) -> list[list[float]]:
    return [course(*case) for case in cases]


def main(arch: str) -> None:
    cases = [
        (method, law, shape)
        for method in METHODS
        for law in ("coulomb", "viscous")
        for shape in ((30, 20), (10, 10, 10))
        if METHODS[method].solves(LAWS[law])
    ]
    found = {}
    for where, precision in (("cpu", "f64"), ("cpu", "f32"), (arch, "f64"), (arch, "f32")):
        code = (
            "import json, sys; from taichi_bearings import runtime; from tests.benchmarks.device_table import courses; "
            f"runtime.start({where!r}, {precision!r}); print(json.dumps(courses({cases!r})))"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parents[2]
        )
        found[where, precision] = json.loads(done.stdout) if done.returncode == 0 else None
        if done.returncode:
            print(f"{where} {precision}: {done.stderr.strip().splitlines()[-1]}")
    print(", ".join(device.name for device in runtime.usable(arch, "f32")) or "no such device")
    print(
        "| method | law | shape | " + " | ".join(f"{where} {precision}" for where, precision in list(found)[1:]) + " |"
    )
    print("|---|---|---|" + "---|" * (len(found) - 1))
    for number, (method, law, shape) in enumerate(cases):
        exact = found["cpu", "f64"][number]
        row = [
            "-" if powers is None else f"{max(abs(a / b - 1) for a, b in zip(powers[number], exact, strict=True)):.0e}"
            for key, powers in found.items()
            if key != ("cpu", "f64")
        ]
        print(f"| {method} | {law} | {'x'.join(map(str, shape))} | " + " | ".join(row) + " |")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "vulkan")
