"""Makes the samples of the studies: solves them, follows them in time, or shares them among worker processes; and
gathers their numbers in tables.

Letters: R samples solved together, T recorded times, N the shape of a lattice, E contacts.
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
from taichi_bearings.runs.lattice_run import build_scene
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
TIMES = np.append(0.0, np.geomspace(1e-6, 1e2, 601))  # times at which the power is recorded, in units of 1 / spin
SPARE = 0.7  # share of the free memory that workers may take
SAME = 1e-6  # relative difference up to which two powers are taken for equal
HERE = Path(__file__).resolve()
SCANS = next(filter(Path.is_dir, (HERE.parent / "scans", HERE.parents[2] / "examples/studies")))  # in a wheel, or not
LEAST_SEEDS = 4  # least number of seeds of a scan
ANY = RunSettings(threads=1)  # settings by which parts that solve no single sample are estimated


class Table:
    """A table of samples: for each column name an array with one entry (a number, text or array) for each sample.

    Each column is an attribute, too: `table.power`. A missing number is not-a-number. The table is never changed; each
    method returns a new one.
    """

    def __init__(self, columns: Mapping[str, Any]) -> None:
        """Make a table.

        columns : by name, the values of all samples, in the same order in each column. None is a missing number.
        """
        self.columns = {
            name: np.array(values, dtype=float if any(value is None for value in values) else None)
            for name, values in columns.items()
        }

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, Any]]) -> "Table":
        """Return the table of some rows, dictionaries that all have the same keys; these become the names of the
        columns.
        """
        return cls({name: [row[name] for row in rows] for name in rows[0]} if rows else {})

    def __getattr__(self, name: str) -> np.ndarray:
        """Return the column of this name, an array with one entry for each sample. Raises AttributeError if there is
        none.
        """
        try:
            found: np.ndarray = self.__dict__["columns"][name]
        except KeyError:
            raise AttributeError(name) from None
        return found

    def __getitem__(self, chosen: Any) -> "Table":
        """Return a table of some of the samples.

        chosen : mask (samples,), slice, or indices.
        """
        return Table({name: values[chosen] for name, values in self.columns.items()})

    def __or__(self, more: Mapping[str, Any]) -> "Table":
        """Return a table with further columns, or with new values in columns of the same name; `more` has them by
        name.
        """
        return Table({**self.columns, **more})

    def __len__(self) -> int:
        """Return the number of samples (rows)."""
        return len(next(iter(self.columns.values()), ()))

    def by(self, name: str, key: str = "side") -> dict[Any, np.ndarray]:
        """Return a column, split into groups of samples that agree in another column.

        name : the column that is returned.
        key : the column that defines the groups, by default the side of the lattice.

        returns : for each value of `key`, from the least on, the values of `name` of the samples that have it.
        """
        keys = self.columns[key]
        return {value.item(): self.columns[name][keys == value] for value in np.unique(keys)}

    def only(self, names: str) -> dict[str, list[Any]]:
        """Return some columns as lists of plain Python numbers, by name.

        names : names of the columns, separated by spaces.
        """
        return {name: self.columns[name].tolist() for name in names.split()}

    def write(self, path: Path) -> None:
        """Write the table as the CSV file `path`, one line for each sample; columns whose entries are arrays are left
        out.
        """
        flat = {name: values.tolist() for name, values in self.columns.items() if values.ndim == 1}
        write_csv(path, list(flat), zip(*flat.values(), strict=True))


def joined(tables: Mapping[str, Table], key: str) -> Table:
    """Return one table with the rows of several, which have the same columns, one table after the other.

    tables : the tables, by name.
    key : name of an additional first column, which says from which table a row comes.
    """
    columns = next(iter(tables.values())).columns
    names = [name for name, table in tables.items() for _ in range(len(table))]
    return Table({key: names} | {of: np.concatenate([t.columns[of] for t in tables.values()]) for of in columns})


def curves(seeds: Sequence[int], **columns: np.ndarray) -> Table:
    """Return quantities that change with time as a table with one row for each sample and time, sorted by sample.

    seeds : seed of each of the R samples.
    columns : arrays (times, R) by name, or (times,) if all samples have the same values. One of them is `time`.
    """
    shape = (len(seeds), len(columns["time"]))
    rows = {name: np.broadcast_to(values.T, shape).ravel() for name, values in columns.items()}
    return Table({"seed": np.repeat(seeds, shape[1])} | rows)


@dataclass(frozen=True)
class StudyResult:
    """What a study returns: everything that its figure, its CSV files and the verdicts on its claims are made from.

    tables : what is written as CSV, by the end of the file name, such as "-samples.csv".
    draw : function that draws the figure from an object whose attributes are the entries of `named`.
    named : the values that the figure and the sentences and rules of the claims use, by name (see :mod:`.claims`).
    """

    tables: Mapping[str, Table]
    draw: Callable[[Any], Figure]
    named: Mapping[str, Any]


def solved(scene: Scene, method: MethodOptions, rule: StopRule = TIGHT, start: str = "linear") -> Solution:
    """Return the solution at which a method ends. Raises KeyboardInterrupt if the user stopped it before.

    scene : what is solved, with all its samples.
    method : options of the solver.
    rule : tolerance and limits at which it stops; by default a relative gap of 1e-12.
    start : name of the initial spins: "linear" (they grow evenly with the height), "random", "zero" or "minimum-cut".
    """
    return uninterrupted(solve(scene, method.build(), initial_spin(scene, start), rule))


@dataclass(frozen=True)
class Part:
    """One piece of a study's work, which a worker process does and whose result is kept in a file: `work(*words)`.

    key : name of the piece, different for each; by it the result is found again after an interruption.
    work : function at the top level of a module, so that another process can import it; returns a dictionary that JSON
        can store.
    words : the arguments of `work`.
    settings : settings of the sample that is solved, by which time and memory are estimated. The default stands for
        work that solves no single sample.
    """

    key: str
    work: Callable[..., dict[str, Any]]
    words: tuple[Any, ...]
    settings: RunSettings = ANY

    @property
    def label(self) -> str:
        """The name of the piece in progress reports."""
        return self.key


def computed(parts: Sequence[Part], journal: Path, name: str, workers: int = 0) -> list[dict[str, Any]]:
    """Return the result of each piece of work, in the order of `parts`. Pieces that the journal does not have are
    computed by worker processes.

    parts : the pieces of work.
    journal : file to which each finished piece is appended at once; what it has already is not computed again. The
        caller removes it when the study is done.
    name : what a piece is called in progress reports and errors, such as "sample".
    workers : number of processes. 1 computes everything in this process; 0 chooses the number from the processors, the
        free memory and the amount of work.

    Raises BearingsError if the computation of a piece fails.
    """
    known = read_journal(journal)
    missing = [part for part in parts if part.key not in known]
    units = [(part,) for part in missing]
    if workers == 0 and missing:
        fitting = SPARE * free_bytes() / max(bytes_of(part.settings) for part in missing)  # workers that memory allows
        workers = paying_workers(missing, max(1, int(min(runtime.available_threads(), fitting))), structure=True)  # type: ignore[arg-type]
        units = units_of(missing, True, workers)  # type: ignore[arg-type, assignment]
    cost = {part.key: seconds_of(part.settings, structure=True) for part in missing}
    with Journal(journal) as kept, closing(_records(missing, units, workers)) as records:
        for _, record in zip(each(missing, name, lambda part: cost[part.key]), records, strict=False):
            if record["scalars"]["status"] == FAILED:
                key, error = record["key"], record["scalars"]["error"]
                raise BearingsError(f"the study needs the {name} {key}, which could not be computed: {error}")
            kept.append([record])
            known[record["key"]] = record
    return [known[part.key]["numbers"] for part in parts]


def _records(
    parts: Sequence[Part], units: Sequence[tuple[Part, ...]], workers: int
) -> Generator[dict[str, Any], None, None]:
    """Yield for each piece, as it is finished, a record with its key, its status and its result (`numbers`) or its
    error.

    parts : the pieces that are computed.
    units : groups of pieces that are sent to a worker together.
    workers : number of processes; up to 1, this process does all.
    """
    if workers <= 1:
        yield from map(_record, parts)
        return
    with closing(LocalEngine(_by_worker, workers)) as engine:
        for found in run_samples(units, engine):
            yield from found


def _record(part: Part) -> dict[str, Any]:
    """Compute one piece, and return its record: key, status, and the result as `numbers`.

    part : the piece: a function with its arguments and a key.
    """
    return {"key": part.key, "scalars": {"status": "solved"}, "numbers": part.work(*part.words)}


def _by_worker(unit: Sequence[Part]) -> list[dict[str, Any]]:
    """Compute some pieces in a worker process, and return their records. The record of a piece that raises an exception
    says so.

    unit : the pieces, which one worker computes.
    """
    runtime.start("cpu", "f64", 1)
    records = []
    with one_thread():
        for part in unit:
            try:
                records.append(_record(part))
            except Exception as error:
                records.append(failure(part, error))
    return records


Numbers = Callable[[Structure], dict[str, Any]]  # returns the columns of a sample, by name


def certified(settings: RunSettings) -> Structure:
    """Return the structure (slipless network, rigid domains, minimum cut, ...) of one sample at its minimum, which is
    certified to a relative gap of 1e-9.

    settings : settings of the sample.
    """
    return structure_of(solved(build_scene(settings), InteriorPoint(), StopRule(1e-9)))


def measured(chosen: Iterable[RunSettings], numbers: Numbers, journal: Path) -> Table:
    """Return a table with a row for each sample, solved to its certified minimum.

    chosen : settings of each sample.
    numbers : function that returns the columns of a row, by name, from the structure of a solved sample.
    journal : file in which each finished sample is kept, and from which an interrupted study goes on.
    """
    return Table.of(computed([Part(sample_key(s), _measure, (s, numbers), s) for s in chosen], journal, "sample"))


def planned(scans: Mapping[str, int], effort: Effort) -> Iterator[RunSettings]:
    """Yield the settings of all samples of some scan files of examples/studies.

    scans : names of the files; for each the largest first side of samples that the quick form takes.
    effort : first seed, number of samples, and whether it is the quick form. The number of seeds in a file is for the
        default number of samples and changes in proportion; it is at least LEAST_SEEDS.
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
    """Solve the sample with these settings, and return its columns of the table of :func:`measured`.

    numbers : function of the certified result that returns the columns, by name.
    """
    return numbers(certified(settings))


def drawn(
    draw: Callable[..., dict[str, Any]], wanted: Mapping[tuple[Any, ...], int], block: int, seed: int, journal: Path
) -> dict[tuple[Any, ...], dict[str, np.ndarray]]:
    """Return the results of many small samples, for several points of a parameter grid, computed in blocks by all
    processors.

    draw : function; `draw(*point, count, first_seed)` computes `count` samples with consecutive seeds and returns lists
        with one entry for each sample, by name.
    wanted : for each point, a tuple of parameters, the number of samples.
    block : number of samples that one call of `draw` computes.
    seed : first seed.
    journal : file in which each finished block is kept, and from which an interrupted study goes on.

    returns : for each point the arrays (samples,) by name.
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
    """Return columns that several studies have, for one sample at its minimum.

    structure : network, domains and cut of the sample.
    names : further quantities that are added, by the names that `bearings analyse --json` gives them.

    Among the columns are `gap`, relative; `power_over_cut`, least power over the power of the minimum cut; `below_cut`,
    True if the minimum is proven to have less power than any cut; `intermediate`, the share of free spheres that
    rolling contacts lock neither to the bottom nor to the top.
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
    """The relaxation in time of R samples that are followed together.

    start : name of the initial spins.
    time : (times T,) recorded times.
    power : (T, R) dissipated power, energy/time.
    first, last : (3, R, *N spheres) spins at the beginning and at the end, 1/time, staggered: with opposite signs on
        neighbours and measured from the bottom, so that spheres that roll on each other have equal values.
    """

    start: str
    time: np.ndarray
    power: np.ndarray
    first: np.ndarray
    last: np.ndarray

    @property
    def ends(self) -> np.ndarray:
        """(samples R,) power at the last recorded time over that at the first."""
        return np.asarray(self.power[-1] / self.power[0])

    @property
    def largest_rise(self) -> np.ndarray:
        """(samples R,) largest amount by which the power rises above its lowest value before, over the initial
        power.
        """
        return np.asarray((self.power - np.minimum.accumulate(self.power)).max(axis=0) / self.power[0])

    def distance(self, other: "Run", at: np.ndarray) -> np.ndarray:
        """Return how far the power curves of two relaxations are apart: (samples that both have,) the largest
        difference of power / initial power.

        other : the relaxation to compare with.
        at : times at which they are compared. Power is interpolated linearly between recorded times, and constant after
            the last.
        """
        ours, theirs = (run.power / run.power[0] for run in (self, other))
        pairs = zip(ours.T, theirs.T, strict=False)  # the samples that both have
        return np.array([np.abs(np.interp(at, self.time, p) - np.interp(at, other.time, q)).max() for p, q in pairs])


def relax(
    scene: Scene, start: str, springs: CundallStrack | None = None, steps: int = STEPS, times: np.ndarray = TIMES
) -> Run:
    """Return the relaxation of all samples of a scene by Cundall-Strack dynamics, followed until each is proven to be
    within a relative END of its least power. The power may rise for a while, unlike with rigid contacts, since a
    contact held by spring and damper creeps at up to mu F_n / A_t (A_t: the damping).

    scene : the lattice with its R samples.
    start : name of the initial spins, such as "random".
    springs : options of the dynamics; by default stiffness and damping of the paper.
    steps : most time steps.
    times : (T,), times at which the powers are recorded.
    """
    return _followed(scene, start, springs or CundallStrack(), StopRule(END, steps), Recording(history=times))


def relax_rigidly(scene: Scene, start: str) -> Run:
    """Return the relaxation of all samples of a scene to the minimum, with rigid contacts: they have no springs, and
    each rolls without slip or slips at the friction limit. It ends when the power of each sample is proven to be within
    a relative RIGID_END of the least one. Powers are recorded at each step.

    start : name of the spins to begin from, such as "random".
    """
    return _followed(scene, start, RigidLimit(), StopRule(RIGID_END), Recording())


def _followed(scene: Scene, start: str, method: MethodOptions, rule: StopRule, recording: Recording) -> Run:
    """Return the relaxation of a scene in time by a method.

    start : name of the initial spins.
    method : the dynamics with its options.
    rule : tolerance and limits at which it stops.
    recording : simulated times at which the power is recorded; each step if there are none.
    """
    axes, spin = scene.lattice.all_spin_axes, initial_spin(scene, start)
    solution = uninterrupted(solve(scene, method.build(), spin, rule, recording=recording))
    time, power = solution.history["time"], solution.history["power"]
    return Run(start, time, power, scene.staggered_spin(spin, axes), scene.staggered_spin(solution.spin, axes))


def minima_of(scene: Scene) -> Table:
    """Return a table of the R samples of a scene at their minima, by the interior-point method, with their minimum
    cuts.

    Columns: `power` and its proven `lower_bound`, and `cut_power` of the minimum cut, energy/time; `below_cut`, True if
    the minimum is proven to have less power than any two rigid domains; `cut_is_minimum`, True if it is proven that no
    state has a power lower than that of the cut by more than a share SAME of it; `spin` (*N spheres, 3), laboratory
    frame, 1/time.
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
