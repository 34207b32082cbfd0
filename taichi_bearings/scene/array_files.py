"""Arrays that users bring, given in Python or read from npy, npz or HDF5 files, and their checks.

Each failure is an InputError or a FileError of one sentence.
"""

import math
import zipfile
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings.checksums import open_checked
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.memory import refuse_beyond
from taichi_bearings.plain_files import CLAIMED_BYTES, CLAIMED_FACTOR, opened


class TextFileError(FileError):
    """Raised for a text file, such as a table, where arrays are to be read."""


class LackingArrayError(FileError):
    """Raised for a file without an array that it must have."""


def own_array(name: str, values: ArrayLike) -> np.ndarray:
    """Return a read-only copy of values of the user as an array in double precision.

    name : what the values are, in the plural, for messages.

    Raises InputError where the values make no array of real numbers, or some are masked.
    """
    try:
        array = np.asanyarray(values)
    except (ValueError, OverflowError, TypeError):
        raise InputError(f"{name} are lists of unequal lengths; they must be an array of real numbers") from None
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name} are of type {array.dtype}; they must be real numbers")
    if np.ma.is_masked(array):
        raise InputError(f"{name} have masked entries; every entry must be a number")
    with np.errstate(over="ignore"):  # of longer floats; infinities are refused later
        copy = np.array(array, dtype=np.float64, order="C", subok=False)
    copy.setflags(write=False)
    return copy


def read_arrays(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Return the arrays of a file by name; optional ones that the file lacks are left out.

    path : npy, npz or HDF5 file, or the folder of a run, whose run.h5 is read.
    names : names of the arrays that the file must have. In npz ``coefficient/x`` may also be stored as ``x``, and
        ``viscosity/x`` as ``x_viscosity``.
    optional : names that the file may lack.

    Raises FileError if the file is missing, truncated or of another kind: TextFileError if it is a text file, and
    LackingArrayError, which names the arrays, if it lacks some of `names`.
    """
    if path.is_dir():
        path = path / "run.h5"
    if not path.is_file():
        raise FileError(f"{path} does not exist or is not a file")
    try:
        if path.suffix == ".npy":
            if len(names) > 1:
                raise FileError(f"{path} holds one array but {', '.join(names)} are needed; use npz or HDF5")
            opened(path).close()  # a regular file
            mapped = np.load(path, mmap_mode="r", allow_pickle=False)  # refuses an array that is longer than its file
            if mapped.dtype.itemsize == 0:  # entries without bytes, of which any file could claim any number
                raise ValueError
            refuse_beyond(mapped.nbytes, f"the array in {path}")
            return {names[0]: np.array(mapped)}
        if path.suffix == ".npz":
            with opened(path) as file, zipfile.ZipFile(file) as stored:
                there = [name.removesuffix(".npy") for name in stored.namelist()]
                most = max(CLAIMED_FACTOR * path.stat().st_size, CLAIMED_BYTES)
                members = {name: name if name in there else short_name(name) for name in (*names, *optional)}
                _refuse_lack(path, [members[name] for name in names], there)
                return {name: _member(path, stored, f"{m}.npy", most) for name, m in members.items() if m in there}
        _refuse_text(path)
        with open_checked(path) as file:
            _refuse_lack(path, names, file)
            found = [name for name in (*names, *optional) if name in file]
            if empty := [name for name in found if file[name].shape is None]:
                raise FileError(f"the array {empty[0]} in {path} is empty; it must hold numbers")
            return {name: np.asarray(file[name][()]) for name in found}
    except (FileError, MemoryError):
        raise
    except Exception:  # zipfile, zlib, NumPy and HDF5 raise some thirty kinds of errors
        raise FileError(
            f"{path} cannot be read as npy, npz or HDF5: it is damaged, truncated or of another kind"
        ) from None


def _refuse_text(path: Path) -> None:
    """Raise TextFileError if the first line of a file is text, as in a table of numbers.

    path : the file.
    """
    with opened(path) as file:
        begin = file.read(64).split(b"\n")[0].rstrip(b"\r")
    if begin and begin.isascii() and begin.decode().replace("\t", " ").isprintable():
        raise TextFileError(f"{path} is a text file; arrays are read from npy, npz or HDF5 files")


def _refuse_lack(path: Path, names: Iterable[str], there: Collection[str]) -> None:
    """Raise LackingArrayError if the file `path` lacks some of the arrays `names`.

    there : names of the arrays that it has.
    """
    if lacking := [name for name in names if name not in there]:
        raise LackingArrayError(f"{path} lacks the array{'s' if len(lacking) > 1 else ''} {', '.join(lacking)}")


def _member(path: Path, stored: zipfile.ZipFile, name: str, most: int) -> np.ndarray:
    """Return an array of an npz file; nothing in it is unpickled.

    path : path of the file, for messages.
    stored : the opened file.
    name : name of the member, such as ``x.npy``.
    most : largest number of bytes that the array may have.

    Raises FileError if its header claims more, or Python objects.
    """
    found, read = stored.getinfo(name), np.lib.format
    if found.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError
    with stored.open(found) as file:
        if read.read_magic(file) != (1, 0):  # only tables of many columns have longer headers
            raise ValueError
        shape, _, dtype = read.read_array_header_1_0(file)
        if dtype.hasobject:
            raise FileError(f"{name} in {path} holds objects of Python such as None; it must hold numbers alone")
        claimed = math.prod(shape) * dtype.itemsize
        if dtype.itemsize == 0 or claimed > found.file_size:
            raise ValueError
        if claimed > most:
            raise FileError(
                f"{name} in {path} claims to hold more than {most:,} bytes, the most that is read from a compressed "
                "file of this size; store it uncompressed by numpy.savez"
            )
    with stored.open(found) as file:
        return np.asarray(read.read_array(file, allow_pickle=False))


def short_name(name: str) -> str:
    """Return the name in an npz file of an array of run.h5: ``x`` for ``coefficient/x``, ``x_viscosity`` for
    ``viscosity/x``.
    """
    kind, _, axis = name.rpartition("/")
    return f"{axis}_viscosity" if kind == "viscosity" else axis


def read_coefficients(path: Path, kind: str = "coefficient", dimension: int = 0) -> tuple[np.ndarray, ...]:
    """Return the coefficients in a file with the layout of run.h5, ``/coefficient/x`` and so on: for each axis an array
    of the contacts along it, with a leading axis of samples if the file has one.

    path : npz or HDF5 file, or the folder of a run.
    kind : "coefficient" or "viscosity".
    dimension : dimension of the lattice, 2 or 3; 0 to take that of the file, which is 2 if it has no array along z.

    Raises FileError if an array is missing: in 3D that along z, even if `dimension` does not say that it is 3D.
    """
    along = [f"{kind}/{axis}" for axis in "xyz"]
    stored = read_arrays(path, along[: dimension or 2], () if dimension else along[2:])
    for name, values in stored.items():
        if values.dtype.kind not in "fiu":
            raise FileError(f"{name} in {path} is of type {values.dtype}; it must be real numbers")
    x, y = (values.shape for values in list(stored.values())[:2])
    if len(stored) == 2 and _fit_one_lattice(3, x, y) and not _fit_one_lattice(2, x, y):
        read_arrays(path, along)  # the shapes are of a lattice in 3D: an array along z is missing, which this raises
    return tuple(values.astype(np.float64) for values in stored.values())


def _fit_one_lattice(dimension: int, x: tuple[int, ...], y: tuple[int, ...]) -> bool:
    """Return True if some lattice of this dimension has as many contacts along x and y as these shapes say.

    x, y : shapes of the coefficients along x and along y, with or without a leading axis of samples.
    """
    if len(x) != len(y) or len(x) not in (dimension, dimension + 1):
        return False
    # along its own axis an array is shorter by 1 than others, or as long if the axis is periodic; the height is not
    more = [along_y - along_x for along_x, along_y in zip(x, y, strict=True)]
    first, second, *others = more[-dimension:]
    return first in (0, 1) and second in ((-1,) if dimension == 2 else (0, -1)) and not any(more[:-dimension] + others)
