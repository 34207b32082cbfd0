"""run.h5: everything about a run, readable with plain h5py (the layout is part of the public contract)."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.files.checkpoint_file import NAME as CHECKPOINT
from taichi_bearings.files.whole_file import read_hdf5, write_hdf5
from taichi_bearings.scene import Solution
from taichi_bearings.scene.solution import ROUNDING

SCHEMA = "taichi_bearings.run"
SCHEMA_VERSION = 1
AXES = "xyz"

CONTACT_SETS = {  # name -> (attribute of Solution, unit, description)
    "slip": ("slip", "length/time", "slip speed |v|"),
    "power": ("power_per_contact", "energy/time", "power dissipated at the contact"),
    "force": ("force", "force", "magnitude of the tangential contact force"),
    "state": ("state", "1", "0 slipless, 1 slipping, 2 undecided, 3 between driven spheres"),
}
HISTORY_UNITS = {
    "iteration": ("1", "iterations done"),
    "seconds": ("s", "wall time of the solve, compilation apart"),
    "time": ("time", "simulated time"),
    "power": ("energy/time", "power dissipated by the spins"),
    "potential": ("energy/time", "dissipation potential of the spins, of which the lower bound is"),
    "lower_bound": ("energy/time", "best proven lower bound so far"),
    "slipping": ("1", "contacts that slip at this moment"),
    "kinetic_energy": ("energy", "kinetic energy of the free spheres"),
    "spring_energy": ("energy", "energy in the elongations of the contacts"),
    "injected_energy": ("energy", "work of the driven spheres since the start"),
    "dissipated_energy": ("energy", "energy dissipated at the contacts since the start"),
    "energy_residual": ("1", "what the energy books leave unexplained, relative to the energy gone through them"),
    "unbalanced_torque": ("force*length", "largest torque left over on a free sphere"),
}


FRICTION = {  # dimension -> description
    2: "friction on the upper disc, component along z x n: upwards at x-contacts, to the left at y-contacts; "
    "in balance and within the friction limits, so it proves a lower bound",
    3: "friction on the upper sphere, laboratory frame; in balance and within the friction limits, so it proves a "
    "lower bound",
}


def write_run_file(path: Path, solution: Solution, attributes: Mapping[str, Any]) -> None:
    """Write run.h5 in full or not at all. With one replica the replica axis is left out."""
    scene = solution.scene
    one = scene.replicas == 1

    def put(file: h5py.File, name: str, values: np.ndarray, unit: str, text: str) -> None:
        sparse = values.dtype == np.uint8 or (name.endswith("/friction") and scene.lattice.dimension == 3)
        packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if sparse else {}
        stored = file.create_dataset(name, data=values, dtype=values.dtype, **packed)
        stored.attrs["units"], stored.attrs["description"] = unit, text

    def strip(values: np.ndarray) -> np.ndarray:
        return values[0] if one else values

    def fill(file: h5py.File) -> None:
        file.attrs["schema"], file.attrs["schema_version"] = SCHEMA, SCHEMA_VERSION
        for key, value in attributes.items():
            file.attrs[key] = storable(value)
        for axis in range(scene.lattice.dimension):
            name = AXES[axis]
            for quantity, (group, parts) in zip(scene.law.quantities, scene.coefficients.items(), strict=True):
                text = f"{quantity.name} coefficient of the {name}-contacts"
                put(file, f"{group}/{name}", strip(parts[axis]), quantity.unit, text)
            for key, (attribute, unit, text) in CONTACT_SETS.items():
                put(file, f"contact/{name}/{key}", strip(getattr(solution, attribute)[axis]), unit, text)
            text = FRICTION[scene.lattice.dimension]
            put(file, f"contact/{name}/friction", strip(solution.friction[axis]), "force", text)
            if solution.slip_bound:
                text = "largest slip speed that any minimum can have at this contact, proven"
                put(file, f"contact/{name}/slip_bound", strip(solution.slip_bound[axis]), "length/time", text)
        put(file, "spin", strip(solution.spin), "1/time", "angular velocity in the laboratory frame")
        if solution.spin_rounding.any():
            text = "what rounding leaves out of the spins: they are the sums of both"
            put(file, "spin_rounding", strip(solution.spin_rounding), "1/time", text)
        for key, column in solution.history.items():
            if one:
                values = column[:, 0] if column.ndim == 2 else column
            else:  # a leading replica axis, like everything else
                values = column.T if column.ndim == 2 else np.tile(column, (scene.replicas, 1))
            put(file, f"history/{key}", values, *HISTORY_UNITS[key])
        if solution.snapshots is not None:
            times, spins = solution.snapshots.time, solution.snapshots.spin
            if one:
                spins = spins[:, 0]
            else:
                times, spins = np.tile(times, (scene.replicas, 1)), np.moveaxis(spins, 1, 0)
            put(file, "snapshots/time", times, "time", "simulated time of each snapshot")
            put(file, "snapshots/spin", spins, "1/time", "angular velocity in the laboratory frame at these times")

    write_hdf5(path, fill)


def storable(value: Any) -> Any:
    """A value that HDF5 can hold as an attribute: nothing becomes "", and not-a-number within a list of numbers; what
    is not UTF-8 in a text, such as the name of a file, is escaped."""
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, list) and None in value:
        return [np.nan if item is None else item for item in value]
    return "" if value is None else value


@dataclass(frozen=True)
class StoredRun:
    """A run as read back. Arrays always have the replica axis (history too); contact sets are one array an axis.

    friction : as in :class:`Solution`; None in files from before it was stored.
    """

    path: Path
    attributes: dict[str, Any]
    coefficient: tuple[np.ndarray, ...]
    viscosity: tuple[np.ndarray, ...]
    spin: np.ndarray
    slip: tuple[np.ndarray, ...]
    power: tuple[np.ndarray, ...]
    force: tuple[np.ndarray, ...]
    state: tuple[np.ndarray, ...]
    history: dict[str, np.ndarray]
    snapshots: dict[str, np.ndarray]
    friction: tuple[np.ndarray, ...] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(int(n) for n in self.attributes["shape"])

    def attribute(self, name: str) -> Any:
        """An attribute of the file; FileError if it is missing."""
        if name not in self.attributes:
            raise FileError(f"{self.path} lacks the attribute {name!r}; it is damaged or was changed")
        return self.attributes[name]


def read_run_file(run: Path) -> StoredRun:
    """Read a run directory or its run.h5; FileError if it is missing, damaged or of an unknown version."""
    path = run / "run.h5" if run.is_dir() else run
    if not path.is_file():
        unfinished = path.with_name(CHECKPOINT).is_file()
        hint = f"; it is unfinished, `bearings run --resume {run}` goes on with it" if unfinished else ""
        raise FileError(f"{run} is not a run: there is no {path}{hint}")
    with read_hdf5(path, SCHEMA, SCHEMA_VERSION, "a run") as file:
        return _read(path, file)


def _read(path: Path, file: h5py.File) -> StoredRun:
    attributes = {key: value.item() if isinstance(value, np.generic) else value for key, value in file.attrs.items()}
    _refuse_bound_above_power(path, attributes)
    axes = AXES[: len(attributes["shape"])]
    one = file["coefficient/x"].ndim == len(axes)
    has_friction = all(f"contact/{axis}/friction" in file for axis in axes)

    def get(name: str) -> np.ndarray:
        values = file[name][()]
        return values[None] if one else values

    sets = {key: tuple(get(f"contact/{axis}/{key}") for axis in axes) for key in CONTACT_SETS}
    return StoredRun(
        path=path,
        attributes=attributes,
        coefficient=tuple(get(f"coefficient/{axis}") for axis in axes),
        viscosity=tuple(get(f"viscosity/{axis}") for axis in axes) if "viscosity" in file else (),
        spin=get("spin"),
        history={key: get(f"history/{key}") for key in file["history"]},
        snapshots={key: get(f"snapshots/{key}") for key in file.get("snapshots", ())},
        friction=tuple(get(f"contact/{axis}/friction") for axis in axes) if has_friction else None,
        **sets,
    )


def _refuse_bound_above_power(path: Path, attributes: Mapping[str, Any]) -> None:
    """FileError if a lower bound lies above its power by more than rounding. What is no number says nothing."""

    def numbers(name: str) -> np.ndarray:
        values = np.atleast_1d(attributes.get(name, np.nan))
        return values.astype(float) if values.dtype.kind in "iuf" else np.full(values.shape, np.nan)

    power, bound = numbers("power"), numbers("lower_bound")
    driven = (numbers("spin_top") != numbers("spin_bottom")).all()
    if (numbers("gap") < -ROUNDING).any() or (driven and (bound > power * (1 + ROUNDING)).any()):
        raise FileError(f"{path} has a lower bound above its power; it is damaged or was changed")
