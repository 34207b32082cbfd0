"""Which contacts slip at every minimum of the Coulomb law, proven from approximate spins and friction.

Let T be the contacts without any slip and S the others. Spheres joined by T are one domain of a component.

1. Over motions that keep every domain in one piece the power is a convex function with a single minimum, close to these
   spins (curvature.py).
2. At that minimum every contact of S still slips and exerts its friction along the slip; this is known closely. What
   the contacts of T bear, as the file says, balances it up to E_D, the sum of the torques left over in a domain D. Each
   domain is in balance as a whole, or held by a driven plane: so forces along the contacts that join it, none larger
   than E_D, take away what is left over. If then every contact of T stays inside its friction disc, the result is in
   balance and admissible, and it agrees with the law at every contact: the minimum of step 1 is one of the whole power.
3. All minima share all optimal forces (equations.md, 7): where the friction is below its limit nothing slips. So T
   rests at every minimum; every minimum then is one of step 1, where there is only one, and S slips at it.

With one component (all of 2D, and cubic lattices driven about x or y) step 1 has no curvature. There minima are
mixtures of lightest cuts, and friction in balance leaves room on them for no more than the gap G between the bounds: a
cut that crosses from u to v has mu F_n - f <= G there. Spheres from which and to which one can go with more room than G
are on one side of every lightest cut. That decides contacts one by one, ties or not.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components

from taichi_bearings.verifier.balance import bearable
from taichi_bearings.verifier.curvature import Slipping, nearest_minimum
from taichi_bearings.verifier.enclosure import UP, Enclosure, joined
from taichi_bearings.verifier.motion import Motion, whole_planes
from taichi_bearings.verifier.samples import DRIVEN_STATE, SLIPLESS, SLIPPING, UNPROVEN, Samples
from taichi_bearings.verifier.ties import MISSED_LIMIT, tied_states

PROVEN_AT_ONCE = 200_000  # spheres of the samples that are proven at once, at most


@dataclass(frozen=True)
class States:
    """Of one sample. proven : (E,) of UNPROVEN, SLIPLESS, SLIPPING, CRITICAL (slips at no minimum, at the limit of this
    friction) or TIED (slips at some minima, rests at others). unique : is there only one minimum? None if that is not
    known. reason : why not all is proven, or "". slip_bound : (E,), that no slip of any minimum exceeds, of packings.
    """

    proven: np.ndarray
    unique: bool | None
    reason: str = ""
    slip_bound: np.ndarray | None = None

    def agree(self, claimed: np.ndarray) -> bool:
        """True if each contact is proven to slip at every minimum or at none, as claimed: (E,), 0 slipless, 1 slipping,
        3 takes no part."""
        return bool((((self.proven == claimed) & (self.proven <= SLIPPING)) | (claimed == DRIVEN_STATE)).all())

    @classmethod
    def of_axes(cls, proven: Iterable[np.ndarray], unique: bool | None, reason: str = "") -> States:
        """From arrays (*contacts,) an axis."""
        return cls(np.concatenate([of.ravel() for of in proven]), unique, reason)


def proven_states(motion: Motion, gap: np.ndarray) -> list[States]:
    """gap : (R,), objective of the spins less the work of the friction, price of its torques paid (Coulomb), or less
    the lower bound (viscous contacts); rounded up, in the units of `Motion.power`."""
    samples = motion.samples
    if samples.flows:
        return _by_distance(motion, gap)
    if not samples.needed:
        return [States.of_axes((np.full(c.shape[1:], SLIPLESS) for c in samples.coefficient), True)] * samples.count
    decided = _by_cuts(motion, gap) if len(samples.needed) == 1 else _by_curvature(motion)
    idle = {k: _rests(motion, k) for k in set(samples.components) - set(samples.needed)}
    found = []
    for number, states in enumerate(decided):
        varies = [k for k, rests in idle.items() if not rests[number]]
        if motion.torn[number]:
            states = _nothing(samples, "contacts without slip join the two driven planes")
        elif varies:
            states = _nothing(
                samples, f"the spin component about {'xyz'[varies[0]]} varies, which it does at no minimum"
            )
        found.append(states)
    return found


def _nothing(samples: Samples, reason: str) -> States:
    return States.of_axes((np.full(c.shape[1:], UNPROVEN) for c in samples.coefficient), None, reason)


def _rests(motion: Motion, component: int) -> np.ndarray:
    """(R,), True if a component that the driving does not need is equal at both ends of every contact that feels it."""
    samples, rests = motion.samples, np.ones(motion.samples.count, dtype=bool)
    for axis in range(samples.dimension):
        if component in samples.felt(axis):
            low, high = samples.ends(axis)
            for part in samples.signed_spin[component]:
                even = (part[low] == part[high]) | samples.absent[axis]
                rests &= even.reshape(samples.count, -1).all(axis=1)
    return rests


def _by_distance(motion: Motion, gap: np.ndarray) -> list[States]:
    """Viscous: the objective exceeds the least one by share / 2 times the sum of eta |z - z*|^2, whatever friction
    there is: slips that would cost more do not end."""
    found = []
    half = motion.samples.share / 2
    for axis, (slips, size, slope) in enumerate(zip(motion.slips, motion.size, motion.samples.slope, strict=True)):
        states = np.where(motion.samples.idle(axis), SLIPLESS, UNPROVEN)
        costs = half * slope.at(slips.own).least * size.least**2 / UP
        states.put(slips.own, np.where(costs > gap[slips.sample], SLIPPING, UNPROVEN))
        found.append(states)
    return [States.of_axes((states[r] for states in found), True) for r in range(motion.samples.count)]


def _by_cuts(motion: Motion, gap: np.ndarray) -> list[States]:
    """One component: what is on the same side, or on opposite sides, of all lightest cuts."""
    samples = motion.samples
    (k,) = samples.needed
    place, jump = whole_planes(samples, k), samples.jump_over(k, samples.dimension)
    sign = samples.sublattice[None] * np.where(jump.high > 0, 1.0, -1.0)
    flat = np.broadcast_to(jump.most == 0, place.shape)  # layers without a jump: nothing slips there at any minimum
    least = np.broadcast_to(jump.least, place.shape)
    below, above, up, down, owner, drop = [], [], [], [], [], []
    for axis in range(samples.dimension):
        if k in samples.felt(axis):
            low, high = samples.ends(axis)
            bears = Enclosure.exact(sign[high] * samples.turning[axis][k])
            up.append((samples.strength[axis] - bears).reshaped((-1,)))
            down.append((samples.strength[axis] + bears).reshaped((-1,)))
            below.append(place[low].ravel())
            above.append(place[high].ravel())
            owner.append(np.repeat(np.arange(samples.count), bears.high[0].size))
            drop.append(least[low].ravel())
    lower, upper, of_sample, of_layer = (np.concatenate(parts) for parts in (below, above, owner, drop))
    slack = joined(up), joined(down)
    beyond = sum(np.maximum(s.error - s.high - s.low, 0.0) for s in slack)
    excess = np.bincount(of_sample, beyond, samples.count)
    left = np.maximum(gap, 0.0) + (jump.most.max() * excess * UP if samples.is_layered else 0.0)  # of other layers
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing holds where there is no jump
        room = (left[of_sample] / of_layer + excess[of_sample]) * UP
    # with more room than all have together: if the first sphere is above a lightest cut, so is the second
    held = [s.least * (s.high > 0) > room for s in slack]
    first = np.concatenate([upper[held[0]], lower[held[1]]])
    second = np.concatenate([lower[held[0]], upper[held[1]]])
    size = place.size
    follows = sparse.csr_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(size, size))
    together = connected_components(follows, directed=True, connection="strong")[1]
    bottom, top = (np.unique(place[..., end][~flat[..., end]]) for end in (0, -1))
    is_above, is_below = reached(follows, top), reached(follows.T.tocsr(), bottom)
    contradicts = np.bincount(bottom // samples.sublattice.size, is_above[bottom], samples.count) > 0
    found = []
    for axis, coefficient in enumerate(samples.coefficient):
        a, b = (place[end] for end in samples.ends(axis))
        alike = (together[a] == together[b]) | (is_above[a] & is_above[b]) | (is_below[a] & is_below[b])
        alike |= flat[samples.ends(axis)[0]]
        apart = (is_above[a] & is_below[b]) | (is_below[a] & is_above[b])
        states = np.where(alike | samples.absent[axis], SLIPLESS, np.where(apart, SLIPPING, UNPROVEN))
        found.append(states if k in samples.felt(axis) else np.full(coefficient.shape, SLIPLESS))
    done = ~np.any([(states == UNPROVEN).reshape(samples.count, -1).any(axis=1) for states in found], axis=0)
    return [
        States.of_axes(
            (states[r] for states in found), True if done[r] else None, "" if done[r] else "cuts (nearly) tie"
        )
        if not contradicts[r]
        else _nothing(samples, "the friction contradicts itself")
        for r in range(samples.count)
    ]


def reached(follows: sparse.csr_array, starts: np.ndarray) -> np.ndarray:
    """Mask of the nodes that can be reached from any of the starts."""
    size = follows.shape[0]
    ends = (np.full(len(starts), size), starts)
    source = sparse.csr_array((np.ones(len(starts), dtype=np.int8), ends), shape=(size + 1, size + 1))
    whole = sparse.block_diag([follows, sparse.csr_array((1, 1), dtype=np.int8)], format="csr") + source
    reached = np.zeros(size + 1, dtype=bool)
    reached[breadth_first_order(whole, size, return_predecessors=False)] = True
    return reached[:-1]


def _by_curvature(motion: Motion) -> list[States]:
    """Two components: steps 1 to 3 of the module docstring, of all samples at once, or else of each half of them; of
    each alone where friction is repeated, so that there may be ties."""
    samples, count = motion.samples, motion.samples.count
    if count == 1:
        return [_of_one(motion)]
    if _repeats(motion):
        return [_of_one(Motion(samples.one(number))) for number in range(count)]
    if count * samples.sublattice.size <= PROVEN_AT_ONCE and not _doubt(motion, Slipping.of(motion)):
        return [_as_stored(motion, number) for number in range(count)]
    halves = samples.some(slice(None, count // 2)), samples.some(slice(count // 2, None))
    return [states for half in halves for states in _by_curvature(Motion(half))]


def _of_one(motion: Motion) -> States:
    """The same of one sample, with ties: first where friction is repeated."""
    contacts, repeats = Slipping.of(motion), _repeats(motion)
    tied = tied_states(motion, contacts) if repeats else None
    if tied is None and not (doubt := _doubt(motion, contacts)):
        return _as_stored(motion, 0)
    tied = tied_states(motion, contacts) if not repeats else tied
    return _nothing(motion.samples, doubt) if tied is None else States.of_axes(*tied, _why_open(tied[0]))


def _as_stored(motion: Motion, number: int) -> States:
    """What slips in the file slips at the only minimum, and nothing else."""
    return States.of_axes((np.where(moving[number], SLIPPING, SLIPLESS) for moving in motion.moving), True)


def _repeats(motion: Motion) -> bool:
    """Have two slipping contacts of some sample the same friction?"""
    pairs = list(zip(motion.samples.coefficient, motion.slips, strict=True))
    values, sample = (np.concatenate(of) for of in zip(*((c.take(s.own), s.sample) for c, s in pairs), strict=True))
    order = np.lexsort((values, sample))
    return bool(((np.diff(values[order]) == 0) & (np.diff(sample[order]) == 0)).any())


def _why_open(states: tuple[np.ndarray, ...]) -> str:
    """Why some of these states, found one by one, are not proven."""
    return "minima tie in ways that are not known closely enough" if any((s == UNPROVEN).any() for s in states) else ""


@np.errstate(all="ignore")  # what is not finite proves nothing
def _doubt(motion: Motion, contacts: Slipping) -> str:
    """What is missing in the proof; "" if nothing is. Samples are like parts of one that no contact joins."""
    if not _saturated(motion):
        return "contacts slip whose friction is not at its limit"
    if not (contacts.size.least > 0).all():
        return "slips are lost in the rounding of the spins"
    near = nearest_minimum(contacts)
    if near is None:
        return "the power is not known to rise in all directions"
    if not bearable(motion, *near):  # perhaps the directions of slip are not known closely enough
        near = nearest_minimum(near[0].improved())
        if near is None or not bearable(motion, *near):
            return "slipless contacts are not known to bear what the others leave to them"
    return ""


def _saturated(motion: Motion) -> bool:
    """True if the friction of all slipping contacts is about at its limit, as it is near a minimum."""
    for turning, slips, strength in zip(motion.samples.turning, motion.slips, motion.strength, strict=True):
        size = np.sqrt(sum(part.take(slips.own) ** 2 for part in turning.values()))
        if not (size >= (1 - MISSED_LIMIT) * strength.value).all():
            return False
    return True
