"""A run of a packing: solved from its settings, written into a run directory, and read back."""

from collections.abc import Callable, Iterator, Mapping
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
from taichi_bearings.files.analysis_file import Finding
from taichi_bearings.files.whole_file import attributes_of, put, write_hdf5
from taichi_bearings.hdf5 import UNREADABLE, open_hdf5
from taichi_bearings.lattice import Lattice
from taichi_bearings.options import options_of
from taichi_bearings.packing import Packing, PackingSolution, solve_packing
from taichi_bearings.packing.system import System
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import CHECK_ROWS, CONTACTS, SPHERES, found_in, plain
from taichi_bearings.runs.run import command, kept, publish, row_of
from taichi_bearings.runs.run_directory import claimed, default_run_path, run_directory
from taichi_bearings.runs.run_file import (
    NOT_IN_ALL,
    RUN_LAYOUT,
    StoredRun,
    file_of,
    opened_run,
    read_array,
    read_run_file,
    scene_settings,
)  # fmt: skip
from taichi_bearings.runs.settings import OF_DRIVEN, OF_PACKINGS, RunSettings
from taichi_bearings.scene import Status
from taichi_bearings.scene.array_files import read_coefficients
from taichi_bearings.scene.law import law_named
from taichi_bearings.solvers.table import METHODS
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
TOLD_OF_RESULT = (
    "power", "potential", "lower_bound", "gap", "proof", "status", "method", "iterations", "seconds", "critical",
    "driven_power", "slipless_motions",
)  # fmt: skip
"""What a summary has of the result under the same name."""
READ_NUMBERS = ("power", "lower_bound", "gap", "driven_power", "seconds")
SIZES = ("radius", "normal_force")
LED_TO_ARRAYS = {"distribution", "viscosity", *SIZES, *OF_DRIVEN}  # keys that are not kept; run.h5 has what they led to


@dataclass(frozen=True)
class PackingRun:
    """A solved packing. path : of the directory or the file that has the run, if any. command : what made it."""

    settings: RunSettings
    result: PackingSolution
    path: Path | None = None
    command: str = ""
    interrupted: bool = False

    def as_interrupted(self) -> "PackingRun":
        return replace(self, interrupted=True)

    def self_contained(self, folder: Path, name: str = "run.h5") -> RunSettings:
        """Settings that solve it again from where its file of this name is."""
        kept = {key: value for key, value in self.settings.given.items() if key not in LED_TO_ARRAYS}
        return RunSettings(**{**kept, "packing": name})

    def write_answer(self, file: Path, attributes: Mapping[str, Any]) -> None:
        write_hdf5(file, partial(_fill, self.result), {**RUN_LAYOUT, **attributes})

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
        found = {name: getattr(result, name) for name in TOLD_OF_RESULT}
        if packing.kind.minimises != "potential":
            del found["potential"]
        numbers = found | {
            "law": str(packing.law),
            "shape": None,
            "spheres": packing.spheres,
            "driven_spheres": int((packing.driven >= 0).sum()),
            "seed": self.settings.seed,
            "seconds_compile": 0.0,
            "contacts": packing.contacts - states[ContactState.DRIVEN],
            "slipping": states[ContactState.SLIPPING],
            "slipless": states[ContactState.SLIPLESS],
            "undecided": states[ContactState.UNDECIDED],
            "states_proven": unproven == 0,
            "unproven": unproven,
            "largest_balance_residual": result.unbalanced,
            "version": VERSION,
            **({} if result.time is None else {"time": result.time}),
            **({} if self.settings.duration is None else {"duration": self.settings.duration}),
            "warnings": [] if result.proof == "proven" else [f"what is proven of the least power: {result.proof}"],
            "coefficients": None,
            "run": None if self.path is None else str(self.path),
        }
        return self.settings.driving | {key: plain(value) for key, value in numbers.items()}

    @property
    def histogram(self) -> PowerHistogram:
        """Of the power over its slipping contacts."""
        return power_histogram(self.result.power_per_contact[None], self.result.state[None], 0.0)


def packing_of(settings: RunSettings) -> Packing:
    """The packing that the settings describe: the arrays of its file, and of the settings what that lacks; or a lattice
    with other driven bodies than planes."""
    given = settings.given
    used = OF_PACKINGS if settings.packing is not None else (*OF_PACKINGS, *OF_DRIVEN)
    if strange := [key for key in given if key not in (*used, *options_of(row_of(settings)))]:
        raise InputError(
            f"{strange[0]} is {shown(given[strange[0]])}, but a packing does not use it; it uses {', '.join(used)}"
        )
    if unused := unused_of_packing(settings):
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


def unused_of_packing(settings: RunSettings) -> dict[str, str]:
    """The given keys that the method or the law does not use, each with a sentence that says so."""
    found = settings.unused(row_of(settings))
    strange = {"initial", *STOPPED_BY} & settings.given.keys() - found.keys() if settings.method == "auto" else ()
    return found | {key: f"{key} is given, but method auto of a packing does not use it" for key in sorted(strange)}


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
            result = solved_packing(settings, packing)
        stopped = result.status == Status.INTERRUPTED.value
        found = PackingRun(settings, result, directory.path, command(), stopped)
        return kept(found, partial(publish, directory, found))


STOPPED_BY = ("iterations", "time_limit", "duration", "record")
ON_DEVICE = ("arch", "precision", "threads")


def solved_packing(
    settings: RunSettings, packing: Packing, system_of: Callable[[Packing], System] = System.of
) -> PackingSolution:
    """The answer of the method that the settings name. system_of : see :func:`solve_packing`."""
    if settings.method == "auto":
        return solve_packing(packing, settings.tolerance, system_of)
    from taichi_bearings.solvers.packings import follow_packing  # and with it Taichi's kernels

    row = METHODS[settings.method]
    options = {key: value for key in options_of(row) if (value := getattr(settings, key)) is not None}
    others = {key: value for key in (*STOPPED_BY, *ON_DEVICE) if (value := getattr(settings, key)) is not None}
    return follow_packing(packing, row(**options), settings.tolerance, settings.initial, **others)


def _fill(result: PackingSolution, file: h5py.File) -> None:
    for name, values in result.packing.arrays().items():
        put(file, f"packing/{name}", values, *PACKING_ARRAYS[name])
    put(file, "spin", result.spin, SPHERES["spin"].unit, SPHERES["spin"].text)
    for row, found in found_in(result, CONTACTS):
        put(file, f"contact/{row.name}", found, row.unit, row.text)
    for name, column in result.history.items():
        put(file, f"history/{name}", column, CHECK_ROWS[name].unit, CHECK_ROWS[name].text)
    put(file, "contact/friction", result.friction, "force", FRICTION_OF_SECOND[result.packing.dimension])


def columns_of_packing(result: PackingSolution) -> tuple[dict[str, Finding], dict[str, Finding]]:
    """What is known of the spheres (N, ...) and of the contacts (E, ...), by name, for other programs."""
    packing, spin = result.packing, result.spin
    if packing.dimension == 2:  # along z
        spin = np.column_stack([np.zeros((packing.spheres, 2)), result.spin])
    spheres = {
        "spin": Finding(spin, SPHERES["spin"].unit, SPHERES["spin"].text),
        "radius": Finding(np.asarray(packing.radius), *PACKING_ARRAYS["radius"]),
        "driven": Finding(packing.driven, *PACKING_ARRAYS["driven"]),
    }
    contacts = {row.name: Finding(found, row.unit, row.text) for row, found in found_in(result, CONTACTS)}
    for name in ("friction", "viscosity", "normal_force"):
        if getattr(packing, name) is not None:
            contacts["coefficient" if name == "friction" else name] = Finding(
                getattr(packing, name), *PACKING_ARRAYS[name]
            )
    of_spheres, of_contacts = _of_structure(PackingStructure.of(result))
    return spheres | of_spheres, contacts | of_contacts


def _of_structure(structure: PackingStructure) -> tuple[dict[str, Finding], dict[str, Finding]]:
    spheres, contacts = (
        {name: Finding(values, "1", STRUCTURE_COLUMNS[name]) for name, values in columns.items()}
        for columns in structure.columns
    )
    return spheres, contacts


def analysed(
    found: PackingRun, threshold: float | None = None
) -> tuple[dict[str, Any], list[dict[str, Finding]], Callable[..., Any]]:
    """Report, arrays and what draws the figures of the structure. threshold : as of runs.analysis.Analysis."""
    from taichi_bearings.plots.packing import draw_packing

    began = perf_counter()
    if threshold is not None and not 0 < threshold < np.inf:
        raise InputError(f"threshold is {threshold}; it must be a positive, finite slip speed")
    with stage("analysing"):
        structure = PackingStructure.of(found.result, threshold)
        of_spheres, of_contacts = _of_structure(structure)
    states = "decided" if threshold is None else "threshold"
    told = ("status", "method", "law", "shape", "spheres", "contacts", "version")
    report = structure.numbers | {"threshold": threshold, "states": states}
    report |= {name: found.summary[name] for name in told} | {"seconds": perf_counter() - began}
    return report, [of_spheres | of_contacts], partial(draw_packing, found.result)


def is_packing_run(run: Path) -> bool:
    """True for a run directory, or its run.h5, that holds a packing."""
    file = file_of(run)
    if not file.is_file() or file.suffix not in (".h5", ".hdf5"):
        return False
    try:
        with open_hdf5(file) as stored:
            return "packing" in stored
    except (FileError, *UNREADABLE):
        return False  # whoever reads it says why it cannot be read


def read_packing_run(run: Path) -> PackingRun:
    """Read a run directory or its run.h5; FileError if it is damaged or was changed."""
    path = file_of(run)
    with opened_run(path) as file:
        attributes = attributes_of(file)
        settings = scene_settings(attributes)
        packing = packing_of(replace(settings, packing=str(path)))
        there = [name for name in CONTACTS if name not in NOT_IN_ALL or f"contact/{name}" in file]
        names = {"spin": "spin", **{name: f"contact/{name}" for name in (*there, "friction")}}
        sets: dict[str, Any] = {name: _whole(path, file, stored, packing) for name, stored in names.items()}
        number: dict[str, Any] = {key: float(attributes[key]) for key in READ_NUMBERS}
        motions, columns = attributes["slipless_motions"], [name for name in CHECK_ROWS if f"history/{name}" in file]
        result = PackingSolution(
            packing=packing,
            potential=float(attributes.get("potential", number["power"])),
            proof=str(attributes["proof"]),
            status=Status(attributes["status"]).value,
            method=str(attributes["method"]),
            power_per_contact=sets.pop("power"),
            slipless_motions=None if motions == "" else int(motions),
            unbalanced=float(attributes["largest_balance_residual"]),
            iterations=int(attributes["iterations"]),
            history={name: read_array(path, file, f"history/{name}", (None,)) for name in columns},
            time=None if "time" not in attributes else float(attributes["time"]),
            **sets,
            **number,
        )
    return PackingRun(settings, result, run, str(attributes.get("command", "")))


def read_run(run: Path, replica: int = 0) -> PackingRun | StoredRun:
    """A run of a packing or of a lattice, by its directory or its run.h5; FileError as of the reader of either.

    replica : the sample that is wanted; InputError if it is none of a packing.
    """
    if not is_packing_run(run):
        return read_run_file(run)
    if replica:
        raise InputError(f"replica is {replica}; a run of a packing has 1, counted from 0")
    return read_packing_run(run)


@contextmanager
def opened_to_draw(
    run: Path, out: Path | None, name: str, force: bool, replica: int
) -> Iterator[tuple[PackingRun | StoredRun, Path]]:
    """A run directory or its run.h5, and the file to write, which is ours meanwhile: `out`, or of this name in the run
    directory.

    Raises FileError if `out` exists, unless `force`; what is in the run directory is replaced. InputError for a sample
    that a packing does not have.
    """
    with stage("reading"):
        found = read_run(run, replica)
    path = (run if run.is_dir() else run.parent) / name if out is None else out
    with claimed(path, force or out is None):
        yield found, path


def _whole(path: Path, file: h5py.File, name: str, packing: Packing) -> np.ndarray:
    """A data set of a run file; FileError for one whose shape or numbers cannot be."""
    components = () if packing.dimension == 2 else (3,)
    count = packing.spheres if name == "spin" else packing.contacts
    shape = (count, *(components if name in ("spin", "contact/friction") else ()))
    values = read_array(path, file, name, shape)
    if np.isnan(values).any() or not (name == "contact/slip_bound" or np.isfinite(values).all()):
        raise FileError(f"{name} in {path} is damaged: it must hold finite numbers")
    if name == "contact/state" and (values.dtype.kind not in "ui" or values.max(initial=0) > ContactState.DRIVEN):
        raise FileError(f"{name} in {path} is damaged: states are 0 to 3")
    return values
