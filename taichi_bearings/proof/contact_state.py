"""The state of each contact in one word: does it slip at every minimum, at some or at none, and is that proven?

:func:`classify` reads a state from slip speed and friction. :func:`decided` combines it with what is proven. The states
(`ContactState`) are SLIPLESS (it slips at no minimum), SLIPPING (at every one), TIED (at some), UNDECIDED, and DRIVEN
(the contact takes no part: it has no coefficient, or no free sphere).

Shapes: R samples, E contacts each, C spin components.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.proof.certificate import saturation
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.solution import ContactState as ContactState
from taichi_bearings.scene.solution import Solution


def decided(
    indicated: np.ndarray, known: np.ndarray, describes_motion: bool = False, has_ended: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays (R, E) for R samples of E contacts: the state of every contact, uint8, and a mask, True where
    the state is proven or the contact takes no part. The state is chosen from `indicated` and `known`:

    * if the states shall describe the minima: that in `known` where one is proven, else that in `indicated`;
    * if they describe a motion: that in `indicated`;
    * if they describe a motion that has ended: that in `indicated`; but a contact that is UNDECIDED there gets its
      state from `known`, and one that slips in one array and rests in the other becomes UNDECIDED.

    Contacts that are DRIVEN in `indicated` take no part and stay DRIVEN; TIED in it counts as UNDECIDED.

    indicated : (R, E), states read from slip and friction.
    known : (R, E), states proven of all minima, UNDECIDED where nothing is proven.
    describes_motion : True if the states describe a motion on its way, or follow from a slip threshold that the user
        chose; False if they describe the minima.
    has_ended : True if `describes_motion`, and the motion is proven to have come to a minimum. There no contact slips
        that rests at every minimum, nor the other way round."""
    indicated = np.where(indicated == ContactState.TIED, ContactState.UNDECIDED, indicated)
    acts, is_known = indicated != ContactState.DRIVEN, known != ContactState.UNDECIDED
    state = indicated if describes_motion else np.where(acts & is_known, known, indicated)
    if has_ended:
        is_plain = (known == ContactState.SLIPLESS) | (known == ContactState.SLIPPING)
        decides = acts & is_plain & (state != known)
        state = np.where(decides, np.where(indicated == ContactState.UNDECIDED, known, ContactState.UNDECIDED), state)
    return state.astype(np.uint8), are_proven(state, known)


def are_proven(state: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the mask (R, E), for R samples of E contacts, of those whose state is proven, or which take no part.

    state : (R, E), states that are reported.
    known : (R, E), states proven of all minima, UNDECIDED where nothing is proven."""
    found: np.ndarray = (state == ContactState.DRIVEN) | ((state == known) & (known != ContactState.UNDECIDED))
    return found


def all_slipless(scene: Bearing) -> np.ndarray:
    """Return states for R samples of E contacts, (R, E) uint8, a new array that a method can overwrite: SLIPLESS at all
    contacts, but DRIVEN where they take no part.

    scene : the R samples.
    """
    return np.where(scene.idle, ContactState.DRIVEN, ContactState.SLIPLESS).astype(np.uint8)


# Conventions of the reported states, none of which a proof uses.
LOST_POWER = 1e-8  # share of the sample's power; a contact that can dissipate less at the smallest jump is called lost
LOST_CONTACTS = 0.05  # a sample is too uneven if more than this share of its contacts is lost
SATURATED = 1 - 1e-6  # friction over mu F_n from which a contact counts as bearing all its friction


def classify(scene: Bearing, slip: np.ndarray, force: np.ndarray, threshold: float) -> np.ndarray:
    """Return the state of every contact, (R samples, E contacts) uint8, by its slip and its friction:

    * SLIPPING if its slip exceeds `threshold` and its friction is at its limit (|f| > 0.999999 mu F_n);
    * SLIPLESS if neither is so, and UNDECIDED if only one is;
    * DRIVEN if it takes no part.

    Viscous contacts have no friction limit: their slip alone decides.

    scene : the R samples, with coefficients and law of their contacts.
    slip : (R, E), slip speeds, length/time.
    force : (C components, R, E), contact forces, of which only the size is used.
    threshold : slip speed, length/time, up to which a contact counts as slipless.
    """
    fast = slip > threshold
    full = saturation(scene, force) > SATURATED if scene.law.has_friction else fast
    state = np.where(fast & full, ContactState.SLIPPING, ContactState.SLIPLESS)
    state = np.where(fast != full, ContactState.UNDECIDED, state)
    return np.where(scene.idle, ContactState.DRIVEN, state).astype(np.uint8)


@dataclass(frozen=True)
class Separation:
    """How far apart the slips of the slipless and of the slipping contacts are; arrays (R,) with an entry for each of R
    samples.

    largest_slipless, smallest_slipping : slip speeds, length/time; NaN where there is no such contact.
    decades : log10 of smallest_slipping / largest_slipless; a largest slipless slip below the rounding of the spins is
        taken as that rounding.
    """

    largest_slipless: np.ndarray
    smallest_slipping: np.ndarray
    decades: np.ndarray


def separate(scene: Bearing, slip: np.ndarray, state: np.ndarray) -> Separation:
    """Return for each of R samples how far apart the slips of its slipless and of its slipping contacts are.

    scene : the R samples.
    slip : (R, E), slip speeds of the E contacts of R samples, length/time.
    state : (R, E), their states."""
    still, moving = state == ContactState.SLIPLESS, state == ContactState.SLIPPING
    largest = np.where(still.any(axis=1), np.where(still, slip, 0.0).max(axis=1), np.nan)
    smallest = np.where(moving.any(axis=1), np.where(moving, slip, np.inf).min(axis=1), np.nan)
    rounding = np.finfo(np.float64).eps * scene.slip_radius * scene.fastest
    with np.errstate(divide="ignore", invalid="ignore"):
        decades = np.log10(smallest / np.maximum(largest, rounding))
    return Separation(largest, smallest, decades)


def unresolved(solution: Solution, times: float = 1.0) -> np.ndarray:
    """Return the mask (R, E) of the contacts about which the gap says nothing: their friction limit times slip is at
    most `times` the difference between the objective and its proven lower bound.

    solution : R samples of E contacts, solved."""
    scene, left = solution.scene, times * (solution.objective - solution.lower_bound)
    found: np.ndarray = scene.strength * scene.coefficient * solution.slip <= left[:, None]
    return found


def too_uneven(solution: Solution) -> np.ndarray:
    """Return the mask (R,) of those of R samples whose contacts are so uneven that their slips cannot be trusted.

    Let j be the smallest component of the imposed jump J, and p the power of a contact that slips by j times the
    radius. The contact is lost, its slip being whatever rounding makes it, in either of two cases:

    * p is at most LOST_POWER times the power of its sample;
    * p j / J is at most the gap between objective and lower bound.

    A sample is too uneven if more than LOST_CONTACTS of its contacts are lost.

    solution : the R samples, solved.
    """
    scene, acting = solution.scene, ~solution.scene.idle
    at_jump = scene.strength * scene.coefficient * scene.slip_radius * scene.smallest_jump  # p
    left = solution.objective - solution.lower_bound
    # j / J: a small component j at right angles to the rest of the jump lengthens it by j^2 / (2 J), such a share of j.
    share = scene.smallest_jump / scene.jump if scene.jump else np.nan
    lost = acting & ((share * at_jump <= left[:, None]) | (at_jump <= LOST_POWER * solution.power[:, None]))
    lost &= scene.smallest_jump > 0
    found: np.ndarray = lost.sum(axis=1) > LOST_CONTACTS * acting.sum(axis=1)
    return found


def what_is_proven(state: np.ndarray, proven: np.ndarray) -> np.ndarray:
    """Return the states (R samples, E contacts) that are proven, and UNDECIDED for all other contacts.

    state : (R, E), states that are reported.
    proven : (R, E) mask of those that are proven."""
    return np.where(proven, state, ContactState.UNDECIDED)


def by_threshold(slip: np.ndarray, state: np.ndarray, threshold: float) -> np.ndarray:
    """Return states (..., E) of E contacts by slip alone: SLIPPING where a contact is faster than `threshold`, SLIPLESS
    elsewhere, but DRIVEN where it takes no part.

    slip : (..., E), slip speeds, length/time.
    state : (..., E), DRIVEN for contacts that take no part; other states are not read.
    threshold : largest speed, length/time, of a contact that counts as slipless."""
    state_by_slip = np.where(slip > threshold, ContactState.SLIPPING, ContactState.SLIPLESS)
    return np.where(state == ContactState.DRIVEN, state, state_by_slip).astype(np.uint8)
