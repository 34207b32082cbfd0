"""How a figure is printed: its width and resolution, and from where and where through a cubic lattice is seen."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.words import meant

JOURNAL_WIDTHS = {"single": 8.6, "double": 17.8}  # widths of a journal's columns, cm
INCH = 2.54  # cm
NARROWEST_PAGE, WIDEST_PAGE = 4.0, 60.0  # cm
AXES = "xyz"
MOST_PLANES = 12
BROAD, NARROW = 1.9, 1.6  # inches of a panel with a long title, and of one with a short
BELOW: dict[str, Any] = {"location": "bottom", "aspect": 30}  # a colour bar below the panels


@dataclass(frozen=True)
class View:
    """From where a lattice is seen, without perspective; degrees. azimuth : from x towards y."""

    elevation: float = 22.0
    azimuth: float = -55.0

    @cached_property
    def matrix(self) -> np.ndarray:
        """Rows: to the right, up, towards the reader."""
        angles = np.deg2rad([self.elevation, self.azimuth])
        (sin_e, sin_a), (cos_e, cos_a) = np.sin(angles), np.cos(angles)
        return np.array([
            [-sin_a, cos_a, 0.0],
            [-sin_e * cos_a, -sin_e * sin_a, cos_e],
            [cos_e * cos_a, cos_e * sin_a, sin_e],
        ])  # fmt: skip

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the lattice as the reader has them: to the right, up, nearer."""
        placed: np.ndarray = points @ self.matrix.T
        return placed

    def faces(self, axis: int) -> bool:
        """True if the side at the end of this axis faces the reader, False if the one at its beginning does."""
        return bool(self.matrix[2, axis] > 0)


VIEW = View()
Planes = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Page:
    """How a figure is printed.

    width : cm; None for the column that suits the figure. dpi : dots an inch of all that is not lines and letters.
    planes : (axis, index) of the cuts to show of a cubic lattice, view : from where; none for what suits the figure.
    title : whether words stand above it.
    """

    width: float | None = None
    dpi: int = 300
    planes: Planes = ()
    view: View | None = None
    title: bool = True

    def inches(self, column: str) -> float:
        """Width of the figure, of the column of this name unless another is asked for."""
        return (JOURNAL_WIDTHS[column] if self.width is None else self.width) / INCH


PAGE = Page()


def read_width(text: str) -> float:
    """Centimetres, or the name of a column; InputError for what is neither."""
    if text in JOURNAL_WIDTHS:
        return JOURNAL_WIDTHS[text]
    try:
        return _within(text, NARROWEST_PAGE, WIDEST_PAGE)
    except ValueError:
        names = ", ".join(f"{name} ({width:g})" for name, width in JOURNAL_WIDTHS.items())
        raise InputError(
            f"width is {text!r}; it must be {names} or a number of cm from {NARROWEST_PAGE:g} to {WIDEST_PAGE:g}"
            + meant(text, JOURNAL_WIDTHS)
        ) from None


def read_plane(text: str) -> tuple[int, int]:
    """(axis, index) of a plane such as x=3; InputError."""
    axis, _, index = text.replace(" ", "").partition("=")
    if axis not in tuple(AXES) or not index.isdecimal():
        raise InputError(f"plane is {text!r}; it must be an axis and the number of a plane, such as x=3, y=0 or z=5")
    return AXES.index(axis), int(index)


def read_view(text: str) -> View:
    """Elevation and azimuth such as 22,-55; InputError."""
    try:
        elevation, azimuth = text.split(",")
        return View(_within(elevation, -90, 90), _within(azimuth, -360, 360))
    except ValueError:
        raise InputError(
            f"view is {text!r}; it must be elevation,azimuth in degrees, such as 22,-55, the elevation from -90 to 90"
        ) from None


def _within(text: str, low: float, high: float) -> float:
    number = float(text)
    if not low <= number <= high:
        raise ValueError
    return number


def middle_planes(shape: tuple[int, ...]) -> Planes:
    """The planes across y and x through the middle of a cubic lattice."""
    return (1, shape[1] // 2), (0, shape[0] // 2)


def check_planes(planes: Planes, shape: tuple[int, ...]) -> None:
    """InputError for a plane that the lattice does not have, or too many."""
    if len(planes) > MOST_PLANES:
        raise InputError(f"plane is given {len(planes)} times; a figure shows at most {MOST_PLANES}")
    for axis, index in planes:
        if len(shape) == 2:
            raise InputError(f"plane is {AXES[axis]}={index}, but the lattice is flat; only cubic ones are cut")
        if index >= shape[axis]:
            raise InputError(
                f"plane is {AXES[axis]}={index}; the planes across {AXES[axis]} go from 0 to {shape[axis] - 1}"
            )


def columns_on(page: Page, number: int, least: float = BROAD) -> int:
    """How many of some panels stand beside each other on a page of two columns, each at least so many inches wide."""
    return max(1, min(number, int(page.inches("double") / least)))
