"""What all minima of a small sample have in common, in 140 digits: on from the middle of them, where the path of
`taichi_bearings_studies.stress.truth` ends.

The slips of all minima point the same way, so the minima are a polyhedron; if it is more than a point, a linear
programme for each contact tells whether it slips at all of them, in doubles: in units of the slips in the middle it is
round.
"""

from dataclasses import dataclass, replace
from decimal import Decimal, localcontext

import numpy as np
from scipy.optimize import linprog
from taichi_bearings_studies.stress import truth as truths
from taichi_bearings_studies.stress.truth import SLIPLESS, SLIPPING, UNCLEAR, Sample, Truth

from taichi_bearings.scene import Scene

EITHER, DRIVEN = 3, 4  # states beside those of a truth
RANK = 1e-25  # pivots below count as zero: directions are known to 1e-35 or better
NEVER = 1e-7  # share of its slip in the middle down to which a contact must be able to go for EITHER
MOVED = 1e-12  # change of a slip over that in the middle below which it is the same at all minima


@dataclass(frozen=True)
class Minima(Truth):
    """state : SLIPPING at every minimum, or EITHER, and DRIVEN where both ends are. slip, length/time : that in their
    middle. margin : the share of the friction that the forces in their middle leave. freedom : dimension of the minima.
    """

    slip: tuple[np.ndarray, ...] = ()
    margin: tuple[np.ndarray, ...] = ()
    freedom: int = 0


def least_of_all(scene: Scene, perturbed: tuple[int, Decimal] | None = None) -> Minima:
    """The truth of a small sample with friction alone, and what every minimum has in common.

    perturbed : seed and size; friction is multiplied by 1 + size * u, |u| < 1.
    """
    with localcontext() as context:
        context.prec = truths.DIGITS
        if not truths.jump_of(scene):
            return Minima(**vars(truths.least(scene)))
        sample = Sample(scene)
        if perturbed:
            rng = np.random.default_rng(perturbed[0])
            factors = [1 + perturbed[1] * Decimal(rng.uniform(-1, 1)) for _ in sample.a]
            sample.a = sample.a * np.array(factors, dtype=object)[:, None]
        truth, barrier = truths.followed(scene, sample)
        if not truth.lower:
            return Minima(**vars(truth))
        return _in_common(Minima(**vars(truth)), scene, sample, barrier)


def _in_common(truth: Minima, scene: Scene, sample: Sample, barrier: Decimal) -> Minima:
    slips, length, _, stiffness = sample.forces(barrier)
    length, room = length[:, 0], 1 - (stiffness * length / sample.a)[:, 0]
    moves = length > truths.CLEAR
    size = np.array([own if moving else Decimal(1) for own, moving in zip(length, moves, strict=True)])
    direction = slips / size[:, None]
    basis = _freedom(sample, moves, direction)
    changes = (basis[:, sample.up] - basis[:, sample.low]) * sample.makes_slip  # (k, E, C)
    along = ((changes * direction).sum(axis=2) / size)[:, moves]
    either = np.zeros(len(moves), dtype=bool)
    either[moves] = _can_rest(_orthonormal(along))
    lattice, speed = scene.lattice, Decimal(scene.radius) * truths.unit_of(scene)
    state = np.where(lattice.between_driven & (lattice.axis < lattice.dimension - 1), DRIVEN, UNCLEAR).astype(np.uint8)
    state[sample.of] = np.where(either, EITHER, np.where(moves, SLIPPING, SLIPLESS))
    slip, margin = np.zeros(len(state)), np.ones(len(state))
    slip[sample.of], margin[sample.of] = length * speed, room
    by_axis = {name: lattice.by_axis(of) for name, of in (("state", state), ("slip", slip), ("margin", margin))}
    return replace(truth, freedom=len(basis), **by_axis)


def _freedom(sample: Sample, moves: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Basis (k, all spins) of changes that leave contacts at rest and slips along their directions; no driven one."""
    rows = []
    for low, up, felt, moving, (*sideways, along) in zip(
        sample.low, sample.up, sample.makes_slip, moves, direction, strict=True
    ):
        parts = np.flatnonzero(felt)
        weights = [] if moving and len(parts) < 2 else [(-along, *sideways)] if moving else np.eye(len(felt), dtype=int)
        for weight in weights:
            row = np.full(len(sample.spin), Decimal(0), dtype=object)
            for part in parts:
                row[up[part]] += weight[part]
                row[low[part]] -= weight[part]
            rows.append(row[: sample.unknowns])
    driven = np.full(len(sample.spin) - sample.unknowns, Decimal(0), dtype=object)
    found = [np.concatenate([vector, driven]) for vector in _null_space(rows, sample.unknowns)]
    return np.array(found, dtype=object).reshape(len(found), len(sample.spin))


def _null_space(rows: list[np.ndarray], width: int) -> list[np.ndarray]:
    """Vectors x with rows . x = 0, by elimination with complete pivoting of rows whose largest entry is 1."""
    sizes = [max(abs(row)) for row in rows]
    left = np.array([row / size for row, size in zip(rows, sizes, strict=True) if size > RANK]).reshape(-1, width)
    columns, pivots, done = list(range(width)), [], np.empty((0, width), dtype=object)
    while len(left) and columns:
        size = np.abs(left[:, columns]).astype(float)
        r, c = np.unravel_index(size.argmax(), size.shape)
        if size[r, c] < RANK:
            break
        column = columns.pop(int(c))
        pivot = left[r] / left[r, column]
        left = np.delete(left, r, axis=0)
        for part in (left, done):
            used = np.flatnonzero(part[:, column])
            part[used] -= np.outer(part[used, column], pivot)
        done = np.vstack([done, pivot])
        pivots.append(column)
    vectors = []
    for column in columns:
        vector = np.full(width, Decimal(0), dtype=object)
        vector[column], vector[pivots] = Decimal(1), -done[:, column]
        vectors.append(vector)
    return vectors


def _orthonormal(vectors: np.ndarray) -> np.ndarray:
    """The same space (k, E), vectors of length 1 at right angles, in doubles; those of no length are left out."""
    kept: list[np.ndarray] = []
    for vector in vectors:
        for other in kept * 2:
            vector = vector - (other @ vector) * other
        size = (vector @ vector).sqrt() if len(vector) else Decimal(0)
        if size > RANK:
            kept.append(vector / size)
    return np.array(kept, dtype=float).reshape(len(kept), vectors.shape[1])


def _can_rest(changes: np.ndarray) -> np.ndarray:
    """Which slips, 1 + changes.T @ y >= 0 in units of those in the middle, (E,), are 0 at some minimum."""
    rows, found = changes.T, np.zeros(changes.shape[1], dtype=bool)
    for number in np.flatnonzero(np.abs(rows).max(axis=1, initial=0.0) >= MOVED):
        lowest = linprog(rows[number], A_ub=-rows, b_ub=np.ones(len(rows)), bounds=(None, None), method="highs")
        if lowest.status not in (0, 3):
            raise ArithmeticError(f"no linear programme tells whether contact {number} rests: {lowest.message}")
        found[number] = lowest.fun < -1 + NEVER
    return found
