"""The conic programme says the same as the scene, and its multipliers are the contact forces; files of instances."""

import numpy as np
import pytest
from scipy.optimize import linprog
from taichi_bearings_studies.benchmarks.instances import SIDES, instances, made
from taichi_bearings_studies.benchmarks.peers import Peer, conic_programme

from taichi_bearings.proof.certificate import lower_bound
from tests.scenes import SIMPLE_LAWS, make_scene, minima, name_of, scene_of


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
@pytest.mark.parametrize("law", SIMPLE_LAWS)
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


def test_there_are_thirty_different_ones():
    found = instances()
    assert len(found) == 30
    assert len({scene.coefficient.tobytes() for scene in found.values()}) == 30
    assert (min(SIDES), max(SIDES)) == (6, 64)


def test_a_row_has_the_proven_optimum(needs_f64, tmp_path):
    pytest.importorskip("clarabel")
    row = made("small", make_scene((3, 4, 5)), tmp_path, peers=3)
    assert {path.name for path in tmp_path.iterdir()} == {"small.cbf", "small.hdf5"}
    assert row["lower_bound"] <= row["power"] <= row["lower_bound"] * (1 + 1e-14)
    assert row["clarabel qdldl"] == pytest.approx(row["power"], rel=1e-6)
    assert (row["unknowns"], row["contacts"]) == (2 * 3 * 4 * 3, 133 - 2 * 17)  # without those between driven spheres
