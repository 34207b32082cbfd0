"""The matrices of Newton steps of several contracted samples: they differ in size, and no contact joins them."""

from functools import partial

import numpy as np

from taichi_bearings.conic.contact_system import stacked
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.grouped import Arrays
from taichi_bearings.conic.newton_matrix import cholesky_of, factorise_raised
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.cholesky.factor import Memory


class NewtonBlocks:
    """As :class:`NewtonMatrix`, a block for each sample; what is singular in one of them is no matter to the others."""

    def __init__(self, tied: Contraction, memory: Memory | None = None) -> None:
        """memory : for a single sample, that of a matrix which is not needed as long."""
        first, second, self._source, self._sign = tied.system.terms()
        owner, samples = tied.owners.spins[first], tied.owners.samples
        order = np.argsort(owner, kind="stable") if samples > 1 else np.arange(len(first))
        bounds, end = np.searchsorted(owner[order], np.arange(samples + 1)).tolist(), 0
        self._blocks, self._places = [], np.empty(len(first), dtype=np.int64)
        for sample in range(samples):
            own, of_sample = tied.span(sample), order[bounds[sample] : bounds[sample + 1]]
            if own.stop == own.start:  # everything is tied to the driven planes
                continue
            pairs = first[of_sample] - own.start, second[of_sample] - own.start
            size = own.stop - own.start
            shared = memory if samples == 1 else None
            cholesky = cholesky_of(size, partial(tied.order, sample), pairs, shared)
            begin, end = end, end + cholesky.pattern.entries
            self._places[of_sample] = begin + cholesky.pattern.entry(*pairs)
            self._blocks.append((sample, own, cholesky, slice(begin, end)))
        self._entries = end

    def factorise_each(self, stiffness: Arrays, chosen: np.ndarray) -> np.ndarray:
        """Factorise the blocks of the chosen samples (samples,); True for those where that succeeds.

        stiffness : (d, d, n) a group.
        """
        numbers, regular = stacked(stiffness)[self._source] * self._sign, chosen.copy()
        values = np.bincount(self._places, numbers, self._entries)
        for sample, _, cholesky, entries in self._blocks:
            if chosen[sample]:
                try:
                    factorise_raised(cholesky, values[entries])
                except NotPositiveDefinite:
                    regular[sample] = False
        return regular

    def solve_each(self, right: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Solutions (unknowns,) of the factorised systems of the chosen samples (samples,); 0 in others."""
        found = np.zeros_like(right)
        for sample, own, cholesky, _ in self._blocks:
            if chosen[sample]:
                found[own] = cholesky.solve(right[own])
        return found
