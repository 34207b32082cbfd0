"""Arithmetic on all groups at once, and contacts of a sample on the lattice and back."""

import numpy as np
import pytest

from taichi_bearings.conic.contact_system import free_spins, lattice_system, place_free_spins
from taichi_bearings.conic.grouped import Grouped
from tests.scenes import make_scene


@pytest.mark.parametrize("shape", [(4, 5), (3, 4, 5)], ids=str)
def test_gather_and_scatter_are_inverse(shape):
    scene = make_scene(shape, seeds=(1, 2))
    lattice, axes = scene.lattice, scene.minimum_spin_axes
    system = lattice_system(lattice, axes, np.ones(len(axes)))
    rng, acts = np.random.default_rng(5), ~lattice.between_driven
    force = rng.standard_normal((len(axes), 2, lattice.all_contacts)) * (lattice.felt(axes) & acts)[:, None]
    slip = rng.random((2, lattice.all_contacts)) * acts
    speeds, again = (np.asfortranarray(np.zeros_like(values)) for values in (slip, force))  # in any order in memory
    for replica in range(2):
        system.scatter(system.gather(slip, replica), speeds, replica)
        at = [(places.slot, replica, places.contact) for places in system.places]
        system.scatter_vectors(Grouped(force[place] for place in at), again, replica)
    assert (speeds == slip).all()
    assert (again == force).all()


def test_free_spins_go_back_to_their_places():
    scene = make_scene((3, 4, 5), seeds=(1, 2))
    staggered = np.random.default_rng(6).standard_normal((2, 2, *scene.lattice.shape))
    staggered[..., scene.lattice.is_driven] = 0.0
    again = np.zeros_like(staggered)
    for replica, spins in enumerate(free_spins(staggered)):
        place_free_spins(again, replica, spins)
    assert (again == staggered).all()
