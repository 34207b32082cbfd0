"""Ctrl-C, a batch queue's SIGTERM and limits of time: how work that takes long hears of them and ends without loss.

Python tells its main thread of a signal between two of its own steps. What may be torn out of anything then ends at
once (`heard_at_once`). What must not be half done looks up where it may end (`look_up`, inside `while_wanted`).
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SOON = 0.02  # seconds


class GivenUp(KeyboardInterrupt):
    """Work has ended because it is no longer wanted; what it had reached before is whole."""


_ended: ContextVar[Callable[[], bool] | None] = ContextVar("ended", default=None)


@contextmanager
def while_wanted(ended: Callable[[], bool]) -> Iterator[None]:
    """Work inside that looks up is given up once `ended` says so."""
    before = _ended.set(ended)
    try:
        yield
    finally:
        _ended.reset(before)


def look_up() -> None:
    """In long loops, where nothing is half done: GivenUp if the work is no longer wanted."""
    ended = _ended.get()
    if ended is not None and ended():
        raise GivenUp


@contextmanager
def handled(handler: Callable[[int, FrameType | None], Any] | signal.Handlers) -> Iterator[None]:
    """Have Ctrl-C and SIGTERM handled so; threads other than the main one do not hear of them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in SIGNALS}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


@contextmanager
def awaited() -> Iterator[threading.Event]:
    """Ctrl-C and SIGTERM change nothing inside but set the event."""
    heard = threading.Event()
    with handled(lambda *_: heard.set()):
        yield heard


@contextmanager
def unheard_by_children() -> Iterator[None]:
    """Processes that are started inside never hear of Ctrl-C and SIGTERM: this one ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker  # which --help does not need

    resource_tracker.ensure_running()  # whose start, before that of the first process, would undo this
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def is_loading(frame: FrameType | None) -> bool:
    """True while a module is loaded: compiled ones swallow an exception then, or make something else of it."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def interrupt(_: int, frame: FrameType | None) -> None:
    """A handler that ends what is under way, or soon if a module is being loaded."""
    if is_loading(frame) and hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, SOON)
    else:
        raise KeyboardInterrupt


def ignored() -> None:
    """For a process of our own that is about to end."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0)


def heard_at_once() -> None:
    """For a process of our own: Ctrl-C, SIGTERM and the alarm of :func:`interrupt` end what is under way."""
    for number in (*SIGNALS, *([signal.SIGALRM] if hasattr(signal, "SIGALRM") else [])):
        signal.signal(number, interrupt)
