"""Finds spins, as sums of two doubles, at which chosen contacts of a packing roll, that is do not slip.

Letters: A contacts of the system, d tangents of a contact (1 for discs, 2 for spheres), u = radius * spin.
"""

import numpy as np

from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.double_double import Pair, add, scaled, subtract, two_product
from taichi_bearings.scene.packing import Packing

LOOSE = 1e-8  # stiffness of the contacts that may slip, over that of the contacts that have to roll
MOST_CORRECTIONS = 8  # least-squares corrections of the spins at most
NONE_IN_PAIRS = 1e-30  # slip over the fastest imposed speed that sums of two doubles cannot reduce further


def rolled(system: ContactSystem, packing: Packing, spins: Pair, rolls: np.ndarray) -> Pair:
    """Return spins (unknowns,) near the given ones at which some contacts roll; the given spins if the matrix for that
    is singular.

    system : the A contacts as a function of the unknown spins.
    packing : the spheres whose contacts they are.
    spins : (unknowns,), u = radius * spin of free spheres, length/time; sums of two doubles, as is the result.
    rolls : (A,), mask of the contacts that have to roll.

    The slips y of these contacts are computed from the normals and the imposed spins as they are stored. Each
    correction x of the spins solves K x = -y by least squares, with the matrix K from spins to slips. The other
    contacts have the weak weight LOOSE, which only keeps the matrix regular. Each correction reduces slips by some
    orders of magnitude, down to the rounding of sums of two doubles.
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
    """Return the slips (d, A) of the contacts along their tangents, computed in sums of two doubles.

    system : the A contacts as a function of the unknown spins.
    packing : the spheres whose contacts they are.
    spins : (unknowns,), u = radius * spin of free spheres, length/time, as sums of two doubles.

    Letters: d slip components, 1 for discs and 2 for spheres.
    """
    network = system.network
    # u of all N spheres, (N, C): the unknowns, radius * spin of driven spheres, and the known rest, which is exact.
    first, second = network.contact[:, system.contact]
    shape = system.known.shape
    is_driven = (packing.driven >= 0)[:, None]
    imposed = two_product(packing.spin.reshape(shape), np.broadcast_to(packing.radius[:, None], shape))
    is_unknown = system.moved >= 0
    u = [
        np.where(is_unknown, np.append(part, 0.0)[system.moved], np.where(is_driven, fixed, known))
        for part, fixed, known in zip(spins, imposed, (system.known, 0.0 * system.known), strict=True)
    ]
    # The slip is (u_i + u_j) x n, turned back by n and projected on the tangents.
    high, low = add((u[0][first], u[1][first]), (u[0][second], u[1][second]))
    if high.shape[1] == 1:
        found: np.ndarray = high.T + low.T
        return found
    n, parts = network.normal[system.contact], [(high[:, k], low[:, k]) for k in range(3)]
    slip = [subtract(scaled(n[:, b], parts[a]), scaled(n[:, a], parts[b])) for a, b in ((1, 2), (2, 0), (0, 1))]
    vectors = np.stack([part[0] + part[1] for part in slip], axis=1)
    found = np.einsum("tek,ek->te", system.across, np.cross(n, vectors))
    return found
