"""How a figure is printed: width and resolution, from where a cubic lattice is seen, and which planes of it are cut."""

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
MOST_PLANES = 12  # most cuts in a figure
BROAD, NARROW = 1.9, 1.6  # least width in inches of a panel with a long title, and with a short one
BELOW: dict[str, Any] = {"location": "bottom", "aspect": 30}  # a colour bar below the panels


@dataclass(frozen=True)
class View:
    """From where a lattice is seen, without perspective; angles in degrees.

    elevation : angle above the xy plane.
    azimuth : angle from x towards y.
    """

    elevation: float = 22.0
    azimuth: float = -55.0

    @cached_property
    def matrix(self) -> np.ndarray:
        """(3, 3), rotation from the axes of the lattice to those of the reader: its rows are the unit vectors to the
        right, up, and towards the reader."""
        angles = np.deg2rad([self.elevation, self.azimuth])
        (sin_e, sin_a), (cos_e, cos_a) = np.sin(angles), np.cos(angles)
        return np.array([
            [-sin_a, cos_a, 0.0],
            [-sin_e * cos_a, -sin_e * sin_a, cos_e],
            [cos_e * cos_a, cos_e * sin_a, sin_e],
        ])  # fmt: skip

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Return the coordinates (..., 3) of points of the lattice to the right, up, and towards the reader."""
        placed: np.ndarray = points @ self.matrix.T
        return placed

    def faces(self, axis: int) -> bool:
        """Return True if the side of the lattice at the upper end of this axis faces the reader, False if the side at
        its lower end does.
        """
        return bool(self.matrix[2, axis] > 0)


VIEW = View()
Planes = tuple[tuple[int, int], ...]  # axis and index of each cut


@dataclass(frozen=True)
class Page:
    """How a figure is printed.

    width : cm; None for the column that suits the figure.
    dpi : dots an inch of all that is not lines and letters.
    planes : (axis, index) of the cuts through a cubic lattice; empty for those that suit the figure.
    view : from where it is seen; None for what suits the figure.
    title : whether the figure has a title.
    ending : format of the file where none is named: "png", "pdf" or "svg".
    """

    width: float | None = None
    dpi: int = 300
    planes: Planes = ()
    view: View | None = None
    title: bool = True
    ending: str = "png"

    def inches(self, column: str) -> float:
        """Return the width of the figure in inches: that of a column of a journal, unless another width was chosen.

        column : "single" or "double".
        """
        return (JOURNAL_WIDTHS[column] if self.width is None else self.width) / INCH


PAGE = Page()


def read_width(text: str) -> float:
    """Return the width in centimetres that a text names, as a number or as "single" or "double"; raise InputError if it
    names none.
    """
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
    """Return the plane that a text such as "x=3" names: the number of the axis across it, and its lattice index along
    this axis. Raises InputError if the text names none.
    """
    axis, _, index = text.replace(" ", "").partition("=")
    if axis not in tuple(AXES) or not index.isdecimal():
        raise InputError(f"plane is {text!r}; it must be an axis and the number of a plane, such as x=3, y=0 or z=5")
    return AXES.index(axis), int(index)


def read_view(text: str) -> View:
    """Return the view that a text such as 22,-55 names, elevation and azimuth in degrees; raise InputError if it names
    none.
    """
    try:
        elevation, azimuth = text.split(",")
        return View(_within(elevation, -90, 90), _within(azimuth, -360, 360))
    except ValueError:
        raise InputError(
            f"view is {text!r}; it must be elevation,azimuth in degrees, such as 22,-55, the elevation from -90 to 90"
        ) from None


def _within(text: str, low: float, high: float) -> float:
    """Return the number in a text; raise ValueError if it is no number from `low` to `high`."""
    number = float(text)
    if not low <= number <= high:
        raise ValueError
    return number


def middle_planes(shape: tuple[int, ...]) -> Planes:
    """Return the two planes across y and across x through the middle of a cubic lattice, each as (axis, index).

    shape : numbers of spheres (nx, ny, nz).
    """
    return (1, shape[1] // 2), (0, shape[0] // 2)


def check_planes(planes: Planes, shape: tuple[int, ...]) -> None:
    """Raise InputError for a plane that the lattice does not have, or for more than MOST_PLANES planes.

    planes : (axis, index) of each.
    shape : numbers of spheres along the axes of the lattice.
    """
    if len(planes) > MOST_PLANES:
        raise InputError(f"plane is given {len(planes)} times; a figure shows at most {MOST_PLANES} planes")
    for axis, index in planes:
        if len(shape) == 2:
            raise InputError(
                f"plane is {AXES[axis]}={index}, but the lattice is two-dimensional; only in 3D can planes be chosen"
            )
        if index >= shape[axis]:
            raise InputError(
                f"plane is {AXES[axis]}={index}; the planes across {AXES[axis]} go from 0 to {shape[axis] - 1}"
            )


def columns_on(page: Page, number: int, least: float = BROAD) -> int:
    """Return how many panels fit into a row on a page of two columns, at least 1.

    page : how the figure is printed.
    number : number of panels there are, the most that is returned.
    least : width that a panel needs, inches.
    """
    return max(1, min(number, int(page.inches("double") / least)))
