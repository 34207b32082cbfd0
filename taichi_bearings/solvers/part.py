"""`Part`, the part of a method that differs between a lattice and a packing; the contacts of a scene choose it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from taichi_bearings.scene import Progress
from taichi_bearings.solvers.found import Found


class Part(ABC):
    """The solver inside a minimising method. A method has one for lattices and another for packings, and hands its
    iterations to the one that fits the scene.

    iteration : how many iterations were made.
    """

    iteration: int

    def next_check(self, iteration: int) -> int:
        """Return the iteration at which to read the progress next.

        iteration : the one at which it was read now.
        """
        return iteration + 1

    @abstractmethod
    def advance(self, steps: int) -> None:
        """Make `steps` further iterations, or fewer if nothing is left to do."""

    @abstractmethod
    def progress(self) -> Progress:
        """Return the progress now: spins and forces, with the bounds on the objective that they prove."""

    def found(self) -> list[Found]:
        """Return the spins and forces that each sample of a packing has reached; empty for lattices, whose answers
        follow from the progress.
        """
        return []

    def state(self) -> dict[str, np.ndarray]:
        """Return by name all arrays that the further iterations depend on, for a checkpoint; empty for a method whose
        runs cannot be resumed.
        """
        return {}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:  # noqa: B027
        """Continue from the arrays by name that `state` returned in an earlier call. Here nothing is done, as for a
        method whose runs cannot be resumed.

        Raises ValueError if the arrays do not fit the scene.
        """
