"""Where the paths between the driven planes run: each link by the share of the shortest paths that it carries."""

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.lattice import Lattice
from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, new_figure

COLOURS = "viridis_r"
LEAST_SHARE = 1e-3  # of the pairs, that a link must carry to get a colour
MOST_IDLE = 4000  # links without a colour are drawn, in grey, up to this number


@in_our_style
def draw_bottlenecks(found: Bottlenecks, title: str = "") -> Figure:
    """Map of the loaded links beside the number of links that carry at least a given share."""
    figure = new_figure(10.5, 5.2)
    network = found.network
    flat = network.lattice.dimension == 2
    parts: Any = figure.add_gridspec(1, 2, width_ratios=(1.35, 1))
    place = figure.add_subplot(
        parts[0], projection=None if flat else "3d", **({} if flat else {"computed_zorder": False})
    )
    _draw_planes(place, network.lattice)
    _draw_links(figure, place, found)
    _draw_limits(place, found)
    _draw_ranks(figure.add_subplot(parts[1]), found)
    if title:
        figure.suptitle(title)
    return figure


def _draw_planes(place: Any, lattice: Lattice) -> None:
    """The driven planes, and limits that hold the whole lattice."""
    last = [n - 1 for n in lattice.shape]
    if lattice.dimension == 2:
        for height in (0, last[1]):
            place.plot([0, last[0]], [height, height], color=GREY, lw=3, alpha=0.4, solid_capstyle="round", zorder=0)
        place.set(xlim=(-0.5, last[0] + 0.5), ylim=(-0.5, last[1] + 0.5), xlabel="x", ylabel="y", aspect="equal")
        return
    corners = [(0, 0), (last[0], 0), (last[0], last[1]), (0, last[1])]
    planes = [[(x, y, z) for x, y in corners] for z in (0, last[2])]
    place.add_collection3d(Poly3DCollection(planes, facecolor=GREY, alpha=0.12, edgecolor=GREY, lw=0.6))
    place.set(xlim=(0, last[0]), ylim=(0, last[1]), zlim=(0, last[2]), xlabel="x", ylabel="y", zlabel="z")
    place.set_box_aspect(lattice.shape, zoom=1.08)
    place.view_init(elev=14, azim=-62)
    place.grid(False)
    for axis in (place.xaxis, place.yaxis, place.zaxis):
        axis.pane.set_visible(False)
        axis.get_major_locator().set_params(nbins=4, integer=True)


def _draw_links(figure: Figure, place: Any, found: Bottlenecks) -> None:
    """Links coloured and thickened by their share; the others in grey, if they are not too many to be seen through."""
    segments = _segments(found)
    loaded = np.flatnonzero(found.share >= LEAST_SHARE)
    loaded = loaded[np.argsort(found.share[loaded])]  # the heaviest on top
    idle = np.flatnonzero(found.share < LEAST_SHARE)
    if len(idle) <= MOST_IDLE:
        _add(place, segments[idle], colors=GREY, linewidths=0.5, alpha=0.35, zorder=1)
    share = found.share[loaded]
    weight = 1 + np.log10(np.maximum(share, LEAST_SHARE)) / -np.log10(LEAST_SHARE)
    lines = _add(
        place, segments[loaded], cmap=COLOURS, norm=LogNorm(LEAST_SHARE, 1), linewidths=0.5 + 3 * weight**2, zorder=2
    )
    lines.set_array(share)
    kept = f"{len(loaded)} of {len(segments)} links carry more than {LEAST_SHARE:g}"
    place.set_title("No path joins the planes" if not found.betweenness.pairs else kept, fontsize=9)
    figure.colorbar(lines, ax=place, label="share of the shortest paths", shrink=0.7, pad=0.08, location="left")


def _draw_limits(place: Any, found: Bottlenecks) -> None:
    """Links that part the planes alone, else the smallest sets that do."""
    middle = _segments(found).mean(axis=1)
    paths = found.network.disjoint_paths
    style = {"linestyle": "none", "markerfacecolor": "none", "zorder": 3}
    if paths.number == 1:
        alone = middle[found.backbone.parting_links]
        place.plot(*alone.T, marker="o", ms=11, mec=ORANGE, mew=1.8, label="parts the planes alone", **style)
    elif paths.number:
        for name, chosen, marker in (("lowest", paths.lowest, "v"), ("highest", paths.highest, "^")):
            label = f"{name} of the smallest parting sets ({paths.number} links)"
            place.plot(*middle[chosen].T, marker=marker, ms=6, mec=ORANGE, mew=1.2, label=label, **style)
    if paths.number:
        place.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0 if middle.shape[1] == 3 else -0.12), fontsize=8)


def _draw_ranks(axes: Any, found: Bottlenecks) -> None:
    """Number of links that carry at least a share: of the shortest paths, and of the current."""
    for name, load, colour in (
        ("shortest paths", found.share, BLUE),
        ("current", found.current.link, ORANGE),
    ):
        falling = np.sort(load[load > 1e-12])[::-1]
        axes.plot(falling, 1 + np.arange(len(falling)), color=colour, lw=1.6, label=name, drawstyle="steps-pre")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="share $s$ of the pairs, or of the current",
        ylabel="links that carry $s$ or more",
    )
    axes.set(xlim=(1e-6, 1.5), ylim=(0.8, 2 * max(5, len(found.share))))
    axes.legend(loc="lower left")
    axes.set_title("Spread of the load", fontsize=9)


def _segments(found: Bottlenecks) -> np.ndarray:
    """Both ends (E, 2, dimension) of each link."""
    network = found.network
    return np.stack(
        [network.contact, network.contact + np.eye(network.lattice.dimension, dtype=int)[network.axis]], axis=1
    )


def _add(place: Any, segments: np.ndarray, **look: Any) -> Any:
    """Add lines to 2D or 3D axes."""
    if segments.shape[2] == 2:
        return place.add_collection(LineCollection(list(segments), **look))
    return place.add_collection3d(Line3DCollection(list(segments), **look), autolim=False)
