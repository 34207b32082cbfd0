"""How wrong a fixed time step of Gear's method makes the spins, from the modes of the lattice: no run is needed.

While contacts stick, every mode of the lattice answers a unit of spin by x = (p e^(p t) - q e^(q t)) / (p - q), p and q
being the roots of s^2 + A R^2 lambda / I s + K R^2 lambda / I = 0. In Gear's method the powers of two eigenvalues of
its amplification matrix stand for the exponentials. The error is the difference of the two, root mean square over the
modes, at the time when it is largest: an error of phase builds up for as long as the damping lets it.

A contact sticks only while it bears no more than its friction, so a mode turns by mu F_n / (R |A + K / p|) at most.
What contacts do that begin or cease to slip comes on top, and is not in this.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.solvers.gear import GEAR_COEFFICIENTS, amplification

SAMPLE_MODES = 32  # that stand for all of a lattice, and wave numbers that stand for all along one of its axes
TIMES_IN_STEPS = np.unique(np.round(np.geomspace(1, 1e12, 600)))  # in steps
ACCURATE_ERROR = 1e-2  # error up to which a step counts as accurate
LEAST_EIGENVALUE = 1e-9  # eigenvalue; that of a layer that turns about the height as a whole is 0
HALVINGS = 12  # of the step, in search of an accurate one


def laplacian_spectrum(lattice: Lattice, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Eigenvalues (SAMPLE_MODES,) of the unweighted lattice Laplacian, driven planes held: the middle ones of equal
    shares of those of all carried components."""
    found = []
    for component in spin_axes:
        total = np.zeros(1)
        for axis, side in enumerate(lattice.shape):
            first, last, parts = (1, side - 2, side - 1) if axis == lattice.height_axis else (0, side - 1, side)
            turn = 2 * np.pi if axis in lattice.periodic else np.pi
            wave = np.linspace(first, last, min(last - first + 1, SAMPLE_MODES))
            along = 2 - 2 * np.cos(turn * wave / parts) if axis != component else np.zeros(len(wave))
            total = np.add.outer(total, along).ravel()
        found.append(total)
    return np.maximum(
        np.quantile(np.concatenate(found), (np.arange(SAMPLE_MODES) + 0.5) / SAMPLE_MODES), LEAST_EIGENVALUE
    )


@dataclass(frozen=True)
class Modes:
    """Modes of sticking contacts, (M,) each.

    decay, oscillation : A R^2 lambda / I and K R^2 lambda / I, 1/time and 1/time^2. damping, stiffness : A and K.
    limit : mu F_n / R over the largest spin, force * time / length; infinite for contacts that bear anything.
    """

    decay: np.ndarray
    oscillation: np.ndarray
    damping: float
    stiffness: float
    limit: float

    @cached_property
    def roots(self) -> tuple[np.ndarray, np.ndarray]:
        """p and q, the faster one first; complex, 1/time. Equal ones are held apart by a relative 1e-6."""
        root = np.sqrt((self.decay**2 - 4 * self.oscillation).astype(complex))
        root = np.where(np.abs(root) < 1e-6 * self.decay, 1e-6 * self.decay, root)
        return -(self.decay + root) / 2, -(self.decay - root) / 2

    @cached_property
    def amplitude(self) -> np.ndarray:
        """Largest spin in each mode, relative to the largest of all."""
        resistance = np.abs(self.damping + self.stiffness / self.roots[0])
        return np.minimum(1.0, self.limit / np.maximum(resistance, np.finfo(float).tiny))

    def errors(self, order: int, time_step: float) -> np.ndarray:
        """Relative error of the spins within each of TIMES_IN_STEPS steps."""
        matrices = amplification(GEAR_COEFFICIENTS[order], time_step * self.decay, time_step**2 * self.oscillation)
        values, (p, q) = np.linalg.eigvals(matrices), self.roots
        error = np.zeros((len(p), len(TIMES_IN_STEPS)), dtype=complex)
        for root, other in ((p, q), (q, p)):
            exact = time_step * root
            nearest = np.abs(values - np.exp(exact)[:, None]).argmin(axis=1)
            found = np.log(values[np.arange(len(values)), nearest])
            found = np.minimum(found.real, 0.0) + 1j * found.imag
            powers = np.exp(found[:, None] * TIMES_IN_STEPS) - np.exp(exact[:, None] * TIMES_IN_STEPS)
            error += (root / (root - other))[:, None] * powers
        size = np.minimum(np.abs(error), 1.0) * self.amplitude[:, None]
        return np.maximum.accumulate(np.sqrt(np.mean(size**2, axis=0)))

    def error(self, order: int, time_step: float, steps: float) -> float:
        """Relative error of the spins in a course of so many steps."""
        reached = int(np.searchsorted(TIMES_IN_STEPS, steps, side="right"))
        return float(self.errors(order, time_step)[reached - 1]) if reached else 0.0

    def accurate_step(self, order: int, time_step: float, steps: int) -> float:
        """A time step, by some halvings, that keeps the error within ACCURATE_ERROR for as long as so many of these
        steps, or up to twice as long; NaN if there is none."""
        longest = 2.0 ** max(steps, 1).bit_length()
        for parts in 2.0 ** np.arange(HALVINGS + 1):
            if self.error(order, time_step / parts, longest * parts) <= ACCURATE_ERROR:
                return float(time_step / parts)
        return float("nan")
