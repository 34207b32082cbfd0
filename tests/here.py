"""Scans and `solve_many` within this process: no worker has to load the program and compile kernels."""

import contextlib
from concurrent.futures import Future
from contextlib import nullcontext
from unittest import mock

from taichi_bearings.scans.engine import LocalEngine


class EngineHere(LocalEngine):
    """An engine that solves each unit of samples as soon as it is submitted, in this process and its runtime."""

    def submit(self, unit):
        solved = Future()
        solved.set_result((self.work(unit), ""))
        self._units[solved] = unit


def _engine(work, workers, *allowed):
    return (EngineHere if workers == 1 else LocalEngine)(work, workers, *allowed)


@contextlib.contextmanager
def one_worker_is_here():
    """Context in which what would be solved by a single worker process is solved in this one; several are started."""
    with contextlib.ExitStack() as patches:
        for user in ("scans.scan", "scans.sample"):
            patches.enter_context(mock.patch(f"taichi_bearings.{user}.LocalEngine", _engine))
        patches.enter_context(mock.patch("taichi_bearings_cli.scan.begun_early", nullcontext))
        yield
