"""Scenes that somebody has made, solved by the workers of scans."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

from taichi_bearings.errors import BearingsError
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.packing import Packing
from taichi_bearings.runs.run import Job
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.solved import Packed, Run
from taichi_bearings.scans.engine import LocalEngine, failure, run_samples


@dataclass(frozen=True)
class JobTask:
    """One of many jobs. key : which, counted from 0. scene : a Scene or a Packing. job : what solves it."""

    key: str
    scene: Any
    job: Job

    @property
    def label(self) -> str:
        return f"number {self.key}, {self.scene}"

    @property
    def settings(self) -> RunSettings:
        return self.job.settings


def solve_tasks(tasks: Sequence[JobTask]) -> list[dict[str, Any]]:
    """In a worker, with one thread where the settings leave that open: a record of each, with its `run`, or why there
    is none."""
    records = []
    with one_thread():
        for task in tasks:
            try:
                run = replace(task.job, settings=replace(task.settings, threads=task.settings.threads or 1)).solve()
                records.append({"key": task.key, "scalars": {"status": run.status[0].value}, "run": run})
            except Exception as error:
                records.append(failure(task, error))
    return records


def solve_all(tasks: Sequence[JobTask], workers: int) -> Iterator[Run]:
    """The answers as they come, of the very scenes that were given; BearingsError for the first that has none."""
    with closing(LocalEngine(solve_tasks, workers)) as engine:
        for records in run_samples([(task,) for task in tasks], engine):
            for record in records:
                task = tasks[int(record["key"])]
                if "run" not in record:
                    raise BearingsError(f"scene {task.label} has no answer: {record['scalars']['error']}")
                run, solution = record["run"], record["run"].solution
                if isinstance(task.scene, Packing):
                    solution = Packed((replace(run.result, packing=task.scene),))
                else:
                    solution = replace(solution, scene=task.scene)
                yield replace(run, settings=task.settings, solution=solution)
