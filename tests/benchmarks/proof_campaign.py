"""Everything that runs claim to have proven, against the least power in 140 digits, on random small scenes.

    python tests/benchmarks/proof_campaign.py --scenes 1000 --kind all --seed 0 --out outputs/proofs.jsonl

A scene is drawn from its kind, the seed, its number and the methods alone. With --out, results are added to a file of
JSON lines, and scenes that it has already are not run again. Prints a table and a line for each false proof, with the
command that repeats it; the exit code is 1 if there is one. False proofs, with their size:

    bound        the lower bound is above the minimum, relative to it
    certificate  the status is certified, but the power is further from the minimum than the tolerance
    gap          the power is further above the minimum than the gap says
    state        contacts of `states_proven` that are wrong at every minimum, or at some; or of which something else is
                 proven than is true
    name         contacts that are called slipping, slipless, critical or tied, and are something else (kind `names`)
    perturbed    contacts of `states_proven` that are wrong once coefficients change by random factors 1 + 1e-40 u
    slip-bound   a minimiser slips faster than `slip_bound`, relative to it
    unique       `cut_is_unique`, but there are more minimisers
    crash        an exception that is no InputError

Those of nearly equal driving that are as small as rounding the imposed spins makes the jump wrong have `-imposed` after
their name, and a column of their own. Beside them, `wrong states` counts contacts of unproven states that are wrong at
every minimum, and `power below` runs whose power is below the minimum by more than 1e-12.
"""

# ruff: noqa: E402

import argparse
import json
import os
import shlex
import sys
import time
import traceback
from collections import defaultdict
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from taichi_bearings_studies.stress import truth as truths

from taichi_bearings.errors import InputError
from taichi_bearings.proof.contact_state import SATURATED, ContactState, unresolved
from taichi_bearings.proof.contact_state import critical as critical_contacts
from taichi_bearings.runs.run import Job, Run, prepare, solve_job, summarise
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Status

KINDS = ("ties", "contrast", "direction", "driving", "continuous", "viscous", "names", "states", "periodic")
METHODS = {  # share of the runs
    "auto": 0.3,
    "interior-point": 0.34,
    "operator-splitting": 0.14,
    "gradient-descent": 0.12,
    "planar-cut": 0.08,
    "rigid-limit": 0.02,
    "linear-solver": 1.0,
}
PLANAR = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 3.0), (0.0, -2.0, 1.0))  # a single component
SHAPES_3D = (
    "2,2,3", "2,2,3", "2,3,3", "3,2,4", "3,3,3", "3,3,3", "2,2,5", "2,2,8", "4,3,3", "4,4,3", "5,4,3", "3,3,5",
    "2,5,4", "4,4,4",
)  # fmt: skip
SHAPES_OF_NAMES = ("3,3,4", "3,3,5", "3,4,4", "4,3,4", "4,4,4", "3,4,5")
DISTRIBUTIONS_OF_NAMES = (  # two values apart, near and whole; one; three whole ones
    "bimodal:0.1,1.0,0.5", "bimodal:0.1,1.0,0.5", "bimodal:1.0,2.0,0.5", "bimodal:2.0,3.0,0.3", "bimodal:1.0,3.0,0.7",
    "constant:0.5", "integers", "integers", "five-values",
)  # fmt: skip
DRAWN_HERE = {  # not among the distributions of the program
    "integers": lambda rng, shape: rng.integers(1, 4, shape).astype(float),
    "five-values": lambda rng, shape: rng.choice(np.random.default_rng(5).uniform(0.1, 1.0, 5), shape),
}
SHAPES_2D = ("2,3", "3,3", "3,4", "4,4", "6,4", "5,5", "2,9", "8,3", "6,6")
MIXED = ("ties", "ties", "contrast", "continuous")  # disorder of periodic lattices
ITERATIONS = 20_000  # limit of every run, and its wall time in seconds
TIME_LIMIT = 20.0
PERTURBATION = Decimal("1e-40")
PERTURBED = 1e-12  # slip over the largest slip above which a perturbed minimum contradicts "slipless"
ROUNDING = 1e-14  # by which the gap may be too small
BELOW = 1e-12
AT_LIMIT = 1e-18  # margin in the middle of the optimal forces below which a contact is at its limit
STRICT = 4e-16  # rounding of the true slips


def draw_settings(kind: str, seed: int, number: int, methods: tuple[str, ...]) -> dict:
    """Settings of one scene, as words of the command line."""
    rng = np.random.default_rng([seed, KINDS.index(kind), number])
    if kind == "names":
        return _draw_names(rng)
    planar = rng.random() < 0.2
    flat = rng.random() < 0.15
    settings = {"shape": str(rng.choice(SHAPES_2D if flat else SHAPES_3D)), "seed": int(rng.integers(1, 10**6))}
    if kind == "periodic":
        settings |= _periodic(settings["shape"], rng)
    settings["distribution"] = _distribution(str(rng.choice(MIXED)) if kind == "periodic" else kind, rng)
    if kind == "viscous":
        settings["law"] = "viscous"
    settings |= _states(rng, flat) if kind == "states" else _driving(rng, wild=kind == "driving" or rng.random() < 0.1)
    if not flat and kind != "states":
        direction = _direction(rng, planar, wild=kind == "direction" or rng.random() < 0.1)
        if direction is not None:
            settings["direction"] = ",".join(repr(float(v)) for v in direction)
    single = flat or (planar and "direction" in settings)
    usable = [m for m in methods if m in _allowed(kind, single)]
    if not usable:
        return {}
    weights = np.array([METHODS[m] for m in usable])
    settings["method"] = str(rng.choice(usable, p=weights / weights.sum()))
    settings["tolerance"] = float(rng.choice([1e-4, 1e-6, 1e-8, 1e-10, 1e-12], p=[0.1, 0.1, 0.6, 0.1, 0.1]))
    settings["initial"] = str(rng.choice(["linear", "random", "minimum-cut"], p=[0.7, 0.2, 0.1]))
    if kind == "viscous" or settings["method"] in ("planar-cut", "auto"):
        settings["initial"] = "linear"
    if rng.random() < 0.08:
        settings["replicas"] = 2
    return settings | {"iterations": ITERATIONS, "time_limit": TIME_LIMIT, "threads": 1}


def _periodic(shape: str, rng: np.random.Generator) -> dict:
    """Sides made even that close on themselves: one or both."""
    *sides, height = map(int, shape.split(","))
    closed = rng.random(len(sides)) < 0.6
    closed[rng.integers(len(sides))] = True
    sides = [side + side % 2 if is_closed else side for side, is_closed in zip(sides, closed, strict=True)]
    names = ",".join(name for name, is_closed in zip("xy", closed, strict=False) if is_closed)
    return {"shape": ",".join(map(str, (*sides, height))), "periodic": names}


def _draw_names(rng: np.random.Generator) -> dict:
    """Friction of few values, two components, the method that settles every contact."""
    shape, distribution = rng.choice(SHAPES_OF_NAMES), rng.choice(DISTRIBUTIONS_OF_NAMES)
    settings = {"shape": str(shape), "seed": int(rng.integers(1, 10**6)), "distribution": str(distribution)}
    return settings | {"method": "auto", "tolerance": 1e-8, "iterations": ITERATIONS, "threads": 1}


def _allowed(kind: str, single: bool) -> tuple[str, ...]:
    if kind == "viscous":
        return ("auto", "linear-solver", "gradient-descent")
    rest = ("auto", "interior-point", "operator-splitting", "gradient-descent", "rigid-limit")
    return (*rest, "planar-cut") if single else rest


def _distribution(kind: str, rng: np.random.Generator) -> str:
    def number(value: float) -> str:
        return repr(float(value))

    if kind == "ties":
        low, ratio = rng.choice([1.0, 0.3, 0.1]), rng.choice([2, 2, 2, 1.5, 3, 4, 10, 1e2, 1e3, 1e6, 1e9, 1e12])
        fraction = rng.choice([0.5, 0.5, 0.1, 0.3, 0.8, 0.9])
        pick = rng.random()
        if pick < 0.25:
            return f"constant:{number(low)}"
        return f"bimodal:1.0,2.0,{number(fraction)}" if pick < 0.5 else _bimodal(low, ratio, fraction)
    if kind == "contrast":
        decades = rng.uniform(4, 18)
        pick = rng.random()
        if pick < 0.5:
            exponent = rng.choice([-1.0, -1.0, -0.5, -2.0, 0.0])
            return f"power-law:{number(10 ** (-decades / 2))},{number(10 ** (decades / 2))},{number(exponent)}"
        if pick < 0.75:
            return f"lognormal:1.0,{number(min(decades, 14) * 2.302585 / 5)}"
        return _bimodal(10 ** (-decades / 2), 10**decades, rng.choice([0.5, 0.2, 0.8]))
    pick = rng.random()
    if pick < 0.5:
        return "uniform:0.1,1.0"
    if pick < 0.75:
        return f"lognormal:0.5,{number(rng.choice([0.3, 1.0, 2.0]))}"
    return f"power-law:{number(10 ** -rng.uniform(0.5, 3))},1.0,{number(rng.choice([-1.0, -1.5, 0.5]))}"


def _bimodal(low: float, ratio: float, fraction: float) -> str:
    return f"bimodal:{float(low)!r},{float(low * ratio)!r},{float(fraction)!r}"


def _states(rng: np.random.Generator, flat: bool) -> dict:
    """Bearing states on both planes: alike, nearly alike, with layers whose jump vanishes, far from each other."""
    if flat:
        return {name: repr(float(rng.choice([1.0, -0.3, 0.0, 1e-9]))) for name in ("top", "bottom")}
    found, small = {}, float(10 ** -rng.uniform(2, 12))
    for name in ("top", "bottom"):
        spins = rng.choice([0.0, 1.0, -1.0, 0.5, small], 3)
        rate = float(rng.choice([0.0, 1.0, -1.0, 0.5, 0.3, small, 1 / small]))
        found[name] = ",".join(repr(float(spin)) for spin in spins) + f";{rate!r}"
    return found


def _driving(rng: np.random.Generator, wild: bool) -> dict:
    if not wild:
        return {} if rng.random() < 0.7 else {"spin_bottom": float(rng.choice([0.1, -0.4, -1.0, 0.5]))}
    pick, top = rng.random(), 1.0
    if pick < 0.45:
        bottom = 1 - 10 ** -rng.uniform(2, 15)
    elif pick < 0.6:
        bottom = float(rng.choice([0.999999999999, 1 - 1e-6, 1 + 1e-9]))
    elif pick < 0.75:
        bottom = -rng.uniform(0, 3)
    else:
        top = float(rng.choice([-1.0, 1.0])) * 10 ** rng.uniform(-14, 14)
        bottom = float(rng.choice([0.0, 0.1, -1.0, 0.9999999])) * top
    found = {"spin_top": top, "spin_bottom": float(bottom)}
    if rng.random() < 0.4:
        found["normal_force"] = float(10 ** rng.uniform(-14, 14))
    if rng.random() < 0.3:
        found["radius"] = float(10 ** rng.uniform(-6, 6))
    return found


def _direction(rng: np.random.Generator, planar: bool, wild: bool) -> tuple[float, ...] | None:
    if planar:
        return PLANAR[rng.integers(len(PLANAR))]
    if not wild:
        return None
    small = float(10 ** -rng.uniform(2, 10))
    choices = [
        (1.0, small, 0.0), (small, 1.0, 0.0), (1.0, small, 0.0), (1.0, -small, 1.0), (small, small**2, 1.0),
        (1.0, 1e-8, 0.0), (1.0, 1.0, 1.0), (2.0, -1.0, 0.5), (1.0, 1 + small, 0.0), (0.3, 0.7, 0.0),
    ]  # fmt: skip
    return choices[rng.integers(len(choices))]


def command(settings: dict) -> str:
    words = ["bearings", "run"]
    for key, value in settings.items():
        words += ["--" + key.replace("_", "-"), repr(value) if isinstance(value, float) else str(value)]
    return shlex.join(words)


@dataclass
class Verdict:
    """What one run claims and what of it is false: (name, size, note) each."""

    imposed: float = 0.0  # relative error of the jump if imposed spins are rounded, where that is much
    false: list = field(default_factory=list)
    wrong_states: int = 0
    power_below: float = 0.0
    names: dict = field(default_factory=dict)  # kind of contact -> how many, and how many of them are proven
    freedom: int = 0
    true_gap: float = 0.0
    unknown: int = 0

    def blame(self, name: str, size: float, note: str = "") -> None:
        if name in ("bound", "certificate", "gap", "slip-bound") and abs(size) <= self.imposed:
            name += "-imposed"
        self.false.append([name, float(size), note])


def judge(solution, summary: dict, replica: int, settings: RunSettings, perturbations: int) -> Verdict:
    """The claims about one replica."""
    scene, verdict = solution.scene, Verdict(_imposed(settings))
    sample = scene.sample(replica)
    truth = truths.least(sample, of_all=scene.law.holds)
    status = summary["status"][replica] if scene.replicas > 1 else summary["status"]
    _judge_power(verdict, solution, replica, truth, status == Status.CERTIFIED.value, settings.tolerance)
    if truth.state:
        _judge_states(verdict, solution, replica, truth)
        if solution.states_proven[replica]:
            for number in range(perturbations):
                other = truths.least(sample, of_all=True, perturbed=(number, PERTURBATION))
                _judge_perturbed(verdict, solution, replica, other)
    return verdict


def _imposed(settings: RunSettings) -> float:
    if settings.top is not None:
        return 0.0
    jump = abs(settings.spin_top - settings.spin_bottom)
    ratio = max(abs(settings.spin_top), abs(settings.spin_bottom)) / jump if jump else 0.0
    return 4 * np.finfo(np.float64).eps * ratio if ratio > 1e2 else 0.0


def _judge_power(
    verdict: Verdict, solution, replica: int, truth: truths.Truth, certified: bool, tolerance: float
) -> None:
    power, bound = (Decimal(float(v[replica])) for v in (solution.power, solution.lower_bound))
    minimum = truth.upper
    if bound > minimum:
        verdict.blame("bound", float((bound - minimum) / minimum) if minimum > 0 else float(bound))
    if power == 0 or minimum == 0:
        return
    above = verdict.true_gap = float((power - minimum) / power)
    verdict.power_below = max(-above, 0.0)
    if certified and abs(above) > tolerance + ROUNDING:
        verdict.blame("certificate", above, f"tolerance {tolerance:g}")
    if above > solution.gap[replica] + ROUNDING:
        verdict.blame("gap", above, f"gap {solution.gap[replica]:.2g}")


def _judge_states(verdict: Verdict, solution, replica: int, truth: truths.Truth) -> None:
    lattice, claim, bound = solution.scene.lattice, solution.state[replica], solution.slip_bound[replica]
    true, slip = lattice.flat(truth.state), lattice.flat(truth.slip)
    slipless, slipping = claim == ContactState.SLIPLESS, claim == ContactState.SLIPPING
    opposite = np.flatnonzero((slipless & (true == truths.SLIPPING)) | (slipping & (true == truths.SLIPLESS)))
    either = int(((slipless | slipping) & (true == truths.EITHER)).sum())
    verdict.freedom, verdict.unknown = truth.freedom, int((true == truths.UNCLEAR).sum())
    faster = slip > bound * (1 + STRICT)
    _judge_names(verdict, solution, replica, truth)
    if faster.any():
        excess = (slip[faster] / np.maximum(bound[faster], 1e-300) - 1).max()
        verdict.blame("slip-bound", excess, f"{faster.sum()} contacts")
    if solution.states_proven[replica]:
        if len(opposite):
            lower = np.stack(np.unravel_index(lattice.ends[0], lattice.shape), axis=1).tolist()
            notes = [
                f"{'xyz'[lattice.axis[n]]}{tuple(lower[n])} claimed to slip by {solution.slip[replica, n]:.1e} and "
                f"slips by {slip[n]:.1e}"
                for n in opposite[:3]
            ]
            verdict.blame("state", len(opposite), "wrong at every minimum: " + "; ".join(notes))
        if either:
            verdict.blame("state", either, "wrong at some minimum")
    else:
        verdict.wrong_states = len(opposite)
    unique = solution.findings.get("cut_is_unique")
    if unique is not None and unique[replica] and truth.freedom:
        verdict.blame("unique", truth.freedom)


PROVEN = {
    ContactState.SLIPLESS: (truths.SLIPLESS, truths.DRIVEN),
    ContactState.SLIPPING: (truths.SLIPPING,),
    ContactState.TIED: (truths.EITHER,),
}


def _judge_names(verdict: Verdict, solution, replica: int, truth: truths.Truth) -> None:
    """What each contact is called, and what is proven of it."""
    lattice, called, known = solution.scene.lattice, called_of(solution, replica), solution.proven[replica]
    true, margin = lattice.flat(truth.state), lattice.flat(truth.margin)
    right = np.where(true == truths.SLIPLESS, np.where(margin < AT_LIMIT, "critical", "slipless"), "slipping")
    right = np.select(
        [true == truths.EITHER, true == truths.DRIVEN, true == truths.UNCLEAR], ["tied", "driven", called], right
    )
    names = defaultdict(lambda: [0, 0])
    for one, of, sure in zip(called.tolist(), right.tolist(), (known != ContactState.UNDECIDED).tolist(), strict=True):
        counted = names[one if one == of else f"{one}, truly {of}"]
        counted[0] += 1
        counted[1] += sure
    verdict.names = dict(names)
    known = np.where(true == truths.UNCLEAR, ContactState.UNDECIDED, known)
    false = sum(int(((known == what) & ~np.isin(true, allowed)).sum()) for what, allowed in PROVEN.items())
    if false:
        verdict.blame("state", false, "something else is proven")
    wrong = int(((called != right) & (called != OPEN)).sum())
    if wrong and solution.method == "interior-point":
        verdict.blame("name", wrong)


OPEN = "tied or undecided"


def called_of(solution, replica: int) -> np.ndarray:
    """Names (E,) of the contacts. Files count critical and tied ones; which is which follows where it is proven, or
    where as many are at their limit as are said to be critical."""
    state, known, scene = solution.state[replica], solution.proven[replica], solution.scene
    full = solution.force[replica] >= SATURATED * scene.strength * scene.coefficient[replica]
    limit = (state == ContactState.UNDECIDED) & (known != ContactState.TIED) & unresolved(solution)[replica] & full
    if limit.sum() != critical_contacts(solution)[replica]:
        limit &= known != ContactState.UNDECIDED
    plain = [state == which for which in (ContactState.SLIPLESS, ContactState.SLIPPING, ContactState.DRIVEN)]
    names = np.select([known == ContactState.TIED, limit], ["tied", "critical"], OPEN)
    return np.select(plain, ["slipless", "slipping", "driven"], names)


def _judge_perturbed(verdict: Verdict, solution, replica: int, truth: truths.Truth) -> None:
    claim, flat = solution.state[replica], solution.scene.lattice.flat
    true, slip = flat(truth.state), flat(truth.slip)
    moves = (true == truths.SLIPPING) & (slip > PERTURBED * slip.max())
    wrong = int(((claim == ContactState.SLIPLESS) & moves).sum())
    wrong += int(((claim == ContactState.SLIPPING) & (true == truths.SLIPLESS)).sum())
    if wrong:
        verdict.blame("perturbed", wrong)


def _job(words: dict) -> tuple[RunSettings, Job]:
    """Settings and scene of these words."""
    own = DRAWN_HERE.get(words["distribution"])
    settings = RunSettings(**(words if own is None else words | {"distribution": "constant:1.0"}))
    job = prepare(settings, strict=False)
    if own is None:
        return settings, job
    lattice, rng = job.scene.lattice, np.random.default_rng(words["seed"])
    coefficients = tuple(own(rng, lattice.contact_shape(axis))[None] for axis in range(lattice.dimension))
    return settings, replace(job, scene=replace(job.scene, coefficients=coefficients))


def run_scene(words: dict, perturbations: int) -> dict:
    """One line of results."""
    began = time.perf_counter()
    try:
        settings, job = _job(words)
    except InputError as refused:
        return {"refused": str(refused)}
    try:
        solution = solve_job(job)
        summary = summarise(Run(settings, solution))
    except Exception as error:
        traceback.print_exc()
        return {"false": [["crash", 1.0, f"{type(error).__name__}: {error}"]], "method": words["method"]}
    solved = time.perf_counter()
    verdicts = [judge(solution, summary, r, settings, perturbations) for r in range(settings.replicas)]
    return {
        "method": solution.method,
        "status": summary["status"],
        "power": summary["power"],
        "lower_bound": summary["lower_bound"],
        "gap": summary["gap"],
        "proven": [bool(v) for v in solution.states_proven],
        "freedom": [v.freedom for v in verdicts],
        "true_gap": [v.true_gap for v in verdicts],
        "power_below": max(v.power_below for v in verdicts),
        "wrong_states": sum(v.wrong_states for v in verdicts),
        "unknown": sum(v.unknown for v in verdicts),
        "names": [v.names for v in verdicts],
        "false": [blame for v in verdicts for blame in v.false],
        "seconds": solved - began,
        "seconds_truth": time.perf_counter() - solved,
    }


def print_table(lines: list[dict]) -> None:
    groups = defaultdict(list)
    for line in lines:
        if "refused" not in line:
            groups[line["kind"], line["method"]].append(line)
    columns = ("bound", "certificate", "gap", "state", "name", "perturbed", "slip-bound", "unique", "crash", "imposed")
    print("\n| kind | method | runs | certified | proven | " + " | ".join(columns), end="")
    print(" | wrong states | power below | s | s truth |")
    print("|" + "---|" * (9 + len(columns)))
    for (kind, method), found in sorted(groups.items()):
        row = [kind, method, len(found), sum("certified" in np.ravel(f.get("status", "")) for f in found)]
        row.append(sum(any(f.get("proven", [])) for f in found))
        row += [
            sum(
                any(name in (b[0], b[0].rpartition("-")[2] if b[0].endswith("imposed") else "") for b in f["false"])
                for f in found
            )
            for name in columns
        ]
        row.append(sum(f.get("wrong_states", 0) for f in found))
        row.append(sum(f.get("power_below", 0.0) > BELOW for f in found))
        row += [f"{np.mean([f.get(k, 0.0) for f in found]):.2f}" for k in ("seconds", "seconds_truth")]
        print("| " + " | ".join(map(str, row)) + " |")
    refused = sum("refused" in line for line in lines)
    for kind in sorted({line["kind"] for line in lines}):
        _print_names(kind, [line for line in lines if line["kind"] == kind])
    print(f"\n{len(lines)} scenes, {refused} refused, {sum(line.get('unknown', 0) for line in lines)} contacts unknown")


def _print_names(kind: str, lines: list[dict]) -> None:
    """How many contacts are called what, of runs that settle them."""
    total = defaultdict(lambda: [0, 0])
    for line in lines:
        for names in line.get("names", []) if line.get("method") == "interior-point" else []:
            for name, counted in names.items():
                total[name] = [total[name][0] + counted[0], total[name][1] + counted[1]]
    total.pop("driven", None)
    words = [f"{name} {number:,} ({proven:,} proven)" for name, (number, proven) in sorted(total.items())]
    print(f"{kind}, contacts of interior-point: {'; '.join(words)}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=100, help="of each kind")
    parser.add_argument("--first", type=int, default=0, help="number of the first scene")
    parser.add_argument("--kind", default="all", choices=("all", *KINDS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--methods", default=",".join(METHODS), help="to draw from, by commas")
    parser.add_argument("--perturb", type=int, default=1, help="perturbed minima to compare proven states with")
    parser.add_argument("--out", type=Path, help="file of JSON lines to add to and to go on from")
    options = parser.parse_args()
    kinds = KINDS if options.kind == "all" else (options.kind,)
    methods = tuple(options.methods.split(","))
    done = {}
    if options.out and options.out.exists():
        texts = options.out.read_text(encoding="utf-8").splitlines()
        done = {line["key"]: line for line in map(json.loads, texts)}
    lines = []
    for number in range(options.first, options.first + options.scenes):
        for kind in kinds:
            key = f"{kind}/{options.seed}/{number}/{options.methods}"
            if key not in done:
                words = draw_settings(kind, options.seed, number, methods)
                if not words:
                    continue
                line = {"key": key, "kind": kind, "command": command(words)} | run_scene(words, options.perturb)
                for name, size, note in line.get("false", []):
                    print(f"{kind}: {name} {size:.3g} {note}: {line['command']}", flush=True)
                if options.out:
                    with options.out.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(line) + "\n")
                done[key] = line
            lines.append(done[key])
    print_table(lines)
    false = [line for line in lines if line.get("false")]
    print(f"{len(false)} runs with a false proof")
    for line in false:
        what = ", ".join(f"{name} {size:.2g}" + (f" ({note})" if note else "") for name, size, note in line["false"])
        print(f"{line['kind']} | {what} | {line['command']}")
    return 1 if false else 0


if __name__ == "__main__":
    sys.exit(main())
