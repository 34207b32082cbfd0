import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import tangential
from taichi_bearings.lattice.incidence import contact_differences, torques


@pytest.mark.parametrize(
    ("shape", "expected"), [((10, 10), 162), ((3, 3, 3), 30), ((10, 10, 10), 2340), ((32, 32, 32), 91264)]
)
def test_contacts_between_driven_spheres_are_not_counted(shape, expected):
    assert Lattice(shape).contacts == expected


def test_neighbours_have_opposite_parity():
    parity = Lattice((3, 4, 5)).parity
    for axis in range(3):
        assert (np.diff(parity, axis=axis) != 0).all()


def test_a_contact_slips_by_the_components_across_it():
    assert tangential(0, (0, 1, 2)) == (1, 2)
    assert tangential(0, (0, 1)) == (1,)
    assert tangential(2, (0, 1)) == (0, 1)
    assert tangential(1, (2,)) == (0,)  # the one component of a disc


@pytest.mark.parametrize("shape", [(4, 5), (3, 4, 5)])
def test_flat_contacts_are_those_of_each_axis_in_turn(shape):
    lattice = Lattice(shape)
    place = np.stack(np.unravel_index(lattice.ends, shape), axis=-1)  # lower and upper, contacts, lattice axes
    assert (place[1] - place[0] == np.eye(len(shape), dtype=int)[lattice.axis]).all()
    number = np.arange(lattice.all_contacts)
    for axis, values in enumerate(lattice.by_axis(number)):
        assert values.shape == lattice.contact_shape(axis)
        for index in np.ndindex(values.shape):
            assert (lattice.axis[values[index]], *place[0, values[index]]) == (axis, *index)
    assert (lattice.flat(lattice.by_axis(number)) == number).all()
    lattice.by_axis(number)[0][...] = -1  # views, through which flat arrays can be written
    assert (number < 0).sum() == np.prod(lattice.contact_shape(0))


def test_torques_are_the_transpose_of_differences():
    """sum f . D = - sum t . Omega, whatever the numbers: work is counted the same at contacts and at spheres."""
    lattice, axes = Lattice((3, 4, 5)), (0, 2)
    rng = np.random.default_rng(77)
    spin = rng.standard_normal((2, 1, *lattice.shape))
    differences = contact_differences(spin, lattice, axes)
    assert (differences[:, 0][~lattice.tangential_mask(axes)] == 0).all()
    force = rng.standard_normal(differences.shape)
    at_contacts = (force * differences).sum()
    assert at_contacts == pytest.approx(-(torques(force, lattice, axes) * spin).sum(), rel=1e-12)


@pytest.mark.parametrize("shape", [(1, 5), (5, 1), (5, 2), (4, 1, 4), (3, 3, 2), (3,), (3, 3, 3, 3), (0, 4)])
def test_impossible_shapes_are_refused(shape):
    with pytest.raises(InputError, match="shape is"):
        Lattice(shape)


def test_lattices_beyond_32_bit_indices_are_refused():
    with pytest.raises(InputError, match="there can be at most"):
        Lattice((1291, 1291, 1291))
