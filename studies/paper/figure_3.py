"""Figures 3 and 4 of the paper: a 10x10x10 sample with omega_T = 10 omega_B, its network, a path, the planes of it.

The paper shows one sample. Shown here is the first seed whose slipless contacts join bottom and top; what holds for how
many samples, and for other sizes, is the business of paper/network.py.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.plots.network import draw_network
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.stages import stage

from ..plots.plane_cuts import draw_plane_cuts, planes_of
from .claims import Claim, Effort, Share, judge
from .network import PRACTICALLY_ALL, Sample, numbers_of
from .samples import certified, measured, save_both

SHAPE, SPIN_BOTTOM = (10, 10, 10), 0.1
MOST_SAMPLES = 40
TENTH = 0.1  # share of the free spheres that counts as many


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write fig3.png, fig3.pdf and fig3.csv into `folder`; returns the claims with their verdicts."""
    samples, shown = minima(folder, effort)
    network, scene = shown.network, shown.scene
    with stage("drawing"):
        save_both(draw_network(network, shown.spin, scene.spin_top, scene.spin_bottom), folder, "fig3")
    rows = [[*sphere.tolist(), *shown.spin[tuple(sphere)].tolist()] for sphere in network.shortest_path]
    write_csv(folder / "fig3.csv", ["x", "y", "z", "spin_x", "spin_y", "spin_z"], rows)
    spanning = [sample for sample in samples if sample.spans]
    of_all = [_intermediate(samples, int((~scene.lattice.is_driven).sum())), _network(samples)]
    return [*of_all, _path(spanning), _few_links(spanning, scene.lattice.contacts)] if spanning else of_all


def reproduce_planes(folder: Path, effort: Effort) -> list[Claim]:
    """Write fig4.png and fig4.pdf into `folder`; returns the claim with its verdict."""
    samples, shown = minima(folder, effort)
    with stage("drawing"):
        scene = shown.scene
        save_both(draw_plane_cuts(shown.network, shown.spin, scene.spin_top, scene.spin_bottom), folder, "fig4")
    if not shown.network.spans:
        return []
    path = shown.network.shortest_path
    planes, held = planes_of(path), np.zeros(len(path) - 1, dtype=bool)
    for axis, index in planes:
        held |= (path[:-1, axis] == index) & (path[1:, axis] == index)
    within = [sample.plane_spans for sample in samples if sample.spans]
    numbers = {"samples": len(within), "planes": [[int(axis), int(index)] for axis, index in planes]}
    return [judge("fig3.planes", numbers, within=within, held=held)]


@lru_cache(maxsize=1)  # for Fig. 4
def minima(folder: Path, effort: Effort) -> tuple[list[Sample], Structure]:
    """Certified samples of the paper's size, and the first one that spans, else the first."""
    runtime.start("cpu", "f64")
    seeds = range(effort.seed, effort.seed + min(MOST_SAMPLES, effort.samples))
    chosen = [RunSettings(shape=SHAPE, seed=seed, spin_bottom=SPIN_BOTTOM) for seed in seeds]
    samples = [Sample(**found["sample"]) for found in measured(chosen, numbers_of, folder / "fig3.jsonl")]
    return samples, certified(chosen[[*(sample.spans for sample in samples), True].index(True) % len(chosen)])


def _intermediate(samples: list[Sample], free: int) -> Claim:
    shares = [sample.intermediate for sample in samples]
    numbers = {"seeds": [sample.seed for sample in samples], "intermediate": shares}
    return judge("fig3.intermediate", numbers, free=free, gap=max(sample.gap for sample in samples), tenth=TENTH,
                 many=Share.of([share > TENTH for share in shares]))  # fmt: skip


def _network(samples: list[Sample]) -> Claim:
    whole = Share.of([sample.spans and sample.spanning_fraction > PRACTICALLY_ALL for sample in samples])
    numbers = {"spanning_fraction": [sample.spanning_fraction for sample in samples]}
    return judge(
        "fig3.network", numbers, found=whole, joined=sum(s.spans for s in samples), practically=PRACTICALLY_ALL
    )


def _path(spanning: list[Sample]) -> Claim:
    lengths, planes = [sample.shortest_path for sample in spanning], [[s.planes_x, s.planes_y] for s in spanning]
    numbers = {"contacts": lengths, "planes": planes}
    (x, y), *_ = planes
    return judge("fig3.path", numbers, seed=spanning[0].seed, length=lengths[0], across_x=x, across_y=y)


def _few_links(spanning: list[Sample], contacts: int) -> Claim:
    numbers = {
        "busiest": [sample.busiest_link_share for sample in spanning],
        "effective_links": [sample.effective_links for sample in spanning],
        "parting_links": [sample.parting_links for sample in spanning],
    }
    links = [round(sample.slipless_fraction * contacts) for sample in spanning]
    return judge("fig3.few_links", numbers, links=links, parted=sum(s.parting_links > 0 for s in spanning))
