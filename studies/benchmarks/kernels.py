"""Measures how fast sweeps, time steps and splitting iterations are; sweeps also in the best NumPy and in plain C."""

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings import runtime
from taichi_bearings.memory import free_bytes
from taichi_bearings.plots.curves import Curve, Look, draw_scan
from taichi_bearings.plots.page import JOURNAL_WIDTHS, Page
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack, GradientDescent, OperatorSplitting
from taichi_bearings.solvers.gradient_descent import GradientDescentMethod
from taichi_bearings.words import counted

from .baselines import Arrays, CSweep, NumpySweep
from .harness import Measurements, Plan, Row, timed

NUMPY, C = "NumPy sweep", "C sweep"
BYTES = {2: 800.0, 3: 1800.0}  # most memory a sphere, with all candidates of a lattice, by its dimension
SPARE = 0.8  # share of the free memory that a lattice may take
FOREVER = 2**40  # number of sweeps that no measurement reaches


class Candidate(NamedTuple):
    """Something that is timed.

    name : name in the table.
    call : function that repeats it as often as its argument says.
    components : number of spin components that it computes.
    seconds_compile : seconds that its first start took to compile; None if nothing is compiled.
    """

    name: str
    call: Callable[[int], None]
    components: int
    seconds_compile: float | None = None


def measure(plan: Plan, precision: str, threads: int) -> Measurements:
    """Yield a row for each kernel and lattice, measured in this process, and a sentence for each lattice that does not
    fit into memory.

    plan : the shapes of the lattices, and how long to measure.
    precision : "f64" or "f32", the type of all numbers.
    threads : number of threads of the kernels.
    """
    runtime.start("cpu", precision, threads)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        for shape in plan.shapes:
            needed, most = BYTES[len(shape)] * prod(shape), SPARE * free_bytes()
            if needed > most:
                name = "x".join(map(str, shape))
                yield f"{name} is left out: it needs {needed / 1e9:.1f} GB, and {most / 1e9:.1f} GB may be used"
                continue
            yield from _of_shape(plan, Scene.random(shape), precision, threads, Path(folder))


def _of_shape(plan: Plan, scene: Scene, precision: str, threads: int, folder: Path) -> Iterator[Row]:
    """Yield a row for each kernel on one lattice, all timed in the same rounds. The sweeps in NumPy and C have a column
    with their time over that of our plain sweep.

    plan : number of rounds and length of a timed call.
    scene : one sample of the lattice.
    precision : "f64" or "f32", the type of all numbers.
    threads : number of threads of the kernels.
    folder : folder for files that the C compiler writes.
    """
    candidates = list(_candidates(scene, precision, folder))
    found = timed({str(n): one.call for n, one in enumerate(candidates)}, plan.rounds, plan.slice_seconds)
    plain = found["0"].alone(threads)
    for one, times in zip(candidates, found.values(), strict=True):
        is_ours = one.name not in (NUMPY, C)
        used = threads if is_ours else 1
        alone = times.alone(used)
        yield {
            "what": one.name, "shape": scene.lattice.shape, "components": one.components, "precision": precision,
            "threads": used, **times.row, "contact_updates": scene.lattice.contacts / alone.seconds,
            **({"seconds_compile": one.seconds_compile} if is_ours else {"ratio": alone.over(plain)}),
        }  # fmt: skip


def _candidates(scene: Scene, precision: str, folder: Path) -> Iterator[Candidate]:
    """Yield all that is timed on a lattice, compiled and ready, the plain sweep first.

    scene : one sample of the lattice.
    precision : "f64" or "f32", the type of all numbers.
    folder : folder for files that the C compiler writes.
    """
    plain = GradientDescentMethod(GradientDescent(momentum=False))
    yield _candidate("sweep", plain, scene, "random")
    plain.epoch_length = FOREVER  # no sweep reaches the part of an epoch in which the method averages spins
    yield _candidate("sweep with momentum", GradientDescent().build(), scene, "random")
    for start in ("linear", "random")[: scene.lattice.dimension - 1]:  # in 3D random spins have all components
        yield _candidate("Cundall-Strack step", CundallStrack().build(), scene, start)
    yield _candidate("splitting iteration", OperatorSplitting().build(), scene, "linear")
    components = len(scene.minimum_spin_axes)
    yield Candidate(NUMPY, NumpySweep(Arrays(scene, precision)).repeat, components)
    with suppress(OSError):  # no compiler here; the report says so
        yield Candidate(C, CSweep(Arrays(scene, precision), folder).repeat, components)


def _candidate(name: str, method: Any, scene: Scene, start: str) -> Candidate:
    """Return a method, begun and ready to be timed. Its `seconds_compile` is the time by which its first start took
    longer than its second: to compile, or to load compiled code.

    name : name in the table.
    method : the method, not yet begun.
    scene : one sample of a lattice, on which the method is begun.
    start : name of the initial spins.
    """
    spin, took = initial_spin(scene, start), []
    for _ in range(2):
        began = time.perf_counter()
        method.begin(scene, spin)
        took.append(time.perf_counter() - began)
    return Candidate(name, method.advance, len(method.spin_axes), max(took[0] - took[1], 0.0))


def draw_throughput(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw contacts a second against the number of spheres: a curve for each kernel, kind of body (discs or spheres)
    and number of spin components.

    rows : one dictionary for each measurement. Only those of the precision of the first row and with the fewest threads
        are drawn.
    """
    precision, threads = rows[0]["precision"], min(row["threads"] for row in rows)
    points: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        if (row["precision"], row["threads"]) == (precision, threads):
            bodies = "discs" if len(row["shape"]) == 2 else "spheres"
            label = f"{row['what']}, {bodies}, {counted(row['components'], 'component')}"
            points.setdefault(label, []).append((prod(row["shape"]), row["contact_updates"] / 1e6))
    curves = []
    for label, of in points.items():
        x, y = np.array(sorted(of)).T
        curves.append(Curve(label, x, y, y, y))
    title = f"{precision}, {counted(threads, 'thread')}; medians"
    return draw_scan(
        curves, Look("discs or spheres", "contacts per second (10⁶)", title, log="xy"), Page(JOURNAL_WIDTHS["double"])
    )
