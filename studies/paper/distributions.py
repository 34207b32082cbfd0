"""Other distributions of the friction coefficients in three dimensions: what of the paper's findings holds for them.

In two dimensions the least power is the minimum cut's whatever the distribution: `fig1`. Equal coefficients, or two
values, leave minima that tie; then the slipless network of the state found is one of many, and it is not judged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.stages import alike, each, stage

from ..plots.distributions import Case, draw_distributions
from .claims import FEWEST, HALF, Claim, Effort, Share, every, interval_of_mean
from .network import BULK, PRACTICALLY_ALL, SAME, certified
from .samples import save_both

SPREAD = (
    "uniform:0.1,1",
    "uniform:0.5,1",
    "uniform:0.9,1",
    "lognormal:0.4,1",
    "power-law:0.001,1,-1",
)  # values that all differ
TIED = ("bimodal:0.1,1,0.5",)
EQUAL = "constant:0.5"
SHARE_OF_SAMPLES = 0.25
ROUND_OFF = 1e-9  # relative difference of powers that are the same


@dataclass(frozen=True)
class Sample:
    """A certified sample. decades : of power of the contacts that slip, if that is proven. Fractions are of the free
    spheres."""

    power_over_cut: float
    below_cut: bool
    gap: float
    states_proven: bool
    spans: bool
    reached_fraction: float
    slipless_fraction: float
    decades: float


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write distributions.png, .pdf and .csv into `folder`; returns the claims with their verdicts."""
    runtime.start("cpu", "f64")
    seeds = range(effort.seed, effort.seed + max(1, int(SHARE_OF_SAMPLES * effort.samples)))
    found: dict[str, list[Sample]] = {}
    for name in each((*SPREAD, *TIED, EQUAL), "distribution", alike):
        shape = (BULK, BULK, BULK)
        found[name] = [sample_of(RunSettings(shape=shape, seed=seed, distribution=name)) for seed in seeds]
    names = ["distribution", "seed", *Sample.__dataclass_fields__]
    write_csv(
        folder / "distributions.csv",
        names,
        [[name, seed, *vars(one).values()] for name, of in found.items() for seed, one in zip(seeds, of, strict=True)],
    )
    with stage("drawing"):
        cases = {name: case_of(samples) for name, samples in found.items()}
        save_both(draw_distributions(cases), folder, "distributions")
    return [_below_cut(found), _equal(found[EQUAL]), _reaches(found), _spans(found)]


def sample_of(settings: RunSettings) -> Sample:
    structure = certified(settings)
    view, scene = structure.view, structure.scene
    power = scene.law.power(scene.contact, structure.slip[None])[0][structure.state == ContactState.SLIPPING]
    power = power[power > 0]
    return Sample(
        power_over_cut=structure.power / structure.interface.power,
        below_cut=bool(structure.power < structure.interface.lower_bound * (1 - SAME)),
        gap=(structure.power - structure.lower_bound) / structure.power,
        states_proven=structure.states_proven,
        spans=view.spans,
        reached_fraction=view.reached_fraction,
        slipless_fraction=view.slipless / scene.lattice.contacts,
        decades=float(np.log10(power.max() / power.min())) if structure.states_proven else float("nan"),
    )


def case_of(samples: Sequence[Sample]) -> Case:
    """What the figure shows of a distribution."""
    proven = sum(sample.states_proven for sample in samples)
    span = Share(sum(sample.spans for sample in samples), len(samples))
    return Case(
        power_over_cut=np.array([sample.power_over_cut for sample in samples]),
        spans=(span.least, span.hits / span.samples, span.most),
        slipless=np.array([sample.slipless_fraction for sample in samples]),
        decades=np.array([sample.decades for sample in samples]),
        proven=2 * proven > len(samples),
    )


def _below_cut(found: Mapping[str, Sequence[Sample]]) -> Claim:
    random = {name: samples for name, samples in found.items() if name != EQUAL}
    below = {name: Share(sum(one.below_cut for one in samples), len(samples)) for name, samples in random.items()}
    ratio = {name: [one.power_over_cut for one in samples] for name, samples in random.items()}
    words = "; ".join(
        f"{name}: {below[name]}, P_min / P_cut {np.mean(ratio[name]):.4f} ({interval_of_mean(ratio[name])})"
        for name in random
    )
    judged = {name: share.above(HALF) for name, share in below.items()}
    fails = [name for name, share in below.items() if share.most <= HALF]
    means = [np.mean(values) for values in ratio.values()]
    others = [name for name in judged if name != SPREAD[0]]
    return Claim(
        "In 3D the least power is below that of the minimum cut, for other distributions of the coefficients too.",
        f"{BULK}^3, proven in {words} (limit: more than half of the samples of each distribution; where some fail the "
        f"claim is refined, where all others do it is refuted). It fails for {', '.join(fails) or 'none'}: the "
        "disorder must be strong enough to pay for a cut that is not flat.",
        judged[SPREAD[0]]["confirmed"] and any(judged[name]["confirmed"] for name in others),
        {"minimum_over_cut": ratio, "below": {name: share.hits for name, share in below.items()}},
        refined=bool(fails),
        samples=min(share.samples for share in below.values()),
        needed=max(judged[SPREAD[0]]["needed"], min(judged[name]["needed"] for name in others)),
        paper="generally below, for uniform friction",
        ours=f"P_min / P_cut from {min(means):.3f} to {max(means):.3f}",
        uncertainty="; ".join(f"{name}: {share.interval}" for name, share in below.items()),
        after_data="that a distribution which fails refines the claim" if fails else "",
    )


def _equal(samples: Sequence[Sample]) -> Claim:
    apart, gap = max(abs(one.power_over_cut - 1) for one in samples), max(one.gap for one in samples)
    return Claim(
        "Beyond the paper: it takes disorder. With equal coefficients the least power is that of a flat cut.",
        f"{EQUAL}: P_min / P_cut differs from 1 by {apart:.1e} (limit {ROUND_OFF:g}), P_min proven within {gap:.0e}. "
        "Each column bears at most mu F_n, and does with the same friction in all its contacts.",
        apart <= ROUND_OFF,
        {"apart": apart, "gap": gap},
        samples=len(samples),
        kind="theorem",
        paper="not given",
        ours=f"P_min = P_cut to {apart:.0e}",
        uncertainty="none but rounding: a theorem",
    )


def _judged(found: Mapping[str, Sequence[Sample]]) -> dict[str, list[Sample]]:
    """Samples whose contact states are proven, of the distributions whose values all differ."""
    return {name: [one for one in found[name] if one.states_proven] for name in SPREAD}


def _reaches(found: Mapping[str, Sequence[Sample]]) -> Claim:
    judged = _judged(found)
    least = {name: min((one.reached_fraction for one in samples), default=np.nan) for name, samples in judged.items()}
    words = "; ".join(f"{name} {least[name]:.4f} ({len(judged[name])})" for name in judged)
    return Claim(
        "The slipless network attains practically every sphere, for other distributions too.",
        f"{BULK}^3, least share of the free spheres that touch a slipless contact, and samples with proven states: "
        f"{words} (limit: {PRACTICALLY_ALL:g} in each).",
        all(value >= PRACTICALLY_ALL for value in least.values()),
        {"least": {name: float(value) for name, value in least.items() if np.isfinite(value)}},
        samples=min(len(samples) for samples in judged.values()),
        needed=FEWEST,
        paper="practically every sphere",
        ours=f"at least {np.nanmin(list(least.values())):.4f}" if any(judged.values()) else "no sample",
        uncertainty=f"each distribution: {every(min(len(samples) for samples in judged.values()))}",
        after_data="the limit 0.99, set after first results for uniform friction",
    )


def _spans(found: Mapping[str, Sequence[Sample]]) -> Claim:
    spans = {name: Share(sum(one.spans for one in of), len(of)) for name, of in _judged(found).items()}
    paper, others = spans[SPREAD[0]], [spans[name] for name in SPREAD[1:]]
    differ = [share for share in others if share.least > paper.most or share.most < paper.least]
    return Claim(
        "Beyond the paper: how often the network joins bottom and top depends on the distribution.",
        f"{BULK}^3: {'; '.join(f'{name} {share}' for name, share in spans.items())} (limit: an interval apart from "
        f"that of {SPREAD[0]}).",
        bool(differ),
        {name: {"spans": share.hits, "samples": share.samples} for name, share in spans.items()},
        samples=min(share.samples for share in spans.values()),
        needed=1 if differ else 1 + min(share.samples for share in spans.values()),
        paper="not given",
        ours=", ".join(f"{share.hits} of {share.samples}" for share in spans.values()),
        uncertainty="; ".join(f"{name}: {share.interval}" for name, share in spans.items()),
    )
