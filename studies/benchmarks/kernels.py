"""How fast sweeps, time steps and splitting iterations are: beside the best NumPy and plain C for the same sweep, and
beside what memory and caches deliver for their bytes."""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from math import prod
from pathlib import Path
from typing import Any

from taichi_bearings import runtime
from taichi_bearings.fields import Fields, make_layout
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.memory import free_bytes
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack, GradientDescent, OperatorSplitting
from taichi_bearings.solvers.gradient_descent import GradientDescentMethod

from . import counts
from .baselines import Arrays, CSweep, NumpySweep
from .harness import Found, Plan, Row, Times, timed
from .probe import Stream, streams

SIZES = {"f64": 8, "f32": 4}  # bytes of a number
PLAIN, NUMPY, C = "sweep", "NumPy sweep", "C sweep"
BYTES = {2: 800.0, 3: 1800.0}  # a sphere at most while all candidates of a lattice are there, by its dimension
SPARE = 0.8  # share of the free memory that a lattice may take
FOREVER = 2**40  # sweeps


@dataclass(frozen=True)
class Candidate:
    """Something that is timed. call : repeats it. bytes : that one moves, and `held` those that it goes through, `kept`
    those of all its fields; 0 where nobody counts."""

    name: str
    call: Callable[[int], None]
    components: int
    bytes: float = 0.0
    held: float = 0.0
    kept: float = 0.0
    seconds_compile: float | None = None


def measure(plan: Plan, precision: str, threads: int) -> Found:
    """The rows of all lattices, in the process that calls it; a text for a lattice that is left out."""
    runtime.start("cpu", precision, threads)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        for shape in plan.shapes:
            needed, room = BYTES[len(shape)] * prod(shape), SPARE * free_bytes()
            if needed > room:
                name = "x".join(map(str, shape))
                yield f"{name} is left out: it needs {needed / 1e9:.1f} GB, {room / 1e9:.1f} GB may be taken"
                continue
            yield from _of_shape(plan, Scene.random(shape), precision, threads, Path(folder))


def _of_shape(plan: Plan, scene: Scene, precision: str, threads: int, folder: Path) -> Iterator[Row]:
    """All candidates of a lattice in the same rounds, each with a stream that goes through as many bytes."""
    candidates = list(_candidates(scene, precision, folder))
    counted = [n for n, one in enumerate(candidates) if one.held]
    alike = dict(zip(counted, streams([candidates[n].held for n in counted], threads), strict=True))
    calls = {str(n): one.call for n, one in enumerate(candidates)}
    found = timed(calls | {f"stream {n}": of.repeat for n, of in alike.items()}, plan.rounds, plan.slice_seconds)
    plain = next(found[str(n)] for n, one in enumerate(candidates) if one.name == PLAIN)
    for n, one in enumerate(candidates):
        times, others = found[str(n)], one.name in (NUMPY, C)
        row: Row = {
            "what": one.name, "shape": scene.lattice.shape, "components": one.components, "precision": precision,
            "threads": 1 if others else threads, **times.row, "contact_updates": scene.lattice.contacts / times.seconds,
        }  # fmt: skip
        if n in alike:
            row |= _beside_the_memory(one, times, alike[n], found[f"stream {n}"], scene.lattice.sites)
        yield row | ({"ratio": times.over(plain)} if others else {})


def _beside_the_memory(one: Candidate, times: Times, stream: Stream, delivered: Times, sites: int) -> Row:
    """share : of the bandwidth of as large a working set, in the same rounds."""
    here = stream.bytes / delivered.seconds
    return {
        "bytes": one.bytes, "working_set": one.held, "bandwidth": one.bytes / times.seconds, "bandwidth_here": here,
        "share": delivered.over(times) * one.bytes / stream.bytes, "bytes_per_sphere": one.kept / sites,
        "seconds_compile": one.seconds_compile,
    }  # fmt: skip


def _candidates(scene: Scene, precision: str, folder: Path) -> Iterator[Candidate]:
    """All with their kernels compiled."""
    plain = GradientDescentMethod(GradientDescent(momentum=False))
    yield _candidate(PLAIN, plain, scene, "random", partial(counts.descent_sweep, momentum=False))
    plain.epoch_length = FOREVER  # stay in the part of the epoch that does not average
    fast, steps, splitting = GradientDescent().build(), CundallStrack(), OperatorSplitting().build()
    yield _candidate("sweep with momentum", fast, scene, "random", partial(counts.descent_sweep, momentum=True))
    for start in ("linear", "random")[: scene.lattice.dimension - 1]:  # in 3D random spins have all components
        yield _candidate("Cundall-Strack step", steps.build(), scene, start, counts.cundall_strack_step)
    modes = 4 / SIZES[precision]
    traffic = partial(counts.splitting_iteration, modes=modes)
    yield _candidate("splitting iteration", splitting, scene, "linear", traffic, modes)
    components = len(scene.minimum_spin_axes)
    yield Candidate(NUMPY, NumpySweep(Arrays(scene, precision)).repeat, components)
    with suppress(OSError):  # no compiler here; the report says so
        yield Candidate(C, CSweep(Arrays(scene, precision), folder).repeat, components)


def _candidate(
    name: str, method: Any, scene: Scene, start: str, traffic: Callable[[Stencil], counts.Traffic], modes: float = 0.0
) -> Candidate:
    """With the seconds that beginning took longer than beginning again: to compile, or to load from a cache.

    modes : numbers a component and site that a method keeps beside its fields, in numbers of these.
    """
    spin, took = initial_spin(scene, start), []
    for _ in range(2):
        began = time.perf_counter()
        method.begin(scene, spin, Fields(make_layout(1, scene.lattice.shape), method.plan(scene, spin)))
        took.append(time.perf_counter() - began)
    fields, components = method.fields, method.stencil.components
    row = fields.layout.length * fields.dtype.itemsize
    unused = sum(fields.components.get(sums, 0) for sums in ("spin_sum", "force_sum"))  # but while averaging
    moved, held = scene.lattice.sites * traffic(method.stencil).bytes(fields.dtype.itemsize), fields.rows - unused
    compiling = max(took[0] - took[1], 0.0)
    return Candidate(
        name, method.advance, components, moved, row * (held + modes * components), row * fields.rows, compiling
    )
