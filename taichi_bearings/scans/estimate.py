"""What a scan costs: a model of the seconds of a sample, corrected by what the samples that are done have taken.

The model gives times on one core of a common server, good to a factor of three; docs/scans.md has the table. It serves
`--dry-run`, makes units of work that are worth sending to a worker, and with :class:`WorkLeft` tells the time left.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

from taichi_bearings.runs.run import row_of
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.plan import Sample, ScanPlan, groups_of

WORKER_START = 1.0  # seconds to start a worker, its imports included
OVERHEAD = 5e-4  # seconds to summarise a sample and write it down
WORKER_BYTES = 200e6  # of a worker that has solved nothing yet
UNIT_SECONDS = 1.0  # estimated work that is sent to a worker at a time
BLOCK_SAMPLES = 24  # samples of which an interior point steps eight at once: where one is done, another takes its place
MOST_IN_A_UNIT = 256
MOST_SITES_IN_A_UNIT = 200_000
KIND_KEYS = (
    "law", "distribution", "viscosity", "shape", "direction", "tolerance", "settle", "time_limit", "duration",
    "stiffness", "time_step", "error_tolerance", "arch", "precision",
)  # fmt: skip
"""Settings of which the time of a sample depends most."""
PRIOR = 0.2  # samples of a kind that weigh as much as what is known of other kinds
KNOWN = 0.5  # share of the remaining work whose kinds are measured, from which on a time left is known
_Kind = tuple[Any, ...]


def unused_keys(plan: ScanPlan) -> list[str]:
    """What no method and no law of a scan uses although it is given, a sentence each."""
    found: dict[str, str] = {}
    used: set[str] = set()
    for group in groups_of(plan.samples):
        settings = group[0].settings
        unused = settings.unused(row_of(settings))
        found = unused | found
        used |= settings.given.keys() - unused.keys()
    return [sentence for key, sentence in found.items() if key not in used]


def seconds_of(settings: RunSettings, structure: bool = False) -> float:
    """Time to solve one sample; infinite where it is not known, as for dynamics."""
    solve = row_of(settings).seconds(settings.shape, settings.tolerance)
    if solve is None:
        return math.inf
    return seconds_beside(settings, structure) + min(solve, settings.time_limit or math.inf)


def seconds_beside(settings: RunSettings, structure: bool = False) -> float:
    """Time that a sample takes beside its solve."""
    return OVERHEAD + (0.06 + 6e-5 * math.prod(settings.shape) if structure else 0.0)


def bytes_of(settings: RunSettings) -> float:
    """Memory of a worker that solves such samples."""
    sites = math.prod(settings.shape)
    return WORKER_BYTES + 1000 * max(sites, MOST_SITES_IN_A_UNIT) + row_of(settings).bytes(sites)


def _kind_of(settings: RunSettings) -> _Kind:
    """The same for samples that take about the same time; the method that solves them comes first."""
    return (row_of(settings).name, *(getattr(settings, name, None) for name in KIND_KEYS))


def units_of(samples: Sequence[Sample], structure: bool = False, workers: int = 1) -> list[tuple[Sample, ...]]:
    """The samples in units of work: as many of like settings as take about a second or gain by being solved
    together, but as much for every worker. One of each kind comes first, so that all are soon known to take how long.
    """
    units = []
    for group in groups_of(samples):
        settings = group[0].settings
        number = int(UNIT_SECONDS / seconds_of(settings, structure))
        if math.prod(settings.shape) < row_of(settings).alike_in_a_block:
            number = max(number, BLOCK_SAMPLES)
        number = max(1, min(number, MOST_IN_A_UNIT, MOST_SITES_IN_A_UNIT // math.prod(settings.shape)))
        rounds = math.ceil(len(group) / (number * workers))
        number = math.ceil(len(group) / (rounds * workers))
        units += [tuple(group[start : start + number]) for start in range(0, len(group), number)]
    first = {_kind_of(unit[0].settings): unit for unit in reversed(units)}
    return sorted(units, key=lambda unit: first[_kind_of(unit[0].settings)] is not unit)


def paying_workers(samples: Sequence[Sample], most: int, structure: bool = False) -> int:
    """How many workers the work pays for, each of which takes a second to start."""
    work = math.fsum(len(group) * seconds_of(group[0].settings, structure) for group in groups_of(samples))
    return max(1, int(min(most, len(samples), work / WORKER_START)))


class WorkLeft:
    """The work that is left of a scan: for each kind of samples the cost that the model estimates, times the ratio of
    measured to estimated seconds of that kind so far, shared over the workers.

    samples : all that are to be solved. structure : they are analysed too.
    """

    def __init__(self, samples: Sequence[Sample], structure: bool = False) -> None:
        self.structure = structure
        self.remaining = Counter[_Kind](_kind_of(sample.settings) for sample in samples)
        self.cost: dict[_Kind, float] = {}  # of one; where there is no estimate, spheres times simulated time
        self.has_estimate: dict[_Kind, bool] = {}
        self.first: tuple[float, float] | None = None  # seconds since the start, and of solves
        self.measured, self.estimated = defaultdict[Any, float](float), defaultdict[Any, float](float)
        for kind, settings in {_kind_of(sample.settings): sample.settings for sample in samples}.items():
            seconds = seconds_of(settings, structure)
            self.has_estimate[kind] = seconds < math.inf
            without = math.prod(settings.shape) * (settings.duration or 1.0)
            self.cost[kind] = seconds if self.has_estimate[kind] else without

    def finish(self, sample: Sample, seconds: float | None) -> None:
        """A sample needs no more work. seconds : that its solve has taken, None if it has failed."""
        kind = _kind_of(sample.settings)
        self.remaining[kind] -= 1
        if seconds is not None:
            for key in (kind, kind[0]):
                self.measured[key] += seconds + seconds_beside(sample.settings, self.structure)
                self.estimated[key] += self.cost[kind]

    def seconds_left(self, workers: int, elapsed: float) -> float | None:
        """Time left; None while what is measured says too little of what is to come. elapsed : seconds since the start.

        What workers have spent beside solving since the first result, they will go on to spend.
        """
        work = {kind: number * self._seconds_each(kind) for kind, number in self.remaining.items() if number}
        known = math.fsum(seconds for kind, seconds in work.items() if self.measured[kind])
        left = self.expected(workers) if known >= KNOWN * math.fsum(work.values()) else None
        if left is None:
            return None
        solving = math.fsum(seconds for key, seconds in self.measured.items() if isinstance(key, tuple))
        self.first = self.first or (elapsed, solving)
        passed, solved = elapsed - self.first[0], solving - self.first[1]
        return left * max(workers * passed / solved, 1.0) if solved else left

    def expected(self, workers: int) -> float | None:
        """Time left as far as can be said; None if nothing can: of methods without an estimate and not yet measured."""
        each = {kind: self._seconds_each(kind) for kind, number in self.remaining.items() if number}
        work = math.fsum(self.remaining[kind] * seconds for kind, seconds in each.items())
        return max(work / workers, *each.values(), 0.0) if work < math.inf else None

    def _seconds_each(self, kind: _Kind) -> float:
        """Seconds of a sample; few are drawn towards the ratio of all of their method. Infinite where nothing is
        estimated or measured."""
        cost, method = self.cost[kind], kind[0]
        unmeasured = 1.0 if self.has_estimate[kind] else math.inf
        ratio = self.measured[method] / self.estimated[method] if self.estimated[method] else unmeasured
        return cost * (self.measured[kind] + PRIOR * cost * ratio) / (self.estimated[kind] + PRIOR * cost)
