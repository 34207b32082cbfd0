"""checkpoint.h5: what a dynamics needs to go on with the same bits, beside the scene it belongs to."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.files.whole_file import read_hdf5, write_hdf5

CHECKPOINT_SCHEMA = "taichi_bearings.checkpoint"
CHECKPOINT_VERSION = 1
CHECKPOINT_NAME = "checkpoint.h5"


def write_checkpoint(folder: Path, scene: str, versions: Mapping[str, str], arrays: Mapping[str, np.ndarray]) -> None:
    """Replace the checkpoint of a run directory in one move: a process killed meanwhile leaves the earlier one.

    scene : the settings as TOML. arrays : none before the first step.
    """

    layout = {"schema": CHECKPOINT_SCHEMA, "schema_version": CHECKPOINT_VERSION, "scene": scene}
    write_hdf5(folder / CHECKPOINT_NAME, lambda file: file.update(arrays), layout | dict(versions))


@dataclass(frozen=True)
class StoredCheckpoint:
    """A checkpoint as read back. arrays : None if the run had not come to its first one."""

    scene: str
    arrays: dict[str, np.ndarray] | None


def checkpoint_of(folder: Path) -> Path:
    """The checkpoint of a run directory; FileError if there is none."""
    path = folder / CHECKPOINT_NAME
    if not path.is_file():
        raise FileError(f"{folder} cannot be resumed: there is no {path}; only runs with --checkpoint-every have one")
    return path


def read_checkpoint(folder: Path) -> StoredCheckpoint:
    """What the checkpoint of a run directory holds; FileError if there is none, or one damaged, changed or unknown."""
    path = checkpoint_of(folder)
    with read_hdf5(path, CHECKPOINT_SCHEMA, CHECKPOINT_VERSION, "a checkpoint") as file:
        arrays: dict[str, np.ndarray] = {}
        file.visititems(lambda name, item: arrays.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
        return StoredCheckpoint(str(file.attrs["scene"]), arrays or None)
