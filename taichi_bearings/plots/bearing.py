"""Draws a bearing on paper: discs and contacts of a lattice, of a plane through it or of a packing, or a block of
spheres.

A plane has its first axis to the right and its second one up. Widths of lines follow from how large a disc is on paper.
A *site* is the distance between the centres of two neighbouring discs on paper, in points. Letters: N discs on paper, E
contacts between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from taichi_bearings.lattice import Lattice
from taichi_bearings.plots.page import AXES, BELOW, VIEW, Page, View
from taichi_bearings.plots.style import label_in_plain_text, larger_spin, new_figure
from taichi_bearings.scene import Bearing
from taichi_bearings.scene.network import Network

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

SPIN_COLOURS = "coolwarm"
MOST_DISCS = 2_500  # a plane of more discs is drawn as an image
MOST_LINES = 5_000  # more lines are drawn as pixels in PDF and SVG, too
BAR = 0.75  # width in inches of a colour bar with its label
LEAST_HEIGHT = 0.6  # least height over width of a panel whose colour bar can stand at its right
PALE = np.array([0.93, 0.93, 0.93, 1.0])  # colour of discs that only carry contacts


@dataclass(frozen=True)
class Sheet:
    """A picture of spheres as N discs, with E contacts. All lengths but `rim` are in the unit of the bearing's own
    lengths; on a lattice in diameters of a sphere.

    sphere : (N,), number in the bearing of the sphere that each disc shows.
    place, radius : (N, 2) and (N,), centres and radii on paper.
    rim : (N,), width of the outline of each disc, points.
    depth : (N,), position along the line of sight; discs with larger numbers are nearer to the reader.
    ends : (2, E), indices of the two discs of each contact.
    to_contact : (2, E, 2), vectors from the centres of the two discs to the point of contact; for a contact over a
        periodic side both lead out of the picture.
    half_line : (E,), half the length of a line that is drawn across the contact.
    contact : (E,), number of each contact in the bearing.
    corners : (2, 2), lower left and upper right corner of the picture.
    pitch : distance between the centres of two neighbouring discs.
    grid : numbers of discs along both axes of a plane of a lattice; empty for anything else.
    rows : indices of the driven rows of that plane.
    """

    sphere: np.ndarray
    place: np.ndarray
    radius: np.ndarray
    rim: np.ndarray
    depth: np.ndarray
    ends: np.ndarray
    to_contact: np.ndarray
    half_line: np.ndarray
    contact: np.ndarray
    corners: np.ndarray
    pitch: float = 1.0
    grid: tuple[int, ...] = ()
    rows: tuple[int, ...] = ()

    @classmethod
    def of_lattice(cls, lattice: Lattice, plane: tuple[int, int] | None = None, view: View = VIEW) -> "Sheet":
        """Return the picture of a square lattice, of one plane of a cubic lattice, or of a whole cubic lattice.

        lattice : the lattice.
        plane : number of the axis across the plane, and index of the plane along it; None for the whole lattice.
        view : direction from which a whole cubic lattice is seen.
        """
        across, index = plane or (-1, 0)  # -1: no axis is left out
        center = np.argwhere(np.ones(lattice.shape, dtype=bool))
        inside = center[:, across] == index if plane else np.ones(lattice.sites, dtype=bool)
        contact = np.flatnonzero((lattice.axis != across) & inside[lattice.ends[0]])
        kept = [axis for axis in range(lattice.dimension) if axis != across]
        place, depth = _on_paper(center[inside][:, kept], view)
        half = _on_paper(np.eye(lattice.dimension)[lattice.axis[contact]][:, kept] / 2, view)[0]
        grid = tuple(lattice.shape[axis] for axis in kept)
        return cls(
            np.flatnonzero(inside), place, np.full(len(place), 0.47), np.zeros(len(place)), depth,
            ends=(np.cumsum(inside) - 1)[lattice.ends[:, contact]], to_contact=np.stack([half, -half]),
            half_line=np.full(len(contact), 0.5), contact=contact,
            corners=np.array([[-0.7] * 2, np.array(grid[:2]) - 0.3]),
            grid=grid if len(grid) == 2 else (),
            rows=(0, grid[-1] - 1) if across != lattice.height_axis else (),
        )  # fmt: skip

    @classmethod
    def of_network(cls, network: Network, view: View = VIEW) -> "Sheet":
        """Return the picture of all spheres and contacts of a network; driven spheres have an outline.

        view : from where it is seen.
        """
        radius, ends = network.radius, network.contact
        (place, depth), (normal, _) = _on_paper(network.center, view), _on_paper(network.normal, view)
        to_contact = radius[ends][..., None] * np.stack([normal, -normal])
        rim = np.where(network.free, 0.1 if network.dimension == 2 else 0.3, 0.8)
        margin = 0.05 * float(np.median(radius))  # rims are drawn half outside
        low, high = (place - radius[:, None]).min(axis=0), (place + radius[:, None]).max(axis=0)
        corners = np.stack([low - margin, high + margin])
        return cls(
            np.arange(len(place)), place, radius, rim, depth, ends=ends, to_contact=to_contact,
            half_line=0.7 * radius[ends].min(axis=0), contact=np.arange(network.contacts), corners=corners,
            pitch=2 * float(np.median(radius)),
        )  # fmt: skip

    @property
    def is_flat(self) -> bool:
        """True if no disc lies in front of another one."""
        return not np.ptp(self.depth)

    def site(self, width: float, height: float = np.inf) -> float:
        """Return the distance on paper between the centres of two neighbouring discs, in points, for a picture that
        fits into `width` and `height`, inches.
        """
        return 72 * float((np.array([width, height]) / np.diff(self.corners, axis=0)[0]).min()) * self.pitch

    def frame(self, axes: Axes) -> None:
        """Set the limits of the picture on these axes of matplotlib, and remove ticks and frame."""
        (x0, y0), (x1, y1) = self.corners
        axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xticks=[], yticks=[])
        for side in axes.spines.values():
            side.set_visible(False)

    def paint(self, axes: Axes, colour: np.ndarray) -> None:
        """Draw the discs on axes of matplotlib, from the back to the front.

        colour : (discs N, 4), or (4,) for all.
        """
        # discs of one colour are a background for contacts: where they lie behind each other their rims are grey
        edge = "0.75" if not self.is_flat and colour.shape == (4,) else "black"
        colour = np.broadcast_to(colour, (len(self.place), 4))
        self.frame(axes)
        if self.grid and len(colour) > MOST_DISCS:
            axes.imshow(np.swapaxes(colour.reshape(*self.grid, 4), 0, 1), origin="lower", interpolation="nearest")
            self.frame(axes)
        else:
            order = np.argsort(self.depth, kind="stable")
            colour, size = colour[order], 2 * self.radius[order]
            discs = EllipseCollection(
                size, size, np.zeros(len(size)), units="xy", offsets=self.place[order], transOffset=axes.transData,
                facecolors=colour, edgecolors=edge, linewidths=self.rim[order], rasterized=len(size) > MOST_LINES,
            )  # fmt: skip
            axes.add_collection(discs)

    def box_driven(self, axes: Axes) -> None:
        """Draw boxes around the driven rows of a plane of a lattice, if this picture is one; else nothing.

        axes : axes of matplotlib.
        """
        for y in self.rows:
            width = 0.8 if self.grid[1] <= 50 else 0.4
            axes.add_patch(Rectangle((-0.55, y - 0.55), self.grid[0] + 0.1, 1.1, fill=False, lw=width))

    def lines(self, chosen: np.ndarray, across: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Return lines that show some contacts, and which contacts they show: an array (lines, 2, 2) of the two end
        points of each line, x and y on paper; and (lines,) the index of its contact in this picture.

        chosen : mask over all contacts of the bearing, True for those to be shown.
        across : False for lines from centre to centre, True for lines between the two discs at right angles to that.

        A contact over a periodic side has two lines, at opposite sides: halves of one, or with `across` whole lines.
        """
        which = np.flatnonzero(chosen[self.contact])
        # contacts in the back come first, so that those in front cover them
        which = which[np.argsort(self.depth[self.ends[:, which]].mean(axis=0), kind="stable")]
        center, middle = self.place[self.ends[:, which]], (self.place[self.ends] + self.to_contact)[:, which]
        # a contact whose point of contact is at two places on paper crosses a periodic side and gets a second line
        crosses = np.linalg.norm(middle[0] - middle[1], axis=1) > self.pitch / 2
        of_lines = np.append(which, which[crosses])
        if across:
            along = self.to_contact[0, of_lines]
            length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), np.finfo(float).tiny)
            half = along[:, ::-1] * [-1, 1] * (self.half_line[of_lines, None] / length)  # turned by a right angle
            at = np.concatenate([middle[0], middle[1, crosses]])
            return np.stack([at - half, at + half], axis=1), of_lines
        # from centre to centre, or from centre to point of contact and from point of contact to centre
        start = np.concatenate([center[0], middle[1, crosses]])
        stop = np.concatenate([np.where(crosses[:, None], middle[0], center[1]), center[1, crosses]])
        return np.stack([start, stop], axis=1), of_lines

    def draw(self, axes: Axes, chosen: np.ndarray, across: bool = False, **look: Any) -> None:
        """Draw some contacts as lines.

        axes : axes of matplotlib.
        chosen : mask over all contacts of the bearing.
        across : False for lines from centre to centre, True for lines between the two discs at right angles to that.
        look : arguments of matplotlib's LineCollection; arrays have an entry for each contact of the bearing.
        """
        lines, which = self.lines(chosen, across)
        which = self.contact[which]
        look = {name: value[which] if isinstance(value, np.ndarray) else value for name, value in look.items()}
        axes.add_collection(LineCollection(list(lines), rasterized=len(lines) > MOST_LINES, **look))


def _on_paper(points: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Return places (..., 2) on paper, and depths (...) towards the reader, of points.

    points : (..., 2), which keep their places and get depth 0, or (..., 3).
    view : direction from which points in 3D are seen.
    """
    if points.shape[-1] == 2:
        return points.astype(float), np.zeros(points.shape[:-1])
    seen = view.seen(points)
    return seen[..., :2], seen[..., 2]


def one_panel(network: Network, page: Page) -> tuple[Figure, Axes, Sheet, float, dict[str, Any]]:
    """Return a figure with one panel for a flat lattice or a packing, its axes, the discs on paper, the distance
    between two neighbouring discs in points, and the arguments that place a colour bar where it fits.

    network : spheres and contacts.
    page : how the figure is printed.
    """
    lattice = network.lattice
    sheet = Sheet.of_network(network, page.view or VIEW) if lattice is None else Sheet.of_lattice(lattice)
    wide, tall = np.diff(sheet.corners, axis=0)[0]
    bar_is_below = tall < LEAST_HEIGHT * wide
    width = page.inches("single")
    panel = width - BAR * (not bar_is_below)
    height = panel * float(np.clip(tall / wide, 0.2, 2.0))
    figure = new_figure(width, height + (0.5 if bar_is_below else 0.1), page.dpi)
    axes = figure.add_subplot()
    sheet.frame(axes)
    return figure, axes, sheet, sheet.site(panel, height), BELOW if bar_is_below else {}


def line_on_site(site: float, share: float, least: float = 0.4, most: float = 1.5) -> float:
    """Return the width of a line in points: a share of the distance `site` of two discs, but from `least` to `most`."""
    return float(np.clip(share * site, least, most))


def speed_of(spin: np.ndarray, spin_top: float, spin_bottom: float) -> np.ndarray:
    """Return |spin| over the larger of the two imposed spins, in the shape of the lattice.

    spin : laboratory spins, in the shape of a flat lattice, or (nx, ny, nz, 3).
    spin_top, spin_bottom : the imposed spins, 1/time.
    """
    length = np.abs(spin) if spin.ndim == 2 else np.linalg.norm(spin, axis=-1)
    speed: np.ndarray = length / (max(abs(spin_top), abs(spin_bottom)) or 1.0)
    return speed


def draw_speed_bar(figure: Figure, axes: Axes | list[Axes], scene: Bearing, **look: object) -> None:
    """Draw the colour bar for spheres coloured by |spin| over the larger of the two imposed spins.

    figure, axes : where it is drawn.
    scene : what was solved.
    look : arguments of matplotlib's colorbar.
    """
    label = rf"$|\omega|\,/\,{larger_spin(scene)}$"
    colour_bar(figure, axes, label, Normalize(0, 1), SPIN_COLOURS, **look)


def colour_bar(figure: Figure, axes: Axes | list[Axes], label: str, norm: Normalize, colours: str, **look: Any) -> None:
    """Draw a bar that says what the colours of a map mean.

    figure, axes : where it is drawn.
    label : label of the bar.
    norm : scale of the values.
    colours : name of the colour map.
    look : arguments of matplotlib's colorbar.
    """
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=axes, label=label, **{"shrink": 0.8, "pad": 0.02, **look})
    if isinstance(norm, LogNorm):
        label_in_plain_text(bar.ax.xaxis if bar.orientation == "horizontal" else bar.ax.yaxis)


def name_cut(axes: Axes, axis: int, index: int, before: str = "", after: str = "") -> None:
    """Write title and axis labels for a plane through a lattice.

    axes : axes of matplotlib on which the plane is drawn.
    axis, index : the plane consists of the spheres whose coordinate along `axis` (0 to 2) is `index`.
    before, after : words of the title before and after the name of the plane.
    """
    axes.set_title(f"{before}${AXES[axis]} = {index}${after}")
    right, up = (name for name in AXES if name != AXES[axis])
    axes.set(xlabel=f"${right}$", ylabel=f"${up}$")


def paint_block(axes: "Axes3D", colour: np.ndarray, view: View = VIEW) -> None:
    """Draw a cubic lattice as a block of spheres seen from outside, the driven planes in boxes.

    axes : axes of matplotlib.
    colour : (nx, ny, nz, 4), colours of all spheres.
    view : direction from which the lattice is seen.
    """
    outside = np.zeros(colour.shape[:3], dtype=bool)
    for axis in range(3):
        np.moveaxis(outside, axis, 0)[-1 if view.faces(axis) else 0] = True
    placed = view.seen(np.argwhere(outside))
    order = np.argsort(placed[:, 2])
    limit_block(axes, colour.shape[:3], view)
    paint_spheres(axes, placed[order, :2], colour[outside][order])
    for z in (0, colour.shape[2] - 1):
        has_open_face = (z > 0) == view.faces(2)  # of the other driven plane only the sides are seen
        edges = view.seen(box_edges(*plane_box(colour.shape[:3], z)))[facing_edges(view, has_open_face)][..., :2]
        axes.add_collection(LineCollection(list(edges), colors="black", lw=0.6, zorder=3))


def box_edges(low: Sequence[float] | np.ndarray, high: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the twelve edges of an upright box, (12, 2, 3): the places of their two ends.

    low, high : its lowest and highest corner, (3,) each.
    """
    corners = np.array([[(low, high)[n >> a & 1][a] for a in range(3)] for n in range(8)], dtype=float)
    return corners[[(n, n | 1 << axis) for n, axis in EDGES]]


EDGES = [(n, axis) for n in range(8) for axis in range(3) if not n >> axis & 1]
"""Edges of a box: number of the first corner, whose bit a is 1 at the upper end of axis a, and axis along the edge."""


def facing_edges(view: View, with_horizontal: bool) -> np.ndarray:
    """Return a mask (12,) of those edges of a box, in the order of EDGES, that bound a side which faces the reader.

    view : direction from which the box is seen.
    with_horizontal : False to leave out the side across z, upper or lower, that faces the reader.
    """
    axes_across = range(3 if with_horizontal else 2)
    return np.array([any((n >> a & 1) == view.faces(a) for a in axes_across if a != axis) for n, axis in EDGES])


def plane_box(shape: tuple[int, ...], z: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest corner, (3,) each, of the box around the spheres of one layer.

    shape : numbers of spheres (nx, ny, nz) of the lattice.
    z : number of the layer.
    """
    return np.array([-0.5, -0.5, z - 0.5]), np.array([shape[0] - 0.5, shape[1] - 0.5, z + 0.5])


def frame_block(axes: "Axes3D", shape: tuple[int, ...], view: View = VIEW) -> None:
    """Draw boxes around the driven planes of a cubic lattice, and set the limits of the picture.

    axes : axes of matplotlib.
    shape : numbers of spheres (nx, ny, nz).
    view : from where it is seen, from outside.
    """
    for z in (0, shape[2] - 1):
        edges = view.seen(box_edges(*plane_box(shape, z)))[..., :2]
        axes.add_collection(LineCollection(list(edges), colors="black", lw=0.5, zorder=1))
    limit_block(axes, shape, view)


def limit_block(axes: "Axes3D", shape: tuple[int, ...], view: View) -> None:
    """Set the limits of a picture so that it holds a whole cubic lattice, and remove the axes.

    axes : where the lattice is drawn.
    shape : numbers of spheres (nx, ny, nz).
    view : from where it is seen.
    """
    corners = view.seen(box_edges((-0.5,) * 3, np.array(shape) - 0.5)).reshape(-1, 3)
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    margin = 0.02 * (high - low).max()
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal")
    axes.set_axis_off()


def paint_spheres(axes: "Axes3D", centre: np.ndarray, colour: np.ndarray, radius: float = 0.5) -> None:
    """Draw shaded spheres as one image; later ones cover earlier ones.

    axes : where they are drawn.
    centre : (spheres, 2), centres on paper.
    colour : (spheres, 4), colours.
    radius : radius of all spheres.
    """
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    # a picture of 1000 pixels along the longer side, and a margin for spheres at the edge
    pixel = max(x1 - x0, y1 - y0) / 1000
    light = lit_sphere(max(5, round(2 * radius / pixel)))
    size = len(light)
    canvas = np.zeros((int((y1 - y0) / pixel) + size, int((x1 - x0) / pixel) + size, 4))
    corner = np.rint((centre - radius - [x0, y0]) / pixel).astype(int)
    # each sphere covers those before it: colour times diffuse light, plus white gloss, by its opacity
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
    """Return the picture of a unit sphere seen from the front, (pixels, pixels, 3): diffuse light, gloss and opacity of
    each pixel.
    """
    x, y = np.meshgrid(*2 * (np.linspace(-1.0, 1.0, pixels),))
    # height z of the surface of the sphere at each pixel, 0 outside
    square = x**2 + y**2
    z = np.sqrt(np.clip(1 - square, 0, None))
    # light from the upper left; the cosine of its angle with the surface gives diffuse light and gloss
    towards = np.array([-0.45, 0.55, 0.70])
    cosine = np.clip((x * towards[0] + y * towards[1] + z * towards[2]) / np.linalg.norm(towards), 0, 1)
    # a soft rim two pixels wide
    opacity = np.clip((1 - np.sqrt(square)) * pixels / 4, 0, 1)
    return np.stack([0.55 + 0.5 * cosine, 0.35 * cosine**24, opacity], axis=-1)
