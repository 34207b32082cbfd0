"""The topology of a network of contacts, before anything is solved: its parts, its odd loops, its slipless motions.

A *slipless motion* is a set of spins, not all 0, at which no contact slips. Letter: N spheres.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, dijkstra

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.numerics.motions import MOST_UNKNOWNS
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.network import Network

MOST_LOOPS = 20_000  # spheres in parts with odd loops up to which the smallest odd loop is searched for
CHUNK = 256  # searches that are made at a time
DENSE_UNKNOWNS = 600  # unknowns up to which a rank is found by singular values
RANK = 1e-9  # singular values below this fraction of the largest one count as 0


@dataclass(frozen=True)
class Topology:
    """Numbers that describe the topology of a network of contacts.

    spheres, contacts, driven, bodies : numbers of spheres, contacts, driven spheres and driven bodies.
    parts : number of connected parts.
    floating : number of parts of several spheres with no driven one.
    rattlers : number of free spheres without contact.
    free_dangling : number of free spheres with one contact.
    bipartite : True if no loop has an odd number of contacts, so that all neighbours can rotate against each other.
    smallest_odd_loop : number of contacts in the smallest odd loop; None if there is none, or if the network is too
        large to search.
    free_motions, all_motions : number of independent motions without slip, of the free spheres with the driven ones at
        rest, and of all spheres; None where the network is too large, or where rounding leaves the number open.
    decided_by : how the number of motions was found, in words.
    """

    spheres: int
    contacts: int
    driven: int
    bodies: int
    parts: int
    floating: int
    rattlers: int
    free_dangling: int
    bipartite: bool
    smallest_odd_loop: int | None
    free_motions: int | None
    all_motions: int | None
    decided_by: str


def topology_of(bearing: Bearing) -> Topology:
    """Return the topology of a bearing, which depends on its contacts alone and not on their coefficients.

    bearing : a lattice or a packing.
    """
    network = bearing.network
    count, free = network.spheres, network.free
    part = pieces(count, *network.contact)
    sizes = np.bincount(part)
    has_driven = np.zeros(len(sizes), dtype=bool)
    has_driven[part[~free]] = True
    degree = np.bincount(network.contact.ravel(), minlength=count)
    free_motions, decided_by = slipless_number(network, free)
    all_motions, _ = slipless_number(network, np.ones(count, dtype=bool))
    return Topology(
        spheres=count,
        contacts=network.contacts,
        driven=int((~free).sum()),
        bodies=len(network.bodies),
        parts=len(sizes),
        floating=int((~has_driven & (sizes > 1)).sum()),
        rattlers=int(((degree == 0) & free).sum()),
        free_dangling=int(((degree == 1) & free).sum()),
        bipartite=not network.sublattices[0].any(),
        smallest_odd_loop=smallest_odd_loop(network),
        free_motions=free_motions,
        all_motions=all_motions,
        decided_by=decided_by,
    )


def smallest_odd_loop(network: Network) -> int | None:
    """Return the number of contacts in the smallest odd loop, a closed chain of an odd number of contacts; None if
    there is none or the network is too large.

    network : the spheres and contacts of a sample.

    An odd loop through a sphere is a path in the double cover from the sphere to its other copy. The double cover is a
    graph with two copies of each sphere, in which each contact joins opposite copies.
    """
    count, has_odd_loops = network.spheres, network.sublattices[0]
    if not has_odd_loops.any():
        return None
    one_way = sparse.csr_array((np.ones(network.contacts, dtype=np.int8), tuple(network.contact)), shape=(count, count))
    adjacent = ((one_way + one_way.T) > 0).astype(np.int64)
    if (adjacent @ adjacent).multiply(adjacent).nnz:  # two neighbours of a sphere touch: a triangle
        return 3
    starts = np.flatnonzero(has_odd_loops)
    if len(starts) > MOST_LOOPS:
        return None
    cover = sparse.csr_array(sparse.block_array([[None, adjacent], [adjacent, None]]), dtype=np.float64)
    # some odd loop, found by a breadth-first search, limits the length of the other searches
    first = int(starts[0])
    _, predecessor = breadth_first_order(cover, first)
    here, shortest = first + count, 0.0
    while here != first:
        here, shortest = int(predecessor[here]), shortest + 1
    # the shortest path from each sphere to its other copy, several searches at a time
    for begin in range(0, len(starts), CHUNK):
        chunk = starts[begin : begin + CHUNK]
        distance = dijkstra(cover, indices=chunk, unweighted=True, limit=shortest)
        shortest = min(shortest, float(distance[np.arange(len(chunk)), chunk + count].min()))
    return int(shortest)


def slipless_number(network: Network, free: np.ndarray) -> tuple[int | None, str]:
    """Return the number of independent slipless motions (spins at which no contact slips), None if it cannot be
    decided, and words for how it was found.

    network : the spheres and contacts of a sample.
    free : (spheres N,), mask of the spheres that may rotate; the others are at rest.
    """
    contact = np.flatnonzero(free[network.contact].any(axis=0))
    return _motions(network, free, contact, range(network.components))[1:]


def self_stress_of(network: Network, contact: np.ndarray, components: Sequence[int]) -> int | None:
    """Return the number of states of self-stress, independent forces on some contacts that balance on all free spheres
    by themselves; None where rounding leaves the number undecided.

    network : the spheres and contacts of a sample.
    contact : numbers of the contacts that bear forces.
    components : numbers of the spin components in which torques are balanced.
    """
    free = np.zeros(network.spheres, dtype=bool)
    free[network.contact[:, contact]] = True
    free &= network.free
    slips, motions, _ = _motions(network, free, contact, components)
    # balance of torques is the transposed matrix: its rank is the number of spins less that of slipless motions
    forces = int((abs(slips).sum(axis=1) > 0).sum())
    return None if motions is None else forces - (slips.shape[1] - motions)


def _motions(
    network: Network, free: np.ndarray, contact: np.ndarray, components: Sequence[int]
) -> tuple[sparse.csr_array, int | None, str]:
    """Return three things: the matrix that turns spins into slips; the number of slipless motions (spins at which none
    of some contacts slips), None if it cannot be decided; and words for how it was found.

    network : the spheres and contacts of a sample.
    free : (spheres N,), mask of the spheres that may rotate.
    contact : numbers of the contacts that must not slip.
    components : numbers of the spin components that may be other than 0.
    """
    # the motions are the kernel of the operator: by singular values if it is small, else by sparse elimination
    column = np.full((network.spheres, network.components), -1)  # of each component of a spin; -1 if it is 0
    unknowns = int(free.sum()) * len(components)
    column[np.ix_(free, np.array(components))] = np.arange(unknowns).reshape(-1, len(components))
    slips = network.operator(contact, column)
    if unknowns <= DENSE_UNKNOWNS:
        sizes = np.linalg.svd(slips.toarray(), compute_uv=False) if min(slips.shape) else np.zeros(0)
        return slips, unknowns - int((sizes > RANK * sizes.max(initial=0.0)).sum()), "singular values"
    if unknowns > MOST_UNKNOWNS:
        return slips, None, f"not decided: more than {MOST_UNKNOWNS:,} unknowns"
    motions = network.motions(slips, np.repeat(np.flatnonzero(free), len(components)), contact, free)
    if not motions.number_is_certain:
        return slips, None, "not decided: some motions slip by little more than rounding"
    return slips, motions.number, "elimination"
