"""HDF5 files from anywhere, which are data and nothing else.

The HDF5 library loops for ever, crashes or takes any amount of memory on some damaged files, and Ctrl-C ends none of
that. So a file is looked through in a process of its own, with limits on its time and memory, before it is opened here.
"""

import contextlib
import faulthandler
import gc
import math
import os
import re
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NoReturn

import h5py
import numpy as np
from h5py._objects import phil

from taichi_bearings.errors import FileError
from taichi_bearings.plain_files import CLAIMED_BYTES, CLAIMED_FACTOR, opened

LAYOUT = 1  # version of all files of the package
UNREADABLE = (OSError, KeyError, ValueError, TypeError, AttributeError, IndexError, RuntimeError)
"""What HDF5 and NumPy raise at damaged files."""
GZIP_FACTOR, UNPACKED_BYTES = 1032, 2**20  # bytes that gzip makes of one, at most; what may be claimed without any
LOOKING_BYTES, LOOKING_FACTOR = 64 * 2**20, 4  # bytes of memory for looking through a file, and for each byte of it
SECONDS, PACE = 5.0, 20e6  # processor time for that, and bytes that need another second of it
FAILS = "it is damaged, HDF5 fails at it"
FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32", 32000: "lzf"}


@contextlib.contextmanager
def open_hdf5(path: Path, kind: str = "an HDF5 file") -> Iterator[h5py.File]:
    """The file, open for reading; FileError if it would do harm, and for what a damaged one makes HDF5 and NumPy raise
    inside. kind : what it is read as, for people."""
    try:
        look_through(path)
        with h5py.File(path, "r") as file:
            yield file
    except UNREADABLE as error:
        words = " ".join(str(error).strip("'").split())
        raise FileError(f"{path} cannot be read as {kind}: {words}") from None


def look_through(path: Path) -> None:
    """FileError if HDF5 would hang or crash on a file, or if that leads out of itself or claims more than it can hold;
    OSError if it is not there."""
    with opened(path) as file:
        found = os.fstat(file.fileno())
    reason = _reason_found(os.path.abspath(path), found.st_size, found.st_mtime_ns, found.st_ino)
    if reason:
        raise FileError(f"{path} is not read: {reason}")


@lru_cache(maxsize=1024)
def _reason_found(path: str, size: int, *_: int) -> str:
    """What a child says of a file, or what its end says; empty if the file can be opened."""
    if sys.platform == "linux":
        return _asked_of_a_fork(path, size)
    command, paths = [sys.executable, "-m", __name__, path], os.pathsep.join(sys.path)
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            timeout=10 * (SECONDS + size / PACE),
            env=os.environ | {"PYTHONPATH": paths, "PYTHONSAFEPATH": "1"},
        )
    except subprocess.TimeoutExpired:
        return "it is damaged: reading it does not terminate"
    return done.stdout.decode(errors="replace").strip() if done.returncode == 0 else FAILS


def _asked_of_a_fork(path: str, size: int) -> str:
    reading, writing = os.pipe()
    with phil, warnings.catch_warnings():  # no other thread is within HDF5 now
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads: the child needs none of them
        child = os.fork()
    if child == 0:
        _answer(path, size, writing)
    os.close(writing)
    status = None
    try:
        with os.fdopen(reading, "rb") as answer:
            words = answer.read().decode(errors="replace")
        status = os.waitpid(child, 0)[1]
    finally:
        if status is None:  # Ctrl-C
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        hangs = os.WTERMSIG(status) == signal.SIGPROF
        return "it is damaged: reading it " + ("does not terminate" if hangs else "crashes HDF5")
    return words if status == 0 else FAILS


def _answer(path: str, size: int, pipe: int) -> NoReturn:
    """The child's part: say why a file must not be read, within the limits, and end."""
    import resource

    failed = 1
    try:
        gc.disable()
        faulthandler.disable()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGPROF):
            signal.signal(number, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_PROF, SECONDS + size / PACE)
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        limit = used + LOOKING_BYTES + LOOKING_FACTOR * size
        resource.setrlimit(resource.RLIMIT_AS, (limit if hard < 0 else min(limit, hard), hard))
        os.write(pipe, reason_against(path, size).encode(errors="replace")[:4000])
        failed = 0
    finally:
        os._exit(failed)


def reason_against(path: str, size: int) -> str:
    """Why a file must not be read, in words; empty if it can be, or if HDF5 itself refuses it."""
    try:
        file = h5py.File(path, "r")
    except UNREADABLE:
        return ""
    try:
        links: list[tuple[bytes, int]] = []
        file.id.links.visit(lambda name, link: links.append((name, link.type)), info=True)
        if leads_out := [name.decode() for name, kind in links if kind == h5py.h5l.TYPE_EXTERNAL]:
            return f"{leads_out[0]} in it is a link to another file; such links are not followed"
        named = ((name.decode(), file.get(name)) for name, _ in links)  # a thing as often as it is named
        declared, most = 0, max(CLAIMED_FACTOR * size, CLAIMED_BYTES)
        for name, item in [("/", file), *((name, item) for name, item in named if item is not None)]:
            is_data = isinstance(item, h5py.Dataset)
            plain = (*PLAIN, h5py.Reference, h5py.RegionReference) if is_data else PLAIN  # as of scales: never followed
            for key in list(item.attrs):
                with contextlib.suppress(TypeError):  # a kind that NumPy has no name for
                    if not (_is_plain(key, plain) and _is_plain(item.attrs[key], plain)):
                        return f"{key} of {name} in it is neither a number nor a text in UTF-8"
            if not is_data:
                continue
            if item.is_virtual or item.external:
                return f"{name} in it lies in other files, which are not read"
            settings = item.id.get_create_plist()
            filters = [settings.get_filter(number)[0] for number in range(settings.get_nfilters())]
            if strange := [number for number in filters if number not in FILTERS]:
                return f"{name} in it is packed by filter {strange[0]}; {', '.join(FILTERS.values())} are read"
            claimed = math.prod(item.shape or ()) * item.id.get_type().get_size()
            declared += claimed
            if claimed > GZIP_FACTOR * item.id.get_storage_size() + UNPACKED_BYTES or declared > most:
                words = f"claims to hold {claimed:,} bytes, more than is read of a file of {size:,} bytes"
                return f"{name} in it {words}"
            if item.dtype.hasobject:  # any number of its entries can share one list or text of any length
                item[()]
    except MemoryError:
        return "it takes more memory than a file of its size can need"
    except UNREADABLE as error:
        return f"it is damaged: {' '.join(str(error).split())}"
    return ""


PLAIN: tuple[type, ...] = (bytes, int, float, np.generic, np.ndarray, h5py.Empty)


def _is_plain(value: object, plain: tuple[type, ...]) -> bool:
    """True for these kinds, texts in UTF-8, and lists of them."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return all(_is_plain(item, plain) for item in value.ravel())
    if isinstance(value, str):
        return not re.search("[\ud800-\udfff]", value)  # what h5py makes of other bytes
    return isinstance(value, plain)


if __name__ == "__main__":
    print(reason_against(sys.argv[1], os.path.getsize(sys.argv[1])))
