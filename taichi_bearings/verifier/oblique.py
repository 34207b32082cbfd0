"""Which contacts of a Coulomb network with oblique normals slip at every minimum, from one that is enclosed.

Let S be the contacts that slip in the given spins, and T the others.

1. Free spheres that do not turn, or turn as a driven one does, up to rounding, are taken to do so exactly, as far as
   contacts of T among them then rest bit by bit and, by a floor of K^T K of these contacts, let them do nothing else.
   Contacts of T that are left have independent rows in the spins that are left, by a floor of K K^T. So the spins V at
   which all of T rest are not empty, and some of them are near the given ones.
2. Within V the power has one minimum near these: along motions x that T allows its curvature is that of the sum of
   mu F_n / |y| (K x across y)^2 over S and of any springs at T, for which elimination proves a floor tau. Where that
   loses no more than a part within a distance of 8 |slope| / tau, the minimum is not further away.
3. There the friction of S is known, and what it leaves to T is borne by the given friction of T and a correction, the
   size of which the floors of step 1 bound. If all of that is inside the discs it is one of the whole power; as T bears
   less than its friction, it rests at every minimum, so all lie in V, and there is only one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from taichi_bearings.verifier.bounds import Bounds
from taichi_bearings.verifier.curvature import Form, proven_floor
from taichi_bearings.verifier.elimination import EPS, Elimination
from taichi_bearings.verifier.enclosure import UP, Enclosure, length
from taichi_bearings.verifier.network import Network, moments
from taichi_bearings.verifier.springs import floor_of_slips, rounding_of, slip_rows

MOVING = 1e-10  # of the fastest imposed component, above which a contact is taken to slip
NEARLY = 1e-11  # of it, up to which a spin may be the one that it is taken to be
MOST_ROUNDS = 12  # of letting go spheres that are not pinned
MOST_TURN = 0.25  # of a slip, over its size
FAINT, TINY = 1e-100, 1e-290  # factors whose products may be rounded


@np.errstate(all="ignore")  # what is not finite proves nothing
def enclosed_minimum(bounds: Bounds) -> tuple[np.ndarray, np.ndarray] | None:
    """True (E,) for the contacts that slip at every minimum, where all others that count rest at every one; and how
    far (E,) their slips are from the given ones at most. None if that is not known."""
    network, springs = bounds.network, bounds.springs
    if springs is None or network.flows:
        return None
    slides = network.counts & (network.slip.value > MOVING * network.box.max())
    held = _Held.of(network, springs.number, network.counts & ~slides)
    return None if held is None else _nearby(bounds, held, slides)


@dataclass(frozen=True)
class _Held:
    """What T allows. rests : T, (E,). spin : with those of step 1 as they are taken to be. number : (N, 3) of unknowns.

    pinned, left : numbers of the unknowns of either kind. stiff, loose : least singular values of K^T of the contacts
    among pinned spheres, and of K of the others, rounded down; infinite of none.
    """

    rests: np.ndarray
    spin: list[Enclosure]
    number: np.ndarray
    pinned: np.ndarray
    left: np.ndarray
    among: np.ndarray
    stiff: float
    loose: float

    @classmethod
    def of(cls, network: Network, number: np.ndarray, rests: np.ndarray) -> _Held | None:
        taken, pinned = _as_taken(network, rests)
        first, second = network.contact
        stiff = np.inf
        for _ in range(MOST_ROUNDS):
            spin = [Enclosure(*(np.where(pinned, a, b) for a, b in zip(t.parts, p.parts, strict=True)))
                    for t, p in zip(taken, network.spin, strict=True)]  # fmt: skip
            still = _still(network, spin)
            whole = pinned | ~network.free
            among = rests & whole[first] & whole[second]
            if (among & ~still).any():
                return None
            if not pinned.any():
                break
            found = _floor_of_spins(network, _numbered(pinned[:, None] & (number >= 0)), among)
            if isinstance(found, float):
                stiff = np.sqrt(found) / UP
                break
            pinned = pinned & ~found
        else:
            return None
        kept = rests & ~among
        of_left = _numbered(~pinned[:, None] & (number >= 0))
        loose = floor_of_slips(network, of_left, kept, sharp=True)
        if loose is None:
            return None
        return cls(rests, spin, number, number[(of_left < 0) & (number >= 0)], number[of_left >= 0], among, stiff,
                   np.sqrt(loose) / UP)  # fmt: skip


def _numbered(mask: np.ndarray) -> np.ndarray:
    """Number of each True one, -1 of the others."""
    return np.where(mask, np.cumsum(mask).reshape(mask.shape) - 1, -1)


def _still(network: Network, spin: list[Enclosure]) -> np.ndarray:
    """(E,) True where (u_i + u_j) x n is exactly 0: where the sum is, or is of doubles whose products with the normal
    are equal bit by bit. u = R omega is exactly a sum of two doubles."""
    still, nothing = np.ones((2, network.contact.shape[1]), dtype=bool)
    sums, n = [], network.normal.T
    for part in spin:
        one, two = (part.at(end) for end in network.contact)
        nothing &= (one.high == -two.high) & (one.low == -two.low) & _clear(one.high)
        sums.append(one + two)
        still &= (one.low == 0) & (two.low == 0) & (sums[-1].low == 0)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        first, second = (Enclosure.exact(sums[i].high).times(n[j]) for i, j in ((a, b), (b, a)))
        still &= (first.high == second.high) & (first.low == second.low)
        still &= np.all([_clear(v) for v in (sums[a].high, sums[b].high, n[a], n[b])], axis=0)
    return np.asarray(nothing | still)


def _clear(values: np.ndarray) -> np.ndarray:
    """0, or so large that no part of a product is lost."""
    return np.asarray((values == 0) | (np.abs(values) > FAINT))


def _as_taken(network: Network, rests: np.ndarray) -> tuple[list[Enclosure], np.ndarray]:
    """Spins that some are taken to have exactly, components (N,), and which, (N,): none, or those of a driven sphere
    or against them, as contacts at rest pass them on."""
    spin, near = np.stack([part.value for part in network.spin], axis=1), NEARLY * network.box.max()
    pinned = network.reached & (np.abs(spin) <= near).all(axis=1)
    high, low = (np.stack([np.where(pinned, 0.0, getattr(p, name)) for p in network.spin]) for name in ("high", "low"))
    ends = network.contact[:, rests]
    known, pairs = pinned | ~network.free, np.append(ends, ends[::-1], axis=1).T
    pairs = pairs[(np.abs(spin[pairs].sum(axis=1)) <= near).all(axis=1)]
    while (passed := known[pairs[:, 0]] & ~known[pairs[:, 1]]).any():
        source, to = pairs[passed].T
        high[:, to], low[:, to], known[to] = -high[:, source], -low[:, source], True
    return [Enclosure(h, w, np.zeros_like(h)) for h, w in zip(high, low, strict=True)], known & network.reached


def _floor_of_spins(network: Network, number: np.ndarray, contacts: np.ndarray) -> float | np.ndarray:
    """Of K^T K of these contacts (E,); or spheres (N,) that they let move, or may do so."""
    rows, there = _rows(network, number, contacts), number >= 0
    loose = np.zeros(number.shape, dtype=bool)
    loose[there] = np.bincount(rows.indices, minlength=rows.shape[1]) == 0
    if loose.any():
        return np.asarray(loose.any(axis=1))
    place = network.place[np.nonzero(there)[0]].T
    tau = proven_floor(rows, rounding_of(rows), Elimination.of((rows.T @ rows).tocsc(), place), sharp=True)
    return np.asarray(there.any(axis=1)) if tau is None else tau


def _rows(network: Network, number: np.ndarray, contacts: np.ndarray) -> sparse.csr_array:
    rows = sparse.csr_array(slip_rows(network, number)[np.flatnonzero(np.tile(contacts, 3))])
    rows.eliminate_zeros()
    return rows


def _curvature(network: Network, held: _Held, own: np.ndarray, y: np.ndarray, size: Enclosure) -> Form | None:
    """Of motions that T allows. own : the contacts of S. y : (S, 3), their slips."""
    number, still, strength = held.number, np.flatnonzero(held.rests), network.holding.at(own)
    across = np.cross(network.normal[own], y)
    across /= np.linalg.norm(across, axis=1)[:, None]
    root = np.sqrt(strength.value / size.value)
    firm = np.sqrt(network.holding.value[still] / (np.median(size.value) if len(own) else 1.0))
    count, rows_of = len(held.rests), slip_rows(network, number)
    at = np.append(
        np.concatenate([k * count + own for k in range(3)]), np.concatenate([k * count + still for k in range(3)])
    )
    row = np.append(np.tile(np.arange(len(own)), 3), len(own) + np.arange(3 * len(still)))
    shape = (len(own) + 3 * len(still), 3 * count)
    size_of = np.append(np.tile(root, 3), np.tile(firm, 3))
    value = size_of * np.append(across.T.ravel(), np.ones(3 * len(still)))
    rows = sparse.csr_array(sparse.csr_array((value, (row, at)), shape=shape) @ rows_of)
    doubt = sparse.csr_array((32 * EPS * size_of, (row, at)), shape=shape) @ abs(rows_of)
    return Form.of(rows, sparse.csr_array(doubt), network.place[np.nonzero(number >= 0)[0]].T)


def _nearby(bounds: Bounds, held: _Held, slides: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Steps 2 and 3."""
    network, number = bounds.network, held.number
    own, still = np.flatnonzero(slides), np.flatnonzero(held.rests)
    slips = network.slips(held.spin)
    size, strength = length(slips).at(own), network.holding.at(own)
    if not (size.least > 0).all():
        return None
    ends, there = network.contact[:, own].T, number >= 0
    missed = np.sqrt(sum((part.most[held.rests & ~held.among] ** 2).sum() for part in slips))
    off = missed / held.loose * UP if missed else 0.0  # of spins in V from the given ones
    wrong = length(
        [f.at(own) - strength * (s.at(own) / size) for f, s in zip(bounds.friction, slips, strict=True)]
    ).most
    left = np.stack([part.most for part in network.torques(moments(bounds.friction, network.normal))], axis=1)

    def unbalanced(turn: np.ndarray) -> np.ndarray:
        """Sizes (unknowns,) of torques, where slips (S,) turn by such a share."""
        unsure, torque = (wrong + 2 * turn * strength.most) * UP**2, left.copy()
        for end in ends.T:
            np.add.at(torque, end, unsure[:, None])
        found = np.zeros(there.sum())
        found[number[there]] = torque[there] * UP
        return found

    form = _curvature(network, held, own, np.stack([part.value[own] for part in slips], axis=1), size)
    if form is None or (tau := form.floor(sharp=True)) is None:
        return None
    # step 2
    scale = form.scale
    far = 2 * off * UP  # of slips at spins in V from the given ones
    slope = float(np.linalg.norm(scale * unbalanced(far / size.least))) * UP
    radius = 8 * slope / tau * UP + TINY
    largest = np.zeros(there.shape)
    largest[there] = scale[number[there]]
    largest = largest.max(axis=1)
    reach = (far + 1.5 * largest[ends].max(axis=1) * radius) * UP
    turn = reach / size.least * UP
    loss = np.zeros(len(there))
    for end in ends.T:
        np.add.at(loss, end, 8 * turn**2 * (strength.most / size.least))
    if not ((turn <= MOST_TURN).all() and (largest**2 * loss * UP < tau / 8).all()):
        return None
    # step 3
    torque = unbalanced(turn)
    by_left = float(np.linalg.norm(torque[held.left])) / held.loose * UP if np.isfinite(held.loose) else 0.0
    most = np.sqrt(2 * np.bincount(network.contact[:, network.counts].ravel()).max())
    by_pinned = (float(np.linalg.norm(torque[held.pinned])) + most * by_left) / held.stiff * UP**2
    room = (network.holding - length(bounds.friction)).lower()[still]
    if not (room > np.where(held.among[still], by_pinned, by_left) * UP).all():
        return None
    distance = np.zeros(len(slides))
    distance[own] = reach
    # the slips with what is taken exactly differ from the given ones by no more
    moved = length([a - b for a, b in zip(network.slips(network.spin), slips, strict=True)]).most
    return slides, np.where(slides, (distance + moved) * UP, 0.0)
