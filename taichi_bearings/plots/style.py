"""One look for all figures."""

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

from matplotlib.figure import Figure

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


def save(figure: Figure, path: Path) -> None:
    """Write a PNG (or PDF, SVG by its ending) under a temporary name and rename it."""
    partial = path.with_name(f".partial-{path.name}")
    figure.savefig(partial)
    partial.replace(path)
