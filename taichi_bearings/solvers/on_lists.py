"""The contacts of any packing as methods step them: in lists, with bounds that are proven by exact arithmetic.

Letters: T unit tangents of a contact, d their number (1 for discs, 2 for spheres), R = 1 sample, N spheres, E contacts
that take part, C components of a spin. The unknowns are u = R omega, radius times spin, with the radius R.
"""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings.conic.proximal import OfNetwork, Unknowns
from taichi_bearings.fields import Fields, team_size
from taichi_bearings.fields.lists import COPY_NUMBERS, Lists, ListSpec
from taichi_bearings.kernels.contact_list import CundallStrackLists, DescentLists
from taichi_bearings.kernels.team import Sweeps, Team, made_once
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.proof.certificate import Forces
from taichi_bearings.proof.contact_state import classify
from taichi_bearings.scene import Progress, Solution
from taichi_bearings.scene.packing import Packing
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.scene.solution import SLIPLESS, SLIPPING, UNDECIDED
from taichi_bearings.solvers.answer import answered
from taichi_bearings.solvers.contacts import Ended, Inertia, Launch, Stepped
from taichi_bearings.solvers.packing_bounds import PackingBounds
from taichi_bearings.solvers.packing_states import PackingReached
from taichi_bearings.solvers.part import Found

if TYPE_CHECKING:
    from taichi_bearings.solvers.table import Motion

NOTHING = (0.0,)  # passed for constants that all copies of the lists share, as there are none


class OnLists(Stepped):
    """The contacts of one sample of a packing for methods that make steps, as flat lists of spheres and contacts on
    which kernels work. A field is an array on the device with some numbers for each sphere, or for each contact.

    The field `force` holds the force on each contact as a vector; other fields of contacts hold components along its
    unit tangents.

    scene : the packing, with only the contacts that can dissipate.
    spin_axes : numbers of the axes of the C spin components that are computed.
    spec : the fields of spheres, and those of contacts: two tuples of pairs (name, how many numbers each sphere or
        contact has in it).
    points : names of the fields that hold the spins which a gradient descent changes.
    forces : names of the fields that hold the contact forces of a gradient descent.
    bounds : the lower bounds on the objective that are proven so far.
    lists : the order of spheres and contacts in memory, once `allocate` was called.
    fields : the arrays on the device, once `allocate` was called. If several samples are stepped together, they are
        parts of common arrays.
    """

    scene: Packing
    spec: ListSpec
    points, forces = ("point",), ("force",)

    def __init__(self, packing: Packing, spin: np.ndarray) -> None:
        """Take a packing of one sample, and find out whether it has a state without slip.

        packing : the packing.
        spin : (1, N spheres, 3), of discs (1, N), spins to start from, 1/time.
        """
        self.spin_axes = packing.minimum_spin_axes
        with one_thread():
            self.bounds = PackingBounds(packing)
            staggered = packing.staggered_spin(spin, self.spin_axes)
            self.scene = packing.as_stepped(staggered, self.bounds.is_at_rest())

    @property
    def across(self) -> np.ndarray:
        """(d tangents, E contacts, C), the unit tangents T of the contacts: d of them, 1 for discs and 2 for spheres,
        with C components each.
        """
        return self.scene.network.tangents

    def field_spec(self, spheres: dict[str, int], contacts: list[str]) -> ListSpec:
        """Return the fields that a method needs, as two tuples, of spheres and of contacts, of pairs (name, how many
        numbers each sphere or contact has in the field).

        spheres : how many numbers each sphere has, by the name of the field.
        contacts : names of the method's fields on contacts; those of the law and the tangents are added.
        """
        tangents, _, components = self.across.shape
        counts: dict[str, int] = {"force": components, "coefficient": 1, "viscosity": 1, "work": 1}
        counts["across"] = 6 if components == 3 else 0
        names = (*contacts, *self.of_law, "across")
        return tuple(spheres.items()), tuple((name, counts.get(name, int(tangents))) for name in names)

    def allocate(self, spec: Any, viscosity: np.ndarray | None) -> None:
        """Allocate the fields (arrays on the device, all 0), and load the unit tangents and the coefficients of the law
        into them. Tangents are loaded for spheres only, two vectors of 3 components for each contact.

        spec : the fields of spheres, and those of contacts: two tuples of pairs (name, how many numbers each sphere or
            contact has in it).
        viscosity : (1, E contacts), viscosity of each contact beside its friction, times the radius, by which kernels
            multiply a spin difference; for gradient descent also divided by the unit of the friction coefficients. None
            for laws without.
        """
        network = self.scene.network
        self._numbers = np.zeros(COPY_NUMBERS)  # the constants of the launch, as last written into the field `numbers`
        self.lists = Lists.of(network.spheres, network.contact.T)
        self.spec, self.fields = spec, Fields(self.lists, spec)
        if network.components == 3:
            self.fields.load("across", self.across.transpose(0, 2, 1).reshape(6, 1, -1))
        self.fields.load("coefficient", self.scene.acting_coefficient[None])
        if viscosity is not None:
            self.fields.load("viscosity", viscosity[None])

    def _sweeps(self, kind: Callable[..., Sweeps], corrector: tuple[float, ...]) -> tuple[Team, Sweeps]:
        """Return the threads that run a kernel, and the kernel, which is compiled once for all samples with the same
        fields.

        kind : class of the kernel.
        corrector : coefficients of Gear's corrector; empty for gradient descent.
        """
        return team_of(self.fields, self.spec), made_once(kind, self.spec, self.scene.law.name, corrector)

    def spring_kernel(self, corrector: tuple[float, ...]) -> tuple[Team, Sweeps]:
        """Return the threads and the kernel for the dynamics of Cundall and Strack.

        corrector : coefficients of Gear's corrector, that of the spin itself first.
        """
        return self._sweeps(CundallStrackLists, corrector)

    def descent_kernel(self) -> tuple[Team, Sweeps]:
        """Return the threads and the kernel for gradient descent."""
        return self._sweeps(DescentLists, ())

    def run(self, team: Team, sweeps: Sweeps, launch: Launch) -> None:
        """Call a kernel several times with the same constants.

        team : the threads that run it.
        sweeps : the kernel.
        launch : how often (`calls`) and with which constants (`numbers`).
        """
        self.load_numbers(launch)
        sweeps.run(self.fields, team, launch.calls, NOTHING)

    def load_numbers(self, launch: Launch) -> None:
        """Load the constants of a launch (repeated calls of the kernel) into the field `numbers`, unless they are there
        already. The last constant is the number of sweeps before this launch; a call of the kernel makes two sweeps.

        launch : the launch, with its constants and the number of calls before it.
        """
        given = np.zeros(COPY_NUMBERS)
        given[: len(launch.numbers)] = launch.numbers
        given[-1] = 2 * launch.first  # in sweeps, which come in pairs
        if not np.array_equal(given, self._numbers):
            self.fields.load("numbers", given[:, None])
            self._numbers = given

    def read_forces(self, name: str) -> np.ndarray:
        """Return the forces (or elongations of springs) of the contacts along their tangents, (d tangents, 1, E
        contacts).

        name : name of the field that holds them; in the field `force` they are vectors, which are projected.
        """
        found = self.fields.read(name)
        return np.einsum("kre,tek->tre", found, self.across) if name == "force" else found

    def load_force(self, force: np.ndarray) -> None:
        """Write contact forces along the tangents, (d tangents, 1, E contacts), into the field `force`, as vectors."""
        self.fields.load("force", np.einsum("tre,tek->kre", force, self.across))

    def weights(self, bounds: np.ndarray) -> np.ndarray:
        """Return upper bounds (C components, 1, N spheres) on the curvature of the objective along each spin component
        of each sphere.

        The curvature at a sphere is a matrix: the sum of b_e T^T T over its contacts e. T (tangents, C) is the matrix
        that gives the slip of the contact from the spin of one end. The sums of the absolute entries of its rows, as a
        diagonal matrix, are an upper bound.

        bounds : (1, E contacts), upper bounds b_e on the second derivative of what contact e adds to the objective by
            its slip.
        """
        network = self.scene.network
        rows = np.abs(np.einsum("tek,tel->ekl", self.across, self.across)).sum(axis=2) * bounds[0][:, None]
        total = np.zeros((network.spheres, network.components))
        for end in network.contact:
            np.add.at(total, end, rows)
        found: np.ndarray = total.T[:, None]
        return found

    def inertias(self, options: "Motion", density: ArrayLike | None) -> np.ndarray:
        """Return the moments of inertia of the spheres over the squares of their radii, (N spheres,), mass.

        options : options of a method, with `mass` and `inertia`.
        density : density of the spheres, mass / length^D in D dimensions, one number or (N,), from which their masses
            follow; None to use the mass in the options.
        """
        return self.scene.inertias(options.mass, options.inertia, density)

    def common_inertia(self, inertia: Inertia) -> float:
        """Return 1.0, the reference moment of inertia in the constants of the kernel. In a packing each sphere has its
        own, which the field `is_free` holds as 1 over it.

        inertia : not used.
        """
        return 1.0

    def fastest_modes(self, inertia: Inertia, slopes: np.ndarray | None) -> tuple[float, float]:
        """Return two upper bounds on how fast spins can change: the decay rate by viscosity, 1/time, 0 without
        viscosity; and the largest eigenvalue of M^-1 L if all contacts stick, 1/mass, from which the shortest period of
        springs follows.

        L is the Laplacian of the contact network, M the diagonal matrix of the inertias. For the decay rate the
        contacts have their slopes as weights in L, for the second number 1. Both are rigorous, by the theorem of
        Collatz and Wielandt on matrices without negative entries.

        inertia : (N spheres,), moments of inertia over squared radii, mass.
        slopes : (1, E contacts), viscosity of each contact, force * time/length; None for friction alone.
        """
        network, each = self.scene.network, np.asarray(inertia)
        decay = 0.0 if slopes is None else network.largest_eigenvalue(slopes[0], each)
        return decay, network.largest_eigenvalue(np.ones(network.contacts), each)

    def unknowns(self, spin_axes: tuple[int, ...], unit: float, inertia: Inertia) -> Unknowns:
        """Return the unknowns of an implicit step: the components of u = radius * spin of the free spheres, as far as
        they make some contact slip.

        spin_axes : not used, as all components of a packing move.
        unit : unit of u in the solve, length/time.
        inertia : (N spheres,), moments of inertia over squared radii, mass.
        """
        return OfNetwork(self.scene, unit, np.asarray(inertia))

    @property
    def has_no_bound(self) -> bool:
        """True if no positive lower bound on the objective is proven yet."""
        return not self.bounds.proven > 0

    def best_bound(self, bound: np.ndarray) -> np.ndarray:
        """Return the larger of the lower bound `bound` (1,) and the best one that was proven before, energy/time."""
        found: np.ndarray = np.maximum(bound, self.bounds.proven)
        return found

    def proven_by(self, force: Forces) -> np.ndarray:
        """Return the lower bound (1,) on the objective that the contact forces of a checkpoint prove.

        force : (d tangents, 1, E contacts), contact forces.
        """
        with one_thread():
            return np.array([self.bounds.again(force)])

    def judged(self, staggered: np.ndarray, force: Forces, proof: Forces | None, **more: Any) -> Progress:
        """Return the progress of a method with given spins and forces: their objective, lower bound, and largest torque
        left.

        The bound that costs a factorisation is computed only if the iterations have grown by a factor `look_again`
        since the last one; otherwise a cheaper one.

        staggered : (C components, 1, N spheres), the unknowns u = radius * spin, length/time.
        force : (d tangents, 1, E contacts), contact forces at these spins.
        proof : (d, 1, E), forces from which the lower bound is computed; None for `force`.
        more : further fields of :class:`Progress`, by name; `iteration` among them.
        """
        scene, bounds, axes = self.scene, self.bounds, self.spin_axes
        objective = scene.objective(staggered, axes)
        is_recent = bounds.looked < more["iteration"] < self.look_again * bounds.looked
        bounds.looked = bounds.looked if is_recent else more["iteration"]
        with one_thread():
            bound, proof = bounds.of(force if proof is None else proof, staggered, factorises=not is_recent)
        bound = min(bound, float(objective[0]))
        bounds.take(bound, staggered)
        return Progress(
            staggered=staggered, spin_axes=axes, force=force, objective=objective, proof=proof,
            lower_bound=np.array([bound]), largest_balance_residual=scene.torques_left(force, axes), **more,
        )  # fmt: skip

    def state(self) -> dict[str, np.ndarray]:
        """Return by name what a checkpoint needs of the bounds: the best one, the spins with which it was proven, and
        the iteration at which a factorisation was last made for one.
        """
        bounds = self.bounds
        return {
            "bounds.proven": np.array(bounds.proven),
            "bounds.witness": np.array(bounds.witness),
            "bounds.looked": np.array(bounds.looked),
        }

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the arrays by name that `state` returned in an earlier call."""
        bounds = self.bounds
        bounds.proven, bounds.looked = float(state["bounds.proven"]), int(state["bounds.looked"])
        bounds.witness = np.array(state["bounds.witness"])

    def answered(self, ended: Ended) -> Solution:
        """Return the answer of a run that ended, from its best spins and forces. Nothing ends the proof of its contact
        states early.

        ended : how the run ended, with the last state and the best forces.
        """
        with one_thread():
            return answered(StepsReached(self.bounds, self.scene, ended), ended, nullcontext)


class StepsReached(PackingReached):
    """What a method that makes steps has reached in the one sample of a packing: the best forces, with the best spins.

    The answer has what is proven of the minima, as with other methods. Four things are those of the last state instead:
    the contact forces of a dynamics, its contact states (slipping or not), its leftover torques, and the states of
    contacts in parts of the packing that nothing drives.

    moves : True for a dynamics.
    spin_axes : numbers of the axes of the spin components.
    acting : (E contacts,), numbers of the contacts that can dissipate, for which the method has forces.
    of_acting : the packing with these contacts alone.
    last : the last state.
    """

    def __init__(self, bounds: PackingBounds, of_acting: Packing, ended: Ended) -> None:
        """Judge the spins and the forces of a run that ended.

        bounds : lower bounds that were proven on the way.
        of_acting : the packing without the contacts that take no part.
        ended : how the run ended, with the last state and the best forces.
        """
        last, system, moves = ended.best, bounds.system, ended.options.is_dynamics
        value, forces = bounds.of(last.force if last.proof is None else last.proof, last.staggered, factorises=True)
        proof = forces if value > ended.bound[0] else ended.proof
        still, spins = np.zeros(system.unknowns), last.staggered[:, 0].T
        found = Found(still, proof[:, 0, bounds.of_system], ended.options.name, everywhere=spins)
        super().__init__(system, [bounds.packing], [found], moves)
        self.of_acting = of_acting
        self.acting, self.last, self.iterations = bounds.acting, last, ended.iterations
        self.moves, self.spin_axes = moves, bounds.packing.minimum_spin_axes

    def numbers(self) -> dict[str, np.ndarray]:
        """Return the numbers of the answer by name, as they are proven; but the torques of a dynamics, force * length,
        are always those of its motion.
        """
        if not self.moves:
            return super().numbers()
        left = self.of_acting.torques_left(self.last.force, self.spin_axes)
        return super().numbers() | {"largest_balance_residual": left}

    def force(self, slip: np.ndarray) -> np.ndarray:
        """Return the sizes (1, E contacts) of the contact forces: of a dynamics those of the last state, else those
        that prove the lower bound.

        slip : not used.
        """
        force = super().force(slip)
        if self.moves:
            force[:, self.acting] = vector_length(self.last.force)
        return force

    def observed(self, answer: Solution, known: np.ndarray | None) -> np.ndarray:
        """Return the states (1, E contacts) that slips and forces of the last state show.

        With friction, a contact slips if it is faster than the method can resolve and its force is at the limit.
        Without friction, contacts in parts of the packing that nothing drives are judged by their speed alone; and a
        contact is undecided if the gap between power and bound allows that it does not slip at the minimum.

        answer : the answer so far.
        known : (1, E), the states that are proven, or None.
        """
        seen, slip, acting, scene = super().observed(answer, known), answer.slip[0], self.acting, self.scene
        loose = np.setdiff1d(acting, self.system.numbers)
        seen[0, loose] = np.where(slip[loose] > self.last.resolution, SLIPPING, SLIPLESS)
        if scene.law.has_friction:
            now = answer.slip[:, acting], self.last.force, float(np.max(self.last.resolution))
            seen[:, acting] = classify(self.of_acting, *now)
        else:
            # sum eta |slip - slip at the minimum|^2 is at most power minus bound: smaller slips may be none
            left = max(answer.objective[0] - answer.lower_bound[0], 0.0)
            apart = np.sqrt(left / self.of_acting.acting_coefficient[0])
            seen[0, acting[slip[acting] <= apart]] = UNDECIDED
        return seen


def team_of(fields: Fields, spec: ListSpec) -> Team:
    """Return the threads for sweeps over some fields, as many as make them faster.

    spec : two tuples, for spheres and for contacts, of pairs (name of a field, its numbers for each of them).
    """
    return Team(team_size(fields.layout, sum(count for _, count in spec[0])))
