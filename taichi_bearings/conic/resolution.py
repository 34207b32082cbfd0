"""The exact minimum, from a point near the end of the central path: which contacts slip, to the last decade of slip.

On the central path slip times friction margin is the same for all contacts, so a slip of 1e-9 can be seen only where
margins of 1e-9 can, and double precision ends before. Here

1. contacts that surely stick are tied and the path goes on in the few unknowns that are left, until every contact is
   decided (contracted_path.py);
2. with all slipless contacts tied the power is a smooth function, and Newton's method finds its minimum, in the end in
   twice the precision (polish.py);
3. the tied contacts have to bear what the slipping ones leave to them (slipless_forces.py). If they can, the contact
   states are those of a minimum; whether that is proven is for the verifier to say;
4. if they cannot, some were tied wrongly: a contact that slips by 1e-12 cannot be told from one that holds until its
   neighbours are. Then a motion is known that lowers the power. It is followed to the least power on its way, and all
   begins anew from there with the contacts that move in it free, and slips in units of theirs.
"""

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.central_path import Iterate, friction_stiffness
from taichi_bearings.conic.cone import inner, length
from taichi_bearings.conic.contact_system import placed
from taichi_bearings.conic.contracted_path import ContractedPath, precise
from taichi_bearings.conic.contraction import Contraction, Contradiction
from taichi_bearings.conic.motion import Motion, largest_parts
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.polish import polished
from taichi_bearings.conic.slipless_forces import bear
from taichi_bearings.numerics.cholesky import NotPositiveDefinite, Part
from taichi_bearings.numerics.double_double import Pair

SAME, NEAR = 1e-12, 1e-6  # how far the power may be above and below that of the path, relative
TRIALS = 40  # rounds of Newton's method and proof
STEPS, BALANCED = 60, 1e-12  # steps of Newton's method, and torques, of the mean friction, that end it
ROUGHLY = 1e-4  # torques that will do if double precision ends before
NEWTON_TRIALS = 30  # of Newton's method, with contacts tied that come to rest
COLLAPSED = 1e-2  # share of its first slip below which a contact comes to rest if the next step would turn it round
LOST = 1e-25  # slip that double precision cannot follow: of a contact if Newton's method fails, or of a whole motion
NEGLIGIBLE = 1e-15  # slip of a motion from which on the contact states count as settled, though not as proven
START = 0.1  # product of slip and margin from which the contacts of a motion are followed, in units of their slip
SHARE = 1e-3  # of the largest slip of a motion: what slips less is left for later
HARDLY = 1e-14  # stiffness along a slip, of that across it, that keeps matrices regular
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Resolved:
    """spins (unknowns,); a group each: difference and dual (d, n), minus the forces, and slipping (n,).

    The differences are more precise than those of the spins, whose rounding can be a part of the smallest slips, unless
    `rest` (unknowns,), what is to be added to the spins, makes up for it. borne : slipless contacts bear their load.
    """

    spins: np.ndarray
    difference: list[np.ndarray]
    dual: list[np.ndarray]
    slipping: list[np.ndarray]
    rest: np.ndarray | None = None
    borne: bool = False


def resolve(iterate: Iterate, tied: list[np.ndarray], parts: list[Part], top: Pair) -> Resolved | None:
    """Spins, forces and contact states at the minimum; None if they cannot be had in double precision.

    iterate : near the end of the central path; not changed. tied : (n,) mask a group, contacts that surely stick.
    parts : of its system. top : (C,), imposed on the top, in twice the precision.
    """
    settled = None
    with np.errstate(all="ignore"):  # what fails shows up as a number that is not finite and is discarded
        try:
            path = ContractedPath(iterate, parts, tied)
            for _ in range(TRIALS):
                found = _minimum(iterate, parts, path, top) if path.decide() else None
                if found is None:
                    break
                borne = bear(iterate.system, parts, iterate.friction, found.dual, found.slipping)
                if isinstance(borne, list):
                    settled = replace(found, dual=borne, borne=True)
                    break
                if borne is None:
                    break
                motion, unit = largest_parts(borne, iterate.system, iterate.friction, found.difference, SHARE)
                settled = replace(found, dual=iterate.dual) if unit < NEGLIGIBLE else None
                if unit < LOST:
                    break
                path = _freed(iterate, parts, found, motion, unit)
        except (NotPositiveDefinite, Contradiction):
            pass
    if settled is None or not -NEAR < _power(iterate, settled.difference) / iterate.power - 1 < SAME:
        return None
    return settled


def _power(iterate: Iterate, difference: list[np.ndarray]) -> float:
    return sum(float(mu @ length(z)) for mu, z in zip(iterate.friction, difference, strict=True))


def _minimum(whole: Iterate, parts: list[Part], path: ContractedPath, top: Pair) -> Resolved | None:
    """The least power if just the contacts that slip at the end of the path do."""
    none = [np.zeros_like(y) for y in whole.dual]
    difference = [placed(z, kept, now) for z, kept, now in zip(none, path.kept, path.point.difference, strict=True)]
    slipping = [placed(z[0] > 0, kept, mask) for z, kept, mask in zip(none, path.kept, path.slipping, strict=True)]
    for _ in range(NEWTON_TRIALS):
        found = _newton(whole, parts, path.spins, difference, slipping, top)
        if isinstance(found, Resolved):
            return found
        if not any(at_rest.any() for at_rest in found):
            return None
        slipping = [s & ~at_rest for s, at_rest in zip(slipping, found, strict=True)]
    return None


def _newton(
    whole: Iterate,
    parts: list[Part],
    spins: np.ndarray,
    tracked: list[np.ndarray],
    slipping: list[np.ndarray],
    top: Pair,
) -> Resolved | list[np.ndarray]:
    """Newton's method on the power of the slipping contacts, all others tied. The minimum, or if that fails masks (n,)
    of contacts that come to rest: between spheres that others tie, or that the next step would turn round.

    tracked : (d, n) a group, differences that are more precise than those of the `spins`.
    """
    last = Contraction(whole.system, parts, [~s for s in slipping])
    system, spins = last.system, last.contracted(spins)
    friction = [mu[kept] for mu, kept in zip(whole.friction, last.kept, strict=True)]
    difference = [precise(g, spins, z[:, kept]) for g, z, kept in zip(system.groups, tracked, last.kept, strict=True)]

    def everywhere(values: list[np.ndarray]) -> list[np.ndarray]:
        return [
            placed(np.zeros((*new.shape[:-1], len(s)), new.dtype), kept, new)
            for s, kept, new in zip(slipping, last.kept, values, strict=True)
        ]

    at_rest = [length(z) == 0 for z in difference]
    if any(still.any() for still in at_rest):
        return everywhere(at_rest)
    dual = [-mu * z / length(z) for mu, z in zip(friction, difference, strict=True)]
    matrix, first = NewtonMatrix(system, last.parts), [length(z) for z in difference]
    for count in range(STEPS):
        torques = system.torques(dual)
        left = float(np.abs(torques).max(initial=0.0))
        if left < (BALANCED if count < STEPS - 1 else ROUGHLY):
            better = polished(last, matrix, friction, spins, difference, top)
            if better is None:
                return Resolved(last.expanded(spins), everywhere(difference), everywhere(dual), slipping)
            (high, low), difference, dual = better
            return Resolved(high, everywhere(difference), everywhere(dual), slipping, low)
        matrix.factorise([friction_stiffness(mu, z, HARDLY) for mu, z in zip(friction, difference, strict=True)])
        step = matrix.solve(torques)
        steps = [g.change(step) for g in system.groups]
        at_rest = [
            (inner(z + dz, z) <= 0) & (length(z) < COLLAPSED * slip)
            for z, dz, slip in zip(difference, steps, first, strict=True)
        ]
        if any(still.any() for still in at_rest):
            return everywhere(at_rest)
        change = max(float((length(dz) / length(z)).max(initial=0.0)) for dz, z in zip(steps, difference, strict=True))
        along = min(1.0, 0.5 / max(change, TINY))
        spins = spins + along * step
        difference = [z + along * dz for z, dz in zip(difference, steps, strict=True)]
        dual = [-mu * z / length(z) for mu, z in zip(friction, difference, strict=True)]
    return everywhere([length(z) < LOST for z in difference])


def _freed(whole: Iterate, parts: list[Part], found: Resolved, motion: Motion, unit: float) -> ContractedPath:
    """A path that begins at the end of the motion, its contacts free. unit : the largest slip among them."""
    free = [s | m for s, m in zip(found.slipping, motion.slipping, strict=True)]
    difference = [
        np.where(f, z + g.change(motion.spins), 0.0)
        for f, z, g in zip(free, found.difference, whole.system.groups, strict=True)
    ]
    point = Iterate.near(whole.system, found.spins + motion.spins, whole.friction, difference, START * unit)
    return ContractedPath(point, parts, [~f for f in free], motion.slipping, unit)
