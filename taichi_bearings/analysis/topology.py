"""What a network of contacts is before anything is solved: its loops, its loose parts, and the spins at which nothing
slips."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, dijkstra

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.numerics.motions import MOST_UNKNOWNS
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.network import Network

MOST_LOOPS = 20_000  # spheres in parts with odd loops up to which the smallest one is looked for
CHUNK = 256
DENSE_UNKNOWNS = 600  # up to which the rank is found by singular values
RANK = 1e-9  # of the largest singular value


@dataclass(frozen=True)
class Topology:
    """spheres, contacts, driven, bodies : numbers. parts : connected ones. floating : parts with no driven sphere, and
    rattlers : spheres without contact; free_dangling : free spheres with one contact.

    bipartite : True if no loop is odd: neighbours can turn against each other everywhere. smallest_odd_loop : its
    contacts; None if there is none or if it was not looked for.
    free_motions, all_motions : number of slipless motions of the free spheres with the driven at rest, and of all
    spheres; None where the network is too large, or rounding leaves it open. decided_by : how, in words.
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
    """What the contacts of a bearing alone say of it; its coefficients play no part."""
    network = bearing.network
    count, held = network.spheres, ~network.free
    label = pieces(count, *network.contact)
    sizes = np.bincount(label)
    parts = len(sizes)
    touched = np.zeros(parts, dtype=bool)
    touched[label[held]] = True
    degree = np.bincount(network.contact.ravel(), minlength=count)
    free, by = slipless_number(network, ~held)
    whole, _ = slipless_number(network, np.ones(count, dtype=bool))
    return Topology(
        count, network.contacts, int(held.sum()), len(network.bodies), parts,
        int((~touched & (sizes > 1)).sum()), int(((degree == 0) & ~held).sum()), int(((degree == 1) & ~held).sum()),
        not network.sublattices[0].any(), smallest_odd_loop(network), free, whole, by,
    )  # fmt: skip


def smallest_odd_loop(network: Network) -> int | None:
    """Contacts of the smallest odd loop: the shortest way in the double cover from a sphere to its other copy."""
    count, inside = network.spheres, network.sublattices[0]
    if not inside.any():
        return None
    one = sparse.csr_array((np.ones(network.contacts, dtype=np.int8), tuple(network.contact)), shape=(count, count))
    both = ((one + one.T) > 0).astype(np.int64)
    if (both @ both).multiply(both).nnz:
        return 3
    starts = np.flatnonzero(inside)
    if len(starts) > MOST_LOOPS:
        return None
    cover = sparse.csr_array(sparse.block_array([[None, both], [both, None]]), dtype=np.float64)
    first, best = int(starts[0]), 2.0 * count + 1
    _, before = breadth_first_order(cover, first)
    here, best = first + count, 0.0
    while here != first:
        here, best = int(before[here]), best + 1
    for begin in range(0, len(starts), CHUNK):
        own = starts[begin : begin + CHUNK]
        far = dijkstra(cover, indices=own, unweighted=True, limit=best)
        best = min(best, float(far[np.arange(len(own)), own + count].min()))
    return int(best)


def slipless_number(network: Network, free: np.ndarray) -> tuple[int | None, str]:
    """Number of slipless motions of the spheres that are `free`, (N,), the others at rest; and how it was found."""
    contact = np.flatnonzero(free[network.contact].any(axis=0))
    return _motions(network, free, contact, range(network.components))[1:]


def self_stress_of(network: Network, contact: np.ndarray, components: Sequence[int]) -> int | None:
    """How many independent forces of these contacts, (n,) numbers, are in balance on all free spheres, in these
    components of the spins; None where rounding leaves it open."""
    free = np.zeros(network.spheres, dtype=bool)
    free[network.contact[:, contact]] = True
    free &= network.free
    slips, motions, _ = _motions(network, free, contact, components)
    forces = int((abs(slips).sum(axis=1) > 0).sum())
    return None if motions is None else forces - (slips.shape[1] - motions)


def _motions(
    network: Network, free: np.ndarray, contact: np.ndarray, components: Sequence[int]
) -> tuple[sparse.csr_array, int | None, str]:
    """Slips of contacts by spins of `free` spheres, (N,), in these components, the slipless motions, how they were
    found."""
    moved = np.full((network.spheres, network.components), -1)
    unknowns = int(free.sum()) * len(components)
    moved[np.ix_(free, np.array(components))] = np.arange(unknowns).reshape(-1, len(components))
    slips = network.operator(contact, moved)
    if unknowns <= DENSE_UNKNOWNS:
        sizes = np.linalg.svd(slips.toarray(), compute_uv=False) if min(slips.shape) else np.zeros(0)
        return slips, unknowns - int((sizes > RANK * sizes.max(initial=0.0)).sum()), "singular values"
    if unknowns > MOST_UNKNOWNS:
        return slips, None, f"not decided: more than {MOST_UNKNOWNS:,} unknowns"
    motions = network.motions(slips, np.repeat(np.flatnonzero(free), len(components)), contact, free)
    if not motions.number_is_certain:
        return slips, None, "not decided: some motions slip by little more than rounding"
    return slips, motions.number, "elimination"
