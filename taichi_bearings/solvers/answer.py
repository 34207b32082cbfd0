"""What a solve amounts to: of the best state and the best forces, what the verifier proves of both."""

from dataclasses import replace

import numpy as np

from taichi_bearings.lattice.grid import laboratory_forces
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.proof.certificate import Forces, certifying_forces, relative_gap
from taichi_bearings.proof.contact_state import ContactState, classify, separate, unresolved
from taichi_bearings.scene import Progress, Scene, Solution, Status
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.method import Method, is_dynamics
from taichi_bearings.verifier.judgement import Judgement
from taichi_bearings.verifier.samples import LAWS, Samples
from taichi_bearings.verifier.states import SLIPPING


def answered(
    scene: Scene, method: Method, final: Progress, forces: Forces, bound: np.ndarray, threshold: float | None
) -> tuple[Solution, Judgement | None]:
    """The answer, no contact states proven yet, and what judges it.

    forces : from which the bound follows. threshold : slip speed up to which a contact counts as slipless, or None for
    what the method can resolve.
    """
    spin, spin_rounding = scene.laboratory_pair(final.staggered, final.rest, final.spin_axes)
    proof = certifying_forces(scene, forces, final.spin_axes, bound)
    friction = laboratory_forces(proof, scene.lattice, final.spin_axes)
    judgement = _judged(scene, spin, spin_rounding, friction)
    slip = _slips(scene, final) if judgement is None else judgement.slip
    state, resolves = _told_apart(scene, slip, final, threshold)
    own = {"slip_threshold": resolves} | ({} if final.ended is None else {"iterations": final.ended})
    per_contact = tuple(scene.power_of(values, axis) for axis, values in enumerate(slip))
    objective, residual = final.objective, final.unbalanced_torque
    power = objective if scene.law.minimises == "power" else scene.total(per_contact)
    if judgement is None:  # the bounds of a law that is not known to the verifier are the method's word
        bound = np.zeros_like(bound) if scene.law.name in LAWS else bound
    else:  # what the answer proves is what is reported
        power, objective, bound = judgement.power, judgement.objective, judgement.lower_bound
        residual = residual if is_dynamics(method) else judgement.largest_torque
        if scene.law.flows and scene.law.holds and threshold is None:  # unique slips, some of them proven
            state = _with_proven_slips(state, judgement)
    answer = Solution(
        scene=scene,
        method=method.options.name,
        status=Status.STALLED,
        iterations=final.iteration,
        spin=spin,
        spin_rounding=spin_rounding,
        slip=slip,
        power_per_contact=per_contact,
        force=_acting(scene, final, slip) if is_dynamics(method) else _sizes(proof),
        friction=friction,
        state=state,
        slip_bound=() if judgement is None else judgement.slip_bound,
        resolved=np.zeros(scene.replicas, dtype=bool),
        power=power,
        objective=objective,
        lower_bound=bound,
        gap=relative_gap(scene, objective, bound),
        slip_threshold=float(resolves.max()),
        own=own,
        unbalanced_torque=residual,
        seconds=0.0,
        seconds_compile=0.0,
        history={},
        findings=final.findings,
    )
    return answer, judgement


def with_forces_of(answer: Solution, other: Solution) -> Solution:
    """An answer with the friction of another one to its scene in replicas where that proves more of it."""
    scene, more = answer.scene, other.lower_bound > answer.lower_bound

    def picked(new: Forces, old: Forces) -> Forces:
        return tuple(np.where(more.reshape(-1, *(1,) * (b.ndim - 1)), a, b) for a, b in zip(new, old, strict=True))

    friction = picked(other.friction, answer.friction)
    judgement = _judged(scene, answer.spin, answer.spin_rounding, friction) if more.any() else None
    if judgement is None:
        return answer
    return replace(
        answer,
        friction=friction,
        force=picked(other.force, answer.force),
        resolved=answer.resolved & ~more,
        slip_bound=judgement.slip_bound,
        unbalanced_torque=judgement.largest_torque,
        lower_bound=judgement.lower_bound,
        gap=relative_gap(scene, answer.objective, judgement.lower_bound),
    )


def _told_apart(
    scene: Scene, slip: tuple[np.ndarray, ...], final: Progress, threshold: float | None
) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Contact states, and slips (R,) up to which contacts count as slipless: as asked for, or what can be resolved."""
    if threshold is not None:
        return _states(scene, slip, final, threshold, asked=True), np.full(scene.replicas, threshold)
    rounding = 1e-12 * scene.lattice.radius * scene.jump if final.slip is None else 0.0
    resolves = np.maximum(final.resolution, rounding) * np.ones(scene.replicas)
    state = _states(scene, slip, final, float(resolves.max()), asked=False)
    # a method that establishes the states has rounded its slips in another way
    return state, np.fmax(resolves, separate(scene, slip, state).largest_slipless)


def _states(
    scene: Scene, slip: tuple[np.ndarray, ...], final: Progress, threshold: float, asked: bool
) -> tuple[np.ndarray, ...]:
    """Contact states by slip and friction, or as the method has established them; then slower ones count as slipless,
    and of faster ones none, only if a threshold was asked for."""
    if final.state is None:
        return classify(scene, slip, final.force, threshold)
    slipping, slipless, undecided = ContactState.SLIPPING, ContactState.SLIPLESS, ContactState.UNDECIDED
    found = []
    for axis, (state, speed) in enumerate(zip(final.state, slip, strict=True)):
        if asked:
            slow, fast = (state == slipping) & (speed <= threshold), (state == slipless) & (speed > threshold)
            state = np.where(slow, slipless, np.where(fast, undecided, state))
        found.append(np.where(scene.idle(axis), ContactState.DRIVEN, state).astype(np.uint8))
    return tuple(found)


def _slips(scene: Scene, final: Progress) -> tuple[np.ndarray, ...]:
    return scene.slips(final.staggered, final.spin_axes) if final.slip is None else final.slip


def _sizes(force: Forces) -> tuple[np.ndarray, ...]:
    return tuple(vector_length(values) for values in force)


def _acting(scene: Scene, final: Progress, slip: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Sizes of the forces in a dynamics at this moment: where contacts hold its own, else those of the law."""
    if scene.law.holds:
        return tuple(
            np.where(of == 0, 0.0, size) for of, size in zip(scene.coefficient, _sizes(final.force), strict=True)
        )
    return tuple(scene.law.force(of, speed) for of, speed in zip(scene.contact, slip, strict=True))


def _with_proven_slips(state: tuple[np.ndarray, ...], judgement: Judgement) -> tuple[np.ndarray, ...]:
    """States (R, *contacts) an axis, with all contacts slipping that are proven to slip at the minimum."""
    proven = [np.stack(of_axis) for of_axis in zip(*(found.proven for found in judgement.states), strict=True)]
    return tuple(
        np.where(slips == SLIPPING, ContactState.SLIPPING, values).astype(np.uint8)
        for slips, values in zip(proven, state, strict=True)
    )


def _judged(scene: Scene, spin: np.ndarray, spin_rounding: np.ndarray, friction: Forces) -> Judgement | None:
    """What the answer proves by itself, whatever the method believes; None for numbers that no arithmetic can judge."""
    samples = Samples(
        scene.lattice.shape, scene.law.name, scene.coefficient, scene.spin_top, scene.spin_bottom, scene.direction,
        scene.normal_force, scene.lattice.radius, spin, spin_rounding, friction,
        scene.named_coefficients.get("viscosity", ()),
    )  # fmt: skip
    return Judgement(samples) if samples.can_be_judged else None


def above_noise(answer: Solution) -> tuple[np.ndarray, ...]:
    """Its contact states, those undecided that seem to slip by less than the gap resolves, where nothing is proven."""
    open_ = ~answer.resolved
    return tuple(
        np.where(
            (state == ContactState.SLIPPING) & faint & open_.reshape(-1, *(1,) * (state.ndim - 1)),
            ContactState.UNDECIDED,
            state,
        ).astype(np.uint8)
        for state, faint in zip(answer.state, unresolved(answer), strict=True)
    )


def proven(scene: Scene, final: Progress, judgement: Judgement | None, state: tuple[np.ndarray, ...]) -> np.ndarray:
    """True (R,) where the verifier proves that these are the states at every minimum.

    It is asked where the method believes so, and where one component makes that cheap.
    """
    one_component = scene.law.is_rate_independent and len(scene.minimum_spin_axes) == 1
    found = np.full(scene.replicas, one_component) if final.resolved is None else np.array(final.resolved)
    if judgement is None or not found.any():
        return np.zeros(scene.replicas, dtype=bool)
    together = one_component or bool(found.all())
    with one_thread():
        for replica in np.flatnonzero(found):
            states = judgement.states[replica] if together else judgement.one(int(replica)).states[0]
            found[replica] = states.agree([values[replica] for values in state])
    return found
