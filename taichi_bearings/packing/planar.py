"""Discs with friction, exactly: nested minimum cuts, on the double cover where loops are odd.

With u = s U the sums u_i + u_j of a network without odd loops are differences, and for any driven values (coarea)

    least power = sum_k (t_{k+1} - t_k) cut({driven >= t_{k+1}} | {driven <= t_k})

over the sorted driven values t. Parts with odd loops take two copies of each spin, U = u and U = -u, and half the
friction. Frictions are rounded down to whole units, so flows are exact: one that fills all nested cuts and is balanced
in whole numbers proves the least power of the rounded network, which is never above that of the true one.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.numerics.minimum_cut import largest_flow, led_to
from taichi_bearings.packing.system import System, odd_parts

UNIT_BITS = 59  # of the sum of all frictions


@dataclass(frozen=True)
class _Cover:
    """Nodes, and edges (low, high) between them; edges of a node with a driven value of a level. weight : whole units.

    contact, sign : of each edge; the force of the contact is the sum of sign * flow, from low to high.
    """

    nodes: int
    low: np.ndarray
    high: np.ndarray
    inner_weight: np.ndarray
    inner_contact: np.ndarray
    inner_sign: np.ndarray
    end: np.ndarray
    level: np.ndarray
    outer_weight: np.ndarray
    outer_contact: np.ndarray
    outer_sign: np.ndarray
    values: np.ndarray
    unit: float


def least_power(system: System) -> tuple[np.ndarray, np.ndarray]:
    """Spins (unknowns,), and forces (d, A), balanced but for one rounding, of friction alone where no contact feels two
    components."""
    component = system.felt.argmax(axis=1)  # (A,); any of contacts that feel none
    cover, node, mirrored, sign = _covered(system, component)
    place = _nested(cover)
    inner, outer = _filling(cover, place)
    force = np.zeros(len(system.contact), dtype=np.int64)
    np.add.at(force, cover.inner_contact, cover.inner_sign * inner)
    np.add.at(force, cover.outer_contact, cover.outer_sign * outer)
    turned = cover.values[place] if len(cover.values) else np.zeros(cover.nodes)
    spins = np.where(mirrored >= 0, (turned[node] - turned[mirrored]) / 2, sign * turned[node])
    return spins, system.across[:, np.arange(len(component)), component] * force * cover.unit


def _covered(system: System, component: np.ndarray) -> tuple[_Cover, np.ndarray, np.ndarray, np.ndarray]:
    """The network of differences; its node and mirrored node, -1 if none, and sign of each unknown (unknowns,)."""
    weight, count = system.coefficients[0], system.unknowns
    spheres = system.packing.contact[system.contact]
    feels = np.any(system.felt, axis=1)
    ends = np.where(feels[:, None], system.moved[spheres, component[:, None]], -1)  # (A, 2)
    within, some = np.all(ends >= 0, axis=1), np.any(ends >= 0, axis=1)
    odd, sign = odd_parts(count, *ends[within].T)
    mirrored = np.where(odd, count + np.cumsum(odd) - 1, -1)
    rim = np.flatnonzero(some & ~within)
    total = float(weight[rim].sum()) or 1.0
    clipped = np.minimum(weight, total)  # no minimum cut holds more
    unit = float(np.ldexp(1.0, int(np.frexp(clipped.sum())[1]) - UNIT_BITS))
    units = np.floor(clipped / unit / 2).astype(np.int64)  # of each of two copies
    first, second = ends[within].T
    at, both = np.flatnonzero(within), odd[first]
    plain, twice = at[~both], at[both]
    low = np.concatenate([first[~both], first[both], second[both]])
    high = np.concatenate([second[~both], mirrored[second[both]], mirrored[first[both]]])
    inner = np.concatenate([plain, twice, twice])
    one = np.ones(len(twice), dtype=np.int64)
    inner_sign = np.concatenate([sign[first[~both]], one, one])
    factor = np.concatenate([np.full(len(plain), 2), one, one])
    own, held = ends[rim].max(axis=1), np.where(ends[rim, 0] < 0, spheres[rim, 0], spheres[rim, 1])
    u, pair = system.known[held, component[rim]], odd[own]
    end = np.concatenate([own[~pair], own[pair], mirrored[own[pair]]])
    value = np.concatenate([-sign[own[~pair]] * u[~pair], -u[pair], u[pair]])
    outer = np.concatenate([rim[~pair], rim[pair], rim[pair]])
    ones = np.ones(int(pair.sum()), dtype=np.int64)
    outer_sign = np.concatenate([sign[own[~pair]], ones, -ones])
    half = np.concatenate([np.full(int((~pair).sum()), 2), ones, ones])
    values, level = np.unique(value + 0.0, return_inverse=True)
    cover = _Cover(
        count + int(odd.sum()), low, high, units[inner] * factor, inner, inner_sign,
        end, level.ravel(), units[outer] * half, outer, outer_sign, values, unit,
    )  # fmt: skip
    return cover, np.arange(count), mirrored, sign


def _nested(cover: _Cover) -> np.ndarray:
    """Level (nodes,) of each node at a minimum: all ranges of levels are halved at once, by one flow."""
    least, most = np.zeros(cover.nodes, dtype=np.int64), np.full(cover.nodes, max(0, len(cover.values) - 1))
    while (least < most).any():
        middle = (least + most + 1) // 2
        low, high = cover.low, cover.high
        together = (least[low] == least[high]) & (most[low] == most[high]) & (least[low] < most[low])
        from_source, to_sink = (np.zeros(cover.nodes, dtype=np.int64) for _ in range(2))
        for own, other in ((low[~together], high[~together]), (high[~together], low[~together])):
            above = least[other] > most[own]
            np.add.at(from_source, own[above], cover.inner_weight[~together][above])
            np.add.at(to_sink, own[~above], cover.inner_weight[~together][~above])
        above = cover.level >= middle[cover.end]
        np.add.at(from_source, cover.end[above], cover.outer_weight[above])
        np.add.at(to_sink, cover.end[~above], cover.outer_weight[~above])
        open_ = least < most
        from_source, to_sink = from_source * open_, to_sink * open_
        ends, weight = (low[together], high[together]), cover.inner_weight[together]
        upper = _source_side(cover.nodes, ends, weight, from_source, to_sink) & open_
        least = np.where(upper, middle, least)
        most = np.where(open_ & ~upper, middle - 1, most)
    return least


def _flow(
    nodes: int, ends: tuple[np.ndarray, np.ndarray], weight: np.ndarray, source: np.ndarray, sink: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Largest flow (edges,) from low to high, from the source and to the sink (nodes,), in whole units."""
    fed, drained = np.flatnonzero(source), np.flatnonzero(sink)
    low = np.concatenate([ends[0] + 1, np.zeros(len(fed), dtype=np.int64), drained + 1])
    high = np.concatenate([ends[1] + 1, fed + 1, np.full(len(drained), nodes + 1)])
    capacity = np.concatenate([weight, source[fed], sink[drained]])
    at_most = min(int(source.sum()), int(sink.sum()))
    flow = np.zeros(len(low), dtype=np.int64)
    if at_most:
        flow = largest_flow(np.stack([low, high]), capacity, at_most)
    inner, into, out = np.split(flow, [len(weight), len(weight) + len(fed)])
    full_in, full_out = np.zeros(nodes, dtype=np.int64), np.zeros(nodes, dtype=np.int64)
    full_in[fed], full_out[drained] = into, out
    return inner, full_in, full_out


def _source_side(
    nodes: int, ends: tuple[np.ndarray, np.ndarray], weight: np.ndarray, source: np.ndarray, sink: np.ndarray
) -> np.ndarray:
    """The smallest source side (nodes,) of a minimum cut."""
    inner, into, _ = _flow(nodes, ends, weight, source, sink)
    left = np.concatenate([weight - inner, weight + inner])
    row, column = np.concatenate([ends[0], ends[1]]), np.concatenate([ends[1], ends[0]])
    start = np.flatnonzero(source > into)
    return led_to(nodes, row[left > 0], column[left > 0], start)


def _filling(cover: _Cover, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flows from low to high, and from ends to driven values, (edges,) each: full across the nested cuts, balanced."""
    fall = np.sign(place[cover.low] - place[cover.high])
    inner, outer = fall * cover.inner_weight, np.sign(place[cover.end] - cover.level) * cover.outer_weight
    need = np.zeros(cover.nodes + 1, dtype=np.int64)  # what flows in; the last node is all that is driven
    np.add.at(need, cover.low, -inner)
    np.add.at(need, cover.high, inner)
    np.add.at(need, cover.end, -outer)
    need[-1] = -need[:-1].sum()
    flat, rim = fall == 0, place[cover.end] == cover.level
    low = np.concatenate([cover.low[flat], cover.end[rim]])
    high = np.concatenate([cover.high[flat], np.full(int(rim.sum()), cover.nodes)])
    weight = np.concatenate([cover.inner_weight[flat], cover.outer_weight[rim]])
    flow, into, _ = _flow(cover.nodes + 1, (low, high), weight, np.maximum(need, 0), np.maximum(-need, 0))
    if (into != np.maximum(need, 0)).any():
        raise RuntimeError("a largest flow does not fill the nested cuts")
    inner[flat], outer[rim] = flow[: int(flat.sum())], flow[int(flat.sum()) :]
    return inner, outer
