"""What a file says in words and numbers: known ones, that agree with each other; and what nobody can check."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.verifier.samples import Samples
from taichi_bearings.verifier.stored_run import FOLLOWED, StoredRun

DYNAMIC = ("stationary", "finished")  # ends of a dynamics alone
STATUSES = ("certified", *DYNAMIC, "stalled", "step-limit", "time-limit", "interrupted", "not-finite")
PACKING_METHODS = ("planar-cut", "interior-point", "linear-solver", *FOLLOWED)
CHECKED = {"law", "shape", "scene", "schema", "schema_version", "sha256", "states_proven", "unproven"}
CHECKED_OF_LATTICES = CHECKED | {
    "seed", "spin_top", "spin_bottom", "normal_force", "radius", "minimum_is_unique", "cut_is_unique", "findings",
    "duration", "coefficients",
}  # fmt: skip
"""Attributes, beside claims of numbers, that others of the file leave no choice."""
CHECKED_SETTINGS = {
    "law", "shape", "periodic", "spin_top", "spin_bottom", "top", "bottom", "normal_force", "radius", "seed",
    "replicas",
}  # fmt: skip
ON_HOST = {"arch": "cpu", "precision": "f64"}
DESCRIPTIONS = "units and descriptions"


@dataclass(frozen=True)
class Claim:
    """What an attribute may say of a sample: this word, or this number, to a share `off` of its size and by so much
    beside it. side : -1 of a bound from below, which may not be above the true one at all, 1 of one from above.
    needed : it must be said. is_sure : false words are found, whatever else the file says."""

    name: str
    true: Any
    source: str = ""
    off: float = 1e-12
    beside: float = 0.0
    side: int = 0
    needed: bool = False
    is_sure: bool = True

    def allows(self, said: Any) -> bool:
        """Whole numbers and truths are of their type already."""
        if said is None or self.true is None or isinstance(self.true, str):
            return bool(said == self.true)
        is_close = abs(said - self.true) <= self.off * abs(self.true) + self.beside
        return said == self.true or bool(is_close and (said - self.true) * self.side >= 0)


def summed_up(run: StoredRun, claims: list[list[Claim]]) -> Iterator[str]:
    """What the summary claims and what is not so. claims : of each sample."""
    for number, of_one in enumerate(claims):
        for claim in of_one:
            said = run.claimed(claim.name)[number]
            if (claim.needed or claim.name in run.attributes) and not claim.allows(said):
                name, true = f"{claim.name.replace('_', ' ')}{of_sample(run, number)}", repr(claim.true)
                yield f"the {name} is said to be {said!r}; {f'{claim.source} have' if claim.source else 'it is'} {true}"


def of_sample(run: StoredRun, number: int) -> str:
    """Words that name a sample where there are several."""
    return f" of sample {number}" if run.samples.count > 1 else ""


def agree(run: StoredRun) -> Iterator[str]:
    """The scene in the file, from which it can be run again, is the one whose numbers these are."""
    settings, samples = run.settings, run.samples
    if not isinstance(samples, Samples):
        for name, told in (("law", samples.law), ("tolerance", run.attributes.get("tolerance"))):
            if name in settings and told is not None and settings[name] != told:
                yield f"the scene has {name} = {settings[name]!r}, and the file {told!r}"
        return
    seed = run.claimed("seed")
    by_spins = {"spin_top": samples.spin_top, "spin_bottom": samples.spin_bottom} if samples.top is None else {}
    expected = {
        "law": samples.law,
        "shape": list(samples.shape),
        **by_spins,
        "normal_force": samples.normal_force,
        "radius": samples.radius,
        "seed": seed[0],
        "replicas": samples.count,
    }
    for name, value in expected.items():
        if not _alike(settings.get(name), value):
            yield f"the scene has {name} = {settings.get(name)!r}, and the file {value!r}"
    if is_drawn(run) and None not in seed and seed != [*range(seed[0], seed[0] + len(seed))]:
        yield f"the seeds are said to be {seed}; those of a block follow each other"
    if (settings.get("coefficients") is None) != (run.claimed("coefficients")[0] is None):
        yield "scene and summary do not agree whether coefficients are given or drawn"
    names = np.asarray(run.attributes.get("findings", [])).reshape(-1).tolist()
    for name in names:
        if name not in run.attributes or names.count(name) > 1:
            yield f"{name!r} is said to be found, and is not in the file, or said twice"
    yield from _computed(run)
    duration = settings.get("duration") if "time" in run.history else None
    said = run.claimed("duration")[0]
    if said != duration:
        yield f"the scene has the duration {duration!r}, and the file {said!r}"


def _computed(run: StoredRun) -> Iterator[str]:
    """The method, device and precision are those of the scene, as far as it leaves no choice: "auto", and methods that
    run on the host in double precision whatever is asked for."""
    for name, open_to in (("method", "auto"), ("arch", "auto"), ("precision", "")):
        said, asked = run.claimed(name)[0], run.settings.get(name)
        if None not in (said, asked) and asked != open_to and said not in (asked, ON_HOST.get(name)):
            yield f"the scene has {name} = {asked!r}, and the file {said!r}"


def _alike(said: Any, value: Any) -> bool:
    """Equal, and of one type: neither 4.0 nor "4" is 4."""
    if isinstance(value, list):
        return isinstance(said, list) and [(type(v), v) for v in said] == [(type(v), v) for v in value]
    return type(said) is type(value) and said == value


def is_drawn(run: StoredRun) -> bool:
    """True if the scene says that the coefficients come from seeds."""
    return run.settings.get("coefficients") is None and "distribution" in run.settings


def ended(run: StoredRun, gap: np.ndarray) -> Iterator[str]:
    """How a run ended is one of the known words, and "certified" where the proven gap (R,) is within the tolerance and
    nowhere else, unless a limit came before the simulated time that was asked for."""
    tolerance, is_dynamics = run.setting("tolerance", run.attributes.get("tolerance", 1e-8)), run.is_dynamics
    if not 0 < tolerance < 1:
        yield f"the tolerance is {tolerance!r}; it must be between 0 and 1"
    duration, allowed = run.settings.get("duration"), list(STATUSES)
    if not run.samples.is_lattice:
        allowed = allowed if is_dynamics else ["certified", "stalled"]
        if "method" in run.attributes and (method := run.claimed("method")[0]) not in PACKING_METHODS:
            yield f"the method is {method!r}; it must be one of {', '.join(PACKING_METHODS)}"
    for number, status in enumerate(run.claimed("status")):
        which, said = of_sample(run, number), run.claimed("gap")[number]
        cut_short = duration is not None and status in ("step-limit", "time-limit")
        if status not in allowed:
            yield f"the status{which} is {status!r}; it must be one of {', '.join(allowed)}"
        elif status == "certified" and not (said is not None and max(said, gap[number]) <= tolerance):
            left = float(gap[number])
            yield f"the run{which} is said to be certified to {tolerance!r}; what is proven leaves {left!r}"
        elif status != "certified" and said is not None and said <= tolerance and not cut_short:
            yield f"the run{which} is said to be {status}; its gap of {said!r} is within the tolerance of {tolerance!r}"
        elif status in DYNAMIC and not is_dynamics:
            yield f"the run{which} is said to be {status}, and is no dynamics"
        elif status == "finished" and not _is_over(run, duration):
            yield f"the run{which} is said to be finished, before the duration of {duration!r}"


def _is_over(run: StoredRun, duration: Any) -> bool:
    if "time" not in run.history:
        return True
    times = run.history["time"].reshape(-1)
    return isinstance(duration, (int, float)) and len(times) > 0 and bool(times[-1] >= duration * (1 - 1e-9))


def not_checked(run: StoredRun, claimed: set[str]) -> list[str]:
    """Names of what is in the file and that nothing is held against, or too little to find a false word: attributes,
    `scene.` and a key of the scene, data sets and groups. claimed : names of attributes that were."""
    samples, settings, sets = run.samples, run.settings, list(run.others)
    if set(run.claimed("status")) == {"certified"}:
        claimed = claimed | {"status"}
    if isinstance(samples, Samples):
        sure, keys = claimed | CHECKED_OF_LATTICES, set(CHECKED_SETTINGS)
        if "yields" in claimed:
            keys |= {"torque"}
        if settings.get("method") != "auto":
            sure |= {"method"}
        if samples.dimension == 3 and samples.top is None:
            keys |= {"direction"}
        if samples.top is not None:
            keys -= {"spin_top", "spin_bottom"}
        if "slip_threshold" in settings:
            sure, keys = sure | {"slip_threshold"}, keys | {"slip_threshold"}
        if run.is_dynamics:
            keys |= {"duration"}
            sets += ["contact/*/friction", *(["contact/*/force"] if samples.holds else [])]
        drawn = {"coefficient": "distribution", **({"viscosity": "viscosity"} if samples.viscosity else {})}
        keys |= set(drawn.values()) if is_drawn(run) else set()
        sets += [] if is_drawn(run) else [*drawn]
    else:
        sure, keys = claimed | CHECKED | {"tolerance"}, {"law", "tolerance"}
        sets += [f"packing/{name}" for name in samples.arrays]
    found = [name for name in run.attributes if name not in sure]
    return [*found, *(f"scene.{key}" for key in settings if key not in keys), *sets, DESCRIPTIONS]
