"""The exact minimum, from a point near the end of the central path: which contacts slip, to the last decade of slip.

On the central path slip times friction margin is the same for all contacts, so a slip of 1e-9 can be seen only where
margins of 1e-9 can, and double precision ends before. Here

1. contacts that surely stick are tied (contraction.py) and the path is followed in the few unknowns that are left;
2. contacts that surely slip then leave their cones and obey their friction law exactly, so that the products of slip
   and margin of those in doubt can be brought down by another ten decades, until nobody is in doubt;
3. with all slipless contacts tied the power is a smooth function, and Newton's method finds its minimum;
4. the forces of the tied contacts are balanced anew. If they fit into their friction discs, the contact states are
   proven to be those of a minimum. Otherwise the spins are still a minimiser as far as the path's bound can tell.
"""

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.cholesky import NotPositiveDefinite, Part
from taichi_bearings.solvers.central_path import Iterate, friction_stiffness, newton_step
from taichi_bearings.solvers.cone import inner, length
from taichi_bearings.solvers.contraction import Contraction
from taichi_bearings.solvers.newton_matrix import NewtonMatrix

STIFF = 1e-7  # ratio of slip and margin below which a contact is tied on the way, once there are any below its square
SAME = 1e-12  # relative excess of power over the path's from which a result is discarded
DECIDED = 1e4  # ratio from which a contact counts as decided in the end
FARTHEST, DECIDED_AT_LAST = 1e-22, 10  # product of slip and margin beyond which nothing is gained; then this will do
STEPS, LAST_STEPS = 40, 8
BALANCE_STEPS, FEW_BALANCE_STEPS, MANY = 6, 2, 20_000  # the second for more unknowns, where more did not help
HELD, AT_MOST = 1e-13, 1e-6  # stiffness of forces that are held, and the relative change that they may suffer
EPS, TINY = np.finfo(np.float64).eps, np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Resolved:
    """spins (unknowns,); a group each: dual (d, n), minus the forces, and slipping (n,). proven : by those forces."""

    spins: np.ndarray
    dual: list[np.ndarray]
    slipping: list[np.ndarray]
    proven: bool = False


def resolve(iterate: Iterate, tied: list[np.ndarray], parts: list[Part], matrix: NewtonMatrix) -> Resolved | None:
    """Spins, forces and contact states at the minimum; None if they cannot be had in double precision.

    iterate : near the end of the central path; not changed. tied : (n,) mask a group, contacts that surely stick.
    parts, matrix : of its system.
    """
    with np.errstate(all="ignore"):  # what fails shows up as a number that is not finite and is discarded
        try:
            path = _Path(iterate, parts, tied)
            found = _minimum(iterate, parts, path) if path.decide() else None
            if found is None or not _power(iterate, found.spins) <= (1 + SAME) * _power(iterate, iterate.spins):
                return None
            dual = _balanced(iterate, matrix, found)
        except NotPositiveDefinite:
            return None
    return replace(found, dual=iterate.dual if dual is None else dual, proven=dual is not None)


def _power(iterate: Iterate, spins: np.ndarray) -> float:
    groups = iterate.system.groups
    return sum(float(mu @ length(g.differences(spins))) for mu, g in zip(iterate.friction, groups, strict=True))


class _Path:
    """The central path over the contacts that are not tied, of which there are fewer and fewer.

    kept : per group, the contacts of the whole system that are left. dual : of all contacts; the last one of tied ones.
    """

    def __init__(self, whole: Iterate, parts: list[Part], tied: list[np.ndarray]) -> None:
        self.point, self.parts = whole, parts
        self.kept = [np.arange(len(mu)) for mu in whole.friction]
        self.dual = [y.copy() for y in whole.dual]
        self.chain: list[Contraction] = []
        self._tie(tied)

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
            [smooth[keep] for smooth, keep in zip(point.smooth, contraction.kept, strict=True)],
        )
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
        point = self.point
        for _ in range(STEPS):
            if self._decided():
                return True
            ratios = self._ratios()
            if min(float(r.min(initial=1.0)) for r in ratios) < STIFF**2:
                self._tie([r < STIFF for r in ratios])
                point = self.point
            # beyond this slip the distance from the cone is lost in rounding; never near the slips in doubt
            product = point.complementarity
            point.let_slip(max(product / (1000 * EPS), 100 * np.sqrt(product)))
            newton_step(point, self.matrix)
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
        apart = DECIDED if self.point.complementarity > FARTHEST else DECIDED_AT_LAST
        return all(((r > apart) | (r < 1 / apart)).all() for r in ratios)


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


def _balanced(whole: Iterate, matrix: NewtonMatrix, found: Resolved) -> list[np.ndarray] | None:
    """Forces of the slipless contacts that leave no torque and fit into the friction discs, slipping ones as they are.

    Newton's method for the analytic centre of such forces, from forces inside the discs that leave torques: every step
    of length a takes away a share a of the torques. None if that does not end.
    """
    dual = [np.where(s, y, _inside(y, mu)) for y, mu, s in zip(found.dual, whole.friction, found.slipping, strict=True)]
    for _ in range(BALANCE_STEPS if whole.system.unknowns < MANY else FEW_BALANCE_STEPS):
        stiffness, pull = [], []
        for mu, y, s in zip(whole.friction, dual, found.slipping, strict=True):
            room = np.where(s, 1.0, mu**2 - inner(y, y))
            rest = room + 2 * inner(y, y)
            unit = np.eye(len(y))[:, :, None]
            soft = (room / 2) * (unit - (2 / rest) * y[:, None] * y[None, :])
            stiffness.append(np.where(s, HELD * unit, soft))
            pull.append(np.where(s, y, y - y * room / rest))
        changed = matrix.balanced(pull, stiffness)
        reach = [
            _reach(y[:, ~s], (new - y)[:, ~s], mu[~s])
            for y, new, mu, s in zip(dual, changed, whole.friction, found.slipping, strict=True)
        ]
        longest = min(float(a.min(initial=np.inf)) for a in reach)
        along = 1.0 if longest > 1 else 0.95 * longest
        if along == 1.0:
            held = [
                np.abs(length(y[:, s]) / mu[s] - 1).max(initial=0.0)
                for y, mu, s in zip(changed, whole.friction, found.slipping, strict=True)
            ]
            return changed if max(held) < AT_MOST else None
        dual = [np.where(s, y, y + along * (new - y)) for y, new, s in zip(dual, changed, found.slipping, strict=True)]
    return None


def _inside(dual: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """The dual, no longer than 0.99 of the friction."""
    return dual * np.minimum(1.0, 0.99 * friction / np.maximum(length(dual), TINY))


def _reach(dual: np.ndarray, step: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """How far each may go along the step within its friction disc, (n,)."""
    a, b, c = inner(step, step), inner(dual, step), np.maximum(friction**2 - inner(dual, dual), 0.0)
    return c / (b + np.sqrt(b * b + a * c) + TINY)
