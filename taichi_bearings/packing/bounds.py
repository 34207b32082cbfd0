"""Lower bounds on the least dissipation of a network, from forces, with every rounding bounded.

For any spins u* at which it is least, forces f that the law admits and the torques r = K^T f that they leave,

    least >= sum f . b - sum phi*(|f|) + r . u* .

Where components do not mix (discs; normals along the axes) one minimiser lies in the symmetric box |u| <= max |driven
u|, component by component, since clipping lengthens no slip, and r . u* is paid for there. On other networks no box of
driven values holds. There x = q K (K^T q K)^-1 r balances what is left, to some 1e-16 of it, and costs little:
sum |x| |y*| <= max(|x| / w) Phi with the dissipation Phi of any spins. What is left after that is paid for by the size
of a minimiser. With q = w + h Y / 2 and Y = Phi / min w no slip of it exceeds Y, so sum q |y|^2 <= 2 Phi Y (without
viscosity Phi Y, without friction q = h and 2 Phi), and

    |D^-1 u*| <= (sqrt(sum q |y|^2) + sqrt(sum q |b|^2)) / sigma,    sigma^2 <= least eigenvalue of D K^T q K D

with D that makes the diagonal about 1. The floor sigma^2 is proven by a Cholesky factorisation of D K^T q K D - s which
succeeds in floats (Rump, BIT 46, 2006): sigma^2 = s less all roundings. Unknowns in which nothing slips are held at 0.
The slip is that of the normals as they are stored, (u_i + u_j) x n: forces lose what they have along n, and torques
are summed in twice the precision.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.numerics.cholesky.fronts import BlockPattern, Pattern
from taichi_bearings.numerics.double_double import Pair, add, two_product
from taichi_bearings.packing.newton import NewtonMatrix, isotropic
from taichi_bearings.packing.system import System, along_axes

EPS = np.finfo(np.float64).eps
ROUNDED_UP = 1 + 1e-9  # more than what rounds in the few sums of positive numbers that it multiplies
INVERSE_STEPS, FLOOR_SHARES = 10, (0.7, 0.2)  # of the inverse iteration; of the eigenvalue found, tried as floors


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
    if potential == 0 or not system.offset.any():
        return Bound(0.0, "proven")
    if not np.isfinite(force).all():
        return Bound(0.0, "not proven: forces are not finite")
    vectors = _admitted(np.einsum("te,tek->ek", force, system.across), law.holding_force(of) if not law.flows else None)
    size = np.linalg.norm(vectors, axis=1)
    free, box = packing.driven < 0, np.abs(packing.imposed).max(axis=0)
    if along_axes(packing, system.contact):
        torque, lost = torques(system, [vectors])
        payment, proof = float(((np.abs(torque) + lost)[free] * box).sum()) * ROUNDED_UP, "proven"
    elif not system.motions.decided:
        return Bound(0.0, "not proven: rounding leaves open how many slipless motions there are")
    else:
        torque, lost, payment = _balanced(system, matrix, vectors, potential)
        proof = (
            _rests_on(system) if payment < np.inf else "not proven: no floor of the smallest singular value was found"
        )
    works = torque[~free] * packing.imposed[~free]
    value = works.sum()
    allowance = (np.abs(packing.imposed[~free]) * lost[~free]).sum() + (works.size + 4) * EPS * np.abs(works).sum()
    if law.flows:
        cost = law.conjugate(of, size * (1 + 8 * EPS))
        value, allowance = value - cost.sum(), allowance + (len(cost) + 16) * EPS * cost.sum()
    found = float((value - allowance * ROUNDED_UP - payment) * (1 - 8 * EPS))
    return Bound(max(0.0, found), proof) if np.isfinite(found) else Bound(0.0, proof)


def _balanced(
    system: System, matrix: NewtonMatrix, vectors: np.ndarray, potential: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Torques (N, C) of the forces less what balances them, with their error, and what that and the rest costs."""
    weight, total = _weight(system, potential)
    floor = Floor.of(system, matrix, weight)
    if floor is None:
        return *torques(system, [vectors]), np.inf
    left = floor.taken(torques(system, [vectors])[0])
    springs = weight * system.change(floor.scale * matrix.solve(left * floor.scale))
    further = np.einsum("te,tek->ek", springs, system.across)
    torque, lost = torques(system, [vectors, -further])
    size = np.linalg.norm(further, axis=1) * (1 + 8 * EPS)
    held, viscosity = (
        law(system.coefficients) for law in (system.packing.kind.holding_force, system.packing.kind.viscosity)
    )
    holds = np.zeros(len(size), dtype=bool) if held is None else held > 0
    payment = 0.0 if held is None else potential * float((size[holds] / held[holds]).max(initial=0.0))
    if viscosity is not None and not holds.all():
        payment += np.sqrt(2 * potential * float((size[~holds] ** 2 / viscosity[~holds]).sum()))
    smallest = floor.proven()
    if not smallest > 0:
        return torque, lost, np.inf
    start = float(np.sqrt((weight * (system.offset**2).sum(axis=0)).sum()))
    rest = np.linalg.norm(floor.taken(np.abs(torque) + lost) * floor.scale)
    return torque, lost, float(payment + rest * (np.sqrt(total) + start) / np.sqrt(smallest)) * ROUNDED_UP


def torques(system: System, forces: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Sums (N, C) of the forces (A, C) at each sphere without what they have along the normals, and their errors."""
    packing = system.packing
    nothing, error = np.zeros_like(forces[0]), np.zeros_like(forces[0])
    sums: Pair = (nothing, nothing)
    for force in forces:
        sums, size = add(sums, (force, nothing)), np.linalg.norm(force, axis=1)[:, None]
        error += 2.0**-98 * size
        if packing.dimension == 3:
            normal = packing.normal[system.contact]  # type: ignore[index]
            high, low = two_product(force, normal)
            part: Pair = (np.zeros(len(force)), np.zeros(len(force)))
            for k in range(3):
                part = add(part, (high[:, k], low[:, k]))
            along = ((part[0] + part[1]) / (normal**2).sum(axis=1))[:, None] * normal
            sums, error = add(sums, (-along, nothing)), error + 12 * EPS * np.abs(along)
    ends = packing.contact[system.contact].T.ravel()
    order = np.argsort(ends, kind="stable")
    sphere = ends[order]
    turn = np.arange(len(sphere)) - np.searchsorted(sphere, sphere)  # of each contact at its sphere
    total = (np.zeros((packing.spheres, nothing.shape[1])), np.zeros((packing.spheres, nothing.shape[1])))
    lost = np.zeros_like(total[0])
    contact = order % len(system.contact)
    by_turn = np.argsort(turn, kind="stable")
    for own in np.split(by_turn, np.cumsum(np.bincount(turn))[:-1]):
        i, e = sphere[own], contact[own]
        after = add((total[0][i], total[1][i]), (sums[0][e], sums[1][e]))
        total[0][i], total[1][i] = after
        lost[i] += error[e] + 2.0**-98 * (np.abs(sums[0][e]) + np.abs(after[0]))
    found = total[0] + total[1]
    return found, (lost + EPS * np.abs(found)) * ROUNDED_UP


def _admitted(vectors: np.ndarray, limit: np.ndarray | None) -> np.ndarray:
    """Forces (A, C), those shortened that exceed their limits (A,)."""
    if limit is None:
        return vectors
    ratio = np.linalg.norm(vectors, axis=1) * (1 + 16 * EPS) / limit
    return vectors / np.where(ratio > 1, ratio * (1 + 4 * EPS), 1.0)[:, None]


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
        return viscosity, 2 * potential * ROUNDED_UP
    fastest = potential / float(held[held > 0].min())
    if viscosity is None:
        return held, potential * fastest * ROUNDED_UP
    return held + viscosity * fastest / 2, 2 * potential * fastest * ROUNDED_UP


@dataclass(frozen=True)
class Floor:
    """Of the eigenvalues of D K^T q K D, whose entries are `values`; D = `scale`, (unknowns,), powers of two."""

    system: System
    matrix: NewtonMatrix
    values: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, system: System, matrix: NewtonMatrix, weight: np.ndarray) -> "Floor | None":
        """The matrix, factorised; None if it is singular. weight : q, (A,)."""
        pattern = matrix.cholesky.pattern
        values = matrix.entries(isotropic(weight, len(system.offset)))
        row, column = _indices(pattern)
        diagonal = np.empty(system.unknowns)
        diagonal[row[pattern.diagonal]] = values[pattern.diagonal]
        if not (np.isfinite(values).all() and (diagonal > 0).all()):
            return None
        scale = np.exp2(-np.round(np.log2(diagonal) / 2))
        floor = cls(system, matrix, values * scale[row] * scale[column], scale)
        return floor if matrix.factorise_entries(floor.values) else None

    def taken(self, torque: np.ndarray) -> np.ndarray:
        """Of (N, C) what belongs to the unknowns, (unknowns,)."""
        there, found = self.system.moved >= 0, np.zeros(self.system.unknowns)
        found[self.system.moved[there]] = torque[there]
        return found

    def proven(self) -> float:
        """The floor, or 0 if none was found; the matrix has to be factorised, and is not afterwards."""
        system, matrix, pattern = self.system, self.matrix, self.matrix.cholesky.pattern
        vector, least = np.random.default_rng(5).standard_normal(system.unknowns), 0.0
        for _ in range(INVERSE_STEPS):
            vector = matrix.solve(vector / np.linalg.norm(vector))
            least = 1 / float(np.linalg.norm(vector))
        degree = int(np.bincount(system.packing.contact[system.contact].ravel()).max())
        entries = (degree + 24) * EPS * 2 * 3 * (degree + 1)  # largest sum of a row of what rounds in its entries
        row, _ = _indices(pattern)
        own = np.empty(system.unknowns)
        own[row[pattern.diagonal]] = self.values[pattern.diagonal]
        # of the sum with most products at most: |error| <= v v^T with v^2 = (2 m + 16) eps a, so its norm is sum v^2
        rounded = entries + float(((2 * matrix.rows + 16) * EPS * own).sum()) * ROUNDED_UP
        for share in FLOOR_SHARES:
            shifted = self.values.copy()
            shifted[pattern.diagonal] -= share * least
            if share * least > 2 * rounded and matrix.factorise_entries(shifted):
                return (share * least - rounded) * (1 - 1e-9)
        return 0.0


def _indices(pattern: Pattern | BlockPattern) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns (entries,) of the stored entries of a pattern."""
    if isinstance(pattern, Pattern):
        return pattern.order[pattern.row], pattern.order[pattern.column]
    column, row = np.divmod(np.arange(pattern.entries), pattern.size)
    return row, column
