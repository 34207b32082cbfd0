"""Scenes that somebody has made, solved by the workers of scans."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taichi_bearings.errors import BearingsError
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.packing import Packing, Packings
from taichi_bearings.runs.run import Job, job_of
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.solved import Run
from taichi_bearings.scans.engine import LocalEngine, failure, run_samples
from taichi_bearings.scene import Scene


@dataclass(frozen=True)
class SceneTask:
    """A scene or a packing to solve, from these spins; those that the settings name if None. number : which of many,
    from 0."""

    number: int
    settings: RunSettings
    scene: Scene | Packing
    spin: np.ndarray | None

    @property
    def key(self) -> str:
        return str(self.number)

    @property
    def label(self) -> str:
        return f"number {self.number}, {self.scene}"

    def job(self, threads: int) -> Job:
        """What solves it; InputError for what cannot be. threads : where the settings leave them open."""
        settings = replace(self.settings, threads=self.settings.threads or threads)
        if isinstance(self.scene, Packing):
            return Job(settings, Packings((self.scene,)), self.spin)
        assert self.spin is not None
        return job_of(settings, self.scene, self.spin)


def solve_tasks(tasks: Sequence[SceneTask]) -> list[dict[str, Any]]:
    """In a worker: a record of each, with its `run`, or why there is none."""
    records = []
    with one_thread():
        for task in tasks:
            try:
                run = task.job(threads=1).solve()
                record = {"key": task.key, "scalars": {"status": run.status[0].value}, "run": run}
            except Exception as error:
                record = failure(task, error)
            records.append(record)
    return records


def solve_all(tasks: Sequence[SceneTask], workers: int) -> Iterator[tuple[int, Run]]:
    """The number and the answer of each, as they come; BearingsError for the first that has none."""
    by_key = {task.key: task for task in tasks}
    with closing(LocalEngine(solve_tasks, workers)) as engine:
        units = [(task,) for task in tasks]
        for records in run_samples(units, engine):
            for record in records:
                task = by_key.pop(record["key"])
                if "run" not in record:
                    raise BearingsError(f"scene {task.label} has no answer: {record['scalars']['error']}")
                run, scene = record["run"], task.scene
                of = Packings((scene,)) if isinstance(scene, Packing) else scene
                solution = replace(run.solution, scene=of)
                yield task.number, replace(run, settings=task.settings, solution=solution)
