"""The network of slipless contacts and a path through it from bottom to top (paper Figs. 3b and 3c)."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.plots import lattice
from taichi_bearings.plots.page import PAGE, VIEW, Page, View, columns_on
from taichi_bearings.plots.style import GREEN, GREY, in_our_style, panels, put_title

NO_PATH = "no path from bottom to top"
PANELS = {"spheres": "from outside", "contacts": "slipless contacts", "path": "spheres of the path, their spins"}
REACHED_COLOURS = {"bottom": colormaps[lattice.SPIN_COLOURS](0.05), "top": colormaps[lattice.SPIN_COLOURS](0.95)}


@in_our_style
def draw_network(
    network: SliplessNetwork, spin: np.ndarray, spin_top: float, spin_bottom: float, page: Page = PAGE
) -> Figure:
    """3D: the spheres from outside; slipless contacts in grey and one shortest path in green; the spheres of the path
    with their spins. 2D: the last two.

    Of more contacts than can be told apart those on the sides behind the path are drawn: nothing hides it then.
    spin : laboratory frame, N or (*N, 3), 1/time. Where no path joins bottom and top the figure says so, and contacts
    joined to the bottom are blue, those joined to the top red.
    """
    path, speed = network.shortest_path, lattice.speed_of(spin, spin_top, spin_bottom)
    flat, some = spin.ndim == 2, len(network.ends.T) > 0
    drawn = ["spheres"] * (not flat) + ["contacts"] * (flat or some) + ["path"] * (len(path) > 0)
    below, view = columns_on(page, len(drawn)) == 1, page.view or VIEW
    figure, each, width = panels(page, len(drawn), (0.9, 0.3), 0.4 if below else 0.0, widest="single")
    words = f"{network.ends.shape[1]:,} slipless contacts, {f'a path of {len(path) - 1}' if len(path) else NO_PATH}"
    for letter, panel, axes in zip("abc", drawn, each, strict=False):
        axes.set_title(f"({letter}) {PANELS[panel]}" if len(drawn) > 1 else "")
        if panel == "spheres":
            lattice.paint_block(axes, colormaps[lattice.SPIN_COLOURS](speed), view)
        elif panel == "contacts":
            words += _draw_contacts(axes, network, view, 0.85 * width)
        else:
            _draw_turning(axes, network, spin / (max(abs(spin_top), abs(spin_bottom)) or 1.0), speed, view)
    if not flat or len(path):
        lattice.draw_speed_bar(figure, each, spin_top, spin_bottom, below, shrink=0.6)
    if some and not network.spans:
        colours: dict[str, Any] = {**REACHED_COLOURS, "neither": GREY}
        marks = [Line2D([], [], color=colour, label=end) for end, colour in colours.items()]
        figure.legend(handles=marks, title="joined to", loc="outside lower center", ncols=3)
    put_title(figure, words, page)
    return figure


def contact_colours(network: SliplessNetwork) -> np.ndarray:
    """Colour (E, 4) of each slipless contact."""
    colour = np.tile(to_rgba(GREY), (network.ends.shape[1], 1))
    if not network.spans:
        piece = network.component.ravel()
        of_edge = piece[network.ends[0]]
        colour[of_edge == piece[0]] = REACHED_COLOURS["bottom"]
        colour[of_edge == piece[-1]] = REACHED_COLOURS["top"]
    return colour


def behind(points: np.ndarray, shape: tuple[int, ...], view: View) -> np.ndarray:
    """True for contacts (E, 2, 3) within the sides of a cubic lattice that are farthest from the reader."""
    far = np.array([0 if view.faces(axis) else n - 1 for axis, n in enumerate(shape)])
    inside: np.ndarray = (points == far).all(axis=1).any(axis=1)
    return inside


def _draw_contacts(axes: Any, network: SliplessNetwork, view: View, width: float) -> str:
    """The contacts and the path on so many inches; returns which contacts are drawn, in words, if not all."""
    shape = network.lattice.shape
    ends, which = lattice.ends_of(network.lattice.by_axis(network.slipless))
    points, trace = lattice.up_to_the_sides(ends, shape), lattice.broken(network.shortest_path, network.path_steps)
    colour, words = contact_colours(network)[which], ""
    if len(shape) == 2:
        lattice.frame_plane(axes, shape)
        lattice.box_driven_rows(axes, shape)
        lines = points
        line = lattice.line_on_site(lattice.site_on_paper(width, shape, width), 0.12, 0.2)
    else:
        lattice.frame_block(axes, shape, view)
        if len(points) > lattice.MOST_LINES:
            chosen = behind(points, shape, view)
            points, colour, words = points[chosen], colour[chosen], "; drawn: the sides behind"
        placed = view.seen(points)
        order = np.argsort(placed[..., 2].mean(axis=1))
        lines, colour = placed[order][..., :2], colour[order]
        near = np.linspace(0.0, 1.0, len(order))
        line = lattice.line_on_site(72 * width / max(shape) / 1.6, 0.12, 0.3, 1.0)
        colour[:, 3] = 0.2 + 0.6 * near if not words else 0.7
        trace = view.seen(trace)[:, :2]
    if not len(lines):
        axes.text(0.5, 0.5, "every contact slips", transform=axes.transAxes, ha="center", va="center")
    many = len(lines) > lattice.MOST_LINES
    axes.add_collection(LineCollection(list(lines), colors=colour, lw=line, rasterized=many, label="slipless contacts"))
    lattice.draw_path(axes, trace, max(shape))
    return words


def _draw_turning(axes: Any, network: SliplessNetwork, spin: np.ndarray, speed: np.ndarray, view: View) -> None:
    """The spheres of the path from the back to the front, an arrow of the spin from each centre, and the path's shadow
    on the bottom."""
    path, shape = network.shortest_path, network.lattice.shape
    on_path = tuple(path.T)
    colour = colormaps[lattice.SPIN_COLOURS](speed[on_path])
    if len(shape) == 2:
        every = np.ones((*shape, 4))
        every[on_path] = colour
        lattice.paint_plane(axes, every)
        lattice.box_driven_rows(axes, shape)
        for (x, y), value in zip(path, spin[on_path], strict=True):
            turn = "" if value == 0 else "↺" if value > 0 else "↻"
            axes.text(x, y, turn, ha="center", va="center", fontsize=max(3.0, 60 / max(shape)))
        return
    lattice.frame_block(axes, shape, view)
    shadow = lattice.broken(path, network.path_steps)
    shadow[:, 2] = -0.5
    shadow = view.seen(shadow)
    axes.plot(*shadow[:, :2].T, color=GREEN, alpha=0.4, lw=1.0, zorder=1)
    placed = view.seen(path)
    order = np.argsort(placed[:, 2])
    lattice.paint_spheres(axes, placed[order][:, :2], colour[order])
    arrow = 1.6 * view.seen(spin[on_path])[order]
    axes.quiver(
        *placed[order][:, :2].T, *arrow[:, :2].T, angles="xy", scale_units="xy", scale=1, zorder=5, units="xy",
        width=0.02 * np.sqrt(max(shape)), color="black", edgecolor="white", lw=0.3, headwidth=3.5, headlength=4,
        minlength=0.5,
    )  # fmt: skip
