"""The directory of a run: there in full under its name, or not at all."""

import contextlib
import errno
import os
import secrets
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from taichi_bearings.errors import FileError
from taichi_bearings.files.checkpoint_file import NAME as CHECKPOINT


@dataclass
class RunDirectory:
    """A run directory that appears under its name only when complete.

    Files are written into a hidden neighbour and renamed at the end, so a killed run leaves nothing half-written; an
    existing directory is replaced only with `force`, and only then.
    """

    path: Path
    force: bool = False

    def __post_init__(self) -> None:
        try:
            self._prepare()
        except OSError as error:
            raise FileError(f"output directory {self.path} cannot be written: {error.strerror or error}") from None

    def _prepare(self) -> None:
        exists = os.path.lexists(self.path)
        if exists and not self.force:
            raise FileError(f"output directory {self.path} already exists; choose another --out or add --force")
        is_run = any((self.path / name).is_file() for name in ("run.h5", CHECKPOINT)) or (
            self.path.is_dir() and not any(self.path.iterdir())
        )
        if exists and not is_run:
            raise FileError(f"{self.path} is not a run directory; --force replaces only run directories")
        self.partial = self.path.with_name(f".{self.path.name}.partial-{os.getpid()}-{secrets.token_hex(3)}")
        self._made = [folder for folder in self.path.parents if not folder.exists()]  # nearest first
        self.partial.mkdir(parents=True)

    def publish(self) -> None:
        """Rename to the final name, replacing an earlier run if that was allowed."""
        if self.path.exists():
            retired = self.partial.with_name(self.partial.name + "-replaced")
            self.path.rename(retired)
            self.partial.rename(self.path)
            shutil.rmtree(retired)
        else:
            self.partial.rename(self.path)

    def merge(self, outdated: Iterable[str] = ()) -> None:
        """Move the files into the directory, which stands already, one by one and run.h5 last; others there stay.

        outdated : names of files there that go, if there are such and they can be removed.
        """
        for name in outdated:
            with contextlib.suppress(OSError):
                (self.path / name).unlink()
        for file in sorted(self.partial.iterdir(), key=lambda file: file.name == "run.h5"):
            file.replace(self.path / file.name)
        self.partial.rmdir()

    def discard(self) -> None:
        """Leave nothing behind, not even folders that were made for this run."""
        shutil.rmtree(self.partial, ignore_errors=True)
        for folder in self._made:
            with contextlib.suppress(OSError):
                folder.rmdir()


@contextlib.contextmanager
def in_use(path: Path, part: str = "") -> Iterator[None]:
    """Keep other processes from working in a run directory; FileError if one does. A lock ends with its process.

    part : keeps others from that part of the work alone.
    """
    lock = path / (f".in-use-{part}" if part else ".in-use")
    what = f"{part} in {path}" if part else path
    while True:
        try:
            file = lock.open("a")
        except OSError as error:
            raise FileError(f"{path} cannot be written: {error.strerror or error}") from None
        with file:
            try:
                _lock(file.fileno())
            except OSError as error:
                if error.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
                    raise FileError(f"{what} is in use by another process; stop that or wait for its end") from None
                # this file system has no locks
            if not _is_at(file, lock):
                continue  # whoever had it before removed it after we opened it: others would lock a new one
            try:
                yield
            finally:
                with contextlib.suppress(OSError):
                    lock.unlink()
            return


@contextlib.contextmanager
def writable_folder(path: Path, part: str = "") -> Iterator[None]:
    """A folder that files can be written to, made if need be, kept from others meanwhile; FileError if it cannot be.

    part : as in :func:`in_use`.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{path} cannot be written: {error.strerror or error}") from None
    with in_use(path, part):
        try:
            yield
        except OSError as error:
            name = error.filename2 or error.filename or path
            raise FileError(f"{name} cannot be written: {error.strerror or error}") from None


def _lock(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _is_at(file: IO[str], path: Path) -> bool:
    """True if an open file is the one at `path`; Windows lets nobody remove an open file."""
    try:
        return sys.platform == "win32" or os.path.samestat(os.fstat(file.fileno()), path.stat())
    except OSError:
        return False


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait until what was computed is written."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def default_run_path(command: str = "run") -> Path:
    """outputs/<time>-<command>-<id> below the working folder."""
    return Path("outputs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{command}-{secrets.token_hex(2)}"
