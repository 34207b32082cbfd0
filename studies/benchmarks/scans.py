"""Measures samples a second of a scan, by this program (to proven states, in the workers of `bearings scan`) and by
Clarabel.

Clarabel runs in as many processes of the same kind, solves to the same tolerance and proves nothing. Both solve the
same samples, in turns, once all workers have started and compiled. The matrices for Clarabel are built once; only what
differs between samples is built again.
"""

import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from functools import lru_cache, partial
from typing import Any

import numpy as np

from taichi_bearings.errors import BearingsError
from taichi_bearings.runs.lattice_run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.engine import LocalEngine, Work, run_samples
from taichi_bearings.scans.estimate import units_of
from taichi_bearings.scans.plan import Sample, sample_key
from taichi_bearings.scans.sample import solve_samples
from taichi_bearings.scene import Scene
from taichi_bearings.stages import stage

from .harness import Measurements, Times, in_turns
from .peers import ConicProgramme, Peer, conic_programme, find_peers

TOLERANCE = 1e-8  # relative gap asked of both
OURS = "this program, states proven"


def samples_of(shape: tuple[int, ...], first: int, number: int) -> list[Sample]:
    """Return `number` samples of the paper's scene on a lattice, with consecutive seeds from `first` on, as a scan
    plans them.

    shape : numbers of spheres along the axes of the lattice.
    """
    seeds = range(first, first + number)
    chosen = [RunSettings(shape=shape, seed=seed, tolerance=TOLERANCE, threads=1) for seed in seeds]
    return [Sample(sample_key(settings), settings, {"seed": settings.seed}) for settings in chosen]


@lru_cache(maxsize=1)
def _template(shape: tuple[int, ...]) -> ConicProgramme:
    """Return the conic programme of any sample on a lattice with this `shape`; its matrices serve for all samples."""
    return conic_programme(Scene.random(shape))


def solve_by_peer(samples: Sequence[Sample], peer: Peer) -> list[dict[str, Any]]:
    """Solve samples by a conic solver, one after another. Return a record of each, in the form in which workers of
    scans return theirs: its key, its status, and that no contact state is proven.

    samples : samples of a scan, with key and settings.
    peer : the conic solver.
    """
    found = []
    for one in samples:
        programme = _template(one.settings.shape).with_friction(build_scene(one.settings))
        status = "certified" if peer.run(programme, TOLERANCE, np.inf, threads=1)[-1] else "stalled"
        found.append({"key": one.key, "scalars": {"status": status, "states_proven": False}})
    return found


def contenders(shape: tuple[int, ...]) -> dict[str, Work]:
    """Return by name the functions that solve samples of a lattice: ours and, if it is installed, Clarabel with the
    linear solver that is quickest on one of them.

    shape : numbers of spheres along the axes of the lattice.
    """

    def seconds(peer: Peer) -> float:
        """Return the seconds that a conic solver (`peer`) takes for one sample."""
        began = time.perf_counter()
        peer.run(_template(shape), TOLERANCE, np.inf, threads=1)
        return time.perf_counter() - began

    found: dict[str, Work] = {OURS: solve_samples}
    here = [peer for peer in find_peers()[0] if peer.name == "clarabel"]
    if quickest := min(here, key=seconds, default=None):
        found[f"{quickest}, no proof"] = partial(solve_by_peer, peer=quickest)
    return found


def measure(shape: tuple[int, ...], number: int, rounds: int, workers: int) -> Measurements:
    """Yield a row for each program (this one and, if it is installed, Clarabel): the seconds that it takes for a sample
    of a scan, measured in rounds in which each solves the same `number` samples.

    shape : numbers of spheres along the axes of the lattice.
    rounds : how often each solves such a set.
    workers : number of processes.

    Raises BearingsError if a sample has no result.
    """
    known = contenders(shape)
    with ExitStack() as stack:
        engines = {name: stack.enter_context(closing(LocalEngine(work, workers))) for name, work in known.items()}

        def solve(round_number: int, name: str, most: int | None = None) -> tuple[float, float]:
            """Let one program solve the samples of a round, and return the seconds for a sample and the share of
            samples all of whose contact states are proven.

            round_number : number of the round.
            name : name of the program.
            most : solve so many units of work only; None for all.
            """
            samples = samples_of(shape, round_number * number, number)
            units = units_of(samples, workers=workers) if name == OURS else [(one,) for one in samples]
            began = time.perf_counter()
            with stage(name):
                scalars = [of["scalars"] for several in run_samples(units[:most], engines[name]) for of in several]
            if errors := [of["error"] for of in scalars if "error" in of]:
                raise BearingsError(f"{name} could not solve a sample: {errors[0]}")
            return (time.perf_counter() - began) / number, float(np.mean([of["states_proven"] for of in scalars]))

        for name in known:  # every worker starts, and compiles what it needs
            solve(rounds, name, workers)
        found = in_turns({name: partial(solve, name=name) for name in known}, rounds)
    times = {name: Times(np.array([seconds for seconds, _ in of])) for name, of in found.items()}
    for name, of in times.items():
        row = {"what": name, "shape": shape, "threads": workers, "samples": number} | of.row
        proven = float(np.mean([share for _, share in found[name]]))
        yield row | ({"proven": proven} if name == OURS else {"ratio": of.over(times[OURS])})
