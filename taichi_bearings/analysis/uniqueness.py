"""Is the minimum the only one? Then the network of slipless contacts is a property of the sample, not of the method.

All minima share their forces of slipping contacts: mu F_n along the slip (PHYSICS 4). So from one minimum to another a
contact may slip more or less but not in another direction, and contacts whose friction is below its limit stay
slipless. Another minimum is therefore a change of the spins that is constant on every domain of a component, zero on
the driven planes, and along the slip at every slipping contact with two components. These conditions are linear. Where
only zero meets them, the minimum is unique; how far from singular they are is told by the least eigenvalue of B^T B, a
row of B being one contact's condition with a direction of unit length.

Spins are those of the components that the driving needs, and unique if and only if the slips are. On a cubic lattice a
free layer may also turn about the height as one bearing, at any speed and at no cost (PHYSICS 3).
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from taichi_bearings.analysis.domains import Lock, RigidDomains
from taichi_bearings.contact_state import ContactState
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import lower, tangential, upper

SINGULAR = 1e-9  # least eigenvalue that counts as zero
STEPS = 40  # of the inverse iteration, which comes down to the least eigenvalue from above


@dataclass(frozen=True)
class Uniqueness:
    """unknowns : free domains, all components. conditions : slipping contacts with two components.

    least_eigenvalue : of B^T B, infinite without unknowns, 0 with fewer conditions than unknowns.
    """

    unknowns: int
    conditions: int
    least_eigenvalue: float

    @property
    def unique(self) -> bool:
        """True if no other slips have the least power."""
        return self.least_eigenvalue > SINGULAR


def uniqueness(
    lattice: Lattice, domains: RigidDomains, friction: tuple[np.ndarray, ...], state: tuple[np.ndarray, ...]
) -> Uniqueness:
    """Of a Coulomb minimum whose slipless contacts bear less than their limit of friction.

    friction : staggered forces, (T, *contacts) an axis; of slipping contacts they have the direction of slip, also
    where the slip is lost in the rounding of the spins. state : values of ContactState, one array (*contacts) an axis.
    """
    unknown = _numbered(domains)
    unknowns, conditions = int(unknown.max(initial=-1)) + 1, 0
    row, column, value = [], [], []
    for axis, force in enumerate(friction):
        slots = tangential(axis, domains.spin_axes)
        if len(slots) < 2:
            continue
        slips = (state[axis] == ContactState.SLIPPING) & force.any(axis=0)
        along = force[:, slips]
        across = np.stack([-along[1], along[0]]) / np.hypot(*along)
        contact = conditions + np.arange(along.shape[1])
        conditions += along.shape[1]
        for slot, part in zip(slots, across, strict=True):
            for end, sign in ((lower, -1.0), (upper, 1.0)):
                of_domain = end(unknown[slot], axis, lattice.dimension)[slips]
                free = of_domain >= 0
                row.append(contact[free])
                column.append(of_domain[free])
                value.append(sign * part[free])
    if unknowns == 0 or conditions < unknowns:
        return Uniqueness(unknowns, conditions, np.inf if unknowns == 0 else 0.0)
    entries = (np.concatenate(value), (np.concatenate(row), np.concatenate(column)))
    condition = coo_array(entries, shape=(conditions, unknowns)).tocsc()
    return Uniqueness(unknowns, conditions, _least_eigenvalue((condition.T @ condition).tocsc()))


def _numbered(domains: RigidDomains) -> np.ndarray:
    """Number (C, *N) of the free domain of each sphere in each component, from 0; -1 where a driven plane holds it."""
    unknown, before = np.full(domains.component_domain.shape, -1), 0
    for slot, label in enumerate(domains.component_domain):
        free = domains.lock[domains.domain, slot] == Lock.NEITHER
        names, number = np.unique(label[free], return_inverse=True)
        unknown[slot][free] = before + number.ravel()
        before += len(names)
    return unknown


def _least_eigenvalue(matrix: csc_array) -> float:
    """Of a positive semidefinite matrix, from above, by inverse iteration."""
    size = matrix.shape[0]
    shifted = (matrix + SINGULAR * 1e-3 * csc_array((np.ones(size), (np.arange(size),) * 2))).tocsc()
    factor = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    vector = np.random.default_rng(0).standard_normal(size)
    for _ in range(STEPS):
        vector = factor.solve(vector / np.linalg.norm(vector))
    vector /= np.linalg.norm(vector)
    return float(vector @ (matrix @ vector))
