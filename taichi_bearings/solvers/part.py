"""`Part`, the part of a method that differs between a lattice and a packing, which the contacts of a scene choose; and
`Found`, the spins and forces that it has found for a packing.

Letters: N spheres, A contacts of the system, d tangents of a contact, C components of a spin, u = R omega.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from taichi_bearings.scene import Progress


@dataclass(frozen=True)
class Found:
    """Spins and forces that a method has found for a packing, not yet judged.

    The contacts are the A that take part; the unknowns are the components of u = radius * spin of free spheres.

    spins : (unknowns,), u, length/time.
    force : (d, A), components of each contact force along its d tangents.
    method : name of the method.
    slips : (A,), mask of slipping contacts, if the method has settled the contact states; else None.
    ties : (A,), mask of contacts whose slip is not the same at all minima, or that bear all their friction without
        slip; None if that is not known.
    steps : factorisations that the method made.
    everywhere : (N spheres, C components), u of all spheres, from methods that step all of them; else None.
    open : (A,), mask of contacts that could not be settled: they slip by more than rounding, but bear less than the
        friction limit; None if there is no such mask.
    rest : (unknowns,), second double of each u, where a method computes sums of two; else None.
    states_are_asked : False if no contact state is to be proven, since a bound on the power alone is asked for.
    """

    spins: np.ndarray
    force: np.ndarray
    method: str
    slips: np.ndarray | None = None
    ties: np.ndarray | None = None
    steps: int = 0
    everywhere: np.ndarray | None = None
    open: np.ndarray | None = None
    rest: np.ndarray | None = None
    states_are_asked: bool = True


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
