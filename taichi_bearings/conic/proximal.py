"""Makes implicit Euler steps in time of spheres under rigid friction, damping or both. A step is a minimisation:

    spins after = argmin Phi(spins) + I / (2 h) |spins - spins before|^2

Phi is the potential of the contacts, I the moment of inertia, h the duration of the step. The contact forces at the
minimum act during the step: their torques over the radius R are I (after - before) / (h R). With friction the central
path (central_path.py), with inertia added to the potential, ends at the minimum; with damping alone the minimum solves
one linear system. Both use one pattern of the matrix, analysed once for all steps and samples.

Spins are measured from the bottom plane in a given unit; forces are in units of the sample's mean coefficient (times
the normal force, or times radius and unit of spin for damping). So inertia and duration enter by one number only, q = I
/ (h R) in units of force over spin.

Letters: R samples, C spin components, N spheres, E contacts; n contacts of the system.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from taichi_bearings.conic.central_path import balance, flowing, newton_step
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.contact_system import ContactSystem, free_spins, lattice_system, place_free_spins
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.iterate import LEAST_GAP, Inertia, Iterate
from taichi_bearings.conic.newton_matrix import MOST_NEWTON_STEPS, NewtonMatrix
from taichi_bearings.conic.rows import compile_passes
from taichi_bearings.numerics.cholesky import NotPositiveDefinite, dissect
from taichi_bearings.scene import Bearing, Scene

# A step is solved if the cost is above its lower bound by at most SOLVED_EXCESS times the work done on inertia, or at
# most LEAST_GAP times itself. Where rounding prevents that, the other two numbers decide whether the step has failed.
SOLVED_EXCESS = 1e-10
ACCEPTED_EXCESS, ACCEPTED_GAP = 1e-3, 1e-9
PROXIMAL_TORQUE = 1e-13  # torque over the mean friction that may be left on a sphere
MOST_IDLE_STEPS = 3  # most Newton steps in a row that gain nothing


@dataclass(frozen=True)
class Step:
    """The result of one time step of all R samples of a scene, with C spin components, E contacts and N the shape of
    arrays over the spheres.

    staggered : (C, R, *N), spins at its end, with the sign flipped on every second sphere of a lattice, 1/time.
    force : (C, R, E), contact forces during the step, by spin component that makes the contact slip.
    slipping : (R,), number of contacts that slip.
    creep : largest difference of spins across a contact that does not slip, 1/time, over all samples; 0 but for
        rounding.
    newton_steps : number of factorisations, of all samples together.
    solved : False if rounding ended the solution of some sample too early.
    """

    staggered: np.ndarray
    force: np.ndarray
    slipping: np.ndarray
    creep: float
    newton_steps: int
    solved: bool


class Unknowns(ABC):
    """The unknown spins of a bearing as one vector: those of free spheres, as far as contacts can change them.

    system : the contacts, as a function of the unknowns; imposed spins are in the unit of spin.
    order : (unknowns,), numbers of the unknowns in the order in which a Cholesky factorisation eliminates them.
    rows : number of components of the force on a contact.
    """

    system: ContactSystem
    order: np.ndarray
    rows: int

    @abstractmethod
    def read(self, staggered: np.ndarray) -> np.ndarray:
        """Return the unknowns of all samples, (R, unknowns).

        staggered : (C, R, *N), spins by component, sample and sphere, with C components, R samples and N the shape of
            arrays over the spheres.
        """

    @abstractmethod
    def write(self, staggered: np.ndarray, replica: int, spins: np.ndarray) -> None:
        """Write the unknowns of one sample into an array over all spheres, in place.

        staggered : (C, R, *N), the array: spins by component, sample and sphere, with C components, R samples and N the
            shape of arrays over the spheres.
        replica : number of the sample.
        spins : (unknowns,), what is written.
        """


class OfLattice(Unknowns):
    """All free spins of a lattice in some components; all other components are at rest.

    Staggered spins are spins with their sign flipped on every second sphere, so that neighbours which roll on each
    other have equal ones.

    spin_axes : numbers of the components that are unknown, 0 to 2.
    height : number of the axis from the bottom plane to the top plane.
    system : the contacts that these components make slip.
    order : (unknowns,), numbers of the unknowns in their order of elimination.
    rows : number of components of the force on a contact: one for each entry of `spin_axes`.
    """

    def __init__(self, scene: Scene, spin_axes: tuple[int, ...], unit: float) -> None:
        """Make the contact system of some spin components on a lattice, and find an order of elimination.

        scene : the bearing, whose spheres are on a lattice.
        spin_axes : numbers of the spin components, 0 to 2.
        unit : difference of spins that is counted as one, 1/time.
        """
        self.system = lattice_system(scene.lattice, spin_axes, scene.top_spin(spin_axes) / unit)
        self.order, self.spin_axes, self.height = (
            dissect(scene.lattice, spin_axes),
            spin_axes,
            scene.lattice.height_axis,
        )
        self.rows = len(spin_axes)

    def read(self, staggered: np.ndarray) -> np.ndarray:
        """Return the staggered spins of the free spheres as one vector for each sample, (R, unknowns).

        staggered : (C, R, *N), spins of all spheres with the sign flipped on every second one, with C components, R
            samples and N the shape of the lattice.
        """
        return free_spins(staggered)

    def write(self, staggered: np.ndarray, replica: int, spins: np.ndarray) -> None:
        """Write the spins of the free spheres of one sample into an array over all spheres, in place.

        staggered : (C, R, *N), the array: spins with the sign flipped on every second sphere, with C components, R
            samples and N the shape of the lattice.
        replica : number of the sample.
        spins : (unknowns,), the staggered spins to be written.

        No contact changes the mean, over a layer, of the spin component along the height axis. Rounding does; so that
        mean is restored here.
        """
        before = staggered[:, replica, ..., 1:-1].copy()
        place_free_spins(staggered, replica, spins)
        if self.height in self.spin_axes:
            slot = self.spin_axes.index(self.height)
            new = staggered[slot, replica, ..., 1:-1]
            new -= (new - before[slot]).mean(axis=(0, 1))


class OfNetwork(Unknowns):
    """Free spins of any network, u = radius * spin. Each is multiplied by a `root`, with which all unknowns have the
    same inertia. Spin components that make no contact slip are left out.

    sphere : (unknowns,), number of the sphere of each unknown.
    component : (unknowns,), number of the spin component of each unknown.
    root : (unknowns,), square root of the sphere's inertia over the mean inertia.
    system : the contacts as a function of the unknowns.
    order : (unknowns,), numbers of the unknowns in their order of elimination.
    rows : number of components of the force on a contact: one for each tangent direction.
    """

    def __init__(self, bearing: Bearing, unit: float, inertia: np.ndarray) -> None:
        """Number the free spins of a bearing, and make the contact system over them. Contacts without coefficient in
        any sample are left out.

        bearing : spheres and contacts, some spheres driven.
        unit : unit of u = radius * spin, length/time.
        inertia : (N,), moment of inertia over radius squared of each of N spheres, mass.
        """
        network, contact = bearing.network, bearing.acting
        # Unknown are the spins of free spheres that make some contact slip, (N, C); they are numbered in this order.
        each = np.arange(network.spheres * network.components).reshape(network.spheres, -1)
        size = np.asarray(abs(network.operator(contact, each)).sum(axis=0)).reshape(each.shape)
        wanted = network.free[:, None] & (size > 0)
        moved = np.where(wanted, np.cumsum(wanted).reshape(wanted.shape) - 1, -1)
        self.sphere, self.component = np.nonzero(wanted)
        self.root = np.sqrt(inertia / inertia.mean())[self.sphere]
        # The slips while all unknowns are 0.
        known = bearing.driven_speed[network.contact[:, contact]].sum(axis=0) / unit
        offset = np.einsum("tek,ek->te", network.tangents[:, contact], known)
        self.system = ContactSystem(
            len(self.sphere),
            offset,
            np.ones(offset.shape, dtype=bool),
            slips=sparse.csr_array(network.operator(contact, moved) @ sparse.diags_array(1 / self.root)),
            contact=contact,
            slot=np.broadcast_to(np.arange(len(offset))[:, None], offset.shape),
            place=np.asarray(network.center[self.sphere].T),
        )
        self.order, self.rows = order_by_place(self.system), len(offset)

    def read(self, staggered: np.ndarray) -> np.ndarray:
        """Return the unknowns (R, unknowns) of R samples: u = radius * spin of free spheres, times `root`.

        staggered : (C, R, N), u of all N spheres, with C spin components; no signs are flipped in a packing.
        """
        return np.asarray(self.root * np.moveaxis(staggered, 1, 0)[:, self.component, self.sphere])

    def write(self, staggered: np.ndarray, replica: int, spins: np.ndarray) -> None:
        """Write the spins of one sample into an array over all spheres, in place.

        staggered : (C, R, N), the array: u = radius * spin, with C spin components, R samples and N spheres.
        replica : number of the sample.
        spins : (unknowns,), values of the unknowns, u times `root`.
        """
        staggered[self.component, replica, self.sphere] = spins / self.root


class ProximalSteps:
    """Makes implicit Euler steps in time of the samples of a bearing, each solved as a minimum. *Carried spins* are the
    staggered spins of a lattice, 1/time, or u = radius * spin of a packing, length/time.

    scene : the bearing.
    unknowns : its spins as one vector.
    unit : unit of the carried spins.
    """

    def __init__(self, scene: Bearing, unknowns: Unknowns, unit: float, inertia: float) -> None:
        """Scale coefficients and inertia of every sample, and analyse the Newton matrix.

        scene : the bearing.
        unknowns : its spins as one vector.
        unit : unit of the carried spins (see the class).
        inertia : mean moment of inertia of the spheres; for a packing over radius squared.
        """
        self.scene, self.unknowns, self.unit = scene, unknowns, unit
        self._system = unknowns.system
        self._matrix = NewtonMatrix(self._system, unknowns.order)
        compile_passes(self._system.offset.shape[1], costly=self._matrix.is_costly)
        # (R, n): coefficients of the n contacts of R samples, over their mean in the sample
        acting = scene.positive_coefficient[:, self._system.contact]
        mean = acting.mean(axis=1)
        self._coefficient = acting / mean[:, None]
        flow = scene.slip_radius * unit  # slip speed that belongs to the unit
        # (R,), unit of force; then for each sample viscosities (n,) in its units, None for a law without
        self._force_unit = scene.strength * (1.0 if scene.law.has_friction else flow) * mean
        viscosities = scene.viscosity_beside_friction
        self._viscosity: list[np.ndarray | None] = [
            None if viscosities is None else flow / own * viscosities[replica, self._system.contact]
            for replica, own in enumerate(self._force_unit)
        ]
        # (R,), time in which the unit of force brings a sphere from rest to the unit of spin
        self._slowness = inertia * unit / (scene.slip_radius * self._force_unit)

    def step(self, staggered: np.ndarray, duration: float) -> Step:
        """Return the implicit Euler step in time of all R samples that begins at given spins.

        staggered : (C, R, *N), carried spins of C components and N spheres.
        duration : length of the step, time.
        """
        scene = self.scene
        after = staggered.copy()
        force = np.zeros((self.unknowns.rows, *scene.coefficient.shape))
        slipping, creep, newton_steps, solved = np.zeros(scene.replicas, dtype=int), 0.0, 0, True
        for replica, before in enumerate(self.unknowns.read(staggered / self.unit)):
            coefficient, inertia = self._coefficient[replica], Inertia(self._slowness[replica] / duration, before)
            if scene.law.has_friction:
                point, steps, ended = self._step_with_friction(coefficient, self._viscosity[replica], inertia)
            else:  # damping alone
                spins = flowing(self._system, coefficient, self._matrix, before, inertia)
                point, steps, ended = Iterate.start(self._system, spins, coefficient, 0.0, coefficient), 1, True
            # A contact slips if its slip is above the margin of its force; both are in units of about 1.
            slip = length(point.difference)
            slips = slip > (point.margin if scene.law.has_friction else 0.0)
            self.unknowns.write(after, replica, self.unit * point.spins)
            self._system.scatter_vectors(-point.whole_dual * self._force_unit[replica], force, replica)
            slipping[replica] = int(slips.sum())
            creep = max(creep, self.unit * slip[~slips].max(initial=0.0))
            newton_steps, solved = newton_steps + steps, solved and ended
        return Step(after, force, slipping, creep, newton_steps, solved)

    def _step_with_friction(
        self, friction: np.ndarray, viscosity: np.ndarray | None, inertia: Inertia
    ) -> tuple[Iterate, int, bool]:
        """Return three things: the point (spins, slips and forces) at the end of a step in time with friction; the
        number of Newton steps taken; and True if it is solved.

        friction : (n,), coefficients of friction of the n contacts, over their mean in the sample.
        viscosity : (n,), viscosities in units of the sample; None without viscous forces.
        inertia : what resists a change of the spins; its `origin` (unknowns,) is the spins before the step.
        """
        # Begin without forces of friction, at the spins before the step, or where viscous forces balance. The size of
        # the slips is the distance of the first bounds from slips that are 0.
        spins = inertia.origin
        slip = length(self._system.differences(spins))
        slack = float(np.sqrt(np.mean(slip**2)))
        if not slack:
            return Iterate.start(self._system, spins, friction, slack), 0, True
        if viscosity is not None:
            spins = flowing(self._system, viscosity, self._matrix, spins, inertia)
        iterate = replace(Iterate.start(self._system, spins, friction, slack, viscosity), inertia=inertia)
        best, steps, patience = iterate, 0, MOST_IDLE_STEPS
        with np.errstate(all="ignore"):  # where double precision ends, numbers that are not finite turn up
            try:
                # Newton steps until the excess is small enough, or as long as it falls; then the last torques go.
                while steps < MOST_NEWTON_STEPS and patience and not _excess(best) <= 1.0:
                    iterate = newton_step(iterate, self._matrix)
                    steps += 1
                    if iterate.excess < best.excess:
                        best, patience = iterate, MOST_IDLE_STEPS
                    else:
                        patience -= 1
                if best.unbalanced > PROXIMAL_TORQUE:
                    balanced = balance(best, self._matrix)
                    best = balanced if balanced.unbalanced < best.unbalanced else best
            except NotPositiveDefinite:
                pass
        return best, steps, _excess(best, ACCEPTED_EXCESS, ACCEPTED_GAP) <= 1.0


def _excess(iterate: Iterate, sharp: float = SOLVED_EXCESS, closest: float = LEAST_GAP) -> float:
    """Return how far the cost of a point is above the lower bound that its forces prove, divided by the allowed
    distance: a step is solved if the result is at most 1.

    iterate : the point on the path that is judged.
    sharp, closest : the allowed distance is the larger one of `sharp` times the work done on inertia and `closest`
        times the cost.
    """
    assert iterate.inertia is not None
    moved = iterate.spins - iterate.inertia.origin
    return iterate.excess / max(sharp * iterate.inertia.weight * float(moved @ moved), closest * iterate.cost)
