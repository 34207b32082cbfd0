"""HDF5 files that are there in full or not at all."""

import contextlib
import io
import os
from collections.abc import Callable
from pathlib import Path

import h5py

from taichi_bearings.errors import FileError


def write_hdf5(path: Path, fill: Callable[[h5py.File], None]) -> None:
    """Write what `fill` puts into a file, and replace `path` by it in one move; FileError if that cannot be done.

    The file is built in memory first: on a full disk HDF5 itself fails in ways that cannot be caught.
    """
    whole = io.BytesIO()
    with h5py.File(whole, "w") as file:
        fill(file)
    temporary = path.with_name(path.name + ".partial")
    try:
        with temporary.open("wb") as written:
            written.write(whole.getbuffer())
            written.flush()
            os.fsync(written.fileno())
        os.replace(temporary, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise FileError(f"{path} cannot be written: {error.strerror or error}") from None
