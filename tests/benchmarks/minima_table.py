"""Both methods against the exact minima, from all starts, as a table: python -m tests.benchmarks.minima_table"""

import sys

from taichi_bearings import runtime
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.solvers import CundallStrack, GradientDescent
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import minima, name_of, scene_of

RUNS = {
    "gradient-descent": (GradientDescent(), StopRule(1e-6, 2_000_000)),
    "without momentum": (GradientDescent(momentum=False), StopRule(1e-4, 2_000_000)),
    "cundall-strack": (CundallStrack(), StopRule(1e-6, 2_000_000)),
}


def main(shapes: list[tuple[int, ...]]) -> None:
    runtime.start()
    print("| scene | method | start | status | iterations | P above the minimum | proven gap | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    for entry in minima(*shapes):
        for name, (method, stop) in RUNS.items():
            for start in STARTS:
                scene = scene_of(entry)
                solution = solve(scene, method.build(), initial_spin(scene, start), stop)
                above = solution.power[0] / entry["power_minimum"] - 1
                assert solution.lower_bound[0] <= entry["power_minimum"] * (1 + 1e-12)
                print(
                    f"| {name_of(entry)} | {name} | {start} | {solution.status.value} | {solution.iterations:,} "
                    f"| {above:.1e} | {solution.gap[0]:.1e} | {solution.seconds:.2f} |"
                )


if __name__ == "__main__":
    given = [tuple(int(n) for n in word.split("x")) for word in sys.argv[1:]]
    main(given or [(10, 10), (3, 3, 3), (10, 10, 10)])
