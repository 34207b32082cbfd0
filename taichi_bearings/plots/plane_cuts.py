"""Cuts of a configuration along the planes through which a slipless path runs (paper Fig. 4)."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.plots.lattice import (
    COLOURS,
    box_driven_rows,
    contacts_in_plane,
    draw_contacts,
    draw_speed_bar,
    middle_cuts,
    paint_plane,
    speed_of,
)
from taichi_bearings.plots.style import GREEN, in_our_style, new_figure

PLANES = 3
TOWARDS_READER = (1, -1)  # along x for planes across x, along y for planes across y


@in_our_style
def draw_plane_cuts(network: SliplessNetwork, spin: np.ndarray, spin_top: float, spin_bottom: float) -> Figure:
    """Spheres coloured by |spin|, slipless contacts of the plane in grey, the path in green.

    spin : laboratory frame, N or (*N, 3), 1/time. 3D: the upright planes that together hold most of the path, or the
    middle ones if there is none. A circle marks where the path leaves the plane: with a dot towards the reader, with a
    cross away.
    """
    speed, path = speed_of(spin, spin_top, spin_bottom), network.shortest_path
    if speed.ndim == 2:
        figure, (axes,) = _panels([speed.shape])
        joined = np.stack([path[:-1], path[1:]], axis=1)
        _draw_plane(axes, speed, network.slipless, joined, np.empty((0, 3), dtype=int))
        axes.set_title(_title(len(joined), len(joined)), fontsize=9)
    else:
        cuts = planes_of(path) if len(path) else middle_cuts(speed.shape)
        planes = [np.take(speed, index, axis) for axis, index in cuts]
        figure, panels = _panels([plane.shape for plane in planes])
        for axes, plane, (axis, index) in zip(panels, planes, cuts, strict=True):
            joined, leaves = path_in_plane(path, axis, index)
            _draw_plane(axes, plane, contacts_in_plane(network.slipless, axis, index), joined, leaves)
            axes.set_title(f"{'xy'[axis]} = {index}: " + _title(len(joined), len(path) - 1), fontsize=9)
            axes.set(xlabel="yx"[axis], ylabel="z")
        if len(path):
            figure.supxlabel("the path leaves the plane towards the reader (dot) or away (cross)", fontsize=8)
    draw_speed_bar(figure, figure.axes, shrink=0.8)
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


def path_in_plane(path: np.ndarray, axis: int, index: int) -> tuple[np.ndarray, np.ndarray]:
    """The pieces of a path (L, 3) in the plane `index` across `axis`, and where it leaves the plane.

    returns : ends (n, 2, 2) of its contacts in the plane; (m, 3) the place in the plane where it leaves, and +1 towards
        the reader or -1 away.
    """
    flat = np.delete(path, axis, axis=1)
    inside = path[:, axis] == index
    both = inside[:-1] & inside[1:]
    joined = np.stack([flat[:-1][both], flat[1:][both]], axis=1)
    side = TOWARDS_READER[axis] * (path[:, axis] - index)
    leaves = []
    for here, there in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
        out = inside[here] & ~inside[there]
        leaves.append(np.column_stack([flat[here][out], side[there][out]]))
    return joined, np.concatenate(leaves)


def _title(held: int, length: int) -> str:
    return f"{held} of {length} contacts of the path" if length > 0 else "no path joins bottom and top"


def _panels(shapes: list[tuple[int, ...]]) -> tuple[Figure, Any]:
    tall = max(shape[1] / shape[0] for shape in shapes)
    figure = new_figure(3.6 * len(shapes) + 1.0, 0.8 + float(np.clip(3.3 * tall, 2.0, 7.0)))
    return figure, figure.subplots(1, len(shapes), squeeze=False)[0]


def _draw_plane(
    axes: Any, speed: np.ndarray, slipless: tuple[np.ndarray, ...], joined: np.ndarray, leaves: np.ndarray
) -> None:
    scale = 10.0 / max(10, *speed.shape)
    paint_plane(axes, colormaps[COLOURS](speed))
    draw_contacts(axes, slipless, colors="0.35", lw=max(0.5, 2.2 * scale), zorder=2)
    for colour, width in (("white", 7.0), (GREEN, 4.2)):
        axes.add_collection(
            LineCollection(list(joined), colors=colour, lw=max(0.5 * width, width * scale), zorder=3, capstyle="round")
        )
    size = 13.0 * scale**0.7
    axes.plot(*leaves[:, :2].T, "o", mfc="white", mec=GREEN, ms=size, mew=max(0.7, 2 * scale), zorder=4)
    for side, mark in ((1, "o"), (-1, "x")):
        chosen = leaves[leaves[:, 2] == side]
        axes.plot(
            *chosen[:, :2].T, mark, color=GREEN, ms=size * (0.3 if side > 0 else 0.5), mew=max(0.7, 2 * scale), zorder=5
        )
    box_driven_rows(axes, speed.shape)
