"""How Cundall-Strack dynamics nears the rigid limit as contacts stiffen: python -m tests.benchmarks.rigid_convergence

The paper's stiffness K and damping A are multiplied by growing factors, both together and each alone, and the motion is
compared with the rigid limit at fixed times of the transient: the root mean square distance of the free spins over the
largest spin, and the relative difference of the power. Both motions are resolved in time: the rigid limit as said at
`Comparison.rigid`, Gear's method by steps of a quarter of `--share` of its stability bound. Coarser steps of both tell
their errors; distances that are not three times as large are in brackets and left out of the fits.
"""

import argparse
import json
from dataclasses import dataclass

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.solvers import CundallStrack, RigidLimit
from taichi_bearings.solvers.cundall_strack import stability_bound
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene

TIMES = (0.1, 0.3, 1.0, 3.0)  # relaxation times of the rigid limit
STIFFENED = {"K+A": (True, True), "K": (True, False), "A": (False, True)}
RESOLVED = 3.0  # times its own error that a distance must be to count


@dataclass(frozen=True)
class Course:
    """Free spins (T, ...) and power (T,) at the times asked for."""

    spin: np.ndarray
    power: np.ndarray

    def distance(self, other):
        """(2, T): root mean square of the spins apart, and the relative difference of the power, without sign."""
        apart = (self.spin - other.spin).reshape(len(self.spin), -1)
        return np.stack([np.sqrt((apart**2).mean(axis=1)), np.abs(self.power / other.power - 1)])


class Comparison:
    """One scene from one start, one sample."""

    def __init__(self, scene, start, relative_times=TIMES):
        self.scene, self.spin = scene, initial_spin(scene, start)
        method = RigidLimit().build()
        method.plan(scene, self.spin)
        method.begin(scene, self.spin, None)
        self.axes, self.largest = method.spin_axes, method.largest
        self.times = np.array(relative_times) * method.relaxation_time

    def course(self, method):
        rule = StopRule(1e-15, iterations=2**62, duration=float(self.times[-1]))
        recording = Recording(history=self.times, snapshots=self.times)
        solution = solve(self.scene, method, self.spin, rule, recording=recording)
        assert np.allclose(solution.snapshots.time, self.times, rtol=1e-2), solution.snapshots.time
        free = ~self.scene.lattice.is_driven
        spins = [self.scene.staggered_spin(spin, self.axes)[..., free] for spin in solution.snapshots.spin]
        return Course(np.array(spins) / self.largest, solution.history["power"][: len(self.times), 0])

    def rigid(self, steps, tolerance=1e-8):
        """The rigid limit and (2, T) its error.

        steps : of the finest of the fixed lengths, until the first time. tolerance : of the error of an adapted step.

        With one component the motion is piecewise linear, and a step exact until a contact begins or ceases to slip:
        there the step is adapted. With more it is smooth most of the time, and two fixed lengths extrapolate to none.
        """
        if len(self.axes) == 1:
            fine, coarse = (self.course(RigidLimit(error_tolerance=e).build()) for e in (tolerance, 10 * tolerance))
            return fine, fine.distance(coarse)
        coarse, middle, fine = (
            self.course(RigidLimit(time_step=self.times[0] / n).build()) for n in (steps // 4, steps // 2, steps)
        )
        limit = Course(2 * fine.spin - middle.spin, 2 * fine.power - middle.power)
        before = Course(2 * middle.spin - coarse.spin, 2 * middle.power - coarse.power)
        return limit, limit.distance(before)

    def soft(self, factor, stiffened, share):
        """Cundall-Strack dynamics with K and A, or one of them, `factor` times the paper's."""
        stiffness, damping = (
            value * (factor if grows else 1) for value, grows in zip((1e5, 1e3), stiffened, strict=True)
        )
        bound = stability_bound(self.scene, self.axes, CundallStrack(stiffness=stiffness, damping=damping))
        # steps divide the first time, so that they end on it
        step = self.times[0] / np.ceil(self.times[0] / (share * bound))
        return self.course(CundallStrack(stiffness=stiffness, damping=damping, time_step=step).build())


def slope(factors, distances, counts):
    """Exponent of the power law beyond the paper's own contacts; None where fewer than two distances count."""
    factors = np.array(factors)
    fitted = counts & (factors > 1)
    if fitted.sum() < 2:
        return None
    return float(np.polyfit(np.log(factors[fitted]), np.log(distances[fitted]), 1)[0])


def measure(scene, start, chosen, factors, steps, share):
    """One dict a choice of what is stiffened: distances and whether they count, (2, factors, T), and slopes (2, T)."""
    comparison = Comparison(scene, start)
    limit, rigid_error = comparison.rigid(steps)
    for name in chosen:
        distances, errors = [], []
        for factor in factors:
            finer, coarser = (comparison.soft(factor, STIFFENED[name], s) for s in (share / 4, share))
            distances.append(finer.distance(limit))
            errors.append(rigid_error + finer.distance(coarser) / 3)
        distance, counts = (
            np.stack(distances, axis=1),
            np.stack(distances, axis=1) > RESOLVED * np.stack(errors, axis=1),
        )
        slopes = [[slope(factors, distance[q, :, t], counts[q, :, t]) for t in range(len(TIMES))] for q in range(2)]
        yield {
            "shape": scene.lattice.shape,
            "seed": scene.seeds[0],
            "start": start,
            "stiffened": name,
            "factors": factors,
            "times": TIMES,
            "distance": distance.tolist(),
            "counts": counts.tolist(),
            "slope": slopes,
            "rigid_error": rigid_error.tolist(),
        }


def rows(found):
    """Markdown: a row for each factor with spins and power at each time, then the slopes."""
    where = f"{'x'.join(map(str, found['shape']))}, {found['start']}"
    distance, counts = np.array(found["distance"]), np.array(found["counts"])
    for f, factor in enumerate(found["factors"]):
        cells = [
            f"{distance[q, f, t]:.1e}" if counts[q, f, t] else f"({distance[q, f, t]:.1e})"
            for q in range(2)
            for t in range(len(TIMES))
        ]
        yield f"| {where} | {found['stiffened']} | {factor:g} | {' | '.join(cells)} |"
    cells = ["" if value is None else f"{value:.2f}" for quantity in found["slope"] for value in quantity]
    yield f"| | | slope | {' | '.join(cells)} |"


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--shape", default="4x5,3x3x3,5x5x5")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--start", default="random,minimum-cut", help=f"of {', '.join(STARTS)}")
    options.add_argument("--stiffened", default=",".join(STIFFENED), help="what grows")
    options.add_argument("--factors", default="1,10,100,1000")
    options.add_argument(
        "--steps", type=int, default=40, help="of the rigid limit until a tenth of its relaxation time"
    )
    options.add_argument("--share", type=float, default=0.8, help="of the stability bound, for the coarser soft course")
    options.add_argument("--json", action="store_true", help="one JSON object a line")
    given = options.parse_args()
    runtime.start(threads=1)
    factors = [float(word) for word in given.factors.split(",")]
    if not given.json:
        heads = [f"{what} at {t:g}" for what in ("spins", "power") for t in TIMES]
        print("\n".join([f"| scene, start | times s | s | {' | '.join(heads)} |", "|---" * (3 + len(heads)) + "|"]))
    for shape in given.shape.split(","):
        scene = make_scene(tuple(int(n) for n in shape.split("x")), seeds=(given.seed,))
        for start in given.start.split(","):
            for found in measure(scene, start, given.stiffened.split(","), factors, given.steps, given.share):
                print(json.dumps(found) if given.json else "\n".join(rows(found)), flush=True)


if __name__ == "__main__":
    main()
