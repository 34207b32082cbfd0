"""The spins of a run: discs in 2D, spheres and cuts in 3D (paper Figs. 1, 3a and 4)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from taichi_bearings.plots import lattice
from taichi_bearings.plots.page import NARROW, PAGE, VIEW, Page, columns_on, middle_planes
from taichi_bearings.plots.style import in_our_style, new_figure, panels, put_title
from taichi_bearings.plots.symbols import describe
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene

# share of more contacts than a few: lines at nearly all would hide the spins and say nothing
MOST_SLIPS, FEW_SLIPS = 0.9, 1_000
BAR = 0.75  # inches of a colour bar with its label


@in_our_style
def draw_spins(
    scene: Scene, spin: np.ndarray, state: Sequence[np.ndarray], page: Page = PAGE, title: str = "", note: str = ""
) -> Figure:
    """|spin| over the larger imposed spin, as colour; slipping contacts in black (2D and cuts).

    If many slip, and nearly all, they are counted in the title instead.

    spin : laboratory frame, (*N) or (*N, 3). state : of the contacts, one array (*contacts) an axis.
    note : what black lines mean.
    """
    speed = lattice.speed_of(spin, *scene.imposed)
    colour = colormaps[lattice.SPIN_COLOURS](speed)
    slips = tuple(values == ContactState.SLIPPING for values in state)
    slipping = sum(int(values.sum()) for values in slips)
    movable = sum(int((values != ContactState.DRIVEN).sum()) for values in state)
    note = note or "slipping contacts in black"
    if slipping > max(MOST_SLIPS * movable, FEW_SLIPS):
        note = f"{slipping:,} of {movable:,} contacts slip"
        slips = tuple(np.zeros_like(values) for values in slips)
    figure = _draw_discs(colour, slips, page) if speed.ndim == 2 else _draw_spheres(colour, slips, page)
    put_title(figure, f"{title or describe(scene)}\n{note}", page)
    below = speed.ndim == 3 and columns_on(page, len(figure.axes), NARROW) < 3
    lattice.draw_speed_bar(figure, figure.axes, *scene.imposed, below)
    return figure


def _draw_discs(colour: np.ndarray, slips: tuple[np.ndarray, ...], page: Page) -> Figure:
    nx, ny = colour.shape[:2]
    width = page.inches("single")
    height = (width - BAR) * min(2.0, max(0.4, ny / nx))
    figure = new_figure(width, height + 0.1, page.dpi)
    axes = figure.add_subplot()
    _paint(axes, colour, slips, lattice.site_on_paper(width - BAR, (nx, ny), height))
    lattice.box_driven_rows(axes, (nx, ny))
    return figure


def _paint(axes: Any, colour: np.ndarray, slips: tuple[np.ndarray, ...], site: float) -> None:
    """Discs of one plane and the slipping contacts between them."""
    lattice.paint_plane(axes, colour)
    lattice.draw_contacts(axes, slips, across=True, colors="black", lw=lattice.line_on_site(site, 0.15))


def _draw_spheres(colour: np.ndarray, slips: tuple[np.ndarray, ...], page: Page) -> Figure:
    """The block of spheres from outside, and cuts with the slipping contacts."""
    shape = colour.shape[:3]
    planes = page.planes or middle_planes(shape)
    tall = float(np.clip(shape[2] / max(shape[:2]), 0.5, 2.0))
    figure, (block, *cuts), width = panels(page, 1 + len(planes), (0.85 * tall, 0.25), 0.1, NARROW)
    lattice.paint_block(block, colour, page.view or VIEW)
    block.set_title("from outside")
    for axes, (axis, index) in zip(cuts, planes, strict=True):
        plane = np.take(colour, index, axis)
        inside = lattice.contacts_in_plane(slips, axis, index)
        _paint(axes, plane, inside, lattice.site_on_paper(0.85 * width, plane.shape[:2]))
        lattice.name_cut(axes, axis, index)
    return figure
