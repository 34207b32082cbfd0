"""`Found`, the spins and forces that a method has found for a packing.

Letters: N spheres, A contacts of the system, d tangents of a contact, C components of a spin, u = R omega.
"""

from dataclasses import dataclass

import numpy as np


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
