"""Draws how fast the spheres of a run rotate, and where its power is dissipated (paper Figs. 1, 3a and 4)."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import Structure
from taichi_bearings.lattice import Lattice
from taichi_bearings.plots import bearing
from taichi_bearings.plots.bearing import SPIN_COLOURS, Sheet
from taichi_bearings.plots.page import BELOW, NARROW, PAGE, VIEW, Page, columns_on, middle_planes
from taichi_bearings.plots.style import (
    BLUE,
    ORANGE,
    describe,
    in_our_style,
    larger_spin,
    over,
    panels,
    power_unit,
    put_title,
)
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene.scene import of_lattice

# slipping contacts are drawn if they are at most this share, or this number: more lines would hide the spins
MOST_SLIPS, FEW_SLIPS = 0.9, 1_000
POWER_COLOURS = "viridis_r"  # what dissipates most stands out on paper
FAINT_SHARE = 0.02  # share of the slipping contacts whose power is below the range of the colours


@in_our_style
def draw_spins(structure: Structure, page: Page = PAGE, title: str = "", note: str = "") -> Figure:
    """Draw how fast spheres rotate as colours, and slipping contacts as black lines; a cubic lattice from outside and
    in cuts.

    structure : the sample.
    page : how the figure is printed.
    title : words above the figure; "" for size, law and seed.
    note : words on what black lines mean; "" for the number of slipping contacts.

    The colour is |spin| over the larger imposed spin; in a packing it is radius * |spin| over its largest imposed
    value. Where nearly all of many contacts slip, or spheres lie behind each other, slipping contacts are not drawn but
    counted in the title. Rotations of whole layers of a lattice that no contact resists are left out.
    """
    slips, movable = structure.state == ContactState.SLIPPING, int((structure.state != ContactState.DRIVEN).sum())
    counted = f"{int(slips.sum()):,} of {movable:,} contacts slip"
    drawn = slips & (slips.sum() <= max(MOST_SLIPS * movable, FEW_SLIPS))
    system, place, spin = structure.scene, structure.network.whole, structure.scene.driving.shown(structure.spin)
    # speed of each sphere on the scale of colours
    if place.lattice is None:
        surface_velocity = spin.reshape(place.spheres, -1) * place.radius[:, None]
        speed = np.linalg.norm(surface_velocity, axis=1) / (structure.fastest or 1.0)
        label = r"$R\,|\omega|$ over the largest imposed"
    else:
        imposed = of_lattice(system).imposed
        speed = bearing.speed_of(spin, *imposed)
        label = rf"$|\omega|\,/\,{larger_spin(system)}$"
    colour = colormaps[SPIN_COLOURS](speed)
    if speed.ndim == 3:
        figure = _draw_block(structure.network.lattice, colour, drawn, page)
        look = BELOW if columns_on(page, len(figure.axes), NARROW) < 3 else {}
    else:
        figure, axes, sheet, site, look = bearing.one_panel(place, page)
        drawn = drawn & sheet.is_flat
        _paint(axes, sheet, colour.reshape(-1, 4), drawn, site)
    words = counted if slips.any() and not drawn.any() else note or f"{counted}, in black"
    put_title(figure, f"{title or describe(system)}\n{words}", page)
    bearing.colour_bar(figure, figure.axes, label, Normalize(0, 1), SPIN_COLOURS, **look)
    return figure


def _paint(axes: Axes, sheet: Sheet, colour: np.ndarray, slips: np.ndarray, site: float) -> None:
    """Draw the discs of one picture and the slipping contacts between them.

    axes : axes of matplotlib.
    sheet : N discs and their contacts on paper.
    colour : (N, 4), colours of the discs.
    slips : (contacts E,) mask of the slipping ones of all contacts.
    site : distance of two discs in points.
    """
    sheet.paint(axes, colour)
    sheet.box_driven(axes)
    sheet.draw(axes, slips, across=True, colors="black", lw=bearing.line_on_site(site, 0.15))


def _draw_block(lattice: Lattice, colour: np.ndarray, slips: np.ndarray, page: Page) -> Figure:
    """Draw a cubic lattice as a block of spheres from outside, and planes through it with the slipping contacts.

    lattice : the lattice.
    colour : (nx, ny, nz, 4), colours of all spheres.
    slips : (contacts E,) mask of slipping contacts.
    page : how the figure is printed, and which planes are cut.
    """
    shape = lattice.shape
    planes = page.planes or middle_planes(shape)
    tall = float(np.clip(shape[2] / max(shape[:2]), 0.5, 2.0))
    figure, (block, *cuts), width = panels(page, 1 + len(planes), (0.85 * tall, 0.25), 0.1, NARROW)
    bearing.paint_block(block, colour, page.view or VIEW)
    block.set_title("from outside")
    for axes, plane in zip(cuts, planes, strict=True):
        sheet = Sheet.of_lattice(lattice, plane)
        _paint(axes, sheet, np.take(colour, plane[1], plane[0]).reshape(-1, 4), slips, sheet.site(0.85 * width))
        bearing.name_cut(axes, *plane)
    return figure


@in_our_style
def draw_power(structure: Structure, page: Page = PAGE) -> Figure:
    """Draw the slipping contacts, coloured by their power; of a cubic lattice in two planes, with the power of each
    layer.

    structure : the sample.
    page : how the figure is printed: width, planes and view.

    Where there are more slipping contacts than lines can show, each disc has the colour of half the power of all its
    contacts.
    """
    system, place = structure.scene, structure.network.whole
    unit, symbol = power_unit(system)
    power = np.where(structure.state == ContactState.SLIPPING, structure.power_per_contact / unit, 0.0)
    if place.lattice is not None and place.dimension == 3:
        figure = _draw_cuts(place.lattice, power, page, symbol)
    else:
        figure, axes, sheet, site, look = bearing.one_panel(place, page)
        has_lines = (power > 0).sum() <= bearing.MOST_LINES or not sheet.is_flat
        if has_lines:
            sheet.paint(axes, bearing.PALE if sheet.is_flat else bearing.PALE * [1, 1, 1, 0.25])
            norm = _draw_lines(axes, sheet, power, site)
        else:
            of_disc = np.bincount(sheet.ends.ravel(), np.tile(power / 2, 2), len(sheet.place))
            norm = _power_scale(of_disc)
            sheet.paint(axes, np.where((of_disc > 0)[:, None], colormaps[POWER_COLOURS](norm(of_disc)), bearing.PALE))
        label = over("P_{ij}" if has_lines else "P_i", symbol, "energy / time")
        bearing.colour_bar(figure, axes, label, norm, POWER_COLOURS, extend="min", **look)
    put_title(figure, describe(system), page)
    return figure


def _power_scale(power: np.ndarray) -> LogNorm:
    """Return the logarithmic scale of colours for powers of contacts: from their quantile FAINT_SHARE to the largest
    one.

    power : (n,), powers of n contacts or discs; only those above 0 count.
    """
    slipping = power[power > 0]
    if not len(slipping):
        return LogNorm(1e-1, 1)
    return LogNorm(float(np.quantile(slipping, FAINT_SHARE)), float(slipping.max()))


def _draw_lines(axes: Axes, sheet: Sheet, power: np.ndarray, site: float) -> LogNorm:
    """Draw slipping contacts as lines coloured by their power, and return the scale of colours.

    axes : axes of matplotlib.
    sheet : discs and contacts on paper.
    power : (contacts E,), power of all contacts, 0 where they do not slip.
    site : distance of two discs in points.

    In a flat picture a line lies across the contact, where the two surfaces slip past each other; where spheres lie
    behind each other it joins the centres.
    """
    norm = _power_scale(power)
    look: dict[str, Any] = {"array": power, "cmap": POWER_COLOURS, "norm": norm}
    sheet.draw(axes, power > 0, across=sheet.is_flat, lw=bearing.line_on_site(site, 0.3, 0.8, 3.0), **look)
    return norm


def _draw_cuts(lattice: Lattice, power: np.ndarray, page: Page, symbol: str) -> Figure:
    """Draw planes of a cubic lattice with the power of their contacts and, in a further panel, the power within each
    layer and between successive layers.

    lattice : the lattice.
    power : (contacts E,), power of all contacts, 0 where they do not slip.
    page : how the figure is printed, and which planes are cut.
    symbol : symbol of the unit of power, "" for none.
    """
    shape = lattice.shape
    planes, nz = page.planes or middle_planes(shape), shape[-1]
    tall = float(np.clip(nz / max(shape[:2]), 0.5, 2.0))
    figure, (*cuts, layers), width = panels(page, 1 + len(planes), (0.85 * tall, 0.35))
    for cut, plane in zip(cuts, planes, strict=True):
        sheet = Sheet.of_lattice(lattice, plane)
        sheet.paint(cut, bearing.PALE)
        norm = _draw_lines(cut, sheet, power, sheet.site(0.8 * width))
        bearing.name_cut(cut, *plane)
    look: dict[str, Any] = {"location": "left"} if columns_on(page, len(figure.axes)) > 1 else BELOW
    label = over("P_{ij}", symbol, "energy / time")
    bearing.colour_bar(figure, cuts, label, norm, POWER_COLOURS, extend="min", **look)
    along_x, along_y, upright = lattice.by_axis(power)
    inside = along_x.sum(axis=(0, 1)) + along_y.sum(axis=(0, 1))
    layers.step(inside, np.arange(nz), where="mid", color=BLUE, label="within a layer")
    layers.step(upright.sum(axis=(0, 1)), np.arange(nz - 1) + 0.5, where="mid", color=ORANGE, label="to the next")
    layers.set(ylabel="height $z$", xlabel=over("P_z", symbol, "energy / time"))
    layers.set(xlim=(0, None), ylim=(-0.5, nz - 0.5))
    layers.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, columnspacing=1.0)
    return figure
