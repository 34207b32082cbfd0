"""Reading arrays that users bring: npy, npz or HDF5, each failure one sentence."""

import zipfile
from pathlib import Path

import h5py
import numpy as np

from taichi_bearings.checksums import UNREADABLE, check
from taichi_bearings.errors import FileError


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
            return {names[0]: np.load(path, allow_pickle=False)}
        if path.suffix == ".npz":
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                return {name: stored[name if name in stored else short_name(name)] for name in names}
        with h5py.File(path, "r") as file:
            check(path, file)
            return {name: file[name][()] for name in names}
    except KeyError:
        raise FileError(f"{path} lacks one of the arrays {', '.join(names)}") from None
    except (*UNREADABLE, EOFError, zipfile.BadZipFile):
        raise FileError(
            f"{path} cannot be read as npy, npz or HDF5: it is damaged, truncated or of another kind"
        ) from None


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
