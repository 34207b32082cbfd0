"""Stationary states of a square lattice under both laws, and how close its two lightest cuts are (paper Fig. 1)."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from taichi_bearings.lattice import Lattice
from taichi_bearings.plots.bearing import SPIN_COLOURS, Sheet, colour_bar
from taichi_bearings.plots.style import BLUE, DOUBLE, GREY, ORANGE, in_our_style, new_figure


@in_our_style
def draw_configurations(viscous: np.ndarray, coulomb: np.ndarray, above: np.ndarray, exact: Any) -> Figure:
    """(a) viscous and (b) Coulomb spins as colour, the minimum cut in black; (c) samples by the distance of their cuts.

    viscous, coulomb : (nx, ny) |spin| over that of the top. above : (nx, ny), the side of the minimum cut. exact : the
    samples of paper.figure_1, with the distance of the second cut and whether descent ended elsewhere.
    """
    figure = new_figure(DOUBLE, 2.5)
    parts: Any = figure.subfigures(1, 2, width_ratios=(2.1, 1.1), wspace=0.05)
    panels, sheet = parts[0].subplots(1, 2), Sheet.of_lattice(Lattice(above.shape))
    names = ("(a) viscous", "(b) Coulomb, minimum cut in black")
    for axes, name, speed in zip(panels, names, (viscous, coulomb), strict=True):
        sheet.paint(axes, colormaps[SPIN_COLOURS](speed).reshape(-1, 4))
        sheet.box_driven(axes)
        axes.set_title(name)
    low, high = above.ravel()[sheet.ends]
    sheet.draw(panels[1], low != high, across=True, colors="black", lw=1.0)
    colour_bar(parts[0], panels, r"$|\omega|\,/\,\omega_T$", Normalize(0, 1), SPIN_COLOURS, pad=0.05)
    _draw_ranks(parts[1].subplots(), exact[np.argsort(exact.distance)])
    return figure


def _draw_ranks(axes: Any, exact: Any) -> None:
    ranks = np.arange(1, len(exact) + 1)
    for chosen, mark, colour, ms, label in (
        (~exact.differs, ".", BLUE, 3, "descent ends at the cut"),
        (exact.differs, "x", ORANGE, 5, "other contacts slip too"),
    ):
        axes.loglog(ranks[chosen], exact.distance[chosen], mark, color=colour, ms=ms, label=label)
    expected = 0.017 * len(exact)
    axes.axvline(expected + 0.5, color=GREY, lw=0.8, ls="--", label="17 of 1000, as in the paper")
    axes.set(xlabel="rank of the sample", ylabel=r"$P_\mathrm{cut,2}\,/\,P_\mathrm{cut} - 1$")
    axes.set_title("(c) near ties of two cuts")
    axes.legend(loc="lower right")
