"""The instances for other solvers are thirty different ones, and each row says what its files hold."""

import pytest
from taichi_bearings_studies.benchmarks.instances import SIDES, instances, made

from tests.scenes import make_scene


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
