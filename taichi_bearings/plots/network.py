"""The network of slipless contacts and a path through it from bottom to top (paper Figs. 3b and 3c)."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.plots.lattice import (
    COLOURS,
    box_driven_rows,
    draw_path,
    draw_speed_bar,
    frame_block,
    frame_plane,
    paint_block,
    paint_plane,
    paint_spheres,
    seen,
    speed_of,
)
from taichi_bearings.plots.style import GREEN, GREY, in_our_style, new_figure

NO_PATH = "they do not join bottom and top"
REACHED = {"bottom": colormaps[COLOURS](0.05), "top": colormaps[COLOURS](0.95)}


@in_our_style
def draw_network(network: SliplessNetwork, spin: np.ndarray, spin_top: float, spin_bottom: float) -> Figure:
    """3D: the spheres from outside; slipless contacts in grey and one shortest path in green; the spheres of the path
    with their spins. 2D: the last two.

    spin : laboratory frame, N or (*N, 3), 1/time. Where no path joins bottom and top the figure says so, and contacts
    joined to the bottom are blue, those joined to the top red.
    """
    path, speed = network.shortest_path, speed_of(spin, spin_top, spin_bottom)
    drawn = ["spheres"] * (spin.ndim == 4) + ["contacts"] + ["path"] * (len(path) > 0)
    figure = new_figure(4.6 * len(drawn) + 0.5, 4.6)
    for number, panel in enumerate(drawn):
        letter = f"({'abc'[number]}) " if len(drawn) > 1 else ""
        axes: Any = figure.add_subplot(1, len(drawn), number + 1, projection="3d" if panel == "spheres" else None)
        if panel == "spheres":
            paint_block(axes, colormaps[COLOURS](speed))
            axes.set_title(letter + "spheres from outside", fontsize=9)
        elif panel == "contacts":
            _draw_contacts(axes, network)
            joined = f"path of {len(path) - 1}" if len(path) else NO_PATH
            axes.set_title(f"{letter}{network.ends.shape[1]:,} slipless contacts,\n{joined}", fontsize=9)
        else:
            _draw_turning(axes, network, spin / (max(abs(spin_top), abs(spin_bottom)) or 1.0), speed)
            axes.set_title(letter + "the spheres of the path and their spins", fontsize=9)
    if len(drawn) > 1:
        draw_speed_bar(figure, axes, shrink=0.6)
    return figure


def contact_colours(network: SliplessNetwork) -> np.ndarray:
    """Colour (E, 4) of each slipless contact."""
    colour = np.tile(to_rgba(GREY), (network.ends.shape[1], 1))
    if not network.spans:
        piece = network.component.ravel()
        of_edge = piece[network.ends[0]]
        colour[of_edge == piece[0]] = REACHED["bottom"]
        colour[of_edge == piece[-1]] = REACHED["top"]
    return colour


def _draw_contacts(axes: Any, network: SliplessNetwork) -> None:
    shape, path = network.lattice.shape, network.shortest_path
    points = np.stack(np.unravel_index(network.ends, shape), axis=-1).swapaxes(0, 1)
    colour = contact_colours(network)
    if len(shape) == 2:
        frame_plane(axes, shape)
        box_driven_rows(axes, shape)
        width = 60.0 / max(30, *shape)
        lines, trace = points, path
    else:
        frame_block(axes, shape)
        placed = seen(points)
        nearness = placed[..., 2].mean(axis=1)
        order = np.argsort(nearness)
        lines, colour = placed[order][..., :2], colour[order]
        near = np.linspace(0.0, 1.0, len(order))
        width = float(np.clip(12.0 / max(shape), 0.15, 1.6))
        colour[:, 3] = (0.25 + 0.75 * near) * np.clip(12.0 / max(shape), 0.1, 0.9)
        trace = seen(path)[:, :2]
    grey = LineCollection(list(lines), colors=colour, lw=width, rasterized=len(lines) > 5000, label="slipless contacts")
    axes.add_collection(grey)
    draw_path(axes, trace, max(shape))


def _draw_turning(axes: Any, network: SliplessNetwork, spin: np.ndarray, speed: np.ndarray) -> None:
    """The spheres of the path from the back to the front, an arrow of the spin from each centre, and the path's shadow
    on the bottom."""
    path, shape = network.shortest_path, network.lattice.shape
    on_path = tuple(path.T)
    colour = colormaps[COLOURS](speed[on_path])
    if len(shape) == 2:
        every = np.ones((*shape, 4))
        every[on_path] = colour
        paint_plane(axes, every)
        box_driven_rows(axes, shape)
        for (x, y), value in zip(path, spin[on_path], strict=True):
            turn = "" if value == 0 else "↺" if value > 0 else "↻"
            axes.text(x, y, turn, ha="center", va="center", fontsize=100 / max(shape))
        return
    frame_block(axes, shape)
    shadow = seen(np.column_stack([path[:, :2], np.full(len(path), -0.5)]))
    axes.plot(*shadow[:, :2].T, color=GREEN, alpha=0.4, lw=1.0, zorder=1)
    placed = seen(path)
    order = np.argsort(placed[:, 2])
    paint_spheres(axes, placed[order][:, :2], colour[order])
    arrow = 1.6 * seen(spin[on_path])[order]
    axes.quiver(
        *placed[order][:, :2].T, *arrow[:, :2].T, angles="xy", scale_units="xy", scale=1, zorder=5, units="xy",
        width=0.02 * np.sqrt(max(shape)), color="black", edgecolor="white", lw=0.3, headwidth=3.5, headlength=4,
        minlength=0.5,
    )  # fmt: skip
