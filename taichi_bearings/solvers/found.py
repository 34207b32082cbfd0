"""`Found`, the spins and forces that a method has found for a packing.

Letters: N spheres, A contacts of the system, d tangents of a contact, C components of a spin, u = R omega.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Found:
    """Spins and forces that a method has found, not yet judged.

    spins : (unknowns,), length/time. force : (d, A), force. method : its name. steps : factorisations that it made.
    rest : (unknowns,), the second double of each spin, where a method computes sums of two.
    slips : mask (A,) of slipping contacts, if the method has settled the contact states, else None.
    open : mask (A,) of contacts that could not be settled: they slip by more than rounding, but bear less than the
    friction limit.
    ties : mask (A,) of contacts whose slip is not the same at all minima, or that bear all their friction without slip;
    None if that is not known.
    everywhere : u (N, C) of all spheres, from methods that step all of them.
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
