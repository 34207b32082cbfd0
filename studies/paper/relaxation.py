"""Samples followed in time by two dynamics, and the certified minima they should end at.

Rigid friction, without springs, is a steepest descent of the power F_n sum mu |v|. With the contacts of Cundall and
Strack it is not: one that holds by its spring and damper creeps at up to mu F_n / A_t, so a power that rigid friction
could only lower can rise by as much as this creep is worth.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import cut_of, initial_spin
from taichi_bearings.solvers import CundallStrack, InteriorPoint, RigidLimit
from taichi_bearings.solvers.drive import solve, uninterrupted
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule

from .samples import solved

STEPS = 1_000_000  # limit; most samples of 3x3x3 are certified within 100 000
END = 1e-8  # proven gap at which a relaxation has ended
RIGID_END = 1e-10  # the same without springs
TIMES = np.append(0.0, np.geomspace(1e-6, 1e2, 601))  # at which the power is written down
SAME = 1e-6  # relative difference up to which two powers count as the same


@dataclass(frozen=True)
class Run:
    """A relaxation of R samples: time (T,), power (T, R), staggered spins (3, R, *N) at both ends."""

    start: str
    time: np.ndarray
    power: np.ndarray
    first: np.ndarray
    last: np.ndarray

    @property
    def largest_rise(self) -> np.ndarray:
        """Height of the power above its lowest value before, at most, over the initial power, (R,)."""
        return np.asarray((self.power - np.minimum.accumulate(self.power)).max(axis=0) / self.power[0])


@dataclass(frozen=True)
class Minima:
    """Certified least powers and minimum-cut powers of R samples; all (R,) but the spins (R, *N, 3)."""

    power: np.ndarray
    lower_bound: np.ndarray
    cut_power: np.ndarray
    cut_bound: np.ndarray
    spin: np.ndarray

    @property
    def below_cut(self) -> np.ndarray:
        """True where some spins are proven to dissipate less than any two domains."""
        return self.power < self.cut_bound * (1 - SAME)

    @property
    def cut_is_minimum(self) -> np.ndarray:
        """True where no spins dissipate less than the minimum cut by more than SAME; proven."""
        return self.cut_power - self.lower_bound <= SAME * self.cut_power


def relax(
    scene: Scene, start: str, springs: CundallStrack | None = None, steps: int = STEPS, times: np.ndarray = TIMES
) -> Run:
    """Follow Cundall-Strack dynamics until every sample is certified to END, or for `steps` time steps.

    springs : the paper's by default. times : at which the power is written down.
    """
    method = (springs or CundallStrack()).build()
    return _followed(scene, start, method, StopRule(END, steps), Recording(history=times))


def relax_rigidly(scene: Scene, start: str) -> Run:
    """Follow the rigid limit until every sample is certified to RIGID_END; the power is written down at every step."""
    return _followed(scene, start, RigidLimit().build(), StopRule(RIGID_END), Recording())


def _followed(scene: Scene, start: str, method: Method, rule: StopRule, recording: Recording) -> Run:
    axes, spin = scene.lattice.all_spin_axes, initial_spin(scene, start)
    solution = uninterrupted(solve(scene, method, spin, rule, recording=recording))
    return Run(
        start=start,
        time=solution.history["time"],
        power=solution.history["power"],
        first=scene.staggered_spin(spin, axes),
        last=scene.staggered_spin(solution.spin, axes),
    )


def minima_of(scene: Scene) -> Minima:
    """Certified minima by the interior-point method, and the minimum cuts."""
    solution = solved(scene, InteriorPoint(settle=False), StopRule(1e-10))
    cut = cut_of(scene)
    unit = scene.normal_force * scene.lattice.radius * scene.jump
    return Minima(solution.power, solution.lower_bound, unit * cut.weight, unit * cut.lower_bound, solution.spin)


def without_idle_spin(staggered: np.ndarray) -> np.ndarray:
    """Staggered spins (3, R, nx, ny, nz) less the mean of each free layer about the height.

    That part makes no contact slip and never changes (equations.md, 3).
    """
    rest = staggered.copy()
    free = rest[2, ..., 1:-1]
    free -= free.mean(axis=(1, 2), keepdims=True)
    return rest


def intermediate_spheres(scene: Scene, spin: np.ndarray) -> np.ndarray:
    """Number (R,) of free spheres that turn neither with the bottom nor with the top, to 1e-3 of the jump."""
    axes = scene.minimum_spin_axes
    staggered = scene.staggered_spin(spin, axes)
    apart = [
        np.linalg.norm(np.moveaxis(staggered, 0, -1) - value, axis=-1) > 1e-3 * scene.jump
        for value in scene.driven_values(axes)
    ]
    return np.asarray((apart[0] & apart[1] & ~scene.lattice.is_driven).reshape(scene.replicas, -1).sum(axis=1))
