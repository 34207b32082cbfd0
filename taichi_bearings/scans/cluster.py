"""Solves the samples of a scan on a Dask cluster, by the same worker processes as on this machine.

Every thread of a Dask worker has a worker process, like the threads of a :class:`LocalEngine`. So wherever a sample is
solved, it has a main thread and a Taichi runtime of one thread, and its result has the same bits. A sample that hangs,
aborts or runs out of memory ends that process, not the Dask worker, which stays in touch with its scheduler however
long a sample takes. If a Dask worker is lost with its machine, Dask gives its samples to another one; if that is lost
too, the scan tries them once more.
"""

import contextlib
import logging
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_bearings.errors import BearingsError, FileError, InputError, warn
from taichi_bearings.plain_files import read_json
from taichi_bearings.scans.engine import LocalEngine, Outcome, Unit, Work, end_solvers
from taichi_bearings.scans.plan import files_of

if TYPE_CHECKING:
    from distributed import Client

CONNECT = 5.0  # seconds to wait for a scheduler
UNITS_AHEAD = 2  # units submitted for each thread, so that the next one is there when one is done
COUNT_SECONDS = 1.0  # seconds between two counts of the workers
NO_WORKER_SECONDS = 10.0  # seconds without any worker after which a warning says so


def connected(scheduler: str | None) -> "contextlib.AbstractContextManager[Client | None]":
    """Connect to a Dask cluster; return a context manager that yields its client, or None where no scheduler is given.

    scheduler : address of its scheduler, such as ``tcp://node:8786``, or the file that this has written (``dask
        scheduler --scheduler-file``).

    Raises InputError if Dask is not installed, if the file names no address, or if nobody answers there.
    """
    if scheduler is None:
        return contextlib.nullcontext()
    try:
        import distributed
        from distributed.comm.addressing import resolve_address
    except ImportError:
        words = "Dask clusters need the package distributed; install it with: pip install 'taichi-bearings[cluster]'"
        raise InputError(words) from None
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)  # errors are raised below instead
    try:
        scheduler = _address(scheduler)
        resolve_address(scheduler)  # raises for a bad address; a client with one would log an error when deleted
        return distributed.Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError, distributed.TimeoutError) as error:
        reason = str(error) if isinstance(error, ValueError) else f"no answer within {CONNECT:g} s"
        raise InputError(f"no Dask scheduler can be reached at {scheduler!r}: {reason}") from None
    finally:
        logger.setLevel(level)


def _address(scheduler: str) -> str:
    """Return the address of a scheduler: the text itself, or the address in a scheduler file.

    Raises FileError for a file without a readable address.
    """
    path = Path(scheduler)
    if path.suffix != ".json" and not path.is_file():
        return scheduler
    found = read_json(path)
    address = found.get("address") if isinstance(found, dict) else None
    if not isinstance(address, str):
        raise FileError(f"{path} has no address of a Dask scheduler; `dask scheduler --scheduler-file FILE` writes one")
    return address


class DaskEngine(LocalEngine):
    """Solves units of samples (tuples that are sent to a worker at a time) in the threads of the workers of a Dask
    cluster.

    client : connection to the cluster.
    work : function that solves a unit.
    allowed : function that returns the seconds that a unit may take.

    The attribute `workers` is the largest number of threads so far.
    """

    def __init__(self, client: "Client", work: Work, allowed: Callable[[Unit], float] = lambda unit: math.inf) -> None:
        """Store the attributes; no thread is counted yet."""
        super().__init__(work, 1, allowed)
        self.client, self.workers, self.executor = client, 0, client.get_executor(pure=False)
        self._threads, self._counted_at, self._seen_at = 0, -COUNT_SECONDS, time.monotonic()

    @property
    def can_take_unit(self) -> bool:
        """True if another unit of samples can be sent: each thread of the cluster has fewer than UNITS_AHEAD of them.

        The threads are counted anew every COUNT_SECONDS; a warning says if there is none for NO_WORKER_SECONDS.
        """
        now = time.monotonic()
        if now >= self._counted_at + COUNT_SECONDS:
            self._counted_at = now
            with contextlib.suppress(Exception):  # no answer says nothing new, and collect() notices a lost scheduler
                self._threads = sum(self.client.nthreads().values())
            self.workers = max(self.workers, self._threads)
            self._seen_at = now if self._threads else self._seen_at
            if now > self._seen_at + NO_WORKER_SECONDS:
                self._seen_at = now + 10 * NO_WORKER_SECONDS  # the next warning comes that much later
                warn("the Dask cluster has no workers; waiting for some")
        return len(self.running) < UNITS_AHEAD * self._threads

    def sent(self, unit: Unit) -> Unit:
        """Return a unit whose files are named by absolute paths, since workers run in other folders."""
        named = []
        for sample in unit:
            names: dict[str, Any] = {name: str(Path(file).absolute()) for name, file in files_of(sample.settings)}
            named.append(replace(sample, settings=replace(sample.settings, **names)) if names else sample)
        return tuple(named)

    def collect(self, seconds: float) -> list[Outcome]:
        """Return the outcomes of units that have ended since the last call; wait for at most so many seconds.

        Raises BearingsError if the connection to the scheduler is lost.
        """
        if not self.running:  # no unit is sent while the cluster has no worker
            time.sleep(seconds)
        found = super().collect(seconds)
        if self.client.status != "running":  # Dask has cancelled all units
            raise BearingsError("the connection to the Dask scheduler is lost; the same command continues the scan")
        return found

    def close(self) -> None:
        """End the solving processes of this engine on all workers of the cluster."""
        with contextlib.suppress(Exception):  # the scheduler may be lost
            self.executor.shutdown(wait=False)
            self.client.run(end_solvers, self.name, on_error="ignore")
