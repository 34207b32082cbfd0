"""The one difference operator of a lattice, from spheres to contacts, and its transpose.

Whole arrays are differenced where they lie: `Lattice.along` says where the two ends of all contacts of an axis are in
an array over the spheres, and a sum over the contacts of a sphere is written to the same places. Graphs and sparse
matrices are made from the ends of an array of numbers (`number_free`).

Letters: C spin components, R replicas (samples), N the shape of the lattice, E contacts. Staggered spins have the sign
of every second sphere changed, so that the slip at a contact is their difference.
"""

import numpy as np

from taichi_bearings.lattice.grid import Lattice, tangential


def difference(field: np.ndarray, axis: int, lattice: Lattice) -> np.ndarray:
    """Return, for each contact along an axis, the value at its upper sphere less that at its lower one, (...,
    *contacts).

    field : (..., *N), whose last axes are those of the lattice of shape N.
    axis : number of the axis.
    lattice : the lattice, which says which spheres each contact joins.
    """
    low, high = lattice.along(axis)
    return np.asarray(field[high] - field[low])


def add_pull(total: np.ndarray, force: np.ndarray, axis: int, lattice: Lattice) -> None:
    """Add forces of the contacts along an axis to their lower spheres, and subtract them from the upper ones, in place:
    minus the transpose of :func:`difference`.

    total : (*N), or with more axes before, N the shape of the lattice; changed.
    force : forces in the shape of the contacts along the axis.
    axis : number of the axis.
    lattice : the lattice, which says which spheres each contact joins.
    """
    low, high = lattice.along(axis)
    total[low] += force
    total[high] -= force


def contact_differences(staggered: np.ndarray, lattice: Lattice, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Return the difference of the staggered spins across every contact, (C components, R samples, E contacts), without
    its component along the contact. The slip speed is the radius times the length of this vector (paper Eq. 2).

    staggered : (C, R, *N spheres), spins with signs that alternate between neighbours, 1/time.
    lattice : the lattice of shape *N with its E contacts.
    spin_axes : numbers of the axes of the C components.
    """
    found = np.zeros((*staggered.shape[: staggered.ndim - lattice.dimension], lattice.all_contacts))
    for axis, across in enumerate(lattice.by_axis(found)):
        for slot in tangential(axis, spin_axes):
            low, high = lattice.along(axis)
            np.subtract(staggered[slot][high], staggered[slot][low], out=across[slot])
    return found


def torques(force: np.ndarray, lattice: Lattice, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Return the sum of the contact forces on each sphere, (C components, R samples, *N spheres): its torque over the
    radius, with the sign of its sublattice.

    force : (C, R, E contacts), forces along the spin difference of the contact.
    lattice : the lattice of shape *N with its E contacts.
    spin_axes : numbers of the axes of the C spin components.
    """
    total = np.zeros((*force.shape[:-1], *lattice.shape))
    for axis, vectors in enumerate(lattice.by_axis(force)):
        for slot in tangential(axis, spin_axes):
            add_pull(total[slot], vectors[slot], axis, lattice)
    return total


def weights(coefficient: np.ndarray, lattice: Lattice, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Return for each sphere and spin component the sum of the coefficients of the contacts that this component makes
    slip, (C components, R samples, *N spheres).

    coefficient : (R, E contacts), such as the friction of each contact.
    lattice : the lattice of shape *N with its E contacts.
    spin_axes : numbers of the axes of the C spin components.
    """
    total = np.zeros((len(spin_axes), len(coefficient), *lattice.shape))
    for axis, values in enumerate(lattice.by_axis(coefficient)):
        for slot in tangential(axis, spin_axes):
            for end in lattice.along(axis):
                total[slot][end] += values
    return total


def number_free(shape: tuple[int, ...]) -> np.ndarray:
    """Return an array of this shape with the number of each free sphere in C order, -1 for driven ones: the first and
    last plane along the last axis."""
    free = (*shape[:-1], shape[-1] - 2)
    number = np.full(shape, -1)
    number[..., 1:-1] = np.arange(np.prod(free)).reshape(free)
    return number
