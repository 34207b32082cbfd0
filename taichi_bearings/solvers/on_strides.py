"""The contacts of a lattice as methods step them: neighbours are a constant stride apart in memory.

Leftover torques are balanced by fast transforms where a lower bound needs it. Shapes: R samples, N spheres (the shape
of the lattice), E contacts, C carried spin components.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.fields import Fields, FieldSpec, block_size, team_size
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.lattice.incidence import weights
from taichi_bearings.lattice.layout import Layout
from taichi_bearings.proof.certificate import Forces, largest_unbalanced_torque, lower_bound
from taichi_bearings.scene import Bearing, Progress, Scene
from taichi_bearings.scene.scene import of_lattice
from taichi_bearings.solvers.contacts import Contacts, Launch
from taichi_bearings.solvers.gear import largest_laplacian_eigenvalue, largest_weighted_eigenvalue

if TYPE_CHECKING:
    from taichi_bearings.conic.proximal import Unknowns
    from taichi_bearings.kernels.team import Sweeps, Team


class OnStrides(Contacts):
    """The contacts of all samples of a lattice, side by side."""

    scene: Scene
    spec: FieldSpec
    points, forces = ("point", "point_next"), ()

    def __init__(self, scene: Bearing, spin: np.ndarray, moves: bool) -> None:
        """Take a lattice. spin : laboratory spins at the start. moves : a dynamics is solved."""
        self.scene = of_lattice(scene)
        self.spin_axes = _moving_axes(self.scene, spin) if moves else scene.minimum_spin_axes

    def specified(self, spheres: dict[str, int], contacts: list[str]) -> FieldSpec:
        """Return the fields as pairs of name and numbers a sphere; arguments as of `Contacts`."""
        dimension, forces = self.scene.lattice.dimension, self.stencil_of(1).force_components
        counts = {"coefficient": dimension, "viscosity": dimension, "work": 1}
        return (*spheres.items(), *((name, counts.get(name, forces)) for name in (*contacts, *self.of_law)))

    def stencil_of(self, block: int) -> Stencil:
        """Return the constants for which kernels are compiled. block : spheres that a kernel works on together."""
        return Stencil(self.spin_axes, self.scene.lattice.dimension, block, self.scene.lattice.periodic)

    def on_device(self, spec: FieldSpec) -> Fields:
        """Return new fields on the device. spec : their names, with the numbers that each sphere has in them."""
        lattice = self.scene.lattice
        return Fields(Layout(self.scene.replicas, lattice.shape, block_size(), lattice.periodic), spec)

    def use(self, spec: Any, viscosity: np.ndarray | None) -> None:
        """Allocate the fields of `spec`, and load the coefficients; as of `Contacts`."""
        self.spec, self.fields = spec, self.on_device(spec)
        layout = self.fields.layout
        self.stencil = self.stencil_of(layout.block)
        self.fields.load("coefficient", layout.at_lower_sphere(self.scene.acting_coefficient))
        if viscosity is not None:
            self.fields.load("viscosity", layout.at_lower_sphere(viscosity))

    def read_forces(self, name: str) -> np.ndarray:
        """Return the forces or elongations (C, R, E) that a field holds."""
        return self.stencil.forces_of_contacts(self.fields.read(name), self.fields.layout)

    def load_force(self, force: np.ndarray) -> None:
        """Write forces (C, R, E) into the field `force`."""
        self.fields.load("force", self.stencil.forces_at_lower_sphere(force, self.fields.layout))

    def springs(self, corrector: tuple[float, ...]) -> "tuple[Team, Sweeps]":
        """Return the threads and the kernels for the dynamics of Cundall and Strack; as of `Contacts`."""
        from taichi_bearings.kernels.cundall_strack import CundallStrackSteps  # methods without sweeps need no Taichi
        from taichi_bearings.kernels.team import Team, made_once

        team = Team(team_size(self.fields.layout, self.stencil.components + self.stencil.force_components))
        return team, made_once(CundallStrackSteps, self.spec, self.stencil, corrector)

    def descents(self) -> "tuple[Team, Sweeps]":
        """Return the threads and the kernels for gradient descent; as of `Contacts`.

        Raises InputError for a law whose force is not known on the device.
        """
        from taichi_bearings.kernels.contact import FORCES
        from taichi_bearings.kernels.descent import DescentSweeps
        from taichi_bearings.kernels.team import Team, made_once

        team, law = Team(team_size(self.fields.layout, self.stencil.components)), self.scene.law.name
        if law not in FORCES:
            raise InputError(
                f"law is {law!r}; gradient-descent needs its force on the device, as a row of "
                "FORCES in taichi_bearings.kernels.contact"
            )
        return team, made_once(DescentSweeps, self.spec, self.stencil, law)

    def run(self, team: "Team", sweeps: "Sweeps", launch: Launch) -> None:
        """Call the kernels as often and with the constants that a launch says."""
        sweeps.run(self.fields, team, launch.turns, launch.numbers, first=launch.first)

    def weights(self, bounds: np.ndarray) -> np.ndarray:
        """Return the sums (C, R, *N) of `bounds`, (R, E), over the contacts that couple each spin component."""
        return weights(bounds, self.scene.lattice, self.spin_axes)

    def inertias(self, options: Any, density: Any) -> float:
        """Return the moment of inertia of every sphere, mass * length^2, as `inertia_of` says."""
        return inertia_of(self.scene, options)

    def unit_inertia(self, inertia: Any) -> float:
        """Return the moment of inertia, which all spheres of a lattice have."""
        return float(inertia)

    def fastest_modes(self, inertia: Any) -> tuple[float, float]:
        """Return the decay rate and R^2 lambda / I of the fastest modes; as of `Contacts`."""
        return fastest_modes(self.scene, self.spin_axes, inertia)

    def unknowns(self, spin_axes: tuple[int, ...], unit: float, inertia: Any) -> "Unknowns":
        """Return the free spins of the components that move, for rigid-limit steps; arguments as of `Contacts`."""
        from taichi_bearings.conic.proximal import OfLattice

        return OfLattice(self.scene, spin_axes, unit)

    def died_out(self, component: int, spins: np.ndarray) -> np.ndarray | None:
        """Return spins (R, *N) of a component that friction has stopped; None for one in which the top is driven.

        About the height they are the mean of each layer, which no contact changes; in other components they are 0.
        """
        rest, free = spins.copy(), spins[..., 1:-1]
        if component == self.scene.lattice.height_axis:
            rest[..., 1:-1] = free.mean(axis=(1, 2), keepdims=True)
        elif self.scene.top_spin((component,)).any():
            return None
        else:
            rest[..., 1:-1] = 0.0
        return rest

    def proven_by(self, force: Forces) -> np.ndarray:
        """Return the lower bound (R,) that the forces (C, R, E) of a checkpoint prove."""
        return lower_bound(self.scene, force, self.spin_axes)

    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None, **more: Any) -> Progress:
        """Return the progress of spins and forces, with the bounds of the certificate; arguments as of `Contacts`."""
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


def inertia_of(scene: Scene, options: Any) -> float:
    """Return the moment of inertia that is given, or m R^2 / 2 of a disc or 2 m R^2 / 5 of a sphere."""
    usual = options.mass * scene.slip_radius**2 * (0.5 if scene.lattice.dimension == 2 else 0.4)
    return float(options.inertia or usual)


def fastest_modes(scene: Scene, spin_axes: tuple[int, ...], inertia: float) -> tuple[float, float]:
    """Return the decay rate by viscosity, 1/time, and R^2 lambda / I, 1/mass, of the fastest modes of a lattice.

    The first follows from the largest eigenvalue of the weighted Laplacian, raised by what Lanczos' method may miss.
    The second is that of contacts that all stick, whose largest eigenvalue is known. inertia : mass * length^2.
    """
    over = scene.slip_radius**2 / inertia
    decay = over * largest_weighted_eigenvalue(scene, spin_axes) if scene.law.flows else 0.0
    return decay, over * largest_laplacian_eigenvalue(scene.lattice, spin_axes)


def _moving_axes(scene: Scene, spin: np.ndarray) -> tuple[int, ...]:
    """Return the spin components that a motion needs: those of the minimum, and others that are not at rest at first.

    spin : laboratory spins (R, *N, 3) at the start. A component is needed if some sphere has another staggered spin
    than the bottom plane.
    """
    needed, every = scene.minimum_spin_axes, scene.lattice.all_spin_axes
    if scene.lattice.dimension == 2:
        return needed
    full = scene.staggered_spin(spin, every)
    return tuple(k for k in every if k in needed or full[k].any())
