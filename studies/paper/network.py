"""The slipless network in three dimensions: what the paper says of Figs. 3 and 4, over samples and sizes.

What counts as large, 24^3, was chosen after seeing which sizes span.
"""

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.lattice import Lattice
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import plain
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.stages import stage

from ..plots.sizes import THRESHOLDS, Column, draw_sizes
from .claims import Claim, Effort, Share, judge
from .samples import SAME, measured, save_both

SHARE_OF_SAMPLES = {3: 1.0, 4: 1.0, 6: 0.5, 8: 0.25, 10: 0.2, 16: 0.1, 24: 0.025, 32: 0.025}
"""Side of the cube -> samples of it, as a share of those that a claim may take."""
BULK, LARGE = 10, 24  # sides: the paper's own, and from which on most samples must span
PRACTICALLY_ALL = 0.99  # of the free spheres
View = dict[str, Any]  # as of `view_of`


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
    found = measured(chosen, numbers_of, folder / "network.jsonl")
    samples, views = [Sample(**of["sample"]) for of in found], dict[int, list[list[View]]]()
    for of in found:
        views.setdefault(of["sample"]["side"], []).append(of["views"])
    write_csv(folder / "network.csv", [item.name for item in fields(Sample)], [astuple(s) for s in samples])
    paths = {"shortest_path": columns_of([sample for sample in samples if sample.spans])["shortest_path"]}
    with stage("drawing"):
        figure = draw_sizes(columns_of(samples) | paths, {side: by_threshold(seen) for side, seen in views.items()})
        save_both(figure, folder, "network")
    bulk = [sample for sample in samples if sample.side >= BULK]
    return [  # those that the samples can say something about
        *([_below_cut(samples)] if bulk else []),
        *([_spans(samples)] if any(sample.side >= LARGE for sample in samples) else []),
        *([_spans_by_threshold(BULK, views[BULK])] if BULK in views else []),
        *([_reaches(bulk), _intermediate(bulk)] if bulk else []),
        *([_crosses_planes(bulk), _few_links(bulk)] if any(sample.spans for sample in bulk) else []),
        _domains_by_threshold(max(views), views[max(views)]),
    ]


def numbers_of(structure: Structure) -> dict[str, Any]:
    """The numbers of one sample, and what thresholds and then contact states show of it."""
    views = [*views_by_threshold(structure), view_of(structure)]
    numbers = asdict(sample_of(structure)).items()
    return {"sample": {name: plain(value) for name, value in numbers}, "views": views}


def view_of(structure: Structure) -> View:
    """Network and domains in a few numbers: slipless contacts, whether their network spans, shares of the free spheres,
    rigid domains, spheres of the largest one that is not locked to one plane."""
    return {
        "slipless": len(structure.network.axis),
        "spans": structure.network.spans,
        "reached_fraction": structure.network.reached_fraction,
        "spanning_fraction": structure.network.spanning_fraction,
        "domains": structure.domains.number,
        "largest_intermediate": structure.domains.largest_intermediate,
    }


def views_by_threshold(structure: Structure) -> list[View]:
    """The same for each of THRESHOLDS: what a solver would have seen that cannot tell tiny slips from none.

    At the minimum of a large sample the slips span many decades, so a coarse threshold merges slipping contacts into
    the network and domains into each other.
    """
    views: dict[int, View] = {}
    chosen = []
    for threshold in THRESHOLDS:
        seen = structure.by_threshold(threshold * (structure.scene.lattice.radius * structure.scene.jump))
        count = seen.contacts_in(ContactState.SLIPLESS)  # the sets are nested: the same number, the same set
        if count not in views:
            views[count] = view_of(seen)
        chosen.append(views[count])
    return chosen


def sample_of(structure: Structure) -> Sample:
    """The numbers of one sample."""
    scene, network, view = structure.scene, structure.network, view_of(structure)
    free = ~scene.lattice.is_driven
    kinds = structure.domains.spheres_of_kind(free)
    planes = network.path_planes
    return Sample(
        side=scene.lattice.shape[0],
        seed=scene.seeds[0],
        power=structure.power,
        gap=(structure.power - structure.lower_bound) / structure.power,
        power_over_cut=structure.power / structure.interface.power,
        below_cut=bool(structure.power < structure.interface.lower_bound * (1 - SAME)),
        slipless_fraction=view["slipless"] / scene.lattice.contacts,
        states_proven=structure.states_proven,
        unique=structure.minimum_is_unique is True,
        spans=view["spans"],
        reached_fraction=view["reached_fraction"],
        reached_by_chance=reached_by_chance(scene.lattice, view["slipless"] / scene.lattice.contacts),
        spanning_fraction=view["spanning_fraction"],
        intermediate=1 - (kinds["bottom"] + kinds["top"]) / int(free.sum()),
        domains=view["domains"],
        largest_intermediate=view["largest_intermediate"],
        shortest_path=max(len(network.shortest_path) - 1, 0),
        planes_x=planes[0],
        planes_y=planes[1],
        disjoint_paths=network.disjoint_paths,
        busiest_link_share=float(structure.bottlenecks.share.max(initial=0.0)),
        effective_links=structure.bottlenecks.effective_links,
        parting_links=int(structure.bottlenecks.parting.sum()),
        plane_spans=any(spans_within_planes(network, axis).any() for axis in (0, 1)),
    )


def spans_within_planes(network: SliplessNetwork, axis: int) -> np.ndarray:
    """For each lattice plane across `axis`: True if its slipless contacts alone join bottom and top."""
    inside, plane = network.axis != axis, network.contact[:, axis]
    pieces = [network.pieces(inside & (plane == index)) for index in range(network.lattice.shape[axis])]
    return np.array([label[0] == label[-1] for label in pieces])


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
    """Every number of `view_of`, (samples, thresholds + 1): for each of THRESHOLDS, then by contact states."""
    return {name: np.array([[float(seen[name]) for seen in sample] for sample in views]) for name in views[0][-1]}


def _by_side(samples: Sequence[Sample], name: str) -> dict[int, np.ndarray]:
    columns = columns_of(samples)[name]
    return dict(zip(columns.side.tolist(), columns.values, strict=True))


def _numbers(samples: Sequence[Sample], *names: str) -> dict[str, Any]:
    return {name: [getattr(sample, name) for sample in samples] for name in ("side", "seed", *names)}


def _below_cut(samples: Sequence[Sample]) -> Claim:
    bulk = [sample for sample in samples if sample.side >= BULK]
    return judge(
        "network.below_cut", _numbers(samples, "power_over_cut", "below_cut", "gap"), bulk=BULK,
        share=Share.of([sample.below_cut for sample in bulk]), of_bulk=[sample.power_over_cut for sample in bulk],
        below=_by_side(samples, "below_cut"), ratio=_by_side(samples, "power_over_cut"),
    )  # fmt: skip


def _spans(samples: Sequence[Sample]) -> Claim:
    share = Share.of([sample.spans for sample in samples if sample.side >= LARGE])
    numbers = _numbers(samples, "spans", "below_cut", "states_proven", "unique")
    return judge("network.spans", numbers, share=share, spanning=_by_side(samples, "spans"), large=LARGE)


def _spans_by_threshold(side: int, views: Sequence[Sequence[View]]) -> Claim:
    spans = by_threshold(views)["spans"].astype(bool)
    differ, coarse, certified = spans[:, 0] != spans[:, -1], int(spans[:, 0].sum()), int(spans[:, -1].sum())
    words = ", ".join(f"{int(spans[:, k].sum())} at {threshold:g}" for k, threshold in enumerate(THRESHOLDS[:6]))
    numbers = {"threshold": list(THRESHOLDS), "spans": spans.tolist()}
    return judge("network.spans_by_threshold", numbers, size=side, differ=differ, share=Share.of(differ), words=words,
                 coarse=coarse, certified=certified)  # fmt: skip


def _reaches(bulk: Sequence[Sample]) -> Claim:
    spanning = [sample for sample in bulk if sample.spans]
    return judge(
        "network.reaches",
        _numbers(bulk, "reached_fraction", "reached_by_chance", "spanning_fraction", "slipless_fraction"),
        practically=PRACTICALLY_ALL,
        reached=_by_side(bulk, "reached_fraction"),
        chance=_by_side(bulk, "reached_by_chance"),
        held=_by_side(spanning, "spanning_fraction"),
        slipless=_by_side(bulk, "slipless_fraction"),
    )


def _intermediate(bulk: Sequence[Sample]) -> Claim:
    numbers = _numbers(bulk, "intermediate", "domains", "largest_intermediate")
    return judge("network.intermediate", numbers, shares=_by_side(bulk, "intermediate"),
                 largest=_by_side(bulk, "largest_intermediate"), numbers=_by_side(bulk, "domains"))  # fmt: skip


def _crosses_planes(bulk: Sequence[Sample]) -> Claim:
    spanning = [sample for sample in bulk if sample.spans]
    numbers = _numbers(bulk, "shortest_path", "planes_x", "planes_y", "disjoint_paths", "plane_spans")
    return judge(
        "network.crosses_planes", numbers, paths=_by_side(spanning, "shortest_path"),
        across_x=_by_side(spanning, "planes_x"), across_y=_by_side(spanning, "planes_y"),
        apart=_by_side(bulk, "disjoint_paths"), least=min(min(s.planes_x, s.planes_y) for s in spanning),
        spanning=len(spanning),
    )  # fmt: skip


def _few_links(bulk: Sequence[Sample]) -> Claim:
    spanning = [sample for sample in bulk if sample.spans]
    return judge(
        "network.few_links", _numbers(spanning, "busiest_link_share", "effective_links", "parting_links"),
        least=min((sample.busiest_link_share for sample in spanning), default=1.0),
        busiest=_by_side(spanning, "busiest_link_share"), effective=_by_side(spanning, "effective_links"),
        parting=_by_side(spanning, "parting_links"),
    )  # fmt: skip


def _domains_by_threshold(side: int, views: Sequence[Sequence[View]]) -> Claim:
    columns = by_threshold(views)
    means = {name: values.mean(axis=0) for name, values in columns.items()}
    seen = {
        name: {column: values[k] for column, values in means.items()}
        for k, name in enumerate([*(f"{threshold:g}" for threshold in THRESHOLDS), "certified"])
    }
    numbers = {"threshold": list(THRESHOLDS)} | {name: values.tolist() for name, values in columns.items()}
    ratio = columns["domains"][:, 0] / columns["domains"][:, -1]
    return judge("network.domains_by_threshold", numbers, size=side, views=seen, ratio=ratio)
