"""Where sphere (r, i, j, k) lives in a field: flat, height fastest, with margins so that no stencil leaves the field.

Every field is one-dimensional in sites: p = margin + ((r * nx + i) * ny + j) * nz + k. The upper neighbour along an
axis is p + stride. A sphere on a side has no upper contact there: its coefficient is 0, so what lies at p + stride (the
other side, the next replica or the margin) does not matter as long as it is finite. Hence kernels have no branch for
the boundary, treat 2D, 3D and replicas alike, and their inner loops run along memory (docs/decisions/0002).
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Layout:
    """Flat layout of `replicas` lattices of `shape`, walked in blocks of `block` sites."""

    replicas: int
    shape: tuple[int, ...]
    block: int

    @property
    def sites(self) -> int:
        return self.replicas * int(np.prod(self.shape))

    @property
    def strides(self) -> tuple[int, ...]:
        """Distance in sites of the upper neighbour along each axis."""
        return tuple(int(np.prod(self.shape[axis + 1 :])) for axis in range(len(self.shape)))

    @property
    def margin(self) -> int:
        return max(self.strides[0], 1)

    @property
    def blocks(self) -> int:
        return -(-self.sites // self.block)

    @property
    def length(self) -> int:
        return self.margin + self.blocks * self.block + max(self.strides[0], 1)

    def flatten(self, values: np.ndarray, length: int) -> np.ndarray:
        """(C, R, *N) -> (length, C), zero in the margins."""
        flat = np.zeros((length, len(values)))
        flat[self.margin : self.margin + self.sites] = values.reshape(len(values), -1).T
        return flat

    def unflatten(self, flat: np.ndarray) -> np.ndarray:
        """(length, C) -> (C, R, *N), float64."""
        inside = flat[self.margin : self.margin + self.sites]
        return np.ascontiguousarray(inside.T, dtype=np.float64).reshape(-1, self.replicas, *self.shape)

    def at_lower_sphere(self, contacts: tuple[np.ndarray, ...]) -> np.ndarray:
        """One array (R, *contacts) an axis -> (D, R, *N): each contact at its lower sphere, 0 where there is none."""
        full = np.zeros((len(contacts), self.replicas, *self.shape))
        for axis, values in enumerate(contacts):
            full[axis][tuple(slice(0, n) for n in values.shape)] = values
        return full

    def from_lower_sphere(self, full: np.ndarray, axis: int) -> np.ndarray:
        """(..., R, *N) -> (..., R, *contacts of axis)."""
        sides = tuple(slice(0, n - (a == axis)) for a, n in enumerate(self.shape))
        return np.asarray(full[(Ellipsis,) + sides])
