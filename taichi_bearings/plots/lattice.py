"""A lattice on paper: planes of discs, a block from outside, and what is seen through it from the same side.

A plane has its first index to the right and its second one up. Lines are as wide as a site on paper asks for.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.patches import Circle, Rectangle

from taichi_bearings.lattice import Lattice
from taichi_bearings.plots.page import AXES, BELOW, VIEW, View
from taichi_bearings.plots.style import GREEN, label_in_plain_text
from taichi_bearings.plots.symbols import larger_spin

SPIN_COLOURS = "coolwarm"
MOST_DISCS = 2_500  # beyond, a plane is an image
MOST_LINES = 5_000  # beyond, lines are dots in files of vectors too


def site_on_paper(width: float, shape: Sequence[float], height: float = np.inf) -> float:
    """Points between the centres of two discs, of a plane on so many inches."""
    return 72 * float(min(width / (shape[0] + 0.4), height / (shape[1] + 0.4)))


def line_on_site(site: float, share: float, least: float = 0.4, most: float = 1.5) -> float:
    """Width of a line that takes a share of a site, in points."""
    return float(np.clip(share * site, least, most))


def speed_of(spin: np.ndarray, spin_top: float, spin_bottom: float) -> np.ndarray:
    """|spin| over the larger imposed spin, shape N; spin : N or (*N, 3), laboratory frame."""
    length = np.abs(spin) if spin.ndim == 2 else np.linalg.norm(spin, axis=-1)
    speed: np.ndarray = length / (max(abs(spin_top), abs(spin_bottom)) or 1.0)
    return speed


def draw_speed_bar(
    figure: Any, axes: Any, spin_top: float, spin_bottom: float, below: bool = False, shrink: float = 0.8
) -> None:
    """The colour bar of spheres coloured by :func:`speed_of`."""
    label = rf"$|\omega|\,/\,{larger_spin(spin_top, spin_bottom)}$"
    colour_bar(figure, axes, label, Normalize(0, 1), SPIN_COLOURS, shrink=shrink, **(BELOW if below else {}))


def colour_bar(figure: Any, axes: Any, label: str, norm: Normalize, colours: str, **look: Any) -> None:
    """What the colours of a map say."""
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=axes, label=label, **{"shrink": 0.8, "pad": 0.02, **look})
    if isinstance(norm, LogNorm):
        label_in_plain_text(bar.ax.xaxis if bar.orientation == "horizontal" else bar.ax.yaxis)


def name_cut(axes: Any, axis: int, index: int, before: str = "", after: str = "") -> None:
    """Title and axes of the plane `index` across `axis`."""
    axes.set_title(f"{before}${AXES[axis]} = {index}${after}")
    right, up = (name for name in AXES if name != AXES[axis])
    axes.set(xlabel=f"${right}$", ylabel=f"${up}$")


def contacts_in_plane(contacts: Sequence[np.ndarray], axis: int, index: int) -> tuple[np.ndarray, ...]:
    """Values of the contacts that lie in the plane `index` across `axis`, one array an axis of the plane."""
    return tuple(np.take(values, index, axis) for along, values in enumerate(contacts) if along != axis)


def walls_between(label: np.ndarray, lattice: Lattice) -> tuple[np.ndarray, ...]:
    """True for the contacts whose spheres differ in `label`, one array (*contacts) an axis."""
    low, high = label.ravel()[lattice.ends]
    return lattice.by_axis(low != high)


def ends_of(contacts: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Ends (m, 2, dimension) of the contacts that are True, and which of them each is, (m,); one array an axis.

    A contact across a periodic side is there twice: once from the last sphere on beyond the side, once from beyond the
    other side to the first sphere.
    """
    unit = np.eye(len(contacts), dtype=int)
    ends = [np.argwhere(chosen)[:, None] + [0 * step, step] for step, chosen in zip(unit, contacts, strict=True)]
    return on_both_sides(np.concatenate(ends), sides_of(contacts))


def sides_of(contacts: Sequence[np.ndarray]) -> np.ndarray:
    """Spheres along each axis of a lattice or a plane, (dimension,)."""
    return np.max([values.shape for values in contacts], axis=0)


def on_both_sides(ends: np.ndarray, sides: Sequence[int] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps (n, 2, dimension) from spheres, and those that lead over a side once more where they come back; and which
    step each is."""
    over = np.flatnonzero((ends[:, 1] % sides != ends[:, 1]).any(axis=1))
    back = sides * (ends[over, :1] - ends[over, 1:])
    return np.concatenate([ends, ends[over] + back]), np.append(np.arange(len(ends)), over)


def up_to_the_sides(points: np.ndarray, sides: Sequence[int] | np.ndarray) -> np.ndarray:
    """Points (..., dimension) of contacts; what is beyond a side is drawn up to it, half a contact."""
    return np.clip(points, -0.5, np.asarray(sides) - 0.5)


def paint_plane(axes: Any, colour: np.ndarray) -> None:
    """The discs of one plane; colour : (nx, ny, 4)."""
    nx, ny = colour.shape[:2]
    if nx * ny <= MOST_DISCS:
        circles = [Circle((a, b), 0.47) for a, b in np.ndindex(nx, ny)]
        axes.add_collection(PatchCollection(circles, facecolors=colour.reshape(-1, 4), lw=0))
    else:
        axes.imshow(np.swapaxes(colour, 0, 1), origin="lower", interpolation="nearest")
    frame_plane(axes, (nx, ny))


def frame_plane(axes: Any, shape: tuple[int, ...]) -> None:
    """Limits of a plane of discs, without ticks."""
    axes.set(xlim=(-0.7, shape[0] - 0.3), ylim=(-0.7, shape[1] - 0.3), aspect="equal", xticks=[], yticks=[])
    for side in axes.spines.values():
        side.set_visible(False)


def box_driven_rows(axes: Any, shape: tuple[int, ...]) -> None:
    """Boxes around the imposed rows of a plane."""
    for y in (0, shape[1] - 1):
        axes.add_patch(Rectangle((-0.55, y - 0.55), shape[0] + 0.1, 1.1, fill=False, lw=0.8 if shape[1] <= 50 else 0.4))


def draw_contacts(axes: Any, contacts: Sequence[np.ndarray], across: bool = False, **look: Any) -> LineCollection:
    """A line along each contact of a plane where `contacts` is True, between the two centres; or across it, between the
    two discs. look : arrays have an entry a contact."""
    ends, which = ends_of(contacts)
    if across:
        half = (ends[:, 1] - ends[:, 0])[:, None, ::-1] / 2
        ends = ends.mean(axis=1, keepdims=True) + half * [[-1], [1]]
    every = up_to_the_sides(ends, sides_of(contacts))
    look = {name: value[which] if isinstance(value, np.ndarray) else value for name, value in look.items()}
    return axes.add_collection(LineCollection(list(every), rasterized=len(every) > MOST_LINES, **look))


def paint_block(axes: Any, colour: np.ndarray, view: View = VIEW) -> None:
    """The spheres of a cubic lattice from outside, the driven planes in boxes; colour : (nx, ny, nz, 4)."""
    outside = np.zeros(colour.shape[:3], dtype=bool)
    for axis in range(3):
        np.moveaxis(outside, axis, 0)[-1 if view.faces(axis) else 0] = True
    placed = view.seen(np.argwhere(outside))
    order = np.argsort(placed[:, 2])
    limit_block(axes, colour.shape[:3], view)
    paint_spheres(axes, placed[order, :2], colour[outside][order])
    for z in (0, colour.shape[2] - 1):
        lid = (z > 0) == view.faces(2)  # the other planes are seen from the side alone
        edges = view.seen(box_edges(*plane_box(colour.shape[:3], z)))[are_near(view, lid)][..., :2]
        axes.add_collection(LineCollection(list(edges), colors="black", lw=0.6, zorder=3))


def box_edges(low: Any, high: Any) -> np.ndarray:
    """The twelve edges (12, 2, 3) of an upright box."""
    corners = np.array([[(low, high)[n >> a & 1][a] for a in range(3)] for n in range(8)], dtype=float)
    return corners[[(n, n | 1 << axis) for n, axis in EDGES]]


EDGES = [(n, axis) for n in range(8) for axis in range(3) if not n >> axis & 1]
"""Edges of a box: their first corner, bit a of which says whether it is at the end of axis a, and their axis."""


def are_near(view: View, lid: bool) -> np.ndarray:
    """True for those of the twelve edges of a box that bound a side which faces the reader.

    lid : whether its lid, or its floor where that faces the reader, is open to the view.
    """
    sides = range(3 if lid else 2)
    return np.array([any((n >> a & 1) == view.faces(a) for a in sides if a != axis) for n, axis in EDGES])


def plane_box(shape: tuple[int, ...], z: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of the box around the spheres of one layer."""
    return np.array([-0.5, -0.5, z - 0.5]), np.array([shape[0] - 0.5, shape[1] - 0.5, z + 0.5])


def frame_block(axes: Any, shape: tuple[int, ...], view: View = VIEW) -> None:
    """Boxes around the driven planes of a cubic lattice, seen from outside, and the limits of the picture."""
    for z in (0, shape[2] - 1):
        edges = view.seen(box_edges(*plane_box(shape, z)))[..., :2]
        axes.add_collection(LineCollection(list(edges), colors="black", lw=0.5, zorder=1))
    limit_block(axes, shape, view)


def limit_block(axes: Any, shape: tuple[int, ...], view: View) -> None:
    """The limits of a picture of a whole cubic lattice, without axes."""
    corners = view.seen(box_edges((-0.5,) * 3, np.array(shape) - 0.5)).reshape(-1, 3)
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    margin = 0.02 * (high - low).max()
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal")
    axes.set_axis_off()


def broken(path: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """A path as a line, (L, dimension) and more: where one of its steps (L - 1, dimension) leads over a periodic side
    it goes half a contact on, and comes back, after a row of not-a-number, as much before the next sphere."""
    over = np.flatnonzero((path[:-1] + steps != path[1:]).any(axis=1))
    half = steps[over] / 2
    gaps = np.stack([path[over] + half, np.full(half.shape, np.nan), path[over + 1] - half], axis=1)
    return np.insert(path.astype(float), np.repeat(over + 1, 3), gaps.reshape(-1, path.shape[1]), axis=0)


def draw_path(axes: Any, trace: np.ndarray, longest: int) -> None:
    """A path in green on white, its ends marked; trace : (L, 2). longest : side of the lattice."""
    if len(trace):
        width = float(np.clip(20.0 / longest, 0.9, 1.8))
        axes.plot(*trace.T, color="white", lw=2 * width, zorder=3, solid_joinstyle="round")
        axes.plot(*trace.T, color=GREEN, lw=width, zorder=4, solid_joinstyle="round", label="path")
        axes.plot(*trace[[0, -1]].T, "o", color=GREEN, mec="white", mew=0.8, ms=3 * width, zorder=4)


def paint_spheres(axes: Any, centre: np.ndarray, colour: np.ndarray, radius: float = 0.5) -> None:
    """Shaded spheres as one image, later ones in front; centre : (n, 2) as seen. colour : (n, 4)."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    pixel = max(x1 - x0, y1 - y0) / 1000
    light = lit_sphere(max(5, round(2 * radius / pixel)))
    size = len(light)
    canvas = np.zeros((int((y1 - y0) / pixel) + size, int((x1 - x0) / pixel) + size, 4))
    corner = np.rint((centre - radius - [x0, y0]) / pixel).astype(int)
    for (left, low), tint in zip(corner, colour, strict=True):
        under = canvas[low : low + size, left : left + size]
        painted = np.clip(light[..., :1] * tint[:3] + light[..., 1:2], 0, 1)
        opacity = light[..., 2:]
        under[..., :3] = opacity * painted + (1 - opacity) * np.where(under[..., 3:] > 0, under[..., :3], painted)
        under[..., 3:] = np.maximum(under[..., 3:], opacity)
    extent = (x0, x0 + canvas.shape[1] * pixel, y0, y0 + canvas.shape[0] * pixel)
    axes.imshow(canvas, extent=extent, origin="lower", interpolation="bilinear", zorder=2)
    axes.set(xlim=(x0, x1), ylim=(y0, y1))


def lit_sphere(pixels: int = 96) -> np.ndarray:
    """Diffuse light, gloss and opacity of a unit sphere seen from the front, (pixels, pixels, 3)."""
    x, y = np.meshgrid(*2 * (np.linspace(-1.0, 1.0, pixels),))
    square = x**2 + y**2
    z = np.sqrt(np.clip(1 - square, 0, None))
    towards = np.array([-0.45, 0.55, 0.70])
    cosine = np.clip((x * towards[0] + y * towards[1] + z * towards[2]) / np.linalg.norm(towards), 0, 1)
    opacity = np.clip((1 - np.sqrt(square)) * pixels / 4, 0, 1)
    return np.stack([0.55 + 0.5 * cosine, 0.35 * cosine**24, opacity], axis=-1)
