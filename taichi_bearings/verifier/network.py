"""Any network of touching spheres or discs, its spins and its friction, as they are to be judged.

With u = R omega the surface of the second sphere of a contact slips past the first with v = -(u_i + u_j) x n, friction
F on the second one turns both with n x F, and what it takes from the motion is (u_i + u_j) . (n x F) = -F . v, at most
|F| |v|. A disc has one component, u and v about z, F along z x n. Normals are taken bit by bit as they are stored: they
say what slips, also where their length is not quite 1.

A part is what contacts between free spheres join. Where it touches nothing that is driven, it rests at some minimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from taichi_bearings.verifier.enclosure import Enclosure, grouped_sum, joined, row_sum
from taichi_bearings.verifier.motion import length
from taichi_bearings.verifier.samples import LAWS, LEAST_SCALE, MOST_SCALE, OfLaw, power_of_two

LEAST_SPEED = 1e-100  # of the fastest surface that is imposed


@dataclass(frozen=True)
class StoredPacking(OfLaw):
    """arrays by name: center (N, D), contact (E, 2), driven (N,), spin (N, 3) or (N,), radius (N,), normal (E, D),
    friction, normal_force (E,) and, with the law coulomb-viscous, viscosity (E,). spin : of all spheres.
    friction : (E, 3) or (E,)."""

    law: str
    arrays: dict[str, np.ndarray]
    spin: np.ndarray
    friction: np.ndarray
    count = 1

    @property
    def is_finite(self) -> bool:
        return bool(np.isfinite(self.spin).all() and np.isfinite(self.friction).all())


@dataclass(frozen=True)
class Network(OfLaw):
    """N spheres, E contacts; D = 2 or 3, and C = 1 or 3 components. Speeds and forces are in units of powers of two.

    law : a key of LAWS. place : (N, D). contact : (E, 2). normal : (E, D). free : (N,). speed_unit, force_unit.
    spin : u by component, C enclosures (N,). friction : F on the second sphere, (E, C), 0 where nothing acts.
    holding : mu F_n; slope : eta, (E,) enclosures, 0 where there is none. rolling : (N,) mask of free spheres whose
    contacts can all roll, whatever the others do; None if nobody has looked for them.
    """

    law: str
    place: np.ndarray
    contact: np.ndarray
    normal: np.ndarray
    free: np.ndarray
    speed_unit: float
    force_unit: float
    spin: list[Enclosure]
    friction: np.ndarray
    holding: Enclosure
    slope: Enclosure
    rolling: np.ndarray | None = None

    @classmethod
    def of(cls, stored: StoredPacking) -> Network | None:
        """None for numbers that are not finite, or of scales for which no arithmetic here is made."""
        law, packing, spin, friction = stored.law, stored.arrays, stored.spin, stored.friction
        free, radius = packing["driven"] < 0, packing["radius"]
        count, contacts = len(free), len(packing["contact"])
        parts = spin.size // count
        spin, imposed = spin.reshape(count, parts), packing["spin"].reshape(count, parts)
        friction = friction.reshape(contacts, parts)
        spin = np.where(free[:, None], spin, imposed)
        fastest = float(np.abs(spin * radius[:, None])[~free].max(initial=0.0)) or 1.0
        holds, flows = LAWS[law]
        first = packing["friction"] * (packing["normal_force"] if holds else 1.0)
        damping = packing.get("viscosity") if holds else packing["friction"]
        slope = damping if flows and damping is not None else np.zeros(contacts)
        largest = max(float((first if holds else 0 * first).max(initial=0.0)), float(slope.max(initial=0.0)) * fastest)
        if not (LEAST_SPEED < fastest < MOST_SCALE and (LEAST_SCALE < largest < MOST_SCALE or not largest)):
            return None
        speed, force = power_of_two(fastest), power_of_two(largest)
        acts = ((first > 0) | (slope > 0)) & free[packing["contact"]].any(axis=1)
        with np.errstate(over="ignore"):
            spin, friction = spin / speed, np.where(acts[:, None], friction / force, 0.0)
        if not all((np.abs(values) < MOST_SCALE).all() for values in (spin, spin * radius[:, None], friction)):
            return None
        zero = Enclosure.exact(np.zeros(contacts))
        return cls(
            law, packing["center"], packing["contact"], packing["normal"], free, speed, force,
            [Enclosure.exact(part).times(radius) for part in spin.T], friction,
            Enclosure.exact(packing["friction"] / force).times(packing["normal_force"]) if holds else zero,
            Enclosure.exact(slope * (speed / force)) if flows else zero,
        )  # fmt: skip

    @property
    def power_unit(self) -> float:
        return self.speed_unit * self.force_unit

    @cached_property
    def acts(self) -> np.ndarray:
        """(E,) mask of contacts with a coefficient and a free end."""
        return ((self.holding.high > 0) | (self.slope.high > 0)) & self.free[self.contact].any(axis=1)

    @cached_property
    def reached(self) -> np.ndarray:
        """(N,) mask of free spheres in parts that touch driven spheres."""
        first, second = self.contact[self._holding].T
        inner, count = self.free[first] & self.free[second], len(self.free)
        graph = sparse.csr_array((np.ones(inner.sum()), (first[inner], second[inner])), shape=(count, count))
        label = connected_components(graph, directed=False)[1]
        touched = np.zeros(count, dtype=bool)
        for end, other in ((first, second), (second, first)):
            touched[label[end[self.free[end] & ~self.free[other]]]] = True
        return self.free & touched[label] & ~(self.rolling if self.rolling is not None else np.zeros(count, dtype=bool))

    @cached_property
    def counts(self) -> np.ndarray:
        """(E,) mask of the contacts that act there: others dissipate nothing at any minimum."""
        return self._holding & self.reached[self.contact].any(axis=1)

    @cached_property
    def _holding(self) -> np.ndarray:
        """(E,) mask of those that act and do not belong to rolling spheres."""
        return self.acts if self.rolling is None else self.acts & ~self.rolling[self.contact].any(axis=1)

    @cached_property
    def box(self) -> np.ndarray:
        """(C,), largest size of each component of what is imposed."""
        return np.array([part.most[~self.free].max(initial=0.0) for part in self.spin])

    @cached_property
    def mixes(self) -> bool:
        """False where components do not mix: of discs, and of normals along the axes at all contacts that count."""
        return self.normal.shape[1] == 3 and not ((self.normal[self.counts] != 0).sum(axis=1) == 1).all()

    def slips(self, spin: list[Enclosure]) -> list[Enclosure]:
        """(u_i + u_j) x n by component, (E,) each."""
        first, second = self.contact.T
        return self._across([part.at(first) + part.at(second) for part in spin])

    def _across(self, vectors: list[Enclosure]) -> list[Enclosure]:
        """Vectors (E,) x n; those of discs as they are."""
        if len(vectors) == 1:
            return vectors
        n = self.normal.T
        turned = [(k + 1) % 3 for k in range(3)], [(k + 2) % 3 for k in range(3)]
        return [vectors[a].times(n[b]) - vectors[b].times(n[a]) for a, b in zip(*turned, strict=True)]

    def moments(self, friction: list[Enclosure]) -> list[Enclosure]:
        """n x F by component, (E,) each: what turns both spheres of a contact."""
        return [-part for part in self._across(friction)] if len(friction) == 3 else friction

    def torques(self, friction: list[Enclosure]) -> list[Enclosure]:
        """Their sums at each sphere, (N,) by component."""
        ends = self.contact.T.ravel()
        return [grouped_sum(joined([part, part]), ends, len(self.free)) for part in self.moments(friction)]

    @cached_property
    def slip(self) -> Enclosure:
        """(E,), its size."""
        return length(self.slips(self.spin))

    @cached_property
    def own_friction(self) -> list[Enclosure]:
        """Of the contacts that count."""
        return [Enclosure.exact(np.where(self.counts, part, 0.0)) for part in self.friction.T]

    def dissipated(self, of_slope: float, some: np.ndarray | None = None) -> Enclosure:
        """(1,), friction times slip plus `of_slope`, a power of two, times damping times its square, of what acts."""
        own = np.flatnonzero(self.acts if some is None else some)
        slip = self.slip.at(own)
        parts = self.holding.at(own) * slip + (self.slope.at(own) * slip * slip).signed(of_slope)
        return row_sum(parts.reshaped((1, -1)))
