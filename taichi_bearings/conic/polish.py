"""Finds the minimum of the power, in twice the precision of doubles, when it is known which contacts slip.

Slips can be 1e-15 of the imposed jump and less, which is below the rounding of spins. To prove that they are slips, and
not rounding, spins have to be far more precise. Here the spins across contacts that do not slip are made exactly equal;
the spins that are left are sums of two doubles (a Pair). Newton's method, whose matrix needs no such precision, goes on
until torques balance to some 1e-30 of the friction.

Letters: n contacts that are left, with up to d slip components; one array holds all samples, one after the other.
"""

import numpy as np

from taichi_bearings.conic.central_path import friction_stiffness
from taichi_bearings.conic.cones import length
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.double_double import (
    Pair,
    add,
    along,
    exactly,
    scaled,
    subtract,
    two_sum,
)

MOST_POLISHING_STEPS = 20  # most Newton steps
# Newton steps end when the largest torque, over the largest friction, is below POLISHED_TORQUE; or below SMALL_TORQUE
# and SMALL_SHARE_OF_SLIP times the smallest slip. A torque changes slips by some multiple of itself, so that slips then
# have about all digits of a double.
POLISHED_TORQUE, SMALL_TORQUE, SMALL_SHARE_OF_SLIP = 1e-31, 3e-27, 1e-17
MATRIX_CHANGE = 1e-2  # change of a slip by a step over the slip, above which the matrix is factorised anew
FREE_STIFFNESS = 1e-20  # stiffness along a slip over that across it, for motions that nothing else resists
MOST_SLIP_CHANGE = 0.5  # largest change of a slip by a step over the slip; beyond it the sample has failed
SUM_BITS = 20  # bits that 2^20 numbers of one size may need in a sum without rounding
Strengths = tuple[np.ndarray, np.ndarray | None]  # friction and viscosity, (n,) each


def polished(
    tied: Contraction,
    matrix: NewtonMatrix,
    strengths: Strengths,
    spins: Pair,
    chosen: np.ndarray,
    factorised: np.ndarray,
) -> tuple[Pair, np.ndarray, np.ndarray, np.ndarray]:
    """Return spins, slips and forces near the given spins at which all torques balance in twice the precision.

    tied : the n contacts that slip, with up to d slip components, over the sets of spins that the other contacts tie
        together.
    matrix : Newton matrix of the system `tied.system`.
    strengths : friction and viscosity (n,) of these contacts; no viscosity: None.
    spins : (sets of tied spins,), where to begin, sums of two doubles.
    chosen : (samples,) mask of the samples to try.
    factorised : (samples,) mask of the samples whose matrix is factorised at spins close to the given ones.
    returns : spins (unknowns,) of the whole system as sums of two doubles; slips (d, n); minus the friction forces (d,
        n); and a mask (samples,) of the chosen samples in which that succeeds and no slip has become 0.
    """
    system = _PreciseSystem(tied)
    # low parts of the given spins may be larger than the rounding of the high ones; two_sum makes them smaller
    balanced, slips, friction, fine = _balanced(system, matrix, strengths, two_sum(*spins), chosen, factorised)
    return tied.expanded(balanced), slips, -friction, fine


def _balanced(
    system: "_PreciseSystem",
    matrix: NewtonMatrix,
    strengths: Strengths,
    unknown: Pair,
    going: np.ndarray,
    factorised: np.ndarray,
) -> tuple[Pair, np.ndarray, np.ndarray, np.ndarray]:
    """Reduce the torques by Newton's method as far as that goes, and return the best point.

    system : computes slips and torques in twice the precision.
    matrix : Newton matrix of the contacts that are left.
    strengths : friction and viscosity, (n,) each, of n contacts; no viscosity: None.
    unknown : (unknowns,), spins to begin with, as sums of two doubles.
    going : (samples,) mask of the samples to try.
    factorised : (samples,) mask of the samples whose matrix is factorised at unknowns close to `unknown`.
    returns : the unknowns there, as sums of two doubles; slips and forces of friction (d, n), in doubles; and a mask
        (samples,) of the samples in which the method works and no slip is 0.
    """
    owners, strongest = system.owners, system.owners.largest(strengths[0])
    best, works, least = unknown, np.zeros_like(going), np.full(len(going), np.inf)
    slips, friction = np.zeros((2, *system.contracted.offset.shape))  # those at `best`
    for _ in range(MOST_POLISHING_STEPS):
        # Slips, forces and the largest torque of each sample at this point, which is kept if it is the best so far.
        precise = system.differences(unknown)
        slip = length(precise[0])
        held = _friction_along(strengths[0], precise)
        torques = system.torques(held if strengths[1] is None else add(held, scaled(strengths[1], precise)))
        size, smallest = owners.largest_of_spins(np.abs(torques)), owners.smallest(slip)
        going = going & (size < least) & (smallest > 0)
        best, works = _where(going[owners.spins], unknown, best), works | going
        slips, friction = _where(going[owners.contacts], (precise[0], held[0]), (slips, friction))
        # Samples go on while torques are more than halved and are not yet negligible.
        enough = np.maximum(POLISHED_TORQUE, np.minimum(SMALL_TORQUE, SMALL_SHARE_OF_SLIP * smallest)) * strongest
        going = going & (size <= least / 2) & (size > enough)
        if not going.any():
            break
        # A Newton step. It fails if the matrix is singular, or if a slip would change too much.
        least, anew, stepping = np.where(going, size, least), going & ~factorised, going
        if anew.any():
            stiffness = friction_stiffness(*strengths, precise[0], FREE_STIFFNESS)
            going = going & (matrix.factorise_each(stiffness, anew) | ~anew)
        step = matrix.solve(-torques, going)
        change = owners.largest(length(system.contracted.change(step)) / slip)
        going = going & (change <= MOST_SLIP_CHANGE)
        works, factorised = works & (going | ~stepping), change < MATRIX_CHANGE
        unknown = _where(going[owners.spins], add(unknown, exactly(step)), unknown)
    return best, slips, friction, works


class _PreciseSystem:
    """Slips and torques of a system with tied contacts, in twice the precision. A contact is tied if the spins at its
    two ends are made equal, as one unknown; n contacts with up to d slip components are left.

    contracted : the contacts that are left; its unknowns are sets of tied spins.
    owners : the sample of each unknown and of each contact.
    imposed : pair that says where, in (d, n), imposed spins contribute to the slips, as two arrays of indices; and how
        much, as sums of two doubles.
    """

    def __init__(self, tied: Contraction) -> None:
        """Find where imposed spins contribute to the slips of the contacts that are left.

        tied : the contacts that are left when others were tied, and their unknowns, one for each set of tied spins.
        """
        self.contracted, self.owners = tied.system, tied.owners
        places, rest = np.nonzero(tied.system.offset), tied.system.offset_rest
        high = tied.system.offset[places]
        self.imposed = places, (exactly(high) if rest is None else (high, rest[places]))

    def differences(self, unknown: Pair) -> Pair:
        """Return the slips (d, n) as sums of two doubles.

        unknown : (unknowns,), values of the unknowns, sums of two doubles.
        """
        assert self.contracted.ends is not None
        # Differences of the unknowns at both ends, with 0 for an imposed spin (-1); then add what those contribute.
        (below, above), (places, contribution) = self.contracted.ends, self.imposed
        high, low = (np.append(part, 0.0) for part in unknown)
        upper, lower = ((high.take(end), low.take(end)) for end in (above, below))
        found = subtract(upper, lower)
        driven = add((found[0][places], found[1][places]), contribution)
        for whole, part in zip(found, driven, strict=True):
            whole[places] = part
        return found

    def torques(self, pulls: Pair) -> np.ndarray:
        """Return the torques (unknowns,) of forces (d, n), rounded only once they have cancelled.

        pulls : forces on n contacts with up to d slip components, sums of two doubles. Their leading bits, multiples of
            one unit in each sample, are summed without any rounding, then the bits that follow, then the rest.
        """
        total, rest = np.zeros(self.contracted.unknowns), pulls[0]
        largest = self.owners.largest(np.abs(rest))
        for _ in range(2):
            grain = np.ldexp(1.5, np.frexp(largest)[1] + SUM_BITS)[self.owners.contacts]
            leading = (rest + grain) - grain  # `rest` rounded to a multiple of the last bit of `grain`
            total = total + self.contracted.torques(leading)
            rest = rest - leading
            largest = largest * 2.0 ** (SUM_BITS - 52)
        found: np.ndarray = total + self.contracted.torques(rest + pulls[1])
        return found


def _friction_along(friction: np.ndarray, difference: Pair) -> Pair:
    """Return friction times the direction of the slip, (d, n), as sums of two doubles; exact where the slip has one
    component only.

    friction : (n,), largest friction force of each of n contacts.
    difference : (d, n), slips with up to d components, as sums of two doubles.
    """
    found = exactly(friction * np.sign(difference[0]))
    both = np.flatnonzero((difference[0] != 0).all(axis=0))
    if len(difference[0]) == 2:
        high, low = (part.take(both, 1) for part in difference)  # many times as fast as an index
        for whole, part in zip(found, along(friction[both], (high, low)), strict=True):
            for row, values in zip(whole, part, strict=True):
                row[both] = values
    return found


def _where(mask: np.ndarray, one: Pair, other: Pair) -> Pair:
    """Return two arrays: the numbers of the two arrays `one` where `mask` is True, and those of `other` elsewhere. All
    have the shape of `mask`, or one more axis before it."""
    if mask.all():
        return one
    return np.where(mask, one[0], other[0]), np.where(mask, one[1], other[1])


__all__ = ["polished"]
