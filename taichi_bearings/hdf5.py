"""Opens HDF5 files from anywhere safely: what a file claims to hold is checked before it is read.

At some damaged files a call of the HDF5 library never returns, so that Python handles no signal. A file that may be one
of them is opened with Ctrl-C and SIGTERM at their default action, which ends a command; for any other file only the
second signal has its default action.
"""

import contextlib
import errno
import math
import mmap
import os
import re
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.leaving import by_default, by_default_next_time
from taichi_bearings.plain_files import CLAIMED_BYTES, CLAIMED_FACTOR, opened

LAYOUT = 2  # version of all files of the package
READ_LAYOUTS = (1, LAYOUT)  # versions that are read
UNREADABLE = (OSError, KeyError, ValueError, TypeError, AttributeError, IndexError, RuntimeError)
"""Exceptions that HDF5 and NumPy raise at damaged files."""
GZIP_FACTOR = 1032  # most bytes that gzip can make of one
UNPACKED_BYTES = 2**20  # a data set may claim so many bytes whatever is stored
FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32", 32000: "lzf"}
HEAP = b"GCOL\1\0\0\0"  # how a heap of texts begins
NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP}  # what a file system without locks says


@contextlib.contextmanager
def open_hdf5(path: Path, kind: str = "an HDF5 file") -> Iterator[h5py.File]:
    """Open an HDF5 file for reading, as a context.

    path : path of a regular file.
    kind : what it is read as, in words, for errors.

    Raises FileError for a file that leads out of itself or claims more than it can hold, and for whatever a damaged one
    makes HDF5 and NumPy raise inside the block.
    """
    try:
        with opened(path) as file:  # a regular file
            size = os.fstat(file.fileno()).st_size
        with by_default_next_time() if _has_whole_heaps(path) else by_default():
            stored = file_at(path)
            reason = reason_against(stored, size)
        with stored:
            if reason:
                raise FileError(f"{path} is refused: {reason}")
            yield stored
    except UNREADABLE as error:
        words = " ".join(str(error).strip("'").split())
        raise FileError(f"{path} cannot be read as {kind}: {words}") from None


def _has_whole_heaps(path: Path) -> bool:
    """Return True unless a heap of the HDF5 file `path` (a block in which texts lie one after another) is damaged, by a
    piece that reaches beyond its end or by free space of length 0. There the library HDF5 2.0 may read on for ever.
    """
    with (
        opened(path) as file,
        contextlib.suppress(ValueError),  # an empty file cannot be mapped
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content,
    ):
        heap = content.find(HEAP)
        while heap >= 0:
            place, end = heap + 16, heap + int.from_bytes(content[heap + 8 : heap + 16], "little")
            while place + 16 <= min(end, len(content)):
                size = int.from_bytes(content[place + 8 : place + 16], "little")
                is_free = content[place : place + 2] == b"\0\0"
                place += size if is_free else 16 + 8 * -(-size // 8)
                if place > end or (is_free and size == 0):
                    return False
            heap = content.find(HEAP, heap + 1)
    return True


def file_at(path: Path) -> h5py.File:
    """Return the HDF5 file at `path`, opened for reading, without a lock where the file system has none.

    That is safe since this program replaces a file in one move, and never writes into one that others may be reading.
    """
    try:
        return h5py.File(path, "r")
    except OSError as error:
        found = re.search(r"errno = (\d+)", str(error))
        if "lock" not in str(error) or found is None or int(found[1]) not in NO_LOCKS:
            raise
    return h5py.File(path, "r", locking=False)


def reason_against(file: h5py.File, size: int) -> str:
    """Return in words why an open file must not be read; "" if it can be.

    size : size of the file in bytes.
    """
    try:
        return _reason_in_content(file, size)
    except UNREADABLE as error:
        return f"it is damaged: {' '.join(str(error).split())}"


def _reason_in_content(file: h5py.File, size: int) -> str:
    """Return in words why an open file must not be read, "" if it can be: it has a link or data in another file, an
    item of an unknown kind, or a data set that claims more bytes than such a file can hold.

    size : size of the file in bytes.
    """
    links: list[tuple[bytes, int]] = []
    file.id.links.visit(lambda name, link: links.append((name, link.type)), info=True)
    if leads_out := [name.decode() for name, kind in links if kind == h5py.h5l.TYPE_EXTERNAL]:
        return f"{leads_out[0]} in it is a link to another file; such links are not followed"
    named = ((name.decode(), file.get(name)) for name, _ in links)  # an item with two names counts twice
    declared, most = 0, max(CLAIMED_FACTOR * size, CLAIMED_BYTES)
    for name, item in [("/", file), *((name, item) for name, item in named if item is not None)]:
        if reason := _reason_in_attributes(name, item):
            return reason
        if not isinstance(item, h5py.Dataset):
            continue
        if reason := _reason_in_data(name, item):
            return reason
        claimed = math.prod(item.shape or ()) * item.id.get_type().get_size()
        declared += claimed
        # more than what is stored can be unpacked to; or, with the data sets before it, more than the file may claim
        if claimed > GZIP_FACTOR * item.id.get_storage_size() + UNPACKED_BYTES or declared > most:
            words = f"claims to hold {claimed:,} bytes, more than is read of a file of {size:,} bytes"
            return f"{name} in it {words}"
    return ""


def _reason_in_attributes(name: str, item: h5py.HLObject) -> str:
    """Return in words which attribute of a group or data set is neither a number nor a text; "" if there is none.

    name : name of the item, for the sentence.
    item : the group or data set.
    """
    plain = (*PLAIN, h5py.Reference, h5py.RegionReference)  # as of scales, which are never followed
    for key in list(item.attrs):
        with contextlib.suppress(TypeError):  # a kind that NumPy has no name for
            if not (
                _is_plain(key, PLAIN) and _is_plain(item.attrs[key], plain if isinstance(item, h5py.Dataset) else PLAIN)
            ):
                return f"{key} of {name} in it is neither a number nor a text in UTF-8"
    return ""


def _reason_in_data(name: str, item: h5py.Dataset) -> str:
    """Return in words why a data set is no array of numbers or texts in this file; "" if it is one, plain or packed by
    a known filter.

    name : name of the data set, for the sentence.
    item : the data set.
    """
    if item.is_virtual or item.external:
        return f"{name} in it lies in other files, which are not read"
    settings = item.id.get_create_plist()
    filters = [settings.get_filter(number)[0] for number in range(settings.get_nfilters())]
    if strange := [number for number in filters if number not in FILTERS]:
        return f"{name} in it is packed by filter {strange[0]}; {', '.join(FILTERS.values())} are read"
    if item.dtype.hasobject and not (h5py.check_string_dtype(item.dtype) or h5py.check_ref_dtype(item.dtype)):
        return f"{name} in it holds lists, which can be of any length; numbers and texts are read"
    return ""


PLAIN: tuple[type, ...] = (bytes, int, float, np.generic, np.ndarray, h5py.Empty)


def _is_plain(value: object, plain: tuple[type, ...]) -> bool:
    """Return True if the value of an attribute is of one of the types `plain`, a text in UTF-8, or an array of these.

    value : the value, as h5py reads it.
    """
    if isinstance(value, np.ndarray) and value.dtype == object:
        return all(_is_plain(item, plain) for item in value.ravel())
    if isinstance(value, str):
        return not re.search("[\ud800-\udfff]", value)  # what h5py makes of other bytes
    return isinstance(value, plain)
