"""Boxes with periodic sides: their vectors, and the nearest images of spheres in them.

An image is a copy of a sphere, shifted by a sum of periods. Letters: D = 2 or 3 dimensions, k periods, E contacts.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

MOST_SIDE = 1e15  # the largest bound of a box, length


@dataclass(frozen=True)
class Box:
    """A parallelepiped that holds spheres, of which some pairs of opposite sides may be periodic.

    origin : (3,), length, the corner from which the edges start.
    edges : (3, 3), length, one edge vector in each row.
    periodic : list with True for each edge that is a period; None if the file does not say.
    """

    origin: np.ndarray
    edges: np.ndarray
    periodic: list[bool] | None

    @classmethod
    def of_bounds(cls, rows: np.ndarray, periodic: list[bool] | None) -> "Box | None":
        """Return the box that three rows of a LAMMPS dump describe; None if they describe none.

        rows : (3, 2), low and high end along each axis; or (3, 3), the bounds of a tilted box with its tilts xy, xz and
            yz; or (3, 4), one edge vector and a component of the origin in each row.
        periodic : list with True for each edge that is a period; None if that is not known.
        """
        if not (np.abs(rows) <= MOST_SIDE).all():
            return None
        if rows.shape[1] == 4:
            origin, edges = rows[:, 3], rows[:, :3]
        else:
            xy, xz, yz = rows[:, 2] if rows.shape[1] == 3 else (0.0, 0.0, 0.0)
            low = rows[:, 0] - [min(0.0, xy, xz, xy + xz), min(0.0, yz), 0.0]
            high = rows[:, 1] - [max(0.0, xy, xz, xy + xz), max(0.0, yz), 0.0]
            origin, edges = low, np.diag(high - low) + np.array([[0, 0, 0], [xy, 0, 0], [xz, yz, 0]])
        if not np.linalg.det(edges) >= 0 or (rows.shape[1] < 4 and (np.diag(edges) < 0).any()):
            return None
        return cls(origin, edges, periodic)

    def places(self, shares: np.ndarray) -> np.ndarray:
        """Return the places (spheres N, 3), length, of points that are given as fractions (N, 3) of the edges.

        shares : (N, 3), the fractions, 0 to 1 inside the box.
        """
        return np.asarray(self.origin + shares @ self.edges)

    def periods(self, dimension: int) -> np.ndarray:
        """Return the periodic ones among the first `dimension` edges, as vectors with so many components: (k,
        dimension), length.
        """
        return self.edges[[axis for axis in range(dimension) if self.periodic and self.periodic[axis]], :dimension]

    def is_nearly(self, other: "Box") -> bool:
        """Return True if another box is the same but for digits that were lost in printing.

        other : the other box.
        """
        size = np.abs(self.edges).max()
        near = np.abs(np.vstack([self.edges - other.edges, self.origin - other.origin])).max() <= 1e-4 * size
        return bool(near) and (self.periodic is None or other.periodic is None or self.periodic == other.periodic)


def reduced(periods: np.ndarray) -> np.ndarray:
    """Return the shortest vectors (k, dimensions D) that generate the same lattice of points as these periods (k, D).

    From each vector multiples of the others are subtracted until none gets shorter. With such vectors the nearest image
    of a sphere can be found step by step: as long as there is a nearer image, one of them is reached by -1, 0 or 1
    times each vector (Minkowski, for k up to 3).
    """
    periods = np.array(periods, dtype=float)
    for _ in range(1000):
        is_shorter = False
        for number in range(len(periods)):
            others = np.delete(periods, number, axis=0)
            for steps in product((-1, 0, 1), repeat=len(others)):
                other = np.array(np.array(steps) @ others if len(others) else 0.0)
                if not other.any():
                    continue
                # the multiple of `other` that is nearest to the projection on it
                times = np.round(periods[number] @ other / (other @ other))
                shorter = periods[number] - times * other
                if shorter @ shorter < (periods[number] @ periods[number]) * (1 - 1e-12):
                    periods[number], is_shorter = shorter, True
        if not is_shorter:
            break
    return periods


def nearest_images(vector: np.ndarray, periods: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the shortest vectors (contacts E, dimensions D), length, between pairs of places in a periodic box; and a
    mask (E,), True where a second image is at most `reach` away, so that it is not clear which one is meant.

    vector : (E, D), length, from one place to another, whichever images these are.
    periods : (k, D), length, linearly independent.
    reach : (E,), length.
    """
    found, doubtful = np.array(vector, dtype=float), np.zeros(len(vector), dtype=bool)
    if not len(periods):
        return found, doubtful
    periods = reduced(periods)
    # a near image first, by rounding the coefficients of the vector; then step by step to the nearest one
    found -= np.round(found @ np.linalg.pinv(periods)) @ periods
    shifts = [np.array(steps) @ periods for steps in product((-1, 0, 1), repeat=len(periods)) if any(steps)]
    for _ in range(100):
        size, is_nearer = np.einsum("ed,ed->e", found, found), False
        for shift in shifts:
            other = found + shift
            near = np.einsum("ed,ed->e", other, other) < size * (1 - 1e-12)
            if near.any():
                found[near], is_nearer = other[near], True
                size = np.einsum("ed,ed->e", found, found)
        if not is_nearer:
            break
    for shift in shifts:
        doubtful |= np.linalg.norm(found + shift, axis=1) <= reach
    return found, doubtful
