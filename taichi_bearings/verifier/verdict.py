"""Does a run prove what it claims? Everything that its file says, held against what follows from its numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.verifier.judgement import Judgement
from taichi_bearings.verifier.samples import Samples
from taichi_bearings.verifier.states import SATURATED, SLIPLESS, SLIPPING, UNPROVEN, States
from taichi_bearings.verifier.stored_run import StoredRun

ARITHMETIC = (
    "sums of two doubles with a bound on every error; bounds are rounded outwards; curvature by floating-point "
    "elimination with a bound on its error"
)
ROUNDED = 1e-12  # relative difference of numbers that the run has computed in doubles
EPS = np.finfo(np.float64).eps
CLAIMS = ("power", "potential", "lower_bound", "gap", "states_proven", "minimum_is_unique")
BALANCED = 1e-12  # of the power, that torques left over may cost where friction counts as balanced
DRIVEN = 3  # state of a contact between driven spheres, in the file
LOST = 1e-150  # of the largest friction: sizes of vectors below it may be lost where they are squared


@dataclass(frozen=True)
class Verdict:
    """Sample by sample: power, rigorous bounds of what is least at rest, their relative gap, and how many contacts are
    proven to be in which state. contradictions : sentences, empty if the file proves what it claims."""

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


def verdict_of(run: StoredRun) -> Verdict:
    """All checks of a run."""
    samples = run.samples
    count = samples.count
    nothing: list[Any] = [None] * count
    contacts = sum(int((~samples.between_driven(axis))[0].sum()) for axis in range(samples.dimension))
    unproven = [{"slipless": 0, "slipping": 0, "unproven": contacts} for _ in range(count)]
    if not samples.can_be_judged:
        text = "a number is not finite, or the scales of the scene are too far from one for any arithmetic"
        false = [False] * count
        said = [run.claimed(name)[r] for name in CLAIMS for r in range(count)]
        is_claim = any(said) or "certified" in run.claimed("status")
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
            [f"{text}: what is said of it is not proven"] if is_claim else [],
        )
    judgement = Judgement(samples)
    power, bound, states = judgement.power, judgement.lower_bound, judgement.states
    upper = judgement.upper_bound
    gap = [_gap(p, b, unit) for p, b, unit in zip(upper, bound, _natural_power(samples), strict=True)]
    found = [*_scene(run), *_driving(samples), *_numbers(run, judgement), *_forces(run, judgement)]
    found += [*_threshold(run, judgement)]
    found += [*_states(run, states), *_summary(run, judgement, gap), *_counts(run), *_history(run, upper, bound)]
    return Verdict(
        power=[_finite(value) for value in power],
        upper_bound=[_finite(value) for value in upper],
        lower_bound=bound.tolist(),
        gap=gap,
        balanced=(judgement.price <= BALANCED).tolist(),
        inside_discs=(judgement.work.saturation <= 1).tolist(),
        largest_balance_residual=judgement.largest_torque.tolist(),
        states=[_counted(samples, number, s) for number, s in enumerate(states)],
        unique=[s.unique for s in states],
        reasons=[s.reason for s in states],
        contradictions=found,
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _gap(power: float, bound: float, natural: float) -> float | None:
    """Relative, without a jump to the natural power if that is larger; None without an upper bound."""
    unit = max(power, natural)
    return None if not np.isfinite(power) else float((power - bound) / unit) if unit > 0 else 0.0


def _natural_power(samples: Samples) -> np.ndarray:
    """(R,), of all contacts with the imposed jump for slip, where nothing joins bottom and top; with the imposed spin
    where there is no jump; else 0."""
    speed = samples.radius * (samples.jump_size or abs(samples.spin_top))
    unit = samples.normal_force * speed if samples.holds else speed**2
    total = np.zeros(samples.count)
    for coefficients, weight in ((samples.coefficient, unit), (samples.viscosity, speed**2 / 2)):
        for axis, values in enumerate(coefficients):
            acting = np.where(samples.between_driven(axis), 0.0, values)
            total += weight * acting.reshape(samples.count, -1).sum(axis=1)
    return np.where(_cut_off(samples) | (samples.jump_size == 0), total, 0.0)


def _cut_off(samples: Samples) -> np.ndarray:
    """(R,), True where absent contacts leave bottom and top unconnected in every component in which they differ."""
    if all((values > 0).all() for values in samples.coefficient):
        return np.zeros(samples.count, dtype=bool)
    return np.array([not any(_joined(samples, number, k) for k in samples.needed) for number in range(samples.count)])


def _joined(samples: Samples, number: int, component: int) -> bool:
    """True if contacts that feel a component lead from the bottom of a sample to its top."""
    reached, before = np.zeros(samples.shape, dtype=bool), -1
    reached[..., 0] = True
    while int(reached.sum()) > before:
        before = int(reached.sum())
        for axis in range(samples.dimension):
            if component in samples.felt(axis):
                low, high = (end[1:] for end in samples.ends(axis))
                there = samples.coefficient[axis][number] > 0
                reached[low] |= there & reached[high]
                reached[high] |= there & reached[low]
    return bool(reached[..., -1].any())


def _counted(samples: Samples, number: int, states: States) -> dict[str, int]:
    names = {"slipless": SLIPLESS, "slipping": SLIPPING, "unproven": UNPROVEN}
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
    for plane, name, imposed in ((0, "bottom", samples.spin_bottom), (-1, "top", samples.spin_top)):
        for k in samples.components:
            spins = [s if samples.dimension == 2 else s[..., k] for s in (samples.spin, samples.spin_rounding)]
            high, low = ((samples.sublattice * part)[..., plane] for part in spins)
            expected = imposed * _along(samples, k)
            uneven = any((part != part.reshape(samples.count, -1)[:, :1].reshape(-1, *(1,) * (part.ndim - 1))).any()
                         for part in (high, low))  # fmt: skip
            if uneven or np.abs(high - expected).max() > 4 * EPS * abs(imposed) + lost:
                yield f"the spins of the {name} about {'xyz'[k]} are not those that the scene imposes"


def _scene(run: StoredRun) -> Iterator[str]:
    """The scene in the file, from which it can be run again, is the one whose numbers these are."""
    settings, samples = run.settings, run.samples
    expected = {
        "law": samples.law,
        "shape": list(samples.shape),
        "spin_top": samples.spin_top,
        "spin_bottom": samples.spin_bottom,
        "normal_force": samples.normal_force,
        "radius": samples.radius,
        "seed": run.claimed("seed")[0],
        "replicas": samples.count,
    }
    for name, value in expected.items():
        if settings.get(name) != value:
            yield f"the scene has {name} = {settings.get(name)!r}, and the file {value!r}"
    if (settings.get("coefficients") is None) != (run.claimed("coefficients")[0] is None):
        yield "scene and summary do not agree whether coefficients are given or drawn"


def _along(samples: Samples, component: int) -> float:
    """Part of the unit vector of the imposed spins, rounded."""
    if samples.dimension == 2:
        return 1.0
    direction = np.asarray(samples.direction) / np.max(np.abs(samples.direction))
    return float(direction[component] / np.linalg.norm(direction))


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
        if (state == DRIVEN).sum() != (~acts).sum() or not (state[~acts] == DRIVEN).all():
            yield f"states of contacts along {name} do not name those between driven spheres and those absent"
        if not np.isin(state, (0, 1, 2, DRIVEN)).all():
            yield f"states of contacts along {name} have values other than 0, 1, 2 and 3"


def _threshold(run: StoredRun, judgement: Judgement) -> Iterator[str]:
    """No contact that is said not to slip is faster than the threshold, none that is said to slip slower.

    But a method that knows more than the slip may say so; then the threshold is the largest slip of a slipless contact.
    Beside viscosity slips may be proven, and they count whatever the threshold.
    """
    samples, threshold, asked = run.samples, run.claimed("slip_threshold")[0] or 0.0, run.settings.get("slip_threshold")
    if asked is not None and asked != threshold:
        yield f"the slip threshold is said to be {threshold!r}; the scene asks for {asked!r}"
    slips, states = (_all(run.reported[name]) for name in ("slip", "state"))
    proven = np.stack([np.concatenate([s.ravel() for s in found.proven]) for found in judgement.states])
    largest = float(slips[states == SLIPLESS].max(initial=0.0))
    if largest > threshold * (1 + ROUNDED):
        yield f"contacts that are said not to slip are faster ({largest!r}) than the threshold {threshold!r}"
    slipping = (states == SLIPPING) & ~((proven == SLIPPING) & samples.holds & samples.flows)
    least = float(slips[slipping].min(initial=np.inf))
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
    most = max(run.setting("static_ratio", 1.0), 1.0) * (1 + SATURATED)
    for axis, name in enumerate("xyz"[: samples.dimension]):
        force, slip, state = (run.reported[key][axis] for key in ("force", "slip", "state"))
        acts, strength = ~samples.idle(axis), _strength(samples, axis)
        size = np.sqrt(sum(part**2 for part in samples.turning[axis].values())) * samples.force_unit
        if size[~acts].any():
            yield f"friction along {name} acts between driven spheres"
        if not (np.isfinite(force) & (force >= 0)).all():
            yield f"forces of contacts along {name} are not finite or negative"
        if not is_dynamics and not (np.abs(force - size) <= ROUNDED * size + LOST * samples.force_unit).all():
            yield f"forces of contacts along {name} are not those of the friction"
        expected = np.where(acts, strength * slip, 0.0)
        if is_dynamics and not samples.holds and not (np.abs(force - expected) <= ROUNDED * expected).all():
            yield f"forces of contacts along {name} are not damping times slip"
        if not samples.flows and (force > most * strength).any():
            yield f"forces of contacts along {name} exceed their friction"
        slips = (state == SLIPPING) & is_dynamics & (not samples.flows)
        if (force[slips] < (1 - SATURATED) * (1 - ROUNDED) * strength[slips]).any():
            yield f"contacts along {name} that are said to slip do not bear all their friction"
        if (
            "slip_bound" in run.reported
            and not (run.reported["slip_bound"][axis] >= judgement.slip_bound[axis] * (1 - ROUNDED)).all()
        ):
            yield f"bounds of the slip along {name} are below what the friction proves"


def _states(run: StoredRun, states: list[States]) -> Iterator[str]:
    """The states that the file gives are not refuted, and proven where it says so."""
    proven = run.claimed("states_proven")
    tied, unique = run.claimed("tied_contacts"), run.claimed("minimum_is_unique")
    for number, found in enumerate(states):
        which = f" of sample {number}" if len(states) > 1 else ""
        given = [run.reported["state"][axis][number] for axis in range(run.samples.dimension)]
        wrong = sum(
            int(((p == SLIPLESS) & (g == SLIPPING)).sum() + ((p == SLIPPING) & (g == SLIPLESS)).sum())
            for p, g in zip(found.proven, given, strict=True)
        )
        if wrong and run.samples.holds and _is_minimum(run, number):
            yield f"{wrong} contact states{which} are not those of any minimum"
        if proven[number] and not found.agree(given):
            reason = f": {found.reason}" if found.reason else ""
            yield f"the contact states{which} are said to be proven, and are not{reason}"
        if found.unique and tied[number]:
            yield f"{tied[number]} contacts{which} are said to differ between minima, and there is only one minimum"
        if unique[number] and not found.unique:
            yield f"the minimum{which} is said to be unique, and that is not proven"
        if unique[number] is not None and not unique[number] and (found.unique or len(run.samples.needed) != 1):
            yield f"the minimum{which} is said not to be unique, and that is not proven"


def _is_minimum(run: StoredRun, number: int) -> bool:
    """A dynamics on its way gives the states of its own motion, and a threshold those of slower contacts, too."""
    return run.claimed("status")[number] == "certified" and "slip_threshold" not in run.settings


def _summary(run: StoredRun, judgement: Judgement, gap: list[float | None]) -> Iterator[str]:
    """Power, potential, bound, gap and status of the summary."""
    power, objective, bound = judgement.power, judgement.objective, judgement.lower_bound
    tolerance, natural = run.setting("tolerance", 1e-8), _natural_power(run.samples)
    claimed = {name: run.claimed(name) for name in ("power", "lower_bound", "gap", "status")}
    for number in range(run.samples.count):
        which = f" of sample {number}" if run.samples.count > 1 else ""
        p, b, g, status = (claimed[name][number] for name in ("power", "lower_bound", "gap", "status"))
        if p is not None and not abs(p - power[number]) <= ROUNDED * abs(p):
            yield f"the power{which} is said to be {p!r}; the spins dissipate {power[number]!r}"
        potential = run.claimed("potential")[number]
        if potential is None and run.samples.holds and run.samples.flows:
            yield f"the potential{which}, of which the lower bound is, is missing"
        if potential is not None and not abs(potential - objective[number]) <= ROUNDED * abs(potential):
            yield f"the potential{which} is said to be {potential!r}; that of the spins is {objective[number]!r}"
        if b is not None and not b <= bound[number] * (1 + ROUNDED / 100):
            yield f"the lower bound{which} is said to be {b!r}; the friction proves {bound[number]!r}"
        proven = gap[number]
        own = float("inf") if proven is None else proven
        if g is not None and not own <= g * (1 + 1e-9) + 4 * EPS:
            yield f"the gap{which} is said to be {g!r}; what is proven leaves {own!r}"
        if None not in (g, b, p):
            follows = _gap(p if potential is None else potential, b, natural[number])
            if follows is None or not abs(g - follows) <= ROUNDED * abs(follows):
                yield f"the gap{which} is said to be {g!r}; power or potential and lower bound leave {follows!r}"
        if g is not None and g < -ROUNDED / 100:
            yield f"the gap{which} is negative: {g!r}"
        if status == "certified" and (not own <= tolerance * (1 + 1e-9) or None in (p, b, g)):
            yield f"the run{which} is said to be certified to {tolerance!r}; what is proven leaves {own!r}"
        yield from _residual(run, judgement, number)
        if bound[number] > objective[number] * (1 + 2 * EPS):
            yield f"the lower bound{which} is above the power or potential: the numbers contradict themselves"


def _residual(run: StoredRun, judgement: Judgement, number: int) -> Iterator[str]:
    """What is left over is the torque of the friction; of a dynamics, what its history ends with."""
    said, is_dynamics = run.claimed("largest_balance_residual")[number], "time" in run.history
    rows = _row(run.history.get("unbalanced_torque"), number) if is_dynamics else judgement.largest_torque[[number]]
    if said is not None and rows is not None and len(rows) and not _close(said, float(rows[-1])):
        yield f"the largest torque left over is said to be {said!r}; it is {float(rows[-1])!r}"


def _counts(run: StoredRun) -> Iterator[str]:
    """What the summary counts and measures is what the arrays hold."""
    samples = run.samples
    unit = samples.normal_force * samples.radius * abs(samples.spin_top)
    contacts = sum(int((~samples.between_driven(axis))[0].sum()) for axis in range(samples.dimension))
    for number in range(samples.count):
        which = f" of sample {number}" if samples.count > 1 else ""
        states, slips = ([parts[number] for parts in run.reported[name]] for name in ("state", "slip"))
        kinds = [np.concatenate([s[k == value] for s, k in zip(slips, states, strict=True)]) for value in range(3)]
        held: dict[str, float | None] = {"contacts": contacts}
        for kind, name in zip(kinds, ("slipless", "slipping", "undecided"), strict=True):
            held[name] = len(kind)
        held["largest_slipless_slip"] = float(kinds[0].max()) if len(kinds[0]) else None
        held["smallest_slipping_slip"] = float(kinds[1].min()) if len(kinds[1]) else None
        power = run.claimed("power")[number]
        if not samples.flows and unit > 0 and power is not None:
            held["power_normalised"] = power / unit
        for name, value in held.items():
            said = run.claimed(name)[number]
            if name in run.attributes and not (said == value or _close(said, value)):
                yield f"{name.replace('_', ' ')}{which}: the summary says {said!r}, the arrays {value!r}"


def _close(said: Any, value: float | None) -> bool:
    return said is not None and value is not None and abs(said - value) <= ROUNDED * abs(value)


ENDS = {"time": "time", "energy_residual": "energy_residual", "iterations": "iteration"}
"""Number of the summary -> column of the history that ends with it."""


def _history(run: StoredRun, power: np.ndarray, bound: np.ndarray) -> Iterator[str]:
    """No bound of the history is above the power, no power below the bound."""
    for number in range(run.samples.count):
        least = "potential" if run.samples.holds and run.samples.flows else "power"
        bounds, powers = (_row(run.history.get(name), number) for name in ("lower_bound", least))
        for name, column in ENDS.items():
            said, rows = run.claimed(name)[number], _row(run.history.get(column), number)
            if said is not None and rows is not None and len(rows) and said != rows[-1]:
                yield f"{name.replace('_', ' ')}: the summary says {said!r}, the history {float(rows[-1])!r}"
        if bounds is not None and (bounds > power[number] * (1 + ROUNDED)).any():
            yield f"a lower bound of the history is above the least {least}"
        if powers is not None and (powers < bound[number] * (1 - ROUNDED)).any():
            yield f"a {least} of the history is below the least {least}"


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
        "arithmetic": ARITHMETIC,
    }
