"""Starts worker processes: under Linux as copies of one process that has loaded the program, elsewhere anew.

A new process takes longer to load the program than to solve a small sample; a copy is there at once. The process that
is copied, the *original*, does nothing but load modules and wait: it has neither threads nor a runtime of Taichi, which
a copy would have in part only. It is a server of :mod:`multiprocessing`. Each group of workers has a server of its own,
which has the environment that they are to have.
"""

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from multiprocessing import spawn, util
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from taichi_bearings import leaving
from taichi_bearings.interrupts import unheard_by_children

CAN_COPY = sys.platform == "linux"
LOADED = "taichi_bearings.scans.loaded"  # the module that the original loads, with all that it imports


class Original:
    """A process that has loaded the program, and of which worker processes are made as copies (forks). On systems other
    than Linux there is none, and each worker loads the program anew.

    The process is started with the first worker, or before by :meth:`begin`. Only one thread at a time may start
    workers.
    """

    def __init__(self) -> None:
        """Prepare what starts the process, which does not run yet."""
        self._server: Any = None
        self._is_loaded = False  # True once the process is known to have loaded the program
        if CAN_COPY:
            from multiprocessing import forkserver

            self._server = forkserver.ForkServer()
            self._server.set_forkserver_preload([LOADED])

    def begin(self) -> None:
        """Start the process, if there is to be one; it then loads the program while this one goes on.

        Nothing is started where no folder for temporary files can be written, as the address of the process is a file
        in one.
        """
        if self._server is None:
            return
        try:
            folder = Path(util.get_temp_dir())
            leaving.add_temporary(folder)  # else removed by Python, which does not happen where a signal ends a command
            with _without_main_script(), _without_working_folder(), unheard_by_children():
                self._server.ensure_running()
        except OSError:
            self._server = None
        else:
            leaving.add_helper(self._server._forkserver_pid)

    def start(self, target: Callable[..., None], arguments: tuple[Any, ...], name: str) -> BaseProcess:
        """Start a new worker process, and return it. It ends with this process, and Ctrl-C and SIGTERM do not reach it.

        target : function that the worker calls.
        arguments : what it is called with.
        name : name of the worker process.

        Raises EOFError or OSError if no process can be started, as after :meth:`give_up`.
        """
        self.begin()
        context: Any = multiprocessing.get_context("spawn" if self._server is None else "forkserver")
        process: BaseProcess = context.Process(target=target, args=arguments, daemon=True, name=name)
        if self._server is None:
            with _without_main_script(), _without_working_folder(), unheard_by_children():
                process.start()
            return process
        with _without_main_script(), self._copied():  # this waits until the program is loaded
            process.start()
        self._is_loaded = True
        return process

    def give_up(self) -> None:
        """Kill the process if it is still loading the program. Another thread may wait for that in :meth:`start`."""
        if not self._is_loaded:
            self._kill()

    def end(self) -> None:
        """End the process, if it runs; its copies must have ended."""
        if self._kill():
            leaving.forget_helper(self._server._forkserver_pid)
            with contextlib.suppress(ChildProcessError, AttributeError):
                self._server._stop()

    def _kill(self) -> bool:
        """Kill the process, which has no work to lose. Return False if it was not started."""
        pid = getattr(self._server, "_forkserver_pid", None)
        if pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        return pid is not None

    @contextlib.contextmanager
    def _copied(self) -> Iterator[None]:
        """Context in which new worker processes are copies of the original. By default they would be copies of a server
        that all users of :mod:`multiprocessing` share, which has loaded other modules."""
        from multiprocessing import forkserver, popen_forkserver

        own: Any = SimpleNamespace(**vars(forkserver))
        own.connect_to_new_process = self._server.connect_to_new_process
        popen: Any = popen_forkserver
        popen.forkserver, before = own, popen.forkserver
        try:
            yield
        finally:
            popen.forkserver = before


_begun: list[Original] = []  # the process that `begun_early` has started, until someone takes it


@contextlib.contextmanager
def begun_early() -> Iterator[None]:
    """Context that starts, at its begin, the process of which worker processes are later made as copies, so that it
    loads the program in parallel to this process. `take_original` inside the block returns it; if that is not called,
    the process is ended with the block.
    """
    original = Original()
    original.begin()
    _begun.append(original)
    try:
        yield
    finally:
        if original in _begun:
            _begun.remove(original)
            original.end()


def take_original() -> Original:
    """Return the process that `begun_early` has started, if no caller has taken it yet; otherwise a new one that is not
    started. The caller has to end it.

    Such a process, an `Original`, has loaded the program and does nothing else; worker processes are copies of it.
    """
    return _begun.pop() if _begun else Original()


@contextlib.contextmanager
def _without_main_script() -> Iterator[None]:
    """Context in which processes that this thread starts do not run the user's script again, so that the script needs
    no guard against that."""
    # multiprocessing calls this function for what a new process is to load
    preparation, ours = spawn.get_preparation_data, threading.get_ident()

    def without_main(name: str) -> dict[str, Any]:
        """Return what :mod:`multiprocessing` tells a new process with this name, without the user's script.

        name : name of the new process.
        """
        prepared = preparation(name)
        is_ours = threading.get_ident() == ours
        return {key: value for key, value in prepared.items() if not (is_ours and key.startswith("init_main_"))}

    spawn.get_preparation_data = without_main
    try:
        yield
    finally:
        spawn.get_preparation_data = preparation


@contextlib.contextmanager
def _without_working_folder() -> Iterator[None]:
    """Context in which new processes load no modules from the working folder, which Python 3.10 would search first."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        del os.environ["PYTHONSAFEPATH"]
        os.environ.update({} if before is None else {"PYTHONSAFEPATH": before})
