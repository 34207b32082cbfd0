"""The central paths of the samples of a lattice, for the interior-point method: where they begin and what they lead to.

Letters: R samples, E contacts of the lattice, n contacts among them that a free sphere has, C carried spin components.
*Staggered* spins have signs by which neighbours differ, and are measured from the bottom plane.
"""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from taichi_bearings.conic.central_path import flowing
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.contact_system import free_spins, place_free_spins
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.descent import DISTANT_GAP, Sample
from taichi_bearings.conic.iterate import LEAST_GAP, Iterate
from taichi_bearings.conic.newton_matrix import MOST_NEWTON_STEPS
from taichi_bearings.conic.resolution import DECIDED_RATIO
from taichi_bearings.conic.rows import compile_passes
from taichi_bearings.conic.shared import surroundings_of_lattice
from taichi_bearings.conic.strong_contacts import weakened
from taichi_bearings.kernels.elimination import LANES
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.double_double import Pair, exactly, multiply
from taichi_bearings.proof.certificate import largest_unbalanced_torque, lower_bound, work_and_bound
from taichi_bearings.proof.contact_state import ContactState, all_slipless
from taichi_bearings.scene import Progress, Scene
from taichi_bearings.solvers.paths import Paths
from taichi_bearings.solvers.splitting_start import centred, splitting
from taichi_bearings.solvers.table import InteriorPoint

# number of unknowns from which splitting comes first: below, it takes as long as the Newton steps that it saves
SPLIT_UNKNOWNS = 40_000
# number of unknowns up to which paths begin with forces: of 16^3 spheres 2 in 64 samples did not settle from there
NEAR_PATH_UNKNOWNS = 2_000
BATCHED_SITES = InteriorPoint.alike_in_a_block  # spheres up to which samples are factorised side by side


def _states(sample: Sample) -> np.ndarray:
    """Return the contact states (n,) of a sample, for the n contacts with a free sphere.

    If the method has settled them, these are returned. Else slip and friction margin (friction limit minus force) are
    compared, in the units of the path, in which both are about 1. A contact slips if its slip is above DECIDED_RATIO
    times its margin, is slipless if its margin is above DECIDED_RATIO times its slip, and is undecided otherwise.

    sample : the end of its central path.
    """
    slipping, slipless, undecided = ContactState.SLIPPING, ContactState.SLIPLESS, ContactState.UNDECIDED
    if (of := sample.resolved) is not None:
        return np.select(
            [of.known_to_slip_sometimes, of.at_limit, of.slipping], [ContactState.TIED, undecided, slipping], slipless
        )
    point, slip, margin = sample.iterate, length(sample.iterate.difference), sample.iterate.margin
    if point.viscosity is not None:  # slips at which viscous forces match the friction are no small ones
        slip = slip * (1 + point.viscosity / point.friction)
    return np.select([slip > DECIDED_RATIO * margin, margin > DECIDED_RATIO * slip], [slipping, slipless], undecided)


class LatticePaths(Paths):
    """The central paths of all samples of a lattice: curves of spins and forces along which Newton steps lead to the
    minimum. At their ends it is found which contacts slip.

    scene : the lattice with its R samples.
    spin_axes : numbers of the axes of the C spin components that are computed.
    unit : unit of spins on the paths, 1/time.
    frustrated : True if the driven planes have different spins, so that something has to be solved.
    system : the contacts with a free sphere. Slips are a linear map of the unknowns, the free spins times signs that
        alternate between neighbours.
    samples : the state of each sample on its path.
    """

    def __init__(self, scene: Scene, spin_axes: tuple[int, ...], spin: np.ndarray, settle: bool) -> None:
        """Build the contact system and its matrix, and put all samples at the starts of their central paths: the curves
        of spins and forces along which Newton steps lead to the minimum.

        scene : the lattice with its R samples.
        spin_axes : numbers of the axes of the C spin components that are computed.
        spin : (R samples, *N spheres, 3), in 2D (R, *N), laboratory spins to start from, 1/time; they are clipped to
            the interval between the driven spins.
        settle : True to go on along the paths until contact states are settled.
        """
        self.scene, self.spin_axes = scene, spin_axes
        # imposed spins of the top less those of the bottom, in `unit`, as sums of two doubles (C, *plane)
        top, self.unit = scene.driving.top_in_units(spin_axes), float(scene.driving.unit[0][0])
        self.frustrated = bool(top[0].any())
        small = scene.lattice.sites < BATCHED_SITES  # several small samples are stepped at a time
        shared = surroundings_of_lattice(scene.lattice, spin_axes, top, small)
        self.system = shared.system
        super().__init__(shared, scene.lattice.sites, small, settles=True, asked=settle)
        if self.frustrated:
            together = LANES if small and scene.replicas > 1 else 1
            # compiled before time is measured; only the kernels of a single sample left at the end are compiled later
            compile_passes(self.system.offset.shape[1], together, shared.matrix.is_costly)
            shared.matrix.compile(together)
            shared.matrix.reserve()
        # the spins to start from, within the interval of the driven ones, and those of the free spheres in `unit`
        inside = scene.clip_to_box(scene.staggered_spin(spin, spin_axes), spin_axes)
        start = free_spins(inside / (self.unit or 1.0))
        self.samples = [self._sample(replica, spins) for replica, spins in enumerate(start)]
        self._split = self._prepared_splitting(spin)

    def _prepared_splitting(self, spin: np.ndarray) -> Callable[[], Progress] | None:
        """Return a function that runs operator splitting, from whose result the paths of large cubic lattices begin.
        Return None for small or planar lattices, for lattices with viscosity, where the matrix of springs is not quick
        to factorise (as on a GPU), and where memory is short.

        spin : laboratory spins to start from, 1/time.
        """
        scene = self.scene
        large = scene.lattice.dimension == 3 and self.system.unknowns >= SPLIT_UNKNOWNS and self.frustrated
        if large and scene.viscosity_beside_friction is None and self.shared.has_quick_springs:
            with suppress(MemoryError):
                return splitting(scene, spin)
        return None

    def advance(self, steps: int) -> None:
        """Take up to `steps` further Newton steps of every sample that is not done; in large cubic lattices with
        friction alone let the paths begin where a short operator splitting ends."""
        split, self._split = self._split, None
        if split is not None and self.iteration == 0:
            self._begin_at(split())
        super().advance(steps)

    def _begin_at(self, reached: Progress) -> None:
        """Move the starts of all paths near the minimum. Samples in which strong contacts got less friction (`firm`)
        keep their starts.

        reached : spins and forces near the minimum.
        """
        spins = free_spins(reached.staggered / self.unit)
        for replica, sample in enumerate(self.samples):
            if sample.firm is None:
                dual = -self.system.gather_vectors(reached.force, replica) / (sample.unit * self.scene.normal_force)
                with one_thread():
                    sample.iterate = centred(sample.iterate, spins[replica], dual, self.shared.springs)

    def _sample(self, replica: int, spins: np.ndarray) -> Sample:
        """Return the start of the central path of a sample, the curve along which Newton steps lead to its minimum.

        Forces are measured in a unit near the mean coefficient. Without viscosity, contacts so strong that they are
        slipless at every minimum get less friction, as wide contrasts cost precision. With viscosity, the path starts
        at the spins at which viscous forces balance.

        replica : number of the sample.
        spins : (unknowns,), free spins in units of `unit`.
        """
        scene, viscosity, firm = self.scene, None, None
        friction, beside = scene.positive_coefficient[replica, self.system.contact], scene.viscosity_beside_friction
        strength = friction  # with viscosity, friction plus the viscous force at a slip of radius * unit
        if beside is not None:
            flow = scene.lattice.radius * self.unit / scene.normal_force * beside[replica, self.system.contact]
            strength = friction + flow
        elif self.frustrated:
            strength = weakened(self.system, friction)
            firm, friction = strength < friction, strength  # firm: contacts whose friction was reduced
        unit = float(np.exp2(np.round(np.log2(np.mean(strength)))))  # dividing by it rounds nothing
        # bound of the slip of a contact that has none at the start: about the mean jump from layer to layer
        slack = 1.0 / (scene.lattice.shape[-1] - 1)
        if beside is not None and self.frustrated:
            viscosity = flow / unit
            with suppress(NotPositiveDefinite), one_thread():
                spins = flowing(self.system, viscosity, self.shared.matrix, spins)
        if beside is None and len(friction) and self.system.unknowns <= NEAR_PATH_UNKNOWNS:
            start = Iterate.near_path(self.system, spins, friction / unit, slack)
        else:
            start = Iterate.start(self.system, spins, friction / unit, slack, viscosity)
        return Sample(start, unit, firm=firm if firm is not None and firm.any() else None)

    def next_check(self, iteration: int) -> int:
        """Return the iteration at which to read the progress next. It does not depend on which other samples are solved
        at the same time.

        If contact states are to be settled (`asked`), it is read at every second step, as reading costs half a step at
        10^3 spheres; small samples are read once, when most of them have ended. If not, the run ends at the tolerance,
        and it is read at every second step far from the tolerance, and at every step near it.

        iteration : the one at which it is read now.
        """
        if self.small and self.asked:
            return iteration + MOST_NEWTON_STEPS  # mostly all they need
        far = self.frustrated and max(sample.gap for sample in self.samples) > DISTANT_GAP
        return iteration + (2 if far or self.asked else 1)

    def progress(self) -> Progress:
        """Return the progress of all samples. A sample whose contact states are settled has the minimum with these
        states; the others have their points on the central path.

        Slips and states come from the path itself, as they are more precise than those of the rounded spins.
        """
        scene = self.scene
        (staggered, rest), speed = self._spins(), scene.lattice.radius * self.unit
        state, slip = all_slipless(scene), np.zeros(scene.coefficient.shape)
        force = np.zeros((len(self.spin_axes), *slip.shape))
        # slips, states and forces of the n contacts with a free sphere, then of all
        answers = [sample.resolved or sample.iterate for sample in self.samples]
        slips = np.stack([length(answer.difference) for answer in answers])
        states = np.stack([_states(sample) for sample in self.samples])
        forces = np.stack(
            [
                -answer.whole_dual * (of.unit * scene.normal_force)
                for answer, of in zip(answers, self.samples, strict=True)
            ]
        )
        slip[:, self.system.contact], state[:, self.system.contact] = speed * slips, states
        self.system.scatter_vectors(forces, force, slice(None))
        objective = scene.objective(scene.impose_driving(staggered, self.spin_axes), self.spin_axes)
        # how far the path is: what is settled, and the largest slip of a contact that seems slipless
        settled = np.array([sample.resolved is not None for sample in self.samples])
        creep = slips.max(axis=1, initial=0.0, where=states == ContactState.SLIPLESS)
        settles_more = self.asked and self.frustrated and not all(sample.done for sample in self.samples)
        return Progress(
            iteration=self.iteration,
            staggered=staggered,
            rest=rest,
            spin_axes=self.spin_axes,
            force=force,
            objective=objective,
            lower_bound=self._lower_bound(force, objective),
            resolution=speed * np.where(settled, 0.0, creep),
            largest_balance_residual=largest_unbalanced_torque(scene, force, self.spin_axes),
            exhausted=not self.frustrated or all(sample.done for sample in self.samples),
            state=state if self.frustrated else None,
            slip=slip if self.frustrated else None,
            settled=settled,
            states_believed=np.array(
                [sample.resolved is not None and sample.resolved.borne for sample in self.samples]
            ),
            settles_more=settles_more,
            falls_to=self.settles_at if settles_more else np.inf,
            ended=np.array([sample.steps for sample in self.samples]),
        )

    def _spins(self) -> Pair:
        """Return the spins as sums of two doubles: a pair of arrays (C components, R samples, *N spheres), 1/time.
        Their signs alternate between neighbours, and they are measured from the bottom; those of driven planes are 0
        here.
        """
        high, low = np.zeros((2, len(self.samples), self.system.unknowns))
        for number, sample in enumerate(self.samples):
            high[number] = sample.iterate.spins if sample.resolved is None else sample.resolved.spins
            # contacts whose friction was reduced must not slip at all, or their whole friction would dissipate
            if sample.resolved is None and sample.firm is not None:
                tied = Contraction(self.system, self.shared.order, sample.firm)
                high[number] = tied.expanded(tied.contracted(exactly(high[number])))[0]
            if sample.resolved is not None and sample.resolved.rest is not None:
                low[number] = sample.resolved.rest
        found = np.zeros((2, len(self.spin_axes), len(high), *self.scene.lattice.shape))
        for whole, free in zip(found, multiply(self.scene.driving.unit, (high, low)), strict=True):
            place_free_spins(whole, slice(None), free)
        return found[0], found[1]

    def _lower_bound(self, force: np.ndarray, objective: np.ndarray) -> np.ndarray:
        """Return lower bounds (R samples,) on the objective, energy/time.

        The bound that follows quickly from the forces is returned for samples on their way, and for those that have
        ended with a gap that is small enough. Other ended samples get the bound with which answers are certified, which
        takes longer.

        force : (C components, R, E contacts), contact forces.
        objective : (R,), at the spins of now.
        """
        ended = np.array([sample.done or not self.frustrated for sample in self.samples])
        if not self.scene.law.is_rate_independent:
            return lower_bound(self.scene, force, self.spin_axes)
        if self.iteration == 0 and not ended.any():  # no forces yet
            return np.zeros(self.scene.replicas)
        quick = work_and_bound(self.scene, force, self.spin_axes)[1]
        rough = ended & ~(quick >= objective * (1 - LEAST_GAP))
        return np.where(rough, lower_bound(self.scene, force, self.spin_axes), quick) if rough.any() else quick
