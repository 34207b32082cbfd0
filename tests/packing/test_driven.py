"""Lattices whose driven bodies are others than planes."""

import numpy as np
import pytest

import taichi_bearings as tb
from tests.packing.twins import clarabel_least

TOP, BOTTOM = (1.0, 0.4, -0.3, 0.2), (0.1, 0.0, 0.3, -0.1)


@pytest.mark.parametrize("shape", [(5, 4), (4, 3, 5)])
def test_walls_are_planes_of_the_lattice_laid_down(shape):
    """The axes are named anew, the last one first; spins, too."""
    dimension = len(shape)
    turn = (dimension - 1, *range(dimension - 1))  # axis of the standing lattice that each axis of the lying one is
    lying = tb.Packing.lattice(
        "square" if dimension == 2 else "cubic", shape, seed=7, driven="walls", spin_bottom=-0.3, direction=(0, 1, 2)
    )
    standing_shape = tuple(np.array(shape)[list(np.argsort(turn))])
    number = np.arange(np.prod(shape)).reshape(shape).transpose(np.argsort(turn))  # lying sphere at a standing place
    standing = tb.Packing.lattice(
        "square" if dimension == 2 else "cubic", standing_shape, spin_bottom=-0.3, direction=(1, 2, 0)
    )
    place = np.argsort(number.ravel())  # standing sphere of each lying one
    pairs = {tuple(sorted(place[list(pair)])): mu for pair, mu in zip(lying.contact, lying.friction, strict=True)}
    friction = [pairs[tuple(sorted(pair))] for pair in standing.contact.tolist()]
    standing = tb.Packing(
        standing.center, standing.contact, standing.driven, standing.spin, standing.radius, friction=friction
    )
    assert tb.solve(lying).power == pytest.approx(tb.solve(standing).power, rel=1e-11)


@pytest.mark.parametrize(
    ("kind", "cells", "driven"),
    [
        ("cubic", (5, 5, 3), "shaft:1"), ("cubic", (6, 5, 3), "shaft:1.2"), ("square", (6, 6), "shaft:1"),
        ("bcc", (3, 3, 2), "walls"), ("triangular", (6, 4), "shaft:1"), ("cubic", (4, 4, 4), "walls"),
    ],
)  # fmt: skip
def test_minima_are_those_of_another_solver_in_the_laboratory(kind, cells, driven):
    states = {"top": TOP, "bottom": BOTTOM} if len(cells) == 3 else {"top": (1.0,), "bottom": (-0.4,)}
    packing = tb.Packing.lattice(kind, cells, seed=1, driven=driven, **states)
    assert set(np.unique(packing.driven)) == {-1, 0, 1}
    found = tb.solve(packing)
    assert found.power == pytest.approx(clarabel_least(packing)[0], rel=1e-8)
    assert found.lower_bound <= clarabel_least(packing)[0] * (1 + 1e-9)


@pytest.mark.parametrize("rate", [1e-12, 1e-6, 1.0, 1e6, 1e12])
@pytest.mark.parametrize("cells", [(4, 5), (4, 3, 4)])
def test_walls_that_meet_planes_in_states_of_any_size(cells, rate):
    """Four bodies, each in a state of its own: C, and A that cancels it at the second sphere along x; in 3D periodic
    along y. Contacts between bodies count apart, and by hand."""
    flat = len(cells) == 2
    built = tb.Packing.lattice("square" if flat else "cubic", cells, periodic=() if flat else "y", seed=2)
    arrays, place = built.arrays() | {"driven": built.driven.copy()}, np.rint(built.center).astype(int)
    for body, axis, side in ((2, 0, 0), (3, 0, cells[0] - 1), (0, -1, 0), (1, -1, cells[-1] - 1)):
        arrays["driven"][place[:, axis] == side] = body
    sign = 1.0 - 2 * (place.sum(axis=1) % 2)
    rates = np.array([0.0, rate, -rate, 1.0, 0.0])[arrays["driven"]]
    turns = np.array([[0, 0, 0], [-rate, 1, 0], [rate, 0, 1], [-1, 0.5, 0], [0, 0, 0]])[arrays["driven"]]
    spin = turns[:, :1].ravel() + 0.7 * rates if flat else turns + rates[:, None] * place
    arrays["spin"] = sign * spin if flat else sign[:, None] * spin
    packing = tb.Packing(**arrays)
    found, unit = tb.solve(packing), max(1.0, rate)  # the minimum is linear in all states together
    power = unit * clarabel_least(tb.Packing(**arrays | {"spin": arrays["spin"] / unit}))[0]
    assert found.status == "certified"
    assert found.power == pytest.approx(power, rel=1e-8)
    assert found.lower_bound <= power * (1 + 1e-9)
    (first, second), u = packing.contact.T, packing.driven_speed
    slip = np.cross(u[first] + u[second], packing.normal) if not flat else u[first] + u[second]
    between = (packing.driven[packing.contact] >= 0).all(axis=1)
    lost = (packing.material[0][0] * np.linalg.norm(slip, axis=1))[between].sum()
    assert found.driven_power == pytest.approx(lost, rel=1e-12)
    assert lost > 0


def test_a_shaft_is_round_and_its_walls_are_square():
    packing = tb.Packing.lattice("cubic", (7, 7, 2), driven="shaft:2", radius=1.5)
    far = np.linalg.norm(packing.center[:, :2] / 3 - 3, axis=1)
    assert np.array_equal(packing.driven == 1, far <= 2)
    edge = np.isin(packing.center[:, :2] / 3, (0, 6)).any(axis=1)
    assert np.array_equal(packing.driven == 0, edge)


@pytest.mark.parametrize(
    "driven", ["wall", "shaft", "shaft:", "shaft:-1", "shaft:nan", "shaft:3", "shaft:0.1", 3, "planes:1"]
)
def test_what_is_no_driven_body_is_refused(driven):
    with pytest.raises(tb.InputError, match="driven is"):
        tb.Packing.lattice("cubic", (6, 6, 3), driven=driven)
