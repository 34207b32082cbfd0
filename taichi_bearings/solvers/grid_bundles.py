"""The viscous law on a lattice, solved to round-off: its power is a quadratic form, so the minimum is a linear system.

The system falls apart (equations.md, 2). Spin components decouple; component k is coupled only by the contacts that are
not along k, so on a cubic lattice each plane k = constant is a two-dimensional weighted grid of its own, and replicas
are independent anyway. The planes of a bundle are factorised together, as one sparse matrix.

With coefficients over many decades, the difference of the spins at a stiff contact can be less than their rounding, so
that its force would be lost. So each spin is a sum of two numbers, spin + rest. The system is solved again for the
torques that are left over, until they no longer fall (iterative refinement). Torques then balance to the rounding of
the forces, however large the contrast.

Letters: a *plane* is the two-dimensional grid of one layer and sample, with m x n spheres, the height last; a *bundle*
has B planes. R samples, N spheres, C carried spin components. Spins are *staggered*: with signs by which neighbours
differ, measured from the bottom plane, so that slips are differences.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csc_array

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.incidence import add_pull, difference
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.double_double import two_sum
from taichi_bearings.numerics.graph_laplacian import factorised, graph_laplacian
from taichi_bearings.scene import Progress
from taichi_bearings.solvers.part import Part

if TYPE_CHECKING:
    from taichi_bearings.solvers.on_strides import OnStrides

BUNDLE_SITES = 250_000  # spheres of a bundle: about 0.1 GB in planes of 64 x 64
MOST_CHECKS = 4  # how often the progress is read in a run of many bundles
MOST_SOLUTION_REFINEMENTS = 50  # two or three do, unless the contrast is near the end of float64

Planes = tuple[np.ndarray, np.ndarray]  # replica and layer of each plane of a bundle


class GridBundles(Part):
    """The linear solver on a lattice: it finds the spins at which viscous forces balance, by factorisations, to
    round-off.

    The linear system falls apart into planes: a plane is the two-dimensional grid of one layer and sample. An iteration
    solves one bundle, some planes that are factorised together; it has so many that memory suffices.

    scene : the lattice with its R samples.
    spin_axes : numbers of the axes of the C spin components that are computed.
    spin, rest : (C components, R samples, *N spheres), the two parts of the spins, which are spin + rest, with signs
        that alternate between neighbours, 1/time.
    bundles : for each bundle the place of its spin component among those computed, and its planes.
    """

    def __init__(self, contacts: "OnStrides") -> None:
        """Prepare to solve: divide the planes (layers of each sample) of each spin component into bundles that are
        solved together.

        contacts : the contacts of the lattice, with the spins to start from.
        """
        self.contacts, self.scene, self.spin_axes = contacts, contacts.scene, contacts.spin_axes
        scene = self.scene
        self.spin = scene.clip_to_box(scene.staggered_spin(contacts.start, self.spin_axes), self.spin_axes)
        self.rest = np.zeros_like(self.spin)
        self.bundles = [(slot, planes) for slot in range(len(self.spin_axes)) for planes in self._planes(slot)]
        self.iteration = 0

    def _planes(self, slot: int) -> list[Planes]:
        """Return the bundles of planes of a spin component: for each bundle two arrays (B,), the sample and the layer
        of each of its B planes.

        A plane is one layer of one sample, perpendicular to the axis of the component: only contacts within a layer
        couple this component. The planes of a bundle are factorised together.

        slot : place of the spin component among those that are computed.
        """
        replicas, layers, *sides = self.scene.lattice.by_plane(self.spin[slot], self.spin_axes[slot]).shape
        replica, layer = (index.ravel() for index in np.indices((replicas, layers)))
        step = max(1, BUNDLE_SITES // int(np.prod(sides)))
        return [(replica[i : i + step], layer[i : i + step]) for i in range(0, replicas * layers, step)]

    def next_check(self, iteration: int) -> int:
        """Return the iteration at which to read the progress next, so that it is read at most MOST_CHECKS times in a
        run.

        iteration : the one at which it is read now.
        """
        return iteration + -(-len(self.bundles) // MOST_CHECKS)

    def advance(self, steps: int) -> None:
        """Solve the next `steps` bundles, each some planes (layers of one sample) that are factorised together."""
        with one_thread():
            for slot, planes in self.bundles[self.iteration : self.iteration + steps]:
                self._solve(slot, planes)
        self.iteration = min(self.iteration + steps, len(self.bundles))

    def _solve(self, slot: int, planes: Planes) -> None:
        """Solve for the free spins of one bundle, and write them into `spin` and `rest` (their low digits) in place.

        A bundle is a set of planes whose linear systems are solved together; a plane is one layer of one sample, and no
        contact that acts on the spin component leads out of it. At the solution viscous torques balance. The solution
        is refined as long as the leftover torques fall; planes in which they do not fall stay as they are. If the
        matrix cannot be factorised, nothing changes.

        slot : place of the spin component among those that are computed.
        planes : two arrays (B,) for B planes, the number of the sample and of the layer of each.
        """
        scene, component = self.scene, self.spin_axes[slot]
        plane = scene.lattice.across(component)
        # (B, ...) each, viscosities of the contacts along the first and along the second axis of each plane
        first, second = (
            self.scene.lattice.by_plane(values, component)[planes]
            for axis, values in enumerate(scene.lattice.by_axis(scene.positive_coefficient))
            if axis != component
        )
        try:
            factor = factorised(_laplacian(plane, first, second))
        except RuntimeError:  # a contrast beyond float64: these spins stay as they are
            return
        spins, rests = (scene.lattice.by_plane(of[slot], component) for of in (self.spin, self.rest))
        spin, rest = spins[planes], rests[planes]
        # each refinement solves for the torques that are left, and is kept in the planes where these fall
        torque = _free_torques(plane, first, second, spin, rest)
        size = _total(torque)
        for _ in range(MOST_SOLUTION_REFINEMENTS):
            new_spin, new_rest = spin.copy(), rest.copy()
            new_spin[..., 1:-1], new_rest[..., 1:-1] = two_sum(
                spin[..., 1:-1], rest[..., 1:-1] + factor.solve(torque.ravel()).reshape(torque.shape)
            )
            new_torque = _free_torques(plane, first, second, new_spin, new_rest)
            new_size = _total(new_torque)
            better = new_size < size  # False for NaN
            halved = new_size < 0.5 * size
            spin[better], rest[better], torque[better] = new_spin[better], new_rest[better], new_torque[better]
            size = np.where(better, new_size, size)
            if not halved.any():
                break
        spins[planes], rests[planes] = spin, rest

    def progress(self) -> Progress:
        """Return spins, forces and bounds now. It is marked as exhausted (no further step helps) once all bundles are
        solved.
        """
        scene = self.scene
        staggered = scene.clip_to_box(self.spin, self.spin_axes)
        difference = scene.differences(self.spin, self.spin_axes) + scene.differences(self.rest, self.spin_axes)
        force = scene.lattice.radius * scene.acting_coefficient * difference
        return self.contacts.judged(
            staggered,
            force,
            None,
            iteration=self.iteration,
            rest=np.where(staggered == self.spin, self.rest, 0.0),  # none where clipping has moved a spin
            resolution=float(np.finfo(np.float64).eps) * scene.lattice.radius * scene.fastest,
            exhausted=self.iteration == len(self.bundles),
        )


def _laplacian(plane: Lattice, first: np.ndarray, second: np.ndarray) -> csc_array:
    """Return the weighted Laplacian (B m (n - 2), B m (n - 2)), sparse, of the free nodes of B planes of m x n nodes,
    one block for each plane.

    plane : grid of m x n nodes; the first and last of each row along the height are held.
    first, second : (B, ...), weights of its contacts along either axis.
    """
    shape = (len(first), *plane.shape)
    node, held = np.arange(np.prod(shape)).reshape(shape), np.ones(shape, dtype=bool)
    held[..., 1:-1] = False
    pairs = zip((plane.along(axis) for axis in range(2)), (first, second), strict=True)
    edges = ((node[low].ravel(), node[high].ravel(), weight.ravel()) for (low, high), weight in pairs)
    return graph_laplacian(edges, node.size, held.ravel())


def _free_torques(
    plane: Lattice, first: np.ndarray, second: np.ndarray, spin: np.ndarray, rest: np.ndarray
) -> np.ndarray:
    """Return the torque on each free node of B planes, (B, m, n - 2), force * length, as it is for spheres of radius 1.

    plane : grid of m x n nodes.
    first, second : (B, ...), viscosities of its contacts along either axis.
    spin, rest : (B, m, n), spins as sums of two doubles.
    """
    pull = np.zeros_like(spin)
    for axis, coefficient in enumerate((first, second)):
        add_pull(pull, coefficient * (difference(spin, axis, plane) + difference(rest, axis, plane)), axis, plane)
    return pull[..., 1:-1]


def _total(torque: np.ndarray) -> np.ndarray:
    """Return the sum (B,) of the absolute torques in each of B planes, a measure of how far they are from balance.

    torque : (B, m, n), torques.
    """
    found: np.ndarray = np.abs(torque).sum(axis=(1, 2))
    return found
