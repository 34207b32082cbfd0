"""Work for the workers of a scan that goes wrong in chosen samples; imported by name in their processes."""

import os
import signal
import time
from dataclasses import replace

from taichi_bearings.scans.engine import Outcome, failure
from taichi_bearings.scans.sample import solve_samples

OUT_OF_MEMORY, EXITS, HANGS, ABORTS, FLAKY = 3, 5, 7, 8, 11  # seeds


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


def dawdle(samples, seconds):
    """Solve samples, slowly."""
    time.sleep(seconds * len(samples))
    return solve_samples(samples)


def die(samples):
    os._exit(1)


def die_of_several(samples):
    """Solve single samples; a worker that gets more than one at a time ends without a word."""
    if len(samples) > 1:
        os._exit(1)
    return solve_samples(samples)


def tell_environment(tasks):
    """Return as results what the environment of this worker has under the names that are the tasks' keys."""
    return [{"key": task.key, "scalars": {"status": "told", "value": os.environ.get(task.key)}} for task in tasks]


def asking(plan, **options):
    """The plan with these options of the scan beside the numbers of `run`."""
    return replace(plan, options=options)


class Here:
    """An engine without workers: units are solved at once, in this process."""

    workers = 0

    def __init__(self, analyse=False, states=None):
        self.options, self.running, self.outcomes = (analyse, states), [], []

    @property
    def can_take_unit(self):
        return not self.outcomes

    def submit(self, unit):
        self.outcomes.append(Outcome(unit, solve_samples(unit, *self.options)))

    def collect(self, seconds):
        outcomes, self.outcomes = self.outcomes, []
        return outcomes

    def close(self):
        pass


def allowed(unit, seconds):
    """So long for what hangs, and for all else as long as a busy machine may take."""
    return seconds if any(sample.settings.seed == HANGS for sample in unit) else 300.0


def halt(samples):
    """Solve samples; at one seed the worker is stopped, and neither ends nor answers."""
    if any(sample.settings.seed == HANGS for sample in samples):
        os.kill(os.getpid(), signal.SIGSTOP)
    return solve_samples(samples)
