"""`Contacts`, through which methods reach the contacts of a scene: their fields, kernels, bounds, and the answer.

There are two kinds. `OnStrides` (solvers/on_strides.py) has the contacts of a lattice, whose neighbours are a constant
stride apart in memory; `OnLists` (solvers/on_lists.py) has those of any other network, in lists. `contacts_of` in
solvers/method.py chooses between them; nothing else asks which of the two it has.

Shapes: R samples, N spheres (the shape of a lattice, or their number), E contacts, C carried spin components.
*Staggered* spins are those that are carried: on a lattice with signs by which neighbours differ and measured from the
bottom plane; in a packing u = R omega, radius times spin. In the shape (C, R, E) of forces of a packing C is the number
of tangents of a contact.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_bearings.fields import Fields
from taichi_bearings.fields.lists import AnySpec
from taichi_bearings.proof.certificate import Forces
from taichi_bearings.scene import Bearing, Progress, Solution, Status
from taichi_bearings.solvers.stopping import StopRule

if TYPE_CHECKING:
    from taichi_bearings.conic.proximal import Unknowns
    from taichi_bearings.kernels.team import Sweeps, Team
    from taichi_bearings.solvers.table import MethodOptions

CONSTANT = ("is_free", "across", "coefficient", "viscosity", "numbers")
"""Fields that steps do not change."""


@dataclass(frozen=True)
class Ended:
    """How a run of a method ended.

    best : the best state that was reached. bound : (R,), the best proven lower bound. proof : forces (C, R, E) from
    which that bound follows. iterations : how many were made. stop, options : what the run was asked to do.
    """

    status: Status
    best: Progress
    bound: np.ndarray
    proof: Forces
    iterations: int
    stop: StopRule
    options: "MethodOptions"


@dataclass(frozen=True)
class Launch:
    """A number of repeated calls of the kernels (`turns`) with the same constants.

    numbers : the constants. first : number of the first of these turns, for kernels whose constants depend on it.
    """

    turns: int
    numbers: tuple[float, ...]
    first: int = 0


class Contacts(ABC):
    """The contacts of a scene as a method steps them.

    scene : what is stepped; for a packing without the contacts that take no part. spin_axes : the spin components that
    are carried. points, forces : names of the fields that hold the spins of a gradient descent (on spheres) and its
    forces (on contacts). fields : the numbers on the device, once `use` was called. spec : names and sizes of these
    fields.
    """

    scene: Bearing
    spin_axes: tuple[int, ...]
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
    def specified(self, spheres: dict[str, int], contacts: list[str]) -> AnySpec:
        """Return the names and sizes of all fields that a method needs, those of the law included.

        spheres : how many numbers each sphere has in the field of each name. contacts : names of fields on contacts.
        """

    @abstractmethod
    def use(self, spec: AnySpec, viscosity: np.ndarray | None) -> None:
        """Allocate the fields of `spec`, and load the coefficients into them.

        viscosity : (R, E), the viscosities of a law with friction and viscosity, in the units of the kernels; None for
        other laws.
        """

    @abstractmethod
    def read_forces(self, name: str) -> np.ndarray:
        """Return the forces or elongations (C, R, E) that the field of this name holds."""

    @abstractmethod
    def load_force(self, force: np.ndarray) -> None:
        """Write forces (C, R, E) into the field `force`."""

    @abstractmethod
    def springs(self, corrector: tuple[float, ...]) -> "tuple[Team, Sweeps]":
        """Return the threads and the kernels for the dynamics of Cundall and Strack.

        corrector : coefficients of Gear's corrector, that of the 0th derivative first.
        """

    @abstractmethod
    def descents(self) -> "tuple[Team, Sweeps]":
        """Return the threads and the kernels for gradient descent."""

    @abstractmethod
    def run(self, team: "Team", sweeps: "Sweeps", launch: Launch) -> None:
        """Call the kernels as often and with the constants that `launch` says."""

    @abstractmethod
    def weights(self, bounds: np.ndarray) -> np.ndarray:
        """Return upper bounds (C, R, *N) on the curvature of the objective along each spin component of each sphere.

        bounds : (R, E), upper bounds on the curvature of what each contact adds.
        """

    @abstractmethod
    def inertias(self, options: Any, density: Any) -> Any:
        """Return the moments of inertia of the free spheres: one number, or (N,).

        options : options of a method with `mass` and `inertia`. density : that of the spheres of a packing, as for
        `Packing.inertias`; lattices have no use for it. The unknowns of a packing are u = R omega, so that its moments
        are divided by the square of the radius; those of a lattice are not.
        """

    @abstractmethod
    def unit_inertia(self, inertia: Any) -> float:
        """Return the moment of inertia of a sphere whose entry of the field `is_free` is 1; others have it scaled."""

    @abstractmethod
    def fastest_modes(self, inertia: Any) -> tuple[float, float]:
        """Return upper bounds on what the fastest modes of the network have.

        The first is the decay rate by viscosity, 1/time. The second is R^2 lambda / I, 1/mass, if all contacts stick,
        with eigenvalues lambda of the network's Laplacian. inertia : as from `inertias`.
        """

    @abstractmethod
    def unknowns(self, spin_axes: tuple[int, ...], unit: float, inertia: Any) -> "Unknowns":
        """Return the unknowns that an implicit step of the rigid-limit dynamics solves for.

        spin_axes : the components that move. unit : of spins, 1/time. inertia : as from `inertias`.
        """

    def died_out(self, component: int, spins: np.ndarray) -> np.ndarray | None:
        """Return what the spins (R, *N) of a component are once friction has stopped it.

        component : number of the spin component. spins : its spins now, 1/time. None for one that never stops.
        """
        return None

    @property
    def has_no_bound(self) -> bool:
        """Whether no positive lower bound is known, so that rest has to be believed without one."""
        return False

    def best_bound(self, bound: np.ndarray) -> np.ndarray:
        """Return the best lower bound (R,) so far. bound : (R,), the one that was computed last."""
        return bound

    @abstractmethod
    def proven_by(self, force: Forces) -> np.ndarray:
        """Return the lower bound (R,) that follows from the forces (C, R, E) of a checkpoint."""

    @abstractmethod
    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None, **more: Any) -> Progress:
        """Return the progress of spins and forces, with the bounds that follow from them.

        staggered : (C, R, *N), spins with signs by which neighbours differ. force : (C, R, E). proof : forces from
        which the lower bound is taken, or None for `force`. more : further entries of the `Progress`.
        """

    def answered(self, ended: Ended) -> Solution | None:
        """Return the answer of a run on a packing that ended; None for a lattice, whose answer drive.py computes."""
        return None

    def state(self) -> dict[str, np.ndarray]:
        """Return what the further run depends on, by name, beside what a method keeps itself."""
        return {}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from what `state` returned in an earlier call."""
        assert not self.state()
