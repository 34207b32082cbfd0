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
from taichi_bearings.solvers.part import Found, Part
from taichi_bearings.solvers.stopping import StopRule

if TYPE_CHECKING:
    from taichi_bearings.conic.proximal import Unknowns
    from taichi_bearings.kernels.team import Sweeps, Team
    from taichi_bearings.solvers.gear import Modes
    from taichi_bearings.solvers.table import CundallStrack, MethodOptions, Motion

Inertia = float | np.ndarray
"""Moments of inertia of the free spheres: one number for all, or an array with one for each."""

CONSTANT = ("is_free", "across", "coefficient", "viscosity", "numbers")
"""Fields that steps do not change."""


@dataclass(frozen=True)
class Ended:
    """How a run of a method ended, with the best that it has reached.

    status : why the run ended.
    best : the best state that was reached, with other results of the method.
    bound : (R samples,), the best proven lower bound on the objective (what is minimised, energy/time).
    proof : (C components, R, E contacts), contact forces from which that bound follows.
    iterations : how many iterations were made.
    stop : the limits and the tolerance that the run was given.
    options : the method and its options.
    slip_threshold : slip speed, length/time, up to which a contact counts as slipless; None for what the method can
        resolve, as always in a packing.
    found : function without arguments that returns, for methods that find minima of packings, the spins and forces of
        each sample.
    while_wanted : function that returns a context manager; work inside its block ends with the exception GivenUp at
        Ctrl-C or when the time is over.
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
    """Several calls of one kernel in a row, with the same constants.

    calls : number of calls.
    numbers : the constants.
    first : for kernels whose momentum grows from call to call: the number of calls since the momentum was last set to
        zero.
    """

    calls: int
    numbers: tuple[float, ...]
    first: int = 0


class Contacts(ABC):
    """The contacts of a scene, in the form in which a method works on them.

    scene : what is solved. For methods that make steps in a packing it has only the contacts that can dissipate.
    spin_axes : numbers of the axes of the C spin components that are computed.
    """

    scene: Bearing
    spin_axes: tuple[int, ...]

    def seconds_to_solve(self, options: "MethodOptions", tolerance: float) -> float:
        """Return an estimate of the seconds that a method takes to solve all samples; 0 if that is not known.

        options : the method's options.
        tolerance : relative gap that is asked for.
        """
        return 0.0

    @property
    def seconds_to_prove(self) -> float:
        """An estimate of the seconds that the proof of an answer takes; 0 if that is not known."""
        return 0.0

    @abstractmethod
    def proven_by(self, force: Forces) -> np.ndarray:
        """Return the lower bound (R samples,) on the objective (least power or potential) that some contact forces
        prove.

        force : (C components, R, E contacts), contact forces, such as a checkpoint keeps.
        """

    @abstractmethod
    def answered(self, ended: Ended) -> Solution:
        """Return the answer of a run that ended, with what is proven of it. Its times and its history are added later.

        ended : how the run ended, and the best that it has reached.
        """

    def state(self) -> dict[str, np.ndarray]:
        """Return by name the arrays that a checkpoint needs of the contacts, beyond those of the method; here none."""
        return {}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the arrays by name that `state` returned in an earlier call; here there are none."""
        assert not self.state()


class WithMinima(Contacts):
    """The contacts of a scene, for methods that find its minimum directly. For each of the three such methods there is
    a function that returns its solver.
    """

    @abstractmethod
    def paths(self, settle: bool, tolerance: float) -> Part:
        """Return the solver of the interior-point method: the central paths of all samples, curves of spins and forces
        along which Newton steps lead to the minimum.

        settle : True to go on along the paths until contact states are settled.
        tolerance : relative gap that will do if `settle` is False.
        """

    @abstractmethod
    def cuts(self) -> Part:
        """Return the solver that finds the minimum cuts of all samples, for the planar cut."""

    @abstractmethod
    def linear_systems(self) -> Part:
        """Return the solver that finds the spins of all samples at which viscous forces balance."""


class Stepped(Contacts):
    """The contacts of a scene, for methods that make steps: their fields (arrays of numbers on spheres and contacts, on
    the device), kernels, and lower bounds on the objective.

    points : names of the fields on spheres that hold the spins of a gradient descent.
    forces : names of the fields on contacts that hold the contact forces of a gradient descent.
    fields : the arrays on the device, once `allocate` was called.
    spec : names and sizes of these fields.
    """

    points: tuple[str, ...]
    forces: tuple[str, ...]
    fields: Fields
    spec: AnySpec
    look_again = 1.2
    """Where a lower bound needs a factorisation, it is computed again once the iterations have grown by this factor."""

    @property
    def of_law(self) -> list[str]:
        """Names of the fields that hold the coefficients of the contact law."""
        return ["coefficient", *(["viscosity"] if self.scene.viscosity_beside_friction is not None else [])]

    @abstractmethod
    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None, **more: object) -> Progress:
        """Return the progress of a method with given spins and forces: their objective, lower bound, and largest torque
        left.

        staggered : (C components, R samples, *N spheres), spins with signs that alternate between neighbours, 1/time;
            in a packing radius * spin, length/time.
        force : (C, R, E contacts), contact forces at these spins.
        proof : (C, R, E), forces from which the lower bound is computed; None for `force`.
        more : further fields of :class:`Progress`, by name.
        """

    @property
    def stores_predicted(self) -> bool:
        """True if there is a field for the spins that the Cundall-Strack dynamics predicts for the end of the next
        step. On large lattices there is none, and the kernel computes these spins anew."""
        return True

    @abstractmethod
    def field_spec(self, spheres: dict[str, int], contacts: list[str]) -> AnySpec:
        """Return the names and sizes of all fields that a method needs, those with the coefficients of the law
        included.

        spheres : how many numbers each sphere has in the field of each name.
        contacts : names of the method's fields on contacts.
        """

    @abstractmethod
    def allocate(self, spec: AnySpec, viscosity: np.ndarray | None) -> None:
        """Allocate the fields, and load the coefficients of the law into them.

        spec : names of the fields, with the numbers that each sphere (in packings also each contact) has in them.
        viscosity : (R samples, E contacts), for a law with friction and viscosity: the viscosity of each contact times
            the radius, by which kernels multiply a spin difference. Gradient descent wants it divided by the unit of
            the friction coefficients as well. None for other laws.
        """

    @abstractmethod
    def read_forces(self, name: str) -> np.ndarray:
        """Return the forces, or elongations of springs, that a field holds, (C components, R samples, E contacts). In a
        packing C counts the tangents of a contact.

        name : name of the field.
        """

    @abstractmethod
    def load_force(self, force: np.ndarray) -> None:
        """Write contact forces, (C components, R samples, E contacts), into the field `force`. In a packing C counts
        the tangents of a contact.
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
        """Call a kernel several times with the same constants.

        team : the threads that run it.
        sweeps : the kernel.
        launch : how often (`calls`) and with which constants (`numbers`).
        """

    @abstractmethod
    def weights(self, bounds: np.ndarray) -> np.ndarray:
        """Return upper bounds (C components, R samples, *N spheres) on the second derivative of the objective by each
        spin component of each sphere.

        bounds : (R, E contacts), upper bounds on the second derivative of what each contact adds.
        """

    @abstractmethod
    def inertias(self, options: "Motion", density: ArrayLike | None) -> Inertia:
        """Return the moments of inertia of the free spheres: one number, or (N spheres,).

        On a lattice they are mass * length^2. In a packing the unknowns are u = radius * spin, and the moments are
        divided by the square of the radius: mass.

        options : options of a method, with `mass` and `inertia`.
        density : density of the spheres of a packing, one number or (N,), mass / length^D in D dimensions; the masses
            of the spheres follow from it. None to use the mass in the options. Lattices do not use it.
        """

    @abstractmethod
    def common_inertia(self, inertia: Inertia) -> float:
        """Return the reference moment of inertia I0, a constant of the kernel. The kernel computes the acceleration of
        a sphere as torque / I0 * is_free. The field `is_free` is I0 / I for a free sphere with moment of inertia I, and
        0 for a driven one.

        inertia : moments of inertia of the free spheres, one number or (N spheres,): mass * length^2 on a lattice, mass
            in a packing.
        """

    @abstractmethod
    def fastest_modes(self, inertia: Inertia, slopes: np.ndarray | None) -> tuple[float, float]:
        """Return two upper bounds on how fast spins can change, from which the longest stable time step follows:

        1. the decay rate by viscosity of the fastest mode, 1/time; 0 without viscosity;
        2. R^2 lambda / I, 1/mass, of the stiffest mode if all contacts stick; R is the radius, I the moment of inertia,
           and lambda the largest eigenvalue of the network's Laplacian.

        inertia : moments of inertia of the free spheres, one number or (N spheres,): mass * length^2 on a lattice, mass
            in a packing.
        slopes : (R samples, E contacts), largest slope of each contact's force over its slip, force * time/length; None
            for friction alone.
        """

    def sticking_modes(self, options: "CundallStrack", largest_spin: float, stable: float) -> "Modes | None":
        """Return the modes of the network if all its contacts stick, from which the error of a time step follows; None
        if they are not known, as in packings.

        options : stiffness, damping, mass and order of Gear's method.
        largest_spin : largest spin at the start, 1/time.
        stable : largest stable time step.
        """
        return None

    @abstractmethod
    def unknowns(self, spin_axes: tuple[int, ...], unit: float, inertia: Inertia) -> "Unknowns":
        """Return the unknowns that an implicit step of the rigid-limit dynamics solves for.

        spin_axes : numbers of the axes of the spin components that move.
        unit : unit of the unknowns in the solve: 1/time on a lattice, length/time in a packing.
        inertia : moments of inertia of the free spheres, one number or (N spheres,): mass * length^2 on a lattice,
            mass in a packing.
        """

    def stopped_spins(self, component: int, spins: np.ndarray) -> np.ndarray | None:
        """Return the spins (R samples, *N spheres), 1/time, to which friction brings one spin component if nothing
        drives it; None if it is driven, or if that is not known.

        component : number of the axis of the spin component.
        spins : (R, *N), its spins now.
        """
        return None

    @property
    def has_no_bound(self) -> bool:
        """True if no positive lower bound on the objective can be used yet; on a lattice there always is one."""
        return False

    def best_bound(self, bound: np.ndarray) -> np.ndarray:
        """Return the best lower bound (R samples,) on the objective that is known: on a lattice `bound`, in a packing
        perhaps an earlier one.

        bound : (R,), energy/time, the bound that the present state proves.
        """
        return bound
