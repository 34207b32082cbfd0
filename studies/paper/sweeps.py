"""Shortest paths across grids of faces, many grids at once: sweeps over the columns until no distance becomes shorter.

A face is a square between four discs; a path over faces crosses the contacts of a cut. A step leads from a face to an
adjacent one and costs the weight of the contact between them. A sweep shortens the distances of one column after the
other: first by steps from the neighbour column, then by steps within the column, up and down. Columns whose neighbours
have not changed are skipped. A path that reverses its direction n times takes n sweeps, and lightest paths seldom do:
this is some ten times as fast as a queue of faces (numerics/planar/paths.py), but in floating point, so without proof.

Letters: B grids, w columns, h rows of discs.
"""

# mypy: ignore-errors
# Taichi reads this syntax, not Python

import numpy as np

from taichi_bearings.compiler import ti

WEIGHTS = ti.types.ndarray(dtype=ti.f64, ndim=3)
CHANGES = ti.types.ndarray(dtype=ti.i32, ndim=2)
TO_THE_RIGHT, TO_THE_LEFT = 1, 2  # bits: the neighbour on that side has not seen the last change of a column


def from_left(sideways: np.ndarray, upward: np.ndarray) -> np.ndarray:
    """Return the least weight of a path from the outside on the left to each face, (B, w, h - 1) for B grids. Faces are
    the squares between four discs, in columns from 1 on; column 0 is the outside. A path from face to face has the
    weight of the contacts that it crosses.

    sideways, upward : weights of the contacts of grids with w columns and h rows of discs, (B, w - 1, h) and (B, w, h -
        1), none negative; those of the lowest and the highest row of `sideways` are not used, since they join driven
        discs.
    """
    found = np.full(upward.shape, np.inf)
    found[:, 0] = 0.0
    unseen = np.zeros(upward.shape[:2], dtype=np.int32)
    unseen[:, 0] = TO_THE_RIGHT
    _sweep(found, np.ascontiguousarray(sideways[..., 1:-1]), np.ascontiguousarray(upward), unseen)
    return found


def crossings(sideways: np.ndarray, upward: np.ndarray, column: int) -> np.ndarray:
    """Return for each upward contact of one column the least weight of a path that crosses it, from the outside on the
    left to the outside on the right: (B, h - 1) for B grids of w columns and h rows of discs.

    sideways, upward : weights of the contacts, (B, w - 1, h) and (B, w, h - 1), none negative.
    column : index of the column, neither the first nor the last.
    """
    left = from_left(sideways, upward)[:, column]
    right = from_left(sideways[:, ::-1], upward[:, ::-1])[:, -1 - column]
    return np.asarray(left + upward[:, column] + right)


@ti.kernel
def _sweep(found: WEIGHTS, inner: WEIGHTS, upward: WEIGHTS, unseen: CHANGES):
    """Shorten the distances by sweeps over the columns of each grid, rightward and leftward in turn, until none becomes
    shorter.

    found : (B, w, h - 1) distances of the faces (squares between four discs) of B grids with w columns and h rows of
        discs from the outside on the left, changed in place.
    inner : (B, w - 1, h - 2) weights of the sideways contacts without those of the driven rows.
    upward : (B, w, h - 1) weights of the upward contacts.
    unseen : (B, w) bits TO_THE_RIGHT and TO_THE_LEFT: the neighbour on that side has not seen the last change of the
        column. Changed in place.
    """
    for grid in range(found.shape[0]):
        columns, has_changed = found.shape[1], 1
        while has_changed:
            has_changed = 0
            for column in range(1, columns):
                if unseen[grid, column - 1] & TO_THE_RIGHT:
                    unseen[grid, column - 1] -= TO_THE_RIGHT
                    has_changed |= _shorten_column(grid, column, column - 1, column - 1, found, inner, upward, unseen)
            for back in range(1, columns - 1):
                column = columns - 1 - back
                if unseen[grid, column + 1] & TO_THE_LEFT:
                    unseen[grid, column + 1] -= TO_THE_LEFT
                    has_changed |= _shorten_column(grid, column, column + 1, column, found, inner, upward, unseen)


@ti.func
def _shorten_column(
    grid: int, column: int, neighbour: int, contact: int,
    found: ti.template(), inner: ti.template(), upward: ti.template(), unseen: ti.template(),
) -> int:  # fmt: skip
    """Shorten the distances of a column of faces (squares between four discs) by steps from the neighbour column, then
    by steps along the column, up and down. Return 1 if a step from the neighbour made one shorter, else 0. All arrays
    are of B grids with w columns and h rows of discs.

    grid, column : indices of the grid and of the column.
    neighbour : index of the neighbour column.
    contact : index of the column of upward contacts that lie between both columns of faces.
    found : (B, w, h - 1) distance of each face from the outside on the left: the least weight of the contacts that a
        path to it crosses. Changed in place.
    inner, upward : weights of the sideways contacts between free discs (B, w - 1, h - 2), which paths along a column
        cross, and of the upward ones (B, w, h - 1).
    unseen : (B, w) bits that say which neighbours have not seen the last change of a column, changed in place.
    """
    rows, has_changed = found.shape[2], 0
    for row in range(rows):
        distance = found[grid, neighbour, row] + upward[grid, contact, row]
        if distance < found[grid, column, row]:
            found[grid, column, row] = distance
            has_changed = 1
    if has_changed:
        unseen[grid, column] = TO_THE_RIGHT | TO_THE_LEFT
        for row in range(1, rows):
            distance = found[grid, column, row - 1] + inner[grid, column - 1, row - 1]
            found[grid, column, row] = ti.min(found[grid, column, row], distance)
        for back in range(2, rows + 1):
            row = rows - back
            distance = found[grid, column, row + 1] + inner[grid, column - 1, row]
            found[grid, column, row] = ti.min(found[grid, column, row], distance)
    return has_changed
