"""Packings of spheres on regular lattices, built from a table of cells. Lengths are in diameters.

Letters: N spheres, E contacts, D = 2 or 3 dimensions. step : (D,), whole numbers of cells along the axes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.lattice.grid import AXIS_NAMES, axis_numbers
from taichi_bearings.scene.checks import MOST_SPHERES
from taichi_bearings.scene.scene import periodic_axes
from taichi_bearings.words import shown


@dataclass(frozen=True)
class Cell:
    """A rectangular cell of a lattice with n spheres, in D dimensions.

    size : (D,), lengths of its edges in diameters.
    basis : (n, D), centres of its spheres as fractions of the size.
    parity : the sublattice, 0 or 1, of each sphere, (n,); and for each axis, (D,), 1 if sublattices are exchanged in
        the next cell along it, else 0. None for a lattice with odd loops (closed chains of an odd number of contacts),
        which has no sublattices.
    """

    size: tuple[float, ...]
    basis: tuple[tuple[float, ...], ...]
    parity: tuple[tuple[int, ...], tuple[int, ...]] | None


FACES = ((0.0, 0.0, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5), (0.5, 0.5, 0.0))
QUARTER = tuple((x + 0.25, y + 0.25, z + 0.25) for x, y, z in FACES)
KINDS = {
    "square": Cell((1.0, 1.0), ((0.0, 0.0),), ((0,), (1, 1))),
    "triangular": Cell((1.0, 3**0.5), ((0.0, 0.0), (0.5, 0.5)), None),
    "honeycomb": Cell(
        (3**0.5, 3.0), ((0.0, 0.0), (0.5, 1 / 6), (0.5, 0.5), (0.0, 2 / 3)), ((0, 1, 0, 1), (0, 0))
    ),
    "cubic": Cell((1.0, 1.0, 1.0), ((0.0, 0.0, 0.0),), ((0,), (1, 1, 1))),
    "bcc": Cell((2 / 3**0.5,) * 3, ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5)), ((0, 1), (0, 0, 0))),
    "fcc": Cell((2**0.5,) * 3, FACES, None),
    "diamond": Cell((4 / 3**0.5,) * 3, FACES + QUARTER, ((0, 0, 0, 0, 1, 1, 1, 1), (0, 0, 0))),
    "hcp": Cell(
        (1.0, 3**0.5, (8 / 3) ** 0.5), ((0.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, 1 / 6, 0.5), (0.0, 2 / 3, 0.5)), None
    ),
}  # fmt: skip
Built = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Places (N, D), contacts (E, 2), normals (E, D), signs of the sublattice (N,), and bodies (N,)."""


def built(
    kind: str, cells: tuple[int, ...], periodic: object
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, set[int]]:
    """Return places (spheres N, dimensions D), contacts (contacts E, 2), normals (E, D), signs of the sublattice (N,),
    and the periodic axes.

    kind : key of KINDS.
    cells : number of cells along each axis.
    periodic : names of the periodic axes.

    Spheres are in the order of their cells. Contacts are in the order of the bonds of a cell, on a cubic lattice axis
    by axis as in scenes. Raises InputError for numbers or names that are not allowed.
    """
    cell = KINDS[kind]
    dimension = len(cell.size)
    if len(cells) != dimension or min(cells) < 1 or np.prod([float(n) for n in cells]) > MOST_SPHERES / len(cell.basis):
        raise InputError(
            f"cells is {shown(cells)}; it must be {dimension} whole numbers, 1 or more each and with at most "
            f"{MOST_SPHERES:,} spheres in all: how often the unit cell of a {kind} lattice is repeated along each axis"
        )
    closed = set(axis_numbers(periodic_axes(periodic, AXIS_NAMES[:dimension])))
    if short := [AXIS_NAMES[axis] for axis in closed if cells[axis] < 2]:
        raise InputError(f"cells is {shown(cells)}; along the periodic axis {short[0]} it must be 2 or more")
    # Spheres cell by cell, then the contacts of each bond of the cell in all cells.
    grid = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, dimension)
    basis, size = np.array(cell.basis), np.array(cell.size)
    place = ((grid[:, None] + basis) * size).reshape(-1, dimension)
    parts = [_of_bond(grid, cells, closed, len(basis), *bond) for bond in _bonds(cell)]
    contact = np.concatenate([pairs for pairs, _ in parts])
    normal = np.concatenate([np.broadcast_to(vector, (len(pairs), dimension)) for pairs, vector in parts])
    # signs of the sublattices: parity within the cell, exchanged from cell to cell along axes with parity 1
    sign = np.ones(len(place))
    if cell.parity is not None:
        sign = np.where((np.array(cell.parity[0]) + (grid @ np.array(cell.parity[1]))[:, None]).ravel() % 2, -1.0, 1.0)
    return place, contact, normal, sign, closed


def driven_bodies(place: np.ndarray, closed: set[int], driven: str) -> np.ndarray:
    """Return the body of each sphere, (spheres N,): 0 for the bottom, 1 for the top, -1 for free spheres.

    place : (N, dimensions D), diameters.
    closed : numbers of the periodic axes.
    driven : which spheres are driven: "planes", the lowest and the highest layer along the last axis; "walls", those
        along x; or "shaft:r", all walls along x and y as the bottom, and the spheres within r diameters of the vertical
        axis through the middle (of discs, of the middle) as the top. InputError is raised for anything else.
    """
    kind, _, size = driven.partition(":") if isinstance(driven, str) else ("", "", "")
    body = np.full(len(place), -1)
    if kind in ("planes", "walls") and not size:
        # Bottom and top along the height, or both ends along x.
        axis = place.shape[1] - 1 if kind == "planes" else 0
        if kind == "walls" and axis in closed:
            raise InputError(
                f"driven is {driven!r}, but x is periodic, so no walls stand at its ends; leave x out of periodic"
            )
        if axis not in closed:
            body[_at_end(place, axis, 1)], body[_at_end(place, axis, -1)] = 1, 0
        return body
    # a shaft: walls are at the ends of x and y, and the shaft is what is near the middle
    try:
        radius = float(size) if kind == "shaft" else np.nan
    except ValueError:
        radius = np.nan
    if not 0 < radius < np.inf:
        raise InputError(
            f"driven is {shown(driven)}; it must be planes, walls, or shaft:r, where r is the radius of the shaft in "
            "diameters of a sphere"
        )
    if named := [AXIS_NAMES[axis] for axis in (0, 1) if axis in closed]:
        raise InputError(
            f"driven is {driven!r}, which needs walls at the ends of x and y, but {named[0]} is periodic; leave "
            f"{named[0]} out of periodic"
        )
    for axis in (0, 1):
        body[_at_end(place, axis, 1) | _at_end(place, axis, -1)] = 0
    middle = (place[:, :2].min(axis=0) + place[:, :2].max(axis=0)) / 2
    shaft = np.linalg.norm(place[:, :2] - middle, axis=1) <= radius * (1 + 1e-12)
    if not shaft.any() or (body[shaft] == 0).any():
        fault = "reaches the walls; make it thinner" if shaft.any() else "holds no sphere; make it thicker"
        raise InputError(f"driven is {driven!r}, but a shaft of this radius {fault}")
    body[shaft] = 1
    return body


def _at_end(place: np.ndarray, axis: int, side: int) -> np.ndarray:
    """Return a mask (spheres N,) of the spheres at the upper end of an axis (`side` 1) or at its lower end (`side` -1).

    place : (N, dimensions D), diameters.
    axis : number of the axis.
    """
    height = side * place[:, axis]
    return np.asarray(height > height.max() - 1e-6)


def _bonds(cell: Cell) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
    """Yield the bonds of a cell, each once. A bond joins two spheres whose centres are one diameter apart; the second
    may be in a neighbouring cell. Each bond is taken in the direction in which the last component of its vector that is
    not 0 is positive.

    yields : numbers within their cells of the first and of the second sphere; step (dimensions D,) in whole cells to
        the cell of the second; unit vector (D,) from the first to the second.

    Raises InputError for a cell in which two spheres overlap.
    """
    basis, size = np.array(cell.basis), np.array(cell.size)
    steps = [np.array(step[::-1]) for step in product((0, 1, -1), repeat=len(size))]
    for step in steps:
        for first, second in product(range(len(basis)), repeat=2):
            vector = (basis[second] + step - basis[first]) * size
            distance = float(np.linalg.norm(vector))
            if distance < 1 - 1e-9 and (first != second or step.any()):
                raise InputError(
                    f"basis is wrong: its spheres {first} and {second} overlap, as their centres are only "
                    f"{distance:.6g} diameters apart"
                )
            if abs(distance - 1) < 1e-9 and _leads_up(vector):
                yield first, second, step, _exact(vector)


def _leads_up(vector: np.ndarray) -> bool:
    """Return True if the last component of a vector that is not 0 is positive. A component up to 1e-9 counts as 0."""
    others = vector[np.abs(vector) > 1e-9]
    return bool(others[-1] > 0)


def _exact(vector: np.ndarray) -> np.ndarray:
    """Return a unit vector of which components of equal size are equal to the last bit, and those below 1e-9 are 0: it
    is rounded to 12 digits.

    vector : (dimensions,), of length 1 but for rounding.
    """
    components = np.where(np.abs(vector) < 1e-9, 0.0, np.round(vector, 12))
    found: np.ndarray = components / np.linalg.norm(components)
    return found


def _of_bond(
    grid: np.ndarray,
    cells: tuple[int, ...],
    closed: set[int],
    each: int,
    first: int,
    second: int,
    step: np.ndarray,
    vector: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the contacts that one bond of the unit cell makes in all cells of a lattice: an array (contacts E, 2) with
    the numbers of both spheres, and the unit vector (dimensions D,) from the first to the second sphere, which is the
    same for all. A bond joins two spheres whose centres are one diameter apart.

    grid : (cells, dimensions D), positions of all cells, in whole numbers.
    cells : number of cells along each axis.
    closed : numbers of the periodic axes.
    each : number of spheres in a cell.
    first, second : numbers within their cells of the two spheres of the bond.
    step : (D,), whole cells from that of the first to that of the second sphere.
    vector : (D,), unit vector from the first to the second sphere.
    """
    there = grid + step
    for axis in closed:
        there[:, axis] %= cells[axis]
    inside = ((there >= 0) & (there < cells)).all(axis=1)
    begin = np.ravel_multi_index(tuple(grid[inside].T), cells)
    end = np.ravel_multi_index(tuple(there[inside].T), cells)
    return np.stack([each * begin + first, each * end + second], axis=1), vector
