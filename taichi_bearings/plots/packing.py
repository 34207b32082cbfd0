"""A packing on paper: discs or spheres of their radii, coloured by how fast they turn, and its contacts."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from taichi_bearings.analysis.domains import RigidDomains
from taichi_bearings.packing import Packing, PackingSolution
from taichi_bearings.plots.domains import colour_of_turn
from taichi_bearings.plots.lattice import MOST_LINES, SPIN_COLOURS, colour_bar
from taichi_bearings.plots.page import PAGE, VIEW, Page
from taichi_bearings.plots.power import POWER_COLOURS
from taichi_bearings.plots.style import GREY, in_our_style, new_figure, put_title
from taichi_bearings.plots.symbols import describe
from taichi_bearings.proof.contact_state import ContactState

PACKING_FIGURES = ("spins", "power", "network")
PACKING_BAR = 0.75  # inches of a colour bar with its label
SHADE = 0.55  # of the colour of spheres that lie farthest behind


@dataclass(frozen=True)
class _Canvas:
    """Axes in lengths. seen : (N, 3) centres, and normal : (E, 3), from the reader. site : points to a radius."""

    figure: Figure
    axes: Any
    seen: np.ndarray
    normal: np.ndarray
    site: float


def _canvas(packing: Packing, page: Page) -> _Canvas:
    view = page.view or VIEW
    flat = packing.dimension == 2
    seen = np.column_stack([packing.center, np.zeros(packing.spheres)]) if flat else view.seen(packing.center)
    normal = np.asarray(packing.normal)
    normal = np.column_stack([normal, np.zeros(packing.contacts)]) if flat else view.seen(normal)
    radius = np.asarray(packing.radius)
    low, high = (seen[:, :2] - radius[:, None]).min(axis=0), (seen[:, :2] + radius[:, None]).max(axis=0)
    width = page.inches("single")
    height = (width - PACKING_BAR) * float(np.clip((high - low)[1] / (high - low)[0], 0.3, 2.0))
    figure = new_figure(width, height + 0.1, page.dpi)
    axes = figure.add_subplot(aspect="equal", xticks=[], yticks=[], xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_axis_off()
    site = 72 * (width - PACKING_BAR) / float((high - low)[0]) * float(np.median(radius))
    return _Canvas(figure, axes, seen, normal, site)


@in_our_style
def draw_domains_of_packing(result: PackingSolution, domains: RigidDomains, page: Page = PAGE) -> Figure:
    """Rigid domains: with two bodies in bearing states as they turn between them, blue as the first and red as the
    second, else each of the largest in a colour of its own; of discs walls between domains in black."""
    packing, canvas = result.packing, _canvas(result.packing, page)
    flat, between = packing.dimension == 2, bool(domains.jump.any())
    own = colormaps["tab20"](np.minimum(np.arange(domains.number), 19))
    colour = (
        colour_of_turn(domains.turn[:, domains.jump.any(axis=0)])
        if between
        else np.where((domains.spheres > 1)[:, None], own, 0.9)
    )
    _spheres(canvas.axes, packing, canvas.seen, colour[domains.domain], flat)
    apart = domains.domain[packing.contact[:, 0]] != domains.domain[packing.contact[:, 1]]
    if flat and apart.sum() <= MOST_LINES:
        _lines(canvas.axes, _walls(packing, apart), canvas.site, colors="black")
    if between and domains.jump.shape[1] == 1:
        colour_bar(canvas.figure, canvas.axes, "turn, from the first body to the second", Normalize(0, 1), SPIN_COLOURS)
    kinds = ", ".join(f"{count:,} {kind}" for kind, count in domains.domains_of_kind().items() if count)
    put_title(canvas.figure, f"{describe(packing)}\n{domains.number:,} rigid domains, locked to: {kinds}", page)
    return canvas.figure


@in_our_style
def draw_packing(result: PackingSolution, kind: str = "spins", page: Page = PAGE, note: str = "") -> Figure:
    """kind : "spins", the surface speed of every sphere and, of discs, slipping contacts in black; "power", of slipping
    contacts; "network", the slipless contacts. Spheres are drawn from the back to the front, driven ones with a rim.
    note : more of the title."""
    packing, canvas = result.packing, _canvas(result.packing, page)
    flat, figure, axes = packing.dimension == 2, canvas.figure, canvas.axes
    seen, normal, site = canvas.seen, canvas.normal, canvas.site
    chosen = result.state == (ContactState.SLIPLESS if kind == "network" else ContactState.SLIPPING)
    words = f"{int(chosen.sum()):,} of {int((result.state != ContactState.DRIVEN).sum()):,} contacts "
    words += "do not slip" if kind == "network" else "slip, in black" if kind == "spins" and flat else "slip"
    if kind == "spins":
        speed, fastest = _speed(result)
        _spheres(axes, packing, seen, colormaps[SPIN_COLOURS](speed / fastest), flat)
        if flat and chosen.sum() <= MOST_LINES:
            _lines(axes, _walls(packing, chosen), site, colors="black")
        colour_bar(figure, axes, r"$R\,|\omega|$ over the largest imposed", Normalize(0, 1), SPIN_COLOURS)
    else:
        _spheres(axes, packing, seen, np.array([[0.93, 0.93, 0.93, 1.0 if flat else 0.25]]), flat)
        lines = _along(packing, seen, normal, chosen)
    if kind == "network":
        _lines(axes, lines, site, colors=GREY)
    if kind == "power":
        power = result.power_per_contact[chosen]
        some = power[power > 0]
        norm = LogNorm(float(np.quantile(some, 0.02)), float(some.max())) if len(some) else LogNorm(0.1, 1.0)
        _lines(axes, lines, 2 * site, colors=np.tile(colormaps[POWER_COLOURS](norm(power)), (2, 1)))
        colour_bar(figure, axes, "power of a contact (energy / time)", norm, POWER_COLOURS, extend="min")
    put_title(figure, f"{describe(packing)}{note}\n{words}", page)
    return figure


def _speed(result: PackingSolution) -> tuple[np.ndarray, float]:
    """Surface speeds (N,), and the largest imposed one, or 1."""
    packing = result.packing
    surface = result.spin.reshape(packing.spheres, -1) * np.asarray(packing.radius)[:, None]
    return np.linalg.norm(surface, axis=1), float(np.linalg.norm(packing.imposed, axis=1).max(initial=0.0)) or 1.0


def _spheres(axes: Any, packing: Packing, seen: np.ndarray, colour: np.ndarray, flat: bool) -> None:
    """Discs of their radii, from the back to the front, those behind darker."""
    order = np.argsort(seen[:, 2], kind="stable")
    colour = np.broadcast_to(colour, (packing.spheres, 4))[order].copy()
    if not flat and np.ptp(seen[:, 2]) > 0:
        near = (seen[order, 2] - seen[:, 2].min()) / np.ptp(seen[:, 2])
        colour[:, :3] *= (SHADE + (1 - SHADE) * near)[:, None]
    size = 2 * np.asarray(packing.radius)[order]
    rim = np.where(packing.driven[order] >= 0, 0.6, 0.1)
    axes.add_collection(
        EllipseCollection(
            size, size, np.zeros(len(size)), units="xy", offsets=seen[order, :2], transOffset=axes.transData,
            facecolors=colour, edgecolors="black", linewidths=rim, rasterized=len(size) > MOST_LINES,
        )
    )  # fmt: skip


def _along(packing: Packing, seen: np.ndarray, normal: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Both halves (2 n, 2, 2) of contacts, each from a centre to the contact: over a periodic side they lead out."""
    first, second = packing.contact[chosen].T
    radius, along = np.asarray(packing.radius)[:, None], normal[chosen, :2]
    starts = [(seen[i, :2], seen[i, :2] + sign * radius[i] * along) for i, sign in ((first, 1), (second, -1))]
    return np.concatenate([np.stack(ends, axis=1) for ends in starts])


def _walls(packing: Packing, chosen: np.ndarray) -> np.ndarray:
    """Lines (n, 2, 2) across contacts of discs, as long as the smaller radius."""
    first, second = packing.contact[chosen].T
    radius, normal = np.asarray(packing.radius), packing.normal[chosen]  # type: ignore[index]
    middle = packing.center[first] + radius[first, None] * normal
    half = 0.7 * np.minimum(radius[first], radius[second])[:, None] * np.column_stack([-normal[:, 1], normal[:, 0]])
    return np.stack([middle - half, middle + half], axis=1)


def _lines(axes: Any, lines: np.ndarray, site: float, **look: Any) -> None:
    width = float(np.clip(0.15 * site, 0.3, 2.0))
    axes.add_collection(LineCollection(list(lines), lw=width, rasterized=len(lines) > MOST_LINES, **look))
