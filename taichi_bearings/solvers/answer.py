"""The answer of a solve: the best spins and the best forces that a method reached, and what is proven of both.

Shapes: R samples, E contacts, C carried spin components. The *jump* of a scene is the difference between the spins that
are imposed on its top and on its bottom, 1/time. A state is *proven* if it is that of the contact at every minimum.
"""

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
from taichi_bearings.scene import Bearing, Progress, Scene, Solution, Status
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.without_slip import without_slip

ROUNDED_LIMIT = 1e-11  # relative distance from the friction limit that rounding leaves on a slipping contact
MISSING_SLIP = 1e2  # a contact that misses its friction limit by a share x is trusted to slip only above 1e2 x R jump


def answered(
    scene: Scene, method: Method, final: Progress, forces: Forces, bound: np.ndarray, threshold: float | None
) -> tuple[Solution, Judgement | None]:
    """Return the answer to a lattice, with no contact state proven yet, and what is proven of its spins and forces:
    None where no arithmetic can judge the numbers.

    final : the best state that the method has reached.
    forces : (C components, R samples, E contacts), contact forces from which the lower bound follows.
    bound : (R,), that lower bound.
    threshold : slip speed, length/time, up to which a contact counts as slipless; None for what the method can resolve.
    """
    # a sample whose least power is 0 gets the state without slip, whatever the method came to
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
    state, resolves, of_all = _states_and_thresholds(
        scene, slip, final, threshold, _known_by_contact(judgement, method.options.is_dynamics), proof
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
    """Return `answer`, with the friction of `other` if that proves a greater lower bound; both answer the same sample.

    Spins and states stay; bound, gap and leftover torque are computed anew from the friction that was taken.
    """
    if not other.lower_bound[0] > answer.lower_bound[0]:
        return answer
    judgement = judged(answer.scene, answer.spin, answer.spin_rounding, other.friction)
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


def _states_and_thresholds(
    scene: Scene,
    slip: np.ndarray,
    final: Progress,
    threshold: float | None,
    known: np.ndarray | None,
    proof: Forces,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return contact states (R samples, E contacts), and the slip speeds up to which contacts count as slipless: (R,),
    and one for all samples.

    Without a threshold, a contact that seems to slip while its friction in `proof` is below its limit is undecided,
    unless `known` has its state. If some slipping contact is slower than what the slip alone resolves, the friction has
    told it apart; the speed that is returned then is the largest slip of a slipless contact.

    slip : (R, E), slip speeds, length/time.
    final : the best state that the method has reached.
    threshold : the slip speed that the user asked for, or None for what can be resolved.
    known : (R, E), states that are proven contact by contact, or None.
    proof : (C components, R, E), forces that prove the lower bound.
    """
    if threshold is not None:
        state = _states(scene, slip, final, threshold, asked=True)
        return state, np.full(scene.replicas, threshold), threshold
    # slips computed from rounded spins: smaller ones than this share of the imposed slip are rounding
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


def _known_by_contact(judgement: Judgement | None, is_dynamics: bool) -> np.ndarray | None:
    """Return the states (R samples, E contacts) that are proven of every minimum where a proof looks at each contact
    alone; else None.

    That is so where the force grows with the slip, and for minima with one spin component. A dynamics without viscosity
    gets None, as its states are those of its motion, not of the minima.

    judgement : what is proven of the answer, or None.
    is_dynamics : True if the method is a dynamics.
    """
    if judgement is None or not (judgement.law.flows or (len(judgement.network.needed) < 2 and not is_dynamics)):
        return None
    return judgement.known


def _states(scene: Scene, slip: np.ndarray, final: Progress, threshold: float, asked: bool) -> np.ndarray:
    """Return contact states (R samples, E contacts): those that the method has established, or else those that slip and
    friction give.

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


def _acting(scene: Scene, method: Method, final: Progress, slip: np.ndarray) -> np.ndarray:
    """Return the sizes (R samples, E contacts) of the contact forces of a dynamics at its last moment.

    Where contacts can hold a force without slip, the dynamics knows it; else the law gives it from the slip. Without
    viscosity a force is cut off at the friction limit, beyond which only the rounding of far stronger contacts can lift
    it.

    final : the last state.
    slip : (R, E), slip speeds, length/time.
    """
    if not scene.law.holds:
        return scene.law.force(scene.material, slip)
    most = np.inf if scene.law.flows else scene.strength * max(getattr(method.options, "static_ratio", 1.0), 1.0)
    absent = scene.coefficient == 0
    return np.where(
        absent, 0.0, np.minimum(vector_length(final.force), most * np.where(absent, 1.0, scene.coefficient))
    )


def judged(scene: Bearing, spin: np.ndarray, spin_rounding: np.ndarray, friction: Forces) -> Judgement | None:
    """Return what spins and friction prove by themselves, whatever the method believes; None for numbers that no
    arithmetic can judge.

    spin, spin_rounding : laboratory spins, and what rounding leaves out of them; (R samples, *N spheres, 3), of discs
        (R, *N), 1/time.
    friction : force on each contact, in the laboratory.
    """
    judgement = Judgement(scene, spin, spin_rounding, friction)
    return judgement if judgement.can_be_judged else None


def named(
    answer: Solution, final: Progress, known: np.ndarray | None, has_ended: bool = False, is_present: bool = False
) -> Solution:
    """Return the answer with the final states of its contacts, and which of them are proven.

    final : the best state that the method has reached.
    known : (R samples, E contacts), the states that are proven of all minima, UNDECIDED where nothing is; None if no
        proof was tried.
    has_ended : True if a motion is proven to have come to a minimum.
    is_present : True if the states are those of the motion now, or follow from a threshold of slip; False if they are
        those of the minima.
    """
    undecided = np.full(answer.state.shape, ContactState.UNDECIDED)
    known = undecided if known is None else known
    is_of_method = final.state is not None and answer.scene.law.is_rate_independent
    observed = above_noise(answer, known) if is_of_method else answer.state
    state, proven = decided(observed, known, is_present, has_ended)
    return replace(answer, state=state, proven=proven)


def above_noise(answer: Solution, known: np.ndarray) -> np.ndarray:
    """Return the states (R samples, E contacts) of an answer with UNDECIDED where slip and friction are too small to
    tell them.

    known : (R, E), the states that are proven; a contact that has one keeps its state.

    Another contact becomes undecided

    * if it seems to slip, but the gap between power and lower bound could explain its slip, or its friction is off the
      limit by more than its slip allows (MISSING_SLIP);
    * if it seems slipless, but bears all the friction that it can;
    * in samples whose coefficients are too uneven for floating-point numbers, unless an exact cut has solved them.
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


def known_states(scene: Scene, final: Progress, judgement: Judgement | None, has_ended: bool) -> np.ndarray | None:
    """Return the states (R samples, E contacts) that are proven of all minima, UNDECIDED where nothing is; None if no
    proof is tried.

    A proof is tried in samples where the method believes to have found these states, and in all samples where the proof
    is cheap (one spin component, or viscosity) or where a motion has come to a minimum.

    final : the best state that the method has reached.
    judgement : what is proven of its spins and forces, or None.
    has_ended : True if a motion is proven to have come to a minimum.
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
        undecided = np.full(scene.coefficient.shape[1], ContactState.UNDECIDED)
        return np.stack([judgement.one(n).known[0] if asks else undecided for n, asks in enumerate(asked)])
