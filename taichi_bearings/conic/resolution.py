"""Finds which contacts slip at the exact minimum, from a point near the end of the central path.

What is decided. The power of the contacts, the sum of mu |v| over all contacts, is to be least. At a minimum each
contact either slips (v is not 0) or does not (v = 0). The central path (central_path.py) comes near the minimum, but at
each of its points all contacts slip a little: the product mu b - v . f, with a bound b of the slip speed, is the same
for all, and it is about mu times slip speed times friction margin. Let this product be 1e-14, near the end of double
precision. A contact that slips by 1e-9 at the minimum then has the margin 1e-5; a contact that does not slip there, and
has this margin, has the slip 1e-9 on the path: both look alike. This module decides for every contact, and returns
spins, slips and forces of the minimum (:class:`Resolved`).

Symbols (all words are in conic/__init__.py).

============  ========================================================================================
u             spins of the free spheres, the unknowns (unknowns,)
v = K u + v0  slip of each contact, (d, n): linear in the spins; v0 comes from the driven spheres
mu            largest friction force of each contact, (n,), in units of their mean
f             friction force of each contact, (d, n); `dual` in the code is -f
margin        1 - |f| / mu, the share of its friction that a contact does not use
S             the contacts that slip
n, d          number of contacts, and most slip components that one of them has (1 or 2)
============  ========================================================================================

Theorem used (optimality of a convex function; Rockafellar, Convex Analysis, 1970, section 27). Spins are a minimum
exactly if there are forces f such that

(a) all torques balance: K^T f = 0;
(b) each slipping contact has f = mu v / |v|, all its friction along its slip;
(c) each other contact has |f| <= mu.

So it is enough to guess S, and to check. *Tie* every contact outside S: make the spins at its two ends equal, so v = 0.
(In this file *tied* means that alone; contacts that slip at some minima and rest at others, which other files call
tied, are `sometimes_slips` here.) Then the power is a smooth function of the spins that are left. At its minimum (b)
holds, and (a) holds for each set of equal spins as a whole. What remains is (c): are there forces within friction at
the tied contacts that balance the torques inside these sets? If there are, all of (a) to (c) hold, and the guess was
right; how it was made does not matter. (All this is in floating point, so torques and friction are checked up to about
1e-9; taichi_bearings/proof makes it rigorous. With a viscosity eta each contact adds eta |v|^2 / 2 to the power, and
has the force eta v besides; nothing else changes.)

Example: three contacts in a row with frictions 3, 1, 2, the first end at rest, the last one driven by a jump of 4. On
the path the middle contact has nearly no margin and slips by nearly 4. With the others tied its slip is 4 and its force
1. The tied contacts have to bear that force, and 1 is below 3 and 2: so the least power is 1 * 4.

Steps of :func:`resolve`.

1. Guess S from the last two points of the path (:func:`_seem_to_stick`), in small samples only: in large ones the guess
   is nearly always wrong for some contact. It mostly is, too, where there may be several minima; there the guess is
   made after step 4, if that fails.
2. Find the minimum of the smooth power by Newton's method (:class:`_SmoothPower`). If a step would reverse a slip, the
   step is shortened, or the contact leaves S if its slip is less than a hundredth of its first one. The last Newton
   steps are in twice the precision (polish.py), as slips go down to 1e-15 of the jump and below.
3. Look for the forces (c) (slipless_forces.py); after step 1 by two methods, since forces may exist although the
   quicker one fails. If they are found and every slip is clearly more than rounding, the sample is done.
4. Else, if the path has ended or there may be several minima, follow it on until it is clear which contacts slip
   (last_decades.py), and repeat steps 2 and 3, up to four times with different contacts tied
   (:func:`_minimum_along_path`).
5. Refuse a minimum whose power differs from that of the path. If its states are sure and there is no viscosity, find
   contacts that slip at some minima and rest at others (ties.py).
"""

from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from taichi_bearings.conic.central_path import LEAST_WORK, friction_stiffness
from taichi_bearings.conic.cones import inner, length
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.iterate import Iterate, whole_dual
from taichi_bearings.conic.last_decades import LastDecades
from taichi_bearings.conic.newton_matrix import MOST_NEWTON_STEPS, NewtonMatrix
from taichi_bearings.conic.polish import polished
from taichi_bearings.conic.slipless_forces import (
    balanced_by_barrier,
    balanced_inside,
    may_have_several_minima,
    nearly_borne,
)
from taichi_bearings.conic.ties import sometimes_slipping
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.double_double import Pair, exactly

# Numbers below without a reason were found by trial. A bad guess of S costs a further trial; what is found is proven
# elsewhere (taichi_bearings/proof).
# The power of a minimum, over that of the path, may exceed 1 by MOST_ABOVE_PATH, as sums over 1e5 contacts round by
# about 1e-12; it may be less than 1 by MOST_BELOW_PATH, as paths that come here have relative gaps of at most 1e-8.
MOST_ABOVE_PATH, MOST_BELOW_PATH = 1e-12, 1e-6
DECIDED_RATIO = 1e2  # a contact seems to stick only if its margin is larger than its slip by more than this factor
# It seems to stick if a step has left less than this share of its slip and more than this share of its margin. A step
# leaves about a fifth of the slip of a contact that sticks, and of the margin of one that slips.
STICKING_TREND = 0.6
# It also seems to stick if its slip is below NOISY_SLIP, in units of the jump, which is hardly more than the rounding
# of the spins, some 1e-13, and its margin is above WIDE_MARGIN.
NOISY_SLIP, WIDE_MARGIN = 1e-11, 0.1
# share of the contacts with friction that may be undecided when the trials of `_minimum_along_path` begin, and bounds
# on the number of contacts that this share allows
DOUBTFUL_SHARE = 1e-2
LEAST_DOUBTFUL, MOST_DOUBTFUL = 30, 300
FEW_DOUBTFUL = 3  # number of contacts that may be undecided in the early trials, made if the minimum is likely unique
# With so many unknowns contacts are tied from the start of the last decades: with fewer the analysis of a further
# pattern takes as long as smaller matrices save (18^3 1.15, 24^3 1.00, 32^3 0.91 of the time).
TIED_UNKNOWNS = 30_000
# Then a contact is tied if its margin is above TIED_MARGIN and changed by less than a share TIED_SHARE of itself in the
# last step of the path, and if its slip is below TIED_SHARE times the margin. In 32^3 spheres, seed 2, with slips down
# to 5e-15, this ties no slipping contact from a relative gap of 4e-10 on, and three quarters of the others.
TIED_MARGIN, TIED_SHARE = 1e-2, 1e-2
# Most of these trials, and the most sets of tied spins over spins in one: with more sets two trials take as long as the
# path without ties. After trial number k contacts are untied whose force may change by fewer than UNTIED_STEPS ** k
# steps to balance, in the clusters of spheres where no forces balance.
TIED_TRIALS, MOST_SETS, UNTIED_STEPS = 8, 0.4, 4.0
# Newton's method ends when the largest torque over the mean friction is below NEWTON_TORQUE, some 1e4 roundings of a
# force; after its last step a torque below ROUNDED_TORQUE is accepted.
NEWTON_TORQUE, ROUNDED_TORQUE = 1e-12, 1e-4
# change of a slip by a Newton step over the slip, below which the next step may use the same matrix
KEPT_MATRIX_CHANGE = 1e-4
# Runs of Newton's method; before each but the first, contacts that have come to rest are tied. The second number is for
# large systems with an order of elimination of their own.
NEWTON_TRIALS, LARGE_NEWTON_TRIALS = 2, 5
# largest change of a slip by a Newton step over the slip, if the whole step does not reverse the slip, and if it does
MOST_CHANGE_ALONG, MOST_CHANGE_IF_REVERSED = 0.5, 0.95
RESTING_SHARE = 1e-2  # share of its first slip below which a contact comes to rest if the next step would reverse it
# Slips above these, over the imposed jump, are surely no rounding: spins known in twice the precision, and in doubles.
# (10^3 spheres, seed 559, has a slip in between, which is decided only when spins are known in twice the precision.)
LEAST_SLIP_IN_PAIRS, LEAST_SLIP_IN_DOUBLES = 1e-22, 1e-9
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Resolved:
    """A minimum of one sample, of n contacts with up to d slip components: spins, slips, forces and contact states.

    spins : (unknowns,), spins of the free spheres.
    difference : (d, n), slips. They are more precise than slips computed from `spins`, whose rounding can be a part of
        the smallest slips, unless `rest` is added.
    dual : (d, n), minus the friction forces.
    slipping : (n,) mask of contacts that slip.
    at_limit : (n,) mask of contacts that do not slip and yet may bear all their friction.
    heads : (unknowns,) mask of one spin of each set of spins that slipless contacts tie together, without the sets that
        are tied to a driven plane. With these spins held the matrix of the slipless contacts is regular.
    rest : (unknowns,), low parts of the spins in twice the precision, spins + rest; None if these are not known.
    borne : True if forces within friction at the slipless contacts have been found that balance all torques.
    sometimes_slips : (n,) mask of contacts that slip at some minima and rest at others; None if not looked for.
    viscosity : (n,), viscous force over slip speed; None for friction alone.
    """

    spins: np.ndarray
    difference: np.ndarray
    dual: np.ndarray
    slipping: np.ndarray
    at_limit: np.ndarray
    heads: np.ndarray
    rest: np.ndarray | None = None
    borne: bool = False
    sometimes_slips: np.ndarray | None = None
    viscosity: np.ndarray | None = None

    @property
    def known_to_slip_sometimes(self) -> np.ndarray:
        """(n,) mask of the contacts that are known to slip at some minima and to rest at others; all False if not
        looked for."""
        return np.zeros_like(self.at_limit) if self.sometimes_slips is None else self.sometimes_slips

    @property
    def sure(self) -> bool:
        """True if the contact states can be expected to be proven: forces of the slipless contacts that balance all
        torques are known, and the smallest slip is larger than what rounding can make."""
        faintest = LEAST_SLIP_IN_DOUBLES if self.rest is None else LEAST_SLIP_IN_PAIRS
        return self.borne and length(self.difference)[self.slipping].min(initial=np.inf) > faintest

    @property
    def whole_dual(self) -> np.ndarray:
        """(d, n), minus the force of every contact, with its viscous part. Letters: n contacts with up to d slip
        components."""
        return whole_dual(self.dual, self.viscosity, self.difference)


@dataclass(frozen=True)
class Surroundings:
    """What the samples of one network share. Samples differ in the friction of their contacts alone.

    system : the contacts of one sample, as a function of its unknown spins.
    order : (unknowns,), numbers of the unknowns in the order in which a factorisation eliminates them.
    newton : Newton matrix of one sample, or of several at once; None where nothing has to be solved.
    """

    system: ContactSystem
    order: np.ndarray
    newton: NewtonMatrix | None

    @property
    def matrix(self) -> NewtonMatrix:
        """The Newton matrix: the field `newton`, where something has to be solved."""
        assert self.newton is not None
        return self.newton

    @cached_property
    def springs(self) -> NewtonMatrix:
        """The matrix of springs at the contacts, each of which resists every slip component alike. Such springs do not
        couple different spin components, so that in lattices with two it is a matrix of its own, which falls apart into
        planes: a factorisation takes a tenth of the operations (10^3), in large lattices a hundredth."""
        if self.system.ends is None or len(self.system.offset) == 1:
            return self.matrix
        return NewtonMatrix(self.system.by_rows(), self.order, self.matrix.memory, self.matrix.engine)

    def copies(self, samples: int) -> ContactSystem:
        """Return the contacts of several samples as one system, in which no contact joins two samples. It is kept for
        later calls, as samples are settled in groups of the same size.

        samples : number of samples.
        """
        if samples not in self._copies:
            self._copies[samples] = self.system.copies(samples)
        return self._copies[samples]

    @cached_property
    def _copies(self) -> dict[int, ContactSystem]:
        """What :meth:`copies` has returned, by the number of samples."""
        return {}

    @property
    def has_quick_springs(self) -> bool:
        """True if a factorisation of `springs` takes far less time than a Newton step, as in large lattices."""
        return self.matrix.is_costly and self.system.ends is not None


def resolve(
    iterates: Sequence[Iterate],
    before: Sequence[Iterate | None],
    shared: Surroundings,
    small: bool,
    last: Sequence[bool],
) -> list[Resolved | None]:
    """Return the minimum of each sample; None where double precision does not reach it. The result for a sample does
    not depend on the other samples, bit by bit.

    iterates : points near the end of the central path, one for each sample; not changed.
    before : the points one step before, None where unknown.
    shared : system, order of elimination and Newton matrix of all samples.
    small : True to guess the slipping contacts at first, from how slips and margins changed in the last step of the
        path; that is mostly right in small samples.
    last : for each sample True to follow its path on if the guess does not lead to a sure minimum. False if the caller
        makes a further trial later; then the path is followed only where there may be several minima.
    """
    shared.matrix.forget()  # the path is left, mostly for smaller matrices
    with np.errstate(all="ignore"):  # what fails shows up as a number that is not finite and is discarded
        # Steps 1 to 3: a guess, but not where there may be several minima, as it is hardly ever right there.
        several = [may_have_several_minima(iterate.friction, np.zeros(0, dtype=bool)) for iterate in iterates]
        found = _guessed(iterates, before, [small and not ties for ties in several], shared)
        for number, iterate in enumerate(iterates):
            # Step 4, for samples without a sure minimum; where it finds nothing, the guess that was left out before.
            quickly = found[number]
            sure = quickly is not None and quickly.sure
            if not sure and (last[number] or several[number]):
                with suppress(NotPositiveDefinite):
                    found[number] = _minimum_along_path(iterate, before[number], shared) or quickly
                if found[number] is None and several[number]:
                    (found[number],) = _guessed([iterate], [before[number]], [small], shared)
        shared.matrix.forget()
        # Step 5: compare with the power of the path, and look for ties.
        pairs = zip(iterates, found, strict=True)
        return [settled and _checked(iterate, settled, shared) for iterate, settled in pairs]


def _guessed(
    iterates: Sequence[Iterate], before: Sequence[Iterate | None], wanted: Sequence[bool], shared: Surroundings
) -> list[Resolved | None]:
    """Guess from the last two points of each path which contacts of a sample slip, and return the minimum in which the
    others rest; None where no guess is wanted or no such minimum is found.

    iterates : for each sample the last point of its path.
    before : the points one step before, None where unknown: then no guess is made.
    wanted : for each sample whether a guess is wanted.
    shared : the contact system of all samples, with its order of elimination and Newton matrix.
    """
    steps = zip(iterates, before, wanted, strict=True)
    slipping = [~_seem_to_stick(here, there) if own and there is not None else None for here, there, own in steps]
    minima = _smooth_minima(iterates, [exactly(iterate.spins) for iterate in iterates], slipping, shared)
    return _with_slipless_forces(iterates, minima, [iterate.dual for iterate in iterates], shared, persists=True)


def _checked(iterate: Iterate, settled: Resolved, shared: Surroundings) -> Resolved | None:
    """Return the minimum `settled` of one sample, completed by the mask of contacts that slip at some minima and rest
    at others; None if its power differs from that of the path, so that it cannot be a minimum.

    iterate : the point of the central path from which it was found.
    settled : the minimum.
    shared : what all samples share.

    The power of the path is above the least power. So the power of a minimum can exceed it by rounding only
    (MOST_ABOVE_PATH), and be less by the gap of the path (MOST_BELOW_PATH).
    """
    cost = replace(iterate, difference=settled.difference).cost
    if not -MOST_BELOW_PATH < cost / iterate.cost - 1 < MOST_ABOVE_PATH:
        return None
    # With viscosity at each contact all minima have the same slips; if only some have it, ties are not looked for.
    if not settled.sure or iterate.viscosity is not None:
        return settled
    of_minimum = settled.difference, settled.dual, settled.slipping, settled.at_limit
    sometimes_slips = sometimes_slipping(shared.system, shared.order, iterate.friction, *of_minimum)
    return replace(settled, sometimes_slips=sometimes_slips)


def _seem_to_stick(iterate: Iterate, before: Iterate) -> np.ndarray:
    """Return a mask (n,) of contacts that seem to stick. Either their slip is as small as rounding; or their margin,
    the share of friction that is left, is far above their slip, and in the last step of the path the slip fell while
    the margin did not.

    iterate : the point of the path after this step: slips, margins and forces of all n contacts.
    before : the point before this step.
    """
    slip, slip_before = length(iterate.difference), length(before.difference)
    apart = iterate.margin > DECIDED_RATIO * slip
    noisy = (slip < NOISY_SLIP) & (iterate.margin > WIDE_MARGIN)
    parting = (slip < STICKING_TREND * slip_before) & (iterate.margin > STICKING_TREND * before.margin)
    return apart & (noisy | parting)


def _clearly_stick(iterate: Iterate, before: Iterate) -> np.ndarray:
    """Return a mask (n,) of contacts that clearly stick: the margin is wide (TIED_MARGIN) and stayed in the last step;
    the slip is far below the margin (TIED_SHARE), and fell about as fast as the product of the path, or faster.

    This can be wrong before the last decades of the path: a contact that slips by less than a hundredth of the product
    seems to stick, as its margin begins to fall only later.

    iterate : the point of the path.
    before : the point one step before.
    """
    slip, margin = length(iterate.difference), iterate.margin
    falls = slip * before.complementarity < 2 * length(before.difference) * iterate.complementarity
    stays = np.abs(margin - before.margin) < TIED_SHARE * margin
    found: np.ndarray = falls & stays & (margin > TIED_MARGIN) & (slip < TIED_SHARE * margin)
    return found


def _minimum_along_path(iterate: Iterate, before: Iterate | None, shared: Surroundings) -> Resolved | None:
    """Return the minimum of one sample, found by following its central path on to the end of double precision; None if
    it is not found.

    iterate : the last point of the path.
    before : the point one step before, None if unknown.
    shared : what all samples share.

    Trials are made in turn up to the first one that is sure of the states of all contacts. A trial follows the path
    until it shows of most contacts whether they slip or stick (others are *undecided*), and then finds the minimum at
    which contacts that stick do not slip. Some contacts may be *tied* before: their two spins are made equal. All but
    the first trial begin where few contacts are undecided. There may be several minima where friction limits repeat.

    ============================  =====  ====================================  ===================================
    minima                        trial  tied contacts                         path followed until
    ============================  =====  ====================================  ===================================
    one, most likely              1      of large systems, those that seem to  FEW_DOUBTFUL contacts are undecided
                                         stick at the start; again with fewer
                                         where no forces balance
    one, most likely              2      none                                  FEW_DOUBTFUL contacts are undecided
    one, most likely              3      none                                  no contact is undecided
    one, most likely              4      those that stick                      no contact is undecided
    several, as frictions repeat  1      those that stick                      no contact is undecided
    several, as frictions repeat  2, 3   also those that stuck in trial 1, 2   double precision ends
    several, as frictions repeat  4      none                                  no contact is undecided
    ============================  =====  ====================================  ===================================

    Tying contacts leaves fewer unknowns (at 32^3 a matrix takes a third of the operations or less), and removes the
    large stiffnesses of contacts that stick, whose rounding hides the forces of the others. If no states are sure, the
    minimum of the last trial that has found one is returned.
    """
    path, settled = LastDecades.after(iterate, before, shared.matrix), None
    none = np.zeros(len(iterate.friction), dtype=bool)
    ties_possible = may_have_several_minima(iterate.friction, none)
    if shared.system.unknowns >= TIED_UNKNOWNS and before is not None and not ties_possible:
        with suppress(NotPositiveDefinite):
            settled = _minimum_with_few_unknowns(iterate, path, _clearly_stick(iterate, before), shared)
            if settled is not None and settled.sure:
                return settled
    if path.decide(int(min(max(DOUBTFUL_SHARE * iterate.in_cones, LEAST_DOUBTFUL), MOST_DOUBTFUL))) is None:
        return None
    sticking = path.sticking
    if not ties_possible:
        with suppress(NotPositiveDefinite):
            settled = _early_minimum(iterate, copy(path), shared) or settled
            if settled is not None and settled.sure:
                return settled
    # for each trial: (are contacts tied?, is the path followed to its end?)
    first, second, free = (True, False), (True, True), (False, False)
    for ties, to_the_end in (first, second, second, free) if ties_possible else (free, first):
        with suppress(NotPositiveDefinite):
            found, more_sticking = _minimum_with_tied(iterate, path, sticking if ties else none, shared, to_the_end)
            settled, sticking = found or settled, sticking | more_sticking if ties else sticking
        if settled is not None and settled.sure:
            break
    return settled


def _early_minimum(iterate: Iterate, path: LastDecades, shared: Surroundings) -> Resolved | None:
    """Follow the central path of one sample until it is decided of all but FEW_DOUBTFUL contacts whether they slip or
    stick, and guess the others by the trend, which saves steps of the path. Return the minimum for these states; None
    if no forces that balance are found, so that the guess may be wrong.

    iterate : the point from which `path` started.
    path : the point that was reached; it is followed on.
    shared : what all samples share.
    """
    slipping = path.decide(FEW_DOUBTFUL)
    if slipping is None:
        return None
    (found,) = _smooth_minima([iterate], [path.spins], [slipping], shared)
    (settled,) = _with_slipless_forces([iterate], [found], [path.point.dual], shared)
    return settled


def _minimum_with_few_unknowns(
    iterate: Iterate, path: LastDecades, sticking: np.ndarray, shared: Surroundings
) -> Resolved | None:
    """Return the minimum at the end of a path on which contacts are tied that clearly stick at its start; None if it is
    not found.

    The path says nothing about forces of the tied contacts, so these are found at its end, by a barrier method. Where
    no forces balance, contacts are tied that slip at the minimum, by so little that the start of the path did not show
    it. So contacts there are untied, from trial to trial more of them, and the path is followed again. If none of them
    is tied, it is followed until no contact is undecided.

    iterate : the point at which the path was begun.
    path : the point that was reached; not changed.
    sticking : (n,) mask of the contacts to tie.
    shared : what all samples share.
    """
    doubtful = FEW_DOUBTFUL
    for trial in range(TIED_TRIALS):
        if shared.system.pieces(sticking)[0] > MOST_SETS * len(iterate.spins):
            return None
        found, later, _ = _smooth_minimum_with_tied(iterate, path, sticking, shared, doubtful=doubtful)
        if found is None:
            return None
        start = np.where(found.slipping, found.whole_dual, later)
        of_system = shared.system, shared.order, iterate.friction
        dual, allowed = balanced_inside(*of_system, start, found.slipping, found.heads)
        if dual is not None:
            return replace(found, dual=np.where(found.slipping, found.dual, dual), borne=True)
        untied = sticking & (allowed < UNTIED_STEPS ** (trial + 1))
        if not (untied.any() or doubtful):
            return None
        sticking, doubtful = sticking & ~untied, FEW_DOUBTFUL if untied.any() else 0
    return None


def _minimum_with_tied(
    iterate: Iterate, path: LastDecades, sticking: np.ndarray, shared: Surroundings, to_the_end: bool
) -> tuple[Resolved | None, np.ndarray]:
    """Follow the central path on with some contacts tied (the spins across each of them are made equal), and find the
    minimum at its end.

    iterate : the point at which the path was begun.
    path : the point that was reached; not changed.
    sticking : (n,) mask of the contacts to tie.
    shared : what all samples share.
    to_the_end : True to follow the path until double precision ends, False until every contact is decided.
    returns : the minimum, None if there is none; (n,) mask of the further contacts that surely stick at the end.
    """
    # Forces of slipless contacts are sought near those at the end of the path; where there may be several minima, then
    # near those before contacts were tied, which can change forces a lot.
    found, later, more_sticking = _smooth_minimum_with_tied(iterate, path, sticking, shared, to_the_end)
    (settled,) = _with_slipless_forces([iterate], [found], [later], shared)
    if found is not None and settled is None and may_have_several_minima(iterate.friction, found.at_limit):
        earlier = np.where(found.at_limit | (path.point.slip_over_margin > 1), later, path.point.dual)
        (settled,) = _with_slipless_forces([iterate], [found], [earlier], shared)
    return settled, more_sticking


def _smooth_minimum_with_tied(
    iterate: Iterate,
    path: LastDecades,
    sticking: np.ndarray,
    shared: Surroundings,
    to_the_end: bool = False,
    doubtful: int = 0,
) -> tuple[Resolved | None, np.ndarray, np.ndarray]:
    """Follow the central path on with some contacts tied, and find the minimum of the smooth power at its end.

    iterate : the point at which the path was begun.
    path : the point that was reached; not changed.
    sticking : (n,) mask of the contacts to tie: the spins across each of them are made equal.
    shared : what all samples share.
    to_the_end : True to follow the path until double precision ends, False until it is clear whether contacts slip.
    doubtful : number of contacts for which that may stay unclear.
    returns : the minimum without forces of the slipless contacts, None if there is none; minus the forces (d, n) at the
        end of the path, for tied contacts those of `path`; (n,) mask of the further contacts that surely stick there.

    Letters: n contacts with up to d slip components.
    """
    none, later = np.zeros_like(sticking), path.point.dual.copy()
    tied = Contraction(shared.system, shared.order, sticking) if sticking.any() else None
    rest = path.over(tied) if tied else copy(path)
    left = None if tied and tied.contradicts.any() else rest.decide(doubtful, to_the_end)
    if left is None:
        return None, later, none
    # From the contacts that are not tied to all: which slip, which may be at their limit, and which stick at the end.
    slipping, at_limit, more_sticking, kept = none.copy(), none.copy(), none.copy(), tied.kept if tied else slice(None)
    slipping[kept], at_limit[kept], more_sticking[kept] = left, rest.at_limit, rest.sticking
    later[:, kept] = rest.point.dual
    spins, order = (tied.expanded(rest.spins), tied.order_of_spins) if tied else (rest.spins, None)
    (found,) = _smooth_minima([iterate], [spins], [slipping], shared, order)
    if found is not None and at_limit.any():  # so may be contacts that Newton's method has brought to rest
        found = replace(found, at_limit=(at_limit | slipping) & ~found.slipping)
    return found, later, more_sticking


def _with_slipless_forces(
    iterates: Sequence[Iterate],
    minima: Sequence[Resolved | None],
    near: Sequence[np.ndarray],
    shared: Surroundings,
    persists: bool = False,
) -> list[Resolved | None]:
    """Return for each sample its minimum, completed by forces of the slipless contacts: forces within friction that
    balance all torques together with those of the slipping ones. None for a sample that has no minimum, or for which no
    such forces are found.

    iterates : for each sample a point of the central path, of which only the friction limits are used.
    minima : for each sample its minimum or None.
    near : for each sample minus the forces (d, n) of n contacts with up to d slip components, near which forces are
        sought.
    shared : what all samples share: contacts and Newton matrix.
    persists : True to use a barrier method as well, where springs balance no forces and no slipless contact may bear
        all its friction.
    """
    settled: list[Resolved | None] = [None] * len(minima)
    some = [(number, found) for number, found in enumerate(minima) if found is not None]
    if some:
        # all samples together, by springs; then those for which that failed, by a barrier
        slipping, at_limit = (
            np.concatenate([getattr(found, of) for _, found in some]) for of in ("slipping", "at_limit")
        )
        dual = np.concatenate([np.where(found.slipping, found.whole_dual, near[n]) for n, found in some], axis=1)
        friction = np.concatenate([iterates[number].friction for number, _ in some])
        heads = [found.heads for _, found in some]
        duals, fine = nearly_borne(shared.system, shared.springs, friction, dual, slipping, at_limit, heads)
        left = ~fine & ~at_limit.reshape(len(some), -1).any(axis=1)
        if persists and left.any():
            of_barrier = balanced_by_barrier(shared.system, shared.matrix, friction, dual, slipping, heads, left)
            of_contacts = np.repeat(left, at_limit.size // len(some))
            duals, fine = np.where(of_contacts, of_barrier[0], duals), np.where(left, of_barrier[1], fine)
        for (number, found), whole, inside in zip(some, np.split(duals, len(some), axis=1), fine, strict=True):
            dual = np.where(found.slipping, found.dual, whole)
            settled[number] = replace(found, dual=dual, borne=True) if inside else None
    return settled


def _smooth_minima(
    iterates: Sequence[Iterate],
    spins: Sequence[Pair],
    masks: Sequence[np.ndarray | None],
    shared: Surroundings,
    order: np.ndarray | None = None,
) -> list[Resolved | None]:
    """Return for each sample the minimum of its power (spins, slips, friction) while only some contacts may slip and
    all others are tied; None where Newton's method does not find it.

    iterates : for each sample a point of the central path, of which the friction limits and viscosities are used.
    spins : for each sample (unknowns,) the spins to begin with, as sums of two doubles.
    masks : for each sample the mask (n,) of the contacts that may slip; None for a sample that is left out.
    shared : what all samples share.
    order : (unknowns,), order in which spins are eliminated, made for nearly the same tied contacts; None for that of
        the lattice.
    """
    found: list[Resolved | None] = [None] * len(iterates)
    # The samples that are tried: their numbers, the contacts that may slip, and the spins to begin with.
    slipping = [mask for mask in masks if mask is not None]
    numbers = [number for number, mask in enumerate(masks) if mask is not None]
    spins = [spins[number] for number in numbers]
    for _ in range((NEWTON_TRIALS if order is None else LARGE_NEWTON_TRIALS) if numbers else 0):
        trial = _SmoothPower([iterates[number] for number in numbers], slipping, shared, order)
        at_rest = trial.descend((np.concatenate([s[0] for s in spins]), np.concatenate([s[1] for s in spins])))
        for number, resolved in zip(numbers, trial.resolved(), strict=True):
            found[number] = resolved
        again = np.flatnonzero(trial.tied.owners.any(at_rest)).tolist()
        if not again:
            break
        # Samples in which contacts came to rest on the way are tried again from where they are, with these tied, too.
        whole, resting = trial.tied.expanded(trial.spins), trial.everywhere(at_rest)
        high, low = (part.reshape(len(numbers), -1) for part in whole)
        spins = [(high[sample], low[sample]) for sample in again]
        slipping = [trial.slipping[sample] & ~resting[sample] for sample in again]
        numbers = [numbers[sample] for sample in again]
    return found


class _SmoothPower:
    """Minimises the power of some samples by Newton's method while all contacts that do not slip are *tied*: their slip
    is held at zero, and all spins that they join become one unknown. The power of the other contacts, `kept` in number
    in all samples together, is a smooth function of the unknowns that are left.

    iterates : for each sample a point of the central path, of which friction limits and viscosities are used.
    samples : number of samples.
    slipping : for each sample a mask (n,) of its n contacts, True for those that are left. That may be fewer than were
        asked for, as tied contacts can keep others from slipping.
    tied : the system of the contacts that are left, over the unknowns that are left.
    matrix : second derivative of the power by these unknowns, factorised sample by sample.
    friction : (kept,), friction limits, all samples one after the other.
    viscosity : (kept,), viscosities; None if there are none.
    spins : (unknowns left,), the spins reached so far, as sums of two doubles.
    difference : (d, kept), the slips at these spins; a contact has up to d components.
    balanced : (samples,) mask of the samples in which all torques balance: they have come to the minimum.
    is_factorised : (samples,) mask of the samples whose `matrix` is factorised at spins close to `spins`.
    """

    def __init__(
        self,
        iterates: Sequence[Iterate],
        slipping: Sequence[np.ndarray],
        shared: Surroundings,
        order: np.ndarray | None = None,
    ) -> None:
        """Tie all contacts that do not slip, which makes the spins across each of them equal, and analyse the matrix of
        second derivatives of the power by the unknowns that are left.

        iterates : for each sample a point of the central path, of which friction limits and viscosities are used.
        slipping : for each sample a mask (n,) of its n contacts: those that may slip. All others are tied.
        shared : what all samples share: system of contacts, order of elimination, Newton matrix.
        order : (unknowns,), order of elimination made for nearly the same tied contacts; None for that of all samples.
        """
        self.iterates, self.samples, whole = iterates, len(iterates), shared.copies(len(iterates))
        suits, order = order is not None, shared.order if order is None else order
        self.tied = Contraction(whole, order, ~np.concatenate(slipping), self.samples, suits)
        self.slipping = self.everywhere(np.ones(len(self.tied.kept), dtype=bool))
        parts = [self.tied.span(sample) for sample in range(self.samples)]
        self.matrix = NewtonMatrix(self.tied.system, self.tied.order, shared.matrix.memory, parts=parts)
        self.friction = np.concatenate([iterate.friction for iterate in iterates])[self.tied.kept]
        viscosity = [iterate.viscosity for iterate in iterates if iterate.viscosity is not None]
        self.viscosity = np.concatenate(viscosity)[self.tied.kept] if viscosity else None
        self.balanced, self.is_factorised = np.zeros((2, self.samples), dtype=bool)
        # set by `descend`
        self.spins: Pair
        self.difference: np.ndarray

    def descend(self, spins: Pair) -> np.ndarray:
        """Run Newton's method until all torques balance, and set `spins`, `difference` and `balanced`.

        spins : where to begin, (samples * unknowns,) single spins, as sums of two doubles; tied ones get their mean.
        returns : (kept,) mask of contacts that come to rest and have to be tied, too: they did not slip at the
            beginning, or the next step would reverse their small slip. Samples with such contacts, and samples in which
            the method fails, are not `balanced`.
        """
        system, owners, self.spins = self.tied.system, self.tied.owners, self.tied.contracted(spins)
        self.difference = self.tied.differences(self.spins)
        of_contacts, of_spins = owners.contacts, owners.spins
        first = length(self.difference)
        at_rest: np.ndarray = (first == 0) & ~self.tied.contradicts[of_contacts]
        going = ~self.tied.contradicts & ~owners.any(at_rest)
        for count in range(MOST_NEWTON_STEPS):
            # Samples whose largest torque is small are balanced; in the last round that may be larger, by rounding.
            torques = system.torques(whole_dual(self.dual, self.viscosity, self.difference))
            left = owners.largest_of_spins(np.abs(torques))
            self.balanced |= going & (left < (NEWTON_TORQUE if count < MOST_NEWTON_STEPS - 1 else ROUNDED_TORQUE))
            going = going & ~self.balanced
            if not going.any():
                break
            # A Newton step for the samples that go on.
            stiffness = friction_stiffness(self.friction, self.viscosity, self.difference, LEAST_WORK)
            going = self.matrix.factorise_each(stiffness, going)
            step = self.matrix.solve(torques, going)
            change, slip = system.change(step), length(self.difference)
            # No slip may be reversed: where the whole step would do so, contacts with small slips come to rest.
            turned = inner(self.difference + change, self.difference) <= 0
            resting = turned & (slip < RESTING_SHARE * first) & going[of_contacts]
            at_rest, going = at_rest | resting, going & ~owners.any(resting)
            # A sample goes such a share `along` of the step that no slip changes by too much of its size.
            most = np.where(turned, MOST_CHANGE_IF_REVERSED, MOST_CHANGE_ALONG)
            reach = owners.largest(length(change) / (most * slip))
            self.is_factorised = np.where(going, reach < KEPT_MATRIX_CHANGE, self.is_factorised)
            along, (high, low) = np.minimum(1.0, 1 / np.maximum(reach, TINY)), self.spins
            self.spins = high, np.where(going[of_spins], low + along[of_spins] * step, low)
            there = self.difference + along[of_contacts] * change
            self.difference = np.where(going[of_contacts], there, self.difference)
        return at_rest

    @property
    def dual(self) -> np.ndarray:
        """(d, kept), minus the friction forces of the contacts that are left: the full friction of each, along its
        slip, which has up to d components."""
        found: np.ndarray = -self.friction * self.difference / length(self.difference)
        return found

    def resolved(self) -> list[Resolved | None]:
        """Return the minimum of each sample, in twice the precision where that is reached, else in doubles; None where
        torques do not balance."""
        if not self.balanced.any():
            return [None] * self.samples
        (spins, rest), difference, dual, fine = polished(
            self.tied, self.matrix, (self.friction, self.viscosity), self.spins, self.balanced, self.is_factorised
        )
        # minima in twice the precision; and in doubles, if that was not reached in some sample
        rests = np.split(rest, self.samples)
        precise, rough = self._as_minima(spins, rests, difference, dual), []
        if not fine[self.balanced].all():
            high, low = self.tied.expanded(self.spins)
            rough = self._as_minima(high + low, [None] * self.samples, self.difference, self.dual)
        pairs = zip(self.balanced, fine, strict=True)
        return [(precise if known else rough)[n] if balanced else None for n, (balanced, known) in enumerate(pairs)]

    def _as_minima(
        self, spins: np.ndarray, rests: Sequence[np.ndarray | None], difference: np.ndarray, dual: np.ndarray
    ) -> list[Resolved]:
        """Return the minimum of each sample, with arrays over all its spins and contacts.

        spins : (samples * unknowns,), all spins of the free spheres, sample after sample.
        rests : for each sample (unknowns,), low parts of the spins in twice the precision, spins + rests; None where
            they are not known.
        difference : (d, kept), slips with d components, sample after sample.
        dual : (d, kept), minus the friction forces, sample after sample.
        """
        of_samples = np.split(spins, self.samples), self.everywhere(difference), self.everywhere(dual)
        at_limit = [np.zeros_like(mask) for mask in self.slipping]
        heads = np.split(self.tied.heads, self.samples)
        found = map(Resolved, *of_samples, self.slipping, at_limit, heads, rests)
        return [replace(of, viscosity=iterate.viscosity) for of, iterate in zip(found, self.iterates, strict=True)]

    def everywhere(self, values: np.ndarray) -> list[np.ndarray]:
        """Return values of the contacts that are left as arrays over all contacts: for each sample an array (..., n),
        which is 0 at contacts that are not left.

        values : (..., kept), values of the contacts that are left, sample after sample.
        """
        found = np.zeros((*values.shape[:-1], self.tied.whole.offset.shape[1]), values.dtype)
        found[..., self.tied.kept] = values
        return np.split(found, self.samples, axis=-1)
