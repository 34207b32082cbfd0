"""Betweenness: how many of the shortest paths from bottom to top each link and each sphere carries.

A bottom sphere s and a top sphere t that slipless contacts join are a *pair*. Let sigma_st be the number of shortest
paths from s to t and sigma_st(e) the number of those through link e. The betweenness of e is the sum over all pairs of
sigma_st(e) / sigma_st: every pair sends one unit from s to t, split evenly over its shortest paths (Freeman, Sociometry
40, 35, 1977, with these sources and targets only). Driven spheres are ends only: contacts within a driven plane are no
links, so no path runs through a third driven sphere.

Brandes' algorithm (J. Math. Sociol. 25, 163, 2001), one level of a breadth-first search at a time for many sources at
once. The sweep out counts paths: sigma_s(w) is the sum of sigma_s(v) over the neighbours v in the level before. The
sweep home takes what has gathered at w to each such v in proportion to sigma_s(v) / sigma_s(w). Only these shares are
kept, so the counts, which grow exponentially with the distance, are rescaled at every level and never overflow. The
work grows like sources times links.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.errors import InputError

EXACT_WORK = 200_000_000  # sources times links; beyond it a sample of the sources must do
BATCH_WORK = 2_000_000  # sources times links, or spheres, searched at once: some 100 MB
LEAST_COUNT = 1e-200  # of paths, in units of the largest of its level


@dataclass(frozen=True)
class Betweenness:
    """Load of each link (E,) and each sphere (sites,) by all pairs; a sphere carries the pairs that it ends, too.

    link, sphere : in pairs; exact if paths were counted from all sources, else an unbiased estimate.
    link_error : standard error of `link`; 0 if exact, and where all drawn sources agree.
    pairs : number of connected pairs. mean_distance : mean length of their shortest paths in links; 0 without pairs.
    sources : spheres that paths were counted from, out of all_sources.
    """

    link: np.ndarray
    sphere: np.ndarray
    link_error: np.ndarray
    pairs: int
    mean_distance: float
    sources: int
    all_sources: int


def betweenness(
    network: SliplessNetwork, links: np.ndarray | None = None, sources: int | None = None, seed: int = 0
) -> Betweenness:
    """The betweenness of one sample.

    links : (E,) bool, those that can lie on a shortest path (the backbone), to save work; default all.
    sources : spheres to count paths from, drawn from the driven plane that has fewer of them; default all, or as many
        as EXACT_WORK allows. seed : of this draw. Errors are those of a sample without replacement (Cochran, Sampling
        Techniques, 1977, ch. 2).
    """
    if sources is not None and sources < 2:
        raise InputError(f"sources is {sources}; it must be 2 or more, so that the error can be estimated")
    sites, edges = network.lattice.sites, len(network.axis)
    neighbours = _neighbours(network, np.arange(edges) if links is None else np.flatnonzero(links))
    starts, targets, pairs = _ends_of_pairs(network)
    is_target = np.zeros(sites, dtype=bool)
    is_target[targets] = True
    work = max(1, len(neighbours.link) // 2)
    number = max(2, EXACT_WORK // work) if sources is None else sources
    drawn = starts
    if number < len(starts):
        drawn = np.sort(np.random.default_rng(seed).choice(starts, number, replace=False))
    (link, squares), sphere, distance = np.zeros((2, edges)), np.zeros(sites), 0.0
    at_once = max(1, BATCH_WORK // max(work, sites))
    for begin in range(0, len(drawn), at_once):
        levels = _count_paths(neighbours, drawn[begin : begin + at_once])
        arrived, flows = _send_home(levels, is_target)
        place = np.concatenate([level.link for level in levels[:0:-1]])
        link += np.bincount(place, weights=flows, minlength=edges)
        squares += np.bincount(place, weights=flows**2, minlength=edges)
        place = np.concatenate([level.sphere for level in levels])
        sphere += np.bincount(place, weights=np.concatenate(arrived), minlength=sites)
        distance += sum(n * is_target[level.sphere].sum() for n, level in enumerate(levels))
    scale, left_out = len(starts) / max(1, len(drawn)), 1 - len(drawn) / max(1, len(starts))
    variance = np.maximum(squares - link**2 / max(1, len(drawn)), 0) / max(1, len(drawn) - 1)
    return Betweenness(
        link=scale * link,
        sphere=scale * sphere,
        link_error=len(starts) * np.sqrt(left_out * variance / max(1, len(drawn))),
        pairs=pairs,
        mean_distance=float(scale * distance) / max(1, pairs),
        sources=len(drawn),
        all_sources=len(starts),
    )


def _ends_of_pairs(network: SliplessNetwork) -> tuple[np.ndarray, np.ndarray, int]:
    """Driven spheres joined to the other plane, as indices, of the plane that has fewer and of the other; the pairs."""
    sites = network.lattice.sites
    ones = np.ones(len(network.axis), dtype=np.int8)
    label = connected_components(csr_array((ones, tuple(network.ends)), shape=(sites, sites)), directed=False)[1]
    low, high = (network.touched_of(body) for body in (0, network.bodies - 1))
    pairs = int((np.bincount(label[low], minlength=sites) * np.bincount(label[high], minlength=sites)).sum())
    bottom, top = low[np.isin(label[low], label[high])], high[np.isin(label[high], label[low])]
    return (bottom, top, pairs) if len(bottom) <= len(top) else (top, bottom, pairs)


class _Neighbours(NamedTuple):
    """Neighbours of sphere i: sphere[first[i] : first[i] + degree[i]], over the links of the same numbers."""

    first: np.ndarray
    degree: np.ndarray
    sphere: np.ndarray
    link: np.ndarray


def _neighbours(network: SliplessNetwork, links: np.ndarray) -> _Neighbours:
    """Over the links of these numbers."""
    low, high = network.ends[:, links]
    here, there = np.concatenate([low, high]), np.concatenate([high, low])
    order = np.argsort(here, kind="stable")
    degree = np.bincount(here, minlength=network.lattice.sites)
    return _Neighbours(np.cumsum(degree) - degree, degree, there[order], np.tile(links, 2)[order])


class _Level(NamedTuple):
    """Spheres at one distance from their source, of several searches, and the links that lead to them.

    sphere, search : (K,). For each link: tail, index of its sphere in the level before; head, in this one; share, of
    the shortest paths to the head that come over it.
    """

    sphere: np.ndarray
    search: np.ndarray
    tail: np.ndarray
    head: np.ndarray
    link: np.ndarray
    share: np.ndarray


def _count_paths(neighbours: _Neighbours, sources: np.ndarray) -> list[_Level]:
    """The levels of the breadth-first searches from `sources`, nearest first, the sources themselves level 0."""
    searches, sites = len(sources), len(neighbours.degree)
    place = np.full(searches * sites, -1, dtype=np.int32)  # index in the level of a sphere found; -1 if not found yet
    none = np.empty(0, dtype=np.int64)
    level = _Level(sources, np.arange(searches), none, none, none, np.empty(0))
    place[level.search * sites + level.sphere] = 0
    count, levels = np.ones(searches), []
    while len(level.sphere):
        levels.append(level)
        degree = neighbours.degree[level.sphere]
        tail = np.repeat(np.arange(len(degree)), degree)
        slot = np.arange(len(tail)) + np.repeat(neighbours.first[level.sphere] - (np.cumsum(degree) - degree), degree)
        found = (level.search * sites)[tail] + neighbours.sphere[slot]
        new = place[found] < 0
        tail, slot, found = tail[new], slot[new], found[new]
        number = np.arange(len(found), dtype=np.int32)
        place[found] = number  # where several links lead to one sphere, the last one stays and represents it
        one_each = place[found] == number
        place[found[one_each]] = number[: one_each.sum()]
        head = place[found]
        total = np.bincount(head, weights=count[tail])
        spheres, searched = neighbours.sphere[slot[one_each]], level.search[tail[one_each]]
        level = _Level(spheres, searched, tail, head, neighbours.link[slot], count[tail] / total[head])
        count = np.maximum(total / total.max(initial=0), LEAST_COUNT)
    return levels


def _send_home(levels: Sequence[_Level], is_target: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Take a unit home from every target of every search: what arrives at the spheres of each level, and what flows
    over the links, from the farthest level to the nearest. is_target : (sites,) bool."""
    arrived, flows = [is_target[level.sphere].astype(float) for level in levels], [np.empty(0)]
    for distance in range(len(levels) - 1, 0, -1):
        level = levels[distance]
        flows.append(level.share * arrived[distance][level.head])
        arrived[distance - 1] += np.bincount(level.tail, weights=flows[-1], minlength=len(arrived[distance - 1]))
    return arrived, np.concatenate(flows)
