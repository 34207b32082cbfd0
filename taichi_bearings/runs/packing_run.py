"""A run of a packing: solved from its settings, written into a run directory, and read back."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter
from typing import Any

import h5py
import numpy as np

from taichi_bearings import runtime
from taichi_bearings.analysis.histogram import PowerHistogram, power_histogram
from taichi_bearings.analysis.packing_structure import PackingStructure
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.analysis_file import Finding
from taichi_bearings.files.whole_file import attributes_of, put, write_arrays, write_hdf5
from taichi_bearings.hdf5 import UNREADABLE, open_hdf5
from taichi_bearings.lattice import Lattice
from taichi_bearings.options import options_of
from taichi_bearings.packing import Packing, PackingSolution, solve_packing
from taichi_bearings.packing.system import System
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import CHECK_ROWS, CONTACTS, FINDINGS, SPHERES, found_in, plain
from taichi_bearings.runs.run_directory import claimed
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
from taichi_bearings.runs.settings import OF_DRIVEN, OF_PACKINGS, RunSettings, settings_table
from taichi_bearings.runs.structure_report import BOTTLENECK_ROWS, SPHERE_BETWEENNESS
from taichi_bearings.runs.torque import refuse_driven, torque_on_packing
from taichi_bearings.scene import Snapshots, Status
from taichi_bearings.scene.array_files import read_arrays, read_coefficients
from taichi_bearings.scene.initial_spins import STARTS
from taichi_bearings.scene.law import law_named
from taichi_bearings.scene.ramp import Ramp
from taichi_bearings.solvers.table import METHODS, InteriorPoint, MethodOptions, row_of_packing
from taichi_bearings.stages import alike, each, stage
from taichi_bearings.version import VERSION
from taichi_bearings.words import counted, shown

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
READ_OF_RESULT = (*TOLD_OF_RESULT, "largest_balance_residual", "time", "slip_threshold", *FINDINGS)
SIZES = ("radius", "normal_force")
AXES_OF_PACKINGS = {"center": 2, "contact": 2, "normal": 2}  # of arrays of one sample; others have one
ALIKE = ("method", "law", "shape", "spheres", "driven_spheres", "contacts", "seconds_compile", "version")
LED_TO_ARRAYS = {"distribution", "viscosity", *SIZES, *OF_DRIVEN}  # keys that are not kept; run.h5 has what they led to


@dataclass(frozen=True)
class PackingRun:
    """A solved packing. results : of each replica. path : of the directory or the file that has the run, if any.
    command : what made it. start : spins that it started from, where those are no start by name."""

    settings: RunSettings
    results: tuple[PackingSolution, ...]
    path: Path | None = None
    command: str = ""
    interrupted: bool = False
    start: Any = None

    @property
    def result(self) -> PackingSolution:
        """That of the first replica."""
        return self.results[0]

    def sample(self, replica: int) -> "PackingRun":
        """The run of one replica; InputError if there is none of this number."""
        if not 0 <= replica < len(self.results):
            raise InputError(f"replica is {replica}; the run has {len(self.results)}, counted from 0")
        settings = replace(self.settings, seed=self.settings.seed + replica, replicas=1)
        return replace(self, settings=settings, results=self.results[replica : replica + 1])

    def as_interrupted(self) -> "PackingRun":
        return replace(self, interrupted=True)

    def self_contained(self, folder: Path, name: str = "run.h5") -> RunSettings:
        """Settings that solve it again from where its files are. name : of that with its arrays."""
        packings = tuple(result.packing for result in self.results)
        return PackingJob(self.settings, packings, self.start).self_contained(folder, name)

    def write_answer(self, file: Path, attributes: Mapping[str, Any]) -> None:
        write_hdf5(file, partial(_fill, self.results), {**RUN_LAYOUT, **attributes})

    @property
    def status(self) -> list[Status]:
        return [Status(result.status) for result in self.results]

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The numbers of the run, as in `--json` of `run`; of several replicas lists where they may differ."""
        ones = [self.sample(replica)._numbers for replica in range(len(self.results))]
        numbers = ones[0] if len(ones) == 1 else {key: [one[key] for one in ones] for key in ones[0]}
        if len(ones) > 1:
            numbers |= {key: ones[0][key] for key in ALIKE} | {"seconds": sum(numbers["seconds"])}
        pairs = zip(self.results, self.settings.seeds, strict=True)
        said = [f"what is proven of the least power{_of(seed, len(ones))}: {result.proof}"
                for result, seed in pairs if result.proof != "proven"]  # fmt: skip
        path = None if self.path is None else str(self.path)
        return self.settings.driving | numbers | {"warnings": said, "coefficients": None, "run": path}

    @property
    def _numbers(self) -> dict[str, Any]:
        """Those of the first replica."""
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
            "states_proven": unproven == 0 and bool((proven == result.state).all()),
            "slip_threshold": result.slip_threshold,
            "unproven": unproven,
            "largest_balance_residual": result.unbalanced,
            "version": VERSION,
            **result.findings,
            **({} if result.time is None else {"time": result.time}),
            **({} if self.settings.duration is None else {"duration": self.settings.duration}),
        }
        return {key: plain(value) for key, value in numbers.items()}

    @property
    def histogram(self) -> PowerHistogram:
        """Of the power over its slipping contacts, of all replicas."""
        return power_histogram(*self.power_and_state, self.result.slip_threshold)

    @property
    def power_and_state(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the contacts of all replicas, (R, E) each."""
        power, state = (np.stack([getattr(r, n) for r in self.results]) for n in ("power_per_contact", "state"))
        return power, state


def _of(seed: int, replicas: int) -> str:
    return f" of seed {seed}" if replicas > 1 else ""


def _stacked(each: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays of one replica as they are, of several with a leading axis; those that end sooner than the longest stay at
    their end, and those that one does not have are not-a-number."""
    if len(each) == 1:
        return dict(each[0])
    found = {}
    for name in {name: None for one in each for name in one}:
        longest = max((one[name] for one in each if name in one), key=len)
        given = [one.get(name, longest[:1] * np.nan) for one in each]
        found[name] = np.stack([np.append(v, np.repeat(v[-1:], len(longest) - len(v), axis=0), axis=0) for v in given])
    return found


@dataclass(frozen=True)
class PackingJob:
    """A checked run that is ready to be solved. packings : of each replica. start : as of PackingRun."""

    settings: RunSettings
    packings: tuple[Packing, ...]
    start: Any = None

    @classmethod
    def of(cls, settings: RunSettings) -> "PackingJob":
        """Raises InputError or FileError."""
        packings, named = packings_of(settings), settings.initial
        if named in STARTS or not Path(named).exists():
            return cls(settings, packings)
        start, one = read_arrays(Path(named), ["spin"])["spin"], packings[0].spin.shape
        if start.shape not in (one, (len(packings), *one)):
            raise InputError(f"spin in {named} has shape {start.shape}; this packing needs {one}")
        return cls(settings, packings, start)

    def self_contained(self, folder: Path, name: str = "run.h5") -> RunSettings:
        """Settings whose files lie in the run directory. With checkpoints those are there while there is no run.h5."""
        kept = {key: value for key, value in self.settings.given.items() if key not in LED_TO_ARRAYS}
        if self.settings.checkpoint_every is not None:
            name = "packing.npz"
            write_arrays(folder / name, _stacked([packing.arrays() for packing in self.packings]))
        if self.start is not None:
            kept["initial"] = "initial_spin.npz"
            write_arrays(folder / "initial_spin.npz", {"spin": self.start})
        return RunSettings(**{**kept, "packing": name})

    def solve(self, monitors: Sequence[Any] = (), checkpoints: Any = None, **others: Any) -> PackingRun:
        """The replicas one after another, each as alone. Ctrl-C leaves those that were begun; with checkpoints, from
        which the others can go on, it is a KeyboardInterrupt unless all were."""
        count, found = len(self.packings), list[PackingSolution]()
        written = [None] * count if checkpoints is None else checkpoints.of_each(count)
        for number, (packing, own) in enumerate(zip(self.packings, written, strict=True)):
            start = self.start[number] if np.ndim(self.start) > packing.spin.ndim else self.start
            told = {} if minimises(self.settings) else {"monitors": monitors, "checkpoints": own}
            try:
                with stage("solving"):
                    found.append(solved_packing(self.settings, packing, start=start, **told, **others))
            except KeyboardInterrupt:
                if not found:
                    raise
            if len(found) <= number or found[-1].status == Status.INTERRUPTED.value:
                if len(found) < count and checkpoints is not None:
                    raise KeyboardInterrupt
                settings = replace(self.settings, replicas=len(found))
                start = self.start[: len(found)] if np.ndim(self.start) > packing.spin.ndim else self.start
                return PackingRun(settings, tuple(found), interrupted=True, start=start)
        return PackingRun(self.settings, tuple(found), start=self.start)


def minimises(settings: RunSettings) -> bool:
    """Whether its method finds the minimum at once; InputError for one that packings lack."""
    return row_of_packing(settings.method) is None


def method_of_packing(settings: RunSettings) -> type[MethodOptions]:
    return row_of_packing(settings.method) or METHODS.get(settings.method, InteriorPoint)


STOPPED_BY = ("iterations", "time_limit", "duration", "record", "snapshots")


def packing_of(settings: RunSettings) -> Packing:
    """That of a single replica."""
    return packings_of(settings)[0]


def refuse_unused(settings: RunSettings) -> None:
    """InputError for what a packing, its method or its law does not use."""
    given = settings.given
    used = OF_PACKINGS if settings.packing is not None else (*OF_PACKINGS, *OF_DRIVEN)
    if strange := [key for key in given if key not in (*used, *options_of(method_of_packing(settings)))]:
        raise InputError(
            f"{strange[0]} is {shown(given[strange[0]])}, but a packing does not use it; it uses {', '.join(used)}"
        )
    if unused := unused_of_packing(settings):
        raise InputError(next(iter(unused.values())))
    if settings.torque is None:
        return
    if method_of_packing(settings).is_dynamics or Ramp.of(settings.torque).rises:
        raise InputError(f"torque is {settings.torque}; of packings minima alone tell what a constant one does")
    if settings.packing is None:
        refuse_driven(settings, InteriorPoint)


def used(settings: RunSettings) -> RunSettings:
    """The settings without what their method or law does not use, as in a scan that compares methods."""
    table = settings_table()
    return replace(settings, **{key: table[key].default for key in unused_of_packing(settings)})


def packings_of(settings: RunSettings) -> tuple[Packing, ...]:
    """The packings that the settings describe, one a replica: the arrays of the file, and of the settings what that
    lacks, drawn from seeds; or lattices with other driven bodies than planes."""
    refuse_unused(settings)
    given = settings.given
    if settings.packing is None:
        return tuple(_lattice(replace(settings, seed=seed)) for seed in settings.seeds)
    found = Packing.read(settings.packing)
    axes = {name: np.ndim(values) - AXES_OF_PACKINGS.get(name, 1) for name, values in found.items()}
    axes["spin"] = np.ndim(found["spin"]) - (1 if np.shape(found["center"])[-1:] == (2,) else 2)
    samples = {len(values) for name, values in found.items() if axes[name] == 1} or {settings.replicas}
    if samples != {settings.replicas}:
        held = counted(samples.pop(), "sample")
        raise InputError(f"replicas is {settings.replicas}, but {settings.packing} holds {held}")
    drawn = set(("friction", "viscosity")[: 1 + len(_drawn_viscosity(settings))])
    if settings.replicas > 1 and 1 not in axes.values() and drawn <= found.keys() and settings.initial != "random":
        raise InputError(
            f"replicas is {settings.replicas}, but {settings.packing} holds all coefficients, so nothing is drawn; "
            "leave out replicas, or friction from the file"
        )
    for key, name in (("distribution", "friction"), ("viscosity", "viscosity"), *((n, n) for n in SIZES)):
        if key in given and name in found:
            raise InputError(
                f"{key} is {shown(given[key])}, but {settings.packing} holds {name}; leave one of the two out"
            )
    others = {key: getattr(settings, key) for key in ("law", "distribution", *SIZES)} | _drawn_viscosity(settings)
    return tuple(
        Packing(**{**others, "seed": seed, **{n: v[number] if axes[n] == 1 else v for n, v in found.items()}})
        for number, seed in enumerate(settings.seeds)
    )


def unused_of_packing(settings: RunSettings) -> dict[str, str]:
    """The given keys that the method or the law does not use, each with a sentence that says so."""
    found = settings.unused(method_of_packing(settings))
    strange = {"initial", *STOPPED_BY} & settings.given.keys() - found.keys() if minimises(settings) else ()
    name = settings.method
    return found | {key: f"{key} is given, but method {name} of a packing does not use it" for key in sorted(strange)}


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


ON_DEVICE = ("arch", "precision", "threads")


def solved_packing(
    settings: RunSettings,
    packing: Packing,
    system_of: Callable[[Packing], System] = System.of,
    start: Any = None,
    **others: Any,
) -> PackingSolution:
    """The answer of the method that the settings name. system_of : see :func:`solve_packing`. start : instead of the
    one that the settings name. others : density, monitors and checkpoints of :func:`follow_packing`."""
    found = _solved(settings, packing, system_of, start, **others)
    if settings.torque is not None and found.status != Status.INTERRUPTED.value:
        again = partial(_solved, settings, system_of=System.of, start=None, **others)
        found = torque_on_packing(found, Ramp.of(settings.torque).stop, again)
    return found if settings.slip_threshold is None else found.by_threshold(settings.slip_threshold)


def _solved(
    settings: RunSettings, packing: Packing, system_of: Callable[[Packing], System], start: Any, **others: Any
) -> PackingSolution:
    row, given = row_of_packing(settings.method), settings.given
    if row is None:
        return solve_packing(packing, settings.tolerance, system_of, settings.method)
    from taichi_bearings.solvers.packings import follow_packing  # and with it Taichi's kernels
    from taichi_bearings.solvers.recording import Recording
    from taichi_bearings.solvers.stopping import StopRule

    method = row(**{key: value for key in options_of(row) if (value := getattr(settings, key)) is not None})
    if device := {key: given[key] for key in ON_DEVICE if key in given}:
        runtime.start(**device)
    first = settings.initial if start is None else start
    return follow_packing(packing, method, first, StopRule.of(settings), Recording.of(settings), **others)


def _fill(results: Sequence[PackingSolution], file: h5py.File) -> None:
    words = {f"packing/{name}": described for name, described in PACKING_ARRAYS.items()}
    words["spin"] = spin = SPHERES["spin"].unit, SPHERES["spin"].text
    words |= {f"contact/{row.name}": (row.unit, row.text) for row in CONTACTS.values()}
    words |= {f"history/{row.name}": (row.unit, row.text) for row in CHECK_ROWS.values()}
    words["contact/friction"] = "force", FRICTION_OF_SECOND[results[0].packing.dimension]
    words["snapshots/time"] = "time", "simulated time of each snapshot"
    words["snapshots/spin"] = spin[0], f"{spin[1]} at these times"
    for name, values in _stacked([_sets_of(result) for result in results]).items():
        put(file, name, values, *words[name])


def _sets_of(result: PackingSolution) -> dict[str, np.ndarray]:
    """The data sets of one replica."""
    found = {f"packing/{name}": values for name, values in result.packing.arrays().items()} | {"spin": result.spin}
    found |= {f"contact/{row.name}": values for row, values in found_in(result, CONTACTS)}
    found |= {"contact/friction": result.friction}
    found |= {f"history/{name}": column for name, column in result.history.items()}
    if result.snapshots is not None:
        found |= {"snapshots/time": result.snapshots.time, "snapshots/spin": result.snapshots.spin}
    return found


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
    if structure.has_pairs:
        contacts |= {row.name: Finding(row.of(structure), row.unit, row.text) for row in BOTTLENECK_ROWS}
        spheres["sphere_betweenness"] = Finding(structure.bottlenecks.visits, "1", SPHERE_BETWEENNESS.text)
    return spheres, contacts


def analysed(
    found: PackingRun, threshold: float | None = None, replica: int = 0
) -> tuple[dict[str, Any], list[dict[str, Finding]], Callable[..., Any]]:
    """Report, arrays of each replica and what draws the figures of one. threshold : as of runs.analysis.Analysis."""
    from taichi_bearings.plots.structure import draw_network_of_packing

    began, drawn = perf_counter(), found.sample(replica)
    if threshold is not None and not 0 < threshold < np.inf:
        raise InputError(f"threshold is {threshold}; it must be a positive, finite slip speed")
    numbers, arrays = [], []
    for result in each(found.results, "analysing", alike):
        structure = PackingStructure.of(result, threshold)
        of_spheres, of_contacts = _of_structure(structure)
        numbers.append(structure.numbers)
        arrays.append(of_spheres | of_contacts)
    together = {key: [one[key] for one in numbers] for key in numbers[0]} if len(numbers) > 1 else numbers[0]
    proven = "proven" if np.all(found.summary["states_proven"]) else "decided"
    states = proven if threshold is None else "threshold"
    told = ("status", "method", "law", "shape", "spheres", "contacts", "seed", "version")
    report = together | {"threshold": threshold, "states": states}
    report |= {name: found.summary[name] for name in told} | {"seconds": perf_counter() - began}
    return report, arrays, lambda _, page: draw_network_of_packing(drawn.result, page)


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
        packings = packings_of(replace(settings, packing=str(path)))
        there = [name for name in CONTACTS if name not in NOT_IN_ALL or f"contact/{name}" in file]
        names = {"spin": "spin", **{name: f"contact/{name}" for name in (*there, "friction")}}
        sets = {name: _whole(path, file, stored, packings) for name, stored in names.items()}
        sets["power_per_contact"] = sets.pop("power")
        history = {name: _read(path, file, f"history/{name}", packings, None) for name in CHECK_ROWS
                   if f"history/{name}" in file}  # fmt: skip
        sizes: dict[str, tuple[int, ...]] = {"time": (), "spin": packings[0].spin.shape}
        ways = {key: _read(path, file, f"snapshots/{key}", packings, None, *size)
                for key, size in sizes.items() if "snapshots" in file}  # fmt: skip
        results = []
        for replica, packing in enumerate(packings):
            own = {name: _one(attributes[name], replica) for name in READ_OF_RESULT if name in attributes}
            number: dict[str, Any] = {key: float(own[key]) for key in READ_NUMBERS}
            motions, way = own["slipless_motions"], _without_repeats(ways, "time", replica)
            results.append(PackingSolution(
                packing=packing,
                potential=float(own.get("potential", number["power"])),
                proof=str(own["proof"]),
                status=Status(own["status"]).value,
                method=str(own["method"]),
                slipless_motions=None if motions == "" or motions != motions else int(motions),
                unbalanced=float(own["largest_balance_residual"]),
                iterations=int(own["iterations"]),
                history=_without_repeats(history, "iteration", replica),
                time=None if "time" not in own else float(own["time"]),
                snapshots=Snapshots(**way) if way and len(way["time"]) else None,
                slip_threshold=float(own.get("slip_threshold", 0.0)),
                torque=settings.torque,  # type: ignore[arg-type]
                findings={name: np.nan if v == "" else v for name in FINDINGS if (v := own.get(name)) is not None},
                **{name: values[replica] for name, values in sets.items()},
                **number,
            ))  # fmt: skip
    return PackingRun(settings, tuple(results), run, str(attributes.get("command", "")))


def _one(value: Any, replica: int) -> Any:
    """That of one replica of an attribute."""
    value = value[replica] if isinstance(value, np.ndarray) else value
    return value.item() if isinstance(value, np.generic) else value


def _without_repeats(columns: Mapping[str, np.ndarray], key: str, replica: int) -> dict[str, np.ndarray]:
    """Columns (R, rows, ...) of one replica without what makes it as long as the longest."""
    own = {name: values[replica] for name, values in columns.items()}
    return {name: values[np.diff(own[key], prepend=-1) > 0] for name, values in own.items()}


def read_run(run: Path) -> PackingRun | StoredRun:
    """A run of a packing or of a lattice, by its directory or its run.h5; FileError as of the reader of either."""
    return read_packing_run(run) if is_packing_run(run) else read_run_file(run)


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
        found = read_run(run)
        found = found.sample(replica) if isinstance(found, PackingRun) else found
    path = (run if run.is_dir() else run.parent) / name if out is None else out
    with claimed(path, force or out is None):
        yield found, path


def _read(path: Path, file: h5py.File, name: str, packings: Sequence[Packing], *shape: int | None) -> np.ndarray:
    """A data set of a run file, with an axis of replicas."""
    several = len(packings) > 1
    values = read_array(path, file, name, (len(packings), *shape) if several else shape)
    return values if several else values[None]


def _whole(path: Path, file: h5py.File, name: str, packings: Sequence[Packing]) -> np.ndarray:
    """The same of spheres or contacts; FileError for one whose shape or numbers cannot be."""
    packing = packings[0]
    components = () if packing.dimension == 2 else (3,)
    count = packing.spheres if name == "spin" else packing.contacts
    shape = (count, *(components if name in ("spin", "contact/friction") else ()))
    values = _read(path, file, name, packings, *shape)
    if np.isnan(values).any() or not (name == "contact/slip_bound" or np.isfinite(values).all()):
        raise FileError(f"{name} in {path} is damaged: it must hold finite numbers")
    if name == "contact/state" and (values.dtype.kind not in "ui" or values.max(initial=0) > ContactState.DRIVEN):
        raise FileError(f"{name} in {path} is damaged: states are 0 to 3")
    return values
