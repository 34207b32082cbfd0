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

from dataclasses import dataclass
from functools import partial

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
    link_error, sphere_error : its standard error; 0 if exact, and where all drawn sources agree.
    pairs : number of connected pairs. sources : spheres that paths were counted from, out of all_sources.
    mean_distance, least_distance : links on the shortest path of a pair; 0 without pairs. distance_error : standard
        error of the mean.
    """

    link: np.ndarray
    sphere: np.ndarray
    link_error: np.ndarray
    sphere_error: np.ndarray
    pairs: int
    mean_distance: float
    distance_error: float
    least_distance: int
    sources: int
    all_sources: int

    @property
    def is_exact(self) -> bool:
        return self.sources == self.all_sources


def betweenness(
    network: SliplessNetwork, links: np.ndarray | None = None, sources: int | None = None, seed: int = 0
) -> Betweenness:
    """The betweenness of one sample.

    links : (E,) bool, those that can lie on a shortest path (the backbone), to save work; default all.
    sources : spheres to count paths from, drawn from the driven plane that has fewer of them; default all, or as many
        as EXACT_WORK allows. seed : of this draw.
    """
    if sources is not None and sources < 2:
        raise InputError(f"sources is {sources}; it must be 2 or more, so that the error can be estimated")
    graph = _Graph.of(network, np.ones(len(network.axis), dtype=bool) if links is None else links)
    starts, targets, pairs = _ends_of_pairs(network)
    work = max(1, len(graph.link) // 2)
    drawn = _draw(starts, max(2, EXACT_WORK // work) if sources is None else sources, seed)
    sums = _Sums(len(network.axis), network.lattice.sites)
    is_target = np.zeros(network.lattice.sites, dtype=bool)
    is_target[targets] = True
    at_once = max(1, BATCH_WORK // max(work, network.lattice.sites))
    for begin in range(0, len(drawn), at_once):
        sums.add(_count_paths(graph, drawn[begin : begin + at_once]), is_target)
    scale = len(starts) / max(1, len(drawn))
    error = partial(_standard_error, number=len(drawn), population=len(starts))
    return Betweenness(
        link=scale * sums.link,
        sphere=scale * sums.sphere,
        link_error=error(sums.link, sums.link_squared),
        sphere_error=error(sums.sphere, sums.sphere_squared),
        pairs=pairs,
        mean_distance=float(scale * sums.distance) / max(1, pairs),
        distance_error=float(error(sums.distance, sums.distance_squared)) / max(1, pairs),
        least_distance=max(0, len(network.shortest_path) - 1),
        sources=len(drawn),
        all_sources=len(starts),
    )


def _ends_of_pairs(network: SliplessNetwork) -> tuple[np.ndarray, np.ndarray, int]:
    """Driven spheres joined to the other plane, as indices, of the plane that has fewer and of the other; the pairs."""
    sites = network.lattice.sites
    ones = np.ones(len(network.axis), dtype=np.int8)
    label = connected_components(csr_array((ones, tuple(network.ends)), shape=(sites, sites)), directed=False)[1]
    planes = [label[network.bottom], label[network.top]]
    bottom = network.bottom[np.isin(planes[0], planes[1])]
    top = network.top[np.isin(planes[1], planes[0])]
    low, high = (np.bincount(piece, minlength=sites) for piece in planes)
    pairs = int((low * high).sum())
    return (bottom, top, pairs) if len(bottom) <= len(top) else (top, bottom, pairs)


def _draw(starts: np.ndarray, number: int, seed: int) -> np.ndarray:
    """A sample of `number` of them without replacement, or all if they are not more."""
    if number >= len(starts):
        return starts
    return np.sort(np.random.default_rng(seed).choice(starts, number, replace=False))


def _standard_error(total: np.ndarray | float, squares: np.ndarray | float, number: int, population: int) -> np.ndarray:
    """Of population / number * total, for a sample without replacement (Cochran, Sampling Techniques, 1977, ch. 2)."""
    if number == population:
        return np.zeros_like(total)
    variance = np.maximum(squares - total**2 / number, 0) / (number - 1)
    return population * np.sqrt((1 - number / population) * variance / number)


@dataclass(frozen=True)
class _Graph:
    """Neighbours of sphere i: neighbour[first[i] : first[i] + degree[i]], over the links of the same numbers."""

    first: np.ndarray
    degree: np.ndarray
    neighbour: np.ndarray
    link: np.ndarray

    @staticmethod
    def of(network: SliplessNetwork, links: np.ndarray) -> "_Graph":
        low, high = network.ends[:, links]
        here, there = np.concatenate([low, high]), np.concatenate([high, low])
        order = np.argsort(here, kind="stable")
        degree = np.bincount(here, minlength=network.lattice.sites)
        return _Graph(np.cumsum(degree) - degree, degree, there[order], np.tile(np.flatnonzero(links), 2)[order])


@dataclass(frozen=True)
class _Level:
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


def _count_paths(graph: _Graph, sources: np.ndarray) -> list[_Level]:
    """The levels of the breadth-first searches from `sources`, nearest first, the sources themselves level 0."""
    searches, sites = len(sources), len(graph.degree)
    place = np.full(searches * sites, -1, dtype=np.int32)  # index in the level of a sphere found; -1 if not found yet
    none = np.empty(0, dtype=np.int64)
    level = _Level(sources, np.arange(searches), none, none, none, np.empty(0))
    place[level.search * sites + level.sphere] = 0
    count, levels = np.ones(searches), []
    while len(level.sphere):
        levels.append(level)
        degree = graph.degree[level.sphere]
        tail = np.repeat(np.arange(len(degree)), degree)
        slot = np.arange(len(tail)) + np.repeat(graph.first[level.sphere] - (np.cumsum(degree) - degree), degree)
        found = (level.search * sites)[tail] + graph.neighbour[slot]
        new = place[found] < 0
        tail, slot, found = tail[new], slot[new], found[new]
        number = np.arange(len(found), dtype=np.int32)
        place[found] = number  # where several links lead to one sphere, the last one stays and represents it
        one_each = place[found] == number
        place[found[one_each]] = number[: one_each.sum()]
        head = place[found]
        total = np.bincount(head, weights=count[tail])
        share = count[tail] / total[head]
        level = _Level(
            graph.neighbour[slot[one_each]], level.search[tail[one_each]], tail, head, graph.link[slot], share
        )
        count = np.maximum(total / total.max(initial=0), LEAST_COUNT)
    return levels


class _Sums:
    """Sums over the searches of the loads, and of their squares."""

    def __init__(self, links: int, sites: int) -> None:
        self.link, self.link_squared = np.zeros((2, links))
        self.sphere, self.sphere_squared = np.zeros((2, sites))
        self.distance, self.distance_squared = np.zeros(2)

    def add(self, levels: list[_Level], is_target: np.ndarray) -> None:
        """Send a unit home from every target (sites,) bool of every search."""
        arrived = [is_target[level.sphere].astype(float) for level in levels]
        distances = np.zeros(len(levels[0].sphere))
        for distance, (level, units) in enumerate(zip(levels, arrived, strict=True)):
            distances += distance * np.bincount(level.search, weights=units, minlength=len(distances))
        flows = []
        for distance in range(len(levels) - 1, 0, -1):
            level = levels[distance]
            flows.append(level.share * arrived[distance][level.head])
            arrived[distance - 1] += np.bincount(level.tail, weights=flows[-1], minlength=len(arrived[distance - 1]))
        link = np.concatenate([level.link for level in levels[:0:-1]])
        sphere = np.concatenate([level.sphere for level in levels])
        for name, where, load in (("link", link, np.concatenate(flows)), ("sphere", sphere, np.concatenate(arrived))):
            for power, total in ((1, getattr(self, name)), (2, getattr(self, f"{name}_squared"))):
                total += np.bincount(where, weights=load**power, minlength=len(total))
        self.distance += distances.sum()
        self.distance_squared += (distances**2).sum()
