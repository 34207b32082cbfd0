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

from taichi_bearings.plots import lattice
from taichi_bearings.plots.page import PAGE, VIEW, Page, View, columns_on, middle_planes
from taichi_bearings.plots.style import BLUE, ORANGE, in_our_style, new_figure, panels

Arrays = tuple[np.ndarray, ...]  # (*contacts) of each axis
LETTERS = "cdefghijklmnopqrstuvwxyz"
SIDES = np.array([to_rgba("#cfdcf3"), to_rgba("#f6d5cd")])  # with the bottom, with the top


@in_our_style
def draw_cut_surface(
    above: np.ndarray,
    walls: Arrays,
    coefficient: Arrays,
    slips: Arrays,
    page: Page = PAGE,
    symbol: str = r"\mu_{ij}",
) -> Figure:
    """3D: the surface by the coefficients it cuts, its height from above, and cuts with the contacts that slip. 2D: the
    line across the discs with them.

    above : N, True on the top side. walls, coefficient, slips : one array (*contacts) an axis; walls are the contacts
        between the sides and, like slips, bool.
    symbol : of the coefficients.
    """
    shape = above.shape
    if above.ndim == 2:
        width = page.inches("single")
        height = width * float(np.clip(shape[1] / shape[0], 0.4, 2.0))
        figure = new_figure(width, 0.6 + height, page.dpi)
        axes = figure.add_subplot()
        _draw_sides(axes, above, walls, slips, lattice.site_on_paper(width, shape, height))
        axes.set_title(_summary(walls, slips, "\n"))
    else:
        planes = page.planes or middle_planes(shape)
        columns = min(2, columns_on(page, 4))
        least = page.inches("double") / columns
        figure, (surface, height_map, *cuts), width = panels(page, 2 + len(planes), (0.85, 0.0), 0.6, least)
        _draw_surface(surface, above, walls, coefficient, page.view or VIEW, symbol)
        surface.set_title("(a) minimum cut")
        _draw_height(height_map, above)
        for axes, letter, (axis, index) in zip(cuts, LETTERS, planes, strict=False):
            cut, slipping = (lattice.contacts_in_plane(values, axis, index) for values in (walls, slips))
            plane = np.take(above, index, axis)
            _draw_sides(axes, plane, cut, slipping, lattice.site_on_paper(0.7 * width, plane.shape), axis < 2)
            lattice.name_cut(axes, axis, index, f"({letter}) ")
        figure.suptitle(_summary(walls, slips, "\n" if columns == 1 else " "))
    key = [
        Line2D([], [], color=ORANGE, lw=3, label="minimum cut"),
        Line2D([], [], color=BLUE, lw=1.2, label="slipping contacts"),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=2)
    return figure


def _summary(walls: Arrays, slips: Arrays, gap: str) -> str:
    cut, slipping, both = (
        sum(int(values.sum()) for values in sets) for sets in (walls, slips, map(np.logical_and, walls, slips))
    )
    return f"the minimum cut has {cut:,} contacts;{gap}{slipping:,} slip, {both:,} of them in the cut"


def _draw_surface(axes: Any, above: np.ndarray, walls: Arrays, coefficient: Arrays, view: View, symbol: str) -> None:
    """A square for each contact of the cut, from the back to the front."""
    ends, which = lattice.ends_of(walls)
    values = np.concatenate([c[chosen] for c, chosen in zip(coefficient, walls, strict=True)])[which]
    placed = view.seen(lattice.squares(ends))
    order = np.argsort(placed[..., 2].mean(axis=1))
    edge = float(np.clip(4.0 / max(above.shape), 0.05, 0.4))
    drawn = PolyCollection(list(placed[order][..., :2]), cmap="cividis", edgecolors="white", lw=edge, zorder=2)
    drawn.set_array(values[order])
    axes.add_collection(drawn)
    lattice.frame_block(axes, above.shape, view)
    axes.figure.colorbar(drawn, ax=axes, label=f"${symbol}$", shrink=0.7, pad=0.02)


def _draw_height(axes: Any, above: np.ndarray) -> None:
    """Spheres of each column on the bottom side, seen from above; dots where the surface hangs over."""
    below = (~above).sum(axis=-1)
    levels = int(below.max() - below.min()) + 1
    look = ScalarMappable(Normalize(below.min() - 0.5, below.max() + 0.5), colormaps["viridis"].resampled(levels))
    axes.imshow(below.T, origin="lower", cmap=look.cmap, norm=look.norm, interpolation="nearest")
    over = np.argwhere((np.diff(above.astype(int), axis=-1) != 0).sum(axis=-1) > 1)
    axes.plot(*over.T, ".", color="white", mec="black", mew=0.2, ms=60 / max(15, *above.shape[:2]))
    ticks = np.arange(below.min(), below.max() + 1, 1 + levels // 9)
    axes.figure.colorbar(look, ax=axes, label="spheres below the surface", shrink=0.7, pad=0.02, ticks=ticks)
    axes.set(xlabel="$x$", ylabel="$y$")
    hangs = f"; {len(over):,} columns overhang (dots)" if len(over) else ""
    axes.set_title("(b) height of the surface" + hangs)


def _draw_sides(axes: Any, above: np.ndarray, walls: Arrays, slips: Arrays, site: float, upright: bool = True) -> None:
    """Discs by side, the cut in orange, and over it the slipping contacts in blue."""
    lattice.paint_plane(axes, SIDES[above.astype(int)])
    lattice.draw_walls(
        axes, walls, colors=ORANGE, lw=lattice.line_on_site(site, 0.3, 1.2, 4.0), capstyle="round", zorder=2
    )
    lattice.draw_walls(axes, slips, colors=BLUE, lw=lattice.line_on_site(site, 0.1, 0.4), zorder=3)
    if upright:
        lattice.box_driven_rows(axes, above.shape)
