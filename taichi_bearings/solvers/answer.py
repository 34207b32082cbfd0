"""What a solve amounts to: of the best state and the best forces, what is proven of both."""

from dataclasses import replace

import numpy as np

from taichi_bearings.lattice.grid import laboratory_forces
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.proof.certificate import Forces, certifying_forces, relative_gap, saturation
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
from taichi_bearings.scene import Progress, Scene, Solution, Status
from taichi_bearings.scene.scene import of_lattice, vector_length
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.without_slip import without_slip

ROUNDED_LIMIT = 1e-11  # share of its friction by which rounding leaves a slipping contact off its limit
MISSING_SLIP = 1e2  # of the jump, that a contact must slip for each share of its friction that it does not bear


def answered(
    scene: Scene, method: Method, final: Progress, forces: Forces, bound: np.ndarray, threshold: float | None
) -> tuple[Solution, Judgement | None]:
    """The answer, no contact states proven yet, and what judges it.

    forces : from which the bound follows. threshold : slip speed up to which a contact counts as slipless, or None for
    what the method can resolve.
    """
    if not method.options.is_dynamics:
        final = without_slip(scene, final)
        idle = scene.is_cut_off | (scene.jump == 0)
        forces = np.where(idle[:, None], 0.0, forces) if idle.any() else forces
    spin, spin_rounding = scene.laboratory_pair(final.staggered, final.rest, final.spin_axes)
    proof = certifying_forces(scene, forces, final.spin_axes, bound, final.objective - bound)
    friction = laboratory_forces(proof, scene.lattice, final.spin_axes)
    judgement = judged(scene, spin, spin_rounding, friction)
    slip = scene.slips(final.staggered, final.spin_axes) if final.slip is None else final.slip
    slip = slip if judgement is None else judgement.slip
    state, resolves, of_all = _told_apart(
        scene, slip, final, threshold, _known_at_once(judgement, method.options.is_dynamics), proof
    )
    own = {"slip_threshold": resolves} | ({} if final.ended is None else {"iterations": final.ended})
    per_contact = scene.law.power(scene.material, slip)
    objective, residual = final.objective, final.largest_balance_residual
    power = objective if scene.law.minimises == "power" else per_contact.sum(axis=1)
    if judgement is None:  # the bounds of a law that is not known to the proofs are the method's word
        bound = np.zeros_like(bound) if scene.law.is_sum else bound
        gap = relative_gap(scene, objective, bound)
    else:  # what the answer proves is what is reported
        power, objective, bound, gap = judgement.power, judgement.objective, judgement.lower_bound, judgement.gap
        residual = residual if method.options.is_dynamics else judgement.largest_torque
    answer = Solution(
        scene=scene,
        method=method.options.name,
        status=Status.STALLED,
        iterations=final.iteration,
        spin=spin,
        spin_rounding=spin_rounding,
        slip=slip,
        power_per_contact=per_contact,
        force=_acting(scene, method, final, slip) if method.options.is_dynamics else vector_length(proof),
        friction=friction,
        state=state,
        proven=state == ContactState.DRIVEN,
        power=power,
        objective=objective,
        lower_bound=bound,
        gap=gap,
        slip_threshold=of_all,
        own=own,
        largest_balance_residual=residual,
        findings=final.findings,
    )
    return answer, judgement


def with_forces_of(answer: Solution, other: Solution) -> Solution:
    """An answer to one sample with the friction of another one to it, if that proves more of it."""
    if not other.lower_bound[0] > answer.lower_bound[0]:
        return answer
    judgement = judged(of_lattice(answer.scene), answer.spin, answer.spin_rounding, other.friction)
    if judgement is None:
        return answer
    return replace(
        answer,
        friction=other.friction,
        force=other.force,
        proven=answer.state == ContactState.DRIVEN,
        largest_balance_residual=judgement.largest_torque,
        lower_bound=judgement.lower_bound,
        gap=judgement.gap,
    )


def _told_apart(
    scene: Scene,
    slip: np.ndarray,
    final: Progress,
    threshold: float | None,
    known: np.ndarray | None,
    proof: Forces,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Contact states, and slips up to which contacts count as slipless, (R,) and of all: as asked for, or else what can
    be resolved. Where more than the slip tells them apart, that is the largest slip of a slipless contact: others may
    slip slower.

    known : states that are proven contact by contact; of the others none slips by Coulomb's law whose friction in
    `proof` is off its limit.
    """
    if threshold is not None:
        state = _states(scene, slip, final, threshold, asked=True)
        return state, np.full(scene.replicas, threshold), threshold
    rounding = 1e-12 * scene.lattice.radius * scene.jump if final.slip is None else 0.0
    resolves = np.maximum(final.resolution, rounding) * np.ones(scene.replicas)
    state = _states(scene, slip, final, float(resolves.max()), asked=False)
    if known is not None:
        off = (state == ContactState.SLIPPING) & (saturation(scene, proof) < SATURATED) & (not scene.law.flows)
        state = np.where(off, ContactState.UNDECIDED, state)
        state = decided(state, known)[0]
    found = separate(scene, slip, state)
    largest, smallest = np.fmax(found.largest_slipless, 0.0), np.fmin(found.smallest_slipping, np.inf)
    each = np.where(smallest <= resolves, largest, np.maximum(resolves, largest))
    of_all = float(largest.max() if smallest.min() <= each.max() else each.max())
    return state, each, of_all


def _known_at_once(judgement: Judgement | None, is_dynamics: bool) -> np.ndarray | None:
    """What is proven of the states at every minimum, (R, E), where it is contact by contact.

    A dynamics has the states of its own motion; where the force grows with the slip these are the same, if proven.
    """
    if judgement is None or not (judgement.law.flows or (len(judgement.network.needed) < 2 and not is_dynamics)):
        return None
    return judgement.known


def _states(scene: Scene, slip: np.ndarray, final: Progress, threshold: float, asked: bool) -> np.ndarray:
    """Contact states by slip and friction, or as the method has established them; then slower ones count as slipless,
    and of faster ones none, only if a threshold was asked for."""
    if final.state is None:
        return classify(scene, slip, final.force, threshold)
    state = final.state
    if asked:
        slow = (state == ContactState.SLIPPING) & (slip <= threshold)
        fast = (state == ContactState.SLIPLESS) & (slip > threshold)
        state = np.where(slow, ContactState.SLIPLESS, np.where(fast, ContactState.UNDECIDED, state))
    return np.where(scene.idle, ContactState.DRIVEN, state).astype(np.uint8)


def _acting(scene: Scene, method: Method, final: Progress, slip: np.ndarray) -> np.ndarray:
    """Sizes (R, E) of the forces in a dynamics at this moment: where contacts hold its own, else those of the law.
    Friction alone is at its limit where the rounding of far stronger contacts says more."""
    if not scene.law.holds:
        return scene.law.force(scene.material, slip)
    most = np.inf if scene.law.flows else scene.strength * max(getattr(method.options, "static_ratio", 1.0), 1.0)
    absent = scene.coefficient == 0
    return np.where(
        absent, 0.0, np.minimum(vector_length(final.force), most * np.where(absent, 1.0, scene.coefficient))
    )


def judged(scene: Scene, spin: np.ndarray, spin_rounding: np.ndarray, friction: Forces) -> Judgement | None:
    """What the answer proves by itself, whatever the method believes; None for numbers that no arithmetic can judge."""
    judgement = Judgement(scene, spin, spin_rounding, friction)
    return judgement if judgement.can_be_judged else None


def named(
    answer: Solution, final: Progress, known: np.ndarray | None, has_ended: bool = False, is_present: bool = False
) -> Solution:
    """The answer with the states of its contacts, and which of them are proven.

    known : (R, E), the states that are proven of all minima, UNDECIDED where nothing is; None if nobody has asked.
    has_ended, is_present : as of :func:`taichi_bearings.proof.contact_state.decided`.
    """
    open_ = np.full(answer.state.shape, ContactState.UNDECIDED)
    known = open_ if known is None else known
    is_of_method = final.state is not None and answer.scene.law.is_rate_independent
    told = above_noise(answer, known) if is_of_method else answer.state
    state, proven = decided(told, known, is_present, has_ended)
    return replace(answer, state=state, proven=proven)


def above_noise(answer: Solution, known: np.ndarray) -> np.ndarray:
    """What slip and friction say of the contacts (R, E): those of which nothing is `known` are undecided where they
    seem to slip by less than the gap or what friction misses of its limit can resolve, or to rest while they bear all
    their friction; all of them where coefficients are too uneven for anything but a cut."""
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


def known_states(scene: Scene, final: Progress, judgement: Judgement | None, has_ended: bool) -> np.ndarray | None:
    """The states (R, E) that are proven of all minima; None where that is not asked.

    It is asked where the method believes that it has found them, where that is cheap, and, has_ended, of a motion that
    is proven to have come there.
    """
    one_component = scene.law.is_rate_independent and len(scene.minimum_spin_axes) == 1
    together = one_component or scene.law.flows or has_ended
    asked = (
        np.full(scene.replicas, together)
        if final.states_believed is None or together
        else np.array(final.states_believed)
    )
    if judgement is None or not asked.any():
        return None
    with one_thread():
        if asked.all():
            return judgement.known
        open_ = np.full(scene.coefficient.shape[1], ContactState.UNDECIDED)
        return np.stack([judgement.one(n).known[0] if asks else open_ for n, asks in enumerate(asked)])
