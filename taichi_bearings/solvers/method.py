"""What every method offers to the common loop in drive.py."""

from typing import Any, ClassVar

import numpy as np

from taichi_bearings.fields import Fields, FieldSpec, block_size
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.lattice.layout import Layout
from taichi_bearings.proof.certificate import Forces, largest_unbalanced_torque, lower_bound
from taichi_bearings.scene import Progress, Scene, Solution
from taichi_bearings.scene.scene import vector_length


class Method:
    """One way to reach the state of least dissipation: its steps and what they mean, nothing else.

    A method never prints, times, opens a file or decides when to stop. options : the row of the table that it was built
    from. What it asks of its contacts is answered here for lattices, for packings in solvers/packings.py.
    """

    resumes: ClassVar[bool] = False
    """Whether its `state()` holds all that the further course depends on, for `restore` to go on from."""
    scene: Scene
    spin_axes: tuple[int, ...]
    spec: Any
    fields: Any

    def __init__(self, options: Any) -> None:
        self.options = options

    def begin(self, scene: Scene, spin: np.ndarray) -> None:
        """Take a scene, and laboratory spins to start from; load the fields, if any, and compile the kernels."""
        self.scene, self.spin_axes = scene, self.carried(scene, spin)

    def carried(self, scene: Scene, spin: np.ndarray) -> tuple[int, ...]:
        """Spin components that are carried."""
        return scene.minimum_spin_axes

    def next_check(self, iteration: int) -> int:
        """Iteration at which to look at the progress next."""
        return iteration + 1

    def advance(self, steps: int) -> None:
        """Do `steps` iterations; a method on Taichi fields reads nothing back."""
        raise NotImplementedError

    def progress(self) -> Progress:
        """Where the method stands, judged by the certificate; the only device-to-host read."""
        raise NotImplementedError

    def answered(self, course: Any) -> Solution | None:
        """The solution of a course through a packing; None for a lattice, whose best state drive.py answers with."""
        return None

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
        return lower_bound(self.scene, force, self.spin_axes)

    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None = None, **more: Any) -> Progress:
        """Progress of spins (C, R, *N) and contact forces (C, R, E), with what follows from them: what is minimised,
        its lower bound from `proof`, or from the forces themselves if None, and the torque that the forces leave."""
        scene, axes = self.scene, self.spin_axes
        return Progress(
            staggered=staggered,
            spin_axes=axes,
            force=force,
            objective=scene.objective(staggered, axes),
            lower_bound=lower_bound(scene, force if proof is None else proof, axes),
            largest_balance_residual=largest_unbalanced_torque(scene, force, axes),
            proof=proof,
            **more,
        )

    def by_plane(self, values: np.ndarray, component: int) -> np.ndarray:
        """View (R, planes, m, n) of spins or contacts (R, ...): one plane a layer along the component, height last."""
        return values[:, None] if self.scene.lattice.dimension == 2 else np.moveaxis(values, 1 + component, 1)

    def specified(self, spheres: dict[str, int], contacts: list[str]) -> Any:
        """Fields with these numbers a sphere, and of these names a contact, and what the law has of each."""
        dimension, forces = self.scene.lattice.dimension, self.stencil_of(1).force_components
        counts = {"coefficient": dimension, "viscosity": dimension, "work": 1}
        return (*spheres.items(), *((name, counts.get(name, forces)) for name in (*contacts, *self.of_law)))

    @property
    def of_law(self) -> list[str]:
        """Fields of the coefficients of the law."""
        return ["coefficient", *(["viscosity"] if self.scene.viscosity_beside_friction is not None else [])]

    def stencil_of(self, block: int) -> Stencil:
        return Stencil(self.spin_axes, self.scene.lattice.dimension, block, self.scene.lattice.periodic)

    def on_device(self, spec: FieldSpec) -> Fields:
        """Fields of a spec, on the device that runs."""
        lattice = self.scene.lattice
        return Fields(Layout(self.scene.replicas, lattice.shape, block_size(), lattice.periodic), spec)

    def use(self, spec: Any, viscosity: np.ndarray | None) -> None:
        """Fields of a spec, with the coefficients of the contacts loaded.

        viscosity : beside friction, (R, E), in the units of the kernels.
        """
        self.spec, self.fields = spec, self.on_device(spec)
        layout = self.fields.layout
        self.stencil = self.stencil_of(layout.block)
        self.fields.load("coefficient", layout.at_lower_sphere(self.scene.acting_coefficient))
        if viscosity is not None:
            self.fields.load("viscosity", layout.at_lower_sphere(viscosity))

    def read_forces(self, name: str) -> np.ndarray:
        """Forces or elongations (C, R, E) in a field."""
        return self.stencil.forces_of_contacts(self.fields.read(name), self.fields.layout)
