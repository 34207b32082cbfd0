"""A lattice on paper: planes of discs, a block from outside, and what is seen through it from the same side.

A plane has its first index to the right and its second one up. Blocks are seen from large x, small y and above.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import Normalize
from matplotlib.patches import Circle, Rectangle
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from taichi_bearings.plots.style import GREEN

COLOURS = "coolwarm"
MOST_DISCS = 10_000  # beyond, a plane is an image
ELEVATION, AZIMUTH = 22.0, -55.0  # degrees


def _view(elevation: float, azimuth: float) -> np.ndarray:
    """Rows: to the right, up, towards the reader."""
    (sin_e, sin_a), (cos_e, cos_a) = (f(np.deg2rad([elevation, azimuth])) for f in (np.sin, np.cos))
    return np.array([
        [-sin_a, cos_a, 0.0],
        [-sin_e * cos_a, -sin_e * sin_a, cos_e],
        [cos_e * cos_a, cos_e * sin_a, sin_e],
    ])  # fmt: skip


VIEW = _view(ELEVATION, AZIMUTH)


def speed_of(spin: np.ndarray, spin_top: float, spin_bottom: float) -> np.ndarray:
    """|spin| over the larger imposed spin, shape N; spin : N or (*N, 3), laboratory frame."""
    length = np.abs(spin) if spin.ndim == 2 else np.linalg.norm(spin, axis=-1)
    speed: np.ndarray = length / (max(abs(spin_top), abs(spin_bottom)) or 1.0)
    return speed


def draw_speed_bar(figure: Any, axes: Any, **look: Any) -> None:
    """The colour bar of spheres coloured by :func:`speed_of`."""
    figure.colorbar(ScalarMappable(Normalize(0, 1), COLOURS), ax=axes, label=r"$|\omega| / \omega_{\max}$", **look)


def seen(points: np.ndarray) -> np.ndarray:
    """Points (..., 3) of the lattice as the reader has them: to the right, up, nearer."""
    return points @ VIEW.T


def middle_cuts(shape: tuple[int, ...]) -> tuple[tuple[int, int], tuple[int, int]]:
    """(axis, index) of the two upright planes through the middle of a cubic lattice."""
    return (1, shape[1] // 2), (0, shape[0] // 2)


def name_cut(axes: Any, axis: int, index: int, before: str = "", after: str = "") -> None:
    """Title and axes of the upright plane `index` across `axis`."""
    axes.set_title(f"{before}cut at {'xy'[axis]} = {index}{after}", fontsize=9)
    axes.set(xlabel="yx"[axis], ylabel="z")


def contacts_in_plane(contacts: Sequence[np.ndarray], axis: int, index: int) -> tuple[np.ndarray, ...]:
    """Values of the contacts that lie in the plane `index` across `axis`, one array an axis of the plane."""
    return tuple(np.take(values, index, axis) for along, values in enumerate(contacts) if along != axis)


def walls_between(label: np.ndarray) -> tuple[np.ndarray, ...]:
    """True for the contacts whose spheres differ in `label`, one array (*contacts) an axis."""
    return tuple(np.diff(label.astype(np.int64), axis=axis) != 0 for axis in range(label.ndim))


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
        axes.add_patch(Rectangle((-0.55, y - 0.55), shape[0] + 0.1, 1.1, fill=False, lw=1.0))


def draw_walls(axes: Any, walls: Sequence[np.ndarray], **look: Any) -> LineCollection:
    """A line across each contact of a plane where `walls` is True, between its two discs."""
    return _draw_lines(axes, walls, lambda along, across: [(along - across) / 2, (along + across) / 2], look)


def draw_contacts(axes: Any, contacts: Sequence[np.ndarray], **look: Any) -> LineCollection:
    """A line along each contact of a plane where `contacts` is True, between the two centres."""
    return _draw_lines(axes, contacts, lambda along, across: [0 * along, along], look)


def _draw_lines(axes: Any, contacts: Sequence[np.ndarray], ends: Callable[..., Any], look: dict[str, Any]) -> Any:
    """One line a contact; ends : of the unit vectors along and across it, from its lower disc."""
    unit = np.eye(2)
    lines = [np.argwhere(chosen)[:, None] + ends(unit[axis], unit[1 - axis]) for axis, chosen in enumerate(contacts)]
    return axes.add_collection(LineCollection(list(np.concatenate(lines)), **look))


def squares(centre: np.ndarray, axis: int) -> np.ndarray:
    """Corners (n, 4, 3) of unit squares across `axis`; centre : (n, 3)."""
    u, v = (a for a in range(3) if a != axis)
    corners = np.repeat(np.asarray(centre, dtype=float)[:, None], 4, axis=1)
    corners[:, :, u] += [-0.5, 0.5, 0.5, -0.5]
    corners[:, :, v] += [-0.5, -0.5, 0.5, 0.5]
    return corners


def paint_block(axes: Any, colour: np.ndarray) -> None:
    """The three sides of a cubic lattice that are seen from outside; axes : 3D. colour : (nx, ny, nz, 4)."""
    nx, ny, nz = shape = colour.shape[:3]
    faces, colours = [], []
    for axis, index in ((0, nx - 1), (1, 0), (2, nz - 1)):
        on_face = [n if a != axis else 1 for a, n in enumerate(shape)]
        centre = np.moveaxis(np.indices(on_face), 0, -1).reshape(-1, 3).astype(float)
        centre[:, axis] = index + (0.5 if index else -0.5)
        faces.append(squares(centre, axis))
        colours.append(np.take(colour, index, axis=axis).reshape(-1, 4))
    surface = Poly3DCollection(
        list(np.concatenate(faces)), lw=0.2, edgecolors="white", facecolors=np.concatenate(colours)
    )
    axes.add_collection3d(surface)
    axes.set(xlim=(-0.5, nx - 0.5), ylim=(-0.5, ny - 0.5), zlim=(-0.5, nz - 0.5))
    axes.set_box_aspect((nx, ny, nz), zoom=1.0 if max(shape) < 3 * min(shape) else 0.8)
    axes.set_axis_off()
    axes.view_init(elev=ELEVATION, azim=AZIMUTH)


def box_edges(low: Any, high: Any) -> np.ndarray:
    """The twelve edges (12, 2, 3) of an upright box."""
    corners = np.array([[(low, high)[n >> a & 1][a] for a in range(3)] for n in range(8)], dtype=float)
    pairs = [(n, n | bit) for n in range(8) for bit in (1, 2, 4) if not n & bit]
    return corners[pairs]


def frame_block(axes: Any, shape: tuple[int, ...]) -> None:
    """Boxes around the driven planes of a cubic lattice, seen from outside, and the limits of the picture."""
    nx, ny, nz = shape
    for z, order in ((0, 1), (nz - 1, 1)):
        edges = seen(box_edges((-0.5, -0.5, z - 0.5), (nx - 0.5, ny - 0.5, z + 0.5)))[..., :2]
        axes.add_collection(LineCollection(list(edges), colors="black", lw=0.6, zorder=order))
    corners = seen(box_edges((-0.5,) * 3, np.array(shape) - 0.5)).reshape(-1, 3)
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    margin = 0.02 * (high - low).max()
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal")
    axes.set_axis_off()


def draw_path(axes: Any, trace: np.ndarray, longest: int) -> None:
    """A path in green on white, its ends marked; trace : (L, 2). longest : side of the lattice."""
    if len(trace):
        width = float(np.clip(40.0 / longest, 1.2, 3.0))
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
