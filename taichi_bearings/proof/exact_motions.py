"""Motions of spheres that let contacts roll exactly, where these close many loops: steps of theorems 3 and 7.

Letters: N spheres, E contacts, A of them looked at, with the slips K x by the n unknown components x of free spins, K
(3 A, n); J some of the unknowns; s a floor of the singular values of K by the other unknowns; q numbers that are
chosen: values of J, and imposed numbers.

Contacts that close more loops than their spheres have freedom for roll together only if the directions of their normals
agree exactly, as those of a lattice do. The least rounding breaks it, so it takes a proof without any rounding. To each
unknown of J belongs a motion, which is 1 there, 0 at the rest of J, and lets no contact slip. An elimination in doubles
lets us guess it. Where it consists of rational numbers, products without rounding prove that no contact slips in it. If
that is so for all of J, these motions span the whole kernel of K. And no other singular value of K is below s: from an
x orthogonal to the kernel subtract the motions that have its values on J. What is left is no shorter, slips as x does,
and is 0 on J.

In the same way the spins that let contacts with driven spheres roll follow from each number that is imposed. Parts that
have no more conditions than unknowns outside J need none of this and are left out; so are spheres that move in a way
that is not exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.curvature import proven_floor
from taichi_bearings.proof.enclosure import UP, Enclosure, grouped_sum, joined
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.rounded_elimination import Elimination, Factor
from taichi_bearings.proof.springs import rounding_of, slip_rows

FAINT = 1e-100  # size of factors above which no part of a product underflows
NULL_PIVOT = 1e-8  # pivot up to which an unknown is put into J
DENOMINATORS = 720  # largest denominator of the fractions that are guessed
WHOLE, LARGEST = 1e-6, 2.0**40  # how far a number may be off the integer that it is taken for, and how large one is
MOST_ROUNDS = 12  # number of times that spheres are left out and the rest is tried again
MOST_EXACT_SPHERES = 5_000  # number of free spheres beyond which this takes longer than finding the minimum
SLOTS_AT_ONCE = 64  # choices of a part that are solved for at once


@dataclass(frozen=True)
class ExactMotions:
    """Contacts that can all roll exactly at once, and the motions in which they do.

    spheres : (N,) mask of the free spheres that they join.
    contacts : (E,) mask of the contacts, among these spheres and with driven ones.
    floor : lower bound of the singular values of K that are not 0; infinite if there are no spheres.
    motions : how spins follow from the chosen numbers; None if there are no spheres.
    """

    spheres: np.ndarray
    contacts: np.ndarray
    floor: float = np.inf
    motions: _Motions | None = None

    @classmethod
    def of(cls, network: JudgedNetwork, number: np.ndarray, rests: np.ndarray) -> ExactMotions:
        """Find exact motions of as many spheres as possible that contacts of the mask `rests` (E,) join. number : (N,
        3), number of each unknown, -1 where there is none."""
        spheres, (first, second) = network.reached, network.graph.contact
        for _ in range(MOST_ROUNDS if spheres.sum() <= MOST_EXACT_SPHERES else 0):
            whole = spheres | ~network.free
            contacts = rests & whole[first] & whole[second]
            touched = np.zeros(len(spheres), dtype=bool)
            touched[network.graph.contact[:, contacts]] = True
            spheres = spheres & touched
            if not spheres.any():
                break
            found = _Parts.of(network, spheres[:, None] & (number >= 0), contacts).solved()  # or a mask to leave out
            if isinstance(found, tuple):
                return cls(spheres, contacts, *found)
            spheres = spheres & ~found
        return cls(np.zeros_like(spheres), np.zeros_like(rests))

    def rolling(self, spin: list[Enclosure]) -> list[Enclosure]:
        """Spins by component, (N,) each, at which all these contacts roll exactly. spin : given spins, sums of two
        doubles; those of J and of all other spheres stay as they are."""
        return spin if self.motions is None else self.motions.spin(spin)


@dataclass(frozen=True)
class _Parts:
    """The parts that A contacts make of free spheres with n unknowns; driven spheres join no parts.

    free : (N, 3) mask of the unknowns.
    ends : (2, A), spheres of the contacts.
    normal : (A, 3).
    rows : K, (3 A, n), component by component.
    of_unknown, of_contact : (n,) and (A,), numbers of their parts, 0 to count - 1.
    """

    network: JudgedNetwork
    free: np.ndarray
    ends: np.ndarray
    normal: np.ndarray
    rows: sparse.csr_array
    of_unknown: np.ndarray
    of_contact: np.ndarray
    count: int

    @classmethod
    def of(cls, network: JudgedNetwork, free: np.ndarray, contacts: np.ndarray) -> _Parts:
        """Parts of the unknowns in the mask `free` (N, 3), joined by the contacts in the mask `contacts` (E,)."""
        ends = network.graph.contact[:, contacts]
        rows = sparse.csr_array(slip_rows(network, numbered(free))[np.flatnonzero(np.tile(contacts, 3))])
        rows.eliminate_zeros()
        first, second = ends[:, network.free[ends].all(axis=0)]
        label = pieces(len(free), first, second)
        parts, of_unknown = np.unique(label[np.nonzero(free)[0]], return_inverse=True)
        of_contact = np.searchsorted(parts, label[np.where(network.free[ends[0]], *ends)])
        return cls(network, free, ends, network.graph.normal[contacts], rows, of_unknown, of_contact, len(parts))

    def solved(self) -> tuple[float, _Motions] | np.ndarray:
        """The floor of singular values, and the motions; or a mask (N,) of at least one sphere that is to be left
        out."""
        everything, place = np.asarray(self.free.any(axis=1)), self.network.graph.place[np.nonzero(self.free)[0]].T
        # Choose J: unknowns without which no pivot is nearly 0.
        follows = ~Elimination.of((self.rows.T @ self.rows).tocsc(), place).dependent(NULL_PIVOT)
        # A slip has two components. Parts without more of them than unknowns outside J have nothing to prove: leave
        # them out.
        conditions = 2 * np.bincount(self.of_contact, minlength=self.count)
        enough = conditions <= np.bincount(self.of_unknown, follows, self.count)
        if enough.any() or not follows.any():
            return self._spheres(enough[self.of_unknown] | ~follows.any())
        # A proven floor of the other unknowns, and the motions that follow from J and from what is imposed.
        rows, choices = sparse.csr_array(self.rows[:, follows]), _Choices.of(self, np.flatnonzero(~follows))
        elimination = Elimination.of((rows.T @ rows).tocsc(), place[:, follows])
        tau, factor = proven_floor(rows, rounding_of(rows), elimination, sharp=True), elimination.factorised()
        if tau is None or factor is None or choices is None:
            return everything
        motions, strange = _Motions.of(self, choices, np.flatnonzero(follows), rows, factor)
        slide = motions.slide()
        if not len(slide):
            return float(np.sqrt(tau) / UP), motions
        found = self._spheres(strange)
        # Leave out spheres with a number that is no fraction, and both ends of contacts that slip though all numbers
        # are fractions.
        clear = ~found[self.ends[:, slide]].any(axis=0)  # of both ends all numbers are whole
        found[self.ends[:, slide[clear]]] = True
        return found & everything

    def _spheres(self, unknowns: np.ndarray) -> np.ndarray:
        """(N,) mask of the spheres to which any of the unknowns in the mask `unknowns` (n,) belongs."""
        found = np.zeros_like(self.free)
        found[self.free] = unknowns
        return np.asarray(found.any(axis=1))


@dataclass(frozen=True)
class _Choices:
    """The q numbers from which all other spins follow: the spins of J, then each distinct size of imposed spins in each
    part.

    chosen : numbers of the unknowns in J.
    imposed : the imposed sizes.
    owner, slot : (q,), the part of each number, and its place (from 0) among the numbers of this part.
    sums : (3 A, q), what a unit of each number contributes to u_i + u_j of the contacts of its part, by component.
    """

    chosen: np.ndarray
    imposed: Enclosure
    owner: np.ndarray
    slot: np.ndarray
    sums: sparse.csr_array

    @classmethod
    def of(cls, parts: _Parts, chosen: np.ndarray) -> _Choices | None:
        """The choices of all parts; None if some imposed spin is too small for exact products. chosen : numbers of the
        unknowns in J."""
        network, contacts = parts.network, len(parts.of_contact)
        high, low, error = (
            np.stack(values, axis=1) for values in zip(*(p.parts for p in network.imposed), strict=True)
        )
        moves = high != 0
        sizes = np.stack([np.abs(high), np.sign(high) * low])[:, moves]
        size, which = np.unique(sizes, axis=1, return_inverse=True)
        if not ((size[0] > FAINT).all() and (error[~moves] == 0).all()):
            return None
        # Imposed components of one size, with either sign, are one number.
        of_size = sparse.csr_array((np.sign(high[moves]), (np.arange(moves.sum()), which.ravel())),
                                   shape=(moves.sum(), size.shape[1]))  # fmt: skip
        brought = sparse.coo_array(_sums(parts.ends, numbered(moves)) @ of_size)
        row, value = brought.coords
        # A column for each pair of a part and an imposed size that occurs in it.
        pairs, column = np.unique(parts.of_contact[row % contacts] + parts.count * value, return_inverse=True)
        # Number the choices of each part from 0.
        owner = np.append(parts.of_unknown[chosen], pairs % parts.count)
        order = np.argsort(owner, kind="stable")
        slot = np.empty_like(order)
        slot[order] = np.arange(len(order)) - np.searchsorted(owner[order], owner[order])
        by_imposed = sparse.csr_array((brought.data, (row, column)), shape=(3 * contacts, len(pairs)))
        sums = sparse.hstack([_sums(parts.ends, numbered(parts.free))[:, chosen], by_imposed], format="csr")
        imposed = Enclosure.exact(*size[:, pairs // parts.count])
        return cls(chosen, imposed, owner, slot, sparse.csr_array(sums))


@dataclass(frozen=True)
class _Motions:
    """What follows from each choice. motion : (n, q), integers. unit : (q,), the integer by which each column is
    divided: a unit of the choice moves the unknowns by motion / unit."""

    parts: _Parts
    choices: _Choices
    motion: sparse.csr_array
    unit: np.ndarray

    @classmethod
    def of(
        cls, parts: _Parts, choices: _Choices, follow: np.ndarray, rows: sparse.csr_array, factor: Factor
    ) -> tuple[_Motions, np.ndarray]:
        """Motions of all choices, and a mask (n,) of unknowns at which some motion is not a fraction.

        follow : numbers of the unknowns outside J. rows : their columns of K. factor : of rows^T rows.
        """
        normal, owner, count = parts.normal.T[..., None], parts.of_unknown[follow], len(choices.slot)
        unit, strange = np.ones(count), np.zeros(len(parts.of_unknown), dtype=bool)
        entries = [np.zeros((3, 0))]
        for begin in range(0, int(choices.slot.max(initial=-1)) + 1, SLOTS_AT_ONCE):
            own = np.flatnonzero((choices.slot >= begin) & (choices.slot < begin + SLOTS_AT_ONCE))
            slot, part = choices.slot[own] - begin, choices.owner[own]
            together = sparse.csr_array((np.ones(len(own)), (np.arange(len(own)), slot)))
            # One choice of each part at once, as parts do not touch: solve K x = -slips in least squares, with one
            # refinement.
            sums = (choices.sums[:, own] @ together).toarray()
            slips = np.cross(sums.reshape(3, -1, sums.shape[1]), normal, axis=0).reshape(sums.shape)
            x = -factor.solve(rows.T @ slips)  # the others follow by K x = -slips
            x -= factor.solve(rows.T @ (rows @ x + slips))
            choice = np.full((parts.count, x.shape[1]), -1)
            choice[part, slot] = own
            x = np.where(np.isfinite(x) & (choice >= 0)[owner], x, 0.0)
            # Multiply the numbers of each part by their common denominator, and round to integers.
            units = _units(x, owner, parts.count)
            x *= units[owner]
            strange[follow[(np.abs(x - np.round(x)) > WHOLE).any(axis=1)]] = True
            (at, column), unit[own] = np.nonzero(np.round(x)), units[part, slot]
            entries.append(np.stack([follow[at], choice[owner[at], column], np.round(x)[at, column]]))
        entries.append(np.stack([choices.chosen, np.arange(len(choices.chosen)), unit[: len(choices.chosen)]]))
        at, choice, number = np.concatenate(entries, axis=1)
        motion = sparse.csr_array((number, (at.astype(int), choice.astype(int))), shape=(len(strange), count))
        return cls(parts, choices, motion, unit), strange

    def slide(self) -> np.ndarray:
        """Numbers of the contacts that are not proven to roll exactly for every choice."""
        count, chosen = len(self.parts.normal), len(self.choices.chosen)
        if not (np.abs(self.motion.data) < LARGEST).all():
            return np.arange(count)
        # u_i + u_j of every contact and choice, in integers, without rounding; then whether it is along the normal.
        imposed = self.choices.sums[:, chosen:] @ sparse.diags_array(self.unit[chosen:])
        brought = _sums(self.parts.ends, numbered(self.parts.free)) @ self.motion
        entries = sparse.coo_array(brought + sparse.hstack([0 * self.choices.sums[:, :chosen], imposed]))
        row, choice = entries.coords
        pairs, column = np.unique(row % count * len(self.unit) + choice, return_inverse=True)
        sums = np.zeros((3, len(pairs)))
        sums[row // count, column] = entries.data
        contact = pairs // max(len(self.unit), 1)
        return np.unique(contact[~_rolls(sums, self.parts.normal[contact].T)])

    def spin(self, given: list[Enclosure]) -> list[Enclosure]:
        """Spins by component, (N,) each, as of ExactMotions.rolling. given : spins, of which those of J are used."""
        free, choices, motion = self.parts.free, self.choices, sparse.coo_array(self.motion)
        high, low = (np.stack([getattr(part, name) for part in given], axis=1)[free] for name in ("high", "low"))
        value = joined([Enclosure.exact(high[choices.chosen], low[choices.chosen]), choices.imposed])
        at, choice = motion.coords
        shares = value.at(choice).times(motion.data) / Enclosure.exact(self.unit[choice])
        total, (sphere, component), found = grouped_sum(shares, at, len(high)), np.nonzero(free), []
        for k, part in enumerate(given):
            found.append(part.where(~np.asarray(free.any(axis=1))))
            found[k].put(sphere[component == k], total.at(np.flatnonzero(component == k)))
        return found


def numbered(mask: np.ndarray) -> np.ndarray:
    """For each True entry of a mask its number, counted from 0 in order; -1 for the others."""
    return np.where(mask, np.cumsum(mask).reshape(mask.shape) - 1, -1)


def _sums(ends: np.ndarray, number: np.ndarray) -> sparse.csr_array:
    """Matrix (3 A, n) that takes unknowns to u_i + u_j of the contacts, component by component. ends : (2, A). number :
    (N, 3), number of each unknown, -1 for a component that is 0."""
    at = number[ends].transpose(0, 2, 1).reshape(2, -1)
    end, row = np.nonzero(at >= 0)
    return sparse.csr_array((np.ones(len(row)), (row, at[end, row])), shape=(at.shape[1], number.max(initial=-1) + 1))


def _units(x: np.ndarray, owner: np.ndarray, parts: int) -> np.ndarray:
    """(parts, m), for each owner and column the least common denominator of its numbers; 1 where that is too large. x :
    (k, m), of which those that are no fractions are ignored. owner : (k,), a part for each row."""
    rest, before, below = x - np.round(x), np.zeros_like(x), np.ones_like(x)
    while True:  # continued fractions of all numbers at once, until each is found or its denominator is too large
        open_ = (np.abs(x * below - np.round(x * below)) > WHOLE) & (np.abs(below) <= DENOMINATORS)
        if not open_.any():
            break
        inverse = 1 / rest
        rest = inverse - np.round(inverse)
        before, below = np.where(open_, below, before), np.where(open_, np.round(inverse) * below + before, below)
    denominator = np.where(np.abs(below) <= DENOMINATORS, np.abs(below), 1).astype(np.int64)
    found, order = np.ones((parts, x.shape[1]), dtype=np.int64), np.argsort(owner, kind="stable")
    present, begin = np.unique(owner[order], return_index=True)
    if len(order):
        found[present] = np.lcm.reduceat(denominator[order], begin, axis=0)
    return np.where((found < 1) | (found > LARGEST), 1, found).astype(float)


def _rolls(sums: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(k,) True where sums x n is exactly 0. sums : (3, k), integers. normal : (3, k)."""
    found = np.asarray(((normal == 0) | (np.abs(normal) > FAINT)).all(axis=0) | (sums == 0).all(axis=0))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        first, second = (Enclosure.exact(sums[i]).times(normal[j]) for i, j in ((a, b), (b, a)))
        found &= (first.high == second.high) & (first.low == second.low)
    return found
