"""One implicit Euler step of spheres under rigid friction or damping, solved as the minimum that it is.

    spins after = argmin P(spins) + I / (2 h) |spins - spins before|^2        (half of P for the viscous law)

The contact forces of the minimum are those that act during the step: I (after - before) = h R pull. For friction the
minimum lies at the end of the central path of the least power with the inertia of the spins added (central_path.py);
for damping it is one linear system. Both use one pattern, analysed once for all steps and samples.

A step works with spins above the bottom plane in a given unit, and with forces in units of the sample's mean
coefficient (times the normal force, or times radius and unit of spin for damping). One number is then left of inertia
and length of the step, q = I / (h R) in units of force over spin.
"""

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.central_path import Inertia, Iterate, balance, newton_step
from taichi_bearings.conic.contact_system import free_spins, lattice_system, place_free_spins
from taichi_bearings.conic.grouped import Arrays, each, isotropic
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import NotPositiveDefinite, dissect
from taichi_bearings.scene import Scene

SHARP = 1e-10  # excess of the cost over its dual, relative to the work done on inertia, at which a step is solved
CLOSEST = 1e-13  # or relative to the power, where double precision ends
ENOUGH, LAST_RESORT = 1e-3, 1e-9  # the same where the path cannot be followed to the end: with less a step has failed
BALANCED = 1e-13  # torque, of the mean friction, that may be left on a sphere
MOST_STEPS, PATIENCE = 60, 3  # Newton steps, and those in a row that gain nothing
REFINEMENTS = 5  # of a linear system, at most; two do


@dataclass(frozen=True)
class Step:
    """What a step of all samples comes to.

    staggered : (C, R, *N) spins at its end. force : during it, one array (T, R, *contacts) an axis.
    slipping : (R,) contacts that slip. creep : largest spin difference across one that does not.
    newton_steps : factorisations. solved : False if rounding ended the path too early.
    """

    staggered: np.ndarray
    force: tuple[np.ndarray, ...]
    slipping: np.ndarray
    creep: float
    newton_steps: int
    solved: bool


@dataclass
class _Answer:
    """A step of one sample in its own units: spins (unknowns,), difference and dual (d, n) a group."""

    spins: np.ndarray
    difference: Arrays
    dual: Arrays
    newton_steps: int = 0
    solved: bool = True


class ProximalSteps:
    """Steps of the samples of a scene in the spin components `spin_axes`; all others are at rest.

    unit : spin difference that is counted as one. inertia : moment of inertia of a sphere.
    """

    def __init__(self, scene: Scene, spin_axes: tuple[int, ...], unit: float, inertia: float) -> None:
        self.scene, self.spin_axes, self.unit = scene, spin_axes, unit
        self._system = lattice_system(scene.lattice, spin_axes, scene.driven_values(spin_axes)[1] / unit)
        self._matrix = NewtonMatrix(self._system, dissect(scene.lattice.free_shape, spin_axes))
        acting = [self._system.gather(scene.coefficient, replica) for replica in range(scene.replicas)]
        mean = np.array([np.concatenate([*coefficient]).mean() for coefficient in acting])
        self._coefficient = [coefficient / unit for coefficient, unit in zip(acting, mean, strict=True)]
        damping = scene.lattice.radius * unit if not scene.law.holds else 1.0
        self._force_unit = scene.strength * damping * mean
        self._slowness = inertia * unit / (scene.lattice.radius * self._force_unit)

    def step(self, staggered: np.ndarray, duration: float) -> Step:
        """The step of length `duration` from the spins (C, R, *N)."""
        scene = self.scene
        after = staggered.copy()
        force = scene.no_force(self.spin_axes)
        slipping, creep, newton_steps, solved = np.zeros(scene.replicas, dtype=int), 0.0, 0, True
        solve = self._damped if not scene.law.holds else self._rubbed
        for replica in range(scene.replicas):
            coefficient, before = self._coefficient[replica], free_spins(staggered / self.unit)[replica]
            answer = solve(coefficient, before, self._slowness[replica] / duration)
            self._put_spins(after, replica, answer.spins)
            self._system.scatter(-answer.dual * self._force_unit[replica], force, replica)
            slip = answer.difference.length()
            slips = slip > (0.0 if not scene.law.holds else 1 - answer.dual.length() / coefficient)
            slipping[replica] = int(slips.sum())
            creep = max(creep, self.unit * slip[~slips].max())
            newton_steps += answer.newton_steps
            solved &= answer.solved
        return Step(after, force, slipping, creep, newton_steps, solved)

    def _put_spins(self, staggered: np.ndarray, replica: int, spins: np.ndarray) -> None:
        """Write the spins of a sample. No contact moves the mean about the height of a layer: nor does rounding."""
        lattice = self.scene.lattice
        before = staggered[:, replica, ..., 1:-1].copy()
        place_free_spins(staggered, replica, self.unit * spins)
        if lattice.height_axis in self.spin_axes:
            slot = self.spin_axes.index(lattice.height_axis)
            new = staggered[slot, replica, ..., 1:-1]
            new -= (new - before[slot]).mean(axis=(0, 1))

    def _rubbed(self, friction: Arrays, before: np.ndarray, q: float) -> _Answer:
        """A step with friction: Newton steps from bounds well above the slips and no forces."""
        difference = self._system.differences(before)
        if not difference.any():
            return _Answer(before, difference, difference)
        slip = np.concatenate([*difference.length()])
        slack = float(np.sqrt(np.mean(slip**2)))
        iterate = replace(Iterate.start(self._system, before, friction, slack), inertia=Inertia(q, before))
        best, steps, patience = iterate, 0, PATIENCE
        with np.errstate(all="ignore"):  # where double precision ends, numbers that are not finite turn up
            try:
                while steps < MOST_STEPS and patience and not _excess(best) <= 1.0:
                    iterate = newton_step(iterate, self._matrix)
                    steps += 1
                    if iterate.excess < best.excess:
                        best, patience = iterate, PATIENCE
                    else:
                        patience -= 1
                if best.unbalanced > BALANCED:
                    balanced = balance(best, self._matrix)
                    best = balanced if balanced.unbalanced < best.unbalanced else best
            except NotPositiveDefinite:
                pass
        solved = _excess(best, ENOUGH, LAST_RESORT) <= 1.0
        return _Answer(best.spins, best.difference, best.dual, steps, solved)

    def _damped(self, damping: Arrays, before: np.ndarray, q: float) -> _Answer:
        """A step with damping: one linear system, refined as long as that helps."""
        inertia, none = Inertia(q, before), each(np.zeros_like, self._system.offset)
        self._matrix.factorise(isotropic(none, damping), q)
        spins, answer, last = before, _Answer(before, none, none), np.inf
        for _ in range(REFINEMENTS):
            difference = self._system.differences(spins)
            dual = -damping * difference
            left_over = self._system.torques(dual) - inertia.torques(spins)
            size = float(np.abs(left_over).max(initial=0.0))
            if size < last:
                answer = _Answer(spins, difference, dual, 1)
            if not size < last / 2:
                break
            spins, last = spins + self._matrix.solve(left_over), size
        return answer


def _excess(iterate: Iterate, sharp: float = SHARP, closest: float = CLOSEST) -> float:
    """Excess of the cost over its dual, relative to what is allowed."""
    assert iterate.inertia is not None
    moved = iterate.spins - iterate.inertia.origin
    return iterate.excess / max(sharp * iterate.inertia.weight * float(moved @ moved), closest * iterate.power)
