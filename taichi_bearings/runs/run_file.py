"""run.h5: everything about a run, readable with plain h5py (the layout is part of the public contract)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.checkpoint_file import CHECKPOINT_NAME
from taichi_bearings.files.scan_journal import JOURNAL_NAME
from taichi_bearings.files.whole_file import attributes_of, put, read_hdf5, write_hdf5
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import axis_numbers, friction_by_axis
from taichi_bearings.proof.contact_state import ContactState, nothing_proven
from taichi_bearings.quantities import CHECK_ROWS, CONTACTS, FRICTION_QUANTITIES, SPHERES, found_in
from taichi_bearings.runs.settings import RunSettings, parse_toml, read_toml
from taichi_bearings.runtime import HOST, Runtime
from taichi_bearings.scene import Scene, Snapshots, Solution, Status
from taichi_bearings.scene.solution import is_crossed

RUN_SCHEMA = "taichi_bearings.run"
RUN_VERSION = 1
RUN_LAYOUT = {"schema": RUN_SCHEMA, "schema_version": RUN_VERSION}
opened_run = partial(read_hdf5, schema=RUN_SCHEMA, version=RUN_VERSION, kind="a run")
AXES = "xyz"
SCAN_NAME = "scan.h5"  # beside the settings and the journal of a scan

NOT_IN_ALL = ("slip_bound", "proven")  # data sets of contacts that a run file may lack
WHOLE_SETS = re.compile("/state$|/proven$|^history/")  # data sets that may hold whole numbers


def write_run_file(path: Path, solution: Solution, attributes: Mapping[str, Any]) -> None:
    """Write run.h5 in full or not at all. With one replica the replica axis is left out."""
    scene, lattice = solution.scene, solution.scene.lattice
    one = scene.replicas == 1

    def strip(values: np.ndarray) -> np.ndarray:
        return values[0] if one else values

    def of_contacts(file: h5py.File, name: str, parts: tuple[np.ndarray, ...], unit: str, text: str) -> None:
        """name : with {} for the axis, as the text may have. parts : one array an axis."""
        for axis, part in zip(AXES, parts, strict=False):
            sparse = part.dtype == np.uint8 or (name.endswith("/friction") and lattice.dimension == 3)
            packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if sparse else {}
            put(file, name.format(axis), part, unit, text.format(axis), **packed)

    def fill(file: h5py.File) -> None:
        for quantity, (group, values) in zip(scene.law.quantities, scene.named_coefficients.items(), strict=True):
            text = f"{quantity.name} coefficient of the {{}}-contacts"
            of_contacts(file, f"{group}/{{}}", lattice.by_axis(strip(values)), quantity.unit, text)
        for row, found in found_in(solution, CONTACTS):
            of_contacts(file, f"contact/{{}}/{row.name}", lattice.by_axis(strip(found)), row.unit, row.text)
        friction = friction_by_axis(strip(solution.friction), lattice)
        of_contacts(file, "contact/{}/friction", friction, "force", FRICTION_QUANTITIES[lattice.dimension])
        for row, found in found_in(solution, SPHERES):
            put(file, row.name, strip(found), row.unit, row.text)
        for key, column in solution.history.items():
            if one:
                values = column[:, 0] if column.ndim == 2 else column
            else:  # a leading replica axis, like everything else
                values = column.T if column.ndim == 2 else np.tile(column, (scene.replicas, 1))
            put(file, f"history/{key}", values, CHECK_ROWS[key].unit, CHECK_ROWS[key].text)
        if solution.snapshots is not None:
            times, spins = solution.snapshots.time, solution.snapshots.spin
            if one:
                spins = spins[:, 0]
            else:
                times, spins = np.tile(times, (scene.replicas, 1)), np.moveaxis(spins, 1, 0)
            put(file, "snapshots/time", times, "time", "simulated time of each snapshot")
            put(file, "snapshots/spin", spins, SPHERES["spin"].unit, f"{SPHERES['spin'].text} at these times")

    write_hdf5(path, fill, {**RUN_LAYOUT, **attributes, "findings": list(solution.findings)})


@dataclass(frozen=True)
class StoredRun:
    """A run as read back. attributes : of its file, as in `--json` of `run`; and `scene`, its settings as TOML."""

    path: Path
    attributes: dict[str, Any]
    solution: Solution

    def attribute(self, name: str) -> Any:
        """An attribute of the file; FileError if it is missing."""
        if name not in self.attributes:
            raise FileError(f"{self.path} lacks the attribute {name!r}; it is damaged or was changed")
        return self.attributes[name]


def refuse_scan(path: Path) -> None:
    """FileError for a scan where a run is wanted, and for a file of settings; it names the command that fits."""
    if path.suffix == ".toml" and path.is_file():
        kind, command = ("a scan", "scan") if "scan" in read_toml(path) else ("a run", "run")
        raise FileError(f"{path} describes {kind} and holds no result; `bearings {command} {path}` solves it")
    folder = path.parent if path.name == SCAN_NAME else path
    if _is_in(folder, SCAN_NAME, JOURNAL_NAME, "scan.toml") and not _is_in(path, "run.h5", CHECKPOINT_NAME):
        raise FileError(
            f"{path} is a scan, not a run; `bearings scan {folder}` goes on with it, `bearings plot scan {folder}` and "
            f"`bearings histogram {folder}` draw it"
        )


def refuse_run(path: Path) -> None:
    """FileError for a run where a scan is wanted; it names the command that fits."""
    folder = path if path.is_dir() else path.parent
    if path.name == "run.h5" or (_is_in(folder, "run.h5", CHECKPOINT_NAME) and not path.is_file()):
        raise FileError(
            f"{folder} is a run, not a scan; `bearings run {folder}` solves it again, `bearings plot spins {folder}` "
            "draws it"
        )


def _is_in(folder: Path, *names: str) -> bool:
    return any((folder / name).is_file() for name in names)


def file_of(run: Path) -> Path:
    """The run.h5 of a run directory, or the file itself."""
    return run / "run.h5" if run.is_dir() else run


def read_run_file(run: Path) -> StoredRun:
    """Read a run directory or its run.h5; FileError if it is missing, damaged or of an unknown version."""
    refuse_scan(run)
    path = file_of(run)
    if not path.is_file():
        unfinished = path.with_name(CHECKPOINT_NAME).is_file()
        hint = f"; it is unfinished, `bearings run --resume {run}` goes on with it" if unfinished else ""
        raise FileError(f"{run} is not a run: there is no {path}{hint}")
    with opened_run(path) as file:
        if "packing" in file:
            raise FileError(f"{run} is a run of a packing, where one of a lattice is wanted")
        attributes = attributes_of(file)
        told = (np.atleast_1d(attributes.get(name, np.nan)) for name in ("power", "lower_bound", "gap"))
        numbers = [v if v.dtype.kind in "iuf" else np.full(v.shape, np.nan) for v in told]  # no number says nothing
        if any(map(is_crossed, *np.broadcast_arrays(*numbers))):
            raise FileError(f"{path} has a lower bound above its power; it is damaged or was changed")
        stored = StoredRun(path, attributes, _solution(path, file, attributes))
    _check_arrays(stored)
    return stored


def read_array(path: Path, file: h5py.File, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """A data set of a run file, None for any length; FileError for another shape or kind of numbers, before it is
    read."""
    stored = file[name]
    fits = len(stored.shape) == len(shape) and all(w in (None, n) for n, w in zip(stored.shape, shape, strict=True))
    if not fits or stored.dtype.kind not in "fiub":
        words = f"it has {stored.dtype} of shape {stored.shape}, and must hold finite numbers of shape {shape}"
        raise FileError(f"{name} in {path} is damaged: {words}")
    is_whole = stored.dtype.kind == "f" or WHOLE_SETS.search(name)
    return np.asarray(stored[()] if is_whole else stored[()].astype(np.float64))


class _Arrays:
    """Data sets of a run file, with an axis of replicas."""

    def __init__(self, path: Path, file: h5py.File, lattice: Lattice) -> None:
        self.path, self.file, self.lattice, self.shape = path, file, lattice, lattice.shape
        first = file["coefficient/x"]
        self.one = first.ndim == lattice.dimension
        self.replicas = 1 if self.one else len(first)
        self.vector = () if lattice.dimension == 2 else (3,)

    def get(self, name: str, *expected: int | None) -> np.ndarray:
        """expected : the shape without the axis of replicas, None for any length."""
        values = read_array(self.path, self.file, name, expected if self.one else (self.replicas, *expected))
        return values[None] if self.one else values

    def by_axis(self, name: str, *parts: int) -> tuple[np.ndarray, ...]:
        """Of the contacts, one array (R, *contacts, *parts) an axis; name : with {} for the axis."""
        names = [name.format(axis) for axis in AXES[: len(self.shape)]]
        if lacking := [name for name in names if name not in self.file]:
            raise KeyError(f"it lacks {lacking[0]}")
        contacts = map(self.lattice.contact_shape, range(self.lattice.dimension))
        return tuple(self.get(name, *sides, *parts) for name, sides in zip(names, contacts, strict=True))

    def of_contacts(self, key: str, *parts: int) -> np.ndarray:
        """Of the contacts, (R, E, *parts)."""
        found = self.by_axis(f"contact/{{}}/{key}", *parts)
        return np.concatenate([values.reshape(self.replicas, -1, *parts) for values in found], axis=1)

    def snapshots(self) -> Snapshots | None:
        if "snapshots" not in self.file:
            return None
        time, spin = self.get("snapshots/time", None), self.get("snapshots/spin", None, *self.shape, *self.vector)
        return Snapshots(time[0], np.moveaxis(spin, 0, 1))


def _solution(path: Path, file: h5py.File, attributes: Mapping[str, Any]) -> Solution:
    """What the run came to, with a replica axis. Its status is that of those replicas that are not certified; columns
    of the history are (checks,) or (checks, R)."""
    settings = scene_settings(attributes)
    shape = tuple(int(side) for side in attributes["shape"])
    arrays = _Arrays(path, file, Lattice(shape, periodic=axis_numbers(settings.periodic)))
    viscosity = arrays.by_axis("viscosity/{}") if "viscosity" in file else ()
    seeds = tuple(int(seed) for seed in np.atleast_1d(attributes["seed"]))
    given = {key: getattr(settings, key) for key in ("law", *Scene.PARAMETERS)}
    scene = Scene(arrays.by_axis("coefficient/{}"), viscosity=viscosity, seeds=seeds, **given)
    drawn = {key: getattr(settings, key) for key in scene.DRAWN} if settings.coefficients is None else {}
    scene = scene.drawn_from(drawn)
    there = [name for name in CONTACTS if name not in NOT_IN_ALL or f"contact/x/{name}" in file]
    sets: dict[str, Any] = {"slip_bound": None} | {name: arrays.of_contacts(name) for name in there}
    sets.setdefault("proven", nothing_proven(sets["state"]))

    def number(name: str) -> np.ndarray:
        """An attribute with one value a replica, (R,); not-a-number where it is missing or says nothing, as "" does."""
        value = attributes.get(name, "")
        values = np.atleast_1d(np.nan if isinstance(value, str) and not value else value)
        if values.dtype.kind not in "biuf" or values.shape not in ((1,), (scene.replicas,)):
            raise ValueError(f"{name} is {value!r}; it must be a number, for each of its {scene.replicas} samples")
        return np.broadcast_to(values, scene.replicas).copy()

    numbers: dict[str, Any] = {key: number(key) for key in ("power", "lower_bound", "gap", "largest_balance_residual")}
    numbers |= {key: float(attributes[key]) for key in ("slip_threshold", "seconds", "seconds_compile")}
    ended = [Status(name) for name in np.atleast_1d(attributes["status"]).tolist()]
    columns = {key: arrays.get(f"history/{key}", None) for key in file["history"]}
    spin = arrays.get("spin", *arrays.shape, *arrays.vector)
    rounding = arrays.get("spin_rounding", *spin.shape[1:]) if "spin_rounding" in file else np.zeros_like(spin)
    return Solution(
        scene=scene,
        method=str(attributes["method"]),
        status=next((one for one in ended if one is not Status.CERTIFIED), Status.CERTIFIED),
        iterations=int(attributes["iterations"]),
        spin=spin,
        spin_rounding=rounding,
        power_per_contact=sets.pop("power"),
        friction=arrays.of_contacts("friction", *arrays.vector),
        states_proven=number("states_proven") == 1,
        objective=number("potential" if scene.law.minimises == "potential" else "power"),
        history={key: column[0] if key in OF_ALL else column.T for key, column in columns.items()},
        findings={name: number(name) for name in attributes["findings"] if name in attributes},
        running=Runtime(**{key: attributes.get(key, value) for key, value in vars(HOST).items()}),
        snapshots=arrays.snapshots(),
        **numbers,
        **sets,
    )


OF_ALL = ("iteration", "seconds", "time")  # columns of the history that are the same for all replicas


def scene_settings(attributes: Mapping[str, Any]) -> RunSettings:
    """Those of a run file; InputError."""
    try:
        return RunSettings.from_mapping(parse_toml(str(attributes["scene"])), "its scene")
    except FileError as error:
        raise InputError(str(error)) from None


def _check_arrays(run: StoredRun) -> None:
    """FileError for numbers that no solve leaves, where what reads them would fail or mislead."""
    solution = run.solution
    ended_finite, samples = solution.status is not Status.NOT_FINITE, solution.scene.replicas
    of_contacts = ((row.name, values) for row, values in found_in(solution, CONTACTS))
    for name, values in (("spin", solution.spin), *of_contacts, ("friction", solution.friction)):
        if len(values) != samples or (ended_finite and not np.isfinite(values).all()):
            raise FileError(f"{name} in {run.path} is damaged: it must hold finite numbers, of {samples} samples")
        if name in CONTACTS and (values < 0).any():
            raise FileError(f"{name} in {run.path} is damaged: it must hold no negative numbers")
    if solution.state.dtype.kind not in "ui" or (solution.state > max(ContactState)).any():
        raise FileError(f"state in {run.path} is damaged: it must hold whole numbers from 0 to {max(ContactState)}")
    history, lengths = solution.history, {len(values) for values in solution.history.values()}
    needed = {"iteration", "power", "lower_bound"} | (ENERGIES if "energy_residual" in history else set())
    if needed - history.keys() or len(lengths) != 1 or 0 in lengths:
        raise FileError(f"history in {run.path} is damaged: it must hold columns of one length, {', '.join(needed)}")
    if solution.snapshots is not None and len(solution.snapshots.time) != len(solution.snapshots.spin):
        raise FileError(f"snapshots in {run.path} are damaged: times and spins differ in number")


ENERGIES = {"time", "kinetic_energy", "spring_energy", "injected_energy", "dissipated_energy"}
