"""What there is to find: the free spins that contacts with driven ones reach, and the slips that they make."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from taichi_bearings.scene import Bearing
from taichi_bearings.scene.network import Network
from taichi_bearings.scene.packing import Packing


@dataclass(frozen=True)
class System:
    """The contacts that act, (A,), and the unknowns: spins of free spheres, by component, that have to be found.

    bearing : what is solved, of one sample. contact : (A,) numbers of contacts with a coefficient and a free end, in
    parts that touch a driven sphere.
    moved : (N, C) number of each unknown, -1 where the spin is imposed, or held at 0. motions : number of slipless ones
    before some were held; None if undecided. sphere : (unknowns,).
    known : (N, C), u of spheres and components that are no unknowns. matrix : K. offset : b, (d, A), of the known
    spins. coefficients : (A,) each. kept : what methods have made of the network, for other coefficients on it.
    """

    bearing: Bearing
    contact: np.ndarray
    moved: np.ndarray
    motions: int | None
    sphere: np.ndarray
    known: np.ndarray
    matrix: sparse.csr_array
    offset: np.ndarray
    coefficients: tuple[np.ndarray, ...]
    kept: dict[Any, Any] = field(default_factory=dict, compare=False)

    @classmethod
    def of(cls, bearing: Bearing) -> "System":
        network, contact = bearing.network, bearing.acting
        moves = network.reached(contact)
        contact = contact[moves[network.contact[:, contact]].any(axis=0)]
        known, wanted, number = network.needed(bearing.driven_speed, contact, moves)
        moved = _numbered(wanted)
        if number is None:
            found = network.motions(network.operator(contact, moved), np.nonzero(wanted)[0], contact, moves)
            number = found.number if found.number_is_certain else None
            wanted &= ~np.isin(moved, found.held)
            moved = _numbered(wanted)
        spins = known[network.contact[:, contact]].sum(axis=0)  # (A, C)
        offset = np.einsum("tek,ek->te", network.tangents[:, contact], spins)
        of = tuple(values[0, contact] for values in bearing.material)
        matrix = network.operator(contact, moved)
        return cls(bearing, contact, moved, number, np.nonzero(wanted)[0], known, matrix, offset, of)

    @property
    def packing(self) -> Packing:
        """The same, where packings alone are spoken of."""
        assert isinstance(self.bearing, Packing)
        return self.bearing

    @property
    def network(self) -> Network:
        return self.bearing.network

    @property
    def unknowns(self) -> int:
        return len(self.sphere)

    @property
    def place(self) -> np.ndarray:
        """(D, unknowns), the centres of their spheres."""
        return np.asarray(self.network.center[self.sphere].T)

    @cached_property
    def across(self) -> np.ndarray:
        """(d, A, C)."""
        return self.network.tangents[:, self.contact]

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


def _numbered(wanted: np.ndarray) -> np.ndarray:
    """Number of each True one, -1 of the others."""
    return np.where(wanted, np.cumsum(wanted).reshape(wanted.shape) - 1, -1)
