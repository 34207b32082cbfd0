"""Work for the workers of a scan that goes wrong in chosen samples; imported by name in their processes."""

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

from taichi_bearings.scans.engine import Outcome, failure
from taichi_bearings.scans.sample import solve_samples

OUT_OF_MEMORY, EXITS, HANGS, ABORTS, FLAKY = 3, 5, 7, 8, 11  # seeds
ROOM = 40_000_000  # bytes of memory


def solve(samples, marks):
    """Solve samples, but for those whose seed means mischief. marks : folder where the flaky one remembers itself."""
    records = []
    for sample in samples:
        seed = sample.settings.seed
        if seed == EXITS:
            os._exit(42)
        if seed == HANGS:
            time.sleep(3600)
        if seed == ABORTS:
            os.abort()
        if seed == FLAKY and not (marks / "tried").exists():
            (marks / "tried").touch()
            os._exit(1)
        if seed == OUT_OF_MEMORY:
            records.append(failure(sample, MemoryError("no room")))
        else:
            records += solve_samples([sample])
    return records


def solve_in_little_memory(samples, marks):
    """Solve samples; memory ends at one seed, and the worker at another. marks : folder for the tries of each."""
    for seed in (sample.settings.seed for sample in samples):
        with (marks / f"tries-{seed}").open("a") as tries:
            tries.write("I")
        if seed == OUT_OF_MEMORY:
            import resource

            used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (used + ROOM, resource.getrlimit(resource.RLIMIT_AS)[1]))
        if seed == EXITS:
            os.kill(os.getpid(), signal.SIGKILL)
    return solve_samples(samples)


def dawdle(samples, seconds):
    """Solve samples, slowly."""
    time.sleep(seconds * len(samples))
    return solve_samples(samples)


def die(samples):
    os._exit(1)


def asking(plan, **wishes):
    """The plan with these wishes beside the numbers of `run`."""
    return replace(plan, wishes=wishes)


class Here:
    """An engine without workers: units are solved at once, in this process."""

    workers = 0

    def __init__(self, analyse=False, states=None):
        self.wishes, self.running, self.outcomes = (analyse, states), [], []

    @property
    def has_room(self):
        return not self.outcomes

    def submit(self, unit):
        self.outcomes.append(Outcome(unit, solve_samples(unit, *self.wishes)))

    def collect(self, seconds):
        outcomes, self.outcomes = self.outcomes, []
        return outcomes

    def close(self):
        pass


class NoRoom(Here):
    """An engine in which no sample has a result."""

    def submit(self, unit):
        self.outcomes.append(Outcome(unit, [failure(sample, MemoryError("no room")) for sample in unit]))


def allowed(unit, seconds):
    """So long for what hangs, and for all else as long as a busy machine may take."""
    return seconds if any(sample.settings.seed == HANGS for sample in unit) else 300.0


def end_dask_worker(samples):
    """Solve samples, but end the process that started this one at one seed."""
    if any(sample.settings.seed == EXITS for sample in samples):
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(3600)
    return solve_samples(samples)


def halt(samples):
    """Solve samples; at one seed the worker is stopped, and neither ends nor answers."""
    if any(sample.settings.seed == HANGS for sample in samples):
        os.kill(os.getpid(), signal.SIGSTOP)
    return solve_samples(samples)
