"""A Newton step's passes over the contacts against their twin in NumPy, and what they have to do with the spins."""

import numpy as np
import pytest
from scipy import sparse

from taichi_bearings.conic import by_numpy, rows
from taichi_bearings.conic.central_path import friction_stiffness
from taichi_bearings.conic.cones import inner, length, longest_step
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.rows import ContactRows
from taichi_bearings.kernels import central_path as kernels
from taichi_bearings.memory import aligned_zeros
from tests.conic.cone_twin import Scaling, clipped_towards, jordan_product

pytestmark = pytest.mark.usefixtures("taichi_runtime")
COMPONENTS = np.repeat([1, 2, 1, 2], [37, 50, 16, 1])  # of the contacts: kinds mixed, blocks not full
FELT = np.arange(2)[:, None] < COMPONENTS
COUNT = len(COMPONENTS)
SPINS = 8


def interior(rng, spread=3):
    """Points in their cones, of contacts with one component on its axis."""
    tail = rng.standard_normal((2, COUNT)) * 10 ** rng.uniform(-spread / 2, spread / 2, COUNT) * FELT
    return length(tail) * (1 + 10 ** rng.uniform(-spread, 1, COUNT)), tail


def _differences(rng):
    """Rows with one to three entries 1 or -1, none where there is no component."""
    counts = rng.integers(1, 4, FELT.size) * FELT.ravel()
    columns = np.concatenate([rng.choice(SPINS, count, replace=False) for count in counts])
    signs = rng.choice([-1.0, 1.0], len(columns))
    return sparse.csr_array((signs, (np.repeat(np.arange(FELT.size), counts), columns)), (FELT.size, SPINS))


class Contacts:
    """Random points inside their cones, a third of them smooth, with right-hand sides and steps, one of S samples."""

    def __init__(self, samples, seed, shared=False):
        rng = np.random.default_rng(seed)
        self.operator, self.place = _differences(rng), rng.permutation(SPINS)
        system = ContactSystem(SPINS, np.zeros(FELT.shape), FELT, slips=self.operator)
        spins = aligned_zeros(SPINS * samples, 8).reshape(SPINS, samples)
        stacked = sparse.identity(3 * COUNT, format="csr")  # each stiffness an entry of its own
        self.rows = ContactRows(system, spins, self.place, stacked, shared)
        self.sample, self.spins = int(rng.integers(samples)), rng.standard_normal((SPINS, samples))
        for sample in range(samples):
            (bound, slip), (friction, dual), smooth = interior(rng), interior(rng), rng.random(COUNT) < 1 / 3
            for row, values in (
                (kernels.FRICTION_ROW, friction), (kernels.BOUND, bound), (kernels.SLIP, slip), (kernels.DUAL, dual),
                (kernels.SMOOTH, smooth),
            ):  # fmt: skip
                self.rows.put(row, sample, values)
            if sample == self.sample:
                self.bound, self.slip, self.friction, self.dual, self.smooth = bound, slip, friction, dual, smooth
        self.run(kernels.prepare, (0, 0), 1e-3)
        self.scaling = Scaling.of((self.bound, self.slip), (self.friction, self.dual))

    def run(self, kernel, slots, *numbers):
        """With these numbers for the sample that is looked at, and others for the rest; what is found for it."""
        others = [np.full(self.rows.samples, 0.3) for _ in numbers]
        for values, number in zip(others, numbers, strict=True):
            values[self.sample] = number
        return self.rows.run(kernel, slots, *others)[:, self.sample]

    def step(self, slot, row, vector=True):
        row += kernels.STATE_ROWS + slot * kernels.STEP_ROWS
        return self.rows.vectors(row, self.sample, 2) if vector else self.rows.numbers(row, self.sample)

    def expand(self, slot):
        """The step that belongs to the spins: changes of slip, bound and dual, and what is found over all contacts."""
        self.rows.spins[self.place] = self.spins
        self.rows.change(kernels.STATE_ROWS + slot * kernels.STEP_ROWS + kernels.CHANGE)
        found = self.run(kernels.expand, (slot, slot))
        rows = (kernels.CHANGE, kernels.BOUND_STEP, kernels.DUAL_STEP)
        return [self.step(slot, row, row != kernels.BOUND_STEP) for row in rows], found

    def compare_right(self, slot, right):
        """right : head and tail of the right-hand side that are expected."""
        head, tail, pull = (
            self.step(slot, kernels.RIGHT_HEAD, False),
            self.step(slot, kernels.RIGHT_TAIL),
            self.step(slot, kernels.PULL),
        )
        cone, scale = ~self.smooth, np.abs(right[0]) + length(right[1])
        assert (np.abs(head - right[0]) <= 1e-9 * scale)[cone].all()
        assert (np.abs(tail - right[1]) <= 1e-9 * scale)[:, cone].all()
        diagonal, off, _ = self.scaling.newton_blocks()
        pulled = self.dual + right[1] - off * (right[0] / diagonal)
        scale = scale + length(off) * np.abs(right[0]) / diagonal
        assert (np.abs(pull - pulled) <= 1e-9 * scale)[:, cone].all()
        assert (pull == self.dual)[:, self.smooth].all()


WAYS = {"by NumPy": (1, 0), "alone": (1, 0), "of eight": (8, 1), "in parts": (1, 0), "shared": (1, 0, True)}


@pytest.fixture(params=WAYS)
def contacts(request, monkeypatch):
    is_first, in_parts = request.param == "by NumPy", request.param in ("in parts", "shared")
    monkeypatch.setattr(by_numpy.SPENT, "contacts", 0 if is_first else by_numpy.WORTH_LOADING)
    monkeypatch.setattr(rows, "PARTED_CONTACTS", 0 if in_parts else 10**9)
    return Contacts(*WAYS[request.param])


def test_passes_that_threads_share_leave_the_bits_as_they_are(monkeypatch):
    monkeypatch.setattr(by_numpy.SPENT, "contacts", by_numpy.WORTH_LOADING)
    monkeypatch.setattr(rows, "PARTED_CONTACTS", 0)
    found = []
    for shared in (False, True, True):
        contacts = Contacts(1, 5, shared)
        entries = aligned_zeros(3 * COUNT, 8).reshape(-1, 1)
        contacts.rows.add_stiffnesses(entries)
        numbers = [contacts.expand(0)[1]]
        numbers += [contacts.run(kernel, (0, 1), 0.3) for kernel in (kernels.correct, kernels.between_steps)]
        numbers.append(contacts.run(kernels.recentre, (0, 1), 0.5, 0.4, 0.1, 2.0, kernels.GO_ON))
        contacts.rows.torques(kernels.DUAL)
        numbers.append(contacts.run(kernels.take, (0, 0), 0.1, 0.2))
        found.append((*numbers, entries, contacts.rows.values, contacts.rows.spins))
    for other in found[1:]:
        assert all(np.array_equal(here, there, equal_nan=True) for here, there in zip(found[0], other, strict=True))


def test_stiffness_is_that_of_the_scaling_or_of_the_law(contacts):
    samples = contacts.rows.samples
    entries = aligned_zeros(3 * COUNT * samples, 8).reshape(-1, samples)
    contacts.rows.add_stiffnesses(entries)
    expected, slip, smooth = contacts.scaling.newton_blocks()[2], contacts.slip, contacts.smooth
    along, law = slip / length(slip), friction_stiffness(contacts.friction, None, slip)
    law = law + (1e-3 - 1e-14) / length(slip) ** 2 * along[:, None] * along[None]  # as asked for
    scale = np.where(smooth, np.abs(law), np.abs(expected)).max(axis=(0, 1))
    for found, (i, j) in zip(entries[:, contacts.sample].reshape(3, -1), ((0, 0), (0, 1), (1, 1)), strict=True):
        right = np.where(FELT[j], np.where(smooth, law[i, j], expected[i, j]), 0.0)
        assert (np.abs(found - right) <= 1e-10 * scale).all()


def test_the_predictor_aims_at_no_product(contacts):
    contacts.compare_right(0, (-contacts.friction, -contacts.dual))


def test_steps_follow_from_the_spins_and_end_on_the_cones(contacts):
    (change, bound_step, dual_step), _ = contacts.expand(0)
    diagonal, off, stiffness = contacts.scaling.newton_blocks()
    friction, smooth, dual = contacts.friction, contacts.smooth, contacts.dual
    moved = contacts.operator @ contacts.spins[:, contacts.sample]
    assert change.ravel() == pytest.approx(moved, rel=1e-14, abs=1e-14)
    head, tail = -friction, -dual
    expected = (head - inner(off, change)) / diagonal
    assert np.where(smooth, 0.0, expected) == pytest.approx(bound_step, rel=1e-8, abs=1e-9)
    pull = dual + tail - off * (head / diagonal)
    moved = pull - np.einsum("ijn,jn->in", stiffness, change) - dual
    scale = length(pull) + np.abs(stiffness).max(axis=(0, 1)) * length(change)
    assert (np.abs(moved - dual_step) <= 1e-9 * scale)[:, ~smooth].all()


def test_the_contact_that_is_first_on_its_cone_ends_the_step(contacts):
    rng, cones = np.random.default_rng(5), ~contacts.smooth
    bound, slip, friction, dual = (
        of[..., cones] for of in (contacts.bound, contacts.slip, contacts.friction, contacts.dual)
    )
    for _ in range(20):
        contacts.spins = rng.standard_normal(contacts.spins.shape) * 10 ** rng.uniform(-3, 3)
        (change, bound_step, dual_step), found = contacts.expand(0)
        half = 0.5 * length(contacts.slip) / length(change)  # a law is not linear further than that
        reach = longest_step((bound, slip), (bound_step[cones], change[:, cones])), *half[~cones]
        dual_reach = longest_step((friction, dual), (np.zeros(cones.sum()), dual_step[:, cones]))
        assert min(found[kernels.REACH], 1e20) == pytest.approx(min(*reach, 1e20), rel=1e-6)
        assert min(found[kernels.DUAL_REACH], 1e20) == pytest.approx(min(dual_reach, 1e20), rel=1e-6)


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_a_step_between_two_steps_goes_as_far_as_is_said(contacts, share):
    (change, bound_step, dual_step), _ = contacts.expand(0)
    contacts.run(kernels.correct, (0, 1), 0.03)
    contacts.spins = np.random.default_rng(6).standard_normal(contacts.spins.shape)
    (to, bound_to, dual_to), _ = contacts.expand(1)
    found, cones = contacts.run(kernels.between_steps, (0, 1), share), ~contacts.smooth
    change, bound_step, dual_step = (
        step + share * (other - step) for step, other in ((change, to), (bound_step, bound_to), (dual_step, dual_to))
    )
    point = contacts.bound[cones], contacts.slip[:, cones]
    half = 0.5 * length(contacts.slip) / length(change)
    reach = longest_step(point, (bound_step[cones], change[:, cones])), *half[~cones]
    dual_point = contacts.friction[cones], contacts.dual[:, cones]
    dual_reach = longest_step(dual_point, (np.zeros(cones.sum()), dual_step[:, cones]))
    assert min(found[kernels.REACH], 1e20) == pytest.approx(min(*reach, 1e20), rel=1e-6)
    assert min(found[kernels.DUAL_REACH], 1e20) == pytest.approx(min(dual_reach, 1e20), rel=1e-6)
    # in memory it takes the place of the second step
    contacts.rows.mix(0, 1, share)
    for row, expected in ((kernels.CHANGE, change), (kernels.BOUND_STEP, bound_step), (kernels.DUAL_STEP, dual_step)):
        assert contacts.step(1, row, row != kernels.BOUND_STEP) == pytest.approx(expected, rel=1e-12, abs=1e-300)


def test_corrector_and_recentring_are_those_of_the_cones(contacts):
    (db, dz, dy), scaling = (contacts.expand(0)[0][n] for n in (1, 0, 2)), contacts.scaling

    def mended(product):
        return scaling.apply_inverse(scaling.divide(product))

    contacts.run(kernels.correct, (0, 1), 0.03)
    head, tail = jordan_product(scaling.apply((np.zeros_like(db), dy)), scaling.apply_inverse((db, dz)))
    head, tail = mended((head - 0.03, tail))
    contacts.compare_right(1, (-contacts.friction - head, -contacts.dual - tail))
    contacts.run(kernels.recentre, (0, 1), 0.4, 0.7, 0.1, 2.0, kernels.GO_ON)
    primal = contacts.bound + 0.4 * db, contacts.slip + 0.4 * dz
    dual = contacts.friction, contacts.dual + 0.7 * dy
    product = jordan_product(scaling.apply(dual), scaling.apply_inverse(primal))
    head, tail = mended(clipped_towards(product, 0.1, 2.0))
    contacts.compare_right(1, (-contacts.friction + head, -contacts.dual + tail))


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
    return all((one == other).all() for one, other in zip(values, others, strict=True))


def test_products_after_a_step_are_counted_in_cones_alone(contacts):
    (change, bound_step, dual_step), found = contacts.expand(0)
    bound, slip = contacts.bound + 0.4 * bound_step, contacts.slip + 0.4 * change
    dual = contacts.dual + 0.7 * dual_step
    products = (bound * contacts.friction + inner(slip, dual))[~contacts.smooth]
    product, by_reach, by_dual_reach, by_both = found[kernels.PRODUCT :]
    after = product + 0.4 * by_reach + 0.7 * by_dual_reach + 0.4 * 0.7 * by_both
    assert after == pytest.approx(products.sum(), abs=1e-9 * np.abs(products).sum())


def test_a_step_is_taken_and_contacts_in_no_cone_obey_the_law(contacts):
    (change, bound_step, dual_step), _ = contacts.expand(0)
    found = contacts.run(kernels.take, (0, 0), 0.4, 0.7)
    rows, sample, smooth = contacts.rows, contacts.sample, contacts.smooth
    for row, before in ((kernels.SLIP_BEFORE, contacts.slip), (kernels.DUAL_BEFORE, contacts.dual)):
        assert (rows.vectors(row, sample, 2) == before).all()
    assert (rows.numbers(kernels.BOUND_BEFORE, sample) == contacts.bound).all()
    slip = contacts.slip + 0.4 * change
    dual = np.where(smooth, -contacts.friction * slip / length(slip), contacts.dual + 0.7 * dual_step)
    bound = np.where(smooth, length(slip), contacts.bound + 0.4 * bound_step)
    for row, expected in ((kernels.SLIP, slip), (kernels.DUAL, dual)):
        assert rows.vectors(row, sample, 2) == pytest.approx(expected, rel=1e-13)
    assert rows.numbers(kernels.BOUND, sample) == pytest.approx(bound, rel=1e-13)
    power = (contacts.friction * length(slip)).sum()
    excess = (contacts.friction * length(slip) + inner(slip, dual)).sum()
    assert (found[kernels.POWER_FOUND], found[kernels.EXCESS]) == pytest.approx((power, excess), rel=1e-12)


def test_torques_are_the_transpose_of_the_slips(contacts):
    rows, rng = contacts.rows, np.random.default_rng(1)
    forces = [rng.standard_normal(FELT.shape) * FELT for _ in range(rows.samples)]
    for sample, own in enumerate(forces):
        rows.put(kernels.FORCE, sample, own)
        assert (rows.vectors(kernels.FORCE, sample, 2) == own).all()
    rows.torques(kernels.FORCE)
    for sample, own in enumerate(forces):
        expected = contacts.operator.T @ own.ravel()
        assert rows.spins[contacts.place, sample] == pytest.approx(expected, rel=1e-13, abs=1e-13)


@pytest.mark.parametrize("spent", [0, by_numpy.WORTH_LOADING])
def test_numbers_of_a_sample_do_not_depend_on_those_beside_it(spent, monkeypatch):
    monkeypatch.setattr(by_numpy.SPENT, "contacts", spent)
    together, alone = Contacts(8, 3), Contacts(1, 4)
    for row in (kernels.FRICTION_ROW, kernels.BOUND, kernels.SMOOTH):
        alone.rows.put(row, 0, together.rows.numbers(row, together.sample))
    for row in (kernels.SLIP, kernels.DUAL):
        alone.rows.put(row, 0, together.rows.vectors(row, together.sample, 2))
    found = []
    for contacts in (alone, together):
        contacts.run(kernels.prepare, (0, 0), 1e-3)
        contacts.rows.two_components(kernels.STATE_ROWS + kernels.CHANGE)[:] = 0.1
        over_contacts = [contacts.run(kernels.expand, (0, 0)), contacts.run(kernels.take, (0, 0), 0.2, 0.3)]
        contacts.run(kernels.correct, (0, 1), 0.1)
        contacts.run(kernels.recentre, (1, 0), 0.2, 0.3, 0.01, 2.0, kernels.GO_ON)
        steps = [contacts.step(slot, row, False) for slot in (0, 1) for row in range(kernels.STEP_ROWS)]
        found.append([*steps, over_contacts])
    for one, other in zip(*found, strict=True):
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True))


def _all_passes(contacts):
    """Everything that a Newton step does with the rows: all numbers of memory, and all that is found."""
    rows, found = contacts.rows, []
    entries = aligned_zeros(3 * COUNT, 8).reshape(-1, 1)
    rows.add_stiffnesses(entries)
    for slot in (0, 1):
        rows.spins[contacts.place] = contacts.spins
        rows.change(kernels.STATE_ROWS + slot * kernels.STEP_ROWS + kernels.CHANGE)
        found += [contacts.run(kernels.expand, (slot, slot)), rows.values.copy()]
        contacts.run(kernels.correct, (slot, 1 - slot), 0.1)
        contacts.run(kernels.recentre, (slot, 1 - slot), 0.2, 0.3, 0.01, 2.0, kernels.GO_ON)
        found.append(contacts.run(kernels.between_steps, (slot, 1 - slot), 0.25))
        found += [contacts.run(kernels.take, (slot, slot), 0.02, 0.03), rows.values.copy()]
        rows.torques(kernels.DUAL)
    return [*found, entries, rows.spins, rows.values]


@pytest.mark.parametrize("seed", range(20))
def test_numpy_has_the_bits_of_kernels(seed, monkeypatch):
    """Also at points that have left their cones, and with numbers that are not finite."""
    found = []
    for spent in (0, by_numpy.WORTH_LOADING):
        monkeypatch.setattr(by_numpy.SPENT, "contacts", spent)
        contacts = Contacts(1, seed)
        if seed % 4 == 0:
            contacts.rows.values[kernels.BOUND, ::7] *= 0.1
        if seed % 4 == 1:
            contacts.rows.values[kernels.BOUND, 5], contacts.rows.values[kernels.DUAL, 9] = np.nan, np.inf
        contacts.run(kernels.prepare, (0, 0), 1e-3)
        found.append(_all_passes(contacts))
        assert (by_numpy.SPENT.contacts > spent) == (spent == 0)
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other, equal_nan=True)
        assert seed % 4 < 2 or np.isfinite(one).mean() > 0.5


def test_kernels_take_over_when_they_are_worth_loading(monkeypatch):
    monkeypatch.setattr(by_numpy.SPENT, "contacts", by_numpy.WORTH_LOADING - 200)
    contacts = Contacts(1, 1)  # one pass
    assert by_numpy.is_quicker(COUNT, 1)
    launched = []
    monkeypatch.setattr(ContactRows, "_launch", lambda self, kernel, *_: launched.append(kernel))
    for _ in range(3):
        contacts.run(kernels.expand, (0, 0))
    assert launched == [kernels.expand] * 2
    assert not by_numpy.is_quicker(COUNT, 1)


@pytest.mark.parametrize(("contacts", "samples"), [(by_numpy.MOST_BY_NUMPY + 1, 1), (10, 8)])
def test_large_samples_and_several_use_kernels_at_once(contacts, samples, monkeypatch):
    monkeypatch.setattr(by_numpy.SPENT, "contacts", 0)
    assert not by_numpy.is_quicker(contacts, samples)


@pytest.mark.parametrize("samples", [1, 8])
def test_a_copied_step_is_what_a_sample_goes_on_with(samples):
    contacts = Contacts(samples, 11)
    rows, rng = contacts.rows, np.random.default_rng(12)
    for slot in (0, 1):
        for row in range(kernels.STEP_ROWS):
            for sample in range(samples):
                at = kernels.STATE_ROWS + slot * kernels.STEP_ROWS + row
                absent = (row in (2, 4, 6, 9)) & (COMPONENTS == 1)  # second components of vectors
                rows.put(at, sample, np.where(absent, 0.0, rng.standard_normal(COUNT)))
    before, begin = rows.values.copy(), kernels.STATE_ROWS
    rows.copy_step(1, 0, contacts.sample)
    needed = [row for row in range(kernels.STEP_ROWS) if row not in (kernels.RIGHT_TAIL, kernels.RIGHT_TAIL + 1)]
    for row in needed:
        copied = rows.values[begin + row, :, contacts.sample]
        assert (copied == before[begin + kernels.STEP_ROWS + row, :, contacts.sample]).all()
    others = [sample for sample in range(samples) if sample != contacts.sample]
    assert np.array_equal(rows.values[..., others], before[..., others], equal_nan=True)
    assert np.array_equal(rows.values[:begin], before[:begin], equal_nan=True)  # with those that fill up blocks
    # vectors on contacts are added component by component
    rows.add(kernels.DUAL, begin + kernels.DUAL_STEP, kernels.FORCE)
    dual, step = (rows.vectors(row, contacts.sample, 2) for row in (kernels.DUAL, begin + kernels.DUAL_STEP))
    assert (rows.vectors(kernels.FORCE, contacts.sample, 2) == dual + step).all()
