"""Operator splitting for Coulomb friction: one step balances all torques, the next one applies the friction limits.

The power is P(Omega) = R sum over contacts of mu F_n |D Omega|, with spins Omega and their differences D Omega across
contacts. Each contact gets a slip z of its own. The alternating direction method of multipliers, which is
Douglas-Rachford splitting, ties z to D Omega by springs of stiffness rho:

    f, z    per contact: the trial force v = f + rho z is split into f, v limited to the friction disc, and the rest
    Omega   minimises sum over contacts of |v - 2 f - rho D Omega|^2, a Poisson problem with constant coefficients,
            solved for the change of Omega that cancels the torque which the springs leave on each sphere
    v       <- f + (1 - alpha) rho z + alpha rho D Omega, with alpha = 1.9 (over-relaxation)

Both halves are exact, so v converges from any start for any rho > 0 and 0 < alpha < 2 (Eckstein and Bertsekas 1992).
The spring force rho D Omega - (v - 2 f) right after the Poisson step leaves no torque on any free sphere: capped or
scaled into the friction discs it proves the lower bound. docs/methods.md has the rules and the measured rates.

Contacts along the height carry the drive and slip most, so their springs are four times softer. The stiffness is
steered by the proven gap, which splits into (P - W) + (W - bound) with W the work that the driven planes would do
against the balanced forces. The first part is large when the springs are too soft (the spins are late), the second when
they are too hard (the forces are late). At each look rho is changed, sample by sample, towards a second part that is
five times the first.

Shapes are (C, R, *N) for spins and (C, R, E) for forces: C carried spin components, N spheres, E contacts, and R in
shapes is the number of samples; in formulas it is the radius. A *look* is when the loop of drive.py reads the progress.
Spins are *staggered*: with signs by which neighbours differ, measured from the bottom plane.
"""

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from itertools import repeat
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.fields import Fields, FieldSpec, on_device, team_size
from taichi_bearings.interrupts import look_up
from taichi_bearings.kernels.balance import BalanceKernels
from taichi_bearings.kernels.splitting import ABSENT_FRICTION, ContactStep
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import Team, made_once
from taichi_bearings.lattice.laplacian import chain_eigenvalues, chain_factors, chain_modes, ring_closures
from taichi_bearings.memory import refuse_beyond
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.proof.certificate import (
    Forces,
    balance,
    largest_unbalanced_torque,
    parts_in_cache,
    work_and_bound,
)
from taichi_bearings.scene import Bearing, Progress, Scene
from taichi_bearings.scene.initial_spins import linear_spin
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.on_strides import OnStrides
from taichi_bearings.solvers.splitting_look import Look

RELAXATION = 1.9  # alpha
HEIGHT_WEIGHT = 0.25  # stiffness of springs along the height over that of the others
USUAL_STIFFNESS = 15.0  # stiffness at the start, in units of the force that a column of spheres transmits over the jump
FORCES_BEHIND = 5.0  # ratio (W - bound) / (P - W) to which the stiffness is steered
LARGEST_CHANGE, LEAST_CHANGE = 2.0, 1.2  # factor on the stiffness at one check; smaller changes are not made
STEERED_ITERATIONS = 20_000  # iterations after which the stiffness stays, so that the proof of convergence applies
FIRST_CHECK, CHECKS_A_RUN = 50, 6  # looks are 50 iterations or 1/6 of the run apart; they take 5 to 20 % of the time
# bytes: 136 for the fields in double precision, 220 for a look, the rest for the answer and its proof
BYTES_A_SPHERE = 1000.0
GAP_FALLS_AS = 2.0  # the gap falls about as iteration^-2, measured from 24^3 to 48^3
RESOLVED_SLIP = 0.01  # of the imposed jump: faster contacts count as slipping at any stage

SHARED_BY_BLAS = 32  # spheres along the height from which the BLAS library would use threads of its own
PRODUCT_TYPE = np.float32  # precision of the products with sines on a CPU
CACHED_NUMBERS = 65_536  # numbers that are still in the second-level cache when they are added to others

Planes = list[tuple[np.ndarray, np.ndarray]]  # some planes of a field, and the same planes of its modes


class OperatorSplittingMethod(Method):
    """Operator splitting: the least power of friction by a pass over all contacts and a Poisson solve, repeated.

    The power is the sum over contacts of radius * mu F_n |D Omega|, with spins Omega and their differences D Omega
    across contacts. Each contact bears a trial force v; f is v cut off at the friction limit; springs of stiffness rho
    tie the slip (v - f) / rho of the contact to D Omega. An iteration is one pass over all contacts and one Poisson
    solve for each spin component.

    Fields, with C spin components or V force components at each site:

    friction : mu F_n of the contact above a site, by axis.
    trial : (V), v.
    spring : (V), rho D Omega - (v - 2 f), the forces of the springs.
    potential : (C), rho Omega.
    pull : (C), the sum of the spring forces on each sphere before the Poisson step.

    Attributes:

    stiffness : (R samples,), rho of each sample.
    weights, weight : stiffness of the springs over rho, by lattice axis, and by contact (E contacts,).
    changing : names of the fields that iterations change.
    layout, stencil : where the numbers of a site stand in the fields, and constants for which kernels are compiled.
    balance : the solver of the Poisson problem, which adds the change of the spins to `potential`.
    contact_step, team : the kernel of the pass over the contacts, and the threads that run it.
    """

    scene: Scene
    contacts: OnStrides
    resumes = True
    changing = ("trial", "spring", "potential", "pull")

    def begin(self, scene: Bearing, spin: np.ndarray) -> None:
        """Prepare the iteration: allocate the fields, build the Poisson solver, compile the kernels, and load the
        start.

        scene : the lattice that is solved.
        spin : (R samples, *N spheres, 3), in 2D (R, *N), laboratory spins to start from, 1/time; clipped to the
            interval of the driven ones.

        Raises an error if the memory does not suffice.
        """
        super().begin(scene, spin)
        scene = self.scene
        dimension, components = scene.lattice.dimension, len(self.spin_axes)
        spheres = scene.lattice.sites * scene.replicas
        refuse_beyond(BYTES_A_SPHERE * spheres, f"{self.options.name} of {spheres:,} spheres")
        # fields and kernels
        forces = self.contacts.stencil_of(1).force_components
        of_contacts = ("friction", dimension), ("trial", forces), ("spring", forces)
        spec = (*of_contacts, ("potential", components), ("pull", components))
        self.fields = self.contacts.on_device(spec)
        self.layout = self.fields.layout
        self.stencil = self.contacts.stencil_of(self.layout.block)
        # the two halves of an iteration: the Poisson solve, and the pass over the contacts
        self.weights = (1.0,) * scene.lattice.height_axis + (HEIGHT_WEIGHT,)
        self.weight = np.array(self.weights)[scene.lattice.axis]
        self.balance = TorqueBalance(spec, self.stencil, self.weights, self.fields)
        self.contact_step = made_once(ContactStep, spec, self.stencil)
        self.team = Team(team_size(self.layout, sum(components for _, components in spec)))
        self.contact_step.compile(self.fields, self.team)
        self._load(scene.clip_to_box(scene.staggered_spin(spin, self.spin_axes), self.spin_axes))

    def _load(self, staggered: np.ndarray) -> None:
        """Load the first iterate: the friction limits, the spins, and the forces that the springs bear at these spins.
        The first stiffness follows from the power of spins that change linearly with the height.

        staggered : (C components, R samples, *N spheres), spins with signs that alternate between neighbours, 1/time.
        """
        scene = self.scene
        friction = np.full((scene.lattice.dimension, scene.replicas, *scene.lattice.shape), ABSENT_FRICTION)
        for axis, coefficient in enumerate(scene.lattice.by_axis(scene.acting_coefficient)):
            self.layout.from_lower_sphere(friction[axis], axis)[...] = scene.strength * coefficient
        self.fields.load("friction", friction)
        linear = scene.staggered_spin(linear_spin(scene), self.spin_axes)
        self.stiffness = self._usual_stiffness(scene.power(linear, self.spin_axes))
        self.iteration = 0
        stiffness = self._along_lattice(self.stiffness)
        self.fields.load("potential", stiffness * staggered)
        self._load_trial_forces(self.weight * self.stiffness[:, None] * self.differences(staggered))

    def _load_trial_forces(self, trial: Forces) -> None:
        """Write trial forces, (C components, R samples, E contacts), into their field. A trial force is cut off at the
        friction limit to give the friction of the contact.
        """
        self.fields.load("trial", self.stencil.forces_at_lower_sphere(trial, self.layout))

    def state(self) -> dict[str, np.ndarray]:
        """Return by name the fields and numbers that the further iterations depend on, for a checkpoint."""
        fields = {name: self.fields.read(name) for name in self.changing}
        return fields | {"iteration": np.array(self.iteration), "stiffness": self.stiffness}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the fields and numbers by name that `state` returned in an earlier call."""
        for name in self.changing:
            self.fields.load(name, state[name])
        self.iteration, self.stiffness = int(state["iteration"]), np.array(state["stiffness"])

    def _along_lattice(self, values: np.ndarray) -> np.ndarray:
        """Return values (R samples,), one a sample, with an axis of length 1 for each axis of the lattice."""
        return values.reshape(-1, *(1,) * self.scene.lattice.dimension)

    def next_check(self, iteration: int) -> int:
        """Return the iteration at which to read the progress next: FIRST_CHECK iterations or a sixth of the run later.

        iteration : the one at which it is read now.
        """
        return iteration + max(FIRST_CHECK, iteration // CHECKS_A_RUN)

    def advance(self, steps: int) -> None:
        """Make `steps` iterations, each a pass over the contacts and a Poisson solve."""
        with self.balance.begin():
            for _ in range(steps):
                look_up()
                self._step_contacts(RELAXATION)
                self.balance.solve()
                self.iteration += 1

    def _step_contacts(self, relaxation: float) -> None:
        """Make the pass over the contacts: cut off trial forces at friction, update them, and sum the spring forces on
        each sphere.

        relaxation : alpha, the factor of the over-relaxation; with 0 the trial forces stay, and only the spring forces
            are computed anew.
        """
        self.contact_step.run(self.fields, self.team, 1, (self.weights[0], self.weights[-1], relaxation))

    def progress(self) -> Progress:
        """Return the progress now: the spins, the friction forces f, and the lower bound that the balanced spring
        forces prove.

        The trial force v is cut off at the friction limit to give f; f leaves a torque on the spheres, which is
        reported and vanishes with the gap. The stiffness rho is adapted here too, so the iterations depend on when this
        is called.
        """
        scene, axes = self.scene, self.spin_axes
        if self.balance.is_rough and self.iteration:  # balance once more, for the torques that its rounding has left
            with self.balance.begin():
                self._step_contacts(0.0)
                self.balance.solve()
        stiffness, (potential, trial) = self._along_lattice(self.stiffness), self._seen("potential", "trial")
        staggered = scene.impose_driving(potential / stiffness, axes)
        look = Look(scene, self.stencil, self.layout, axes, staggered, trial, (self.stiffness, self.weights))
        found = look.look(self.balance.each)
        balanced, bound = found.balanced, found.bound
        if self.fields.dtype != np.float64:  # in single precision they are balanced once more
            balanced = balance(scene, balanced, axes)
            _, bound = work_and_bound(scene, balanced, axes)
        self._change_stiffness(self._stiffness_factors(found.power, found.work, bound))
        return Progress(
            iteration=self.iteration,
            staggered=staggered,
            spin_axes=axes,
            force=found.friction,
            objective=found.power,
            lower_bound=bound,
            resolution=min(found.creep, RESOLVED_SLIP * scene.lattice.radius * scene.jump),
            largest_balance_residual=largest_unbalanced_torque(scene, found.friction, axes),
            proof=balanced,
            falls_as=GAP_FALLS_AS,
        )

    def _seen(self, *names: str) -> list[np.ndarray]:
        """Return fields by name: on a CPU the arrays themselves, so that they can be changed in place; of a GPU
        copies.
        """
        see = self.fields.read if runtime.current().is_gpu else self.fields.view
        return [see(name) for name in names]

    def _change_stiffness(self, change: np.ndarray) -> None:
        """Multiply the stiffness rho of each sample by a factor, in place. Spins Omega and friction f stay, so that rho
        Omega and the rest v - f of the trial forces are multiplied.

        f keeps its bits, so that a contact that sticks goes on to stick.

        change : (R samples,), the factors; if all are 1 nothing is done.
        """
        if (change == 1).all():
            return
        self.stiffness = change * self.stiffness
        # the fields, in pieces that fit into the cache and that the threads share
        of_sites = self._along_lattice(change)
        potential, trial, friction = self._seen("potential", "trial", "friction")
        potential *= of_sites
        pieces = [
            ([trial[row][part] for row in rows], friction[axis][part], of_sites[part[0]])
            for axis, rows in enumerate(self.stencil.force_rows(0))
            for part in parts_in_cache(friction[axis])
            if rows
        ]
        list(self.balance.each(lambda piece: _rescale(*piece), pieces))
        if runtime.current().is_gpu:
            self.fields.load("potential", potential)
            self.fields.load("trial", trial)

    def _usual_stiffness(self, power: np.ndarray) -> np.ndarray:
        """Return the usual stiffness (R samples,): USUAL_STIFFNESS times the force of a column of spheres over the
        imposed spin difference.

        A column transmits the force power / (radius * spin difference * number of columns).

        power : (R,), energy/time.
        """
        scene = self.scene
        jump, columns = scene.jump or 1.0, scene.lattice.sites // scene.lattice.shape[-1]
        found: np.ndarray = (
            USUAL_STIFFNESS * np.maximum(power, np.finfo(np.float32).tiny) / (scene.lattice.radius * columns * jump**2)
        )
        return found

    def _stiffness_factors(self, power: np.ndarray, balanced_power: np.ndarray, bound: np.ndarray) -> np.ndarray:
        """Return factors (R samples,) by which the stiffness is to change so that the two parts of the gap get the
        ratio FORCES_BEHIND; 1 for no change.

        The part power - balanced_power is large if the springs are too soft, balanced_power - bound if they are too
        hard. The stiffness may differ from its usual value only by a ratio that grows slowly with the iterations;
        without that limit it could grow for ever, if both parts shrink in proportion. Small changes are not made.

        power : (R,), power of the spins.
        balanced_power : (R,), work of the driven spheres against the balanced forces.
        bound : (R,), lower bound on the least power.
        """
        if not 0 < self.iteration < STEERED_ITERATIONS:
            return np.ones(len(power))
        # neither part counts as less than a thousandth of the gap, so that their ratio stays finite
        least = np.maximum(1e-3 * (power - bound), np.finfo(np.float64).tiny)
        spins_late = np.maximum(power - balanced_power, least)
        forces_late = np.maximum(balanced_power - bound, least)
        factor = np.sqrt(FORCES_BEHIND * spins_late / forces_late).clip(1 / LARGEST_CHANGE, LARGEST_CHANGE)
        ratio = np.sqrt(max(self.iteration / FIRST_CHECK, 1.0))
        usual = self._usual_stiffness(power)
        wanted = (self.stiffness * factor).clip(usual / ratio, usual * ratio)
        factor = wanted / self.stiffness
        return np.where(np.abs(np.log(factor)) > np.log(LEAST_CHANGE), factor, 1.0)


class TorqueBalance:
    """Solves the Poisson problem of an iteration, and adds its solution u to the field `potential`.

    The problem is: sum over axes a of weight_a (-Laplace_a) u = `pull`, with u = 0 on the driven planes. A spin
    component is coupled along the height and one other axis only. A sine transform along the height separates the
    *modes*, one for each sine. A mode is a *chain* of spheres along the other axis (a ring if that is periodic), whose
    tridiagonal equations are solved by elimination, with factors that are computed once. On a GPU the solve is one
    launch. On a CPU the BLAS library multiplies by the sines.

    fields : the fields of the method.
    kernels : the kernels of the solve.
    weight : stiffness of the springs sideways.
    products : type of the numbers in the products with the sines on a CPU: single precision, or that of the fields if
        that is less.
    sines : matrix of the sine transform along a column of nz spheres: (nz, nz), 0 for driven ones; on a GPU (nz - 2, nz
        - 2).
    chains : flat, inverse pivots by which the chains, one for each mode, are solved.
    modes : flat, the transformed field, where solutions replace pulls.
    measures : whole numbers by which kernels find spheres: length of a row in memory, strides and the like.
    workers : number of threads that share the planes (layers of spheres that the height and one side span); 0 on a GPU.
    each : function like `map` that shares its calls among these threads.
    pulls, potentials : for each thread a list of pairs: some planes of `pull`, or of `potential`, and the same planes
        of the modes.
    is_rough : True if the products are less precise than the fields.
    is_small : True if a column is so short that the BLAS library would use no threads of its own.
    """

    def __init__(self, spec: FieldSpec, stencil: Stencil, weights: tuple[float, ...], fields: Fields) -> None:
        """Prepare the solution: the matrix `sines` of the transform along the height, and the factors `chains` of the
        tridiagonal equations along the other axis, one chain of spheres for each sine (a *mode*). On a CPU share the
        planes of the lattice among threads. The class says what each attribute is.

        spec : pairs (name of a field, number of its components).
        stencil : spin components, dimension and periodic axes of the lattice.
        weights : relative stiffness of the springs along each axis of the lattice, one number each; all axes but the
            height have the same.
        fields : the numbers of the fields; `pull` will be read, and `potential` changed.
        """
        self.fields, self.kernels, self.weight = fields, made_once(BalanceKernels, spec, stencil), weights[0]
        shape, layout = fields.layout.shape, fields.layout
        self.products = min(np.dtype(PRODUCT_TYPE), fields.dtype, key=lambda kind: kind.itemsize)
        # modes and eigenvalues of the chain of free spheres along the height; driven spheres have 0
        modes, held = chain_modes(shape[-1] - 2, is_held=True), np.zeros(shape[-1])
        held[1:-1] = weights[-1] * chain_eigenvalues(shape[-1] - 2, is_held=True)
        sides = [shape[axis] for axis in stencil.coupled_sides]
        numbers = (chain_factors, ring_closures)[: 2 if stencil.periodic else 1]
        # factors of the chain along the other axis of each spin component, for each mode; rings have a second row
        chains = np.zeros((len(numbers), len(sides), max(sides), shape[-1]))
        for kind, number in enumerate(numbers):
            for slot, side in enumerate(sides):
                chains[kind, slot, :side, 1:-1] = number(side, held[1:-1], self.weight)
        padded = np.arange(shape[-1] + layout.block)  # each row is continued by its beginning, for one block
        self.chains = self._numbers(np.take(chains, padded, axis=-1, mode="wrap").ravel())
        self.modes = self._numbers(np.zeros(len(sides) * layout.sites + layout.block))
        self.measures = self.kernels.measures(layout, max(sides))
        on_gpu = runtime.current().is_gpu
        # on a CPU driven spheres have sines 0: products of whole rows are faster than shorter ones
        self.sines = self._numbers(modes if on_gpu else np.pad(modes, 1))
        self.workers = team_size(layout, stencil.components)
        self.each: Callable[..., Iterable[None]] = ThreadPoolExecutor(self.workers).map if self.workers > 1 else map
        self.is_rough = self.workers > 0 and self.products != fields.dtype
        self.is_small = shape[-1] < SHARED_BY_BLAS
        if self.workers:
            self.pulls, self.potentials = self._shares("pull"), self._shares("potential")

    def _numbers(self, values: np.ndarray) -> Any:
        """Return an array of constants where the kernels read it: on a GPU on the device, with the precision of the
        fields; on a CPU a NumPy array of the type in which planes are multiplied by the sine matrix (`products`).

        values : the array, of any shape.
        """
        return on_device(values) if runtime.current().is_gpu else values.astype(self.products)

    def begin(self) -> AbstractContextManager[None]:
        """Return the context in which `solve` is called. It limits the BLAS library to one thread where the threads of
        this object share the planes. It changes nothing on a GPU, or in lattices so low that BLAS uses one thread
        anyway.
        """
        return nullcontext() if self.workers == 0 or self.is_small else one_thread()

    def solve(self) -> None:
        """Change the spins of the free spheres so that the springs balance.

        On a CPU the sines of each plane are one product of the BLAS library. So no number depends on what else is
        solved at the time, nor on how many threads share the planes. The products are in single precision, which is
        twice as fast. That is enough: the solution is only a change of the spins, small in the end, and the next one
        makes up for the rounding.
        """
        layout = self.fields.layout
        if self.workers == 0:
            values, places = self.fields.values, (layout.length, layout.margin)
            self.kernels.on_gpu(values, self.modes, self.sines, self.chains, *places, *self.measures, self.weight)
            return
        list(self.each(_to_modes, self.pulls, repeat(self.sines)))
        self.kernels.chains_on_cpu(self.workers, self.modes, self.chains, *self.measures, self.weight)
        list(self.each(_from_modes, self.potentials, repeat(self.sines)))

    def _shares(self, name: str) -> list[Planes]:
        """Divide a field among the threads. Return for each thread a list of pairs (planes of the field, the same
        planes of the array of modes).

        A plane is spanned by the last side of the lattice and the height; a pair has so few planes that they fit into
        the cache.

        name : name of the field.
        """
        layout = self.fields.layout
        planes, of_modes = (-1, *layout.shape[-2:]), self.modes[: -layout.block].reshape(-1, layout.sites)
        shares: list[Planes] = [[] for _ in range(self.workers)]
        for parts in zip(self.fields.view(name), of_modes, strict=True):
            field, modes = (part.reshape(planes) for part in parts)
            few = max(1, CACHED_NUMBERS // field[0].size)
            for worker, share in enumerate(shares):
                first, last = (len(field) * n // self.workers for n in (worker, worker + 1))
                share += [
                    (field[n : min(n + few, last)], modes[n : min(n + few, last)]) for n in range(first, last, few)
                ]
        return shares


def _to_modes(planes: Planes, sines: np.ndarray) -> None:
    """Write the sine transform along the height of some planes of the field `pull` (the spring forces summed on each
    sphere) into an array of modes, in place.

    planes : pairs (planes of `pull`, the same planes of the modes), arrays (..., nz) with nz spheres along the height.
    sines : (nz, nz), matrix of the transform.
    """
    for pull, modes in planes:
        np.matmul(pull.astype(sines.dtype, copy=False), sines, out=modes)


def _from_modes(planes: Planes, sines: np.ndarray) -> None:
    """Add the inverse sine transform of some planes of an array of modes to the field `potential` (stiffness times
    spins), in place.

    planes : pairs (planes of `potential`, the same planes of the modes), arrays (..., nz) with nz spheres along the
        height.
    sines : (nz, nz), matrix of the transform, which is its own inverse.
    """
    for potential, modes in planes:
        potential += np.matmul(modes, sines)


def _rescale(force: list[np.ndarray], friction: np.ndarray, change: np.ndarray) -> None:
    """Multiply the part of trial forces beyond the friction limit by a factor, in place, for some contacts along one
    axis.

    force : a list of one or two components of trial forces, arrays (R samples, *N sites) each.
    friction : (R, *N), their friction limits, negative where there is no contact.
    change : (R, 1, ..., 1), the factor of each sample.
    """
    limit = np.maximum(friction, 0.0)
    if len(force) == 1:
        limited = [np.clip(force[0], -limit, limit)]
    else:
        size = np.sqrt(force[0] * force[0] + force[1] * force[1])
        share = np.divide(limit, size, out=np.ones_like(size), where=size > limit)
        limited = [of * share for of in force]
    for of, cut in zip(force, limited, strict=True):
        of -= cut
        of *= change
        of += cut
