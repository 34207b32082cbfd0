"""Warnings: sentences, each with a number, that say where an answer could be misread.

They are `warnings` in the summary of a run, and lines on stderr. Each function here takes the answer to all samples of
a run, and the settings of the run if it needs them. It yields the sentences on one matter; none if there is nothing to
warn of.
"""

from collections.abc import Iterator

import numpy as np

from taichi_bearings.proof.contact_state import (
    SATURATED,
    ContactState,
    separate,
    too_uneven,
    unresolved,
)
from taichi_bearings.runs.own_law_torque import SHARP
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Solution, Status
from taichi_bearings.scene.solution import PROVEN
from taichi_bearings.solvers.gear import ACCURATE_ERROR
from taichi_bearings.words import counted

DECADE = 10.0  # ratio below which slipping contacts are named as too close to slipless ones, or to what is resolved
STRETCHED_SHARE = 1e-2  # springs may be stretched by this part of the distance that the planes slid past each other
ROUNDED_SLIP = 1e-10  # slips up to this part of the fastest imposed surface speed may be rounding
UNFINISHED = {  # words for why a run ended early
    Status.STEP_LIMIT: "the limit of iterations came",
    Status.TIME_LIMIT: "the time limit came",
    Status.INTERRUPTED: "it was interrupted",
    Status.STALLED: "the method got no closer",
}


def caveats(solution: Solution, settings: RunSettings) -> list[str]:
    """Return all warnings about an answer as sentences, each for all of its samples together.

    solution : the answer to all samples of a lattice or a packing.
    settings : settings of the run.
    """
    return [
        *_torque_between(solution, settings), *_beside_a_bottom_that_turns(solution, settings),
        *_strength_unknown(solution, settings), *_law_of_ones_own(solution), *_no_power(solution),
        *_unfinished(solution, settings), *_not_proven(solution), *_contacts_found_and_idle(solution, settings),
        *_undecided(solution), *_hardly_apart(solution, settings), *_tied(solution), *_long_time_step(solution),
        *_stretched_springs(solution),
    ]  # fmt: skip


def _torque_between(solution: Solution, settings: RunSettings) -> Iterator[str]:
    """Yield a sentence for each sample of which it is not known whether its top moves: the torque on the top lies
    between the largest one that friction is proven to hold and the smallest one that it is proven not to hold.

    solution : the answer to all samples, with findings on the torque if one was given.
    settings : settings of the run, with the torque.
    """
    found = solution.findings
    if settings.torque is None or "yields" not in found:
        return
    low, high = found["yield_torque_lower_bound"], found["yield_torque"]
    beside = np.isnan(found["amplitude"]) & (abs(settings.torque) <= high)
    for number in np.flatnonzero(beside & (abs(settings.torque) > low)):
        yield (
            f"the torque {settings.torque:.17g} lies between {low[number]:.17g}, up to which friction is proven to "
            f"hold the top, and {high[number]:.17g}, above which the top is proven to move; so it is not known "
            "whether it moves"
        )


def _beside_a_bottom_that_turns(solution: Solution, settings: RunSettings) -> Iterator[str]:
    """Yield a sentence if a torque does not turn the top in its direction but the bottom, which turns, may turn it the
    other way.

    solution : the answer to all samples, with findings on the torque if one was given.
    settings : settings of the run, with the torque.
    """
    found = solution.findings
    if settings.torque is None or "yields" not in found or not solution.scene.top_and_bottom[1]:
        return
    held = abs(settings.torque) <= found["yield_torque_lower_bound"]
    if held.any():
        other = -settings.torque
        yield (
            f"the torque {settings.torque:g} does not turn the top in its direction{_in_samples(held)}, but the bottom "
            f"may turn the top the other way: it does if the yield_torque with --torque {other:g} is below "
            f"{-abs(other):g}"
        )


def _strength_unknown(solution: Solution, settings: RunSettings) -> Iterator[str]:
    """Yield a sentence if, with a law that the user has defined, a torque turns the top with a speed that is not known.

    solution : the answer to all samples, with findings on the torque if one was given.
    settings : settings of the run, with the torque.
    """
    found = solution.findings
    if settings.torque is None or "yields" not in found or solution.scene.law.is_sum:
        return
    unknown = found["yields"] & np.isnan(found["amplitude"])
    if unknown.any():
        yield (
            f"the torque {settings.torque:g} turns the top{_in_samples(unknown)}, but how fast is not known: no speed "
            f"is proven within {SHARP:.1%}; perhaps nothing limits it, or the tolerance {settings.tolerance:g} is too "
            "large"
        )


def _not_proven(solution: Solution) -> Iterator[str]:
    """Yield a sentence for each sample of a packing whose lower bound on the least power is not proven of all spins."""
    several, said = solution.scene.replicas > 1, solution.findings.get("proof", ())
    for seed, proof in zip(solution.scene.seeds, said, strict=False):
        if proof != PROVEN:
            yield (
                f"the lower bound{f' of seed {seed}' * several} is {proof}: some spheres can roll but for the rounding "
                "of their normals, and much faster spins may dissipate less"
            )


def _contacts_found_and_idle(solution: Solution, settings: RunSettings) -> Iterator[str]:
    """Yield up to two sentences about the contacts of a packing: how many were found from the centres of its spheres,
    if the user gave a table of centres without a list of contacts; and how many have normal force 0 and so do not act,
    if there are any.

    solution : the answer for the packing, with all samples.
    settings : settings of the run; they tell where the contacts come from.
    """
    network, pressing = solution.scene.network, solution.scene.sample(0).normal_force
    if settings.has_table and settings.contacts is None:
        from taichi_bearings.scene.readers.found import TOLERANCE, contact_summary

        share = TOLERANCE if settings.touching is None else settings.touching
        yield contact_summary(network.contact.T, network.spheres, share)[0]
    idle = int((np.asarray(pressing) == 0).sum())
    if idle:
        do = "bears no normal force and does not act" if idle == 1 else "bear no normal force and do not act"
        yield f"{idle:,} of {counted(network.contacts, 'contact')} {do}"


def _in_samples(which: np.ndarray) -> str:
    """Return the words " in n of R samples"; empty for a single sample.

    which : (R samples,), mask of the samples that are counted.
    """
    return f" in {int(which.sum()):,} of {len(which):,} samples" if len(which) > 1 else ""


def _law_of_ones_own(solution: Solution) -> Iterator[str]:
    """Yield a sentence on what lower bounds assume of the law, if it is one that the user has defined."""
    if not solution.scene.law.is_sum:
        yield (
            f"what is proven rests on the law {solution.scene.law.name!r} as it was given: that its potential is "
            "convex and its conjugate is right was checked at some slips only, and the rounding of its functions is "
            "not bounded"
        )


def _no_power(solution: Solution) -> Iterator[str]:
    """Yield a sentence if the least power is 0, with the reason."""
    scene = solution.scene
    still = (solution.objective == 0) & (solution.gap == 0)
    if reason := scene.driving.why_without_power:
        yield f"the least power is 0: {reason}"
    elif scene.is_cut_off.any():
        yield (
            f"the least power is 0{_in_samples(scene.is_cut_off)}: contacts are absent, and no chain of those that are "
            "left and feel the imposed spins joins bottom and top"
        )
    elif still.any():
        among = np.asarray(solution.findings.get("driven_power", 0.0)) > 0
        others = " but those between driven spheres" if (still & among).any() else ""
        yield f"the least power is 0{_in_samples(still)}: the spins can be such that no contact slips{others}"


def _unfinished(solution: Solution, settings: RunSettings) -> Iterator[str]:
    """Yield a sentence if a run ended early, with the reason and what was reached.

    * of a dynamics: the simulated time; without a duration also the torques left over, as it was to end at rest;
    * of a minimisation: the proven gap; or, if it stalled, that power and slips may be due to rounding alone.

    solution : the answer to all samples.
    settings : settings of the run, with the tolerance and the duration that were asked for.
    """
    reason, history = UNFINISHED.get(solution.status), solution.history
    if reason is None:
        return
    if "time" in history:
        reached = float(np.min(history["time"][-1]))  # by the sample that came least far
        if settings.duration is not None:
            if reached < settings.duration * (1 - 1e-9):
                yield f"{reason} at the simulated time {reached:.6g} of {settings.duration:.6g}"
            return
        left = float(solution.largest_balance_residual.max())
        yield f"{reason} before the motion was at rest: at the time {reached:.3g} torques of {left:.1e} were left over"
        return
    short, stalled = ~(solution.gap <= settings.tolerance), solution.status is Status.STALLED
    if stalled and (faint := short & _hardly_slip(solution)).any():
        largest = float(solution.power[faint].max())
        yield (
            f"the power of {largest:.1e} may be that of rounding alone{_in_samples(faint)}: contacts hardly slip, but "
            "no state without slip is proven to exist for normals and spins as they are stored"
        )
    elif short.any():
        worst = float(np.max(np.where(np.isfinite(solution.gap), solution.gap, np.inf)))
        words = f"{reason} with a proven gap of {worst:.1e}{_in_samples(short)}; "
        words += f"the tolerance is {settings.tolerance:g}"
        if stalled and solution.running.precision == "f32":
            words += f", which single precision cannot reach here: --precision f64, or a tolerance of {1.5 * worst:.0e}"
        yield words


def _hardly_slip(solution: Solution) -> np.ndarray:
    """Return a mask (R samples,): True where no contact slips faster than rounding could make it."""
    fastest = float(np.abs(solution.scene.driven_speed).max(initial=0.0))
    slip = np.where(solution.state == ContactState.DRIVEN, 0.0, solution.slip).max(axis=1, initial=0.0)
    return np.asarray(slip <= ROUNDED_SLIP * fastest)


def _undecided(solution: Solution) -> Iterator[str]:
    """Yield a sentence with the numbers of undecided contacts by reason, if there are any. If the weakest contacts of a
    sample dissipate too little for any unproven state to be named, the sentence says that instead.
    """
    if solution.states_proven.all():
        return
    number = int(solution.counts[:, ContactState.UNDECIDED].sum())
    named = ~solution.proven & (solution.state != ContactState.UNDECIDED)
    uneven = too_uneven(solution) & ~named.any(axis=1) & ~solution.states_proven
    if uneven.any():
        of = _in_samples(uneven)
        yield f"the weakest contacts dissipate less than gap or rounding leave open{of}: only proven states are named"
    elif number > 0:
        scene, full = solution.scene, SATURATED * solution.scene.strength
        undecided = solution.state == ContactState.UNDECIDED
        fast = undecided & (solution.slip > solution.slip_threshold)
        # contacts without friction have no limit, so slip alone says what they do
        has_limit = scene.law.has_friction
        at_limit = solution.force >= full * scene.coefficient if has_limit else fast
        below_limit = int((fast & ~at_limit).sum())
        resolved = int((fast & at_limit & ~(unresolved(solution) & has_limit)).sum())
        slow = number - below_limit - resolved
        all_contacts = int((solution.state != ContactState.DRIVEN).sum())
        faster = f" faster than {solution.slip_threshold:.1e} (slip_threshold)" if solution.slip_threshold else ""
        kinds = {
            f"slipping{faster}, although with friction below its limit": below_limit,
            f"{'at the friction limit, and ' * has_limit}slipping too slowly to be told from rest": slow,
            "slipping, but perhaps not at every minimum": resolved,
        }
        reasons = "; ".join(f"{count:,} {words}" for words, count in kinds.items() if count)
        yield f"{number:,} of {counted(all_contacts, 'contact')} undecided: {reasons}"


def _hardly_apart(solution: Solution, settings: RunSettings) -> Iterator[str]:
    """Yield sentences if slipping contacts are hard to tell from slipless ones. There are two cases: some
    dissipate less than ten times the power that the gap leaves open, or the slowest one slips less than ten times
    faster than the fastest slipless one.

    solution : the answer to all samples.
    settings : settings of the run, with the tolerance.
    """
    near = (solution.gap <= settings.tolerance) & ~solution.states_proven
    if not solution.scene.law.has_friction or not near.any():
        return
    doubtful = near[:, None] & (solution.state == ContactState.SLIPPING) & ~solution.proven
    faint = int((doubtful & unresolved(solution, DECADE)).sum())
    if faint:
        dissipate = "dissipates" if faint == 1 else "dissipate"
        much = f"less than {DECADE:g} times the power that the gap leaves open, so perhaps not at the minimum"
        yield f"{counted(faint, 'slipping contact')} {dissipate} {much}"
    found = separate(solution.scene, solution.slip, solution.state)
    near &= found.decades < np.log10(DECADE)
    if near.any():
        worst = int(np.argmin(np.where(near, found.decades, np.inf)))
        yield (
            f"slipping and slipless contacts are hardly apart: the slowest slipping one has a slip speed of "
            f"{found.smallest_slipping[worst]:.1e}, the fastest slipless one {found.largest_slipless[worst]:.1e}"
        )


def _tied(solution: Solution) -> Iterator[str]:
    """Yield a sentence with the number of contacts that slip at some minima and not at others; none if there are no
    such contacts.
    """
    tied = int(solution.counts[:, ContactState.TIED].sum())
    if tied:
        contacts = counted(tied, "contact")
        yield f"minima tie exactly (several have the least power): {contacts} slip at some of them and not at others"


def _long_time_step(solution: Solution) -> Iterator[str]:
    """Yield a sentence if the time step of a dynamics is too long for accurate spins before its end."""
    error, advised = (solution.findings.get(name) for name in ("step_error", "accurate_time_step"))
    if error is not None and error.max() > ACCURATE_ERROR:
        words = f"the time step makes spins wrong by about {error.max():.1e} of the largest one on their way"
        step = float(np.min(advised)) if advised is not None else np.nan
        yield f"{words}; --time-step {step:.2g} keeps that below {ACCURATE_ERROR:g}" if np.isfinite(step) else words


def _stretched_springs(solution: Solution) -> Iterator[str]:
    """Yield a sentence if the springs of a dynamics are stretched by more than STRETCHED_SHARE of the distance by which
    the driven spheres have slid past each other.
    """
    share = solution.findings.get("elastic_share")
    largest = 0.0 if share is None else float(np.nanmax(share, initial=0.0))
    if largest > STRETCHED_SHARE:
        stiffer = largest / STRETCHED_SHARE
        yield (
            f"springs are stretched by up to {largest:.1e} of the distance that driven spheres have slid past each "
            f"other; a stiffness {stiffer:.2g} times as large, or as much more time, keeps that below "
            f"{STRETCHED_SHARE:g}"
        )
