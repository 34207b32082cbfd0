"""Solving the samples of a scan on a Dask cluster, by the same worker processes as on this machine.

Every thread of a Dask worker keeps one process of its own, in which a :class:`LocalEngine` has the samples solved. So a
sample gets a fresh main thread and a Taichi runtime of one thread wherever it is solved, and the same bits; one that
hangs, aborts or runs out of memory ends that process, not the Dask worker, which stays in touch with its scheduler
however long a sample takes. A Dask worker that is lost with its machine costs what it was at: Dask gives that to
another one, and if it is lost again the scan tries it once more.
"""

import contextlib
import logging
import math
import multiprocessing
import threading
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_bearings.errors import BearingsError, InputError
from taichi_bearings.scans.engine import LOOK_SECONDS, LocalEngine, Outcome, Record, Unit, Work
from taichi_bearings.scans.plan import files_of

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT = 5.0  # seconds to wait for a scheduler
UNITS_AHEAD = 2  # units at a time for each thread, so that the next one is there when one is done
PAUSE = 0.02  # seconds between two looks at units
LOOK = 1.0  # seconds between two counts of the workers
LONELY = 10.0  # seconds without any worker after which that is said


def connected(scheduler: str | None) -> "contextlib.AbstractContextManager[Client | None]":
    """The client of the Dask cluster whose scheduler has this address, such as ``tcp://node:8786``; None for None.

    Raises InputError if Dask is not installed, or if nobody answers at the address.
    """
    if scheduler is None:
        return contextlib.nullcontext()
    try:
        import distributed
        from distributed.comm import resolve_address
    except ImportError:
        words = "Dask clusters need the package distributed; install it with: pip install 'taichi-bearings[cluster]'"
        raise InputError(words) from None
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)  # what goes wrong is said below
    try:
        resolve_address(scheduler)  # else a client complains again when it is deleted
        return distributed.Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError, distributed.TimeoutError) as error:
        reason = str(error) if isinstance(error, ValueError) else f"no answer within {CONNECT:g} s"
        raise InputError(f"no Dask scheduler at {scheduler!r}: {reason}") from None
    finally:
        logger.setLevel(level)


@dataclass
class DaskEngine:
    """Workers of a Dask cluster, each thread of which has a process that solves.

    client : of the cluster. work, allowed : as in :class:`LocalEngine`.
    """

    client: "Client"
    work: Work
    allowed: Callable[[Unit], float] = lambda unit: math.inf
    workers: int = 0  # threads at most so far
    _name: str = field(default_factory=lambda: uuid.uuid4().hex)
    _submitted: "dict[str, tuple[Future, Unit]]" = field(default_factory=dict)
    _threads: int = 0
    _looked: float = -LOOK
    _seen: float = field(default_factory=time.monotonic)

    @property
    def running(self) -> list[Unit]:
        return [unit for _, unit in self._submitted.values()]

    @property
    def has_room(self) -> bool:
        now = time.monotonic()
        if now >= self._looked + LOOK:  # count the workers now and then
            self._looked = now
            with contextlib.suppress(Exception):  # no answer says nothing new, and collect() notices a lost scheduler
                self._threads = sum(self.client.nthreads().values())
            self.workers = max(self.workers, self._threads)
            self._seen = now if self._threads else self._seen
            if now > self._seen + LONELY:
                self._seen = now + 10 * LONELY
                logging.getLogger(__name__).warning("bearings: the Dask cluster has no workers; waiting for some")
        return len(self._submitted) < UNITS_AHEAD * self._threads

    def submit(self, unit: Unit) -> None:
        sent = []  # with its files named in full, since workers run elsewhere
        for sample in unit:
            names: dict[str, Any] = {name: str(Path(file).absolute()) for name, file in files_of(sample.settings)}
            sent.append(replace(sample, settings=replace(sample.settings, **names)) if names else sample)
        key = f"bearings-{self._name}-{uuid.uuid4().hex}"
        future = self.client.submit(solve_unit, tuple(sent), self._name, self.work, self.allowed, key=key, pure=False)
        self._submitted[key] = future, unit

    def collect(self, seconds: float) -> list[Outcome]:
        end = time.monotonic() + seconds
        while not (done := [key for key, (future, _) in self._submitted.items() if future.done()]):
            if time.monotonic() >= end:
                break
            time.sleep(PAUSE)
        if self.client.status != "running":  # then its units are cancelled
            raise BearingsError("the connection to the Dask scheduler is lost; the same scan again goes on")
        return [outcome for key in done if (outcome := self._outcome(key)) is not None]

    def _outcome(self, key: str) -> Outcome | None:
        """What became of a unit; None if its result was lost again, with the worker that had it."""
        import distributed

        future, unit = self._submitted[key]
        records, reason = None, "Dask has cancelled it"
        try:
            if future.status == "finished":
                records, reason = future.result(timeout=CONNECT)
            elif future.status == "error":
                error = future.exception(timeout=CONNECT)
                lost = isinstance(error, distributed.KilledWorker)
                reason = "its Dask workers were lost" if lost else f"{type(error).__name__}: {error}"
        except distributed.TimeoutError:
            return None
        del self._submitted[key]
        return Outcome(unit, records, reason)

    def close(self) -> None:
        with contextlib.suppress(Exception):  # a scheduler that is lost needs no telling
            self.client.cancel([future for future, _ in self._submitted.values()])
            self.client.run(end_solvers, self._name, on_error="ignore")
        self._submitted.clear()


_engines: dict[tuple[str, int], LocalEngine] = {}  # of this Dask worker, by scan and thread


def solve_unit(unit: Unit, scan: str, work: Work, allowed: Callable[[Unit], float]) -> tuple[list[Record] | None, str]:
    """On a Dask worker: the records of a unit, or None and the reason why there are none."""
    multiprocessing.current_process().daemon = False  # Dask sets this, and then no process can be started from here
    engine = _engines.setdefault((scan, threading.get_ident()), LocalEngine(work, 1, allowed))
    engine.submit(unit)
    while not (outcomes := engine.collect(LOOK_SECONDS)):
        pass
    return outcomes[0].records, outcomes[0].reason


def end_solvers(scan: str) -> None:
    """On a Dask worker: end the processes of a scan. The threads that listen to them hear of it."""
    for name, thread in list(_engines):
        if name == scan:
            _engines.pop((name, thread)).kill()
