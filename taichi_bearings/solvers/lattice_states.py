"""What a method has reached on a lattice, and which states of its contacts that indicates and proves.

Shapes: R samples, E contacts, C carried spin components. The *jump* of a scene is the difference between the spins that
are imposed on its top and on its bottom, 1/time. A state is *proven* if it is that of the contact at every minimum.
"""

from dataclasses import replace

import numpy as np

from taichi_bearings.lattice.grid import laboratory_forces
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.certificate import certifying_forces, relative_gap, saturation
from taichi_bearings.proof.contact_state import (
    SATURATED,
    ContactState,
    classify,
    decided,
    separate,
    too_uneven,
    unresolved,
)
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene import Progress, Scene, Solution
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.answer import Indicated, Reached
from taichi_bearings.solvers.contacts import Ended

ROUNDED_LIMIT = 1e-11  # relative distance from the friction limit that rounding leaves on a slipping contact
MISSING_SLIP = 1e2  # a contact that misses its friction limit by a share x is trusted to slip only above 1e2 x R jump


class LatticeReached(Reached):
    """What a method has reached in all samples of a lattice.

    scene : the lattice with its R samples.
    final : the best state that it has reached, with the sizes of its forces (1, R, E) in place of the vectors.
    bound : (R samples,), the lower bound that the method knows.
    size : (1, R, E contacts), sizes of forces near those of the method that prove a bound by themselves.
    options : the method and its options.
    threshold : slip speed, length/time, up to which a contact counts as slipless; None for what the method can resolve.
    """

    scene: Scene

    def __init__(self, scene: Scene, ended: Ended) -> None:
        """Judge the spins and the forces of a run that ended. Samples of a minimisation whose least power is 0 get the
        state without slip, and no forces.

        scene : the lattice with its R samples.
        ended : how the run ended, with the best spins and forces it reached.
        """
        final, forces, self.options = ended.best, ended.proof, ended.options
        # samples whose least power is 0 (`idle`), whatever the method came to
        if not self.options.is_dynamics:
            final = without_slip(scene, final)
            idle = scene.is_cut_off | (scene.jump == 0)
            forces = np.where(idle[:, None], 0.0, forces) if idle.any() else forces
        self.scene, self.bound = scene, ended.bound
        self.final = replace(final, force=vector_length(final.force)[None])
        self.threshold = ended.slip_threshold
        # laboratory spins with their rounding; forces near those of the method that prove the bound, and their friction
        self.spin, self.spin_rounding = scene.laboratory_pair(final.staggered, final.rest, final.spin_axes)
        excess = final.objective - ended.bound
        are_asked = self.options.is_dynamics or final.state is not None or bool(self._asked.any())
        proof = certifying_forces(scene, forces, final.spin_axes, ended.bound, excess, are_asked)
        self.size, self.friction = vector_length(proof)[None], laboratory_forces(proof, scene.lattice, final.spin_axes)
        self.judgement = Judgement.of(scene, self.spin, self.spin_rounding, self.friction)
        self.method, self.iterations, self.findings = self.options.name, ended.iterations, final.findings

    def numbers(self) -> dict[str, np.ndarray]:
        """Return by name the slips (R samples, E contacts), and (R,) each power, objective, lower bound, gap and
        largest leftover torque.

        All of them are proven, with two exceptions. Where no proof can judge the numbers, as for a law that the proofs
        do not know, they are those of the method. The torques of a dynamics are always those of its motion.
        """
        scene, final = self.scene, self.final
        if self.judgement is not None:
            moves = {"largest_balance_residual": final.largest_balance_residual} if self.options.is_dynamics else {}
            return super().numbers() | moves
        slip = scene.slips(final.staggered, final.spin_axes) if final.slip is None else final.slip
        objective = power = final.objective
        if scene.law.minimises != "power":
            power = scene.law.power(scene.material, slip).sum(axis=1)
        bound = np.zeros_like(self.bound) if scene.law.is_sum else self.bound
        gap, residual = relative_gap(scene, objective, bound), final.largest_balance_residual
        return {
            "slip": slip, "power": power, "objective": objective, "lower_bound": bound, "gap": gap,
            "largest_balance_residual": residual,
        }  # fmt: skip

    def force(self, slip: np.ndarray) -> np.ndarray:
        """Return the sizes (R samples, E contacts) of the contact forces: those of a dynamics now, or those that prove
        the bound.

        slip : (R, E), slip speeds, length/time.
        """
        return self._of_motion(slip) if self.options.is_dynamics else self.size[0]

    def _of_motion(self, slip: np.ndarray) -> np.ndarray:
        """Return the sizes (R samples, E contacts) of the contact forces of a dynamics at its last moment.

        With friction they are the forces that the dynamics has stored; without, the law gives them from the slips.
        With friction alone a force is cut off at the limit of static friction, since more can only be rounding.

        slip : (R, E), slip speeds.
        """
        scene = self.scene
        if not scene.law.has_friction:
            return scene.law.force(scene.material, slip)
        ratio = max(getattr(self.options, "static_ratio", 1.0), 1.0)
        most = np.inf if scene.law.has_viscosity else scene.strength * ratio
        absent = scene.coefficient == 0
        limit = most * np.where(absent, 1.0, scene.coefficient)
        return np.where(absent, 0.0, np.minimum(self.final.force[0], limit))

    def indicated(self, slip: np.ndarray) -> Indicated:
        """Return the contact states before any is proven, from the method, slips and forces; the slip speed up to which
        contacts count as slipless, of all samples and of each; and the iterations of each sample, if known.

        slip : (R samples, E contacts), slip speeds, length/time.
        """
        known = _known_by_contact(self.judgement, self.options.is_dynamics)
        state, each, of_all = _states_and_thresholds(self.scene, slip, self.final, self.threshold, known, self.size)
        ended = self.final.ended
        return Indicated(state, of_all, {"slip_threshold": each} | ({} if ended is None else {"iterations": ended}))

    @property
    def _asked(self) -> np.ndarray:
        """(R samples,) mask of the samples in which a proof of the contact states is tried in any case. (In other
        samples of a dynamics it is tried if the motion has come to a minimum.)

        These are the samples whose method reports the states of every minimum, and all samples if the proof is cheap
        (one spin component, or viscosity).
        """
        scene, believed = self.scene, self.final.states_believed
        one_component = scene.law.is_rate_independent and len(scene.minimum_spin_axes) == 1
        is_cheap = one_component or scene.law.has_viscosity
        return np.full(scene.replicas, is_cheap) if believed is None or is_cheap else np.array(believed)

    def known(self, has_ended: bool) -> np.ndarray | None:
        """Return the states (R samples, E contacts) that are proven of all minima, UNDECIDED where nothing is; None if
        no proof is tried.

        A proof is tried in the samples `_asked`, and in all where a motion has come to a minimum.

        has_ended : True if a motion is proven to have come to a minimum.
        """
        scene, judgement, asked = self.scene, self.judgement, self._asked | has_ended
        if judgement is None or not asked.any():
            return None
        with one_thread():
            if asked.all():
                return judgement.known
            undecided = np.full(scene.coefficient.shape[1], ContactState.UNDECIDED)
            return np.stack([judgement.one(n).known[0] if asks else undecided for n, asks in enumerate(asked)])

    def observed(self, answer: Solution, known: np.ndarray | None) -> np.ndarray:
        """Return the contact states (R samples, E contacts) of the answer. Unproven states become UNDECIDED where slip
        and friction are too close to rounding to show whether the contact slips.

        Nothing is changed if the method has established no states, or if the law is not friction alone.

        answer : the answer with its states.
        known : (R, E), the states that are proven, UNDECIDED where nothing is; None if no proof was tried.
        """
        if self.final.state is None or not self.scene.law.is_rate_independent:
            return answer.state
        return above_noise(answer, np.full(answer.state.shape, ContactState.UNDECIDED) if known is None else known)


def _states_and_thresholds(
    scene: Scene,
    slip: np.ndarray,
    final: Progress,
    threshold: float | None,
    known: np.ndarray | None,
    size: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return contact states (R samples, E contacts); the slip threshold of each sample, (R,), the speed, length/time,
    up to which its contacts count as slipless; and one threshold for all samples.

    Without a threshold of the user, states in `known` are taken, if it is given. With friction alone, another contact
    is then undecided if it seems to slip but its force in `size` is below its friction limit. From these states
    follows the threshold: the largest slip of a slipless contact, or what the method can resolve if that is larger and
    no slipping contact is slower.

    scene : the lattice with its R samples.
    slip : (R, E), slip speeds, length/time.
    final : the best state that the method has reached.
    threshold : the slip speed that the user asked for, or None for what can be resolved.
    known : (R, E), states that are proven contact by contact, or None.
    size : (1, R, E), sizes of the forces that prove the lower bound.
    """
    if threshold is not None:
        state = _states(scene, slip, final, threshold, asked=True)
        return state, np.full(scene.replicas, threshold), threshold
    # slips computed from rounded spins: smaller ones than this share of the imposed slip are rounding
    rounding = 1e-12 * scene.lattice.radius * scene.jump if final.slip is None else 0.0
    resolves = np.maximum(final.resolution, rounding) * np.ones(scene.replicas)
    state = _states(scene, slip, final, float(resolves.max()), asked=False)
    if known is not None:
        off = (state == ContactState.SLIPPING) & (saturation(scene, size) < SATURATED) & (not scene.law.has_viscosity)
        state = np.where(off, ContactState.UNDECIDED, state)
        state = decided(state, known)[0]
    found = separate(scene, slip, state)
    largest, smallest = np.fmax(found.largest_slipless, 0.0), np.fmin(found.smallest_slipping, np.inf)
    each = np.where(smallest <= resolves, largest, np.maximum(resolves, largest))
    of_all = float(largest.max() if smallest.min() <= each.max() else each.max())
    return state, each, of_all


def _known_by_contact(judgement: Judgement | None, is_dynamics: bool) -> np.ndarray | None:
    """Return the contact states (R samples, E contacts) that are proven of every minimum, if there is a cheap proof
    that treats each contact by itself; else None.

    There is such a proof for laws whose force grows with the slip, and for minima with one spin component. A dynamics
    without viscosity gets None, as its states are those of its motion, not of the minima.

    judgement : what is proven of the answer, or None.
    is_dynamics : True if the method is a dynamics.
    """
    if judgement is None or not (
        judgement.law.has_viscosity or (len(judgement.network.needed) < 2 and not is_dynamics)
    ):
        return None
    return judgement.known


def _states(scene: Scene, slip: np.ndarray, final: Progress, threshold: float, asked: bool) -> np.ndarray:
    """Return contact states (R samples, E contacts): those that the method has established, or, if it has none, those
    that slip and friction give.

    scene : the lattice with its R samples.
    slip : (R, E), slip speeds, length/time.
    final : the best state that the method has reached.
    threshold : slip speed up to which a contact counts as slipless, length/time.
    asked : True if the user gave it. Then a slipping contact that is slower becomes slipless, and a slipless one that
        is faster becomes undecided.
    """
    if final.state is None:
        return classify(scene, slip, final.force, threshold)
    state = final.state
    if asked:
        slow = (state == ContactState.SLIPPING) & (slip <= threshold)
        fast = (state == ContactState.SLIPLESS) & (slip > threshold)
        state = np.where(slow, ContactState.SLIPLESS, np.where(fast, ContactState.UNDECIDED, state))
    return np.where(scene.idle, ContactState.DRIVEN, state).astype(np.uint8)


def above_noise(answer: Solution, known: np.ndarray) -> np.ndarray:
    """Return the contact states (R samples, E contacts) of an answer, UNDECIDED where slip and friction are too small
    to tell them.

    known : (R, E), the states that are proven; a contact that has one keeps its state.

    Another contact becomes undecided in one of these cases:

    * it seems to slip, but the gap between power and lower bound could explain its slip;
    * it seems to slip, but its friction is further from the limit than its slip allows (MISSING_SLIP);
    * it seems slipless, but bears all the friction that it can;
    * the coefficients of its sample are too uneven for floating-point numbers, and no exact cut has solved it.
    """
    scene, slips = answer.scene, answer.state == ContactState.SLIPPING
    limit = scene.strength * scene.coefficient
    missing = limit - answer.force - ROUNDED_LIMIT * limit
    faint = MISSING_SLIP * missing * scene.slip_radius * scene.jump > answer.slip * limit
    doubtful = slips & (unresolved(answer) | faint)
    doubtful |= (answer.state == ContactState.SLIPLESS) & (answer.force >= SATURATED * limit)
    if "cut_is_unique" not in answer.findings:  # cuts are exact, whatever the contrast
        doubtful |= too_uneven(answer)[:, None] & (answer.state != ContactState.DRIVEN)
    doubtful &= known == ContactState.UNDECIDED
    return np.where(doubtful, ContactState.UNDECIDED, answer.state).astype(np.uint8)


def without_slip(scene: Scene, final: Progress) -> Progress:
    """Return the end of a minimisation, with the slipless state put in for every sample whose least objective is 0.
    Other samples are not changed.

    The least objective is 0 in a sample whose driven planes have the same spins, or are not joined by contacts. In the
    slipless state no contact bears a force. Spheres that contacts join to the top plane have the spin of the top, all
    others that of the bottom.

    scene : the lattice.
    final : the progress that the method has reached at its end.
    """
    idle = np.flatnonzero(scene.is_cut_off | (scene.jump == 0))
    if not len(idle):
        return final
    staggered, axes = final.staggered.copy(), final.spin_axes
    top = scene.top_spin(axes)[..., None]  # (C, *plane, 1), of component k the same all along its layer x_k
    for replica in idle:
        # a contact couples only the spin components across its normal, so that each component has a graph of its own
        for slot, couples in enumerate(scene.lattice.tangential_mask(axes)):
            with_top = _joined_to_top(scene, couples & (scene.acting_coefficient[replica] > 0))
            staggered[slot, replica] = np.where(with_top, top[slot], 0.0)
    some = np.isin(np.arange(scene.replicas), idle)
    rest, slip = final.rest, final.slip
    if rest is not None:
        rest = np.where(some.reshape(1, -1, *(1,) * scene.lattice.dimension), 0.0, rest)
    if slip is not None:
        slip = np.where(some[:, None], 0.0, slip)
    force = np.where(some[:, None], 0.0, final.force)
    return replace(final, staggered=staggered, rest=rest, force=force, slip=slip)


def _joined_to_top(scene: Scene, contacts: np.ndarray) -> np.ndarray:
    """Return the mask (*N,) of the top plane and of all spheres that contacts join to it, *N the shape of the lattice.

    scene : the lattice, with *N its shape.
    contacts : (E contacts,), mask of the contacts that join.
    """
    sites = scene.lattice.sites
    sphere = np.arange(sites).reshape(scene.lattice.shape)
    sphere[..., -1] = sites - 1
    label = pieces(sites, *sphere.ravel()[scene.lattice.ends][:, contacts])
    return np.asarray(label[sphere] == label[sites - 1])
