"""Current-flow betweenness: how much of a unit current from bottom to top each link and each sphere carries.

Every slipless contact is a unit conductance and each driven plane one electrode. Current takes all ways at once, the
short ones more, where shortest paths know only themselves (Newman, Social Networks 27, 39, 2005, with one source and
one sink). A link that parts bottom from top carries 1, dangling ends carry nothing.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import LinearOperator, cg

from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.numerics.graph_laplacian import factorised, graph_laplacian

DENSE = 4.5  # links a sphere from which the factor grows too large and conjugate gradients need few steps
ITERATION_TOLERANCE = 1e-13  # of the residual, relative to the current that flows in
MOST_REFINEMENTS = 6  # solutions of the residual equation, each good to 1e-5


@dataclass(frozen=True)
class CurrentFlow:
    """Load of each link (E,) and each sphere (sites,) by a current of 1 from bottom to top; 0 if they are apart.

    link : amount of the current through it. sphere : what flows into it, and out again.
    resistance : between the planes, in units of one contact's; infinite if they are apart.
    residual : largest current that appears from nowhere at a sphere.
    """

    link: np.ndarray
    sphere: np.ndarray
    resistance: float
    residual: float


def current_flow(network: SliplessNetwork, links: np.ndarray) -> CurrentFlow:
    """The current through one sample; links : (E,) bool, those that can carry current (the backbone)."""
    link, sphere = np.zeros(len(network.axis)), np.zeros(network.lattice.sites)
    if not links.any():
        return CurrentFlow(link, sphere, np.inf, 0.0)
    low, high = network.body[network.ends[:, links]]
    voltage = _voltages(low, high, network.bodies)
    current = voltage[low] - voltage[high]
    balance = np.bincount(low, current, network.bodies) - np.bincount(high, current, network.bodies)
    total = balance[0]
    link[links] = np.abs(current) / total
    passing = sum(np.bincount(end, link, network.lattice.sites) for end in network.ends)
    sphere = np.where(network.lattice.is_driven.ravel(), passing, passing / 2)
    return CurrentFlow(link, sphere, float(1 / total), float(np.abs(balance[1:-1]).max() / total))


def _voltages(low: np.ndarray, high: np.ndarray, bodies: int) -> np.ndarray:
    """Voltage of each body, 1 at the first one and 0 at the last one; also 0 where no link leads."""
    degree = np.bincount(low, minlength=bodies) + np.bincount(high, minlength=bodies)
    inner = np.flatnonzero(degree[1:-1]) + 1
    held = degree == 0
    held[[0, -1]] = True
    laplacian = graph_laplacian([(low, high, np.ones(len(low)))], bodies, held)
    fed = np.zeros(bodies)
    fed[np.concatenate([high[low == 0], low[high == 0]])] = 1.0
    voltage = np.zeros(bodies)
    voltage[0] = 1.0
    voltage[inner] = _solve(laplacian, degree[inner], fed[inner])
    return voltage


def _solve(laplacian: csc_array, degree: np.ndarray, right: np.ndarray) -> np.ndarray:
    """By a sparse factorisation with minimum degree ordering; by conjugate gradients where links are dense."""
    if degree.mean() < DENSE:
        return factorised(laplacian).solve(right)
    jacobi = LinearOperator(laplacian.shape, matvec=lambda values: values.ravel() / degree, dtype=float)
    solution = np.zeros(len(right))
    for _ in range(MOST_REFINEMENTS):
        residual = right - laplacian @ solution
        if np.linalg.norm(residual) <= ITERATION_TOLERANCE * np.linalg.norm(right):
            break
        solution += cg(laplacian, residual, atol=0.0, M=jacobi)[0]
    return solution
