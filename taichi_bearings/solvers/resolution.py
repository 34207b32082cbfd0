"""The exact minimum, from a point near the end of the central path: which contacts slip, to the last decade of slip.

On the central path slip times friction margin is the same for all contacts, so a slip of 1e-9 can be seen only where
margins of 1e-9 can, and double precision ends before. Here

1. contacts that surely stick are tied (contraction.py) and the path is followed in the few unknowns that are left;
2. contacts that surely slip then leave their cones and obey their friction law exactly, so that the products of slip
   and margin of those in doubt can be brought down by another ten decades, until nobody is in doubt;
3. with all slipless contacts tied the power is a smooth function, and Newton's method finds its minimum;
4. the forces of the tied contacts are balanced anew. If they fit into their friction discs, the contact states are
   those of a minimum; contacts that cannot hold their force are untied and all is done once more.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.cholesky import NotPositiveDefinite, Part
from taichi_bearings.solvers.central_path import Iterate, newton_step
from taichi_bearings.solvers.cone import Scaling, determinant, inner, length, longest_step
from taichi_bearings.solvers.contact_system import ContactSystem
from taichi_bearings.solvers.contraction import Contraction
from taichi_bearings.solvers.newton_matrix import NewtonMatrix

STIFF = 1e-7  # ratio of slip and margin below which a contact is tied on the way, once there are any below its square
DECIDED = 1e4  # ratio from which a contact counts as decided in the end
CONES_END = 1e-14  # product of slip and margin at which cones alone lose their precision
ROUNDS, STEPS, LAST_STEPS, BALANCE_STEPS = 3, 40, 8, 15
HELD = 1e-13  # stiffness of forces that are held
WEAK = 1e-18  # product of slip and stiffness along it that keeps Newton matrices regular; it slows nothing down
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Resolved:
    """spins (unknowns,); dual (d, n), minus the forces, and slipping (n,) a group."""

    spins: np.ndarray
    dual: list[np.ndarray]
    slipping: list[np.ndarray]


def resolve(iterate: Iterate, tied: list[np.ndarray], parts: list[Part], matrix: NewtonMatrix) -> Resolved | None:
    """Spins, forces and contact states at the minimum; None if they cannot be had in double precision.

    iterate : near the end of the central path; not changed. tied : (n,) mask a group, contacts that surely stick.
    parts, matrix : of its system.
    """
    try:
        for _ in range(ROUNDS):
            path = _Path(iterate, parts, tied)
            if not path.decide():
                return None
            found = _minimum(iterate, parts, path)
            if found is None:
                return None
            dual, weak = _balanced(iterate, matrix, found)
            if dual is not None:
                return Resolved(found.spins, dual, found.slipping)
            tied = [t & ~w for t, w in zip(tied, weak, strict=True)]
    except NotPositiveDefinite:
        pass
    return None


class _Path:
    """The central path over the contacts that are not tied, of which there are fewer and fewer.

    kept : per group, the contacts of the whole system that are left. dual : of all contacts; the last one of tied ones.
    """

    def __init__(self, whole: Iterate, parts: list[Part], tied: list[np.ndarray]) -> None:
        self.point, self.parts = whole, parts
        self.kept = [np.arange(len(mu)) for mu in whole.friction]
        self.dual = [y.copy() for y in whole.dual]
        self.smooth = [np.zeros(len(mu), dtype=bool) for mu in whole.friction]
        self.chain: list[Contraction] = []
        self._tie(tied)
        self.target = self.point.complementarity

    def _tie(self, tied: list[np.ndarray]) -> None:
        """Go on without the contacts `tied`, (n,) masks over those that are left."""
        point, contraction = self.point, Contraction(self.point.system, self.parts, tied)
        self.chain.append(contraction)
        self.store()
        spins = contraction.contracted(point.spins)
        difference, bound = [], []
        for group, z, b, keep in zip(
            contraction.system.groups, point.difference, point.bound, contraction.kept, strict=True
        ):
            new = group.differences(spins)
            close = np.abs(new - z[:, keep]) < 1e-14  # the old ones are more precise
            difference.append(np.where(close, z[:, keep], new))
            bound.append(b[keep] - length(z[:, keep]) + length(difference[-1]))
        self.point = Iterate(
            contraction.system,
            spins,
            [mu[keep] for mu, keep in zip(point.friction, contraction.kept, strict=True)],
            bound,
            difference,
            [y[:, keep] for y, keep in zip(point.dual, contraction.kept, strict=True)],
        )
        self.smooth = [smooth[keep] for smooth, keep in zip(self.smooth, contraction.kept, strict=True)]
        self.kept = [kept[keep] for kept, keep in zip(self.kept, contraction.kept, strict=True)]
        self.parts = contraction.parts
        self.matrix = NewtonMatrix(contraction.system, contraction.parts)

    def store(self) -> None:
        """Bring `dual` up to date."""
        for all_dual, y, kept in zip(self.dual, self.point.dual, self.kept, strict=True):
            all_dual[:, kept] = y

    @property
    def spins(self) -> np.ndarray:
        """Spins of the whole system."""
        spins = self.point.spins
        for contraction in reversed(self.chain):
            spins = contraction.expanded(spins)
        return spins

    def decide(self) -> bool:
        """Follow the path until slip and margin of every contact differ by DECIDED; False if that fails."""
        for _ in range(STEPS):
            if self._decided():
                return True
            if self.target > CONES_END:
                newton_step(self.point, self.matrix)
                self.target = self.point.complementarity
                if self.target <= CONES_END:
                    self.target *= 0.1
                continue
            ratios = self._ratios()
            if min(float(r.min(initial=1.0)) for r in ratios) < STIFF**2:
                self._tie([r < STIFF for r in ratios])
            if self._step() > 0.5:
                self.target *= 0.1
        return False

    def _ratios(self) -> list[np.ndarray]:
        """Slip over margin (relative to the friction) of the contacts that are left."""
        return [
            length(z) / np.maximum(1 - length(y) / mu, TINY)
            for mu, z, y in zip(self.point.friction, self.point.difference, self.point.dual, strict=True)
        ]

    def _decided(self) -> bool:
        ratios = self._ratios()
        self.slipping = [r > 1 for r in ratios]
        return all(((r > DECIDED) | (r < 1 / DECIDED)).all() for r in ratios)

    def _leave_cones(self) -> None:
        """Sort contacts into those that obey their friction law exactly and those that keep a cone."""
        point = self.point
        # beyond this slip, the distance from the cone is lost in rounding; far above sqrt(target) in any case
        limit = max(self.target / (200 * np.finfo(float).eps), 100 * np.sqrt(self.target))
        for mu, z, y, b, smooth in zip(
            point.friction, point.difference, point.dual, point.bound, self.smooth, strict=True
        ):
            back = smooth & (length(z) <= limit)
            b[back] = ((self.target / mu + np.hypot(self.target / mu, 2 * length(z))) / 2)[back]
            y[:, back] = -mu[back] * z[:, back] / b[back]
            smooth[:] = length(z) > limit
            y[:, smooth] = -mu[smooth] * z[:, smooth] / length(z[:, smooth])

    def _step(self) -> float:
        """One Newton step towards products of slip and margin equal to the target; returns its length."""
        self._leave_cones()
        point, system = self.point, self.point.system
        pulls, stiffnesses, cones = [], [], []
        for mu, z, y, b, smooth in zip(
            point.friction, point.difference, point.dual, point.bound, self.smooth, strict=True
        ):
            cone = ~smooth
            stiffness = np.zeros((len(z), *z.shape))
            stiffness[:, :, smooth] = friction_stiffness(mu[smooth], z[:, smooth])
            primal, dual = (b[cone], z[:, cone]), (mu[cone], y[:, cone])
            diagonal, off, stiffness[:, :, cone] = Scaling.of(primal, dual).newton_blocks()
            head = -dual[0] + self.target * primal[0] / determinant(primal)
            pull = y.copy()
            pull[:, cone] = -self.target * primal[1] / determinant(primal) - off * (head / diagonal)
            pulls.append(pull)
            stiffnesses.append(stiffness)
            cones.append((cone, diagonal, off, head))
        self.matrix.factorise(stiffnesses)
        step, change, new_dual = self._solved(system, pulls, stiffnesses)
        along, dual_along, moves = 1.0, 1.0, []
        for mu, z, y, b, dz, y_new, (cone, diagonal, off, head) in zip(
            point.friction, point.difference, point.dual, point.bound, change, new_dual, cones, strict=True
        ):
            db, dy = (head - inner(off, dz[:, cone])) / diagonal, (y_new - y)[:, cone]
            along = min(along, 0.9 * longest_step((b[cone], z[:, cone]), (db, dz[:, cone])))
            dual_along = min(dual_along, 0.9 * longest_step((mu[cone], y[:, cone]), (np.zeros_like(db), dy)))
            shortest = (length(z) / np.maximum(length(dz), TINY))[~cone].min(initial=np.inf)
            along = min(along, 0.5 * float(shortest))
            moves.append((cone, db, dy))
        point.spins = point.spins + along * step
        for z, dz, y, b, (cone, db, dy) in zip(point.difference, change, point.dual, point.bound, moves, strict=True):
            z += along * dz
            b[cone] += along * db
            y[:, cone] += dual_along * dy
        return min(along, dual_along)

    def _solved(
        self, system: ContactSystem, pulls: list[np.ndarray], stiffnesses: list[np.ndarray]
    ) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
        """Step of the spins, changes of the differences, and the dual that balances; refined twice."""
        step = np.zeros(system.unknowns)
        for _ in range(3):
            change = [g.change(step) for g in system.groups]
            dual = [p - np.einsum("ijn,jn->in", k, dz) for p, k, dz in zip(pulls, stiffnesses, change, strict=True)]
            step = step + self.matrix.solve(system.torques(dual))
        change = [g.change(step) for g in system.groups]
        dual = [p - np.einsum("ijn,jn->in", k, dz) for p, k, dz in zip(pulls, stiffnesses, change, strict=True)]
        return step, change, dual


def friction_stiffness(friction: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Second derivative (d, d, n) of friction * |difference|, plus the weak WEAK / slip^2 along the slip."""
    size = length(difference)
    along = difference / size
    stiffness = (WEAK / size**2) * along[:, None] * along[None, :]
    if len(along) == 2:
        across = np.stack([-along[1], along[0]])
        stiffness = stiffness + (friction / size) * across[:, None] * across[None, :]
    return stiffness


def _minimum(whole: Iterate, parts: list[Part], path: _Path) -> Resolved | None:
    """Newton's method on the power of the slipping contacts, all others tied."""
    slipping = [np.zeros(len(mu), dtype=bool) for mu in whole.friction]
    path.store()
    dual = [y.copy() for y in path.dual]
    for s, keep, mask in zip(slipping, path.kept, path.slipping, strict=True):
        s[keep] = mask
    last = Contraction(whole.system, parts, [~s for s in slipping])
    spins = last.contracted(path.spins)
    groups = last.system.groups
    friction = [mu[keep] for mu, keep in zip(whole.friction, last.kept, strict=True)]
    matrix = NewtonMatrix(last.system, last.parts) if last.unknowns else None
    worst = 0.0
    for _ in range(LAST_STEPS):
        difference = [g.differences(spins) for g in groups]
        if any((length(z) == 0).any() for z in difference):
            return None
        if matrix is None:
            break
        matrix.factorise([friction_stiffness(mu, z) for mu, z in zip(friction, difference, strict=True)])
        step = matrix.solve(
            last.system.torques([-mu * z / length(z) for mu, z in zip(friction, difference, strict=True)])
        )
        changes = [length(g.change(step)) / length(z) for g, z in zip(groups, difference, strict=True)]
        worst = max(float(c.max(initial=0.0)) for c in changes)
        if not np.isfinite(worst):
            return None
        spins = spins + min(1.0, 0.5 / max(worst, TINY)) * step
        if worst < 1e-9:
            break
    if worst > 1e-2:
        return None
    for y, mu, g, keep in zip(dual, friction, groups, last.kept, strict=True):
        z = g.differences(spins)
        y[:, keep] = -mu * z / length(z)
    return Resolved(last.expanded(spins), dual, slipping)


def _balanced(
    whole: Iterate, matrix: NewtonMatrix, found: Resolved
) -> tuple[list[np.ndarray] | None, list[np.ndarray]]:
    """Forces of the slipless contacts that leave no torque and fit into the friction discs, slipping ones as they are.

    Newton's method for the analytic centre of such forces, from forces inside the discs that leave torques: every step
    of length a takes away a share a of the torques. returns : the dual, or None with the contacts in the way.
    """
    system = whole.system
    dual = [np.where(s, y, _inside(y, mu)) for y, mu, s in zip(found.dual, whole.friction, found.slipping, strict=True)]
    for _ in range(BALANCE_STEPS):
        stiffness, pull = [], []
        for mu, y, s in zip(whole.friction, dual, found.slipping, strict=True):
            room = np.where(s, 1.0, mu**2 - inner(y, y))
            rest = room + 2 * inner(y, y)
            unit = np.eye(len(y))[:, :, None]
            soft = (room / 2) * (unit - (2 / rest) * y[:, None] * y[None, :])
            stiffness.append(np.where(s, HELD * unit, soft))
            pull.append(np.where(s, y, y - y * room / rest))
        matrix.factorise(stiffness)
        potential = np.zeros(system.unknowns)
        for _ in range(3):
            changed = [
                p - np.einsum("ijn,jn->in", k, g.change(potential))
                for p, k, g in zip(pull, stiffness, system.groups, strict=True)
            ]
            potential = potential + matrix.solve(system.torques(changed))
        changed = [
            p - np.einsum("ijn,jn->in", k, g.change(potential))
            for p, k, g in zip(pull, stiffness, system.groups, strict=True)
        ]
        reach = [
            _reach(y[:, ~s], (new - y)[:, ~s], mu[~s])
            for y, new, mu, s in zip(dual, changed, whole.friction, found.slipping, strict=True)
        ]
        longest = min(float(a.min(initial=np.inf)) for a in reach)
        along = 1.0 if longest > 1 else 0.95 * longest
        if along == 1.0:
            return changed, []
        dual = [np.where(s, y, y + along * (new - y)) for y, new, s in zip(dual, changed, found.slipping, strict=True)]
    weak = [np.zeros(len(mu), dtype=bool) for mu in whole.friction]
    for w, s, a in zip(weak, found.slipping, reach, strict=True):
        w[np.flatnonzero(~s)[a < 2 * longest]] = True
    return None, weak


def _inside(dual: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """The dual, no longer than 0.99 of the friction."""
    return dual * np.minimum(1.0, 0.99 * friction / np.maximum(length(dual), TINY))


def _reach(dual: np.ndarray, step: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """How far each may go along the step within its friction disc, (n,)."""
    a, b, c = inner(step, step), inner(dual, step), friction**2 - inner(dual, dual)
    return c / (b + np.sqrt(b * b + a * c) + TINY)
