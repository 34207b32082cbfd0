"""Driven spheres whose radius times spin differs by rounding alone have one surface speed."""

from fractions import Fraction

import h5py
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.runs.verify import verify
from tests.scenes import FRICTION_LAWS


def pair(spin, radius):
    """Two driven discs that touch one free disc between them, and a third body that makes it slip."""
    center = [[0, 0], [radius[0] + 1, 0], [radius[0] + 2 + radius[1], 0], [radius[0] + 1, 1 + radius[2]]]
    pairs, bodies, spins = [[0, 1], [1, 2], [1, 3]], [0, -1, 0, 1], [spin[0], 0, spin[1], 5.0]
    sizes, friction = [radius[0], 1, *radius[1:]], [2.0, 1.5, 1.0]
    return tb.Packing(center, pairs, bodies, spins, radius=sizes, friction=friction, normal_force=1.0)


@pytest.mark.parametrize("units", range(-6, 7))
def test_speeds_that_differ_by_four_units_in_the_last_place_are_one(units):
    least = 1.5
    speed = least + units * np.spacing(least)
    found = tb.solve(pair([least, speed], [1.0, 1.0, 2.0]))
    imposed = found.packing.driven_speed[[0, 2], 0]
    assert (imposed[0] == imposed[1]) == (abs(units) <= 4)
    assert (found.state[:2] == 0).all() == (abs(units) <= 4)
    assert found.state[2] == 1
    assert found.proven.all()


@pytest.mark.parametrize("law", FRICTION_LAWS)
@pytest.mark.parametrize("least", [0.02, 0.01])
def test_space_filling_discs_are_proven_and_their_files_say_the_same(law, least, tmp_path):
    packing = tb.Packing.space_filling(law=law, seed=2, spin_bottom=0.3, least_radius=least)
    held = packing.driven >= 0
    exact = {
        abs(Fraction(float(r)) * Fraction(float(s)))
        for r, s in zip(packing.radius[held], packing.spin[held], strict=True)
    }
    assert len(exact) > 2  # of two lines
    assert len(np.unique(np.abs(packing.driven_speed[held]))) == 2
    found = tb.solve(packing)
    assert found.proven.all()
    path = found.save(tmp_path / "run") / "run.h5"
    report = verify(path)
    assert report["verified"]
    assert report["states_proven"]["unproven"] == 0
    with h5py.File(path) as file:
        again = tb.Packing(**{name: values[()] for name, values in file["packing"].items()} | {"law": law})
    assert (again.driven_speed == packing.driven_speed).all()
