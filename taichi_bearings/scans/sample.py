"""Solves what workers are given: samples of a scan, one by one or many seeds at once, and scenes that a user has made.

Seeds are solved together only where that changes no bit of their results.
"""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from taichi_bearings.analysis.histogram import count_powers
from taichi_bearings.errors import BearingsError, InputError, WriteError
from taichi_bearings.files.scan_file import BINS_PER_DECADE
from taichi_bearings.files.whole_file import make_folder
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.plain_files import Json
from taichi_bearings.quantities import plain
from taichi_bearings.runs.job import Job
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.run import run_kind_of
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.writing import self_contained, write_state
from taichi_bearings.scans.engine import LocalEngine, failure, refuse_in_worker, run_samples
from taichi_bearings.scans.plan import Sample, files_of, groups_of, sample_key, spheres_of
from taichi_bearings.scene import Bearing

STATES = "states"  # folder of the full states
LISTS = ("planes_crossed", "driving_torque")  # lists where they are known, which a table cannot hold


class Interrupted(SystemExit):
    """Raised if the solve was interrupted from outside: what it has reached is no result, and the worker ends."""


def solve_samples(samples: Sequence[Sample], analyse: bool = False, states: Path | None = None) -> list[Json]:
    """Solve samples and return a record of each, in their order.

    samples : what is solved.
    analyse : True to compute the numbers of `bearings analyse`, too.
    states : folder for the full states; None to store none.

    A record is valid JSON: `key`; `scalars`, the numbers and texts in the summary of `bearings run` for that sample
    alone; `bins`, number of slipping contacts by number of the power bin. A sample whose solve raises an exception
    gets the status failed, with the reason as `error`, and `final` if another try is pointless. If the disk failed and
    not the sample, the record has `unwritten`, and the samples after it are not tried.
    """
    records: dict[str, Json] = {}
    with one_thread():
        for block in _blocks(samples):
            try:
                found = _solve_block(block, analyse, states)
            except WriteError as error:
                unwritten = {"unwritten": True}
                return [records.get(sample.key) or failure(sample, error) | unwritten for sample in samples]
            except Exception as error:
                if len(block) == 1:
                    found = [failure(block[0], error)]
                else:
                    found = [record for sample in block for record in solve_samples([sample], analyse, states)]
            records |= {sample.key: record for sample, record in zip(block, found, strict=True)}
    return [records[sample.key] for sample in samples]


def _blocks(samples: Sequence[Sample]) -> Iterator[list[Sample]]:
    """Yield lists of samples that are solved together as one scene: they differ in their seeds only, and each gets the
    same bits as if it were solved alone. A sample that cannot be solved together with others is a list of its own.
    """
    for group in groups_of(samples):
        yield from [group] if _are_solved_together(group) else [[sample] for sample in group]


def _are_solved_together(group: Sequence[Sample]) -> bool:
    """Return True if samples that differ in their seeds can be solved together. It is False for a packing that cannot
    be read: each sample then reports that itself.

    group : the samples.
    """
    settings = group[0].settings
    try:
        return len(group) > 1 and run_kind_of(settings).are_solved_together(settings, spheres_of(settings))
    except BearingsError:
        return False


def _solve_block(block: Sequence[Sample], analyse: bool, states: Path | None) -> list[Json]:
    """Solve a block of samples that differ in their seeds, and return their records.

    block : the samples.
    analyse : True to compute the numbers of `bearings analyse` as well.
    states : folder for the full states; None to store none.
    """
    first = block[0].settings
    # the key has a hash of the files: if it differs, a file has changed
    files = [file for _, file in files_of(first)]
    if files and sample_key(first) != block[0].key:
        raise InputError(
            f"{' or '.join(files)} has changed since the scan began; start the same scan again to use the new file"
        )
    asked = replace(first, threads=first.threads or 1)
    found = run_kind_of(first).job_of_seeds(asked, [sample.settings.seed for sample in block]).solve()
    if found.interrupted:
        raise Interrupted
    # store the full state of each sample, if asked for, and make the records
    runs = [found.sample(number) for number in range(len(block))]
    for sample, run in zip(block, runs, strict=True):
        if states is not None:
            make_folder(states)
            path = state_path(states, sample.key)
            stored = replace(run.asked, threads=first.threads)
            stored = self_contained(stored, run.scene, run.given_start, states, path.name)
            write_state(path, replace(run, path=path, command="bearings scan"), stored)
    return [_record(sample.key, run, analyse) for sample, run in zip(block, runs, strict=True)]


def _record(key: str, run: Result, analyse: bool) -> Json:
    """Return the record of a sample: key, numbers and texts, and counts of contacts by bin of power. Shapes are written
    as tables show them; numbers that are not finite become None.

    key : key of the sample.
    run : its result.
    analyse : True to add the numbers of `bearings analyse`.
    """
    answer = run.solution
    scalars = run.numbers | run.asked.driving | {"slip_threshold": answer.slip_threshold}
    if analyse:
        from taichi_bearings.analysis.structure import structure_of

        scalars |= structure_of(answer).numbers
    counts = count_powers(answer.power_per_contact, answer.state, BINS_PER_DECADE)
    bins = {str(number): many for number, many in enumerate(counts.count[0].tolist(), start=counts.first) if many}
    record = {name: plain(value) for name, value in scalars.items() if name not in LISTS}
    # an empty list, for packings without shape and runs without warnings, is left out below, like all lists
    record["shape"] = "x".join(map(str, record["shape"] or ())) or []
    record["warnings"] = "; ".join(record["warnings"]) or []
    record = {
        name: value for name, value in record.items() if value is None or isinstance(value, (bool, int, float, str))
    }
    return {"key": key, "scalars": record, "bins": bins}


def state_path(folder: Path, key: str) -> Path:
    """Return the path of the file with the full state of a sample, which has the layout of run.h5.

    folder : folder of the states.
    key : key of the sample.
    """
    return folder / f"{key}.h5"


@dataclass(frozen=True)
class JobTask:
    """One of many jobs to be solved by workers.

    key : its number, counted from 0, as a text.
    scene : the Scene or Packing of the user.
    job : the run that solves it.
    """

    key: str
    scene: Bearing
    job: Job

    @property
    def label(self) -> str:
        """The job in words, for messages: its number and its scene."""
        return f"number {self.key}, {self.scene}"

    @property
    def settings(self) -> RunSettings:
        """The settings of the run."""
        return self.job.settings


def solve_tasks(tasks: Sequence[JobTask]) -> list[Json]:
    """Solve jobs in a worker, and return a record of each: with its result as `run`, or with the reason why there is
    none. Each job uses one thread where its settings leave that open.

    tasks : the jobs.
    """
    records = []
    with one_thread():
        for task in tasks:
            try:
                run = replace(task.job, settings=replace(task.settings, threads=task.settings.threads or 1)).solve()
                records.append({"key": task.key, "scalars": {"status": run.ended[0].value}, "run": run})
            except Exception as error:
                records.append(failure(task, error))
    return records


def solve_all(tasks: Sequence[JobTask], workers: int) -> Iterator[Result]:
    """Yield the results of jobs as they come; the scene of each result is the object that the user gave, not a copy.

    tasks : the jobs.
    workers : number of processes.

    Raises BearingsError for the first job without a result, and InputError if it is called in a worker process.
    """
    refuse_in_worker()
    with closing(LocalEngine(solve_tasks, workers)) as engine:
        for records in run_samples([(task,) for task in tasks], engine):
            for record in records:
                task = tasks[int(record["key"])]
                if "run" not in record:
                    raise BearingsError(f"scene {task.label} has no answer: {record['scalars']['error']}")
                run = record["run"]
                solution = replace(run.solution, scene=task.job.scene)
                yield replace(run, asked=task.settings, solution=solution)
