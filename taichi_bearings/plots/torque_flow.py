"""How close to slipping contacts are, how their forces are distributed, and the torque that flows through one plane."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from taichi_bearings.analysis.torque_flow import Counted, FrictionLoad
from taichi_bearings.plots.lattice import draw_contacts, frame_plane, site_on_paper
from taichi_bearings.plots.page import PAGE, Page
from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, panels
from taichi_bearings.proof.contact_state import ContactState

FLOW_COLOURS = (
    (ContactState.SLIPLESS, BLUE, "slipless"),
    (ContactState.SLIPPING, ORANGE, "slipping"),
    (ContactState.UNDECIDED, GREY, "undecided"),
)
WIDEST_CONTACT = 0.45  # of the lattice spacing: width of the contact that carries most
DARK_ORANGE = "#a34e14"  # for letters


@in_our_style
def draw_torque_flow(
    load: FrictionLoad,
    distribution: Counted,
    torque: Sequence[np.ndarray],
    state: Sequence[np.ndarray],
    title: str,
    page: Page = PAGE,
) -> Figure:
    """Three panels: saturation of the slipless contacts, P(f / <f>), and the current of torque in a plane.

    torque, state : of the contacts in the plane, (m - 1, H) sideways and (m, H - 1) upright; values of ContactState.
    title : of the third panel.
    """
    figure, (saturation, forces, current), width = panels(page, 3, (1.2, 0.0))
    _draw_saturation(saturation, load)
    _draw_distribution(forces, distribution)
    _draw_current(current, torque, state, 0.9 * width)
    current.set_title(title)
    return figure


def _draw_saturation(axes: Any, load: FrictionLoad) -> None:
    number, edges = max(1, len(load.saturation)), load.counted.edges
    density = load.counted.slipless / (number * np.diff(edges))
    axes.bar(edges[:-1], density, np.diff(edges), align="edge", color=BLUE, alpha=0.35, linewidth=0)
    axes.step(edges, np.append(density, density[-1]), where="post", color=BLUE, lw=1)
    axes.axvline(1.0, color=ORANGE, lw=1.5)
    axes.annotate(
        f"{load.counted.slipping.sum():,} slipping\ncontacts at 1",
        (1.0, 0.96), (-6, 0), xycoords=("data", "axes fraction"), textcoords="offset points",
        ha="right", va="top", color=DARK_ORANGE, fontsize=7,
    )  # fmt: skip
    axes.set(
        xlim=(0, 1.02), ylim=(0, 1.25 * max(float(density.max(initial=0.0)), 1e-9)),
        xlabel=r"saturation, $|f|\,/\,\mu F_n$", ylabel="probability density, slipless",
    )  # fmt: skip
    mean = f", mean {load.mean:.2f}" if len(load.saturation) else ""
    axes.set_title(f"{len(load.saturation):,} slipless contacts{mean}")


def _draw_distribution(axes: Any, distribution: Counted) -> None:
    middle = (distribution.edges[1:] + distribution.edges[:-1]) / 2
    for density, colour, marker, label in (
        (distribution.slipless, BLUE, "o", "slipless"),
        (distribution.slipping, ORANGE, "s", "slipping"),
        (distribution.every, GREY, None, "all"),
    ):
        filled = density > 0
        if filled.any():
            axes.plot(middle[filled], density[filled], color=colour, marker=marker, ms=3, lw=1, label=label)
    axes.set(yscale="log", xlabel=r"force over its mean, $f\,/\,\langle f \rangle$", ylabel="probability density")
    axes.set_xlim(left=0)
    if axes.lines:
        axes.legend()
    axes.set_title("each with its own mean")


def _draw_current(axes: Any, torque: Sequence[np.ndarray], states: Sequence[np.ndarray], width: float) -> None:
    """Contacts as lines between the centres of their spheres, as wide as they carry torque."""
    columns, layers = len(torque[1]), torque[0].shape[1]
    state = np.concatenate([values.ravel() for values in states])
    sizes = np.abs(np.concatenate([values.ravel() for values in torque]))
    largest = float(sizes[state != ContactState.DRIVEN].max(initial=0.0)) or 1.0
    frame_plane(axes, (columns, layers))
    site = site_on_paper(width, (columns, layers), width)
    for which, colour, _ in FLOW_COLOURS:
        lines = WIDEST_CONTACT * site * sizes[state == which] / largest
        draw_contacts(axes, [values == which for values in states], colors=colour, linewidths=lines, capstyle="round")
    for layer in (0, layers - 1):
        axes.plot([-0.5, columns - 0.5], [layer, layer], color="black", lw=1.5, solid_capstyle="butt")
    shown = [(colour, label) for which, colour, label in FLOW_COLOURS if (state == which).any()]
    handles = [Line2D([], [], color=colour, lw=3, label=label) for colour, label in shown]
    handles.append(Line2D([], [], color="black", lw=1.5, label="driven plane"))
    axes.legend(handles=handles, ncols=2, loc="upper center", bbox_to_anchor=(0.5, 0.0))
