"""A Newton step's passes over the contacts against their twin in NumPy, and what they have to do with the spins."""

import numpy as np
import pytest
from scipy import sparse

from taichi_bearings.conic.central_path import friction_stiffness
from taichi_bearings.conic.grouped import Grouped, each, inner, length, longest_step
from taichi_bearings.conic.rows import ContactRows
from taichi_bearings.kernels import central_path as kernels
from taichi_bearings.memory import aligned_zeros
from tests.conic.cone_twin import Scaling, clipped_towards, jordan_product

pytestmark = pytest.mark.usefixtures("taichi_runtime")
SIZES = ((1, 37), (2, 50), (1, 16), (2, 1))  # components and contacts of the groups: kinds mixed, blocks not full
UPPER = [n for d, n in SIZES for _ in range(d * (d + 1) // 2)]  # numbers of upper triangles
SPINS = 8


def interior(rng, d, n, spread=3):
    tail = rng.standard_normal((d, n)) * 10 ** rng.uniform(-spread / 2, spread / 2, n)
    return length(tail) * (1 + 10 ** rng.uniform(-spread, 1, n)), tail


def _differences(rng, rows):
    """Rows with one to three entries 1 or -1."""
    counts = rng.integers(1, 4, rows)
    columns = np.concatenate([rng.choice(SPINS, count, replace=False) for count in counts])
    signs = rng.choice([-1.0, 1.0], len(columns))
    return sparse.csr_matrix((signs, (np.repeat(np.arange(rows), counts), columns)), (rows, SPINS))


class Contacts:
    """Random points inside their cones, a third of them smooth, with right-hand sides and steps, one of S samples."""

    def __init__(self, samples, seed):
        rng = np.random.default_rng(seed)
        self.operators = [_differences(rng, d * n) for d, n in SIZES]
        self.place = rng.permutation(SPINS)
        spins = aligned_zeros(SPINS * samples, 8).reshape(SPINS, samples)
        stacked = sparse.identity(sum(UPPER), format="csr")  # each stiffness an entry of its own
        self.rows = ContactRows(self.operators, [d for d, _ in SIZES], spins, self.place, stacked)
        self.sample, self.spins = int(rng.integers(samples)), rng.standard_normal((SPINS, samples))
        for sample in range(samples):
            points = [(interior(rng, d, n), interior(rng, d, n)) for d, n in SIZES]
            bound, slip = Grouped(p[0] for p, _ in points), Grouped(p[1] for p, _ in points)
            friction, dual = Grouped(q[0] for _, q in points), Grouped(q[1] for _, q in points)
            smooth = Grouped(rng.random(n) < 1 / 3 for _, n in SIZES)
            for row, values in (
                (kernels.FRICTION_ROW, friction), (kernels.BOUND, bound), (kernels.SLIP, slip), (kernels.DUAL, dual),
                (kernels.SMOOTH, smooth),
            ):  # fmt: skip
                self.rows.put(row, sample, values)
            if sample == self.sample:
                self.bound, self.slip, self.friction, self.dual, self.smooth = bound, slip, friction, dual, smooth
        self.run(kernels.prepare, (0, 0), 1e-3)
        points = self.bound, self.slip, self.friction, self.dual
        self.scaling = each(lambda b, z, m, y: Scaling.of((b, z), (m, y)), *points)

    def run(self, kernel, slots, *numbers):
        """With these numbers for the sample that is looked at, and others for the rest; what is found for it."""
        others = [np.full(self.rows.samples, 0.3) for _ in numbers]
        for values, number in zip(others, numbers, strict=True):
            values[self.sample] = number
        return self.rows.run(kernel, slots, *others)[:, self.sample]

    def step(self, slot, row, vector=True):
        row += kernels.STATE_ROWS + slot * kernels.STEP_ROWS
        return (self.rows.vectors if vector else self.rows.numbers)(row, self.sample)

    def expand(self, slot):
        """The step that belongs to the spins: changes of slip, bound and dual, and what is found over all contacts."""
        self.rows.spins[self.place] = self.spins
        self.rows.change(kernels.STATE_ROWS + slot * kernels.STEP_ROWS + kernels.CHANGE)
        found = self.run(kernels.expand, (slot, slot))
        rows = (kernels.CHANGE, kernels.BOUND_STEP, kernels.DUAL_STEP)
        return [self.step(slot, row, row != kernels.BOUND_STEP) for row in rows], found

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
            assert np.abs(head.parts[g] - right[0])[cone] == pytest.approx(0.0, abs=1e-9 * scale[cone].max(initial=0.0))
            assert (np.abs(tail.parts[g] - right[1]) <= 1e-9 * scale)[:, cone].all()
            diagonal, off, _ = scaling.newton_blocks()
            pulled = self.dual.parts[g] + right[1] - off * (right[0] / diagonal)
            assert (np.abs(pull.parts[g] - pulled) <= 1e-9 * (scale + length(off) * np.abs(right[0]) / diagonal))[
                :, cone
            ].all()
            assert (pull.parts[g] == self.dual.parts[g])[:, smooth].all()


@pytest.fixture(params=[(1, 0), (8, 1)], ids=["alone", "of eight"])
def contacts(request):
    return Contacts(*request.param)


def test_stiffness_is_that_of_the_scaling_or_of_the_law(contacts):
    samples = contacts.rows.samples
    entries = aligned_zeros(sum(UPPER) * samples, 8).reshape(-1, samples)
    contacts.rows.add_stiffnesses(entries)
    found = iter(np.split(entries[:, contacts.sample], np.cumsum(UPPER)[:-1]))
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
    (change, bound_step, dual_step), _ = contacts.expand(0)
    for g, operator in enumerate(contacts.operators):
        diagonal, off, stiffness = contacts.scaling.parts[g].newton_blocks()
        friction, smooth, dual = contacts.friction.parts[g], contacts.smooth.parts[g], contacts.dual.parts[g]
        moved = operator @ contacts.spins[:, contacts.sample]
        assert change.parts[g].ravel() == pytest.approx(moved, rel=1e-14, abs=1e-14)
        head, tail = -friction, -dual
        expected = (head - inner(off, change.parts[g])) / diagonal
        assert np.where(smooth, 0.0, expected) == pytest.approx(bound_step.parts[g], rel=1e-8, abs=1e-9)
        pull = dual + tail - off * (head / diagonal)
        moved = pull - np.einsum("ijn,jn->in", stiffness, change.parts[g]) - dual
        scale = length(pull) + np.abs(stiffness).max(axis=(0, 1)) * length(change.parts[g])
        assert (np.abs(moved - dual_step.parts[g]) <= 1e-9 * scale)[:, ~smooth].all()


def test_the_contact_that_is_first_on_its_cone_ends_the_step(contacts):
    rng = np.random.default_rng(5)
    for _ in range(20):
        contacts.spins = rng.standard_normal(contacts.spins.shape) * 10 ** rng.uniform(-3, 3)
        (change, bound_step, dual_step), found = contacts.expand(0)
        reach, dual_reach = [], []
        for g in range(len(SIZES)):
            cones, slip = ~contacts.smooth.parts[g], contacts.slip.parts[g]
            point, step = (contacts.bound.parts[g], slip), (bound_step.parts[g], change.parts[g])
            dual_point = contacts.friction.parts[g], contacts.dual.parts[g]
            reach.append(longest_step(*((head[cones], tail[:, cones]) for head, tail in (point, step))))
            steps = np.zeros(cones.sum()), dual_step.parts[g][:, cones]
            dual_reach.append(longest_step((dual_point[0][cones], dual_point[1][:, cones]), steps))
            half = 0.5 * length(slip) / length(change.parts[g])  # a law is not linear further than that
            reach.append(half[~cones].min(initial=np.inf))
        assert min(found[kernels.REACH], 1e20) == pytest.approx(min(*reach, 1e20), rel=1e-6)
        assert min(found[kernels.DUAL_REACH], 1e20) == pytest.approx(min(*dual_reach, 1e20), rel=1e-6)


def test_corrector_and_recentring_are_those_of_the_cones(contacts):
    (change, bound_step, dual_step), _ = contacts.expand(0)
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
    contacts.run(kernels.recentre, (0, 1), 0.4, 0.7, 0.1, 2.0, kernels.GO_ON)

    def recentred(g):
        scaling, (db, dz, dy) = contacts.scaling.parts[g], steps[g]
        primal = contacts.bound.parts[g] + 0.4 * db, contacts.slip.parts[g] + 0.4 * dz
        dual = contacts.friction.parts[g], contacts.dual.parts[g] + 0.7 * dy
        product = jordan_product(scaling.apply(dual), scaling.apply_inverse(primal))
        head, tail = mended(g, clipped_towards(product, 0.1, 2.0))
        return -contacts.friction.parts[g] + head, -contacts.dual.parts[g] + tail

    contacts.compare_right(1, recentred)


def test_a_step_that_is_good_enough_can_be_made_once_more(contacts):
    def aims():
        return [[contacts.step(slot, row, False) for row in (kernels.RIGHT_HEAD, kernels.PULL)] for slot in (0, 1)]

    contacts.expand(0)
    contacts.run(kernels.correct, (0, 1), 0.03)
    contacts.expand(1)
    contacts.run(kernels.recentre, (1, 0), 0.4, 0.7, 0.1, 2.0, kernels.GO_ON)
    better, before = aims()
    assert not _same(better, before)
    contacts.run(kernels.recentre, (0, 1), 0.4, 0.7, 0.1, 2.0, kernels.AS_WRITTEN)
    assert _same(aims()[1], before)
    contacts.run(kernels.recentre, (0, 1), 0.4, 0.7, 0.1, 2.0, kernels.AS_READ)
    assert _same(aims()[1], better)


def _same(values, others):
    return all(
        (a == b).all() for one, other in zip(values, others, strict=True) for a, b in zip(one, other, strict=True)
    )


def test_products_after_a_step_are_counted_in_cones_alone(contacts):
    (change, bound_step, dual_step), found = contacts.expand(0)
    expected, scale = 0.0, 0.0
    for g in range(len(SIZES)):
        bound = contacts.bound.parts[g] + 0.4 * bound_step.parts[g]
        slip, dual = contacts.slip.parts[g] + 0.4 * change.parts[g], contacts.dual.parts[g] + 0.7 * dual_step.parts[g]
        products = (bound * contacts.friction.parts[g] + inner(slip, dual))[~contacts.smooth.parts[g]]
        expected, scale = expected + products.sum(), scale + np.abs(products).sum()
    product, by_reach, by_dual_reach, by_both = found[kernels.PRODUCT :]
    after = product + 0.4 * by_reach + 0.7 * by_dual_reach + 0.4 * 0.7 * by_both
    assert after == pytest.approx(expected, abs=1e-9 * scale)


def test_a_step_is_taken_and_contacts_in_no_cone_obey_the_law(contacts):
    (change, bound_step, dual_step), _ = contacts.expand(0)
    found = contacts.run(kernels.take, (0, 0), 0.4, 0.7)
    rows, power, excess = contacts.rows, 0.0, 0.0
    for row, before in ((kernels.SLIP_BEFORE, contacts.slip), (kernels.DUAL_BEFORE, contacts.dual)):
        assert _same([rows.vectors(row, contacts.sample)], [before])
    assert _same([rows.numbers(kernels.BOUND_BEFORE, contacts.sample)], [contacts.bound])
    slips, duals = (rows.vectors(row, contacts.sample) for row in (kernels.SLIP, kernels.DUAL))
    bounds = rows.numbers(kernels.BOUND, contacts.sample)
    for g, smooth in enumerate(contacts.smooth):
        slip = contacts.slip.parts[g] + 0.4 * change.parts[g]
        law = -contacts.friction.parts[g] * slip / length(slip)
        dual = np.where(smooth, law, contacts.dual.parts[g] + 0.7 * dual_step.parts[g])
        bound = np.where(smooth, length(slip), contacts.bound.parts[g] + 0.4 * bound_step.parts[g])
        for new, expected in ((slips, slip), (duals, dual), (bounds, bound)):
            assert new.parts[g] == pytest.approx(expected, rel=1e-13)
        power += (contacts.friction.parts[g] * length(slip)).sum()
        excess += (contacts.friction.parts[g] * length(slip) + inner(slip, dual)).sum()
    assert (found[kernels.POWER_FOUND], found[kernels.EXCESS]) == pytest.approx((power, excess), rel=1e-12)


def test_torques_are_the_transpose_of_the_slips(contacts):
    rows, rng = contacts.rows, np.random.default_rng(1)
    forces = [each(lambda z: rng.standard_normal(z.shape), contacts.slip) for _ in range(rows.samples)]
    for sample, own in enumerate(forces):
        rows.put(kernels.FORCE, sample, own)
        assert _same([rows.vectors(kernels.FORCE, sample)], [own])
    rows.torques(kernels.FORCE)
    for sample, own in enumerate(forces):
        expected = sum(operator.T @ f.ravel() for operator, f in zip(contacts.operators, own, strict=True))
        assert rows.spins[contacts.place, sample] == pytest.approx(expected, rel=1e-13, abs=1e-13)


def test_numbers_of_a_sample_do_not_depend_on_those_beside_it():
    together, alone = Contacts(8, 3), Contacts(1, 4)
    for row in (kernels.FRICTION_ROW, kernels.BOUND, kernels.SMOOTH):
        alone.rows.put(row, 0, together.rows.numbers(row, together.sample))
    for row in (kernels.SLIP, kernels.DUAL):
        alone.rows.put(row, 0, together.rows.vectors(row, together.sample))
    found = []
    for contacts in (alone, together):
        contacts.run(kernels.prepare, (0, 0), 1e-3)
        contacts.rows.two(kernels.STATE_ROWS + kernels.CHANGE)[:] = 0.1
        over_contacts = [contacts.run(kernels.expand, (0, 0)), contacts.run(kernels.take, (0, 0), 0.2, 0.3)]
        contacts.run(kernels.correct, (0, 1), 0.1)
        contacts.run(kernels.recentre, (1, 0), 0.2, 0.3, 0.01, 2.0, kernels.GO_ON)
        steps = [contacts.step(slot, row, False) for slot in (0, 1) for row in range(kernels.STEP_ROWS)]
        found.append([*steps, over_contacts])
    for one, other in zip(*found, strict=True):
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True))
