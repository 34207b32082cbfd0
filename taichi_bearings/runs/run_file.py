"""Reads a run.h5 back into the result that it was written from; h5py alone can read it as well.

Letters: R replicas (samples; files have no axis of replicas if there is one), E contacts.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.scan_journal import JOURNAL_NAME
from taichi_bearings.files.whole_file import attributes_of, read_hdf5
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import axis_numbers
from taichi_bearings.plain_files import Json
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import CONTACTS, FINDINGS, SAID_OF_PACKINGS
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.run_directory import CHECKPOINT_NAME, claimed, is_run
from taichi_bearings.runs.run_layout import AXES, PACKING_ARRAYS
from taichi_bearings.runs.settings import (
    RunSettings,
    parse_toml,
    read_toml,
    refuse_unloaded,
    settings_table,
    without_unloaded,
)
from taichi_bearings.runtime import HOST, Runtime
from taichi_bearings.scene import Bearing, Scene, Snapshots, Solution, Status
from taichi_bearings.scene.solution import OF_ALL, is_crossed
from taichi_bearings.stages import stage

SCAN_NAME = "scan.h5"  # beside the settings and the journal of a scan
WHOLE_SETS = re.compile("/state$|/proven$|^history/")  # data sets that may hold whole numbers


def refuse_scan(path: Path) -> None:
    """Raise FileError if a path names a scan, or a file of settings, where a run is needed; the message names the right
    command.
    """
    if path.suffix == ".toml" and path.is_file():
        kind, command = ("a scan", "scan") if "scan" in read_toml(path) else ("a run", "run")
        raise FileError(f"{path} describes {kind} and holds no result; `bearings {command} {path}` solves it")
    folder = path.parent if path.name == SCAN_NAME else path
    if any((folder / name).is_file() for name in (SCAN_NAME, JOURNAL_NAME, "scan.toml")) and not is_run(path):
        raise FileError(
            f"{path} is a scan, not a run; `bearings scan {folder}` goes on with it, `bearings plot scan {folder}` and "
            f"`bearings histogram {folder}` draw it"
        )


def refuse_run(path: Path) -> None:
    """Raise FileError if a path names a run where a scan is needed; the message names the right command."""
    folder = path if path.is_dir() else path.parent
    if path.name == "run.h5" or (is_run(folder) and not path.is_file()):
        raise FileError(
            f"{folder} is a run, not a scan; `bearings run {folder}` solves it again, `bearings plot spins {folder}` "
            "draws it"
        )


def file_of(run: Path) -> Path:
    """Return the path of the run.h5 in a run directory, or the path itself if it is no directory."""
    return run / "run.h5" if run.is_dir() else run


def read_run(run: str | Path) -> Result:
    """Return the result in a run directory or a run.h5, of a lattice or a packing.

    Raises FileError if the file is missing, damaged, was changed, or has an unknown layout.
    """
    with _opened(run) as (path, file, attributes):
        stored = (np.atleast_1d(attributes.get(name, np.nan)) for name in ("power", "lower_bound", "gap"))
        numbers = [
            v if v.dtype.kind in "iuf" else np.full(v.shape, np.nan) for v in stored
        ]  # words are unknown numbers
        if any(map(is_crossed, *np.broadcast_arrays(*numbers))):
            raise FileError(f"{path} has a lower bound above the power, so it is damaged or was changed")
        return _run_in(path, file, attributes)


def read_claims(run: str | Path) -> tuple[Result, list[str]]:
    """Return the result in a run file as the file claims it to be, without checking it; and the names of the data sets
    and attributes that were changed after the file was written.

    run : a run directory, or its run.h5.

    `Result.attributes` has what the file says. The gap of the solution, between power and lower bound, is not-a-number
    until it is proven anew. If the method of the run is not loaded, as one that a user has registered, the settings of
    the result have the method "auto", without its options. Raises FileError if the file is missing, has an unknown
    layout, or is so damaged that it holds no run.
    """
    changed: list[str] = []
    with _opened(run, changed) as (path, file, attributes):
        found = _run_in(path, file, attributes | {"gap": np.nan}, needs_method=False)
    return replace(found, attributes=attributes), changed


@contextmanager
def _opened(run: str | Path, changed: list[str] | None = None) -> Iterator[tuple[Path, h5py.File, Json]]:
    """Yield the path of a run.h5, the opened file and its attributes.

    run : a run directory or its run.h5.
    changed : a list that gets the names of what was changed after the file was written; None to raise FileError for
        that.
    """
    run = Path(run)
    refuse_scan(run)
    path = file_of(run)
    if not path.is_file():
        unfinished = path.with_name(CHECKPOINT_NAME).is_file()
        hint = f"; it is unfinished, `bearings run --resume {run}` goes on with it" if unfinished else ""
        lacking = f"{path} is not a file" if path.exists() else f"there is no file or folder {path}"
        raise FileError(f"{run} is not a run: {lacking}{hint}")
    with read_hdf5(path, "run", changed) as file:
        yield path, file, attributes_of(file)


def _run_in(path: Path, file: h5py.File, attributes: Json, needs_method: bool = True) -> Result:
    """Return the result in an opened run.h5.

    path, attributes : path and attributes of the file; the attributes hold settings and numbers.
    needs_method : False to read it also where its method, or an option of it, is not loaded.
    """
    if "scene" not in attributes:
        raise FileError(f"{path} lacks the attribute 'scene'; it is damaged or was changed")
    try:
        scene = parse_toml(str(attributes["scene"]))
    except FileError as error:
        raise InputError(str(error)) from None
    scene = scene if needs_method else without_unloaded(scene)
    refuse_unloaded(scene, path)
    try:
        settings = RunSettings.from_mapping(scene, "its scene")
    except FileError as error:
        raise InputError(str(error)) from None
    solution = _read(path, file, attributes, settings)
    place = path.parent if path.name == "run.h5" else path
    return Result(settings, solution, None, place, str(attributes.get("command", "")), attributes=attributes)


@contextmanager
def opened_to_draw(
    run: str | Path, out: str | Path | None, name: str, force: bool, replica: int = 0
) -> Iterator[tuple[Result, Path]]:
    """Yield the result of a run, and the path of a picture to be written, which is locked so that no other process
    writes it.

    run : a run directory or its run.h5.
    out : the picture; None for a file in the run directory, which is replaced.
    name : name of the file in the run directory; for a sample other than the first its number is added.
    force : True to replace `out` if it exists; else FileError is raised.
    replica : number of the sample that is drawn.
    """
    run, out = Path(run), None if out is None else Path(out)
    with stage("reading"):
        found = read_run(run)
    kind = Path(name)
    name = f"{kind.stem}-replica-{replica}{kind.suffix}" if replica else name
    path = file_of(run).parent / name if out is None else out
    with claimed(path, force or out is None):
        yield found, path


def replica_drawn(found: Result, replica: int) -> dict[str, int]:
    """Return two numbers by name, for the report on a picture: `replica`, the sample that it shows, and `replicas`, the
    number of samples of the run. Return an empty dictionary if the run has one sample only.

    found : the run.
    replica : number of the sample, from 0.
    """
    replicas = len(found.solution.state)
    return {"replica": replica, "replicas": replicas} if replicas > 1 else {}


@dataclass(frozen=True)
class _Sets:
    """Reader of the data sets of a run file. It checks them, and adds an axis of samples if the file has none.

    path : path of the file, for messages.
    file : the opened file.
    head : (R,) for R samples, or () if the arrays of the file have no axis of samples.
    lattice : the lattice of a run on one, whose contacts have data sets of their own for each axis; None for a packing.
    """

    path: Path
    file: h5py.File
    head: tuple[int, ...]
    lattice: Lattice | None = None

    @property
    def are_apart(self) -> bool:
        """True if samples were solved one by one, as those of packings, so that each has checks and times of its
        own."""
        return self.lattice is None and len(self.head) > 0

    def get(self, name: str, *expected: int | None) -> np.ndarray:
        """Return a data set with a leading axis of samples.

        name : name of the data set.
        expected : its shape without that axis, None for any length.

        Raises FileError for another shape, or for anything but numbers, before the data are read.
        """
        stored, shape = self.file[name], (*self.head, *expected)
        fits = len(stored.shape) == len(shape) and all(w in (None, n) for n, w in zip(stored.shape, shape, strict=True))
        if not fits or stored.dtype.kind not in "fiub":
            words = f"it has {stored.dtype} of shape {stored.shape}, and must hold finite numbers of shape {shape}"
            raise FileError(f"{name} in {self.path} is damaged: {words}")
        keeps_type = stored.dtype.kind == "f" or WHOLE_SETS.search(name)
        values = np.asarray(stored[()] if keeps_type else stored[()].astype(np.float64))
        return values if self.head else values[None]

    def by_axis(self, name: str, *parts: int) -> tuple[np.ndarray, ...]:
        """Return data sets of the contacts of a lattice as a tuple, one array (samples R, *contacts, *parts) for each
        axis.

        name : name of the data sets, with {} in place of the axis.
        parts : shape of the value of one contact.
        """
        lattice = self.lattice
        assert lattice is not None
        names = [name.format(axis) for axis in AXES[: lattice.dimension]]
        if lacking := [name for name in names if name not in self.file]:
            raise KeyError(f"it lacks {lacking[0]}")
        return tuple(self.get(name, *lattice.contact_shape(axis), *parts) for axis, name in enumerate(names))

    def has_proofs(self) -> bool:
        """Return True if the file says which contact states are proven; early ones do not."""
        return f"contact{'' if self.lattice is None else '/x'}/proven" in self.file

    def of_contacts(self, name: str, contacts: int, *parts: int) -> np.ndarray:
        """Return a data set of the contacts, (samples R, contacts E, *parts); on a lattice axis after axis.

        name : its name in the group of the contacts.
        contacts : number of contacts.
        parts : shape of the value of one contact.
        """
        if self.lattice is None:
            return self.get(f"contact/{name}", contacts, *parts)
        found = self.by_axis(f"contact/{{}}/{name}", *parts)
        return np.concatenate([values.reshape(len(values), -1, *parts) for values in found], axis=1)

    def history(self) -> dict[str, np.ndarray]:
        """Return the columns of the history by name: (checks,) for columns of all samples together, else (checks,
        samples R). The files of lattices must have a history.

        Raises FileError for columns that no solve leaves, or where they are needed and missing.
        """
        columns = {key: self.get(f"history/{key}", None) for key in self.file.get("history", ())}
        needed = {"iteration", "power", "lower_bound"} | (ENERGIES if "energy_residual" in columns else set())
        lengths, is_needed = {values.shape[1] for values in columns.values()}, self.lattice is not None
        if (is_needed or columns) and (needed - columns.keys() or len(lengths) != 1 or 0 in lengths):
            words = f"it must hold columns of one length, {', '.join(needed)}"
            raise FileError(f"history in {self.path} is damaged: {words}")
        return {key: column[0] if key in OF_ALL and not self.are_apart else column.T for key, column in columns.items()}

    def snapshots(self, *spins: int) -> Snapshots | None:
        """Return the snapshots of a dynamics, times and laboratory spins; None if the file has none.

        spins : shape of the spins of one sample.

        Raises FileError if times and spins differ in number.
        """
        if "snapshots" not in self.file:
            return None
        time, ways = self.get("snapshots/time", None), self.get("snapshots/spin", None, *spins)
        if time.shape[1] != ways.shape[1]:
            raise FileError(f"snapshots in {self.path} are damaged: times and spins differ in number")
        return Snapshots(time.T if self.are_apart else time[0], np.moveaxis(ways, 0, 1))

    def check(self, name: str, values: np.ndarray, is_fine: Callable[[np.ndarray], Any] = np.isfinite) -> None:
        """Raise FileError if a data set has values that no solve writes, such as infinite ones.

        name : name of the data set.
        values : its values, any shape.
        is_fine : function that returns a mask of the values that are allowed; by default all finite ones are.
        """
        words, known = "", max(ContactState)
        if not np.all(is_fine(values)):
            words = "finite numbers"
        elif name in CONTACTS and (values < 0).any():
            words = "no negative numbers"
        elif name in ("state", "proven") and (values.dtype.kind not in "ui" or (values > known).any()):
            words = f"whole numbers from 0 to {known}"
        if words:
            raise FileError(f"{name} in {self.path} is damaged: it must hold {words}")


def _read(path: Path, file: h5py.File, attributes: Json, settings: RunSettings) -> Solution:
    """Return the solution in an opened run.h5, with an axis of samples. Its status is "certified" if all samples are,
    else that of the first other one.

    path, file, attributes : path of the file, the opened file, and its attributes.
    settings : settings of the run.
    """
    scene, sets = (_packings_in if "packing" in file else _lattice_in)(path, file, attributes, settings)
    number = partial(_number, attributes, scene.replicas)
    ended = [Status(name) for name in np.atleast_1d(attributes["status"]).tolist()]
    status = next((one for one in ended if one is not Status.CERTIFIED), Status.CERTIFIED)
    arrays = _arrays_in(sets, scene, np.isreal if status is Status.NOT_FINITE else np.isfinite)
    history = sets.history()
    if attributes["schema_version"] == 1:
        state, proven, all_proven = arrays["state"], arrays.get("proven"), number("states_proven") == 1
        arrays["state"], arrays["proven"] = _of_layout_1(state, proven, all_proven, is_dynamics="time" in history)
    own: dict[str, np.ndarray] = {"status": np.broadcast_to(np.array(ended, dtype=object), scene.replicas)}
    if sets.are_apart:
        own["iterations"] = number("iterations").astype(np.int64)
    # findings are those that the file names; files that name none may have any
    said = attributes.get("findings", FINDINGS), SAID_OF_PACKINGS if sets.lattice is None else ()
    findings = {name: number(name) for name in dict.fromkeys(chain(*said)) if name in attributes}
    findings.pop("tied_contacts", None)  # of layout 1
    numbers: dict[str, Any] = {key: number(key) for key in ("power", "lower_bound", "gap", "largest_balance_residual")}
    numbers |= {key: float(attributes[key]) for key in ("slip_threshold", "seconds", "seconds_compile")}
    return Solution(
        scene=scene,
        method=str(attributes["method"]),
        status=status,
        iterations=int(np.max(attributes["iterations"])),
        power_per_contact=arrays.pop("power"),
        objective=number("potential" if scene.law.minimises == "potential" else "power"),
        history=history,
        findings=findings,
        own=own,
        running=Runtime(**{key: attributes.get(key, value) for key, value in vars(HOST).items()}),
        snapshots=sets.snapshots(*arrays["spin"].shape[1:]),
        proven=arrays.pop("proven") == 1,
        **numbers,
        **arrays,
    )


def _number(attributes: Json, replicas: int, name: str) -> np.ndarray:
    """Return an attribute of a run file with a value for each sample, (samples R,); not-a-number where it is missing.
    Raise ValueError if it is something else.

    attributes : attributes of the file.
    replicas : number of samples.
    name : name of the attribute.
    """
    value = attributes.get(name, "")
    values = np.atleast_1d(np.nan if isinstance(value, str) and not value else value)
    kinds = "UO" if name == "proof" else "biuf"
    if values.dtype.kind not in kinds or values.shape not in ((1,), (replicas,)):
        raise ValueError(f"{name} is {value!r}; it must be one number, or one for each of the {replicas} samples")
    return np.array(np.broadcast_to(values, replicas))


def _arrays_in(sets: _Sets, scene: Bearing, is_fine: Callable[[np.ndarray], Any]) -> dict[str, Any]:
    """Return the arrays of a solution by name, each with a leading axis of samples: those of the contacts, the spins,
    and what their rounding lost. Raise FileError for values that no solve writes.

    sets : reader of the data sets.
    scene : what was solved.
    is_fine : function that returns a mask of the values that are allowed.
    """
    contacts, vector = scene.network.contacts, () if scene.network.dimension == 2 else (3,)
    spins = (*scene.network.shape, *vector)
    there = [name for name in CONTACTS if name != "proven" or sets.has_proofs()]
    arrays = {name: sets.of_contacts(name, contacts) for name in there}
    arrays |= {"friction": sets.of_contacts("friction", contacts, *vector), "spin": sets.get("spin", *spins)}
    is_stored = "spin_rounding" in sets.file
    arrays["spin_rounding"] = sets.get("spin_rounding", *spins) if is_stored else np.zeros_like(arrays["spin"])
    for name, values in arrays.items():
        sets.check(name, values, is_fine)
    return arrays


def _of_layout_1(
    state: np.ndarray, proven: np.ndarray | None, all_proven: np.ndarray, is_dynamics: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return contact states (samples R, contacts E), and a mask (R, E) of those that are proven, from a file of layout
    1. There the state 2 also stood for tied contacts, and for contacts at their friction limit that slip at no minimum.

    state : (R, E), the states in the file.
    proven : (R, E), the state that is proven of all minima: 0 slipless, 1 slipping, 4 tied; 2 if none is; 3 for
        contacts that take no part. None in files that have no such data set.
    all_proven : (R,), used if `proven` is None: True for samples all of whose decided states are proven.
    is_dynamics : True for a dynamics, whose states are those of its motion and stay as they are.
    """
    acts = state != ContactState.DRIVEN
    if proven is None:
        return state, ~acts | (all_proven[:, None] & (state != ContactState.UNDECIDED))
    known, is_named = proven != ContactState.UNDECIDED, state != ContactState.UNDECIDED
    if not is_dynamics:
        state = np.where(acts & ~is_named & known, proven, state)
    return state, ~acts | (known & (state == proven))


# columns of the history that a dynamics with an energy balance has
ENERGIES = {"time", "kinetic_energy", "spring_energy", "injected_energy", "dissipated_energy"}
OWN_COEFFICIENTS = ("run.h5", "coefficients.npz")  # files that runs write: no names of where coefficients come from


def _lattice_in(path: Path, file: h5py.File, attributes: Json, settings: RunSettings) -> tuple[Bearing, _Sets]:
    """Return the scene on a lattice that a file holds, and the reader of its data sets.

    path, file, attributes : the file, opened, and its attributes.
    settings : settings of the run.
    """
    shape = tuple(int(side) for side in attributes["shape"])
    lattice, first = Lattice(shape, periodic=axis_numbers(settings.periodic)), file["coefficient/x"]
    sets = _Sets(path, file, first.shape[: first.ndim - len(shape)], lattice)
    viscosity = sets.by_axis("viscosity/{}") if "viscosity" in file else ()
    seeds = tuple(int(seed) for seed in np.atleast_1d(attributes["seed"]))
    given = {key: getattr(settings, key) for key in ("law", *Scene.PARAMETERS)}
    scene = Scene(sets.by_axis("coefficient/{}"), viscosity=viscosity, seeds=seeds, **given)
    # coefficients count as drawn unless the settings name a file of them; a file of the user is named, too
    drawn = {key: getattr(settings, key) for key in scene.DRAWN} if settings.coefficients is None else {}
    name = Path(str(attributes.get("coefficients", ""))).name
    if settings.coefficients is not None and name not in OWN_COEFFICIENTS:
        scene.read_from(name)
    return scene.drawn_from(drawn), sets


def _packings_in(path: Path, file: h5py.File, attributes: Json, settings: RunSettings) -> tuple[Bearing, _Sets]:
    """Return the packing that a file holds, and the reader of its data sets.

    path, file, attributes : the file, opened, and its attributes.
    settings : settings of the run.
    """
    from taichi_bearings.runs.packing_run import TWICE, packing_of
    from taichi_bearings.scene.packing import NEEDED  # and with it much of SciPy

    if lacking := [name for name in SAID_OF_PACKINGS if name not in attributes]:
        raise KeyError(f"it lacks {lacking[0]}")
    superfluous = (*TWICE, "contacts", "touching")  # settings whose effect the arrays of the file have
    usual = {key: settings_table()[key].default for key in superfluous}
    stored = file["packing"]
    if lacking := [name for name in NEEDED if name not in stored]:
        raise KeyError(f"it lacks packing/{lacking[0]}")
    found = {name: np.asarray(stored[name][()]) for name in PACKING_ARRAYS if name in stored}
    scene = packing_of(replace(settings, packing=str(path), **usual), found)
    return scene, _Sets(path, file, (scene.replicas,) * (scene.replicas > 1))
