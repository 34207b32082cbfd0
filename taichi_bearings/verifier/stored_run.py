"""run.h5 of a lattice or a packing as its own reader sees it: the numbers to be judged, and what it claims of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.verifier.network import StoredPacking
from taichi_bearings.verifier.samples import LAWS, Samples

AXES = "xyz"
Table = dict[str, Any]
Groups = dict[str, tuple[int, ...]]
"""Group of the file -> shape of its arrays without the axis of samples."""
LAYOUT = 1  # version that is read
NEEDED_ATTRIBUTES = ("law", "scene", "power", "lower_bound", "status")
OF_LATTICES = ("shape", "spin_top", "spin_bottom", "normal_force", "radius")
ATTRIBUTE_TYPES = {
    **dict.fromkeys(("status", "coefficients", "method", "arch", "precision", "proof"), ("a text", str)),
    **dict.fromkeys(("seed", "contacts", "slipping", "slipless", "undecided", "critical", "unproven", "iterations",
                     "tied_contacts", "spheres", "driven_spheres"), ("a whole number", int)),
    **dict.fromkeys(("states_proven", "minimum_is_unique", "cut_is_unique", "yields"), ("true or false", bool)),
}  # fmt: skip
"""Type of an attribute, if it is no real number; truths in a list with gaps are numbers."""
NEVER_OPEN = ("states_proven",)
WHOLE_DATA = ("/state", "/proven", "/contact", "/driven")  # that hold whole numbers
REPORTED_SETS, OPTIONAL_SETS = ("slip", "power", "force", "state"), ("slip_bound", "proven")
OF_SPHERES = ("center", "driven", "spin", "radius")  # arrays of packings
STORED_SIZES = ("radius", "friction", "viscosity", "normal_force")
LEAST_STORED, MOST_STORED = 1e-15, 1e15  # of these, and most of places and spins
FOLLOWED = ("cundall-strack", "gradient-descent")  # methods of packings that end in a motion
MOST_SCENE_TEXT = 2**22  # letters of the scene
A_LINE = re.compile(r"""\s*([\w-]+\s*=\s*("|[^"{]*\Z|\[["xyz, ]*\]\Z)|#|\Z)""")
"""A key without dots and its value, which is no table: keys of many dots take memory like their length squared. Words
in a list are axes."""


@dataclass(frozen=True)
class StoredRun:
    """attributes : of the file. settings : its scene. reported : by name, (R, E), of lattices all contacts along x,
    then y, then z. history : columns (checks,) or (R, checks). others : names of what else is in the file.
    """

    path: Path
    samples: Samples | StoredPacking
    attributes: dict[str, Any]
    settings: dict[str, Any]
    reported: dict[str, np.ndarray]
    history: dict[str, np.ndarray]
    others: list[str]

    @property
    def is_dynamics(self) -> bool:
        """True if forces and states are those of a motion."""
        if isinstance(self.samples, Samples):
            return "time" in self.history
        return self.attributes.get("method") in FOLLOWED

    def claimed(self, name: str) -> list[Any]:
        """An attribute, sample by sample; None where the file leaves it open."""
        value = np.asarray(self.attributes.get(name, ""))
        if value.shape not in ((), *([(self.samples.count,)] if self.samples.count > 1 else [])):
            raise FileError(f"{self.path} has {value.size} values of {name!r} for {self.samples.count} samples")
        value = value.reshape(-1)
        values = value.tolist() if len(value) == self.samples.count else value.tolist() * self.samples.count
        found = [None if v == "" or (isinstance(v, float) and np.isnan(v)) else v for v in values]
        words, *kinds = ATTRIBUTE_TYPES.get(name, ("a number", int, float))
        if bool in kinds:
            found = [bool(v) if self.samples.count > 1 and v in (0.0, 1.0) else v for v in found]
        for v, given in zip(found, values, strict=True):
            is_open = v is None and not (name in NEVER_OPEN and name in self.attributes)
            is_open &= bool not in kinds or self.samples.count > 1 or given == ""  # no number alone is a truth
            if not is_open and type(v) not in kinds:
                raise FileError(f"{self.path} has {given!r} for {name!r}; it must be {words}")
        return found

    def setting(self, name: str, default: float) -> float:
        """A number of the scene."""
        value = self.settings.get(name, default)
        if type(value) not in (int, float):
            raise FileError(f"the scene in {self.path} has {value!r} for {name!r}; it must be a number")
        return float(value)


def read_stored_run(run: Path) -> list[StoredRun]:
    """A run directory or its run.h5, of several replicas of a packing one by one; FileError in one sentence where it
    cannot be read."""
    path = run / "run.h5" if run.is_dir() else run
    if not path.is_file():
        lacking = f"{path} is not a file" if path.exists() else f"there is no {path}"
        raise FileError(f"{run} is not a run: {lacking}")
    try:
        with h5py.File(path, "r") as file:
            stored = file["packing/center"] if "packing" in file else None
            replicas = 1 if stored is None or stored.ndim < 3 else max(len(stored), 1)
            return [_read(path, file, number, replicas) for number in range(replicas)]
    except FileError:
        raise
    except (OSError, KeyError, ValueError, TypeError, AttributeError, IndexError, RuntimeError) as error:
        raise FileError(f"{path} cannot be read as a run: {str(error).strip(chr(39))}") from None


def _read(path: Path, file: h5py.File, number: int, replicas: int) -> StoredRun:
    """number : of the replicas of a packing, where these are several; lattices have theirs side by side."""
    is_lattice = "packing" not in file
    attributes = _attributes(path, file, NEEDED_ATTRIBUTES + OF_LATTICES * is_lattice)
    get = partial(_array, path, file)
    if replicas > 1:
        attributes = {name: _of_replica(value, number, replicas) for name, value in attributes.items()}
        get = partial(_array, path, file, number=number, replicas=replicas)
    law = attributes["law"]
    if not isinstance(law, str) or law not in LAWS:
        raise FileError(f"{path} has the law {law!r}; {', '.join(LAWS)} can be verified")
    settings = _settings(path, str(attributes["scene"]))
    samples, groups, known = (_lattice if is_lattice else _packing)(path, file, get, attributes, settings)
    names = [*REPORTED_SETS, *(name for name in OPTIONAL_SETS if f"{[*groups][-1]}/{name}" in file)]
    reported = {}
    for name in names:
        parts = [get(samples.count, f"{group}/{name}", shape) for group, shape in groups.items()]
        reported[name] = np.concatenate([part.reshape(samples.count, -1) for part in parts], axis=1)
    known |= {f"{group}/{name}" for group in groups for name in (*names, "friction")}
    count = max(samples.count, replicas)
    history = {name: _column(path, name, values, count) for name, values in file.get("history", {}).items()}
    if replicas > 1:
        history = {name: column if column.ndim == 1 else column[number] for name, column in history.items()}
    return StoredRun(path, samples, attributes, settings, reported, history, [*_unread(file, "", known)])


def _of_replica(value: Any, number: int, replicas: int) -> Any:
    """An attribute of one of several replicas: its own, or that of all of them."""
    if not isinstance(value, np.ndarray) or value.shape != (replicas,):
        return value
    return value[number].item() if isinstance(value[number], np.generic) else value[number]


def _unread(group: h5py.Group, inside: str, known: set[str]) -> Iterator[str]:
    """Names of what is in the group and not known, nor holds anything that is."""
    for name in (inside + part for part in group):
        if any(one.startswith(f"{name}/") for one in known):
            yield from _unread(group.file[name], f"{name}/", known)
        elif name not in known:
            yield name


def _attributes(path: Path, file: h5py.File, needed: tuple[str, ...]) -> dict[str, Any]:
    """Those of a run of a known version, with the needed ones among them."""
    attributes = {key: value.item() if isinstance(value, np.generic) else value for key, value in file.attrs.items()}
    if attributes.get("schema") != "taichi_bearings.run":
        raise FileError(f"{path} was not written by taichi_bearings")
    version = attributes.get("schema_version", LAYOUT)
    if type(version) is not int or version != LAYOUT:
        raise FileError(f"{path} has layout version {version!r}; this program reads version {LAYOUT}")
    for name in needed:
        if name not in attributes:
            raise FileError(f"{path} lacks the attribute {name!r}; it is damaged or was changed")
    return attributes


def _lattice(
    path: Path, file: h5py.File, array: Callable[..., np.ndarray], attributes: Table, settings: Table
) -> tuple[Samples, Groups, set[str]]:
    """What is in the open file of a run of a lattice."""
    shape = _shape(path, attributes["shape"])
    axes = AXES[: len(shape)]
    count = 1 if file["coefficient/x"].ndim == len(shape) else len(file["coefficient/x"])
    if count < 1:
        raise FileError(f"{path} holds no sample")
    parts = () if len(shape) == 2 else (3,)
    periodic = _periodic(path, settings.get("periodic", []), shape)
    contacts = {name: tuple(n - (a == axis and axis not in periodic) for a, n in enumerate(shape))
                for axis, name in enumerate(axes)}  # fmt: skip
    get = partial(array, count)

    def by_axis(name: str, parts: tuple[int, ...] = ()) -> tuple[np.ndarray, ...]:
        return tuple(get(name.format(axis), (*n, *parts)) for axis, n in contacts.items())

    spin, law = get("spin", (*shape, *parts)), attributes["law"]
    samples = Samples(
        shape=shape,
        law=law,
        coefficient=by_axis("coefficient/{}"),
        **{name: _number(path, attributes, name) for name in ("spin_top", "spin_bottom", "normal_force", "radius")},
        direction=_numbers(path, "direction", settings.get("direction", [1.0, 1.0, 0.0]), (3,)),
        spin=spin,
        spin_rounding=get("spin_rounding", (*shape, *parts)) if "spin_rounding" in file else np.zeros_like(spin),
        friction=by_axis("contact/{}/friction", parts),
        viscosity=by_axis("viscosity/{}") if all(LAWS[law]) else (),
        top=_state(path, settings, "top", len(shape)),
        bottom=_state(path, settings, "bottom", len(shape)),
        periodic=periodic,
    )
    known = {"coefficient", "spin", *(["viscosity"] if samples.viscosity else [])}
    return samples, {f"contact/{axis}": n for axis, n in contacts.items()}, known


def _packing(
    path: Path, file: h5py.File, array: Callable[..., np.ndarray], attributes: Table, _: Table
) -> tuple[StoredPacking, Groups, set[str]]:
    """What is in the open file of a run of a packing, or of one replica, within the limits that any packing has."""
    places, pairs = (file[f"packing/{name}"].shape for name in ("center", "contact"))
    if len(places) == 3 and len(pairs) == 3:
        places, pairs = places[1:], pairs[1:]
    if len(places) != 2 or places[1] not in (2, 3) or not places[0] or len(pairs) != 2:
        raise FileError(f"{path} has centres of shape {places} and contacts of shape {pairs}; (N, 2 or 3) and (E, 2)")
    (count, dimension), contacts = places, pairs[0]
    parts = (3,) if dimension == 3 else ()
    get, law = partial(array, 1), attributes["law"]
    shapes: Groups = {
        "center": places, "contact": (contacts, 2), "driven": (count,), "spin": (count, *parts), "radius": (count,),
        "normal": (contacts, dimension), "friction": (contacts,), "normal_force": (contacts,),
        **({"viscosity": (contacts,)} if all(LAWS[law]) else {}),
    }  # fmt: skip
    arrays = {name: get(f"packing/{name}", shape)[0] for name, shape in shapes.items()}
    contact, is_free = arrays["contact"], arrays["driven"] < 0
    arrays["spin"][is_free] = 0.0
    fine = {
        "contact": (contact >= 0) & (contact < count) & (contact[:, :1] != contact[:, 1:]),
        "driven": (arrays["driven"] >= -1) & (arrays["driven"] < count),
    }
    for name, values in arrays.items():
        if name in STORED_SIZES:
            absent = (values == 0) & (name in ("friction", "viscosity", "normal_force"))
            fine[name] = (values >= LEAST_STORED) & (values <= MOST_STORED) | absent
        all_fine = fine.get(name, np.abs(values) <= MOST_STORED).reshape(len(values), -1).all(axis=1)
        if not all_fine.all():
            first, what = int(np.argmin(all_fine)), "sphere" if name in OF_SPHERES else "contact"
            raise FileError(
                f"{path} has {values[first].tolist()!r} for packing/{name} of {what} {first}; that cannot be"
            )
    for name in ("contact", "driven"):
        arrays[name] = arrays[name].astype(np.int64)
    spin, friction = get("spin", (count, *parts))[0], get("contact/friction", (contacts, *parts))[0]
    rounding = get("spin_rounding", (count, *parts))[0] if "spin_rounding" in file else np.zeros_like(spin)
    return (
        StoredPacking(law, arrays, spin, rounding, friction),
        {"contact": (contacts,)},
        {"spin", *(f"packing/{n}" for n in arrays)},
    )


def _shape(path: Path, stored: Any) -> tuple[int, ...]:
    sides = np.asarray(stored)
    if sides.dtype.kind not in "iu" or sides.ndim != 1:
        raise FileError(f"{path} has the shape {sides.tolist()!r}; it must be a list of whole numbers")
    shape = tuple(sides.tolist())
    if len(shape) not in (2, 3) or min(shape) < 2 or shape[-1] < 3:
        raise FileError(f"{path} has the shape {list(shape)}; a lattice has two or three sides of 2 or more, height 3")
    return shape


def _periodic(path: Path, stored: Any, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Numbers of the axes that close on themselves, in their order."""
    allowed = AXES[: len(shape) - 1]
    periodic = tuple(axis for axis, name in enumerate(allowed) if isinstance(stored, list) and name in stored)
    if not isinstance(stored, list) or len(stored) != len(periodic):
        words = " and ".join(allowed)
        raise FileError(f"the scene in {path} has {stored!r} for periodic; it must be a list of axes, of {words}")
    for axis in periodic:
        if shape[axis] % 2:
            raise FileError(f"{path} has {shape[axis]} spheres along the periodic axis {AXES[axis]}; they must be even")
    return periodic


def _number(path: Path, attributes: dict[str, Any], name: str) -> float:
    if type(attributes[name]) not in (int, float):
        raise FileError(f"{path} has {attributes[name]!r} for {name!r}; it must be a number")
    return float(attributes[name])


def _array(
    path: Path, file: h5py.File, count: int, name: str, expected: tuple[int, ...], number: int = 0, replicas: int = 1
) -> np.ndarray:
    """A data set (count, *expected), in which a single sample has no axis of samples; of what it must be. Of several
    replicas of a packing that of one, (1, *expected)."""
    if name not in file:
        raise FileError(f"{path} lacks the data set {name}, without which nothing can be verified")
    stored, whole = file[name], (max(count, replicas), *expected)
    if stored.shape != whole and (whole[0] > 1 or stored.shape != expected):
        raise FileError(f"{path} has {name} of shape {stored.shape}; its lattice or packing needs {expected}")
    kinds, words = ("ui", "whole numbers") if name.endswith(WHOLE_DATA) else ("f", "real numbers")
    if stored.dtype.kind not in kinds:
        raise FileError(f"{path} has {name} of {stored.dtype}; it must hold {words}")
    return np.asarray(stored[number if replicas > 1 else ()], dtype=np.float64).reshape(count, *expected)


def _state(path: Path, settings: dict[str, Any], name: str, dimension: int) -> tuple[float, ...] | None:
    """A bearing state of the scene; that of the other plane alone makes it 0."""
    if settings.get("top") is None and settings.get("bottom") is None:
        return None
    counts = (1,) if dimension == 2 else (3, 4)
    numbers = _numbers(path, name, settings.get(name, [0.0] * counts[-1]), counts)
    return (*numbers, *(0.0,) * (counts[-1] - len(numbers)))


def _numbers(path: Path, name: str, stored: Any, counts: tuple[int, ...]) -> tuple[float, ...]:
    """A list of the scene of so many numbers."""
    numbers = isinstance(stored, list) and all(type(part) in (int, float) for part in stored)
    if not numbers or len(stored) not in counts or not np.isfinite(stored).all():
        raise FileError(f"the scene in {path} has {stored!r} for {name}; it must be {counts[-1]} numbers")
    return tuple(map(float, stored))


def _column(path: Path, name: str, stored: h5py.Dataset, count: int) -> np.ndarray:
    """A column of the history; FileError if it is none."""
    if stored.dtype.kind not in "fiu" or not (
        len(stored.shape) == 1 or (len(stored.shape) == 2 and len(stored) == count)
    ):
        raise FileError(f"{path} has history/{name} of {stored.dtype} and shape {stored.shape}; it must be numbers")
    return np.asarray(stored[()])


def _settings(path: Path, text: str) -> dict[str, Any]:
    import sys

    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    if len(text) > MOST_SCENE_TEXT or not all(map(A_LINE.match, text.split("\n"))):
        raise FileError(
            f"the scene in {path} is longer than {MOST_SCENE_TEXT:,} letters, or not a key and a value on each line"
        )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FileError(f"the scene in {path} is not valid TOML: {error}") from None
