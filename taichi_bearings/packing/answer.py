"""A packing solved: spins of least dissipation, what is proven of them, and which contacts slip."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.errors import InputError
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.packing import planar
from taichi_bearings.packing.bounds import Bound, lower_bound
from taichi_bearings.packing.central_path import balanced, followed, viscous_spins
from taichi_bearings.packing.newton import NewtonMatrix
from taichi_bearings.packing.packing import Packing
from taichi_bearings.packing.polish import polished
from taichi_bearings.packing.system import System
from taichi_bearings.packing.ties import tied
from taichi_bearings.scene.solution import Status
from taichi_bearings.words import shown

CLOSEST = 1e-13  # relative gap at which the central path ends: states come apart where the gap is small
MARGIN, RESOLVED, NO_MARGIN = 1e-2, 1e3, 1e-6  # of contacts that rest; powers over what is open, and margin, that slip
SURE_MARGIN, SURE_SLIP = 1e-6, 1e-11  # the same at exact minima, slips in units of the largest imposed one
NO_POWER = 1e-10  # of the natural power, below which a relative gap says nothing
SLIPLESS, SLIPPING, UNDECIDED, DRIVEN = range(4)


@dataclass(frozen=True, eq=False, repr=False)
class PackingResult:
    """What was found for a packing. Contacts between driven spheres, or with no coefficient, are left out of `power`.

    power : energy/time. potential : what is minimised; the power, but for "coulomb-viscous". lower_bound : on the least
    potential of any spins (for "viscous" on the power); 0 where nothing is proven. It is rigorous where `proof` is
    "proven"; else only if the motions that `proof` counts slip nowhere, which the rounding of normals hides.
    gap : (potential - lower_bound) / potential; where next to nothing is dissipated, over what all contacts would at
    the largest imposed surface velocity, or where none is imposed at the largest one. proof : "proven", what it rests
    on beside, or why there is none.
    status : "certified" if the gap is within the tolerance, else "stalled", or how a dynamics or descent ended.
    method : "planar-cut", "interior-point", "linear-solver", or the one that was asked for.
    spin : (N, 3), of discs (N,), laboratory frame, 1/time; slipless motions that nothing decides are left at rest, by a
    dynamics as it moves them.
    slip : (E,), length/time. force : (E,), its size. friction : (E, 3), of discs (E,), force on the second sphere,
    of discs its component along z x n. power_per_contact : (E,). state : (E,) 0 slipless, 1 slipping, 2 undecided, 3
    between driven or absent. driven_power : what contacts between driven spheres dissipate, energy/time.
    slipless_motions : of the free spheres that driven ones reach; None if undecided. unbalanced : largest torque left.
    seconds : wall time. iterations : of the method, factorisations of an interior point.
    history : of dynamics and descent, the columns of `Result.history`. time : simulated time of a dynamics, else None.
    """

    packing: Packing
    power: float
    potential: float
    lower_bound: float
    gap: float
    proof: str
    status: str
    method: str
    spin: np.ndarray
    slip: np.ndarray
    force: np.ndarray
    friction: np.ndarray
    power_per_contact: np.ndarray
    state: np.ndarray
    driven_power: float
    slipless_motions: int | None
    unbalanced: float
    seconds: float
    iterations: int = 0
    history: Mapping[str, np.ndarray] = field(default_factory=dict)
    time: float | None = None

    @property
    def critical(self) -> int:
        """Undecided contacts at their friction limit with a slip that the proven gap does not resolve."""
        held = self.packing.kind.holding_force(self.packing.coefficients)
        if held is None:
            return 0
        left = self.potential - self.lower_bound
        full = (self.force >= (1 - NO_MARGIN) * held) & (held * self.slip <= left)
        return int((full & (self.state == UNDECIDED)).sum())

    def __repr__(self) -> str:
        words = f"{self.method}: {self.status}, P = {self.power:.12g}, gap {self.gap:.1e}, {self.seconds:.2g} s"
        return f"<PackingResult {self.packing!r}, {words}>"


@dataclass(frozen=True)
class Found:
    """spins (unknowns,), force (d, A) in units of force, state (A,) where it is known exactly, else None. slips : (A,)
    sets of an exact minimum, where they were found. everywhere : u (N, C) of all spheres, where a method moves all."""

    spins: np.ndarray
    force: np.ndarray
    method: str
    state: np.ndarray | None = None
    bound: float | None = None
    slips: np.ndarray | None = None
    everywhere: np.ndarray | None = None


def solve_packing(packing: Packing, tolerance: float = 1e-8) -> PackingResult:
    """The state of least dissipation. tolerance : proven relative gap at which it counts as certified.

    Discs with friction by minimum cuts, exactly; viscous networks by one linear system; all else by the central path.
    """
    if not isinstance(packing, Packing):
        raise InputError(f"the packing is a {type(packing).__name__}; it must be a taichi_bearings.Packing")
    if not (isinstance(tolerance, (int, float)) and 0 < tolerance < 1):
        raise InputError(f"tolerance is {shown(tolerance)}; it must be above 0 and below 1")
    begun = perf_counter()
    runtime.current()
    with one_thread():
        system = System.of(packing)
        matrix = NewtonMatrix(system)
        found = _found(system, matrix)
        return judged(system, matrix, found, tolerance, begun)


def _found(system: System, matrix: NewtonMatrix) -> Found:
    law, of = system.packing.kind, system.coefficients
    if not system.unknowns or not system.offset.any():
        return Found(np.zeros(system.unknowns), np.zeros_like(system.offset), "linear-solver")
    if law.is_rate_independent and system.packing.dimension == 2:
        cut = planar.least_power(system)
        return Found(cut.spins, cut.force, "planar-cut", cut.state, cut.lower_bound)
    held, viscosity = (
        np.zeros(len(system.contact)) if v is None else v for v in (law.holding_force(of), law.viscosity(of))
    )
    fastest = float(np.abs(system.offset).max())
    if not held.any():
        spins = viscous_spins(system, matrix, viscosity)
        return Found(spins, viscosity * system.difference(spins), "linear-solver")
    largest = float(max(held.max(), viscosity.max() * fastest))
    scaled = replace(system, offset=system.offset / fastest)
    point = followed(scaled, matrix, held / largest, viscosity * fastest / largest, CLOSEST)
    exact = polished(point, scaled, matrix)
    slips = None if exact is None else exact[1]
    point = balanced(point, scaled, matrix) if exact is None else exact[0]
    return Found(point.spins * fastest, point.force * largest, "interior-point", slips=slips)


def judged(system: System, matrix: NewtonMatrix, found: Found, tolerance: float, begun: float) -> PackingResult:
    """What was found, with all that is proven of it. begun : when, by `perf_counter`."""
    packing, law = system.packing, system.packing.kind
    spins = system.all_spins(found.spins) if found.everywhere is None else found.everywhere
    slip = slip_of(packing, spins)
    acts = np.zeros(packing.contacts, dtype=bool)
    acts[system.contact] = True
    between = (packing.driven[packing.contact] >= 0).all(axis=1)
    power = law.power(packing.coefficients, slip)
    objective = law.objective(packing.coefficients, slip)
    slip_sum, total = float(power[~between].sum()), float(objective[~between].sum())
    above = float(law.potential(packing.coefficients, slip)[acts].sum()) * (1 + len(slip) * 1e-16 + 1e-12)
    bound = lower_bound(system, matrix, found.force, above)
    value = bound.value * law.share
    if found.bound is not None:
        bound, value = Bound(max(found.bound, value), "proven"), max(found.bound, value)
    value = min(value, total)  # both are of the same minimum; roundings of the power are above
    fastest = float(np.abs(packing.imposed).max(initial=0.0)) or float(np.abs(spins).max(initial=0.0))
    natural = float(law.objective(packing.coefficients, np.full(packing.contacts, fastest))[~between].sum())
    unit = total if total > NO_POWER * natural else natural
    gap = (total - value) / unit if unit > 0 else 0.0
    reached = gap <= tolerance
    force, friction = _forces(system, found.force)
    left = max(total - _estimate(system, found) * law.share, 0.0)
    state = _states(system, found, slip, left, natural)
    proof = bound.proof
    if not bound.proven and gap > tolerance:
        state[state != DRIVEN] = UNDECIDED
        proof += f"; balanced exactly, the forces would prove a gap of {left / unit:.0e}"
    spin = spins / np.asarray(packing.radius)[:, None]
    unbalanced = float(np.abs(system.torques(found.force)).max(initial=0.0))
    return PackingResult(
        packing, slip_sum, total, value, gap, proof, (Status.CERTIFIED if reached else Status.STALLED).value,
        found.method, spin[:, 0] if packing.dimension == 2 else spin, slip, force, friction, power, state,
        float(power[between].sum()), system.motions.number if system.motions.counted else None,
        unbalanced, perf_counter() - begun, matrix.factorisations,
    )  # fmt: skip


def slip_of(packing: Packing, spins: np.ndarray) -> np.ndarray:
    """Slip speeds (E,) for u = R omega of all spheres, (N, C)."""
    sums = spins[packing.contact].sum(axis=1)
    if packing.dimension == 2:
        return np.abs(sums[:, 0])
    assert packing.normal is not None
    return np.linalg.norm(np.cross(sums, packing.normal), axis=1)


def _forces(system: System, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sizes (E,) and friction on the second sphere, (E, 3), of discs (E,), along z x n."""
    packing = system.packing
    size, vectors = np.zeros(packing.contacts), np.zeros((packing.contacts, system.across.shape[2]))
    size[system.contact] = np.linalg.norm(force, axis=0)
    vectors[system.contact] = np.einsum("te,tek->ek", force, system.across)
    if packing.dimension == 2:
        return size, vectors[:, 0]
    assert packing.normal is not None
    return size, np.cross(vectors, packing.normal)


def _estimate(system: System, found: Found) -> float:
    """What the forces would prove if they were balanced exactly, in units of potential."""
    law = system.packing.kind
    work = float((found.force * system.offset).sum())
    cost = law.conjugate(system.coefficients, np.linalg.norm(found.force, axis=0)).sum() if law.flows else 0.0
    return work - float(cost)


def _states(system: System, found: Found, slip: np.ndarray, left: float, natural: float) -> np.ndarray:
    """States (E,). left : what is open of the power; natural : what all contacts would dissipate."""
    packing, law = system.packing, system.packing.kind
    acts = np.any([values > 0 for values in packing.coefficients], axis=0)
    state = np.where(acts & (packing.driven[packing.contact] < 0).any(axis=1), SLIPLESS, DRIVEN).astype(np.uint8)
    if found.state is not None:
        state[system.contact] = found.state
        return state
    held, speed = law.holding_force(system.coefficients), slip[system.contact]
    open_ = max(left, np.finfo(np.float64).eps * natural)
    if held is None or not held.any():
        rounding = 1e-12 * float(np.abs(packing.imposed).max(initial=0.0))
        state[system.contact] = np.where(speed > rounding, SLIPPING, SLIPLESS)
        return state
    if not system.offset.any():
        return state
    margin = 1 - np.linalg.norm(found.force, axis=0) / np.where(held > 0, held, 1.0)
    rests = (margin > MARGIN) & (held * speed * margin <= RESOLVED * open_) & (held > 0)
    slips = (margin < NO_MARGIN) & (held * speed > RESOLVED * open_) | (held == 0) & (speed > 0)
    if found.slips is not None:
        rests = ~found.slips & (margin > SURE_MARGIN)
        slips = found.slips & (speed > SURE_SLIP * float(np.abs(system.offset).max()))
    own = np.where(rests, SLIPLESS, np.where(slips, SLIPPING, UNDECIDED)).astype(np.uint8)
    if not law.flows:
        own[tied(system, found.force, own)] = UNDECIDED
    state[system.contact] = own
    return state
