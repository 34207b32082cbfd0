"""Boxes with periodic sides: their vectors, and the images of spheres in them."""

from dataclasses import dataclass
from itertools import product

import numpy as np

MOST_SIDE = 1e15  # length


@dataclass(frozen=True)
class Box:
    """A parallelepiped. origin : (3,), length. edges : (3, 3), its edge vectors, a row each, length.

    periodic : which edges are periods; None where the dump does not say.
    """

    origin: np.ndarray
    edges: np.ndarray
    periodic: list[bool] | None

    @classmethod
    def of_bounds(cls, rows: np.ndarray, periodic: list[bool] | None) -> "Box | None":
        """Out of the three rows of LAMMPS: low and high; bounds of the tilted box and its tilts xy, xz, yz; or edge
        vectors and origin. None if they are of no box."""
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
        """Places (N, 3) of shares of the edges."""
        return np.asarray(self.origin + shares @ self.edges)

    def periods(self, dimension: int) -> np.ndarray:
        """The periodic edges within the first axes, (k, dimension)."""
        return self.edges[[axis for axis in range(dimension) if self.periodic and self.periodic[axis]], :dimension]

    def is_as(self, other: "Box") -> bool:
        """True if another box is the same, but for digits that printing has lost."""
        size = np.abs(self.edges).max()
        near = np.abs(np.vstack([self.edges - other.edges, self.origin - other.origin])).max() <= 1e-4 * size
        return bool(near) and (self.periodic is None or other.periodic is None or self.periodic == other.periodic)


def reduced(periods: np.ndarray) -> np.ndarray:
    """The shortest vectors (k, D) that make the same lattice: each is reduced by sums of the others until none gets
    shorter. Then steps of -1, 0 and 1 along them lead from any image to the nearest one (Minkowski, k up to 3)."""
    periods = np.array(periods, dtype=float)
    for _ in range(1000):
        is_shorter = False
        for own in range(len(periods)):
            others = np.delete(periods, own, axis=0)
            for steps in product((-1, 0, 1), repeat=len(others)):
                shift = np.array(steps) @ others if len(others) else 0.0
                pull = np.array(shift)
                if not pull.any():
                    continue
                times = np.round(periods[own] @ pull / (pull @ pull))
                shorter = periods[own] - times * pull
                if shorter @ shorter < (periods[own] @ periods[own]) * (1 - 1e-12):
                    periods[own], is_shorter = shorter, True
        if not is_shorter:
            break
    return periods


def nearest_images(vector: np.ndarray, periods: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors (E, D) to the nearest images, and whether a second image (E,) is as near as `reach` (E,), length.

    vector : (E, D), length, between places anywhere. periods : (k, D), independent.
    """
    found, doubtful = np.array(vector, dtype=float), np.zeros(len(vector), dtype=bool)
    if not len(periods):
        return found, doubtful
    periods = reduced(periods)
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
