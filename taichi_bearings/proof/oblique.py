"""Proof that one minimum exists close to given spins, where contact normals have any direction: theorem 7.

What is proven. The contacts that can dissipate are divided into S, which slip in the given spins, and T, which do not.
If the proof succeeds, T slips at no minimum, all minima have the same slips, and these are within a known distance of
the given ones. Contacts with damping alone belong to S, however slowly they slip.

Symbols
    N spheres, E contacts; S and T in array shapes stand for their numbers.
    n : number of unknowns, the components of the spins of free spheres; x a change of all of them.
    K : matrix (3 E, n) of slips: three components of the slip of each contact, linear in the unknowns.
    V : all spins at which no contact of T slips.
    y : slip of a contact. mu F_n : its friction limit. eta : its damping.
    r : torques that the friction at hand leaves over on free spheres.
    B : matrix whose square |B x|^2 is the curvature of the potential along x, for x in V.
    tau : proven lower bound of |B x|^2 / |x|^2, with each unknown in a unit of its own (curvature.Floor).
    to_v : bound on how far the slip of a contact is from its slip at some spins in V.
    loose : contacts of T that need not roll exactly; also the free spheres that no exactly rolling contact touches.

The proof
1. V is not empty, and some of its spins are close to the given ones. Where contacts of T set more conditions than their
   spheres have freedoms, all of them can rest only in motions in which they roll exactly; these are found in fractions
   (exact_motions.py), with a bound on the friction that these contacts need for torques. For the loose contacts and
   spheres an elimination proves that the rows of K are independent, with a number for each contact that says how large
   spins have to be to give it a slip (springs.floor_by_contact).
2. Within V the potential has one minimum close to these spins. Its curvature along x is |B x|^2, the sum over S of (mu
   F_n / |y|) (part of K x across y)^2 + eta |K x|^2, and elimination proves tau. Its slope along x is r . x + a . B x:
   r are the torques left over, and the vector a comes from the angle between the given friction and the slip in V.
   Friction resists a change by at least 0.72 of its curvature while no slip changes by more than a quarter
   (curvature.py says why), damping by all of it. For any motion z, r . x = (B z) . (B x) + (r - B^T B z) . x. So the
   potential rises wherever |B x| exceeds (|B z| + |r - B^T B z| / tau^1/2 + |a|) / 0.72, and the minimum is closer than
   that. (This B is that at the nearest spins in V; a factor covers its difference from the B of the given spins.) If z
   is a step of Newton's method, hardly any torque is left to be divided by tau: stiff contacts balance most of r.
3. This minimum in V is a minimum over all spins, if friction of T, within its limits, balances the torques of S. The
   friction of S at the minimum is known closely. The potential has no slope within V, so the torques that the given
   friction leaves over are balanced by some correction on T, which has two parts. The loose spheres touch loose
   contacts only, whose rows of K there are independent: so the correction on these is at most unit |torques| / floor.
   Its torques on the other spheres are added to those there. The sum is orthogonal to each motion that rolls exactly,
   as loose spheres can join any such motion without slip. So the exactly rolling contacts can balance it, with at most
   |unit torques| / s (exact_motions.py, step 4). If |given friction| + correction stays below mu F_n at each contact
   of T, this is optimal friction below its limit, and T slips at no minimum (theorem 4). So all minima are in V, where
   there is one.

Example. A free ball touches one driven ball at which it rolls (T, mu F_n = 3) and another one along which it slips with
|y| = 1 (S, mu F_n = 1). The contact of T leaves the ball one freedom: to turn about the normal of T. This motion x
changes y; the curvature is the square of that change across y, times mu F_n / |y| = 1, which gives tau. If S exerts the
friction 1 along y, and the torque of S about the normal of T is 0, the spins are those of the minimum in V. The
friction on T that balances the rest of the torque of S has size 1, below 3: the ball rolls on T at every minimum.

If the proof fails with the given spins, Newton's method improves spins and friction of T for a second try, until all
torques balance. Each step finds more digits of sums of two doubles. Nothing about it has to be proven, since the proof
starts from whatever spins come out.

Steps 2 and 3 are in centre.py. Where some contacts slip so slowly that their stiffness mu F_n / |y| leaves nothing but
rounding of softer motions, step 2 takes other unknowns (among_motions.py).
"""

from __future__ import annotations

import numpy as np

from taichi_bearings.proof.among_motions import CentreAmongMotions
from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.centre import Centre, LooseFloor
from taichi_bearings.proof.enclosure import UP, length
from taichi_bearings.proof.exact_motions import ExactMotions
from taichi_bearings.proof.springs import floor_by_contact, numbered

# A contact is put into S if its slip over the fastest imposed component exceeds the first number; or the second one, if
# its friction misses its limit by no more than the third share. A wrong choice only makes the proof fail.
MOVING, SLOWLY_MOVING, NOT_AT_LIMIT = 1e-10, 1e-22, 1e-9
# slip over the fastest imposed component, below which coordinates of its own for each slow contact are tried first
SLOW_SLIP = 3e-11


@np.errstate(all="ignore")  # what is not finite proves nothing
def enclosed_minimum(bounds: Bounds) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Prove which contacts slip at the minima, and how far their slips are from the stored ones. Return None if nothing
    is proven, else three arrays:

    1. slides : (E,) mask of contacts that may slip. Every other contact that can dissipate is proven to rest at every
       minimum.
    2. distance : (E,), for the contacts of `slides` a bound on |slip at any minimum - stored slip|, in units of the
       network; 0 for others. So a contact of `slides` slips at every minimum if it has friction, or if its stored slip
       is larger than this bound.
    3. proven : (R,) mask of the samples for which `slides` and `distance` hold; nothing is said of the others.

    bounds : the network of R samples of a packing with E contacts in all, and its friction, in which forces of
        fictitious springs at the contacts have balanced all torques. Several samples are treated as one network that
        falls into separate parts. Then only the stored spins are tried; for a single sample also spins improved by
        Newton's method."""
    network, unknown = bounds.network, bounds.unknown
    longest = np.linalg.norm(network.graph.normal, axis=1).max(initial=0.0)  # the proof takes normals for unit vectors
    if unknown is None or not longest < UP:
        return None
    # Guess which contacts slip (S) and which rest (T), find the motions in which contacts of T roll exactly,
    # and prove that the slips of the loose contacts, the others of T, are independent.
    at_limit = bounds.size.value >= (1 - NOT_AT_LIMIT) * network.friction_limit.value
    least = np.where(at_limit, SLOWLY_MOVING, MOVING) * network.largest_imposed.max()
    moves = (network.slip.value > least) | (network.friction_limit.high == 0)
    slides, number = network.counts & moves, numbered(unknown)
    slipping, resting = np.flatnonzero(slides), np.flatnonzero(network.counts & ~slides)
    exact = ExactMotions.of(network, number, network.counts & ~slides)
    loose = network.counts & ~slides & ~exact.contacts  # contacts that need not roll exactly
    loose_floor, loose_unit = floor_by_contact(network, numbered(~exact.spheres[:, None] & (number >= 0)), loose)
    if not (loose_floor > 0).any():
        return None
    holds_loose = LooseFloor(np.sqrt(loose_floor) / UP, loose_unit)
    given = Centre(network, exact, holds_loose, number, slipping, resting, network.spin, bounds.friction)
    centre, distance, proven = _proven_near(given)
    if not proven.any():
        return None
    # `distance` is from the slips of `centre`, which may be improved spins: add how far these are from the given ones.
    moved = [a - b for a, b in zip(network.slips(network.spin), centre.slips, strict=True)]
    distances = np.zeros(len(slides))
    distances[slipping] = (distance + length(moved).most[slipping]) * UP
    return slides, distances, proven


def _proven_near(given: Centre) -> tuple[Centre, np.ndarray, np.ndarray]:
    """Return spins near which a minimum is proven; for each of S slipping contacts a bound (S,) on |slip at the minimum
    - slip at these spins|; and the mask (R,) of the samples for which this is proven.

    given : the stored spins of R samples. For R = 1 spins improved by Newton's method are tried next. If these fail,
        too, or some slips are tiny, spins improved among the motions in which contacts roll exactly are tried.
    """
    if given.network.count > 1:
        return given, *given.proven_distance()
    among_motions = CentreAmongMotions.of(given)
    if among_motions is None or not given.slowest < SLOW_SLIP * float(given.network.largest_imposed.max()):
        for improves in (False, True):
            centre = given.improved() if improves else given
            distance, proven = centre.proven_distance()
            if proven.any() or (improves and among_motions is None):
                return centre, distance, proven
    assert among_motions is not None
    centre = among_motions.improved()
    return centre, *centre.proven_distance()
