"""Samples of the studies: followed in time, or solved part by part by the workers of scans, and tables of them.

Letters: R samples, T times, N the shape of a lattice.
"""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings import runtime
from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import BearingsError
from taichi_bearings.files.scan_file import FAILED
from taichi_bearings.files.scan_journal import Journal, read_journal
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.memory import free_bytes
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.quantities import ANALYSED, plain
from taichi_bearings.runs.run import build_scene
from taichi_bearings.runs.settings import RunSettings, read_toml
from taichi_bearings.scans.engine import LocalEngine, failure, run_samples
from taichi_bearings.scans.estimate import bytes_of, paying_workers, seconds_of, units_of
from taichi_bearings.scans.plan import read_plan, sample_key
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.interface import cut_of
from taichi_bearings.solvers import CundallStrack, InteriorPoint, MethodOptions, RigidLimit
from taichi_bearings.solvers.drive import solve, uninterrupted
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import each

from .claims import SAMPLES, Effort

TIGHT = StopRule(1e-12)
STEPS = 1_000_000  # most time steps; most samples of 3x3x3 are certified within 100 000
END = 1e-8  # proven gap at which a relaxation has ended
RIGID_END = 1e-10  # proven gap at which a relaxation without springs has ended
TIMES = np.append(0.0, np.geomspace(1e-6, 1e2, 601))  # times at which the power is recorded
SPARE = 0.7  # share of the free memory that workers may take
SAME = 1e-6  # relative difference up to which two powers are taken for equal
HERE = Path(__file__).resolve()
SCANS = next(filter(Path.is_dir, (HERE.parent / "scans", HERE.parents[2] / "examples/studies")))  # in a wheel, or not
LEAST_SEEDS = 4  # least number of seeds of a scan
ANY = RunSettings(threads=1)  # settings of parts that solve no sample in particular


class Table:
    """Samples in columns: arrays (samples, ...) by name, each an attribute too; missing numbers are not-a-number."""

    def __init__(self, columns: Mapping[str, Any]) -> None:
        """columns : values of the samples by name; None stands for a missing number."""
        self.columns = {
            name: np.array(values, dtype=float if any(value is None for value in values) else None)
            for name, values in columns.items()
        }

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, Any]]) -> "Table":
        """Return a table of rows, which all have the same names."""
        return cls({name: [row[name] for row in rows] for name in rows[0]} if rows else {})

    def __getattr__(self, name: str) -> np.ndarray:
        try:
            found: np.ndarray = self.__dict__["columns"][name]
        except KeyError:
            raise AttributeError(name) from None
        return found

    def __getitem__(self, chosen: Any) -> "Table":
        """Return the samples that a mask or a slice picks."""
        return Table({name: values[chosen] for name, values in self.columns.items()})

    def __or__(self, more: Mapping[str, Any]) -> "Table":
        return Table({**self.columns, **more})

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def by(self, name: str, key: str = "side") -> dict[Any, np.ndarray]:
        """Return a column split by the values of another one (`key`), which rise."""
        own = self.columns[key]
        return {value.item(): self.columns[name][own == value] for value in np.unique(own)}

    def only(self, names: str) -> dict[str, list[Any]]:
        """Return some columns as lists of plain numbers. names : with spaces between."""
        return {name: self.columns[name].tolist() for name in names.split()}

    def write(self, path: Path) -> None:
        """Write the columns of one number a sample as CSV."""
        flat = {name: values.tolist() for name, values in self.columns.items() if values.ndim == 1}
        write_csv(path, list(flat), zip(*flat.values(), strict=True))


def joined(tables: Mapping[str, Table], key: str) -> Table:
    """Return tables below one another, the name of each in a column `key`."""
    columns = next(iter(tables.values())).columns
    names = [name for name, table in tables.items() for _ in range(len(table))]
    return Table({key: names} | {of: np.concatenate([t.columns[of] for t in tables.values()]) for of in columns})


def curves(seeds: Sequence[int], **columns: np.ndarray) -> Table:
    """Return a table of samples' numbers against time, one row a sample and time.

    seeds : of the R samples. columns : (T,) or (T, R).
    """
    shape = (len(seeds), len(columns["time"]))
    rows = {name: np.broadcast_to(values.T, shape).ravel() for name, values in columns.items()}
    return Table({"seed": np.repeat(seeds, shape[1])} | rows)


@dataclass(frozen=True)
class Found:
    """The results of a study.

    tables : to be written, by the ends of their file names.
    draw : draws its figure from `named`, whose names are attributes there.
    named : values by the names that the figure and its claims use (see :mod:`.claims`).
    """

    tables: Mapping[str, Table]
    draw: Callable[[Any], Figure]
    named: Mapping[str, Any]


def solved(scene: Scene, method: MethodOptions, rule: StopRule = TIGHT, start: str = "linear") -> Solution:
    """Return where a method ends; KeyboardInterrupt if it was stopped before. rule : when it stops. start : its
    first spins.
    """
    return uninterrupted(solve(scene, method.build(), initial_spin(scene, start), rule))


@dataclass(frozen=True)
class Part:
    """Work whose result is kept as a whole: `work(*words)` returns valid JSON.

    work : a function of a module, so that workers find it.
    settings : of the sample that it solves, or of none in particular.
    """

    key: str
    work: Callable[..., dict[str, Any]]
    words: tuple[Any, ...]
    settings: RunSettings = ANY

    @property
    def label(self) -> str:
        return self.key


def computed(parts: Sequence[Part], journal: Path, name: str, workers: int = 0) -> list[dict[str, Any]]:
    """Return what each part gives, computed by worker processes.

    journal : file that keeps finished parts; parts that it has are not computed again. It is removed at the study's
        end.
    name : of a part, for progress and errors.
    workers : processes; 1 for none but this one, 0 for as many as the work pays for.

    Raises BearingsError if a part has no result.
    """
    known = read_journal(journal)
    missing = [part for part in parts if part.key not in known]
    units = [(part,) for part in missing]
    if workers == 0 and missing:
        fitting = SPARE * free_bytes() / max(bytes_of(part.settings) for part in missing)  # workers in the memory
        workers = paying_workers(missing, max(1, int(min(runtime.available_threads(), fitting))), structure=True)  # type: ignore[arg-type]
        units = units_of(missing, True, workers)  # type: ignore[arg-type, assignment]
    cost = {part.key: seconds_of(part.settings, structure=True) for part in missing}
    with Journal(journal) as kept, closing(_records(missing, units, workers)) as records:
        for _, record in zip(each(missing, name, lambda part: cost[part.key]), records, strict=False):
            if record["scalars"]["status"] == FAILED:
                raise BearingsError(f"{name} {record['key']} of the study has no result: {record['scalars']['error']}")
            kept.append([record])
            known[record["key"]] = record
    return [known[part.key]["numbers"] for part in parts]


def _records(
    parts: Sequence[Part], units: Sequence[tuple[Part, ...]], workers: int
) -> Generator[dict[str, Any], None, None]:
    """Yield a record of each part as it comes."""
    if workers <= 1:
        yield from map(_record, parts)
        return
    with closing(LocalEngine(_by_worker, workers)) as engine:
        for found in run_samples(units, engine):
            yield from found


def _record(part: Part) -> dict[str, Any]:
    return {"key": part.key, "scalars": {"status": "solved"}, "numbers": part.work(*part.words)}


def _by_worker(unit: Sequence[Part]) -> list[dict[str, Any]]:
    """Return the records of some parts, in a worker."""
    runtime.start("cpu", "f64", 1)
    records = []
    with one_thread():
        for part in unit:
            try:
                records.append(_record(part))
            except Exception as error:
                records.append(failure(part, error))
    return records


Numbers = Callable[[Structure], dict[str, Any]]  # returns the numbers that a study wants of a sample


def certified(settings: RunSettings) -> Structure:
    """Return the structure of the sample that the settings name, at its certified minimum."""
    return structure_of(solved(build_scene(settings), InteriorPoint(), StopRule(1e-9)))


def measured(chosen: Iterable[RunSettings], numbers: Numbers, journal: Path) -> Table:
    """Return a table of `numbers` of each sample at its certified minimum. journal : see :func:`computed`."""
    return Table.of(computed([Part(sample_key(s), _measure, (s, numbers), s) for s in chosen], journal, "sample"))


def planned(scans: Mapping[str, int], effort: Effort) -> Iterator[RunSettings]:
    """Yield the samples of scans in examples/studies, with a number of seeds in proportion to the effort.

    scans : for each name the largest first side of its samples in the quick form.
    """
    for name, largest in scans.items():
        path = SCANS / f"{name}.toml"
        usual = read_toml(path)["scan"]["seed"]
        seeds = round((usual["stop"] - usual["start"]) * effort.samples / SAMPLES)
        stop = effort.seed + max(LEAST_SEEDS, seeds)
        for sample in read_plan(path, [f"scan.seed={{start={effort.seed}, stop={stop}}}"]).samples:
            if not effort.quick or sample.settings.shape[0] <= largest:
                yield sample.settings


def _measure(settings: RunSettings, numbers: Numbers) -> dict[str, Any]:
    return numbers(certified(settings))


def drawn(
    draw: Callable[..., dict[str, Any]], wanted: Mapping[tuple[Any, ...], int], block: int, seed: int, journal: Path
) -> dict[tuple[Any, ...], dict[str, np.ndarray]]:
    """Return what `draw(*point, samples, seed)` gives for many small samples, as arrays by point.

    wanted : number of samples of each point, with seeds from `seed` on. block : samples of one call; calls are shared
        by as many processes as there are cores. journal : see :func:`computed`.
    """
    parts = [
        Part("-".join(map(str, (*point, seed + first))), draw, (*point, min(block, count - first), seed + first))
        for point, count in wanted.items()
        for first in range(0, count, block)
    ]
    found: dict[tuple[Any, ...], list[dict[str, Any]]] = {point: [] for point in wanted}
    for part, lists in zip(parts, computed(parts, journal, "block", runtime.available_threads()), strict=True):
        found[part.words[:-2]].append(lists)
    return {
        point: {name: np.concatenate([part[name] for part in several]) for name in several[0]}
        for point, several in found.items()
    }


def shared_numbers(structure: Structure, *names: str) -> dict[str, Any]:
    """Return numbers of a minimum that studies share, and numbers of `bearings analyse` by their `names`.

    Fractions are of the free spheres.

    intermediate : share of them that are not locked to a driven plane in all components.
    """
    cut, free = structure.interface, structure.network.free
    assert cut is not None  # as a lattice has two planes
    locked = structure.rigid_domains.spheres_of_kind(free)
    numbers = {
        "side": structure.whole.shape[0],
        "seed": structure.scene.seeds[0],
        "power": structure.power,
        "gap": (structure.power - structure.lower_bound) / structure.power if structure.power else 0.0,
        "power_over_cut": structure.power / cut.power if cut.power else 1.0,
        "below_cut": structure.power < cut.lower_bound * (1 - SAME),
        "states_proven": structure.states_proven,
        "intermediate": 1 - (locked["bottom"] + locked["top"]) / int(free.sum()),
        "largest_intermediate": structure.rigid_domains.largest_intermediate,
    }
    shown = ("slipless_fraction", "spans", "reached_fraction", *names)
    return {name: plain(of) for name, of in (numbers | {name: ANALYSED[name].of(structure) for name in shown}).items()}


@dataclass(frozen=True)
class Run:
    """A relaxation of R samples.

    start : spins that it began with. time : (T,). power : (T, R). first, last : staggered spins (3, R, *N) at both
        ends.
    """

    start: str
    time: np.ndarray
    power: np.ndarray
    first: np.ndarray
    last: np.ndarray

    @property
    def ends(self) -> np.ndarray:
        """(R,) last power over the first."""
        return np.asarray(self.power[-1] / self.power[0])

    @property
    def largest_rise(self) -> np.ndarray:
        """(R,) largest rise of the power above its lowest value before, over the initial power."""
        return np.asarray((self.power - np.minimum.accumulate(self.power)).max(axis=0) / self.power[0])

    def distance(self, other: "Run", at: np.ndarray) -> np.ndarray:
        """Return the largest difference of power / initial power from another relaxation, for each sample that both
        have.

        at : times that are compared. Powers are linear between recorded times and constant after the last one.
        """
        own, theirs = (run.power / run.power[0] for run in (self, other))
        pairs = zip(own.T, theirs.T, strict=False)
        return np.array([np.abs(np.interp(at, self.time, p) - np.interp(at, other.time, q)).max() for p, q in pairs])


def relax(
    scene: Scene, start: str, springs: CundallStrack | None = None, steps: int = STEPS, times: np.ndarray = TIMES
) -> Run:
    """Follow Cundall-Strack dynamics until every sample is certified to END, or for `steps` time steps.

    springs : the paper's by default. times : at which the power is recorded.

    Rigid friction is a steepest descent of the power F_n sum mu |v|. These contacts are not rigid: one that holds by
    its spring and damper creeps at up to mu F_n / A_t, so the power can rise by as much as this creep is worth.
    """
    return _followed(scene, start, springs or CundallStrack(), StopRule(END, steps), Recording(history=times))


def relax_rigidly(scene: Scene, start: str) -> Run:
    """Follow the rigid limit until every sample is certified to RIGID_END; the power is recorded at every step."""
    return _followed(scene, start, RigidLimit(), StopRule(RIGID_END), Recording())


def _followed(scene: Scene, start: str, method: MethodOptions, rule: StopRule, recording: Recording) -> Run:
    """Return the relaxation of a scene by a method. start : name of the initial spins."""
    axes, spin = scene.lattice.all_spin_axes, initial_spin(scene, start)
    solution = uninterrupted(solve(scene, method.build(), spin, rule, recording=recording))
    time, power = solution.history["time"], solution.history["power"]
    return Run(start, time, power, scene.staggered_spin(spin, axes), scene.staggered_spin(solution.spin, axes))


def minima_of(scene: Scene) -> Table:
    """Return least powers with bounds and spins by the interior-point method, and the powers of the minimum cuts.

    below_cut : True where some spins are proven to dissipate less than any two rigid domains. cut_is_minimum : True
        where no spins dissipate less than the minimum cut by more than SAME; proven.
    """
    solution, cut = solved(scene, InteriorPoint(settle=False), StopRule(1e-10)), cut_of(scene)
    unit = scene.normal_force * scene.lattice.radius * scene.jump
    cut_power = unit * cut.weight
    return Table(
        {
            "power": solution.power,
            "lower_bound": solution.lower_bound,
            "cut_power": cut_power,
            "below_cut": solution.power < unit * cut.lower_bound * (1 - SAME),
            "cut_is_minimum": cut_power - solution.lower_bound <= SAME * cut_power,
            "spin": solution.spin,
        }
    )
