"""`Contacts`, through which methods reach the contacts of a scene: their fields, kernels, bounds, and the answer.

There are three kinds. `OnStrides` (on_strides.py) has the contacts of a lattice, whose neighbours are a constant stride
apart in memory; `OnLists` (on_lists.py) has those of any other network, in lists, for methods that step them; and
`OnSystem` (on_system.py) has the linear map from its spins to its slips, for methods that find minima. `contacts_of` in
solvers/method.py chooses between them; nothing else asks which one it has.

Shapes: R samples, N spheres (the shape of a lattice, or their number), E contacts, C carried spin components.
*Staggered* spins are those that are carried: on a lattice with signs by which neighbours differ and measured from the
bottom plane; in a packing u = R omega, radius times spin. In the shape (C, R, E) of forces of a packing C is the number
of tangents of a contact.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings.fields import Fields
from taichi_bearings.fields.lists import AnySpec
from taichi_bearings.proof.certificate import Forces
from taichi_bearings.scene import Bearing, Progress, Solution, Status
from taichi_bearings.solvers.found import Found
from taichi_bearings.solvers.part import Part
from taichi_bearings.solvers.stopping import StopRule

if TYPE_CHECKING:
    from taichi_bearings.conic.proximal import Unknowns
    from taichi_bearings.kernels.team import Sweeps, Team
    from taichi_bearings.solvers.table import MethodOptions, Motion

Inertia = float | np.ndarray
"""Moments of inertia as `Contacts.inertias` returns them: one for all spheres, or one for each."""

CONSTANT = ("is_free", "across", "coefficient", "viscosity", "numbers")
"""Fields that steps do not change."""


@dataclass(frozen=True)
class Ended:
    """How a run of a method ended, with the best that it has reached.

    status : why the run ended.
    best : the best state that was reached, with the findings of the method.
    bound : (R samples,), the best proven lower bound on the objective of each sample.
    proof : (C components, R, E contacts), contact forces from which that bound follows.
    iterations : how many iterations were made.
    stop : the limits and the tolerance that the run was given.
    options : the method and its options.
    slip_threshold : slip speed, length/time, up to which a contact counts as slipless; None for what the method can
        resolve, as always in a packing.
    found : function that returns the spins and forces which a method for minima has reached in each sample of a
        packing.
    while_wanted : function that returns a context whose work ends with GivenUp by Ctrl-C, or when the time is over.
    """

    status: Status
    best: Progress
    bound: np.ndarray
    proof: Forces
    iterations: int
    stop: StopRule
    options: "MethodOptions"
    slip_threshold: float | None
    found: Callable[[], list[Found]]
    while_wanted: Callable[[], AbstractContextManager[None]]


@dataclass(frozen=True)
class Launch:
    """A number of repeated calls of a kernel with the same constants.

    turns : how many.
    numbers : the constants.
    first : number of the first of these turns, for kernels in which turns differ.
    """

    turns: int
    numbers: tuple[float, ...]
    first: int = 0


class Contacts(ABC):
    """The contacts of a scene as a method sees them.

    scene : what is solved; for methods that step a packing without the contacts that take no part.
    spin_axes : numbers of the axes of the C spin components that are computed.
    """

    scene: Bearing
    spin_axes: tuple[int, ...]

    @property
    def seconds_to_prove(self) -> float:
        """An estimate of the seconds that the proof of an answer takes; 0 if that is not known."""
        return 0.0

    @abstractmethod
    def proven_by(self, force: Forces) -> np.ndarray:
        """Return the lower bound (R samples,) on the objective that contact forces (C components, R, E contacts), of a
        checkpoint, prove.
        """

    @abstractmethod
    def answered(self, ended: Ended) -> Solution:
        """Return the answer of a run that ended, with what is proven of it; its clock and history are still to be set.

        It is made by `answered` in answer.py from what was reached with these contacts.

        ended : how the run ended, and the best that it has reached.
        """

    def state(self) -> dict[str, np.ndarray]:
        """Return by name the arrays that a checkpoint needs of the contacts, beside those of the method."""
        return {}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the arrays by name that `state` returned in an earlier call; here there are none."""
        assert not self.state()


class WithMinima(Contacts):
    """Contacts whose minima are found: each kind of minimising method has a solver for them."""

    @abstractmethod
    def paths(self, spin: np.ndarray, settle: bool) -> Part:
        """Return the solver of the interior-point method: the central paths of all samples, curves of spins and forces
        along which Newton steps lead to the minimum.

        spin : (R samples, *N spheres, 3), of discs (R, *N), laboratory spins to start from, 1/time.
        settle : True to go on along the paths until contact states are settled.
        """

    @abstractmethod
    def cuts(self, spin: np.ndarray) -> Part:
        """Return the solver that finds the minimum cuts of all samples, for the planar cut.

        spin : (R samples, *N spheres, 3), of discs (R, *N), laboratory spins to start from, 1/time.
        """

    @abstractmethod
    def linear_systems(self, spin: np.ndarray) -> Part:
        """Return the solver that finds the spins of all samples at which viscous forces balance.

        spin : (R samples, *N spheres, 3), of discs (R, *N), laboratory spins to start from, 1/time.
        """


class Stepped(Contacts):
    """Contacts that a method steps: their fields (arrays of numbers on spheres and contacts, on the device), kernels,
    and lower bounds on the objective.

    points : names of the fields, with numbers on spheres, that hold the spins of a gradient descent.
    forces : names of the fields, with numbers on contacts, that hold its contact forces.
    fields : the numbers on the device, once `allocate` was called.
    spec : names and sizes of these fields.
    """

    points: tuple[str, ...]
    forces: tuple[str, ...]
    fields: Fields
    spec: AnySpec
    look_again = 1.2
    """A bound that costs a factorisation is computed again once the iterations have grown by this factor."""

    @property
    def of_law(self) -> list[str]:
        """Names of the fields that hold the coefficients of the contact law."""
        return ["coefficient", *(["viscosity"] if self.scene.viscosity_beside_friction is not None else [])]

    @abstractmethod
    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None, **more: object) -> Progress:
        """Return the progress of a method with given spins and forces: their objective, lower bound, and largest torque
        left.

        staggered : (C components, R samples, *N spheres), spins as methods carry them (on lattices with alternating
            signs), 1/time; in a packing radius * spin.
        force : (C, R, E contacts), contact forces at these spins.
        proof : (C, R, E), forces from which the lower bound is computed; None for `force`.
        more : further fields of :class:`Progress`, by name.
        """

    @property
    def stores_predicted(self) -> bool:
        """True if the kernel of Cundall and Strack keeps the spins that it predicts for the end of the next step in a
        field; on large lattices it adds them up anew.
        """
        return True

    @abstractmethod
    def field_spec(self, spheres: dict[str, int], contacts: list[str]) -> AnySpec:
        """Return the names and sizes of all fields that a method needs, those of the law included.

        spheres : how many numbers each sphere has in the field of each name.
        contacts : names of the method's fields on contacts.
        """

    @abstractmethod
    def allocate(self, spec: AnySpec, viscosity: np.ndarray | None) -> None:
        """Allocate the fields, and load the coefficients of the law into them.

        spec : names of the fields, with the numbers that each sphere (in packings also each contact) has in them.
        viscosity : (R samples, E contacts), viscosity of each contact of a law with friction and viscosity, multiplied
            by the radius: kernels multiply it by a spin difference; for gradient descent also divided by the unit of
            the friction coefficients. None for other laws.
        """

    @abstractmethod
    def read_forces(self, name: str) -> np.ndarray:
        """Return the forces, or elongations of springs, that a field holds: (C components, R samples, E contacts) by
        component of the contact.

        name : of the field.
        """

    @abstractmethod
    def load_force(self, force: np.ndarray) -> None:
        """Write contact forces, (C components, R samples, E contacts) by component of the contact, into the field
        `force`.
        """

    @abstractmethod
    def spring_kernel(self, corrector: tuple[float, ...]) -> "tuple[Team, Sweeps]":
        """Return the threads and the kernel for the dynamics of Cundall and Strack.

        corrector : coefficients of Gear's corrector, that of the spin itself (0th derivative) first.
        """

    @abstractmethod
    def descent_kernel(self) -> "tuple[Team, Sweeps]":
        """Return the threads, and the kernel that makes the sweeps of gradient descent over all spheres."""

    @abstractmethod
    def run(self, team: "Team", sweeps: "Sweeps", launch: Launch) -> None:
        """Call a kernel as often, and with the constants, as a launch says.

        team : threads.
        sweeps : the kernel.
        """

    @abstractmethod
    def weights(self, bounds: np.ndarray) -> np.ndarray:
        """Return upper bounds (C components, R samples, *N spheres) on the curvature of the objective along each spin
        component of each sphere.

        bounds : (R, E contacts), upper bounds on the curvature of what each contact adds.
        """

    @abstractmethod
    def inertias(self, options: "Motion", density: ArrayLike | None) -> Inertia:
        """Return the moments of inertia of the free spheres: one number, or (N spheres,).

        On a lattice they are mass * length^2. The unknowns of a packing are u = radius * spin, so that its moments are
        divided by the square of the radius.

        options : options of a method, with `mass` and `inertia`.
        density : of the spheres of a packing, mass / length^D in D dimensions, one number or (N,), from which their
            masses follow; None to use the mass in the options. Not used by lattices.
        """

    @abstractmethod
    def common_inertia(self, inertia: Inertia) -> float:
        """Return the reference moment of inertia I0, a constant of the kernel. The kernel computes a sphere's
        acceleration as torque / I0 * is_free, with the field `is_free`: I0 / I for a free sphere with moment of inertia
        I, 0 for a driven one.

        inertia : moments of inertia of the free spheres, one number or (N spheres,): mass * length^2 on a lattice, mass
            in a packing.
        """

    @abstractmethod
    def fastest_modes(self, inertia: Inertia) -> tuple[float, float]:
        """Return upper bounds on two numbers of the fastest modes of the network: the decay rate by viscosity, 1/time,
        0 without; and R^2 lambda / I, 1/mass, of contacts that all stick, with the largest eigenvalue lambda of the
        network's Laplacian, radius R and moment of inertia I.

        inertia : moments of inertia of the free spheres, one number or (N spheres,): mass * length^2 on a lattice, mass
            in a packing.
        """

    @abstractmethod
    def unknowns(self, spin_axes: tuple[int, ...], unit: float, inertia: Inertia) -> "Unknowns":
        """Return the unknowns that an implicit step of the rigid-limit dynamics solves for.

        spin_axes : numbers of the axes of the spin components that move.
        unit : unit of the unknowns in the solve: 1/time on a lattice, length/time in a packing.
        inertia : moments of inertia of the free spheres, one number or (N spheres,): mass * length^2 on a lattice,
            mass in a packing.
        """

    def stopped_spins(self, component: int, spins: np.ndarray) -> np.ndarray | None:
        """Return what the spins of a component are once friction has stopped it, (R samples, *N spheres); None if it
        does not stop, or if that is not known.

        component : number of the axis of the spin component.
        spins : (R, *N), its spins now.
        """
        return None

    @property
    def has_no_bound(self) -> bool:
        """True if no positive lower bound on the objective can be used yet; on a lattice there always is one."""
        return False

    def best_bound(self, bound: np.ndarray) -> np.ndarray:
        """Return the best lower bound so far, (R samples,): on a lattice the present one, in a packing perhaps an
        earlier one.

        bound : (R,), the present one.
        """
        return bound
