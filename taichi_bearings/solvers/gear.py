"""Gear's predictor-corrector for first-order equations, and the largest time step that is stable with it, from the
stiffest mode of the lattice.

Coefficients: Allen and Tildesley, Computer Simulation of Liquids (1987), appendix E, table for first-order equations.
"""

from math import comb

import numpy as np
from scipy.sparse.linalg import eigsh

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.laplacian import eigenvalues
from taichi_bearings.numerics.graph_laplacian import graph_laplacian
from taichi_bearings.scene import Scene

# order -> corrector coefficients of the 0th ... order-th scaled derivative
GEAR_COEFFICIENTS = {
    2: (5 / 12, 1.0, 1 / 2),
    3: (3 / 8, 1.0, 3 / 4, 1 / 6),
    4: (251 / 720, 1.0, 11 / 12, 1 / 3, 1 / 24),
    5: (95 / 288, 1.0, 25 / 24, 35 / 72, 5 / 48, 1 / 120),
}
LARGEST_GROWTH = 1 + 1e-9
SOFTER_MODES = np.linspace(1.0, 0.02, 25)  # eigenvalues of the softer modes relative to the stiffest


def amplification(corrector: tuple[float, ...], decay: np.ndarray, oscillation: np.ndarray) -> np.ndarray:
    """Matrices (..., q + 3, q + 3) that carry one mode over one step.

    decay, oscillation : time step times the damping rate and (time step times the frequency) squared of the mode,
    i.e. h A R^2 lambda / I and h^2 K R^2 lambda / I for an eigenvalue lambda of the lattice Laplacian. The state is the
    scaled derivatives 0 ... q, the stretch (in units of radius * time step), and the last corrector error.
    """
    values = len(corrector)
    decay, oscillation = np.broadcast_arrays(np.asarray(decay, float), np.asarray(oscillation, float))
    pascal = np.array([[comb(n, k) for n in range(values)] for k in range(values)], dtype=float)
    size = values + 2
    identity = np.eye(size)
    predicted = pascal @ identity[:values]  # rows: predicted scaled derivatives, as functionals of the state
    mean = sum(identity[n] / (n + 1) for n in range(values)) + corrector[0] ** 2 * identity[size - 1]
    stretch = identity[values] + mean
    error = -(oscillation[..., None] * stretch + decay[..., None] * predicted[0] + predicted[1])
    matrix = np.empty((*decay.shape, size, size))
    for n in range(values):
        matrix[..., n, :] = predicted[n] + corrector[n] * error
    matrix[..., values, :] = stretch
    matrix[..., values + 1, :] = error
    return matrix


def largest_stable_step(order: int, decay_rate: float, frequency_squared: float) -> float:
    """Largest stable time step of all modes from the stiffest down, time.

    decay_rate, frequency_squared : A R^2 lambda / I and K R^2 lambda / I of the stiffest mode (largest lambda); softer
    modes share their ratio. One of them may be 0. No bound on the step: infinity.
    """
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
    """Largest |eigenvalue| over the modes, for each of `steps`."""
    h = steps[:, None]
    matrices = amplification(
        GEAR_COEFFICIENTS[order], h * decay_rate * SOFTER_MODES, h**2 * frequency_squared * SOFTER_MODES
    )
    return np.abs(np.linalg.eigvals(matrices)).max(axis=(1, 2))


def largest_laplacian_eigenvalue(lattice: Lattice, spin_axes: tuple[int, ...]) -> float:
    """Largest eigenvalue of the unweighted lattice Laplacian of any carried component, driven planes held (exact)."""
    return max(float(eigenvalues(lattice, component).max()) for component in spin_axes)


def largest_weighted_eigenvalue(scene: Scene, spin_axes: tuple[int, ...], held: np.ndarray | None = None) -> float:
    """Upper estimate of the largest eigenvalue of the Laplacian weighted by the viscosities, over all replicas.

    held : spheres (*N) whose spins are given; the driven ones if None. Lanczos to a relative 1e-3, raised by as much.
    """
    lattice, largest, viscosities = scene.lattice, 0.0, scene.viscosities
    if viscosities is None:
        return largest
    for felt in lattice.felt(spin_axes):
        for weights in viscosities:
            edges = [(*lattice.ends[:, felt], weights[felt])]
            matrix = graph_laplacian(edges, lattice.sites, (lattice.is_driven if held is None else held).ravel())
            if not matrix.count_nonzero():
                continue
            if matrix.shape[0] < 3:
                found = np.linalg.eigvalsh(matrix.toarray())
            else:
                start = np.cos(np.arange(matrix.shape[0]))  # fixed, so that the default time step is reproducible
                found = eigsh(matrix, k=1, tol=1e-3, v0=start, return_eigenvectors=False)
            largest = max(largest, float(found.max()))
    return largest * (1 + 1e-3)
