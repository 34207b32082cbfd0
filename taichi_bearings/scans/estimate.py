"""What a scan costs: a model of the seconds of a sample, corrected by what the samples that are done have taken.

The model gives times on one core of a common server, good to a factor of three; docs/scans.md has the table. It serves
`--dry-run`, makes units of work that are worth sending to a worker, and with :class:`WorkLeft` tells the time left.
"""

import heapq
import itertools
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from taichi_bearings.runs.run import row_of
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.engine import Record, Unit
from taichi_bearings.scans.plan import MOST_SAMPLES, Sample, ScanPlan, groups_of, spheres_of

WORKER_START = 1.0  # seconds to start a worker, its imports included
OVERHEAD = 5e-4  # seconds to summarise a sample and write it down
WORKER_BYTES = 200e6  # of a worker that has solved nothing yet
UNIT_SECONDS = 1.0  # estimated work that is sent to a worker at a time
BLOCK_SAMPLES = 24  # samples of which an interior point steps eight at once: where one is done, another takes its place
MOST_IN_A_UNIT = 256
MOST_SITES_IN_A_UNIT = 200_000
KIND_KEYS = (
    "method", "law", "distribution", "viscosity", "shape", "direction", "tolerance", "settle", "time_limit", "duration",
    "stiffness", "time_step", "error_tolerance", "arch", "precision", "packing", "driven",
)  # fmt: skip
"""Settings of which the time of a sample depends most."""
PRIOR = 0.2  # samples of a kind that weigh as much as what is known of other kinds
OVERDUE = 1.25  # a unit that takes longer than expected is expected to take so many times what it has taken
KNOWN = 0.5  # share of the remaining work whose kinds are measured, from which on a time left is known
BEGUN = 0.1  # or share of all work that is done
PORTION = 0.05  # of a worker's share of the work: shorter units are handed out together


def unused_keys(plan: ScanPlan) -> list[str]:
    """What no method and no law of a scan uses although it is given, a sentence each."""
    found: dict[str, str] = {}
    used: set[str] = set()
    for group in groups_of(plan.samples):
        settings = group[0].settings
        if settings.is_packing:
            from taichi_bearings.runs.packing_run import unused_of_packing

            unused = unused_of_packing(settings)
        else:
            unused = settings.unused(row_of(settings))
        found = unused | found
        used |= settings.given.keys() - unused.keys()
    return [sentence for key, sentence in found.items() if key not in used]


def seconds_of(settings: RunSettings, structure: bool = False) -> float:
    """Time to solve one sample; infinite where it is not known, as for dynamics and packings."""
    solve = None if settings.is_packing else row_of(settings).seconds(settings.shape, settings.tolerance)
    if solve is None:
        return math.inf
    return seconds_beside(settings, structure) + min(solve, settings.time_limit or math.inf)


def seconds_beside(settings: RunSettings, structure: bool = False) -> float:
    """Time that a sample takes beside its solve."""
    return OVERHEAD + (0.06 + 6e-5 * spheres_of(settings) if structure else 0.0)


def bytes_of(settings: RunSettings) -> float:
    """Memory of a worker that solves such samples."""
    sites = spheres_of(settings)
    return WORKER_BYTES + 1000 * max(sites, MOST_SITES_IN_A_UNIT) + row_of(settings).bytes(sites)


def kind_of(settings: RunSettings) -> tuple[Any, ...]:
    """The same for samples that take about the same time."""
    return tuple(getattr(settings, name, None) for name in KIND_KEYS)


def units_of(samples: Sequence[Sample], structure: bool = False, workers: int = 1) -> list[tuple[Sample, ...]]:
    """The samples in units of work: as many of like settings as take about a second or gain by being solved
    together, but as much for every worker. One of each kind comes first, so that all are soon known to take how long.
    """
    units = []
    for group in groups_of(samples):
        settings = group[0].settings
        number = int(UNIT_SECONDS / seconds_of(settings, structure))
        if not settings.is_packing and spheres_of(settings) < row_of(settings).alike_in_a_block:
            number = max(number, BLOCK_SAMPLES)
        number = max(1, min(number, MOST_IN_A_UNIT, MOST_SITES_IN_A_UNIT // spheres_of(settings)))
        rounds = math.ceil(len(group) / (number * workers))
        number = math.ceil(len(group) / (rounds * workers))
        units += [tuple(group[start : start + number]) for start in range(0, len(group), number)]
    first = {kind_of(unit[0].settings): unit for unit in reversed(units)}
    return sorted(units, key=lambda unit: first[kind_of(unit[0].settings)] is not unit)


def paying_workers(samples: Sequence[Sample], most: int, structure: bool = False) -> int:
    """How many workers the work pays for, each of which takes a second to start."""
    work = math.fsum(len(group) * seconds_of(group[0].settings, structure) for group in groups_of(samples))
    return max(1, int(min(most, len(samples), work / WORKER_START)))


@dataclass(eq=False)
class _Kind:
    """Samples that take about the same time.

    cost : estimated seconds of one; where there is no estimate, spheres times simulated time. together : samples of a
    unit. remaining : samples without a result, of which `alone` are tried again. measured, estimated : seconds and cost
    of the samples that have been in work.
    """

    method: str
    has_estimate: bool
    cost: float
    together: int = 1
    remaining: int = 0
    alone: int = 0
    measured: float = 0.0
    estimated: float = 0.0


@dataclass
class _Begun:
    """A unit in work since `seconds`. is_first : of its worker, which also loads and compiles for it."""

    unit: Unit
    kind: _Kind
    seconds: float
    is_first: bool


class WorkLeft:
    """The work that is left of a scan: for each kind of samples the cost that the model estimates, times the ratio of
    measured to estimated seconds of that kind so far, shared over the workers.

    units : all that are to be solved, in their order. records : of the samples that are done, by key, as they come.
    structure : samples are analysed too.
    """

    def __init__(self, units: Sequence[Unit], records: Mapping[str, Record], structure: bool = False) -> None:
        self.records, self.structure = records, structure
        self.kinds: dict[tuple[Any, ...], _Kind] = {}
        for unit in units:
            kind = self._kind_of(unit[0])
            kind.remaining += len(unit)
            kind.together = max(kind.together, len(unit))
        self.begun: dict[str, _Begun] = {}  # units in work, by the key of their first sample
        self.again: set[str] = set()  # samples that wait for another try
        self.started, self.start = 0, WORKER_START  # workers; seconds that the last of them took to load and compile

    def _kind_of(self, sample: Sample) -> _Kind:
        settings, key = sample.settings, kind_of(sample.settings)
        if key not in self.kinds:
            seconds = seconds_of(settings, self.structure)
            has_estimate = seconds < math.inf
            cost = seconds if has_estimate else spheres_of(settings) * (settings.duration or 1.0)
            name = row_of(settings).name + " of packings" * settings.is_packing
            self.kinds[key] = _Kind(name, has_estimate, cost)
        return self.kinds[key]

    def retry(self, sample: Sample) -> None:
        """A sample has failed and is tried again: when all others are done, alone."""
        self.again.add(sample.key)
        self._kind_of(sample).alone += 1

    def finish(self, sample: Sample) -> None:
        """A sample needs no more work."""
        self._kind_of(sample).remaining -= 1

    def look(self, running: Sequence[Unit], workers: int, now: float) -> None:
        """Learn which units are in work, and what those have taken that no longer are.

        running : units with the workers, the oldest first; each worker has one in work, the others wait. now : seconds.
        """
        in_work = {unit[0].key: unit for unit in running[:workers]}
        for key in self.begun.keys() - in_work.keys():
            self._end(self.begun.pop(key), now)
        for key in in_work.keys() - self.begun.keys():
            kind = self._kind_of(in_work[key][0])
            kind.alone -= key in self.again
            self.again.discard(key)
            self.begun[key] = _Begun(in_work[key], kind, now, self.started < workers)
            self.started = min(self.started + 1, workers)

    def _end(self, old: _Begun, now: float) -> None:
        seconds = now - old.seconds
        if old.is_first:
            found = [self.records[sample.key]["scalars"] for sample in old.unit if sample.key in self.records]
            solving = math.fsum(scalars.get("seconds", 0.0) for scalars in found)
            work = solving + len(found) * seconds_beside(old.unit[0].settings, self.structure)
            self.start, seconds = max(seconds - work, 0.0), min(seconds, work)
        if seconds > 0:
            old.kind.measured += seconds
            old.kind.estimated += len(old.unit) * old.kind.cost

    def seconds_left(self, workers: int, now: float) -> float | None:
        """Time left; None while what is measured says too little of what is to come."""
        done, each = math.fsum(kind.measured for kind in self.kinds.values()), self._seconds_each()
        left = math.fsum(kind.remaining * seconds for kind, seconds in each.items())
        known = math.fsum(kind.remaining * seconds for kind, seconds in each.items() if kind.measured)
        is_known = done > 0 and (known >= KNOWN * left or done >= BEGUN * (done + left))
        return self.expected(workers, now) if is_known else None

    def expected(self, workers: int, now: float = 0.0) -> float | None:
        """Time left as far as can be said; None if nothing can: of methods without an estimate and not yet measured."""
        each, late = self._seconds_each(), list[tuple[_Kind, float, float]]()
        waiting = {kind: kind.remaining - kind.alone for kind in each}
        busy = [0.0] * (workers - len(self.begun))
        for begun in self.begun.values():
            kind, taken = begun.kind, now - begun.seconds - (self.start if begun.is_first else 0.0)
            seconds = len(begun.unit) * each[kind]
            if OVERDUE * taken > seconds:
                seconds = OVERDUE * taken
                late.append((kind, seconds, len(begun.unit) * kind.cost))
            waiting[kind] -= len(begun.unit)
            busy.append(seconds - taken)
        each = self._seconds_each(late)
        if any(kind.remaining and seconds == math.inf for kind, seconds in each.items()):
            return None
        pieces = [(kind, *divmod(number, kind.together)) for kind, number in waiting.items() if number > 0]
        shared = [(units, kind.together * each[kind]) for kind, units, _ in pieces]
        shared += [(1, rest * each[kind]) for kind, _, rest in pieces]
        return _shared(busy, shared) + math.fsum(kind.alone * each[kind] for kind in each if kind.alone)

    def _seconds_each(self, late: Sequence[tuple[_Kind, float, float]] = ()) -> dict[_Kind, float]:
        """Seconds of a sample of each kind; few samples are drawn towards the ratio of all of their method.

        late : kind, seconds and cost of units in work that count as measured. Infinite where nothing is estimated or
        measured.
        """
        measured, estimated = defaultdict[_Kind | str, float](float), defaultdict[_Kind | str, float](float)
        known = ((kind, kind.measured, kind.estimated) for kind in self.kinds.values())
        for kind, seconds, cost in itertools.chain(known, late):
            for key in (kind, kind.method):
                measured[key] += seconds
                estimated[key] += cost
        each = {}
        for kind in self.kinds.values():
            unmeasured, prior = 1.0 if kind.has_estimate else math.inf, PRIOR * kind.cost
            ratio = measured[kind.method] / estimated[kind.method] if estimated[kind.method] else unmeasured
            each[kind] = kind.cost * (measured[kind] + prior * ratio) / (estimated[kind] + prior)
        return each


def _shared(busy: list[float], pieces: Sequence[tuple[int, float]]) -> float:
    """Time until all is done: each piece in turn goes to the worker that is free first.

    busy : seconds until each worker is free. pieces : how many, of how many seconds each.
    """
    portion = PORTION * (math.fsum(busy) + math.fsum(number * seconds for number, seconds in pieces)) / len(busy)
    heapq.heapify(busy)
    for number, seconds in pieces:
        together = max(1, int(portion / seconds)) if seconds else MOST_SAMPLES
        for first in range(0, number, together):
            heapq.heapreplace(busy, busy[0] + min(together, number - first) * seconds)
    return max(busy)
