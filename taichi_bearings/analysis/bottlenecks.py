"""Bottlenecks: the few links of the slipless network that carry most of the shortest paths from bottom to top.

A *link* is a slipless contact, a *body* is a set of driven spheres that rotate as one: the bottom or the top plane of a
lattice, or a driven body of a packing. There are two kinds of bottleneck.

*Shortest paths*: a path leads from a driven sphere s of one body over free spheres alone to a driven sphere t of
another body. Driven spheres are ends only: contacts within a body are no links, and no path runs through a third driven
sphere. Two spheres s and t that some path joins are a *pair*. Let sigma_st be the number of shortest paths from s to t
and sigma_st(e) the number of those through link e; two links between the same two spheres, as in a ring of two spheres,
make two paths. The betweenness, or *load*, of e is the sum over all pairs of sigma_st(e) / sigma_st: every pair sends
one unit from s to t, split evenly over its shortest paths (Freeman, Sociometry 40, 35, 1977, with these sources and
targets only). Divided by the number of pairs it is the *share* of the link.

*Single links that separate the bodies*, in words of percolation theory (Stauffer and Aharony, Introduction to
Percolation Theory, 1994): the *backbone* has all links on some path from the bottom to the top that visits nothing
twice; other links are dangling ends. A link of the backbone whose removal separates bottom from top is *parting*: every
path takes it (a "red bond" of Pike and Stanley, J. Phys. A 14, L169, 1981). Extra links from each body to a node
outside close every path between two bodies into a cycle, so the backbone is made of the biconnected blocks that hold
these links (Hopcroft and Tarjan, Comm. ACM 16, 372, 1973). With more than two bodies, pairs are of any two of them.

Paths are counted by Brandes' algorithm (J. Math. Sociol. 25, 163, 2001), one level of a breadth-first search at a time
for many sources at once. The forward sweep counts paths: sigma_s(w) is the sum of sigma_s(v) over the neighbours v in
the level before. The backward sweep passes the load gathered at w on to each such v in proportion to sigma_s(v) /
sigma_s(w). Only these ratios are kept, so the counts, which grow exponentially with the distance, are rescaled at every
level and never overflow. The work grows like sources times links.

Shapes: E links, N spheres (the shape of a lattice, else their number); `sites` is the number of spheres.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import rustworkx

from taichi_bearings.analysis.slipless_network import SliplessNetwork
from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.plain_files import Json
from taichi_bearings.stages import alike, each, stage

LEAST_LOAD = 1e-12  # share below which a link is not listed
EXACT_WORK = 200_000_000  # sources times links up to which all sources are searched; beyond it a random sample of them
BATCH_WORK = 2_000_000  # sources times links, or spheres, searched at once: some 100 MB
LEAST_COUNT = 1e-200  # smallest number of paths that is kept, in units of the largest of its level


@dataclass(frozen=True)
class Betweenness:
    """The loads of all links and spheres. A link is a slipless contact. A pair is a bottom and a top sphere that links
    connect. The load of a link or sphere is the number of shortest paths through it, where all shortest paths of one
    pair together count 1.

    link : (links,), load of each link.
    sphere : (spheres,), load of each sphere; pairs of which it is an end count, too.
    pairs : number of connected pairs.
    mean_distance : mean length of their shortest paths, as a number of links; 0 without pairs.
    is_exact : True if the paths of all pairs were counted; False if the loads are an unbiased estimate from a random
        sample of starting spheres.
    """

    link: np.ndarray
    sphere: np.ndarray
    pairs: int
    mean_distance: float
    is_exact: bool


@dataclass(frozen=True)
class Bottlenecks:
    """What carries the paths of slipless contacts, the links, from bottom to top in one sample: loads, backbone, and
    links that alone separate the two.

    network : the slipless network of the sample.
    """

    network: SliplessNetwork

    @cached_property
    def backbone(self) -> np.ndarray:
        """(links,) mask: True for links on some path from bottom to top that visits no node twice; all False if there
        is no path. No other link is on a shortest path.

        It is found by blocks: the largest sets of links any two of which lie on a common cycle. Extra links join each
        driven body to one extra node, so that every path from bottom to top becomes part of a cycle. The backbone
        consists of the blocks that contain extra links.
        """
        network, through = self.network, np.zeros(self.network.ends.shape[1], dtype=bool)
        if not network.spans:
            return through
        # links of pieces that span, and links from each body to a node outside, form biconnected blocks
        with stage("finding the backbone"):
            in_piece = network.spanning.ravel()[network.ends[0]]
            low, high = network.body[network.ends[:, in_piece]]
            outside = np.full(len(network.driven_nodes), network.bodies)
            block = _blocks(np.append(low, network.driven_nodes), np.append(high, outside), network.bodies + 1)
            through[in_piece] = np.isin(block[: len(low)], block[len(low) :])
        return through

    @cached_property
    def parting(self) -> np.ndarray:
        """(links,) mask: True for links of the backbone whose removal alone separates bottom from top."""
        # removing a link separates its ends exactly if it is alone in its biconnected block: no cycle runs through it
        parting = np.zeros(len(self.backbone), dtype=bool)
        low, high = self.network.body[self.network.ends[:, self.backbone]]
        block = _blocks(low, high, self.network.bodies)
        parting[self.backbone] = np.bincount(block)[block] == 1
        return parting

    @cached_property
    def betweenness(self) -> Betweenness:
        """How many shortest paths from bottom to top run through each link (slipless contact) and each sphere. Only
        links of the backbone have to be searched for that.
        """
        return betweenness(self.network, self.backbone)

    @property
    def share(self) -> np.ndarray:
        """(links,) load of each link, divided by the number of connected pairs of a bottom and a top sphere: the share
        of shortest paths that run through it. It is 0 without pairs.
        """
        return self.betweenness.link / max(1, self.betweenness.pairs)

    @property
    def visits(self) -> np.ndarray:
        """Load of each sphere, divided by the number of connected pairs of a bottom and a top sphere: the share of
        shortest paths that visit it. The array has the shape of the lattice, or (spheres,).
        """
        found = self.betweenness
        return found.sphere.reshape(self.network.shape) / max(1, found.pairs)

    @property
    def effective_links(self) -> float:
        """Effective number of links that carry the shortest paths from bottom to top: (sum load)^2 / sum load^2, with
        the loads of all links. It is n if n links have equal loads and the others none; 0 without paths.
        """
        load = self.share
        return float(load.sum() ** 2 / (load**2).sum()) if load.any() else 0.0

    def most_loaded(self, number: int = 10) -> list[Json]:
        """Return the links of greatest load (share of the shortest paths from bottom to top that run through a link),
        the greatest first, each as a dictionary.

        number : how many links at most.

        Entries: what identifies the link (`contact`, and `axis` or `spheres`), its load as `share`, and
        `parts_the_planes`, True if its removal alone separates bottom and top.
        """
        columns = {**self.network.names, "share": self.share, "parts_the_planes": self.parting}
        rank = np.argsort(-self.share.round(12), kind="stable")
        chosen = rank[self.share[rank] > LEAST_LOAD][:number]
        return [{name: values[edge].tolist() for name, values in columns.items()} for edge in chosen]


def _blocks(low: np.ndarray, high: np.ndarray, bodies: int) -> np.ndarray:
    """Return the number (links,) of the biconnected block of each link. Two links are in one block if they lie on a
    common cycle, or join the same two nodes.

    low, high : (links,), the two nodes of each link.
    bodies : number of nodes.
    """
    graph = rustworkx.PyGraph(multigraph=False)
    graph.add_nodes_from(range(bodies))
    graph.add_edges_from_no_data(list(zip(low.tolist(), high.tolist(), strict=True)))
    found = rustworkx.biconnected_components(graph)
    # look up the block of each link; two nodes a <= b have the code a * bodies + b
    codes = np.sort(np.array(list(found.keys()), dtype=np.int64).reshape(-1, 2), axis=1) @ [bodies, 1]
    order = np.argsort(codes)
    wanted = np.minimum(low, high).astype(np.int64) * bodies + np.maximum(low, high)
    block: np.ndarray = np.array(list(found.values()), dtype=np.int64)[order[np.searchsorted(codes[order], wanted)]]
    return block


def betweenness(network: SliplessNetwork, links: np.ndarray | None = None) -> Betweenness:
    """Return the loads of links (slipless contacts) and spheres of one sample: how many shortest paths between its
    driven bodies run through each.

    network : the slipless network.
    links : (links,) mask of the links that can lie on a shortest path, to save work; None for all.

    Paths are counted from the driven spheres of the body that has fewer spheres on paths: from all of them or, if that
    would take more work than EXACT_WORK, from a random sample.
    """
    sites, edges = len(network.body), network.ends.shape[1]
    neighbours = _neighbours(network, np.arange(edges) if links is None else np.flatnonzero(links))
    passed = network.free.ravel()
    link, sphere, pairs, distances, is_exact = np.zeros(edges), np.zeros(sites), 0, 0.0, True
    for ends in _ends_of_pairs(network):
        found = _loads_between(neighbours, passed, edges, *ends)
        link += found.link
        sphere += found.sphere
        pairs += found.pairs
        distances += found.pairs * found.mean_distance
        is_exact &= found.is_exact
    return Betweenness(link, sphere, pairs, distances / max(1, pairs), is_exact)


def _loads_between(
    neighbours: "_Neighbours", passed: np.ndarray, edges: int, starts: np.ndarray, targets: np.ndarray, pairs: int
) -> Betweenness:
    """Return the loads of links and spheres by the shortest paths between two driven bodies.

    neighbours : the neighbours of all spheres.
    passed : (spheres,) mask of those that paths may run through.
    edges : number of links of the network.
    starts, targets : (n,) and (m,), numbers of the spheres of the one and of the other body.
    pairs : number of pairs of a start and a target that some path connects.
    """
    # paths are counted from all starts, or from a random sample of as many as EXACT_WORK allows
    sites = len(passed)
    is_target = np.zeros(sites, dtype=bool)
    is_target[targets] = True
    work = max(1, len(neighbours.link) // 2)
    most, sources = max(2, EXACT_WORK // work), starts
    if most < len(starts):
        sources = np.sort(np.random.default_rng(0).choice(starts, most, replace=False))
    # a batch of sources at a time: levels of the searches, then loads summed over links and spheres
    link, sphere, distance = np.zeros(edges), np.zeros(sites), 0.0
    at_once = max(1, BATCH_WORK // max(work, sites))
    for begin in each(range(0, len(sources), at_once), "counting shortest paths", alike):
        levels = _count_paths(neighbours, passed, sources[begin : begin + at_once])
        arrived, flows = _loads_of_levels(levels, is_target)
        links = np.concatenate([level.link for level in levels[:0:-1]])  # from the farthest level to the nearest
        link += np.bincount(links, weights=flows, minlength=edges)
        spheres = np.concatenate([level.sphere for level in levels])
        sphere += np.bincount(spheres, weights=np.concatenate(arrived), minlength=sites)
        distance += sum(n * is_target[level.sphere].sum() for n, level in enumerate(levels))
    # with a random sample of the starts the loads are scaled up to all of them
    scale = len(starts) / max(1, len(sources))
    mean = float(scale * distance) / max(1, pairs)
    return Betweenness(scale * link, scale * sphere, pairs, mean, is_exact=len(sources) == len(starts))


def _ends_of_pairs(network: SliplessNetwork) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """Yield, for each driven body but the last, the ends of the paths between it and all later bodies: the numbers of
    the spheres of this body, those of the spheres of later bodies (the shorter array first), and the number of pairs of
    them that some path connects. Paths lead over free spheres: they connect two driven spheres if both have links to
    the same connected piece of free spheres. Spheres without a path are left out.

    network : a graph of spheres, some of them driven, and of links between them.
    """
    pieces_of = _linked_pieces(network)
    bodies = [network.touched_of(body).tolist() for body in network.driven_nodes]
    for number, body in enumerate(bodies[:-1]):
        later = [sphere for other in bodies[number + 1 :] for sphere in other]
        # pieces of free spheres that have links to this body and to a later one, by driven sphere
        common = _union(pieces_of[sphere] for sphere in body) & _union(pieces_of[sphere] for sphere in later)
        here, there = ({sphere: pieces_of[sphere] & common for sphere in ends} for ends in (body, later))
        # count pairs with a piece in common; spheres with the same pieces are counted together
        counts = Counter(here.values()), Counter(there.values())
        pairs = sum(n * m for one, n in counts[0].items() for other, m in counts[1].items() if one & other)
        first, second = (np.array([n for n, linked in ends.items() if linked], np.int64) for ends in (here, there))
        yield (first, second, pairs) if len(first) <= len(second) else (second, first, pairs)


def _union(sets: Iterable[frozenset[int]]) -> frozenset[int]:
    """Return the union of the sets."""
    return frozenset[int]().union(*sets)


def _linked_pieces(network: SliplessNetwork) -> dict[int, frozenset[int]]:
    """Return the connected pieces of free spheres to which each driven sphere has a link: sets of numbers of pieces, by
    the number of the driven sphere.

    network : a graph of spheres, some of them driven, and of links between them.
    """
    sites, free = len(network.body), network.free.ravel()
    # connected pieces of the free spheres alone
    inner = free[network.ends].all(axis=0)
    label = pieces(sites, *network.ends[:, inner])
    # links from driven spheres into these pieces, in both directions
    found: dict[int, set[int]] = {}
    for here, there in (network.ends, network.ends[::-1]):
        is_driven = ~free[here]
        for sphere, piece in zip(here[is_driven].tolist(), label[there[is_driven]].tolist(), strict=True):
            found.setdefault(sphere, set()).add(piece)
    return {sphere: frozenset(linked) for sphere, linked in found.items()}


class _Neighbours(NamedTuple):
    """The neighbours of all spheres in one long list, sphere after sphere: sphere i has the neighbours sphere[k] over
    the links link[k], with k from first[i] to first[i] + degree[i] - 1.

    first, degree : (spheres,), where the neighbours of each sphere begin in the list, and how many it has.
    sphere, link : (2 * links,), number of each neighbour, and of the link to it.
    """

    first: np.ndarray
    degree: np.ndarray
    sphere: np.ndarray
    link: np.ndarray


def _neighbours(network: SliplessNetwork, links: np.ndarray) -> _Neighbours:
    """Return for each sphere its neighbours over some of the links.

    network : a graph of spheres and links.
    links : (n,), numbers of these links.
    """
    low, high = network.ends[:, links]
    here, there = np.concatenate([low, high]), np.concatenate([high, low])
    order = np.argsort(here, kind="stable")
    degree = np.bincount(here, minlength=len(network.body))
    return _Neighbours(np.cumsum(degree) - degree, degree, there[order], np.tile(links, 2)[order])


class _Level(NamedTuple):
    """One level of several breadth-first searches: the spheres at one distance from the sources, and the links that
    lead to them from the level before. A sphere that several searches find has an entry for each.

    sphere, search : (entries,), number of each sphere found, and of the search that found it.
    tail, head : (links used,), entry of the nearer end of each link in the level before, and of its farther end in
        this level.
    link : (links used,), number of each link.
    share : (links used,), fraction of the shortest paths to the farther end that come over each link.
    """

    sphere: np.ndarray
    search: np.ndarray
    tail: np.ndarray
    head: np.ndarray
    link: np.ndarray
    share: np.ndarray


def _count_paths(neighbours: _Neighbours, passed: np.ndarray, sources: np.ndarray) -> list[_Level]:
    """Return the levels of breadth-first searches, the nearest first: the spheres at each distance from the sources,
    and the share that each link to them has in their shortest paths. Level 0 has the sources themselves.

    neighbours : the neighbours of all spheres.
    passed : (spheres,) mask of those from which a search goes on.
    sources : (searches,), number of the sphere where each search begins.
    """
    searches, sites = len(sources), len(neighbours.degree)
    place = np.full(searches * sites, -1, dtype=np.int32)  # entry in its level of each sphere; -1 if not found yet
    none = np.empty(0, dtype=np.int64)
    level = _Level(sources, np.arange(searches), none, none, none, np.empty(0))
    place[level.search * sites + level.sphere] = 0
    count, levels = np.ones(searches), []
    while len(level.sphere):
        levels.append(level)
        # all links from this level, by their place (slot) in the list of neighbours
        degree = neighbours.degree[level.sphere]
        if len(levels) > 1:
            degree = np.where(passed[level.sphere], degree, 0)
        tail = np.repeat(np.arange(len(degree)), degree)
        slot = np.arange(len(tail)) + np.repeat(neighbours.first[level.sphere] - (np.cumsum(degree) - degree), degree)
        found = (level.search * sites)[tail] + neighbours.sphere[slot]
        # only links to spheres that this search has not found before lead on
        new = place[found] < 0
        tail, slot, found = tail[new], slot[new], found[new]
        # number the spheres found: of several links to one sphere the assignment keeps the last, which represents it
        number = np.arange(len(found), dtype=np.int32)
        place[found] = number
        one_each = place[found] == number
        place[found[one_each]] = number[: one_each.sum()]
        head = place[found]
        # number of shortest paths to a sphere: the sum over the links to it of the paths to their nearer ends
        total = np.bincount(head, weights=count[tail])
        spheres, searched = neighbours.sphere[slot[one_each]], level.search[tail[one_each]]
        level = _Level(spheres, searched, tail, head, neighbours.link[slot], count[tail] / total[head])
        count = np.maximum(total / total.max(initial=0), LEAST_COUNT)  # only ratios within a level are needed
    return levels


def _loads_of_levels(levels: Sequence[_Level], is_target: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the loads of spheres, a list of arrays by level, and of links, one array from the farthest level to the
    nearest.

    levels : levels of the searches, the nearest first.
    is_target : (spheres,) mask of the targets.

    One unit starts at every target and is divided over the shortest paths back to the source of its search. A load is
    the amount that passes.
    """
    arrived, flows = [is_target[level.sphere].astype(float) for level in levels], [np.empty(0)]
    for distance in range(len(levels) - 1, 0, -1):
        level = levels[distance]
        flows.append(level.share * arrived[distance][level.head])
        arrived[distance - 1] += np.bincount(level.tail, weights=flows[-1], minlength=len(arrived[distance - 1]))
    return arrived, np.concatenate(flows)
