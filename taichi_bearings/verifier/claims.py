"""What a file says in words: known ones, that agree with each other and with the numbers; and what nobody can check."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from taichi_bearings.verifier.stored_run import StoredRun

DYNAMIC = ("stationary", "finished")  # ends of a dynamics alone
STATUSES = ("certified", *DYNAMIC, "stalled", "step-limit", "time-limit", "interrupted", "not-finite")
CHECKED = {
    "power", "potential", "lower_bound", "gap", "law", "shape", "seed", "contacts", "slipping", "slipless", "undecided",
    "critical", "states_proven", "unproven", "largest_slipless_slip", "smallest_slipping_slip", "separation_decades",
    "spin_top", "spin_bottom", "normal_force", "radius", "power_normalised", "minimum_is_unique", "cut_is_unique",
    "findings", "duration", "coefficients", "scene", "schema", "schema_version", "sha256",
}  # fmt: skip
"""Attributes that are recomputed, or that others of the file leave no choice."""
CHECKED_SETTINGS = {
    "law", "shape", "periodic", "spin_top", "spin_bottom", "top", "bottom", "normal_force", "radius", "seed",
    "replicas",
}  # fmt: skip
ON_HOST = {"arch": "cpu", "precision": "f64"}
DESCRIPTIONS = "units and descriptions"


def of_sample(run: StoredRun, number: int) -> str:
    """Words that name a sample where there are several."""
    return f" of sample {number}" if run.samples.count > 1 else ""


def agree(run: StoredRun) -> Iterator[str]:
    """The scene in the file, from which it can be run again, is the one whose numbers these are."""
    settings, samples = run.settings, run.samples
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
    tolerance, is_dynamics = run.setting("tolerance", 1e-8), "time" in run.history
    if not 0 < tolerance < 1:
        yield f"the tolerance is {tolerance!r}; it must be between 0 and 1"
    duration = run.settings.get("duration")
    for number, status in enumerate(run.claimed("status")):
        which, said = of_sample(run, number), run.claimed("gap")[number]
        cut_short = duration is not None and status in ("step-limit", "time-limit")
        if status not in STATUSES:
            yield f"the status{which} is {status!r}; it must be one of {', '.join(STATUSES)}"
        elif status == "certified" and not (said is not None and max(said, gap[number]) <= tolerance):
            yield f"the run{which} is said to be certified to {tolerance!r}; what is proven leaves {gap[number]!r}"
        elif status != "certified" and said is not None and said <= tolerance and not cut_short:
            yield f"the run{which} is said to be {status}; its gap of {said!r} is within the tolerance of {tolerance!r}"
        elif status in DYNAMIC and not is_dynamics:
            yield f"the run{which} is said to be {status}, and is no dynamics"
        elif status == "finished" and not _is_over(run, duration):
            yield f"the run{which} is said to be finished, before the duration of {duration!r}"


def _is_over(run: StoredRun, duration: Any) -> bool:
    times = run.history["time"].reshape(-1)
    return isinstance(duration, (int, float)) and len(times) > 0 and bool(times[-1] >= duration * (1 - 1e-9))


def not_checked(run: StoredRun, judged: bool) -> list[str]:
    """Names of what is in the file and that nothing is held against, or too little to find a false word: attributes,
    `scene.` and a key of the scene, data sets and groups. judged : False for numbers that no arithmetic can judge."""
    if not judged:
        return ["everything but the status"]
    samples, settings, is_dynamics = run.samples, run.settings, "time" in run.history
    sure, keys = set(CHECKED), set(CHECKED_SETTINGS)
    if "iteration" in run.history:
        sure |= {"iterations"}
    sure |= {name for name in ("time", "energy_residual") if name in run.history}
    if not ((samples.holds and samples.flows) or samples.spin_bottom or isinstance(settings.get("torque"), str)):
        sure, keys = sure | {"yields", "yield_torque", "yield_torque_lower_bound", "amplitude"}, keys | {"torque"}
    if not is_dynamics:
        sure |= {"largest_balance_residual"}
    if set(run.claimed("status")) == {"certified"}:
        sure |= {"status"}
    if settings.get("method") != "auto":
        sure |= {"method"}
    if samples.dimension == 3 and samples.top is None:
        keys |= {"direction"}
    if samples.top is not None:
        keys -= {"spin_top", "spin_bottom"}
    if "slip_threshold" in settings:
        sure, keys = sure | {"slip_threshold"}, keys | {"slip_threshold"}
    if is_dynamics and "duration" in settings:
        keys |= {"duration"}
    if is_drawn(run):
        keys |= {"distribution", *(["viscosity"] if samples.viscosity else [])}
    found = [name for name in run.attributes if name not in sure]
    found += [f"scene.{key}" for key in settings if key not in keys]
    found += run.others
    if is_dynamics:
        found += ["contact/*/friction", *(["contact/*/force"] if samples.holds else [])]
    if not is_drawn(run):
        found += ["coefficient", *(["viscosity"] if samples.viscosity else [])]
    return [*found, DESCRIPTIONS]
