"""What a method has found of a packing."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Found:
    """What a method has found. spins (unknowns,), force (d, A) in units of force. steps : factorisations. rest :
    (unknowns,), what rounding leaves out of the spins.

    slips : (A,), of contacts that are settled, but for some that are `open`, (A,), and slip by more than rounding,
    though less than friction allows; and there ties : (A,) those that are not the same at all minima, or bear all their
    friction at rest, if that is known. everywhere : u (N, C) of all spheres, where a method moves all.
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
