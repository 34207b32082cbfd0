"""Samples of the studies: followed in time, or at their minima, which the workers of scans find."""

from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings import runtime
from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import BearingsError
from taichi_bearings.files.scan_file import FAILED
from taichi_bearings.files.scan_journal import Journal, read_journal
from taichi_bearings.memory import free_bytes
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.plots.style import save
from taichi_bearings.runs.run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.engine import LocalEngine, run_samples
from taichi_bearings.scans.estimate import bytes_of, paying_workers, seconds_of, units_of
from taichi_bearings.scans.plan import Sample, sample_key
from taichi_bearings.scans.sample import failure
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.scene.initial_spins import cut_of, initial_spin
from taichi_bearings.solvers import CundallStrack, InteriorPoint, MethodOptions, RigidLimit
from taichi_bearings.solvers.drive import solve, uninterrupted
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import each

TIGHT = StopRule(1e-12)
STEPS = 1_000_000  # limit; most samples of 3x3x3 are certified within 100 000
END = 1e-8  # proven gap at which a relaxation has ended
RIGID_END = 1e-10  # the same without springs
TIMES = np.append(0.0, np.geomspace(1e-6, 1e2, 601))  # at which the power is written down
SPARE = 0.7  # share of the free memory that workers may take
SAME = 1e-6  # relative difference up to which two powers count as the same


def solved(scene: Scene, method: MethodOptions, rule: StopRule = TIGHT, start: str = "linear") -> Solution:
    """Where a method ends; KeyboardInterrupt if it was stopped before."""
    return uninterrupted(solve(scene, method.build(), initial_spin(scene, start), rule))


def save_both(figure: Figure, folder: Path, name: str) -> None:
    """Write `name`.png and `name`.pdf."""
    for ending in ("png", "pdf"):
        save(figure, folder / f"{name}.{ending}")


def certified(settings: RunSettings) -> Structure:
    """Structure of the sample that the settings name, at its certified minimum."""
    return structure_of(solved(build_scene(settings), InteriorPoint(), StopRule(1e-9)))


Numbers = Callable[[Structure], dict[str, Any]]  # of a module, so that workers find it; the result is valid JSON


def measured(chosen: Sequence[RunSettings], numbers: Numbers, journal: Path) -> list[dict[str, Any]]:
    """`numbers` of the structure of each sample at its certified minimum.

    journal : keeps what is done where the study is interrupted, until the end; samples that it has are not solved
    again. Raises BearingsError if a sample has no result.
    """
    samples = [Sample(sample_key(settings), settings, {"seed": settings.seed}) for settings in chosen]
    known = read_journal(journal)
    missing = [sample for sample in samples if sample.key not in known]
    costs = {sample.key: seconds_of(sample.settings, structure=True) for sample in missing}
    known |= kept_in(journal, _records(missing, numbers), missing, "sample", lambda sample: costs[sample.key])
    return [known[sample.key]["numbers"] for sample in samples]


def kept_in(
    journal: Path,
    records: Generator[dict[str, Any], None, None],
    missing: Sequence[Any],
    name: str,
    work: Callable[[Any], float] | None = None,
) -> dict[str, Any]:
    """The records of what is missing by key, each kept in the journal as it comes until all are there.

    name, work : see :func:`taichi_bearings.stages.each`. Raises BearingsError if one has no result.
    """
    found = {}
    with Journal(journal) as kept, closing(records):
        for _, record in zip(each(missing, name, work), records, strict=False):
            if record["scalars"]["status"] == FAILED:
                raise BearingsError(f"sample {record['key']} of the study has no result: {record['scalars']['error']}")
            kept.append([record])
            found[record["key"]] = record
    journal.unlink()
    return found


def _records(samples: Sequence[Sample], numbers: Numbers) -> Generator[dict[str, Any], None, None]:
    """A record of each as it comes, by as many worker processes as pay, or here if that is one."""
    room = SPARE * free_bytes() / max((bytes_of(sample.settings) for sample in samples), default=1.0)
    most = max(1, int(min(runtime.available_threads(), room)))
    workers = paying_workers(samples, most, structure=True) if samples else 1
    if workers == 1:
        for sample in samples:
            yield _record(sample, numbers)
        return
    with ExitStack() as stack:
        engine = stack.enter_context(closing(LocalEngine(partial(_by_worker, numbers=numbers), workers)))
        for found in run_samples(units_of(samples, True, workers), engine, lambda *_: None, failure):
            yield from found


def _record(sample: Sample, numbers: Numbers) -> dict[str, Any]:
    return {"key": sample.key, "scalars": {"status": "solved"}, "numbers": numbers(certified(sample.settings))}


def _by_worker(unit: Sequence[Sample], numbers: Numbers) -> list[dict[str, Any]]:
    runtime.start("cpu", "f64", 1)
    records = []
    with one_thread():
        for sample in unit:
            try:
                records.append(_record(sample, numbers))
            except Exception as error:
                records.append(failure(sample, error))
    return records


@dataclass(frozen=True)
class Run:
    """A relaxation of R samples: time (T,), power (T, R), staggered spins (3, R, *N) at both ends."""

    start: str
    time: np.ndarray
    power: np.ndarray
    first: np.ndarray
    last: np.ndarray

    @property
    def largest_rise(self) -> np.ndarray:
        """Height of the power above its lowest value before, at most, over the initial power, (R,)."""
        return np.asarray((self.power - np.minimum.accumulate(self.power)).max(axis=0) / self.power[0])


def relax(
    scene: Scene, start: str, springs: CundallStrack | None = None, steps: int = STEPS, times: np.ndarray = TIMES
) -> Run:
    """Follow Cundall-Strack dynamics until every sample is certified to END, or for `steps` time steps.

    springs : the paper's by default. times : at which the power is written down.

    Rigid friction is a steepest descent of the power F_n sum mu |v|; these contacts are not: one that holds by its
    spring and damper creeps at up to mu F_n / A_t, so the power can rise by as much as this creep is worth.
    """
    method = (springs or CundallStrack()).build()
    return _followed(scene, start, method, StopRule(END, steps), Recording(history=times))


def relax_rigidly(scene: Scene, start: str) -> Run:
    """Follow the rigid limit until every sample is certified to RIGID_END; the power is written down at every step."""
    return _followed(scene, start, RigidLimit().build(), StopRule(RIGID_END), Recording())


def _followed(scene: Scene, start: str, method: Method, rule: StopRule, recording: Recording) -> Run:
    axes, spin = scene.lattice.all_spin_axes, initial_spin(scene, start)
    solution = uninterrupted(solve(scene, method, spin, rule, recording=recording))
    time, power = solution.history["time"], solution.history["power"]
    return Run(start, time, power, scene.staggered_spin(spin, axes), scene.staggered_spin(solution.spin, axes))


@dataclass(frozen=True)
class Minima:
    """Certified least powers and minimum-cut powers of R samples; all (R,) but the spins (R, *N, 3)."""

    power: np.ndarray
    lower_bound: np.ndarray
    cut_power: np.ndarray
    cut_bound: np.ndarray
    spin: np.ndarray

    @property
    def below_cut(self) -> np.ndarray:
        """True where some spins are proven to dissipate less than any two domains."""
        return self.power < self.cut_bound * (1 - SAME)

    @property
    def cut_is_minimum(self) -> np.ndarray:
        """True where no spins dissipate less than the minimum cut by more than SAME; proven."""
        return self.cut_power - self.lower_bound <= SAME * self.cut_power


def minima_of(scene: Scene) -> Minima:
    """Certified minima by the interior-point method, and the minimum cuts."""
    solution = solved(scene, InteriorPoint(settle=False), StopRule(1e-10))
    cut = cut_of(scene)
    unit = scene.normal_force * scene.lattice.radius * scene.jump
    return Minima(solution.power, solution.lower_bound, unit * cut.weight, unit * cut.lower_bound, solution.spin)
