"""How fast sweeps, time steps and splitting iterations are: beside the best NumPy and plain C for the same sweep, and
beside what the machine's memory and arithmetic allow for their bytes and operations."""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.fields import Fields, make_layout
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.memory import free_bytes
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack, GradientDescent, OperatorSplitting
from taichi_bearings.solvers.gradient_descent import GradientDescentMethod
from taichi_bearings.solvers.method import Method

from . import counts
from .baselines import Arrays, CSweep, NumpySweep
from .machine import chains, sizes_below, streams
from .timing import Row, Times, timed

SIZES = {"f64": 8, "f32": 4}  # bytes of a number
PLAIN, NUMPY, C = "sweep", "NumPy sweep", "C sweep"
BYTES = {2: 800.0, 3: 1800.0}  # a sphere at most while all candidates of a lattice are there, by its dimension
SPARE = 0.8  # share of the free memory that a lattice may take
FOREVER = 2**40  # sweeps


@dataclass(frozen=True)
class Task:
    """What one process measures. folder : for what it compiles."""

    shapes: tuple[tuple[int, ...], ...]
    precision: str
    threads: int
    rounds: int
    slice_seconds: float
    largest_stream: float


@dataclass(frozen=True)
class Candidate:
    """Something that is timed. call : repeats it. work : a site, counted. held : bytes that it goes through.

    kept : bytes of all its fields.
    """

    name: str
    call: Callable[[int], None]
    components: int
    work: counts.Work | None = None
    held: float = 0.0
    kept: float = 0.0
    seconds_compile: float | None = None


def measure(task: Task) -> Iterator[Row | str]:
    """The rows of a task, in the process that calls it; a text for a lattice that is left out."""
    runtime.start("cpu", task.precision, task.threads)
    yield from _bandwidths(task)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        for shape in task.shapes:
            needed, room = BYTES[len(shape)] * prod(shape), SPARE * free_bytes()
            if needed > room:
                name = "x".join(map(str, shape))
                yield f"{name} is left out: it needs {needed / 1e9:.1f} GB, {room / 1e9:.1f} GB may be taken"
                continue
            yield from _of_shape(task, shape, Path(folder))


def _bandwidths(task: Task) -> Iterator[Row]:
    known = streams(sizes_below(task.largest_stream), task.threads)
    found = timed({str(n): stream.repeat for n, stream in enumerate(known)}, task.rounds, task.slice_seconds)
    for stream, times in zip(known, found.values(), strict=True):
        speed = stream.bytes / times.seconds
        kept: dict[str, Any] = {"precision": task.precision, "threads": task.threads, "bytes": stream.bytes}
        yield Row(part="memory", what="stream", working_set=stream.bytes, bandwidth=speed, **kept, **times.columns)


def _of_shape(task: Task, shape: tuple[int, ...], folder: Path) -> Iterator[Row]:
    """All candidates of a lattice in the same rounds."""
    scene = Scene.random(shape)
    candidates = list(_candidates(scene, task, folder))
    counted = [n for n, one in enumerate(candidates) if one.held]
    alike = dict(zip(counted, streams([candidates[n].held for n in counted], task.threads), strict=True))
    limits = chains(task.threads)
    calls = {str(n): one.call for n, one in enumerate(candidates)}
    calls |= {f"stream {n}": stream.repeat for n, stream in alike.items()}
    calls |= {name: limit.repeat for name, limit in limits.items()}
    found = timed(calls, task.rounds, task.slice_seconds)
    rates = {name: limit.number / found[name].each for name, limit in limits.items()}
    plain = next(str(n) for n, one in enumerate(candidates) if one.name == PLAIN)
    for n, one in enumerate(candidates):
        row = _row(one, scene, task, found[str(n)])
        if n in alike:
            delivered = alike[n].bytes / found[f"stream {n}"].each
            row = _beside_the_machine(row, found[str(n)].each, {"bandwidth": delivered, **rates})
        if one.name in (NUMPY, C):
            row = replace(row, ratio=float(np.median(found[str(n)].each / found[plain].each)))
        yield row


def _row(one: Candidate, scene: Scene, task: Task, times: Times) -> Row:
    sites, size = scene.lattice.sites, SIZES[task.precision]
    counted: dict[str, Any] = {}
    if one.work is not None:
        moved = sites * one.work.bytes(size)
        counted = {
            "bytes": moved,
            "operations": sites * one.work.operations,
            "roots": sites * one.work.roots,
            "passes": one.work.passes,
            "bandwidth": moved / times.seconds,
            "working_set": one.held,
            "bytes_per_sphere": one.kept / sites,
        }
    return Row(
        part="kernels",
        what=one.name,
        shape=scene.lattice.shape,
        components=one.components,
        precision=task.precision,
        threads=1 if one.name in (NUMPY, C) else task.threads,
        seconds_compile=one.seconds_compile,
        contact_updates=scene.lattice.contacts / times.seconds,
        **counted,
        **times.columns,
    )


def _beside_the_machine(row: Row, seconds: np.ndarray, rates: dict[str, np.ndarray]) -> Row:
    """The row with the share of the speed that the machine allows; seconds, rates : (rounds,)."""
    work = {"bandwidth": row.bytes, "operations": row.operations, "roots": row.roots}
    shares = {name: float(np.median((work[name] or 0.0) / rate / seconds)) for name, rate in rates.items()}
    limit = max(shares, key=lambda name: shares[name])
    here: dict[str, Any] = {f"{name}_here": float(np.median(rate)) for name, rate in rates.items()}
    return replace(row, roof=shares[limit], limit="memory" if limit == "bandwidth" else limit, **here)


def _candidates(scene: Scene, task: Task, folder: Path) -> Iterator[Candidate]:
    """All with their kernels compiled."""
    plain = GradientDescentMethod(GradientDescent(momentum=False))
    yield _candidate(PLAIN, plain, scene, "random", lambda s: counts.descent_sweep(s, momentum=False))
    plain.epoch_length = FOREVER  # stay in the part of the epoch that does not average
    fast, steps, splitting = GradientDescent().build(), CundallStrack(), OperatorSplitting().build()
    yield _candidate("sweep with momentum", fast, scene, "random", lambda s: counts.descent_sweep(s, momentum=True))
    for start in ("linear", "random")[: scene.lattice.dimension - 1]:  # in 3D random spins have all components
        yield _candidate("Cundall-Strack step", steps.build(), scene, start, counts.cundall_strack_step)
    shape, modes = scene.lattice.shape, 4 / SIZES[task.precision]
    work = partial(counts.splitting_iteration, shape=shape, modes=modes)
    yield _candidate("splitting iteration", splitting, scene, "linear", work, modes)
    components = len(scene.minimum_spin_axes)
    yield Candidate(NUMPY, NumpySweep(Arrays(scene, task.precision)).repeat, components)
    with suppress(OSError):  # no compiler here; the report says so
        yield Candidate(C, CSweep(Arrays(scene, task.precision), folder).repeat, components)


def _candidate(
    name: str, method: Any, scene: Scene, start: str, count: Callable[[Stencil], counts.Work], modes: float = 0.0
) -> Candidate:
    """modes : numbers a component and site that a method keeps beside its fields, in numbers of these."""
    seconds = seconds_to_compile(method, scene, initial_spin(scene, start))
    fields, components = method.fields, method.stencil.components
    row = fields.layout.length * fields.dtype.itemsize
    unused = sum(fields.components.get(sums, 0) for sums in ("spin_sum", "force_sum"))  # but while averaging
    held = row * (fields.rows - unused + modes * components)
    return Candidate(name, method.advance, components, count(method.stencil), held, row * fields.rows, seconds)


def seconds_to_compile(method: Method, scene: Scene, spin: np.ndarray) -> float:
    """Begin, and tell how much longer that took than beginning again: the time to compile, or to load from a cache."""
    took = []
    for _ in range(2):
        began = time.perf_counter()
        spec = method.plan(scene, spin)
        method.begin(scene, spin, Fields(make_layout(1, scene.lattice.shape), spec))
        took.append(time.perf_counter() - began)
    return max(took[0] - took[1], 0.0)
