"""One word for each contact: does it slip at every minimum, at some or at none, and is that proven?

What slip speed and friction indicate for a contact (:func:`classify`) and what is proven of it are combined in one
place, :func:`decided`. Letters: R samples, E contacts, C components.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.proof.certificate import saturation
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.solution import ContactState as ContactState
from taichi_bearings.scene.solution import Solution


def decided(
    told: np.ndarray, known: np.ndarray, is_present: bool = False, has_ended: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """The state of every contact, (R, E) uint8, and a mask (R, E) of those that are proven.

    told : (R, E), the states that slip and friction indicate; where it is DRIVEN a contact takes no part, and counts as
        proven.
    known : (R, E), the states that are proven of all minima, UNDECIDED elsewhere.
    is_present : the states are not those of the minima, but of a motion on its way, or by a threshold of slip that was
        asked for: then they stay as slip and friction indicate.
    has_ended : such a motion is proven to have come to a minimum. There no contact slips that rests at every minimum,
        nor the other way round: a contact for which `told` contradicts `known` becomes undecided, and one that is
        undecided in `told` gets the known state.
    """
    told = np.where(told == ContactState.TIED, ContactState.UNDECIDED, told)
    acts, is_known = told != ContactState.DRIVEN, known != ContactState.UNDECIDED
    state = told if is_present else np.where(acts & is_known, known, told)
    if has_ended:
        is_plain = (known == ContactState.SLIPLESS) | (known == ContactState.SLIPPING)
        decides = acts & is_plain & (state != known)
        state = np.where(decides, np.where(told == ContactState.UNDECIDED, known, ContactState.UNDECIDED), state)
    return state.astype(np.uint8), are_proven(state, known)


def are_proven(state: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(R, E) mask of the contacts whose state is the one that is proven of all minima, and of those that take no part.
    state, known : (R, E)."""
    return (state == ContactState.DRIVEN) | ((state == known) & (known != ContactState.UNDECIDED))


def all_slipless(scene: Bearing) -> np.ndarray:
    """States (R, E) uint8 in which all contacts rest, for a method to fill in."""
    return np.where(scene.idle, ContactState.DRIVEN, ContactState.SLIPLESS).astype(np.uint8)


LOST_POWER = 1e-8  # share of the power below which what a contact dissipates at the smallest jump component is lost
LOST_CONTACTS = 0.05  # share of contacts that may dissipate less than that
SATURATED = 1 - 1e-6  # share of the friction disc from which a Coulomb contact counts as saturated


def classify(scene: Bearing, slip: np.ndarray, force: np.ndarray, threshold: float) -> np.ndarray:
    """State of every contact, (R, E) uint8, by slip and friction.

    slip : speeds, (R, E). force : (C, R, E). threshold : slip speed, length/time.

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
    """How far apart in slip the slipless and the slipping contacts are, one entry (R,) each.

    largest_slipless, smallest_slipping : slip speeds, length/time; NaN where there are none.
    decades : log10 of their ratio, where a slipless slip counts at least as much as the rounding of the spins.
    """

    largest_slipless: np.ndarray
    smallest_slipping: np.ndarray
    decades: np.ndarray


def separate(scene: Bearing, slip: np.ndarray, state: np.ndarray) -> Separation:
    """The gap between the slips of slipless and of slipping contacts. slip, state : (R, E)."""
    still, moving = state == ContactState.SLIPLESS, state == ContactState.SLIPPING
    largest = np.where(still.any(axis=1), np.where(still, slip, 0.0).max(axis=1), np.nan)
    smallest = np.where(moving.any(axis=1), np.where(moving, slip, np.inf).min(axis=1), np.nan)
    rounding = np.finfo(np.float64).eps * scene.slip_radius * scene.fastest
    with np.errstate(divide="ignore", invalid="ignore"):
        decades = np.log10(smallest / np.maximum(largest, rounding))
    return Separation(largest, smallest, decades)


def unresolved(solution: Solution, times: float = 1.0) -> np.ndarray:
    """(R, E) mask of contacts that dissipate, as friction times slip, no more than `times` the difference of power and
    lower bound."""
    scene, left = solution.scene, times * (solution.objective - solution.lower_bound)
    return scene.strength * scene.coefficient * solution.slip <= left[:, None]


def too_uneven(solution: Solution) -> np.ndarray:
    """(R,) mask of samples with so many weak contacts that their slips cannot be trusted: what such contacts dissipate
    is lost in the gap, or in the rounding of doubles, so their slips are whatever rounding makes them."""
    scene, acting = solution.scene, ~solution.scene.idle
    at_jump = scene.strength * scene.coefficient * scene.slip_radius * scene.smallest_jump  # power of a slip by it
    left = solution.objective - solution.lower_bound
    # a slip by the whole jump gets longer by about this share of the smallest component added across it
    share = scene.smallest_jump / scene.jump if scene.jump else np.nan
    lost = acting & ((share * at_jump <= left[:, None]) | (at_jump <= LOST_POWER * solution.power[:, None]))
    lost &= scene.smallest_jump > 0
    return lost.sum(axis=1) > LOST_CONTACTS * acting.sum(axis=1)


def what_is_proven(state: np.ndarray, proven: np.ndarray) -> np.ndarray:
    """The states (R, E) that are proven, UNDECIDED for the other contacts: the `known` of :func:`decided`."""
    return np.where(proven, state, ContactState.UNDECIDED)


def by_threshold(slip: np.ndarray, state: np.ndarray, threshold: float) -> np.ndarray:
    """States by slip alone: contacts faster than `threshold` slip, all others are slipless, except those that take no
    part. slip, threshold : length/time. slip, state : (..., E)."""
    told = np.where(slip > threshold, ContactState.SLIPPING, ContactState.SLIPLESS)
    return np.where(state == ContactState.DRIVEN, state, told).astype(np.uint8)


def counts(state: np.ndarray) -> np.ndarray:
    """Number of contacts in each state, (R, states). state : (R, E)."""
    return np.stack([np.bincount(one, minlength=len(ContactState)) for one in state])


def count(state: np.ndarray, which: ContactState) -> np.ndarray:
    """Number of contacts in the state `which`, (R,). state : (R, E)."""
    return counts(state)[:, which]
