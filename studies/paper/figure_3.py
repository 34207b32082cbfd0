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
from taichi_bearings.plots.network import draw_network
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.stages import alike, each, stage
from taichi_bearings.words import counted
from taichi_bearings.words import share as in_percent

from .claims import FEWEST, HALF, Claim, Effort, Share, every, interval_of_mean
from .network import MOST, PRACTICALLY_ALL, certified, mean
from .samples import save_both

SHAPE, SPIN_BOTTOM = (10, 10, 10), 0.1
MOST_SAMPLES = 40
NETWORK = "Its slipless contacts form a network that joins bottom and top and attains practically every sphere."
RARE = 0.1  # share of the samples up to which a network that joins the planes counts as missing
INTERMEDIATE = 0.1  # share of the free spheres that counts as many


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write fig3.png, fig3.pdf and fig3.csv into `folder`; returns the claims with their verdicts."""
    samples, spanning = solved_samples(effort), spanning_samples(effort)
    shown = spanning[0]
    scene = shown.scene
    with stage("drawing"):
        figure = draw_network(shown.network, shown.spin, scene.spin_top, scene.spin_bottom)
        save_both(figure, folder, "fig3")
    write_path(folder / "fig3.csv", shown)
    of_all = [_intermediate(samples), _network(samples)]
    return [*of_all, _path(spanning), _few_links(spanning)] if shown.network.spans else of_all


@lru_cache(maxsize=1)  # for Fig. 4
def solved_samples(effort: Effort) -> list[Structure]:
    """Certified samples of the paper's size."""
    runtime.start("cpu", "f64")
    seeds = range(effort.seed, effort.seed + min(MOST_SAMPLES, effort.samples))
    return [
        certified(RunSettings(shape=SHAPE, seed=seed, spin_bottom=SPIN_BOTTOM)) for seed in each(seeds, "sample", alike)
    ]


def spanning_samples(effort: Effort) -> list[Structure]:
    """Those whose slipless contacts join bottom and top, and the first one if none do."""
    samples = solved_samples(effort)
    return [sample for sample in samples if sample.network.spans] or samples[:1]


def write_path(path: Path, structure: Structure) -> None:
    """The spheres along the path with their spins, as numbers."""
    spheres = structure.network.shortest_path
    rows = [[*sphere.tolist(), *structure.spin[tuple(sphere)].tolist()] for sphere in spheres]
    write_csv(path, ["x", "y", "z", "spin_x", "spin_y", "spin_z"], rows)


def _intermediate(samples: list[Structure]) -> Claim:
    free = ~samples[0].scene.lattice.is_driven
    kinds, total = [sample.domains.spheres_of_kind(free) for sample in samples], int(free.sum())
    shares = np.array([1 - (of["bottom"] + of["top"]) / total for of in kinds])
    many = Share(int((shares > INTERMEDIATE).sum()), len(shares))
    gap = max((sample.power - sample.lower_bound) / sample.power for sample in samples)
    return Claim(
        "10x10x10, omega_T = 10 omega_B: many spheres in the middle are in intermediate bearing states.",
        f"Minima proven within {gap:.0e}. Of the {total} free spheres {mean(shares)} are locked to neither plane "
        f"({counted(len(samples), 'sample')}); more than {INTERMEDIATE:.0%} are in {many}; limit: more than half.",
        numbers={"seeds": [sample.scene.seeds[0] for sample in samples], "intermediate": shares.tolist()},
        paper="many, one sample",
        ours=f"{in_percent(float(shares.mean()), 0)} of the free spheres in the mean",
        uncertainty=f"mean: {interval_of_mean(shares)}; share of the samples: {many.interval}",
        after_data="what counts as many, a tenth",
        **many.above(HALF),
    )


def _network(samples: list[Structure]) -> Claim:
    whole = [sample.network.spanning_fraction > PRACTICALLY_ALL for sample in samples if sample.network.spans]
    found = Share(sum(whole), len(samples))
    return Claim(
        NETWORK,
        f"So it is in {found}; limit: more than {RARE:.0%}, so that the paper's sample is no rarity. The network joins "
        f"the planes in {len(whole)}, and then more than {PRACTICALLY_ALL:.0%} of the free spheres belong to the piece "
        f"that does in {sum(whole)}. Whether a sample of this size has one is a matter of chance: see `network`.",
        numbers={"spanning_fraction": [float(sample.network.spanning_fraction) for sample in samples]},
        refined=found.hits < found.samples,
        paper="one sample, which has one",
        ours=f"{found.hits} of {counted(found.samples, 'sample')}",
        uncertainty=found.interval,
        after_data=f"the limits {RARE:g} and {PRACTICALLY_ALL:g}",
        **found.above(RARE),
    )


def _path(spanning: list[Structure]) -> Claim:
    paths = [sample.network.shortest_path for sample in spanning]
    planes = [planes_crossed(path) for path in paths]
    return Claim(
        "A path of slipless contacts connects bottom and top and goes through several planes (Fig. 4).",
        f"The shortest one of the sample shown, seed {spanning[0].scene.seeds[0]}, the first that has one, has "
        f"{len(paths[0]) - 1} contacts and visits {planes[0][0]} planes across x and {planes[0][1]} across y. It needs "
        "two of each at least, since slipless contacts within a plane across x tie Omega_x.",
        min(map(min, planes)) > 1,
        {"contacts": [len(path) - 1 for path in paths], "planes": [list(map(int, of)) for of in planes]},
        samples=len(spanning),
        kind="theorem",
        paper="several planes, one sample",
        ours=f"at least {min(map(min, planes))} across x and across y",
        uncertainty="none: a theorem",
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
        paper="a few links, large betweenness",
        ours=f"the busiest carries {largest.mean():.2f} of the paths",
        uncertainty=f"mean: {interval_of_mean(largest)}; {every(len(samples))}",
        after_data=f"the limit {MOST:g}",
    )
