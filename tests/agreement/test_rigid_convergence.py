"""Cundall-Strack dynamics nears the rigid limit, which shares no code with it, in proportion to 1/A_t."""

from dataclasses import dataclass

import numpy as np
import pytest

from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack, RigidLimit
from taichi_bearings.solvers.cundall_strack import stability_bound
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("needs_f64")

FACTORS = (10.0, 100.0)
STIFFENED = {"K+A": (True, True), "K": (True, False), "A": (False, True)}


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

    def __init__(self, scene, start, relative_times):
        self.scene, self.spin = scene, initial_spin(scene, start)
        method = RigidLimit().build()
        method.begin(scene, self.spin)
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


def falls(comparison, limit, error, stiffened):
    """(T,) how much nearer the spins come for ten times the stiffened numbers (the power may cross its limit)."""
    far, near = (comparison.soft(factor, STIFFENED[stiffened], 0.4).distance(limit)[0] for factor in FACTORS)
    assert (near > 3 * error[0]).all(), (near, error)
    return far / near


def test_discs_turn_as_under_rigid_friction_but_for_a_creep_in_proportion_to_one_over_the_damping():
    comparison = Comparison(make_scene((3, 4), seeds=(0,)), "random", (0.3, 1.0))
    limit = comparison.rigid(0, tolerance=2e-5)
    for stiffened in ("K+A", "A"):
        assert falls(comparison, *limit, stiffened) == pytest.approx([10, 10], rel=0.2)
    assert (falls(comparison, *limit, "K") < 5).all()  # the creep stays


def test_spheres_from_the_minimum_cut_near_the_rigid_limit_between_the_root_and_the_first_power():
    comparison = Comparison(make_scene((2, 2, 3), seeds=(1,)), "minimum-cut", (0.3, 1.0))
    found = falls(comparison, *comparison.rigid(8), "K+A")
    assert ((found > 10**0.5) & (found < 13)).all(), found


def test_driven_discs_creep_by_what_the_spring_does_not_bear_over_the_damping():
    """Top 0.7, bottom 0.3 of the friction: the discs speed up until they turn with the top. From then on the upper
    contacts need to bear 0.3 F_n, but their springs still hold the 0.7 F_n of slipping, and give way in a time
    A / K = 10 only: until then the discs turn faster than the top, by 0.4 F_n / A."""
    height = np.empty((1, 2, 2))
    height[..., 0], height[..., 1] = 0.3, 0.7
    scene = Scene((np.full((1, 1, 3), 0.1), height))
    comparison = Comparison(scene, "linear", (4.0,))
    limit, _ = comparison.rigid(0, tolerance=1e-3)
    assert limit.spin == pytest.approx(np.ones_like(limit.spin), abs=1e-8)
    creep = 0.4 * scene.normal_force / 1e6 / scene.lattice.radius
    ahead = comparison.soft(1e3, STIFFENED["A"], 0.4).spin - 1
    assert ahead == pytest.approx(np.full_like(limit.spin, creep), rel=0.01)
