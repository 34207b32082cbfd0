"""Solving the samples of a scan on a Dask cluster, by the same worker processes as on this machine.

Every thread of a Dask worker keeps one process of its own, in which a :class:`LocalEngine` has the samples solved. So a
sample gets a fresh main thread and a Taichi runtime of one thread wherever it is solved, and the same bits; one that
hangs, aborts or runs out of memory ends that process, not the Dask worker, which stays in touch with its scheduler
however long a sample takes. A Dask worker that is lost with its machine costs what it was at: Dask gives that to
another one, and if it is lost again the scan tries it once more.
"""

import contextlib
import importlib
import logging
import math
import multiprocessing
import queue
import shutil
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_bearings.errors import BearingsError, InputError
from taichi_bearings.runs.settings import parse_assignment
from taichi_bearings.runtime import available_threads
from taichi_bearings.scans.engine import LOOK_SECONDS, LocalEngine, Outcome, Record, Unit, Work
from taichi_bearings.scans.plan import Sample
from taichi_bearings.scene.initial_spins import STARTS

if TYPE_CHECKING:
    from distributed import Client, Future
    from distributed.deploy import Cluster

QUEUES = {"slurm": "SLURMCluster", "pbs": "PBSCluster", "sge": "SGECluster", "lsf": "LSFCluster"}  # of dask_jobqueue
DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"  # Ctrl-C is for the scan, which ends its workers
JOB = {"cores": 1, "memory": "2GB"}  # of a job in a queue, where neither an option nor the settings of Dask say
CONNECT = 5.0  # seconds to wait for a scheduler
SETTINGS = {
    "distributed.scheduler.allowed-failures": 1,  # moves of a unit whose worker was lost; then the scan decides
    "distributed.worker.profile.enabled": False,  # looks at every thread a hundred times a second
}
UNITS_AHEAD = 2  # units at a time for each thread, so that the next one is there when one is done
LOOK = 1.0  # seconds between two counts of the workers
RENEW = 60.0  # seconds between two submissions of jobs in place of those that have ended
LONELY = 10.0  # seconds without any worker after which that is said


def connected(
    scheduler: str | None = None, cluster: str | None = None, workers: int | None = None, options: Sequence[str] = ()
) -> "contextlib.AbstractContextManager[Client | None]":
    """The client of a Dask cluster: either one that is there, or one that is started for the scan and ended with it;
    None if neither is named.

    scheduler : address of one that is there, such as ``tcp://node:8786``.
    cluster : one of QUEUES or "local" to start instead.
    workers : Dask workers to start; default: a process for each processor (local), or one job.
    options : ``key=value`` for the class of dask-jobqueue, values as in TOML, other words are texts.
    Raises InputError if Dask is not installed, if nobody answers at the address, or if the options do not fit.
    """
    if scheduler is None and cluster is None:
        return contextlib.nullcontext()
    _need("distributed")
    if scheduler is not None:
        if cluster is not None or workers is not None or options:
            raise InputError("--scheduler has workers already; --cluster, --workers and --cluster-option start some")
        return _client_at(scheduler)
    given = dict(_option(text) for text in options)
    if cluster == "local" and given:
        raise InputError(f"--cluster-option {options[0]} needs a queue, such as --cluster slurm")
    return _client_of(partial(_local, workers) if cluster == "local" else partial(_queue, str(cluster), workers, given))


def _need(package: str) -> None:
    try:
        importlib.import_module(package)
    except ImportError:
        words = f"Dask clusters need the package {package.replace('_', '-')}"
        raise InputError(f"{words}; install it with: pip install 'taichi-bearings[cluster]'") from None


def _client_at(address: str) -> "Client":
    import distributed
    from distributed.comm import resolve_address

    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)  # what goes wrong is said below
    try:
        resolve_address(address)  # else a client complains again when it is deleted
        return distributed.Client(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError, distributed.TimeoutError) as error:
        reason = str(error) if isinstance(error, ValueError) else f"no answer within {CONNECT:g} s"
        raise InputError(f"no Dask scheduler at {address!r}: {reason}") from None
    finally:
        logger.setLevel(level)


@contextlib.contextmanager
def _client_of(start: "Callable[[], Cluster]") -> "Iterator[Client]":
    """The client of a cluster that lasts as long."""
    import dask
    import distributed

    with dask.config.set(SETTINGS):
        cluster = start()
    with cluster, distributed.Client(cluster, set_as_default=False) as client:
        yield client


def _local(workers: int | None) -> "Cluster":
    """Processes on this machine."""
    import distributed

    return distributed.LocalCluster(
        n_workers=workers or available_threads(), threads_per_worker=1, processes=True, host="127.0.0.1",
        dashboard_address=":0", silence_logs=logging.CRITICAL, preload=[DEAF],
    )  # fmt: skip


def _queue(name: str, workers: int | None, options: Mapping[str, Any]) -> "Cluster":
    """Jobs in a queue, one a worker unless the options say otherwise."""
    _need("dask_jobqueue")
    import dask
    import dask_jobqueue
    import distributed

    kind = getattr(dask_jobqueue, QUEUES[name])
    command = kind.job_cls.submit_command
    if shutil.which(command) is None:
        raise InputError(f"--cluster {name} needs the command {command}, which is not there")
    settings = dask.config.get(f"jobqueue.{name}")
    defaults = {key: value for key, value in JOB.items() if settings.get(key) is None}
    refusals: list[Exception] = []

    class Job(kind.job_cls):  # type: ignore[name-defined]
        """A job that says so when the queue refuses it, where Dask would wait for its worker for ever."""

        async def start(self) -> None:
            try:
                await super().start()
            except Exception as error:
                refusals.append(error)
                self.status = distributed.Status.running  # Dask insists on it here, and on the other when it closes

        async def close(self) -> None:
            if self.job_id is not None:
                await super().close()
            self.status = distributed.Status.closed

    try:
        cluster = kind(job_cls=Job, **(defaults | dict(options)))
    except (TypeError, ValueError, RuntimeError, OSError) as error:
        raise InputError(f"--cluster {name} cannot be started: {str(error).splitlines()[0]}") from None
    cluster.scale(workers or 1)
    cluster.sync(cluster._correct_state)  # which scale() only begins
    if refusals:
        cluster.close()
        raise InputError(f"{command} refused the jobs: {str(refusals[0]).strip().splitlines()[-1]}")
    return cluster


def _option(text: str) -> tuple[str, Any]:
    key, value = parse_assignment(text, "--cluster-option", "key=value")
    return key, value if isinstance(value, (bool, int, float, list, Mapping)) else str(value)


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
    _finished: "queue.SimpleQueue[Future]" = field(default_factory=queue.SimpleQueue)
    _threads: int = 0
    _wanted: int = 0  # Dask workers
    _looked: float = -LOOK
    _renewed: float = field(default_factory=time.monotonic)
    _seen: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        if self.client.cluster is not None:
            self._wanted = len(self.client.cluster.plan)

    @property
    def running(self) -> list[Unit]:
        return [unit for _, unit in self._submitted.values()]

    @property
    def has_room(self) -> bool:
        self._look()
        return len(self._submitted) < UNITS_AHEAD * self._threads

    def _look(self) -> None:
        """Count the workers now and then; replace those whose jobs have ended."""
        now = time.monotonic()
        if now < self._looked + LOOK:
            return
        self._looked = now
        with contextlib.suppress(Exception):  # no answer: nothing new is known, and collect() notices a lost scheduler
            self._threads = sum(self.client.nthreads().values())
        self.workers = max(self.workers, self._threads)
        if self._threads:
            self._seen = now
        elif now > self._seen + LONELY:
            self._seen = now + 10 * LONELY
            logging.getLogger(__name__).warning("bearings: the Dask cluster has no workers; waiting for some")
        if self.client.cluster is not None and now > self._renewed + RENEW:
            self._renewed = now
            self.client.cluster.scale(self._wanted)

    def submit(self, unit: Unit) -> None:
        sent = tuple(_for_any_folder(sample) for sample in unit)
        key = f"bearings-{self._name}-{uuid.uuid4().hex}"
        future = self.client.submit(solve_unit, sent, self._name, self.work, self.allowed, key=key, pure=False)
        self._submitted[key] = future, unit
        future.add_done_callback(self._finished.put)

    def collect(self, seconds: float) -> list[Outcome]:
        if self.client.status == "closed":
            raise BearingsError("the connection to the Dask scheduler is lost; the same scan again goes on")
        finished: list[Future] = []
        with contextlib.suppress(queue.Empty):
            finished.append(self._finished.get(timeout=seconds))
            while True:
                finished.append(self._finished.get(block=False))
        return [outcome for future in finished if (outcome := self._outcome(future)) is not None]

    def _outcome(self, future: "Future") -> Outcome | None:
        """What became of a unit; None if its result was lost again, with the worker that had it."""
        import distributed

        key = str(future.key)
        _, unit = self._submitted[key]
        records, reason = None, "Dask has cancelled it"
        try:
            if future.status == "finished":
                records, reason = future.result(timeout=CONNECT)
            elif future.status == "error":
                error = future.exception(timeout=CONNECT)
                lost = isinstance(error, distributed.KilledWorker)
                reason = "its Dask workers were lost" if lost else f"{type(error).__name__}: {error}"
        except distributed.TimeoutError:
            future.add_done_callback(self._finished.put)
            return None
        del self._submitted[key]
        return Outcome(unit, records, reason)

    def close(self) -> None:
        with contextlib.suppress(Exception):  # a scheduler that is lost needs no telling
            self.client.cancel([future for future, _ in self._submitted.values()])
            self.client.run(end_solvers, self._name, on_error="ignore")
        self._submitted.clear()


def _for_any_folder(sample: Sample) -> Sample:
    """The sample with its files named in full, since workers run elsewhere."""
    settings = sample.settings
    named = {name: getattr(settings, name) for name in ("coefficients", "initial")}
    changes: dict[str, Any] = {
        name: str(Path(file).absolute()) for name, file in named.items() if file is not None and file not in STARTS
    }
    return replace(sample, settings=replace(settings, **changes)) if changes else sample


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
