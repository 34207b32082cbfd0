"""What every method offers to the common loop in drive.py."""

from collections.abc import Mapping
from typing import Protocol, TypeGuard

import numpy as np

from taichi_bearings.fields import Fields, FieldSpec
from taichi_bearings.scene import Progress, Scene
from taichi_bearings.solvers.table import MethodOptions


class Method(Protocol):
    """One way to reach the state of least dissipation: its steps and what they mean, nothing else.

    A method never prints, times, opens a file or decides when to stop.
    """

    @property
    def options(self) -> MethodOptions:
        """The row of the table that it was built from."""
        ...

    def plan(self, scene: Scene, spin: np.ndarray) -> FieldSpec:
        """Fields needed for this scene from these laboratory spins; fixes the spin components that are carried.

        Without fields the method works in NumPy alone.
        """
        ...

    def begin(self, scene: Scene, spin: np.ndarray, fields: Fields | None) -> None:
        """Load the fields and compile the kernels."""
        ...

    def next_check(self, iteration: int) -> int:
        """Iteration at which to look at the progress next."""
        ...

    def advance(self, steps: int) -> None:
        """Do `steps` iterations; a method on Taichi fields reads nothing back."""
        ...

    def progress(self) -> Progress:
        """Where the method stands, judged by the certificate; the only device-to-host read."""
        ...


class Dynamics(Method, Protocol):
    """A method whose iterations are steps in time, which can be interrupted and resumed with the same bits."""

    iteration: int
    time: float
    spin_axes: tuple[int, ...]

    def aim_at(self, time: float) -> None:
        """The next simulated time at which a state is wanted; infinity for none.

        `next_check` stops at the first step that reaches it; a method that chooses its steps ends one there exactly.
        """
        ...

    def state(self) -> dict[str, np.ndarray]:
        """Everything that the further course depends on."""
        ...

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from such a state; called after `begin`."""
        ...


def is_dynamics(method: Method) -> TypeGuard[Dynamics]:
    """True for a method that steps in time."""
    return hasattr(method, "aim_at")
