"""Forces of resting contacts that close loops are moved below their limits, with the same torques."""

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.conic.friction_inside import moved_inside
from taichi_bearings.conic.shared import surroundings_of, system_of


@pytest.fixture(scope="module")
def bcc():
    """A lattice in which contacts close many loops: its contacts and their Newton matrix."""
    system = system_of(tb.Packing.lattice("bcc", (4, 4, 4), seed=3))
    return system, surroundings_of(system).matrix


def forces(count, limit, seed):
    draw = np.random.default_rng(seed)
    found = draw.standard_normal((2, count))
    return found * limit * draw.uniform(0.2, 0.8, count) / np.linalg.norm(found, axis=0)


@pytest.mark.parametrize("seed", range(4))
def test_torques_stay_and_forces_at_the_limit_move_below_it(bcc, seed):
    system, matrix = bcc
    count = len(system.numbers)
    draw = np.random.default_rng([5, seed])
    limit, rests = draw.uniform(0.1, 1, count), draw.random(count) < 0.97
    force = forces(count, limit, seed)
    at_limit = draw.choice(np.flatnonzero(rests), 3, replace=False)
    force[:, at_limit] *= limit[at_limit] / np.linalg.norm(force[:, at_limit], axis=0)
    found = moved_inside(system, matrix, limit, force, rests)
    assert (found[:, ~rests] == force[:, ~rests]).all()
    assert (np.linalg.norm(found, axis=0) / limit)[rests].max() < 1 - 1e-7
    np.testing.assert_allclose(system.torques(found), system.torques(force), atol=1e-12)


def test_forces_below_their_limits_stay(bcc):
    system, matrix = bcc
    limit = np.ones(len(system.numbers))
    force = forces(len(limit), limit, 1)
    assert moved_inside(system, matrix, limit, force, np.ones(len(limit), dtype=bool)) is force


def test_forces_that_nothing_else_can_take_over_stay_at_the_limit(bcc):
    system, matrix = bcc
    limit = np.ones(len(system.numbers))
    force, rests = forces(len(limit), limit, 2), np.zeros(len(limit), dtype=bool)
    rests[7] = True  # alone: its force follows from its torque
    force[:, 7] /= np.linalg.norm(force[:, 7])
    assert moved_inside(system, matrix, limit, force, rests) is force
