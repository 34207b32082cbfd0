"""Minima of packings with very slow contacts, proven among the motions in which contacts roll exactly."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy import sparse

import taichi_bearings as tb
from taichi_bearings.proof import among_motions, oblique
from taichi_bearings.proof.among_motions import CentreAmongMotions, basis_for, times_exact
from taichi_bearings.proof.centre import Centre, Coordinates
from taichi_bearings.proof.enclosure import Enclosure


def test_states_are_proven_beside_a_contact_that_slips_by_a_ten_trillionth(monkeypatch):
    packing = tb.Packing.lattice("bcc", (8, 8, 8), seed=33)
    found = tb.solve(packing)
    slips = packing.slip_speeds(found.spin)[found.state == 1]
    assert slips.min() < 1e-13 * slips.max()
    assert found.states_proven
    monkeypatch.setattr(among_motions, "MOST_MOTIONS", 0)
    assert not tb.solve(packing).states_proven


@pytest.fixture(params=[("bcc", 1), ("bcc", 2), ("diamond", 4)], ids=str)
def centre(request, monkeypatch):
    """Spins near which a minimum was proven among motions, from a sample without slow contacts."""
    kept = list[Centre]()
    monkeypatch.setattr(oblique, "SLOW_SLIP", np.inf)
    proven = oblique._proven_near
    monkeypatch.setattr(oblique, "_proven_near", lambda found: kept.append(found) or proven(found))
    kind, seed = request.param
    assert tb.solve(tb.Packing.lattice(kind, (4, 4, 4), seed=seed)).states_proven
    found = CentreAmongMotions.of(kept[-1])
    assert found is not None
    return found.improved()


@pytest.mark.parametrize("size", [1e-13, 1e-11, 1e-9])
def test_the_minimum_is_as_near_as_is_proven(centre, size):
    """From spins that are off by `size`, at which resting contacts rest and all forces are those of these spins."""
    rng, there = np.random.default_rng(7), centre.number >= 0
    step = np.zeros(centre.number.shape)
    step[there] = size * centre.motions @ rng.standard_normal(centre.motions.shape[1])
    off = replace(centre, spin=[part + Enclosure.exact(by) for part, by in zip(centre.spin, step.T, strict=True)])
    distance, turned, proven = off._distance_of_minimum()
    slips, minimum = (np.stack([part.value[of.slipping] for part in of.slips], axis=1) for of in (off, centre))
    changes = np.linalg.norm(
        np.stack([(a - b).value[off.slipping] for a, b in zip(off.slips, centre.slips, strict=True)]), axis=0
    )
    directions = [of / np.linalg.norm(of, axis=1)[:, None] for of in (slips, minimum)]
    turns = np.linalg.norm(directions[0] - directions[1], axis=1)
    assert proven.all() or size > 1e-13
    assert changes.max() > size / 10
    assert (changes <= distance * (1 + 1e-9)).all()
    assert (turns <= turned + 1e-15).all()


@np.errstate(all="ignore")
def test_nothing_is_known_of_the_direction_of_a_slip_whose_friction_limit_may_be_0(centre):
    limit, at = centre.network.friction_limit, centre.with_friction[0]
    error = limit.error.copy()
    error[centre.slipping[at]] = 2 * limit.high[centre.slipping[at]]
    network = replace(centre.network, friction_limit=Enclosure(limit.high, limit.low, error))
    _, turned, proven = replace(centre, network=network)._distance_of_minimum()
    assert not turned[at] < np.inf
    assert not proven.any()


def test_torques_along_motions_do_not_depend_on_friction_of_rolling_contacts(centre):
    rows = centre.rows[centre.rows_of(np.flatnonzero(centre.exact.contacts))]
    slips = rows @ centre.motions
    assert np.abs(slips).max() <= 1e-14 * np.abs(centre.motions).max()
    assert (centre.motions.data == np.round(centre.motions.data)).all()


@pytest.mark.parametrize("seed", range(6))
def test_rows_become_unknowns_of_their_own(seed):
    rng = np.random.default_rng([3, seed])
    rows = sparse.random_array((12, 30), density=0.15, rng=rng, data_sampler=rng.standard_normal).toarray()
    rows[np.abs(rows).sum(axis=1) == 0, 3] = 1.0
    rows[7], rows[9] = rows[1] - 2 * rows[2], 3 * rows[4]  # two that depend on others
    basis = basis_for(sparse.csr_array(rows)).toarray()
    assert np.linalg.cond(basis) < 1e6
    after = rows / np.linalg.norm(rows, axis=1)[:, None] @ basis
    single = np.abs(np.abs(after).max(axis=1) - 1) + np.sort(np.abs(after), axis=1)[:, -2] < 1e-9
    assert single.sum() >= np.linalg.matrix_rank(rows)
    assert np.linalg.matrix_rank(after[single]) == np.linalg.matrix_rank(rows)


@pytest.mark.parametrize("of_motions", [True, False])
def test_slips_change_by_no_more_than_is_bounded(centre, of_motions):
    """By entries and by lengths; expected are changes by drawn coordinates, and by single ones."""
    coordinates = centre.coordinates() if of_motions else Coordinates(centre.curvature())
    rows, count = sparse.csr_array(centre.rows[centre.rows_of(centre.slipping)]), coordinates.form.rows.shape[1]
    rng = np.random.default_rng(5)
    scale = np.exp2(rng.integers(-6, 7, count))
    sizes, lengths = coordinates.changes_of_slips(rows, scale)
    drawn = np.column_stack([rng.standard_normal((count, 50)), np.eye(count)[:, :: max(count // 50, 1)]])
    moved = scale[:, None] * drawn
    changes = rows @ (coordinates.motions @ (coordinates.basis @ moved) if of_motions else moved)
    assert (np.abs(changes) <= sizes @ np.abs(drawn) + 1e-14 * np.abs(changes).max()).all()
    longest = np.linalg.norm(changes.reshape(3, -1, drawn.shape[1]), axis=0)
    assert (longest <= lengths[:, None] * np.linalg.norm(drawn, axis=0) * (1 + 1e-12)).all()
    assert (longest.max(axis=1) >= lengths / 10 - 1e-12).all()  # some are 0 but for rounding
    assert lengths.max() > 1


def test_nothing_slips_or_moves_without_a_contact_or_an_unknown():
    coordinates = Coordinates(None)
    for shape in ((0, 4), (6, 0), (0, 0)):
        sizes, lengths = coordinates.changes_of_slips(sparse.csr_array(shape), np.ones(shape[1]))
        assert sizes.shape == shape
        assert lengths.tolist() == [0.0] * (shape[0] // 3)


def test_errors_of_products_are_within_their_bounds_in_fractions():
    rng = np.random.default_rng(2)
    rows, by = (
        sparse.csr_array(sparse.random_array(shape, density=0.5, rng=rng, data_sampler=rng.standard_normal))
        for shape in ((9, 12), (12, 7))
    )
    off = sparse.csr_array(1e-13 * abs(rows))
    found, doubt = (of.toarray() for of in times_exact(rows, off, by))
    true = [[Fraction(x) for x in row] for row in (rows.toarray() + off.toarray()).tolist()]
    columns = [[Fraction(x) for x in column] for column in by.toarray().T.tolist()]
    for i, row in enumerate(true):
        for j, column in enumerate(columns):
            exact = sum(a * b for a, b in zip(row, column, strict=True))
            assert abs(exact - Fraction(found[i, j])) <= Fraction(doubt[i, j])
    assert 0 < doubt.max() < 1e-11
