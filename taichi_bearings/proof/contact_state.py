"""Which contacts slip: judged by slip speed and by friction together."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from taichi_bearings.proof.certificate import saturation
from taichi_bearings.scene.scene import Scene
from taichi_bearings.scene.solution import Solution


class ContactState(IntEnum):
    """Values of ``/contact/<axis>/state``, and of ``/contact/<axis>/proven``: the state at every minimum."""

    SLIPLESS = 0
    SLIPPING = 1
    UNDECIDED = 2  # critical, tied, or not known; not proven
    DRIVEN = 3  # between two driven spheres, or absent: it takes no part
    TIED = 4  # slips at some minima and rests at others: undecided in ``state``


def all_slipless(scene: Scene) -> np.ndarray:
    """States (R, E) uint8 of contacts that all rest, for a method to fill in."""
    return np.where(scene.idle, ContactState.DRIVEN, ContactState.SLIPLESS).astype(np.uint8)


SLIP_AT_LIMIT = 1e-2  # of the jump, that the gap must resolve at a critical contact
LOST_POWER = 1e-8  # of the power, that a contact must dissipate when it slips by the smallest component of the jump
LOST_CONTACTS = 0.05  # share of contacts that may dissipate less than that
SATURATED = 1 - 1e-6  # share of the friction disc from which a Coulomb contact counts as saturated


def classify(scene: Any, slip: np.ndarray, force: np.ndarray, threshold: float) -> np.ndarray:
    """State of every contact, (R, E) uint8.

    scene : a Scene, or a packing in its words. slip : speed, (R, E). force : (C, R, E). threshold : length/time.

    Slipping if the slip exceeds `threshold` and the friction is saturated (|f| > 0.999999 mu F_n), slipless if neither,
    undecided if the two disagree. Viscous contacts have no friction limit: the slip alone decides.
    """
    fast = slip > threshold
    full = saturation(scene, force) > SATURATED if scene.law.holds else fast
    state = np.where(fast & full, ContactState.SLIPPING, ContactState.SLIPLESS)
    state = np.where(fast != full, ContactState.UNDECIDED, state)
    return np.where(scene.idle, ContactState.DRIVEN, state).astype(np.uint8)


@dataclass(frozen=True)
class Separation:
    """How far apart in slip the two populations of contacts are, one entry (R,) each.

    largest_slipless, smallest_slipping : length/time; NaN where there are none.
    decades : log10 of their ratio, a slipless slip counting as the rounding of the spins at least.
    """

    largest_slipless: np.ndarray
    smallest_slipping: np.ndarray
    decades: np.ndarray


def separate(scene: Scene, slip: np.ndarray, state: np.ndarray) -> Separation:
    """Observed gap between the slips of slipless and of slipping contacts; slip, state : (R, E)."""
    still, moving = state == ContactState.SLIPLESS, state == ContactState.SLIPPING
    largest = np.where(still.any(axis=1), np.where(still, slip, 0.0).max(axis=1), np.nan)
    smallest = np.where(moving.any(axis=1), np.where(moving, slip, np.inf).min(axis=1), np.nan)
    rounding = np.finfo(np.float64).eps * scene.lattice.radius * scene.fastest
    with np.errstate(divide="ignore", invalid="ignore"):
        decades = np.log10(smallest / np.maximum(largest, rounding))
    return Separation(largest, smallest, decades)


def unresolved(solution: Solution, times: float = 1.0) -> np.ndarray:
    """(R, E) True where friction times slip is no more than what power and lower bound leave open, or so many times
    that."""
    scene, left = solution.scene, times * (solution.objective - solution.lower_bound)
    return scene.strength * scene.coefficient * solution.slip <= left[:, None]


def too_uneven(solution: Solution) -> np.ndarray:
    """(R,) True where too many contacts are so weak beside the rest that the gap, or doubles, lose what they dissipate:
    they bend the others, whose slips are then whatever rounding makes them."""
    scene, acting = solution.scene, ~solution.scene.idle
    at_jump, left = _at_smallest_jump(solution), solution.objective - solution.lower_bound
    share = scene.smallest_jump / scene.jump if scene.jump else np.nan  # of it, added to a slip by the other component
    lost = acting & ((share * at_jump <= left[:, None]) | (at_jump <= LOST_POWER * solution.power[:, None]))
    lost &= scene.smallest_jump > 0
    return lost.sum(axis=1) > LOST_CONTACTS * acting.sum(axis=1)


def _at_smallest_jump(solution: Solution) -> np.ndarray:
    """Power (R, E) that contacts dissipate by friction when they slip by the component of the jump that differs
    least."""
    scene = solution.scene
    return scene.strength * scene.coefficient * scene.lattice.radius * scene.smallest_jump


def critical(solution: Solution) -> np.ndarray:
    """Number (R,) of undecided contacts that bear all their friction, with a slip that the gap does not resolve; but
    for those that are known to slip at other minima. On lattices those that are not proven to rest count where the gap
    would resolve a hundredth of the jump, and coefficients are not too uneven."""
    scene, undecided = solution.scene, solution.state == ContactState.UNDECIDED
    others = undecided.sum(axis=1) - solution.findings.get("tied_contacts", 0)
    if not scene.law.holds:
        return np.zeros(scene.replicas, dtype=np.int64)
    full = solution.force >= SATURATED * scene.strength * scene.coefficient
    left = (solution.objective - solution.lower_bound)[:, None]
    found = undecided & full & unresolved(solution) & (solution.proven != ContactState.TIED)
    if isinstance(scene, Scene):
        clear = (left <= SLIP_AT_LIMIT * _at_smallest_jump(solution)) & ~too_uneven(solution)[:, None]
        found &= clear | (solution.proven == ContactState.SLIPLESS)
    return np.minimum(found.sum(axis=1), others)


def nothing_proven(state: np.ndarray) -> np.ndarray:
    """`Solution.proven` of contacts in these states, (R, E), where no proof is known."""
    return np.where(state == ContactState.DRIVEN, ContactState.DRIVEN, ContactState.UNDECIDED).astype(np.uint8)


def by_threshold(slip: np.ndarray, state: np.ndarray, threshold: float) -> np.ndarray:
    """States of contacts of which those that are faster than `threshold` slip, and all others are slipless, but for
    those that take no part. slip, threshold : length/time. slip, state : (..., E)."""
    told = np.where(slip > threshold, ContactState.SLIPPING, ContactState.SLIPLESS)
    return np.where(state == ContactState.DRIVEN, state, told).astype(np.uint8)


def all_proven(state: np.ndarray, proven: np.ndarray) -> np.ndarray:
    """(R,) True where every contact has the state that is proven of it; state, proven : (R, E)."""
    return np.asarray(((proven == state) & (proven != ContactState.UNDECIDED)).all(axis=1))


def counts(state: np.ndarray) -> np.ndarray:
    """Number of contacts in each state, (R, states); state : (R, E)."""
    return np.stack([np.bincount(one, minlength=len(ContactState)) for one in state])


def count(state: np.ndarray, which: ContactState) -> np.ndarray:
    """Number of contacts in a state, (R,)."""
    return counts(state)[:, which]
