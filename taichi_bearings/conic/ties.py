"""Finds contacts that slip at some minima and rest at others (state TIED), in doubles and without a proof.

At all minima a contact that slips does so in the same direction. So one minimum is changed into another by a motion
that changes no slip's direction and reverses no slip. Contacts that rest at every minimum tie spheres together; a
motion turns such sets of spheres as a whole. For example, two neighbours with equal friction may pull a set with the
same force in opposite directions. With k independent motions, the slips of n contacts that y (k,) of them lead to are
slips + rates @ y, and the minima are the polyhedron on which none of these is negative.

Letters: n contacts with up to d slip components, k independent motions; y (k,) how far each motion goes.
"""

from itertools import combinations
from math import comb

import numpy as np
from scipy import sparse

from taichi_bearings.conic.cones import length
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.numerics.graphs import pieces

# Limits of a search in doubles that proves nothing: what lies beyond them is not found, or taken to be tied.
MOST_BLOCK_UNKNOWNS = 600  # most unknowns of a block that is searched for motions without change of direction (n^3)
NOISE_SHARE = 2e-3  # component of a force at its limit, over the other one, that may be noise
LEAST_TURN = 1e-9  # change of the direction of a unit slip, per unit of motion, that counts as none
LEAST_MOVE = 1e-7  # change of a slip over the largest of its motion, and share left of a slip, that count as 0
LONGEST_MOTION = 1e6  # largest multiple of a motion that is considered
MOST_CORNERS = 3000  # most candidates for corners of a polyhedron that are all computed


def sometimes_slipping(
    system: ContactSystem,
    order: np.ndarray,
    friction: np.ndarray,
    difference: np.ndarray,
    dual: np.ndarray,
    slipping: np.ndarray,
    at_limit: np.ndarray,
) -> np.ndarray:
    """Return a mask (n,) of contacts that slip at some minima and rest at others. Only contacts with equal friction can
    do so.

    system : the contacts.
    order : order in which its unknowns are eliminated.
    friction : (n,), largest friction force mu F_n of each contact.
    difference : (d, n), slips at one minimum.
    dual : (d, n), minus the friction forces there.
    slipping : (n,) mask of contacts that slip there.
    at_limit : (n,) mask of contacts that do not slip there and yet may bear all their friction.
    """
    found = np.zeros(len(friction), dtype=bool)
    if len(np.unique(friction)) == len(friction):
        return found
    tied = Contraction(system, order, ~(slipping | at_limit))
    slipping, difference, dual = slipping[tied.kept], difference[:, tied.kept], dual[:, tied.kept]
    # a contact at its limit can begin to slip in one direction only, that of -dual
    one_way = np.where(np.abs(dual) > NOISE_SHARE * np.abs(dual).max(axis=0), -dual, 0.0)
    towards = np.where(slipping, difference, one_way)
    # Motions along which minima may differ, and the rates at which they change each slip, the largest of a motion 1.
    motions = _turning_no_slip(tied, towards)
    if motions.shape[1] == 0:
        return found
    rates = np.einsum("dn,dnk->nk", towards / length(towards), tied.system.change(motions))
    rates = rates / np.maximum(np.abs(rates).max(axis=0), LEAST_MOVE)
    rates = np.where(np.abs(rates) > LEAST_MOVE, rates, 0.0)
    found[tied.kept] = _sometimes_zero(np.where(slipping, length(difference), 0.0), rates)
    return found


def _turning_no_slip(tied: Contraction, difference: np.ndarray) -> np.ndarray:
    """Return k independent motions that change the direction of no slip, a matrix (unknowns, k); all motions of this
    kind are sums of its columns. An unknown is the spin of a set of spheres that turn together.

    tied : the contacts that slip or are at their limit, over the sets of spins that the other contacts tie together.
    difference : (d, contacts), slips, or directions in which contacts can begin to slip.

    A slip with one component always keeps its direction. A slip with two components keeps it if the component of its
    change at right angles to it is 0: one equation for each contact. Unknowns that equations join form a block; blocks
    of more than MOST_BLOCK_UNKNOWNS unknowns are left out.
    """
    unknowns, count = tied.unknowns, difference.shape[1]
    conditions = sparse.csr_array((0, unknowns))
    if len(difference) == 2:
        along = difference / np.hypot(*difference)
        across = np.where(np.abs(along[::-1]) > LEAST_TURN, [-along[1], along[0]], 0.0)
        take = np.tile(np.arange(count), 2), np.arange(2 * count)
        conditions = sparse.csr_array((across.ravel(), take), shape=(count, 2 * count)) @ tied.system.operator
    conditions.eliminate_zeros()
    # Unknowns that no condition joins are independent: each block has a kernel of its own, by singular values.
    entries, motions = conditions.tocoo(), [np.zeros((unknowns, 0))]
    for own, some in _blocks(unknowns, entries.row, entries.col):
        if len(own) <= MOST_BLOCK_UNKNOWNS:
            row = np.unique(entries.row[some], return_inverse=True)[1]
            matrix = np.zeros((int(row.max(initial=0)) + 1, len(own)))
            matrix[row, np.searchsorted(own, entries.col[some])] = entries.data[some]
            kernel = _kernel(matrix)
            basis = np.zeros((unknowns, kernel.shape[1]))
            basis[own] = kernel
            motions.append(basis)
    return np.concatenate(motions, axis=1)


def _kernel(matrix: np.ndarray) -> np.ndarray:
    """Return orthogonal unit vectors, (n, k), that a matrix (m, n) maps to vectors shorter than LEAST_TURN."""
    n = matrix.shape[1]
    if n == 1:
        return np.ones((1, int(np.linalg.norm(matrix) < LEAST_TURN)))
    # the triangular factor R of Q R has the same kernel as the matrix, and fewer rows
    _, sizes, vectors = np.linalg.svd(np.linalg.qr(matrix, "r"))
    kernel: np.ndarray = vectors[np.append(sizes, np.zeros(n - len(sizes))) < LEAST_TURN].T
    return kernel


def _blocks(unknowns: int, rows: np.ndarray, columns: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the blocks of a sparse matrix with a column for each unknown: groups of unknowns that no row joins with
    other groups. A block is a pair: its unknowns, and the indices of its entries, both in rising order.

    unknowns : number of unknowns.
    rows, columns : (entries,), where the entries stand, row by row.
    """
    joined = np.flatnonzero(np.diff(rows) == 0)
    label = pieces(unknowns, columns[joined], columns[joined + 1])
    count = int(label.max(initial=-1)) + 1
    own, entries = (
        np.split(np.argsort(of, kind="stable"), np.cumsum(np.bincount(of, minlength=count))[:-1])
        for of in (label, label[columns])
    )
    return list(zip(own, entries, strict=True))[:count]


def _sometimes_zero(slips: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the contacts that slip at some minima and rest at others. The minima are the points of the
    polyhedron slips + rates @ y >= 0. Motions that share no contact are treated separately.

    slips : (n,), slip speeds at one minimum, 0 or more.
    rates : (n, k), their changes by k motions; y (k,) says how far each motion goes.
    """
    found = np.zeros(len(slips), dtype=bool)
    contact, motion = np.nonzero(rates)
    for own, entries in _blocks(rates.shape[1], contact, motion):
        some = np.unique(contact[entries])
        slip = np.where(slips[some] > 0, slips[some], 1.0)
        found[some] = _sometimes_zero_of_part((slips[some] > 0).astype(float), rates[np.ix_(some, own)] / slip[:, None])
    return found


def _sometimes_zero_of_part(first: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the contacts that slip at some minima and rest at others, of motions that share contacts.
    A slip is linear in y and not negative, so its least and largest values are at corners of the polyhedron of minima.

    first : (n,), slips at one minimum, y = 0, each in units of itself: 1 where a contact slips there, else 0.
    rates : (n, k), changes of these numbers by k motions.
    """
    # So many candidates for corners occur where friction is the same everywhere.
    motions = rates.shape[1]
    if comb(len(first) + 2 * motions, motions) > MOST_CORNERS:
        return np.ones(len(first), dtype=bool)
    there = first + _corners(first, rates) @ rates.T
    found: np.ndarray = np.where(first > 0, (there < LEAST_MOVE).any(axis=0), (there > LEAST_MOVE).any(axis=0))
    return found


def _corners(first: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return the corners (corners, k) of the polyhedron first + rates @ y >= 0, |y| <= LONGEST_MOTION: the points at
    which k of these bounds are equalities and the others hold.

    first : (n,), slips of n contacts at y = 0.
    rates : (n, k), their changes by k motions; y (k,) says how far each motion goes.
    """
    # every k of the bounds meet in a point, if they are independent; it is a corner if all other bounds hold there
    box, motions = np.eye(rates.shape[1]), rates.shape[1]
    bounds, offsets = np.vstack([rates, box, -box]), np.append(first, np.full(2 * motions, LONGEST_MOTION))
    meeting = np.array(list(combinations(range(len(bounds)), motions)))
    matrices = bounds[meeting]
    regular = np.abs(np.linalg.det(matrices)) > LEAST_TURN * np.prod(np.linalg.norm(matrices, axis=2), axis=1)
    points = np.linalg.solve(matrices[regular], -offsets[meeting[regular]][..., None])[..., 0]
    found: np.ndarray = points[(offsets + points @ bounds.T >= -LEAST_MOVE / 10).all(axis=1)]
    return found
