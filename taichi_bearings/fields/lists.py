"""Numbers of spheres and contacts in lists, in an order in which neighbours stand near each other."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from taichi_bearings import runtime
from taichi_bearings.errors import DeviceError
from taichi_bearings.fields.fields import MOST_FIELD_NUMBERS, FieldSpec, number_type, on_device, team_size

ListSpec = tuple[FieldSpec, FieldSpec]
"""(name, numbers) of what each sphere has, and of what each contact has."""


@dataclass(frozen=True)
class Lists:
    """Who touches whom, in memory. sphere, contact : numbers in the packing of those that stand here, by place.

    ends : (2 E,), places of the spheres of each contact. start, incident : of each sphere its contacts,
    incident[start[i] : start[i + 1]].
    """

    sphere: np.ndarray
    contact: np.ndarray
    ends: np.ndarray
    start: np.ndarray
    incident: np.ndarray

    @classmethod
    def of(cls, spheres: int, pairs: np.ndarray) -> "Lists":
        """pairs : (E, 2). Spheres by reverse Cuthill and McKee, contacts by their first sphere there."""
        ones = np.ones(2 * len(pairs), dtype=np.int8)
        graph = sparse.csr_array((ones, (pairs.T.ravel(), pairs[:, ::-1].T.ravel())), shape=(spheres, spheres))
        sphere = reverse_cuthill_mckee(graph, symmetric_mode=True)
        place = np.empty(spheres, dtype=np.int64)
        place[sphere] = np.arange(spheres)
        ends = np.sort(place[pairs], axis=1)
        contact = np.lexsort((ends[:, 1], ends[:, 0]))
        ends = ends[contact]
        incident = np.argsort(ends.ravel(), kind="stable") // 2
        start = np.concatenate([[0], np.cumsum(np.bincount(ends.ravel(), minlength=spheres))])
        return cls(sphere, contact, *(values.astype(np.int32).ravel() for values in (ends, start, incident)))


class ListFields:
    """What `Fields` is on lattices, with arrays (C, 1, N) of spheres and (C, 1, E) of contacts; all 0 at first."""

    def __init__(self, lists: Lists, spec: ListSpec) -> None:
        self.lists, self.spec = lists, spec
        self._place: dict[str, tuple[slice, np.ndarray]] = {}
        end = 0
        for names, order in zip(spec, (lists.sphere, lists.contact), strict=True):
            for name, count in names:
                self._place[name] = slice(end, end + count * len(order)), order
                end += count * len(order)
        if end > MOST_FIELD_NUMBERS:
            raise DeviceError(f"{len(lists.sphere)} spheres are too many here: {end} numbers of {MOST_FIELD_NUMBERS}")
        self.values = on_device(np.zeros(end))
        self.blocks, start, incident = (self._integers(values) for values in (lists.ends, lists.start, lists.incident))
        self.layout = SimpleNamespace(measures=(start, incident, len(lists.sphere), len(lists.contact)))
        spheres: Any = SimpleNamespace(sites=len(lists.sphere))
        self.team_size = team_size(spheres, sum(count for _, count in spec[0]))

    @staticmethod
    def _integers(values: np.ndarray) -> Any:
        if not runtime.current().is_gpu:
            return values if len(values) else np.zeros(1, np.int32)
        from taichi_bearings.compiler import ti

        array = ti.ndarray(ti.i32, max(len(values), 1))
        array.from_numpy(values if len(values) else np.zeros(1, np.int32))
        return array

    def _host(self) -> np.ndarray:
        return self.values if isinstance(self.values, np.ndarray) else self.values.to_numpy()

    def load(self, name: str, values: np.ndarray) -> None:
        """Set a field from (C, 1, N) or (C, 1, E)."""
        (where, order), host = self._place[name], self._host()
        host[where] = values.reshape(len(values), -1)[:, order].T.ravel().astype(number_type())
        if host is not self.values:
            self.values.from_numpy(host)

    def read(self, name: str) -> np.ndarray:
        """A field as (C, 1, N) or (C, 1, E), float64."""
        where, order = self._place[name]
        stored = self._host()[where].reshape(len(order), -1).T
        found = np.empty(stored.shape)
        found[:, order] = stored
        return found[:, None]

    def clear(self, name: str) -> None:
        where, order = self._place[name]
        self.load(name, np.zeros(((where.stop - where.start) // max(len(order), 1), 1, len(order))))
