"""How unevenly the links carry the paths and the current from bottom to top, over the samples of a run."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from taichi_bearings.analysis.bottlenecks import Loads
from taichi_bearings.plots.page import PAGE, Page, columns_on
from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, new_figure

SHARES = np.geomspace(1e-5, 1.0, 301)
"""Where the distributions are drawn."""


@in_our_style
def draw_load_distribution(samples: Sequence[Loads], page: Page = PAGE) -> Figure:
    """Part of the links that carry a share or more: of the shortest paths, and of the current.

    Links of all samples together, over thin lines for each alone. Samples without a path are counted, not drawn.
    """
    columns = columns_on(page, 2)
    figure = new_figure(page.inches("double"), 2.8 if columns == 2 else 4.6, page.dpi)
    joined = [(share, current) for share, current in samples if current.any()]
    panels: Any = figure.subplots(3 - columns, columns, sharex=True, sharey=True)
    for axes, name, colour, parts in (
        (panels[0], "shortest paths", BLUE, [share for share, _ in joined]),
        (panels[1], "current", ORANGE, [current for _, current in joined]),
    ):
        _draw(axes, parts, colour)
        axes.set_xlabel(f"share $s$ of the {name}")
    lowest = min((1 / len(share) for share, _ in joined), default=1e-3)
    panels[0].set(xscale="log", yscale="log", xlim=(SHARES[0], 1.5), ylim=(lowest / 2, 1.3))
    panels[0].set_ylabel("part of the links that carry $s$ or more")
    figure.suptitle(_count(len(joined), len(samples)))
    return figure


def _draw(axes: Any, parts: Sequence[np.ndarray], colour: str) -> None:
    """Curves of the loads (links,) of each sample, and of all together."""
    if not parts:
        return
    alone = [np.column_stack([SHARES, carrying(load)]) for load in parts]
    axes.add_collection(LineCollection(alone, colors=GREY, linewidths=0.6, alpha=0.6, label="a sample alone"))
    axes.plot(SHARES, carrying(np.concatenate(parts)), color=colour, lw=1.6, label="all links together")
    axes.legend(loc="lower left")


def carrying(load: np.ndarray) -> np.ndarray:
    """Part of the links that carry each of SHARES or more; load : (links,). Not-a-number where none does."""
    number = len(load) - np.searchsorted(np.sort(load), SHARES * (1 - 1e-9))  # a load of 1 may be rounded
    return np.where(number > 0, number / len(load), np.nan)


def _count(joined: int, samples: int) -> str:
    if joined == 0:
        return f"No path joins the planes in any of {samples:,} samples"
    rest = f"; {samples - joined:,} without one are not drawn" if joined < samples else ""
    return f"{joined:,} of {samples:,} samples with a path from bottom to top{rest}"
