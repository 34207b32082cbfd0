"""Domains that can move on the line between two others without a change of the power: a part of theorem 9.

What is proven. Two sets of contacts, which slip in both components, pull a sphere with the same friction in opposite
directions. If it moves along this line, one set dissipates as much less as the other one more. Such a sphere is a
*link* here. It moves with all spheres that contacts without slip join to it: a slipless domain in the first component,
and another one in the second. Each of these may have further links, which then have to move along their own lines, and
so on. This file finds all domains that move together in that way. (tied_minima.py defines the other words.)

Drawing. Two links, spheres 1 and 2, are joined in the first component alone. Each lies between two other spheres,
which are driven::

    driven                 driven
       \\                    /
        1 ------ T ------- 2            1 and 2 move by the same number in the first component, and by others in the
         \\                /             second one, such that each moves along its line
        driven         driven

Symbols
    node : a slipless domain of one component, without a driven sphere. v : unit vector along the slips of one set of a
        link, with the sign with which they pull; v' : that of the other set. w : the friction of either set.

The proof. Let links connect some nodes to a tree, and let all turning contacts at these nodes be contacts of the links.
Let all exactly known pulls on each node cancel. One node, the root, is held; all others are in balance at the minimum
u*.
1. A node with one link is pulled by w (v + v') along its component. That is 0, so v and v' are opposite along it. As
   both are unit vectors, they are opposite or alike along the other component; signs say that they are opposite there.
   So v' = -v, and the link pulls on no node at all. The same follows for one link after the other, towards the root.
2. So the root is in balance, too, though it is held.
3. Each link can move along its line: no slip of its contacts turns. In a tree the motion of one node says those of all
   others. So the motions of such a tree are the multiples of one, and with the root held there is none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import breadth_first_order

from taichi_bearings.numerics.graphs import graph_of, pieces
from taichi_bearings.proof.curvature import Slipping
from taichi_bearings.proof.enclosure import UP
from taichi_bearings.proof.pulls import Pulls

Node = tuple[int, int]  # a component of the spins (0 or 1), and the label of a slipless domain in it


@dataclass(frozen=True, eq=False)
class Link:
    """A group of spheres that turn as one in both components, between two other groups that pull it with the same
    friction: each by a set of contacts, which slip in both components.

    nodes : the slipless domain of the group in either component.
    contacts : (q,), the contacts of both sets, as indices in the arrays of :class:`Pulls`.
    opposite : for either component True if the group is faster than all spheres of one set and slower than all of the
        other, in the stored spins.
    size : for either component the median of the slips of the contacts along it, in the stored spins."""

    nodes: tuple[Node, Node]
    contacts: np.ndarray
    opposite: tuple[bool, bool]
    size: tuple[float, float]


@dataclass(frozen=True)
class BetweenTwo:
    """The m links of a sample that can move, each along the line between its two neighbours, and the nodes that move
    with them. (The head of this file defines links and nodes.)

    labels : two arrays, the labels in `Pulls.slipless_domain` of the nodes of either component.
    held : two arrays, labels of the nodes that are held: the root of each tree, so that one minimum is left.
    slot : (m,), for each link the component (0 or 1) along which its slips must not change their signs.
    sets : m arrays with the contacts of the links, as indices in the arrays of :class:`Pulls`.
    undecided : (n,) mask of the contacts of `Pulls` of which no state is proven: those in `sets`, and those at the
        nodes that slip along one component alone, as their slips change when the node moves."""

    labels: tuple[np.ndarray, np.ndarray]
    held: tuple[np.ndarray, np.ndarray]
    slot: np.ndarray
    sets: list[np.ndarray]
    undecided: np.ndarray

    @classmethod
    def of(cls, pulls: Pulls, contacts: Slipping) -> BetweenTwo:
        """Return the links that can move, with their nodes, by the proof at the head of this file. They form trees in
        which every link lies between its two neighbours, along the component of its node nearer to the root.

        pulls : the n contacts whose friction is at its limit.
        contacts : slips of those of them that slip."""
        links = _closed(pulls, _links(pulls, contacts, _where_known_pulls_cancel(pulls)))
        # Keep the trees all of whose links lie between their neighbours in the stored spins.
        roots, nodes, outwards = set[Node](), set[Node](), list[tuple[Link, int]]()
        for tree in _trees(links):
            root = _farthest(tree)
            if all(link.opposite[near] for link, near in _outwards(tree, root)):
                roots.add(root)
                nodes.update(node for link in tree for node in link.nodes)
                outwards += _outwards(tree, root)
        # Undecided: the contacts of these links, and those that slip along one component alone at a node that moves.
        undecided = np.zeros(len(pulls.own), dtype=bool)
        for link, _ in outwards:
            undecided[link.contacts] = True
        for slot, label in nodes:
            changes = pulls.felt[slot] & ~pulls.turned_by[slot]
            undecided |= changes & pulls.touches(pulls.slipless_domain[slot], label)
        slots, sets = np.array([near for _, near in outwards], dtype=int), [link.contacts for link, _ in outwards]
        return cls(_labels(nodes), _labels(roots), slots, sets, undecided)

    def lie_between(self, pulls: Pulls, contacts: Slipping, relative_change: np.ndarray) -> bool:
        """Return True if each link is proven to lie between its two neighbours at the minimum, as it does in the stored
        spins: no slip of its contacts, along the component in `slot`, changes its sign from there to the minimum.

        pulls : the contacts whose friction is at its limit, with the signs of the slips in the stored spins.
        contacts : the slipping contacts at spins close to the minimum.
        relative_change : (slipping contacts,), bound on |slip at the minimum - slip| / |slip|.
        """
        for some, slot in zip(self.sets, self.slot, strict=True):
            slip, change = contacts.difference[slot].at(some), relative_change[some] * contacts.size.at(some).most * UP
            if not ((np.sign(slip.high) == pulls.sign[slot, some]) & (slip.least > change)).all():
                return False
        return True


def _labels(nodes: set[Node]) -> tuple[np.ndarray, np.ndarray]:
    """Return for either component the labels of the nodes of it, two arrays."""
    first, second = (np.array(sorted(label for slot, label in nodes if slot == k), dtype=int) for k in range(2))
    return first, second


def _where_known_pulls_cancel(pulls: Pulls) -> np.ndarray:
    """Return the mask (2, spheres), by component, of the spheres in slipless domains without a driven sphere on which
    the exactly known forces cancel.

    pulls : the contacts whose friction is at its limit."""
    found = np.zeros(pulls.slipless_domain.shape, dtype=bool)
    for slot, label in enumerate(pulls.slipless_domain):
        is_free = label >= pulls.imposed_labels(pulls.slipless_domain, slot)  # smaller labels: with a driven sphere
        found[slot] = is_free & pulls.known_pulls_cancel_at(label, slot)[label]
    return found


def _links(pulls: Pulls, contacts: Slipping, can_be_linked: np.ndarray) -> list[Link]:
    """Return all links. A link is a group of spheres that turn as one in both components and have just two neighbours:
    two other groups, each joined to it by a set of contacts that slip in both components. The friction limits of both
    sets have the same sum, exactly.

    pulls : the contacts whose friction is at its limit.
    contacts : slips of those of them that slip.
    can_be_linked : (2, spheres) mask, by component, of the spheres that a link may have."""
    label, found = pulls.same_in_both, []
    # contacts that slip in both components, between two domains in either
    slips_in_both = pulls.in_s & pulls.turned_by.all(axis=0)
    slips_in_both &= pulls.apart(pulls.slipless_domain, 0) & pulls.apart(pulls.slipless_domain, 1)
    # groups that such contacts join to two others
    ends = label[np.stack([pulls.lower[slips_in_both], pulls.upper[slips_in_both]])]
    pairs = np.unique(np.concatenate([ends, ends[::-1]], axis=1), axis=1)
    has_two = np.bincount(pairs[0], minlength=int(label.max()) + 1) == 2
    spheres = np.unique(label, return_index=True)[1][has_two]
    for sphere in spheres[can_be_linked[:, spheres].all(axis=0)]:
        first, second = (int(pulls.slipless_domain[slot, sphere]) for slot in range(2))
        chosen = np.flatnonzero(slips_in_both & pulls.crossing(label, label[sphere]))
        is_upper = label[pulls.upper[chosen]] == label[sphere]
        other = label[np.where(is_upper, pulls.lower[chosen], pulls.upper[chosen])]
        # The friction limits of one set less those of the other have to be exactly 0.
        sign_of_set = np.where(other == other[0], 1.0, -1.0)
        if math.fsum((sign_of_set[:, None] * pulls.coefficient[chosen]).ravel().tolist()) == 0.0:
            parts = [part.at(chosen) for part in contacts.difference]
            # the sign of (spin of the link less that of the other sphere), times that of the set: opposite if all agree
            signs = [np.unique(np.sign(part.high) * np.where(is_upper, 1, -1) * sign_of_set) for part in parts]
            sizes = [float(np.median(part.most)) for part in parts]
            opposite = len(signs[0]) == 1, len(signs[1]) == 1
            found.append(Link(((0, first), (1, second)), chosen, opposite, (sizes[0], sizes[1])))
    return found


def _closed(pulls: Pulls, links: list[Link]) -> list[Link]:
    """Return a largest set of the given links such that all turning contacts at their nodes (contacts whose slip
    changes its direction if the node moves) are contacts of links of the set.

    pulls : the contacts whose friction is at its limit.
    links : candidates. A node is a slipless domain of one component."""
    turning = {
        (slot, label): set(np.flatnonzero(pulls.turned_at(label, slot)).tolist())
        for slot, label in {node for link in links for node in link.nodes}
    }
    while True:
        at: dict[Node, set[int]] = {node: set() for node in turning}
        for link in links:
            for node in link.nodes:
                at[node].update(link.contacts.tolist())
        kept = [link for link in links if all(at[node] == turning[node] for node in link.nodes)]
        if len(kept) == len(links):
            return kept
        links = kept


def _trees(links: list[Link]) -> list[list[Link]]:
    """Return the trees of a graph, each as a list of its links. Connected parts with a loop are left out.

    links : the edges of the graph; each connects two nodes, a slipless domain of either component."""
    nodes, ends = _numbered(links)
    piece = pieces(len(nodes), *ends)
    of_link = piece[ends[0]].tolist()
    trees = np.bincount(piece) == np.bincount(of_link) + 1  # a tree has one node more than links
    return [
        [link for link, own in zip(links, of_link, strict=True) if own == number] for number in np.flatnonzero(trees)
    ]


def _numbered(links: list[Link]) -> tuple[list[Node], np.ndarray]:
    """Return the nodes of links (slipless domains of one component) as a list, and the numbers of the two nodes of each
    link in it, (2, links).

    links : the links."""
    nodes = list(dict.fromkeys(node for link in links for node in link.nodes))
    number = {node: i for i, node in enumerate(nodes)}
    return nodes, np.array([[number[node] for node in link.nodes] for link in links], dtype=int).reshape(-1, 2).T


def _outwards(tree: list[Link], root: Node) -> list[tuple[Link, int]]:
    """Return pairs (link, near) for all links of a tree, in the order in which a search from the root finds them. Each
    link has a node of either component; `near` is the component, 0 or 1, of the node nearer to the root.

    tree : its links.
    root : one of its nodes."""
    nodes, ends = _numbered(tree)
    order, before = breadth_first_order(graph_of(len(nodes), *ends), nodes.index(root), directed=False)
    link_of = {link.nodes: link for link in tree}  # by its nodes, that of component 0 first
    near_and_far = [(nodes[before[number]], nodes[number]) for number in order[1:]]
    return [(link_of[min(pair), max(pair)], pair[0][0]) for pair in near_and_far]


def _farthest(tree: list[Link]) -> Node:
    """Return the node of a tree that moves farthest if every link moves along the direction of its slips. A link
    connects two nodes, one of either component, so the motion of one node gives those of all others.

    tree : its links."""
    moves = {tree[0].nodes[0]: 1.0}
    for link, near in _outwards(tree, tree[0].nodes[0]):
        with np.errstate(divide="ignore", invalid="ignore"):  # a line along one component has no slip along the other
            moves[link.nodes[1 - near]] = moves[link.nodes[near]] * np.divide(link.size[1 - near], link.size[near])
    return max(moves, key=lambda node: moves[node])
