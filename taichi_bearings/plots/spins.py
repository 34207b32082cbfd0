"""The spins of a run: discs in 2D, spheres and cuts in 3D (paper Figs. 1, 3a and 4)."""

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from taichi_bearings.contact_state import ContactState
from taichi_bearings.files.run_file import StoredRun
from taichi_bearings.plots.style import new_figure

COLOURS = "coolwarm"


def draw_spins(run: StoredRun, replica: int = 0) -> Figure:
    """|spin| over the larger imposed spin, as colour; slipping contacts in black (2D and cuts)."""
    largest = max(abs(run.attributes["spin_top"]), abs(run.attributes["spin_bottom"])) or 1.0
    spin = run.spin[replica]
    if spin.ndim == 2:
        return _draw_discs(np.abs(spin) / largest, [s[replica] for s in run.state])
    return _draw_spheres(np.linalg.norm(spin, axis=-1) / largest, [s[replica] for s in run.state])


def _draw_discs(speed: np.ndarray, state: list[np.ndarray]) -> Figure:
    nx, ny = speed.shape
    figure = new_figure(5.6, 5.6 * min(2.0, max(0.5, ny / nx)) * 0.85)
    axes = figure.add_subplot()
    colours = _paint_plane(axes, speed, state)
    for y in (0, ny - 1):  # boxes around the imposed rows
        axes.add_patch(Rectangle((-0.55, y - 0.55), nx + 0.1, 1.1, fill=False, lw=1.0))
    figure.colorbar(colours, ax=axes, label=r"$|\omega| / \omega_{\max}$", shrink=0.8)
    return figure


def _paint_plane(axes: Any, speed: np.ndarray, state: list[np.ndarray]) -> Any:
    """Discs of one plane (first index to the right, second up) and the slipping contacts between them."""
    nx, ny = speed.shape
    if nx * ny <= 10_000:
        discs = PatchCollection([Circle((a, b), 0.47) for a, b in np.ndindex(nx, ny)], cmap=COLOURS, lw=0)
        discs.set_array(speed.ravel())
        discs.set_clim(0, 1)
        axes.add_collection(discs)
        colours = discs
    else:
        colours = axes.imshow(speed.T, origin="lower", cmap=COLOURS, vmin=0, vmax=1, interpolation="nearest")
    lines = []
    for axis, values in enumerate(state):
        i, j = np.nonzero(values == ContactState.SLIPPING)
        if axis == 0:  # a contact along x is crossed by a vertical line between its discs
            lines += [[(a + 0.5, b - 0.5), (a + 0.5, b + 0.5)] for a, b in zip(i, j, strict=True)]
        else:
            lines += [[(a - 0.5, b + 0.5), (a + 0.5, b + 0.5)] for a, b in zip(i, j, strict=True)]
    axes.add_collection(LineCollection(lines, colors="black", lw=1.0 if nx <= 40 else 0.4))
    axes.set(xlim=(-0.7, nx - 0.3), ylim=(-0.7, ny - 0.3), aspect="equal", xticks=[], yticks=[])
    for side in axes.spines.values():
        side.set_visible(False)
    return colours


def _draw_spheres(speed: np.ndarray, state: list[np.ndarray]) -> Figure:
    """The block of spheres from outside, and two cuts through its middle with the slipping contacts."""
    nx, ny, nz = speed.shape
    figure = new_figure(11.0, 4.2)
    block = figure.add_subplot(1, 3, 1, projection="3d", computed_zorder=True)
    faces = ((0, nx - 1), (1, 0), (2, nz - 1))  # (axis, index) of the three faces that are seen
    squares, values = [], []
    for axis, index in faces:
        u, v = (a for a in range(3) if a != axis)
        for i, j in np.ndindex(speed.shape[u], speed.shape[v]):
            corners = np.empty((4, 3))
            corners[:, axis] = index + (0.5 if index else -0.5)
            corners[:, u] = i + np.array([-0.5, 0.5, 0.5, -0.5])
            corners[:, v] = j + np.array([-0.5, -0.5, 0.5, 0.5])
            squares.append(corners)
        values.append(np.take(speed, index, axis=axis).ravel())
    surface = Poly3DCollection(squares, cmap=COLOURS, lw=0.2, edgecolors="white")
    surface.set_array(np.concatenate(values))
    surface.set_clim(0, 1)
    block.add_collection3d(surface)
    block.set(xlim=(-0.5, nx - 0.5), ylim=(-0.5, ny - 0.5), zlim=(-0.5, nz - 0.5))
    block.set_box_aspect((nx, ny, nz), zoom=1.0)
    block.set_axis_off()
    block.view_init(elev=22, azim=-55)
    block.set_title("|spin| on three sides", fontsize=9)
    for place, (name, plane, crossing) in enumerate(
        (
            (f"cut at y = {ny // 2}", speed[:, ny // 2, :], [state[0][:, ny // 2, :], state[2][:, ny // 2, :]]),
            (f"cut at x = {nx // 2}", speed[nx // 2], [state[1][nx // 2], state[2][nx // 2]]),
        )
    ):
        axes = figure.add_subplot(1, 3, 2 + place)
        colours = _paint_plane(axes, plane, crossing)
        axes.set_title(name + ", slipping contacts in black", fontsize=9)
        axes.set(xlabel="xy"[place], ylabel="z")
    figure.colorbar(colours, ax=figure.axes, label=r"$|\omega| / \omega_{\max}$", shrink=0.7)
    return figure
