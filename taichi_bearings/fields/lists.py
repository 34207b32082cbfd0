"""Spheres and contacts of any network in lists, in an order in which neighbours stand near each other in memory."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from taichi_bearings.fields.fields import FieldSpec, block_size
from taichi_bearings.lattice.layout import Rows

ListSpec = tuple[FieldSpec, FieldSpec]
"""Fields that each sphere has, and fields that each contact has: names and numbers of components."""
AnySpec = FieldSpec | ListSpec
"""Fields of a lattice, or of lists."""
COPY_NUMBERS = 10  # constants of a copy that kernels read


@dataclass(frozen=True)
class Lists:
    """The order of the spheres and contacts of a network in memory. A *place* is an index into an array of all spheres,
    or of all contacts, in this order. Both arrays are filled up with unused places to whole blocks.

    sphere, contact : (spheres N,) and (contacts E,), number in the packing of the sphere, or contact, at each place.
    size : lengths of an array of spheres and of one of contacts, with unused places.
    ends : (2 size[1],) places of the first sphere of each contact, then of the second.
    start, incident : the places of the contacts of the sphere at place i are incident[start[i] : start[i + 1]].
    block : number of places that a kernel works on together.
    copies : number of samples of the network; they follow one another, each in whole blocks.
    """

    sphere: np.ndarray
    contact: np.ndarray
    size: tuple[int, int]
    ends: np.ndarray
    start: np.ndarray
    incident: np.ndarray
    block: int
    copies: int = 1

    @classmethod
    def of(cls, spheres: int, pairs: np.ndarray) -> "Lists":
        """Return the lists of a network, ordered so that neighbours stand near each other: spheres by the method of
        reverse Cuthill and McKee, contacts by their first sphere in that order.

        spheres : number of spheres.
        pairs : (E contacts, 2) spheres of each contact.
        """
        ones, block = np.ones(2 * len(pairs), dtype=np.int8), block_size()
        graph = sparse.csr_array((ones, (pairs.T.ravel(), pairs[:, ::-1].T.ravel())), shape=(spheres, spheres))
        sphere = reverse_cuthill_mckee(graph, symmetric_mode=True)
        place = np.empty(spheres, dtype=np.int64)
        place[sphere] = np.arange(spheres)
        # places of the ends of each contact, the lower one first; contacts are sorted by them
        ends = np.sort(place[pairs], axis=1)
        contact = np.lexsort((ends[:, 1], ends[:, 0]))
        ends = ends[contact]
        whole = [block * max(1, -(-count // block)) for count in (spheres, len(pairs))]
        rows = np.zeros((2, whole[1]), dtype=np.int32)
        rows[:, : len(pairs)] = ends.T
        # for each sphere in turn the contacts that it is an end of, and where they begin
        incident = np.append(np.argsort(ends.ravel(), kind="stable") // 2, 0)
        start = np.append(0, np.cumsum(np.bincount(ends.ravel(), minlength=whole[0])))
        tables = rows.ravel(), start.astype(np.int32), incident.astype(np.int32)
        return cls(sphere, contact, (whole[0], whole[1]), *tables, block)

    def several(self, copies: int) -> "Lists":
        """Return the lists of `copies` samples of this network, one after another."""
        spheres, contacts = self.size
        # places and positions in `incident` of each copy are those of the first one, shifted by the copies before it
        ends = self.ends.reshape(2, 1, -1) + spheres * np.arange(copies, dtype=np.int32)[:, None]
        incident, each = self.incident[:-1], np.arange(copies)[:, None]
        start = np.append(self.start[:-1] + len(incident) * each, copies * len(incident))
        incident = np.append(incident + contacts * each, 0)
        size, tables = (spheres * copies, contacts * copies), (start.astype(np.int32), incident.astype(np.int32))
        return Lists(self.sphere, self.contact, size, ends.astype(np.int32).ravel(), *tables, self.block, copies)

    @property
    def sites(self) -> int:
        """Number of spheres, of all copies."""
        return self.copies * len(self.sphere)

    @property
    def numbers_row(self) -> int:
        """Length of a row that holds a constant of each sample: one number for a sample, at the start of a block."""
        return self.block * self.copies

    @property
    def measures(self) -> np.ndarray:
        """Integers that kernels need, one flat array: lengths of the rows of spheres and of contacts, of all samples
        and then of one; `numbers_row`; and the lists themselves, the ends of contacts and for each sphere the contacts
        on it.
        """
        one = [length // self.copies for length in self.size]
        return np.concatenate([self.size, one, [self.numbers_row], self.ends, self.start, self.incident])

    def parts(self, spec: ListSpec) -> list[tuple[FieldSpec, Rows]]:
        """Return where the fields of the first sample lie in memory, as three pairs: the names and numbers of
        components of some fields, and the layout of their rows. The first pair is of the fields of the N spheres, each
        (components C, 1, N); the second of those of the E contacts, (C, 1, E); the third of "numbers", (C, 1).

        spec : names and numbers of components, for the spheres and for the contacts; "numbers" are constants.
        """
        rows = [
            Rows(length, 0, (1, len(order)), order)
            for length, order in zip(self.size, (self.sphere, self.contact), strict=True)
        ]
        numbers: FieldSpec = (("numbers", COPY_NUMBERS),)
        return list(zip((*spec, numbers), (*rows, Rows(self.numbers_row, 0, (1,))), strict=True))
