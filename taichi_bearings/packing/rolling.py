"""Spins that let some contacts of a packing roll, in twice the precision of a double."""

import numpy as np

from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.double_double import Pair, add, scaled, subtract, two_product
from taichi_bearings.scene.packing import Packing

LOOSE = 1e-8  # stiffness of the contacts that may slip, over that of the contacts that are to roll
MOST_CORRECTIONS = 8
NONE_IN_PAIRS = 1e-30  # of the fastest imposed surface: slips that sums of two doubles cannot bring down further


def rolled(system: ContactSystem, packing: Packing, spins: Pair, rolls: np.ndarray) -> Pair:
    """The spins nearest to the given ones, both sums of two doubles (unknowns,), at which the contacts of a mask (A,)
    roll; the given ones where no such are found.

    The slips y of these contacts are computed from the normals and the imposed spins as they are stored. Each
    correction x solves the least squares K x = -y, softened by the other contacts, which only keep the matrix regular,
    so that slips fall by some orders of magnitude each time, down to the rounding of sums of two doubles.
    """
    matrix = NewtonMatrix(system, order_by_place(system))
    try:
        matrix.factorise(isotropic(system.offset, np.where(rolls, 1.0, LOOSE)))
    except NotPositiveDefinite:
        return spins
    best, least, fastest = spins, np.inf, float(np.abs(packing.driven_speed).max(initial=0.0))
    for _ in range(MOST_CORRECTIONS):
        slips = np.where(rolls, slips_in_pairs(system, packing, spins), 0.0)
        size = float(np.abs(slips).max(initial=0.0))
        if not size < least / 2:
            break
        best, least = spins, size
        if size <= NONE_IN_PAIRS * fastest:
            break
        spins = add(spins, (matrix.solve(system.torques(-slips)), np.zeros(system.unknowns)))
    return best


def slips_in_pairs(system: ContactSystem, packing: Packing, spins: Pair) -> np.ndarray:
    """(d, A), slips of the contacts along their tangents, to all digits. spins : (unknowns,)."""
    network = system.network
    first, second = network.contact[:, system.contact]
    shape = system.known.shape
    held = (packing.driven >= 0)[:, None]
    imposed = two_product(packing.spin.reshape(shape), np.broadcast_to(packing.radius[:, None], shape))
    moving = system.moved >= 0
    u = [
        np.where(moving, np.append(part, 0.0)[system.moved], np.where(held, fixed, known))
        for part, fixed, known in zip(spins, imposed, (system.known, 0.0 * system.known), strict=True)
    ]
    high, low = add((u[0][first], u[1][first]), (u[0][second], u[1][second]))
    if high.shape[1] == 1:
        return high.T + low.T
    n, parts = network.normal[system.contact], [(high[:, k], low[:, k]) for k in range(3)]
    slip = [  # (u_i + u_j) x n
        subtract(scaled(n[:, b], parts[a]), scaled(n[:, a], parts[b])) for a, b in ((1, 2), (2, 0), (0, 1))
    ]
    vectors = np.stack([part[0] + part[1] for part in slip], axis=1)
    return np.einsum("tek,ek->te", system.across, np.cross(n, vectors))
