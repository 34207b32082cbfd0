"""Where the power is dissipated: every contact coloured by its power."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from taichi_bearings.lattice.incidence import weights
from taichi_bearings.plots import lattice
from taichi_bearings.plots.page import BELOW, PAGE, Page, columns_on, middle_planes
from taichi_bearings.plots.style import BLUE, ORANGE, in_our_style, new_figure, panels, put_title
from taichi_bearings.plots.symbols import describe, over, power_unit
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Solution

POWER_COLOURS = "viridis_r"  # what dissipates most stands out on paper
IDLE_GREY = "0.75"
LEAST_HEIGHT = 0.6  # of a plane, of its width, beside which a colour bar has room for its labels
FAINT_SHARE = 0.02  # share of the contacts that are below the range of the colours
Arrays = Sequence[np.ndarray]


@in_our_style
def draw_power(solution: Solution, replica: int = 0, page: Page = PAGE) -> Figure:
    """2D: all contacts. 3D: the contacts in two cuts, and the power of each layer of the height.

    Where more contacts slip than lines can show, each sphere has the colour of the power of its contacts, half of each.
    """
    scene = solution.scene
    shape = scene.lattice.shape
    unit, symbol = power_unit(scene)
    slipping = solution.state[replica] == ContactState.SLIPPING
    every = np.where(slipping, solution.power_per_contact[replica] / unit, 0.0)
    power = scene.lattice.by_axis(every)
    lines = sum(int((p > 0).sum()) for p in power) <= lattice.MOST_LINES or len(shape) == 3
    label = over("P_{ij}" if lines else "P_i", symbol, "energy / time")
    if len(shape) == 2:
        shown = power if lines else weights(every[None] / 2, scene.lattice, scene.lattice.all_spin_axes)[0]
        norm = _norm(shown)
        width, flat_bar = page.inches("single"), shape[1] < LEAST_HEIGHT * shape[0]
        height = (width - 0.8 * (not flat_bar)) * float(np.clip(shape[1] / shape[0], 0.2, 2.0))
        figure = new_figure(width, height + (0.5 if flat_bar else 0.1), page.dpi)
        axes = figure.add_subplot()
        if lines:
            _draw_plane(axes, power, shape, norm, lattice.site_on_paper(width, shape, height))
        else:
            image = np.where(shown[0] > 0, shown[0], np.nan).T
            axes.imshow(image, origin="lower", cmap=POWER_COLOURS, norm=norm, interpolation="nearest")
            lattice.frame_plane(axes, shape)
        look = BELOW if flat_bar else {"shrink": 0.9}
        lattice.colour_bar(figure, axes, label, norm, POWER_COLOURS, extend="min", **look)
        put_title(figure, describe(scene, replica), page)
        return figure
    figure = _draw_cuts(power, shape, _norm(power), label, page)
    figure.axes[len(page.planes) or 2].set_xlabel(over("P_z", symbol, "energy / time"))
    put_title(figure, describe(scene, replica), page)
    return figure


def _norm(powers: Arrays) -> LogNorm:
    every = np.concatenate([values.ravel() for values in powers])
    slipping = every[every > 0]
    if not len(slipping):
        return LogNorm(1e-1, 1)
    return LogNorm(float(np.quantile(slipping, FAINT_SHARE)), float(slipping.max()))


def _draw_cuts(power: Arrays, shape: tuple[int, ...], norm: LogNorm, label: str, page: Page) -> Figure:
    """Planes of a cubic lattice, and the power of the contacts in each layer and to the next one."""
    planes, nz = page.planes or middle_planes(shape), shape[-1]
    tall = float(np.clip(nz / max(shape[:2]), 0.5, 2.0))
    figure, (*cuts, layers), width = panels(page, 1 + len(planes), (0.85 * tall, 0.35))
    for cut, (axis, index) in zip(cuts, planes, strict=True):
        size = tuple(n for a, n in enumerate(shape) if a != axis)
        _draw_plane(
            cut, lattice.contacts_in_plane(power, axis, index), size, norm, lattice.site_on_paper(0.8 * width, size)
        )
        lattice.name_cut(cut, axis, index)
    look = {"location": "left"} if columns_on(page, len(figure.axes)) > 1 else BELOW
    lattice.colour_bar(figure, cuts, label, norm, POWER_COLOURS, extend="min", **look)
    inside = power[0].sum(axis=(0, 1)) + power[1].sum(axis=(0, 1))
    layers.step(inside, np.arange(nz), where="mid", color=BLUE, label="within a layer")
    layers.step(power[2].sum(axis=(0, 1)), np.arange(nz - 1) + 0.5, where="mid", color=ORANGE, label="to the next")
    layers.set(ylabel="height $z$", xlim=(0, None), ylim=(-0.5, nz - 0.5))
    layers.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, columnspacing=1.0)
    return figure


def _draw_plane(axes: Any, power: Arrays, shape: tuple[int, ...], norm: LogNorm, site: float) -> None:
    """Contacts of one plane as lines between the centres: slipping ones by power, the rest in grey if there is room."""
    if site > 3:
        lattice.draw_contacts(
            axes, [values == 0 for values in power], colors=IDLE_GREY, lw=lattice.line_on_site(site, 0.06, 0.25)
        )
    lattice.draw_contacts(
        axes,
        [values > 0 for values in power],
        array=np.concatenate([values[values > 0] for values in power]),
        cmap=POWER_COLOURS,
        norm=norm,
        lw=lattice.line_on_site(site, 0.3, 0.8, 3.0),
    )
    lattice.frame_plane(axes, shape)
