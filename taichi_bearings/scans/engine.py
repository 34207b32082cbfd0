"""Solves many samples in worker processes; if one of these fails, only the sample that it was solving is lost.

An engine takes *units* of work (a few samples each) and returns their *records*, or the reason why there are none.
:func:`run_samples` decides what to do about units that fail, for every engine alike. Workers are never copies of this
process, whose threads a copy would lack (copies.py).
"""

import contextlib
import logging
import math
import multiprocessing
import multiprocessing.connection
import os
import pickle
import signal
import threading
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from taichi_bearings import runtime
from taichi_bearings.copies import Original, take_original
from taichi_bearings.errors import BearingsError, InputError, WriteError, warn
from taichi_bearings.files.scan_file import FAILED
from taichi_bearings.later import collect_cycles_seldom
from taichi_bearings.memory import keep_freed
from taichi_bearings.plain_files import Json

Unit = tuple[Any, ...]
"""Tasks that can be pickled: samples of a scan, or scenes that a user has made. Each has key, label and settings."""
Record = Json  # result of a task as JSON, see sample.solve_samples
Work = Callable[[Sequence[Any]], list[Record]]  # solves the tasks of a unit
TRIES = 2  # how often each sample is tried
HOPELESS = 10  # a scan ends with an error if so many workers in a row end without a result, before there is any result
LOOK_SECONDS = 0.2  # seconds between looks at what else is going on
KEEPING_SECONDS = 5.0  # seconds that an idle worker may take to keep its compiled kernels and end
WORKER_NAME = "bearings-worker"  # name of the worker processes
IDLE_SECONDS = 60.0  # seconds without work after which a worker ends
DASK_REASONS = {"KilledWorker": "its Dask workers were lost", "CancelledError": "Dask has cancelled it"}
LONGEST_WAIT = 2e6  # most seconds to wait at once: the system counts milliseconds in 31 bits


@dataclass(frozen=True)
class Outcome:
    """The outcome of a unit of work, a tuple of samples that were solved together.

    unit : the samples, or other tasks.
    records : result of each, as JSON; None if there are none.
    reason : why there are none, in words.
    """

    unit: Unit
    records: list[Record] | None
    reason: str = ""


def failure(task: Any, reason: Exception | str) -> Record:
    """Return the record of a sample that has no result. After an InputError the record is marked as final: another try
    is pointless.

    task : the sample.
    reason : the exception, or words.
    """
    words = str(reason) if isinstance(reason, (str, BearingsError)) else f"{type(reason).__name__}: {reason}"
    if isinstance(reason, Exception):
        logging.getLogger(__name__).debug("sample %s", task.label, exc_info=reason)
    record: Record = {"key": task.key, "scalars": {"status": FAILED, "error": words}, "bins": {}}
    return record | ({"final": True} if isinstance(reason, InputError) else {})


def run_samples(units: Sequence[Unit], engine: "LocalEngine") -> Iterator[list[Record]]:
    """Solve all units (tuples of samples); yield lists of records as samples finish or fail, and empty lists in
    between, at least every LOOK_SECONDS.

    units : the samples of each unit are solved together.
    engine : what solves them.

    A unit that fails as a whole is split into its samples. A sample that fails is named in a warning and tried once
    more, at the end and alone, so that it has all memory for itself.

    Raises BearingsError if worker after worker ends without any result, WriteError if results cannot be written.
    """
    waiting, retries, tries = deque(units), deque[Unit](), Counter[str]()
    lost_in_a_row, any_result = 0, False
    while waiting or retries or engine.running:
        # Send as many units as the engine takes; samples that failed once come at the end, one at a time.
        while engine.can_take_unit and waiting:
            engine.submit(waiting.popleft())
        if retries and not waiting and not engine.running:
            engine.submit(retries.popleft())
        yield []
        finished: list[Record] = []
        unwritten = ""
        # A unit without any result is split into its samples; a sample without a result is tried once more.
        for outcome in engine.collect(LOOK_SECONDS):
            lost_in_a_row = lost_in_a_row + 1 if outcome.records is None else 0
            any_result |= outcome.records is not None
            if outcome.records is None and len(outcome.unit) > 1:
                waiting.extend((sample,) for sample in outcome.unit)
                continue
            records = outcome.records or [failure(sample, outcome.reason) for sample in outcome.unit]
            for sample, record in zip(outcome.unit, records, strict=True):
                if record.get("unwritten", False):
                    unwritten = record["scalars"]["error"]
                    continue
                tries[sample.key] += 1
                may_succeed = record["scalars"]["status"] == FAILED and not record.pop("final", False)
                if may_succeed and tries[sample.key] < TRIES:
                    warn(f"sample {sample.label} failed and is tried again: {record['scalars']['error']}")
                    retries.append((sample,))
                else:
                    finished.append(record)
        if finished:
            yield finished
        if unwritten:
            raise WriteError(unwritten)
        if lost_in_a_row >= HOPELESS and not any_result:
            raise BearingsError(f"{lost_in_a_row} worker processes in a row ended without a result: {outcome.reason}")


class LocalEngine:
    """An engine that solves units of samples in processes on this machine. Each of its threads starts one process when
    needed.

    work : function that solves a unit, run in the process; it must be possible to pickle it.
    workers : largest number of units that are solved at a time.
    allowed : function that returns the seconds that a unit may take; by default no limit.
    """

    def __init__(self, work: Work, workers: int, allowed: Callable[[Unit], float] = lambda unit: math.inf) -> None:
        """Store the attributes, and begin without processes."""
        self.work, self.workers, self.allowed = work, workers, allowed
        self.name = uuid.uuid4().hex
        self.executor: Executor = ThreadPoolExecutor(workers)
        self._units = dict[Future[Solved], Unit]()

    @property
    def running(self) -> list[Unit]:
        """Units that were submitted and whose outcomes have not been collected yet."""
        return list(self._units.values())

    @property
    def can_take_unit(self) -> bool:
        """True if a worker is free, so that a unit (tuple of samples) that is submitted now is begun at once."""
        return len(self._units) < self.workers

    def sent(self, unit: Unit) -> Unit:
        """Return a unit of samples in the form in which it is sent to workers: here unchanged."""
        return unit

    def submit(self, unit: Unit) -> None:
        """Begin to solve a unit, in another thread; :meth:`collect` returns its outcome."""
        self._units[self.executor.submit(solve_unit, self.sent(unit), self.name, self.work, self.allowed)] = unit

    def collect(self, seconds: float) -> list[Outcome]:
        """Return the outcomes of units that have ended since the last call; wait for the first, but for at most so many
        seconds.
        """
        found, (done, _) = list[Outcome](), wait(self._units, seconds, FIRST_COMPLETED)
        for future in done:
            unit = self._units.pop(future)
            try:
                found.append(Outcome(unit, *future.result()))
            except Exception as error:
                kind = type(error).__name__
                found.append(Outcome(unit, None, DASK_REASONS.get(kind, f"{kind}: {error}")))
        return found

    def close(self) -> None:
        """Stop all workers. Busy ones are killed at once and lose what they are solving; idle ones end after they have
        saved their compiled kernels to disk.
        """
        end_solvers(self.name)
        self.executor.shutdown()


Solved = tuple[list[Record] | None, str]  # the records of a unit, or the reason why there are none
_solvers: dict[tuple[str, int], "_Solver"] = {}  # by engine and thread of this process
_originals: dict[str, Original] = {}  # by engine, the process that has loaded the program, which workers are copies of
_closed: set[str] = set()  # names of engines that are closed
_one_at_a_time = threading.Lock()  # to start or end a process: at each start multiprocessing checks all others


def solve_unit(unit: Unit, engine: str, work: Work, allowed: Callable[[Unit], float]) -> Solved:
    """Solve a unit, a tuple of samples, in the worker process that belongs to this thread. Return their records and "",
    or None and the reason why there are none.

    unit : the samples.
    engine : name of the engine.
    work : function that solves a unit.
    allowed : function that returns the seconds that the unit may take.
    """
    return _solvers.setdefault((engine, threading.get_ident()), _Solver(engine, work)).solve(unit, allowed(unit))


def end_solvers(engine: str) -> None:
    """End the worker processes of an engine: busy ones are killed; idle ones save their compiled kernels for later
    processes. A thread that waits for an answer then gets the reason why there is none.

    engine : name of the engine.
    """
    _closed.add(engine)
    if engine in _originals:
        _originals[engine].give_up()  # a thread may wait until this process has loaded the program
    with _one_at_a_time:
        ended = [_solvers.pop(key) for key in list(_solvers) if key[0] == engine]
        for solver in ended:
            solver.dismiss()
        for process in (solver.process for solver in ended):
            if process is not None:
                process.join(KEEPING_SECONDS)
                process.kill()
                process.join()
        if engine in _originals:
            _originals.pop(engine).end()


@dataclass
class _Solver:
    """The worker process of one thread, which solves units (tuples of samples) one after the other. It is started with
    the first unit, and started again if it has ended, or for another device: a process can have one Taichi runtime
    only.

    engine : name of the engine.
    work : function that solves a unit.
    process : the process; None while there is none.
    """

    engine: str
    work: Work
    process: BaseProcess | None = None
    _device: tuple[str, str, int] | None = None
    _at_work: bool = False

    def solve(self, unit: Unit, seconds: float) -> Solved:
        """Return the records of a unit of samples and "", or None and the reason why there are none.

        unit : the samples.
        seconds : the most that the process may take; then it is killed.
        """
        self._at_work = True
        try:
            return self._solved(unit, seconds)
        finally:
            self._at_work = False

    def dismiss(self) -> None:
        """Kill the process if it is at work, else close its pipe, so that it ends by itself."""
        if self.process is not None:
            if self._at_work:
                self.process.kill()
            else:
                self._pipe.close()

    def _solved(self, unit: Unit, seconds: float) -> Solved:
        """Have the process solve a unit of samples. Return their records and "", or None and the reason why there are
        none.

        unit : the samples.
        seconds : the most that the process may take.
        """
        settings = unit[0].settings
        device = (settings.arch, settings.precision, settings.threads)
        # an idle process has an answer only if it has ended
        if self.process is not None and (self._device != device or self._has_answer(0)):
            self._end()
        try:
            if self.process is None:
                self._start()
                self._device = device
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                self._pipe.send(unit)
            if not self._has_answer(seconds):
                self._end()
                return None, f"no result within {seconds:g} s"
            records, health = self._pipe.recv()  # True if the process can go on
            if records is None:  # it could not load the unit and ends; `health` says why
                self._end()
                return None, str(health)
        except (EOFError, OSError, pickle.UnpicklingError):  # it has ended, perhaps amid a message
            return None, self._end()
        if not health:
            self._end()
        return records, ""

    def _has_answer(self, seconds: float) -> bool:
        """Return True if the process sends something, or ends, within so many seconds."""
        return bool(multiprocessing.connection.wait([self._pipe], min(seconds, LONGEST_WAIT)))

    def _start(self) -> None:
        """Start the process, a copy of the engine's original (copies.py), and wait until it says that it has started.
        Raises EOFError if the engine is closed.
        """
        multiprocessing.current_process().daemon = False  # where Dask has set this, no process could be started
        with _one_at_a_time:
            if self.engine in _closed:
                raise EOFError
            original = _originals.get(self.engine) or take_original()
            _originals[self.engine] = original
            self._pipe, theirs = multiprocessing.Pipe()
            self.process = original.start(serve, (theirs, pickle.dumps(self.work)), WORKER_NAME)
            theirs.close()
        self._pipe.recv()  # that it has started

    def _end(self) -> str:
        """End the process, and return in words how it ended."""
        with _one_at_a_time:
            process, self.process = self.process, None
            if process is None:
                return "no worker could be started"
            self._pipe.close()
            process.join(0.5)
            if alive := process.exitcode is None:
                process.kill()
                process.join()
            code = process.exitcode or 0
            process.close()
        if alive:
            return "the worker no longer answered"
        if code >= 0:
            return f"the worker ended with exit code {code}"
        name = signal.Signals(-code).name if -code in {s.value for s in signal.Signals} else f"signal {-code}"
        return f"the worker was ended by {name}" + (" (out of memory?)" if name == "SIGKILL" else "")


def refuse_in_worker() -> None:
    """Raise InputError if this is a worker process: its workers would start workers, too, without end."""
    if multiprocessing.current_process().name == WORKER_NAME:
        raise InputError(
            "a module that a worker process imports calls solve_many itself; put such calls under "
            "`if __name__ == '__main__'`"
        )


def serve(pipe: Connection, pickled_work: bytes) -> None:
    """Solve units (tuples of samples) as they come through a pipe, and send back their records: the main loop of a
    worker process.

    pipe : connection to the parent process.
    pickled_work : function that solves a unit, pickled; unpickling it loads most of the program.

    The loop ends when the pipe or the parent ends, or after IDLE_SECONDS without work. After an exception the process
    sends what it has and ends, as its state may be damaged. Otherwise it saves its compiled kernels for later
    processes, if there is a parent that waits for that.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent alone
    threading.Thread(target=_end_with_parent, daemon=True).start()
    collect_cycles_seldom()
    keep_freed()
    work: Work = pickle.loads(pickled_work)
    with contextlib.suppress(OSError):  # if memory runs out, Linux ends a worker first, not the scan
        Path("/proc/self/oom_score_adj").write_text("500")
    healthy, parent = True, multiprocessing.parent_process()
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError), pipe:
        pipe.send("started")
        while healthy and pipe.poll(IDLE_SECONDS):
            try:
                unit = pipe.recv()
            except (AttributeError, ImportError, BearingsError) as error:  # raised by a module that it has to import
                pipe.send((None, f"a worker process cannot load what is solved: {error}"))
                return
            records = work(unit)
            healthy = all(r["scalars"]["status"] != FAILED or r.get("final", False) for r in records)
            pipe.send((records, healthy))
    if healthy and parent is not None and parent.is_alive():
        runtime.end()


def _end_with_parent() -> None:
    """End this worker when its parent has ended, so that a killed scan leaves no process behind."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
