"""The contacts of a lattice as methods step them: neighbours are a constant stride apart in memory.

Leftover torques are balanced by fast transforms where a lower bound needs it. Shapes: R samples, N spheres (the shape
of the lattice), E contacts, C carried spin components.
"""

import gc
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from taichi_bearings.fields import Fields, FieldSpec, block_size, team_size
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.lattice.incidence import weights
from taichi_bearings.lattice.layout import Layout
from taichi_bearings.memory import give_back_freed
from taichi_bearings.proof.certificate import Forces, largest_unbalanced_torque, lower_bound
from taichi_bearings.scene import Progress, Scene, Solution
from taichi_bearings.solvers.answer import answered
from taichi_bearings.solvers.contacts import Ended, Inertia, Launch, Stepped, WithMinima
from taichi_bearings.solvers.gear import (
    Modes,
    laplacian_spectrum,
    largest_laplacian_eigenvalue,
    largest_stable_step,
    largest_weighted_eigenvalue,
)
from taichi_bearings.solvers.lattice_states import LatticeReached
from taichi_bearings.solvers.part import Part
from taichi_bearings.solvers.table import JUDGED_SECONDS, MethodOptions

if TYPE_CHECKING:
    from taichi_bearings.conic.proximal import Unknowns
    from taichi_bearings.kernels.team import Sweeps, Team
    from taichi_bearings.solvers.table import CundallStrack, Motion


UNCACHED_SPHERES = 60_000  # with so many spheres the 12 MB of fields of a dynamics do not fit into the caches of a core


class OnStrides(Stepped, WithMinima):
    """The contacts of all samples of a lattice, for methods that make steps and for those that find minima. In the
    arrays on the device neighbours are a constant stride apart.

    scene : the lattice, with its R samples.
    start : (R samples, *N spheres, 3), in 2D (R, *N), laboratory spins to start from, 1/time.
    spec : names of the fields, with the numbers that each sphere has in them.
    spin_axes : numbers of the axes of the C spin components that are computed.
    points : names of the fields that hold the spins of a gradient descent.
    forces : empty, as the sweeps of a gradient descent compute the contact forces anew and need no field for them.
    fields : the arrays on the device, once `allocate` was called.
    stencil : constants for which kernels are compiled, once `allocate` was called.
    """

    scene: Scene
    spec: FieldSpec
    points, forces = ("point", "point_next"), ()

    def __init__(self, scene: Scene, spin: np.ndarray, moves: bool) -> None:
        """Take a lattice, and choose the spin components that are computed.

        scene : the lattice.
        spin : (R samples, *N spheres, 3), in 2D (R, *N), spins to start from, 1/time.
        moves : True for a dynamics, which needs all components that are not at rest at the start; False for a minimum.
        """
        self.scene, self.start = scene, spin
        self.spin_axes = _moving_axes(scene, spin) if moves else scene.minimum_spin_axes

    def paths(self, settle: bool, tolerance: float) -> Part:
        """Return the solver of the interior-point method: the central paths of all samples, curves of spins and forces
        along which Newton steps lead to the minimum.

        settle : True to go on along the paths until it is known which contacts slip.
        tolerance : not used; the paths of lattices prove their gap after each step.
        """
        from taichi_bearings.solvers.lattice_paths import LatticePaths

        return LatticePaths(self.scene, self.spin_axes, self.start, settle)

    def cuts(self) -> Part:
        """Return the solver that finds the minimum cuts of all planes of the lattice, the layers whose contacts couple
        the one spin component that is computed.
        """
        from taichi_bearings.solvers.grid_cuts import GridCuts

        return GridCuts(self.scene, self.spin_axes, self.start)

    def linear_systems(self) -> Part:
        """Return the solver that balances the viscous forces in all planes of the lattice, the layers whose contacts
        couple one spin component.
        """
        from taichi_bearings.solvers.grid_bundles import GridBundles

        return GridBundles(self)

    @property
    def stores_predicted(self) -> bool:
        """True if the spins that Gear's method predicts for the end of the next step have a field of their own.

        False on lattices too large for the caches of a core. There the kernel adds up the Taylor series again, from
        derivatives that it reads anyway, since that costs less than to write and read one more field.
        """
        return self.scene.lattice.sites * self.scene.replicas < UNCACHED_SPHERES

    def field_spec(self, spheres: dict[str, int], contacts: list[str]) -> FieldSpec:
        """Return the fields that a method needs, as pairs (name, how many numbers each sphere has in it).

        spheres : how many numbers each sphere has, by the name of the field.
        contacts : names of the method's fields on contacts. A contact has its numbers at its lower sphere: one for each
            axis, or one for each component of a force.
        """
        dimension, forces = self.scene.lattice.dimension, self.stencil_of(1).force_components
        counts = {"coefficient": dimension, "viscosity": dimension, "work": 1}
        return (*spheres.items(), *((name, counts.get(name, forces)) for name in (*contacts, *self.of_law)))

    def stencil_of(self, block: int) -> Stencil:
        """Return the constants for which kernels of this lattice are compiled.

        block : spheres that a kernel works on together.
        """
        return Stencil(self.spin_axes, self.scene.lattice.dimension, block, self.scene.lattice.periodic)

    def on_device(self, spec: FieldSpec, kind: DTypeLike | None = None) -> Fields:
        """Return new fields on the device, all 0.

        spec : names of the fields, with the numbers that each sphere has in them.
        kind : type of the numbers, on a CPU alone; by default that of the precision of the runtime.
        """
        lattice = self.scene.lattice
        return Fields(Layout(self.scene.replicas, lattice.shape, block_size(), lattice.periodic), spec, kind)

    def allocate(self, spec: Any, viscosity: np.ndarray | None) -> None:
        """Allocate the fields, and load the coefficients of the law into them.

        spec : pairs (name of a field, how many numbers each sphere has in it).
        viscosity : (R samples, E contacts), viscosity of each contact beside its friction, times the radius, by which
            kernels multiply a spin difference; for gradient descent also divided by the unit of the friction
            coefficients. None for laws without.
        """
        self.spec, self.fields = spec, self.on_device(spec)
        layout = self.fields.layout
        self.stencil = self.stencil_of(layout.block)
        self.fields.load("coefficient", layout.at_lower_sphere(self.scene.acting_coefficient))
        if viscosity is not None:
            self.fields.load("viscosity", layout.at_lower_sphere(viscosity))

    def read_forces(self, name: str) -> np.ndarray:
        """Return the forces (or elongations of springs) of the contacts, (C components, R samples, E contacts), by spin
        component.

        name : name of the field that holds them.
        """
        return self.stencil.forces_of_contacts(self.fields.read(name), self.fields.layout)

    def load_force(self, force: np.ndarray) -> None:
        """Write contact forces, (C components, R samples, E contacts) by spin component, into the field `force`."""
        self.fields.load("force", self.stencil.forces_at_lower_sphere(force, self.fields.layout))

    def spring_kernel(self, corrector: tuple[float, ...]) -> "tuple[Team, Sweeps]":
        """Return the threads and the kernel for the dynamics of Cundall and Strack.

        corrector : coefficients of Gear's corrector, that of the spin itself first.

        Raises InputError for a law whose force is not known on the device.
        """
        from taichi_bearings.kernels.cundall_strack import CundallStrackSteps
        from taichi_bearings.kernels.team import Team, made_once

        law, numbers = self.scene.law, self.stencil.components + self.stencil.force_components
        team = Team(team_size(self.fields.layout, numbers))
        own = () if law.is_sum else (self._force_law(),)
        return team, made_once(CundallStrackSteps, self.spec, self.stencil, corrector, *own)

    def descent_kernel(self) -> "tuple[Team, Sweeps]":
        """Return the threads that make the sweeps of gradient descent together, and the kernel of these sweeps.

        Raises InputError for a law whose force is not known on the device.
        """
        from taichi_bearings.kernels.descent import DescentSweeps
        from taichi_bearings.kernels.team import Team, made_once

        team = Team(team_size(self.fields.layout, self.stencil.components))
        return team, made_once(DescentSweeps, self.spec, self.stencil, self._force_law())

    def _force_law(self) -> Callable[..., Any]:
        """Return the force of the law as kernels compute it, a Taichi function.

        Raises InputError for a law whose force is not known on the device, or is another there than in its class.
        """
        # imported here, because methods without sweeps need no Taichi
        from taichi_bearings.kernels.contact import ForceTrial, check_force, force_on_device
        from taichi_bearings.kernels.team import made_once

        scene, law = self.scene, self.scene.law
        found = force_on_device(law.name)
        if not law.is_sum:
            acting = scene.material[0][scene.material[0] > 0]
            slip = scene.lattice.radius * (scene.jump or 1.0) * np.array([0.01, 0.1, 0.5, 1.0])
            coefficient = np.repeat([acting.min(), acting.max()], len(slip))
            slip = np.tile(slip, 2)
            force = law.force((coefficient,), slip)
            check_force(law.name, made_once(ForceTrial, found), slip, coefficient, scene.lattice.radius, force)
        return found

    def run(self, team: "Team", sweeps: "Sweeps", launch: Launch) -> None:
        """Call a kernel several times with the same constants.

        team : the threads that run it.
        sweeps : the kernel.
        launch : how often (`calls`), after how many calls since the momentum was zero (`first`), and with which
            constants (`numbers`).
        """
        sweeps.run(self.fields, team, launch.calls, launch.numbers, first=launch.first)

    def weights(self, bounds: np.ndarray) -> np.ndarray:
        """Return for each spin component of each sphere the sum of `bounds` over the contacts that this component makes
        slip: (C components, R samples, *N spheres).

        bounds : (R, E contacts), a number for each contact, such as a bound on its curvature.
        """
        return weights(bounds, self.scene.lattice, self.spin_axes)

    def inertias(self, options: "Motion", density: ArrayLike | None) -> float:
        """Return the moment of inertia, mass * length^2, which all spheres have.

        options : options of a method, with `mass` and `inertia`.
        density : not used by lattices.
        """
        return inertia_of(self.scene, options)

    def common_inertia(self, inertia: Inertia) -> float:
        """Return the moment of inertia of all spheres as a number, which the kernel takes as one of its constants.

        inertia : the moment of inertia, mass * length^2.
        """
        return float(inertia)

    def fastest_modes(self, inertia: Inertia, slopes: np.ndarray | None) -> tuple[float, float]:
        """Return two bounds on how fast spins can change: the decay rate by viscosity of the fastest mode, 1/time; and
        R^2 lambda / I, 1/mass, if all contacts stick. R is the radius, I the moment of inertia, lambda the largest
        eigenvalue of the Laplacian of the contacts.

        inertia : I, mass * length^2.
        slopes : (R samples, E contacts), largest slope of each contact's force over its slip, force * time/length; None
            for friction alone.
        """
        return fastest_modes(self.scene, self.spin_axes, float(inertia), slopes)

    def sticking_modes(self, options: "CundallStrack", largest_spin: float, stable: float) -> Modes:
        """Return the modes of the lattice if all its contacts stick, from which the error of a time step follows.

        options : stiffness, damping, mass and order of Gear's method.
        largest_spin : largest spin at the start, 1/time.
        stable : largest stable time step.
        """
        return sticking_modes(self.scene, self.spin_axes, options, largest_spin, stable)

    def unknowns(self, spin_axes: tuple[int, ...], unit: float, inertia: Inertia) -> "Unknowns":
        """Return the free spins of the spin components that move, as the unknowns of an implicit step.

        spin_axes : the components that move.
        unit : unit of the spins in the solve, 1/time.
        inertia : not used; all spheres of a lattice have the same.
        """
        from taichi_bearings.conic.proximal import OfLattice

        return OfLattice(self.scene, spin_axes, unit)

    def stopped_spins(self, component: int, spins: np.ndarray) -> np.ndarray | None:
        """Return the spins (R samples, *N spheres), 1/time, at which friction stops one spin component if nothing
        drives it; None if the top is driven in it.

        A component that is not driven ends at 0. Only the component about the height keeps a mean spin in each layer,
        which no contact changes.

        component : number of the axis of the spin component.
        spins : (R, *N), its spins now, 1/time, with signs that alternate between neighbours, less that of the bottom.
        """
        rest, free = spins.copy(), spins[..., 1:-1]
        if component == self.scene.lattice.height_axis:
            rest[..., 1:-1] = free.mean(axis=(1, 2), keepdims=True)
        elif self.scene.top_spin((component,)).any():
            return None
        else:
            rest[..., 1:-1] = 0.0
        found: np.ndarray | None = rest
        return found

    def proven_by(self, force: Forces) -> np.ndarray:
        """Return the lower bound (R samples,) on the objective (least power or potential) that some contact forces
        prove.

        force : (C components, R, E contacts), contact forces, such as a checkpoint keeps.
        """
        return lower_bound(self.scene, force, self.spin_axes)

    def seconds_to_solve(self, options: MethodOptions, tolerance: float) -> float:
        """Return an estimate of the seconds that a method takes to solve all samples, by the size of the lattice; 0 if
        that is not known. The arguments are explained in :class:`Contacts`.
        """
        return (options.seconds(self.scene.lattice.shape, tolerance) or 0.0) * self.scene.replicas

    @property
    def seconds_to_prove(self) -> float:
        """An estimate of the seconds that the proof of an answer takes, by the size of the lattice."""
        lattice = self.scene.lattice
        return JUDGED_SECONDS[lattice.dimension] * lattice.sites * self.scene.replicas

    def answered(self, ended: Ended) -> Solution:
        """Return the answer to all samples, from the best spins and the best forces of a run.

        ended : how the run ended, with the best that it has reached.
        """
        is_large = self.scene.lattice.sites * self.scene.replicas >= UNCACHED_SPHERES
        reached = LatticeReached(self.scene, ended)
        ended = replace(ended, best=reached.final, proof=reached.size)  # sizes of forces, as vectors take much memory
        if is_large:
            give_back_freed()
        found = answered(reached, ended, ended.while_wanted)
        if is_large:
            del reached
            gc.collect()  # objects of the proof refer to each other, so that only this frees them
            give_back_freed()
        return found

    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None, **more: Any) -> Progress:
        """Return the progress of a method with given spins and forces: their objective, lower bound, and largest torque
        left.

        staggered : (C components, R samples, *N spheres), spins with signs that alternate between neighbours, 1/time.
        force : (C, R, E contacts), contact forces at these spins.
        proof : (C, R, E), forces from which the lower bound is computed; None for `force`.
        more : further fields of :class:`Progress`, by name.
        """
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


def inertia_of(scene: Scene, options: "Motion") -> float:
    """Return the moment of inertia of every sphere of a lattice, mass * length^2.

    It is the option `inertia` if given, else m R^2 / 2 of a disc or 2 m R^2 / 5 of a sphere.

    scene : the lattice.
    options : options of a method, with `mass` (m) and `inertia` (None if not given).
    """
    usual = options.mass * scene.slip_radius**2 * (0.5 if scene.lattice.dimension == 2 else 0.4)
    return float(options.inertia or usual)


def fastest_modes(
    scene: Scene, spin_axes: tuple[int, ...], inertia: float, slopes: np.ndarray | None
) -> tuple[float, float]:
    """Return two numbers of the fastest modes of a lattice: the decay rate by viscosity, 1/time, and R^2 lambda / I,
    1/mass, if all contacts stick.

    The first follows from the largest eigenvalue of the Laplacian weighted by the slopes, as an upper estimate; it is 0
    for friction alone. For the second, lambda is the largest eigenvalue of the Laplacian with weights 1, in closed
    form.

    scene : the lattice.
    spin_axes : numbers of the axes of the spin components that are computed.
    inertia : I, mass * length^2; R is the radius.
    slopes : (R samples, E contacts), largest slope of each contact's force over its slip, such as its viscosity,
        force * time/length; None for friction alone.
    """
    over = scene.slip_radius**2 / inertia
    decay = over * largest_weighted_eigenvalue(scene, spin_axes, slopes)
    return decay, over * largest_laplacian_eigenvalue(scene.lattice, spin_axes)


def sticking_modes(
    scene: Scene, spin_axes: tuple[int, ...], options: "CundallStrack", largest_spin: float, stable: float
) -> Modes:
    """Return the modes of a lattice whose contacts stick, from which the error of a time step follows.

    scene : the lattice.
    spin_axes : numbers of the axes of the spin components that are computed.
    options : stiffness, damping, mass and order of Gear's method.
    largest_spin : largest spin at the start, 1/time; the driven spins are taken into account too.
    stable : largest stable time step.
    """
    radius = scene.slip_radius
    over = radius**2 / inertia_of(scene, options)
    spectrum = over * laplacian_spectrum(scene.lattice, spin_axes)
    if not scene.law.has_friction:
        # without friction: the rates are those of equal contacts, scaled so that the stiffest mode has its known rate
        stiffest = largest_stable_step(options.gear_order, 1.0, 0.0) / stable
        decay = stiffest * spectrum / (over * largest_laplacian_eigenvalue(scene.lattice, spin_axes))
        return Modes(decay, np.zeros_like(spectrum), 1.0, 0.0, np.inf)
    # with friction: a contact sticks up to the friction of the strongest one
    strongest = float(scene.acting_coefficient.max())
    holds = scene.strength * strongest * options.static_ratio
    fastest = float(max(largest_spin, scene.fastest, np.finfo(float).tiny))
    damping = options.damping
    if scene.viscosities is not None:
        damping += max(float(values.mean()) for values in scene.lattice.by_axis(scene.viscosities))
    return Modes(damping * spectrum, options.stiffness * spectrum, damping, options.stiffness, holds / radius / fastest)


def _moving_axes(scene: Scene, spin: np.ndarray) -> tuple[int, ...]:
    """Return the axes of the spin components that a motion needs: those that the minimum has, and others in which
    something moves at the start.

    A component moves if some sphere has another spin in it than the bottom, with signs that alternate between
    neighbours.

    scene : the lattice with its R samples.
    spin : (R samples, *N spheres, 3), in 2D (R, *N), spins at the start, 1/time.
    """
    needed, every = scene.minimum_spin_axes, scene.lattice.all_spin_axes
    if scene.lattice.dimension == 2:
        return needed
    full = scene.staggered_spin(spin, every)
    return tuple(k for k in every if k in needed or full[k].any())
