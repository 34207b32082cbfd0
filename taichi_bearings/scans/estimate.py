"""Estimates what a scan costs, by a model of the seconds of a sample and by what finished samples have taken.

The model gives times on one core of a common server, good to a factor of three (docs/measurements.md). It
serves `--dry-run`, makes units of work that are worth sending to a worker, and with :class:`WorkLeft` foretells the
time left.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from taichi_bearings.runs.run import run_kind_of
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.engine import Record, Unit
from taichi_bearings.scans.plan import Sample, groups_of, spheres_of
from taichi_bearings.solvers.table import JUDGED_SECONDS

WORKER_START = 1.0  # seconds to start a worker, its imports included
OVERHEAD = 5e-4  # seconds to summarise a sample and write it down
UNIT_SECONDS = 1.0  # estimated work that is sent to a worker at a time
MOST_IN_A_UNIT = 256  # samples
MOST_SITES_IN_A_UNIT = 200_000  # spheres of all its samples
KIND_KEYS = (
    "method", "law", "distribution", "viscosity", "shape", "direction", "tolerance", "settle", "time_limit", "duration",
    "stiffness", "time_step", "error_tolerance", "arch", "precision", "packing", "driven",
)  # fmt: skip
"""Settings on which the time of a sample depends most."""
BEGUN = 0.1  # share of the work after which the time left is given, even if most of the rest is of kinds not measured


def seconds_of(settings: RunSettings, structure: bool = False) -> float:
    """Return the estimated seconds to solve one sample; infinite if not known, as for dynamics and packings.

    settings : settings of the sample.
    structure : True if its structure (domains, network, cut) is analysed as well.
    """
    if (solve := run_kind_of(settings).seconds(settings)) is None:
        return math.inf
    judged = JUDGED_SECONDS[len(settings.shape)] * spheres_of(settings)
    return seconds_without_solve(settings, structure) + judged + min(solve, settings.time_limit or math.inf)


def seconds_without_solve(settings: RunSettings, structure: bool = False) -> float:
    """Return the estimated seconds that a sample takes apart from its solve.

    settings : settings of the sample.
    structure : True if its structure (domains, network, cut) is analysed as well.
    """
    return OVERHEAD + (0.06 + 6e-5 * spheres_of(settings) if structure else 0.0)


def bytes_of(settings: RunSettings) -> float:
    """Return the estimated memory, bytes, of a worker that solves samples with these settings."""
    spheres = spheres_of(settings)
    samples_at_once = max(1, min(MOST_IN_A_UNIT, MOST_SITES_IN_A_UNIT // spheres))
    return run_kind_of(settings).worker_bytes(settings, spheres, samples_at_once)


def kind_of(settings: RunSettings) -> tuple[object, ...]:
    """Return a key that is equal for settings whose samples take about the same time."""
    return tuple(getattr(settings, name, None) for name in KIND_KEYS)


def units_of(samples: Sequence[Sample], structure: bool = False, workers: int = 1) -> list[tuple[Sample, ...]]:
    """Return the samples divided into units of work, tuples that are sent to a worker at a time.

    samples : samples without a result.
    structure : True if their structure is analysed as well.
    workers : number of workers.

    A unit has as many samples of like settings as take about a second together, or as are faster when solved together,
    but not so many that another worker gets none. One unit of each kind of settings comes first, so that the times of
    all kinds are soon known.
    """
    units = []
    for group in groups_of(samples):
        settings = group[0].settings
        spheres, in_a_second = spheres_of(settings), int(UNIT_SECONDS / seconds_of(settings, structure))
        number = max(in_a_second, run_kind_of(settings).samples_at_a_time(settings, spheres))
        number = max(1, min(number, MOST_IN_A_UNIT, MOST_SITES_IN_A_UNIT // spheres))
        # so many units for each worker, and all of equal size
        rounds = math.ceil(len(group) / (number * workers))
        number = math.ceil(len(group) / (rounds * workers))
        units += [tuple(group[start : start + number]) for start in range(0, len(group), number)]
    first = {kind_of(unit[0].settings): unit for unit in reversed(units)}  # of each kind
    return sorted(units, key=lambda unit: first[kind_of(unit[0].settings)] is not unit)


def seconds_in_all(samples: Sequence[Sample], workers: int, structure: bool = False) -> float:
    """Return the estimated seconds in which some workers solve all samples, at least the time of the longest; infinite
    if not known.

    samples : what is solved.
    workers : number of workers.
    structure : True if the structure of each sample is analysed as well.
    """
    each = [(len(group), seconds_of(group[0].settings, structure)) for group in groups_of(samples)]
    shared = math.fsum(number * seconds for number, seconds in each) / workers
    return max([shared, *(seconds for _, seconds in each)])


def paying_workers(samples: Sequence[Sample], most: int, structure: bool = False) -> int:
    """Return how many workers are worth starting: one for each WORKER_START seconds of work, the time of a start.

    samples : what is solved.
    most : largest number of workers.
    structure : True if the structure of each sample is analysed as well.
    """
    return max(1, int(min(most, len(samples), seconds_in_all(samples, 1, structure) / WORKER_START)))


@dataclass(eq=False)
class Kind:
    """Samples of a scan that take about the same time each.

    method : name of the method that solves them, with the kind of scene.
    cost : estimated seconds for one of them; for dynamics and packings, which have no estimate, its number of spheres
        times its simulated time.
    remaining : number of samples without a result.
    done, seconds : number of samples with a result, and the time that they have taken together.
    """

    method: str
    cost: float
    remaining: int = 0
    done: int = 0
    seconds: float = 0.0


class WorkLeft:
    """Estimate of the work that is left of a scan, which learns from the times of finished samples.

    Samples that cost about the same form a kind. A sample that is left is expected to take as long as the finished ones
    of its kind have taken on average. If none of its kind is finished, it is expected to take its estimated cost, times
    the ratio of measured time to cost that its method has had so far.

    structure : True if the structure of samples is analysed as well.
    """

    def __init__(self, samples: Sequence[Sample], structure: bool = False) -> None:
        """Group the samples into kinds that cost alike.

        samples : samples without a result.
        structure : True if the structure of each is analysed as well.
        """
        self.structure, self.kinds = structure, dict[tuple[object, ...], Kind]()
        for group in groups_of(samples):
            settings = group[0].settings
            seconds = seconds_of(settings, structure)
            cost = seconds if seconds < math.inf else spheres_of(settings) * (settings.duration or 1.0)
            runs = run_kind_of(settings)
            name = f"{runs.row(settings).name} of {runs.what}"
            self.kinds.setdefault(kind_of(settings), Kind(name, cost)).remaining += len(group)

    def finish(self, sample: Sample, record: Record) -> None:
        """Count a sample as finished, and learn from its time.

        sample : the sample.
        record : record of the sample, with its result.
        """
        kind, seconds = self.kinds[kind_of(sample.settings)], record["scalars"].get("seconds")
        kind.remaining -= 1
        if seconds is not None:
            kind.done += 1
            kind.seconds += seconds + seconds_without_solve(sample.settings, self.structure)

    def seconds_left(self, running: Sequence[Unit], workers: int, elapsed: float) -> float | None:
        """Return the estimated seconds left: the work left, shared among the workers and slowed down as the work so far
        was, by all that is done apart from solving. None if too little is finished to tell: no sample of a method, or
        less than BEGUN of the work while most of the rest is of kinds without a finished sample.

        running : units (tuples of samples) in work; half of each is taken to be done.
        workers : number of workers.
        elapsed : seconds since the start.
        """
        taken = defaultdict[str, list[float]](lambda: [0.0, 0.0])  # by method: seconds and cost of finished samples
        for kind in self.kinds.values():
            taken[kind.method][0] += kind.seconds
            taken[kind.method][1] += kind.done * kind.cost
        # seconds expected for one sample of each kind, and for all that remain, by whether their kind is measured
        expected, left = dict[Kind, float](), {True: 0.0, False: 0.0}
        for kind in self.kinds.values():
            seconds, cost = taken[kind.method]
            expected[kind] = kind.seconds / kind.done if kind.done else kind.cost * seconds / cost if cost else math.inf
            left[kind.done > 0] += kind.remaining * expected[kind] if kind.remaining else 0.0
        done, all_left = sum(kind.seconds for kind in self.kinds.values()), sum(left.values())
        if not done or all_left == math.inf or (left[True] < left[False] and done < BEGUN * (done + all_left)):
            return None
        half = 0.5 * sum(len(unit) * expected[self.kinds[kind_of(unit[0].settings)]] for unit in running[:workers])
        slowdown = workers * elapsed / (done + half)  # time of the workers over the work done
        return (all_left - half) / workers * max(slowdown, 1.0)
