"""Does a run prove what it claims? Everything that its file says, held against what follows from its numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.verifier.claims import agree, ended, not_checked, of_sample
from taichi_bearings.verifier.judgement import Judgement
from taichi_bearings.verifier.samples import CRITICAL, SLIPLESS, SLIPPING, TIED, UNPROVEN, Samples
from taichi_bearings.verifier.states import States
from taichi_bearings.verifier.stored_run import StoredRun
from taichi_bearings.verifier.ties import MISSED_LIMIT

ARITHMETIC = (
    "sums of two doubles with a bound on every error; bounds are rounded outwards; curvature by floating-point "
    "elimination with a bound on its error"
)
ROUNDED = 1e-12  # relative difference of numbers that the run has computed in doubles
EPS = np.finfo(np.float64).eps
CLAIMS = ("lower_bound", "states_proven", "minimum_is_unique")
OFF_IN_SINGLE = 1e-5  # relative, that motions in single precision are off
TORQUE_COST = 1e-12  # of the power, that torques left over may cost where friction counts as balanced
DRIVEN_STATE = 3  # state of a contact between driven spheres, in the file
LOST_SQUARE = 1e-150  # of the largest friction: sizes of vectors below it may be lost where they are squared


@dataclass(frozen=True)
class Verdict:
    """Sample by sample: power, rigorous bounds of what is least at rest, their relative gap, and how many contacts are
    proven to be in which state. contradictions : sentences, empty if the file proves what it claims. not_checked :
    names of what is in the file beside that."""

    power: list[float | None]
    upper_bound: list[float | None]
    lower_bound: list[float | None]
    gap: list[float | None]
    balanced: list[bool]
    inside_discs: list[bool]
    largest_balance_residual: list[float | None]
    states: list[dict[str, int]]
    unique: list[bool | None]
    reasons: list[str]
    contradictions: list[str]
    not_checked: list[str]


def verdict_of(run: StoredRun) -> Verdict:
    """All checks of a run."""
    samples = run.samples
    count = samples.count
    nothing: list[Any] = [None] * count
    contacts = sum(int((~samples.between_driven(axis))[0].sum()) for axis in range(samples.dimension))
    unproven = [{"slipless": 0, "slipping": 0, "critical": 0, "tied": 0, "unproven": contacts} for _ in range(count)]
    if not samples.can_be_judged:
        text = "a number is not finite, or the scales of the scene are too far from one for any arithmetic"
        false = [False] * count
        said = [run.claimed(name)[r] for name in CLAIMS for r in range(count)]
        finite = all(np.isfinite(v).all() for v in (samples.spin, samples.spin_rounding, *samples.friction))
        is_claim = any(said) or (set(run.claimed("status")) != {"not-finite"} and not finite)
        return Verdict(
            nothing,
            nothing,
            nothing,
            nothing,
            false,
            false,
            nothing,
            unproven,
            nothing,
            [text] * count,
            [*([f"{text}: what is said of it is not proven"] if is_claim else []), *ended(run, np.full(count, np.inf))],
            not_checked(run, judged=False),
        )
    judgement = Judgement(samples)
    power, bound, states = judgement.power, judgement.lower_bound, judgement.states
    upper = judgement.upper_bound
    gap = [_finite(value) for value in judgement.gap]
    found = [
        *agree(run),
        *ended(run, judgement.gap),
        *_driving(samples),
        *_numbers(run, judgement),
        *_forces(run, judgement),
    ]
    found += [*_threshold(run)]
    found += [*_states(run, states), *_summary(run, judgement), *_counts(run, judgement)]
    found += [*_under_torque(run, judgement), *_history(run, upper, bound)]
    return Verdict(
        power=[_finite(value) for value in power],
        upper_bound=[_finite(value) for value in upper],
        lower_bound=bound.tolist(),
        gap=gap,
        balanced=(judgement.price <= TORQUE_COST).tolist(),
        inside_discs=(judgement.work.saturation <= 1).tolist(),
        largest_balance_residual=judgement.largest_torque.tolist(),
        states=[_counted(samples, number, s) for number, s in enumerate(states)],
        unique=[s.unique for s in states],
        reasons=[s.reason for s in states],
        contradictions=found,
        not_checked=not_checked(run, judged=True),
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _counted(samples: Samples, number: int, states: States) -> dict[str, int]:
    names = {"slipless": SLIPLESS, "slipping": SLIPPING, "critical": CRITICAL, "tied": TIED, "unproven": UNPROVEN}
    acting = [~samples.idle(axis)[number] for axis in range(samples.dimension)]
    return {
        name: sum(int((s[a] == value).sum()) for s, a in zip(states.proven, acting, strict=True))
        for name, value in names.items()
    }


def _driving(samples: Samples) -> Iterator[str]:
    """The spins of the driven spheres are those that the scene imposes, and each plane turns as one.

    They are sums of the bottom's and of the jump, each known to some 2^-100: a spin far below both is known no better.
    """
    lost = 2.0**-98 * (abs(samples.spin_top) + abs(samples.spin_bottom))
    largest = {"bottom": 0.0, "top": 0.0}
    for k in samples.components:
        spins = [s if samples.dimension == 2 else s[..., k] for s in (samples.spin, samples.spin_rounding)]
        signed = [samples.sublattice * part for part in spins]
        first = [samples.first_in_layers(part, k) for part in signed]
        on_top = samples.imposed_in_layers(k)
        low = on_top[0] if k < samples.dimension - 1 else [samples.states[0][k]]
        for plane, name, imposed in ((0, "bottom", low), (-1, "top", on_top[1])):
            values = np.array([[float(value) for value in imposed]])
            expected = samples.by_layer(values, k, samples.dimension - 1)
            largest[name] = largest[name] + expected**2  # type: ignore[assignment]
            uneven = any((part[..., plane] != one[..., plane]).any() for part, one in zip(signed, first, strict=True))
            allowed = 4 * EPS * np.abs(expected) + EPS * abs(samples.spin_top if plane else samples.spin_bottom) + lost
            if uneven or (np.abs(signed[0][..., plane] - expected) > allowed).any():
                yield f"the spins of the {name} about {'xyz'[k]} are not those that the scene imposes"
    for name, said in (("bottom", samples.spin_bottom), ("top", samples.spin_top)):
        true = float(np.sqrt(np.max(largest[name])))
        if samples.top is not None and not (_close(said, true) or abs(said - true) <= 2 * lost):
            yield f"the largest spin of the {name} is said to be {said!r}; it is another"


def _numbers(run: StoredRun, judgement: Judgement) -> Iterator[str]:
    """Slip and power of every contact follow from spins and coefficients, and its state from its slip."""
    samples = run.samples
    for axis, name in enumerate("xyz"[: samples.dimension]):
        slip, power, state = (run.reported[key][axis] for key in ("slip", "power", "state"))
        actual, acts = judgement.slip[axis], ~samples.idle(axis)
        if not (np.abs(slip - actual) <= ROUNDED * actual).all():
            yield f"slips of contacts along {name} are not those of the spins"
        strength = _strength(samples, axis)
        expected = np.where(acts, strength * slip if samples.holds else strength * slip**2, 0.0)
        if samples.viscosity:
            expected += np.where(acts, samples.viscosity[axis] * slip**2, 0.0)
        if not (np.abs(power - expected) <= ROUNDED * expected).all():
            yield f"powers of contacts along {name} are not friction or damping times slip"
        if (state == DRIVEN_STATE).sum() != (~acts).sum() or not (state[~acts] == DRIVEN_STATE).all():
            yield f"states of contacts along {name} do not name those between driven spheres and those absent"
        if not np.isin(state, (0, 1, 2, DRIVEN_STATE)).all():
            yield f"states of contacts along {name} have values other than 0, 1, 2 and 3"


def _threshold(run: StoredRun) -> Iterator[str]:
    """No contact that is said not to slip is faster than the threshold, none that is said to slip slower.

    But a method that knows more than the slip may say so; then the threshold is the largest slip of a slipless contact.
    """
    threshold, asked = run.claimed("slip_threshold")[0], run.settings.get("slip_threshold")
    if threshold is None or not 0 <= threshold < np.inf:
        yield f"the slip threshold is said to be {threshold!r}; it must be a speed"
        return
    if asked is not None and asked != threshold:
        yield f"the slip threshold is said to be {threshold!r}; the scene asks for {asked!r}"
    slips, states = (_all(run.reported[name]) for name in ("slip", "state"))
    largest = float(slips[states == SLIPLESS].max(initial=0.0))
    if largest > threshold * (1 + ROUNDED):
        yield f"contacts that are said not to slip are faster ({largest!r}) than the threshold {threshold!r}"
    least = float(slips[states == SLIPPING].min(initial=np.inf))
    if least <= threshold * (1 - ROUNDED) and not (asked is None and _close(threshold, largest)):
        yield f"contacts that are said to slip are slower ({least!r}) than the threshold {threshold!r}"


def _all(parts: tuple[np.ndarray, ...]) -> np.ndarray:
    """(R, n), contacts of all axes."""
    return np.concatenate([values.reshape(len(values), -1) for values in parts], axis=1)


def _strength(samples: Samples, axis: int) -> np.ndarray:
    """(R, *contacts), friction that a contact bears, or without friction its damping."""
    return samples.coefficient[axis] * (samples.normal_force if samples.holds else 1.0)


def _forces(run: StoredRun, judgement: Judgement) -> Iterator[str]:
    """Forces are the sizes of the friction, and what is left over is its torque. Those of a dynamics are others: of
    viscous contacts they follow from the slips, of Coulomb's they are within the static friction, and at the kinetic
    one where a contact is said to slip."""
    samples, is_dynamics = run.samples, "time" in run.history
    most = max(run.setting("static_ratio", 1.0), 1.0) * (1 + MISSED_LIMIT)
    for axis, name in enumerate("xyz"[: samples.dimension]):
        force, slip, state = (run.reported[key][axis] for key in ("force", "slip", "state"))
        acts, strength = ~samples.idle(axis), _strength(samples, axis)
        size = np.sqrt(sum(part**2 for part in samples.turning[axis].values())) * samples.force_unit
        if size[~acts].any():
            yield f"friction along {name} acts between driven spheres"
        if samples.dimension == 3 and samples.friction[axis][..., axis].any():
            yield f"friction along {name} acts along the contacts themselves"
        if not (np.isfinite(force) & (force >= 0)).all():
            yield f"forces of contacts along {name} are not finite or negative"
        if not is_dynamics and not (np.abs(force - size) <= ROUNDED * size + LOST_SQUARE * samples.force_unit).all():
            yield f"forces of contacts along {name} are not those of the friction"
        expected = np.where(acts, strength * slip, 0.0)
        if is_dynamics and not samples.holds and not (np.abs(force - expected) <= ROUNDED * expected).all():
            yield f"forces of contacts along {name} are not damping times slip"
        if not samples.flows and (force > most * strength).any():
            yield f"forces of contacts along {name} exceed their friction"
        slips = (state == SLIPPING) & is_dynamics & (not samples.flows)
        if (force[slips] < (1 - MISSED_LIMIT) * (1 - ROUNDED) * strength[slips]).any():
            yield f"contacts along {name} that are said to slip do not bear all their friction"
        if (
            "slip_bound" in run.reported
            and not np.isclose(run.reported["slip_bound"][axis], judgement.slip_bound[axis], ROUNDED, 0.0).all()
        ):
            yield f"bounds of the slip along {name} are not those that the friction proves"


def _states(run: StoredRun, states: list[States]) -> Iterator[str]:
    """The states that the file gives are not refuted, and proven where it says so."""
    proven = run.claimed("states_proven")
    tied, unique = run.claimed("tied_contacts"), run.claimed("minimum_is_unique")
    for number, found in enumerate(states):
        which = of_sample(run, number)
        given = [run.reported["state"][axis][number] for axis in range(run.samples.dimension)]
        wrong = sum(
            int((np.isin(p, (SLIPLESS, CRITICAL)) & (g == SLIPPING)).sum() + ((p == SLIPPING) & (g == SLIPLESS)).sum())
            for p, g in zip(found.proven, given, strict=True)
        )
        if wrong and _is_minimum(run, number):
            yield f"{wrong} contact states{which} are not those of any minimum"
        if proven[number] and not found.agree(given):
            reason = f": {found.reason}" if found.reason else ""
            yield f"the contact states{which} are said to be proven, and are not{reason}"
        if found.unique and tied[number]:
            yield f"{tied[number]} contacts{which} are said to differ between minima, and there is only one minimum"
        if unique[number] and not found.unique:
            yield f"the minimum{which} is said to be unique, and that is not proven"
        exact = len(run.samples.needed) == 1  # then the method knows ties exactly
        if (proven[number] and not unique[number]) or (exact and unique[number] is None and tied[number]):
            yield f"it is said whether the minimum{which} is unique, and other words say something else"
        if run.claimed("cut_is_unique")[number] not in (None, not tied[number]):
            yield f"the cut{which} is said to be unique or not, and {tied[number]} contacts to differ between minima"
        if unique[number] is False and (found.unique or not (exact or found.unique is False)):
            yield f"the minimum{which} is said not to be unique, and that is not proven"
        told = run.claimed("unproven")[number] == 0
        if proven[number] is False and told and found.agree(given):
            yield f"the states{which} are said not to be proven, and each of them is"
        yield from _kinds(run, number, found)


def _kinds(run: StoredRun, number: int, found: States) -> Iterator[str]:
    """What the file says to be proven of each contact is, and as many are tied as can be."""
    which, unproven, ties = of_sample(run, number), 0, [0, 0]
    for axis, proven in enumerate(found.proven):
        driven = run.samples.idle(axis)[number]
        known = np.where(driven, DRIVEN_STATE, np.where(proven == CRITICAL, SLIPLESS, proven))
        ties = [ties[0] + int((known == TIED).sum()), ties[1] + int(np.isin(known, (TIED, UNPROVEN)).sum())]
        if "proven" in run.reported:
            said = run.reported["proven"][axis][number]
            unproven += int((said == UNPROVEN).sum())
            false = int(((said != known) & ((said != UNPROVEN) | (known == DRIVEN_STATE))).sum())
            if false:
                yield f"{false} contacts{which} along {'xyz'[axis]} are said to be proven what they are not"
    tied, said = run.claimed("tied_contacts")[number], run.claimed("unproven")[number]
    if tied is not None and not ties[0] <= tied <= ties[1]:
        yield f"{tied} contacts{which} are said to differ between minima; what is proven allows {ties[0]} to {ties[1]}"
    if "unproven" in run.attributes and "proven" in run.reported and said != unproven:
        yield f"unproven{which}: the summary says {said!r}, the arrays {unproven!r}"


def _is_minimum(run: StoredRun, number: int) -> bool:
    """A dynamics on its way gives the states of its own motion, and a threshold those of slower contacts, too. Where
    the force grows with the slip, a contact that is proven to slip at the minimum does so now."""
    return (run.samples.flows or run.claimed("status")[number] == "certified") and "slip_threshold" not in run.settings


def _summary(run: StoredRun, judgement: Judgement) -> Iterator[str]:
    """Power, potential, bound and gap of the summary are those computed anew; None where these are no numbers."""
    found = {"power": judgement.power, "lower_bound": judgement.lower_bound}
    if run.samples.holds and run.samples.flows:
        found["potential"] = judgement.objective
    for number in range(run.samples.count):
        which = of_sample(run, number)
        for name, values in found.items():
            said, value = run.claimed(name)[number], _finite(values[number])
            if not (said == value or _close(said, value)):
                yield f"the {name.replace('_', ' ')}{which} is said to be {said!r}; it is {value!r}"
        said, own = run.claimed("gap")[number], _finite(judgement.gap[number])
        if said is not own and (said is None or own is None or not abs(said - own) <= ROUNDED * own + 4 * EPS):
            yield f"the gap{which} is said to be {said!r}; what is proven leaves {own!r}"
        yield from _residual(run, judgement, number)
        if judgement.lower_bound[number] > judgement.objective[number] * (1 + 2 * EPS):
            yield f"the lower bound{which} is above the power or potential: the numbers contradict themselves"


def _under_torque(run: StoredRun, judgement: Judgement) -> Iterator[str]:
    """Whether a torque moves the top follows from the bounds on the power of strength 1, but for coulomb-viscous, a
    torque that grows, and a bottom that turns."""
    samples, text = run.samples, isinstance(run.settings.get("torque"), str)
    if "yields" not in run.attributes or (samples.holds and samples.flows) or samples.spin_bottom or text:
        return
    torque = run.setting("torque", np.nan)
    for number in range(samples.count):
        high, low = (float(v[number]) if samples.holds else 0.0 for v in (judgement.power, judgement.lower_bound))
        moves, held = abs(torque) > high * (1 + ROUNDED), abs(torque) <= low
        strength = torque / judgement.power[number] if samples.flows and moves and judgement.power[number] else np.nan
        held_at = {"yields": moves, "yield_torque": high, "yield_torque_lower_bound": low,
                   "amplitude": 0.0 if held else _finite(strength)}  # fmt: skip
        for name, value in held_at.items():
            said = run.claimed(name)[number]
            if not (said == value or _close(said, value)):
                yield f"{name.replace('_', ' ')}{of_sample(run, number)} is said to be {said!r}; it is {value!r}"


def _residual(run: StoredRun, judgement: Judgement, number: int) -> Iterator[str]:
    """What is left over is the torque of the friction; of a dynamics, what its history ends with."""
    said, is_dynamics = run.claimed("largest_balance_residual")[number], "time" in run.history
    rows = (
        _row(run.history.get("largest_balance_residual"), number) if is_dynamics else judgement.largest_torque[[number]]
    )
    value = None if rows is None or not len(rows) else _finite(rows[-1])
    if rows is not None and said is not value and not _close(said, value):
        yield f"the largest torque left over is said to be {said!r}; it is {value!r}"


def _counts(run: StoredRun, judgement: Judgement) -> Iterator[str]:
    """What the summary counts and measures is what the arrays hold."""
    samples = run.samples
    unit = samples.normal_force * samples.radius * abs(samples.spin_top)
    contacts = sum(int((~samples.between_driven(axis))[0].sum()) for axis in range(samples.dimension))
    for number in range(samples.count):
        which = of_sample(run, number)
        states, slips = ([parts[number] for parts in run.reported[name]] for name in ("state", "slip"))
        kinds = [np.concatenate([s[k == value] for s, k in zip(slips, states, strict=True)]) for value in range(3)]
        held: dict[str, float | None] = {"contacts": contacts}
        for kind, name in zip(kinds, ("slipless", "slipping", "undecided"), strict=True):
            held[name] = len(kind)
        held["critical"] = min(
            _at_limit(run, judgement, number), len(kinds[2]) - (run.claimed("tied_contacts")[number] or 0)
        )
        held["largest_slipless_slip"] = float(kinds[0].max()) if len(kinds[0]) else None
        held["smallest_slipping_slip"] = float(kinds[1].min()) if len(kinds[1]) else None
        if not samples.flows and unit > 0:
            held["power_normalised"] = _finite(judgement.power[number] / unit)
        held["separation_decades"] = _decades(run, kinds, judgement.gap[number])
        for name, value in held.items():
            said = run.claimed(name)[number]
            if name in run.attributes and not (said == value or _close(said, value)):
                yield f"{name.replace('_', ' ')}{which}: the summary says {said!r}, the arrays {value!r}"


def _at_limit(run: StoredRun, judgement: Judgement, number: int) -> int:
    """Undecided contacts with all their friction and no more of the power than what the bounds leave open. Where they
    are not proven to rest, that is at most 0.01 of their power at the least component of the jump, and no more than 1
    in 20 contacts have so little there that doubles, 1e-8 of the whole power, or the bounds lose it."""
    samples, left = run.samples, judgement.objective[number] - judgement.lower_bound[number]
    proven, clear, weak, acting = 0, 0, 0, 0
    share = samples.least_jump / (samples.jump_size or 1.0)  # of it, added to a slip by the other component
    for axis in range(samples.dimension if samples.holds else 0):
        force, slip, state = (run.reported[name][axis][number] for name in ("force", "slip", "state"))
        known = run.reported["proven"][axis][number] if "proven" in run.reported else np.full(state.shape, UNPROVEN)
        friction = samples.normal_force * samples.coefficient[axis][number]
        at_jump, takes_part = friction * samples.radius * samples.least_jump, ~samples.one(number).idle(axis)[0]
        lost = (at_jump <= 1e-8 * judgement.power[number]) | (share * at_jump <= left)
        weak += int((takes_part & lost).sum()) if samples.least_jump else 0
        acting += int(takes_part.sum())
        at_limit = (state == UNPROVEN) & (friction * slip <= left) & (force >= (1 - MISSED_LIMIT) * friction)
        proven += int((at_limit & (known == SLIPLESS)).sum())
        clear += int((at_limit & ~np.isin(known, (SLIPLESS, TIED)) & (left <= 0.01 * at_jump)).sum())
    return proven if weak > 0.05 * acting else proven + clear


def _decades(run: StoredRun, kinds: list[np.ndarray], gap: float) -> float | None:
    """Between the slips of the two kinds of contacts, where the gap is within the tolerance; one that rests slips by
    the rounding of the spins at least."""
    samples, slipless, slipping = run.samples, *kinds[:2]
    rounding = EPS * samples.radius * max(abs(samples.spin_top), abs(samples.spin_bottom))
    if not (gap <= run.setting("tolerance", 1e-8) and len(slipless) and len(slipping)):
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        return _finite(np.log10(slipping.min() / max(slipless.max(), rounding)))


def _close(said: Any, value: float | None) -> bool:
    return said is not None and value is not None and bool(abs(said - value) <= ROUNDED * abs(value))


END_COLUMNS = {"time": "time", "energy_residual": "energy_residual", "iterations": "iteration"}
"""Number of the summary -> column of the history that ends with it."""


def _history(run: StoredRun, power: np.ndarray, bound: np.ndarray) -> Iterator[str]:
    """No bound of the history is above the power, no power below the bound."""
    for number in range(run.samples.count):
        least = "potential" if run.samples.holds and run.samples.flows else "power"
        bounds, powers = (_row(run.history.get(name), number) for name in ("lower_bound", least))
        for name, column in END_COLUMNS.items():
            said, rows = run.claimed(name)[number], _row(run.history.get(column), number)
            if name in run.attributes and rows is not None and len(rows) and said != _finite(rows[-1]):
                yield f"{name.replace('_', ' ')}: the summary says {said!r}, the history {float(rows[-1])!r}"
        if bounds is not None and (bounds > power[number] * (1 + ROUNDED)).any():
            yield f"a lower bound of the history is above the least {least}"
        least_then = bound[number] * _least_share(run, number)
        if powers is not None and (powers < least_then * (1 - ROUNDED)).any():
            yield f"a {least} of the history is below the least {least}"


def _least_share(run: StoredRun, number: int) -> Any:
    """What a motion of the strength a that a torque gives the top takes at least, over that of strength 1: |a| for
    friction, a^2 for viscosity, and the smaller one for both."""
    strength = _row(run.history.get("amplitude"), number)
    if strength is None:
        return 1.0
    powers = [1] * run.samples.holds + [2] * run.samples.flows
    return np.min([np.abs(strength) ** power for power in powers], axis=0) * (1 - OFF_IN_SINGLE)


def _row(column: np.ndarray | None, number: int) -> np.ndarray | None:
    return None if column is None else np.asarray(column if column.ndim == 1 else column[number], dtype=float)


def as_report(verdict: Verdict, count: int) -> dict[str, Any]:
    """The verdict as `--json` of `verify` has it: lists where there are several samples."""

    def per_sample(values: list[Any]) -> Any:
        return values if count > 1 else values[0]

    return {
        "power": per_sample(verdict.power),
        "upper_bound": per_sample(verdict.upper_bound),
        "lower_bound": per_sample(verdict.lower_bound),
        "gap": per_sample(verdict.gap),
        "balanced": per_sample(verdict.balanced),
        "inside_discs": per_sample(verdict.inside_discs),
        "largest_balance_residual": per_sample(verdict.largest_balance_residual),
        "states_proven": per_sample(verdict.states),
        "minimum_is_unique": per_sample(verdict.unique),
        "unproven_because": per_sample(verdict.reasons),
        "contradictions": verdict.contradictions,
        "not_checked": verdict.not_checked,
        "arithmetic": ARITHMETIC,
    }
