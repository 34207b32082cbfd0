"""Does a run prove what it claims? Everything that its file says, held against what follows from its numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from taichi_bearings.verifier.claims import Claim, agree, ended, not_checked, of_sample, summed_up
from taichi_bearings.verifier.judgement import EPS, Judgement
from taichi_bearings.verifier.network import StoredPacking
from taichi_bearings.verifier.samples import CRITICAL, DRIVEN_STATE, SLIPLESS, SLIPPING, TIED, UNPROVEN, Samples
from taichi_bearings.verifier.stored_run import StoredRun
from taichi_bearings.verifier.ties import MISSED_LIMIT

ARITHMETIC = (
    "sums of two doubles with a bound on every error; bounds are rounded outwards; curvature by floating-point "
    "elimination with a bound on its error"
)
ROUNDED_UP = 1 + 1e-13  # factor of a power that is not below the exact one
ROUNDED = 1e-12  # relative difference of numbers that the run has computed in doubles
PROVING = ("lower_bound", "states_proven", "minimum_is_unique")  # words that say that something is proven
OF_SAMPLES = ("power", "upper_bound", "lower_bound", "gap", "balanced", "inside_discs", "largest_balance_residual",
           "states_proven", "minimum_is_unique", "unproven_because")  # fmt: skip
TORQUE_COST = 1e-12  # of the power, that torques left over may cost where friction counts as balanced
LOST_SQUARE = 1e-150  # of the largest friction: sizes of vectors below it may be lost where they are squared
NORMAL_ERROR = 1e-6  # of the length of a normal, and between those of two contacts of the same spheres
STATE_NAMES = {"slipless": SLIPLESS, "slipping": SLIPPING, "critical": CRITICAL, "tied": TIED, "unproven": UNPROVEN}


def report_of(run: StoredRun) -> dict[str, Any]:
    """As `--json` of `verify` has it, sample by sample where there are several: power, rigorous bounds of what is least
    at rest, their relative gap, how many contacts are proven to be in which state. contradictions : sentences, empty
    if the file proves what it claims. not_checked : names of what is in the file beside that."""
    count, judgement = run.samples.count, Judgement(run.samples)
    told: dict[str, Any]
    if not judgement.can_be_judged:
        text = "a number is not finite, or the scales of the scene are too far from one for any arithmetic"
        acts = int((run.reported["state"][0] != DRIVEN_STATE).sum())
        proof, told = None, dict.fromkeys(OF_SAMPLES, [None] * count)
        told |= dict.fromkeys(("balanced", "inside_discs"), [False] * count)
        told |= {"states_proven": [dict.fromkeys(STATE_NAMES, 0) | {"unproven": acts}] * count}
        told |= {"unproven_because": [text] * count}
        said = [run.claimed(name)[r] for name in PROVING for r in range(count)]
        is_claim = any(said) or (set(run.claimed("status")) != {"not-finite"} and not run.samples.is_finite)
        found = [f"{text}: what is said of it is not proven"] if is_claim else []
        found += ended(run, np.full(count, np.inf))
        unseen = ["everything but the status"]
    else:
        states, proof = judgement.states, judgement.proof
        told = {
            "power": _finite(judgement.power),
            "upper_bound": _finite(judgement.upper_bound),
            "lower_bound": judgement.lower_bound.tolist(),
            "gap": _finite(judgement.gap),
            "balanced": (judgement.price <= TORQUE_COST).tolist(),
            "inside_discs": (judgement.bounds.worst <= 1 + ROUNDED * (not run.samples.is_lattice)).tolist(),
            "largest_balance_residual": judgement.largest_torque.tolist(),
            "states_proven": [
                {name: int(((s.proven == kind) & acts).sum()) for name, kind in STATE_NAMES.items()}
                for s, acts in zip(states, judgement.acts, strict=True)
            ],
            "minimum_is_unique": [s.unique for s in states],
            "unproven_because": [s.reason for s in states],
        }
        claims = [list(_claims(run, judgement, number)) for number in range(count)]
        found = [*agree(run), *ended(run, judgement.gap)]
        found += _packing(run.samples) if isinstance(run.samples, StoredPacking) else _driving(run.samples)
        found += [*_arrays(run, judgement), *_threshold(run), *_states(run, judgement), *summed_up(run, claims)]
        found += _history(run, judgement)
        unseen = not_checked(run, {claim.name for claim in claims[0] if claim.is_sure})
    report = told if count > 1 else {name: values[0] for name, values in told.items()}
    return report | {"proof": proof, "contradictions": found, "not_checked": unseen, "arithmetic": ARITHMETIC}


def together(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """The reports of several replicas of a packing as one, in which contradictions name the replica."""
    found = {name: [report[name] for report in reports] for name in (*OF_SAMPLES, "proof")}
    said = [f"sample {n}: {text}" for n, report in enumerate(reports) for text in report["contradictions"]]
    unseen = dict.fromkeys(name for report in reports for name in report["not_checked"])
    return reports[0] | found | {"contradictions": said, "not_checked": [*unseen]}


def _finite(values: np.ndarray) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values.tolist()]


def _driving(samples: Samples) -> Iterator[str]:
    """The spins of the driven spheres are those that the scene imposes, and each plane turns as one.

    They are sums of the bottom's and of the jump, each known to some 2^-100: a spin far below both is known no better.
    """
    lost = 2.0**-98 * (abs(samples.spin_top) + abs(samples.spin_bottom))
    largest = {"bottom": 0.0, "top": 0.0}
    sign, height = samples.sublattice.ravel(), samples.shape[-1]
    for at, k in enumerate(samples.components):
        parts = [
            part.reshape(samples.count, sign.size, -1)[..., at] * sign for part in (samples.spin, samples.spin_rounding)
        ]
        layer, leader = samples.layer(k)[::height], samples.leader(k)[0, : sign.size : height]
        on_top = samples.imposed_in_layers(k)
        low = on_top[0] if k < samples.dimension - 1 else [samples.states[0][k]]
        for first, name, imposed in ((0, "bottom", low), (height - 1, "top", on_top[1])):
            values = np.array([float(value) for value in imposed])
            expected = values[layer]
            largest[name] += float((values**2).max())
            uneven = any((part[:, first::height] != part[:, leader + first]).any() for part in parts)
            allowed = 4 * EPS * np.abs(expected) + EPS * abs(samples.spin_top if first else samples.spin_bottom) + lost
            if uneven or (np.abs(parts[0][:, first::height] - expected) > allowed).any():
                yield f"the spins of the {name} about {'xyz'[k]} are not those that the scene imposes"
    for name, said in (("bottom", samples.spin_bottom), ("top", samples.spin_top)):
        true = float(np.sqrt(largest[name]))
        if samples.top is not None and not abs(said - true) <= max(ROUNDED * true, 2 * lost):
            yield f"the largest spin of the {name} is said to be {said!r}; it is another"


def _packing(packing: StoredPacking) -> Iterator[str]:
    """What is stored is a packing: unit normals, each contact once, and imposed spins of driven spheres."""
    contact, normal, imposed = (packing.arrays[name] for name in ("contact", "normal", "spin"))
    held = packing.arrays["driven"] >= 0
    if not (np.abs(packing.spin - imposed)[held] <= 4 * EPS * np.abs(imposed)[held]).all():
        yield "the spins of driven spheres are not those imposed"
    size = np.linalg.norm(normal, axis=1)
    if (bad := np.abs(size - 1) > NORMAL_ERROR).any():
        e = int(np.argmax(bad))
        yield f"the normal of contact {e} has length {float(size[e])!r}; it must be a unit vector"
    low, high = np.sort(contact, axis=1).T
    outward = np.where((contact[:, 0] == low)[:, None], normal, -normal)
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    same &= np.linalg.norm(outward[order][1:] - outward[order][:-1], axis=1) < NORMAL_ERROR
    if same.any():
        twins = order[int(np.argmax(same)) :][:2]
        yield f"contacts {twins[0]} and {twins[1]} are of the same two spheres, at the same place"


def _arrays(run: StoredRun, judgement: Judgement) -> Iterator[str]:
    """Slip, power, force and state of every contact follow from spins, friction and coefficients. Forces and states of
    a dynamics are of its own: of viscous contacts they follow from the slips, of Coulomb's they are within the static
    friction, and at the kinetic one where a contact is said to slip."""
    slip, power, force, state = (run.reported[name] for name in ("slip", "power", "force", "state"))
    acts, limit, size, is_lattice = judgement.acts, judgement.limit, judgement.friction_size, run.samples.is_lattice
    strange = ~(np.abs(slip - judgement.slip) <= ROUNDED * judgement.slip)
    slip = np.where(strange, judgement.slip, slip)  # of infinite ones no product says anything
    expected = judgement.damping * slip**2 + (limit * slip if judgement.holds else 0.0)
    expected = np.where(acts | (not is_lattice), expected, 0.0)  # driven contacts of packings are beside the power
    wrong = {
        "slips that are not those of the spins": strange,
        "powers that are not friction or damping times slip": ~(np.abs(power - expected) <= ROUNDED * expected),
        "states other than 0, 1, 2 and 3": ~np.isin(state, (SLIPLESS, SLIPPING, UNPROVEN, DRIVEN_STATE)),
        "states that do not name those between driven spheres and those absent": (state == DRIVEN_STATE) == acts,
        "friction between driven spheres, or where there is none": ~acts & (size > 0),
        "friction along the contacts themselves": judgement.friction_along,
        "forces that are not finite or negative": ~(np.isfinite(force) & (force >= 0)),
    }
    if not run.is_dynamics:
        lost = ROUNDED * size + LOST_SQUARE * judgement.force_unit
        wrong["forces that are not those of the friction"] = ~(np.abs(force - size) <= lost)
    elif not judgement.holds:
        expected = np.where(acts, limit * slip, 0.0)
        wrong["forces that are not damping times slip"] = ~(np.abs(force - expected) <= ROUNDED * expected)
    if not judgement.flows:
        most = max(run.setting("static_ratio", 1.0), 1.0) * (1 + MISSED_LIMIT)
        slips = (state == SLIPPING) & run.is_dynamics
        wrong["forces that exceed their friction"] = (force > most * limit) & (is_lattice | run.is_dynamics)
        wrong["less than all their friction and are said to slip"] = slips & (
            force < (1 - MISSED_LIMIT) * (1 - ROUNDED) * limit
        )
    if "slip_bound" in run.reported and judgement.slip_bound is not None:
        close = np.isclose(run.reported["slip_bound"], judgement.slip_bound, ROUNDED, 0.0)
        wrong["bounds of the slip that are not those that spins and friction prove"] = ~close
    for what, mask in wrong.items():
        if mask.any():
            yield f"{int(mask.sum()):,} contacts have {what}"


def _threshold(run: StoredRun) -> Iterator[str]:
    """No contact that is said not to slip is faster than the threshold, none that is said to slip slower.

    But a method that knows more than the slip may say so; then the threshold is the largest slip of a slipless contact.
    """
    threshold, asked = run.claimed("slip_threshold")[0], run.settings.get("slip_threshold")
    if not run.samples.is_lattice and asked is None:
        return
    if threshold is None or not 0 <= threshold < np.inf:
        yield f"the slip threshold is said to be {threshold!r}; it must be a speed"
        return
    if asked is not None and asked != threshold:
        yield f"the slip threshold is said to be {threshold!r}; the scene asks for {asked!r}"
    slips, states = run.reported["slip"], run.reported["state"]
    largest = float(slips[states == SLIPLESS].max(initial=0.0))
    if largest > threshold * (1 + ROUNDED):
        yield f"contacts that are said not to slip are faster ({largest!r}) than the threshold {threshold!r}"
    least = float(slips[states == SLIPPING].min(initial=np.inf))
    if least <= threshold * (1 - ROUNDED) and not (asked is None and abs(threshold - largest) <= ROUNDED * largest):
        yield f"contacts that are said to slip are slower ({least!r}) than the threshold {threshold!r}"


def _states(run: StoredRun, judgement: Judgement) -> Iterator[str]:
    """The states that the file gives are not refuted, and what it says to be proven is."""
    for number, found in enumerate(judgement.states):
        which, given = of_sample(run, number), run.reported["state"][number]
        proven, tied, unique, cut, unproven = (
            run.claimed(name)[number]
            for name in ("states_proven", "tied_contacts", "minimum_is_unique", "cut_is_unique", "unproven")
        )
        rests = np.where(found.proven == CRITICAL, SLIPLESS, found.proven)
        wrong = int((np.isin(rests, (SLIPLESS, SLIPPING)) & (given == SLIPLESS + SLIPPING - rests)).sum())
        if wrong and _is_minimum(run, number):
            yield f"{wrong} contact states{which} are not those of any minimum"
        if proven and not found.agree(given):
            reason = f": {found.reason}" if found.reason else ""
            yield f"the contact states{which} are said to be proven, and are not{reason}"
        if found.unique and tied:
            yield f"{tied} contacts{which} are said to differ between minima, and there is only one minimum"
        if unique and not found.unique:
            yield f"the minimum{which} is said to be unique, and that is not proven"
        exact = run.samples.is_lattice and len(judgement.network.needed) == 1  # then the method knows ties exactly
        if run.samples.is_lattice and ((proven and not unique) or (exact and unique is None and tied)):
            yield f"it is said whether the minimum{which} is unique, and other words say something else"
        if cut not in (None, not tied):
            yield f"the cut{which} is said to be unique or not, and {tied} contacts to differ between minima"
        if unique is False and (found.unique or not (exact or found.unique is False)):
            yield f"the minimum{which} is said not to be unique, and that is not proven"
        if proven is False and unproven == 0 and found.agree(given):
            yield f"the states{which} are said not to be proven, and each of them is"
        known = np.where(given == DRIVEN_STATE, DRIVEN_STATE, rests)
        if "proven" in run.reported:
            said = run.reported["proven"][number]
            weaker = (said == UNPROVEN) & (known != DRIVEN_STATE) & run.samples.is_lattice
            if false := int(((said != known) & ~weaker).sum()):
                yield f"{false} contacts{which} are said to be proven what they are not"
            if "unproven" in run.attributes and unproven != (count := int((said == UNPROVEN).sum())):
                yield f"unproven{which}: the summary says {unproven!r}, the arrays {count!r}"
        least, most = int((known == TIED).sum()), int(np.isin(known, (TIED, UNPROVEN)).sum())
        if tied is not None and not least <= tied <= most:
            yield f"{tied} contacts{which} are said to differ between minima; what is proven allows {least} to {most}"


def _is_minimum(run: StoredRun, number: int) -> bool:
    """A dynamics on its way gives the states of its own motion, and a threshold those of slower contacts, too. Where
    the force grows with the slip, a contact that is proven to slip at the minimum does so now."""
    moves = run.samples.is_lattice or run.is_dynamics
    ended_there = run.samples.flows or run.claimed("status")[number] == "certified" or not moves
    return bool(ended_there) and "slip_threshold" not in run.settings


def _claims(run: StoredRun, judgement: Judgement, number: int) -> Iterator[Claim]:
    """What the summary says of a sample is what was computed anew, or what the arrays and the history hold."""
    samples = run.samples
    objective, bound = float(judgement.objective[number]), float(judgement.lower_bound[number])
    (power,), (gap,) = _finite(judgement.power[[number]]), _finite(judgement.gap[[number]])
    yield Claim("power", power, side=1, needed=True)
    yield Claim("lower_bound", bound, side=-1, needed=True)
    if samples.holds and samples.flows:
        yield Claim("potential", _finite(judgement.objective[[number]])[0], side=1, needed=True)
    yield Claim("gap", gap, beside=4 * EPS, side=1, needed=True)
    slip, force, state = (run.reported[name][number] for name in ("slip", "force", "state"))
    kinds = [slip[state == kind] for kind in (SLIPLESS, SLIPPING, UNPROVEN)]
    for kind, name in zip(kinds, ("slipless", "slipping", "undecided"), strict=True):
        yield Claim(name, len(kind), source="the arrays")
    for column, name in (("time", "time"), ("energy_residual", "energy_residual"), ("iteration", "iterations")):
        rows = _row(run.history.get(column), number)
        if rows is not None and len(rows):
            yield Claim(name, _finite(rows[-1:])[0], off=0.0, source="the history")
    if not isinstance(samples, Samples):
        yield Claim("contacts", int((state != DRIVEN_STATE).sum()), source="the arrays")
        full = force >= (1 - MISSED_LIMIT) * judgement.limit[0]
        full &= judgement.limit[0] * np.where(np.isfinite(slip), slip, judgement.slip[0]) <= objective - bound
        yield Claim("critical", int((full & (state == UNPROVEN) & samples.holds).sum()), source="the arrays")
        yield Claim("largest_balance_residual", float(judgement.largest_torque[0]))
        yield Claim("driven_power", judgement.driven_power)
        yield Claim("spheres", len(samples.spin), source="the arrays")
        yield Claim("driven_spheres", int((samples.arrays["driven"] >= 0).sum()), source="the arrays")
        unproven = int(((judgement.states[0].proven == UNPROVEN) & judgement.acts[0]).sum())
        yield Claim("unproven", unproven)
        yield Claim("states_proven", judgement.states[0].agree(state))
        yield Claim("slip_threshold", run.setting("slip_threshold", 0.0))
        yield Claim("proof", judgement.proof)
        yield Claim("shape", None)
        yield from _under_torque(run, judgement, number)
        return
    network = judgement.network
    between = ~network.free[network.contact[:, : force.size]].any(axis=0)  # in all samples
    yield Claim("contacts", int((~between).sum()), source="the arrays")
    yield Claim("largest_slipless_slip", float(kinds[0].max()) if len(kinds[0]) else None, source="the arrays")
    yield Claim("smallest_slipping_slip", float(kinds[1].min()) if len(kinds[1]) else None, source="the arrays")
    unit = samples.normal_force * samples.radius * abs(samples.spin_top)
    if not samples.flows and unit > 0:
        yield Claim("power_normalised", None if power is None else power / unit)
    rows = judgement.largest_torque[[number]]
    if run.is_dynamics:
        rows = _row(run.history.get("largest_balance_residual"), number)
    if rows is not None:
        value = _finite(rows[-1:])[0] if len(rows) else None
        yield Claim("largest_balance_residual", value, needed=True, is_sure=not run.is_dynamics)
    yield from _under_torque(run, judgement, number)


def _under_torque(run: StoredRun, judgement: Judgement, number: int) -> Iterator[Claim]:
    """Whether a torque moves the top follows from the bounds on the power of strength 1, but for coulomb-viscous and a
    bottom that turns."""
    samples, beside = run.samples, 0.0
    if isinstance(samples, Samples):
        turns = bool(samples.spin_bottom)
    else:  # the last body stands for the top, contacts among driven spheres add to what it takes
        driven, beside = samples.arrays["driven"], judgement.driven_power
        turns = samples.arrays["spin"][(driven >= 0) & (driven < driven.max())].any()
    if "yields" not in run.attributes or (samples.holds and samples.flows) or turns:
        return
    torque, power = run.setting("torque", np.nan), float(judgement.power[number]) + beside
    low = float(judgement.lower_bound[number])
    low = (low + beside) * (1 - 4 * EPS) if beside else low  # of sums that are rounded
    high, low = (power * ROUNDED_UP, low) if samples.holds else (0.0, 0.0)
    most = run.claimed("yield_torque")[number]  # if that is true, a torque beyond it is not held
    said = run.claimed("yield_torque_lower_bound")[number]  # a little less may be said, and then less is held
    moves, held = abs(torque) > (high if most is None else most), said is not None and abs(torque) <= said
    strength = np.array([torque / power if samples.flows and moves and power else np.nan])
    yield Claim("yields", bool(moves), needed=True)
    yield Claim("yield_torque", high, needed=True)
    yield Claim("yield_torque_lower_bound", low, side=-1, needed=True)
    yield Claim("amplitude", 0.0 if held else _finite(strength)[0], needed=True)


def _history(run: StoredRun, judgement: Judgement) -> Iterator[str]:
    """No bound of the history is above the power, no power below the bound."""
    least = "potential" if run.samples.holds and run.samples.flows else "power"
    for number in range(run.samples.count):
        if judgement.lower_bound[number] > judgement.objective[number] * (1 + 2 * EPS):
            yield f"the lower bound{of_sample(run, number)} is above the {least}: the numbers contradict themselves"
        bounds, powers = (_row(run.history.get(name), number) for name in ("lower_bound", least))
        if bounds is not None and (bounds > judgement.upper_bound[number] * (1 + ROUNDED)).any():
            yield f"a lower bound of the history is above the least {least}"
        if powers is not None and (powers < judgement.lower_bound[number] * (1 - ROUNDED)).any():
            yield f"a {least} of the history is below the least {least}"


def _row(column: np.ndarray | None, number: int) -> np.ndarray | None:
    return None if column is None else np.asarray(column if column.ndim == 1 else column[number], dtype=float)
