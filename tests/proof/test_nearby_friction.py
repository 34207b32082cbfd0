"""Friction that bears a load within limits is found wherever Clarabel finds some; the spheres on which it is sought."""

import numpy as np
import pytest
from scipy import sparse

from taichi_bearings.proof.nearby_friction import friction_within_limits, spheres_nearby


def largest_share(friction, limit):
    return (np.linalg.norm(friction, axis=1) / limit).max()


def least_share(rows, friction, limit, load):
    """Least t such that some friction with |G| <= t * limit bears the load, by Clarabel."""
    clarabel = pytest.importorskip("clarabel")
    count, unknowns = len(limit), 2 * len(limit) + 1
    balance = sparse.hstack([sparse.csc_array(rows.T), sparse.csc_array((rows.shape[1], 1))])
    cones, right = (
        np.zeros((3 * count, unknowns)),
        np.concatenate([rows.T @ friction.ravel() - load, np.zeros(3 * count)]),
    )
    cones[3 * np.arange(count), -1] = -limit
    for tangent in range(2):
        cones[3 * np.arange(count) + 1 + tangent, 2 * np.arange(count) + tangent] = -1
    matrix = sparse.csc_matrix(sparse.vstack([balance, sparse.csc_array(cones)]))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cost = np.append(np.zeros(unknowns - 1), 1.0)
    of = [clarabel.ZeroConeT(rows.shape[1]), *[clarabel.SecondOrderConeT(3)] * count]
    return clarabel.DefaultSolver(sparse.csc_matrix((unknowns,) * 2), cost, matrix, right, of, settings).solve().x[-1]


@pytest.mark.parametrize("seed", range(12))
def test_friction_within_limits_is_found_where_there_is_some(seed):
    rng = np.random.default_rng([7, seed])
    contacts, unknowns = int(rng.integers(6, 30)), int(rng.integers(2, 9))
    rows, limit = rng.standard_normal((2 * contacts, unknowns)), rng.uniform(0.1, 1, contacts)
    friction = rng.standard_normal((contacts, 2))
    friction *= (0.95 * limit * rng.random(contacts) / np.linalg.norm(friction, axis=1))[:, None]
    direction = rng.standard_normal(unknowns)
    for share in (0.97, 1.03):  # loads just below and just above the largest that can be borne
        low, high = 0.0, 100.0
        while high - low > 1e-4 * high:
            middle = (low + high) / 2
            inside = least_share(rows, friction, limit, middle * direction) < share
            low, high = (middle, high) if inside else (low, middle)
        found = friction_within_limits(rows, friction, limit, low * direction)
        assert (largest_share(found, limit) < 1) == (share < 1)
        if share < 1:
            left = rows.T @ (found - friction).ravel() + low * direction
            assert np.abs(left).max() < 1e-7 * max(low, 1)


def test_two_contacts_share_a_load_by_their_limits():
    rows = np.array([[1.0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1]])
    found = friction_within_limits(rows, np.zeros((2, 2)), np.array([3.0, 1.0]), np.array([-3.6, 0, 0]))
    assert found[:, 0].sum() == pytest.approx(3.6)
    assert largest_share(found, np.array([3.0, 1.0])) < 1


def test_spheres_are_added_in_rings_until_there_are_too_many():
    ends = np.array([[0, 1, 2, 3, 1], [1, 2, 3, 4, 5]])  # a row of five, and one beside the second
    inside, start = np.ones(6, dtype=bool), np.arange(6) == 1
    assert spheres_nearby(ends, inside, start, 3).tolist() == start.tolist()  # the next ring makes four
    assert spheres_nearby(ends, inside, start, 4).tolist() == [True, True, True, False, False, True]
    inside[2] = False
    assert spheres_nearby(ends, inside, start, 9).tolist() == [True, True, False, False, False, True]
