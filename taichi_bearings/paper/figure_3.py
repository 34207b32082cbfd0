"""Figures 3 and 4 of the paper: a 10x10x10 sample with omega_T = 10 omega_B, its network and a path through it.

The paper shows one sample. Shown here is the first seed whose slipless contacts join bottom and top; what holds for how
many samples, and for other sizes, is the business of paper/network.py.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.analysis.network import planes_crossed
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.paper.claims import FEWEST, Claim, Effort, Share
from taichi_bearings.paper.network import MOST, certified, mean
from taichi_bearings.paper.samples import save_both
from taichi_bearings.plots.network import draw_network
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.stages import alike, each, stage
from taichi_bearings.words import counted
from taichi_bearings.words import share as in_percent

SHAPE, SPIN_BOTTOM = (10, 10, 10), 0.1
MOST_SAMPLES = 40
NETWORK = "Its slipless contacts form a network that joins bottom and top and attains practically every sphere."
RARE = 0.1  # share of the samples up to which a network that joins the planes counts as missing
INTERMEDIATE = 0.1  # share of the free spheres that counts as many


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write fig3.png, fig3.pdf and fig3.csv into `folder`; returns the claims with their verdicts."""
    samples = spanning_samples(effort)
    shown = samples[0]
    scene = shown.scene
    with stage("drawing"):
        figure = draw_network(shown.network, shown.spin, scene.spin_top, scene.spin_bottom)
        save_both(figure, folder, "fig3")
    write_path(folder / "fig3.csv", shown)
    if not shown.network.spans:
        return [_intermediate(shown), _no_network(effort)]
    return [_intermediate(shown), _network(shown), _path(shown), _few_links(samples)]


@lru_cache(maxsize=1)  # for Fig. 4
def spanning_samples(effort: Effort) -> list[Structure]:
    """Certified samples of the paper's size whose slipless contacts join bottom and top, and the first one if none."""
    runtime.start("cpu", "f64")
    seeds = range(effort.seed, effort.seed + min(MOST_SAMPLES, effort.samples))
    samples = []
    for seed in each(seeds, "sample", alike):
        samples.append(certified(RunSettings(shape=SHAPE, seed=seed, spin_bottom=SPIN_BOTTOM)))
    return [sample for sample in samples if sample.network.spans] or samples[:1]


def write_path(path: Path, structure: Structure) -> None:
    """The spheres along the path with their spins, as numbers."""
    spheres = structure.network.shortest_path
    rows = [[*sphere.tolist(), *structure.spin[tuple(sphere)].tolist()] for sphere in spheres]
    write_csv(path, ["x", "y", "z", "spin_x", "spin_y", "spin_z"], rows)


def _intermediate(shown: Structure) -> Claim:
    free = ~shown.scene.lattice.is_driven
    kinds, total = shown.domains.spheres_of_kind(free), int(free.sum())
    share = 1 - (kinds["bottom"] + kinds["top"]) / total
    return Claim(
        "10x10x10, omega_T = 10 omega_B: many spheres in the middle are in intermediate bearing states.",
        f"Seed {shown.scene.seeds[0]}, minimum proven within {(shown.power - shown.lower_bound) / shown.power:.0e}: "
        f"{in_percent(share, 0)} of the {total} free spheres are locked to neither plane (limit {INTERMEDIATE:.0%}), "
        f"{kinds['bottom']} turn with the bottom, {kinds['top']} with the top.",
        share > INTERMEDIATE,
        {"seed": shown.scene.seeds[0], "free_spheres_locked_to": kinds, "domains": shown.domains.number},
        kind="selected",
    )


def _network(shown: Structure) -> Claim:
    network = shown.network
    return Claim(
        NETWORK,
        f"Seed {shown.scene.seeds[0]}, the first one whose network joins them: {len(network.axis)} slipless "
        f"contacts touch {in_percent(network.reached_fraction, 2)} of the free spheres; "
        f"{in_percent(network.spanning_fraction, 2)} belong to "
        "the piece that joins the planes. Not every sample has one: see `network`.",
        network.spans and network.spanning_fraction > 0.99,
        {"reached_fraction": network.reached_fraction, "spanning_fraction": network.spanning_fraction},
        refined=True,
        kind="selected",
    )


def _no_network(effort: Effort) -> Claim:
    none = Share(0, min(MOST_SAMPLES, effort.samples))
    return Claim(
        NETWORK,
        f"They join the planes in {none}, from seed {effort.seed} on (limit: {RARE:.0%}); see `network`.",
        numbers={"seed": effort.seed, "samples": none.samples},
        **none.above(RARE),
    )


def _path(shown: Structure) -> Claim:
    path = shown.network.shortest_path
    planes = planes_crossed(path)
    return Claim(
        "A path of slipless contacts connects bottom and top and goes through several planes (Fig. 4).",
        f"The shortest one has {max(len(path) - 1, 0)} contacts and visits {planes[0]} planes across x and {planes[1]} "
        "across y. It needs two of each at least, since slipless contacts within a plane across x tie Omega_x.",
        min(planes) > 1,
        {"contacts": max(len(path) - 1, 0), "planes": list(planes)},
        kind="theorem",
    )


def _few_links(samples: list[Structure]) -> Claim:
    found = [sample.bottlenecks for sample in samples]
    largest = np.array([one.concentration.largest for one in found])
    effective = np.array([one.concentration.effective for one in found])
    links = np.array([len(one.network.axis) for one in found])
    parting = [int(one.backbone.parting_links.sum()) for one in found]
    return Claim(
        "There are a few links through which most connecting paths go: they have large betweenness.",
        f"{counted(len(samples), 'sample')} that span. Of the shortest paths between a bottom and a top sphere the "
        f"busiest link carries {mean(largest)} (limit: {MOST:g} in every sample; the least is {largest.min():.3f}). "
        f"The load is that of {mean(effective)} equal links, of {mean(links)} that are slipless. "
        f"{sum(n > 0 for n in parting)} samples have links that part the planes alone, on average {mean(parting)} in "
        "each sample.",
        bool(largest.min() > MOST),
        {"busiest": largest.tolist(), "effective_links": effective.tolist(), "parting_links": parting},
        samples=len(samples),
        needed=FEWEST,
    )
