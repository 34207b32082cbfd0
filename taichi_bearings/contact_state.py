"""Which contacts slip: judged by slip speed and by friction together."""

from enum import IntEnum

import numpy as np

from taichi_bearings.certificate import saturation
from taichi_bearings.scene.scene import Scene


class ContactState(IntEnum):
    """Values of ``/contact/<axis>/state``."""

    SLIPLESS = 0
    SLIPPING = 1
    UNDECIDED = 2
    DRIVEN = 3  # between two driven spheres


SATURATED = 1 - 1e-6  # share of the friction disc from which a Coulomb contact counts as saturated


def classify(
    scene: Scene, slip: tuple[np.ndarray, ...], force: tuple[np.ndarray, ...], threshold: float
) -> tuple[np.ndarray, ...]:
    """State of every contact, one array (R, *contacts) of uint8 an axis.

    slip : speed, (R, *contacts) an axis; force : vectors (T, R, *contacts) an axis; threshold : length/time.

    Coulomb: slipping if the slip exceeds `threshold` and the friction is saturated (|f| > 0.999999 mu F_n), slipless if
    neither, undecided if the two disagree. Viscous contacts have no friction limit: the slip alone decides.
    """
    states = []
    for axis, (speed, ratio) in enumerate(zip(slip, saturation(scene, force), strict=True)):
        fast = speed > threshold
        full = ratio > SATURATED if scene.law == "coulomb" else fast
        state = np.where(fast & full, ContactState.SLIPPING, ContactState.SLIPLESS)
        state = np.where(fast != full, ContactState.UNDECIDED, state)
        states.append(np.where(scene.lattice.between_driven(axis), ContactState.DRIVEN, state).astype(np.uint8))
    return tuple(states)


def count(state: tuple[np.ndarray, ...], which: ContactState) -> np.ndarray:
    """Number of contacts in a state, (R,)."""
    return np.sum([(s == which).reshape(len(s), -1).sum(axis=1) for s in state], axis=0)
