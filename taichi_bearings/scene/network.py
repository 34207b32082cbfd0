"""The spheres or discs of a bearing at their fixed places, their contacts, and what follows from these alone.

With u = R omega (R the radius, omega the spin) the slip at a contact with unit normal n, from the first sphere i to the
second sphere j, is -(u_i + u_j) x n. Along two tangents across n, or one for discs, it is y = T (u_i + u_j), up to a
rotation about n that does not change its size. The sparse matrix K has these rows for all contacts: y = K u. Its
transpose turns contact forces into torques over the radius.

Letters: N spheres (*N the shape of arrays over them: that of a lattice, or (N,)), E contacts, D = 2 or 3 dimensions,
C spin components (1 of discs, 3 of spheres), d tangents (1 of discs, 2 of spheres), R samples in shapes.
contact : as an argument, (n,) numbers of contacts. driven body : a set of driven spheres with a number, from 0.
piece : a connected part of the network. odd loop : a closed chain of an odd number of contacts; in a piece without odd
loops spheres have signs, +1 or -1, that differ across every contact: the sublattices.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from taichi_bearings.dissection import dissected
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import friction_by_axis
from taichi_bearings.lattice.incidence import contact_differences, torques
from taichi_bearings.numerics.graphs import odd_pieces, pieces
from taichi_bearings.numerics.motions import Motions, Parts, slipless_motions
from taichi_bearings.read_only import cached_read_only, read_only

PERRON_STEPS = 30  # steps by which the vector that bounds the largest eigenvalue is improved
LEAST_SHARE = 1e-3  # smallest entry of that vector, relative to its largest
LEAF_SPHERES = 8  # nested dissection divides no region with so few spheres


OF_LATTICE: dict[str, Callable[[Lattice], np.ndarray]] = {
    "center": lambda lattice: 2 * lattice.radius * np.argwhere(np.ones(lattice.shape, dtype=bool)),
    "radius": lambda lattice: np.full(lattice.sites, lattice.radius),
    "contact": lambda lattice: lattice.ends,
    "normal": lambda lattice: np.eye(lattice.dimension)[lattice.axis],
    "body": lambda lattice: lattice.driven.ravel(),
}
"""Functions that make the arrays of a network from a lattice, by field. The bottom is body 0, and the top is body 1."""


@dataclass(frozen=True, eq=False)
class Network:
    """Spheres and their contacts, at fixed places, and which spheres are driven; arrays are read-only.

    center : (spheres N, dimensions D), length.
    radius : (N,), length.
    contact : (2, contacts E), numbers of the first and the second sphere of each contact.
    normal : (E, D), unit vectors from the first to the second sphere.
    body : (N,), number of the driven body of each sphere, -1 for free spheres.
    lattice : the lattice whose contacts these are, None for other packings.
    """

    center: np.ndarray
    radius: np.ndarray
    contact: np.ndarray
    normal: np.ndarray
    body: np.ndarray
    lattice: Lattice | None = None

    @classmethod
    def of(cls, lattice: Lattice) -> "Network":
        """Return the network of a lattice; each of its arrays is made when it is first asked for."""
        found = object.__new__(cls)
        vars(found)["lattice"] = lattice
        return found

    def __getattr__(self, name: str) -> np.ndarray:
        """Return an array of the network of a lattice when it is asked for the first time, and store it for later."""
        if name not in OF_LATTICE:
            raise AttributeError(f"a network has no attribute {name!r}")
        values = vars(self)[name] = read_only(OF_LATTICE[name](vars(self)["lattice"]))
        return values

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape *N of arrays over the spheres: that of the lattice, or (spheres N,)."""
        return (len(self.body),) if self.lattice is None else self.lattice.shape

    @property
    def periodic(self) -> tuple[int, ...]:
        """Numbers of the axes along which a lattice closes on itself; none in other packings."""
        return () if self.lattice is None else self.lattice.periodic

    @property
    def spheres(self) -> int:
        """Number N of spheres."""
        return len(self.body)

    @property
    def contacts(self) -> int:
        """Number E of contacts."""
        return int(self.contact.shape[1])

    @property
    def dimension(self) -> int:
        """Number D of dimensions, 2 or 3."""
        return int(self.center.shape[1]) if self.lattice is None else self.lattice.dimension

    @property
    def components(self) -> int:
        """Number C of spin components: 1 for discs, 3 for spheres."""
        return 1 if self.dimension == 2 else 3

    @cached_read_only
    def free(self) -> np.ndarray:
        """(spheres N,) mask of the free spheres, those whose spin is not imposed."""
        return self.body < 0

    @cached_read_only
    def is_driven(self) -> np.ndarray:
        """(spheres *N) mask of the spheres whose spin is imposed."""
        return ~self.free if self.lattice is None else self.lattice.is_driven

    @cached_read_only
    def bodies(self) -> np.ndarray:
        """(bodies,) numbers of the driven bodies that there are, in ascending order."""
        return np.unique(self.body[~self.free])

    @cached_read_only
    def has_free_end(self) -> np.ndarray:
        """(contacts E,) mask of the contacts of which at least one sphere is free."""
        return self.free[self.contact].any(axis=0) if self.lattice is None else ~self.lattice.between_driven

    @cached_read_only
    def tangents(self) -> np.ndarray:
        """(d, contacts E, components C), unit vectors along which the slip of each contact is measured: d = 2 vectors
        at right angles to its normal; for discs d = 1, and the number 1.
        """
        if self.dimension == 2:
            return np.ones((1, self.contacts, 1))
        axis = np.eye(3)[np.argmin(np.abs(self.normal), axis=1)]
        first = np.cross(self.normal, axis)
        first /= np.linalg.norm(first, axis=1)[:, None]
        return np.stack([first, np.cross(self.normal, first)])

    @cached_read_only
    def sublattices(self) -> tuple[np.ndarray, np.ndarray]:
        """Two arrays (spheres N,). The first is a mask of the spheres in connected pieces with odd loops (closed chains
        of an odd number of contacts). The second has signs, +1 or -1, which differ across each contact of the other
        pieces."""
        return odd_pieces(self.spheres, *self.contact)

    def as_given(self, values: np.ndarray) -> np.ndarray | tuple[np.ndarray, ...]:
        """Return values (..., contacts E) of all contacts in the form in which users give and get them: on a lattice a
        tuple with one array for each axis, (..., *contacts), in other packings as they are.
        """
        return values if self.lattice is None else self.lattice.by_axis(values)

    def named(self, contact: np.ndarray) -> dict[str, np.ndarray]:
        """Return columns (n, ...) that identify contacts in listings, by name: on a lattice the position of the lower
        sphere, `contact`, and the `axis`; in other packings the number of the `contact`, and those of its `spheres`.

        contact : (n,) numbers of the contacts.
        """
        if self.lattice is None:
            return {"contact": contact, "spheres": self.contact[:, contact].T}
        place = np.stack(np.unravel_index(self.contact[0, contact], self.shape), axis=1)
        return {"contact": place, "axis": self.lattice.axis[contact].astype(int)}

    def friction_as_given(self, friction: np.ndarray) -> np.ndarray | tuple[np.ndarray, ...]:
        """Return friction (..., contacts E, 3), in 2D (..., E), of all contacts in the form in which users get it: on a
        lattice a tuple with one array for each axis, (..., *contacts, 3), in other packings as it is.
        """
        return friction if self.lattice is None else friction_by_axis(friction, self.lattice)

    def across(self, vectors: np.ndarray, contact: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Return the lengths (n,) of vectors after their parts along the normals of n contacts are removed.

        vectors : (n, C), one for each contact; in 2D, with C = 1, they are at right angles to the plane and nothing is
            removed.
        contact : numbers of the n contacts, or a slice; by default all.
        """
        turned = vectors if self.dimension == 2 else np.cross(vectors, self.normal[contact])
        return np.asarray(np.linalg.norm(turned, axis=1))

    def slips(self, u: np.ndarray) -> np.ndarray:
        """Return the slip speeds of all contacts, (contacts E,), length/time.

        u : radius * spin of the spheres, (spheres N, components C), length/time.
        """
        return self.across(u[self.contact].sum(axis=0))

    def operator(self, contact: np.ndarray, unknown: np.ndarray) -> sparse.csr_array:
        """Return the sparse matrix K, (d * n, unknowns), that turns unknown spin components into slips: y = K u.

        u is radius * spin. The slips of a contact are the components of u_i + u_j along its d tangents.

        contact : (n,) numbers of contacts. The rows of all their first tangents come first, then those of the second.
        unknown : (spheres N, components C), the column of each component of u; -1 for a component without a column.
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
    def slip_matrix(self) -> sparse.csr_array:
        """The sparse matrix K, (d * E, N * C), that turns radius * spin of all N spheres into the slips of all E
        contacts. Column sphere * C + component is of a spin component of a sphere. Rows are the slips of all contacts
        along their first tangents, then along the second ones: d tangents, 1 of discs, 2 of spheres.
        """
        every = np.arange(self.spheres * self.components).reshape(-1, self.components)
        return self.operator(np.arange(self.contacts), every)

    @cached_property
    def slip_matrix_transposed(self) -> sparse.csr_array:
        """Sparse matrix (N * C, d * E) that turns forces along the d tangents of all E contacts into their sums on all
        N spheres, by spin component: the transpose of `slip_matrix`.
        """
        return self.slip_matrix.T.tocsr()

    def differences(self, spins: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return a vector for each contact, (components d, samples R, contacts E), whose length gives the slip speed.

        * On a lattice it is the difference of the spins of both spheres, 1/time, without its component along the
          contact. Its d = C components are those in `spin_axes`; the slip speed is the radius times its length.
        * In another packing it is the slip itself, length/time. Its d components are along the tangents of the contact:
          1 for discs, 2 for spheres.

        spins : (C, R, spheres *N). On a lattice spins with signs that alternate between neighbours, 1/time; in another
            packing radius * spin in all C components, length/time.
        spin_axes : axes of the C components, as numbers from 0 to 2; not used in a packing.
        """
        if self.lattice is not None:
            return contact_differences(spins, self.lattice, spin_axes)
        columns = np.moveaxis(spins, 2, 0).reshape(-1, spins.shape[1])
        shape = self.dimension - 1, self.contacts, spins.shape[1]
        found: np.ndarray = (self.slip_matrix @ columns).reshape(shape).transpose(0, 2, 1)
        return found

    def pulls(self, force: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return the sum of the contact forces on each sphere, by spin component: (C, samples R, spheres *N). Times the
        radius it is the torque on the sphere. As a linear map it is minus the transpose of :meth:`differences`.

        force : (d, R, contacts E), contact forces by the d components that the vectors of :meth:`differences` have.
        spin_axes : axes of the C components, as numbers from 0 to 2; not used in a packing.
        """
        if self.lattice is not None:
            return torques(force, self.lattice, spin_axes)
        columns = np.moveaxis(force, 1, 2).reshape(-1, force.shape[1])
        shape = self.spheres, self.components, force.shape[1]
        found: np.ndarray = -(self.slip_matrix_transposed @ columns).reshape(shape).transpose(1, 2, 0)
        return found

    def largest_eigenvalue(self, weight: np.ndarray, inertia: np.ndarray) -> float:
        """Return an upper bound on the eigenvalues of M^-1 K^T W K over the free spheres, in units of weight over
        inertia. K turns radius * spin of spheres into slips of contacts; W and M are diagonal.

        weight : diagonal of W, (contacts E,), such as stiffnesses; one number for all tangents of a contact.
        inertia : diagonal of M, (spheres N,): moments of inertia over squared radii, all positive.

        For any vector x > 0 no eigenvalue of a matrix A exceeds the largest (|A| x)_i / x_i (Collatz and Wielandt; x =
        1 gives Gershgorin's circles). Here x comes near the best such vector by steps of the power method.
        """
        # absolute values of M^-1/2 K^T W K M^-1/2, which has the same eigenvalues
        scale = np.repeat(np.where(self.free, 1 / np.sqrt(inertia), 0.0), self.components)
        rows = np.tile(np.sqrt(weight), len(self.tangents))
        half = sparse.diags_array(rows) @ self.slip_matrix @ sparse.diags_array(scale)
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
        """Return True if no slip of these contacts mixes spin components: in 2D, or if all normals lie along the axes.

        contact : (n,) numbers of the contacts.
        """
        return self.dimension == 2 or bool(((self.normal[contact] != 0).sum(axis=1) == 1).all())

    def reached(self, contact: np.ndarray) -> np.ndarray:
        """Return a mask (spheres N,) of the free spheres that chains of contacts connect to a driven sphere.

        contact : (n,) numbers of the contacts that chains may use.
        """
        first, second = self.contact[:, contact]
        inner = self.free[first] & self.free[second]
        label = pieces(self.spheres, first[inner], second[inner])
        touched = np.zeros(self.spheres, dtype=bool)  # by label
        for end, other in ((first, second), (second, first)):
            touched[label[end[self.free[end] & ~self.free[other]]]] = True
        found: np.ndarray = self.free & touched[label]
        return found

    def needed(
        self, imposed: np.ndarray, contact: np.ndarray, moves: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, int | None]:
        """Return which spin components have to be solved for, and the values of those that are known beforehand.

        The three results are

        * known values of u = radius * spin, (spheres N, components C), length/time: those of driven spheres, and those
          of components by which no contact has to slip; 0 elsewhere;
        * a mask (N, C) of the components to be solved for;
        * the number of independent motions without slip, None where normals are oblique, and 0 in 2D. In each such
          motion one spin is set to 0, so that the solution is unique.

        imposed : u (N, C) of driven spheres, 0 of others, length/time.
        contact : (n,) numbers of the contacts to consider.
        moves : (N,) mask of the spheres whose spins are wanted.

        Where normals lie along the axes, each component of the spins adds its square to the squared slip. So if all
        spheres can have values in one component by which no contact slips, they have them at some minimum. That is
        possible if in each connected piece the imposed values, times the sign of the sublattice, agree. In a piece with
        odd loops (closed chains of an odd number of contacts) they have to be 0. A piece without driven spheres and
        without odd loops has one motion without slip.
        """
        known, wanted = imposed.copy(), np.tile(moves[:, None], imposed.shape[1])
        if not self.along_axes(contact):
            return known, wanted, None
        number, held = 0, ~self.free  # motions without slip; mask of driven spheres
        for k in range(wanted.shape[1]) if self.dimension == 3 else ():
            ends = self.contact[:, contact[self.normal[contact, k] == 0]]
            odd, sign = odd_pieces(self.spheres, *ends)
            label = pieces(self.spheres, *ends)
            signed = sign * imposed[:, k]
            # range of the imposed values times sign in each piece
            low, high = np.full(label.max() + 1, np.inf), np.full(label.max() + 1, -np.inf)
            np.minimum.at(low, label[held], signed[held])
            np.maximum.at(high, label[held], signed[held])
            # the first sphere of each piece without driven spheres that can turn without slip
            loose = np.isinf(low)
            turning = np.flatnonzero(moves & loose[label] & ~odd)
            first = turning[np.unique(label[turning], return_index=True)[1]]
            number += len(first)
            if (low < high).any() or (odd[held] & (signed[held] != 0)).any():
                wanted[first, k] = False
            else:  # no contact has to slip by this component
                wanted[:, k] = False
                known[moves, k] = (np.where(loose, 0.0, low)[label] * np.where(odd, 0.0, sign))[moves]
        return known, wanted, number

    def order(self, contact: np.ndarray, free: np.ndarray) -> Parts:
        """Return an order in which the unknowns of all spheres can be eliminated, by nested dissection: a list with,
        for each region of the packing, the numbers of its own spheres and those of the regions inside it.

        contact : (n,) numbers of contacts, of which those between two free spheres couple unknowns.
        free : (spheres N,) mask of the free spheres.
        """
        ends = self.contact[:, contact]
        first, second = np.sort(ends[:, free[ends].all(axis=0)], axis=0)
        size = (self.spheres,) * 2
        once = sparse.csr_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=size)
        graph = sparse.csr_array(once + once.T)
        return [(part.nodes, part.children) for part in dissected(graph, self.center.T, LEAF_SPHERES)]

    def motions(self, slips: sparse.csr_array, sphere: np.ndarray, contact: np.ndarray, free: np.ndarray) -> Motions:
        """Return the motions without slip: spins that the matrix `slips` maps to 0.

        slips : (rows, unknowns), sparse, from unknown spin components to slips.
        sphere : (unknowns,), number of the sphere of each unknown.
        contact : (n,) numbers of contacts, of which those between two free spheres couple unknowns.
        free : (spheres N,) mask of the free spheres.
        """
        return slipless_motions(slips, sphere, self.order(contact, free))
