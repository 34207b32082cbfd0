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
* With damping: no slip is further than (2 E / eta)^1/2 from the given one. Steps 1 to 3 say the rest, with the domains
  of contacts whose share of friction left exceeds their slip over the jump. In packings the contacts that are still
  undecided are tried part by part (resting.py); with oblique normals also beside loops that cannot roll as their
  normals are rounded (loops.py, borne.py).

The proof that S slips and T rests
1. Over motions that keep every domain in one piece the power is a convex function with a single minimum, close to these
   spins (curvature.py).
2. At that minimum every contact of S still slips and exerts its friction along the slip; this is known closely. What
   the contacts of T bear, as the file says, balances it up to E_D, the sum of the torques left over in a domain D.
   These torques cancel in each domain, or a driven plane holds it: T pulls both ends of its contacts alike, which are
   in one domain, and the power has no slope along a free domain. So forces along a tree of the contacts that join it,
   none larger than E_D, take away what is left over. If then every contact of T stays inside its friction disc, the
   result is in balance and admissible, and it agrees with the law at every contact: the minimum of step 1 is one of the
   whole power.
3. All minima share all optimal forces (equations.md, 7): where the friction is below its limit nothing slips. So T
   rests at every minimum. Every minimum then is one of step 1, where there is only one, and S slips at it.

What the excess says of any network (theorem 5). At any minimum the sum over all contacts of phi(y*) + phi*(F) - F . y*
is at most E. With damping this alone bounds |y* - y|. With friction alone a contact at its limit has at least the share
mu F_n b^2 / (2 |y*|), b the part of y* across F, and one with margin m = mu F_n - |F| left has at least m |y*|. With
|y*| bounded above, these shares are a quadratic form of y* that is at most E, and so is that of the given slips. Its
floor, by an elimination, says how far minima are (`_by_cones`).
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
from taichi_bearings.proof.tied_minima import MISSED_LIMIT, tied_states
from taichi_bearings.scene.solution import PROVEN, SLIPLESS, SLIPPING, TIED, UNDECIDED

PROVEN_AT_ONCE = 200_000  # most spheres of samples that are proven together
# What is tried as resting, and by which form minima are enclosed. A wrong choice only makes a proof fail.
STILL, STILL_IN_PAIRS = 1e-12, 1e-28  # slip over the fastest imposed one that may be 0; by spins in twice the precision
CLEAR_RATIO = 10  # ratio of slip / jump and (friction left) / limit, either way, from which damping leaves no doubt
CLEAR_ROOM = 1e-3  # (friction left) / limit, above which a contact may well rest
STIFFEST = 1e4  # largest weight of a contact off its limit in the form, over the one that it would have at its limit
ODD_LOOPS = "loops are odd"  # what is missing where spins cannot be given signs such that slips are differences
PASSES = 2  # number of times that the form is made, the second time with the bounds on slips of the first


@dataclass(frozen=True)
class States:
    """Proven contact states of one sample.

    known : (E,), the states that hold at all minima, UNDECIDED where nothing is proven.
    unique : True if all minima have the same slips, False if not, None if that is not known. It is said of networks
        alone whose driving allows it (`Driving.slips_are_unique`).
    reason : words that say why not all states are proven, or "".
    """

    known: np.ndarray
    unique: bool | None
    reason: str = ""


@np.errstate(all="ignore")  # what is not finite proves nothing
def proven_states(bounds: Bounds) -> list[States]:
    """Return what is proven of the contact states at every minimum, a list with an object for each of R samples.

    Which theorem is applied depends on whether there is damping, on whether each component of a slip depends on one
    component of the spins, and on how many spin components can make contacts slip.

    bounds : bounds on the power of the samples, with their stored spins and friction."""
    network = bounds.network
    # Contacts that can dissipate at no minimum rest, and so do all in samples whose stored spins have no potential.
    rests = ~network.counts | network.on_contacts(bounds.upper == 0)
    if not imposed_exactly(network):  # what rests beside what turns so slowly is not known
        return _samples(network, np.where(rests, SLIPLESS, UNDECIDED), "an imposed spin is too small", None)
    if bounds.alone:
        return [states for one in bounds.alone for states in proven_states(one)]
    if network.mixes and network.count > 1:
        near = _enclosed_minimum(bounds) if _can_be_enclosed_together(bounds) else None
        together = _all_undecided(network, "") if near is None else _enclosed(network, near)
        done = np.zeros(network.count, dtype=bool) if near is None else near[2]
        found = [
            states if proven else proven_states(bounds.sample(number))[0]
            for number, (states, proven) in enumerate(zip(together, done, strict=True))
        ]
    elif (bounds.proof != PROVEN).any():
        found = _all_undecided(network, "the lower bound is not proven for all spins")
    # With damping; then friction alone: with normals in any direction, where nothing has to slip, and all others.
    elif network.law.has_viscosity:
        far = np.sqrt(2 * network.on_contacts(bounds.excess) / network.slope.least) * UP
        known = _slipping_beyond(network, far)
        found = _samples(network, known, "slips are small, or nothing is known of what bears no viscosity", True)
        near = _enclosed_minimum(bounds) if network.mixes and network.law.has_friction else None
        found = _with_damping(bounds, found) if near is None else _enclosed(network, near)
        found = _with_parts_at_rest(bounds, far, found) if network.graph.rests_in_parts else found
    elif network.mixes and (near := _enclosed_minimum(bounds)) is not None:
        found = _enclosed(network, near)
    elif network.mixes:
        far = _by_cones(bounds)
        known = _slipping_beyond(network, far)
        found = _samples(network, known, "the spins of least power are not enclosed closely enough", None)
        found = _with_parts_at_rest(bounds, far, found)
    elif not network.needed:
        found = _samples(network, np.full(len(rests), SLIPLESS), "", True)
    else:
        found = _by_cuts(bounds, network.needed[0]) if len(network.needed) == 1 else _by_curvature(network)
    completed = []
    for states, rest, acts in zip(found, *(v.reshape(network.count, -1) for v in (rests, network.acts)), strict=True):
        # Add the contacts that rest anyhow, and the reason only where some contact is undecided.
        known = np.where(rest, SLIPLESS, states.known)
        open_ = bool((acts & (known == UNDECIDED)).any())
        completed.append(States(known, states.unique, states.reason if open_ else ""))
    return completed


def _samples(network: JudgedNetwork, states: np.ndarray, reason: str, unique: bool | None) -> list[States]:
    """Return a list of R objects, one for each sample, with its part of the given states.

    network : the R samples, with m contacts in all.
    states : (m,), contact states, UNDECIDED where nothing is proven.
    reason : words that say why states are missing, the same for all samples.
    unique : True if all minima of a sample have the same slips, False if not, None if not known; the same for all."""
    return [States(own, unique, reason) for own in states.reshape(network.count, -1)]


def _enclosed_minimum(bounds: Bounds) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Prove near which slips the minima are, in R samples of a packing with E contacts in all, whose normals may have
    any direction. Return None if nothing is proven, else three arrays: the mask (E,) of contacts that may slip; bounds
    (E,) on |slip at any minimum - stored slip|; and the mask (R,) of the samples for which this is proven. (The module
    that does it is loaded here, as lattices do not need it.)

    bounds : bounds on the power of these samples, with their spins and friction.
    """
    from taichi_bearings.proof.oblique import enclosed_minimum

    return enclosed_minimum(bounds)


def _can_be_enclosed_together(bounds: Bounds) -> bool:
    """Return True if the minima of several samples may be enclosed together, as those of one network of separate parts.
    That is so if the lower bound of each sample is proven of all spins, and every contact that can dissipate has
    friction. Contacts with damping alone need close bounds on their slips, which single samples have; for several
    together bounds are wider.

    bounds : bounds on the power of the samples, with their friction."""
    held = bounds.network.holding.high[bounds.network.counts] > 0
    return bool((bounds.proof == PROVEN).all() and bounds.network.law.has_friction and held.all())


def _beside_loops(bounds: Bounds, far: np.ndarray) -> np.ndarray:
    """Return the mask (m,) of the contacts of a packing, with normals in any direction, that are proven to rest at
    every minimum. They may be connected with loops of contacts that cannot all roll exactly, since their normals are
    rounded. The module that does it is loaded here, as lattices do not need it.

    bounds : bounds on the power, with the m contacts and the friction that is in balance on all spheres.
    far : (m,), bound on |slip at any minimum - stored slip|.
    """
    from taichi_bearings.proof.borne import at_rest_beside_loops

    return at_rest_beside_loops(bounds, far)


def _enclosed(network: JudgedNetwork, near: tuple[np.ndarray, np.ndarray, np.ndarray]) -> list[States]:
    """Return the states of all samples, as a list, from bounds on the slips of minima. A contact that cannot slip is
    SLIPLESS. One that may slip is SLIPPING if it has friction, or if its stored slip exceeds its bound; else it is
    UNDECIDED.

    network : the samples, with E contacts in all.
    near : a mask (E,) of contacts that may slip, bounds (E,) on |slip at any minimum - stored slip|, and a third entry
        that is not used here.
    """
    slides, far, _ = near
    known = (network.holding.high > 0) | (network.slip.least > far)
    slips = np.where(known, SLIPPING, UNDECIDED)
    return _samples(network, np.where(slides & network.counts, slips, SLIPLESS), "slips are small", None)


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

    If two minima have different slips, these change in proportion along the line through both. The line can be followed
    at the same power until the first slip is 0; this contact is TIED. So without such contacts the slips are the same,
    though contacts that slip at every minimum might do so at several speeds.

    states : (E,), states of all contacts."""
    return False if (states == TIED).any() else None if (states == UNDECIDED).any() else True


def _by_curvature(network: JudgedNetwork) -> list[States]:
    """Return the states of R samples with friction alone. Minima may slip along two or more spin components, and each
    component of a slip depends on one of these.

    The proof has two steps. (1) Near the stored spins there is one minimum of the power among motions in which the
    contacts that rest now still rest. (2) Friction below their limits can balance the torques of the slipping contacts
    there. Samples of a lattice are first tried all at once, and if that fails half by half. Where friction limits are
    repeated, so that there may be several minima, they are tried one by one. Packings are proven elsewhere
    (`_of_packings`).

    network : the R samples with stored spins and friction.
    """
    count = network.count
    if not network.graph.still_is_exact:
        return _of_packings(network)
    if count == 1:
        states = _with_ties(network.motion)
        return [states] if isinstance(states, States) else _all_undecided(network, states)
    if _repeats(network.motion):
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

    Contacts that hardly slip in the stored spins are taken to rest. Then it is proven that one such minimum is near,
    and that friction below the limits of these contacts can balance the torques of the others. All samples are tried at
    once, and if that fails half by half.

    network : the R samples with stored spins and friction."""
    slip, fastest = network.slip.value, network.box.max()
    still, nearly = (network.counts & (slip <= most * fastest) for most in (STILL_IN_PAIRS, STILL))
    if network.count > 1:
        known = _by_domains(network, still)
        if isinstance(known, str):
            return [states for half in _halves(network) for states in _of_packings(half)]
        return _samples(network, known, "", None)
    # First as if spins were known in twice the precision.
    doubt = ""
    for rests in (still, nearly) if (nearly != still).any() else (still,):
        motion = _in_domains(network, rests)
        states = motion if isinstance(motion, str) else _with_ties(motion)
        if isinstance(states, States):
            return [replace(states, unique=None if states.unique else states.unique)]
        doubt = doubt or states
    if doubt == ODD_LOOPS:
        return proven_states(Bounds.of(replace(network, as_oblique=True)))
    return _all_undecided(network, doubt)


def _with_ties(motion: Motion) -> States | str:
    """Return the states of one sample that may have several minima, or a text that says why nothing is proven. Where
    friction limits are repeated, a proof for several minima is tried first, then one for a single minimum; else the
    other way round.

    motion : the sample with stored spins and friction, and which of its contacts are taken to rest."""
    contacts, repeats, doubt = Slipping.of(motion), _repeats(motion), ""
    for several in (True, False) if repeats else (False, True):
        if several and (tied := tied_states(motion, contacts)) is not None:
            return States(*tied, "minima tie in ways that are not known closely enough")
        if not several and isinstance(near := _one_minimum(motion, contacts), tuple):
            return States(_as_stored(motion), True)
        doubt = doubt if several else str(near)
    return doubt


def _with_damping(bounds: Bounds, known: list[States]) -> list[States]:
    """Return the states of R samples of friction with damping. Where it is proven that exactly those contacts rest that
    seem to rest, these states are returned, else `known`.

    A contact seems to rest if the share of its friction that is left, 1 - |F| / (mu F_n), exceeds its slip over the
    largest imposed speed. The proof is tried only for samples in which this is clear of every contact: one of both
    numbers is at least CLEAR_RATIO times the other.

    bounds : the samples, with their spins and friction, and bounds on their power.
    known : states of each sample, which are returned where nothing better is proven.
    """
    network, count = bounds.network, bounds.network.count
    if not network.law.has_friction or network.mixes or not network.needed:
        return known
    room, slip = 1 - bounds.size.value / network.holding.value, network.slip.value / network.box.max()
    rests = network.counts & (room > slip)
    unclear = network.counts & (np.maximum(room, slip) < CLEAR_RATIO * np.minimum(room, slip))
    improved = []
    for number, (own, states) in enumerate(zip(rests.reshape(count, -1), known, strict=True)):
        found: np.ndarray | str = ""
        if not unclear.reshape(count, -1)[number].any():
            found = _by_domains(network.some(slice(number, number + 1)), own)
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
    """Return the states (m,) of the m contacts of a network if it is proven to have one minimum in which the contacts
    in `rests` rest; else a text that says what is missing in the proof.

    In each component of the spins resting contacts join spheres to domains that turn as one. Contacts between different
    domains slip, and all contacts within a domain rest.

    network : stored spins and friction; each component of a slip depends on one component of the spins.
    rests : (m,) mask of the contacts that are taken to rest.
    """
    motion = _in_domains(network, rests)
    if isinstance(motion, str):
        return motion
    near = _one_minimum(motion, Slipping.of(motion))
    return near if isinstance(near, str) else _as_stored(motion)


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


def _repeats(motion: Motion) -> bool:
    """Return True if friction limits repeat: if two contacts of one sample that slip in the stored spins have the same
    limit. Then sums of friction may cancel, and there may be several minima.

    motion : the samples with stored spins, and which of their contacts rest.
    """
    network = motion.network
    own = np.flatnonzero(network.counts & ~motion.rests)
    values, sample = network.holding.high[own], network.sample_of(own)
    if (np.diff(np.sort(values)) != 0).all():  # in no two samples; to sort by sample takes ten times as long
        return False
    order = np.lexsort((values, sample))
    return bool(((np.diff(values[order]) == 0) & (np.diff(sample[order]) == 0)).any())


def _one_minimum(motion: Motion, contacts: Slipping) -> tuple[Slipping, np.ndarray] | str:
    """Prove that a network has one minimum near its stored spins, at which certain contacts rest. Several samples are
    treated as one network of separate parts.

    motion : the network with its stored spins, and which contacts are taken to rest.
    contacts : the n contacts that slip in it, with their slips.

    Returns the slipping contacts close to the minimum, and for each of them a bound (n,) on |slip there - slip| /
    |slip|; or a text that says what is missing in the proof."""
    if motion.torn.any():
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

    Let F be the friction that proves the lower bound on the power, within all limits. For the slips of any minimum the
    sum over contacts of mu F_n |slip| - F . slip is at most the upper less the lower bound. A contact near its friction
    limit has at least mu F_n b^2 / (2 |slip|) of this sum, where b is the part of its slip across F; another one at
    least (mu F_n - |F|) |slip|. Together these are a quadratic form of the spins, whose least eigenvalue bounds them.

    The form of the given slips is at most the excess as well: the given spins have no larger potential than that from
    which `Springs.reach` bounds spins, so the torques left over are paid for at these, too.

    bounds : bounds on the power of the sample, with its spins and friction, in which forces of fictitious springs have
        balanced all torques. Without such springs (`unknown` is None) nothing is proven."""
    network = bounds.network
    if bounds.unknown is None:
        return np.full(len(network.acts), np.inf)
    holding, slip = np.where(network.counts, network.holding.value, 0.0), network.slip.most
    room = np.maximum((network.holding - bounds.size).lower(), 0.0)
    # Direction n x F / |F|, across friction and normal, for contacts near their limit.
    moment = np.stack([part.value for part in moments(bounds.friction, network.graph.normal)], axis=1)
    across = moment / np.linalg.norm(moment, axis=1)[:, None]
    slides = network.counts & (room <= CLEAR_ROOM * holding) & np.isfinite(across).all(axis=1)
    number = numbered(bounds.unknown)
    rows, sizes = _rows_of_cones(network, across, slides, number)
    excess, far, most = float(bounds.excess[0]), np.full(len(holding), np.inf), bounds.upper / holding * UP
    for _ in range(PASSES):
        fastest = np.maximum(np.fmin(most, slip + far), slip)
        # mu F_n / (2 |y*|) for contacts near their limit. For others m |y*| >= m^2 |y*|^2 / E as m |y*| <= E. As all
        # |y*| and all given slips are at most `fastest`, this holds of both.
        weight = np.where(network.counts, holding / (2 * fastest), 0.0)
        stiff = np.minimum(room**2 / excess, STIFFEST * weight)
        weight = np.where(slides, weight, np.where(network.counts, stiff, 0.0))
        form = weighed(network, rows, np.sqrt(np.tile(weight, 3)), number, sizes)
        floor = 0.0 if form is None else float(form.floor()[0])
        if form is None or not floor > 0:
            break
        # Both y* and the given slips have a form of at most E, so they differ by at most twice its root. The floor is
        # one of the form without any rounding.
        radius = 2 * np.sqrt(excess) / np.sqrt(floor) * UP**2
        scale = np.zeros(number.shape)
        scale[number >= 0] = form.scale
        largest = scale.max(axis=1)[network.graph.contact].max(axis=0)
        far = np.fmin(far, np.sqrt(2) * largest * radius * np.linalg.norm(network.graph.normal, axis=1) * UP**2)
    return far


def _rows_of_cones(
    network: JudgedNetwork, across: np.ndarray, slides: np.ndarray, number: np.ndarray
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Return two matrices (3 E, n) for n unknown spin components. The rows of the first give what the quadratic form of
    `_by_cones` counts at each of E contacts: one row, the slip across friction, for a contact in the mask `slides`;
    three rows, all components of the slip, for any other contact that can dissipate. The second matrix has for each
    entry the sum of the sizes of the products from which it is made, as its rounding error is a share of that sum.

    network : one sample of a packing, with the normals of its contacts.
    across : (E, 3), unit vectors across friction and normal.
    slides : (E,) mask.
    number : (N spheres, 3), the index of each spin component among the unknowns; -1 for those that are none.
    """
    count, own = len(slides), np.flatnonzero(slides)
    at = np.tile(own, 3), np.concatenate([k * count + own for k in range(3)])
    kept = np.flatnonzero(np.tile(network.counts & ~slides, 3))
    pick = sparse.csr_array((np.append(across[own].T.ravel(), np.ones(len(kept))),
                             (np.append(at[0], kept), np.append(at[1], kept))), shape=(3 * count,) * 2)  # fmt: skip
    slips = slip_rows(network, number)
    return sparse.csr_array(pick @ slips), sparse.csr_array(abs(pick) @ abs(slips))
