"""What is proven of slips that spins can give to contacts, and of torques that a motion takes away."""

from fractions import Fraction

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.proof.centre import Centre, LooseFloor, newton_step
from taichi_bearings.proof.exact_motions import ExactMotions
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.proof.springs import floor_by_contact, numbered, weighed
from taichi_bearings.proof.states import _rows_of_cones


def judged(packing: tb.Packing) -> Judgement:
    """Return what the minimum of a packing proves."""
    found = tb.solve(packing).solution
    return Judgement(packing, found.spin, found.spin_rounding, found.friction)


def slips_of(packing: tb.Packing, contacts: np.ndarray) -> np.ndarray:
    """Return the matrix (3 q, 3 N) of the slips (u_i + u_j) x n of q contacts from all spins, 0 for driven spheres."""
    found = np.zeros((len(contacts), 3, packing.spheres, 3))
    for row, contact in enumerate(contacts):
        x, y, z = packing.normal[contact]
        for sphere in packing.contact[contact]:
            found[row, :, sphere] += np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])
    found[:, :, packing.driven >= 0] = 0.0
    return found.reshape(3 * len(contacts), -1)


@pytest.mark.parametrize("seed", range(3))
def test_spins_for_any_slips_and_friction_for_any_torques_are_within_the_bounds(seed):
    """A tree of contacts, with which any slips are possible."""
    packing, rng = tb.Packing.lattice("bcc", (3, 3, 3), seed=seed), np.random.default_rng(seed)
    network, chosen, label = judged(packing).network, np.zeros(packing.contacts, dtype=bool), np.arange(packing.spheres)
    label[packing.driven >= 0] = packing.spheres  # all driven spheres count as one
    for contact in rng.permutation(np.flatnonzero(network.counts)):
        first, second = label[packing.contact[contact]]
        if first != second:
            chosen[contact], label[label == first] = True, second
    tau, unit = floor_by_contact(network, numbered(network.free[:, None] & np.ones(3, dtype=bool)), chosen)
    own = np.flatnonzero(chosen)
    assert len(own) > 15
    assert tau[0] > 0
    matrix, normal = slips_of(packing, own), packing.normal[own]
    for _ in range(50):
        vectors = np.cross(rng.standard_normal(normal.shape), normal) * rng.exponential(size=(len(own), 1)) ** 3
        spins = np.linalg.lstsq(matrix, vectors.ravel(), rcond=1e-12)[0]
        np.testing.assert_allclose(matrix @ spins, vectors.ravel(), atol=1e-9 * np.abs(vectors).max())
        size = np.linalg.norm(vectors, axis=1)
        assert np.linalg.norm(spins) <= np.sqrt(((unit[own] * size) ** 2).sum() / tau[0]) * (1 + 1e-9)
        torque = np.linalg.norm(matrix.T @ vectors.ravel())
        assert (size <= unit[own] * torque / np.sqrt(tau[0]) * (1 + 1e-9)).all()


def test_what_a_motion_takes_away_is_bounded_in_fractions():
    """The matrix B, the motion z that belongs to the torques that are subtracted, and all sums of both in fractions."""
    packing = tb.Packing.lattice("bcc", (2, 2, 2), seed=3)
    bounds = judged(packing).bounds
    network, number = bounds.network, numbered(bounds.unknown)
    slides = network.counts & (network.slip.value > 1e-10 * network.largest_imposed.max())
    exact, unit = ExactMotions.none(network), np.ones(packing.contacts)
    ends = np.flatnonzero(slides), np.flatnonzero(network.counts & ~slides)
    centre = Centre(network, exact, LooseFloor(np.ones(1), unit), number, *ends, network.spin, bounds.friction)
    curvature = centre.curvature()
    factor_of, kept = curvature.floor_in_units(), []

    class Kept:
        """The factor, which keeps what it has solved."""

        failed = factor_of.factor.failed

        @staticmethod
        def solve(right):
            kept.append(factor_of.factor.solve(right))
            return kept[-1]

    floor = type(factor_of)(factor_of.tau, factor_of.unit, Kept)
    pull, taken, inexact = newton_step(curvature, floor, centre.torque_values[number >= 0])
    z = [Fraction(x) for x in (kept[0] + kept[1]).tolist()]
    rows = [[Fraction(x) for x in row] for row in curvature.rows.toarray().tolist()]
    along = [sum(b * x for b, x in zip(row, z, strict=True)) for row in rows]
    assert sum(x**2 for x in along) <= Fraction(pull[0]) ** 2
    assert float(sum(x**2 for x in along)) == pytest.approx(pull[0] ** 2, rel=1e-6)
    for k, (given, off, scale) in enumerate(zip(taken, inexact, curvature.scale, strict=True)):
        true = sum(row[k] * x for row, x in zip(rows, along, strict=True)) / Fraction(scale)
        assert abs(true - Fraction(given)) <= Fraction(off)
    assert 0 < inexact.max() < 1e-9 * np.abs(taken).max()


def test_entries_of_slips_across_friction_are_within_their_bounds_in_fractions():
    """Each is a difference of two products, which may nearly cancel. Here free spheres touch a driven one each."""
    count, rng = 400, np.random.default_rng(0)
    normal, friction = rng.standard_normal((2, count, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    place, spheres = np.tile(np.arange(count), 2), np.arange(2 * count)
    center, spin = np.stack([place, spheres, spheres], axis=1), np.zeros((2 * count, 3))
    packing = tb.Packing(
        center, spheres.reshape(2, -1).T, driven=spheres // count - 1, spin=spin, normal=normal,
        friction=np.ones(count), schematic=True,
    )  # fmt: skip
    network = Judgement(packing, spin[None], spin[None], np.zeros((1, count, 3))).network
    number = numbered(network.free[:, None] & np.ones(3, dtype=bool))
    across = np.cross(normal, friction)
    across /= np.linalg.norm(across, axis=1)[:, None]
    rows, sizes = _rows_of_cones(network, across, np.ones(count, dtype=bool), number)
    form = weighed(network, rows, np.ones(3 * count), number, sizes)
    off, beyond = form.doubt.toarray()[:count], 0
    for contact, (a, n) in enumerate(zip(across.tolist(), normal.tolist(), strict=True)):
        a, n = list(map(Fraction, a)), list(map(Fraction, n))
        for k, unknown in enumerate(number[packing.contact[contact, 0]]):
            exact = (n[k - 2] * a[k - 1] - n[k - 1] * a[k - 2]) * Fraction(form.scale[unknown])
            missed = abs(Fraction(form.rows[contact, unknown]) - exact)
            assert missed <= off[contact, unknown]
            beyond += missed > 16 * 2.0**-52 * abs(form.rows[contact, unknown])
    assert beyond > 0
