"""Proof that a state without any slip exists (theorem 3): from contacts and imposed spins, never from small slips.

Samples of a lattice have one if, in each component in which the two planes are driven differently, no contacts that
this component makes slip connect them. For packings there are three proofs, each for some *parts* of a packing, what
contacts join through free spheres:

1. No driven sphere touches the part: it can be at rest.
2. Components do not mix (discs, normals along the axes), and in no component contacts join driven spheres with
   different imposed spins, or a driven sphere that turns to a loop of an odd number of contacts.
3. Components mix, and spins can give any slips to the contacts (the rows of the matrix of slips are independent, by a
   proven floor), or spins without slip are found in exact fractions.

Normals and imposed spins are the stored doubles. If a motion without slip needs special normals and these are rounded,
nothing is proven.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.springs import rolling, turning_freely

LEAST_IMPOSED = 1e-200  # imposed surface speed in `speed_unit`, below which products with radii are not exact
NEARLY_NONE = 1e-10  # largest slip over the fastest imposed component, up to which the proof is tried for packings
MOST_IN_FRACTIONS = 8  # most free spheres of a part for which fractions are used: they become long
IMPOSED = -1  # the key for the constant term of an equation, from imposed spins


def exists_without_slip(network: JudgedNetwork) -> np.ndarray:
    """Return the mask (R,) of the samples in which no contact has to slip: spins of the free spheres without any slip
    are proven to exist, so that the least power is 0. False means that nothing is proven.

    network : the R samples, of a lattice or a packing.
    """
    if network.graph.has_two_planes:
        return _planes_are_separate(network)
    if not network.counts.any():
        return np.ones(network.count, dtype=bool)
    if not imposed_exactly(network):
        return np.zeros(network.count, dtype=bool)
    return _roll_exactly(network) if network.mixes else np.full(network.count, not network.needed)


def _planes_are_separate(network: JudgedNetwork) -> np.ndarray:
    """Return the mask (R,) of the samples of a lattice in which no contact has to slip, as nothing joins the two
    planes: in each spin component in which bottom and top are driven differently, there is no chain of contacts from
    one plane to the other that this component makes slip.

    network : the R samples of a lattice.
    """
    if not network.needed:  # both planes are driven alike
        return np.ones(network.count, dtype=bool)
    # Only absent contacts can separate the planes: on a whole lattice chains join them.
    absent = network.graph.any_end(network.free) & ~network.acts
    if not absent.any():
        return np.zeros(network.count, dtype=bool)
    return ~network.must_slip


def imposed_exactly(network: JudgedNetwork) -> bool:
    """Return True if every imposed spin times radius is known as an exact sum of two doubles: always, unless an imposed
    speed other than 0 is so much slower than the fastest that products underflow.

    network : samples of a lattice or a packing, with what is imposed on them.
    """
    sizes = [np.abs(part.high[part.high != 0]) for part in network.imposed]
    return all((size > LEAST_IMPOSED).all() for size in sizes)


@np.errstate(all="ignore")  # what is not finite proves nothing
def _roll_exactly(network: JudgedNetwork) -> np.ndarray:
    """Return the mask (R,) of the samples for which spins are proven to exist at which every contact rolls without any
    slip. Normals may point in any direction. Only samples are tried in which no contact slips faster than NEARLY_NONE
    times the fastest imposed speed in the stored spins.

    network : R samples of a packing, with their stored spins."""
    # Contacts that cannot dissipate (not in `counts`) may slip.
    nearly = ~network.counts | (network.slip.most <= NEARLY_NONE * network.largest_imposed.max(initial=0.0))
    found = nearly.reshape(network.count, -1).all(axis=1)
    for number in np.flatnonzero(found).tolist():
        found[number] = _rolls_exactly(network.some(slice(number, number + 1)))
    result: np.ndarray = found
    return result


def _rolls_exactly(network: JudgedNetwork) -> bool:
    """Return True if spins are proven to exist at which every contact rolls without any slip.

    network : a single sample of a packing, with normals in any direction."""
    from taichi_bearings.proof.exact_motions import ExactMotions  # which only packings need

    # Leave out spheres whose spins can give any slips to their contacts, then contacts that roll in exact motions.
    left = replace(network, rolling=rolling(network))
    if not left.counts.any():
        return True
    number = np.full((len(left.free), 3), -1)
    is_unknown = left.reached[:, None] & ~turning_freely(left)
    number[is_unknown] = np.arange(is_unknown.sum())
    unproven = left.counts & ~ExactMotions.of(left, number, left.counts).contacts
    # Parts with other contacts are tried in fractions.
    first, second = left.graph.contact[:, left.counts]
    inner = left.free[first] & left.free[second]
    part_of_sphere = pieces(len(left.free), first[inner], second[inner])
    part = part_of_sphere[np.where(left.free[left.graph.contact[0]], *left.graph.contact)]
    return all(_is_consistent(left, left.counts & (part == label)) for label in np.unique(part[unproven]))


def _is_consistent(network: JudgedNetwork, contacts: np.ndarray) -> bool:
    """Return True if spins exist at which given contacts all roll exactly, by Gaussian elimination in fractions without
    any rounding. Return False if no such spins exist, or if the contacts have more than MOST_IN_FRACTIONS free spheres,
    which is not tried.

    network : a packing with E contacts.
    contacts : (E,) mask of the contacts; free spheres connect all of them."""
    spheres = np.unique(network.graph.contact[:, contacts])
    spheres = spheres[network.free[spheres]]
    if len(spheres) > MOST_IN_FRACTIONS:
        return False
    unknown = {int(sphere): 3 * place for place, sphere in enumerate(spheres)}
    pivots = dict[int, dict[int, Fraction]]()  # by unknown, an equation that is 1 there and 0 at the pivots before
    for contact in np.flatnonzero(contacts):
        for row in _equations(network, int(contact), unknown):
            # Subtract multiples of the equations before, until the row is 0 at all of their pivots.
            for column, equation in pivots.items():
                factor = row.get(column, 0)
                if factor:
                    for other, value in equation.items():
                        row[other] = row.get(other, Fraction(0)) - factor * value
            first = next((c for c, value in row.items() if c != IMPOSED and value), None)
            if first is not None:
                pivots[first] = {c: value / row[first] for c, value in row.items() if value}
            elif row.get(IMPOSED, 0):  # the equation says that a constant other than 0 is 0
                return False
    return True


def _equations(network: JudgedNetwork, contact: int, unknown: dict[int, int]) -> list[dict[int, Fraction]]:
    """Return the three components of the equation (u_i + u_j) x n = 0 of a contact that rolls, with exact coefficients,
    for the spins times radius of both spheres and the normal. Each is a dictionary: coefficients by the number of the
    unknown spin component, and the constant term, from imposed spins, under the key IMPOSED.

    network : a packing, with the normals of its contacts and the imposed spins.
    contact : index of the contact.
    unknown : for each free sphere the number of the first of its three unknowns."""
    normal = [Fraction(float(value)) for value in network.graph.normal[contact]]
    rows = list[dict[int, Fraction]]()
    for a, b in ((1, 2), (2, 0), (0, 1)):
        row = {IMPOSED: Fraction(0)}
        for sphere in network.graph.contact[:, contact].tolist():
            for component, factor in ((a, normal[b]), (b, -normal[a])):
                if sphere in unknown:
                    column = unknown[sphere] + component
                    row[column] = row.get(column, Fraction(0)) + factor
                else:
                    part = network.imposed[component]
                    row[IMPOSED] += factor * (Fraction(float(part.high[sphere])) + Fraction(float(part.low[sphere])))
        rows.append(row)
    return rows
