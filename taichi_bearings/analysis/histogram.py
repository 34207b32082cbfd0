"""The distribution of power over the slipping contacts: logarithmic bins, pooled over samples, with standard errors.

Letters: S samples, B bins, R replicas, E contacts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from taichi_bearings.analysis.statistics import Census
from taichi_bearings.errors import InputError
from taichi_bearings.scene.solution import ContactState, counts_of_states

ENERGY_PER_TIME = "energy/time"
# states whose contacts are counted, in the order of `SampleCounts.contacts`
COUNTED_STATES = (ContactState.SLIPLESS, ContactState.SLIPPING, ContactState.UNDECIDED, ContactState.TIED)


@dataclass(frozen=True)
class SampleCounts:
    """Numbers of slipping contacts of S samples in B logarithmic bins of power.

    first, bins_per_decade : whole numbers; bin b begins at the power 10^((first + b) / bins_per_decade).
    count : (S, bins B), slipping contacts in each bin.
    contacts : (S, 4), numbers of contacts that are slipless, slipping, undecided and tied (slip at some minima only).
    """

    first: int
    bins_per_decade: int
    count: np.ndarray
    contacts: np.ndarray

    @property
    def edges(self) -> np.ndarray:
        """(bins + 1,), powers where bins begin and end; empty if there is no bin."""
        bins = self.count.shape[1]
        return 10.0 ** ((self.first + np.arange(bins + 1 if bins else 0)) / self.bins_per_decade)

    def of(self, samples: np.ndarray) -> "SampleCounts":
        """Return the counts of some of the samples, in the same bins.

        samples : (n,), numbers of these samples.
        """
        return replace(self, count=self.count[samples], contacts=self.contacts[samples])


@dataclass(frozen=True)
class PowerHistogram:
    """Distribution of power over the slipping contacts of all samples, in B bins.

    edges : (B + 1,), powers where bins begin and end, evenly spaced in the logarithm.
    count : (bins B,), number of slipping contacts in each bin.
    standard_error : (B,), standard error of the count.
    density, density_error : (B,), share of the slipping contacts per decade of power, and its standard error.
    slipless, tied, undecided : numbers of contacts in these states, which are in no bin. Tied contacts slip at some
        minima only.
    slip_threshold : largest slip speed, length/time, up to which contacts counted as slipless in one of the runs.
    samples : number of samples that are pooled.
    units : unit of the power, as a text.
    left_out : number of other samples that were left out, by reason.

    With several samples the errors are those of sums, or of ratios of sums, over independent samples; samples with the
    same coefficients count as one. With a single sample they are those of contacts that slip independently (Poisson).
    """

    edges: np.ndarray
    count: np.ndarray
    standard_error: np.ndarray
    density: np.ndarray
    density_error: np.ndarray
    slipless: int
    tied: int
    undecided: int
    slip_threshold: float
    samples: int
    units: str = ENERGY_PER_TIME
    left_out: Mapping[str, int] = field(default_factory=dict)

    @property
    def census(self) -> Census:
        """How many samples were pooled, and how many were left out."""
        return Census(self.samples, self.left_out)

    @property
    def slipping(self) -> int:
        """Number of slipping contacts in all bins."""
        return int(self.count.sum())


def count_powers(
    power: np.ndarray,
    state: np.ndarray,
    bins_per_decade: int = 5,
    unit: np.ndarray | None = None,
) -> SampleCounts:
    """Return how many slipping contacts of each of R samples fall into each logarithmic bin of power. Slipping contacts
    with a power of exactly 0 are in no bin.

    power : (R, contacts E), energy/time.
    state : (R, E), values of ContactState.
    bins_per_decade : bins for each factor of 10 of the power.
    unit : (R,), power that serves as unit in each sample; None for 1.
    """
    slipping = np.flatnonzero((state == ContactState.SLIPPING) & (power > 0))
    replica, scale = slipping // power.shape[1], np.ones(len(power)) if unit is None else unit
    number = np.floor(bins_per_decade * np.log10(power.ravel()[slipping] / scale[replica])).astype(int)
    first, bins = (int(number.min()), int(np.ptp(number)) + 1) if len(number) else (0, 0)
    count = np.bincount(replica * bins + number - first, minlength=len(power) * bins).reshape(len(power), bins)
    return SampleCounts(first, bins_per_decade, count, counts_of_states(state)[:, COUNTED_STATES])


MOST_POWER_BINS = 100_000  # no spread of floating-point numbers needs more


def rebinned(fine: SampleCounts, bins_per_decade: int, unit: np.ndarray) -> SampleCounts:
    """Return counts in coarser bins and other units, made from counts in fine bins alone.

    fine : the counts of S samples.
    bins_per_decade : bins per decade of the new bins; it must divide that of `fine`, which callers check.
    unit : (S,), the new unit of power in each sample.

    A new unit shifts the bins of a sample by the nearest whole number of fine bins, so its powers are off by at most
    half a fine bin.
    """
    merged = fine.bins_per_decade // bins_per_decade
    shift = np.rint(fine.bins_per_decade * np.log10(1 / unit)).astype(int)
    number = (fine.first + shift[:, None] + np.arange(fine.count.shape[1])) // merged  # (S, fine bins): coarse bin
    if not fine.count.any():
        return SampleCounts(0, bins_per_decade, np.zeros((len(fine.count), 0), dtype=int), fine.contacts)
    used = number[fine.count > 0]
    first, bins = int(used.min()), int(np.ptp(used)) + 1
    if bins > MOST_POWER_BINS:
        raise InputError(
            f"the powers of the samples span {bins / bins_per_decade:.3g} decades, too many for one histogram; "
            "use fewer bins per decade or fewer samples"
        )
    count = np.zeros((len(fine.count), bins), dtype=int)
    sample, column = np.nonzero(fine.count)
    np.add.at(count, (sample, number[sample, column] - first), fine.count[sample, column])
    return SampleCounts(first, bins_per_decade, count, fine.contacts)


def joined_counts(parts: Sequence[SampleCounts]) -> SampleCounts:
    """Return the counts of the samples of all `parts` together, in bins that hold them all.

    All parts must have the same `bins_per_decade`.
    """
    filled = [part for part in parts if part.count.shape[1]]
    first = min((part.first for part in filled), default=0)
    bins = max((part.first + part.count.shape[1] for part in filled), default=0) - first
    rows = []
    for part in parts:
        before = part.first - first if part.count.shape[1] else 0
        rows.append(np.pad(part.count, ((0, 0), (before, bins - before - part.count.shape[1]))))
    contacts = np.concatenate([part.contacts for part in parts])
    return SampleCounts(first, parts[0].bins_per_decade, np.vstack(rows), contacts)


def pool(
    counts: SampleCounts,
    slip_threshold: float,
    units: str = ENERGY_PER_TIME,
    disorder: np.ndarray | None = None,
    left_out: Mapping[str, int] | None = None,
) -> PowerHistogram:
    """Return one histogram of the power of all slipping contacts of S samples, with standard errors.

    counts : numbers of slipping contacts of the S samples by bins of power.
    slip_threshold : largest slip speed, length/time, up to which contacts counted as slipless in one of the samples.
    units : unit of the power, as a text.
    disorder : (S,), equal numbers for samples with the same coefficients; None if all coefficients differ.
    left_out : number of further samples that were left out, by reason; None for none.
    """
    # samples of one disorder depend on each other: they are summed to one independent sample
    independent = counts.count if disorder is None else _by_disorder(counts.count, disorder)
    samples, count = len(independent), counts.count.sum(axis=0)
    total = max(int(count.sum()), 1)
    share = count / total
    slipless, _, undecided, tied = counts.contacts.sum(axis=0).tolist()
    if samples > 1:
        # standard errors of a sum of independent samples, and of a ratio of two such sums (to first order)
        spread = samples / (samples - 1)
        error = np.sqrt(spread * ((independent - count / samples) ** 2).sum(axis=0))
        slipping = independent.sum(axis=1, keepdims=True)
        share_error = np.sqrt(spread * ((independent - share * slipping) ** 2).sum(axis=0)) / total
    else:  # Poisson
        error, share_error = np.sqrt(count), np.sqrt(count) / total
    return PowerHistogram(
        edges=counts.edges,
        count=count,
        standard_error=error,
        density=share * counts.bins_per_decade,
        density_error=share_error * counts.bins_per_decade,
        slipless=slipless,
        tied=tied,
        undecided=undecided,
        slip_threshold=slip_threshold,
        samples=len(counts.count),
        units=units,
        left_out=left_out or {},
    )


def _by_disorder(count: np.ndarray, disorder: np.ndarray) -> np.ndarray:
    """Return counts (disorders, bins B) in which the samples with the same coefficients, one disorder, are added up.

    count : (samples S, B), counts of the samples.
    disorder : (S,), number of the disorder of each sample.
    """
    values, which = np.unique(disorder, return_inverse=True)
    summed = np.zeros((len(values), count.shape[1]), dtype=count.dtype)
    np.add.at(summed, which, count)
    return summed
