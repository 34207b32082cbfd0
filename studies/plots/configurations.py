"""Stationary states of a square lattice under both laws, and how close its two lightest cuts are (paper Fig. 1)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from taichi_bearings.plots.lattice import SPIN_COLOURS, box_driven_rows, draw_contacts, paint_plane
from taichi_bearings.plots.style import BLUE, DOUBLE, GREY, ORANGE, in_our_style, new_figure


@in_our_style
def draw_configurations(
    viscous: np.ndarray,
    coulomb: np.ndarray,
    cut: Sequence[np.ndarray],
    distance: np.ndarray,
    differs: np.ndarray,
) -> Figure:
    """(a) viscous and (b) Coulomb spins as colour, the minimum cut in black; (c) samples by the distance of their cuts.

    viscous, coulomb : (nx, ny) |spin| over that of the top. cut : mask of the contacts of the minimum cut, one an axis.
    distance : (S,) weight of the second cut over that of the minimum cut, less 1. differs : (S,), True where descent
    ended with other contacts slipping than those of the cut.
    """
    figure = new_figure(DOUBLE, 2.5)
    parts: Any = figure.subfigures(1, 2, width_ratios=(2.1, 1.1), wspace=0.05)
    panels = parts[0].subplots(1, 2)
    for axes, name, speed in (
        (panels[0], "(a) viscous", viscous),
        (panels[1], "(b) Coulomb, minimum cut in black", coulomb),
    ):
        paint_plane(axes, colormaps[SPIN_COLOURS](speed))
        box_driven_rows(axes, speed.shape)
        axes.set_title(name)
    draw_contacts(panels[1], tuple(cut), across=True, colors="black", lw=1.0)
    parts[0].colorbar(
        ScalarMappable(Normalize(0, 1), SPIN_COLOURS), ax=panels, label=r"$|\omega|\,/\,\omega_T$", shrink=0.8
    )
    _draw_ranks(parts[1].subplots(), distance, differs)
    return figure


def _draw_ranks(axes: Any, distance: np.ndarray, differs: np.ndarray) -> None:
    order = np.argsort(distance)
    ranks, failed = np.arange(1, len(order) + 1), differs[order]
    axes.loglog(ranks[~failed], distance[order][~failed], ".", color=BLUE, ms=3, label="descent ends at the cut")
    axes.loglog(ranks[failed], distance[order][failed], "x", color=ORANGE, ms=5, label="other contacts slip too")
    expected = 0.017 * len(order)
    axes.axvline(expected + 0.5, color=GREY, lw=0.8, ls="--", label="17 of 1000, as in the paper")
    axes.set(xlabel="rank of the sample", ylabel=r"$P_\mathrm{cut,2}\,/\,P_\mathrm{cut} - 1$")
    axes.set_title("(c) near ties of two cuts")
    axes.legend(loc="lower right")
