"""Who touches whom: spheres or discs at fixed places, their contacts, and what follows from these alone.

With u = R omega the slip at a contact with unit normal n, from the first to the second sphere, is -(u_i + u_j) x n.
Along two tangents across n, of discs along one, it is y = T (u_i + u_j): the sparse operator K takes spins to slips
without their direction, and its transpose takes forces to torques over the radius.

Letters: N spheres, E contacts, D = 2 or 3 dimensions, C spin components (of discs 1, of spheres 3), d = C - 1 tangents
of spheres and 1 of discs. "contact" as an argument is (n,), numbers of the contacts that are meant.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.dissection import dissected
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.incidence import contact_differences, torques
from taichi_bearings.numerics.graphs import odd_pieces, pieces
from taichi_bearings.numerics.motions import Motions, Parts, slipless_motions
from taichi_bearings.read_only import cached_read_only, read_only

PERRON_STEPS, LEAST_SHARE = 30, 1e-3  # of the vector that bounds an eigenvalue: improvements, and its smallest entries
LEAF_SPHERES = 8  # of a region that nested dissection does not divide further


OF_LATTICE: dict[str, Callable[[Lattice], np.ndarray]] = {
    "center": lambda lattice: 2 * lattice.radius * np.argwhere(np.ones(lattice.shape, dtype=bool)),
    "radius": lambda lattice: np.full(lattice.sites, lattice.radius),
    "contact": lambda lattice: lattice.ends,
    "normal": lambda lattice: np.eye(lattice.dimension)[lattice.axis],
    "body": lambda lattice: lattice.driven.ravel(),
}
"""The arrays of a network whose contacts are those of a lattice. Driven are its bottom, body 0, and its top, body 1."""


@dataclass(frozen=True, eq=False)
class Network:
    """Spheres and their contacts; arrays are read-only.

    center : (N, D), length. radius : (N,), length. contact : (2, E), the first and the second sphere of each contact.
    normal : (E, D), unit vectors from the first to the second sphere. body : (N,), -1 for a free sphere, else the
    number of its driven body. lattice : where the contacts are those of a lattice, what knows their strides.
    """

    center: np.ndarray
    radius: np.ndarray
    contact: np.ndarray
    normal: np.ndarray
    body: np.ndarray
    lattice: Lattice | None = None

    @classmethod
    def of(cls, lattice: Lattice) -> "Network":
        """The spheres and contacts of a lattice; each array is made when it is first asked for."""
        found = object.__new__(cls)
        vars(found)["lattice"] = lattice
        return found

    def __getattr__(self, name: str) -> np.ndarray:
        if name not in OF_LATTICE:
            raise AttributeError(f"a network has no attribute {name!r}")
        values = vars(self)[name] = read_only(OF_LATTICE[name](vars(self)["lattice"]))
        return values

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of arrays over the spheres as users have them: that of a lattice, else (N,)."""
        return (len(self.body),) if self.lattice is None else self.lattice.shape

    @property
    def spheres(self) -> int:
        """N."""
        return len(self.body)

    @property
    def contacts(self) -> int:
        """E."""
        return int(self.contact.shape[1])

    @property
    def dimension(self) -> int:
        """D."""
        return int(self.center.shape[1]) if self.lattice is None else self.lattice.dimension

    @property
    def components(self) -> int:
        """C."""
        return 1 if self.dimension == 2 else 3

    @cached_read_only
    def free(self) -> np.ndarray:
        """(N,) True for the spheres that nothing drives."""
        return self.body < 0

    @cached_read_only
    def is_driven(self) -> np.ndarray:
        """True for the spheres whose spin is imposed, in the shape that arrays over the spheres have."""
        return ~self.free if self.lattice is None else self.lattice.is_driven

    @cached_read_only
    def bodies(self) -> np.ndarray:
        """Numbers of the driven bodies."""
        return np.unique(self.body[~self.free])

    @cached_read_only
    def has_free_end(self) -> np.ndarray:
        """(E,) True for the contacts that can slip: those that do not join two driven spheres."""
        return self.free[self.contact].any(axis=0) if self.lattice is None else ~self.lattice.between_driven

    @cached_read_only
    def tangents(self) -> np.ndarray:
        """Unit vectors (d, E, C) that span the slips: two across each normal of spheres, 1 for discs."""
        if self.dimension == 2:
            return np.ones((1, self.contacts, 1))
        axis = np.eye(3)[np.argmin(np.abs(self.normal), axis=1)]
        first = np.cross(self.normal, axis)
        first /= np.linalg.norm(first, axis=1)[:, None]
        return np.stack([first, np.cross(self.normal, first)])

    @cached_read_only
    def sublattices(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) True in pieces with odd loops; and signs (N,) by which neighbours differ in the other pieces."""
        return odd_pieces(self.spheres, *self.contact)

    def across(self, vectors: np.ndarray, contact: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(n,) sizes of vectors (n, C) across the normals of these contacts; of discs all of them."""
        turned = vectors if self.dimension == 2 else np.cross(vectors, self.normal[contact])
        return np.asarray(np.linalg.norm(turned, axis=1))

    def slips(self, u: np.ndarray) -> np.ndarray:
        """(E,) slip speeds of u = R omega (N, C); length/time."""
        return self.across(u[self.contact].sum(axis=0))

    def operator(self, contact: np.ndarray, unknown: np.ndarray) -> sparse.csr_array:
        """K (d * n, unknowns): y = T (u_i + u_j) of these contacts, first along their first tangents.

        unknown : (N, C), the column of each component of a spin, -1 for one that has none.
        """
        across = self.tangents[:, contact]
        d, count, components = across.shape
        rows, columns, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
        for end in self.contact[:, contact]:
            column = unknown[end]  # (n, C)
            for k in range(components):
                moves = np.flatnonzero(column[:, k] >= 0)
                for t in range(d):
                    rows.append(t * count + moves)
                    columns.append(column[moves, k])
                    values.append(across[t, moves, k])
        value, row, column = (np.concatenate(part) for part in (values, rows, columns))
        return sparse.csr_array((value, (row, column)), shape=(d * count, int(unknown.max(initial=-1)) + 1))

    @cached_property
    def whole(self) -> sparse.csr_array:
        """K (d * E, N * C) of all contacts and all spins; column = sphere * C + component."""
        every = np.arange(self.spheres * self.components).reshape(-1, self.components)
        return self.operator(np.arange(self.contacts), every)

    @cached_property
    def whole_transposed(self) -> sparse.csr_array:
        return self.whole.T.tocsr()

    def differences(self, spins: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Vectors (d, R, E) across all contacts, whose length is the slip.

        spins : (C, R, *N). Of a lattice staggered spins with components as named by `spin_axes`, whose differences are
        taken by strides; else u = R omega in all components, and y = K u.
        """
        if self.lattice is not None:
            return contact_differences(spins, self.lattice, spin_axes)
        columns = np.moveaxis(spins, 2, 0).reshape(-1, spins.shape[1])
        shape = self.dimension - 1, self.contacts, spins.shape[1]
        return (self.whole @ columns).reshape(shape).transpose(0, 2, 1)

    def pulls(self, force: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Minus the transpose of :meth:`differences`: sums of the contact forces (d, R, E) that pull on each sphere,
        (C, R, *N)."""
        if self.lattice is not None:
            return torques(force, self.lattice, spin_axes)
        columns = np.moveaxis(force, 1, 2).reshape(-1, force.shape[1])
        shape = self.spheres, self.components, force.shape[1]
        return -(self.whole_transposed @ columns).reshape(shape).transpose(1, 2, 0)

    def largest_eigenvalue(self, weight: np.ndarray, inertia: np.ndarray) -> float:
        """No eigenvalue of M^-1 K^T W K over the free spheres is larger. weight : W, (E,). inertia : M, (N,).

        Of a matrix A none exceeds max (|A| x)_i / x_i, for any x > 0 (Gershgorin's circles are x = 1; Collatz and
        Wielandt); x is brought near the vector for which that is least.
        """
        scale = np.repeat(np.where(self.free, 1 / np.sqrt(inertia), 0.0), self.components)
        rows = np.tile(np.sqrt(weight), len(self.tangents))
        half = sparse.diags_array(rows) @ self.whole @ sparse.diags_array(scale)
        size = abs(half.T.tocsr() @ half)
        vector, least = np.ones(size.shape[0]), np.inf
        for _ in range(PERRON_STEPS):
            image = size @ vector
            least = min(least, float((image / vector).max(initial=0.0)))
            if least == 0:
                break
            vector = np.maximum(image / image.max(), LEAST_SHARE)
        return least * (1 + 1e-9)

    def along_axes(self, contact: np.ndarray) -> bool:
        """True where components do not mix: discs, or normals along the axes at these contacts."""
        return self.dimension == 2 or bool(((self.normal[contact] != 0).sum(axis=1) == 1).all())

    def reached(self, contact: np.ndarray) -> np.ndarray:
        """(N,) True for free spheres of pieces, joined by these contacts, that touch a driven sphere."""
        first, second = self.contact[:, contact]
        inner = self.free[first] & self.free[second]
        label = pieces(self.spheres, first[inner], second[inner])
        touched = np.zeros(self.spheres, dtype=bool)  # by label
        for end, other in ((first, second), (second, first)):
            touched[label[end[self.free[end] & ~self.free[other]]]] = True
        return self.free & touched[label]

    def needed(
        self, imposed: np.ndarray, contact: np.ndarray, moves: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, int | None]:
        """Which components of spins a minimum needs: u (N, C) of driven spheres and of components that slip nowhere;
        mask (N, C) of what is to be found; and how many motions slip nowhere, one spin of each held at 0, None where
        normals are oblique.

        Where normals lie along the axes, components meet in the norms of the slips alone, so a component that can turn
        without any slip does so at a minimum: along it no driven spheres of a piece differ but by the sign of a
        sublattice. A piece without driven spheres and odd loops has a motion.

        imposed : u (N, C) of driven spheres, 0 of others. moves : (N,) mask of the spheres whose spins are asked for.
        """
        known, wanted = imposed.copy(), np.tile(moves[:, None], imposed.shape[1])
        if not self.along_axes(contact):
            return known, wanted, None
        number, held = 0, ~self.free
        for k in range(wanted.shape[1]) if self.dimension == 3 else ():
            ends = self.contact[:, contact[self.normal[contact, k] == 0]]
            odd, sign = odd_pieces(self.spheres, *ends)
            label = pieces(self.spheres, *ends)
            turned = sign * imposed[:, k]
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

    def order(self, contact: np.ndarray, free: np.ndarray) -> Parts:
        """An order of elimination of all spheres from their centres, by these contacts between `free` spheres, (N,)."""
        ends = self.contact[:, contact]
        first, second = np.sort(ends[:, free[ends].all(axis=0)], axis=0)
        size = (self.spheres,) * 2
        once = sparse.csr_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=size)
        graph = sparse.csr_array(once + once.T)
        return [(part.nodes, part.children) for part in dissected(graph, self.center.T, LEAF_SPHERES)]

    def motions(self, slips: sparse.csr_array, sphere: np.ndarray, contact: np.ndarray, free: np.ndarray) -> Motions:
        """Spins that make none of these slips, (rows, unknowns).

        sphere : (unknowns,) that each belongs to. contact, free : as of :meth:`order`.
        """
        return slipless_motions(slips, sphere, self.order(contact, free))
