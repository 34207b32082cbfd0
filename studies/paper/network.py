"""The slipless network in three dimensions: what the paper says of Figs. 3 and 4, over samples and sizes.

What counts as large, 24^3, was chosen after seeing which sizes span.
"""

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.analysis.network import planes_crossed
from taichi_bearings.analysis.statistics import LEAST
from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.analysis.thresholds import THRESHOLDS, View
from taichi_bearings.files.scan_journal import Journal, read_journal
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.lattice import Lattice
from taichi_bearings.runs.run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.estimate import seconds_of
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import each, stage
from taichi_bearings.words import counted, with_error

from ..plots.sizes import Column, draw_sizes
from .claims import FEWEST, HALF, Claim, Effort, Share, every, interval_of_mean
from .samples import save_both, solved

SHARE_OF_SAMPLES = {3: 1.0, 4: 1.0, 6: 0.5, 8: 0.25, 10: 0.2, 16: 0.1, 24: 0.025, 32: 0.025}
"""Side of the cube -> samples of it, as a share of those that a claim may take."""
JOURNAL = "network.jsonl"
BULK, LARGE = 10, 24  # sides: the paper's own, and from which on most samples must span
ROUND_OFF = 1e-12  # relative difference that numbers of samples may have by rounding alone
SAME = 1e-6  # relative difference up to which two powers count as the same
PRACTICALLY_ALL = 0.99  # of the free spheres
MOST = 0.5  # of the connecting paths


@dataclass(frozen=True)
class Sample:
    """One certified sample in numbers; fractions are of the free spheres, `intermediate` of those not locked to a
    driven plane in all components. reached_by_chance : mean of as many contacts at random places."""

    side: int
    seed: int
    power: float
    gap: float
    power_over_cut: float
    below_cut: bool
    slipless_fraction: float
    states_proven: bool
    unique: bool
    spans: bool
    reached_fraction: float
    reached_by_chance: float
    spanning_fraction: float
    intermediate: float
    domains: int
    largest_intermediate: int
    shortest_path: int
    planes_x: int
    planes_y: int
    disjoint_paths: int
    busiest_link_share: float
    effective_links: float
    parting_links: int
    plane_spans: bool


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write network.png, network.pdf and network.csv into `folder`; returns the claims with their verdicts."""
    runtime.start("cpu", "f64")
    chosen = [
        RunSettings(shape=(side, side, side), seed=effort.seed + number)
        for side, share in SHARE_OF_SAMPLES.items()
        for number in range(int(share * effort.samples))
    ]
    samples, views = measured(chosen, folder / JOURNAL)
    write_csv(folder / "network.csv", [item.name for item in fields(Sample)], [astuple(s) for s in samples])
    paths = {"shortest_path": columns_of([sample for sample in samples if sample.spans])["shortest_path"]}
    with stage("drawing"):
        figure = draw_sizes(columns_of(samples) | paths, {side: by_threshold(seen) for side, seen in views.items()})
        save_both(figure, folder, "network")
    (folder / JOURNAL).unlink()
    bulk = [sample for sample in samples if sample.side >= BULK]
    return [  # those that the samples can say something about
        *([_below_cut(samples)] if bulk else []),
        *([_spans(samples)] if any(sample.side >= LARGE for sample in samples) else []),
        *([_spans_by_threshold(BULK, views[BULK])] if BULK in views else []),
        *([_reaches(bulk), _intermediate(bulk)] if bulk else []),
        *([_crosses_planes(bulk), _few_links(bulk)] if any(sample.spans for sample in bulk) else []),
        _domains_by_threshold(max(views), views[max(views)]),
    ]


def measured(chosen: Sequence[RunSettings], path: Path) -> tuple[list[Sample], dict[int, list[list[View]]]]:
    """The numbers of these samples, and what thresholds and contact states show of them, by side.

    path : journal that keeps what is done when the study is interrupted; samples that it has are not solved again.
    """

    def key_of(settings: RunSettings) -> str:
        return f"{settings.shape[0]}-{settings.seed}"

    known = read_journal(path)
    missing = [settings for settings in chosen if key_of(settings) not in known]
    with Journal(path) as journal:
        for settings in each(missing, "sample", lambda settings: seconds_of(settings, structure=True) or 1.0):
            structure = certified(settings)
            views = [_plain(view) for view in (*structure.views_by_threshold, structure.view)]
            record: dict[str, Any] = {"key": key_of(settings), "sample": _plain(sample_of(structure)), "views": views}
            journal.append([record])
            known[record["key"]] = record
    found = [known[key_of(settings)] for settings in chosen]
    by_side: dict[int, list[list[View]]] = {}
    for record in found:
        by_side.setdefault(record["sample"]["side"], []).append([View(**view) for view in record["views"]])
    return [Sample(**record["sample"]) for record in found], by_side


def _plain(numbers: Sample | View) -> dict[str, Any]:
    """The same as Python's own numbers."""
    return {name: value.item() if isinstance(value, np.generic) else value for name, value in asdict(numbers).items()}


def certified(settings: RunSettings) -> Structure:
    """Structure of the sample that the settings name, at its certified minimum."""
    return structure_of(solved(build_scene(settings), InteriorPoint(), StopRule(1e-9)))


def sample_of(structure: Structure) -> Sample:
    """The numbers of one sample."""
    scene, network, view = structure.scene, structure.network, structure.view
    free = ~scene.lattice.is_driven
    kinds = structure.domains.spheres_of_kind(free)
    planes = planes_crossed(network.shortest_path)
    return Sample(
        side=scene.lattice.shape[0],
        seed=scene.seeds[0],
        power=structure.power,
        gap=(structure.power - structure.lower_bound) / structure.power,
        power_over_cut=structure.power / structure.interface.power,
        below_cut=bool(structure.power < structure.interface.lower_bound * (1 - SAME)),
        slipless_fraction=view.slipless / scene.lattice.contacts,
        states_proven=structure.states_proven,
        unique=structure.minimum_is_unique is True,
        spans=view.spans,
        reached_fraction=view.reached_fraction,
        reached_by_chance=reached_by_chance(scene.lattice, view.slipless / scene.lattice.contacts),
        spanning_fraction=view.spanning_fraction,
        intermediate=1 - (kinds["bottom"] + kinds["top"]) / int(free.sum()),
        domains=view.domains,
        largest_intermediate=view.largest_intermediate,
        shortest_path=max(len(network.shortest_path) - 1, 0),
        planes_x=planes[0],
        planes_y=planes[1],
        disjoint_paths=network.disjoint_paths.number,
        busiest_link_share=structure.bottlenecks.concentration.largest,
        effective_links=structure.bottlenecks.concentration.effective,
        parting_links=int(structure.bottlenecks.backbone.parting_links.sum()),
        plane_spans=any(bool(network.spans_within_planes(axis).any()) for axis in (0, 1)),
    )


def reached_by_chance(lattice: Lattice, density: float) -> float:
    """Share of the free spheres that contacts touch of which each is there with probability `density`."""
    contacts = np.zeros(lattice.shape)  # of each sphere
    for axis in range(lattice.dimension):
        one = np.ones(lattice.contact_shape(axis))
        for side in ((0, 1), (1, 0)):  # as the lower and as the upper sphere
            contacts += np.pad(one, [side if n == axis else (0, 0) for n in range(lattice.dimension)])
    return float((1 - (1 - density) ** contacts[~lattice.is_driven]).mean())


def columns_of(samples: Sequence[Sample]) -> dict[str, Column]:
    """Every number of Sample against the side: values, one array a side."""
    sides = sorted({sample.side for sample in samples})
    return {
        item.name: Column(
            np.array(sides),
            [np.array([float(getattr(s, item.name)) for s in samples if s.side == side]) for side in sides],
        )
        for item in fields(Sample)
    }


def by_threshold(views: Sequence[Sequence[View]]) -> dict[str, np.ndarray]:
    """Every number of View, (samples, thresholds + 1): for each of THRESHOLDS, then by the contact states."""
    return {
        item.name: np.array([[float(getattr(seen, item.name)) for seen in sample] for sample in views])
        for item in fields(View)
    }


def mean(values: Sequence[float] | np.ndarray) -> str:
    """Mean and standard error, for people; without the latter if the samples are too few for one."""
    found = np.asarray(values, dtype=float)
    if len(found) < LEAST or np.ptp(found) <= ROUND_OFF * np.abs(found).max():
        return with_error(found.mean(), np.nan)
    return with_error(found.mean(), found.std(ddof=1) / np.sqrt(len(found)))


def _by_side(samples: Sequence[Sample], name: str) -> str:
    columns = columns_of(samples)[name]
    return ", ".join(
        f"{mean(values)} at {side}^3 ({len(values)})" for side, values in zip(columns.side, columns.values, strict=True)
    )


def _numbers(samples: Sequence[Sample], *names: str) -> dict[str, Any]:
    return {"side": [sample.side for sample in samples], "seed": [sample.seed for sample in samples]} | {
        name: [getattr(sample, name) for sample in samples] for name in names
    }


def _share_by_side(samples: Sequence[Sample], name: str) -> str:
    columns = columns_of(samples)[name]
    return ", ".join(
        f"{int(values.sum())} of {len(values)} at {side}^3"
        for side, values in zip(columns.side, columns.values, strict=True)
    )


def _below_cut(samples: Sequence[Sample]) -> Claim:
    bulk = [sample.below_cut for sample in samples if sample.side >= BULK]
    always = all(sample.below_cut for sample in samples)
    return Claim(
        "In 3D the least power is below that of the minimum cut.",
        f"Proven in {_share_by_side(samples, 'below_cut')} (limit: all from {BULK}^3 on). In small samples the cut is "
        f"often the minimum itself. P_min / P_cut: {_by_side(samples, 'power_over_cut')} (samples).",
        all(bulk) and any(sample.below_cut for sample in samples),
        _numbers(samples, "power_over_cut", "below_cut", "gap"),
        refined=not always,
        samples=len(bulk),
        needed=FEWEST,
        paper="generally below",
        ours=f"P_min / P_cut {np.mean([s.power_over_cut for s in samples if s.side >= BULK]):.3f} from {BULK}^3 on",
        uncertainty=f"from {BULK}^3 on: {Share(sum(bulk), len(bulk)).interval}",
    )


def _spans(samples: Sequence[Sample]) -> Claim:
    large = [sample.spans for sample in samples if sample.side >= LARGE]
    spanning = Share(sum(large), len(large))
    return Claim(
        "Slipless contacts form a network that joins bottom and top.",
        f"They do in {_share_by_side(samples, 'spans')}. So a sample of the paper's size has such a network or not, "
        f"by chance, and a large one mostly has it: from {LARGE}^3 on {spanning}; limit: more than half. P_min "
        f"is below P_cut without it, too. Contact states are proven in {sum(s.states_proven for s in samples)} of "
        f"{counted(len(samples), 'sample')}, and that no other slips have the least power in "
        f"{sum(s.unique for s in samples)}.",
        numbers=_numbers(samples, "spans", "below_cut", "states_proven", "unique"),
        refined=not all(sample.spans for sample in samples),
        **spanning.above(HALF),
        paper="spans, one sample of 10^3",
        ours=f"{spanning.hits} of {spanning.samples} from {LARGE}^3 on",
        uncertainty=spanning.interval,
        after_data=f"what counts as large, {LARGE}^3",
    )


def _spans_by_threshold(side: int, views: Sequence[Sequence[View]]) -> Claim:
    spans = by_threshold(views)["spans"]
    differ = spans[:, 0] != spans[:, -1]
    words = ", ".join(f"{int(spans[:, k].sum())} at {threshold:g}" for k, threshold in enumerate(THRESHOLDS[:6]))
    return Claim(
        f"Beyond the paper, {side}^3: whether the network spans depends on how well slips are resolved.",
        f"Samples of {len(spans)} that span when contacts that slip less than a threshold, in units of R times the "
        f"jump, are taken for slipless: {words}; by certified contact states {int(spans[:, -1].sum())}. A solver that "
        "cannot tell tiny slips from none closes the gaps that they make (limit: one sample in which 1e-2 and "
        "certified differ).",
        bool(differ.any()),
        {"threshold": list(THRESHOLDS), "spans": spans.astype(bool).tolist()},
        samples=len(spans),
        needed=1 if differ.any() else FEWEST,
        paper="not given",
        ours=f"{int(spans[:, 0].sum())} at 1e-2, {int(spans[:, -1].sum())} certified",
        uncertainty=f"samples that differ: {Share(int(differ.sum()), len(differ)).interval}",
    )


def _reaches(bulk: Sequence[Sample]) -> Claim:
    least = min(sample.reached_fraction for sample in bulk)
    chance = np.mean([sample.reached_by_chance for sample in bulk])
    return Claim(
        "The slipless network attains practically every sphere.",
        f"Of the free spheres touch a slipless contact: {_by_side(bulk, 'reached_fraction')} (samples; limit: "
        f"{PRACTICALLY_ALL:g} of every sample, the least is {least:.4f}). That is a matter of density: as many "
        f"contacts at random places touch {_by_side(bulk, 'reached_by_chance')}. "
        f"Where a piece joins bottom and top it holds "
        f"{_by_side([sample for sample in bulk if sample.spans], 'spanning_fraction')} of them. Of the contacts are "
        f"slipless: {_by_side(bulk, 'slipless_fraction')}.",
        least >= PRACTICALLY_ALL,
        _numbers(bulk, "reached_fraction", "reached_by_chance", "spanning_fraction", "slipless_fraction"),
        refined=bool(chance >= PRACTICALLY_ALL),
        samples=len(bulk),
        needed=FEWEST,
        paper="practically every sphere",
        ours=f"{least:.4f} of them at least",
        uncertainty=every(len(bulk)),
        after_data=f"the limit {PRACTICALLY_ALL:g}",
    )


def _intermediate(bulk: Sequence[Sample]) -> Claim:
    return Claim(
        "Many spheres are in intermediate bearing states, synchronised with neither driven plane.",
        f"Share of the free spheres that no slipless contacts lock to one plane in both components: "
        f"{_by_side(bulk, 'intermediate')} (samples; limit: a tenth at least). But they are not large domains: the "
        f"largest intermediate rigid domain holds {_by_side(bulk, 'largest_intermediate')} spheres, and there are "
        f"{_by_side(bulk, 'domains')} rigid domains. Slipless contacts tie most spheres in one component only.",
        min(sample.intermediate for sample in bulk) > 0.1,
        _numbers(bulk, "intermediate", "domains", "largest_intermediate"),
        refined=True,
        samples=len(bulk),
        needed=FEWEST,
        paper="many",
        ours=f"{min(sample.intermediate for sample in bulk):.2f} of the free spheres at least",
        uncertainty=every(len(bulk)),
        after_data="the limit, a tenth",
    )


def _crosses_planes(bulk: Sequence[Sample]) -> Claim:
    within, spanning = sum(sample.plane_spans for sample in bulk), [sample for sample in bulk if sample.spans]
    return Claim(
        "A slipless path from bottom to top must go through several planes.",
        f"It must: within a plane x = const all slipless contacts tie Omega_x, so no path inside it joins two values "
        f"of Omega_x, and likewise for y. {within} of {counted(len(bulk), 'sample')} have a plane that spans by itself "
        f"(limit: none). The shortest spanning path has {_by_side(spanning, 'shortest_path')} contacts (samples that "
        f"span) and visits {_by_side(spanning, 'planes_x')} planes across x, {_by_side(spanning, 'planes_y')} across "
        f"y. Paths that share no contact: {_by_side(bulk, 'disjoint_paths')}.",
        within == 0 and all(sample.planes_x > 1 and sample.planes_y > 1 for sample in spanning),
        _numbers(bulk, "shortest_path", "planes_x", "planes_y", "disjoint_paths", "plane_spans"),
        samples=len(spanning),
        kind="theorem",
        paper="several planes",
        ours=f"at least {min(min(s.planes_x, s.planes_y) for s in spanning)} across x and y",
        uncertainty="none: a theorem",
    )


def _few_links(bulk: Sequence[Sample]) -> Claim:
    spanning = [sample for sample in bulk if sample.spans]
    least = min((sample.busiest_link_share for sample in spanning), default=1.0)
    return Claim(
        "A few links carry most of the connecting paths.",
        f"Of the shortest paths between a bottom and a top sphere the busiest link carries "
        f"{_by_side(spanning, 'busiest_link_share')} (samples that span; limit: {MOST:g} in each, the least is "
        f"{least:.3f}); the load is that of {_by_side(spanning, 'effective_links')} equal links. Links that part the "
        f"planes alone: {_by_side(spanning, 'parting_links')}.",
        least >= MOST,
        _numbers(spanning, "busiest_link_share", "effective_links", "parting_links"),
        samples=len(spanning),
        needed=FEWEST,
        paper="large betweenness",
        ours=f"the busiest carries {least:.2f} of the paths at least",
        uncertainty=every(len(spanning)),
        after_data=f"the limit {MOST:g}",
    )


def _domains_by_threshold(side: int, views: Sequence[Sequence[View]]) -> Claim:
    seen = {name: values.mean(axis=0) for name, values in by_threshold(views).items()}
    rows = "; ".join(
        f"{'certified' if k == len(THRESHOLDS) else format(THRESHOLDS[k], 'g')}: {seen['slipless'][k]:.0f} slipless, "
        f"{seen['domains'][k]:.0f} domains, largest intermediate {seen['largest_intermediate'][k]:.0f}, reached "
        f"{seen['reached_fraction'][k]:.5f}, spanning {seen['spanning_fraction'][k]:.5f}"
        for k in range(len(THRESHOLDS) + 1)
    )
    domains = by_threshold(views)["domains"]
    ratio = domains[:, 0] / domains[:, -1]
    return Claim(
        f"Beyond the paper, {side}^3: number and size of the domains depend on how well slips are resolved.",
        f"Means over {counted(len(views), 'sample')} by threshold, in units of R times the jump - {rows}. At 1e-2 "
        f"there are {mean(ratio)} times as many domains (limit: below 0.9 in each).",
        bool((ratio < 0.9).all()),
        {"threshold": list(THRESHOLDS)} | {name: values.tolist() for name, values in by_threshold(views).items()},
        samples=len(views),
        needed=FEWEST,
        paper="not given",
        ours=f"{ratio.mean():.2f} times as many at 1e-2",
        uncertainty=interval_of_mean(ratio),
    )
