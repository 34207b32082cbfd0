"""Runs a scan from its plan: solves missing samples, records each in a journal, and collects all in scan.h5."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from taichi_bearings.errors import FileError, InputError, warn
from taichi_bearings.files.scan_file import write_scan
from taichi_bearings.files.scan_journal import JOURNAL_NAME as JOURNAL
from taichi_bearings.files.scan_journal import Journal
from taichi_bearings.interrupts import awaited, keep
from taichi_bearings.plain_files import Json, refuse_link_out, replace_file
from taichi_bearings.runs.run import run_kind_of
from taichi_bearings.runs.run_directory import tidy, writable_folder
from taichi_bearings.runtime import available_threads, refuse_absent
from taichi_bearings.scans import estimate as cost
from taichi_bearings.scans import parts
from taichi_bearings.scans.engine import LocalEngine, Record, Unit, run_samples
from taichi_bearings.scans.plan import Sample, ScanPlan, groups_of
from taichi_bearings.scans.sample import STATES, solve_samples, state_path
from taichi_bearings.scans.stored_scans import attributes_of, columns_of, histograms_of, outdated_figures
from taichi_bearings.scene import LAWS, Status
from taichi_bearings.solvers.table import MethodOptions
from taichi_bearings.words import shown

if TYPE_CHECKING:
    from distributed import Client

REWRITE = 60.0  # least seconds between two writings of scan.h5 while a scan runs
REACHED_STATUS = [status.value for status in Status if status.reached]
LEAST_ALLOWED, ALLOWED = 600.0, 100.0  # a sample may take so many seconds or, if that is more, times its estimate


@dataclass
class ScanProgress:
    """The progress of a scan.

    total : number of samples in all.
    before : number of those with a result from earlier calls.
    done : number of those with a result, `before` included.
    failed : number of those that have failed.
    running : samples in work, the first of each unit of samples that are solved together.
    seconds : time since the start of this call.
    seconds_left : estimated time left; None while it is not known.
    """

    total: int
    before: int
    done: int = 0
    failed: int = 0
    running: list[Sample] = field(default_factory=list)
    seconds: float = 0.0
    seconds_left: float | None = None

    @property
    def rate(self) -> float:
        """Samples a second of this call."""
        return (self.done + self.failed - self.before) / max(self.seconds, 1e-9)


Monitor = Callable[[ScanProgress], None]


def missing_samples(
    plan: ScanPlan, folder: Path, part: parts.Part | None = None
) -> tuple[list[Sample], dict[str, Record]]:
    """Return the samples that still have to be solved, and the records that the folder has, by key. Samples have to be
    solved if the folder lacks them, if they failed there, or if they lack something that is asked for now.

    plan : the samples asked for.
    folder : folder of the scan.
    part : part of the scan that is solved; None for the whole scan.

    Raises FileError if the folder holds samples that the plan does not ask for, or something else altogether.
    """
    names = [file.name for file in folder.iterdir() if file.name[0] != "."] if folder.is_dir() else []
    if names and JOURNAL not in names and not any(name.startswith("scan.toml") for name in names):
        raise FileError(f"{folder} is not the folder of a scan and not empty; choose another --out")
    records = parts.read_journals(folder)
    others = len(records.keys() - {sample.key for sample in plan.samples})
    if others:
        raise FileError(
            f"{folder} holds {others:,} samples that this scan does not ask for; choose another --out, or a scan with "
            "all of them"
        )

    def is_kept(sample: Sample) -> bool:
        """Return True if the folder has all that is asked for of this sample."""
        record, options, state = records.get(sample.key), plan.options, state_path(folder / STATES, sample.key)
        if record is None or parts.is_failed(record) or (options.get("analyse") and not parts.is_analysed(record)):
            return False
        if not options.get("keep_states") or not state.is_file():
            return not options.get("keep_states")
        from taichi_bearings.runs.run_file import read_run

        try:
            read_run(state)
        except FileError as error:
            warn(f"a kept state is taken for missing: {error}")
            return False
        return True

    return [sample for sample in parts.part_of(plan, part).samples if not is_kept(sample)], records


def refuse_unused(plan: ScanPlan, folder: Path, is_here: bool = False) -> None:
    """Raise InputError for a setting that no method and no law of the scan uses, and for samples that cannot be solved.
    Where the scan continues in its folder, an unused setting is only named in a warning.

    plan : all samples of the scan with their settings.
    folder : folder of the scan.
    is_here : True if the scan is solved on this machine.
    """
    found, used = dict[str, str](), set[str]()
    for group in groups_of(plan.samples):  # samples of a group differ in the seed only
        settings = group[0].settings
        if not LAWS[settings.law].is_sum:
            known = ", ".join(name for name, law in LAWS.items() if law.is_sum)
            raise InputError(
                f"law is {shown(settings.law)}, a law of your own; scans allow {known}, as their processes do not "
                "import the file that defines another law; solve its scenes with taichi_bearings.solve_many"
            )
        runs = run_kind_of(settings)
        runs.refuse(settings, has_seeds=len(group) > 1)
        row = runs.row(settings)
        if row.__module__ != MethodOptions.__module__:
            raise InputError(
                f"method is {shown(row.name)}, a method of your own, which scans do not allow, as their processes do "
                "not import the file that registers it; solve its scenes with taichi_bearings.solve_many"
            )
        unused = settings.unused(row)
        if is_here:
            refuse_absent(settings.arch, settings.precision)
        found = unused | found
        used |= settings.given.keys() - unused.keys()
    for sentence in (sentence for key, sentence in found.items() if key not in used):
        if not (folder / "scan.toml").is_file():
            raise InputError(sentence)
        warn(f"{sentence}: it changes nothing here")


def estimate(plan: ScanPlan, folder: Path, workers: int = 0, part: parts.Part | None = None) -> Json:
    """Return what a scan would cost, by name: `samples`, `scanned` settings, `missing` samples, `workers`, `seconds`
    (None if unknown) and `bytes`. Nothing is solved.

    plan : the samples asked for.
    folder : folder of the scan, which may hold some of them.
    workers : largest number of worker processes; 0 for one a processor.
    part : part of the scan that is counted alone; None for the whole scan.
    """
    refuse_unused(plan, folder)
    plan = plan.with_options_of(folder)
    missing, _ = missing_samples(plan, folder, part)
    analyse = bool(plan.options.get("analyse"))
    number = _number_of_workers(missing, workers, analyse)
    seconds = cost.seconds_in_all(missing, number, analyse) + cost.WORKER_START if missing else 0.0
    return {
        "samples": len(parts.part_of(plan, part).samples),
        "scanned": list(plan.scanned),
        "missing": len(missing),
        "workers": number,
        "seconds": seconds if seconds < math.inf else None,
        "bytes": number * max((cost.bytes_of(group[0].settings) for group in groups_of(missing)), default=0.0),
    }


def _number_of_workers(missing: Sequence[Sample], workers: int, analyse: bool) -> int:
    """Return how many worker processes to start, at most as many as pay off.

    missing : samples to be solved.
    workers : largest number, 0 for one a processor.
    analyse : True if the structure of samples is analysed as well.
    """
    on_device = any(sample.settings.arch != "cpu" for sample in missing)
    return cost.paying_workers(missing, workers or (1 if on_device else available_threads()), analyse)


def scan(
    plan: ScanPlan,
    folder: Path,
    workers: int = 0,
    monitor: Monitor = lambda _: None,
    engine: LocalEngine | None = None,
    client: "Client | None" = None,
    part: parts.Part | None = None,
) -> Json:
    """Solve the samples of a plan that `folder` lacks, write scan.h5, scan.csv and scan.toml there, and return the
    report that `--json` prints.

    plan : all samples of the scan with their settings.
    folder : folder of the scan.
    workers : largest number of processes; 0 for one a processor.
    monitor : function that is called now and then with the progress.
    engine : where to solve; None for processes on this machine, or the Dask cluster of `client`.
    client : connection to a Dask cluster, or None.
    part : part of the scan that is solved alone; only its journal is written then. None for the whole scan.

    Ctrl-C and SIGTERM end the scan; finished samples are kept. Samples that lack something that is asked for are solved
    again. Options of the scan itself that the plan lacks are those of the scan.toml in the folder. By default a sample
    may take 100 times the expected time, at least 600 s; there is no limit for dynamics.

    Raises InputError or FileError before anything is computed.
    """
    plan = plan.with_options_of(folder)
    refuse_unused(plan, folder, is_here=engine is None and client is None)
    with writable_folder(folder, "" if part is None else part.name):
        opened = _OpenScan(plan, folder, part, monitor)
        refuse_link_out(folder / STATES)
        if (folder / STATES).is_dir():
            tidy(folder / STATES)
        replace_file(folder / "scan.toml", plan.text.encode())
        engine = engine or _engine(plan, folder, list(opened.missing.values()), workers, client)
        try:
            with awaited() as stopped, closing(engine), Journal(opened.journal) as journal:
                keep()
                opened.follow(engine, journal, stopped)
            opened.write_files()
        except FileError as error:
            kept = len(parts.read_journals(folder))  # samples that did fit on the disk are among them
            raise FileError(f"{error}; {kept:,} samples are kept in {folder}, and the same command continues") from None
    return opened.report(stopped.is_set()) | {"workers": engine.workers}


def merge(plan: ScanPlan, folder: Path) -> Json:
    """Write scan.h5 and scan.csv from the journals of all parts of a scan, be they complete or not. Return the report
    that `--json` prints of a scan, with `incomplete_parts`, the parts that lack samples and how many.

    plan : all samples of the scan with their settings.
    folder : folder of the scan.

    Raises FileError if the folder has no samples of this scan.
    """
    if not folder.is_dir():
        raise FileError(f"{folder} is not the folder of a scan")
    plan = plan.with_options_of(folder)
    with writable_folder(folder):
        opened = _OpenScan(plan, folder)
        if not opened.records:
            raise FileError(f"{folder} holds no samples of this scan; solve its parts first, with --part i/n")
        opened.write_files()
        return opened.report(False) | {"incomplete_parts": parts.incomplete_parts(plan, folder, opened.records)}


def _engine(
    plan: ScanPlan, folder: Path, missing: Sequence[Sample], workers: int, client: "Client | None"
) -> LocalEngine:
    """Return the engine that solves the missing samples: on a Dask cluster, or in processes on this machine.

    plan : all samples of the scan with their settings.
    folder : folder of the scan.
    missing : samples to be solved.
    workers : largest number of processes; 0 for one a processor.
    client : connection to a Dask cluster; None for this machine.
    """
    analyse, states = bool(plan.options.get("analyse")), plan.options.get("keep_states")
    work = partial(solve_samples, analyse=analyse, states=(folder / STATES).absolute() if states else None)
    allowed = partial(_allowed_seconds, sample_timeout=plan.options.get("sample_timeout"), analyse=analyse)
    if client is None:
        return LocalEngine(work, _number_of_workers(missing, workers, analyse), allowed)
    from taichi_bearings.scans.cluster import DaskEngine

    return DaskEngine(client, work, allowed)


def _allowed_seconds(unit: Unit, sample_timeout: float | None, analyse: bool) -> float:
    """Return the seconds that a unit of samples, which are solved together, may take.

    unit : the samples.
    sample_timeout : limit for one sample that the user has set, or None.
    analyse : True if the structure is analysed as well.
    """
    if sample_timeout is not None:
        return sample_timeout * len(unit)
    return max(LEAST_ALLOWED, ALLOWED * sum(cost.seconds_of(sample.settings, analyse) for sample in unit))


class _OpenScan:
    """A scan in its folder, while it is solved: its missing samples, its records so far, its journal and its progress.

    plan : the samples asked for.
    folder : folder of the scan.
    part : part of the scan that is solved alone; None for the whole scan.
    monitor : function that is called now and then with the progress.
    """

    def __init__(
        self, plan: ScanPlan, folder: Path, part: parts.Part | None = None, monitor: Monitor = lambda _: None
    ) -> None:
        """Read what the folder holds, and find which samples are missing."""
        self.began = time.monotonic()
        self.next_write = self.began + REWRITE  # time at which scan.h5 is to be written again
        self.plan, self.folder, self.monitor = parts.part_of(plan, part), folder, monitor
        self.journal = folder / (JOURNAL if part is None else f"{part.name}.jsonl")
        # files that are made of the records; those of parts are made by `merge`
        self.files = [folder / name for name in ("scan.h5", "scan.csv")] if part is None else []
        self.other_journals = sum(file.stat().st_size for file in parts.journals_in(folder) if file != self.journal)
        missing, self.records = missing_samples(plan, folder, part)
        self.missing = {sample.key: sample for sample in missing}  # samples that still lack something
        before = len(self.plan.samples) - len(missing)
        self.progress = ScanProgress(len(self.plan.samples), before, done=before)
        self.removed: list[Path] = []

    def follow(self, engine: LocalEngine, journal: Journal, stopped: threading.Event) -> None:
        """Have the missing samples solved and recorded, until all are done or `stopped` is set.

        engine : what solves them.
        journal : the journal, opened for appending.
        stopped : event that Ctrl-C or SIGTERM sets.
        """
        analyse, missing = bool(self.plan.options.get("analyse")), list(self.missing.values())
        units, work = cost.units_of(missing, analyse, engine.workers or 1), cost.WorkLeft(missing, analyse)
        for finished in run_samples(units, engine):
            self.progress.seconds = time.monotonic() - self.began
            if finished:
                self._record_finished(finished, work, journal)
                continue
            running, workers = engine.running, max(engine.workers, 1)
            self.progress.running = [unit[0] for unit in running]
            self.progress.seconds_left = work.seconds_left(running, workers, self.progress.seconds)
            self.monitor(self.progress)
            if stopped.is_set():
                return
            if self.files and (began := time.monotonic()) > self.next_write:
                self._write()
                written = time.monotonic()
                self.next_write = written + max(REWRITE, 50 * (written - began))  # at most 2 % of the time is writing

    def _record_finished(self, finished: Sequence[Record], work: cost.WorkLeft, journal: Journal) -> None:
        """Record finished samples in the journal and count them. A failure does not replace an earlier result.

        finished : their records.
        work : the estimate of the work left.
        journal : the journal, opened for appending.
        """
        news = [record for record in finished if not (parts.is_failed(record) and self._has_result(record["key"]))]
        journal.append(news)
        self.records |= {record["key"]: record for record in news}
        for record in finished:
            sample = self.missing[record["key"]]
            work.finish(sample, record)
            if parts.is_failed(record):
                self.progress.failed += 1
                warn(f"sample {sample.label} failed: {record['scalars']['error']}")
            else:
                self.progress.done += 1
                del self.missing[sample.key]

    def _has_result(self, key: str) -> bool:
        """Return True if the sample with this key has a result already."""
        return key in self.records and not parts.is_failed(self.records[key])

    def _write(self, removes: bool = False) -> None:
        """Write scan.h5 and scan.csv, each in full or not at all, with rows in the order of the plan. scan.h5 stores
        the size of the journals whose records it holds, so that readers see whether it is up to date.

        removes : True to remove figures that are out of date first.
        """
        journals = self.other_journals + (self.journal.stat().st_size if self.journal.exists() else 0)
        self.removed = outdated_figures(self.folder, journals) if removes else []
        for figure in self.removed:
            figure.unlink(missing_ok=True)
        columns, histograms = columns_of(self.plan, self.records), histograms_of(self.plan, self.records)
        write_scan(self.folder, columns, histograms, attributes_of(self.plan, journals))

    def write_files(self) -> None:
        """Write scan.h5 and scan.csv at the end, and remove figures that show the scan as it was before. Parts write
        neither.
        """
        if self.files:
            with awaited():
                self._write(removes=True)

    def report(self, interrupted: bool) -> Json:
        """Return the report that `--json` prints, by name.

        interrupted : True if the scan was stopped early.

        * samples: number of samples of the scan. Each is in one of `done` (with a result), `failed` (with an error
          instead; `failures` lists them) and `missing` (not yet solved).
        * solved_now, seconds: number of samples solved in this call, and how long it took.
        * reached, warned, unanalysed: numbers of results that reached what was asked, that have warnings, and that have
          no analysis although others have one.
        * lacking: number of samples with a result that lacks something asked for now, such as an analysis; they are
          solved again.
        * interrupted: True if the scan was stopped early and work was left.
        * scan, files, removed: paths of the folder, of the files written, and of outdated figures that were removed.
        """
        known = [(sample, self.records[sample.key]) for sample in self.plan.samples if sample.key in self.records]
        solved = [record for _, record in known if not parts.is_failed(record)]
        failed = [(sample, record["scalars"]["error"]) for sample, record in known if parts.is_failed(record)]
        lacking = sum(map(self._has_result, self.missing))
        analysed, missing = sum(map(parts.is_analysed, solved)), len(self.plan.samples) - len(known)
        return {
            "samples": len(self.plan.samples),
            "done": len(solved),
            "solved_now": self.progress.done - self.progress.before,
            "reached": sum(record["scalars"]["status"] in REACHED_STATUS for record in solved),
            "failed": len(failed),
            "warned": sum("warnings" in record["scalars"] for record in solved),
            "missing": missing,
            "lacking": lacking,
            "unanalysed": len(solved) - analysed if analysed else 0,
            "failures": [{"sample": sample.label, "error": error} for sample, error in failed],
            "interrupted": interrupted and (missing > 0 or lacking > 0),
            "seconds": time.monotonic() - self.began,
            "scan": str(self.folder),
            "files": [str(file) for file in self.files or [self.journal]],
            "removed": [str(file) for file in self.removed],
        }
