"""Reads, makes and locks regular files and nothing else: no link, pipe or device stands in for one.

Whoever reads or writes a file that others may have put there goes through here (HDF5: :mod:`taichi_bearings.hdf5`).
"""

import contextlib
import errno
import json
import os
import secrets
import shutil
import stat
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import IO, Any

from taichi_bearings import leaving
from taichi_bearings.errors import FileError, WriteError

# opening never waits for the other end of a pipe
OPEN_FLAGS = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
MOST_JSON = 2**24  # bytes of a summary or report that are read
MOST_PARTS = 200_000  # lists and tables in it
MOST_LINE = 2**20  # bytes of a line of a journal
# the content of a file may be said to take so many times the bytes of the file, or so many in any case
CLAIMED_FACTOR, CLAIMED_BYTES = 16, 2**25


@contextlib.contextmanager
def writing(what: object, inside: bool = False) -> Iterator[None]:
    """Context that turns an OSError inside it into a WriteError, which says what cannot be written.

    what : the file or folder that the block writes, for the message.
    inside : `what` is a folder; the message names the file in it that cannot be written.
    """
    try:
        yield
    except OSError as error:
        named = (error.filename2 or error.filename or what) if inside else what
        stands = isinstance(error, FileExistsError) and error.filename
        reason = f"{error.filename} is no folder" if stands else error.strerror or error
        raise WriteError(f"{named} cannot be written: {reason}") from None


def opened(path: Path, flags: int = os.O_RDONLY) -> IO[bytes]:
    """Open a regular file, unbuffered if it is for writing. Raise OSError if there is none, FileError if something else
    has this name.

    path : path of the file.
    flags : flags of `os.open`.
    """
    strange = FileError(f"{path} is not a regular file")
    try:
        descriptor = os.open(path, flags | OPEN_FLAGS, 0o666)
    except OSError as error:
        if error.errno in (errno.ENXIO, errno.ELOOP):  # a pipe that nobody reads, a link
            raise strange from None
        raise
    with contextlib.ExitStack() as stack:
        stack.callback(os.close, descriptor)
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise strange
        stack.pop_all()
    is_written = bool(flags & (os.O_WRONLY | os.O_RDWR))
    return os.fdopen(descriptor, "wb", buffering=0) if is_written else os.fdopen(descriptor, "rb")


def real_path(path: Path) -> Path:
    """Return where a path leads, all links followed; links that lead nowhere or in a circle are followed as far as they
    go.
    """
    return Path(os.path.realpath(path))


def refuse_link_out(path: Path) -> None:
    """Raise WriteError if `path` is a link to another folder: writing into a folder must change nothing outside of
    it.
    """
    if path.is_symlink() and real_path(path).parent != real_path(path.parent):
        raise WriteError(
            f"{path} is a link out of its folder; nothing is written through such a link, so remove it first"
        )


def read_whole(path: Path, most: int) -> bytes:
    """Return the content of the regular file `path`; raise FileError if it is longer than `most` bytes or cannot be
    read.
    """
    try:
        with opened(path) as file:
            content = file.read(most + 1)
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from None
    if len(content) > most:
        raise FileError(f"{path} is longer than {most:,} bytes, the most that this program reads")
    return content


def read_lines(path: Path) -> Generator[bytes, None, None]:
    """Yield the lines of the regular file `path`, each with its end. For a line longer than MOST_LINE bytes only an
    empty line is yielded; if there is no file, nothing.
    """
    try:
        with opened(path) as file:
            while line := file.readline(MOST_LINE):
                if len(line) == MOST_LINE and not line.endswith(b"\n"):
                    while line and not line.endswith(b"\n"):
                        line = file.readline(MOST_LINE)
                    line = b"\n"
                yield line
    except FileNotFoundError:
        return
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from None


Json = dict[str, Any]
"""An object of JSON or a table of TOML: numbers, texts, truth values and None by name, lists and tables of them."""


def read_json(path: Path) -> Any:
    """Return what the JSON file `path` holds; raise FileError if it is no JSON, or so large that it would take much
    memory.
    """
    try:
        return parse_json(read_whole(path, MOST_JSON).decode())
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path} is not JSON: {str(error).splitlines()[0]}") from None


def parse_json(text: str) -> Any:
    """Return what a text of JSON holds.

    Raises ValueError or RecursionError for a text that is no JSON, is longer than MOST_JSON characters, or has more
    than MOST_PARTS lists and tables, which would take much memory.
    """
    if len(text) > MOST_JSON or text.count("[") + text.count("{") > MOST_PARTS:
        raise ValueError(
            f"it is longer than {MOST_JSON:,} characters or has more than {MOST_PARTS:,} lists and objects, the most "
            "that this program reads"
        )
    return json.loads(text)


def new_file(path: Path) -> tuple[IO[bytes], Path]:
    """Return a new, empty file in the folder of `path`, opened for writing, and its path. It is hidden and locked, so
    that a file that a killed process has left can be told from one that is being written.
    """
    while True:
        name = path.with_name(f".{path.name[:40]}.partial-{os.getpid()}-{secrets.token_hex(3)}")
        leaving.add_temporary(name)
        file = opened(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | NO_LINK)
        if lock(file) is not False and is_at(file, name):
            return file, name
        file.close()  # it was taken for a leftover before it was locked


def write_all(file: IO[bytes], content: bytes | memoryview) -> None:
    """Write all of the content to an unbuffered file, and have the disk keep it."""
    written = 0
    while written < len(content):
        written += file.write(content[written:])
    os.fsync(file.fileno())


def let_go(file: IO[bytes]) -> None:
    """Close a file that is about to be renamed or removed, as Windows demands; on other systems it stays open and
    locked.
    """
    if sys.platform == "win32":
        file.close()


def replace_file(path: Path, content: bytes | memoryview) -> None:
    """Replace `path` by a file with this content in one move; WriteError if that cannot be done."""
    refuse_link_out(path)
    path = real_path(path)  # a link stays one
    with writing(path):
        file, temporary = new_file(path)
        try:
            with file:
                write_all(file, content)
                let_go(file)
                os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
            leaving.forget_temporary(temporary)


def remove(path: Path) -> None:
    """Remove the file, link or folder `path` if it exists; what a link leads to stays."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def remove_leftover(path: Path) -> None:
    """Remove `path`, a new file that a killed process has left; one that another process is writing stays."""
    try:
        with opened(path, os.O_WRONLY | NO_LINK) as file:
            if lock(file) is True:
                let_go(file)
                path.unlink()
    except FileError:  # a link, a pipe
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def locked(path: Path, what: str) -> Iterator[bool]:
    """Hold a lock file inside the block; raise FileError if another process holds it. The value of the block is True,
    or False where the file system has no locks.

    path : path of the lock file, which is made and removed again.
    what : what the lock protects, named in the error.
    """
    refuse_link_out(path)
    while True:
        with leaving.undisturbed():  # so that no signal comes before a file that is made is noted as temporary
            with writing(path.parent):
                file = opened(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | NO_LINK)
            held = lock(file)
            is_ours = held is not False and is_at(file, path)
            if is_ours:
                leaving.add_temporary(path)
        with file:
            if held is False:
                raise FileError(f"{what} is in use by another process; stop that or wait for its end")
            if not is_ours:
                continue  # the process that had the lock removed this file after it was opened here
            try:
                yield bool(held)
            finally:
                with leaving.undisturbed():
                    if is_at(file, path):  # else the folder was exchanged, and the lock file with it
                        with contextlib.suppress(OSError):
                            let_go(file)
                            path.unlink()
                    leaving.forget_temporary(path)
        return


def lock(file: IO[bytes]) -> bool | None:
    """Take the system's lock of a file, which ends with the process.

    returns : False if another process has it, None where this file system has no locks.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return False if error.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK) else None
    return True


def is_at(file: IO[bytes], path: Path) -> bool:
    """Return True if an open file is the one at `path`; always on Windows, which lets nobody remove an open file."""
    try:
        return sys.platform == "win32" or os.path.samestat(os.fstat(file.fileno()), path.lstat())
    except OSError:
        return False
