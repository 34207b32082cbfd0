"""Motions of spheres that let contacts roll exactly, where these contacts put more conditions on spins than there are.

Contacts that close more loops than their spheres have freedom for roll together only if the directions of their normals
agree exactly, as those of a lattice do; the least rounding breaks it, so it takes a proof without any. Let K x be the
slips of these contacts by the spins x of the spheres, and J some of the unknowns, such that on the others the singular
values of K have a floor s. To each unknown of J belongs a motion, which is 1 there and 0 at the rest of J. Where it
consists of rational numbers, which an elimination lets guess, products without rounding tell that no contact slips in
it. If that is so of all of J, these motions are the whole kernel of K. And no other singular value of K is below s: from
an x across the kernel take the motions of its values on J; what is left is no shorter, slips as x does, and is 0 on J.

In the same way the spins that let contacts with driven spheres roll follow from each number that is imposed. Parts with
no more conditions than they follow need none of this and are left out; so is what moves in a way that is not exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from taichi_bearings.verifier.curvature import proven_floor
from taichi_bearings.verifier.elimination import Elimination
from taichi_bearings.verifier.enclosure import UP, Enclosure, joined
from taichi_bearings.verifier.network import Network, connected
from taichi_bearings.verifier.springs import rounding_of, slip_rows

FAINT = 1e-100  # size of factors from which nothing of a product is lost
NULL_PIVOT = 1e-8  # up to which an unknown may follow from no condition
DENOMINATORS = 720  # up to which fractions are guessed
WHOLE, LARGEST = 1e-6, 2.0**40  # how far a number may be off the integer that it is taken for, and how large one is
MOST_ROUNDS = 12  # of leaving out spheres


@dataclass(frozen=True)
class ExactMotions:
    """spheres : (N,) mask. contacts : (E,) mask of those among them and with driven spheres: all can roll exactly.

    floor : of the singular values of K but for its kernel, rounded down; infinite of no spheres.
    """

    spheres: np.ndarray
    contacts: np.ndarray
    floor: float = np.inf
    found: _Motions | None = None

    @classmethod
    def of(cls, network: Network, number: np.ndarray, rests: np.ndarray) -> ExactMotions:
        """Of spheres that contacts of a mask (E,) join, as many as can be had. number : (N, 3), -1 for no unknown."""
        spheres, (first, second) = network.reached, network.contact
        for _ in range(MOST_ROUNDS):
            whole = spheres | ~network.free
            contacts = rests & whole[first] & whole[second]
            touched = np.zeros(len(spheres), dtype=bool)
            touched[network.contact[:, contacts]] = True
            spheres = spheres & touched
            if not spheres.any():
                break
            found = _Parts.of(network, spheres[:, None] & (number >= 0), contacts).solved()
            if isinstance(found, tuple):
                return cls(spheres, contacts, *found)
            spheres = spheres & ~found
        return cls(np.zeros_like(spheres), np.zeros_like(rests))

    def rolling(self, spin: list[Enclosure]) -> list[Enclosure]:
        """Spins by component (N,) at which all the contacts roll exactly: those of J, and of all other spheres, are the
        given ones, which are exact sums of two doubles."""
        return spin if self.found is None else self.found.spin(spin)


@dataclass(frozen=True)
class _Parts:
    """The parts 0 to count - 1 that A contacts make of spheres with n unknowns; driven spheres join none.

    free : (N, 3) mask of the unknowns. ends : (2, A). normal : (A, 3). rows : K, (3 A, n), component by component.
    of_unknown, of_contact : numbers of the parts, (n,) and (A,).
    """

    network: Network
    free: np.ndarray
    ends: np.ndarray
    normal: np.ndarray
    rows: sparse.csr_array
    of_unknown: np.ndarray
    of_contact: np.ndarray
    count: int

    @classmethod
    def of(cls, network: Network, free: np.ndarray, contacts: np.ndarray) -> _Parts:
        ends = network.contact[:, contacts]
        rows = sparse.csr_array(slip_rows(network, numbered(free))[np.flatnonzero(np.tile(contacts, 3))])
        rows.eliminate_zeros()
        label = connected(*ends[:, network.free[ends].all(axis=0)], len(free))
        parts, of_unknown = np.unique(label[np.nonzero(free)[0]], return_inverse=True)
        of_contact = np.searchsorted(parts, label[np.where(network.free[ends[0]], *ends)])
        return cls(network, free, ends, network.normal[contacts], rows, of_unknown, of_contact, len(parts))

    def solved(self) -> tuple[float, _Motions] | np.ndarray:
        """Floor and motions; or the spheres (N,) that are to be left out, one at least."""
        everything, place = self.free.any(axis=1), self.network.place[np.nonzero(self.free)[0]].T
        follows = ~Elimination.of((self.rows.T @ self.rows).tocsc(), place).dependent(NULL_PIVOT)
        conditions = 2 * np.bincount(self.of_contact, minlength=self.count)
        enough = conditions <= np.bincount(self.of_unknown, follows, self.count)
        if enough.any():
            return self._spheres(enough[self.of_unknown])
        rows, choices = sparse.csr_array(self.rows[:, follows]), _Choices.of(self, np.flatnonzero(~follows))
        elimination = Elimination.of((rows.T @ rows).tocsc(), place[:, follows])
        tau, factor = proven_floor(rows, rounding_of(rows), elimination, sharp=True), elimination.factorised()
        if tau is None or factor is None or choices is None:
            return everything
        brought, n = choices.brought, self.normal.T[..., None]
        slips = np.cross(brought, n, axis=0).reshape(rows.shape[0], -1)
        x = -factor.solve(rows.T @ slips)
        x -= factor.solve(rows.T @ (rows @ x + slips))
        # in whole numbers of units
        units = _units(x, self.of_unknown[follows], self.count)
        motion, exact = choices.unit_motions(units, len(follows)), x * units[self.of_unknown[follows]]
        motion[follows] = np.round(exact)
        if not (np.abs(motion) < LARGEST).all():
            return everything
        sums = _sums(self.ends, numbered(self.free))[:, follows] @ motion[follows]
        slides = ~_rolls(sums.reshape(brought.shape) + brought * units[self.of_contact], n)
        if slides.any():
            strange = np.zeros_like(motion)
            strange[follows] = np.abs(exact - np.round(exact)) > WHOLE
            found = self._spheres(strange.any(axis=1))
            clear = ~found[self.ends[:, slides.any(axis=1)]].any(axis=0)
            found[self.ends[:, slides.any(axis=1)][:, clear]] = True
            return found & everything
        return float(np.sqrt(tau) / UP), _Motions(self, choices, units, motion)

    def _spheres(self, unknowns: np.ndarray) -> np.ndarray:
        """(N,) mask of those with any of some unknowns (n,)."""
        found = np.zeros_like(self.free)
        found[self.free] = unknowns
        return found.any(axis=1)


@dataclass(frozen=True)
class _Choices:
    """The q numbers from which all else follows, those of a part counted from 0: the spins of J, as they are given, and
    those that are imposed, each for either sign.

    chosen : J. imposed : the others. owner, slot : (q,), part, and number in it. sums : (3 A, q), of the spins at each
    contact, by each choice of its part."""

    chosen: np.ndarray
    imposed: Enclosure
    owner: np.ndarray
    slot: np.ndarray
    sums: sparse.csr_array

    @classmethod
    def of(cls, parts: _Parts, chosen: np.ndarray) -> _Choices | None:
        """chosen : numbers of the unknowns in J. None where something faint is imposed."""
        network, contacts = parts.network, len(parts.of_contact)
        high, low = (np.stack([getattr(part, name) for part in network.imposed], axis=1) for name in ("high", "low"))
        moves = high != 0
        sign, sizes = np.sign(high[moves]), np.stack([np.abs(high), np.sign(high) * low])[:, moves]
        size, which = np.unique(sizes, axis=1, return_inverse=True)
        if not (size[0] > FAINT).all():
            return None
        of_size = sparse.csr_array((sign, (np.arange(len(sign)), which.ravel())), shape=(len(sign), size.shape[1]))
        imposed = sparse.coo_array(_sums(parts.ends, numbered(moves)) @ of_size)
        pairs, column = np.unique(
            parts.of_contact[imposed.row % contacts] + parts.count * imposed.col, return_inverse=True
        )
        owner = np.append(parts.of_unknown[chosen], pairs % parts.count)
        order = np.argsort(owner, kind="stable")
        slot = np.empty_like(order)
        slot[order] = np.arange(len(order)) - np.searchsorted(owner[order], owner[order])
        by_imposed = sparse.csr_array((imposed.data, (imposed.row, column)), shape=(3 * contacts, len(pairs)))
        sums = sparse.hstack([_sums(parts.ends, numbered(parts.free))[:, chosen], by_imposed], format="csr")
        values = Enclosure.exact(*size[:, pairs // parts.count])
        return cls(chosen, values, owner, slot, sparse.csr_array(sums))

    @property
    def brought(self) -> np.ndarray:
        """(3, A, m) sums of spins; of each contact from the choices of its part."""
        places = np.arange(len(self.slot)), self.slot
        spread = sparse.csr_array((np.ones(len(self.slot)), places), shape=(len(self.slot), self.slot.max(initial=0) + 1))
        return np.asarray((self.sums @ spread).toarray()).reshape(3, self.sums.shape[0] // 3, -1)

    def unit_motions(self, units: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
        """(n, m): a unit for each choice of a spin, at the spin, 0 elsewhere."""
        motion, own = np.zeros((unknowns, units.shape[1])), slice(len(self.chosen))
        motion[self.chosen, self.slot[own]] = units[self.owner[own], self.slot[own]]
        return motion


@dataclass(frozen=True)
class _Motions:
    """What follows from the choices of each part. motion : (n, m), integers, for the first of its part, the second, ...;
    units : (P, m), what they are multiples of in it."""

    parts: _Parts
    choices: _Choices
    units: np.ndarray
    motion: np.ndarray

    def spin(self, given: list[Enclosure]) -> list[Enclosure]:
        """As of ExactMotions.rolling."""
        free, owner, choices = self.parts.free, self.parts.of_unknown, self.choices
        high, low = (np.stack([getattr(part, name) for part in given], axis=1)[free] for name in ("high", "low"))
        value, total = Enclosure.exact(np.zeros(self.units.shape)), Enclosure.exact(np.zeros(len(owner)))
        own = Enclosure.exact(high[choices.chosen], low[choices.chosen])
        value.put(choices.owner * self.units.shape[1] + choices.slot, joined([own, choices.imposed]))
        for slot in range(self.units.shape[1]):
            share = value[:, slot].at(owner).times(self.motion[:, slot])
            total = total + share / Enclosure.exact(self.units[owner, slot])
        (sphere, component), found = np.nonzero(free), []
        for k, part in enumerate(given):
            found.append(part.where(~free.any(axis=1)))
            found[k].put(sphere[component == k], total.at(np.flatnonzero(component == k)))
        return found


def numbered(mask: np.ndarray) -> np.ndarray:
    """Number of each True one, -1 of the others."""
    return np.where(mask, np.cumsum(mask).reshape(mask.shape) - 1, -1)


def _sums(ends: np.ndarray, number: np.ndarray) -> sparse.csr_array:
    """(3 A, n): u_i + u_j of contacts (2, A), component by component. number : (N, 3), -1 for what is 0."""
    count, at = ends.shape[1], number[ends].transpose(0, 2, 1).reshape(2, -1)
    end, row = np.nonzero(at >= 0)
    shape = (3 * count, int(number.max(initial=-1)) + 1)
    return sparse.csr_array((np.ones(len(row)), (row, at[end, row])), shape=shape)


def _units(x: np.ndarray, owner: np.ndarray, parts: int) -> np.ndarray:
    """(parts, m), of which numbers (k, m) of each owner (k,) are multiples; 1 where no fractions are found."""
    rest, before, below = x - np.round(x), np.zeros_like(x), np.ones_like(x)
    for _ in range(10):  # of a continued fraction
        open_ = (np.abs(x * below - np.round(x * below)) > WHOLE) & (np.abs(below) <= DENOMINATORS)
        if not open_.any():
            break
        inverse = 1 / rest
        rest = inverse - np.round(inverse)
        before, below = np.where(open_, below, before), np.where(open_, np.round(inverse) * below + before, below)
    denominator = np.where(np.abs(below) <= DENOMINATORS, np.abs(below), 1).astype(np.int64)
    found = np.ones((parts, x.shape[1]), dtype=np.int64)
    order = np.argsort(owner, kind="stable")
    present, begin = np.unique(owner[order], return_index=True)
    if len(order):
        found[present] = np.lcm.reduceat(denominator[order], begin, axis=0)
    return np.where((found < 1) | (found > LARGEST), 1, found).astype(float)


def _rolls(sums: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(A, m) True where sums x n is exactly 0. sums : (3, A, m), integers. normal : (3, A, 1)."""
    found = np.asarray(((normal == 0) | (np.abs(normal) > FAINT)).all(axis=0) | (sums == 0).all(axis=0))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        first, second = (Enclosure.exact(sums[i]).times(normal[j]) for i, j in ((a, b), (b, a)))
        found &= (first.high == second.high) & (first.low == second.low)
    return found
