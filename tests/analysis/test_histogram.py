"""Histograms conserve contacts, and their errors are those of independent samples."""

import numpy as np
import pytest

from taichi_bearings.analysis.histogram import SampleCounts, count_powers, joined_counts, pool, rebinned
from taichi_bearings.proof.contact_state import ContactState


def contacts(seed, replicas=6, number=500, spread=4.0):
    """Powers and states, some contacts of every state."""
    rng = np.random.default_rng(seed)
    power = rng.lognormal(0, spread, (replicas, 2 * number))
    return power, rng.integers(0, 5, power.shape)


def slipping(power, state):
    return [p[s == 1] for p, s in zip(power, state, strict=True)]


@pytest.mark.parametrize("bins_per_decade", [1, 5, 7])
def test_every_slipping_contact_is_in_its_bin_and_the_others_are_counted(bins_per_decade):
    power, state = contacts(3)
    found = pool(count_powers(power, state, bins_per_decade), 1e-9)
    values = np.concatenate(slipping(power, state))
    assert (found.count == np.histogram(values, found.edges)[0]).all()
    assert found.slipping == len(values)
    assert found.count[[0, -1]].all()
    assert np.allclose(np.diff(np.log10(found.edges)), 1 / bins_per_decade)
    assert found.slipless == (state == ContactState.SLIPLESS).sum()
    assert found.undecided == (state == ContactState.UNDECIDED).sum()
    assert found.tied == (state == ContactState.TIED).sum()
    assert found.samples == 6
    assert found.density.sum() / bins_per_decade == pytest.approx(1)


def test_nothing_that_slips_makes_no_bins():
    power, state = np.ones((2, 5)), np.zeros((2, 5), dtype=int)
    found = pool(count_powers(power, state), 1e-9)
    assert (found.slipping, found.slipless, len(found.edges), len(found.count)) == (0, 10, 0, 0)
    both = joined_counts([count_powers(power, state), count_powers(*contacts(1))])
    assert both.count[:2].sum() == 0
    assert both.count[2:].sum() == sum(len(values) for values in slipping(*contacts(1)))


def test_errors_by_hand():
    """Two samples with 4 and 0 contacts in the first bin, 2 and 6 in the second."""
    counts = SampleCounts(0, 1, np.array([[4, 2], [0, 6]]), np.array([[1, 6, 0, 4], [2, 6, 3, 5]]))
    found = pool(counts, 1e-9)
    assert found.count.tolist() == [4, 8]
    assert found.standard_error == pytest.approx(2 * [np.sqrt(2 * 8)])  # 2 samples of variance ((4-2)^2 + (0-2)^2)/1
    assert found.density == pytest.approx([1 / 3, 2 / 3])
    # residuals n_sb - p_b N_s are +-2 and -+2 with N_s = 6, 6
    assert found.density_error == pytest.approx(2 * [np.sqrt(2 * 8) / 12])
    assert (found.slipless, found.undecided, found.tied, found.samples) == (3, 3, 9, 2)
    one = pool(counts.of(np.array([0])), 1e-9)
    assert one.standard_error == pytest.approx([2, np.sqrt(2)])
    assert one.density_error == pytest.approx([2 / 6, np.sqrt(2) / 6])


def test_errors_are_the_spread_of_repeated_histograms():
    """Samples whose contacts hang together: Poisson errors would be several times too small."""
    rng = np.random.default_rng(11)

    def drawn():
        level = rng.lognormal(0, 1.0, (40, 1))  # shifts all powers of a sample
        return level * rng.lognormal(0, 1.0, (40, 200)), np.ones((40, 200), dtype=int)

    found = [count_powers(*drawn(), bins_per_decade=1) for _ in range(200)]
    lined_up = [pool(joined_counts([part, *found]).of(np.arange(40)), 1e-9) for part in found]
    count = np.array([histogram.count for histogram in lined_up])
    common = count.mean(axis=0) > 500
    stated = np.array([histogram.standard_error for histogram in lined_up]).mean(axis=0)
    assert stated[common] == pytest.approx(count.std(axis=0, ddof=1)[common], rel=0.15)
    assert (stated[common] > 3 * np.sqrt(count.mean(axis=0))[common]).all()


def fine_counts(power, state):
    return count_powers(power, state, 20)


@pytest.mark.parametrize("bins_per_decade", [1, 2, 4, 5, 10, 20])
def test_bins_merge_to_the_same_histogram_as_from_the_powers(bins_per_decade):
    power, state = contacts(5)
    merged, direct = (
        pool(counts, 1e-9)
        for counts in (
            rebinned(fine_counts(power, state), bins_per_decade, np.ones(6)),
            count_powers(power, state, bins_per_decade),
        )
    )
    assert merged.edges == pytest.approx(direct.edges, rel=1e-12)
    assert (merged.count == direct.count).all()
    assert (merged.standard_error == direct.standard_error).all()


def test_units_of_their_own_move_contacts_by_half_a_fine_bin_at_most():
    power, state = contacts(7)
    unit = np.random.default_rng(1).lognormal(0, 2, 6)
    moved = rebinned(fine_counts(power, state), 20, unit)
    direct = count_powers(power, state, 20, unit)
    assert (moved.count.sum(axis=1) == direct.count.sum(axis=1)).all()
    for r, values in enumerate(slipping(power, state)):
        exact = np.sort(20 * np.log10(values / unit[r]))
        bins = np.repeat(moved.first + np.arange(moved.count.shape[1]), moved.count[r])
        assert (exact >= bins - 0.5 - 1e-9).all()
        assert (exact <= bins + 1.5 + 1e-9).all()
