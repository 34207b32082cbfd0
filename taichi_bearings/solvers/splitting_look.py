"""What the iterates of operator splitting are worth, in one pass over the contacts: friction, power, lower bound.

Each array of contacts is as large as the caches of a processor many times over, so that every operation on whole arrays
costs a passage through memory. Here all operations are made on one piece of some thousand contacts after the other, and
the pieces are shared among threads. How the contacts are divided into pieces does not depend on the number of threads,
and the sums of the pieces are added in their order, so that any number of threads gives the same bits.

Letters: R samples, N spheres (shape of the lattice), E contacts, C carried spin components, V force components of a
site, one for each axis and each spin component that makes the contacts along it slip.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.lattice.layout import Layout
from taichi_bearings.proof.certificate import Forces, largest_unbalanced_torque, work_and_bound_within
from taichi_bearings.proof.column_sums import Part, Share, parts_in_cache
from taichi_bearings.scene import Scene
from taichi_bearings.scene.bearing import inverse

PLAIN_SHARE = 1e-3  # part of the gap that the roundings of a quick bound may make up
ROUNDED_UP = 1 + 4 * np.finfo(np.float64).eps  # a computed length times this factor is no less than the exact one
# limits of friction between which squares of forces neither overflow nor lose digits
LEAST_LIMIT, GREATEST_LIMIT = 1e-100, 1e100


class Looked(NamedTuple):
    """What one iterate of operator splitting is worth: its forces, its power, and the bound that it proves.

    Operator splitting puts a spring into each contact. The trial force of a contact is the force that it would have
    without a friction limit. The forces of the springs balance all torques, but may exceed the friction limits. Shapes:
    C spin components, R samples, E contacts.
    """

    friction: Forces  # (C, R, E), force, the trial forces, each cut off at its friction limit
    balanced: Forces  # (C, R, E), force, the forces of the springs
    power: np.ndarray  # (R,), of the spins, energy/time
    work: np.ndarray  # (R,), of the driven planes against the forces of the springs, energy/time
    bound: np.ndarray  # (R,), lower bound on the least power that the forces of the springs prove, energy/time
    creep: float  # length/time, the fastest slip of contacts within their friction limit; it is 0 at the minimum
    left_over: np.ndarray  # (R,), the largest torque that `friction` leaves on a free sphere, force * length


class Sums(NamedTuple):
    """What one piece of the contacts adds to the power, and its largest values, for r of the R samples."""

    samples: slice  # which of the R samples the piece is of
    power: np.ndarray  # (r,), of these contacts, energy/time
    saturation: np.ndarray  # (r,), the largest force of a spring over its friction limit
    creep: float  # length/time, the fastest slip of a contact whose trial force is within its friction limit


Task = Callable[[], "Sums"]
"""Computes and writes the forces of one piece of the contacts, and returns the sums of the piece."""


class Look:
    """Computes forces, power and lower bound of one iterate of operator splitting. :class:`Looked` explains its springs
    and trial forces, the head of the file the letters of shapes.

    friction : (C, R, E), the trial forces, each cut off at its friction limit.
    balanced, capped : (C, R, E), the forces of the springs as they are, and each cut off at its friction limit.
    """

    def __init__(
        self, scene: Scene, stencil: Stencil, layout: Layout, spin_axes: tuple[int, ...], staggered: np.ndarray,
        trial: np.ndarray, springs: tuple[np.ndarray, tuple[float, ...]],
    ) -> None:  # fmt: skip
        """Store the iterate, and allocate its forces. Components of forces that make no contact slip are 0.

        scene : R samples of a lattice with friction.
        stencil, layout : which components make contacts slip, and where the forces of contacts stand in `trial`.
        spin_axes : axes of the C spin components.
        staggered : (C, R, *N spheres), the spins of the iterate, with signs that alternate between neighbours, 1/time.
        trial : (V, R, *N), the trial force of each contact, at its lower sphere, with V components at each site.
        springs : stiffness (R,) of the springs sideways, force * time; and for each axis the stiffness of its springs
            divided by that.
        """
        self.scene, self.stencil, self.layout, self.spin_axes = scene, stencil, layout, spin_axes
        self.staggered, self.trial, (self.stiffness, self.weights) = staggered, trial, springs
        self.friction, self.balanced, self.capped = (
            np.empty((len(spin_axes), scene.replicas, scene.lattice.all_contacts)) for _ in range(3)
        )
        for forces in (self.friction, self.balanced, self.capped):
            for slot, axis in enumerate(spin_axes):
                if axis < scene.lattice.dimension:
                    forces[slot, :, scene.lattice.spans[axis]] = 0.0
        # function for the lengths of vectors, given as one or two arrays: a slower one where squares could overflow
        greatest = float(scene.strength * scene.acting_coefficient.max(initial=0.0))
        is_usual = float(scene.inverse_limit.max(initial=0.0)) < 1 / LEAST_LIMIT and greatest < GREATEST_LIMIT
        self._length = _length if is_usual else _safe_length

    def look(self, share: Share) -> Looked:
        """Return what the iterate is worth: forces, power and bound, which :class:`Looked` explains.

        The spring forces prove the bound in one of two forms, whichever proves more: each cut off at its friction
        limit, or all scaled down by the largest ratio of a force to its limit (`worst`).

        share : a function like `map`, which may share the calls among threads.
        """
        tasks = [task for axis in self.stencil.slipping_axes for task in self._tasks(axis)]
        power, worst = np.zeros((2, self.scene.replicas))
        creep = 0.0
        for sums in share(lambda task: task(), tasks):
            power[sums.samples] += sums.power
            worst[sums.samples] = np.maximum(worst[sums.samples], sums.saturation)
            creep = max(creep, sums.creep)
        work, bound = work_and_bound_within(
            self.scene, self.balanced, self.capped, worst, self.spin_axes, PLAIN_SHARE, share
        )
        left_over = largest_unbalanced_torque(self.scene, self.friction, self.spin_axes, share)
        return Looked(self.friction, self.balanced, power, work, bound, creep, left_over)

    def _tasks(self, axis: int) -> list[Task]:
        """Return functions without arguments, one for each piece of the contacts along an axis. Each computes the
        forces of its piece, writes them into `friction`, `balanced` and `capped`, and returns the sums of the piece.

        axis : number of the lattice axis.
        """
        # views of the arrays of these contacts, a list with one for each component that makes them slip
        lattice, slots = self.scene.lattice, self.stencil.slip_components[axis]
        low, high = ([self.staggered[slot][end] for slot in slots] for end in lattice.along(axis))
        trial = [self.layout.from_lower_sphere(self.trial[row], axis) for row in self.stencil.force_rows(0)[axis]]
        found = [
            [lattice.by_axis(of[slot])[axis] for slot in slots] for of in (self.friction, self.balanced, self.capped)
        ]
        limit = lattice.by_axis(self.scene.acting_coefficient)[axis], lattice.by_axis(self.scene.inverse_limit)[axis]

        def task(part: Part) -> Task:
            """Return the function that computes and writes the forces of one piece, and returns its sums.

            part : slices of the samples and of the first axis of the lattice, which cut the piece out of arrays.
            """
            spins = [[of[part] for of in end] for end in (low, high)]
            forces = [[of[part] for of in arrays] for arrays in found]
            given = [of[part] for of in trial]
            return lambda: self._piece(
                part[0], self.weights[axis], spins, given, forces, (limit[0][part], limit[1][part])
            )

        return [task(part) for part in parts_in_cache(limit[0].shape)]

    def _piece(
        self, samples: slice, weight: float, spins: list[list[np.ndarray]], trial: list[np.ndarray],
        found: list[list[np.ndarray]], limit: tuple[np.ndarray, np.ndarray],
    ) -> Sums:  # fmt: skip
        """Write the forces of a piece, some contacts along one axis of r of the R samples; return its sums.

        Arrays have the shape (r, n, ...) of the piece. Lists have an array for each component that makes these contacts
        slip.

        samples : slice, the r samples that the piece is of.
        weight : factor by which the springs along this axis are stiffer than `stiffness`.
        spins : two lists, the spin components of the lower and of the upper spheres, 1/time.
        trial : components of the trial forces.
        found : three lists of arrays that are written: `friction`, the trial forces cut off at the friction limits;
            `balanced`, the forces of the springs; and `capped`, these cut off. A spring has the force
            weight * stiffness * (upper less lower spin) - trial + 2 * friction.
        limit : two arrays: coefficients, and one over the friction limits; both 0 for contacts that take no part.
        """
        scene, (friction, balanced, capped), (coefficient, inverse_limit) = self.scene, found, limit
        radius, by_sample = scene.lattice.radius, (-1, *(1,) * (inverse_limit.ndim - 1))
        # friction: the trial forces cut off at their limits
        trial = [np.array(of, dtype=np.float64) for of in trial]
        share = np.minimum(inverse(self._length(trial) * ROUNDED_UP * inverse_limit), 1.0)
        bears = coefficient > 0
        for force, of in zip(friction, trial, strict=True):
            np.multiply(of, share, out=force)
            bears &= force == of
        # slips, and the power of the spins
        difference = [high - low for low, high in zip(*spins, strict=True)]
        slip = self._length(difference)
        slip *= radius  # in place, as below: further arrays would not fit into the cache
        creep = float(np.where(bears, slip, 0.0).max(initial=0.0))  # a fifth of the time that a maximum `where` takes
        slip *= coefficient
        power = scene.strength * slip.reshape(len(slip), -1).sum(axis=1)
        # forces of the springs, and these forces cut off at the friction limits
        stiffness = (weight * self.stiffness[samples]).reshape(by_sample)
        for force, of, cut, step in zip(balanced, trial, friction, difference, strict=True):
            np.multiply(step, stiffness, out=step)
            of -= 2.0 * cut
            np.subtract(step, of, out=force)
        ratio = self._length(balanced)
        ratio *= ROUNDED_UP
        ratio *= inverse_limit
        worst = ratio.reshape(len(ratio), -1).max(axis=1, initial=0.0)
        share = np.minimum(inverse(ratio), 1.0)
        for force, of in zip(capped, balanced, strict=True):
            np.multiply(of, share, out=force)
        return Sums(samples, power, worst, creep)


def _length(components: list[np.ndarray]) -> np.ndarray:
    """Return the lengths of vectors of one or two components, arrays of one shape; their squares must not overflow.

    components : a list with the first, or the first and the second component of all vectors.
    """
    if len(components) == 1:
        result: np.ndarray = np.abs(components[0])
        return result
    found = components[0] * components[0]
    found += components[1] * components[1]
    result = np.sqrt(found, out=found)
    return result


def _safe_length(components: list[np.ndarray]) -> np.ndarray:
    """Return the lengths of vectors of one or two components, arrays of one shape, of any size.

    components : a list with the first, or the first and the second component of all vectors.
    """
    found: np.ndarray = np.abs(components[0]) if len(components) == 1 else np.hypot(*components)
    return found
