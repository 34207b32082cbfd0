"""Draws the coefficients of all contacts of a sample: its friction or damping, as drawn from the seed or given."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import Structure
from taichi_bearings.plots import bearing
from taichi_bearings.plots.bearing import Sheet
from taichi_bearings.plots.page import BELOW, VIEW, Page, middle_planes
from taichi_bearings.plots.style import describe, in_our_style, new_figure, panels, put_title, short
from taichi_bearings.scene.law import Quantity
from taichi_bearings.scene.network import Network

COLOURS = "viridis"  # weak contacts are dark
MOST_LINEAR = 30.0  # largest over smallest coefficient up to which the scale of colours is linear


@in_our_style
def draw_coefficients(structure: Structure, page: Page) -> Figure:
    """Draw every contact, coloured by its coefficient; a cubic lattice in two planes, or in those that the page names.

    structure : the sample.
    page : how the figure is printed: width, planes and view.

    The law "coulomb-viscous" has two coefficients, friction and damping, and panels for each. Absent contacts are left
    out. Where a flat lattice has more contacts than lines can show, each disc has the colour of the mean coefficient of
    its contacts.
    """
    system, network = structure.scene, structure.network.whole
    planes: list[tuple[int, int] | None] = [None]
    if network.lattice is not None and network.dimension == 3:
        planes = list(page.planes or middle_planes(network.lattice.shape))
    sheets = [_sheet(network, plane, page) for plane in planes]
    wide, tall = np.diff(sheets[0].corners, axis=0)[0]
    quantities, height = system.law.quantities, 0.95 * float(np.clip(tall / wide, 0.2, 2.0))
    figure, axes, width = _panels(page, len(sheets), len(quantities), height)
    words = []
    for quantity, values, column in zip(quantities, system.named_coefficients.values(), axes, strict=True):
        present = values[0][values[0] > 0]
        norm = _scale(present)
        label = _label(quantity)
        for one, sheet, plane in zip(column, sheets, planes, strict=True):
            if _draw_picture(one, sheet, values[0], norm, sheet.site(0.9 * width)):
                label = f"mean over the contacts of a disc:\n{label}"
            if plane is not None:
                bearing.name_cut(one, *plane)
        bearing.colour_bar(figure, column, label, norm, COLOURS, **BELOW)
        words.append(_in_words(quantity, present))
    put_title(figure, f"{describe(system)}\n{'; '.join(words)}", page)
    return figure


def _panels(page: Page, sheets: int, coefficients: int, height: float) -> tuple[Figure, list[list[Axes]], float]:
    """Return a figure of panels, the axes of its panels, and the width of a panel in inches. The axes are in lists, one
    for each coefficient.

    page : how the figure is printed.
    sheets : number of pictures that show one coefficient.
    coefficients : number of coefficients: 1, or 2, which get a column of panels each.
    height : height of a panel over its width.
    """
    if coefficients == 1:
        figure, axes, width = panels(page, sheets, (height, 0.75), widest="single")
        return figure, [axes], width
    width = page.inches("double") / coefficients
    figure = new_figure(coefficients * width, sheets * (height * width + 0.3) + 0.6, page.dpi)
    grid = figure.subplots(sheets, coefficients, squeeze=False)
    return figure, [list(column) for column in grid.T], width


def _sheet(network: Network, plane: tuple[int, int] | None, page: Page) -> Sheet:
    """Return the picture of discs and contacts on paper.

    network : spheres and contacts.
    plane : (axis, index) of a cut through a cubic lattice; None for anything else.
    page : how the figure is printed; it may say from where a packing is seen.
    """
    if network.lattice is None:
        return Sheet.of_network(network, page.view or VIEW)
    return Sheet.of_lattice(network.lattice, plane)


def _scale(values: np.ndarray) -> Normalize:
    """Return the scale of colours for positive coefficients: linear, or logarithmic if they differ by more than the
    factor MOST_LINEAR.

    values : (n,), the coefficients of all n contacts that are present.
    """
    if not len(values):
        return Normalize(0, 1)
    low, high = float(values.min()), float(values.max())
    return LogNorm(low, high) if high > MOST_LINEAR * low else Normalize(0.0 if low == high else low, high)


def _draw_picture(axes: Axes, sheet: Sheet, values: np.ndarray, norm: Normalize, site: float) -> bool:
    """Draw the coefficients of the contacts of one picture, and return True if discs show them, False if lines do.

    axes : axes of matplotlib.
    sheet : discs and contacts as they lie on paper.
    values : (contacts E,) coefficients of all contacts of the bearing, 0 where absent.
    norm : scale of the colours.
    site : distance of two neighbouring discs in points.

    Each contact is a line across it, or between centres where spheres lie behind each other. If there are too many
    contacts for lines, each disc has the colour of the mean of its contacts.
    """
    shown = values[sheet.contact]
    if (shown > 0).sum() > bearing.MOST_LINES and sheet.is_flat:
        ends = sheet.ends[:, shown > 0].ravel()
        total = np.bincount(ends, np.tile(shown[shown > 0], 2), len(sheet.place))
        number = np.bincount(ends, minlength=len(sheet.place))
        mean = np.divide(total, number, out=np.zeros(len(sheet.place)), where=number > 0)
        sheet.paint(axes, np.where((number > 0)[:, None], colormaps[COLOURS](norm(mean)), bearing.PALE))
        return True
    sheet.paint(axes, bearing.PALE if sheet.is_flat else bearing.PALE * [1, 1, 1, 0.25])
    sheet.box_driven(axes)
    line = bearing.line_on_site(site, 0.3, 0.8, 3.0)
    sheet.draw(axes, values > 0, across=sheet.is_flat, lw=line, array=values, cmap=COLOURS, norm=norm)
    return False


def _label(quantity: Quantity) -> str:
    """Return the label of the scale of colours of a coefficient, with its symbol and unit.

    quantity : friction or damping, as the contact law declares it.
    """
    if quantity.is_friction:
        return r"friction coefficient $\mu$"
    symbol = r" $\eta$" if quantity.name == "damping" else ""
    return f"{quantity.name}{symbol} ({quantity.unit.replace('/', ' / ').replace('*', ' · ')})"


def _in_words(quantity: Quantity, present: np.ndarray) -> str:
    """Return in words the least, largest and mean coefficient.

    quantity : friction or damping, as the contact law declares it.
    present : (n,), the coefficients of the n contacts that are present.
    """
    if not len(present):
        return f"no contact has {quantity.name}"
    low, high, mean = (short(float(value)) for value in (present.min(), present.max(), present.mean()))
    return f"{quantity.name} {low} to {high}, mean {mean}"
