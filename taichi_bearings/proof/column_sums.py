"""Torques that contact forces leave on the spheres of a lattice, some planes of spheres at a time.

Arrays over a large lattice exceed the caches of a processor many times over. So torques are summed for some planes of
spheres (those with neighbouring places along x), and only what a bound needs of them is kept for each column of spheres
along the height. Threads may share the planes. Each number is computed in the same way, whatever the planes are.

Letters: C spin components, R samples, E contacts, *N the shape of the lattice, *N' the same without the height.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import Index, tangential

CACHED_PULLS = 16_384  # length of arrays of which several fit the second-level cache of a processor

Part = tuple[slice, slice]
"""Some of the R samples, and some planes of an array (R, *N)."""
Share = Callable[..., Iterable[Any]]
"""A function like `map`, which may share the calls among threads."""


class ColumnSums(NamedTuple):
    """Sums over each column of spheres along the height: arrays (C components, R samples, *N'), where N' is the lattice
    without its last axis. They are torques over the radius."""

    bottom: np.ndarray  # force, on the driven sphere at the bottom
    top: np.ndarray  # force, on the driven sphere at the top
    left_over: np.ndarray  # force, sum of the sizes on the free spheres


def parts_in_cache(shape: tuple[int, ...]) -> list[Part]:
    """Return pairs of slices that cut the first two axes of arrays (R samples, n, ...) into parts which fit the caches
    of a processor.

    shape : their shape.
    """
    each = max(int(np.prod(shape[1:])), 1)
    several, size = max(1, CACHED_PULLS // each), max(1, CACHED_PULLS * shape[1] // each)
    return [
        (slice(r, r + several), slice(first, first + size))
        for r in range(0, shape[0], several)
        for first in range(0, shape[1], size)
    ]


def torques_on(part: Part, force: np.ndarray, lattice: Lattice, spin_axes: tuple[int, ...], plain: bool) -> np.ndarray:
    """Return the sum of the contact forces that pull on each sphere of some planes, (C, r, n, ...) for r samples and n
    planes.

    part : which samples and planes.
    force : (C, R, E), forces along the spin difference of the contacts.
    lattice : the shape of the lattice and its periodic axes.
    spin_axes : the axes of the C components.
    plain : True for sums in plain doubles. Else each addition keeps what it rounds away (Knuth's two-sum): the relative
        error is that of one rounding, plus about 1e-32 of the forces. A plain sum of forces in balance has an error as
        large as the torque itself.
    """
    samples, (first, last, _) = part[0], part[1].indices(lattice.shape[0])
    total = np.zeros((*force[:, samples].shape[:2], last - first, *lattice.shape[1:]))
    lost = total if plain else np.zeros_like(total)
    for axis, vectors in enumerate(lattice.by_axis(force)):
        for slot in tangential(axis, spin_axes):
            for place, adds, pull in _pulls(vectors[slot][samples], axis, (first, last), lattice):
                old = total[slot][place]
                new = adds(old, pull, out=old if plain else None)
                if not plain:  # what the addition rounds away goes to the rest
                    added = new - old
                    lost[slot][place] += (old - (new - added)) + adds(-added, pull)
                if not plain or axis in lattice.periodic:
                    total[slot][place] = new
    return total if plain else total + lost


def _pulls(
    force: np.ndarray, axis: int, planes: tuple[int, int], lattice: Lattice
) -> Iterator[tuple[Index, np.ufunc, np.ndarray]]:
    """Yield tuples of three: an index of spheres in some planes; `np.add` for contacts above these spheres, then
    `np.subtract` for those below; and the forces (r samples, *spheres) of these contacts.

    force : (r samples, *contacts), one component of the forces of all contacts along an axis.
    axis : number of the axis.
    planes : the first of the planes, and the one after the last.
    lattice : the shape of the lattice and its periodic axes.
    """
    (first, last), count = planes, force.shape[1]
    if axis:  # contacts within the planes
        own, (low, high) = force[:, first:last], lattice.along(axis)
        yield low, np.add, own
        yield high, np.subtract, own
        return
    yield np.s_[:, : min(last, count) - first], np.add, force[:, first:last]
    begin = max(first, 1)
    if begin < last:
        yield np.s_[:, begin - first :], np.subtract, force[:, begin - 1 : last - 1]
    if first == 0 and axis in lattice.periodic:  # the last plane touches the first
        yield np.s_[:, :1], np.subtract, force[:, -1:]


def column_sums(
    force: np.ndarray, lattice: Lattice, spin_axes: tuple[int, ...], plain: bool, share: Share = map
) -> ColumnSums:
    """Return for each column of spheres along the height the torques over the radius that forces leave on the driven
    spheres at both ends, and the sum of the sizes of the torques on its free spheres.

    force : (C, R, E), forces along the spin difference of the contacts.
    lattice : the shape of the lattice and its periodic axes.
    spin_axes : the axes of the C components.
    plain : True for sums in plain doubles, False for sums with an error of about 1e-32 of the forces.
    share : a function like `map`, which may share the calls among threads.
    """
    bottom, top, left_over = np.empty((3, *force.shape[:2], *lattice.shape[:-1]))  # each (C, R, *N')

    def of_part(part: Part) -> None:
        """Write the columns in some planes to `bottom`, `top` and `left_over`.

        part : which samples and planes.
        """
        pull, place = torques_on(part, force, lattice, spin_axes, plain), (slice(None), *part)
        bottom[place], top[place] = pull[..., 0], pull[..., -1]
        np.abs(pull, out=pull)
        np.sum(pull[..., 1:-1], axis=-1, out=left_over[place])

    list(share(of_part, parts_in_cache((force.shape[1], *lattice.shape))))
    return ColumnSums(bottom, top, left_over)


def largest_torques(force: np.ndarray, lattice: Lattice, spin_axes: tuple[int, ...], share: Share = map) -> np.ndarray:
    """Return the largest torque over the radius (R,), a force, that forces leave on a free sphere.

    force : (C, R, E), forces along the spin difference of the contacts.
    lattice : the shape of the lattice and its periodic axes.
    spin_axes : the axes of the C components.
    share : a function like `map`, which may share the calls among threads.
    """
    found = np.zeros(force.shape[1])

    def of_part(part: Part) -> tuple[slice, np.ndarray]:
        """Return the samples of a part, and the largest size of a torque over the radius in each.

        part : which samples and planes.
        """
        pull = np.abs(torques_on(part, force, lattice, spin_axes, plain=True)[..., 1:-1])
        return part[0], pull.max(axis=(0, *range(2, pull.ndim)))

    for samples, most in share(of_part, parts_in_cache((force.shape[1], *lattice.shape))):
        found[samples] = np.maximum(found[samples], most)
    return found
