"""How the power falls from several starts to its minimum, with the spins at both ends (paper Fig. 2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from taichi_bearings.plots.lattice import SPIN_COLOURS, box_edges, lit_sphere
from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, GREY, ORANGE, in_our_style, new_figure

HUES = ((BLUE, "#0b2545"), (ORANGE, "#6b2d00"))  # of a start: with springs, rigid
DRAWN_RADIUS = 0.36  # of the spacing: touching spheres would hide those behind
VIEW = np.array([[0.866, 0.5, 0.0], [-0.17, 0.294, 0.94], [0.47, -0.814, 0.342]])  # right, up, towards the reader


@dataclass(frozen=True)
class Relaxation:
    """One start: its name, time (T,) and power (T,), the same of rigid friction at times of its own, and the spins
    (nx, ny, nz, 3) at its beginning and its end.

    Spins are staggered, in units of the larger imposed one, and less the mean of each free layer about the height: that
    part makes no contact slip and never changes, so ends can only be compared without it.
    """

    name: str
    time: np.ndarray
    power: np.ndarray
    rigid_time: np.ndarray
    rigid_power: np.ndarray
    first: np.ndarray
    last: np.ndarray


@in_our_style
def draw_relaxation(starts: Sequence[Relaxation], least_power: float, cut_power: float) -> Figure:
    """Above P/P_0, below its excess over the minimum, both against time; beside them the spins at both ends.

    P_0 is the initial power of the first start; least_power is the certified minimum. An inset enlarges the end of
    both starts around the power of the minimum cut. The spins are those of the dynamics with springs.
    """
    figure = new_figure(DOUBLE, 4.6)
    parts: Any = figure.subfigures(1, 2, width_ratios=(1.12, 1.0), wspace=0.02)
    _draw_curves(parts[0], starts, least_power, cut_power)
    _draw_snapshots(parts[1], starts)
    return figure


def _draw_curves(figure: Any, starts: Sequence[Relaxation], least_power: float, cut_power: float) -> None:
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.3, 1))
    inset = top.inset_axes((0.57, 0.46, 0.42, 0.5))
    initial = starts[0].power[0]
    for start, (colour, dark) in zip(starts, HUES, strict=False):
        for time, power, look, dynamics in (
            (start.time, start.power, {"color": colour, "lw": 1.3}, "Cundall-Strack"),
            (start.rigid_time, start.rigid_power, {"color": dark, "lw": 0.8, "ls": (0, (4, 1.5))}, "rigid"),
        ):
            later, excess = time > 0, power / least_power - 1
            for axes in (top, inset):
                axes.plot(time[later], power[later] / initial, label=f"from {start.name}, {dynamics}", **look)
            shown = later & (excess > 0)
            bottom.plot(time[shown], excess[shown], **look)
    cut, least = cut_power / initial, least_power / initial
    for axes in (top, inset):
        axes.axhline(cut, color=GREEN, ls="-.", lw=1.2, label=rf"$P_{{\mathrm{{cut}}}} = {cut:.4f}\,P_0$, minimum cut")
        axes.axhline(least, color=GREY, ls=":", lw=1.2, label=rf"$P_{{\min}} = {least:.4f}\,P_0$, certified")
    if cut > least:
        bottom.axhline(cut / least - 1, color=GREEN, ls="-.", lw=1.2)
    columns = [*top.lines[0:4:2], *top.lines[1:4:2], *top.lines[4:]]
    figure.figure.legend(handles=columns, loc="outside upper center", ncols=3)
    last = max(float(start.time[-1]) for start in starts)
    high = max(cut, 1.02 * least)
    inset.set(xscale="log", xlim=(last / 1e3, last), ylim=(1.2 * least - 0.2 * high, 2 * high - least))
    inset.tick_params(labelsize=7)
    first = min(float(start.time[start.time > 0][0]) for start in starts)
    top.set(xscale="log", xlim=(first / 2, 2 * last), ylabel=r"$P\,/\,P_0$", ylim=(0, 1.04))
    bottom.set(xscale="log", yscale="log", xlabel=r"time, $\omega_T\, t$", ylabel=r"$P\,/\,P_{\min} - 1$")
    bottom.set_ylim(1e-8, 10)
    for axes, letter in ((top, "a"), (bottom, "b")):
        axes.text(-0.17, 1.0, f"({letter})", transform=axes.transAxes, va="top")


def _draw_snapshots(figure: Any, starts: Sequence[Relaxation]) -> None:
    grid = figure.subplots(len(starts), 2, squeeze=False)
    for row, start in enumerate(starts):
        for axes, spin, when in zip(grid[row], (start.first, start.last), ("= 0", r"\to \infty"), strict=True):
            _draw_spheres(axes, spin)
            axes.set_title(f"{start.name}, $t {when}$", pad=2)
    grid[0, 0].text(-0.02, 1.1, "(c)", transform=grid[0, 0].transAxes, va="top")
    scale = ScalarMappable(Normalize(0, 1), SPIN_COLOURS)
    bar = figure.colorbar(scale, ax=grid, location="bottom", shrink=0.6, aspect=30, pad=0.02, extend="max")
    bar.set_label(
        r"$|\omega|\,/\,\omega_T$; arrows: $(-1)^{x+y+z}\,\omega$" + "\n(without the mean of each layer about $z$)",
    )


def _draw_spheres(axes: Any, spin: np.ndarray) -> None:
    """Shaded spheres from the back to the front with their spins as arrows, the driven planes in boxes."""
    centre = np.moveaxis(np.indices(spin.shape[:-1]), 0, -1).reshape(-1, 3) @ VIEW.T
    spins = spin.reshape(-1, 3)
    length = np.linalg.norm(spins, axis=1)
    nx, ny, nz = spin.shape[:-1]
    for height in (0, nz - 1):
        _draw_box(axes, (nx, ny), height)
    light = lit_sphere()
    for order, n in enumerate(np.argsort(centre[:, 2])):
        x, y = centre[n, :2]
        r = DRAWN_RADIUS
        colour = np.array(colormaps[SPIN_COLOURS](min(length[n], 1.0)))
        image = np.clip(light[..., :1] * colour[:3] + light[..., 1:2], 0, 1)
        axes.imshow(
            np.concatenate([image, light[..., 2:]], axis=-1),
            extent=(x - r, x + r, y - r, y + r), origin="lower", zorder=2 + 2 * order, interpolation="bilinear",
        )  # fmt: skip
        if length[n] > 0.02:
            across = VIEW[:2] @ spins[n] * 0.42
            tail, head = (x, y) - across, (x, y) + across
            axes.add_patch(
                FancyArrowPatch(
                    tail, head, arrowstyle="-|>", mutation_scale=5, lw=0.8, color="black", shrinkA=0, shrinkB=0,
                    zorder=3 + 2 * order,
                )
            )  # fmt: skip
    low, high = centre[:, :2].min(axis=0) - 0.75, centre[:, :2].max(axis=0) + 0.75
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()


def _draw_box(axes: Any, sides: tuple[int, int], height: int) -> None:
    """The twelve edges of a box around a plane of spheres, as in the paper."""
    edges = box_edges((-0.5, -0.5, height - 0.5), (sides[0] - 0.5, sides[1] - 0.5, height + 0.5))
    for ends in edges @ VIEW.T:
        axes.plot(ends[:, 0], ends[:, 1], color=GREY, lw=0.7, zorder=1)


__all__ = ["Relaxation", "draw_relaxation"]
