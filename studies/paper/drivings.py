"""Other imposed bearing states: which leave the problem the same, and what those that do not make of the network.

In staggered spins the planes are held at two constant vectors, and P depends on differences alone. So only the jump
between them counts, its length is a factor of P, and mirrors turn the sign of each component. Its component along the
height drops out: contacts across the layers do not feel it, so it may change from layer to layer at no cost. What is
left is |d_x| : |d_y|, one angle from 0 to 90 degrees. Bearing states A + C x have a fourth number, C: where that of
both planes differs, the jump varies over the plane.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.stages import stage

from ..plots.drivings import draw_drivings
from .claims import Claim, Effort, Share, judge
from .network import BULK
from .samples import measured, save_both

MOST_SAMPLES = 10
REFERENCE = "axis (1, 1, 0), omega_B = 0"
SAME: dict[str, dict[str, Any]] = {  # the same problem, rescaled, shifted or mirrored
    "omega_B = 0.1 omega_T": {"spin_bottom": 0.1},
    "omega_B = -omega_T": {"spin_bottom": -1.0},
    "omega_T = 3, omega_B = 0.5": {"spin_top": 3.0, "spin_bottom": 0.5},
    "axis (1, -1, 0)": {"direction": (1.0, -1.0, 0.0)},
    "axis (1, 1, 1)": {"direction": (1.0, 1.0, 1.0)},
    "A_z = 2 above, -1 below": {"top": (1.0, 1.0, 2.0, 0.0), "bottom": (0.0, 0.0, -1.0, 0.0)},
    "A and C of both raised": {"top": (1.5, 1.25, 0.25, 0.5), "bottom": (0.5, 0.25, 0.25, 0.5)},
}
RATES = [0.001, 0.01, 0.1, 0.3, 1.0, 10.0, 1000.0]  # C of the top beside A = (1, 1, 0), for the lattice spacing 1
OTHER = [(1.0, 0.0, 0.0), (4.0, 1.0, 0.0), (2.0, 1.0, 0.0), (10.0, 9.0, 0.0), (1.0, 2.0, 0.0), (1.0, 4.0, 0.0),
         (0.0, 1.0, 0.0)]  # fmt: skip
HEIGHT = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Driven:
    """A certified sample under one driving.

    slipless : mask of the contacts. power : over F_n R times the jump across the height (times the jump itself where it
    has no such part). over_cut : P_min / P_cut, 1 where both are 0. gap : proven, relative.
    """

    slipless: np.ndarray
    power: float
    over_cut: float
    gap: float
    angle: float


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write drivings.png, .pdf and .csv into `folder`; returns the claims with their verdicts."""
    runtime.start("cpu", "f64")
    seeds = range(effort.seed, effort.seed + max(1, min(MOST_SAMPLES, effort.samples // 4)))
    drivings: dict[str, dict[str, Any]] = (
        {REFERENCE: {}}
        | SAME
        | {axis_name(axis): {"direction": axis} for axis in (*OTHER, HEIGHT)}
        | {rate_name(rate): {"top": (1.0, 1.0, 0.0, rate), "bottom": (0.0, 0.0, 0.0, 0.0)} for rate in RATES}
    )
    points = list(product(drivings, seeds))
    chosen = [RunSettings(shape=(BULK,) * 3, seed=seed, **drivings[name]) for name, seed in points]
    found: dict[str, list[Driven]] = {}
    for (name, _), numbers in zip(points, measured(chosen, numbers_of, folder / "drivings.jsonl"), strict=True):
        slipless = np.array(numbers.pop("slipless"), dtype=bool)
        found.setdefault(name, []).append(Driven(slipless, **numbers))
    write_samples(folder / "drivings.csv", found, seeds)
    others = [found[axis_name(axis)] for axis in OTHER]
    with stage("drawing"):
        shown = sorted([found[REFERENCE], *others], key=lambda samples: samples[0].angle)
        angles = np.array([samples[0].angle for samples in shown])
        kept = np.array([overlaps(samples, found[REFERENCE]) for samples in shown])
        ratio = np.array([[sample.over_cut for sample in samples] for samples in shown])
        rates = [found[rate_name(rate)] for rate in RATES]
        kept_at = np.array([overlaps(samples, found[REFERENCE]) for samples in rates])
        save_both(draw_drivings(angles, kept, ratio, np.array(RATES), kept_at), folder, "drivings")
    return [
        _speeds(found, seeds),
        _axis(found, seeds),
        _rate(found, seeds),
        _one_component([found[axis_name(axis)] for axis in OTHER if 0.0 in axis[:2]]),
        _height(found[axis_name(HEIGHT)]),
    ]


def axis_name(axis: tuple[float, float, float]) -> str:
    return f"axis ({', '.join(f'{part:g}' for part in axis)})"


def rate_name(rate: float) -> str:
    return f"A = (1, 1, 0), C = {rate:g}"


def numbers_of(structure: Structure) -> dict[str, Any]:
    """A Driven as a mapping."""
    scene = structure.scene
    jump, cut = np.abs(scene.driving.jump.spin[0]), structure.interface.power
    unit = scene.normal_force * scene.lattice.radius * (np.hypot(*jump[:2]) or np.linalg.norm(jump))
    return {
        "slipless": structure.network.slipless.astype(int).tolist(),
        "power": float(structure.power / unit),
        "over_cut": float(structure.power / cut) if cut else 1.0,
        "gap": float((structure.power - structure.lower_bound) / structure.power) if structure.power else 0.0,
        "angle": float(np.degrees(np.arctan2(jump[1], jump[0]))),
    }


def overlaps(samples: Sequence[Driven], reference: Sequence[Driven]) -> list[float]:
    """Contacts slipless under both drivings over those slipless under either, sample by sample."""
    pairs = [(a.slipless, b.slipless) for a, b in zip(samples, reference, strict=True)]
    return [float((a & b).sum() / (a | b).sum()) for a, b in pairs]


def changes(samples: Sequence[Driven], reference: Sequence[Driven]) -> list[int]:
    """Contacts that are slipless under one of both drivings alone."""
    return [int((a.slipless != b.slipless).sum()) for a, b in zip(samples, reference, strict=True)]


def write_samples(path: Path, found: Mapping[str, Sequence[Driven]], seeds: Sequence[int]) -> None:
    rows = []
    for name, samples in found.items():
        numbers = zip(
            seeds, samples, changes(samples, found[REFERENCE]), overlaps(samples, found[REFERENCE]), strict=True
        )
        rows += [[name, s, d.angle, d.power, d.over_cut, d.gap, changed, kept] for s, d, changed, kept in numbers]
    names = ["driving", "seed", "angle", "power_over_jump", "power_over_cut", "gap", "contacts_that_differ", "overlap"]
    write_csv(path, names, rows)


def _speeds(found: Mapping[str, Sequence[Driven]], seeds: Sequence[int]) -> Claim:
    reference = found[REFERENCE]
    changed = {name: changes(found[name], reference) for name in SAME}
    spread = max(abs(a.power / b.power - 1) for name in SAME for a, b in zip(found[name], reference, strict=True))
    differ = sum(map(sum, changed.values()))
    numbers = {"seeds": list(seeds), "contacts_that_differ": changed, "spread": spread}
    return judge("drivings.speeds", numbers, bulk=BULK, differ=differ, answer="no" if differ else "yes")


def _axis(found: Mapping[str, Sequence[Driven]], seeds: Sequence[int]) -> Claim:
    return _changed("drivings.axis", found, [axis_name(axis) for axis in OTHER], seeds)


def _rate(found: Mapping[str, Sequence[Driven]], seeds: Sequence[int]) -> Claim:
    return _changed("drivings.rate", found, [rate_name(rate) for rate in RATES], seeds)


def _changed(key: str, found: Mapping[str, Sequence[Driven]], names: Sequence[str], seeds: Sequence[int]) -> Claim:
    """Whether any of these drivings changes the network."""
    changed = {name: changes(found[name], found[REFERENCE]) for name in names}
    kept = {name: overlaps(found[name], found[REFERENCE]) for name in names}
    told = {n: {"angle": found[n][0].angle, "changed": changed[n], "kept": kept[n]} for n in names}
    touched = Share.of([any(column) for column in zip(*changed.values(), strict=True)])
    numbers = {"seeds": list(seeds), "contacts_that_differ": changed, "overlap": kept}
    return judge(key, numbers, bulk=BULK, found=told, touched=touched)


def _one_component(along: Sequence[Sequence[Driven]]) -> Claim:
    samples = [sample for of_axis in along for sample in of_axis]
    apart, gap = max(abs(sample.over_cut - 1) for sample in samples), max(sample.gap for sample in samples)
    return judge("drivings.one_component", {"apart": apart, "gap": gap}, samples=len(samples))


def _height(samples: Sequence[Driven]) -> Claim:
    return judge("drivings.height", {"power": [sample.power for sample in samples]})
