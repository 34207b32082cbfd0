"""What methods ask of the contacts that they step, whatever these lie in: fields, kernels, bounds, and the answer.

`OnStrides` of solvers/on_strides.py has the contacts of a lattice, whose neighbours are a stride apart; `OnLists` of
solvers/on_lists.py those of any other network, in lists. Which of the two it is, is asked in solvers/method.py alone.
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
    """How a course ended: its status, the best state that it reached, the bound (R,) that is proven, the forces from
    which that follows, and the iterations that were made."""

    status: Status
    best: Progress
    bound: np.ndarray
    proof: Forces
    iterations: int
    stop: StopRule
    options: "MethodOptions"


@dataclass(frozen=True)
class Launch:
    """Turns of kernels with the same constants, `numbers`, the first of them number `first`."""

    turns: int
    numbers: tuple[float, ...]
    first: int = 0


class Contacts(ABC):
    """The contacts of a scene as a method steps them.

    scene : what is stepped; of a packing that has the contacts alone that act. spin_axes : the components of spins that
    are carried. points, forces : names of the fields of spheres and of contacts that hold the spins of a descent and
    its forces. fields : the numbers on the device, once `use` was called.
    """

    scene: Bearing
    spin_axes: tuple[int, ...]
    points: tuple[str, ...]
    forces: tuple[str, ...]
    fields: Fields
    spec: AnySpec
    look_again = 1.2
    """Times the iterations after which a bound that costs a factorisation is looked for again."""

    @property
    def of_law(self) -> list[str]:
        """The names of the fields that hold the coefficients of the law."""
        return ["coefficient", *(["viscosity"] if self.scene.viscosity_beside_friction is not None else [])]

    @abstractmethod
    def specified(self, spheres: dict[str, int], contacts: list[str]) -> AnySpec:
        """Say which fields there are: of these names with so many numbers a sphere, of these names on the contacts, and
        those of the law."""

    @abstractmethod
    def use(self, spec: AnySpec, viscosity: np.ndarray | None) -> None:
        """Make the fields, and load the coefficients into them.

        viscosity : (R, E) beside friction, in the units of the kernels; None of a law that has no such.
        """

    @abstractmethod
    def read_forces(self, name: str) -> np.ndarray:
        """Forces or elongations (C, R, E) that the field of this name holds."""

    @abstractmethod
    def load_force(self, force: np.ndarray) -> None:
        """Write forces (C, R, E) into the field `force`."""

    @abstractmethod
    def springs(self, corrector: tuple[float, ...]) -> "tuple[Team, Sweeps]":
        """Workers, and the kernels of Cundall and Strack's dynamics with this corrector of Gear's method."""

    @abstractmethod
    def descents(self) -> "tuple[Team, Sweeps]":
        """Workers, and the kernels of gradient descent."""

    @abstractmethod
    def run(self, team: "Team", sweeps: "Sweeps", launch: Launch) -> None:
        """Make turns of the kernels."""

    @abstractmethod
    def weights(self, bounds: np.ndarray) -> np.ndarray:
        """Numbers (C, R, *N) no smaller than the curvature of a spin component whose contacts have at most the
        curvatures `bounds`, (R, E)."""

    @abstractmethod
    def inertias(self, options: Any, density: Any) -> Any:
        """Moments of inertia of the free spheres over the square of the radius that spins are carried with: one number,
        or (N,). options : have `mass` and `inertia`. density : of packings, as of `Packing.inertias`."""

    @abstractmethod
    def unit_inertia(self, inertia: Any) -> float:
        """Return the inertia of a sphere whose field `is_free` holds 1."""

    @abstractmethod
    def fastest_modes(self, inertia: Any) -> tuple[float, float]:
        """Return the decay rate by viscosity, 1/time, of the mode that decays fastest, and lambda / I, 1/mass, of the
        stiffest mode if all contacts stick; no mode has more."""

    @abstractmethod
    def unknowns(self, spin_axes: tuple[int, ...], unit: float, inertia: Any) -> "Unknowns":
        """What rigid steps of these components find. unit : of spins. inertia : as of `inertias`."""

    def died_out(self, component: int, spins: np.ndarray) -> np.ndarray | None:
        """What spins (R, *N) in a component are once it has died out; None of one that never does."""
        return None

    @property
    def has_no_bound(self) -> bool:
        """Whether no bound can be proven, so that rest has to be believed without one."""
        return False

    def best_bound(self, bound: np.ndarray) -> np.ndarray:
        """The best lower bound (R,) so far. bound : of the last look."""
        return bound

    @abstractmethod
    def proven_by(self, force: Forces) -> np.ndarray:
        """Return the lower bound (R,) that follows from forces (C, R, E) which were looked at before."""

    @abstractmethod
    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None, **more: Any) -> Progress:
        """As `Method.judged`."""

    def answered(self, ended: Ended) -> Solution | None:
        """The answer to a course that ended; None of a lattice, which drive.py judges."""
        return None

    def state(self) -> dict[str, np.ndarray]:
        """What the further course depends on, beside what a method keeps itself."""
        return {}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from such a state."""
        assert not self.state()
