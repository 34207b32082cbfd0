"""The minimum cut as a surface between two rigid halves, and the contacts that really slip.

In 2D they are the same. In 3D the minimum dissipates less than the cut: slips spread around the surface.
"""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from taichi_bearings.plots.lattice import (
    box_driven_rows,
    contacts_in_plane,
    draw_walls,
    frame_block,
    middle_cuts,
    name_cut,
    paint_plane,
    seen,
    squares,
    walls_between,
)
from taichi_bearings.plots.style import BLUE, ORANGE, in_our_style, new_figure

SIDES = np.array([to_rgba("#cfdcf3"), to_rgba("#f6d5cd")])  # with the bottom, with the top


@in_our_style
def draw_cut_surface(above: np.ndarray, coefficient: tuple[np.ndarray, ...], slips: tuple[np.ndarray, ...]) -> Figure:
    """3D: the surface by the coefficients it cuts, its height from above, and two cuts through the middle with the
    contacts that slip. 2D: the line across the discs with them.

    above : N, True on the top side. coefficient, slips : one array (*contacts) an axis; slips is bool.
    """
    walls = walls_between(above)
    if above.ndim == 2:
        figure = new_figure(5.2, 0.9 + 4.6 * float(np.clip(above.shape[1] / above.shape[0], 0.4, 1.6)))
        axes = figure.add_subplot()
        _draw_sides(axes, above, walls, slips)
        axes.set_title(_summary(walls, slips), fontsize=9)
    else:
        figure = new_figure(9.6, 8.6)
        (surface, height), cuts = figure.subplots(2, 2)
        _draw_surface(surface, above, walls, coefficient)
        surface.set_title("(a) minimum cut", fontsize=9)
        _draw_height(height, above)
        for axes, letter, (axis, index) in zip(cuts, "cd", middle_cuts(above.shape), strict=True):
            inside = [contacts_in_plane(values, axis, index) for values in (walls, slips)]
            _draw_sides(axes, np.take(above, index, axis), *inside)
            name_cut(axes, axis, index, f"({letter}) ")
        figure.suptitle(_summary(walls, slips), fontsize=10)
    key = [
        Line2D([], [], color=ORANGE, lw=4, label="minimum cut"),
        Line2D([], [], color=BLUE, lw=1.5, label="slipping contacts"),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=2, fontsize=9)
    return figure


def _summary(walls: tuple[np.ndarray, ...], slips: tuple[np.ndarray, ...]) -> str:
    cut, slipping, both = (
        sum(int(values.sum()) for values in sets) for sets in (walls, slips, map(np.logical_and, walls, slips))
    )
    return f"the minimum cut has {cut:,} contacts, {slipping:,} slip, {both:,} of them in the cut"


def _draw_surface(
    axes: Any, above: np.ndarray, walls: tuple[np.ndarray, ...], coefficient: tuple[np.ndarray, ...]
) -> None:
    """A square for each contact of the cut, from the back to the front."""
    corners = np.concatenate(
        [squares(np.argwhere(chosen) + 0.5 * np.eye(3)[axis], axis) for axis, chosen in enumerate(walls)]
    )
    values = np.concatenate([c[chosen] for c, chosen in zip(coefficient, walls, strict=True)])
    placed = seen(corners)
    order = np.argsort(placed[..., 2].mean(axis=1))
    edge = float(np.clip(8.0 / max(above.shape), 0.1, 0.6))
    drawn = PolyCollection(list(placed[order][..., :2]), cmap="cividis", edgecolors="white", lw=edge, zorder=2)
    drawn.set_array(values[order])
    axes.add_collection(drawn)
    frame_block(axes, above.shape)
    axes.figure.colorbar(drawn, ax=axes, label="coefficient of the contact", shrink=0.7)


def _draw_height(axes: Any, above: np.ndarray) -> None:
    """Spheres of each column on the bottom side, seen from above; dots where the surface hangs over."""
    below = (~above).sum(axis=-1)
    levels = int(below.max() - below.min()) + 1
    look = ScalarMappable(Normalize(below.min() - 0.5, below.max() + 0.5), colormaps["viridis"].resampled(levels))
    axes.imshow(below.T, origin="lower", cmap=look.cmap, norm=look.norm, interpolation="nearest")
    over = np.argwhere((np.diff(above.astype(int), axis=-1) != 0).sum(axis=-1) > 1)
    axes.plot(*over.T, ".", color="white", mec="black", mew=0.3, ms=90 / max(15, *above.shape[:2]))
    ticks = np.arange(below.min(), below.max() + 1, 1 + levels // 9)
    axes.figure.colorbar(look, ax=axes, label="spheres below the surface", shrink=0.7, ticks=ticks)
    axes.set(xlabel="x", ylabel="y")
    hangs = f"; {len(over):,} columns with overhangs (dots)" if len(over) else ""
    axes.set_title("(b) height of the surface" + hangs, fontsize=9)


def _draw_sides(axes: Any, above: np.ndarray, walls: tuple[np.ndarray, ...], slips: tuple[np.ndarray, ...]) -> None:
    """Discs by side, the cut in orange, and over it the slipping contacts in blue."""
    scale = 12.0 / max(12, *above.shape)
    paint_plane(axes, SIDES[above.astype(int)])
    draw_walls(axes, walls, colors=ORANGE, lw=max(2.2, 6.0 * scale), capstyle="round", zorder=2)
    draw_walls(axes, slips, colors=BLUE, lw=max(0.7, 1.8 * scale), zorder=3)
    box_driven_rows(axes, above.shape)
