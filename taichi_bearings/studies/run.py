"""One run from its settings: build the scene, solve it, write the run directory."""

import contextlib
import json
import os
import secrets
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.contact_state import ContactState, count, separate
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import MOST_SITES
from taichi_bearings.scene import Scene, Solution, Status
from taichi_bearings.scene.array_files import read_coefficients
from taichi_bearings.scene.disorder import Distribution, draw_coefficients
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.studies.settings import RunSettings


def build_scene(settings: RunSettings) -> Scene:
    """The scene that the settings describe: seeds seed ... seed + replicas - 1, drawn or read coefficients."""
    lattice = Lattice(settings.shape, settings.radius)
    if lattice.sites * settings.replicas > MOST_SITES // 8:
        most = MOST_SITES // 8 // lattice.sites
        raise InputError(f"replicas is {settings.replicas}; with this shape at most {most} can be indexed")
    seeds = tuple(range(settings.seed, settings.seed + settings.replicas))
    if settings.coefficients is None:
        distribution = Distribution.parse(settings.distribution)
        drawn = [draw_coefficients(lattice, distribution, seed) for seed in seeds]
        coefficient = tuple(np.stack(parts) for parts in zip(*drawn, strict=True))
    else:
        stored = read_coefficients(Path(settings.coefficients), lattice.dimension)
        coefficient = tuple(_with_replicas(values, lattice.dimension, len(seeds)) for values in stored)
    return Scene(
        lattice=lattice,
        law=settings.law,
        coefficient=coefficient,
        spin_top=settings.spin_top,
        spin_bottom=settings.spin_bottom,
        direction=(settings.direction[0], settings.direction[1], settings.direction[2]),
        normal_force=settings.normal_force,
        seeds=seeds,
    )


def _with_replicas(values: np.ndarray, dimension: int, replicas: int) -> np.ndarray:
    """Coefficients with a replica axis, which a file of a single sample lacks."""
    if values.ndim == dimension and replicas > 1:
        raise InputError(f"replicas is {replicas}, but the coefficients file holds a single sample; it must be 1")
    return values[None] if values.ndim == dimension else values


MOST_FACTORISED = 120_000  # spheres of a cubic lattice up to which a factorisation pays and fits (about 48^3)
ROUGH = 3e-5  # tolerance that operator splitting reaches sooner than the interior-point method


def automatic_method(scene: Scene, settings: RunSettings) -> str:
    """Name of the fastest method that certifies this scene."""
    if scene.law == "viscous":
        return "linear-solver"
    if len(scene.minimum_spin_axes) == 1:
        return "planar-cut"
    if settings.arch != "cpu" and (settings.arch == "cuda" or runtime.has_cuda()):
        return "gradient-descent"
    if settings.tolerance < ROUGH and scene.lattice.sites <= MOST_FACTORISED:
        return "interior-point"
    return "operator-splitting"


def build_method(settings: RunSettings, scene: Scene) -> Any:
    """The method that the settings name; auto takes the fastest one that certifies (docs/methods.md)."""
    from taichi_bearings.solvers import method_class

    name = automatic_method(scene, settings) if settings.method == "auto" else settings.method
    if name == "gradient-descent":
        from taichi_bearings.solvers.gradient_descent import GradientDescentOptions

        return method_class(name)(GradientDescentOptions(momentum=settings.momentum))
    if name != "cundall-strack":
        return method_class(name)()
    from taichi_bearings.solvers.cundall_strack import CundallStrackOptions

    return method_class(name)(
        CundallStrackOptions(
            stiffness=settings.stiffness,
            damping=settings.damping,
            mass=settings.mass,
            inertia=settings.inertia,
            static_ratio=settings.static_ratio,
            gear_order=settings.gear_order,
            time_step=settings.time_step,
            rest_tolerance=settings.rest_tolerance,
        )
    )


@dataclass(frozen=True)
class Job:
    """A checked run that is ready to be solved."""

    settings: RunSettings
    scene: Scene
    spin: np.ndarray
    method: Any


def prepare(settings: RunSettings) -> Job:
    """Build everything the settings describe; every input error is raised here, before anything is computed."""
    scene = build_scene(settings)
    return Job(settings, scene, initial_spin(scene, settings.initial), build_method(settings, scene))


def solve_job(job: Job, monitors: Sequence[Any] = ()) -> Solution:
    """Solve on the device that the settings name; starts Taichi if the method needs it."""
    from taichi_bearings.solvers.drive import solve
    from taichi_bearings.solvers.stopping import StopRule

    settings = job.settings
    if job.method.needs_taichi:
        runtime.start(settings.arch, settings.precision, settings.threads)
    stop = StopRule(settings.tolerance, settings.iterations, settings.time_limit or float("inf"), settings.settle)
    solution = solve(job.scene, job.method, job.spin, stop, monitors, settings.slip_threshold)
    if settings.method == "auto" and solution.method == "interior-point" and solution.status is Status.STALLED:
        from taichi_bearings.solvers.operator_splitting import OperatorSplitting

        left = StopRule(stop.tolerance, stop.iterations, max(stop.seconds - solution.seconds, 1e-3))
        other = solve(job.scene, OperatorSplitting(), solution.spin, left, monitors, settings.slip_threshold)
        solution = _better(solution, other, settings.tolerance)
    return solution


def _better(first: Solution, second: Solution, tolerance: float) -> Solution:
    """Of two answers to one scene, judged by the best bounds of both, the second if it is clearly closer."""
    from taichi_bearings.certificate import relative_gap

    bound = np.maximum(first.lower_bound, second.lower_bound)
    gaps = [relative_gap(first.scene, answer.power, bound) for answer in (first, second)]
    clearly = gaps[1].max() <= tolerance < gaps[0].max() or 2 * gaps[1].max() < gaps[0].max()
    answer, gap = (second, gaps[1]) if clearly else (first, gaps[0])
    status = Status.CERTIFIED if (gap <= tolerance).all() else second.status
    seconds = first.seconds + second.seconds
    return replace(answer, lower_bound=bound, gap=gap, status=status, seconds=seconds)


def summarise(solution: Solution, tolerance: float) -> dict[str, Any]:
    """The numbers of a solution, as in `--json` of `run`; one value a seed becomes a list with several replicas.

    A replica whose own gap is within `tolerance` is certified, however the run as a whole ended. Numbers that are not
    finite become None, so that the summary is valid JSON.
    """
    from taichi_bearings import __version__

    scene = solution.scene

    def per_seed(values: Any) -> Any:
        listed = [_plain(v) for v in values]
        return listed if scene.replicas > 1 else listed[0]

    unit = scene.normal_force * scene.lattice.radius * abs(scene.spin_top)
    separation = separate(scene, solution.slip, solution.state)
    summary = {
        "power": per_seed(solution.power),
        "lower_bound": per_seed(solution.lower_bound),
        "gap": per_seed(solution.gap),
        "status": per_seed(
            [Status.CERTIFIED.value if gap <= tolerance else solution.status.value for gap in solution.gap]
        ),
        "method": solution.method,
        "law": scene.law,
        "shape": list(scene.lattice.shape),
        "seed": per_seed(scene.seeds),
        "iterations": solution.iterations,
        "seconds": solution.seconds,
        "seconds_compile": solution.seconds_compile,
        "contacts": scene.lattice.contacts,
        "slipping": per_seed(count(solution.state, ContactState.SLIPPING)),
        "slipless": per_seed(count(solution.state, ContactState.SLIPLESS)),
        "undecided": per_seed(count(solution.state, ContactState.UNDECIDED)),
        "states_proven": per_seed(solution.resolved),
        "largest_slipless_slip": per_seed(separation.largest_slipless),
        "smallest_slipping_slip": per_seed(separation.smallest_slipping),
        "separation_decades": per_seed(separation.decades),
        "slip_threshold": solution.slip_threshold,
        "largest_balance_residual": per_seed(solution.unbalanced_torque),
        "spin_top": scene.spin_top,
        "spin_bottom": scene.spin_bottom,
        "normal_force": scene.normal_force,
        "radius": scene.lattice.radius,
        "version": __version__,
    }
    if scene.law == "coulomb" and unit > 0:
        summary["power_normalised"] = per_seed(solution.power / unit)
    summary |= {name: per_seed(values) for name, values in solution.findings.items()}
    if "time" in solution.history:
        summary["time"] = float(solution.history["time"][-1])
    return summary


def _plain(value: Any) -> Any:
    """A Python number or text; None for one that is not finite."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not np.isfinite(value) else value


def versions() -> dict[str, str]:
    """Versions of what shapes a result."""
    import platform
    from importlib.metadata import version

    found = {name: version(name) for name in ("taichi", "numpy", "scipy", "h5py")}
    return {"python": platform.python_version(), **found}


@dataclass
class RunDirectory:
    """A run directory that appears under its name only when complete.

    Files are written into a hidden neighbour and renamed at the end, so a killed run leaves nothing half-written; an
    existing directory is replaced only with `force`, and only then.
    """

    path: Path
    force: bool = False

    def __post_init__(self) -> None:
        try:
            self._prepare()
        except OSError as error:
            raise FileError(f"output directory {self.path} cannot be written: {error.strerror or error}") from None

    def _prepare(self) -> None:
        exists = os.path.lexists(self.path)
        if exists and not self.force:
            raise FileError(f"output directory {self.path} already exists; choose another --out or add --force")
        is_run = (self.path / "run.h5").is_file() or (self.path.is_dir() and not any(self.path.iterdir()))
        if exists and not is_run:
            raise FileError(f"{self.path} is not a run directory; --force replaces only run directories")
        self.partial = self.path.with_name(f".{self.path.name}.partial-{os.getpid()}-{secrets.token_hex(3)}")
        self._made = [folder for folder in self.path.parents if not folder.exists()]  # nearest first
        self.partial.mkdir(parents=True)

    def publish(self) -> None:
        """Rename to the final name, replacing an earlier run if that was allowed."""
        if self.path.exists():
            retired = self.partial.with_name(self.partial.name + "-replaced")
            self.path.rename(retired)
            self.partial.rename(self.path)
            shutil.rmtree(retired)
        else:
            self.partial.rename(self.path)

    def discard(self) -> None:
        """Leave nothing behind, not even folders that were made for this run."""
        shutil.rmtree(self.partial, ignore_errors=True)
        for folder in self._made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def default_run_path(command: str = "run") -> Path:
    """outputs/<time>-<command>-<id> below the working folder."""
    return Path("outputs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{command}-{secrets.token_hex(2)}"


def run(
    settings: RunSettings, out: Path | None = None, force: bool = False, monitors: Sequence[Any] = ()
) -> tuple[Solution, dict[str, Any]]:
    """Solve and write a run directory: run.h5, summary.json, scene.toml, power_histogram.csv and .png, history.png.

    returns : the solution and the summary, which has the directory as "run".
    Raises InputError or FileError before anything is computed or overwritten.
    """
    job = prepare(settings)
    directory = RunDirectory(out or default_run_path(), force)
    try:
        solution = solve_job(job, monitors)
        summary = write_run(directory.partial, directory.path, job, solution)
        directory.publish()
    except BaseException:
        directory.discard()
        raise
    return solution, summary


def write_run(folder: Path, path: Path, job: Job, solution: Solution) -> dict[str, Any]:
    """Write every file of a run into `folder`, which will be renamed to `path`; returns the summary."""
    from taichi_bearings.analysis.histogram import power_histogram, write_csv
    from taichi_bearings.files.run_file import read_run_file, write_run_file
    from taichi_bearings.plots.histogram import draw_histogram
    from taichi_bearings.plots.history import draw_history
    from taichi_bearings.plots.style import save

    running = runtime.current() if job.method.needs_taichi else runtime.HOST
    summary = summarise(solution, job.settings.tolerance) | {
        "arch": running.arch,
        "precision": running.precision,
        "threads": running.threads,
        "coefficients": job.settings.coefficients,
        "run": str(path),
    }
    stored = _self_contained(job, folder)
    attributes = summary | {"command": " ".join(["bearings", *sys.argv[1:]]), "scene": stored.to_toml(), **versions()}
    write_run_file(folder / "run.h5", solution, attributes)
    (folder / "scene.toml").write_text(stored.to_toml(), encoding="utf-8")
    histogram = power_histogram(
        solution.power_per_contact, solution.state, solution.slip_threshold, samples=job.scene.replicas
    )
    write_csv(histogram, folder / "power_histogram.csv")
    save(draw_histogram(histogram), folder / "power_histogram.png")
    save(draw_history(read_run_file(folder / "run.h5")), folder / "history.png")
    full = summary | {"settings": asdict(job.settings), "versions": versions()}
    (folder / "summary.json").write_text(json.dumps(full, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return summary


def _self_contained(job: Job, folder: Path) -> RunSettings:
    """Settings whose files lie in the run directory itself, so that it can be moved and run again."""
    settings = job.settings
    if settings.coefficients is not None:
        settings = replace(settings, coefficients="run.h5")
    if settings.initial not in STARTS:
        np.savez(folder / "initial_spin.npz", spin=job.spin[0] if job.scene.replicas == 1 else job.spin)
        settings = replace(settings, initial="initial_spin.npz")
    return settings
