"""The spins of a run: discs in 2D, spheres and cuts in 3D (paper Figs. 1, 3a and 4)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from taichi_bearings.plots.lattice import (
    COLOURS,
    box_driven_rows,
    contacts_in_plane,
    draw_speed_bar,
    draw_walls,
    middle_cuts,
    name_cut,
    paint_block,
    paint_plane,
    speed_of,
)
from taichi_bearings.plots.style import in_our_style, new_figure
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene


@in_our_style
def draw_spins(scene: Scene, spin: np.ndarray, state: Sequence[np.ndarray]) -> Figure:
    """|spin| over the larger imposed spin, as colour; slipping contacts in black (2D and cuts).

    spin : laboratory frame, (*N) or (*N, 3). state : of the contacts, one array (*contacts) an axis.
    """
    speed = speed_of(spin, scene.spin_top, scene.spin_bottom)
    colour = colormaps[COLOURS](speed)
    slips = tuple(values == ContactState.SLIPPING for values in state)
    return _draw_discs(colour, slips) if speed.ndim == 2 else _draw_spheres(colour, slips)


def _draw_discs(colour: np.ndarray, slips: tuple[np.ndarray, ...]) -> Figure:
    nx, ny = colour.shape[:2]
    figure = new_figure(5.6, 5.6 * min(2.0, max(0.5, ny / nx)) * 0.85)
    axes = figure.add_subplot()
    _paint(axes, colour, slips)
    box_driven_rows(axes, (nx, ny))
    draw_speed_bar(figure, axes, shrink=0.8)
    return figure


def _paint(axes: Any, colour: np.ndarray, slips: tuple[np.ndarray, ...]) -> None:
    """Discs of one plane and the slipping contacts between them."""
    paint_plane(axes, colour)
    draw_walls(axes, slips, colors="black", lw=1.0 if len(colour) <= 40 else 0.4)


def _draw_spheres(colour: np.ndarray, slips: tuple[np.ndarray, ...]) -> Figure:
    """The block of spheres from outside, and two cuts through its middle with the slipping contacts."""
    figure = new_figure(11.0, 4.2)
    block = figure.add_subplot(1, 3, 1, projection="3d", computed_zorder=True)
    paint_block(block, colour)
    block.set_title("|spin| on three sides", fontsize=9)
    for place, (axis, index) in enumerate(middle_cuts(colour.shape)):
        axes = figure.add_subplot(1, 3, 2 + place)
        _paint(axes, np.take(colour, index, axis), contacts_in_plane(slips, axis, index))
        name_cut(axes, axis, index, after=", slipping contacts in black")
    draw_speed_bar(figure, figure.axes, shrink=0.7)
    return figure
