"""Follows the central path of the samples of one network, until it is decided which of their contacts slip.

"To settle the states" of a sample is to find out which contacts slip at its minimum (resolution.py). The relative gap
is (cost - lower bound) / cost.
"""

import math
import time
from collections import deque
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from taichi_bearings.conic.central_path import Path, balance
from taichi_bearings.conic.iterate import LEAST_GAP, Iterate
from taichi_bearings.conic.resolution import Resolved, Surroundings, resolve
from taichi_bearings.conic.slipless_forces import may_have_several_minima
from taichi_bearings.kernels.elimination import LANES
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.stages import stage

# relative gap at which settling is tried first, also if the path ends there (32^3 seed 2); it is tried again when the
# gap has fallen by RETRY_FACTOR
SETTLING_GAP, RETRY_FACTOR = 1e-9, 100
# small samples have larger slips: there the first trial comes at SETTLING_GAP_FACTOR / spheres^2, at most at the other
FIRST_SETTLING_GAP, SETTLING_GAP_FACTOR = 1e-8, 1e-4
# If the gap of a second trial is above LEAST_SECOND_GAP, well before double precision ends (up to 1 100 spheres), small
# samples have two trials, and the first comes at a gap EARLIER_FACTOR times as large.
EARLIER_FACTOR, LEAST_SECOND_GAP = 3.0, 8e-13
SETTLING_STEPS = 5.0  # number of steps along the path that take as long as settling the contact states
# With so many samples or fewer left, each takes its steps alone, in 0.31 of the time of a step of LANES samples (10^3).
MOST_ALONE = 2
DISTANT_GAP = 1e-4  # relative gap above which the price of leftover torques does not matter yet


@dataclass
class Sample:
    """One sample with n contacts at a point of its central path, which ends at the minimum of the power. To *settle the
    contact states* is to find out which contacts slip at the minimum.

    iterate : the point of the path.
    unit : power of two near the mean coefficient, in which its friction is measured.
    steps : number of Newton steps taken.
    gap : relative gap, (cost - lower bound) / cost; infinite before the first step.
    done : True if nothing is left to gain.
    at_end : True if its contact states are to be settled before it goes on.
    before : the point one step before `iterate`, if it is known and `at_end` is set.
    tried : relative gap at the last trial to settle the states; infinite before the first.
    resolved : the best minimum found so far; None before.
    firm : (n,) mask of contacts that rest at every minimum: so strong ones that less friction is used for them in
        `iterate`; None for none.
    """

    iterate: Iterate
    unit: float
    steps: int = 0
    gap: float = np.inf
    done: bool = False
    at_end: bool = False
    before: Iterate | None = None
    tried: float = np.inf
    resolved: Resolved | None = None
    firm: np.ndarray | None = None

    @cached_property
    def may_have_several_minima(self) -> bool:
        """True if frictions repeat, so that the sample may have several minima."""
        return may_have_several_minima(self.iterate.friction, np.zeros(0, dtype=bool))


class Descent:
    """Follows the central paths of samples of one system until it is known which contacts slip at the minimum, and
    which rest: until their states are *settled*.

    samples : all samples.
    ends_at : relative gap, (cost - lower bound) / cost, at which a path ends.
    """

    samples: list[Sample]
    ends_at = LEAST_GAP

    def __init__(
        self,
        shared: Surroundings,
        spheres: int,
        small: bool,
        settles: bool,
        asked: bool = True,
    ) -> None:
        """Prepare a descent; the subclass sets `samples`.

        shared : system, order of elimination and Newton matrix of all samples.
        spheres : number of spheres, by which the first gap for settling is chosen.
        small : True if several samples are solved together, as is faster in small networks.
        settles : True if this descent can settle contact states: the force of the law does not depend on the slip
            speed, so some contacts rest.
        asked : True if contact states are wanted, and not only a bound on the power.
        """
        self.shared, self.spheres, self.small, self.settles, self.asked = shared, spheres, small, settles, asked
        self.step_seconds = 0.0  # duration of the last Newton step, seconds

    def advance(self, steps: int) -> None:
        """Take up to `steps` further Newton steps of every sample that is not done. Near the end of its path settle the
        contact states of a sample: find out which contacts slip at the minimum.

        Small samples take their steps together, as many as a path has places; where one leaves, another takes its
        place. The last few take their steps alone, as empty places cost as much time as others; but not before the
        kernels for that are loaded.
        """
        # Three lists of samples, each with the number of steps at which it pauses: those whose states are settled next,
        # those that wait for a place on the path, and those on the path, by place.
        at_end = [(sample, sample.steps + steps) for sample in self.samples if sample.at_end]
        waiting = deque((of, of.steps + steps) for of in self.samples if not (of.done or of.at_end))
        if not (at_end or waiting):
            return
        together = LANES if self.small and len(waiting) + len(at_end) > 1 else 1
        path, going = Path(self.shared.matrix, together, self.small), dict[int, tuple[Sample, int]]()
        with one_thread():  # fronts are shared among threads here, not inside the library
            try:
                while waiting or going or at_end:
                    # Settle the states of as many samples as fit together, which takes half the time.
                    if len(at_end) >= together or not (waiting or going):
                        some, at_end = at_end[:together], at_end[together:]
                        self._settle([sample for sample, _ in some])
                        waiting += [(sample, last) for sample, last in some if not sample.done and sample.steps < last]
                        continue
                    # For the last few samples change to a path with one place.
                    few = len(waiting) + len(going) <= MOST_ALONE and self.shared.matrix.is_ready_for(1)
                    places = 1 if few else together
                    if places != path.samples:
                        for place, (sample, _) in going.items():
                            self._leave(path, place, sample)
                        waiting += going.values()
                        path, going = Path(self.shared.matrix, places, self.small), {}
                    # Fill the free places, and take a step.
                    for place in [place for place in range(places) if place not in going][: len(waiting)]:
                        going[place] = waiting.popleft()
                        path.put(place, going[place][0].iterate)
                    began = time.perf_counter()
                    taken = path.step()
                    self.step_seconds = time.perf_counter() - began
                    self._judge({place: sample for place, (sample, _) in going.items()}, path, taken)
                    # Samples that are done, near the end or at their last step leave the path.
                    for place, (sample, last) in list(going.items()):
                        if sample.done or sample.at_end or sample.steps == last:
                            self._leave(path, place, going.pop(place)[0])
                        if sample.at_end:
                            at_end.append((sample, last))
            finally:
                for place, (sample, _) in going.items():
                    self._leave(path, place, sample)

    def _leave(self, path: Path, place: int, sample: Sample) -> None:
        """Store the point that a sample has reached, unless it is done, and free its place on the path for others.

        path : the path on which it is, together with others.
        place : its place among the samples there.
        sample : the sample.
        """
        if not sample.done:
            sample.iterate = path.iterate(place)
        path.put(place, None)

    @property
    def settles_at(self) -> float:
        """Relative gap below which it is first tried to settle contact states: SETTLING_GAP in large samples. In small
        ones it depends on the number of spheres (`_small_gap`); it is larger where there will be a second trial, and at
        most FIRST_SETTLING_GAP."""
        if not self.small:
            return SETTLING_GAP
        return min(self._small_gap * (EARLIER_FACTOR if self._tries_twice else 1.0), FIRST_SETTLING_GAP)

    @property
    def _small_gap(self) -> float:
        """Relative gap at which most contacts of a small sample that seem to stick do stick. It falls with the number
        of spheres, as the smallest slips do."""
        return SETTLING_GAP_FACTOR / self.spheres**2

    @property
    def _tries_twice(self) -> bool:
        """True if there are two trials to settle the contact states of a sample before its path ends: in small samples,
        if the second trial comes well before double precision ends."""
        return self.small and self._small_gap / RETRY_FACTOR > LEAST_SECOND_GAP

    @np.errstate(all="ignore")  # at the end numbers that are not finite turn up
    def _judge(self, samples: dict[int, Sample], path: Path, taken: np.ndarray) -> None:
        """Update samples after a step: their numbers of steps and relative gaps, and whether they are done (`done`) or
        their contact states are to be settled next (`at_end`). In both cases the point of the path is stored.

        samples : the samples on the path, by their place there.
        path : the path on which they are.
        taken : mask of the places; False if the step could not be taken: then the sample is done, at the point before.
        """
        for place, sample in samples.items():
            gap = self._gap(sample, path, place) if taken[place] else np.nan
            sample.steps, accepted = sample.steps + 1, math.isfinite(gap)
            sample.gap, sample.done = gap if accepted else sample.gap, not accepted or not gap > self.ends_at
            sample.at_end = sample.gap < max(self._near(sample), SETTLING_GAP if self.settles and sample.done else 0.0)
            if sample.done or sample.at_end:
                sample.iterate = path.iterate(place) if accepted else path.before(place)
            if sample.at_end:
                sample.before = path.before(place) if accepted else None

    def _near(self, sample: Sample) -> float:
        """Return the relative gap below which the next trial to settle the contact states of a sample comes; 0 if no
        trial comes before the path ends."""
        if not self.settles:
            return 0.0
        # With several minima not below SETTLING_GAP: settling then follows the path on with fewer unknowns.
        first = max(self.settles_at, SETTLING_GAP) if sample.may_have_several_minima else self.settles_at
        if not math.isfinite(sample.tried):  # no trial yet
            return first
        if not self.small:
            return min(first, sample.tried / RETRY_FACTOR)
        return 0.0 if self._is_last(sample.tried) else min(first, self.settles_at / RETRY_FACTOR)

    def _is_last(self, gap: float) -> bool:
        """Return True if a trial to settle contact states, at the relative gap `gap`, follows the path to its end. Only
        the first of two trials of small samples does not: where it fails, a few more steps together with other samples
        take less time than to follow the path to its end alone."""
        return not self._tries_twice or gap < self.settles_at / RETRY_FACTOR

    def _gap(self, sample: Sample, path: Path, place: int) -> float:
        """Return the relative gap of a sample after a step, (cost - lower bound) / cost; not finite if it cannot be
        computed.

        sample : the sample.
        path : the path on which it is, together with others.
        place : its place among the samples there.

        Unbalanced forces lower the bound. If this loss, the price of torques, is above the gap and LEAST_GAP, the first
        of these rules that applies is followed:

        1. If no states are settled here, a loss below SETTLING_GAP is ignored.
        2. If states are wanted, the next trial to settle them is not due, and balancing takes as long as a step, the
           loss is added to the gap.
        3. If states are wanted and the gap is above LEAST_GAP, a loss below SETTLING_GAP is ignored, as settling
           balances forces itself.
        4. Forces are balanced, and the sample goes on from there.
        """
        gap = path.gap(place)
        price = 0.0 if gap > DISTANT_GAP else path.price_of_torques(place)
        if not price > max(gap, LEAST_GAP) or (not self.settles and price < SETTLING_GAP):
            return gap
        if self.settles and self.asked:
            if not self.shared.has_quick_springs and not gap < self._near(sample):
                return gap + price
            if gap > LEAST_GAP and price < SETTLING_GAP:
                return gap
        try:
            balanced = balance(path.iterate(place), self.shared.springs)
        except NotPositiveDefinite:
            return np.nan
        path.put(place, balanced)
        return balanced.gap

    def _settle(self, samples: list[Sample]) -> None:
        """Try to find which contacts of some samples slip at the minimum. Store in each sample the best minimum found
        so far, and set `done` where the contact states are sure."""
        with stage("settling contact states", SETTLING_STEPS * self.step_seconds):
            last = [sample.done or self._is_last(sample.gap) for sample in samples]
            points = [s.iterate for s in samples], [s.before for s in samples]
            resolved = resolve(*points, self.shared, self.small, last)
        for sample, found in zip(samples, resolved, strict=True):
            sample.tried, sample.at_end, sample.before = sample.gap, False, None
            if found is None:
                continue
            if sample.resolved is None or self._misses(sample, found) <= self._misses(sample, sample.resolved):
                sample.resolved = found
            sample.done |= found.sure

    def _misses(self, sample: Sample, found: Resolved) -> tuple[bool, bool, float]:
        """Return three measures by which minima are compared, the most important first; the smaller one is better:

        1. True if no forces of the slipless contacts are known that balance all torques;
        2. True if it is not sure which contacts slip;
        3. the relative gap, plus the cost of unbalanced torques.

        sample : the sample, whose friction is used.
        found : the minimum.
        """
        settled = replace(sample.iterate, difference=found.difference, dual=found.dual)
        return not found.borne, not found.sure, settled.gap + settled.price_of_torques
