"""A Newton step's passes over the contacts against their twin in NumPy, and what they have to do with the spins."""

import numpy as np
import pytest
from scipy import sparse

from taichi_bearings.conic.central_path import friction_stiffness
from taichi_bearings.conic.cone import inner, length, longest_step
from taichi_bearings.conic.grouped import Grouped, each
from taichi_bearings.conic.rows import ContactRows
from taichi_bearings.kernels import central_path as kernels
from tests.conic.cone_twin import Scaling, clipped_towards, jordan_product

pytestmark = pytest.mark.usefixtures("taichi_runtime")
SIZES = ((1, 37), (2, 50), (1, 16), (2, 1))  # components and contacts of the groups: kinds mixed, blocks not full


def interior(rng, d, n, spread=3):
    tail = rng.standard_normal((d, n)) * 10 ** rng.uniform(-spread / 2, spread / 2, n)
    return length(tail) * (1 + 10 ** rng.uniform(-spread, 1, n)), tail


class Contacts:
    """Random points inside their cones, a third of them smooth, with right-hand sides and steps, one of S samples."""

    def __init__(self, samples, seed):
        rng = np.random.default_rng(seed)
        operators = [sparse.random_array((d * n, 8), rng=rng, format="csr") for d, n in SIZES]
        self.rows, self.sample = ContactRows(operators, [d for d, _ in SIZES], samples), int(rng.integers(samples))
        self.spins = rng.standard_normal((8, samples))
        for sample in range(samples):
            points = [(interior(rng, d, n), interior(rng, d, n)) for d, n in SIZES]
            bound, slip = Grouped(p[0] for p, _ in points), Grouped(p[1] for p, _ in points)
            friction, dual = Grouped(q[0] for _, q in points), Grouped(q[1] for _, q in points)
            smooth = Grouped(rng.random(n) < 1 / 3 for _, n in SIZES)
            for row, values in (
                (kernels.FRICTION, friction), (kernels.BOUND, bound), (kernels.SLIP, slip), (kernels.DUAL, dual),
                (kernels.SMOOTH, smooth),
            ):  # fmt: skip
                self.rows.put(row, sample, values)
            if sample == self.sample:
                self.bound, self.slip, self.friction, self.dual, self.smooth = bound, slip, friction, dual, smooth
        self.run(kernels.prepare, (0, 0), 1e-3)
        points = self.bound, self.slip, self.friction, self.dual
        self.scaling = each(lambda b, z, m, y: Scaling.of((b, z), (m, y)), *points)

    def run(self, kernel, slots, *numbers):
        """With these numbers for the sample that is looked at, and others for the rest."""
        others = [np.full(self.rows.samples, 0.3) for _ in numbers]
        for values, number in zip(others, numbers, strict=True):
            values[self.sample] = number
        self.rows.run(kernel, slots, *others)

    def step(self, slot, row, vector=True):
        row += kernels.STATE_ROWS + slot * kernels.STEP_ROWS
        if vector:
            return self.rows.vectors(self.rows.two(row), self.sample)
        return self.rows.numbers(self.rows.values[row], self.sample)

    def expand(self, slot):
        change = self.rows.two(kernels.STATE_ROWS + slot * kernels.STEP_ROWS + kernels.CHANGE)
        change[:] = self.rows.operator @ self.spins
        self.run(kernels.expand, (slot, slot))
        rows = (kernels.CHANGE, kernels.BOUND_STEP, kernels.DUAL_STEP)
        return [self.step(slot, row, row != kernels.BOUND_STEP) for row in rows]

    def compare_right(self, slot, expected):
        """expected : function of the group's number that gives head and tail of the right-hand side."""
        head, tail, pull = (
            self.step(slot, kernels.RIGHT_HEAD, False),
            self.step(slot, kernels.RIGHT_TAIL),
            self.step(slot, kernels.PULL),
        )
        for g, (scaling, smooth) in enumerate(zip(self.scaling, self.smooth, strict=True)):
            right, cone = expected(g), ~smooth
            scale = np.abs(right[0]) + length(right[1])
            assert np.abs(head.parts[g] - right[0])[cone] == pytest.approx(0.0, abs=1e-9 * scale[cone].max())
            assert (np.abs(tail.parts[g] - right[1]) <= 1e-9 * scale)[:, cone].all()
            diagonal, off, _ = scaling.newton_blocks()
            pulled = self.dual.parts[g] + right[1] - off * (right[0] / diagonal)
            assert (np.abs(pull.parts[g] - pulled) <= 1e-9 * (scale + length(off) * np.abs(right[0]) / diagonal))[
                :, cone
            ].all()
            assert (pull.parts[g] == self.dual.parts[g])[:, smooth].all()


@pytest.fixture(params=[(1, 0), (8, 1), (2, 2)], ids=["alone", "of eight", "of two"])
def contacts(request):
    return Contacts(*request.param)


def test_stiffness_is_that_of_the_scaling_or_of_the_law(contacts):
    found = iter(
        np.split(
            contacts.rows.upper_stiffness()[:, contacts.sample],
            np.cumsum([n for d, n in SIZES for _ in range(d * (d + 1) // 2)])[:-1],
        )
    )
    for scaling, smooth, friction, slip in zip(
        contacts.scaling, contacts.smooth, contacts.friction, contacts.slip, strict=True
    ):
        expected = scaling.newton_blocks()[2]
        along = slip / length(slip)
        law = friction_stiffness(friction, slip) if len(slip) == 2 else np.zeros((1, 1, len(friction)))
        law = law - 1e-18 / length(slip) ** 2 * along[:, None] * along[None] * (len(slip) == 2)
        law = law + 1e-3 / length(slip) ** 2 * along[:, None] * along[None]  # as asked for
        for i in range(len(slip)):
            for j in range(i, len(slip)):
                right = np.where(smooth, law[i, j], expected[i, j])
                scale = np.where(smooth, np.abs(law), np.abs(expected)).max(axis=(0, 1))
                assert (np.abs(next(found) - right) <= 1e-10 * scale).all()


def test_the_predictor_aims_at_no_product(contacts):
    contacts.compare_right(0, lambda g: (-contacts.friction.parts[g], -contacts.dual.parts[g]))


def test_steps_follow_from_the_spins_and_end_on_the_cones(contacts):
    change, bound_step, dual_step = contacts.expand(0)
    reach, dual_reach = contacts.step(0, kernels.REACH, False), contacts.step(0, kernels.DUAL_REACH, False)
    stacked = np.concatenate([c.ravel() for c in change])
    start = 0
    for g, (d, n) in enumerate(SIZES):
        diagonal, off, stiffness = contacts.scaling.parts[g].newton_blocks()
        friction, bound = contacts.friction.parts[g], contacts.bound.parts[g]
        slip, dual, smooth = contacts.slip.parts[g], contacts.dual.parts[g], contacts.smooth.parts[g]
        assert (stacked[start : start + d * n] == change.parts[g].ravel()).all()
        start += d * n
        head, tail = -friction, -dual
        expected = (head - inner(off, change.parts[g])) / diagonal
        assert np.where(smooth, 0.0, expected) == pytest.approx(bound_step.parts[g], rel=1e-8, abs=1e-9)
        pull = dual + tail - off * (head / diagonal)
        moved = pull - np.einsum("ijn,jn->in", stiffness, change.parts[g]) - dual
        scale = length(pull) + np.abs(stiffness).max(axis=(0, 1)) * length(change.parts[g])
        assert (np.abs(moved - dual_step.parts[g]) <= 1e-9 * scale)[:, ~smooth].all()
        for i in np.flatnonzero(~smooth):
            one = slice(i, i + 1)
            for found, point, step in (
                (reach, (bound[one], slip[:, one]), (bound_step.parts[g][one], change.parts[g][:, one])),
                (dual_reach, (friction[one], dual[:, one]), (np.zeros(1), dual_step.parts[g][:, one])),
            ):
                assert min(found.parts[g][i], 1e20) == pytest.approx(min(longest_step(point, step), 1e20), rel=1e-6)


def test_corrector_and_recentring_are_those_of_the_cones(contacts):
    change, bound_step, dual_step = contacts.expand(0)
    contacts.run(kernels.correct, (0, 1), 0.03)
    parts = range(len(SIZES))
    steps = [(bound_step.parts[g], change.parts[g], dual_step.parts[g]) for g in parts]

    def mended(g, product):
        head, tail = contacts.scaling.parts[g].divide(product)
        return contacts.scaling.parts[g].apply_inverse((head, tail))

    def corrected(g):
        scaling, (db, dz, dy) = contacts.scaling.parts[g], steps[g]
        head, tail = jordan_product(scaling.apply((np.zeros_like(db), dy)), scaling.apply_inverse((db, dz)))
        head, tail = mended(g, (head - 0.03, tail))
        return -contacts.friction.parts[g] - head, -contacts.dual.parts[g] - tail

    contacts.compare_right(1, corrected)
    contacts.run(kernels.recentre, (0, 1), 0.4, 0.7, 0.1, 2.0)

    def recentred(g):
        scaling, (db, dz, dy) = contacts.scaling.parts[g], steps[g]
        primal = contacts.bound.parts[g] + 0.4 * db, contacts.slip.parts[g] + 0.4 * dz
        dual = contacts.friction.parts[g], contacts.dual.parts[g] + 0.7 * dy
        product = jordan_product(scaling.apply(dual), scaling.apply_inverse(primal))
        head, tail = mended(g, clipped_towards(product, 0.1, 2.0))
        return -contacts.friction.parts[g] + head, -contacts.dual.parts[g] + tail

    contacts.compare_right(1, recentred)


def test_products_are_counted_in_cones_alone(contacts):
    change, bound_step, dual_step = contacts.expand(0)
    contacts.run(kernels.multiply, (0, 0), 0.4, 0.7)
    expected = 0.0
    for g in range(len(SIZES)):
        bound = contacts.bound.parts[g] + 0.4 * bound_step.parts[g]
        slip, dual = contacts.slip.parts[g] + 0.4 * change.parts[g], contacts.dual.parts[g] + 0.7 * dual_step.parts[g]
        expected += (bound * contacts.friction.parts[g] + inner(slip, dual))[~contacts.smooth.parts[g]].sum()
    row = kernels.STATE_ROWS + kernels.PRODUCT
    assert contacts.rows.values[row, :, contacts.sample].sum() == pytest.approx(expected, rel=1e-9)


def test_torques_are_the_transpose_of_the_slips(contacts):
    rows, rng = contacts.rows, np.random.default_rng(1)
    forces = [each(lambda z: rng.standard_normal(z.shape), contacts.slip) for _ in range(rows.samples)]
    flat = rows.flattened(forces)
    work = (flat * (rows.operator @ contacts.spins)).sum(axis=0)
    assert (contacts.spins * (rows.transposed @ flat)).sum(axis=0) == pytest.approx(work, rel=1e-12)
    for sample, own in enumerate(forces):
        assert all((a == b).all() for a, b in zip(rows.vectors(flat, sample), own, strict=True))


def test_numbers_of_a_sample_do_not_depend_on_those_beside_it():
    together, alone = Contacts(8, 3), Contacts(1, 4)
    for row in (kernels.FRICTION, kernels.BOUND, kernels.SMOOTH):
        alone.rows.put(row, 0, together.rows.numbers(together.rows.values[row], together.sample))
    for row in (kernels.SLIP, kernels.DUAL):
        alone.rows.put(row, 0, together.rows.vectors(together.rows.two(row), together.sample))
    found = []
    for contacts in (alone, together):
        contacts.run(kernels.prepare, (0, 0), 1e-3)
        contacts.rows.two(kernels.STATE_ROWS + kernels.CHANGE)[:] = 0.0
        contacts.run(kernels.expand, (0, 0))
        contacts.run(kernels.correct, (0, 1), 0.1)
        contacts.run(kernels.multiply, (0, 0), 0.2, 0.3)
        found.append([contacts.step(slot, row, False) for slot in (0, 1) for row in range(kernels.STEP_ROWS)])
    for one, other in zip(*found, strict=True):
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True))
