"""Contacts that slip at some minima of a Coulomb network and rest, or slip otherwise, at others.

Forces of slipping contacts are the same at all minima, so the slips of two minima differ along them alone. The spins
that make no slip across the force of a slipping contact, nor any slip of one that rests, are a kernel; if it is that of
the network itself, the minimum is the only one.
"""

import numpy as np
from scipy import sparse

from taichi_bearings.packing.motions import slipless_motions
from taichi_bearings.packing.system import System

MOST_TIES = 200  # whose motions are found; more of them leave every slipping contact undecided
MOVED = 1e-7  # of a slip that a motion makes


def tied(system: System, force: np.ndarray, state: np.ndarray) -> np.ndarray:
    """True (A,) for slipping contacts whose slip is not the same at all minima. force : (d, A). state : (A,)."""
    d, count = force.shape
    size = np.linalg.norm(force, axis=0)
    along = force / np.where(size > 0, size, 1.0)
    across = np.stack([-along[1], along[0]]) if d == 2 else np.zeros((1, count))
    slipping, resting = np.flatnonzero(state == 1), np.flatnonzero(state == 0)
    rows = [system.matrix[t * count + resting] for t in range(d)]
    if d == 2:
        parts = (sparse.diags_array(across[t, slipping]) @ system.matrix[t * count + slipping] for t in range(d))
        rows.append(sum(parts))
    found = np.zeros(count, dtype=bool)
    motions = slipless_motions(sparse.csr_array(sparse.vstack(rows)), system.sphere, system.parts())
    if not motions.number:
        return found
    if motions.number > MOST_TIES:
        found[slipping] = True
        return found
    basis = motions.basis()
    moved = sum(np.abs(along[t, :, None] * (system.matrix[t * count : (t + 1) * count] @ basis)) for t in range(d))
    found[slipping] = (moved > MOVED * np.abs(basis).max()).any(axis=1)[slipping]
    return found
