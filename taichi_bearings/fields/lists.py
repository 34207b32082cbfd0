"""Numbers of spheres and contacts in lists, in an order in which neighbours stand near each other."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from taichi_bearings.fields.fields import FieldSpec, block_size
from taichi_bearings.lattice.layout import Rows

ListSpec = tuple[FieldSpec, FieldSpec]
"""(name, numbers) of what each sphere has, and of what each contact has."""


@dataclass(frozen=True)
class Lists:
    """Who touches whom, in memory. sphere, contact : numbers in the packing of those that stand here, by place.

    size : lengths of the rows of spheres and contacts, whole blocks. ends : (2 size[1],), places of the first sphere of
    each contact, then of the second. start, incident : of each sphere its contacts, incident[start[i] : start[i + 1]].
    block : places that a kernel works on together.
    """

    sphere: np.ndarray
    contact: np.ndarray
    size: tuple[int, int]
    ends: np.ndarray
    start: np.ndarray
    incident: np.ndarray
    block: int

    @classmethod
    def of(cls, spheres: int, pairs: np.ndarray) -> "Lists":
        """pairs : (E, 2). Spheres by reverse Cuthill and McKee, contacts by their first sphere there."""
        ones, block = np.ones(2 * len(pairs), dtype=np.int8), block_size()
        graph = sparse.csr_array((ones, (pairs.T.ravel(), pairs[:, ::-1].T.ravel())), shape=(spheres, spheres))
        sphere = reverse_cuthill_mckee(graph, symmetric_mode=True)
        place = np.empty(spheres, dtype=np.int64)
        place[sphere] = np.arange(spheres)
        ends = np.sort(place[pairs], axis=1)
        contact = np.lexsort((ends[:, 1], ends[:, 0]))
        ends = ends[contact]
        whole = [block * max(1, -(-count // block)) for count in (spheres, len(pairs))]
        rows = np.zeros((2, whole[1]), dtype=np.int32)
        rows[:, : len(pairs)] = ends.T
        incident = np.append(np.argsort(ends.ravel(), kind="stable") // 2, 0)
        start = np.append(0, np.cumsum(np.bincount(ends.ravel(), minlength=whole[0])))
        tables = rows.ravel(), start.astype(np.int32), incident.astype(np.int32)
        return cls(sphere, contact, (whole[0], whole[1]), *tables, block)

    @property
    def sites(self) -> int:
        """Spheres."""
        return len(self.sphere)

    @property
    def measures(self) -> np.ndarray:
        """What kernels must know: the lengths of the rows, and the lists."""
        return np.concatenate([self.size, self.ends, self.start, self.incident])

    def parts(self, spec: ListSpec) -> list[tuple[FieldSpec, Rows]]:
        """Fields of spheres (C, 1, N) and of contacts (C, 1, E)."""
        rows = [
            Rows(length, 0, (1, len(order)), order)
            for length, order in zip(self.size, (self.sphere, self.contact), strict=True)
        ]
        return list(zip(spec, rows, strict=True))
