"""Points of cones, and contacts of a sample on the lattice and back."""

import numpy as np
import pytest

from taichi_bearings.conic.contact_system import free_spins, lattice_system, place_free_spins
from taichi_bearings.conic.grouped import Grouped, determinant, length, longest_step
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


@pytest.mark.parametrize("d", [1, 2])
def test_the_longest_step_ends_on_the_surface_of_the_cone(d):
    rng = np.random.default_rng(d)
    for _ in range(50):
        tail, turn, change = rng.standard_normal((d, 1)), rng.standard_normal((d, 1)), rng.standard_normal(1)
        head = length(tail) * (1 + 10 ** rng.uniform(-2, 1))
        longest = longest_step((head, tail), (change, turn))

        def depth(step, head=head, tail=tail, change=change, turn=turn):
            return (head + step * change - length(tail + step * turn))[0]

        if np.isinf(longest):
            assert depth(1e6) >= -1e-9 * abs(head + 1e6 * change)[0]
        else:
            assert min(depth(0.5 * longest), depth(0.999 * longest)) > 0 > depth(1.001 * longest)


def test_determinant_keeps_its_digits_next_to_the_surface():
    tail = np.array([[0.6], [0.8]])
    assert determinant((np.array([1 + 1e-12]), tail))[0] == pytest.approx(2e-12, rel=1e-3)
