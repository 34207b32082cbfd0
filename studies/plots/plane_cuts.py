"""Cuts of a configuration along the planes through which a slipless path runs (paper Fig. 4)."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.plots import lattice
from taichi_bearings.plots.page import PAGE, middle_planes
from taichi_bearings.plots.style import GREEN, in_our_style, panels

PLANES = 3
TOWARDS_READER = (1, -1, 1)  # along x for planes across x, against y for those across y, along z for those across z


@in_our_style
def draw_plane_cuts(network: SliplessNetwork, spin: np.ndarray, spin_top: float, spin_bottom: float) -> Figure:
    """Spheres coloured by |spin|, slipless contacts of the plane in grey, the path in green, on the upright planes that
    together hold most of the path, or the middle ones if there is none. A circle marks where the path leaves the plane:
    with a dot towards the reader, with a cross away. spin : laboratory frame, (*N, 3), 1/time.
    """
    speed = lattice.speed_of(spin, spin_top, spin_bottom)
    path, steps = network.shortest_path, network.path_steps
    slipless = network.lattice.by_axis(network.slipless)
    cuts = planes_of(path) if len(path) else middle_planes(speed.shape)
    tall = float(np.clip(speed.shape[2] / min(speed.shape[:2]), 0.4, 2.0))
    figure, each, width = panels(PAGE, len(cuts), (0.85 * tall, 0.4), 0.25, widest="single")
    for axes, (axis, index) in zip(each, cuts, strict=True):
        joined, leaves = path_in_plane(path, steps, axis, index)
        inside = lattice.contacts_in_plane(slipless, axis, index)
        _draw_plane(axes, np.take(speed, index, axis), inside, joined, leaves, 0.8 * width)
        held = f"{len(joined)} of {len(path) - 1} contacts of the path" if len(path) else "no path joins bottom and top"
        lattice.name_cut(axes, axis, index, after=f": {held}")
    if len(path):
        figure.supxlabel("the path leaves the plane towards the reader (dot) or away (cross)", fontsize=7)
    lattice.draw_speed_bar(figure, figure.axes, spin_top, spin_bottom, len(cuts) < 2)
    return figure


def planes_of(path: np.ndarray) -> tuple[tuple[int, int], ...]:
    """(axis, index) of up to three upright planes, each holding most contacts of the path (L, 3) that the ones before
    do not hold."""
    step, lower = np.diff(path, axis=0), np.minimum(path[:-1], path[1:])
    shown, chosen = np.zeros(len(step), dtype=bool), []
    for _ in range(PLANES):
        best, held = None, shown
        for axis in (0, 1):
            for index in np.unique(path[:, axis]):
                inside = (step[:, axis] == 0) & (lower[:, axis] == index)
                if (shown | inside).sum() > held.sum():
                    best, held = (axis, int(index)), shown | inside
        if best is not None:
            chosen.append(best)
            shown = held
    return tuple(chosen)


def path_in_plane(path: np.ndarray, steps: np.ndarray, axis: int, index: int) -> tuple[np.ndarray, np.ndarray]:
    """The pieces of a path (L, 3) of steps (L - 1, 3) in the plane `index` across `axis`, and where it leaves it.

    returns : ends (n, 2, 2) of its contacts in the plane, over a periodic side outwards; (m, 3) the place in the plane
        where it leaves, and +1 towards the reader or -1 away.
    """
    flat = np.delete(path, axis, axis=1)
    inside = path[:, axis] == index
    both = inside[:-1] & inside[1:]
    joined = np.stack([flat[:-1][both], (flat[:-1] + np.delete(steps, axis, axis=1))[both]], axis=1)
    side = TOWARDS_READER[axis] * steps[:, axis]
    leaves = []
    for here, there, way in ((slice(None, -1), slice(1, None), side), (slice(1, None), slice(None, -1), -side)):
        out = inside[here] & ~inside[there]
        leaves.append(np.column_stack([flat[here][out], way[out]]))
    return joined, np.concatenate(leaves)


def _draw_plane(
    axes: Any, speed: np.ndarray, slipless: Any, joined: np.ndarray, leaves: np.ndarray, width: float
) -> None:
    site = lattice.site_on_paper(width, speed.shape)
    lattice.paint_plane(axes, colormaps[lattice.SPIN_COLOURS](speed))
    lattice.draw_contacts(axes, slipless, colors="0.35", lw=lattice.line_on_site(site, 0.1, 0.3), zorder=2)
    joined = lattice.up_to_the_sides(lattice.on_both_sides(joined, speed.shape)[0], speed.shape)
    for colour, share in (("white", 0.5), (GREEN, 0.3)):
        line = lattice.line_on_site(site, share, 4 * share, 12 * share)
        axes.add_collection(LineCollection(list(joined), colors=colour, lw=line, zorder=3, capstyle="round"))
    size = float(np.clip(0.75 * site, 3.0, 9.0))
    axes.plot(*leaves[:, :2].T, "o", mfc="white", mec=GREEN, ms=size, mew=0.12 * size, zorder=4)
    for side, mark in ((1, "o"), (-1, "x")):
        chosen = leaves[leaves[:, 2] == side]
        ms = size * (0.3 if side > 0 else 0.5)
        axes.plot(*chosen[:, :2].T, mark, color=GREEN, ms=ms, mew=0.12 * size, zorder=5)
    lattice.box_driven_rows(axes, speed.shape)
