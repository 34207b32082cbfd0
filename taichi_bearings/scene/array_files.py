"""Reading arrays that users bring: npy, npz or HDF5, each failure one sentence."""

import math
import zipfile
from pathlib import Path

import numpy as np

from taichi_bearings.checksums import check
from taichi_bearings.errors import FileError
from taichi_bearings.hdf5 import open_hdf5
from taichi_bearings.plain_files import ALL, LEAST, opened

LAYOUT = 1  # version of run.h5


def read_arrays(path: Path, names: list[str]) -> dict[str, np.ndarray]:
    """The named arrays; in npz ``coefficient/x`` may also be stored as ``x``, ``viscosity/x`` as ``x_viscosity``.

    Raises FileError if the file is missing, truncated, of another kind, or lacks a name.
    """
    if path.is_dir():
        path = path / "run.h5"
    if not path.is_file():
        raise FileError(f"{path} does not exist or is not a file")
    try:
        if path.suffix == ".npy":
            if len(names) > 1:
                raise FileError(f"{path} holds one array but {', '.join(names)} are needed; use npz or HDF5")
            opened(path).close()  # no file of holes
            mapped = np.load(path, mmap_mode="r", allow_pickle=False)  # none longer than its file
            if mapped.dtype.itemsize == 0:  # and so without limit
                raise ValueError
            return {names[0]: np.array(mapped)}
        if path.suffix == ".npz":
            with opened(path) as file, zipfile.ZipFile(file) as stored:
                there, most = stored.namelist(), max(ALL * path.stat().st_size, LEAST)
                members = (f"{name}.npy" if f"{name}.npy" in there else f"{short_name(name)}.npy" for name in names)
                return {name: _member(path, stored, member, most) for name, member in zip(names, members, strict=True)}
        with open_hdf5(path) as file:
            if file.attrs.get("schema_version", LAYOUT) != LAYOUT:
                found = file.attrs["schema_version"]
                raise FileError(f"{path} has layout version {found}; this program reads version {LAYOUT}")
            check(path, file)
            if empty := [name for name in names if file[name].shape is None]:
                raise FileError(f"{empty[0]} in {path} is empty")
            return {name: np.asarray(file[name][()]) for name in names}
    except KeyError:
        raise FileError(f"{path} lacks one of the arrays {', '.join(names)}") from None
    except (FileError, MemoryError):
        raise
    except Exception:  # zipfile, zlib, NumPy and HDF5 raise some thirty kinds of errors
        raise FileError(
            f"{path} cannot be read as npy, npz or HDF5: it is damaged, truncated or of another kind"
        ) from None


def _member(path: Path, stored: zipfile.ZipFile, name: str, most: int) -> np.ndarray:
    """An array of an npz file; FileError if it claims more than so many bytes. Nothing is unpickled."""
    found, read = stored.getinfo(name), np.lib.format
    if found.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError
    with stored.open(found) as file:
        if read.read_magic(file) != (1, 0):  # only tables of many columns have longer headers
            raise ValueError
        shape, _, dtype = read.read_array_header_1_0(file)
        claimed = math.prod(shape) * dtype.itemsize
        if dtype.itemsize == 0 or claimed > found.file_size:
            raise ValueError
        if claimed > most:
            words = f"{most:,} bytes, the most that is read of a packed file of its size; numpy.savez packs nothing"
            raise FileError(f"{name} in {path} claims to hold more than {words}")
    with stored.open(found) as file:
        return np.asarray(read.read_array(file, allow_pickle=False))


def short_name(name: str) -> str:
    """What an array of run.h5 is called in an npz file."""
    kind, _, axis = name.rpartition("/")
    return f"{axis}_viscosity" if kind == "viscosity" else axis


def read_coefficients(path: Path, dimension: int, kind: str = "coefficient") -> tuple[np.ndarray, ...]:
    """Coefficients along x, y(, z) in the layout of run.h5: ``/coefficient/x`` and so on. kind : or "viscosity"."""
    names = [f"{kind}/{axis}" for axis in "xyz"[:dimension]]
    stored = read_arrays(path, names)
    for name in names:
        if np.asarray(stored[name]).dtype.kind not in "fiu":
            raise FileError(f"{name} in {path} is of type {np.asarray(stored[name]).dtype}; it must be real numbers")
    return tuple(np.asarray(stored[name], dtype=np.float64) for name in names)
