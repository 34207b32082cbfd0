"""One look for all figures, of matplotlib's Figure objects: neither its settings nor its backend are ever changed."""

import io
import math
from pathlib import Path
from typing import Any

from matplotlib import colormaps, rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from taichi_bearings.files.whole_file import replace_file
from taichi_bearings.plots.page import PAGE

RC: dict[Any, Any] = {
    "font.size": 8,  # points on paper; nothing is smaller than 7 but indices
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "figure.titlesize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.title_fontsize": 7,
    "axes.titlepad": 4,
    "axes.labelpad": 2,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "xtick.minor.size": 1.6,
    "ytick.minor.size": 1.6,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "savefig.dpi": "figure",
    "pdf.fonttype": 42,  # letters stay letters, in a font that is embedded
    "ps.fonttype": 42,
    "svg.fonttype": "none",
}
BLUE, ORANGE, GREEN, GREY = "#2060a8", "#d0702a", "#3a8f4c", "#8a8a8a"
in_our_style = rc_context(RC)  # decorates what makes a figure


class NotebookFigure(Figure):
    """A figure that notebooks show, whether or not pyplot is there."""

    def _repr_png_(self) -> bytes:
        return _png(self)

    def draw(self, renderer: Any) -> None:
        """Lay out twice: titles above axes of a fixed aspect know their place only then."""
        if engine := self.get_layout_engine():
            engine.execute(self)
        super().draw(renderer)

    @in_our_style
    def savefig(self, *args: Any, **look: Any) -> None:
        """As of any figure, with letters as letters."""
        super().savefig(*args, **look)


DOUBLE, SINGLE = PAGE.inches("double"), PAGE.inches("single")


def new_figure(width: float = SINGLE, height: float = 2.5, dpi: float = PAGE.dpi) -> Figure:
    """An empty figure, width and height in inches on paper, laid out so that nothing overlaps."""
    figure = NotebookFigure(figsize=(width, height), dpi=dpi, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.03, h_pad=0.03)  # type: ignore[union-attr, call-arg]
    return figure


def plain_figure(width: float = SINGLE, height: float = 2.5, dpi: float = PAGE.dpi) -> Figure:
    """An empty figure for plain axes, in inches: with margins that are known, so that nothing is laid out anew."""
    figure = NotebookFigure(figsize=(width, height), dpi=dpi)
    figure.subplots_adjust(left=0.6 / width, right=1 - 0.08 / width, bottom=0.40 / height, top=1 - 0.42 / height)
    return figure


SUPERSCRIPTS = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")


class PlainLogFormatter(LogFormatter):
    """Labels of a logarithmic axis in plain text, which is drawn ten times faster than mathematics."""

    def __call__(self, value: float, position: int | None = None) -> str:
        if not super().__call__(value, position):
            return ""
        exponent = math.log10(value)
        is_decade = abs(exponent - round(exponent)) < 1e-6
        return f"10{str(round(exponent)).translate(SUPERSCRIPTS)}" if is_decade else f"{value:g}"


def label_in_plain_text(*axes: Any) -> None:
    """Label logarithmic axes in plain text; within a decade some of the ticks between, too."""
    for axis in axes:
        axis.set_major_formatter(PlainLogFormatter())
        axis.set_minor_formatter(PlainLogFormatter(minor_thresholds=(1, 0.4)))


def shades(number: int) -> list[Any]:
    """Colours of curves in an order, dark to light."""
    return [colormaps["viridis"](0.85 * k / max(number - 1, 1)) for k in range(number)]


MOST_VECTOR = 2**20  # bytes of a PDF that is written where no file is named
ENDINGS = (".png", ".pdf", ".svg")


@in_our_style
def _png(figure: Figure) -> bytes:
    drawn = io.BytesIO()
    FigureCanvasAgg(figure).print_png(drawn)  # draws once, savefig twice
    return drawn.getvalue()


def save_small(figure: Figure, stem: Path) -> Path:
    """Write `stem`.pdf, or `stem`.png where the former had more than MOST_VECTOR bytes; returns which."""
    drawn = _vectors(figure, "pdf")
    path = stem.with_name(f"{stem.name}.{'pdf' if len(drawn) <= MOST_VECTOR else 'png'}")
    replace_file(path, drawn if path.suffix == ".pdf" else _png(figure))
    return path


@in_our_style
def _vectors(figure: Figure, kind: str) -> bytes:
    drawn = io.BytesIO()
    figure.savefig(drawn, format=kind)
    return drawn.getvalue()


def save(figure: Figure, path: Path) -> None:
    """Write a PNG (or PDF, SVG by its ending), in full or not at all; FileError if that cannot be done."""
    if path.suffix == ".png":
        replace_file(path, _png(figure))
        return
    replace_file(path, _vectors(figure, path.suffix[1:]))
