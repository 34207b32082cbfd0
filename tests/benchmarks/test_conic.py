"""The conic programme says the same as the scene, and its multipliers are the contact forces."""

import numpy as np
import pytest
from scipy.optimize import linprog
from taichi_bearings_studies.benchmarks.peers import Peer, conic_programme

from taichi_bearings.proof.certificate import lower_bound
from tests.scenes import make_scene, minima, name_of, scene_of


def test_spins_that_are_not_finite_or_outside_become_allowed_ones():
    scene = make_scene((3, 4, 5), spin_bottom=-0.4)
    programme = conic_programme(scene)
    spins = programme.spins(np.resize([np.nan, 1e9, -1e9], programme.linear.shape))
    for values, top in zip(spins, scene.top_spin(scene.minimum_spin_axes), strict=True):
        assert (values >= 0).all()
        assert (values <= top.max()).all()
        assert (values[..., -1] == top).all()


@pytest.mark.parametrize("entry", minima((10, 10)), ids=name_of)
def test_discs_are_a_linear_programme(entry):
    """HiGHS reads the same matrices: its multipliers prove its power, and that is the exact minimum."""
    scene = scene_of(entry)
    programme = conic_programme(scene)
    answer = linprog(programme.linear, programme.matrix, programme.offset, bounds=(None, None), method="highs")
    power = scene.power(programme.spins(answer.x), (2,))[0]
    bound = lower_bound(scene, programme.forces(-answer.ineqlin.marginals), (2,))[0]
    assert power == pytest.approx(entry["power_minimum"], rel=1e-10)
    assert bound == pytest.approx(entry["power_minimum"], rel=1e-10)


@pytest.mark.parametrize("name", ["clarabel", "scs"])
@pytest.mark.parametrize("law", ["coulomb", "viscous"])
@pytest.mark.parametrize(
    ("shape", "driving"),
    [
        ((9, 7), {"spin_bottom": 0.7}), ((5, 5, 5), {}), ((3, 4, 5), {"direction": (1, 0, 0)}),
        ((4, 5, 6), {"direction": (1, -2, 3), "spin_bottom": -0.4}),
    ],
)  # fmt: skip
def test_spins_and_forces_of_a_peer_are_certified(name, law, shape, driving):
    pytest.importorskip(name)
    scene = make_scene(shape, law, **driving)
    answer = Peer(name, "qdldl").solve(conic_programme(scene), 1e-9, 20.0, threads=1)
    assert answer.done
    assert 0 <= answer.power - answer.lower_bound <= 1e-7 * answer.power


@pytest.mark.parametrize("name", ["clarabel", "scs"])
@pytest.mark.parametrize("entry", minima((3, 3, 3), (5, 5, 5)), ids=name_of)
def test_a_peer_finds_the_exact_minimum(name, entry):
    pytest.importorskip(name)
    answer = Peer(name, "qdldl").solve(conic_programme(scene_of(entry)), 1e-9, 20.0, threads=1)
    assert answer.lower_bound <= entry["power_minimum"] * (1 + 1e-12)
    assert entry["power_minimum"] * (1 - 1e-12) <= answer.power <= entry["power_minimum"] * (1 + 1e-7)
