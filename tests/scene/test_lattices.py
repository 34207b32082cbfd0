"""Every kind of lattice: contacts of a sphere, distances, normals; and a basis in which spheres overlap is refused."""

import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.scene.generators import lattices

CONTACTS = {"square": 4, "triangular": 6, "honeycomb": 3, "cubic": 6, "bcc": 8, "fcc": 12, "diamond": 4, "hcp": 12}
"""Contacts of a sphere."""


@pytest.mark.parametrize("kind", lattices.KINDS)
def test_each_sphere_touches_as_many_as_in_the_table(kind):
    """In a block of three cells along each axis, all of which are periodic. Distances are sought among all pairs."""
    size = 3 * np.array(lattices.KINDS[kind].size)
    place, contact, normal, _, _ = lattices.built(kind, (3,) * len(size), tuple("xyz")[: len(size)])
    assert (np.bincount(contact.ravel(), minlength=len(place)) == CONTACTS[kind]).all()
    between = place[contact[:, 1]] - place[contact[:, 0]]
    between -= size * np.round(between / size)
    distance = np.linalg.norm(between, axis=1)[:, None]
    assert np.abs(between / distance - normal).max() < 1e-12
    apart = place[:, None] - place
    apart = np.linalg.norm(apart - size * np.round(apart / size), axis=-1)
    assert (apart + np.eye(len(place))).min() == pytest.approx(1, abs=1e-12)
    assert (np.abs(apart - 1) < 1e-9).sum() == 2 * len(contact)


@pytest.mark.parametrize("basis", [((0, 0), (0.5, 1 / 6)), ((0.1, 0), (0.9, 0))], ids=["inside", "next cell"])
def test_a_basis_in_which_spheres_overlap_is_refused(basis, monkeypatch):
    monkeypatch.setitem(lattices.KINDS, "own", lattices.Cell((1.0, 3**0.5), basis, None))
    with pytest.raises(InputError, match="basis is wrong: its spheres 0 and 1 overlap, as their centres are only 0"):
        lattices.built("own", (2, 2), ())
