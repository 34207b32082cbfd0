"""Contacts and spins of a sample on the lattice and back."""

from fractions import Fraction

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.conic.contact_system import free_spins, lattice_system, place_free_spins, stacked
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.shared import system_of
from tests.scenes import make_scene


@pytest.mark.parametrize("shape", [(4, 5), (3, 4, 5)], ids=str)
def test_gather_and_scatter_are_inverse(shape):
    scene = make_scene(shape, seeds=(1, 2))
    lattice, axes = scene.lattice, scene.minimum_spin_axes
    system = lattice_system(lattice, axes, np.ones(len(axes)))
    rng, acts = np.random.default_rng(5), ~lattice.between_driven
    force = rng.standard_normal((len(axes), 2, lattice.all_contacts)) * (lattice.tangential_mask(axes) & acts)[:, None]
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


@pytest.mark.parametrize("tied", [False, True], ids=["whole", "with tied contacts"])
@pytest.mark.parametrize("shape", [(4, 5), (3, 4, 5), (2, 3, 4)], ids=str)
def test_the_terms_of_the_laplacian_are_what_springs_at_the_contacts_resist(shape, tied):
    scene, rng = make_scene(shape, seeds=(1,)), np.random.default_rng(7)
    lattice, axes = scene.lattice, scene.minimum_spin_axes
    system = lattice_system(lattice, axes, np.ones(len(axes)))
    if tied:
        some = rng.random(system.offset.shape[1]) < 0.3
        system = Contraction(system, np.arange(system.unknowns), some).system
    d, count = system.offset.shape
    springs = rng.standard_normal((d, d, count))
    springs = springs + springs.transpose(1, 0, 2)
    whole = np.zeros((system.unknowns,) * 2)
    for contact in range(count):
        rise = np.zeros((d, system.unknowns))
        for slip in range(d):
            for unknown, sign in zip(system.ends[:, slip, contact], (-1, 1), strict=True):
                if unknown >= 0:
                    rise[slip, unknown] += sign
        whole += rise.T @ springs[:, :, contact] @ rise
    first, second, source, factor = system.terms()
    found = np.zeros_like(whole)
    np.add.at(found, (first, second), factor * stacked(springs)[source])
    np.add.at(found, (second, first), np.where(first == second, 0.0, factor * stacked(springs)[source]))
    np.testing.assert_allclose(found, whole, atol=1e-12)


@pytest.mark.parametrize("kind", ["bcc", "triangular"])
def test_slips_far_below_the_rounding_of_spins_have_all_their_digits(kind):
    """Spins of neighbours cancel up to 1e-20, along the normal of the contact as well; expected are fractions."""
    packing = tb.Packing.lattice(kind, (3,) * (3 if kind == "bcc" else 2), seed=1)
    system = system_of(packing)
    draw, number = np.random.default_rng(3), system.moved
    for contact, (first, second) in enumerate(packing.contact[system.numbers]):
        if not ((number[[first, second]] >= 0).all() and draw.random() < 0.3):
            continue
        normal = packing.normal[system.numbers[contact]]
        high, low = np.zeros((2, system.unknowns))
        own = draw.standard_normal(number.shape[1])
        high[number[first]], high[number[second]] = own, (normal if kind == "bcc" else 0.0) - own
        low[number[first]] = 1e-20 * draw.standard_normal(number.shape[1])
        total = [
            sum(Fraction(of[k]) for part in (high, low) for of in (part[number[first]], part[number[second]]))
            for k in range(number.shape[1])
        ]
        n = [Fraction(of) for of in normal]
        cross = [total[a] * n[b] - total[b] * n[a] for a, b in ((1, 2), (2, 0), (0, 1))] if kind == "bcc" else total
        expected = float(sum(of * of for of in cross)) ** 0.5
        found = np.linalg.norm(system.to_all_digits((high, low))[:, contact])
        assert found == pytest.approx(expected, rel=1e-12)
        assert 0 < expected < 1e-15
