"""`Method`, what every method offers to the common loop in drive.py.

*Staggered* spins are those that are carried: on a lattice with signs by which neighbours differ and measured from the
bottom plane, so that the slip of a contact is the radius times a difference of spins; in a packing u = R omega, radius
times spin. Shapes: R samples, N spheres, E contacts, C carried spin components; in the shape (C, R, E) of forces of a
packing C is the number of tangents of a contact.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from taichi_bearings.fields import Fields
from taichi_bearings.proof.certificate import Forces
from taichi_bearings.scene import Bearing, Progress, Scene
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.contacts import Contacts, Launch, Stepped
from taichi_bearings.solvers.part import Found

if TYPE_CHECKING:
    from taichi_bearings.kernels.team import Sweeps, Team
    from taichi_bearings.solvers.table import MethodOptions


class Method(ABC):
    """One way to reach the state of least dissipation: its steps, and what they have reached. It never prints, times,
    opens a file or decides when to stop; the loop of drive.py does.

    options : the options of this method, an object of its class in table.py.
    scene : what it solves.
    contacts : the fields and kernels of the contacts of this scene.
    iteration : how many iterations were made.
    spin_axes : numbers of the axes of the C spin components that are computed.
    tolerance : relative gap, (objective - lower bound) / objective, at which the loop takes an answer as certified; set
        before `begin`.
    """

    resumes: ClassVar[bool] = False
    """True if a run can be resumed: `state()` returns all that its further steps depend on, and `restore` takes it."""
    options: "MethodOptions"
    scene: Bearing
    contacts: Contacts
    iteration: int
    spin_axes: tuple[int, ...]
    tolerance: float = 1e-8

    def __init__(self, options: "MethodOptions") -> None:
        """Take the options of the method: an object of its class in table.py."""
        self.options = options

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare to solve a scene. Here only the contacts are chosen, with the scene and the spin axes that they have.
        Subclasses also load fields (arrays on the device) and compile kernels, if they have any.

        spin : (R samples, *N spheres, 3), of discs (R, *N), spins to start from, 1/time.
        """
        self.contacts = contacts_of(scene, spin, self.options)
        self.scene, self.spin_axes = self.contacts.scene, self.contacts.spin_axes

    def next_check(self, iteration: int) -> int:
        """Return the iteration at which to read the progress next.

        iteration : the one at which it was read now.
        """
        return iteration + 1

    @abstractmethod
    def advance(self, steps: int) -> None:
        """Make `steps` iterations; a method on Taichi fields reads nothing back from the device."""

    @abstractmethod
    def progress(self) -> Progress:
        """Return the state now with its bounds; the only call that reads from the device."""

    def state(self) -> dict[str, np.ndarray]:
        """Return by name all arrays that the further iterations depend on, for a checkpoint; empty for a method whose
        runs cannot be resumed (`resumes` is False).
        """
        return {}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:  # noqa: B027
        """Continue from the arrays by name that `state` returned in an earlier call. It is called after `begin`, and
        only if the method can be resumed (`resumes`).
        """

    def give_back(self) -> None:  # noqa: B027
        """Free the memory that only further iterations would need; no iteration is made afterwards."""

    def found(self) -> list[Found]:
        """Return the spins and forces that each sample of a packing has reached, for a method that finds minima; empty
        for other methods.
        """
        return []

    def differences(self, staggered: np.ndarray) -> np.ndarray:
        """Return the differences of the spins across all contacts, (C components, R samples, E contacts), 1/time, from
        which slips follow by a factor: the radius (`Bearing.slip_radius`). In a packing return the slips themselves,
        length/time, and the factor is 1.

        staggered : (C, R, *N spheres), spins with signs that alternate between neighbours, 1/time; in a packing radius
            * spin.
        """
        return self.scene.differences(staggered, self.spin_axes)

    def pulls(self, force: np.ndarray) -> np.ndarray:
        """Return the sum (C components, R samples, *N spheres) of the contact forces on each sphere.

        force : (C, R, E contacts), contact forces.
        """
        return self.scene.pulls(force, self.spin_axes)

    def absolute(self, staggered: np.ndarray) -> np.ndarray:
        """Return spins measured from zero instead of from the bottom, (C components, R samples, *N spheres), as
        energies need them. Their signs still alternate between neighbours.

        staggered : (C, R, *N spheres), spins with signs that alternate between neighbours, less those of the bottom,
            1/time; in a packing radius * spin.
        """
        return self.scene.absolute(staggered, self.spin_axes)

    def with_viscosity(self, force: np.ndarray, difference: np.ndarray) -> np.ndarray:
        """Return contact forces (C components, R samples, E contacts): those given plus the resistance by viscosity, or
        by a law that a user has defined.

        force : (C, R, E), friction alone.
        difference : (C, R, E), spin differences of the contacts, 1/time.
        """
        law, radius = self.scene.law, self.scene.slip_radius
        slip = difference if law.is_sum else radius * vector_length(difference)
        resistance = law.resistance(self.scene.material, slip)
        return force if resistance is None else force + radius * resistance * difference

    def forces_at(self, staggered: np.ndarray, width: float) -> np.ndarray:
        """Return the contact forces (C components, R samples, E contacts) of the law at some spins, with friction that
        grows from 0 over a small slip.

        staggered : (C, R, *N spheres), spins with signs that alternate between neighbours, 1/time; in a packing radius
            * spin.
        width : spin difference, 1/time, up to which friction grows in proportion to it.
        """
        difference = self.differences(staggered)
        held = self.scene.law.holding_force(self.scene.material)
        force = 0 * difference if held is None else held / np.maximum(vector_length(difference), width) * difference
        return self.with_viscosity(force, difference)

    def proven_by(self, force: Forces) -> np.ndarray:
        """Return the lower bound (R samples,) on the objective (least power or potential) that some contact forces
        prove.

        force : (C components, R, E contacts), contact forces, such as a checkpoint keeps.
        """
        return self.contacts.proven_by(force)

    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None = None, **more: object) -> Progress:
        """Return the progress for given spins and forces: with objective, its lower bound, and the largest torque left.

        staggered : (C components, R samples, *N spheres), spins with signs that alternate between neighbours, 1/time;
            in a packing radius * spin.
        force : (C, R, E contacts), contact forces.
        proof : (C, R, E), forces from which the lower bound follows; None for `force`.
        more : further entries of the `Progress`, by name.
        """
        assert isinstance(self.contacts, Stepped), "methods that find minima of packings judge them by their part"
        return self.contacts.judged(staggered, force, proof, **more)


class Swept(Method):
    """A method whose steps are repeated calls of one kernel that works on all spheres and contacts.

    team, sweeps : the threads that run the kernel, and the kernel; both are set by `begin`.
    """

    contacts: Stepped
    team: "Team"
    sweeps: "Sweeps"

    @property
    def fields(self) -> Fields:
        """The arrays of numbers on all spheres and contacts."""
        return self.contacts.fields

    @abstractmethod
    def launches(self, steps: int) -> Iterator[Launch]:
        """Yield the launches (repeated calls of the kernel with the same constants), one after the other, that make
        `steps` steps.
        """

    def advance(self, steps: int) -> None:
        """Make `steps` steps by the launches that the method plans."""
        for launch in self.launches(steps):
            self.contacts.run(self.team, self.sweeps, launch)


def contacts_of(scene: Bearing, spin: np.ndarray, options: "MethodOptions") -> Contacts:
    """Return the contacts of a scene in the form that a method needs. There are three: those of a lattice; those of a
    packing in lists, for methods that make steps; and those of a packing as a linear system, for methods that find
    minima.

    spin : (R samples, *N spheres, 3), of discs (R, *N), spins to start from, 1/time.
    options : options of the method. A dynamics may begin with spin components that no minimum needs.
    """
    if isinstance(scene, Scene):
        from taichi_bearings.solvers.on_strides import OnStrides

        return OnStrides(scene, spin, options.is_dynamics)
    from taichi_bearings.scene.packing import of_packing  # and with it much of SciPy

    packing = of_packing(scene)
    if not options.steps_packings:
        from taichi_bearings.solvers.on_system import OnSystem

        return OnSystem(packing)
    from taichi_bearings.solvers.on_lists import OnLists  # and with it what judges packings

    return OnLists(packing, spin)
