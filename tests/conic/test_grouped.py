"""Arithmetic on all groups at once, and contacts of a sample on the lattice and back."""

import numpy as np
import pytest

from taichi_bearings.conic.contact_system import free_spins, lattice_system, place_free_spins
from taichi_bearings.conic.grouped import Grouped, each, isotropic, where
from tests.scenes import make_scene


@pytest.fixture
def vectors():
    rng = np.random.default_rng(4)
    return Grouped([rng.standard_normal((1, 5)), rng.standard_normal((2, 3))])


def test_arithmetic_is_that_of_the_groups(vectors):
    scalars = vectors.length()
    found = 2 * vectors - scalars * vectors / 3
    for part, v in zip(found, vectors, strict=True):
        assert (part == 2 * v - np.linalg.norm(v, axis=0) * v / 3).all()
    assert (np.float64(2) * vectors).sum() == pytest.approx(2 * sum(v.sum() for v in vectors))
    assert scalars.max() == max(np.linalg.norm(v, axis=0).max() for v in vectors)


def test_chosen_contacts_go_back_to_their_places(vectors):
    chosen = vectors.length() > 1.0
    assert (vectors.placed(chosen, vectors[chosen]) == vectors).all()
    assert (where(chosen, vectors, 0.0) == each(np.zeros_like, vectors).placed(chosen, vectors[chosen])).all()
    assert not (vectors[chosen].length() <= 1.0).any()


def test_isotropic_stiffness_resists_in_every_direction(vectors):
    stiffness = isotropic(vectors, vectors.length())
    for k, v in zip(stiffness, vectors, strict=True):
        assert np.einsum("ijn,jn->in", k, v) == pytest.approx(np.linalg.norm(v, axis=0) * v)


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
