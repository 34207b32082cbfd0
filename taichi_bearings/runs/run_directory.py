"""The directory of a run, which appears under its name whole or not at all, and which one process at a time may change.

Also the file checkpoint.h5 in it, which has what a dynamics needs to go on with the same bits. Whoever changes a
directory holds a lock on a file in it or beside it; the lock ends with its process, even if that is killed.
"""

import contextlib
import ctypes
import errno
import os
import re
import secrets
import shutil
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from taichi_bearings import leaving
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.whole_file import layout_of, make_folder, read_hdf5, refuse_standing, write_hdf5
from taichi_bearings.plain_files import locked, real_path, remove, remove_leftover, writing

CHECKPOINT_NAME = "checkpoint.h5"

LEFTOVER = re.compile(r"\.(?P<name>.+)\.(?P<kind>in-use|partial-\d+-[0-9a-f]{6}(?P<old>-replaced)?)", re.DOTALL)
"""Hidden names beside a file or directory `name`: its lock, a new one that does not have the name yet, and an old one
that is to be removed."""


@dataclass
class RunDirectory:
    """A run directory that is being written under a hidden name.

    path : the name that it gets.
    partial : the hidden folder to which files are written until :meth:`publish` renames it.
    replaced : file status of what had the name `path` at the beginning; None if nothing had.
    """

    path: Path
    partial: Path
    replaced: os.stat_result | None = None

    def publish(self) -> None:
        """Give the directory its name `path` in one move, and remove the directory that had this name.

        Raises WriteError if that is not possible. If another program created something under this name in the meantime,
        that stays.
        """
        with writing(self.path):
            standing = os.lstat(self.path) if os.path.lexists(self.path) else None
            if standing is None or self.replaced is None:
                self.partial.rename(self.path)  # the system refuses to replace anything but an empty folder
            elif os.path.samestat(standing, self.replaced):
                exchange(self.partial, self.path)
                shutil.rmtree(self.partial, ignore_errors=True)
            else:
                raise FileExistsError(
                    errno.EEXIST, "another program created a file or folder of this name in the meantime"
                )


@contextlib.contextmanager
def run_directory(path: Path, force: bool = False) -> Iterator[RunDirectory]:
    """Yield a new run directory. It is written under a hidden name, and appears under the name `path` when it is
    published.

    path : name that the directory gets.
    force : True to replace a run directory that exists, if no process works in it. Anything else that has the name is
        never replaced.

    No other process can write to this name inside the block. Files that were not published are removed at the end.
    Raises FileError, before anything is written, if the name cannot be used.
    """
    refuse_name(path)
    if path.is_symlink() or path.name in ("", ".."):
        path = real_path(path)
    if not path.name:
        raise FileError(f"output directory {path} is the root of the file system; choose another --out")
    missing_parents = [folder for folder in path.parents if not folder.exists()]  # nearest first
    with contextlib.ExitStack() as stack:
        stack.callback(_remove_empty, missing_parents)
        with writing(f"output directory {path}"):
            path.parent.mkdir(parents=True, exist_ok=True)
            held = stack.enter_context(locked(path.with_name(f".{path.name}.in-use"), f"output directory {path}"))
            tidy(path.parent, ours=path.name if held else "")
            # a run that is to be replaced is locked as well, so that no process works in it
            if os.path.lexists(path):
                if not force:
                    raise FileError(f"output directory {path} already exists; choose another --out or add --force")
                if not is_run(path) and not (path.is_dir() and not any(path.iterdir())):
                    raise FileError(f"{path} is not a run directory; --force replaces only run directories")
                lock_inside = stack.enter_context(contextlib.ExitStack())
                lock_inside.enter_context(in_use(path))
                if sys.platform == "win32":  # where nothing can be renamed while a file in it is open
                    lock_inside.close()
            standing = path.stat() if path.exists() else None
            partial = path.with_name(f".{path.name}.partial-{os.getpid()}-{secrets.token_hex(3)}")
            stack.callback(leaving.forget_temporary, partial)
            stack.callback(shutil.rmtree, partial, ignore_errors=True)
            leaving.add_temporary(partial)
            partial.mkdir()
        yield RunDirectory(path, partial, standing)


def is_run(path: Path) -> bool:
    """Return True if `path` is the directory of a run, finished or not: it has a run.h5 or a checkpoint."""
    return any((path / name).is_file() for name in ("run.h5", CHECKPOINT_NAME))


def refuse_name(path: Path) -> None:
    """Raise InputError for a path that cannot be encoded in UTF-8, as run files store it."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputError(f"the name {str(path)!r} cannot be written in UTF-8; choose another --out") from None


def _remove_empty(folders: Iterable[Path]) -> None:
    """Remove those of the folders that are empty, one after the other."""
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def tidy(parent: Path, ours: str = "") -> None:
    """Remove the unfinished files and directories that killed processes have left in a folder.

    A directory that was just being replaced gets its name back. What a running process has locked stays.

    parent : the folder.
    ours : name of a file or directory in it whose lock this process itself holds; empty for none.
    """
    # hidden files are removed unless another process writes them; locks and hidden folders wait, by their name
    found: dict[str, list[re.Match[str]]] = {}
    for match in filter(None, map(LEFTOVER.fullmatch, os.listdir(parent))):
        if match["kind"] == "in-use" or (parent / match[0]).is_dir():
            found.setdefault(match["name"], []).append(match)
        else:
            with contextlib.suppress(OSError):
                remove_leftover(parent / match[0])
    # they are touched under the lock of their name alone
    for name, leftovers in found.items():
        with contextlib.suppress(OSError, FileError), contextlib.ExitStack() as stack:
            held = name == ours or stack.enter_context(locked(parent / f".{name}.in-use", name))
            for match in leftovers if held else ():
                left = parent / match[0]
                if match["old"] and not os.path.lexists(parent / name) and not left.is_symlink():
                    left.rename(parent / name)  # :func:`exchange` was killed between its moves
                elif match["kind"] != "in-use":
                    remove(left)


def exchange(one: Path, other: Path) -> None:
    """Swap the names of two directories, in one move where the system can do that.

    one, other : paths of the directories, which lie in the same folder.

    Elsewhere it takes three moves, and :func:`tidy` repairs what is left if the process is killed between them.
    """
    if _swap(one, other):
        return
    retired = one.with_name(one.name + "-replaced")
    other.rename(retired)
    try:
        one.rename(other)
    except OSError:
        retired.rename(other)
        raise
    retired.rename(one)


def _swap(one: Path, other: Path) -> bool:
    """Swap two names in one move and return True; return False where the system or the file system has no such move.

    one, other : paths of two files or directories.

    Raises OSError if the move fails for another reason.
    """
    if sys.platform not in ("linux", "darwin"):
        return False
    library, names = ctypes.CDLL(None, use_errno=True), (os.fsencode(one), os.fsencode(other))
    if sys.platform == "linux":
        if not hasattr(library, "renameat2"):
            return False
        failed = library.renameat2(-100, names[0], -100, names[1], 2)  # -100: from the working folder; 2: exchange
    else:
        failed = library.renamex_np(*names, 2)  # 2: swap
    error = ctypes.get_errno()
    if failed and error not in (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP):
        raise OSError(error, os.strerror(error), str(other))
    return not failed


@contextlib.contextmanager
def completed(path: Path, outdated: Sequence[str] = ()) -> Iterator[Path]:
    """Yield a folder for new files of a run directory; all are moved into the directory together when the block ends.

    path : the run directory, which this process has locked; its other files stay.
    outdated : names of files in it that are removed before, such as figures of the answer that is replaced.

    If the process is killed while files are written, none of them is moved; if it is killed while they are moved,
    :func:`in_use` moves the rest when the directory is used next.
    """
    folder = path / PARTIAL
    try:
        with writing(path, inside=True):
            remove(folder)
            folder.mkdir()
            yield folder
            for name in outdated:
                with contextlib.suppress(OSError):
                    (path / name).unlink()
            folder.rename(path / COMPLETE)
            _complete(path)
    finally:
        remove(folder)


PARTIAL, COMPLETE = ".partial", ".complete"  # names of that folder before and after all of its files are written


def _complete(path: Path) -> None:
    """Move all files of the folder COMPLETE up into its run directory, run.h5 last; then remove the folder. The folder
    has this name only once all its files are written.

    path : the run directory.
    """
    folder = path / COMPLETE
    for file in sorted(folder.iterdir(), key=lambda file: (file.name == "run.h5", file.name)):
        file.replace(path / file.name)
    remove(folder)


@contextlib.contextmanager
def in_use(path: Path, part: str = "") -> Iterator[None]:
    """Lock a run directory inside the block, so that no other process works in it; raise FileError if one already does.
    Files that a killed process has left there are removed, or moved to their places if they were complete.

    path : the run directory.
    part : name for one part of the work, such as a part of a scan, to lock that part alone; empty for all work.
    """
    with locked(path / (f".in-use-{part}" if part else ".in-use"), f"{part} in {path}" if part else f"{path}") as held:
        with writing(path):
            tidy(path)
            if held and not part:
                if (path / COMPLETE).is_dir() and not (path / COMPLETE).is_symlink():
                    _complete(path)
                for left in (COMPLETE, PARTIAL):
                    remove(path / left)
        yield


@contextlib.contextmanager
def claimed(path: Path, force: bool = False) -> Iterator[None]:
    """Lock a file, and the run directory in which it lies, inside the block, so that no other process writes them.

    path : the file, which need not exist.
    force : True to allow that it exists.

    Raises FileError if another process has locked it already, or if the file exists and `force` is False.
    """
    refuse_name(path)
    with contextlib.ExitStack() as stack:
        if is_run(path.parent):
            stack.enter_context(in_use(path.parent))
        held = stack.enter_context(locked(path.with_name(f".{path.name}.in-use"), f"{path}"))
        tidy(path.parent, ours=path.name if held else "")
        refuse_standing([path], force)
        yield


@contextlib.contextmanager
def writable_folder(path: Path, part: str = "") -> Iterator[None]:
    """Make a folder unless it exists, and lock it inside the block, so that no other process works in it.

    path : the folder.
    part : name for one part of the work, to lock that part alone; empty for all work.

    Raises FileError if the folder cannot be made, or if another process works in it.
    """
    refuse_name(path)
    make_folder(path)
    with in_use(path, part), writing(path, inside=True):
        yield


def default_run_path(command: str = "run") -> Path:
    """Return a new name for a run directory, outputs/<time>-<command>-<id> below the working folder.

    command : word for the middle of the name, such as "run".
    """
    return Path("outputs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{command}-{secrets.token_hex(2)}"


def write_checkpoint(folder: Path, scene: str, versions: Mapping[str, str], arrays: Mapping[str, np.ndarray]) -> None:
    """Replace the checkpoint of a run directory in one move, so that a process that is killed leaves the earlier one.

    folder : the run directory.
    scene : the settings as TOML.
    versions : versions of the programs that compute it, by name.
    arrays : state of the method, by name; empty before the first step.
    """
    attributes = layout_of("checkpoint") | {"scene": scene} | dict(versions)
    write_hdf5(folder / CHECKPOINT_NAME, lambda file: file.update(arrays), attributes)


def checkpoint_of(folder: Path) -> Path:
    """Return the path of the checkpoint in the run directory `folder`; raise FileError if there is none."""
    path = folder / CHECKPOINT_NAME
    if not path.is_file():
        raise FileError(f"{folder} cannot be resumed: there is no {path}; only runs with --checkpoint-every have one")
    return path


def read_checkpoint(folder: Path) -> tuple[str, dict[str, np.ndarray]]:
    """Return the settings, as TOML, and the arrays, by name, in the checkpoint of the run directory `folder`.

    There are no arrays if the run had not reached its first checkpoint. Raises FileError if there is no checkpoint, or
    if it is damaged, was changed or has an unknown layout.
    """
    arrays: dict[str, np.ndarray] = {}
    with read_hdf5(checkpoint_of(folder), "checkpoint") as file:
        file.visititems(lambda name, item: arrays.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
        return str(file.attrs["scene"]), arrays
