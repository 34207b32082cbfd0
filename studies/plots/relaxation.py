"""How the power falls to its minimum: from several starts, with the spins at both ends (paper Fig. 2), and under other
springs, dampers and normal forces."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from taichi_bearings.plots.bearing import SPIN_COLOURS, colour_bar, frame_block, limit_block, lit_sphere
from taichi_bearings.plots.page import View
from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, GREY, ORANGE, in_our_style, new_figure

SPRINGS: Any = tuple({"color": colour, "lw": 1.3} for colour in (BLUE, ORANGE))  # by the start
RIGID: Any = tuple({"color": colour, "lw": 0.8, "ls": (0, (4, 1.5))} for colour in ("#0b2545", "#6b2d00"))
DRAWN_RADIUS = 0.36  # of the spacing: touching spheres would hide those behind
SEEN = View(20, -60)
VARIANTS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#D55E00", "#CC79A7", "#8a8a8a", "#0072B2")


@in_our_style
def draw_relaxation(
    names: Sequence[str], runs: Sequence[Any], rigid: Sequence[Any], ends: Sequence[Any], minima: Any, sample: int
) -> Figure:
    """Above P/P_0, below its excess over the minimum, both against time; beside them the spins at both ends.

    names : of the starts; runs, rigid : the relaxations from each (paper.samples.Run), with springs and without.
    P_0 is the initial power of the first. minima : powers of the samples and of their minimum cuts. An inset enlarges
    the end around the latter. ends : of each start the spins (nx, ny, nz, 3) at its beginning and its end, of the
    dynamics with springs: staggered, in units of the larger imposed one, and less the mean of each free layer about the
    height: that part makes no contact slip and never changes, so ends can only be compared without it.
    """
    figure = new_figure(DOUBLE, 4.6)
    parts: Any = figure.subfigures(1, 2, width_ratios=(1.12, 1.0), wspace=0.02)
    courses = [
        (run.time, run.power[:, sample], look | {"label": f"from {name}, {dynamics}"})
        for several, looks, dynamics in ((runs, SPRINGS, "Cundall-Strack"), (rigid, RIGID, "rigid"))
        for name, run, look in zip(names, several, looks, strict=True)
    ]
    _draw_curves(parts[0], courses, float(minima.power[sample]), float(minima.cut_power[sample]))
    _draw_snapshots(parts[1], names, ends)
    return figure


def _draw_curves(figure: Any, courses: Sequence[Any], least_power: float, cut_power: float) -> None:
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.3, 1))
    inset = top.inset_axes((0.57, 0.46, 0.42, 0.5))
    initial = courses[0][1][0]
    for time, power, look in courses:
        later, excess = time > 0, power / least_power - 1
        for axes in (top, inset):
            axes.plot(time[later], power[later] / initial, **look)
        shown = later & (excess > 0)
        bottom.plot(time[shown], excess[shown], **look)
    cut, least = cut_power / initial, least_power / initial
    for axes in (top, inset):
        axes.axhline(cut, color=GREEN, ls="-.", lw=1.2, label=rf"$P_{{\mathrm{{cut}}}} = {cut:.4f}\,P_0$, minimum cut")
        axes.axhline(least, color=GREY, ls=":", lw=1.2, label=rf"$P_{{\min}} = {least:.4f}\,P_0$, certified")
    if cut > least:
        bottom.axhline(cut / least - 1, color=GREEN, ls="-.", lw=1.2)
    figure.figure.legend(handles=top.lines, loc="outside upper center", ncols=3)
    first, last = (limit(float(time[place]) for time, *_ in courses[:2]) for limit, place in ((min, 1), (max, -1)))
    high = max(cut, 1.02 * least)
    inset.set(xscale="log", xlim=(last / 1e3, last), ylim=(1.2 * least - 0.2 * high, 2 * high - least))
    inset.tick_params(labelsize=7)
    top.set(xscale="log", xlim=(first / 2, 2 * last), ylabel=r"$P\,/\,P_0$", ylim=(0, 1.04))
    bottom.set(xscale="log", yscale="log", xlabel=r"time, $\omega_T\, t$", ylabel=r"$P\,/\,P_{\min} - 1$")
    bottom.set_ylim(1e-8, 10)
    for axes, letter in ((top, "a"), (bottom, "b")):
        axes.text(-0.17, 1.0, f"({letter})", transform=axes.transAxes, va="top")


def _draw_snapshots(figure: Any, names: Sequence[str], ends: Sequence[Any]) -> None:
    grid = figure.subplots(len(names), 2, squeeze=False)
    for row, name, spins in zip(grid, names, ends, strict=True):
        for axes, spin, when in zip(row, spins, ("= 0", r"\to \infty"), strict=True):
            _draw_spheres(axes, spin)
            axes.set_title(f"{name}, $t {when}$", pad=2)
    grid[0, 0].text(-0.02, 1.1, "(c)", transform=grid[0, 0].transAxes, va="top")
    label = r"$|\omega|\,/\,\omega_T$; arrows: $(-1)^{x+y+z}\,\omega$" + "\n(without the mean of each layer about $z$)"
    look: Any = {"location": "bottom", "shrink": 0.6, "aspect": 30, "extend": "max"}
    colour_bar(figure, grid, label, Normalize(0, 1), SPIN_COLOURS, **look)


def _draw_spheres(axes: Any, spin: np.ndarray) -> None:
    """Shaded spheres from the back to the front with their spins as arrows, the driven planes in boxes."""
    shape, spins = spin.shape[:-1], spin.reshape(-1, 3)
    frame_block(axes, shape, SEEN)
    seen = SEEN.seen(np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3))
    length = np.linalg.norm(spins, axis=1)
    light = lit_sphere()
    for order, n in enumerate(np.argsort(seen[:, 2])):
        (x, y), r = seen[n, :2], DRAWN_RADIUS
        colour = np.array(colormaps[SPIN_COLOURS](min(length[n], 1.0)))
        image = np.clip(light[..., :1] * colour[:3] + light[..., 1:2], 0, 1)
        axes.imshow(
            np.concatenate([image, light[..., 2:]], axis=-1),
            extent=(x - r, x + r, y - r, y + r), origin="lower", zorder=2 + 2 * order, interpolation="bilinear",
        )  # fmt: skip
        if length[n] > 0.02:
            across = SEEN.seen(spins[n])[:2] * 0.42
            look: Any = {"arrowstyle": "-|>", "mutation_scale": 5, "lw": 0.8, "color": "black", "zorder": 3 + 2 * order}
            axes.add_patch(FancyArrowPatch((x, y) - across, (x, y) + across, shrinkA=0, shrinkB=0, **look))
    limit_block(axes, shape, SEEN)


@in_our_style
def draw_parameters(courses: Mapping[str, Any], seed: int) -> Figure:
    """(a) P / P_0 and (b) its excess over the least power against F_n t, of the first sample; the first course, the
    paper's, is black. courses : as of paper.parameters."""
    figure = new_figure(7.1, 3.2)
    left, right = figure.subplots(1, 2)
    for (name, course), colour in zip(courses.items(), VARIANTS, strict=True):
        look: dict[str, Any] = {"color": colour, "lw": 1.8 if colour == VARIANTS[0] else 1.1, "label": name}
        later = course.scaled > 0
        left.plot(course.scaled[later], course.power[later, 0], **look)
        shown = later & (course.excess[:, 0] > 0)
        right.plot(course.scaled[shown], course.excess[shown, 0], **look)
    time = r"time, $\omega_T\, t\, F_n / 50$"
    left.set(xscale="log", xlabel=time, ylabel=r"$P\,/\,P_0$", ylim=(0, 1.04))
    right.set(xscale="log", yscale="log", xlabel=time, ylabel=r"$P\,/\,P_{\min} - 1$", ylim=(1e-8, 10))
    left.set_title(f"(a) seed {seed}, random spins")
    right.set_title("(b) above the minimum")
    figure.legend(handles=left.lines, loc="outside lower center", ncols=4)
    return figure
