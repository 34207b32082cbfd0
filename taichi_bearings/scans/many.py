"""Scenes that somebody has made, solved by the workers of scans."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taichi_bearings.errors import BearingsError, InputError
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.runs.run import Run, job_of, solve_job
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.engine import LocalEngine, run_samples
from taichi_bearings.scans.sample import failure
from taichi_bearings.scene import Scene


@dataclass(frozen=True)
class SceneTask:
    """A scene to solve, from these spins. number : which of many, from 0."""

    number: int
    settings: RunSettings
    scene: Scene
    spin: np.ndarray

    @property
    def key(self) -> str:
        return str(self.number)

    @property
    def label(self) -> str:
        return f"number {self.number}, {self.scene}"


def solve_tasks(tasks: Sequence[SceneTask]) -> list[dict[str, Any]]:
    """In a worker: a record of each, with the answer as `solution`, or why there is none."""
    records = []
    with one_thread():
        for task in tasks:
            try:
                settings = replace(task.settings, threads=task.settings.threads or 1)
                solution = solve_job(job_of(settings, task.scene, task.spin))
                record = {"key": task.key, "scalars": {"status": solution.status.value}, "solution": solution}
            except Exception as error:
                record = failure(task, error)
            records.append(record)
    return records


def solve_all(tasks: Sequence[SceneTask], workers: int) -> Iterator[tuple[int, Run]]:
    """The number and the answer of each, as they come; BearingsError for the first that has none."""
    by_key = {task.key: task for task in tasks}
    with closing(LocalEngine(solve_tasks, workers)) as engine:
        units = [(task,) for task in tasks]
        for records in run_samples(units, engine, lambda *_: None, failure):
            for record in records:
                task = by_key.pop(record["key"])
                if "solution" not in record:
                    kind = InputError if record.get("final", False) else BearingsError
                    raise kind(f"scene {task.label} has no answer: {record['scalars']['error']}")
                solution = replace(record["solution"], scene=task.scene)
                yield task.number, Run(task.settings, solution, task.spin)
