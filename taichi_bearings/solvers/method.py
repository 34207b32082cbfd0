"""What every method offers to the common loop in drive.py."""

from typing import Any, Protocol

import numpy as np

from taichi_bearings.fields import Fields, FieldSpec
from taichi_bearings.lattice.incidence import contact_differences, torques
from taichi_bearings.proof.certificate import Forces, largest_unbalanced_torque, lower_bound
from taichi_bearings.scene import Progress, Scene
from taichi_bearings.solvers.table import MethodOptions


class Method(Protocol):
    """One way to reach the state of least dissipation: its steps and what they mean, nothing else.

    A method never prints, times, opens a file or decides when to stop.
    """

    @property
    def options(self) -> MethodOptions:
        """The row of the table that it was built from."""
        ...

    def plan(self, scene: Scene, spin: np.ndarray) -> FieldSpec:
        """Fields needed for this scene from these laboratory spins; fixes the spin components that are carried.

        Without fields the method works in NumPy alone.
        """
        ...

    def begin(self, scene: Scene, spin: np.ndarray, fields: Fields | None) -> None:
        """Load the fields and compile the kernels."""
        ...

    def next_check(self, iteration: int) -> int:
        """Iteration at which to look at the progress next."""
        ...

    def advance(self, steps: int) -> None:
        """Do `steps` iterations; a method on Taichi fields reads nothing back."""
        ...

    def progress(self) -> Progress:
        """Where the method stands, judged by the certificate; the only device-to-host read."""
        ...


class OnLattice:
    """What methods ask of the contacts that their spins meet at; those of a packing answer in solvers/network.py."""

    scene: Scene
    spin_axes: tuple[int, ...]

    def differences(self, staggered: np.ndarray) -> np.ndarray:
        """(C, R, *N) -> (C, R, E); the slip over the radius."""
        return contact_differences(staggered, self.scene.lattice, self.spin_axes)

    def pulls(self, force: np.ndarray) -> np.ndarray:
        """Sums of the contact forces (C, R, E) that pull on each sphere, (C, R, *N)."""
        return torques(force, self.scene.lattice, self.spin_axes)

    def absolute(self, staggered: np.ndarray) -> np.ndarray:
        """Staggered spins (C, R, *N) as they are in the laboratory, not measured from the bottom: for energies."""
        return staggered + self.scene.driving.bottom_state(self.spin_axes)[0]

    def proven_by(self, force: Forces) -> np.ndarray:
        """Lower bound (R,) that follows from forces (C, R, E) which were looked at before."""
        return lower_bound(self.scene, force, self.spin_axes)

    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None = None, **more: Any) -> Progress:
        return judged(self.scene, self.spin_axes, staggered, force, proof, **more)


def judged(
    scene: Scene,
    spin_axes: tuple[int, ...],
    staggered: np.ndarray,
    force: Forces,
    proof: Forces | None = None,
    **more: Any,
) -> Progress:
    """Progress of spins (C, R, *N) and contact forces (C, R, E), with what follows from them: what is minimised, its
    lower bound from `proof`, or from the forces themselves if None, and the torque that the forces leave."""
    return Progress(
        staggered=staggered,
        spin_axes=spin_axes,
        force=force,
        objective=scene.objective(staggered, spin_axes),
        lower_bound=lower_bound(scene, force if proof is None else proof, spin_axes),
        largest_balance_residual=largest_unbalanced_torque(scene, force, spin_axes),
        proof=proof,
        **more,
    )
