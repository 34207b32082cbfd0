"""Numbers of spheres and contacts in lists, in an order in which neighbours stand near each other."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from taichi_bearings import runtime
from taichi_bearings.errors import DeviceError
from taichi_bearings.fields.fields import (
    CPU_BLOCK,
    MOST_FIELD_NUMBERS,
    FieldSpec,
    number_type,
    on_device,
    one_block,
    team_size,
)
from taichi_bearings.memory import aligned_zeros

ListSpec = tuple[FieldSpec, FieldSpec]
"""(name, numbers) of what each sphere has, and of what each contact has."""


def list_block() -> int:
    """Spheres or contacts that a kernel works on together."""
    return 1 if runtime.current().is_gpu else CPU_BLOCK


@dataclass(frozen=True)
class Lists:
    """Who touches whom, in memory. sphere, contact : numbers in the packing of those that stand here, by place.

    size : lengths of the rows of spheres and contacts, whole blocks. ends : (2 size[1],), places of the first sphere of
    each contact, then of the second. start, incident : of each sphere its contacts, incident[start[i] : start[i + 1]].
    """

    sphere: np.ndarray
    contact: np.ndarray
    size: tuple[int, int]
    ends: np.ndarray
    start: np.ndarray
    incident: np.ndarray

    @classmethod
    def of(cls, spheres: int, pairs: np.ndarray) -> "Lists":
        """pairs : (E, 2). Spheres by reverse Cuthill and McKee, contacts by their first sphere there."""
        ones, block = np.ones(2 * len(pairs), dtype=np.int8), list_block()
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
        return cls(
            sphere, contact, (whole[0], whole[1]), rows.ravel(), start.astype(np.int32), incident.astype(np.int32)
        )


class ListFields:
    """What `Fields` is on lattices, with arrays (C, 1, N) of spheres and (C, 1, E) of contacts; all 0 at first."""

    def __init__(self, lists: Lists, spec: ListSpec) -> None:
        self._place: dict[str, tuple[slice, int, np.ndarray]] = {}
        end = 0
        for names, order, size in zip(spec, (lists.sphere, lists.contact), lists.size, strict=True):
            for name, count in names:
                self._place[name] = slice(end, end + count * size), count, order
                end += count * size
        if end > MOST_FIELD_NUMBERS:
            raise DeviceError(f"{len(lists.sphere)} spheres are too many here: {end} numbers of {MOST_FIELD_NUMBERS}")
        self.on_gpu = runtime.current().is_gpu
        self.values: Any = on_device(np.zeros(end)) if self.on_gpu else aligned_zeros(end, CPU_BLOCK, number_type())
        self.blocks = one_block() if self.on_gpu else self.values.reshape(-1, CPU_BLOCK)
        parts = np.array(lists.size), lists.ends, lists.start, lists.incident
        self.tables = on_device(np.concatenate(parts), "i32")
        spheres: Any = SimpleNamespace(sites=len(lists.sphere))
        self.team_size = team_size(spheres, sum(count for _, count in spec[0]))

    def _host(self) -> np.ndarray:
        return self.values.to_numpy() if self.on_gpu else self.values

    def load(self, name: str, values: np.ndarray) -> None:
        """Set a field from (C, 1, N) or (C, 1, E)."""
        where, count, order = self._place[name]
        host = self._host()
        host[where].reshape(count, -1)[:, : len(order)] = values.reshape(count, -1)[:, order]
        if self.on_gpu:
            self.values.from_numpy(host)

    def read(self, name: str) -> np.ndarray:
        """A field as (C, 1, N) or (C, 1, E), float64."""
        where, count, order = self._place[name]
        found = np.empty((count, 1, len(order)))
        found[:, 0, order] = self._host()[where].reshape(count, -1)[:, : len(order)]
        return found

    def clear(self, name: str) -> None:
        _, count, order = self._place[name]
        self.load(name, np.zeros((count, 1, len(order))))
