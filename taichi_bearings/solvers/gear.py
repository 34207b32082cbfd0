"""Gear's predictor-corrector for first-order equations: its largest stable time step, and the error of a fixed step.

Both follow from the modes of the lattice, without a run. Coefficients: Allen and Tildesley, Computer Simulation of
Liquids (1987), appendix E, table for first-order equations.

Letters: h time step, I moment of inertia, R radius, K and A stiffness and damping of a contact, lambda eigenvalue of
the lattice Laplacian, q order of the method, M number of modes.

While contacts stick, a mode that starts with spin 1 has the spin x(t) = (a e^(a t) - b e^(b t)) / (a - b), where a and
b are the roots of s^2 + A R^2 lambda / I s + K R^2 lambda / I = 0. In Gear's method the exponentials over a step are
replaced by two eigenvalues of its amplification matrix. The error is the difference of the two solutions, root mean
square over the modes, at the time when it is largest: an error of phase grows until the damping has stopped the mode.

A contact sticks only while it bears no more than its friction. So the largest spin of a mode is mu F_n / (R |A + K /
a|). Contacts that begin or cease to slip cause further errors, which are not estimated here.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import comb

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.laplacian import eigenvalues
from taichi_bearings.numerics.blas import SPARSE
from taichi_bearings.numerics.graph_laplacian import graph_laplacian
from taichi_bearings.scene import Scene

# order -> corrector coefficients of the 0th ... order-th scaled derivative
GEAR_COEFFICIENTS = {
    2: (5 / 12, 1.0, 1 / 2),
    3: (3 / 8, 1.0, 3 / 4, 1 / 6),
    4: (251 / 720, 1.0, 11 / 12, 1 / 3, 1 / 24),
    5: (95 / 288, 1.0, 25 / 24, 35 / 72, 5 / 48, 1 / 120),
}
LARGEST_GROWTH = 1 + 1e-9  # largest modulus of an eigenvalue of the amplification matrix that counts as stable
SOFTER_MODES = np.linspace(1.0, 0.02, 25)  # eigenvalues of the softer modes relative to the stiffest
SAMPLE_MODES = 32  # modes by which all modes of a lattice are represented
TIMES_IN_STEPS = np.unique(np.round(np.geomspace(1, 1e12, 600)))  # times at which the error is computed, in steps
ACCURATE_ERROR = 1e-2  # error up to which a step counts as accurate
LEAST_EIGENVALUE = 1e-9  # replaces the eigenvalue 0 of a layer that rotates about the height as a whole
HALVINGS = 12  # how often a step is halved in search of an accurate one


def amplification(corrector: tuple[float, ...], decay: np.ndarray, oscillation: np.ndarray) -> np.ndarray:
    """Return the matrices (..., q + 3, q + 3) that carry the state of a mode over one step of Gear's method of order q.

    The state has the scaled derivatives 0 ... q of the spin (n-th time derivative times h^n / n!, time step h), the
    stretch of the spring (in units of radius * h), and the last corrector error.

    corrector : (q + 1) coefficients of the method.
    decay, oscillation : (...), damping rate of the mode times h, and its squared frequency times h^2: h A R^2 lambda /
        I and h^2 K R^2 lambda / I, with damping A and stiffness K of a contact, radius R, moment of inertia I and
        eigenvalue lambda.
    """
    values = len(corrector)
    decay, oscillation = np.broadcast_arrays(np.asarray(decay, float), np.asarray(oscillation, float))
    pascal = np.array([[comb(n, k) for n in range(values)] for k in range(values)], dtype=float)
    size = values + 2
    # linear functions of the state as rows: the Taylor series one step on (Pascal's triangle); the mean spin of the
    # step, corrected by the last error, by which the spring is stretched
    identity = np.eye(size)
    predicted = pascal @ identity[:values]
    mean = sum(identity[n] / (n + 1) for n in range(values)) + corrector[0] ** 2 * identity[size - 1]
    stretch = identity[values] + mean
    # what the predicted state lacks in the equation of motion; the corrector adds its coefficients times this error
    error = -(oscillation[..., None] * stretch + decay[..., None] * predicted[0] + predicted[1])
    matrix = np.empty((*decay.shape, size, size))
    for n in range(values):
        matrix[..., n, :] = predicted[n] + corrector[n] * error
    matrix[..., values, :] = stretch
    matrix[..., values + 1, :] = error
    return matrix


@lru_cache(maxsize=1000)  # samples of one network mostly have the same rates
def largest_stable_step(order: int, decay_rate: float, frequency_squared: float) -> float:
    """Return the largest time step at which the stiffest mode and all softer modes are stable; infinity if any step is.

    order : order of Gear's method.
    decay_rate, frequency_squared : decay rate and frequency squared of the stiffest mode, 1/time and 1/time^2: A R^2
        lambda / I and K R^2 lambda / I, with damping A and stiffness K of a contact, radius R, moment of inertia I, and
        largest eigenvalue lambda. Softer modes have the same ratio of the two. Either may be 0.
    """
    # first the step is bracketed on a grid, then the bracket is halved 40 times
    rates = [r for r in (decay_rate, np.sqrt(frequency_squared)) if r > 0]
    if not rates:
        return np.inf
    steps = np.geomspace(1e-3, 20.0, 400) / max(rates)
    radius = _spectral_radius(order, decay_rate, frequency_squared, steps)
    unstable = np.flatnonzero(radius > LARGEST_GROWTH)
    if len(unstable) == 0:
        return float(steps[-1])
    if unstable[0] == 0:
        return 0.0
    low, high = steps[unstable[0] - 1], steps[unstable[0]]
    for _ in range(40):
        middle = (low + high) / 2
        if _spectral_radius(order, decay_rate, frequency_squared, np.array([middle]))[0] > LARGEST_GROWTH:
            high = middle
        else:
            low = middle
    return float(low)


def _spectral_radius(order: int, decay_rate: float, frequency_squared: float, steps: np.ndarray) -> np.ndarray:
    """Return for each time step, (steps,), the largest modulus of an eigenvalue of the amplification matrices of the
    stiffest mode and of softer ones. Time steps are stable where it is at most 1.

    order : order of Gear's method.
    decay_rate, frequency_squared : damping rate, 1/time, and squared frequency, 1/time^2, of the stiffest mode; the
        softer modes have SOFTER_MODES times both.
    steps : (steps,), time steps.
    """
    h = steps[:, None]
    matrices = amplification(
        GEAR_COEFFICIENTS[order], h * decay_rate * SOFTER_MODES, h**2 * frequency_squared * SOFTER_MODES
    )
    found: np.ndarray = np.abs(np.linalg.eigvals(matrices)).max(axis=(1, 2))
    return found


def largest_laplacian_eigenvalue(lattice: Lattice, spin_axes: tuple[int, ...]) -> float:
    """Return the exact largest eigenvalue of the lattice Laplacian with all weights 1, driven spheres held, over the
    computed spin components.

    spin_axes : numbers of the axes of the spin components that are computed.
    """
    return max(float(eigenvalues(lattice, component).max()) for component in spin_axes)


def largest_weighted_eigenvalue(scene: Scene, spin_axes: tuple[int, ...], slopes: np.ndarray | None) -> float:
    """Return an upper estimate of the largest eigenvalue of the Laplacians of a lattice weighted by the slopes of the
    forces over the slips, over all samples and spin components; 0 for friction alone.

    It is found by Lanczos' method to a relative error of 1e-3, and raised by this error.

    scene : the lattice.
    spin_axes : numbers of the axes of the spin components that are computed.
    slopes : (R samples, E contacts), largest slope of each contact, such as its viscosity, force * time/length; None
        for friction alone.
    """
    lattice, largest = scene.lattice, 0.0
    if slopes is None:
        return largest
    for couples in lattice.tangential_mask(spin_axes):
        for weights in slopes:
            edges = [(*lattice.ends[:, couples], weights[couples])]
            matrix = graph_laplacian(edges, lattice.sites, lattice.is_driven.ravel())
            if not matrix.count_nonzero():
                continue
            if matrix.shape[0] < 3:
                found = np.linalg.eigvalsh(matrix.toarray())
            else:
                start = np.cos(np.arange(matrix.shape[0]))  # fixed, so that the default time step is reproducible
                found = SPARSE.eigsh(matrix, k=1, tol=1e-3, v0=start, return_eigenvectors=False)
            largest = max(largest, float(found.max()))
    return largest * (1 + 1e-3)


def laplacian_spectrum(lattice: Lattice, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Return eigenvalues (SAMPLE_MODES,) that stand for all those of the lattice Laplacian with weights 1 and driven
    spheres held.

    All eigenvalues of the computed spin components are sorted and split into SAMPLE_MODES equal groups; the median of
    each group is returned. An eigenvalue 0 is replaced by LEAST_EIGENVALUE.

    spin_axes : numbers of the axes of the spin components.
    """
    found = [np.broadcast_to(eigenvalues(lattice, component), lattice.free_shape) for component in spin_axes]
    result: np.ndarray = np.maximum(
        np.quantile(found, (np.arange(SAMPLE_MODES) + 0.5) / SAMPLE_MODES), LEAST_EIGENVALUE
    )
    return result


@dataclass(frozen=True)
class Modes:
    """M modes of a lattice whose contacts stick, and the errors that Gear's method makes in them.

    A contact has damping A and stiffness K; R is the radius, I the moment of inertia, lambda the eigenvalue of a mode.

    decay : (M,), A R^2 lambda / I, 1/time.
    oscillation : (M,), K R^2 lambda / I, 1/time^2.
    damping, stiffness : A and K.
    limit : friction limit mu F_n of a contact over R and over the largest spin, force * time / length; infinite for
        contacts without a friction limit.
    """

    decay: np.ndarray
    oscillation: np.ndarray
    damping: float
    stiffness: float
    limit: float

    @cached_property
    def roots(self) -> tuple[np.ndarray, np.ndarray]:
        """The two complex rates, (modes M,) each, 1/time, the faster one first.

        They are the roots s of s^2 + decay s + oscillation = 0; a double root is split by a relative 1e-6, so that
        solutions can be divided by the difference of the roots.
        """
        root = np.sqrt((self.decay**2 - 4 * self.oscillation).astype(complex))
        root = np.where(np.abs(root) < 1e-6 * self.decay, 1e-6 * self.decay, root)
        return -(self.decay + root) / 2, -(self.decay - root) / 2

    @cached_property
    def amplitude(self) -> np.ndarray:
        """(modes M,), the largest spin that a mode can have while its contacts stick, divided by the largest spin of
        all modes; at most 1."""
        resistance = np.abs(self.damping + self.stiffness / self.roots[0])
        return np.minimum(1.0, self.limit / np.maximum(resistance, np.finfo(float).tiny))

    def errors(self, order: int, time_step: float) -> np.ndarray:
        """Return the relative error of the spins in runs of 1 ... 1e12 steps (as many as TIMES_IN_STEPS has numbers):
        for each run the largest error on the way.

        The error is the difference between the exact decay of the modes and that by Gear's method, root mean square
        over the modes.

        order : order of Gear's method.
        time_step : length of its steps, time.
        """
        matrices = amplification(GEAR_COEFFICIENTS[order], time_step * self.decay, time_step**2 * self.oscillation)
        values, (a, b) = np.linalg.eigvals(matrices), self.roots
        error = np.zeros((len(a), len(TIMES_IN_STEPS)), dtype=complex)
        for root, other in ((a, b), (b, a)):
            # the eigenvalue of the amplification matrix that stands for exp(h p); growth by rounding is cut off
            exact = time_step * root
            nearest = np.abs(values - np.exp(exact)[:, None]).argmin(axis=1)
            found = np.log(values[np.arange(len(values)), nearest])
            found = np.minimum(found.real, 0.0) + 1j * found.imag
            powers = np.exp(found[:, None] * TIMES_IN_STEPS) - np.exp(exact[:, None] * TIMES_IN_STEPS)
            error += (root / (root - other))[:, None] * powers
        # no spin is wrong by more than itself; the error of a run is the largest on the way
        size = np.minimum(np.abs(error), 1.0) * self.amplitude[:, None]
        return np.maximum.accumulate(np.sqrt(np.mean(size**2, axis=0)))

    def error(self, order: int, time_step: float, steps: float) -> float:
        """Return the largest relative error of the spins on the way through a run; 0 for a run of less than one step.
        The errors are those that :meth:`errors` returns for the numbers of steps in TIMES_IN_STEPS (1, 2, ... 1e12), up
        to the length of the run.

        order : order of Gear's method.
        time_step : length of its steps, time.
        steps : length of the run in steps, which need not be a whole number.
        """
        reached = int(np.searchsorted(TIMES_IN_STEPS, steps, side="right"))
        return float(self.errors(order, time_step)[reached - 1]) if reached else 0.0

    def accurate_step(self, order: int, time_step: float, steps: int) -> float:
        """Return a time step, time, with which the error of a run stays within ACCURATE_ERROR: `time_step`, or the
        largest of its halves, quarters, ... that suffices; NaN if HALVINGS halvings are not enough.

        The error is that of a run of up to twice the length, the next power of two of steps.

        order : order of Gear's method.
        time_step, steps : the run: its time step, time, and how many steps it has.
        """
        longest = 2.0 ** max(steps, 1).bit_length()
        for parts in 2.0 ** np.arange(HALVINGS + 1):
            if self.error(order, time_step / parts, longest * parts) <= ACCURATE_ERROR:
                return float(time_step / parts)
        return float("nan")
