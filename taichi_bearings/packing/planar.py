"""Discs with friction, exactly: nested minimum cuts, on the double cover where loops are odd.

With u = s U the sums u_i + u_j of a network without odd loops are differences, and for any driven values (coarea)

    least power = sum_k (t_{k+1} - t_k) cut({driven >= t_{k+1}} | {driven <= t_k})

over the sorted driven values t. Parts with odd loops take two copies of each spin, U = u and U = -u, and half the
friction; exchanging the copies turns the cut of (a, b) into that of (-b, -a), so cuts at positive values are enough.
All of it is exact: frictions, products of two doubles, are whole multiples of a unit, however far apart they are, and
flows are whole numbers of any length (numerics/exact_flow.py). A flow that fills all nested cuts and is balanced is the
friction of a minimum; each part of the network that the cuts leave together carries no more than what they bring to it,
so that forces in doubles are balanced to the rounding of what flows there.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.numerics.double_double import Pair, subtract, two_product
from taichi_bearings.numerics.exact_flow import exact_flow
from taichi_bearings.numerics.graphs import odd_pieces, pieces
from taichi_bearings.numerics.minimum_cut import led_to
from taichi_bearings.scene.packing import Packing

MANTISSA_BITS = 53


@dataclass(frozen=True)
class _Cover:
    """Edges (low, high) between nodes: the first `free` ones are to be found, each other one has one of the driven
    `values`, sums of two doubles: R omega is no double in general. opposite : number of the value that is the negative
    of each one, if there is such a value. weight : (edges,), whole numbers of Python, of units of force.

    contact, sign : of each edge; the force of the contact is the sum of sign * flow, from low to high.
    mirror : (free,), the other copy of a node, -1 if it has none. rest : the highest level of such parts that is not
    positive.
    """

    free: int
    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray
    contact: np.ndarray
    sign: np.ndarray
    values: Pair
    opposite: np.ndarray
    unit: float
    mirror: np.ndarray
    rest: int


def least_power(system: ContactSystem, packing: Packing) -> tuple[Pair, np.ndarray]:
    """Spins (unknowns,) as sums of two doubles, and forces (d, A), balanced but for one rounding, of friction alone
    where no contact feels two components."""
    component = system.feels.argmax(axis=1)  # (A,); any of contacts that feel none
    cover, sign = _covered(system, packing, component)
    place = _nested(cover)
    force = np.zeros(len(component), dtype=object)
    np.add.at(force, cover.contact, cover.sign * _filling(cover, place))
    spins = _spins(cover, place, sign)
    return spins, system.across[:, np.arange(len(component)), component] * (force.astype(float) * cover.unit)


def least_spins(system: ContactSystem, packing: Packing) -> np.ndarray:
    """The same spins alone, rounded to doubles, in about half the time."""
    cover, sign = _covered(system, packing, system.feels.argmax(axis=1))
    return _spins(cover, _nested(cover), sign)[0]


def _spins(cover: _Cover, place: np.ndarray, sign: np.ndarray) -> Pair:
    own, twin = np.arange(len(sign)), cover.mirror[: len(sign)]
    high, low = (part[place] if len(part) else np.zeros(len(place)) for part in cover.values)
    half = subtract((high[own] / 2, low[own] / 2), (high[twin] / 2, low[twin] / 2))
    found = zip(half, (sign * high[own], sign * low[own]), strict=True)
    spins, rest = (np.where(twin >= 0, odd, even) for odd, even in found)
    return spins, rest


def _covered(system: ContactSystem, packing: Packing, component: np.ndarray) -> tuple[_Cover, np.ndarray]:
    """The network of differences; the sign of each unknown (unknowns,)."""
    count = system.unknowns
    spheres = packing.contact[system.numbers]
    feels = np.any(system.feels, axis=1)
    ends = np.where(feels[:, None], system.moved[spheres, component[:, None]], -1)  # (A, 2)
    within, some = np.all(ends >= 0, axis=1), np.any(ends >= 0, axis=1)
    odd, sign = odd_pieces(count, *ends[within].T)
    mirrored = np.where(odd, count + np.cumsum(odd) - 1, -1)
    inner, rim = np.flatnonzero(within), np.flatnonzero(some & ~within)
    units, unit = _whole(packing, system.numbers)
    units = np.minimum(units, units[rim].sum())  # no minimum cut holds more
    first, second = ends[inner].T
    own, held = ends[rim].max(axis=1), np.where(ends[rim, 0] < 0, spheres[rim, 0], spheres[rim, 1])
    twice, pair, u = odd[first], odd[own], _imposed(system, packing, held, component[rim])
    single = tuple(np.where(pair, -part, -sign[own] * part) for part in u)
    values, level, opposite = _ordered(*(np.append(part, of[pair]) + 0.0 for part, of in zip(single, u, strict=True)))
    driven = count + int(odd.sum()) + level
    of_rim, of_pair = np.split(driven, [len(rim)])
    low = [first, second[twice], own, mirrored[own[pair]]]
    high = [np.where(twice, mirrored[second], second), mirrored[first[twice]], of_rim, of_pair]
    contact = np.concatenate([inner, inner[twice], rim, rim[pair]])
    copies = np.concatenate([2 - twice, np.ones(twice.sum(), int), 2 - pair, np.ones(pair.sum(), int)])
    signs = [np.where(twice, 1, sign[first]), np.ones(twice.sum(), int)]
    signs += [np.where(pair, 1, sign[own]), -np.ones(pair.sum(), int)]
    edges = np.concatenate(low), np.concatenate(high), units[contact] * copies, contact, np.concatenate(signs)
    mirror = np.append(mirrored, np.flatnonzero(odd))
    of_twins = np.append(level[: len(rim)][pair], level[len(rim) :])
    negative = of_twins[(values[0][of_twins] < 0) | (values[0][of_twins] == 0)]
    rest = int(negative.max(initial=0))
    return _Cover(len(mirror), *edges, values, opposite, unit / 2, mirror, rest), sign


def _imposed(system: ContactSystem, packing: Packing, spheres: np.ndarray, component: np.ndarray) -> Pair:
    """u = R omega of spheres (n,), exactly where they are driven; of the others it is chosen, a double."""
    spin = packing.spin.reshape(system.known.shape)[spheres, component]
    high, low = two_product(np.asarray(packing.radius)[spheres], spin)
    held, known = packing.driven[spheres] >= 0, system.known[spheres, component]
    return np.where(held, high, known), np.where(held, low, 0.0)


def _ordered(high: np.ndarray, low: np.ndarray) -> tuple[Pair, np.ndarray, np.ndarray]:
    """Different ones of sums of two doubles (n,) in order; number of each of the n, and of the negative of each."""
    keys, number = np.unique(np.stack([high, low], axis=1), axis=0, return_inverse=True)
    place = {tuple(key): k for k, key in enumerate(keys.tolist())}
    opposite = np.array([place.get((-a, -b), 0) for a, b in keys.tolist()], dtype=np.int64)
    return (keys[:, 0], keys[:, 1]), number.ravel(), opposite


def _whole(packing: Packing, contact: np.ndarray) -> tuple[np.ndarray, float]:
    """Friction times normal force of contacts (A,), exactly: whole numbers of Python, and the unit of force. A normal
    force that all of them have is left to the unit."""
    normal = np.broadcast_to(packing.normal_force, packing.contacts)[contact]
    same = bool((normal == normal[:1]).all())
    (part, power), (more, further) = (np.frexp(v) for v in (np.asarray(packing.friction)[contact], normal))
    whole = np.ldexp(part, MANTISSA_BITS).astype(np.int64).astype(object)
    if not same:
        whole, power = whole * np.ldexp(more, MANTISSA_BITS).astype(np.int64), power + further
    least = int(power[whole > 0].min(initial=2**16))
    whole = whole << np.where(whole > 0, power - least, 0).astype(object)
    common = int(np.bitwise_or.reduce(whole, initial=0))
    zeros = (common & -common).bit_length() - 1 if common else 0
    bits = MANTISSA_BITS if same else 2 * MANTISSA_BITS
    unit = float(np.ldexp(float(normal[0]) if same and len(normal) else 1.0, least - bits + zeros)) if common else 1.0
    return whole >> zeros, unit


def _nested(cover: _Cover) -> np.ndarray:
    """Level (nodes,) of each node at a minimum.

    Of copies that exchange, the least positive parts; the negative ones are the images of the largest positive parts.
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
_Round = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, _Arcs]  # what _halved gives


def _levels(cover: _Cover, largest: np.ndarray, rounds: list[_Round]) -> np.ndarray:
    """Level (nodes,) of each node, of those with a copy from `rest` on: all ranges of levels are halved at once, by one
    flow. Where cuts tie, by the smallest source sides, or the largest ones of the nodes that are `largest` (free,).

    rounds : of a search before; as long as ranges are the same its flows serve again. Gets those of this one.
    """
    levels, count = np.arange(len(cover.opposite)), 0
    least = np.concatenate([np.where(cover.mirror >= 0, cover.rest, 0), levels])
    most = np.concatenate([np.full(cover.free, max(0, len(levels) - 1)), levels])
    largest = np.append(largest, np.zeros(len(levels), dtype=bool))
    while (open_ := least < most).any():
        if count == len(rounds) or not np.array_equal(rounds[count][:2], (least, most)):
            rounds[count:] = [_halved(cover, least, most)]
        middle, upper, backwards = rounds[count][2:]
        if largest.any():
            upper = np.where(largest, ~led_to(len(least), *backwards), upper)
        least = np.where(open_ & upper, middle, least)
        most = np.where(open_ & ~upper, middle - 1, most)
        count += 1
    return least


def _halved(cover: _Cover, least: np.ndarray, most: np.ndarray) -> _Round:
    """A cut of all ranges that are open. Of each node: least and greatest level, the middle from which on the upper
    half begins, and True on the smallest source side. Then what a largest flow leaves, backwards from the nodes that
    could still be drained: they reach the smallest sink side."""
    middle, (low, high), open_ = (least + most + 1) // 2, (cover.low, cover.high), least < most
    together = (least[low] == least[high]) & (most[low] == most[high]) & open_[low]
    source, sink = np.zeros((2, len(least)), dtype=object)
    for own, other in ((low, high), (high, low)):
        above = least[other] >= middle[own]  # ranges are the same or share no level; driven nodes have one
        np.add.at(source, own, cover.weight * (above & ~together & open_[own]))
        np.add.at(sink, own, cover.weight * (~above & ~together & open_[own]))
    ends, weight = np.stack([low[together], high[together]]), cover.weight[together]
    inner, into, out = exact_flow(ends, weight, source, sink)
    left = np.concatenate([weight - inner, weight + inner]) > 0
    row, column = np.concatenate([ends, ends[::-1]], axis=1)[:, left]
    upper = led_to(len(least), row, column, np.flatnonzero(source > into))
    return least, most, middle, upper, (column, row, np.flatnonzero(sink > out))


def _filling(cover: _Cover, place: np.ndarray) -> np.ndarray:
    """Flow (edges,) from low to high: full across the nested cuts, balanced at all nodes that are not driven."""
    fall = np.sign(place[cover.low] - place[cover.high])
    flow, flat = fall * cover.weight, fall == 0
    need = np.zeros(len(place), dtype=object)  # what flows in
    np.add.at(need, cover.low, -flow)
    np.add.at(need, cover.high, flow)
    low, high = cover.low[flat], cover.high[flat]
    within = high < cover.free
    part = pieces(cover.free, low[within], high[within])
    ground = cover.free + part  # the driven spheres that touch a part, as a node of its own
    need, own = np.append(need[: cover.free], np.zeros(part.max(initial=-1) + 1, dtype=object)), need[: cover.free]
    np.subtract.at(need, ground, own)
    ends = np.stack([low, np.where(within, high, ground[low])])
    source, sink = np.maximum(need, 0), np.maximum(-need, 0)
    flow[flat], into, _ = exact_flow(ends, cover.weight[flat], source, sink)
    if (into != source).any():
        raise RuntimeError("internal check failed: the maximum flow does not fill the minimum cuts; please report it")
    return flow
