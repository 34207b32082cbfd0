"""Other imposed bearing states: which leave the problem the same, and what those that do not make of the network.

In staggered spins the planes are held at two constant vectors, and P depends on differences alone. So only the jump
between them counts, its length is a factor of P, and mirrors turn the sign of each component. Its component along the
height drops out: contacts across the layers do not feel it, so it may change from layer to layer at no cost. What is
left is |d_x| : |d_y|, one angle from 0 to 90 degrees.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.stages import alike, each, stage
from taichi_bearings.words import counted

from ..plots.drivings import draw_drivings
from .claims import FEWEST, Claim, Effort, Share, interval_of_mean
from .network import BULK, certified
from .samples import save_both

MOST_SAMPLES = 10
ROUND_OFF = 1e-9  # relative difference of powers that are the same
REFERENCE = "axis (1, 1, 0), omega_B = 0"
SAME: dict[str, dict[str, Any]] = {  # the same problem, rescaled, shifted or mirrored
    "omega_B = 0.1 omega_T": {"spin_bottom": 0.1},
    "omega_B = -omega_T": {"spin_bottom": -1.0},
    "omega_T = 3, omega_B = 0.5": {"spin_top": 3.0, "spin_bottom": 0.5},
    "axis (1, -1, 0)": {"direction": (1.0, -1.0, 0.0)},
    "axis (1, 1, 1)": {"direction": (1.0, 1.0, 1.0)},
}
OTHER = [
    (1.0, 0.0, 0.0),
    (4.0, 1.0, 0.0),
    (2.0, 1.0, 0.0),
    (10.0, 9.0, 0.0),
    (1.0, 2.0, 0.0),
    (1.0, 4.0, 0.0),
    (0.0, 1.0, 0.0),
]
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
        {REFERENCE: {}} | SAME | {axis_name(axis): {"direction": axis} for axis in (*OTHER, HEIGHT)}
    )
    found = {}
    for name in each(list(drivings), "driving", alike):
        found[name] = [driven(RunSettings(shape=(BULK,) * 3, seed=seed, **drivings[name])) for seed in seeds]
    write_samples(folder / "drivings.csv", found, seeds)
    others = [found[axis_name(axis)] for axis in OTHER]
    with stage("drawing"):
        shown = sorted([found[REFERENCE], *others], key=lambda samples: samples[0].angle)
        angles = np.array([samples[0].angle for samples in shown])
        kept = np.array([overlaps(samples, found[REFERENCE]) for samples in shown])
        ratio = np.array([[sample.over_cut for sample in samples] for samples in shown])
        save_both(draw_drivings(angles, kept, ratio), folder, "drivings")
    return [
        _speeds(found, seeds),
        _axis(found, seeds),
        _one_component([found[axis_name(axis)] for axis in OTHER if 0.0 in axis[:2]]),
        _height(found[axis_name(HEIGHT)]),
    ]


def axis_name(axis: tuple[float, float, float]) -> str:
    return f"axis ({', '.join(f'{part:g}' for part in axis)})"


def driven(settings: RunSettings) -> Driven:
    structure = certified(settings)
    scene, axis = structure.scene, np.abs(settings.direction)
    across = np.hypot(*axis[:2]) / np.linalg.norm(axis)
    unit = scene.normal_force * scene.lattice.radius * abs(scene.spin_top - scene.spin_bottom) * (across or 1.0)
    cut = structure.interface.power
    return Driven(
        slipless=structure.network.slipless,
        power=structure.power / unit,
        over_cut=structure.power / cut if cut else 1.0,
        gap=(structure.power - structure.lower_bound) / structure.power if structure.power else 0.0,
        angle=float(np.degrees(np.arctan2(axis[1], axis[0]))),
    )


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
    same = not any(any(counts) for counts in changed.values())
    return Claim(
        "The network of slipless contacts does not change with the imposed bearing states: their speeds.",
        f"{BULK}^3, {counted(len(seeds), 'sample')}. The same in every contact for {', '.join(SAME)}: "
        f"{'yes' if same else 'no'} (limit: no contact differs), and P over the jump to {spread:.1e} (limit "
        f"{ROUND_OFF:g}). These rescale, shift or mirror the same problem.",
        same and spread <= ROUND_OFF,
        {"seeds": list(seeds), "contacts_that_differ": changed, "spread": spread},
        samples=len(seeds),
        kind="theorem",
        paper="does not change",
        ours=f"{sum(map(sum, changed.values()))} contacts differ",
        uncertainty="none: a theorem",
    )


def _axis(found: Mapping[str, Sequence[Driven]], seeds: Sequence[int]) -> Claim:
    names = [axis_name(axis) for axis in OTHER]
    changed = {name: changes(found[name], found[REFERENCE]) for name in names}
    kept = {name: overlaps(found[name], found[REFERENCE]) for name in names}
    words = "; ".join(
        f"{name} ({found[name][0].angle:.3g} degrees): {np.mean(changed[name]):.4g} contacts differ, slipless in both "
        f"over in either {np.mean(kept[name]):.4f} ({interval_of_mean(kept[name])})"
        for name in names
    )
    touched = Share(sum(any(column) for column in zip(*changed.values(), strict=True)), len(seeds))
    return Claim(
        "The network of slipless contacts does not change with the imposed bearing states: their axis.",
        f"{BULK}^3, against the axis (1, 1, 0): {words}. It changes in {touched} (limit: no contact differs in any).",
        not touched.hits,
        {"seeds": list(seeds), "contacts_that_differ": changed, "overlap": kept},
        samples=len(seeds),
        needed=1 if touched.hits else FEWEST,
        paper="does not change",
        ours=f"changes in {touched.hits} of {counted(touched.samples, 'sample')}",
        uncertainty=touched.interval,
    )


def _one_component(along: Sequence[Sequence[Driven]]) -> Claim:
    samples = [sample for of_axis in along for sample in of_axis]
    apart, gap = max(abs(sample.over_cut - 1) for sample in samples), max(sample.gap for sample in samples)
    return Claim(
        "Beyond the paper: spins imposed about a lattice axis leave one component, and the least power is the cut's.",
        f"About (1, 0, 0) and (0, 1, 0) P_min / P_cut differs from 1 by {apart:.1e} (limit {ROUND_OFF:g}), both found "
        f"by methods of their own, in {counted(len(samples), 'case')}; P_min is proven within {gap:.0e}. The fragments "
        "of Figs. 2 to 4 need a jump in two components.",
        bool(apart <= ROUND_OFF),
        {"apart": apart, "gap": gap},
        samples=len(samples),
        kind="theorem",
        paper="not given",
        ours=f"P_min = P_cut to {apart:.0e}",
        uncertainty="none but rounding: a theorem",
    )


def _height(samples: Sequence[Driven]) -> Claim:
    most = max(sample.power for sample in samples)
    return Claim(
        "Beyond the paper: spins imposed about the height dissipate nothing.",
        f"About (0, 0, 1) P_min is at most {most:.1e} F_n R times the jump (limit {ROUND_OFF:g}): each layer turns "
        "about the height as it likes.",
        most <= ROUND_OFF,
        {"power": [sample.power for sample in samples]},
        samples=len(samples),
        kind="theorem",
        paper="not given",
        ours=f"P_min = {most:.0e}",
        uncertainty="none: a theorem",
    )
