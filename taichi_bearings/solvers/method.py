"""What every method offers to the common loop in drive.py."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from taichi_bearings.fields import Fields
from taichi_bearings.proof.certificate import Forces
from taichi_bearings.scene import Bearing, Progress
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.contacts import Contacts, Launch

if TYPE_CHECKING:
    from taichi_bearings.kernels.team import Sweeps, Team
    from taichi_bearings.solvers.table import MethodOptions


class Method:
    """One way to reach the state of least dissipation: its steps and what they mean, nothing else.

    A method never prints, times, opens a file or decides when to stop. options : the row of the table that it was built
    from. scene, contacts : what it steps, and what it asks of the contacts of that. iteration : how many were made.
    """

    resumes: ClassVar[bool] = False
    """Whether its `state()` holds all that the further course depends on, for `restore` to go on from."""
    scene: Bearing
    contacts: Contacts
    iteration: int
    spin_axes: tuple[int, ...]

    def __init__(self, options: "MethodOptions") -> None:
        self.options: Any = options

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Take a scene, and laboratory spins to start from; load the fields, if any, and compile the kernels."""
        self.contacts = contacts_of(scene, spin, self.options.is_dynamics)
        self.scene, self.spin_axes = self.contacts.scene, self.contacts.spin_axes

    def next_check(self, iteration: int) -> int:
        """Iteration at which to look at the progress next."""
        return iteration + 1

    def advance(self, steps: int) -> None:
        """Do `steps` iterations; a method on Taichi fields reads nothing back."""
        raise NotImplementedError

    def progress(self) -> Progress:
        """Where the method stands, judged by the certificate; the only device-to-host read."""
        raise NotImplementedError

    def state(self) -> dict[str, np.ndarray]:
        """Everything that the further course depends on, of a method that `resumes`."""
        raise NotImplementedError

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from such a state; called after `begin`."""
        raise NotImplementedError

    def differences(self, staggered: np.ndarray) -> np.ndarray:
        """(C, R, *N) -> (C, R, E); the slip over the radius."""
        return self.scene.differences(staggered, self.spin_axes)

    def pulls(self, force: np.ndarray) -> np.ndarray:
        """Sums of the contact forces (C, R, E) that pull on each sphere, (C, R, *N)."""
        return self.scene.pulls(force, self.spin_axes)

    def absolute(self, staggered: np.ndarray) -> np.ndarray:
        """Staggered spins (C, R, *N) as they are in the laboratory, not measured from the bottom: for energies."""
        return self.scene.absolute(staggered, self.spin_axes)

    def with_viscosity(self, force: np.ndarray, difference: np.ndarray) -> np.ndarray:
        """Forces (C, R, E) and what the contacts resist beyond them at these differences (C, R, E), 1/time: their
        viscosity, or what a law of one's own says."""
        law, radius = self.scene.law, self.scene.slip_radius
        slip = difference if law.is_sum else radius * vector_length(difference)
        resistance = law.resistance(self.scene.material, slip)
        return force if resistance is None else force + radius * resistance * difference

    def forces_at(self, staggered: np.ndarray, width: float) -> np.ndarray:
        """Contact forces (C, R, E) of the law at these spins; friction grows up to a difference of `width`, 1/time."""
        difference = self.differences(staggered)
        held = self.scene.law.holding_force(self.scene.material)
        force = 0 * difference if held is None else held / np.maximum(vector_length(difference), width) * difference
        return self.with_viscosity(force, difference)

    def proven_by(self, force: Forces) -> np.ndarray:
        """Lower bound (R,) that follows from forces (C, R, E) which were looked at before."""
        return self.contacts.proven_by(force)

    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None = None, **more: Any) -> Progress:
        """Progress of spins (C, R, *N) and contact forces (C, R, E), with what follows from them: what is minimised,
        its lower bound from `proof`, or from the forces themselves if None, and the torque that the forces leave."""
        return self.contacts.judged(staggered, force, proof, **more)

    def by_plane(self, values: np.ndarray, component: int) -> np.ndarray:
        """View (R, planes, m, n) of spins or contacts (R, ...): one plane a layer along the component, height last."""
        return values[:, None] if self.scene.network.dimension == 2 else np.moveaxis(values, 1 + component, 1)


class Swept(Method):
    """A method whose steps are turns of one kernel over all spheres and contacts, for which `begin` makes `team` and
    `sweeps`."""

    team: "Team"
    sweeps: "Sweeps"

    @property
    def fields(self) -> Fields:
        """The numbers of all spheres and contacts."""
        return self.contacts.fields

    def launches(self, steps: int) -> Iterator[Launch]:
        """What to launch, one after the other, to make so many steps."""
        raise NotImplementedError

    def advance(self, steps: int) -> None:
        for launch in self.launches(steps):
            self.contacts.run(self.team, self.sweeps, launch)


def contacts_of(scene: Bearing, spin: np.ndarray, moves: bool) -> Contacts:
    """The contacts of a scene, in the memory where it has them.

    spin : laboratory spins to start from. moves : the spins are those of a motion, which may begin in components that
    no minimum needs.
    """
    if scene.network.lattice is not None:
        from taichi_bearings.solvers.on_strides import OnStrides

        return OnStrides(scene, spin, moves)
    from taichi_bearings.solvers.on_lists import OnLists  # and with it what judges packings

    return OnLists(scene, spin)
