"""Which contacts slip: judged by slip speed and by friction together."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from taichi_bearings.proof.certificate import saturation
from taichi_bearings.scene.scene import Scene
from taichi_bearings.scene.solution import Solution


class ContactState(IntEnum):
    """Values of ``/contact/<axis>/state``."""

    SLIPLESS = 0
    SLIPPING = 1
    UNDECIDED = 2  # critical, tied, or not known
    DRIVEN = 3  # between two driven spheres, or absent: it takes no part


def all_slipless(scene: Scene) -> tuple[np.ndarray, ...]:
    """States of contacts that all rest, one array (R, *contacts) of uint8 an axis, for a method to fill in."""
    states = []
    for axis in range(scene.lattice.dimension):
        state = np.full((scene.replicas, *scene.lattice.contact_shape(axis)), ContactState.SLIPLESS, dtype=np.uint8)
        state[scene.idle(axis)] = ContactState.DRIVEN
        states.append(state)
    return tuple(states)


SATURATED = 1 - 1e-6  # share of the friction disc from which a Coulomb contact counts as saturated


def classify(
    scene: Scene, slip: tuple[np.ndarray, ...], force: tuple[np.ndarray, ...], threshold: float
) -> tuple[np.ndarray, ...]:
    """State of every contact, one array (R, *contacts) of uint8 an axis.

    slip : speed, (R, *contacts) an axis; force : vectors (T, R, *contacts) an axis; threshold : length/time.

    Slipping if the slip exceeds `threshold` and the friction is saturated (|f| > 0.999999 mu F_n), slipless if neither,
    undecided if the two disagree. Viscous contacts have no friction limit: the slip alone decides.
    """
    states = []
    for axis, (speed, ratio) in enumerate(zip(slip, saturation(scene, force), strict=True)):
        fast = speed > threshold
        full = ratio > SATURATED if scene.law.holds else fast
        state = np.where(fast & full, ContactState.SLIPPING, ContactState.SLIPLESS)
        state = np.where(fast != full, ContactState.UNDECIDED, state)
        states.append(np.where(scene.idle(axis), ContactState.DRIVEN, state).astype(np.uint8))
    return tuple(states)


@dataclass(frozen=True)
class Separation:
    """How far apart in slip the two populations of contacts are, one entry (R,) each.

    largest_slipless, smallest_slipping : length/time; NaN where there are none.
    decades : log10 of their ratio, a slipless slip counting as the rounding of the spins at least.
    """

    largest_slipless: np.ndarray
    smallest_slipping: np.ndarray
    decades: np.ndarray


def separate(scene: Scene, slip: tuple[np.ndarray, ...], state: tuple[np.ndarray, ...]) -> Separation:
    """Observed gap between the slips of slipless and of slipping contacts."""
    flat_slip = np.concatenate([s.reshape(scene.replicas, -1) for s in slip], axis=1)
    flat_state = np.concatenate([s.reshape(scene.replicas, -1) for s in state], axis=1)
    still, moving = flat_state == ContactState.SLIPLESS, flat_state == ContactState.SLIPPING
    largest = np.where(still.any(axis=1), np.where(still, flat_slip, 0.0).max(axis=1), np.nan)
    smallest = np.where(moving.any(axis=1), np.where(moving, flat_slip, np.inf).min(axis=1), np.nan)
    rounding = np.finfo(np.float64).eps * scene.lattice.radius * max(abs(scene.spin_top), abs(scene.spin_bottom))
    with np.errstate(divide="ignore", invalid="ignore"):
        decades = np.log10(smallest / np.maximum(largest, rounding))
    return Separation(largest, smallest, decades)


def unresolved(solution: Solution) -> tuple[np.ndarray, ...]:
    """Masks (R, *contacts) an axis: friction times slip is no more than what power and lower bound leave open."""
    scene, left = solution.scene, solution.objective - solution.lower_bound
    return tuple(
        scene.strength * of * slip <= left.reshape(-1, *(1,) * (slip.ndim - 1))
        for of, slip in zip(scene.coefficient, solution.slip, strict=True)
    )


def critical(solution: Solution) -> np.ndarray:
    """Number (R,) of undecided contacts that bear all their friction, with a slip that the gap does not resolve; but
    for those that are known to slip at other minima."""
    scene, found = solution.scene, np.zeros(solution.scene.replicas, dtype=np.int64)
    others = count(solution.state, ContactState.UNDECIDED) - solution.findings.get("tied_contacts", 0)
    if scene.law.holds:
        parts = zip(solution.state, solution.force, scene.coefficient, unresolved(solution), strict=True)
        for state, force, of, faint in parts:
            at_limit = (state == ContactState.UNDECIDED) & faint & (force >= SATURATED * scene.strength * of)
            found += at_limit.reshape(len(found), -1).sum(axis=1)
    return np.minimum(found, others)


def counts(state: tuple[np.ndarray, ...]) -> np.ndarray:
    """Number of contacts in each state, (R, states)."""
    size = len(ContactState)
    return np.sum([[np.bincount(one.ravel(), minlength=size) for one in of_axis] for of_axis in state], axis=0)


def count(state: tuple[np.ndarray, ...], which: ContactState) -> np.ndarray:
    """Number of contacts in a state, (R,)."""
    return counts(state)[:, which]
