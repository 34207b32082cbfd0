"""Other distributions of the friction coefficients in three dimensions: what of the paper's findings holds for them.

In two dimensions the least power is the minimum cut's whatever the distribution: `fig1`. Equal coefficients, or two
values, leave minima that tie; then the slipless network of the state found is one of many, and it is not judged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.stages import stage

from ..plots.distributions import Case, draw_distributions
from .claims import Claim, Effort, Share, judge
from .network import BULK, PRACTICALLY_ALL
from .samples import SAME, measured, save_both

SPREAD = ("uniform:0.1,1", "uniform:0.5,1", "uniform:0.9,1", "lognormal:0.4,1", "power-law:0.001,1,-1")
"""Distributions whose values all differ; the first is the paper's."""
TIED = ("bimodal:0.1,1,0.5",)
EQUAL = "constant:0.5"
SHARE_OF_SAMPLES = 0.25


@dataclass(frozen=True)
class Sample:
    """A certified sample. decades : of power of the contacts that slip, None where that is not
    proven. Fractions are of the free
    spheres."""

    power_over_cut: float
    below_cut: bool
    gap: float
    states_proven: bool
    spans: bool
    reached_fraction: float
    slipless_fraction: float
    decades: float | None


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write distributions.png, .pdf and .csv into `folder`; returns the claims with their verdicts."""
    runtime.start("cpu", "f64")
    seeds = range(effort.seed, effort.seed + max(1, int(SHARE_OF_SAMPLES * effort.samples)))
    points = list(product((*SPREAD, *TIED, EQUAL), seeds))
    chosen = [RunSettings(shape=(BULK,) * 3, seed=seed, distribution=name) for name, seed in points]
    found: dict[str, list[Sample]] = {}
    for (name, _), numbers in zip(points, measured(chosen, numbers_of, folder / "distributions.jsonl"), strict=True):
        found.setdefault(name, []).append(Sample(**numbers))
    names = ["distribution", "seed", *Sample.__dataclass_fields__]
    samples = [sample for of in found.values() for sample in of]
    rows = [[*point, *_written(sample)] for point, sample in zip(points, samples, strict=True)]
    write_csv(folder / "distributions.csv", names, rows)
    with stage("drawing"):
        cases = {name: case_of(samples) for name, samples in found.items()}
        save_both(draw_distributions(cases), folder, "distributions")
    return [_below_cut(found), _equal(found[EQUAL]), _reaches(found), _spans(found)]


def _written(sample: Sample) -> list[Any]:
    return [float("nan") if value is None else value for value in asdict(sample).values()]


def numbers_of(structure: Structure) -> dict[str, Any]:
    """A Sample as a mapping."""
    network, scene = structure.network, structure.scene
    power = scene.law.power(scene.contact, structure.slip[None])[0][structure.state == ContactState.SLIPPING]
    power = power[power > 0]
    found = Sample(
        power_over_cut=structure.power / structure.interface.power,
        below_cut=bool(structure.power < structure.interface.lower_bound * (1 - SAME)),
        gap=(structure.power - structure.lower_bound) / structure.power,
        states_proven=bool(structure.states_proven),
        spans=network.spans,
        reached_fraction=network.reached_fraction,
        slipless_fraction=len(network.axis) / scene.lattice.contacts,
        decades=float(np.log10(power.max() / power.min())) if structure.states_proven else None,
    )
    return asdict(found)


def case_of(samples: Sequence[Sample]) -> Case:
    """What the figure shows of a distribution."""
    span = Share.of([sample.spans for sample in samples])
    return Case(
        power_over_cut=np.array([sample.power_over_cut for sample in samples]),
        spans=(span.least, span.hits / span.samples, span.most),
        slipless=np.array([sample.slipless_fraction for sample in samples]),
        decades=np.array([sample.decades for sample in samples], dtype=float),
        proven=2 * sum(sample.states_proven for sample in samples) > len(samples),
    )


def _below_cut(found: Mapping[str, Sequence[Sample]]) -> Claim:
    random = {name: samples for name, samples in found.items() if name != EQUAL}
    shares = {name: Share.of([one.below_cut for one in samples]) for name, samples in random.items()}
    ratio = {name: [one.power_over_cut for one in samples] for name, samples in random.items()}
    numbers = {"minimum_over_cut": ratio, "below": {name: share.hits for name, share in shares.items()}}
    return judge(
        "distributions.below_cut",
        numbers,
        bulk=BULK,
        found={name: {"share": shares[name], "ratio": ratio[name]} for name in random},
        shares=shares,
        own=shares[SPREAD[0]],
        others=[share for name, share in shares.items() if name != SPREAD[0]],
        fails=[name for name, share in shares.items() if share.most <= 0.5],
        means=[np.mean(values) for values in ratio.values()],
    )


def _equal(samples: Sequence[Sample]) -> Claim:
    numbers = {"apart": max(abs(one.power_over_cut - 1) for one in samples), "gap": max(one.gap for one in samples)}
    return judge("distributions.equal", numbers, name=EQUAL, samples=len(samples))


def _judged(found: Mapping[str, Sequence[Sample]]) -> dict[str, list[Sample]]:
    """Samples whose contact states are proven, of the distributions whose values all differ."""
    return {name: [one for one in found[name] if one.states_proven] for name in SPREAD}


def _reaches(found: Mapping[str, Sequence[Sample]]) -> Claim:
    judged = _judged(found)
    least = {name: min(one.reached_fraction for one in samples) for name, samples in judged.items() if samples}
    told = {name: {"least_share": least.get(name, np.nan), "number": len(of)} for name, of in judged.items()}
    least_of_all = f"at least {min(least.values()):.4f}" if least else "no sample"
    return judge("distributions.reaches", {"least": least}, bulk=BULK, practically=PRACTICALLY_ALL, found=told,
                 least_of_all=least_of_all, samples=min(map(len, judged.values())))  # fmt: skip


def _spans(found: Mapping[str, Sequence[Sample]]) -> Claim:
    shares = {name: Share.of([one.spans for one in of]) for name, of in _judged(found).items()}
    paper, others = shares[SPREAD[0]], [shares[name] for name in SPREAD[1:]]
    numbers = {name: {"spans": share.hits, "samples": share.samples} for name, share in shares.items()}
    return judge(
        "distributions.spans", numbers, bulk=BULK, shares=shares, paper_name=SPREAD[0],
        differ=any(share.least > paper.most or share.most < paper.least for share in others),
        samples=min(share.samples for share in shares.values()),
        hits=[f"{share.hits} of {share.samples}" for share in shares.values()],
    )  # fmt: skip
