"""Lower bounds on the least dissipation of a network, from forces, with every rounding bounded.

For any spins u* at which it is least and forces f that the law admits, with torques r = K^T f that they leave,

    least >= sum f . b - sum phi*(|f|) + r . u* .

In exact balance the last term is 0. Else it is paid for by the size of a minimiser. Where components do not mix (discs;
normals along the axes) one lies in the symmetric box |u| <= max |driven u|, component by component, since clipping
lengthens no slip. On other networks no box of driven values holds. There the dissipation itself bounds the slips: with q
= w + h Y / 2 and Y = Phi / min w no slip of a minimiser exceeds Y, so sum q |y|^2 <= 2 Phi Y (without viscosity Phi Y,
without friction q = h and 2 Phi), and

    |D^-1 u*| <= (sqrt(sum q |y|^2) + sqrt(sum q |b|^2)) / sigma,    sigma^2 <= least eigenvalue of D K^T q K D

with D that makes the diagonal about 1. The floor sigma^2 is proven by a Cholesky factorisation of D K^T q K D - s which
succeeds in floats (Rump, BIT 46, 2006): sigma^2 = s less all roundings. Unknowns in which nothing slips are held at 0.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.packing.newton import NewtonMatrix, isotropic
from taichi_bearings.packing.system import System

EPS = np.finfo(np.float64).eps
UP = 1 + 1e-9  # more than what rounds in the few sums of positive numbers that it multiplies
INVERSE_STEPS, SHARES = 10, (0.7, 0.2)  # of the inverse iteration; of the eigenvalue that it finds, tried as floors


@dataclass(frozen=True)
class Bound:
    """value : energy/time, never below 0. proof : "proven", what it rests on beside, or why nothing is proven."""

    value: float
    proof: str

    @property
    def proven(self) -> bool:
        return not self.proof.startswith("not proven")


def lower_bound(system: System, matrix: NewtonMatrix, force: np.ndarray, potential: float) -> Bound:
    """force : (d, A), in units of force, any values. potential : of some spins, not below the least one."""
    packing, law, of = system.packing, system.packing.kind, system.coefficients
    if potential == 0 or not system.unknowns and not system.motions.number:
        return Bound(max(0.0, potential * (1 - 1e-12)), "proven")
    if not np.isfinite(force).all():
        return Bound(0.0, "not proven: forces are not finite")
    vectors = _admitted(np.einsum("te,tek->ek", force, system.across), law.holding_force(of) if not law.flows else None)
    first, second = packing.contact[system.contact].T
    size = np.linalg.norm(vectors, axis=1)
    along = np.zeros_like(vectors)
    if packing.dimension == 3:
        normal = packing.normal[system.contact]  # type: ignore[index]
        along = (np.abs((vectors * normal).sum(axis=1)) + 4 * EPS * size)[:, None] * np.abs(normal) * UP
    torque, terms, astray = (np.zeros((packing.spheres, vectors.shape[1])) for _ in range(3))
    for end in (first, second):
        for total, part in ((torque, vectors), (terms, np.abs(vectors)), (astray, along)):
            np.add.at(total, end, part)
    degree = np.bincount(np.concatenate([first, second]), minlength=packing.spheres)[:, None]
    left = (np.abs(torque) + (degree + 2) * EPS * terms + astray) * UP
    driven = packing.driven >= 0
    works = torque[driven] * packing.imposed[driven]
    lost = (degree[driven] + 2) * EPS * terms[driven] + astray[driven]
    allowance = (np.abs(packing.imposed[driven]) * lost).sum() + (works.size + 2) * EPS * np.abs(works).sum()
    value = works.sum()
    if law.flows:
        cost = law.conjugate(of, size * (1 + 8 * EPS))
        value, allowance = value - cost.sum(), allowance + (len(cost) + 16) * EPS * cost.sum()
    payment, proof = _payment(system, matrix, left, potential)
    found = value - allowance * UP - payment
    return Bound(max(0.0, float(found * (1 - 8 * EPS))), proof) if np.isfinite(found) else Bound(0.0, proof)


def _admitted(vectors: np.ndarray, limit: np.ndarray | None) -> np.ndarray:
    """Forces (A, C), all of them shortened alike so that none exceeds its limit (A,)."""
    if limit is None:
        return vectors
    worst = float((np.linalg.norm(vectors, axis=1) * (1 + 16 * EPS) / limit).max(initial=0.0))
    return vectors / (worst * (1 + 2 * EPS)) if worst > 1 else vectors


def along_axes(system: System) -> bool:
    """True where components do not mix: discs, or normals along the axes."""
    normal = system.packing.normal[system.contact]  # type: ignore[index]
    return system.packing.dimension == 2 or bool(((normal != 0).sum(axis=1) == 1).all())


def _payment(system: System, matrix: NewtonMatrix, left: np.ndarray, potential: float) -> tuple[float, str]:
    """What torques left (N, C) can take from the bound, at most; infinite with the reason if nothing is known."""
    packing = system.packing
    free = packing.driven < 0
    if along_axes(system):
        box = np.abs(packing.imposed).max(axis=0)
        return float((left[free] * box).sum()) * UP, "proven"
    if not system.motions.decided:
        return np.inf, "not proven: rounding leaves open how many slipless motions there are"
    weight, total = _weight(system, potential)
    start = float(np.sqrt((weight * (system.offset**2).sum(axis=0)).sum()))
    floor, scale = eigenvalue_floor(system, matrix, weight)
    if not floor > 0:
        return np.inf, "not proven: no floor of the smallest singular value was found"
    there = system.moved >= 0
    scaled = np.zeros(system.unknowns)
    scaled[system.moved[there]] = left[there]
    payment = np.linalg.norm(scaled * scale) * (np.sqrt(total) + start) / np.sqrt(floor) * UP
    return float(payment), _rests_on(system)


def _rests_on(system: System) -> str:
    number = system.motions.number
    if not number or _one_way(system) >= number:
        return "proven"
    return f"proven, with {number:,} slipless motions that are exact but for the rounding of the normals"


def _one_way(system: System) -> int:
    """Spheres in the system whose contacts all have one direction, bit by bit: turning about it slips nowhere."""
    packing = system.packing
    normal = packing.normal[system.contact]  # type: ignore[index]
    ends = packing.contact[system.contact]
    turned = normal * np.sign(normal[np.arange(len(normal)), np.argmax(np.abs(normal), axis=1)])[:, None]
    low, high = np.full((packing.spheres, 3), np.inf), np.full((packing.spheres, 3), -np.inf)
    for end in ends.T:
        np.minimum.at(low, end, turned)
        np.maximum.at(high, end, turned)
    return int(((low == high).all(axis=1) & (packing.driven < 0)).sum())


def _weight(system: System, potential: float) -> tuple[np.ndarray, float]:
    """q (A,), and what sum q |y|^2 of a minimiser cannot exceed."""
    law, of = system.packing.kind, system.coefficients
    held, viscosity = law.holding_force(of), law.viscosity(of)
    if held is None or not (held > 0).any():
        assert viscosity is not None
        return viscosity, 2 * potential * UP
    fastest = potential / float(held[held > 0].min())
    if viscosity is None:
        return held, potential * fastest * UP
    return held + viscosity * fastest / 2, 2 * potential * fastest * UP


def eigenvalue_floor(system: System, matrix: NewtonMatrix, weight: np.ndarray) -> tuple[float, np.ndarray]:
    """A proven floor of the eigenvalues of D K^T q K D, or 0, and D (unknowns,), powers of two. weight : q, (A,)."""
    pattern = matrix.cholesky.pattern
    values = matrix.entries(isotropic(weight, len(system.offset)))
    row, column = _indices(pattern)
    diagonal = np.empty(system.unknowns)
    diagonal[row[pattern.diagonal]] = values[pattern.diagonal]
    if not (np.isfinite(values).all() and (diagonal > 0).all()):
        return 0.0, diagonal
    scale = np.exp2(-np.round(np.log2(diagonal) / 2))
    values = values * scale[row] * scale[column]
    if not matrix.factorise_entries(values):
        return 0.0, scale
    vector, least = np.random.default_rng(5).standard_normal(system.unknowns), 0.0
    for _ in range(INVERSE_STEPS):
        vector = matrix.solve(vector / np.linalg.norm(vector))
        least = 1 / float(np.linalg.norm(vector))
    degree = int(np.bincount(system.packing.contact[system.contact].ravel()).max())
    trace = 2.0 * system.unknowns
    rounded = (degree + 24) * EPS * 2 * 3 * (degree + 1) + (2 * matrix.longest_row + 16) * EPS * trace * UP
    for share in SHARES:
        shifted = values.copy()
        shifted[pattern.diagonal] -= share * least
        if share * least > 2 * rounded and matrix.factorise_entries(shifted):
            return (share * least - rounded) * (1 - 1e-9), scale
    return 0.0, scale


def _indices(pattern: object) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns (entries,) of the stored entries of a pattern."""
    if hasattr(pattern, "row"):
        return pattern.order[pattern.row], pattern.order[pattern.column]  # type: ignore[attr-defined]
    column, row = np.divmod(np.arange(pattern.entries), pattern.size)  # type: ignore[attr-defined]
    return row, column
