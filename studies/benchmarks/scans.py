"""Samples a second of a scan: ours to proven states, in the workers of `bearings scan`; beside it Clarabel in as many
processes of the same kind and moreau in batches, which solve to the same tolerance and prove nothing.

All take the same samples, in turns; the workers are warm. For the others only what differs between samples is made
anew: their matrices are kept.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from taichi_bearings.errors import BearingsError
from taichi_bearings.runs.run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.engine import LocalEngine, Work, run_samples
from taichi_bearings.scans.estimate import units_of
from taichi_bearings.scans.plan import Sample, sample_key
from taichi_bearings.scans.sample import failure, solve_samples
from taichi_bearings.scene import Scene
from taichi_bearings.stages import stage

from .conic import ConicProgramme, conic_programme, with_coefficients
from .peers import Peer, find_peers, moreau_solver
from .timing import Row, Times, in_turns

TOLERANCE = 1e-8
BATCH = 24  # samples that moreau is given at a time
OURS = "this program, states proven"


@dataclass(frozen=True)
class Contender:
    """Who solves samples. work : of a unit of at most `unit` samples, 0 for as many as a scan takes, in `workers`."""

    name: str
    work: Work
    workers: int
    unit: int = 0

    def units(self, samples: Sequence[Sample]) -> list[tuple[Sample, ...]]:
        if not self.unit:
            return units_of(samples, workers=self.workers)
        size = min(self.unit, -(-len(samples) // self.workers))
        return [tuple(samples[first : first + size]) for first in range(0, len(samples), size)]


def samples_of(shape: tuple[int, ...], first: int, number: int) -> list[Sample]:
    """Samples of the paper's scene with seeds from `first` on, as a scan plans them."""
    chosen = [
        RunSettings(shape=shape, seed=seed, tolerance=TOLERANCE, threads=1) for seed in range(first, first + number)
    ]
    return [Sample(sample_key(settings), settings, {"seed": settings.seed}) for settings in chosen]


@lru_cache(maxsize=1)
def _template(shape: tuple[int, ...]) -> ConicProgramme:
    return conic_programme(Scene.random(shape))


def programme_of(settings: RunSettings) -> ConicProgramme:
    """The conic programme of a sample, with matrices that all of its lattice share."""
    return with_coefficients(_template(settings.shape), build_scene(settings))


def solve_by_peer(samples: Sequence[Sample], peer: Peer) -> list[dict[str, Any]]:
    """One sample after another."""
    return [
        _record(sample, peer.run(programme_of(sample.settings), TOLERANCE, np.inf, threads=1)[-1]) for sample in samples
    ]


@lru_cache(maxsize=2)
def _batched(shape: tuple[int, ...], batch: int) -> Any:
    return moreau_solver(_template(shape), batch, tolerance=TOLERANCE)


def solve_by_moreau(samples: Sequence[Sample]) -> list[dict[str, Any]]:
    """All samples of a unit in one batch."""
    programmes = [programme_of(sample.settings) for sample in samples]
    solver = _batched(samples[0].settings.shape, len(samples))
    solver.solve(np.stack([one.linear for one in programmes]), np.stack([one.offset for one in programmes]))
    states = solver.info.status
    return [_record(sample, str(state) == "Solved") for sample, state in zip(samples, states, strict=True)]


def _record(sample: Sample, solved: bool) -> dict[str, Any]:
    return {"key": sample.key, "scalars": {"status": "certified" if solved else "stalled", "states_proven": False}}


def contenders(workers: int, shape: tuple[int, ...]) -> list[Contender]:
    """Ours, Clarabel with its quickest linear solver here, and moreau; the peers as far as they are installed."""
    found = [Contender(OURS, solve_samples, workers)]
    here, _ = find_peers()
    if peer := quickest([one for one in here if one.name == "clarabel"], shape):
        work = partial(solve_by_peer, peer=peer)
        found.append(Contender(f"Clarabel ({peer.linear_solver}), no proof", work, workers, unit=1))
    if any(peer.name == "moreau" for peer in here):
        found.append(Contender(f"moreau, batches of {BATCH}, no proof", solve_by_moreau, 1, unit=BATCH))
    return found


def quickest(peers: Sequence[Peer], shape: tuple[int, ...]) -> Peer | None:
    """The one that solves a sample of this lattice first, on one thread."""
    programme = conic_programme(Scene.random(shape))

    def seconds(peer: Peer) -> float:
        began = time.perf_counter()
        peer.run(programme, TOLERANCE, np.inf, threads=1)
        return time.perf_counter() - began

    return min(peers, key=seconds, default=None)


def measure(shape: tuple[int, ...], number: int, rounds: int, workers: int) -> Iterator[Row]:
    """Rounds in which every contender solves the same `number` samples, one contender after another.

    Raises BearingsError if a sample has no result.
    """
    with ExitStack() as stack:
        known = contenders(workers, shape)
        engines = {one.name: stack.enter_context(closing(LocalEngine(one.work, one.workers))) for one in known}
        for one in known:  # every worker starts, and compiles what it needs
            some = one.units(samples_of(shape, 10**6, number))[: one.workers]
            with stage(f"{one.name}, warming up"):
                list(_solved(one, engines[one.name], some))

        def solve(turn: int, one: Contender) -> tuple[float, float]:
            """Seconds a sample, and share of the samples with all states proven."""
            units, began = one.units(samples_of(shape, turn * number, number)), time.perf_counter()
            with stage(one.name):
                records = list(_solved(one, engines[one.name], units))
            proven = float(np.mean([record["scalars"]["states_proven"] for record in records]))
            return (time.perf_counter() - began) / number, proven

        found = in_turns({one.name: partial(solve, one=one) for one in known}, rounds)
    times = {name: Times(np.array([seconds for seconds, _ in of])) for name, of in found.items()}
    for one in known:
        is_ours = one.name == OURS
        own: dict[str, Any] = {
            "proven": float(np.mean([proven for _, proven in found[one.name]])) if is_ours else None,
            "ratio": None if is_ours else float(np.median(times[one.name].each / times[OURS].each)),
        }
        columns = own | times[one.name].columns
        yield Row(part="scans", what=one.name, shape=shape, threads=one.workers, samples=rounds * number, **columns)


def _solved(one: Contender, engine: LocalEngine, units: Sequence[tuple[Sample, ...]]) -> Iterator[dict[str, Any]]:
    for records in run_samples(units, engine, lambda *_: None, failure):
        for record in records:
            if "error" in record["scalars"]:
                raise BearingsError(f"{one.name} has no result for a sample: {record['scalars']['error']}")
            yield record
