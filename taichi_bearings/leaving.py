"""Ends the process of a command at Ctrl-C or SIGTERM, whatever it is doing; a program that imports us is never ended.

Python runs the handler of a signal in its main thread, between two of its own steps. So no handler runs during a long
call of a library, and some code swallows what a handler raises: modules that are being loaded, destructors, callbacks.
Therefore a thread is told of each signal too (:func:`watch`). If the process still runs a second later and nothing is
being saved, the thread removes the temporary files, prints one sentence and ends the process.
"""

import atexit
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM)
EXIT_CODE = 130  # of an interrupted command, as shells have it
IGNORED = 1  # in C the handler that ignores a signal, the largest of those that are no functions
GRACE, GLANCE = 1.0, 0.05  # seconds until a process is ended that does not end itself, and between two checks of that
NOTHING_KEPT = "interrupted; only files that were complete are kept"
AS_BEFORE = "\r\x1b[2K\x1b[?25h"  # a terminal without a line of progress, and with its cursor

_temporary = set[str]()
_helpers = set[int]()  # processes that this one has started beside those that multiprocessing lists
_sentences = [NOTHING_KEPT]
_heard = threading.Event()
_raised = False  # True while an exception that a signal has raised is on its way, perhaps as another one
_own_signals = 0  # signals that this process has sent to itself and that have not come yet
_watched = False
_exit_code: int | None = None  # with which the command ends; None as long as it is not known
_ending = threading.Lock()  # the thread that gets it ends the process; it is never released


class _Blocks:
    """Counter of the `with` blocks of one kind that are being executed; they may be inside each other.

    under_way : number of the blocks that were entered and not left.
    """

    under_way = 0

    @contextlib.contextmanager
    def one_more(self) -> Iterator[None]:
        """Context of a `with` block that is counted until it is left, by an exception too."""
        self.under_way += 1
        try:
            yield
        finally:
            self.under_way -= 1


_saving = _Blocks()
_ended_by_signals = _Blocks()  # in which a signal may end the process by default, without a word


def saving() -> contextlib.AbstractContextManager[None]:
    """Context for work that saves something: the process is not ended in it. The work handles signals itself."""
    return _saving.one_more()


@contextlib.contextmanager
def handled(handler: Callable[[int, FrameType | None], Any] | signal.Handlers) -> Iterator[None]:
    """Context in which Ctrl-C and SIGTERM call a handler. In threads other than the main one nothing changes.

    handler : function of the number of the signal and the frame that it interrupts.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in SIGNALS}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Context for a few steps that belong together: Ctrl-C and SIGTERM that come in it are handled after it. In threads
    other than the main one, which get no signals, nothing changes."""
    came: list[int] = []
    with handled(lambda number, _: came.append(number)):
        yield
    for number in set(came):
        signal.raise_signal(number)


@contextlib.contextmanager
def saying(sentence: str) -> Iterator[None]:
    """Context in which a sentence is printed if the process is ended: it says what is kept.

    sentence : the sentence.
    """
    _sentences.append(sentence)
    try:
        yield
    finally:
        _sentences.pop()


def add_temporary(path: Path) -> None:
    """Have the file or folder `path` removed if the process is ended before :func:`forget_temporary` is called for
    it.
    """
    _temporary.add(os.path.abspath(path))


def forget_temporary(path: Path) -> None:
    """Undo :func:`add_temporary` for `path`, which was removed or has got its final name."""
    _temporary.discard(os.path.abspath(path))


def add_helper(process: int) -> None:
    """Have a process killed if this one is ended before :func:`forget_helper` is called for it.

    process : process number of a child of this process. No other process gets this number before the child is waited
        for.
    """
    _helpers.add(process)


def forget_helper(process: int) -> None:
    """Undo :func:`add_helper`, before the process is waited for."""
    _helpers.discard(process)


def heard() -> bool:
    """Return True if a signal (Ctrl-C or SIGTERM) has asked this process to end."""
    return _heard.is_set()


def note_heard() -> None:
    """Note, in the handler of a signal, that this process has been asked to end; the thread that hears of signals may
    note it later only.
    """
    _heard.set()


def forget_heard() -> None:
    """Note that the signal that came has been answered: what goes wrong from now on has another cause."""
    _heard.clear()
    forget_raised()


def has_raised() -> bool:
    """Return True if a signal has raised an exception: an error that comes now may be what a library made of it."""
    return _raised


def note_raised() -> None:
    """Note, in the handler of a signal, that it raises an exception."""
    global _raised
    _raised = True


def forget_raised() -> None:
    """Note that the exception which a signal has raised was caught as what it is, a KeyboardInterrupt."""
    global _raised
    _raised = False


def disregard_next() -> None:
    """Mark the next signal as one that this process is about to send to itself, not the wish of a person."""
    global _own_signals
    if _watched:
        _own_signals += 1


def _is_own() -> bool:
    """Return True if the signal that has just come is one that this process has sent to itself, and count it as
    come.
    """
    global _own_signals
    if _own_signals == 0:
        return False
    _own_signals -= 1
    return True


def is_ended_by_signals() -> bool:
    """Return True if a signal may now end this process as the system does by default, without a word."""
    return _ended_by_signals.under_way > 0


@contextlib.contextmanager
def by_default() -> Iterator[None]:
    """Context in which signals end the command's process as the operating system does by default.

    That works even in a call of a library that never returns and lets no other thread work. Where something is being
    saved nothing changes.
    """
    if not _watched or _saving.under_way:
        yield
        return
    with _ended_by_signals.one_more(), handled(signal.SIG_DFL):
        yield


@contextlib.contextmanager
def by_default_next_time() -> Iterator[None]:
    """Context in which a second signal ends the command's process, as the operating system does by default.

    The first signal is left to Python's handler as usual. Python runs a handler only between two of its own steps, so
    never while a call of a library does not return. Even then a second Ctrl-C ends the process. This needs the function
    `sysv_signal` of the GNU C library, whose handlers are called once only; elsewhere nothing changes. Nothing changes
    either while something is being saved, or in threads other than the main one.
    """
    if not _watched or _saving.under_way or threading.current_thread() is not threading.main_thread():
        yield
        return
    import ctypes  # which --help does not need

    python, heard_once = ctypes.pythonapi, getattr(ctypes.CDLL(None), "sysv_signal", None)
    if heard_once is None:
        yield
        return
    for call in (python.PyOS_getsig, python.PyOS_setsig, heard_once):
        call.restype = ctypes.c_void_p
    before = {number: ctypes.c_void_p(python.PyOS_getsig(int(number))) for number in SIGNALS}
    with _ended_by_signals.one_more():
        for number, handler in before.items():
            if (handler.value or 0) > IGNORED:
                heard_once(int(number), handler)
        try:
            yield
        finally:
            for number, handler in before.items():
                if (handler.value or 0) > IGNORED:
                    python.PyOS_setsig(int(number), handler)


def watch() -> None:
    """Start a thread that ends this process if a signal comes that Python cannot handle. The process must be that of a
    command, not that of a user's program."""
    global _watched
    if _watched or sys.platform == "win32":
        return
    _watched = True
    if not atexit._ncallbacks():  # functions registered before, as by a tool that counts lines, would not be called
        atexit.register(_end_without_clearing)  # the first to be registered is the last to be called
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=_end_if_stuck, args=(reading,), daemon=True).start()


def _end_if_stuck(reading: int) -> None:
    """Wait for a signal, then give the process GRACE seconds to end by itself, counted from the end of the last work
    that saves something. After that print the last sentence and end the process. Runs in a thread of its own.

    reading : pipe from which the numbers of signals can be read as they come.
    """
    while os.read(reading, 1)[0] not in SIGNALS or _is_own():
        pass
    _heard.set()
    left = GRACE
    while left > 0:
        time.sleep(GLANCE)
        left = GRACE if _saving.under_way else left - GLANCE
    _ending.acquire()
    with contextlib.suppress(OSError):
        os.write(2, f"{AS_BEFORE if os.isatty(2) else ''}bearings: {_sentences[-1]}\n".encode(errors="replace"))
    _leave()


def note_exit_code(code: int) -> None:
    """Note that the command is done and ends with this exit code: Python then ends without clearing its memory."""
    global _exit_code
    _exit_code = code


def _end_without_clearing() -> None:
    """End the process of a command that is done, after Python has joined its threads and called what was registered for
    its end.

    Python would now free all modules one by one, and the libraries all that they hold: a tenth of a second, for memory
    that the system takes back at once. Taichi is ended before, so that it writes what it has compiled.
    """
    if _exit_code is None:  # an error that is still to be shown
        return
    if (runtime := sys.modules.get("taichi_bearings.runtime")) is not None:
        runtime.end()
    with contextlib.suppress(OSError, ValueError):  # a stream that cannot be written is left to Python, which says so
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        os._exit(_exit_code)


def end_now(sentence: str = "") -> None:
    """End an interrupted command at once, without waiting for its threads; do nothing in a process that is not watched
    (:func:`watch`).

    sentence : what is still to be printed, on stderr.
    """
    if not _watched:
        return
    _ending.acquire()
    if sentence and sys.stderr is not None:
        with contextlib.suppress(OSError, ValueError):
            print(sentence, file=sys.stderr)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    _leave()


def _leave() -> NoReturn:
    """End the processes that this one has started, remove its temporary files, and end this process."""
    with contextlib.suppress(Exception):
        multiprocessing: Any = sys.modules.get("multiprocessing")
        for child in multiprocessing.active_children() if multiprocessing else []:
            child.kill()
    for process in list(_helpers):
        with contextlib.suppress(OSError):
            os.kill(process, signal.SIGKILL)
    for path in list(_temporary):
        with contextlib.suppress(OSError):
            if os.path.isdir(path) and not os.path.islink(path):
                import shutil  # loaded by whoever made the folder

                shutil.rmtree(path, ignore_errors=True)
            else:
                os.unlink(path)
    os._exit(EXIT_CODE)
