"""What a sample costs, roughly: measured times on one core of a common server, good to a factor of three.

They serve `--dry-run`, and to make units of work that are worth sending to a worker. docs/scans.md has the table.
"""

import math
from collections.abc import Sequence

from taichi_bearings.runs.run import row_of
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.plan import Sample, ScanPlan, groups_of

WORKER_START = 1.0  # seconds to start a worker, its imports included
OVERHEAD = 5e-4  # seconds to summarise a sample and write it down
WORKER_BYTES = 200e6  # of a worker that has solved nothing yet
UNIT_SECONDS = 1.0  # estimated work that is sent to a worker at a time
TOGETHER = 24  # samples of which an interior point steps eight at once: where one is done, another takes its place
MOST_IN_A_UNIT = 256
MOST_SITES_IN_A_UNIT = 200_000


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


def seconds_of(settings: RunSettings, structure: bool = False) -> float | None:
    """Time to solve one sample; None where it is not known, as for dynamics."""
    sites = math.prod(settings.shape)
    solve = row_of(settings).seconds(settings.shape, settings.tolerance)
    if solve is None:
        return None
    return OVERHEAD + min(solve, settings.time_limit or math.inf) + (0.06 + 6e-5 * sites if structure else 0.0)


def bytes_of(settings: RunSettings) -> float:
    """Memory of a worker that solves such samples."""
    sites = math.prod(settings.shape)
    return WORKER_BYTES + 1000 * max(sites, MOST_SITES_IN_A_UNIT) + row_of(settings).bytes(sites)


def units_of(samples: Sequence[Sample], structure: bool = False, workers: int = 1) -> list[tuple[Sample, ...]]:
    """The samples in units of work: as many of like settings as take about a second or gain by being solved
    together, but as much for every worker."""
    units = []
    for group in groups_of(samples):
        settings = group[0].settings
        seconds = seconds_of(settings, structure)
        number = 1 if seconds is None else int(UNIT_SECONDS / seconds)
        if math.prod(settings.shape) < row_of(settings).alike_in_a_block:
            number = max(number, TOGETHER)
        number = max(1, min(number, MOST_IN_A_UNIT, MOST_SITES_IN_A_UNIT // math.prod(settings.shape)))
        rounds = math.ceil(len(group) / (number * workers))
        number = math.ceil(len(group) / (rounds * workers))
        units += [tuple(group[start : start + number]) for start in range(0, len(group), number)]
    return units


def total_seconds(samples: Sequence[Sample], structure: bool = False) -> float | None:
    """Work of one core for all samples; None if any of it is not known."""
    parts = [(len(group), seconds_of(group[0].settings, structure)) for group in groups_of(samples)]
    known = [number * seconds for number, seconds in parts if seconds is not None]
    return math.fsum(known) if len(known) == len(parts) else None


def paying_workers(samples: Sequence[Sample], most: int, structure: bool = False) -> int:
    """How many workers the work pays for, each of which takes a second to start."""
    work = total_seconds(samples, structure)
    least = 1 if work is None else max(1, math.floor(work / WORKER_START))
    return max(1, min(most, len(samples), most if work is None else least))
