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
from importlib.util import find_spec
from typing import Any

import numpy as np

from taichi_bearings.errors import BearingsError
from taichi_bearings.runs.run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.engine import LocalEngine, Work, run_samples
from taichi_bearings.scans.estimate import units_of
from taichi_bearings.scans.plan import Sample, sample_key
from taichi_bearings.scans.sample import solve_samples
from taichi_bearings.scene import Scene
from taichi_bearings.stages import stage

from .harness import Found, Times, in_turns
from .peers import HOW_TO_INSTALL, ConicProgramme, Peer, conic_programme, find_peers

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
    seeds = range(first, first + number)
    chosen = [RunSettings(shape=shape, seed=seed, tolerance=TOLERANCE, threads=1) for seed in seeds]
    return [Sample(sample_key(settings), settings, {"seed": settings.seed}) for settings in chosen]


@lru_cache(maxsize=1)
def _template(shape: tuple[int, ...]) -> ConicProgramme:
    return conic_programme(Scene.random(shape))


def programme_of(settings: RunSettings) -> ConicProgramme:
    """The conic programme of a sample, with matrices that all of its lattice share."""
    return _template(settings.shape).with_friction(build_scene(settings))


def solve_by_peer(samples: Sequence[Sample], peer: Peer) -> list[dict[str, Any]]:
    """One sample after another."""
    return [_record(one, peer.run(programme_of(one.settings), TOLERANCE, np.inf, threads=1)[-1]) for one in samples]


def solve_by_moreau(samples: Sequence[Sample]) -> list[dict[str, Any]]:
    """All samples of a unit in one batch."""
    programmes = [programme_of(sample.settings) for sample in samples]
    solver = _batched(samples[0].settings.shape, len(samples))
    solver.solve(np.stack([one.linear for one in programmes]), np.stack([one.offset for one in programmes]))
    states = solver.info.status
    return [_record(sample, str(state) == "Solved") for sample, state in zip(samples, states, strict=True)]


@lru_cache(maxsize=2)
def _batched(shape: tuple[int, ...], batch: int) -> Any:
    """A solver of so many programmes at a time that differ in their costs only."""
    import moreau

    programme = _template(shape)
    matrix, quadratic = programme.matrix.tocsr(), programme.quadratic.tocsr()
    tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), TOLERANCE)
    cones = moreau.Cones(
        num_zero_cones=programme.equalities, num_nonneg_cones=programme.inequalities, so_cone_dims=[3] * programme.cones
    )
    ipm = moreau.IPMSettings(direct_solve_method="auto", **tolerances)
    settings = moreau.Settings(solver="ipm", device="cpu", batch_size=batch, time_limit=np.inf, ipm_settings=ipm)
    patterns = (quadratic.indptr, quadratic.indices, matrix.indptr, matrix.indices)
    solver = moreau.CompiledSolver(*reversed(matrix.shape), *patterns, cones, settings)
    solver.setup(quadratic.data, matrix.data)
    return solver


def _record(sample: Sample, solved: bool) -> dict[str, Any]:
    return {"key": sample.key, "scalars": {"status": "certified" if solved else "stalled", "states_proven": False}}


def missing() -> dict[str, str]:
    return {name: HOW_TO_INSTALL for name in ("clarabel", "moreau") if find_spec(name) is None}


def contenders(workers: int, shape: tuple[int, ...]) -> list[Contender]:
    """Ours, Clarabel with its quickest linear solver here, and moreau; the peers as far as they are installed."""
    found, programme = [Contender(OURS, solve_samples, workers)], _template(shape)

    def seconds(peer: Peer) -> float:
        began = time.perf_counter()
        peer.run(programme, TOLERANCE, np.inf, threads=1)
        return time.perf_counter() - began

    here = [peer for peer in find_peers()[0] if peer.name == "clarabel"]
    if quickest := min(here, key=seconds, default=None):
        found.append(Contender(f"{quickest}, no proof", partial(solve_by_peer, peer=quickest), workers, unit=1))
    if "moreau" not in missing():
        found.append(Contender(f"moreau, batches of {BATCH}, no proof", solve_by_moreau, 1, unit=BATCH))
    return found


def measure(shape: tuple[int, ...], number: int, rounds: int, workers: int) -> Found:
    """Rounds in which every contender solves the same `number` samples, one contender after another.

    Raises BearingsError if a sample has no result.
    """
    with ExitStack() as stack:
        known = contenders(workers, shape)
        engines = {one.name: stack.enter_context(closing(LocalEngine(one.work, one.workers))) for one in known}
        for one in known:  # every worker starts, and compiles what it needs
            with stage(f"{one.name}, warming up"):
                list(_solved(one, engines[one.name], one.units(samples_of(shape, 10**6, number))[: one.workers]))

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
        row = {"what": one.name, "shape": shape, "threads": one.workers, "samples": number} | times[one.name].row
        if one.name == OURS:
            yield row | {"proven": float(np.mean([proven for _, proven in found[OURS]]))}
        else:
            yield row | {"ratio": times[one.name].over(times[OURS])}


def _solved(one: Contender, engine: LocalEngine, units: Sequence[tuple[Sample, ...]]) -> Iterator[dict[str, Any]]:
    for records in run_samples(units, engine):
        for record in records:
            if "error" in record["scalars"]:
                raise BearingsError(f"{one.name} has no result for a sample: {record['scalars']['error']}")
            yield record
