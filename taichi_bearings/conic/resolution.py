"""The exact minimum, from a point near the end of the central path: which contacts slip, to the last decade of slip.

On the central path slip times friction margin is the same for all contacts. So a slip of 1e-9 can be seen only where
margins of 1e-9 can, and double precision ends before. The way on has these steps:

1. Contacts that seem to stick are tied. In small samples mostly all others slip. The path goes on until every contact
   is decided (last_decades.py) if more contacts come to rest, or if the tied ones cannot bear what is left to them, and
   in large samples always.
2. With all slipless contacts tied the power is a smooth function. Newton's method finds its minimum, in the end in
   twice the precision (polish.py).
3. The tied contacts have to bear what the slipping ones leave to them (slipless_forces.py). If they can, the contact
   states are those of a minimum; whether that is proven is for taichi_bearings/proof to say.
4. If they cannot, the path is followed once more with other contacts tied.

Letters and words (n, d, unknowns, tied, margin, ...) are explained in conic/__init__.py.
"""

from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.conic.central_path import LEAST_WORK, friction_stiffness
from taichi_bearings.conic.cones import inner, length
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.iterate import Iterate, whole_dual
from taichi_bearings.conic.last_decades import LastDecades
from taichi_bearings.conic.newton_matrix import MOST_NEWTON_STEPS, NewtonMatrix
from taichi_bearings.conic.polish import polished
from taichi_bearings.conic.slipless_forces import may_tie, nearly_borne
from taichi_bearings.conic.ties import tied_contacts
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.double_double import Pair, exactly

POWER_BELOW, POWER_ABOVE = 1e-12, 1e-6  # relative bounds on the rise and on the fall of power from that of the path
DECIDED_RATIO = 1e2  # ratio of slip and margin, either way, beyond which a contact is decided without a proof
STICKING_TREND = 0.6  # a contact sticks if its slip fell by more than this factor in a step, and its margin by less
DOUBTFUL_SHARE = 1e-2  # share of the contacts that may be in doubt when those are tied that surely stick
LEAST_DOUBTFUL, MOST_DOUBTFUL = 30, 300  # bounds on the number of contacts that this share allows
FEW_DOUBTFUL = 3  # contacts that may be in doubt when the states are tried where no minima may tie
# torques over the mean friction: at the first Newton's method ends, the second is accepted after its last step
NEWTON_TORQUE, ROUNDED_TORQUE = 1e-12, 1e-4
NEWTON_TRIALS = 2  # runs of Newton's method; before the second, contacts that have come to rest are tied
# largest change of a slip by a step, over the slip; the second if the whole step would reverse the slip
TURNED_SLIP_STEP, SLIP_STEP = 0.5, 0.95
RESTING_SHARE = 1e-2  # share of its first slip below which a contact comes to rest if the next step would turn it round
# smallest slip that needs no second look, known in twice the precision, and in one: 10^3 seed 559 asks for it
LEAST_SLIP_IN_PAIRS, LEAST_SLIP_IN_DOUBLES = 1e-22, 1e-9
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Resolved:
    """A minimum of one sample: spins, slips, forces and contact states.

    spins : (unknowns,).
    difference : (d, n), slips. They are more precise than those of `spins`, whose rounding can be a part of the
        smallest slips, unless `rest` is added.
    dual : (d, n), minus the friction forces.
    slipping : (n,) mask of contacts that slip.
    at_limit : (n,) mask of contacts that bear all their friction and yet do not slip.
    heads : (unknowns,) mask, one representative unknown for each set of tied spins without a driven plane; holding
        these makes the matrix of slipless contacts regular.
    rest : (unknowns,), what the spins lack, in twice the precision; None if that is not known.
    borne : whether the slipless contacts bear their load.
    tied : (n,) mask of contacts that slip at some minima and rest at others; None if not looked for.
    viscosity : (n,), None for friction alone.
    """

    spins: np.ndarray
    difference: np.ndarray
    dual: np.ndarray
    slipping: np.ndarray
    at_limit: np.ndarray
    heads: np.ndarray
    rest: np.ndarray | None = None
    borne: bool = False
    tied: np.ndarray | None = None
    viscosity: np.ndarray | None = None

    @property
    def ties(self) -> np.ndarray:
        """(n,) mask of the contacts that are known to slip at some minima and rest at others."""
        return np.zeros_like(self.at_limit) if self.tied is None else self.tied

    @property
    def sure(self) -> bool:
        """Whether a proof of the states can be expected: slipless contacts bear their load, and no slip is as small as
        rounding."""
        faintest = LEAST_SLIP_IN_DOUBLES if self.rest is None else LEAST_SLIP_IN_PAIRS
        return self.borne and length(self.difference)[self.slipping].min(initial=np.inf) > faintest

    @property
    def whole_dual(self) -> np.ndarray:
        """Minus the force of every contact, (d, n), with its viscous part."""
        return whole_dual(self.dual, self.viscosity, self.difference)


@dataclass(frozen=True)
class Surroundings:
    """What samples of one network share.

    system : the contacts of a sample.
    order : order of elimination of its unknowns.
    matrix : Newton matrix of one sample, or of several at once.
    top : for each spin of a sample the imposed spin of the top above it, in twice the precision; None where imposed
        spins are doubles.
    """

    system: ContactSystem
    order: np.ndarray
    matrix: NewtonMatrix
    top: Pair | None


def resolve(
    iterates: Sequence[Iterate], before: Sequence[Iterate | None], lattice: Surroundings, small: bool
) -> list[Resolved | None]:
    """The minimum of each sample; None where double precision does not reach it. The result for a sample does not
    depend on the others, bit by bit.

    iterates : points near the end of the central path, one for each sample; not changed.
    before : the points one step before, None where unknown.
    small : whether in these samples most contacts that seem to stick do stick.
    """
    with np.errstate(all="ignore"):  # what fails shows up as a number that is not finite and is discarded
        steps = zip(iterates, before, strict=True)
        # Step 1: guess the slipping contacts from the last two points of the path.
        slipping = [~_sticking(here, there) if small and there is not None else None for here, there in steps]
        minima = _minima(iterates, [exactly(iterate.spins) for iterate in iterates], slipping, lattice)
        # Steps 2 and 3: minima for these guesses, and forces of the slipless contacts.
        found = _with_slipless_forces(iterates, minima, [iterate.dual for iterate in iterates], lattice)
        for number, iterate in enumerate(iterates):
            # Step 4, for samples without a sure minimum.
            quickly = found[number]
            if quickly is None or not quickly.sure:
                with suppress(NotPositiveDefinite):
                    found[number] = _followed(iterate, before[number], lattice) or quickly
        lattice.matrix.forget()
        pairs = zip(iterates, found, strict=True)
        return [settled and _least(iterate, settled, lattice) for iterate, settled in pairs]


def _least(iterate: Iterate, settled: Resolved, lattice: Surroundings) -> Resolved | None:
    """The minimum `settled`, completed by the contacts that slip at some minima only; None if its power is too far from
    that of the path."""
    cost = replace(iterate, difference=settled.difference).cost
    if not -POWER_ABOVE < cost / iterate.cost - 1 < POWER_BELOW:
        return None
    if not settled.sure or iterate.viscosity is not None:  # with viscosity all minima have the same slips
        return settled
    of_minimum = settled.difference, settled.dual, settled.slipping, settled.at_limit
    return replace(settled, tied=tied_contacts(lattice.system, lattice.order, iterate.friction, *of_minimum))


def _sticking(iterate: Iterate, before: Iterate) -> np.ndarray:
    """(n,) mask of contacts that seem to stick: over the last step of the path their slips fell, their margins did
    not."""
    slip, slip_before = length(iterate.difference), length(before.difference)
    apart = iterate.margin > DECIDED_RATIO * slip
    return apart & (slip < STICKING_TREND * slip_before) & (iterate.margin > STICKING_TREND * before.margin)


def _followed(iterate: Iterate, before: Iterate | None, lattice: Surroundings) -> Resolved | None:
    """The minimum found along the last decades of the path; None if none is found.

    The path is followed until few contacts are in doubt. Then come trials, until the states of one are sure:
    - Where minima cannot tie: with nothing tied, first until hardly any contact is in doubt, then until none is; then
      with the contacts tied that surely stick.
    - Where minima may tie: with these tied; then up to twice to the end of the path, with those tied as well that
      surely stick at the end of the trial before, whose stiffness blurs the forces of the others; at last with nothing
      tied.
    """
    path, settled = LastDecades.after(iterate, before, lattice.matrix), None
    if path.decide(int(min(max(DOUBTFUL_SHARE * iterate.in_cones, LEAST_DOUBTFUL), MOST_DOUBTFUL))) is None:
        return None
    none, sticking = np.zeros_like(path.sticking), path.sticking
    if not (ties_possible := may_tie(iterate.friction, none)):
        with suppress(NotPositiveDefinite):
            early = _tried_early(iterate, copy(path), lattice)
            if early is not None and early.sure:
                return early
    # of each trial: are contacts tied, and is the path followed to its end?
    first, second, free = (True, False), (True, True), (False, False)
    for ties, to_the_end in (first, second, second, free) if ties_possible else (free, first):
        with suppress(NotPositiveDefinite):
            found, more = _over_tied(iterate, path, sticking if ties else none, lattice, to_the_end)
            settled, sticking = found or settled, sticking | more if ties else sticking
        if settled is not None and settled.sure:
            break
    return settled


def _tried_early(iterate: Iterate, path: LastDecades, lattice: Surroundings) -> Resolved | None:
    """The minimum if nearly all contacts are decided on `path`, with forces in balance; None where there is none.

    How the ratios of the few others change nearly always tells whether they slip. The last steps, each with the matrix
    of the whole lattice, would only make that certain, and balanced forces are certain enough.
    """
    slipping = path.decide(FEW_DOUBTFUL)
    if slipping is None:
        return None
    (found,) = _minima([iterate], [path.spins], [slipping], lattice)
    (settled,) = _with_slipless_forces([iterate], [found], [path.point.dual], lattice)
    return settled


def _over_tied(
    iterate: Iterate, path: LastDecades, sticking: np.ndarray, lattice: Surroundings, to_the_end: bool
) -> tuple[Resolved | None, np.ndarray]:
    """The minimum found when the path goes on with the contacts `sticking` (n,) tied, None if there is none; and a mask
    (n,) of further contacts that surely stick at its end.

    to_the_end : follow the path to its end, not only until no contact is in doubt.

    Slipless contacts begin with the forces that they have at the end of the path. Where minima may tie, a path with
    other contacts tied can change these forces a lot; then the forces from before are tried as well.
    """
    none, later = np.zeros_like(sticking), path.point.dual.copy()
    tied = Contraction(lattice.system, lattice.order, sticking) if sticking.any() else None
    rest = path.over(tied) if tied else copy(path)
    left = None if tied and tied.contradicts.any() else rest.decide(to_the_end=to_the_end)
    if left is None:
        return None, none
    slipping, at_limit, sticking, kept = none.copy(), none.copy(), none.copy(), tied.kept if tied else slice(None)
    slipping[kept], at_limit[kept], sticking[kept] = left, rest.at_limit, rest.sticking
    later[:, kept] = rest.point.dual
    (found,) = _minima([iterate], [tied.expanded(rest.spins) if tied else rest.spins], [slipping], lattice)
    if found is not None and at_limit.any():  # as are those that Newton's method has brought to rest
        found = replace(found, at_limit=(at_limit | slipping) & ~found.slipping)
    earlier = np.where(at_limit | (path.point.slip_over_margin > 1), later, path.point.dual)
    (settled,) = _with_slipless_forces([iterate], [found], [later], lattice)
    if settled is None and may_tie(iterate.friction, at_limit):
        (settled,) = _with_slipless_forces([iterate], [found], [earlier], lattice)
    return settled, sticking


def _with_slipless_forces(
    iterates: Sequence[Iterate], minima: Sequence[Resolved | None], near: Sequence[np.ndarray], lattice: Surroundings
) -> list[Resolved | None]:
    """The minima, completed by forces of the slipless contacts that balance the others; None for a sample where no such
    forces are found. near : duals (d, n) of the samples, near which they are looked for."""
    settled: list[Resolved | None] = [None] * len(minima)
    some = [(number, found) for number, found in enumerate(minima) if found is not None]
    if some:
        slipping, at_limit = (
            np.concatenate([getattr(found, of) for _, found in some]) for of in ("slipping", "at_limit")
        )
        dual = np.concatenate([np.where(found.slipping, found.whole_dual, near[n]) for n, found in some], axis=1)
        friction = np.concatenate([iterates[number].friction for number, _ in some])
        heads = [found.heads for _, found in some]
        duals, fine = nearly_borne(lattice.system, lattice.matrix, friction, dual, slipping, at_limit, heads)
        for (number, found), whole, inside in zip(some, np.split(duals, len(some), axis=1), fine, strict=True):
            dual = np.where(found.slipping, found.dual, whole)
            settled[number] = replace(found, dual=dual, borne=True) if inside else None
    return settled


def _minima(
    iterates: Sequence[Iterate], spins: Sequence[Pair], given: Sequence[np.ndarray | None], lattice: Surroundings
) -> list[Resolved | None]:
    """The least power of each sample if only given contacts slip, or those of them that do not come to rest; None for a
    sample where it is not found.

    spins : of each sample, where to begin.
    given : (n,) mask of the contacts that slip, None for a sample that is left out.
    """
    found: list[Resolved | None] = [None] * len(iterates)
    slipping = [mask for mask in given if mask is not None]
    numbers = [number for number, mask in enumerate(given) if mask is not None]
    spins = [spins[number] for number in numbers]
    for _ in range(NEWTON_TRIALS if numbers else 0):
        trial = _Slipping([iterates[number] for number in numbers], slipping, lattice)
        at_rest = trial.descend((np.concatenate([s[0] for s in spins]), np.concatenate([s[1] for s in spins])))
        for number, resolved in zip(numbers, trial.resolved(lattice.top), strict=True):
            found[number] = resolved
        again = np.flatnonzero(trial.tied.owners.any(at_rest)).tolist()
        if not again:
            break
        whole, resting = trial.tied.expanded(trial.spins), trial.everywhere(at_rest)
        high, low = (part.reshape(len(numbers), -1) for part in whole)
        spins = [(high[sample], low[sample]) for sample in again]
        slipping = [trial.slipping[sample] & ~resting[sample] for sample in again]
        numbers = [numbers[sample] for sample in again]
    return found


class _Slipping:
    """The power of samples as a function of the slips of some contacts, while all others are tied. It is smooth.

    slipping : (n,) mask for each sample.
    balanced : (samples,) mask of those that have come to the minimum of this function.
    """

    def __init__(self, iterates: Sequence[Iterate], slipping: Sequence[np.ndarray], lattice: Surroundings) -> None:
        """Tie all contacts that do not slip, and analyse the Newton matrix of what is left."""
        self.iterates, self.samples, whole = iterates, len(iterates), lattice.system.copies(len(iterates))
        self.tied = Contraction(whole, lattice.order, ~np.concatenate(slipping), self.samples)
        self.slipping = self.everywhere(np.ones(len(self.tied.kept), dtype=bool))
        parts = [self.tied.span(sample) for sample in range(self.samples)]
        self.matrix = NewtonMatrix(self.tied.system, self.tied.order, lattice.matrix.memory, parts=parts)
        self.friction = np.concatenate([iterate.friction for iterate in iterates])[self.tied.kept]
        viscosity = [iterate.viscosity for iterate in iterates if iterate.viscosity is not None]
        self.viscosity = np.concatenate(viscosity)[self.tied.kept] if viscosity else None
        self.balanced = np.zeros(self.samples, dtype=bool)
        self.spins: Pair
        self.difference: np.ndarray

    def descend(self, spins: Pair) -> np.ndarray:
        """Run Newton's method from these spins of the whole systems until the torques are in balance. No slip may be
        reversed.

        Returns a mask over the contacts that are left, true for those that come to rest and have to be tied: they did
        not slip to begin with, or the next step would reverse their slip. Their samples, and those in which the method
        fails, end unbalanced.
        """
        system, owners, self.spins = self.tied.system, self.tied.owners, self.tied.contracted(spins)
        self.difference = self.tied.differences(self.spins)
        of_contacts, of_spins = owners.contacts, owners.spins
        first = length(self.difference)
        at_rest = (first == 0) & ~self.tied.contradicts[of_contacts]
        going = ~self.tied.contradicts & ~owners.any(at_rest)
        for count in range(MOST_NEWTON_STEPS):
            torques = system.torques(whole_dual(self.dual, self.viscosity, self.difference))
            left = owners.largest_of_spins(np.abs(torques))
            self.balanced |= going & (left < (NEWTON_TORQUE if count < MOST_NEWTON_STEPS - 1 else ROUNDED_TORQUE))
            going = going & ~self.balanced
            if not going.any():
                return at_rest
            # A Newton step for the samples that go on.
            stiffness = friction_stiffness(self.friction, self.viscosity, self.difference, LEAST_WORK)
            going = self.matrix.factorise_each(stiffness, going)
            step = self.matrix.solve(torques, going)
            change, slip = system.change(step), length(self.difference)
            # Slips that the whole step would reverse: small ones come to rest, others make the step shorter.
            turned = inner(self.difference + change, self.difference) <= 0
            resting = turned & (slip < RESTING_SHARE * first) & going[of_contacts]
            at_rest, going = at_rest | resting, going & ~owners.any(resting)
            reach = owners.largest(length(change) / (np.where(turned, SLIP_STEP, TURNED_SLIP_STEP) * slip))
            along, (high, low) = np.minimum(1.0, 1 / np.maximum(reach, TINY)), self.spins
            self.spins = high, np.where(going[of_spins], low + along[of_spins] * step, low)
            there = self.difference + along[of_contacts] * change
            self.difference = np.where(going[of_contacts], there, self.difference)
        return at_rest

    @property
    def dual(self) -> np.ndarray:
        return -self.friction * self.difference / length(self.difference)

    def resolved(self, top: Pair | None) -> list[Resolved | None]:
        """The minima of the samples that are balanced, None for the others; in twice the precision where that is
        reached. top : as of :class:`Surroundings`."""
        if not self.balanced.any():
            return [None] * self.samples
        (spins, rest), difference, dual, fine = polished(
            self.tied, self.matrix, (self.friction, self.viscosity), self.spins, top, self.balanced
        )
        rests = np.split(rest, self.samples)
        precise, rough = self._each(spins, rests, difference, dual), []
        if not fine[self.balanced].all():
            high, low = self.tied.expanded(self.spins)
            rough = self._each(high + low, [None] * self.samples, self.difference, self.dual)
        pairs = zip(self.balanced, fine, strict=True)
        return [(precise if known else rough)[n] if balanced else None for n, (balanced, known) in enumerate(pairs)]

    def _each(
        self, spins: np.ndarray, rests: Sequence[np.ndarray | None], difference: np.ndarray, dual: np.ndarray
    ) -> list[Resolved]:
        """The minima sample by sample, from arrays over all samples. rests : of each sample what its spins lack, or
        None."""
        of_samples = np.split(spins, self.samples), self.everywhere(difference), self.everywhere(dual)
        at_limit = [np.zeros_like(mask) for mask in self.slipping]
        heads = np.split(self.tied.heads, self.samples)
        found = map(Resolved, *of_samples, self.slipping, at_limit, heads, rests)
        return [replace(of, viscosity=iterate.viscosity) for of, iterate in zip(found, self.iterates, strict=True)]

    def everywhere(self, values: np.ndarray) -> list[np.ndarray]:
        """Values (..., kept) of the slipping contacts, spread over all contacts with zeros for the others: an array
        (..., n) for each sample."""
        found = np.zeros((*values.shape[:-1], self.tied.whole.offset.shape[1]), values.dtype)
        found[..., self.tied.kept] = values
        return np.split(found, self.samples, axis=-1)
