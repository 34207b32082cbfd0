"""How long work reacts to Ctrl-C, to the SIGTERM of a batch queue and to limits of time, and ends without loss.

Python runs the handler of a signal in its main thread, between two of its own steps. There are two kinds of work:

* What may be broken off anywhere ends at once (`raise_at_signals`).
* What must not be half done asks at certain places whether it is to end (`look_up`, inside `while_wanted`).

A command that does not end by these means is ended by :mod:`taichi_bearings.leaving`.

A command that reports a result runs inside `keeping`. Once its result is reached (`keep`), a signal is only noted, so
the result is stored and reported whatever comes. What may still be broken off, such as figures, runs in `broken_off`.
"""

import _thread
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from types import FrameType
from typing import Any

from taichi_bearings import leaving
from taichi_bearings.leaving import SIGNALS, handled

SOON = 0.02  # seconds until an interrupt that was swallowed is raised again
IMPATIENCE = 5.0  # seconds; a second Ctrl-C that comes later than this ends the process


class GivenUp(KeyboardInterrupt):
    """Raised in work that is no longer wanted. Results that it had reached before are complete."""


_ended: ContextVar[Callable[[], bool] | None] = ContextVar("ended", default=None)


@contextmanager
def while_wanted(ended: Callable[[], bool]) -> Iterator[None]:
    """Context in which work that is no longer wanted ends with GivenUp, at its next call of `look_up`.

    ended : function that returns True once the work is no longer wanted.
    """
    before = _ended.set(ended)
    try:
        yield
    finally:
        _ended.reset(before)


def look_up() -> None:
    """Raise GivenUp if the work is no longer wanted (see :func:`while_wanted`). Long loops call this between two steps,
    when no result is half written."""
    ended = _ended.get()
    if ended is not None and ended():
        raise GivenUp


class Keeper:
    """Notes signals for a command that has reached a result and has to report it.

    reached : True once there is a result.
    heard : True once a signal has come that was noted and raised nothing.
    """

    def __init__(self) -> None:
        """Begin without a result, and without having heard anything."""
        self.reached = self.heard = False
        self.first = 0.0  # clock reading, seconds, of the first signal that was heard
        self.until_reported = ExitStack()  # once there is a result, holds the context in which the process is not ended

    def note(self) -> None:
        """Note a signal."""
        if not self.heard:
            self.heard, self.first = True, time.monotonic()


_keeper: Keeper | None = None  # that of the command under way


@contextmanager
def keeping() -> Iterator[None]:
    """Context of a command that reaches a result and reports it. Once `keep` is called in it, signals are only noted
    and do not end the process. Only one more than IMPATIENCE seconds after the first raises KeyboardInterrupt.

    Errors after the call of `keep` are shown as always, since no signal has caused them.
    """
    global _keeper
    before, _keeper = _keeper, Keeper()
    try:
        yield
    except Exception:
        if _keeper.reached:
            leaving.forget_heard()
        raise
    finally:
        _keeper.until_reported.close()
        _keeper = before


def keep() -> None:
    """Note that a result is reached: inside `keeping` signals are only noted from now on. Called where signals raise
    nothing, so that no signal comes between the result and this note.
    """
    if _keeper is not None and not _keeper.reached:
        _keeper.until_reported.enter_context(leaving.saving())
        _keeper.reached = True


def _note() -> None:
    """Note a signal for the command under way, if it keeps its result."""
    if _keeper is not None:
        _keeper.note()


@contextmanager
def awaited() -> Iterator[threading.Event]:
    """Context in which Ctrl-C and SIGTERM do nothing but set an event, which the block gets. The event is set from the
    start if a signal was noted before, inside `keeping`.
    """
    heard = threading.Event()

    def hear(*_: object) -> None:
        """Note a signal and set the event; what Python passes about the signal is not used."""
        heard.set()
        _note()

    with leaving.saving(), handled(hear):
        if _keeper is not None and _keeper.heard:
            heard.set()
        yield heard


@contextmanager
def unheard_by_children() -> Iterator[None]:
    """Context in which processes are started that ignore Ctrl-C and SIGTERM: this process ends them itself.

    Signals that come during the block are handled after it, also if another thread got them. Otherwise the start could
    be interrupted, and leave a process that waits for its task, finds nothing and prints a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker  # which --help does not need

    with leaving.undisturbed():
        resource_tracker.ensure_running()  # whose start, before that of the first process, would undo the mask
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def is_loading(frame: FrameType | None) -> bool:
    """Return True if a module is being loaded in the frame or above it. An exception that is raised then may be lost or
    turned into another one by compiled modules.

    frame : frame of Python that a signal interrupts; None if there is none.
    """
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def again_soon(is_wanted: Callable[[], bool] = lambda: True) -> None:
    """Send Ctrl-C to this process once more after a moment. This is called where a KeyboardInterrupt was swallowed, or
    would be swallowed if the handler raised it now.

    is_wanted : function that is called at that moment; if it returns False, nothing is sent.
    """

    def send() -> None:
        """Wait a moment, and send Ctrl-C to the main thread."""
        time.sleep(SOON)
        while leaving.is_ended_by_signals() or signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
            time.sleep(SOON)  # else the process would end without a word
        if not is_wanted():
            return
        leaving.disregard_next()
        if hasattr(signal, "pthread_kill"):  # which also ends a wait
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        else:
            _thread.interrupt_main()

    _thread.start_new_thread(
        send, ()
    )  # no Thread: the main one may be starting another, which a second start waits for


def interrupt(_: int, frame: FrameType | None) -> None:
    """Handle a signal: raise KeyboardInterrupt; or, while a module is being loaded, send the signal again a moment
    later; or, where a result is kept (`keeping`), note it.

    frame : frame of Python that the signal interrupts.
    _ : number of the signal.
    """
    leaving.note_heard()  # first, since libraries make another exception of the one raised here
    if _keeper is not None and _keeper.reached:
        _keeper.note()
        if time.monotonic() - _keeper.first > IMPATIENCE:
            leaving.note_raised()
            raise KeyboardInterrupt
    elif is_loading(frame):
        again_soon()
    else:
        leaving.note_raised()
        raise KeyboardInterrupt


def ignore_signals() -> None:
    """Ignore Ctrl-C and SIGTERM from now on. Called in a command's own process that is about to end."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def raise_at_signals() -> None:
    """Let Ctrl-C and SIGTERM raise KeyboardInterrupt from now on. Called in a command's own process, not in that of a
    user's program."""
    for number in SIGNALS:
        signal.signal(number, interrupt)


def end_at_signals() -> None:
    """Let Ctrl-C and SIGTERM end a command in every case. Called once in the command's own process.

    A KeyboardInterrupt that a destructor or a callback swallows is sent again. Where compiled code keeps Python from
    handling the signal, a thread (`leaving.watch`) ends the process.
    """
    raise_at_signals()
    leaving.watch()
    unraisable, in_thread = sys.unraisablehook, threading.excepthook

    def swallowed(what: Any) -> None:
        """Handle an exception of a destructor or a callback, which Python cannot raise: a Ctrl-C is sent again, other
        errors are shown as usual unless the process is ending.

        what : the exception and where it came from, as `sys.unraisablehook` gets them.
        """
        if what.exc_type is not None and issubclass(what.exc_type, KeyboardInterrupt):
            again_soon()
        elif not leaving.heard():  # errors of objects that end with the process do not matter
            unraisable(what)

    def failed(what: Any) -> None:
        """Handle an exception that has ended a thread: it is shown as usual unless the process is ending.

        what : the exception and its thread, as `threading.excepthook` gets them.
        """
        if not leaving.heard():
            in_thread(what)

    sys.unraisablehook, threading.excepthook = swallowed, failed


class Interrupt:
    """Notes Ctrl-C, or the SIGTERM of a batch queue, without interrupting a step of a solve.

    A second signal raises KeyboardInterrupt if it comes more than IMPATIENCE seconds after the first one. The step has
    this time to end.

    heard : True once a signal has come.
    """

    def __init__(self) -> None:
        """Begin before any signal; the handlers change when the context begins."""
        self.heard, self._first, self._at_once, self._is_own = False, 0.0, False, False
        self._context = handled(self._hear)

    def __enter__(self) -> "Interrupt":
        """Handle Ctrl-C and SIGTERM by :meth:`_hear` from now on. A signal that was noted before, inside `keeping`,
        counts as heard.
        """
        self._context.__enter__()
        if _keeper is not None and _keeper.heard:
            self.heard, self._first = True, _keeper.first
        return self

    def __exit__(self, *_: object) -> None:
        """Give Ctrl-C and SIGTERM back to the handlers that they had before."""
        self._context.__exit__(None, None, None)

    @contextmanager
    def at_once(self, seconds: float = math.inf) -> Iterator[None]:
        """Context whose work ends with GivenUp, at whatever point it is, at Ctrl-C or SIGTERM, or after `seconds`."""
        timer = threading.Timer(min(seconds, threading.TIMEOUT_MAX), self._end)
        try:
            if threading.current_thread() is threading.main_thread() and seconds < math.inf:
                timer.start()
            self._at_once = True
            if self.heard or not seconds > 0:
                raise GivenUp
            yield
        except KeyboardInterrupt:
            leaving.forget_raised()
            raise
        finally:
            self._at_once = False
            timer.cancel()
            if timer.ident is not None:
                timer.join()  # if it is just sending its signal, that comes before the context ends

    def _end(self) -> None:
        """Send Ctrl-C to the main thread since the time is up."""
        self._is_own = True
        leaving.disregard_next()
        _thread.interrupt_main()

    def _hear(self, _: int, frame: FrameType | None) -> None:
        """Handle Ctrl-C or SIGTERM.

        The first signal sets `heard`; a later one raises KeyboardInterrupt if more than IMPATIENCE seconds have passed.
        A signal that this process has sent to itself, as at the end of the time that `at_once` allows, does neither.
        Then work inside `at_once` is given up: GivenUp is raised, or, while a module is being loaded, soon after.

        frame : frame of Python that the signal interrupts.
        _ : number of the signal.
        """
        # `_end` and `again_soon` mark the signals that they send
        is_own, self._is_own = self._is_own, False
        if is_own:
            pass
        elif not self.heard:
            self.heard, self._first = True, time.monotonic()
            _note()
        elif time.monotonic() - self._first > IMPATIENCE:
            leaving.note_raised()
            raise KeyboardInterrupt

        def is_wanted() -> bool:
            """Return True if the work inside `at_once` is still going on, and then mark the signal that `again_soon`
            is about to send as this process's own."""
            self._is_own = self._at_once
            return self._at_once

        if self._at_once and is_loading(frame):
            again_soon(is_wanted)
        elif self._at_once:
            leaving.note_raised()
            raise GivenUp


def broken_off(work: Callable[[], object]) -> bool:
    """Do some work that Ctrl-C or SIGTERM may break off anywhere, and return True if that happened.

    work : function that does the work. Libraries may make another exception of the one that ends it.
    """
    with Interrupt() as interrupt:
        try:
            with interrupt.at_once():
                work()
        except KeyboardInterrupt:
            return True
        except Exception:
            if not interrupt.heard:
                raise
            return True
    return False
