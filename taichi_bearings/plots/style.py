"""One look for all figures, of matplotlib's Figure objects: neither its settings nor its backend are ever changed."""

import io
import math
from pathlib import Path
from typing import Any

from matplotlib import colormaps, rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from taichi_bearings.errors import InputError
from taichi_bearings.files.whole_file import replace_file

RC: dict[Any, Any] = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "legend.frameon": False,
    "figure.dpi": 150,
    "savefig.dpi": 150,
}
BLUE, ORANGE, GREEN, GREY = "#2060a8", "#d0702a", "#3a8f4c", "#8a8a8a"
in_our_style = rc_context(RC)  # decorates what makes a figure


class NotebookFigure(Figure):
    """A figure that notebooks show, whether or not pyplot is there."""

    def _repr_png_(self) -> bytes:
        return _png(self)


def new_figure(width: float = 5.5, height: float = 4.0) -> Figure:
    """An empty figure, width and height in inches, laid out so that nothing overlaps."""
    return NotebookFigure(figsize=(width, height), layout="constrained")


def plain_figure(width: float = 5.5, height: float = 4.0) -> Figure:
    """An empty figure for plain axes, in inches: with margins that are known, so that nothing is laid out anew."""
    figure = NotebookFigure(figsize=(width, height))
    figure.subplots_adjust(left=0.78 / width, right=1 - 0.15 / width, bottom=0.55 / height, top=1 - 0.5 / height)
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


ENDINGS = (".png", ".pdf", ".svg")


def refuse_ending(path: Path) -> None:
    """InputError for the name of a figure of a kind that is not written."""
    if path.suffix not in ENDINGS:
        raise InputError(f"out is {str(path)!r}; it must end in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}")


@in_our_style
def _png(figure: Figure) -> bytes:
    drawn = io.BytesIO()
    FigureCanvasAgg(figure).print_png(drawn)  # draws once, savefig twice
    return drawn.getvalue()


@in_our_style
def save(figure: Figure, path: Path) -> None:
    """Write a PNG (or PDF, SVG by its ending), in full or not at all; FileError if that cannot be done."""
    if path.suffix == ".png":
        replace_file(path, _png(figure))
        return
    drawn = io.BytesIO()
    figure.savefig(drawn, format=path.suffix[1:])
    replace_file(path, drawn.getbuffer())
