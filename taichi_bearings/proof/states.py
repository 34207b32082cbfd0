"""Which contacts slip at every minimum: the theorem that applies to each kind of network, and theorems 4 and 5.

Symbols
    E contacts of one sample, m of all R samples (in shapes); n : number of slipping contacts.
    T : contacts without any slip. S : the others. D : a domain, spheres that T joins in a component and that turn as
    one.
    E (in formulas) : excess, the potential of the given spins less what the friction proves.
    y, y* : slip at hand and at a minimum. F : friction. phi, phi* : potential of a contact and its conjugate, as
        __init__.py of this folder defines them.

What is used, by the contact law and by how the components of spins matter
* One component (all of 2D, cubic lattices driven about x or y), friction alone: minima are mixtures of lightest cuts
  (minima_by_cuts.py).
* Two components or more that do not mix (lattices; normals along the axes), friction alone: steps 1 to 3 below; where
  friction is repeated, so that minima may tie, tied_minima.py first.
* Components that mix: the minimum is enclosed (oblique.py); where that fails, `_by_cones`, see below, and parts at rest
  beside loops that cannot roll as their normals are rounded (loops.py, borne.py).
* With damping: no slip is further than (2 E / eta)^1/2 from the given one. Steps 1 to 3 prove the other states; T are
  the contacts whose friction margin over the limit, 1 - |F| / (mu F_n), exceeds their slip over the jump. In packings
  the contacts that are still undecided are tried part by part (resting.py); with oblique normals also beside loops that
  cannot roll as their normals are rounded (loops.py, borne.py).

The proof that S slips and T rests
1. Among motions in which each domain turns as one the power has a single minimum, close to these spins (curvature.py).
2. At that minimum every contact of S still slips and exerts its friction along the slip; this is known closely. The
   stored friction of T balances it but for torques; let E_D be the sum of their sizes in a domain D. These torques
   cancel in each free domain, as a contact of T has both ends in one domain, and the power has no slope along it; in
   other domains a driven plane takes them. So forces along a tree of the contacts that join D, none larger than E_D,
   balance them. If then every contact of T stays inside its friction disc, all friction is in balance, within its
   limits and by the law at every contact: the minimum of step 1 is one of the whole power.
3. Any friction that is optimal is so at all minima (theorem 4): where it is below its limit nothing slips. So T rests
   at every minimum. Every minimum then is one of step 1, where there is only one, and S slips at it.

What the excess says of any network (theorem 5). At any minimum the sum over all contacts of phi(y*) + phi*(F) - F . y*
is at most E. With damping this alone bounds |y* - y|. With friction alone the term of a contact at its limit is at
least mu F_n b^2 / (2 |y*|), with b the part of y* across F; that of a contact with the friction margin m = mu F_n - |F|
is at least m |y*|. With |y*| bounded above, these terms are a quadratic form of y* that is at most E, and so is that of
the given slips. Its floor, by an elimination, says how far minima are (`_by_cones`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from taichi_bearings.proof.bounds import Bounds
from taichi_bearings.proof.curvature import Slipping, bearable, nearest_minimum
from taichi_bearings.proof.enclosure import UP
from taichi_bearings.proof.judged_network import JudgedNetwork, Motion
from taichi_bearings.proof.listed import moments
from taichi_bearings.proof.minima_by_cuts import states_by_cuts
from taichi_bearings.proof.resting import at_rest
from taichi_bearings.proof.slipless_state import imposed_exactly
from taichi_bearings.proof.springs import numbered, slip_rows, weighed
from taichi_bearings.proof.tied_minima import tied_states
from taichi_bearings.scene.solution import PROVEN, SLIPLESS, SLIPPING, TIED, UNDECIDED

PROVEN_AT_ONCE = 200_000  # most spheres of samples that are proven together
# What is tried as resting, and by which form minima are enclosed. A wrong choice only makes a proof fail.
STILL, STILL_IN_PAIRS = 1e-12, 1e-28  # slip over the fastest imposed one that may be 0; by spins in twice the precision
CLEAR_RATIO = 10  # slip / jump and margin / limit have to differ by this factor, either way, with damping
MISSED_LIMIT = 1e-6  # largest share of the friction limit that the stored friction of a slipping contact may miss
CLEAR_MARGIN = 1e-3  # (friction margin, limit less friction) / limit, above which a contact may well rest
STIFFEST = 1e4  # largest weight of a contact off its limit in the form, over the one that it would have at its limit
ODD_LOOPS = "loops are odd"  # what is missing where spins cannot be given signs such that slips are differences
PASSES = 2  # number of times that the form is made, the second time with the bounds on slips of the first


@dataclass(frozen=True)
class States:
    """Proven contact states of one sample.

    known : (E,), the states that hold at all minima, UNDECIDED where nothing is proven.
    unique : True if all minima have the same slips, False if not, None if that is not known. True is possible only for
        networks whose driving allows it (`Driving.slips_are_unique`).
    reason : words that say why not all states are proven, or "".
    """

    known: np.ndarray
    unique: bool | None
    reason: str = ""


@np.errstate(all="ignore")  # what is not finite proves nothing
def proven_states(bounds: Bounds) -> list[States]:
    """Return the proven contact states at every minimum, a list with an object for each of R samples.

    The theorem depends on whether there is damping, on whether each component of a slip depends on one component of the
    spins (else `network.mixes`), and on the spin components that can make contacts slip (`network.needed`).

    bounds : bounds on the power of the samples, with their stored spins and friction."""
    network = bounds.network
    # Contacts that can dissipate at no minimum rest, and so do all in samples whose stored spins have no potential.
    rests = ~network.counts | network.on_contacts(bounds.upper == 0)
    if not imposed_exactly(network):  # products with so small a spin underflow
        return _samples(network, np.where(rests, SLIPLESS, UNDECIDED), "an imposed spin is too small", None)
    if bounds.alone:  # samples whose bounds need different proofs
        return [states for one in bounds.alone for states in proven_states(one)]
    if network.mixes and network.count > 1:  # all samples together; those that fail, one by one
        near = _enclosed_minimum(bounds) if _can_be_enclosed_together(bounds) else None
        together = _all_undecided(network, "") if near is None else _enclosed(network, near)
        done = np.zeros(network.count, dtype=bool) if near is None else near[2]
        found = [
            states if proven else proven_states(bounds.sample(number))[0]
            for number, (states, proven) in enumerate(zip(together, done, strict=True))
        ]
    elif (bounds.proof != PROVEN).any():
        found = _all_undecided(network, "the lower bound is not proven for all spins")
    elif network.law.has_viscosity:  # all cases below have friction alone
        far = np.sqrt(2 * network.on_contacts(bounds.excess) / network.damping.least) * UP
        known = _slipping_beyond(network, far)
        found = _samples(network, known, "slips are small, or nothing is known of what bears no viscosity", True)
        near = _enclosed_minimum(bounds) if network.mixes and network.law.has_friction else None
        found = _with_damping(bounds, found) if near is None else _enclosed(network, near)
        found = _with_parts_at_rest(bounds, far, found) if network.graph.rests_in_parts else found
    elif network.mixes and (near := _enclosed_minimum(bounds)) is not None:
        found = _enclosed(network, near)
    elif network.mixes:  # where the minimum is not enclosed
        far = _by_cones(bounds)
        known = _slipping_beyond(network, far)
        found = _samples(network, known, "the spins of least power are not enclosed closely enough", None)
        found = _with_parts_at_rest(bounds, far, found)
    elif not network.needed:  # nothing has to slip
        found = _samples(network, np.full(len(rests), SLIPLESS), "", True)
    else:
        found = _by_cuts(bounds, network.needed[0]) if len(network.needed) == 1 else _by_curvature(network)
    completed = []
    for states, rest, acts in zip(found, *(v.reshape(network.count, -1) for v in (rests, network.acts)), strict=True):
        # Add the contacts that rest anyhow, and keep the reason only where some contact is undecided.
        known = np.where(rest, SLIPLESS, states.known)
        is_undecided = bool((acts & (known == UNDECIDED)).any())
        completed.append(States(known, states.unique, states.reason if is_undecided else ""))
    return completed


def _samples(network: JudgedNetwork, states: np.ndarray, reason: str, unique: bool | None) -> list[States]:
    """Return a list of R objects, one for each sample, with its part of the given states.

    network : the R samples, with m contacts in all.
    states : (m,), contact states, UNDECIDED where nothing is proven.
    reason : words that say why states are missing, the same for all samples.
    unique : True if all minima of a sample have the same slips, False if not, None if not known; the same for all."""
    return [States(own, unique, reason) for own in states.reshape(network.count, -1)]


def _enclosed_minimum(bounds: Bounds) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Prove how far the slips of all minima may be from the stored ones, in R samples of a packing with E contacts in
    all, whose normals may have any direction. Return None if nothing is proven, else three arrays: the mask (E,) of
    contacts that may slip; bounds (E,) on |slip at any minimum - stored slip|; and the mask (R,) of the samples for
    which this is proven.

    bounds : bounds on the power of these samples, with their spins and friction.
    """
    from taichi_bearings.proof.oblique import enclosed_minimum  # which lattices do not need

    return enclosed_minimum(bounds)


def _can_be_enclosed_together(bounds: Bounds) -> bool:
    """Return True if the minima of several samples may be enclosed together, as those of one network of separate parts:
    if the lower bound of each sample is proven of all spins, and every contact that can dissipate has friction.
    Contacts with damping alone need closer bounds on their slips than those for several samples together.

    bounds : bounds on the power of the samples, with their friction."""
    has_friction = bounds.network.friction_limit.high[bounds.network.counts] > 0
    return bool((bounds.proof == PROVEN).all() and bounds.network.law.has_friction and has_friction.all())


def _beside_loops(bounds: Bounds, far: np.ndarray) -> np.ndarray:
    """Return the mask (m,) of the contacts of a packing, with normals in any direction, that are proven to rest at
    every minimum. They may be connected with loops of contacts that cannot all roll exactly, since their normals are
    rounded.

    bounds : bounds on the power, with the m contacts and the friction that is in balance on all spheres.
    far : (m,), bound on |slip at any minimum - stored slip|.
    """
    from taichi_bearings.proof.borne import at_rest_beside_loops  # which lattices do not need

    return at_rest_beside_loops(bounds, far)


def _enclosed(network: JudgedNetwork, near: tuple[np.ndarray, np.ndarray, np.ndarray]) -> list[States]:
    """Return the states of all samples, as a list, from what `enclosed_minimum` (oblique.py) has proven.

    * SLIPLESS: contacts outside the mask of those that may slip; they rest at every minimum.
    * SLIPPING: contacts of the mask with friction, as they are proven to slip at every minimum; and those with damping
      alone whose stored slip exceeds its bound.
    * UNDECIDED: all other contacts of the mask.

    network : the samples, with E contacts in all.
    near : the mask (E,), bounds (E,) on |slip at any minimum - stored slip|, and a third entry that is not used here.
    """
    may_slip, far, _ = near
    slips = (network.friction_limit.high > 0) | (network.slip.least > far)
    states = np.where(slips, SLIPPING, UNDECIDED)
    return _samples(network, np.where(may_slip & network.counts, states, SLIPLESS), "slips are small", None)


def _all_undecided(network: JudgedNetwork, reason: str) -> list[States]:
    """Return a list of R objects, one for each sample, in which all contacts are UNDECIDED.

    network : the R samples.
    reason : words that say why nothing is proven."""
    return _samples(network, np.full(len(network.acts), UNDECIDED), reason, None)


def _slipping_beyond(network: JudgedNetwork, far: np.ndarray) -> np.ndarray:
    """Return states (m,) of the m contacts of a network: SLIPPING where a contact can dissipate and its stored slip
    exceeds `far`; SLIPLESS where it has no coefficient or no free sphere; UNDECIDED elsewhere.

    far : (m,), bound on |slip at any minimum - stored slip|.
    """
    slips = network.counts & (network.slip.least > far)
    return np.where(slips, SLIPPING, np.where(network.acts, UNDECIDED, SLIPLESS))


def _by_cuts(bounds: Bounds, k: int) -> list[States]:
    """Return the states of each of R samples, with friction alone, where minima may slip along one component of the
    spins only. There all minima are mixtures of lightest cuts, which divide the spheres into two sides such that the
    friction limits of the contacts between them have the least sum.

    bounds : the samples, with their friction and bounds on their power.
    k : number of the spin component.
    """
    states = states_by_cuts(bounds, k)
    return [States(of, _has_one_minimum(of), "cuts (nearly) tie") for of in states.reshape(bounds.network.count, -1)]


def _has_one_minimum(states: np.ndarray) -> bool | None:
    """Return True if all minima have the same slips, False if not, None if that is not known.

    Suppose that two minima have different slips. Along the line through both the slips change in proportion to the
    distance and the power stays the same, until the first slip is 0; this contact is TIED. So without TIED contacts all
    minima have the same slips.

    states : (E,), states of all contacts."""
    return False if (states == TIED).any() else None if (states == UNDECIDED).any() else True


def _by_curvature(network: JudgedNetwork) -> list[States]:
    """Return the states of R samples with friction alone. Minima may slip along two or more spin components, and each
    component of a slip depends on one of these.

    The proof has two steps. (1) Near the stored spins there is one minimum of the power among motions in which the
    contacts that rest in the stored spins still rest. (2) Friction below their limits can balance the torques of the
    slipping contacts there. Samples of a lattice are first tried all at once, and if that fails half by half. Where
    friction limits repeat, so that there may be several minima, they are tried one by one. Packings are proven by
    `_of_packings`.

    network : the R samples with stored spins and friction.
    """
    count = network.count
    if not network.graph.still_is_exact:
        return _of_packings(network)
    if count == 1:
        states = _with_ties(network.motion)
        return [states] if isinstance(states, States) else _all_undecided(network, states)
    if _limits_repeat(network.motion):
        parts = [network.some(slice(number, number + 1)) for number in range(count)]
    else:
        if len(network.free) <= PROVEN_AT_ONCE and isinstance(
            _one_minimum(network.motion, Slipping.of(network.motion)), tuple
        ):
            return _samples(network, _as_stored(network.motion), "", True)
        parts = _halves(network)
    return [states for part in parts for states in _by_curvature(part)]


def _halves(network: JudgedNetwork) -> list[JudgedNetwork]:
    """Return a list of two networks: with the first and with the second half of the samples of `network`."""
    return [network.some(slice(None, network.count // 2)), network.some(slice(network.count // 2, None))]


def _of_packings(network: JudgedNetwork) -> list[States]:
    """Return the states of R samples of a packing (discs, or normals along the axes), with friction alone, in which
    minima may slip along several spin components.

    Contacts that hardly slip in the stored spins are taken to rest. It is proven that one minimum with these contacts
    at rest is near, and that friction on them, below their limits, can balance the torques of the others. All samples
    are tried at once, and if that fails half by half; a single sample also by proofs for several minima, and with odd
    loops by those for normals in any direction.

    network : the R samples with stored spins and friction."""
    slip, fastest = network.slip.value, network.largest_imposed.max()
    still, nearly_still = (network.counts & (slip <= most * fastest) for most in (STILL_IN_PAIRS, STILL))
    if network.count > 1:
        known = _by_domains(network, still)
        if isinstance(known, str):
            return [states for half in _halves(network) for states in _of_packings(half)]
        return _samples(network, known, "", None)
    # Which slips hardly differ from 0: first as if spins were known in twice the precision, then in one.
    first_reason = ""
    for rests in (still, nearly_still) if (nearly_still != still).any() else (still,):
        motion = _in_domains(network, rests)
        states = motion if isinstance(motion, str) else _with_ties(motion)
        if isinstance(states, States):  # one minimum is claimed for lattices only
            return [replace(states, unique=None if states.unique else states.unique)]
        first_reason = first_reason or states
    if first_reason == ODD_LOOPS:
        return proven_states(Bounds.of(replace(network, as_oblique=True)))
    return _all_undecided(network, first_reason)


def _with_ties(motion: Motion) -> States | str:
    """Return the states of one sample that may have several minima, or a text that says why nothing is proven. Where
    friction limits are repeated, a proof for several minima is tried first, then one for a single minimum; else the
    other way round.

    motion : the sample with stored spins and friction, and which of its contacts are taken to rest."""
    contacts, reason = Slipping.of(motion), ""
    for several in (True, False) if _limits_repeat(motion) else (False, True):
        if several:
            tied = tied_states(motion, contacts)
            if tied is not None:
                return States(*tied, "minima tie in ways that are not known closely enough")
        else:
            minimum = _one_minimum(motion, contacts)
            if not isinstance(minimum, str):
                return States(_as_stored(motion), True)
            reason = minimum
    return reason


def _with_damping(bounds: Bounds, known: list[States]) -> list[States]:
    """Return the states of R samples of friction with damping: all of them where it is proven that exactly those
    contacts rest that seem to rest, else those in `known`.

    A contact seems to rest if its friction margin over its limit, 1 - |F| / (mu F_n), exceeds its slip over the largest
    imposed speed. The proof is tried only for samples in which one of both numbers is at least CLEAR_RATIO times the
    other at every contact.

    bounds : the samples, with their spins and friction, and bounds on their power.
    known : states of each sample, which are returned where nothing better is proven.
    """
    network, count = bounds.network, bounds.network.count
    if not network.law.has_friction or network.mixes or not network.needed:
        return known
    margin, slip = (
        1 - bounds.size.value / network.friction_limit.value,
        network.slip.value / network.largest_imposed.max(),
    )
    rests = network.counts & (margin > slip)
    unclear = network.counts & (np.maximum(margin, slip) < CLEAR_RATIO * np.minimum(margin, slip))
    improved = []
    for number, (rests_here, states) in enumerate(zip(rests.reshape(count, -1), known, strict=True)):
        found: np.ndarray | str = ""
        if not unclear.reshape(count, -1)[number].any():
            found = _by_domains(network.some(slice(number, number + 1)), rests_here)
        improved.append(states if isinstance(found, str) else States(found, True))
    return improved


def _with_parts_at_rest(bounds: Bounds, far: np.ndarray, before: list[States]) -> list[States]:
    """Return the states of R samples of a packing in which further contacts are proven to rest: those that can all rest
    at once, if friction below their limits can balance the torques of the other contacts.

    bounds : bounds on the power of the samples, with their spins and friction.
    far : (m,), bound on |slip at any minimum - stored slip| for all m contacts.
    before : the states that are proven before, a list of R objects.
    """
    network, known = bounds.network, np.concatenate([states.known for states in before])
    if not network.law.has_friction or not (network.counts & (known == UNDECIDED)).any():
        return before
    rests = _beside_loops(bounds, far) if network.mixes else at_rest(bounds, far)
    known = np.where(rests, SLIPLESS, known).reshape(network.count, -1)
    return [replace(states, known=own) for states, own in zip(before, known, strict=True)]


def _by_domains(network: JudgedNetwork, rests: np.ndarray) -> np.ndarray | str:
    """Try to prove that there is one minimum, at which the contacts in `rests` rest.

    In each spin component resting contacts join spheres to domains, which turn as one. Contacts within a domain rest,
    too; contacts between two domains slip.

    network : m contacts with stored spins and friction; each component of a slip depends on one spin component.
    rests : (m,) mask of the contacts that are taken to rest.

    Returns the states (m,) of the contacts if that is proven, else a sentence that says why not.
    """
    motion = _in_domains(network, rests)
    if isinstance(motion, str):
        return motion
    minimum = _one_minimum(motion, Slipping.of(motion))
    return minimum if isinstance(minimum, str) else _as_stored(motion)


def _in_domains(network: JudgedNetwork, rests: np.ndarray) -> Motion | str:
    """Return the stored spins as a motion in which the contacts in `rests` rest, and with them all contacts between
    spheres that they join, as these cannot slip either. Return a text instead if a loop has an odd number of contacts,
    since the spheres in it do not turn as one.

    network : stored spins and friction; each component of a slip depends on one component of the spins.
    rests : (m,) mask of the contacts that are taken to rest.
    """
    odd = (network.graph.in_odd_loops(k, network.feels[k]) for k in network.needed)
    if any(found[network.graph.contact[:, network.counts]].any() for found in odd):
        return ODD_LOOPS
    motion = Motion(network, rests)
    first, second = network.graph.contact
    within = [(motion.domain[k][first] == motion.domain[k][second]) | ~network.feels[k] for k in network.needed]
    return Motion(network, network.counts & np.all(within, axis=0))


def _as_stored(motion: Motion) -> np.ndarray:
    """Return states (m,) of m contacts: those that can dissipate and do not rest in the motion are SLIPPING, all
    others SLIPLESS.

    motion : a motion of a network in which some contacts (`motion.rests`) are taken to rest."""
    return np.where(motion.network.counts & ~motion.rests, SLIPPING, SLIPLESS)


def _limits_repeat(motion: Motion) -> bool:
    """Return True if two contacts of one sample that slip in the stored spins have the same friction limit. Then sums
    of friction may cancel, and there may be several minima.

    motion : the samples with stored spins, and which of their contacts rest.
    """
    network = motion.network
    slipping = np.flatnonzero(network.counts & ~motion.rests)
    limit, sample = network.friction_limit.high[slipping], network.sample_of(slipping)
    if (np.diff(np.sort(limit)) != 0).all():  # no two of all samples; to sort by sample takes ten times as long
        return False
    order = np.lexsort((limit, sample))
    return bool(((np.diff(limit[order]) == 0) & (np.diff(sample[order]) == 0)).any())


def _one_minimum(motion: Motion, contacts: Slipping) -> tuple[Slipping, np.ndarray] | str:
    """Prove that a network has one minimum near its stored spins, at which certain contacts rest. Several samples are
    treated as one network of separate parts.

    motion : the network with its stored spins, and which contacts are taken to rest.
    contacts : the n contacts that slip in it, with their slips.

    Returns the slipping contacts close to the minimum, and for each of them a bound (n,) on |slip there - slip| /
    |slip|; or a text with the reason why this is not proven."""
    if motion.cannot_rest.any():
        return "contacts without slip join driven spheres with different imposed spins"
    if not _saturated(motion.network, contacts):
        return "some contacts slip although their friction is not at its limit"
    if not (contacts.size.least > 0).all():
        return "slips are lost in the rounding of the spins"
    near = nearest_minimum(contacts)
    if near is not None and not bearable(motion, *near):
        return "friction of slipless contacts is not proven to balance the torques of the others"
    return "the power is not proven to rise in every direction from these spins" if near is None else near


def _saturated(network: JudgedNetwork, contacts: Slipping) -> bool:
    """Return True if the stored friction of every slipping contact is nearly at its limit, as it is near a minimum: at
    least 1 - MISSED_LIMIT times the limit. This is asked of lattices only; for packings the answer is always True.

    network : a network with its stored friction.
    contacts : its slipping contacts."""
    if not network.graph.friction_is_at_limit:
        return True
    parts = [part.high[contacts.own] for part in network.moment]
    return bool((np.sqrt(sum(p**2 for p in parts)) >= (1 - MISSED_LIMIT) * contacts.strength.value).all())


def _by_cones(bounds: Bounds) -> np.ndarray:
    """Return a bound (E,) on |slip at any minimum - stored slip| for one sample of E contacts with friction alone,
    whose normals have any direction; infinite where nothing is proven.

    Let F be the friction that proves the lower bound on the power, within all limits. The upper less the lower bound is
    the excess. For the slips y* of any minimum the sum over contacts of mu F_n |y*| - F . y* is at most the excess. The
    term of a contact near its limit is at least mu F_n b^2 / (2 |y*|), where b is the part of y* across F; that of any
    other contact at least (mu F_n - |F|) |y*|. With |y*| bounded above, these terms exceed a quadratic form of spins.

    The form of the given slips is at most the excess as well: their potential is no larger than that from which
    `Springs.reach` bounds spins, so the excess includes the price of leftover torques at the given spins, too.

    bounds : bounds on the power of the sample, with its spins and friction, in which forces of fictitious springs have
        balanced all torques. Without such springs (`unknown` is None) nothing is proven."""
    network = bounds.network
    if bounds.unknown is None:
        return np.full(len(network.acts), np.inf)
    limit, slip = np.where(network.counts, network.friction_limit.value, 0.0), network.slip.most
    margin = np.maximum((network.friction_limit - bounds.size).lower(), 0.0)
    # Direction n x F / |F|, across friction and normal, for contacts near their limit.
    moment = np.stack([part.value for part in moments(bounds.friction, network.graph.normal)], axis=1)
    across = moment / np.linalg.norm(moment, axis=1)[:, None]
    at_limit = network.counts & (margin <= CLEAR_MARGIN * limit) & np.isfinite(across).all(axis=1)
    number = numbered(bounds.unknown)
    rows, sizes = _rows_of_cones(network, across, at_limit, number)
    excess, far, most = float(bounds.excess[0]), np.full(len(limit), np.inf), bounds.upper / limit * UP
    for _ in range(PASSES):
        fastest = np.maximum(np.fmin(most, slip + far), slip)
        # Weights in the form: mu F_n / (2 |y*|) near the limit. At others, with the margin m, m |y*| is at most the
        # excess, and so at least m^2 |y*|^2 / excess. All |y*| and all given slips are at most `fastest`.
        weight = np.where(network.counts, limit / (2 * fastest), 0.0)
        off_limit = np.minimum(margin**2 / excess, STIFFEST * weight)
        weight = np.where(at_limit, weight, np.where(network.counts, off_limit, 0.0))
        form = weighed(network, rows, np.sqrt(np.tile(weight, 3)), number, sizes)
        floor = 0.0 if form is None else float(form.floor()[0])
        if form is None or not floor > 0:
            break
        # The form is at most the excess for y* and for the given slips, so the spins of both differ by at most 2
        # (excess / floor)^1/2. The floor is proven of the form without any rounding.
        radius = 2 * np.sqrt(excess) / np.sqrt(floor) * UP**2
        scale = np.zeros(number.shape)
        scale[number >= 0] = form.scale
        largest = scale.max(axis=1)[network.graph.contact].max(axis=0)
        far = np.fmin(far, np.sqrt(2) * largest * radius * np.linalg.norm(network.graph.normal, axis=1) * UP**2)
    return far


def _rows_of_cones(
    network: JudgedNetwork, across: np.ndarray, at_limit: np.ndarray, number: np.ndarray
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Return two matrices (3 E, n) for E contacts and n unknown spin components. The first one gives the slips whose
    squares `_by_cones` adds up: the component across friction for a contact in the mask `at_limit` (one row), all
    components for any other contact that can dissipate (three rows). Each entry of it is a sum of products; that of the
    second matrix is the sum of their sizes, from which the rounding is bounded.

    network : one sample of a packing, with the normals of its contacts.
    across : (E, 3), unit vectors across friction and normal.
    at_limit : (E,) mask of the contacts near their friction limit.
    number : (N spheres, 3), the index of each spin component among the unknowns; -1 for those that are none.
    """
    count, one_row = len(at_limit), np.flatnonzero(at_limit)
    first = np.tile(one_row, 3), np.concatenate([k * count + one_row for k in range(3)])
    kept = np.flatnonzero(np.tile(network.counts & ~at_limit, 3))
    weights = sparse.csr_array((np.append(across[one_row].T.ravel(), np.ones(len(kept))),
                                (np.append(first[0], kept), np.append(first[1], kept))),
                               shape=(3 * count,) * 2)  # fmt: skip
    slips = slip_rows(network, number)
    return sparse.csr_array(weights @ slips), sparse.csr_array(abs(weights) @ abs(slips))
