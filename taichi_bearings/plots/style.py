"""Gives all figures one look, through matplotlib's Figure objects: its global settings and backend are never changed.

It also names quantities and their units on axes, and says in titles what system a figure shows.
"""

import io
import math
import re
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context, rcParamsDefault
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import TICKDOWN, TICKLEFT
from matplotlib.ticker import LogFormatter, NullLocator

from taichi_bearings.plain_files import replace_file
from taichi_bearings.plots.page import BROAD, PAGE, Page, columns_on
from taichi_bearings.quantities import COLUMNS
from taichi_bearings.scene import Bearing
from taichi_bearings.scene.scene import of_lattice

RC: dict[Any, Any] = {
    # sizes in points on paper; only indices are smaller than 7
    **dict.fromkeys(("font.size", "axes.titlesize", "axes.labelsize", "figure.titlesize"), 8),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize", "legend.title_fontsize"), 7),
    **dict.fromkeys(("axes.linewidth", "xtick.major.width", "ytick.major.width"), 0.6),
    **dict.fromkeys(("xtick.minor.width", "ytick.minor.width"), 0.4),
    **dict.fromkeys(("xtick.major.size", "ytick.major.size"), 3),
    **dict.fromkeys(("xtick.minor.size", "ytick.minor.size", "legend.handlelength"), 1.6),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False),
    **{"axes.titlepad": 4, "axes.labelpad": 2, "lines.linewidth": 1.0, "savefig.dpi": "figure"},
    # letters stay letters, in a font that is embedded
    **{"pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "none"},
}
BLUE, ORANGE, GREEN, GREY = "#2060a8", "#d0702a", "#3a8f4c", "#8a8a8a"
TALLER = 1.5  # height of a panel that spans several columns, relative to the others
SCREEN_DPI = 100  # dots an inch of the figures in notebooks
LETTERS_AN_INCH, TITLE_LINE = 16, 0.14  # letters of a title in an inch, and height of its lines in inches
IN_DOLLARS = re.compile(r"(?<!\\)\$.*?(?<!\\)\$")  # mathematics within a text
OF_THE_PROCESS = (
    "animation", "backend", "date", "docstring", "interactive", "keymap", "savefig.directory", "timezone", "tk",
    "toolbar", "webagg",
)  # fmt: skip
"""First parts of the names of settings that no figure depends on."""
PLAIN_RC = {key: value for key, value in rcParamsDefault.items() if not key.startswith(OF_THE_PROCESS)}
in_our_style = rc_context(PLAIN_RC | RC)  # decorates functions that make figures, so that no matplotlibrc changes them


class NotebookFigure(Figure):
    """A figure that notebooks show, whether or not pyplot is loaded."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """Return a PNG and its size for the screen; it has twice as many dots, to be sharp on fine screens."""
        printed, self.dpi = self.dpi, 2 * SCREEN_DPI
        try:
            width, height = (int(SCREEN_DPI * inches) for inches in self.get_size_inches())
            return _file_content(self, "png"), {"width": width, "height": height}
        finally:
            self.dpi = printed

    def draw(self, renderer: RendererBase) -> None:
        """Lay out the figure twice and draw it: titles above axes of a fixed aspect have their final place only
        then.
        """
        if engine := self.get_layout_engine():
            engine.execute(self)
        super().draw(renderer)

    @in_our_style
    def savefig(self, *args: Any, **look: Any) -> None:
        """Save as any figure of matplotlib, with the same arguments, and with text kept as text in PDF and SVG."""
        super().savefig(*args, **look)


DOUBLE, SINGLE = PAGE.inches("double"), PAGE.inches("single")


def new_figure(width: float = SINGLE, height: float = 2.5, dpi: float = PAGE.dpi) -> Figure:
    """Return an empty figure, laid out so that nothing overlaps.

    width, height : inches on paper.
    dpi : dots an inch.
    """
    figure = NotebookFigure(figsize=(width, height), dpi=dpi, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.03, h_pad=0.03)  # type: ignore[union-attr, call-arg]
    return figure


def panels(
    page: Page, number: int, row: tuple[float, float], more: float = 0.0, least: float = BROAD, widest: str = "double"
) -> tuple[Figure, list[Axes], float]:
    """Return a figure of panels in rows, their axes, and the width of each panel in inches. The first panel spans the
    columns that would stay empty.

    page : how the figure is printed.
    number : number of panels.
    row : height of a row, as a share of the width of a panel and as inches to add.
    more : inches to add to the height of the figure.
    least : width that a panel needs, inches.
    widest : column of the page, "single" or "double", that no panel exceeds in width.
    """
    columns = columns_on(page, number, least)
    rows = math.ceil(number / columns)
    spanned = 1 + columns * rows - number  # columns of the first panel
    width = min(page.inches("double") / columns, page.inches(widest))
    heights = [TALLER if spanned > 1 else 1.0, *[1.0] * (rows - 1)]
    figure = new_figure(columns * width, sum(heights) * row[0] * width + rows * row[1] + more, page.dpi)
    cells = figure.add_gridspec(rows, columns, height_ratios=heights)
    others = [cells[divmod(place, columns)] for place in range(spanned, columns * rows)]
    return figure, [figure.add_subplot(place) for place in (cells[0, :spanned], *others)], width


def plain_figure(width: float = SINGLE, height: float = 2.5, dpi: float = PAGE.dpi) -> Figure:
    """Return an empty figure with known margins, which needs no layout and is drawn faster.

    width, height : inches on paper.
    dpi : dots an inch.
    """
    figure = NotebookFigure(figsize=(width, height), dpi=dpi)
    figure.subplots_adjust(left=0.6 / width, right=1 - 0.08 / width, bottom=0.40 / height, top=1 - 0.08 / height)
    return figure


def put_title(figure: Figure, words: str, page: Page = PAGE) -> None:
    """Put a title above a figure, which becomes taller by its lines. Do nothing if the page has no titles.

    figure : figure of matplotlib, changed in place.
    words : the title. Long lines are broken, but never inside mathematics or before a per cent sign.
    page : how the figure is printed.
    """
    if not page.title:
        return
    # spaces at which no line may break are replaced until the lines are broken
    joined = IN_DOLLARS.sub(lambda found: found[0].replace(" ", "\0"), words.replace(" %", "\u00a0%"))
    width, height = figure.get_size_inches()
    lines = [line for part in joined.split("\n") for line in textwrap.wrap(part, int(LETTERS_AN_INCH * width))]
    margins, taller = figure.subplotpars, height + TITLE_LINE * (len(lines) + 0.5)
    figure.set_figheight(taller)
    if figure.get_layout_engine() is None:
        figure.subplots_adjust(bottom=margins.bottom * height / taller, top=margins.top * height / taller)
    figure.suptitle("\n".join(lines).replace("\0", " "))


SUPERSCRIPTS = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")


class PlainLogFormatter(LogFormatter):
    """Formats labels of a logarithmic axis in plain text, which is drawn ten times faster than mathematics.

    Powers of ten are written with exponents; in full if the axis has at most two. What matplotlib labels between them
    is written in full; on a horizontal axis of more than a decade only numbers that begin with 3 are.
    """

    def __call__(self, value: float, position: int | None = None) -> str:
        """Return the label of a value, "" for ticks without one; matplotlib calls this with the number of the tick."""
        if not super().__call__(value, position):
            return ""
        exponent = math.log10(value)
        assert self.axis is not None  # which matplotlib sets before it asks for labels
        low, high = sorted(math.log10(end) for end in self.axis.get_view_interval())
        is_decade = abs(exponent - round(exponent)) < 1e-6
        is_crowded = getattr(self.axis, "axis_name", "") == "x" and high - low > 1
        if is_crowded and not is_decade and round(10 ** (exponent % 1)) != 3:
            return ""
        in_full = math.floor(high) - math.ceil(low) < 2 or not is_decade
        return short(value) if in_full else f"10{str(round(exponent)).translate(SUPERSCRIPTS)}"


def short(value: float) -> str:
    """Return a value as the name of a tick: whole numbers below 100 000 as they are, others to three digits.

    >>> short(1024.0), short(3.16228), short(0.0316228), short(316227.8), short(1e6)
    ('1024', '3.16', '0.0316', '3.16·10⁵', '10⁶')
    """
    if value == round(value) and abs(value) < 1e5:
        return str(round(value))
    if 1e-4 <= abs(value) < 1e5:
        return f"{float(f'{value:.3g}'):g}"
    mantissa, _, exponent = f"{value:.2e}".partition("e")
    power = f"10{str(int(exponent)).translate(SUPERSCRIPTS)}"
    return power if float(mantissa) == 1 else f"{float(mantissa):g}·{power}"


def label_in_plain_text(*axes: Axis) -> None:
    """Label logarithmic axes in plain text, and within a decade some of the minor ticks, too."""
    for axis in axes:
        axis.set_major_formatter(PlainLogFormatter())
        axis.set_minor_formatter(PlainLogFormatter(minor_thresholds=(1, 0.4)))


def fix_minor_ticks(axes: Any) -> None:
    """Replace the minor ticks of each axis by one line of markers at their places. An axis whose minor ticks have
    labels stays as it is.

    axes : axes of matplotlib, with their final limits.

    matplotlib makes five objects of each tick, which takes half of the time in which a small figure is drawn.
    """
    for axis, name, marker in ((axes.xaxis, "xtick", TICKDOWN), (axes.yaxis, "ytick", TICKLEFT)):
        low, high = axis.get_view_interval()
        places = np.array([place for place in axis.get_minorticklocs() if low <= place <= high])
        if any(axis.get_minor_formatter().format_ticks(places)):
            continue
        axis.set_minor_locator(NullLocator())
        look: dict[str, Any] = {"markersize": RC[f"{name}.minor.size"], "markeredgewidth": RC[f"{name}.minor.width"]}
        at, transform = [places, np.zeros(len(places))], axes.get_xaxis_transform("tick1")
        if name == "ytick":
            at, transform = at[::-1], axes.get_yaxis_transform("tick1")
        look |= {"color": "black", "linestyle": "", "marker": marker, "transform": transform, "clip_on": False}
        axes.add_artist(Line2D(*at, **look))


def shades(number: int) -> list[Any]:
    """Return `number` colours for curves that have an order, from dark to light.

    number : how many colours.
    """
    return [colormaps["viridis"](0.85 * k / max(number - 1, 1)) for k in range(number)]


MOST_VECTOR = 2**20  # bytes; a larger PDF gives way to a PNG where the user named no file
ENDINGS = (".png", ".pdf", ".svg")


@in_our_style
def _file_content(figure: Figure, kind: str) -> bytes:
    """Return the bytes of the file of a figure.

    kind : "png", "pdf" or "svg".
    """
    drawn = io.BytesIO()
    if kind == "png":
        # draws once, savefig twice; more compression takes twice the time for a sixth of the bytes
        FigureCanvasAgg(figure).print_png(drawn, pil_kwargs={"compress_level": 3})
    else:
        figure.savefig(drawn, format=kind)
    return drawn.getvalue()


def save_small(figure: Figure, stem: Path) -> Path:
    """Write a figure as PDF, or as PNG if the PDF had more than MOST_VECTOR bytes, and return the path.

    figure : the figure.
    stem : path without ending.
    """
    drawn, ending = _file_content(figure, "pdf"), "pdf"
    if len(drawn) > MOST_VECTOR:
        drawn, ending = _file_content(figure, "png"), "png"
    path = stem.with_name(f"{stem.name}.{ending}")
    replace_file(path, drawn)
    return path


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, PDF or SVG, by the ending of the path, in full or not at all; raise FileError if that
    fails.
    """
    replace_file(path, _file_content(figure, path.suffix[1:]))


def _printed_unit(unit: str) -> str:
    """Return a unit as figures print it; nothing for pure numbers.

    unit : unit as the table of quantities has it, such as "energy/time" or "1".
    """
    return "" if unit == "1" else unit.replace("/", " / ").replace("*", " · ")


def describe(scene: Bearing, sample: int | None = 0) -> str:
    """Return words for a title: size, law and seed of a sample; for a packing size and law.

    scene : what was solved.
    sample : number of the sample; None for all samples.
    """
    network = scene.network
    if network.lattice is None:
        what = "discs" if network.dimension == 2 else "spheres"
        return f"{network.spheres:,} {what}, {str(scene.law).replace('coulomb', 'Coulomb')}"
    scene = of_lattice(scene)
    shape = "×".join(map(str, scene.lattice.shape))  # as plain text: mathematics would take matplotlib 40 ms more
    source = (scene if sample is None else scene.sample(sample)).source
    return f"{shape} {str(scene.law).replace('coulomb', 'Coulomb')}{scene.periodic_in_words}, {as_text(source)}"


def mathematics(value: float, digits: int = 6) -> str:
    """Return a value to so many significant digits as mathematics of LaTeX: 5e-12 as 5 times a power of ten.

    value : the number.
    """
    mantissa, power, exponent = f"{value:.{digits}g}".partition("e")
    return mantissa + (rf"\times10^{{{int(exponent)}}}" if power else "")


def _symbol(scene: Bearing, of_top: bool) -> str:
    """Return the symbol of the imposed spin of a driven plane of a lattice, for labels; if the spins of the plane grow
    with the position, it is that of the largest one.

    scene : what was solved.
    of_top : True for the top, False for the bottom.
    """
    top_grows, bottom_grows = of_lattice(scene).driving.grows
    letter, largest = "T" if of_top else "B", r",\mathrm{max}" * (top_grows if of_top else bottom_grows)
    return rf"\omega_{{{letter}{largest}}}" if largest else rf"\omega_{letter}"


def larger_spin(scene: Bearing) -> str:
    """Return the symbol of the larger one of the two imposed spins of a lattice, for labels.

    scene : what was solved.
    """
    spin_top, spin_bottom = of_lattice(scene).imposed
    return _symbol(scene, abs(spin_top) >= abs(spin_bottom))


def driving(scene: Bearing) -> tuple[float, str]:
    """Return the unit of rates in figures of a scene, an imposed spin, 1/time, and its symbol; 1 and "" for packings.

    scene : what was solved.
    """
    natural = scene.natural_spin
    return (1.0, "") if natural is None else (natural, _symbol(scene, bool(scene.top_and_bottom[0])))


def power_unit(scene: Bearing) -> tuple[float, str]:
    """Return the unit of power in figures of a scene, F_n R |imposed spin|, energy/time, and its symbol; 1 and "" for
    packings and laws without friction.

    scene : what was solved.
    """
    spin, symbol = driving(scene)
    unit = scene.natural_energy
    return (1.0, "") if unit is None else (unit * spin, rf"F_n R\,{symbol}")


def time_label(symbol: str) -> str:
    """Return the label of an axis of time.

    symbol : symbol of the spin that is its unit, or "".
    """
    return rf"time, ${symbol}\,t$" if symbol else "time"


def energy_unit(scene: Bearing) -> tuple[float, str]:
    """Return the unit of energy in figures of a scene, F_n R, and its symbol; 1 and "" for packings and laws without
    friction.

    scene : what was solved.
    """
    unit = scene.natural_energy
    return (1.0, "") if unit is None else (unit, r"F_n R")


def over(symbol: str, unit: str, without: str) -> str:
    """Return the label of a quantity divided by its unit, as mathematics.

    symbol : symbol of the quantity.
    unit : symbol of the unit, or "".
    without : words for the unit where it has no symbol.
    """
    if not unit:
        return f"${symbol}$ ({without})"
    return rf"${symbol}\,/\,({unit})$" if "R" in unit else rf"${symbol}\,/\,{unit}$"


SYMBOLS = {name: (row.symbol, _printed_unit(row.unit)) for name, row in COLUMNS.items() if row.symbol}
"""Symbol and unit of those columns of a scan that have a symbol; the others are called by their names."""


def as_text(words: object) -> str:
    """Return words from a file as a figure shows them: a dollar sign in them begins no mathematics."""
    return str(words).replace("$", r"\$")


def column_label(name: str) -> str:
    """Return the label of an axis for a column of a scan.

    name : name of the column; or "a/b" for the mean of column a over that of column b.
    """
    parts = name.split("/")
    if not all(part in SYMBOLS for part in parts):
        unit = _printed_unit(COLUMNS[name].unit) if name in COLUMNS else ""
        words = " / ".join(part.replace("_", " ") for part in parts)
        return as_text(words + (f" ({unit})" if unit else ""))
    symbols, units = zip(*(SYMBOLS[part] for part in parts), strict=True)
    if len(parts) == 1:
        unit = f" ({units[0]})" if units[0] else ""
        return f"${symbols[0]}${unit}"
    above, below = (f"({unit})" if " " in unit else unit or "1" for unit in units)
    unit = "" if above == below else f" ({above} / {below})"
    return rf"$\langle {symbols[0]} \rangle\,/\,\langle {symbols[1]} \rangle${unit}"
