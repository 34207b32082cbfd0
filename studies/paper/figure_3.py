"""Figures 3 and 4 of the paper: a 10x10x10 sample with omega_T = 10 omega_B, its slipless network and a path through
it.

The slipless network consists of the contacts whose spheres roll on each other without slip. Fig. 4 has the same sample,
cut along the planes that hold most of the path. The paper shows one sample. Shown here is the first seed whose slipless
contacts join bottom and top; network.py asks for how many samples, and for which sizes, that is so.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from taichi_bearings.analysis.slipless_network import SliplessNetwork
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.plots.bearing import SPIN_COLOURS, Sheet, draw_speed_bar, line_on_site, name_cut, speed_of
from taichi_bearings.plots.page import BELOW, PAGE, middle_planes
from taichi_bearings.plots.structure import draw_network
from taichi_bearings.plots.style import GREEN, in_our_style, panels
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene.scene import of_lattice

from .claims import Effort
from .network import PRACTICALLY_ALL, sample_of
from .samples import StudyResult, Table, certified, measured

SHAPE, SPIN_BOTTOM = (10, 10, 10), 0.1
MOST_SAMPLES = 40
PLANES = 3  # most planes of Fig. 4
TOWARDS_READER = (1, -1, 1)  # sign, for planes across x, y and z, of the direction of that axis towards the reader


def study(folder: Path, effort: Effort) -> StudyResult:
    """Return Fig. 3, which shows one sample, a table of the spheres on its shortest slipless path from bottom to top,
    and values for the claims, from the minima of several samples.

    folder : folder where finished samples are kept until the study ends.
    effort : first seed and number of samples.
    """
    table, shown = minima(folder, effort)
    path, scene = shown.network.shortest_path, of_lattice(shown.scene)
    columns = [*path.T, *shown.spin[tuple(path.T)].T]
    spheres = Table(dict(zip(("x", "y", "z", "spin_x", "spin_y", "spin_z"), columns, strict=True)))
    named = {
        "table": table, "spanning": table[table.spans], "practically": PRACTICALLY_ALL,
        "free": int((~scene.lattice.is_driven).sum()), "contacts": scene.lattice.contacts,
    }  # fmt: skip
    return StudyResult({".csv": spheres}, lambda _: draw_network(shown), named)


def planes(folder: Path, effort: Effort) -> StudyResult:
    """Return Fig. 4 and the values for its claims: the lattice planes that are drawn, and for each contact of the
    shortest slipless path from bottom to top whether it lies in one of them (`held`).

    folder : folder where finished samples are kept until the study ends.
    effort : first seed and number of samples.
    """
    table, shown = minima(folder, effort)
    path = shown.network.shortest_path
    chosen = planes_of(path) if len(path) else ()
    held = [(path[:-1, axis] == index) & (path[1:, axis] == index) for axis, index in chosen]
    named = {"spanning": table[table.spans], "planes": chosen, "held": np.any(held, axis=0)}
    return StudyResult({}, lambda _: draw_plane_cuts(shown), named)


@lru_cache(maxsize=1)  # Fig. 3 and Fig. 4 share the samples
def minima(folder: Path, effort: Effort) -> tuple[Table, Structure]:
    """Return a table of samples of the paper's size at their certified minima, and the structure (network, domains,
    cut) of the one that is shown: the first whose slipless contacts join bottom and top, or the first of all.

    folder : folder where finished samples are kept until the study ends.
    effort : first seed and number of samples.
    """
    seeds = effort.seeds(min(MOST_SAMPLES, effort.samples))
    chosen = [RunSettings(shape=SHAPE, seed=seed, spin_bottom=SPIN_BOTTOM) for seed in seeds]
    table = measured(chosen, sample_of, folder / "fig3.jsonl")
    return table, certified(chosen[int(table.spans.argmax())])


@in_our_style
def draw_plane_cuts(shown: Structure) -> Figure:
    """Draw Fig. 4: the upright planes that together hold most of the path, or the middle ones if there is no path.

    shown : network and domains of the sample that the figure shows.

    Spheres are coloured by |spin|; slipless contacts of the plane are grey, the path is green. A circle marks where the
    path leaves the plane: with a dot towards the reader, with a cross away.
    """
    network, imposed = shown.network, of_lattice(shown.scene).imposed
    speed, path = speed_of(shown.spin, *imposed), network.shortest_path
    cuts = planes_of(path) if len(path) else middle_planes(speed.shape)
    tall = float(np.clip(speed.shape[2] / min(speed.shape[:2]), 0.4, 2.0))
    figure, each, width = panels(PAGE, len(cuts), (0.85 * tall, 0.4), 0.25, widest="single")
    for axes, (axis, index) in zip(each, cuts, strict=True):
        sheet = Sheet.of_lattice(network.lattice, (axis, index))
        _draw_plane(axes, sheet, np.take(speed, index, axis), network, sheet.site(0.8 * width))
        _mark_leaves(axes, leaves_of(network, axis, index), sheet.site(0.8 * width))
        held = f"{network.on_path[sheet.contact].sum()} of {len(path) - 1} contacts of the path"
        name_cut(axes, axis, index, after=f": {held if len(path) else 'no path joins bottom and top'}")
    if len(path):
        figure.supxlabel("the path leaves the plane towards the reader (dot) or away (cross)", fontsize=7)
    draw_speed_bar(figure, figure.axes, shown.scene, **(BELOW if len(cuts) < 2 else {}))
    return figure


def planes_of(path: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Return up to PLANES upright lattice planes that hold most of a path, each as (axis across it, index along that
    axis). They are chosen one by one: each is the plane with most contacts of the path that are in no plane chosen
    before.

    path : (spheres, 3) lattice indices of the spheres along the path.
    """
    step, lower = np.diff(path, axis=0), np.minimum(path[:-1], path[1:])
    covered, chosen = np.zeros(len(step), dtype=bool), []  # contacts of the path in the planes chosen so far
    for _ in range(PLANES):
        best, with_best = None, covered
        for axis in (0, 1):
            for index in np.unique(path[:, axis]):
                inside = (step[:, axis] == 0) & (lower[:, axis] == index)
                if (covered | inside).sum() > with_best.sum():
                    best, with_best = (axis, int(index)), covered | inside
        if best is not None:
            chosen.append(best)
            covered = with_best
    return tuple(chosen)


def leaves_of(network: SliplessNetwork, axis: int, index: int) -> np.ndarray:
    """Return the m places, (m, 3), where the shortest slipless path leaves a lattice plane: two lattice coordinates
    within the plane, and +1 where the path goes towards the reader of the figure, -1 where it goes away.

    network : the slipless contacts of a lattice, with the path.
    axis, index : the plane: the axis across it, and its lattice index along this axis.
    """
    lattice = network.lattice
    ends = lattice.ends[:, network.on_path & (lattice.axis == axis)]
    leaves = []
    for spheres, direction in zip(ends, (1, -1), strict=True):  # lower spheres, from which the contact leads upwards
        place = np.stack(np.unravel_index(spheres, lattice.shape), axis=1)
        in_plane = np.delete(place[place[:, axis] == index], axis, axis=1)
        leaves.append(np.column_stack([in_plane, np.full(len(in_plane), direction * TOWARDS_READER[axis])]))
    return np.concatenate(leaves)


def _draw_plane(axes: Any, sheet: Sheet, speed: np.ndarray, network: SliplessNetwork, site: float) -> None:
    """Draw the discs in which a lattice plane cuts the spheres, its slipless contacts, and the path.

    axes : where it is drawn.
    sheet : the plane, with the places of its discs and contacts.
    speed : (discs,), |spin| of its spheres, as a share of the colour scale.
    network : the slipless contacts, and the path.
    site : distance of two discs in the figure, in points.
    """
    sheet.paint(axes, colormaps[SPIN_COLOURS](speed).reshape(-1, 4))
    sheet.box_driven(axes)
    sheet.draw(axes, network.slipless, colors="0.35", lw=line_on_site(site, 0.1, 0.3), zorder=2)
    for colour, share in (("white", 0.5), (GREEN, 0.3)):
        line = line_on_site(site, share, 4 * share, 12 * share)
        sheet.draw(axes, network.on_path, colors=colour, lw=line, zorder=3, capstyle="round")


def _mark_leaves(axes: Any, leaves: np.ndarray, site: float) -> None:
    """Draw a circle at each place where the path leaves the plane: with a dot towards the reader, with a cross
    away.

    axes : panel of matplotlib.
    leaves : (places, 3) place in the plane (two lattice coordinates), and +1 towards the reader or -1 away.
    site : distance of two discs in the figure, in points.
    """
    size = float(np.clip(0.75 * site, 3.0, 9.0))
    axes.plot(*leaves[:, :2].T, "o", mfc="white", mec=GREEN, ms=size, mew=0.12 * size, zorder=4)
    for side, mark in ((1, "o"), (-1, "x")):
        chosen = leaves[leaves[:, 2] == side]
        ms = size * (0.3 if side > 0 else 0.5)
        axes.plot(*chosen[:, :2].T, mark, color=GREEN, ms=ms, mew=0.12 * size, zorder=5)
