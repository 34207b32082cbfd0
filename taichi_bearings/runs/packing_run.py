"""A run of a packing: solved from its settings, written into a run directory, and read back."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter
from typing import Any

import h5py
import numpy as np

from taichi_bearings.analysis.histogram import PowerHistogram, power_histogram
from taichi_bearings.analysis.packing_structure import PackingStructure
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.analysis_file import Finding, write_analysis
from taichi_bearings.files.whole_file import read_hdf5, refuse_standing, storable, write_hdf5, write_text
from taichi_bearings.hdf5 import UNREADABLE, open_hdf5
from taichi_bearings.interrupts import awaited
from taichi_bearings.lattice import Lattice
from taichi_bearings.options import options_of
from taichi_bearings.packing import Packing, PackingResult, solve_packing
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import CHECK_ROWS, CONTACTS, SPHERES
from taichi_bearings.runs.run import publish, rescued, versions, with_figures, write_histogram
from taichi_bearings.runs.run_directory import claimed, default_run_path, run_directory, writable_folder
from taichi_bearings.runs.run_file import RUN_SCHEMA, RUN_VERSION
from taichi_bearings.runs.settings import DRIVING_KEYS, OF_DRIVEN, OF_PACKINGS, RunSettings, parse_toml
from taichi_bearings.scene import Status
from taichi_bearings.scene.array_files import read_coefficients
from taichi_bearings.scene.law import law_named
from taichi_bearings.solvers.table import METHODS, InteriorPoint
from taichi_bearings.stages import stage
from taichi_bearings.version import VERSION
from taichi_bearings.words import shown

PACKING_ARRAYS = {
    "center": ("length", "centres of the spheres"),
    "contact": ("1", "first and second sphere of each contact"),
    "driven": ("1", "-1 for a free sphere, else the number of its driven body"),
    "spin": ("1/time", "imposed on driven spheres, laboratory frame"),
    "radius": ("length", "of the spheres"),
    "normal": ("1", "unit vector of each contact from its first to its second sphere"),
    "friction": ("1", "coefficient of the law: friction, or with the law viscous damping, force*time/length"),
    "viscosity": ("force*time/length", "viscosity of the contacts"),
    "normal_force": ("force", "normal force of the contacts"),
}
"""Data sets of the group /packing: unit and words."""
STRUCTURE_COLUMNS = {
    "domain": "rigid domain: spheres that slipless contacts make turn as one",
    "component": "connected piece of the slipless network; a driven body joins its spheres",
    "above_cut": "on the second body's side of the minimum cut",
    "on_cut": "on the minimum cut",
}
FRICTION_OF_SECOND = {
    2: "friction on the second disc, component along z x n",
    3: "friction on the second sphere, laboratory frame",
}
"""By dimension. It is in balance and within the friction limits, so the lower bound follows from it."""
MAY_LACK = ("proven", "slip_bound")
CONTACT_SETS = ("slip", "power", "force", "state", "friction", *MAY_LACK)  # of the group /contact
READ_NUMBERS = ("power", "lower_bound", "gap", "driven_power", "seconds")
SIZES = ("radius", "normal_force")
LED_TO_ARRAYS = {"distribution", "viscosity", *SIZES, *OF_DRIVEN}  # keys that are not kept; run.h5 has what they led to


@dataclass(frozen=True)
class PackingRun:
    """A solved packing. path : of the directory or the file that has the run, if any. command : what made it."""

    settings: RunSettings
    result: PackingResult
    path: Path | None = None
    command: str = ""
    interrupted: bool = False

    def as_interrupted(self) -> "PackingRun":
        return replace(self, interrupted=True)

    def write(self, folder: Path) -> None:
        """Write every file of the run but its figures into `folder`, which will be renamed to its path."""
        _write(folder, self)

    def draw(self) -> None:
        """Draw the figures that every run gets into its directory."""
        _draw(self)

    @property
    def status(self) -> list[Status]:
        return [Status(self.result.status)]

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The numbers of the run, as in `--json` of `run`."""
        result, packing = self.result, self.result.packing
        states = np.bincount(result.state, minlength=4).tolist()
        proven = np.full(packing.contacts, ContactState.UNDECIDED) if result.proven is None else result.proven
        unproven = int(((proven == ContactState.UNDECIDED) & (result.state != ContactState.DRIVEN)).sum())
        numbers = {
            "power": result.power,
            **({"potential": result.potential} if packing.kind.minimises == "potential" else {}),
            "lower_bound": result.lower_bound,
            "gap": result.gap,
            "proof": result.proof,
            "status": result.status,
            "method": result.method,
            "law": str(packing.law),
            "shape": None,
            "spheres": packing.spheres,
            "driven_spheres": int((packing.driven >= 0).sum()),
            "seed": self.settings.seed,
            "iterations": result.iterations,
            "seconds": result.seconds,
            "seconds_compile": 0.0,
            "contacts": packing.contacts - states[ContactState.DRIVEN],
            "slipping": states[ContactState.SLIPPING],
            "slipless": states[ContactState.SLIPLESS],
            "undecided": states[ContactState.UNDECIDED],
            "critical": result.critical,
            "states_proven": unproven == 0,
            "unproven": unproven,
            "driven_power": result.driven_power,
            "slipless_motions": result.slipless_motions,
            "largest_balance_residual": result.unbalanced,
            "version": VERSION,
            **({} if result.time is None else {"time": result.time}),
            **({} if self.settings.duration is None else {"duration": self.settings.duration}),
            "warnings": [] if result.proof == "proven" else [f"what is proven of the least power: {result.proof}"],
            "coefficients": None,
            "run": None if self.path is None else str(self.path),
        }
        return self.settings.driving | {
            key: None if isinstance(value, float) and not np.isfinite(value) else value
            for key, value in numbers.items()
        }

    @property
    def histogram(self) -> PowerHistogram:
        """Of the power over its slipping contacts."""
        return power_histogram(self.result.power_per_contact[None], self.result.state[None], 0.0)


def packing_of(settings: RunSettings) -> Packing:
    """The packing that the settings describe: the arrays of its file, and of the settings what that lacks; or a lattice
    with other driven bodies than planes."""
    given = settings.given
    used = OF_PACKINGS if settings.packing is not None else (*OF_PACKINGS, *OF_DRIVEN)
    row = InteriorPoint if settings.method == "auto" else METHODS[settings.method]
    if strange := [key for key in given if key not in (*used, *options_of(row))]:
        raise InputError(
            f"{strange[0]} is {shown(given[strange[0]])}, but a packing does not use it; it uses {', '.join(used)}"
        )
    if unused := settings.unused(row):
        raise InputError(next(iter(unused.values())))
    if settings.packing is None:
        return _lattice(settings)
    found = Packing.read(settings.packing)
    for key, name in (("distribution", "friction"), ("viscosity", "viscosity"), *((n, n) for n in SIZES)):
        if key in given and name in found:
            raise InputError(
                f"{key} is {shown(given[key])}, but {settings.packing} holds {name}; leave one of the two out"
            )
    others = {key: getattr(settings, key) for key in ("law", "seed", "distribution", *SIZES)}
    return Packing(**{**others, **_drawn_viscosity(settings), **found})


def _drawn_viscosity(settings: RunSettings) -> dict[str, str]:
    return {"viscosity": settings.viscosity} if len(law_named(settings.law).quantities) > 1 else {}


def _lattice(settings: RunSettings) -> Packing:
    """A square or cubic lattice with the coefficients that it has between planes."""
    names = ("periodic", "seed", "law", "distribution", "driven", "spin_top", "spin_bottom", "top", "bottom", *SIZES)
    others = {key: getattr(settings, key) for key in names} | _drawn_viscosity(settings)
    if len(settings.shape) == 3:
        others["direction"] = settings.direction
    if settings.coefficients is not None:
        file = Path(settings.coefficients)
        groups = ("coefficient", "viscosity")[: len(law_named(settings.law).quantities)]
        for name, group in zip(("friction", "viscosity"), groups, strict=False):
            found = read_coefficients(file, group, len(settings.shape))
            if Lattice.of(found).shape != settings.shape or found[0].ndim > len(settings.shape):
                raise InputError(f"coefficients is {settings.coefficients!r}, which is not of this one lattice")
            others[name] = np.concatenate([part.ravel() for part in found])
    return Packing.lattice("cubic" if len(settings.shape) == 3 else "square", settings.shape, **others)


def run_packing(settings: RunSettings, out: Path | None = None, force: bool = False) -> PackingRun:
    """Solve a packing and write its run directory: run.h5, summary.json, scene.toml, power_histogram.csv and figures.

    Raises InputError or FileError before anything is computed or overwritten.
    """
    with stage("reading"):
        packing = packing_of(settings)
    with run_directory(out or default_run_path(), force) as directory:
        with stage("solving"):
            result = _solved(settings, packing)
        stopped = result.status == Status.INTERRUPTED.value
        found = PackingRun(settings, result, directory.path, " ".join(["bearings", *sys.argv[1:]]), stopped)
        with awaited() as heard:
            found = rescued(found, partial(publish, directory, found), "the result is lost")
        return with_figures(found, heard.is_set())


STOPPED_BY = ("iterations", "time_limit", "duration", "record")
ON_DEVICE = ("arch", "precision", "threads")


def _solved(settings: RunSettings, packing: Packing) -> PackingResult:
    if settings.method == "auto":
        if strange := settings.given.keys() & {"initial", *STOPPED_BY}:
            raise InputError(f"{min(strange)} is given, but method auto of a packing does not use it")
        return solve_packing(packing, settings.tolerance)
    from taichi_bearings.solvers.packings import follow_packing  # and with it Taichi's kernels

    row = METHODS[settings.method]
    options = {key: value for key in options_of(row) if (value := getattr(settings, key)) is not None}
    others = {key: value for key in (*STOPPED_BY, *ON_DEVICE) if (value := getattr(settings, key)) is not None}
    return follow_packing(packing, row(**options), settings.tolerance, settings.initial, **others)


def _write(folder: Path, found: PackingRun) -> None:
    kept = {key: value for key, value in found.settings.given.items() if key not in LED_TO_ARRAYS}
    stored = RunSettings(**{**kept, "packing": "run.h5"})
    origin = {"command": found.command, "scene": stored.to_toml(), **versions()}
    numbers = {key: value for key, value in found.summary.items() if key not in DRIVING_KEYS}  # which led to the arrays
    with stage("writing"):
        write_hdf5(folder / "run.h5", lambda file: _fill(file, found.result, numbers | origin))
        write_text(folder / "scene.toml", stored.to_toml())
        full = found.summary | {"settings": found.settings.described, "versions": versions()}
        write_text(folder / "summary.json", json.dumps(full, indent=2, allow_nan=False) + "\n")
    write_histogram(folder, found.histogram)


def _fill(file: h5py.File, result: PackingResult, attributes: dict[str, Any]) -> None:
    file.attrs["schema"], file.attrs["schema_version"] = RUN_SCHEMA, RUN_VERSION
    for key, value in attributes.items():
        file.attrs[key] = storable(value)

    def put(name: str, values: np.ndarray, unit: str, text: str) -> None:
        stored = file.create_dataset(name, data=values)
        stored.attrs["units"], stored.attrs["description"] = unit, text

    for name, values in result.packing.arrays().items():
        put(f"packing/{name}", values, *PACKING_ARRAYS[name])
    put("spin", result.spin, SPHERES["spin"].unit, SPHERES["spin"].text)
    for name, found in _of_contacts(result).items():
        put(f"contact/{name}", found.values, found.units, found.description)
    for name, column in result.history.items():
        put(f"history/{name}", column, CHECK_ROWS[name].unit, CHECK_ROWS[name].text)
    put("contact/friction", result.friction, "force", FRICTION_OF_SECOND[result.packing.dimension])


def _draw(found: PackingRun) -> None:
    from taichi_bearings.plots.histogram import draw_histogram
    from taichi_bearings.plots.style import save

    assert found.path is not None
    save(draw_histogram(found.histogram), found.path / "power_histogram.png")


def columns_of_packing(result: PackingResult) -> tuple[dict[str, Finding], dict[str, Finding]]:
    """What is known of the spheres (N, ...) and of the contacts (E, ...), by name, for other programs."""
    packing, spin = result.packing, result.spin
    if packing.dimension == 2:  # along z
        spin = np.column_stack([np.zeros((packing.spheres, 2)), result.spin])
    spheres = {
        "spin": Finding(spin, SPHERES["spin"].unit, SPHERES["spin"].text),
        "radius": Finding(np.asarray(packing.radius), *PACKING_ARRAYS["radius"]),
        "driven": Finding(packing.driven, *PACKING_ARRAYS["driven"]),
    }
    contacts = _of_contacts(result)
    for name in ("friction", "viscosity", "normal_force"):
        if getattr(packing, name) is not None:
            contacts["coefficient" if name == "friction" else name] = Finding(
                getattr(packing, name), *PACKING_ARRAYS[name]
            )
    of_spheres, of_contacts = _of_structure(PackingStructure.of(result))
    return spheres | of_spheres, contacts | of_contacts


def _of_contacts(result: PackingResult) -> dict[str, Finding]:
    """The quantities of contacts that the result has."""
    found = {name: getattr(result, "power_per_contact" if name == "power" else name) for name in CONTACTS}
    rows = {name: (values, CONTACTS[name]) for name, values in found.items() if values is not None}
    return {name: Finding(values, row.unit, row.text) for name, (values, row) in rows.items()}


def _of_structure(structure: PackingStructure) -> tuple[dict[str, Finding], dict[str, Finding]]:
    spheres, contacts = (
        {name: Finding(values, "1", STRUCTURE_COLUMNS[name]) for name, values in columns.items()}
        for columns in structure.columns
    )
    return spheres, contacts


def analyse_packing(
    run: Path, out: Path | None = None, force: bool = False, threshold: float | None = None, figures: bool = True
) -> dict[str, Any]:
    """Analyse a stored run of a packing, write /analysis and the figure of the network, and return the report.

    out, threshold : as of runs.analysis.analyse. Raises InputError or FileError before anything is computed.
    """
    from taichi_bearings.plots.packing import draw_packing
    from taichi_bearings.plots.style import save

    began = perf_counter()
    if threshold is not None and not 0 < threshold < np.inf:
        raise InputError(f"threshold is {threshold}; it must be a positive, finite slip speed")
    with stage("reading"):
        found = read_packing_run(run)
    file = run / "run.h5" if run.is_dir() else run
    target = file if out is None else out / "analysis.h5"
    picture = target.parent / "network.png"
    refuse_standing((target, *((picture,) if figures else ())), force or out is None)
    with writable_folder(target.parent):
        with stage("analysing"):
            structure = PackingStructure.of(found.result, threshold)
            of_spheres, of_contacts = _of_structure(structure)
        states = "decided" if threshold is None else "threshold"
        told = ("status", "method", "law", "shape", "spheres", "contacts", "version")
        report = structure.numbers | {"threshold": threshold, "states": states}
        report |= {name: found.summary[name] for name in told} | {"seconds": perf_counter() - began}
        with stage("writing"):
            write_analysis(target, [of_spheres | of_contacts], report, into_run=out is None)
        if figures:
            with stage("drawing"):
                save(draw_packing(found.result, "network"), picture)
    return report | {"run": str(run), "files": [str(target), *([str(picture)] if figures else [])]}


def is_packing_run(run: Path) -> bool:
    """True for a run directory, or its run.h5, that holds a packing."""
    file = run / "run.h5" if run.is_dir() else run
    if not file.is_file() or file.suffix not in (".h5", ".hdf5"):
        return False
    try:
        with open_hdf5(file) as stored:
            return "packing" in stored
    except (FileError, *UNREADABLE):
        return False  # whoever reads it says why it cannot be read


def read_packing_run(run: Path) -> PackingRun:
    """Read a run directory or its run.h5; FileError if it is damaged or was changed."""
    path = run / "run.h5" if run.is_dir() else run
    with read_hdf5(path, RUN_SCHEMA, RUN_VERSION, "a run") as file:
        attributes = {key: v.item() if isinstance(v, np.generic) else v for key, v in file.attrs.items()}
        try:
            settings = RunSettings.from_mapping(parse_toml(str(attributes["scene"])), f"the scene of {path}")
            packing = packing_of(replace(settings, packing=str(path)))
        except InputError as error:
            raise FileError(f"{path} is damaged or was changed: {error}") from None
        names = ["spin", *(f"contact/{n}" for n in CONTACT_SETS if n not in MAY_LACK or f"contact/{n}" in file)]
        arrays = {name: _whole(path, file, name, packing) for name in names}
        sets: dict[str, Any] = {name.removeprefix("contact/"): values for name, values in arrays.items()}
        number: dict[str, Any] = {key: float(attributes[key]) for key in READ_NUMBERS}
        motions = attributes["slipless_motions"]
        result = PackingResult(
            packing=packing,
            potential=float(attributes.get("potential", number["power"])),
            proof=str(attributes["proof"]),
            status=Status(attributes["status"]).value,
            method=str(attributes["method"]),
            power_per_contact=sets.pop("power"),
            slipless_motions=None if motions == "" else int(motions),
            unbalanced=float(attributes["largest_balance_residual"]),
            iterations=int(attributes["iterations"]),
            history=_history(path, file),
            time=None if "time" not in attributes else float(attributes["time"]),
            **sets,
            **number,
        )
    return PackingRun(settings, result, run, str(attributes.get("command", "")))


@contextmanager
def packing_to_draw(
    run: Path, out: Path | None, name: str, force: bool, replica: int = 0
) -> Iterator[tuple[PackingRun, Path]]:
    """A run and the file to write, as runs.points_and_lines.opened_to_draw."""
    if replica:
        raise InputError(f"replica is {replica}; a run of a packing has 1, counted from 0")
    with stage("reading"):
        found = read_packing_run(run)
    path = (run if run.is_dir() else run.parent) / name if out is None else out
    with claimed(path, force or out is None):
        yield found, path


def _history(path: Path, file: h5py.File) -> dict[str, np.ndarray]:
    """Columns of the history; FileError for what is none."""
    if "history" not in file:
        return {}
    columns = {name: file[f"history/{name}"] for name in CHECK_ROWS if f"history/{name}" in file}
    if strange := [name for name, column in columns.items() if column.ndim != 1 or column.dtype.kind not in "fiu"]:
        raise FileError(f"history/{strange[0]} in {path} is damaged: it must hold numbers, one a check")
    return {name: column[()] for name, column in columns.items()}


def _whole(path: Path, file: h5py.File, name: str, packing: Packing) -> np.ndarray:
    """A data set of a run file; FileError for one whose shape or numbers cannot be."""
    components = () if packing.dimension == 2 else (3,)
    count = packing.spheres if name == "spin" else packing.contacts
    shape = (count, *(components if name in ("spin", "contact/friction") else ()))
    stored = file[name]
    if stored.shape != shape or stored.dtype.kind not in "fiu":
        raise FileError(f"{name} in {path} is damaged: it has shape {stored.shape}, and must have {shape}")
    values = stored[()]
    if np.isnan(values).any() or not (name == "contact/slip_bound" or np.isfinite(values).all()):
        raise FileError(f"{name} in {path} is damaged: it must hold finite numbers")
    if name == "contact/state" and values.max(initial=0) > ContactState.DRIVEN:
        raise FileError(f"{name} in {path} is damaged: states are 0 to 3")
    return np.asarray(values)
