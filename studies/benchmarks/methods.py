"""One sample by every method, to a proven gap or as far as the time allows; beside it the conic solvers, in turns.

A method's time is that of its solve, with the set-up of the scene and without compilation; of a conic solver that of
setting up and solving. Of methods that factorise, the operations are those of the factorisations alone.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.conic.contact_system import lattice_system
from taichi_bearings.errors import InputError
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.memory import free_bytes
from taichi_bearings.numerics.cholesky import dissect, tuning
from taichi_bearings.numerics.cholesky.fronts import analyse
from taichi_bearings.proof.certificate import relative_gap
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS, InteriorPoint, MethodOptions
from taichi_bearings.solvers.drive import solve, uninterrupted
from taichi_bearings.solvers.stopping import StopRule

from . import counts
from .conic import ConicProgramme, conic_programme
from .peers import Peer, find_peers
from .timing import Row, Times, in_turns

TOLERANCE = 1e-8
BRIEF = 3.0  # seconds of a solve from which it is not made again and again
MOST_OF_PEERS = 20_000  # spheres up to which conic solvers are asked: beyond they take minutes and gigabytes
NO_STATES = "interior-point, no states"
SPARE, NOTICED = 0.7, 2e7  # share of the free memory that may be taken; bytes that are told from what comes and goes
STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


@dataclass(frozen=True)
class Task:
    """What one process measures. seconds : limit for each solve."""

    shapes: tuple[tuple[int, ...], ...]
    laws: tuple[str, ...]
    threads: int
    rounds: int
    seconds: float
    peers: bool = True


@dataclass(frozen=True)
class Solve:
    """How a solve ended. bytes : of memory more than before, at most; None where the system does not tell."""

    seconds: float
    processor: float
    iterations: int
    gap: float
    status: str
    compiling: float | None = None
    bytes: float | None = None


def measure(task: Task) -> Iterator[Row | str]:
    """The rows of a task, in the process that calls it; a text for what is left out."""
    runtime.start("cpu", "f64", task.threads)
    for law in task.laws:
        for shape in task.shapes:
            scene = Scene.random(shape, law=law)
            calls: dict[str, Callable[[], Solve]] = {}
            for name, options in all_methods().items():
                needed = options.bytes(prod(shape))
                if needed > SPARE * free_bytes():
                    yield f"{name} at {'x'.join(map(str, shape))} is left out: it needs {needed / 1e9:.1f} GB"
                elif not options.refusal(scene):
                    calls[name] = partial(_by_method, scene, options, task.seconds)
            if task.peers and scene.lattice.sites <= MOST_OF_PEERS:
                calls |= _peers(scene, task)
            yield from _in_turns(calls, scene, task)


def all_methods() -> dict[str, MethodOptions]:
    """Every method with its defaults, and the interior-point method without its proof of the contact states."""
    return {name: row() for name, row in METHODS.items()} | {NO_STATES: InteriorPoint(settle=False)}


def _peers(scene: Scene, task: Task) -> dict[str, Callable[[], Solve]]:
    programme = conic_programme(scene)
    return {
        f"{peer.name} ({peer.linear_solver})": partial(_by_peer, peer, programme, task.seconds, task.threads)
        for peer in find_peers()[0]
    }


def _in_turns(calls: dict[str, Callable[[], Solve]], scene: Scene, task: Task) -> Iterator[Row]:
    """Every call once, then those that are brief again in as many rounds as are wanted."""
    attempts = {name: partial(_attempt, call) for name, call in calls.items()}
    found = in_turns(attempts, task.rounds, lambda first: first is not None and first.seconds < BRIEF)
    for name, solves in found.items():
        if known := [one for one in solves if one is not None]:
            yield _row(name, known, scene, task)


def _attempt(call: Callable[[], Solve], _: int) -> Solve | None:
    """None where the method cannot solve the scene."""
    try:
        return call()
    except InputError:
        return None


def _row(name: str, solves: list[Solve], scene: Scene, task: Task) -> Row:
    times = Times.of([(one.seconds, one.processor) for one in solves])
    first, is_ours, grown = solves[0], name in all_methods(), max(one.bytes or 0.0 for one in solves)
    return Row(
        part="methods",
        what=name,
        shape=scene.lattice.shape,
        components=len(scene.minimum_spin_axes),
        threads=task.threads,
        seconds_compile=first.compiling,
        contact_updates=scene.lattice.contacts * first.iterations / times.seconds if is_ours else None,
        bytes_per_sphere=grown / scene.lattice.sites if grown > NOTICED else None,
        iterations=first.iterations,
        gap=first.gap,
        status=first.status,
        law=scene.law.name,
        **times.columns,
        **(_counted(name, scene, first.iterations) if is_ours else {}),
    )


def _counted(name: str, scene: Scene, iterations: int) -> dict[str, Any]:
    """Bytes and operations of a whole solve, where they are known: those of its sweeps, or of its factorisations."""
    if not scene.law.holds or scene.law.flows:
        return {}
    stencil, sites = Stencil(scene.minimum_spin_axes, scene.lattice.dimension, 1), scene.lattice.sites
    if name in ("interior-point", NO_STATES):
        operations, entries = factorisation(scene)
        return {"operations": iterations * operations, "bytes": 8 * iterations * entries}
    work = {
        "gradient-descent": lambda: counts.descent_sweep(stencil, momentum=True),
        "cundall-strack": lambda: counts.cundall_strack_step(stencil),
        "operator-splitting": lambda: counts.splitting_iteration(stencil, scene.lattice.shape, 0.5),
    }.get(name)
    if work is None:
        return {}
    one = work()
    return {
        "operations": iterations * sites * one.operations,
        "roots": iterations * sites * one.roots,
        "bytes": iterations * sites * one.bytes(8),
        "passes": one.passes,
    }


def factorisation(scene: Scene) -> tuple[float, int]:
    """Operations of one factorisation of the Newton matrix on the central path, and numbers of its factor."""
    axes = scene.minimum_spin_axes
    system = lattice_system(scene.lattice, axes, scene.top_spin(axes) / (scene.jump or 1.0))
    small = scene.lattice.sites < InteriorPoint.alike_in_a_block
    price = tuning.LAUNCH_PRICE if small else tuning.CALLS_PRICE
    pattern = analyse(dissect(scene.lattice, axes), *system.couplings(), price)
    return pattern.operations, pattern.factor_entries


def _by_method(scene: Scene, options: MethodOptions, seconds: float) -> Solve:
    """Raises InputError for a scene that the method cannot solve."""
    spin, before = initial_spin(scene, "linear"), _resident()
    first = uninterrupted(solve(scene, options.build(), spin, StopRule(TOLERANCE, iterations=1)))
    began, at = time.perf_counter(), time.process_time()
    found = uninterrupted(solve(scene, options.build(), spin, StopRule(TOLERANCE, seconds=seconds)))
    wall, processor = time.perf_counter() - began, time.process_time() - at
    return Solve(
        seconds=wall,
        processor=processor,
        iterations=found.iterations,
        gap=float(relative_gap(scene, found.objective, found.lower_bound).max()),
        status=found.status.value,
        compiling=max(first.seconds_compile - found.seconds_compile, 0.0),
        bytes=None if before is None else max(_peak() - before, 0.0),
    )


def _by_peer(peer: Peer, programme: ConicProgramme, seconds: float, threads: int) -> Solve:
    before, at = _resident(), time.process_time()
    found = peer.solve(programme, TOLERANCE, seconds, threads)
    processor = time.process_time() - at
    grown = None if before is None else max(_peak() - before, 0.0)
    power, bound = np.array([found.power]), np.array([found.lower_bound])
    gap = float(relative_gap(programme.scene, power, bound)[0])
    return Solve(found.seconds, processor, found.iterations, gap, found.status, bytes=grown)


def _resident() -> float | None:
    """Bytes of memory now; the peak counts from here. None where the system does not tell."""
    try:
        CLEAR.write_text("5")
        return _told("VmRSS")
    except OSError:
        return None


def _peak() -> float:
    return _told("VmHWM")


def _told(name: str) -> float:
    lines = STATUS.read_text().splitlines()
    return 1024.0 * next(int(line.split()[1]) for line in lines if line.startswith(name))
