"""Tell slipping from slipless contacts when the interior-point method has done all that double precision allows.

On the central path slip times friction margin is about the same for all contacts, so a slip of 1e-9 can be seen only if
margins of 1e-9 can. Here the contacts that surely stick are tied (contraction.py), those that surely slip follow their
friction law exactly, and only the few in doubt keep their cone, whose complementarity can then be brought down by ten
further decades. In the end nobody is in doubt: slipless contacts are tied, their slips are exactly zero, and Newton's
method finds the minimum of what is then a smooth function.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.cholesky import NotPositiveDefinite, Part
from taichi_bearings.solvers.cone import Scaling, determinant, inner, length, longest_step
from taichi_bearings.solvers.contact_system import ContactSystem
from taichi_bearings.solvers.contraction import Contraction
from taichi_bearings.solvers.newton_matrix import NewtonMatrix

SURE = 1e3  # ratio of slip and margin (both relative) from which a contact is not in doubt when the path is left
DECIDED = 1e4  # and from which it counts as decided in the end
SMOOTH = 1e3  # slips above SMOOTH * sqrt(complementarity) follow the friction law exactly
STEPS, LAST_STEPS = 25, 6


@dataclass(frozen=True)
class Resolved:
    """spins (unknowns,); dual (d, n) and slipping (n,) a group. worst : largest last change of a slip, relative to it."""

    spins: np.ndarray
    dual: list[np.ndarray]
    slipping: list[np.ndarray]
    worst: float


def resolve(
    system: ContactSystem,
    parts: list[Part],
    friction: list[np.ndarray],
    spins: np.ndarray,
    bound: list[np.ndarray],
    dual: list[np.ndarray],
    complementarity: float,
) -> Resolved | None:
    """Exact contact states from a nearly optimal primal-dual pair; None if some contact stays in doubt.

    friction (n,), dual (d, n) a group: minus the forces. complementarity : mean of |slip| times margin of the pair.
    """
    slip = [length(g.differences(spins)) for g in system.groups]
    margin = [1 - length(y) / mu for y, mu in zip(dual, friction, strict=True)]
    root = np.sqrt(complementarity)
    tied = [(m > SURE * s) & (m > SURE * root) for m, s in zip(margin, slip, strict=True)]
    first = Contraction(system, parts, tied)
    try:
        path = _Path(first, friction, spins, [b - s for b, s in zip(bound, slip, strict=True)], dual, complementarity)
        if not path.decide():
            return None
        slipping = [np.zeros(len(mu), dtype=bool) for mu in friction]
        dual = [y.copy() for y in dual]
        for all_slipping, y, keep, mask, new in zip(
            slipping, dual, first.kept, path.slipping, path.dual, strict=True
        ):
            all_slipping[keep] = mask
            y[:, keep] = new
        return _minimum(system, parts, friction, first.expanded(path.spins), dual, slipping)
    except NotPositiveDefinite:
        return None


class _Path:
    """The central path of the contacts that are not tied, those that surely slip taken out of their cones."""

    def __init__(
        self,
        contraction: Contraction,
        friction: list[np.ndarray],
        spins: np.ndarray,
        slack: list[np.ndarray],
        dual: list[np.ndarray],
        complementarity: float,
    ) -> None:
        self.groups = contraction.system.groups
        self.system = contraction.system
        self.matrix = NewtonMatrix(contraction.system, contraction.parts)
        self.friction = [mu[keep] for mu, keep in zip(friction, contraction.kept, strict=True)]
        self.dual = [y[:, keep] for y, keep in zip(dual, contraction.kept, strict=True)]
        self.spins = contraction.contracted(spins)
        self.difference = [g.differences(self.spins) for g in self.groups]
        self.target = complementarity
        self.bound = [length(z) + b[keep] for z, b, keep in zip(self.difference, slack, contraction.kept, strict=True)]
        self.smooth = [np.zeros(len(mu), dtype=bool) for mu in self.friction]

    def _central(self, mu: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Bounds (n,) that the central path has for these slips."""
        return (self.target / mu + np.hypot(self.target / mu, 2 * length(z))) / 2

    def decide(self) -> bool:
        """Follow the path until slip and margin of every contact differ by DECIDED; False if that fails."""
        for _ in range(STEPS):
            along = self._step()
            ratio = [self._ratio(*contact) for contact in zip(self.friction, self.difference, self.dual, strict=True)]
            self.slipping = [r > 1 for r in ratio]
            if along > 0.5 and all(((r > DECIDED) | (r < 1 / DECIDED)).all() for r in ratio):
                return True
            if along > 0.5:
                self.target *= 0.1
            elif along < 1e-3:
                self.target *= 2.0
        return False

    def _ratio(self, mu: np.ndarray, z: np.ndarray, y: np.ndarray) -> np.ndarray:
        return length(z) / np.maximum(1 - length(y) / mu, np.finfo(float).tiny)

    def _step(self) -> float:
        limit = SMOOTH * np.sqrt(self.target)
        pulls, expansions, stiffnesses = [], [], []
        for mu, z, y, b, s in zip(self.friction, self.difference, self.dual, self.bound, self.smooth, strict=True):
            back = s & (length(z) <= limit)
            b[back] = self._central(mu, z)[back]
            y[:, back] = -mu[back] * z[:, back] / b[back]
            s[:] = length(z) > limit
            y[:, s] = -mu[s] * z[:, s] / length(z[:, s])
            stiffness = np.zeros((len(z), *z.shape))
            stiffness[:, :, s] = friction_stiffness(mu[s], z[:, s], self.target)
            cone = ~s
            primal, dual = (b[cone], z[:, cone]), (mu[cone], y[:, cone])
            diagonal, off, stiffness[:, :, cone] = Scaling.of(primal, dual).newton_blocks()
            det = determinant(primal)
            head = -dual[0] + self.target * primal[0] / det
            tail = -dual[1] - self.target * primal[1] / det
            pull = y.copy()
            pull[:, cone] += tail - off * (head / diagonal)
            pulls.append(pull)
            stiffnesses.append(stiffness)
            expansions.append((cone, diagonal, off, head))
        self.matrix.factorise(stiffnesses)
        step, change, new_dual = self._solved(pulls, stiffnesses)
        along, dual_along = 1.0, 1.0
        moves = []
        for mu, z, y, b, dz, yn, (cone, diagonal, off, head) in zip(
            self.friction, self.difference, self.dual, self.bound, change, new_dual, expansions, strict=True
        ):
            db = (head - inner(off, dz[:, cone])) / diagonal
            dy = (yn - y)[:, cone]
            along = min(along, 0.9 * longest_step((b[cone], z[:, cone]), (db, dz[:, cone])))
            dual_along = min(dual_along, 0.9 * longest_step((mu[cone], y[:, cone]), (0 * db, dy)))
            if not cone.all():
                along = min(along, float((0.5 * length(z) / np.maximum(length(dz), 1e-300))[~cone].min()))
            moves.append((cone, db, dy))
        self.spins = self.spins + along * step
        for z, dz, y, b, (cone, db, dy) in zip(
            self.difference, change, self.dual, self.bound, moves, strict=True
        ):
            z += along * dz  # not from the spins, whose rounding is coarser than the distances from the cones
            b[cone] += along * db
            y[:, cone] += dual_along * dy
        return min(along, dual_along)

    def _solved(self, pulls: list, stiffnesses: list) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
        """Step of the spins, changes of the differences, and the dual that balances; refined twice."""
        step = self.matrix.solve(self.system.torques(pulls))
        for _ in range(2):
            new = [p - np.einsum("ijn,jn->in", k, g.change(step)) for p, k, g in zip(pulls, stiffnesses, self.groups, strict=True)]
            step = step + self.matrix.solve(self.system.torques(new))
        change = [g.change(step) for g in self.groups]
        new = [p - np.einsum("ijn,jn->in", k, dz) for p, k, dz in zip(pulls, stiffnesses, change, strict=True)]
        return step, change, new


def friction_stiffness(friction: np.ndarray, difference: np.ndarray, complementarity: float = 0.0) -> np.ndarray:
    """Second derivative (d, d, n) of friction * |difference|, plus the weak complementarity / slip^2 along the slip."""
    size = length(difference)
    along = difference / size
    stiffness = (complementarity / size**2) * along[:, None] * along[None, :]
    if len(along) == 2:
        across = np.stack([-along[1], along[0]])
        stiffness = stiffness + (friction / size) * across[:, None] * across[None, :]
    return stiffness


def _minimum(
    system: ContactSystem,
    parts: list[Part],
    friction: list[np.ndarray],
    spins: np.ndarray,
    dual: list[np.ndarray],
    slipping: list[np.ndarray],
) -> Resolved:
    """Newton's method on the power of the slipping contacts, all others tied."""
    last = Contraction(system, parts, [~mask for mask in slipping])
    reduced = last.contracted(spins)
    groups = last.system.groups
    mu = [f[keep] for f, keep in zip(friction, last.kept, strict=True)]
    worst = np.inf
    if last.unknowns:
        matrix = NewtonMatrix(last.system, last.parts)
        for _ in range(LAST_STEPS):
            difference = [g.differences(reduced) for g in groups]
            matrix.factorise([friction_stiffness(f, z, 1e-22) for f, z in zip(mu, difference, strict=True)])
            pull = [-f * z / length(z) for f, z in zip(mu, difference, strict=True)]
            step = matrix.solve(last.system.torques(pull))
            changes = [length(g.change(step)) / length(z) for g, z in zip(groups, difference, strict=True)]
            worst = max(float(c.max(initial=0.0)) for c in changes)
            reduced = reduced + min(1.0, 0.5 / worst) * step
            if worst < 1e-9:
                break
    difference = [g.differences(reduced) for g in groups]
    for y, f, z, keep in zip(dual, mu, difference, last.kept, strict=True):
        y[:, keep] = -f * z / length(z)
    return Resolved(last.expanded(reduced), dual, slipping, worst)
