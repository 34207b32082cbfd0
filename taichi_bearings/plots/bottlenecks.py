"""Where the paths between the driven planes run: each link by the share of the shortest paths that it carries."""

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from taichi_bearings.analysis.bottlenecks import LEAST_LOAD, Bottlenecks
from taichi_bearings.lattice import Lattice
from taichi_bearings.plots.lattice import ends_of, frame_block, line_on_site, site_on_paper, up_to_the_sides
from taichi_bearings.plots.page import PAGE, Page, View, columns_on
from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, new_figure

LOAD_COLOURS = "viridis_r"
LEAST_PAIR_SHARE = 1e-3  # of the pairs, that a link must carry to get a colour
SIDEWAYS = View(14.0, -62.0)
MOST_IDLE = 4000  # links without a colour are drawn, in grey, up to this number


@in_our_style
def draw_bottlenecks(found: Bottlenecks, title: str = "", page: Page = PAGE) -> Figure:
    """Map of the loaded links beside the number of links that carry at least a given share."""
    columns, lattice = columns_on(page, 2), found.network.lattice
    width = page.inches("double")
    figure = new_figure(width, 3.6 if columns == 2 else 6.0, page.dpi)
    ratios: Any = {"width_ratios": (1.35, 1)} if columns == 2 else {"height_ratios": (1.4, 1)}
    place, ranks = figure.subplots(3 - columns, columns, **ratios)
    view = page.view or SIDEWAYS
    ends, which = ends_of(lattice.by_axis(found.network.slipless))
    placed = up_to_the_sides(ends, lattice.shape)
    placed = placed if lattice.dimension == 2 else view.seen(placed)[..., :2]
    _draw_planes(place, lattice, view)
    site = site_on_paper(0.4 * width * (2 if columns == 1 else 1), (1.6 * max(lattice.shape),) * 2)
    _draw_links(figure, place, found, placed, which, site)
    _draw_limits(place, found, placed.mean(axis=1), which)
    _draw_ranks(ranks, found)
    if title:
        figure.suptitle(title)
    return figure


def _draw_planes(place: Any, lattice: Lattice, view: View) -> None:
    """The driven planes, and limits that hold the whole lattice."""
    if lattice.dimension == 3:
        frame_block(place, lattice.shape, view)
        return
    last = [n - 1 for n in lattice.shape]
    for height in (0, last[1]):
        place.plot([0, last[0]], [height, height], color=GREY, lw=3, alpha=0.4, solid_capstyle="round", zorder=0)
    place.set(xlim=(-0.5, last[0] + 0.5), ylim=(-0.5, last[1] + 0.5), xlabel="$x$", ylabel="$y$", aspect="equal")


def _draw_links(
    figure: Figure, place: Any, found: Bottlenecks, placed: np.ndarray, which: np.ndarray, site: float
) -> None:
    """Links coloured and thickened by their share; the others in grey, if they are not too many to be seen through."""
    shares = found.share[which]
    loaded = np.flatnonzero(shares >= LEAST_PAIR_SHARE)
    loaded = loaded[np.argsort(shares[loaded])]  # the heaviest on top
    idle = np.flatnonzero(shares < LEAST_PAIR_SHARE)
    if len(idle) <= MOST_IDLE:
        place.add_collection(LineCollection(list(placed[idle]), colors=GREY, lw=0.4, alpha=0.35, zorder=1.5))
    share = shares[loaded]
    weight = 1 + np.log10(np.maximum(share, LEAST_PAIR_SHARE)) / -np.log10(LEAST_PAIR_SHARE)
    width = 0.3 + line_on_site(site, 0.35, 1.0, 2.5) * weight**2
    norm = LogNorm(LEAST_PAIR_SHARE, 1)
    lines = LineCollection(list(placed[loaded]), array=share, cmap=LOAD_COLOURS, norm=norm, linewidths=width, zorder=2)
    place.add_collection(lines)
    number = int((found.share >= LEAST_PAIR_SHARE).sum())
    kept = f"{number:,} of {len(found.share):,} links carry more than {LEAST_PAIR_SHARE:g}"
    place.set_title("No path joins the planes" if not found.betweenness.pairs else kept)
    figure.colorbar(lines, ax=place, label="share $s$ of the shortest paths", shrink=0.7, pad=0.04, location="left")


def _draw_limits(place: Any, found: Bottlenecks, middle: np.ndarray, which: np.ndarray) -> None:
    """Links that part the planes alone, else the smallest sets that do; middle : (m, 2) of the lines of links."""
    paths, (lowest, highest) = found.network.disjoint_paths, found.network.parting_sets
    style = {"linestyle": "none", "markerfacecolor": "none", "zorder": 3}
    if paths == 1:
        alone = middle[found.parting[which]]
        place.plot(*alone.T, marker="o", ms=8, mec=ORANGE, mew=1.4, label="parts the planes alone", **style)
    elif paths:
        for name, chosen, marker in (("lowest", lowest, "v"), ("highest", highest, "^")):
            label = f"{name} of the smallest parting sets ({paths} links)"
            place.plot(*middle[chosen[which]].T, marker=marker, ms=4.5, mec=ORANGE, mew=1.0, label=label, **style)
    if paths:
        place.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0 if found.network.lattice.dimension == 3 else -0.12))


def _draw_ranks(axes: Any, found: Bottlenecks) -> None:
    """Number of links that carry at least a share of the shortest paths."""
    falling = np.sort(found.share[found.share > LEAST_LOAD])[::-1]
    axes.plot(falling, 1 + np.arange(len(falling)), color=BLUE, lw=1.2, drawstyle="steps-pre")
    axes.set(xscale="log", yscale="log", xlim=(1e-6, 1.5), ylim=(0.8, 2 * max(5, len(found.share))))
    axes.set(xlabel="share $s$ of the shortest paths", ylabel="links that carry $s$ or more")
    axes.set_title("Spread of the load")
