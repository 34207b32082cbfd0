"""What a packing is before anything is solved: loops, loose parts, and the spins at which nothing slips."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components, dijkstra

from taichi_bearings.packing.motions import MOST_UNKNOWNS, order_of, slipless_motions
from taichi_bearings.packing.packing import Packing
from taichi_bearings.packing.system import odd_parts, slips_of

MOST_LOOPS = 20_000  # spheres in parts with odd loops up to which the smallest one is looked for
CHUNK = 256
DENSE_UNKNOWNS = 600  # up to which the rank is found by singular values
RANK = 1e-9  # of the largest singular value


@dataclass(frozen=True)
class Structure:
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


def structure_of(packing: Packing) -> Structure:
    """Look through a packing; its coefficients play no part."""
    count, held = packing.spheres, packing.driven >= 0
    parts, label = connected_components(_graph(packing), directed=False)
    touched = np.zeros(parts, dtype=bool)
    touched[label[held]] = True
    degree = np.bincount(packing.contact.ravel(), minlength=count)
    sizes = np.bincount(label, minlength=parts)
    odd = odd_parts(count, *packing.contact.T)[0]
    free, by = slipless_number(packing, ~held)
    whole, _ = slipless_number(packing, np.ones(count, dtype=bool))
    return Structure(
        count, packing.contacts, int(held.sum()), len(np.unique(packing.driven[held])), int(parts),
        int((~touched & (sizes > 1)).sum()), int(((degree == 0) & ~held).sum()), int(((degree == 1) & ~held).sum()),
        not odd.any(), smallest_odd_loop(packing), free, whole, by,
    )  # fmt: skip


def _graph(packing: Packing) -> sparse.csr_array:
    ones = np.ones(packing.contacts, dtype=np.int8)
    return sparse.csr_array((ones, tuple(packing.contact.T)), shape=(packing.spheres,) * 2)


def smallest_odd_loop(packing: Packing) -> int | None:
    """Contacts of the smallest odd loop: the shortest way in the double cover from a sphere to its other copy."""
    count = packing.spheres
    inside = odd_parts(count, *packing.contact.T)[0]
    if not inside.any():
        return None
    one = _graph(packing)
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


def slipless_number(packing: Packing, free: np.ndarray) -> tuple[int | None, str]:
    """Number of slipless motions of the spheres that are `free`, (N,), the others at rest; and how it was found."""
    components = 1 if packing.dimension == 2 else 3
    contact = np.flatnonzero(free[packing.contact].any(axis=1))
    return _motions(packing, free, contact, range(components))[1:]


def self_stress_of(packing: Packing, contact: np.ndarray, components: Sequence[int]) -> int | None:
    """How many independent forces of these contacts, (n,) numbers, are in balance on all free spheres, in these
    components of the spins; None where rounding leaves it open."""
    free = np.zeros(packing.spheres, dtype=bool)
    free[packing.contact[contact]] = True
    free &= packing.driven < 0
    slips, motions, _ = _motions(packing, free, contact, components)
    forces = int((abs(slips).sum(axis=1) > 0).sum())
    return None if motions is None else forces - (slips.shape[1] - motions)


def _motions(
    packing: Packing, free: np.ndarray, contact: np.ndarray, components: Sequence[int]
) -> tuple[sparse.csr_array, int | None, str]:
    """Slips of contacts by spins of `free` spheres, (N,), in these components, the slipless motions, how they were
    found."""
    moved = np.full((packing.spheres, 1 if packing.dimension == 2 else 3), -1)
    unknowns = int(free.sum()) * len(components)
    moved[np.ix_(free, np.array(components))] = np.arange(unknowns).reshape(-1, len(components))
    slips = slips_of(packing, contact, moved)
    if unknowns <= DENSE_UNKNOWNS:
        sizes = np.linalg.svd(slips.toarray(), compute_uv=False) if min(slips.shape) else np.zeros(0)
        return slips, unknowns - int((sizes > RANK * sizes.max(initial=0.0)).sum()), "singular values"
    if unknowns > MOST_UNKNOWNS:
        return slips, None, f"not decided: more than {MOST_UNKNOWNS:,} unknowns"
    sphere, parts = np.repeat(np.flatnonzero(free), len(components)), order_of(packing, contact, free)
    motions = slipless_motions(slips, sphere, parts)
    if not motions.counted:
        return slips, None, "not decided: some motions slip by little more than rounding"
    return slips, motions.number, "elimination"
