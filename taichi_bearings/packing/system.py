"""What there is to find: the free spins that contacts with driven ones reach, and the slips that they make."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.packing.motions import order_of, slipless_motions
from taichi_bearings.packing.packing import Packing


def tangents(normal: np.ndarray) -> np.ndarray:
    """Unit vectors (d, E, C) that span the slips of contacts: two across each normal of spheres, 1 for discs."""
    if normal.shape[1] == 2:
        return np.ones((1, len(normal), 1))
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(normal, axis)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normal, first)])


def slips_of(packing: Packing, contact: np.ndarray, moved: np.ndarray) -> sparse.csr_array:
    """K (d * E, unknowns): y = T (u_i + u_j) of these contacts, (E,) numbers, for spins numbered as `moved` (N, C) has
    them, -1 where they are none."""
    assert packing.normal is not None
    across = tangents(packing.normal[contact])
    d, count, components = across.shape
    rows, columns, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    for end in packing.contact[contact].T:
        unknown = moved[end]  # (E, C)
        for k in range(components):
            known = unknown[:, k] >= 0
            for t in range(d):
                rows.append(t * count + np.flatnonzero(known))
                columns.append(unknown[known, k])
                values.append(across[t, known, k])
    parts = (np.concatenate(part) for part in (values, rows, columns))
    value, row, column = parts
    return sparse.csr_array((value, (row, column)), shape=(d * count, int(moved.max(initial=-1)) + 1))


@dataclass(frozen=True)
class System:
    """The contacts that act, (A,), and the unknowns: spins of free spheres, by component, that have to be found.

    packing. contact : (A,) numbers of contacts with a coefficient and a free end, in parts that touch a driven sphere.
    moved : (N, C) number of each unknown, -1 where the spin is imposed, or held at 0. motions : number of slipless ones
    before some were held; None if undecided. sphere : (unknowns,).
    known : (N, C), u of spheres and components that are no unknowns. matrix : K. offset : b, (d, A), of the known
    spins. coefficients : (A,) each.
    """

    packing: Packing
    contact: np.ndarray
    moved: np.ndarray
    motions: int | None
    sphere: np.ndarray
    known: np.ndarray
    matrix: sparse.csr_array
    offset: np.ndarray
    coefficients: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, packing: Packing) -> "System":
        contact = acting(packing)
        free = packing.driven < 0
        first, second = packing.contact[contact].T
        inner = free[first] & free[second]
        label = components_of(packing.spheres, first[inner], second[inner])
        joined = np.zeros(packing.spheres, dtype=bool)  # by label
        for end, other in ((first, second), (second, first)):
            joined[label[end[free[end] & ~free[other]]]] = True
        moves = free & joined[label]
        contact = contact[moves[first] | moves[second]]
        known, wanted, number = _without_slip(packing, contact, moves)
        moved = _numbered(wanted)
        if number is None:
            parts = order_of(packing, contact, moves)
            found = slipless_motions(slips_of(packing, contact, moved), np.nonzero(wanted)[0], parts)
            number = found.number if found.counted else None
            wanted &= ~np.isin(moved, found.held)
            moved = _numbered(wanted)
        spins = known[packing.contact[contact]].sum(axis=1)  # (A, C)
        offset = np.einsum("tek,ek->te", tangents(packing.normal[contact]), spins)  # type: ignore[index]
        of = tuple(values[contact] for values in packing.coefficients)
        matrix = slips_of(packing, contact, moved)
        return cls(packing, contact, moved, number, np.nonzero(wanted)[0], known, matrix, offset, of)

    @property
    def unknowns(self) -> int:
        return len(self.sphere)

    @property
    def place(self) -> np.ndarray:
        """(D, unknowns), the centres of their spheres."""
        return np.asarray(self.packing.center[self.sphere].T)

    @cached_property
    def across(self) -> np.ndarray:
        """(d, A, C)."""
        return tangents(self.packing.normal[self.contact])  # type: ignore[index]

    @cached_property
    def felt(self) -> np.ndarray:
        """(A, C), True for the components of spins that move and make a contact slip."""
        return np.any(self.across, axis=0) & np.any(self.moved >= 0, axis=0)

    def difference(self, spins: np.ndarray) -> np.ndarray:
        """y = K u + b, (d, A)."""
        return (self.matrix @ spins).reshape(self.offset.shape) + self.offset

    def all_spins(self, spins: np.ndarray) -> np.ndarray:
        """u of all spheres, (N, C)."""
        return np.where(self.moved >= 0, np.append(spins, 0.0)[self.moved], self.known)


@dataclass(frozen=True)
class Found:
    """What a method has found. spins (unknowns,), force (d, A) in units of force. steps : factorisations. rest :
    (unknowns,), what rounding leaves out of the spins.

    slips : (A,), of contacts that are settled, but for some that are `open`, (A,), and slip by more than rounding,
    though less than friction allows; and there ties : (A,) those that are not the same at all minima, or bear all their
    friction at rest, if that is known. everywhere : u (N, C) of all spheres, where a method moves all.
    """

    spins: np.ndarray
    force: np.ndarray
    method: str
    slips: np.ndarray | None = None
    ties: np.ndarray | None = None
    steps: int = 0
    everywhere: np.ndarray | None = None
    open: np.ndarray | None = None
    rest: np.ndarray | None = None


def along_axes(packing: Packing, contact: np.ndarray) -> bool:
    """True where components do not mix: discs, or normals along the axes at these contacts, (A,)."""
    normal = packing.normal[contact]  # type: ignore[index]
    return packing.dimension == 2 or bool(((normal != 0).sum(axis=1) == 1).all())


def needed_components(packing: Packing) -> tuple[np.ndarray, np.ndarray]:
    """Spins u (N, C) at which the components that are not needed slip nowhere; and (C,) True for those that are needed:
    all but those that can turn without any slip where normals lie along the axes."""
    known, wanted, _ = _without_slip(packing, acting(packing), packing.driven < 0)
    return known, np.asarray(wanted.any(axis=0))


def _numbered(wanted: np.ndarray) -> np.ndarray:
    """Number of each True one, -1 of the others."""
    return np.where(wanted, np.cumsum(wanted).reshape(wanted.shape) - 1, -1)


def _without_slip(
    packing: Packing, contact: np.ndarray, moves: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int | None]:
    """u (N, C) of driven spheres and of components that slip nowhere; mask (N, C) of what is to be found; and how many
    motions slip nowhere, one spin of each held at 0; None where normals are oblique.

    Where normals lie along the axes, components meet in the norms of the slips alone, so a component that can turn
    without any slip does so at a minimum: along it no driven spheres of a part differ but by the sign of a sublattice.
    A part without driven spheres and odd loops has a motion.
    """
    known, wanted = packing.imposed.copy(), np.tile(moves[:, None], packing.imposed.shape[1])
    if not along_axes(packing, contact):
        return known, wanted, None
    number, held = 0, packing.driven >= 0
    for k in range(wanted.shape[1]) if packing.dimension == 3 else ():
        ends = packing.contact[contact[packing.normal[contact, k] == 0]]  # type: ignore[index]
        odd, sign = odd_parts(packing.spheres, *ends.T)
        label = components_of(packing.spheres, *ends.T)
        turned = sign * packing.imposed[:, k]
        low, high = np.full(label.max() + 1, np.inf), np.full(label.max() + 1, -np.inf)
        np.minimum.at(low, label[held], turned[held])
        np.maximum.at(high, label[held], turned[held])
        loose = np.isinf(low)
        turning = np.flatnonzero(moves & loose[label] & ~odd)
        first = turning[np.unique(label[turning], return_index=True)[1]]
        number += len(first)
        if (low < high).any() or (odd[held] & (turned[held] != 0)).any():
            wanted[first, k] = False
        else:
            wanted[:, k] = False
            known[moves, k] = (np.where(loose, 0.0, low)[label] * np.where(odd, 0.0, sign))[moves]
    return known, wanted, number


def odd_parts(count: int, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(count,) True for nodes of parts with odd loops; and signs (count,) by which neighbours differ in other parts.

    A part has an odd loop if its two copies in the double cover are joined.
    """
    ends = np.concatenate([first, second]), np.concatenate([second, first]) + count
    cover = sparse.csr_array((np.ones(len(ends[0]), dtype=np.int8), ends), shape=(2 * count, 2 * count))
    label = connected_components(cover, directed=False)[1]
    odd, mirrored = label[:count] == label[count:], label[:count] > label[count:]
    return odd, np.where(mirrored, -1, 1)


def acting(packing: Packing) -> np.ndarray:
    """Numbers of the contacts with a coefficient that have a free end."""
    free = packing.driven < 0
    some = np.any([values > 0 for values in packing.coefficients], axis=0)
    return np.flatnonzero(some & free[packing.contact].any(axis=1))


def components_of(spheres: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    graph = sparse.csr_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(spheres, spheres))
    return np.asarray(connected_components(graph, directed=False)[1])
