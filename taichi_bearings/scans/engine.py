"""Solving many samples in worker processes, of which any may fail: that costs the sample it was at and nothing else.

An engine takes units of work (a few samples each) and tells what became of them; :func:`run_samples` decides what to do
about units that fail, for every engine alike. The local engine starts its workers by spawn: a fork hangs in Taichi.
"""

import contextlib
import logging
import math
import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import threading
import time
import types
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Protocol

from taichi_bearings.errors import BearingsError, InputError, WriteError
from taichi_bearings.files.scan_file import FAILED
from taichi_bearings.interrupts import unheard_by_children
from taichi_bearings.runs.settings import RunSettings


class Task(Protocol):
    """What a worker solves: a sample of a scan, or a scene that somebody has made. It must be possible to pickle it."""

    @property
    def key(self) -> str: ...

    @property
    def label(self) -> str: ...

    @property
    def settings(self) -> RunSettings: ...


Unit = tuple[Any, ...]  # of tasks of one kind
Record = dict[str, Any]  # of a task, as in sample.solve_samples
Work = Callable[[Sequence[Any]], list[Record]]
TRIES = 2  # of each sample
HOPELESS = 10  # workers that end one after the other without any result
LOOK_SECONDS = 0.2  # seconds between looks at what else is going on
IDLE_SECONDS = 60.0  # seconds without work after which a worker ends


@dataclass(frozen=True)
class Outcome:
    """What became of a unit: a record of each sample, or the reason why there is none."""

    unit: Unit
    records: list[Record] | None
    reason: str = ""


class Engine(Protocol):
    """Where units of work are solved."""

    @property
    def workers(self) -> int:
        """Units at most that have been or can be in work at a time."""
        ...

    @property
    def has_room(self) -> bool:
        """True if a unit can be submitted that would be begun at once, or soon."""
        ...

    @property
    def running(self) -> list[Unit]:
        """Units that were submitted and of which nothing has been heard yet."""
        ...

    def submit(self, unit: Unit) -> None: ...

    def collect(self, seconds: float) -> list[Outcome]:
        """What has become of units since; waits for that, but no longer than `seconds`."""
        ...

    def close(self) -> None:
        """End all workers at once, whatever they do."""
        ...


def failure(task: Task, reason: Exception | str) -> Record:
    """The record of a sample that has no result."""
    words = str(reason) if isinstance(reason, (str, BearingsError)) else f"{type(reason).__name__}: {reason}"
    if isinstance(reason, Exception):
        logging.getLogger(__name__).debug("sample %s", task.label, exc_info=reason)
    record: Record = {"key": task.key, "scalars": {"status": FAILED, "error": words}, "bins": {}}
    return record | ({"final": True} if isinstance(reason, InputError) else {})


def run_samples(units: Sequence[Unit], engine: Engine) -> Iterator[list[Record]]:
    """Solve all units; gives records of finished samples, failed ones too, as they come, and often none of them.

    A unit that fails as a whole is split into its samples; a sample that fails is named and tried once more, at the end
    and alone, so that it has all memory for itself.
    Raises BearingsError if worker after worker ends without any result, WriteError if results cannot be written.
    """
    waiting, last, tries = deque(units), deque[Unit](), Counter[str]()
    lost, any_result = 0, False
    while waiting or last or engine.running:
        while engine.has_room and waiting:
            engine.submit(waiting.popleft())
        if last and not waiting and not engine.running:
            engine.submit(last.popleft())
        yield []
        finished: list[Record] = []
        unwritten = ""
        for outcome in engine.collect(LOOK_SECONDS):
            lost = lost + 1 if outcome.records is None else 0
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
                again = record["scalars"]["status"] == FAILED and not record.pop("final", False)
                if again and tries[sample.key] < TRIES:
                    words, why = "bearings: sample %s failed and is tried again: %s", record["scalars"]["error"]
                    logging.getLogger(__name__).warning(words, sample.label, why)
                    last.append((sample,))
                else:
                    finished.append(record)
        if finished:
            yield finished
        if unwritten:
            raise WriteError(unwritten)
        if lost >= HOPELESS and not any_result:
            raise BearingsError(f"{lost} workers ended one after the other without a result: {outcome.reason}")


@dataclass
class _Worker:
    """A worker process. unit : what it solves, or will once it has started; since `began`, of the monotonic clock."""

    process: BaseProcess
    pipe: Connection
    device: tuple[str, str, int]
    started: bool = False
    unit: Unit | None = None
    began: float = math.inf

    def send(self) -> None:
        """Hand over the unit. A worker that has ended meanwhile is noticed when it is listened to."""
        self.began = time.monotonic()
        with contextlib.suppress(OSError):
            self.pipe.send(self.unit)


@dataclass
class LocalEngine:
    """Processes on this machine, started as they are needed.

    work : solves a unit in a worker; a function that can be pickled. workers : at most so many at a time.
    allowed : seconds that a unit may take.
    """

    work: Work
    workers: int
    allowed: Callable[[Unit], float] = lambda unit: math.inf
    _pool: list[_Worker] = field(default_factory=list)

    @property
    def running(self) -> list[Unit]:
        return [worker.unit for worker in self._pool if worker.unit is not None]

    @property
    def has_room(self) -> bool:
        return len(self.running) < self.workers

    def submit(self, unit: Unit) -> None:
        settings = unit[0].settings
        device = (settings.arch, settings.precision, settings.threads)  # of the one Taichi runtime a process can have
        for known in [known for known in self._pool if known.unit is None]:
            if multiprocessing.connection.wait([known.pipe], 0):  # it has ended meanwhile
                self._end(known)
        idle = [worker for worker in self._pool if worker.unit is None]
        worker = next((worker for worker in idle if worker.device == device), None)
        if worker is None:
            if len(self._pool) >= self.workers:
                self._end(idle[0])
            context = multiprocessing.get_context("spawn")
            ours, theirs = context.Pipe()
            process = context.Process(target=serve, args=(theirs, self.work), daemon=True, name="bearings-worker")
            worker = _Worker(process, ours, device)
            with _main_left_out(), unheard_by_children():  # the tracker is started without the working folder too
                process.start()
                theirs.close()
                self._pool.append(worker)
        worker.unit = unit
        if worker.started:  # else when it says so: a large unit would block the pipe until then
            worker.send()

    def collect(self, seconds: float) -> list[Outcome]:
        if not self._pool:
            return []
        ready = multiprocessing.connection.wait([worker.pipe for worker in self._pool], seconds)
        found = list[Outcome | None]()
        for worker in list(self._pool):
            unit = worker.unit
            if worker.pipe in ready:
                found.append(self._hear(worker))
            elif unit is not None and time.monotonic() - worker.began >= (allowed := self.allowed(unit)):
                self._end(worker)
                found.append(Outcome(unit, None, f"no result within {allowed:g} s"))
        return [outcome for outcome in found if outcome is not None]

    def _hear(self, worker: _Worker) -> Outcome | None:
        """What a worker has sent, or that it is gone."""
        unit = worker.unit
        try:
            message = worker.pipe.recv()
        except Exception:  # the end of the pipe, or a message torn by the end of the worker
            reason = self._end(worker)
            return None if unit is None else Outcome(unit, None, reason)
        if not worker.started:
            worker.started = True
            worker.send()
            return None
        records, healthy = message
        worker.unit = None
        if not healthy:
            self._end(worker)
        return None if unit is None else Outcome(unit, records)

    def _end(self, worker: _Worker) -> str:
        """Remove a worker from the pool; says how it ended."""
        self._pool.remove(worker)
        worker.pipe.close()
        worker.process.join(0.5)
        alive = worker.process.exitcode is None
        if alive:
            worker.process.kill()
            worker.process.join()
        code = worker.process.exitcode or 0
        worker.process.close()
        if alive:
            return "the worker no longer answered"
        if code >= 0:
            return f"the worker ended with exit code {code}"
        name = signal.Signals(-code).name if -code in {s.value for s in signal.Signals} else f"signal {-code}"
        return f"the worker was ended by {name}" + (" (out of memory?)" if name == "SIGKILL" else "")

    def kill(self) -> None:
        """End all workers at once, from any thread; the one that listens to them removes them."""
        for worker in list(self._pool):
            with contextlib.suppress(ValueError):  # it is removed already
                worker.process.kill()

    def close(self) -> None:
        self.kill()
        for worker in list(self._pool):
            self._end(worker)


@contextlib.contextmanager
def _main_left_out() -> Iterator[None]:
    """Processes that are started within do not run the user's script again, which needs no guard against that, nor
    modules of the working folder, which Python would look for first (3.10 still does)."""
    main, before = sys.modules["__main__"], os.environ.get("PYTHONSAFEPATH", "")
    sys.modules["__main__"], os.environ["PYTHONSAFEPATH"] = types.ModuleType("__main__"), "1"
    try:
        yield
    finally:
        sys.modules["__main__"], os.environ["PYTHONSAFEPATH"] = main, before


def serve(pipe: Connection, work: Work) -> None:
    """The life of a worker: solve units as they come, until the pipe or the parent ends or nothing has come for long.

    After an exception the process is not trusted any more: it hands over what it has and ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where nothing keeps Ctrl-C from us: it is for the parent
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(OSError):  # if memory runs out, let it be a worker that goes, not the scan
        Path("/proc/self/oom_score_adj").write_text("500")
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError), pipe:
        pipe.send("started")
        healthy = True
        while healthy and pipe.poll(IDLE_SECONDS):
            records = work(pipe.recv())
            healthy = all(r["scalars"]["status"] != FAILED or r.get("final", False) for r in records)
            pipe.send((records, healthy))


def _end_with_parent() -> None:
    """A worker whose scan was killed must not go on for hours."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
