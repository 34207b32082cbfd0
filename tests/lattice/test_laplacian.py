"""The Laplacian's eigenvalues and the numbers of spheres, against a loop over the contacts."""

import numpy as np
import pytest

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.incidence import number_free
from taichi_bearings.lattice.laplacian import chain_eigenvalues, chain_modes, eigenvalues
from taichi_bearings.numerics.minimum_cut import number_bodies

CASES = [
    *(((5, 6), (), 2), ((3, 4, 5), (), 0), ((3, 4, 5), (), 1), ((3, 4, 5), (), 2), ((2, 2, 3), (), 1)),
    *(((6, 5), (0,), 2), ((4, 3, 5), (0,), 1), ((2, 4, 5), (0, 1), 2), ((2, 4, 3), (0, 1), 0)),
]


def dense_laplacian(lattice, component):
    """Over the free spheres in C order, one contact at a time."""
    number = {site: n for n, site in enumerate(s for s in np.ndindex(lattice.shape) if not lattice.is_driven[s])}
    matrix = np.zeros((len(number),) * 2)
    for axis in set(range(lattice.dimension)) - {component}:
        for site in np.ndindex(lattice.contact_shape(axis)):
            other = tuple((n + (a == axis)) % side for a, (n, side) in enumerate(zip(site, lattice.shape, strict=True)))
            here = [number[end] for end in (site, other) if end in number]
            matrix[here, here] += 1
            if len(here) == 2:
                matrix[here, here[::-1]] -= 1
    return matrix


@pytest.mark.parametrize(("shape", "periodic", "component"), CASES, ids=str)
def test_eigenvalues_are_those_of_the_matrix(shape, periodic, component):
    lattice = Lattice(shape, periodic=periodic)
    found = eigenvalues(lattice, component)
    every = np.broadcast_to(found, lattice.free_shape).ravel()  # the same in each plane across the component
    exact = np.linalg.eigvalsh(dense_laplacian(lattice, component))
    assert np.sort(every) == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize("is_held", [False, True])
def test_modes_belong_to_their_eigenvalues(is_held):
    side = 6
    matrix = 2 * np.eye(side) - np.eye(side, k=1) - np.eye(side, k=-1)
    if not is_held:
        matrix[0, 0] = matrix[-1, -1] = 1
    modes = chain_modes(side, is_held)
    assert modes.T @ modes == pytest.approx(np.eye(side), abs=1e-14)
    assert matrix @ modes == pytest.approx(modes * chain_eigenvalues(side, is_held), abs=1e-13)


def test_numbers_of_spheres():
    assert number_free((2, 4)).tolist() == [[-1, 0, 1, -1], [-1, 2, 3, -1]]
    assert number_bodies(Lattice((2, 4)).driven).tolist() == [[0, 1, 2, 5], [0, 3, 4, 5]]
