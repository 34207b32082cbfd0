"""Contacts and spins of a sample on the lattice and back."""

import numpy as np
import pytest

from taichi_bearings.conic.contact_system import free_spins, lattice_system, place_free_spins
from tests.scenes import make_scene


@pytest.mark.parametrize("shape", [(4, 5), (3, 4, 5)], ids=str)
def test_gather_and_scatter_are_inverse(shape):
    scene = make_scene(shape, seeds=(1, 2))
    lattice, axes = scene.lattice, scene.minimum_spin_axes
    system = lattice_system(lattice, axes, np.ones(len(axes)))
    rng, acts = np.random.default_rng(5), ~lattice.between_driven
    force = rng.standard_normal((len(axes), 2, lattice.all_contacts)) * (lattice.felt(axes) & acts)[:, None]
    again = np.asfortranarray(np.zeros_like(force))  # in any order in memory
    for replica in range(2):
        vectors = system.gather_vectors(force, replica)
        assert (vectors[~system.felt] == 0).all()
        system.scatter_vectors(vectors, again, replica)
    assert (again == force).all()
    assert (system.contact == np.flatnonzero(acts)).all()


def test_free_spins_go_back_to_their_places():
    scene = make_scene((3, 4, 5), seeds=(1, 2))
    staggered = np.random.default_rng(6).standard_normal((2, 2, *scene.lattice.shape))
    staggered[..., scene.lattice.is_driven] = 0.0
    again = np.zeros_like(staggered)
    for replica, spins in enumerate(free_spins(staggered)):
        place_free_spins(again, replica, spins)
    assert (again == staggered).all()
