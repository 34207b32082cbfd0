"""One look for all figures."""

import io
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

from matplotlib.figure import Figure

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
matplotlib.rcParams.update(RC)


def new_figure(width: float = 5.5, height: float = 4.0) -> Figure:
    """An empty figure, width and height in inches, laid out so that nothing overlaps."""
    return Figure(figsize=(width, height), layout="constrained")


def shades(number: int) -> list[Any]:
    """Colours of curves in an order, dark to light."""
    return [matplotlib.colormaps["viridis"](0.85 * k / max(number - 1, 1)) for k in range(number)]


def save(figure: Figure, path: Path) -> None:
    """Write a PNG (or PDF, SVG by its ending), in full or not at all; FileError if that cannot be done."""
    drawn = io.BytesIO()
    figure.savefig(drawn, format=path.suffix[1:])
    replace_file(path, drawn.getbuffer())
