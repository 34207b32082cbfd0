"""run.h5 of a packing as the verifier reads it: its arrays, within the limits that any packing has, and its claims."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.verifier.samples import LAWS
from taichi_bearings.verifier.stored_run import (
    REPORTED_SETS,
    StoredRun,
    array_of,
    attributes_of,
    changed_sets,
    read_lattice,
    read_with,
    settings_of,
)

NEEDED_OF_PACKINGS = ("law", "scene", "power", "lower_bound", "status")  # attributes
STORED_SIZES = {"radius": "sphere", "friction": "contact", "viscosity": "contact", "normal_force": "contact"}
LEAST_STORED, MOST_STORED = 1e-15, 1e15  # of these, and most of places and spins
OPTIONAL_SETS = ("proven", "slip_bound")


@dataclass(frozen=True)
class StoredPacking:
    """packing : arrays by name: center (N, D), contact (E, 2), driven (N,), spin (N, 3) or (N,), radius (N,), normal
    (E, D), friction, normal_force (E,) and, with the law coulomb-viscous, viscosity (E,). spin : of all spheres.
    friction : (E, 3) or (E,). reported : by name, (E,). others, changed : as of a `StoredRun`.
    """

    path: Path
    law: str
    packing: dict[str, np.ndarray]
    spin: np.ndarray
    friction: np.ndarray
    attributes: dict[str, Any]
    settings: dict[str, Any]
    reported: dict[str, np.ndarray]
    others: list[str]
    changed: tuple[str, ...] | None

    def claimed(self, name: str) -> Any:
        """An attribute; None where the file leaves it open."""
        value = self.attributes.get(name)
        if isinstance(value, np.ndarray):
            raise FileError(f"{self.path} has {value.size} values of {name!r}; a packing has one")
        return None if value == "" or value != value else value

    def setting(self, name: str, default: float) -> float:
        value = self.settings.get(name, default)
        if type(value) not in (int, float):
            raise FileError(f"the scene in {self.path} has {value!r} for {name!r}; it must be a number")
        return float(value)


def read_any_run(run: Path) -> StoredRun | StoredPacking:
    """A run directory or its run.h5, of a lattice or of a packing; FileError where it cannot be read."""

    def read(path: Path, file: h5py.File) -> StoredRun | StoredPacking:
        return _read(path, file) if "packing" in file else read_lattice(path, file)

    return read_with(run, read)


def _read(path: Path, file: h5py.File) -> StoredPacking:
    attributes = attributes_of(path, file, NEEDED_OF_PACKINGS)
    law = attributes["law"]
    if not isinstance(law, str) or law not in LAWS:
        raise FileError(f"{path} has the law {law!r}; {', '.join(LAWS)} can be verified")
    places, pairs = (np.shape(file[f"packing/{name}"]) for name in ("center", "contact"))
    if len(places) != 2 or places[1] not in (2, 3) or not places[0] or len(pairs) != 2:
        raise FileError(f"{path} has centres of shape {places} and contacts of shape {pairs}; (N, 2 or 3) and (E, 2)")
    (count, dimension), contacts = places, pairs[0]
    parts = (3,) if dimension == 3 else ()
    get = partial(array_of, path, file, 1)
    shapes: dict[str, tuple[int, ...]] = {
        "center": places, "contact": (contacts, 2), "driven": (count,), "spin": (count, *parts), "radius": (count,),
        "normal": (contacts, dimension), "friction": (contacts,), "normal_force": (contacts,),
        **({"viscosity": (contacts,)} if all(LAWS[law]) else {}),
    }  # fmt: skip
    packing = {name: get(f"packing/{name}", shape)[0] for name, shape in shapes.items()}
    for name in ("contact", "driven"):
        _refuse(path, name, "sphere" if name == "driven" else "contact", packing[name],
                (packing[name] >= -(name == "driven")) & (packing[name] < count))  # fmt: skip
        packing[name] = packing[name].astype(np.int64)
    _refuse(path, "contact", "contact", packing["contact"], packing["contact"][:, :1] != packing["contact"][:, 1:])
    for name, what in STORED_SIZES.items():
        if name in packing:
            values = packing[name]
            absent = (values == 0) & (name in ("friction", "viscosity"))
            _refuse(path, name, what, values, (values >= LEAST_STORED) & (values <= MOST_STORED) | absent)
    packing["spin"][packing["driven"] < 0] = 0.0
    for name, what in (("center", "sphere"), ("spin", "sphere"), ("normal", "contact")):
        _refuse(path, name, what, packing[name], np.abs(packing[name]) <= MOST_STORED)
    spin, friction = get("spin", (count, *parts))[0], get("contact/friction", (contacts, *parts))[0]
    names = [*REPORTED_SETS, *(name for name in OPTIONAL_SETS if f"contact/{name}" in file)]
    reported = {name: get(f"contact/{name}", (contacts,))[0] for name in names}
    others = [name for name in file if name not in ("packing", "spin", "contact")]
    others += [f"packing/{name}" for name in file["packing"] if name not in shapes]
    others += [f"contact/{name}" for name in file["contact"] if name not in (*names, "friction")]
    settings = settings_of(path, str(attributes["scene"]))
    return StoredPacking(path, law, packing, spin, friction, attributes, settings, reported, others,
                         changed_sets(path, file))  # fmt: skip


def _refuse(path: Path, name: str, what: str, values: np.ndarray, fine: np.ndarray | np.bool_) -> None:
    """FileError for the first of these values that is not fine."""
    fine = fine.reshape(len(values), -1).all(axis=1) if len(values) else np.ones(0, dtype=bool)
    if not fine.all():
        first = int(np.argmin(fine))
        raise FileError(f"{path} has {values[first].tolist()!r} for packing/{name} of {what} {first}; that cannot be")
