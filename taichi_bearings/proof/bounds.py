"""Rigorous bounds on the least potential (dissipation) of any network, from its spins and its friction: theorem 1.

Letters: R samples; n spheres, free and driven, and m contacts of all samples; F friction, r the torques over the radius
that it leaves over on free spheres, u* spins at which the potential is least, s a factor of at most 1.

For any friction F of which s F stays below mu F_n at contacts without viscosity,

    least potential >= s (work of the driven spheres + sum r . u*) - sum max(s |F| - mu F_n, 0)^2 / (2 eta)

u* is not known, so r . u* is replaced by the least value that it may have. Where components do not mix (discs; normals
along the axes) no slip becomes longer if every component of the spins is clipped to the largest imposed size, on
lattices to the interval between both planes, layer by layer. So some u* lies within these limits. On other networks
forces of fictitious springs balance r (springs.py).

Example. A free disc between a still disc (mu F_n = 3) and one that turns with u = 1 (mu F_n = 1). Spins with the free
disc still have the power 1. Friction 1 on both contacts is in balance, r = 0, and does the work 1. So 1 is the least
power. Friction 2 on both has s = 1/2, as the second contact bears no more than 1, and proves the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.proof.enclosure import UP, Enclosure, joined, row_sum
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.springs import Springs, rolling
from taichi_bearings.scene.solution import PROVEN

FASTEST_COMPARED = 1e6  # surface speed over the fastest imposed one, up to which a restricted bound is proven
# Shares of the potential: most that leftover torques may cost in a bound proven of all spins, else a restricted one is
# given; and most that they may cost without being balanced further.
PAID, HARDLY_PAID = 1e-9, 1e-13
DOUBLE_ERROR = 1e-12  # relative error, amply, of a quotient found in plain doubles
BOUNDS_OF_SAMPLES = ("upper", "lower", "excess", "worst", "proof", "largest_torque", "price")  # fields (R,) of bounds
WITHIN = f"proven only among surface speeds up to {FASTEST_COMPARED:.0e} times the fastest imposed"


@dataclass(frozen=True)
class Bounds:
    """Upper and lower bounds on the least potential of each of R samples (the least power, with friction alone), with n
    spheres and m contacts in all. Powers are in units of `network`.

    The upper bound is the potential of the stored spins. The lower bound follows from the stored friction:

    * Its torques do not quite cancel on free spheres. Where contacts are not along the axes, forces of fictitious
      *springs* at the contacts are added that cancel them, but for rounding. Call the friction F after that.
    * A factor s <= 1 brings s |F| within the friction limit of every contact without damping.
    * The bound is s times the work of the driven spheres against F, less s times the price of torques that are left,
      less the cost of s |F| beyond the friction limit at contacts with damping.

    network : the R samples, with their spins, friction and coefficients.
    upper, lower : (R,), the bounds, rounded up and down.
    excess : (R,), upper less lower bound, 0 or more: computed with twice the digits, then rounded up.
    size : (m,), s |F| of each contact.
    worst : (R,), 1 / s: the largest |F| over its limit, at least 1.
    proof : (R,), PROVEN, or the words that restrict `lower` to slower spins.
    largest_torque : (R,), largest torque over radius, a force, that the stored friction leaves over on a free sphere.
    price : (R,), the most power that these torques may take from the lower bound if no component of a spin exceeds the
        largest imposed one.
    unknown : (n, 3) mask of the spin components on which the springs act; None if no springs were made.
    friction : F by component, 3 enclosures (m,), where contacts are not along the axes; else empty.
    alone : where only some samples need springs, one Bounds for each sample, with its own `unknown` and `friction`;
        else empty.
    """

    network: JudgedNetwork
    upper: np.ndarray
    lower: np.ndarray
    excess: np.ndarray
    size: Enclosure
    worst: np.ndarray
    proof: np.ndarray
    largest_torque: np.ndarray
    price: np.ndarray
    unknown: np.ndarray | None
    friction: list[Enclosure]
    alone: tuple[Bounds, ...] = ()

    @classmethod
    def one_by_one(cls, network: JudgedNetwork) -> Bounds:
        """Return the bounds of R samples, each computed alone, since they need different proofs: in some the torques
        that friction leaves over are balanced by fictitious springs at the contacts, in others not.

        network : the R samples."""
        network = replace(network, rolling=None)
        samples = [cls.of(network.some(slice(number, number + 1))) for number in range(network.count)]
        found = {name: np.concatenate([getattr(one, name) for one in samples]) for name in BOUNDS_OF_SAMPLES}
        size = joined([one.size for one in samples])
        return cls(network, size=size, unknown=None, friction=[], alone=tuple(samples), **found)

    def sample(self, number: int) -> Bounds:
        """Return the bounds of the single sample with this number, 0 to R - 1."""
        pick, count = slice(number, number + 1), self.network.count
        own = {name: getattr(self, name)[pick] for name in BOUNDS_OF_SAMPLES}
        sizes = len(self.network.free) // count, len(self.network.acts) // count
        spheres, contacts = (slice(number * size, (number + 1) * size) for size in sizes)
        unknown = None if self.unknown is None else self.unknown[spheres]
        friction = [part[contacts] for part in self.friction]
        return Bounds(self.network.some(pick), size=self.size[contacts], unknown=unknown, friction=friction, **own)

    @classmethod
    def of(cls, network: JudgedNetwork) -> Bounds:
        """Return the bounds of all samples of a network. Where samples need different proofs each is computed alone.

        Upper bound: the potential of the stored spins. Lower bound, in this order:
        1. the work of the driven spheres against the friction, less the most that its unbalanced torques may cost;
        2. divided by the largest ratio of friction to its limit, over contacts without damping;
        3. less the cost of friction beyond the limit at contacts with damping.

        network : R samples with stored spins and friction."""
        potential, count = network.dissipated(0.5), network.count
        # Any spins have a potential that is not below the least, but spins that cannot exist prove nothing.
        upper = np.where(network.impossible, np.inf, potential.upper())
        if network.mixes and count > 1 and not (upper > 0).all():
            return cls.one_by_one(network)
        if network.mixes and (upper > 0).all():
            network = replace(network, rolling=rolling(network))
            if len(set(network.samples_that_mix.tolist())) > 1:  # without `rolling` some samples need no springs
                return cls.one_by_one(network)
        # Cost of the torques that the friction leaves over, at spins of at most the imposed size or by springs.
        friction, unknown = network.own_friction, None
        torques, proof = network.own_torques, np.full(network.count, PROVEN)
        left = np.array([_largest(network, torque) for torque in torques])
        cost_of_torques = price = _price(network, torques)
        if network.mixes and (upper > 0).all():
            balance = _balanced_by_springs(network, upper)
            if balance is None:
                return cls.one_by_one(network)
            friction, torques, unknown, proof, cost_of_torques = balance
        # 1. Work of the driven spheres, less that cost.
        work = -cost_of_torques
        for torque, imposed in zip(torques, network.imposed, strict=True):
            driven = np.flatnonzero(imposed.high)
            if len(driven):
                work = work + row_sum((torque.at(driven) * imposed.at(driven)).reshaped((count, -1)))
        size = network.graph.lengths(friction) if network.mixes else network.own_size
        # 2. The worst ratio of F to its limit. 3. The cost of F beyond the limit, (|F| - mu F_n)^2 / (2 eta).
        undamped = network.counts & (network.damping.high == 0)
        damped = np.flatnonzero(network.counts & (network.damping.high > 0))
        worst = _largest_ratio(network, size, undamped)
        if (worst > 1).any():
            size = size / Enclosure.exact(network.on_contacts(worst))
        beyond = size.at(damped)
        if network.law.has_friction:
            beyond = Enclosure.exact(np.maximum((beyond - network.friction_limit.at(damped)).upper(), 0.0))
        cost = network.by_sample((beyond * beyond / network.damping.at(damped)).signed(0.5), damped)
        least = work / Enclosure.exact(worst) - cost
        # Where components mix and the upper bound is 0, `least` is no bound; but no power is below 0, which `upper` is.
        lower = np.minimum(least.lower(), upper)
        apart = np.where(network.impossible, np.inf, (potential - least).upper())
        return cls(network, upper, lower, np.maximum(apart, 0.0), size, worst, proof, left.max(axis=0), price.upper(),
                   unknown, friction if network.mixes else [])  # fmt: skip


def _balanced_by_springs(
    network: JudgedNetwork, upper: np.ndarray
) -> tuple[list[Enclosure], list[Enclosure], np.ndarray | None, np.ndarray, Enclosure] | None:
    """Return friction whose torques on free spheres cancel but for rounding, and what these torques cost. It is the
    stored friction plus forces of fictitious springs at the contacts. This is for contacts that are not along the axes.

    The torques of rounding can reduce the lower bound by their size times the largest spins (times radius) of some
    minimum. Where such spins are not proven to be slow, FASTEST_COMPARED times the fastest imposed speed is taken in
    their place, and the bound is proven for spins up to that alone.

    network : R samples with n spheres and m contacts in all.
    upper : (R,), potentials of the stored spins.

    Returns None if there are several samples and in one of them no spring resists some spin; else a tuple:

    1. friction with the forces of the springs, 3 components, enclosures (m,);
    2. torques over radius that it leaves over, 3 components, enclosures (n,);
    3. mask (n, 3) of the spin components on which springs act, None without springs;
    4. (R,), the words that say for which spins the bound is proven;
    5. (R,), the power by which the torques of rounding reduce the lower bound."""
    count, springs = network.count, Springs.of(network, upper)
    if springs is None and count > 1:
        return None
    friction, torques, unknown = network.own_friction, network.own_torques, None
    fastest = FASTEST_COMPARED * float(network.largest_imposed.max(initial=0.0))
    reach = np.full(count, np.inf)  # (R,), bound on spins times radius at some minimum

    def sum_of_sizes(torques: list[Enclosure]) -> np.ndarray:
        """Return for each of R samples an upper bound (R,) on the sum of |torque over radius| over all components and
        all free spheres that contacts connect to driven ones.

        torques : for each component the torques left over on n spheres, enclosures (n,)."""
        by_component = [np.where(network.reached, part.most, 0.0).reshape(count, -1).sum(axis=1) for part in torques]
        found: np.ndarray = np.sum(by_component, axis=0) * UP
        return found

    def cost(torques: list[Enclosure], reach: np.ndarray) -> np.ndarray:
        """Return for each of R samples the power (R,) that torques may cost at most at spins up to `reach`.

        torques : for each component the torques over radius left over on n spheres, enclosures (n,)."""
        with np.errstate(invalid="ignore"):
            found: np.ndarray = reach * sum_of_sizes(torques)
        return np.where(np.isnan(found), np.inf, found)

    if springs is not None:
        reach, unknown = springs.reach, springs.number >= 0
        friction, torques = springs.balanced(lambda torques: cost(torques, springs.reach) > HARDLY_PAID * upper)
        is_too_large = (reach > fastest) & (cost(torques, reach) > PAID * upper)
        if is_too_large.any():  # the bound by equally stiff springs may be smaller
            reach = np.where(is_too_large, np.minimum(reach, springs.even_reach), reach)
    at_reach = cost(torques, reach)
    known = (reach <= fastest) | (at_reach <= PAID * upper)
    lost = Enclosure.exact(np.where(known, at_reach, sum_of_sizes(torques) * fastest))
    return friction, torques, unknown, np.where(known, PROVEN, WITHIN), lost


def _largest(network: JudgedNetwork, torque: Enclosure) -> np.ndarray:
    """Return for each of R samples the largest size (R,) of one component of the torque on a free sphere that contacts
    connect to driven ones.

    network : the R samples, with n spheres in all.
    torque : (n,), that component of the torque on each, an enclosure."""
    if not torque.high.any():
        return np.zeros(network.count)
    found: np.ndarray = np.where(network.reached, torque.most, 0.0).reshape(network.count, -1).max(axis=1, initial=0.0)
    return found


def _price(network: JudgedNetwork, torques: list[Enclosure]) -> Enclosure:
    """Return a bound (R,) on the power by which leftover torques on free spheres may reduce the lower bound: the sum
    over spheres of the torque times the largest spin (times radius) that the sphere may have at some minimum.

    network : R samples with n spheres in all.
    torques : torque over radius on each of the n spheres by spin component, C enclosures (n,)."""
    total = Enclosure.exact(np.zeros(network.count))
    for torque, reach, size in zip(torques, network.reach, network.largest_imposed, strict=True):
        if size and (torque.high.any() or torque.error.any()):
            lost = network.graph.power_lost(torque, reach, network.reached)
            total = total + row_sum(lost[np.flatnonzero(network.free)].reshaped((network.count, -1)))
    return total


def _largest_ratio(network: JudgedNetwork, size: Enclosure, undamped: np.ndarray) -> np.ndarray:
    """Return for each of R samples the largest ratio of friction to its limit, |F| / (mu F_n), over the contacts
    `undamped`; 1 if that is less. The result is (R,), rounded up.

    Ratios are first computed in doubles. Those close to the largest are computed once more with bounds on their errors.

    network : R samples with m contacts in all.
    size : (m,), |F| of all m contacts.
    undamped : (m,) mask of the contacts without viscosity, whose friction has a limit."""
    found, about = np.ones(network.count), np.zeros(len(network.acts))
    np.divide(size.high, network.friction_limit.high, out=about, where=undamped)
    most = about.reshape(network.count, -1).max(axis=1, initial=1.0)
    large = np.flatnonzero(undamped & (about >= network.on_contacts(most * (1 - DOUBLE_ERROR))))
    np.maximum.at(found, network.sample_of(large), (size.at(large) / network.friction_limit.at(large)).most)
    return found
