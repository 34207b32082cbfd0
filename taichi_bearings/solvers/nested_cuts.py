"""Discs with friction, exactly: nested minimum cuts, on the double cover of parts with odd loops.

Let s be signs by which neighbours differ, and u = s U. In a network without odd loops the sums u_i + u_j are then
differences of U, and for any driven values of U (coarea formula)

    least power = sum_k (t_{k+1} - t_k) cut({driven >= t_{k+1}} | {driven <= t_k})

over the sorted driven values t, with the weight cut(. | .) of the lightest cut between two sets of driven spheres. A
part with odd loops has no such signs. It takes two copies of each spin, U = u and U = -u, and half the friction (double
cover); exchanging the copies maps the cut of (a, b) to that of (-b, -a), so that cuts at positive values are enough.
All of it is exact: frictions, products of two doubles, are whole multiples of a unit, however far apart they are, and
flows are whole numbers of any length (numerics/exact_flow.py). A flow that fills all nested cuts and is balanced is the
friction of a minimum; each part of the network that the cuts leave together carries no more than what they bring to it,
so that forces in doubles are balanced to the rounding of what flows there.

Words: the *level* of a node is the number k of its value t_k at the minimum. Nodes are the free spins, then their
second copies (twins), then one node for each driven value. *Rim* contacts have one driven sphere. The *upper side* of a
cut has the nodes of the higher levels. Letters: A contacts of the system, d tangents of a contact.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.numerics.double_double import Pair, subtract, two_product
from taichi_bearings.numerics.exact_flow import exact_flow
from taichi_bearings.numerics.graphs import odd_pieces, pieces
from taichi_bearings.numerics.minimum_cut import reachable_from
from taichi_bearings.scene.packing import Packing

MANTISSA_BITS = 53


@dataclass(frozen=True)
class _Cover:
    """The graph whose minimum cuts give the spins of least power.

    A node stands for a free spin u times a sign by which neighbours differ, called U. Parts of the network with odd
    loops have no such signs; there each spin has two nodes (twins), for U = u and for U = -u: a double cover. One
    further node stands for each value of U that is imposed on driven spheres; these values are sorted, and the number
    of a value is called its level. An edge stands for a contact, with its friction limit as weight.
    """

    free: int  # number of nodes that stand for free spins; those of the driven values come after them
    low: np.ndarray  # (edges,), number of the first node of each edge
    high: np.ndarray  # (edges,), number of its second node
    weight: np.ndarray  # (edges,), friction limits as whole numbers of `unit`
    contact: np.ndarray  # (edges,), place of the edge's contact among the A contacts of the system
    sign: np.ndarray  # (edges,), 1 or -1; the force of a contact is the sum of sign * flow from low to high
    values: Pair  # two arrays (levels,): the sorted driven values of U, length/time, as sums of two doubles
    opposite: np.ndarray  # (levels,), for each value the number of its negative, 0 if there is none
    unit: float  # unit of the weights, force
    mirror: np.ndarray  # (free,), number of the twin of each node, -1 if it has none
    rest: int  # the highest level of a value that is not positive, in parts with twins; 0 if there is none


def least_power(system: ContactSystem, packing: Packing) -> tuple[Pair, np.ndarray]:
    """Return spins times radius of least power (unknowns,), length/time, as sums of two doubles, and contact forces
    along the tangents (d, A). The forces balance but for the rounding of each to a double.

    The law must have friction alone, and each contact must couple one spin component only.

    system : the A contacts that take part; d tangents each.
    packing : one sample.
    """
    component = system.feels.argmax(axis=1)  # (A,), the coupled component; any one where none is
    # the graph whose minimum cuts give the spins, and the sign that each spin has in it
    cover, sign = _covered(system, packing, component)
    level = _nested(cover)  # of each node, the number of its value among the sorted driven values
    force = np.zeros(len(component), dtype=object)  # whole numbers of any length
    np.add.at(force, cover.contact, cover.sign * _filling(cover, level))
    spins = _spins(cover, level, sign)
    return spins, system.across[:, np.arange(len(component)), component] * (force.astype(float) * cover.unit)


def least_spins(system: ContactSystem, packing: Packing) -> np.ndarray:
    """Return u = radius * spin at a minimum of the power, (unknowns,), length/time, each rounded to a double.

    The contact forces are not computed; that takes about half the time of `least_power`, which computes both.

    system : the contacts that take part. The unknowns are the components of u of their free spheres.
    packing : one sample.
    """
    cover, sign = _covered(system, packing, system.feels.argmax(axis=1))
    return _spins(cover, _nested(cover), sign)[0]


def _spins(cover: _Cover, level: np.ndarray, sign: np.ndarray) -> Pair:
    """Return u = radius * spin (unknowns,), length/time, as sums of two doubles, from the values of the nodes.

    In a part without odd loops u is sign times the value of its node. In a part with odd loops two nodes (twins) stand
    for u and -u; then u is half the difference of their values.

    cover : the graph, with the sorted driven values that nodes can have.
    level : (nodes,), for each node the number of its value among these.
    sign : (unknowns,), 1 or -1, alternating between neighbours; not used in parts with odd loops.
    """
    # the value of each node; then u as with a twin, and as without
    own, twin = np.arange(len(sign)), cover.mirror[: len(sign)]
    high, low = (part[level] if len(part) else np.zeros(len(level)) for part in cover.values)
    half = subtract((high[own] / 2, low[own] / 2), (high[twin] / 2, low[twin] / 2))
    found = zip(half, (sign * high[own], sign * low[own]), strict=True)
    spins, rest = (np.where(twin >= 0, odd, even) for odd, even in found)
    return spins, rest


def _covered(system: ContactSystem, packing: Packing, component: np.ndarray) -> tuple[_Cover, np.ndarray]:
    """Return the graph whose minimum cuts give the least power, and the sign (unknowns,) of each unknown spin in it.

    Without odd loops there are signs that alternate between neighbours; a node stands for sign * spin, and a contact is
    one edge. In a part with odd loops there are no such signs: each unknown has two nodes, for spin and -spin, and each
    contact two edges of half the weight between opposite nodes (double cover).

    system : the A contacts that take part.
    packing : one sample.
    component : (A,), the spin component that each contact couples.
    """
    # `ends`: the unknowns that each contact joins, -1 for an end without one; `odd`: mask of the unknowns in parts with
    # odd loops; `mirrored`: their second nodes, else -1
    count = system.unknowns
    spheres = packing.contact[system.numbers]
    feels = np.any(system.feels, axis=1)
    ends = np.where(feels[:, None], system.moved[spheres, component[:, None]], -1)  # (A, 2)
    both_free, any_free = np.all(ends >= 0, axis=1), np.any(ends >= 0, axis=1)
    odd, sign = odd_pieces(count, *ends[both_free].T)
    mirrored = np.where(odd, count + np.cumsum(odd) - 1, -1)
    # contacts between two unknowns (inner), and those of an unknown with an imposed spin (rim)
    inner, rim = np.flatnonzero(both_free), np.flatnonzero(any_free & ~both_free)
    units, unit = _whole(packing, system.numbers)
    units = np.minimum(units, units[rim].sum())  # no minimum cut holds more
    # which contacts are in parts with odd loops; u of the driven sphere of each rim contact
    first, second = ends[inner].T
    free_end, driven_end = ends[rim].max(axis=1), np.where(ends[rim, 0] < 0, spheres[rim, 0], spheres[rim, 1])
    inner_odd, rim_odd, u = odd[first], odd[free_end], _imposed(system, packing, driven_end, component[rim])
    # for each rim contact the value that its free node has if it does not slip; in odd parts also that of the twin, u
    value = tuple(np.where(rim_odd, -part, -sign[free_end] * part) for part in u)
    values, level, opposite = _ordered(*(np.append(part, of[rim_odd]) + 0.0 for part, of in zip(value, u, strict=True)))
    driven = count + int(odd.sum()) + level
    rim_value, rim_opposite = np.split(driven, [len(rim)])
    # a contact is one edge with twice the weight, or in odd parts two edges between nodes of opposite sign
    low = [first, second[inner_odd], free_end, mirrored[free_end[rim_odd]]]
    high = [np.where(inner_odd, mirrored[second], second), mirrored[first[inner_odd]], rim_value, rim_opposite]
    contact = np.concatenate([inner, inner[inner_odd], rim, rim[rim_odd]])
    copies = np.concatenate([2 - inner_odd, np.ones(inner_odd.sum(), int), 2 - rim_odd, np.ones(rim_odd.sum(), int)])
    signs = [np.where(inner_odd, 1, sign[first]), np.ones(inner_odd.sum(), int)]
    signs += [np.where(rim_odd, 1, sign[free_end]), -np.ones(rim_odd.sum(), int)]
    edges = np.concatenate(low), np.concatenate(high), units[contact] * copies, contact, np.concatenate(signs)
    mirror = np.append(mirrored, np.flatnonzero(odd))
    # the highest level, in parts with odd loops, whose value is not positive
    of_twins = np.append(level[: len(rim)][rim_odd], level[len(rim) :])
    rest = int(of_twins[values[0][of_twins] <= 0].max(initial=0))
    return _Cover(len(mirror), *edges, values, opposite, unit / 2, mirror, rest), sign


def _imposed(system: ContactSystem, packing: Packing, spheres: np.ndarray, component: np.ndarray) -> Pair:
    """Return radius * spin, in one component, of n spheres whose spin is not an unknown, as a pair (high, low) of
    arrays (n,), length/time; the value is high + low.

    For a driven sphere it is the exact product of the radius and the imposed spin. For a free sphere whose spin nothing
    determines, high is the number that `system.known` holds for it, and low is 0.

    system : the contacts that take part; `system.known` has radius * spin of each sphere and component not unknown.
    packing : the sample, with radii, imposed spins and driven spheres.
    spheres : (n,), numbers of the spheres.
    component : (n,), which spin component of each sphere is asked for.
    """
    spin = packing.spin.reshape(system.known.shape)[spheres, component]
    high, low = two_product(np.asarray(packing.radius)[spheres], spin)
    held, known = packing.driven[spheres] >= 0, system.known[spheres, component]
    return np.where(held, high, known), np.where(held, low, 0.0)


def _ordered(high: np.ndarray, low: np.ndarray) -> tuple[Pair, np.ndarray, np.ndarray]:
    """Sort numbers (n,), given as sums high + low of two doubles. Return three things: the different values in order,
    as two arrays; for each of the n numbers the index of its value; and for each value the index of its negative, 0 if
    there is none.

    high, low : (n,) each.
    """
    keys, number = np.unique(np.stack([high, low], axis=1), axis=0, return_inverse=True)
    place = {tuple(key): k for k, key in enumerate(keys.tolist())}
    opposite = np.array([place.get((-a, -b), 0) for a, b in keys.tolist()], dtype=np.int64)
    return (keys[:, 0], keys[:, 1]), number.ravel(), opposite


def _whole(packing: Packing, contact: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the friction limits of some contacts exactly, as whole numbers (n,) of type object, and their common unit
    of force.

    A limit is friction coefficient times normal force. A normal force that all contacts have in common is part of the
    unit.

    packing : one sample.
    contact : (n,), numbers of the contacts.
    """
    normal = np.broadcast_to(packing.normal_force, packing.contacts)[contact]
    same = bool((normal == normal[:1]).all())
    # a double is a whole number of 53 bits times a power of two; a product of two doubles has up to 106 bits
    (mantissa, power), (mantissa_of_normal, power_of_normal) = (
        np.frexp(values) for values in (np.asarray(packing.friction)[contact], normal)
    )
    whole = np.ldexp(mantissa, MANTISSA_BITS).astype(np.int64).astype(object)
    if not same:
        whole = whole * np.ldexp(mantissa_of_normal, MANTISSA_BITS).astype(np.int64)
        power = power + power_of_normal
    # in units of the least power of two; then without the zeros at the end that all have in common
    least = int(power[whole > 0].min(initial=2**16))  # which is above all exponents of doubles
    whole = whole << np.where(whole > 0, power - least, 0).astype(object)
    common = int(np.bitwise_or.reduce(whole, initial=0))
    zeros = (common & -common).bit_length() - 1 if common else 0
    bits = MANTISSA_BITS if same else 2 * MANTISSA_BITS
    unit = float(np.ldexp(float(normal[0]) if same and len(normal) else 1.0, least - bits + zeros)) if common else 1.0
    return whole >> zeros, unit


def _nested(cover: _Cover) -> np.ndarray:
    """Return the lowest level that each node has at any minimum, (nodes,): the number of its value among the sorted
    driven values. All nodes can have their lowest levels at once.

    In parts with odd loops each spin has two nodes, twins. `_levels` finds their levels of positive values only, those
    above `cover.rest`. Exchanging twins changes the sign of all values. So the lowest value of a node, if negative, is
    minus the highest value of its twin.
    """
    twin, rounds = cover.mirror >= 0, list[_Round]()
    lowest = _levels(cover, np.zeros_like(twin), rounds)
    if not twin.any() or not len(cover.opposite):
        return lowest
    highest = _levels(cover, twin, rounds)
    own, image = lowest[: cover.free][twin], highest[cover.mirror[twin]]
    lowest[: cover.free][twin] = np.where((own > cover.rest) | (image <= cover.rest), own, cover.opposite[image])
    return lowest


_Arcs = tuple[np.ndarray, np.ndarray, np.ndarray]  # from, to, and the nodes to start at
# what _halved returns: least and most level of each node, the middle, the mask of the upper half, and a residual graph
_Round = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, _Arcs]


def _levels(cover: _Cover, largest: np.ndarray, rounds: list[_Round]) -> np.ndarray:
    """Return the lowest level of each node at any minimum, (nodes,), or its highest level for nodes in `largest`. Nodes
    with a twin get `cover.rest`, the highest level whose value is not positive, in place of lower levels.

    Levels are found by bisection: each round halves the range of levels of every node, by one maximum flow.

    largest : (free,), mask of nodes of which the highest level is returned.
    rounds : the rounds of an earlier search, whose flows are used again as long as the ranges are the same. In the end
        it holds those of this search.
    """
    levels, count = np.arange(len(cover.opposite)), 0
    least = np.concatenate([np.where(cover.mirror >= 0, cover.rest, 0), levels])
    most = np.concatenate([np.full(cover.free, max(0, len(levels) - 1)), levels])
    largest = np.append(largest, np.zeros(len(levels), dtype=bool))
    while (undecided := least < most).any():
        if count == len(rounds) or not np.array_equal(rounds[count][:2], (least, most)):
            rounds[count:] = [_halved(cover, least, most)]
        # of several lightest cuts the one with the smallest upper side, or for `largest` with the smallest lower side
        middle, upper, backwards = rounds[count][2:]
        if largest.any():
            upper = np.where(largest, ~reachable_from(len(least), *backwards), upper)
        least = np.where(undecided & upper, middle, least)
        most = np.where(undecided & ~upper, middle - 1, most)
        count += 1
    return least


def _halved(cover: _Cover, least: np.ndarray, most: np.ndarray) -> _Round:
    """Find out by one maximum flow in which half of its range of levels each node is at a minimum.

    cover : the graph that is cut.
    least, most : (nodes,), lowest and highest level that each node may have.

    Returns five things:

    1. and 2. `least` and `most` as they were given;
    3. (nodes,), the level at which the upper half of each range begins;
    4. (nodes,), mask of the nodes in the upper half, by the minimum cut with the smallest upper side;
    5. three arrays (arcs from, arcs to, nodes to start at). What arcs lead to from the start is the smallest lower side
       of a minimum cut.
    """
    middle, (low, high), undecided = (least + most + 1) // 2, (cover.low, cover.high), least < most
    # the edges whose two nodes have the same range
    together = (least[low] == least[high]) & (most[low] == most[high]) & undecided[low]
    # edges within a range are arcs; one to a node of a higher range is a source, of a lower range a sink
    source, sink = np.zeros((2, len(least)), dtype=object)
    for own, other in ((low, high), (high, low)):
        above = least[other] >= middle[own]  # ranges are the same or share no level; driven nodes have one
        np.add.at(source, own, cover.weight * (above & ~together & undecided[own]))
        np.add.at(sink, own, cover.weight * (~above & ~together & undecided[own]))
    ends, weight = np.stack([low[together], high[together]]), cover.weight[together]
    inner, into, out = exact_flow(ends, weight, source, sink)
    # residual arcs, along which more could flow, lead from the source to the smallest upper side; reversed, they lead
    # from the nodes whose arc to the sink is not filled to the smallest lower side
    is_left = np.concatenate([weight - inner, weight + inner]) > 0
    tail, head = np.concatenate([ends, ends[::-1]], axis=1)[:, is_left]
    upper = reachable_from(len(least), tail, head, np.flatnonzero(source > into))
    return least, most, middle, upper, (head, tail, np.flatnonzero(sink > out))


def _filling(cover: _Cover, level: np.ndarray) -> np.ndarray:
    """Return a flow along the edges, (edges,), from low to high, in whole numbers of `cover.unit`. It is balanced at
    all free nodes, and fills all edges between nodes of different levels, which are the edges of the minimum cuts.

    level : (nodes,), the number of each node's value among the sorted driven values.
    """
    # edges between different levels carry their whole weight, down from the higher level
    fall = np.sign(level[cover.low] - level[cover.high])
    flow, is_flat = fall * cover.weight, fall == 0
    surplus = np.zeros(len(level), dtype=object)  # what they bring to each node, and has to flow out again
    np.add.at(surplus, cover.low, -flow)
    np.add.at(surplus, cover.high, flow)
    # the other edges join nodes of one level into parts, through which a maximum flow leads what was brought
    low, high = cover.low[is_flat], cover.high[is_flat]
    within = high < cover.free
    part = pieces(cover.free, low[within], high[within])
    ground = cover.free + part  # one more node for each part, in place of the driven spheres that touch it
    of_free = surplus[: cover.free]
    surplus = np.append(of_free, np.zeros(part.max(initial=-1) + 1, dtype=object))
    np.subtract.at(surplus, ground, of_free)  # so that each part is balanced as a whole
    ends = np.stack([low, np.where(within, high, ground[low])])
    source, sink = np.maximum(surplus, 0), np.maximum(-surplus, 0)
    flow[is_flat], into, _ = exact_flow(ends, cover.weight[is_flat], source, sink)
    if (into != source).any():
        raise RuntimeError(
            "internal check failed: the maximum flow does not equal the minimum cut; please report it with the command"
        )
    found: np.ndarray = flow
    return found
