"""Proof that one minimum exists near given spins, where components do not mix (lattices, discs): theorem 7.

What is proven. Some contacts are taken to rest. Spheres that they join turn as one in a component: such a set is a
*domain*. Only free domains may move, each by one number. With these contacts at rest there is exactly one minimum of
the power; it is near the given spins, and how much each slip changes on the way to it is bounded (`nearest_minimum`).
If friction of the resting contacts, below their limits, can balance the torques of the others, it is a minimum over all
spins (`bearable`).

Symbols
    n : number of slipping contacts (elsewhere in this folder the number of spheres). m : number of those that slip in
        two components; they are called *curved*, since only their slip, a vector in a plane, can change its direction.
    k : number of a spin component. q : unknowns of a quadratic form (`Form`).
    u : (unknowns,), change of the spin of each free domain. v : other unknowns, of which u are sums (`_clusters`).
    z : slip of a contact at the given spins (one or two components), w : its change, t : unit vector across z.
    relative_change : in the code, a bound on |w| / |z| for each contact.
    g : slope of the power at the given spins; in words, the torque on each domain.
    H : curvature of the power at the given spins, the sum of (mu F_n / |z|) (w . t)^2 + eta |w|^2.
    h : positive numbers, one for each v; the diagonal of H. tau : proven number with H >= tau h as quadratic forms.
    rho : radius; (sum of h v^2)^1/2 is the size of a change v.

The proof
1. Friction of size 1 has the direction n(z) = z / |z|. When the slip changes by w, this force changes by n(z + w) -
   n(z), which does the work (n(z + w) - n(z)) . w against w: at least 0.72 (w . t)^2 / |z| while |w| <= |z| / 4. For
   with |z| = 1, L = |z + w| and a the part of w along z, it is (w . t)^2 (L + 1) / (L (L + 1 + a)), least at L = 5/4
   and a = 1/4: (9/4) / (5/4 x 5/2) = 0.72. The work of damping is eta |w|^2.
2. So along a ray the derivative of the power at v, times |v|, is at least -|g| |v| + 0.72 tau |v|^2, with |v|
   measured by h and |g| by 1 / h. The power rises outwards on the surface |v| = rho for any rho > |g| / (0.72 tau),
   if no slip changes by more than a quarter on the way. As the power is convex, all minima are inside.
3. Two minima inside would differ by a motion that changes every slip along its own direction alone and no slip with
   damping, as the power is straight between them. Directions inside differ little from n(z), so the part of this motion
   across z is small, and its curvature H would be less than tau h: a contradiction. There is just one
   (`Curvature.is_positive_within`).

Example. One free sphere slips along three contacts with mu F_n = 1 past driven spheres, whose spins (two components)
are the corners of an equilateral triangle with its centre at 0, at distance 1. The power is |u - a_1| + |u - a_2| + |u
- a_3| (Fermat's problem). At u = 0 all |z| = 1 and the unit vectors cancel: g = 0. H is the sum of 1 - n n^T, that is
3/2 of the identity, so h = 3/2 and tau = 1. Given spins with an error d have |g| = (3/2) d / (3/2)^1/2, and with 1.5
for 1 / 0.72 the minimum is proven to be within rho / h^1/2 = 1.5 d in each component, as long as that changes no slip
by more than a quarter. The program is content with a far smaller tau (CURVATURE_SHARE), since g is of the size of
rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from taichi_bearings.dissection import Part
from taichi_bearings.numerics.graphs import graph_of, pieces
from taichi_bearings.proof.enclosure import UP, Enclosure, grouped_sum, joined, length
from taichi_bearings.proof.judged_network import JudgedNetwork, Motion
from taichi_bearings.proof.rounded_elimination import EPS, Elimination, Factor, Samples

# largest change of a slip, over its size, up to which a slip resists by at least 0.72 of its curvature
MOST_RELATIVE_CHANGE = 0.25
CURVATURE_TRIALS = 4  # number of trials, each but the first from spins that a step of Newton's method has improved
RIGID_STIFFNESS = 10.0  # stiffness mu F_n / |z| over the median, beyond which a contact holds a cluster together
CURVATURE_SHARE = 1e-7  # first guess of tau, which most networks exceed by far
LEAST_CURVATURE, POWER_ITERATIONS = 1e-14, 6  # curvature that rounding hides, and number of power iterations
# random vectors that choose the unit of each unknown of a floor, and the largest such unit: larger ones would make more
# of the rounding than is left of the floor
RANDOM_VECTORS, MOST_UNIT = 16, 2.0**15
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Slipping:
    """The n contacts of a network that slip, and the unknowns that change their slips.

    There is one unknown for each free domain, spheres that turn as one, of each component. The number -1 stands for a
    domain that does not move or changes no slip, and for a component in which a contact does not slip.

    unknowns : number of unknowns.
    felt : (2, n), the one or two spin components that make each contact slip, -1 for none.
    lower, upper : (2, n), unknown of the domain of the first and of the second sphere, for either component in `felt`.
    curved : (m,), indices (0 to n - 1) of the contacts that slip in two components; for all others one entry of
        `difference` is exactly 0.
    difference : the slip z, two enclosures (n,), one for each row of `felt`: signed spin of the second sphere less that
        of the first, in units of the network. Signed means multiplied by the sign +1 or -1 by which neighbours differ,
        so equal signed spins roll.
    strength : (n,), friction limits mu F_n.
    damping : (n,), eta; None for laws without damping.
    own : (n,), indices of these contacts among all contacts of the network.
    place : (d, n), position of each contact; used only to order the elimination.
    """

    unknowns: int
    felt: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    curved: np.ndarray
    difference: tuple[Enclosure, Enclosure]
    strength: Enclosure
    damping: Enclosure | None
    own: np.ndarray
    place: np.ndarray

    @classmethod
    def of(cls, motion: Motion) -> Slipping:
        """Collect the contacts that can dissipate and do not rest in a motion. Number the domains that can change their
        slips; a domain is a group of spheres that turn as one, since resting contacts join them.

        motion : the network, and which contacts rest.
        """
        network = motion.network
        slipping = np.flatnonzero(network.counts & ~motion.rests)
        felt = _slipping_components(network, slipping)
        difference = [Enclosure.exact(np.zeros(len(slipping))) for _ in range(2)]
        for slot in range(2):
            for k in network.needed:
                with_k = np.flatnonzero(felt[slot] == k)
                if len(with_k):
                    difference[slot].put(with_k, motion.difference(k, slipping[with_k]))
        strength, damping = (
            network.friction_limit.at(slipping),
            network.damping.at(slipping) if network.law.has_viscosity else None,
        )
        place = network.graph.middle(slipping).T
        curved, pair = np.flatnonzero((felt >= 0).all(axis=0)), (difference[0], difference[1])
        without_unknowns = cls(0, felt, felt, felt, curved, pair, strength, damping, slipping, place)
        return without_unknowns.over(network, motion.domain)

    def over(self, network: JudgedNetwork, domain: dict[int, np.ndarray]) -> Slipping:
        """Return a copy with other unknowns: the spins of other domains.

        network : the network of these contacts.
        domain : by component, the label (N,) of the domain of each sphere; spheres that shall not move have the label
            of a driven sphere.
        """
        ends, unknowns = network.graph.contact.take(self.own, 1), 0
        lower, upper = np.full((2, len(self.own)), -1), np.full((2, len(self.own)), -1)
        for k in network.needed:
            # A domain gets an unknown if a slipping contact joins it to another domain and no sphere of it is driven.
            label = domain[k]
            pairs = label[ends[:, network.feels[k][self.own]]]
            is_unknown = np.zeros(int(label.max()) + 1, dtype=bool)
            is_unknown[pairs[:, pairs[0] != pairs[1]]] = True
            is_unknown[label[~network.free]] = False
            unknown_of_sphere = np.where(is_unknown, unknowns + np.cumsum(is_unknown) - 1, -1)[label]
            unknowns += int(is_unknown.sum())
            for slot in range(2):
                with_k = np.flatnonzero(self.felt[slot] == k)
                lower[slot, with_k], upper[slot, with_k] = unknown_of_sphere[ends[:, with_k]]
        return replace(self, unknowns=unknowns, lower=lower, upper=upper)

    @cached_property
    def size(self) -> Enclosure:
        """Slip speed of each of the n contacts, an enclosure (n,)."""
        first, second = (abs(part).parts for part in self.difference)
        size = Enclosure(*(a + b for a, b in zip(first, second, strict=True)))  # one is exactly 0 unless curved
        size.put(self.curved, length([part.at(self.curved) for part in self.difference]))
        return size

    @cached_property
    def direction(self) -> tuple[Enclosure, Enclosure]:
        """Unit vector along the slip of each of the m contacts that slip in two components: its two components,
        enclosures (m,)."""
        size = self.size.at(self.curved)
        return self.difference[0].at(self.curved) / size, self.difference[1].at(self.curved) / size

    @cached_property
    def stiffness(self) -> Enclosure:
        """mu F_n / slip speed of each of the m contacts that slip in two components, (m,). If a slip changes by a small
        w at right angles to itself, its friction keeps its size and changes by this number times w."""
        return self.strength.at(self.curved) / self.size.at(self.curved)

    @cached_property
    def pulls(self) -> tuple[Enclosure, Enclosure]:
        """Force of each of n contacts, friction mu F_n along the slip plus damping times the slip: two enclosures (n,),
        its components along the two spin components in `felt`."""
        found = [self.strength.signed(np.sign(part.high)) for part in self.difference]
        for pull, along in zip(found, self.direction, strict=True):
            pull.put(self.curved, self.strength.at(self.curved) * along)
        if self.damping is not None:
            found = [pull + self.damping * part for pull, part in zip(found, self.difference, strict=True)]
        return found[0], found[1]

    def change(self, slot: int) -> sparse.csr_array:
        """Return the matrix (n, unknowns), with entries 1, -1 and 0, that gives one component of the change of each
        slip from the changes of the unknowns. An unknown is the spin of a free domain, a group of spheres that turn as
        one.

        slot : 0 or 1, for the first or the second component in `felt`.
        """
        ends = np.stack([self.upper[slot], self.lower[slot]], axis=1)
        kept = (ends >= 0) & (ends[:, :1] != ends[:, 1:])  # a contact within one domain has no difference
        begin = np.append(0, np.cumsum(kept[:, 0].astype(np.int8) + kept[:, 1]))
        signs = np.broadcast_to([1.0, -1.0], ends.shape)[kept]
        return sparse.csr_array((signs, ends[kept], begin), shape=(len(ends), self.unknowns))

    def moved(self, step: np.ndarray) -> Slipping:
        """Return a copy with the slips after a change of the unknowns. An unknown is the spin (times radius) of a free
        domain, a group of spheres that turn as one.

        step : (unknowns,), change of each unknown, in the units of the network.
        """
        by = np.append(step, 0.0)  # the last entry is for domains that do not move, number -1
        difference = tuple(
            part + (Enclosure.exact(by[upper]) - Enclosure.exact(by[lower]))
            for part, upper, lower in zip(self.difference, self.upper, self.lower, strict=True)
        )
        return replace(self, difference=(difference[0], difference[1]))

    def slope(self) -> Enclosure:
        """Return the slope (unknowns,) of the power along each unknown: the torque over radius that the slipping
        contacts exert on its domain. An unknown is the spin of a free domain, a group of spheres that turn as one."""
        owner, pulls = [], []
        for slot in range(2):
            for pull, end in ((self.pulls[slot], self.upper[slot]), (-self.pulls[slot], self.lower[slot])):
                free = np.flatnonzero(end >= 0)
                owner.append(end[free])
                pulls.append(pull.at(free))
        return grouped_sum(joined(pulls), np.concatenate(owner), self.unknowns)

    def blocks(self) -> np.ndarray:
        """Return for each unknown the number (unknowns,) of its block. Blocks are the smallest groups of unknowns such
        that the slip of each contact depends on unknowns of one block only; so each block can be proven by itself."""
        ends = np.concatenate([self.lower, self.upper])
        some = ends.max(axis=0)  # an unknown of the contact if it has any
        pairs = [(end[end >= 0], some[end >= 0]) for end in ends]
        first, second = (np.concatenate([pair[i] for pair in pairs]) for i in range(2))
        return pieces(self.unknowns, first, second)


def _slipping_components(network: JudgedNetwork, indices: np.ndarray) -> np.ndarray:
    """Return for each of q contacts the numbers of the spin components that make it slip at some minimum, (2, q); -1
    where there is no second one. Of all three components the one along the normal of a contact makes it never slip, so
    there are at most two.

    network : a network in which each component of a slip depends on one component of the spins.
    indices : (q,), indices of the contacts."""
    if len(network.needed) == 3:
        axis = np.argmax(np.abs(network.graph.normal[indices]), axis=1)
        return np.stack([(axis + 1) % 3, (axis + 2) % 3])
    felt = [np.where(network.feels[k][indices], k, -1) for k in network.needed]
    return np.stack([*felt, np.full(len(indices), -1)][:2])


@np.errstate(all="ignore")  # what is not finite proves nothing
def nearest_minimum(contacts: Slipping) -> tuple[Slipping, np.ndarray] | None:
    """Prove that there is one minimum near given spins.

    contacts : the n slipping contacts with their slips at these spins, and the unknowns that change them: spins of free
        domains (spheres that turn as one).

    Returns None if it is not proven. Else a pair: the contacts with their slips at spins close to the minimum, which
    are the given ones or those after up to CURVATURE_TRIALS - 1 steps of Newton's method; and a bound (n,) on |slip at
    the minimum - slip of the returned contact| / |slip|."""
    if contacts.unknowns == 0:
        return contacts, np.zeros(len(contacts.place[0]))
    for number in range(CURVATURE_TRIALS):
        curvature = Curvature.of(contacts)
        if curvature is None:
            return None
        relative_change = _bound_on_changes(contacts, curvature, number == CURVATURE_TRIALS - 1)
        if relative_change is not None:
            return contacts, relative_change
        step = curvature.newton_step(contacts.slope().value)
        if step is None:
            return None
        contacts = contacts.moved(step)
        if not (contacts.size.least > 0).all():
            return None
    return None


def _bound_on_changes(contacts: Slipping, curvature: Curvature, last: bool) -> np.ndarray | None:
    """Return a bound (n,) on |slip at the minimum - slip| / |slip| for each of n slipping contacts; None if it is not
    proven, or if there might be several minima within it.

    Let h be the diagonal of the curvature in the variables v of :class:`Curvature`, tau h a proven lower bound of it,
    and g the slope of the power along each v, over the root of its h. As long as a slip changes by no more than a
    quarter, it resists by at least 0.72 of its curvature. So the minimum is where the sum of h v^2 is at most rho^2,
    with rho = |g| / (0.72 tau), if slips change by no more than a quarter there.

    contacts : slips at the spins that are tried.
    curvature : of the power at these spins.
    last : False if other spins can be tried after these. Then tau, which takes an elimination, is computed only if
        CURVATURE_SHARE / 2 in its place would do; most networks have a larger tau."""
    root, block = np.sqrt(curvature.form.squares), contacts.blocks()
    slope = curvature.clusters.T @ contacts.slope().most

    # The minimum is within rho = 1.5 |g| / tau of these spins, as 1.5 > 1 / 0.72. Each block has its own radius.
    def relative_change_for(tau: float) -> np.ndarray:
        """Return the bound (n,) on |slip at the minimum - slip| / |slip| of each of n contacts that follows if the
        curvature is at least `tau` times its diagonal."""
        radius = 1.5 * np.bincount(block, (slope / root) ** 2) ** 0.5 / tau * UP + TINY  # rho, block by block
        most_v = radius[block] / root  # largest |v| of each variable, as h v^2 <= rho^2
        return np.asarray(sum((e @ most_v) ** 2 for e in curvature.entries) ** 0.5 / contacts.size.least * UP)

    # proven_floor proves half of its guess, CURVATURE_SHARE
    if not (last or (relative_change_for(CURVATURE_SHARE / 2) <= MOST_RELATIVE_CHANGE).all()):
        return None
    found = relative_change_for(curvature.tau)
    return found if curvature.is_positive_within(contacts, found) else None


@np.errstate(all="ignore")
def rises(contacts: Slipping, relative_change: np.ndarray) -> bool:
    """Return True if the power is proven to have positive curvature along every motion of the unknowns, at all spins
    near given ones. An unknown is the spin of a free domain, a group of spheres that turn as one.

    contacts : the n slipping contacts, with their slips at the given spins, and the unknowns.
    relative_change : (n,), how near: |slip - given slip| / |given slip| is at most this at each contact.
    """
    curvature = Curvature.of(contacts) if contacts.unknowns else None
    return contacts.unknowns == 0 or (curvature is not None and curvature.is_positive_within(contacts, relative_change))


def bearable(
    motion: Motion, contacts: Slipping, relative_change: np.ndarray, unsure: dict[int, np.ndarray] | None = None
) -> bool:
    """Return True if some friction of the resting contacts balances all torques at the minimum and stays below every
    friction limit.

    motion : the network of N spheres, and which contacts rest. These join spheres to domains, which turn as one.
    contacts : the n slipping contacts close to the minimum.
    relative_change : (n,), bound on |slip at the minimum - slip| / |slip|.
    unsure : by component k a force (N,), for contacts at their limit (tied_minima.py): a bound on how much the sum of
        their friction on each sphere changes up to the minimum. None if there are no such contacts."""
    network, added_by_domain = motion.network, {}
    torques = network.own_torques
    off = _change_of_friction(motion, contacts, relative_change)
    for k in network.needed:
        # Bound on the torque on each sphere that additional friction of resting contacts has to balance: the torque
        # that the given friction leaves over, and the change of the friction of slipping contacts up to the minimum.
        residual = np.where(network.free, torques[k].most if unsure is None else torques[k].most + unsure[k], 0.0)
        for slot in range(2):
            some = contacts.felt[slot] == k
            for end in network.graph.contact[:, contacts.own[some]]:
                residual += np.bincount(end, off[slot, some], len(residual))
        residual[~network.free] = 0.0
        # At the minimum these torques add up to 0 on each free domain: a resting contact has both ends in one domain,
        # where its torques cancel, and the power has no slope. In other domains a driven sphere takes any torque. So
        # forces along a tree of the contacts of a domain balance the torques, none larger than the sum of their sizes.
        domain = motion.domain[k]
        added_by_domain[k] = np.bincount(domain, residual)[domain] * UP
    # Compare the stored friction and what is added to it, a vector of the components, with the friction limit.
    resting = np.flatnonzero(motion.rests & network.counts)
    feels = {k: network.feels[k][resting] for k in network.needed}
    margin = network.friction_limit.at(resting) - network.own_size.at(resting)
    first = network.graph.contact[0, resting]
    added = np.sqrt(sum(np.where(feels[k], added_by_domain[k][first], 0.0) ** 2 for k in network.needed))
    takes_part = np.any(list(feels.values()), axis=0)
    return bool((~takes_part | ((margin.high > 0) & (margin.least > added * UP))).all())


def _change_of_friction(motion: Motion, contacts: Slipping, relative_change: np.ndarray) -> np.ndarray:
    """Return a bound (2, n) on how far the stored friction of each of n slipping contacts may be from that at the
    minimum. It has an entry for either spin component that makes the contact slip (`contacts.felt`), 0 if there is only
    one.

    motion : the network, whose friction is stored as moments.
    contacts : the slipping contacts close to the minimum.
    relative_change : (n,), bound on |slip at the minimum - slip| / |slip|.
    """
    network, found = motion.network, np.zeros(contacts.felt.shape)
    for slot in range(2):
        stored = Enclosure.exact(np.zeros(len(contacts.own)))
        for k in network.needed:
            some = np.flatnonzero(contacts.felt[slot] == k)
            own = contacts.own[some]
            stored.put(some, network.moment[k].at(own).signed(network.sign[k][network.graph.contact[1, own]]))
        found[slot] = (contacts.pulls[slot] - stored).most
        # A slip z that changes by a share c of its size changes its unit vector by at most 2 c, and eta z by c eta |z|.
        found[slot, contacts.curved] += (
            2 * relative_change[contacts.curved] * contacts.strength.at(contacts.curved).most
        )
        if contacts.damping is not None:
            found[slot] += relative_change * (contacts.damping * contacts.size).most
    return found


@dataclass(frozen=True)
class Form:
    """A quadratic form x^T A^T A x in q unknowns, scaled so that every column of A has length 1 up to rounding.

    rows : A, a sparse matrix (rows, q) of doubles.
    doubt : matrix of the same shape, bounds on the errors of the entries of A.
    squares : (q,), squared lengths of the columns before they were scaled.
    elimination : the elimination of A^T A, ordered but not carried out.
    """

    rows: sparse.csr_array
    doubt: sparse.csr_array
    squares: np.ndarray
    elimination: Elimination

    @classmethod
    def of(
        cls,
        rows: sparse.csr_array,
        doubt: sparse.csr_array,
        place: np.ndarray,
        of_rows: bool = False,
        parts: list[Part] | None = None,
        samples: Samples | None = None,
    ) -> Form | None:
        """Make the form |A x|^2 from a matrix: scale its columns to length 1, and order the elimination of A^T A.
        Return None where a column is 0 or not finite.

        rows : (p, q), the matrix A of p rows for q unknowns before its columns are scaled.
        doubt : (p, q), bounds on the errors of its entries, and on the rounding of two further products with each.
        place : (d, q), positions of the unknowns in d dimensions. If `of_rows` is True: (d, p), positions of the rows,
            and each unknown is put at the mean of its rows, weighted by the squares of their entries.
        parts : the groups in which unknowns are eliminated; None to find them.
        samples : which sample each unknown belongs to; None if there is only one sample."""
        squares = np.bincount(rows.indices, rows.data**2, rows.shape[1])
        if not ((squares > 0) & (squares < np.inf)).all():
            return None
        inverse = 1 / np.sqrt(squares)
        rows, doubt = (_with_values(part, part.data * inverse[part.indices]) for part in (rows, doubt))
        if of_rows:
            place = place @ _with_values(rows, rows.data**2)
        return cls(rows, doubt, squares, Elimination.of((rows.T @ rows).tocsc(), place, parts, samples))

    @cached_property
    def scale(self) -> np.ndarray:
        """(q,), factors by which the q scaled unknowns are multiplied to give the original ones."""
        found: np.ndarray = 1 / np.sqrt(self.squares)
        return found

    def floor(self) -> np.ndarray:
        """Return for each of R samples a number tau, (R,): all eigenvalues of A^T A are proven to be tau or more. A is
        the scaled matrix `rows`, or any other that differs from it by `doubt` at most. It is 0 where nothing is proven,
        and infinite for a sample without unknowns."""
        return proven_floor(self.rows, self.doubt, self.elimination)

    def floor_in_units(self) -> Floor:
        """Return a floor of |A x|^2 in which each of the q scaled unknowns has a unit of its own."""
        return Floor.of(self.rows, self.doubt, self.elimination)


@dataclass(frozen=True)
class Curvature:
    """The curvature of the power at given slips, as a quadratic form. Its unknowns are u, the changes of the spins of
    free domains (spheres that turn as one). It is written in other variables v, of which u are sums. With h the
    diagonal of the form in v, it is proven to be at least the sum of tau h v^2, for some number tau.

    clusters : (unknowns, unknowns), entries 0 and 1: u = clusters @ v.
    form : the curvature in variables v that are scaled such that its diagonal is 1; `form.squares` are h.
    changes : two matrices (contacts, unknowns), entries 1, -1 and 0: changes[0] @ v and changes[1] @ v are the two
        components of the changes of all slips.
    """

    clusters: sparse.csr_array
    form: Form
    changes: list[sparse.csr_array]

    @classmethod
    def of(cls, contacts: Slipping) -> Curvature | None:
        """Return the curvature of the power at given slips. Return None if the power has no curvature along some
        variable v, because v changes neither the direction of any slip nor any slip that is damped.

        contacts : the slipping contacts with these slips."""
        clusters = _clusters(contacts)
        # exact; a variable at both ends of a contact cancels
        changes = [contacts.change(slot) @ clusters for slot in range(2)]
        rows, doubt, owner = _curvature_rows(contacts, changes)
        form = Form.of(rows, doubt, contacts.place[:, owner], of_rows=True)
        return None if form is None else cls(clusters, form, changes)

    @cached_property
    def tau(self) -> float:
        """A number for which it is proven that the curvature in scaled unknowns has no eigenvalue below it; 0 if none
        is found."""
        return float(self.form.floor()[0])

    @cached_property
    def entries(self) -> list[sparse.csr_array]:
        """Two matrices (contacts, unknowns) of zeros and ones: 1 where a variable v changes a component of the slip of
        a contact. They are the absolute values of `changes`."""
        return [_with_values(change, np.abs(change.data)) for change in self.changes]

    def is_positive_within(self, contacts: Slipping, relative_change: np.ndarray) -> bool:
        """Return True if the power is proven to have a positive curvature along every motion, wherever slips are near
        those of `contacts`. Then there is at most one minimum there.

        contacts : the n slipping contacts.
        relative_change : (n,), most that |slip - slip of `contacts`| may be, over the size of the latter; the answer is
            False if it is above a quarter anywhere.

        Two minima would differ by a motion that changes each slip by some w along its direction; at contacts with
        damping w is 0, as their power is strictly convex. With c the relative change, unit vectors along slips differ
        by 2 c at most, so the part of w across the slip of `contacts` is at most 2 c |w|. The curvature of this motion
        is at most the sum of (mu F_n / slip) (2 c |w|)^2, computed here as a diagonal form. It has to be below half of
        tau h, with h the diagonal of the curvature and tau h a proven lower bound of it; below all of it would be
        enough."""
        # A component of w is a row of `changes` times v. With e, 0 or 1, the sizes of the entries of this row, Cauchy
        # and Schwarz give w^2 <= (sum of e) (sum of e v^2).
        loss = np.zeros_like(relative_change)
        loss[contacts.curved] = (2 * relative_change[contacts.curved]) ** 2 * contacts.stiffness.most
        most_loss = sum(e.T @ (loss * e.sum(axis=1)) for e in self.entries)  # factors of v^2 in that diagonal form
        return bool(
            (relative_change <= MOST_RELATIVE_CHANGE).all()
            and (most_loss * UP < self.tau * self.form.squares / 2).all()
        )

    def newton_step(self, slope: np.ndarray) -> np.ndarray | None:
        """Return the step (unknowns,) of Newton's method: the change of the unknowns after which the slope of the power
        vanishes to first order; None if rounding hides the curvature. Nothing about it is proven. An unknown is the
        spin of a free domain, a group of spheres that turn as one.

        slope : (unknowns,), derivatives of the power by the unknowns.
        """
        root, factor = np.sqrt(self.form.squares), self.form.elimination.factorised()
        return None if factor is None else -(self.clusters @ (factor.solve((self.clusters.T @ slope) / root) / root))


def _clusters(contacts: Slipping) -> sparse.csr_array:
    """Return a matrix B (unknowns, unknowns) of 0 and 1 that changes variables: changes of the spins of free domains =
    B @ v. Any regular B is valid. This one is chosen so that the curvature in the variables v has no tiny eigenvalue,
    although some contacts are very stiff.

    Domains (spheres that turn as one) joined by contacts with tiny slips, which resist changes most, form a cluster.
    The change of one domain of a cluster, its head, is a variable. For every other domain the variable is its change
    less that of its neighbour on the way to the head, along a tree of the stiffest contacts. So one variable moves the
    whole cluster and changes the slip of no stiff contact in it.

    contacts : the slipping contacts, and the unknowns, which are the changes of the spins of free domains.
    """
    # Graph of the stiff contacts between unknowns, all driven domains being one node and a source another.
    driven, source = contacts.unknowns, contacts.unknowns + 1
    stiffness = contacts.stiffness.value
    stiff = stiffness > RIGID_STIFFNESS * (np.median(stiffness) if len(stiffness) else np.inf)
    ends = (end[:, contacts.curved[stiff]] for end in (contacts.lower, contacts.upper))
    first, second = (np.where(end < 0, driven, end).ravel() for end in ends)
    slip = np.tile(1 / stiffness[stiff], 2)
    apart = first != second
    # Of parallel contacts, those between the same two unknowns, only the stiffest is kept: the last in this order.
    order = np.argsort(-slip[apart], kind="stable")
    low, high = np.minimum(first, second)[apart][order], np.maximum(first, second)[apart][order]
    last = np.unique((low * source + high)[::-1], return_index=True)[1]
    low, high, slip = low[::-1][last], high[::-1][last], slip[apart][order][::-1][last]
    # A tree of the stiffest contacts in each cluster, with an edge from its head to the source. Edges to the source are
    # longer than all slips; that of the driven node is the shortest of them, so that it is the head of its cluster.
    everything, longest = np.arange(source), slip.max(initial=1.0)
    to_source = (2 + np.append(everything[1:], 0)) * longest
    edges = np.append(low, everything), np.append(high, np.full(source, source))
    linked = minimum_spanning_tree(graph_of(source + 1, *edges, np.append(slip, to_source)))
    # The neighbour of each unknown that is next on the way to the head of its cluster; the source beyond the head.
    next_to_head = breadth_first_order(linked, source, directed=False)[1][: contacts.unknowns]
    # The change of a domain is the sum of the variables on its way to the head, itself first: an entry 1 for each.
    pair = [np.arange(contacts.unknowns)] * 2  # an unknown, and a variable on its way
    entries = []
    while len(pair[0]):
        entries.append(pair)
        ahead = next_to_head[pair[1]]
        pair = [pair[0][ahead < contacts.unknowns], ahead[ahead < contacts.unknowns]]
    rows, columns = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(contacts.unknowns,) * 2)


def _with_values(matrix: sparse.csr_array, data: np.ndarray) -> sparse.csr_array:
    """Return a sparse matrix with entries at the same places as those of `matrix`, whose values are `data` (in the
    order in which they are stored)."""
    found = copy(matrix)  # SciPy's constructor would check all places again, which takes longer than the copy
    found.data = data
    return found


def _row_scaled(
    values: np.ndarray, matrix: sparse.csr_array, function: Callable[[np.ndarray], np.ndarray] = np.asarray
) -> sparse.csr_array:
    """Return the sparse matrix `matrix` (k, n) with row i multiplied by values[i].

    values : (k,).
    function : function applied to the entries of the matrix first, for instance np.abs."""
    return _with_values(matrix, np.repeat(values, np.diff(matrix.indptr)) * function(matrix.data))


def _curvature_rows(
    contacts: Slipping, changes: list[sparse.csr_array]
) -> tuple[sparse.csr_array, sparse.csr_array, np.ndarray]:
    """Return the matrix A of the curvature of the power, |A x|^2 for changes x of the unknowns: three things,

    1. A, (rows, unknowns);
    2. bounds on the errors of its entries, a matrix of its shape;
    3. (rows,), the contact, 0 to n - 1, to which each row belongs.

    contacts : the n slipping contacts.
    changes : two matrices (n, unknowns) that give both components of the changes of slips.

    A contact that slips in two components has one row, the change of its slip at right angles to the slip, times the
    root of mu F_n / slip. With damping every contact has two more, both components of the change of its slip times the
    root of eta. Friction in one component has no curvature: mu F_n |slip| is straight.
    """
    # The unit vector at right angles to each slip, two components.
    across, stiffness = (-contacts.direction[1], contacts.direction[0]), contacts.stiffness
    # Relative error of the root: at most that of its square, and 16 roundings: five of a root, products and a sum; the
    # others are for later products of A with units.
    root, inexact = np.sqrt(stiffness.value), stiffness.error / stiffness.least + 16 * EPS
    rows, doubt = [], []
    for part, change in zip(across, (whole[contacts.curved] for whole in changes), strict=True):
        rows.append(_row_scaled(root * part.value, change))
        doubt.append(_row_scaled(root * (part.error + inexact * part.most), change, np.abs))
    found, unsure, owner = rows[0] + rows[1], doubt[0] + doubt[1], [contacts.curved]
    found.eliminate_zeros()
    if contacts.damping is None:
        return found, unsure, contacts.curved
    # With damping: two more rows for each contact.
    damping = contacts.damping
    relative = np.where(damping.most > 0, damping.error / damping.least, 0.0)  # a contact may have none
    root, inexact = np.sqrt(damping.value), relative + 16 * EPS
    whole, off = [found], [unsure]
    for change in changes:
        whole.append(_row_scaled(root, change))
        off.append(_row_scaled(root * inexact, change, np.abs))
        owner.append(np.arange(len(root)))
    found, unsure = (sparse.csr_array(sparse.vstack(parts, format="csr")) for parts in (whole, off))
    return found, unsure, np.concatenate(owner)


def proven_floor(rows: sparse.csr_array, doubt: sparse.csr_array, elimination: Elimination) -> np.ndarray:
    """Return for each of R samples a number tau, (R,): all eigenvalues of A^T A are proven to be tau or more. This
    holds for every matrix A whose entries differ from those of `rows` by `doubt` at most. It is 0 where nothing is
    proven, and infinite for samples without unknowns.

    rows, doubt : (m, n) for n unknowns.
    elimination : how to eliminate the matrix rows^T rows, as doubles have formed it.

    CURVATURE_SHARE is tried first, which needs no estimate, then half of the least eigenvalue as it is estimated.
    """
    first = np.full(elimination.samples.count, CURVATURE_SHARE)
    found = _floor_by_guess(rows, doubt, elimination, first, 1)
    if found.all():
        return found
    guess = _least_eigenvalue(elimination, elimination.factorised_samples(-LEAST_CURVATURE)) / 2
    return np.where(found > 0, found, _floor_by_guess(rows, doubt, elimination, guess, POWER_ITERATIONS))


@dataclass(frozen=True)
class Floor:
    """A quadratic form |A x|^2 in q unknowns that is proven to be at least tau times the sum of (x / unit)^2.

    Each unknown has a unit of its own, as the form grows far more slowly along some unknowns than along others: with
    one unit tau would be as small as along the softest.

    tau : (R,), for each of R samples; 0 where nothing is proven, infinite for samples without unknowns.
    unit : (q,), powers of two.
    factor : Cholesky factor of about A^T A, of which nothing is proven.
    """

    tau: np.ndarray
    unit: np.ndarray
    factor: Factor

    @classmethod
    def of(
        cls,
        rows: sparse.csr_array,
        doubt: sparse.csr_array,
        elimination: Elimination,
        factor: Factor | None = None,
    ) -> Floor:
        """Return a floor of |A x|^2 for every matrix A whose entries differ from those of `rows` by `doubt` at most.

        The unit of an unknown is about the root of its entry on the diagonal of (A^T A)^-1. It is estimated from random
        vectors whose covariance is that inverse. The proof holds with any units.

        rows, doubt : (m, q) for q unknowns.
        elimination : how to eliminate the matrix rows^T rows, as doubles have formed it.
        factor : its Cholesky factor, if that is known.
        """
        samples, factor = elimination.samples, factor or elimination.factorised_samples(-LEAST_CURVATURE)
        if factor.failed.all():
            return cls(np.zeros(samples.count), np.ones(elimination.size), factor)
        normal = np.random.default_rng(0).standard_normal((elimination.size, RANDOM_VECTORS))[samples.rank]
        size = np.sqrt((factor.drawn(normal) ** 2).mean(axis=1))
        size = np.where(np.isfinite(size) & ~factor.failed[samples.of], size, 1.0)
        unit = np.exp2(np.round(np.log2(np.clip(size, 1 / MOST_UNIT, MOST_UNIT))))
        rows, doubt = (_with_values(part, part.data * unit[part.indices]) for part in (rows, doubt))
        guess = _least_eigenvalue(elimination, factor, unit) / 2
        tau = _floor_by_guess(rows, doubt, elimination.in_units(unit), guess, POWER_ITERATIONS)
        return cls(tau, unit, factor)


def _floor_by_guess(
    rows: sparse.csr_array, doubt: sparse.csr_array, elimination: Elimination, guess: np.ndarray, steps: int
) -> np.ndarray:
    """Return for each of R samples half of its guess, (R,), if all eigenvalues of A^T A are proven to be at least that;
    else 0, and infinity for samples without unknowns.

    A^T A less the guess times the identity is eliminated. If all pivots are positive, this matrix has no eigenvalue
    below minus the errors that are bounded here. If these are less than half of the guess, the other half is proven.

    rows, doubt : (m, n), A differs from the first by no more than the second.
    elimination : how to eliminate the matrix rows^T rows, as doubles have formed it.
    guess : (R,).
    steps : number of power iterations that improve the bounds on errors."""
    samples, found = elimination.samples, np.zeros(elimination.samples.count)
    found[np.bincount(samples.of, minlength=samples.count) == 0] = np.inf
    if found.all() or not (guess > 0).any():
        return found
    terms = samples.largest(np.bincount(rows.indices, minlength=rows.shape[1])) + 4
    sizes = _with_values(rows, np.abs(rows.data)) + doubt
    most, off = (largest_eigenvalue(part, steps, samples) for part in (sizes, doubt))
    # `most` and `off` bound the squared spectral norms of |rows| + doubt and of doubt. Doubles form A^T A as sums of
    # `terms` products, each with a rounding of EPS, and round once more where the diagonal, no more than `most`, is
    # shifted. What is eliminated has no eigenvalue below -missed. The products A^T A of all these A differ from each
    # other by 2 |A| |doubt| at most. So A^T A - guess has no eigenvalue below -(missed + rounding + that difference).
    rounding = (terms + 2) * EPS * most + EPS
    missed = elimination.distance_from_positive(guess)

    def is_proven(difference: np.ndarray | float) -> np.ndarray:
        """Return the mask (R,) of the samples in which half of the guess is proven, if the matrices A^T A of all these
        A differ from each other by no more than `difference`."""
        half_is_left: np.ndarray = (found == 0) & (guess - (missed + rounding + difference) * UP > guess / 2)
        return half_is_left

    proven = is_proven(2 * np.sqrt(most * off))
    if not proven.any() and is_proven(0.0).any():
        proven = is_proven(_largest_of_products(sizes, doubt, steps, samples))
    found[proven] = guess[proven] / 2
    return found


def _largest_of_products(sizes: sparse.csr_array, doubt: sparse.csr_array, steps: int, samples: Samples) -> np.ndarray:
    """Return for each of R samples an upper bound (R,) of the spectral norm of A^T A - A'^T A'. It holds for all
    matrices with |A| and |A'| no more than `sizes` and |A - A'| no more than `doubt`, entry by entry.

    The entries of the difference are at most those of S = sizes^T doubt + doubt^T sizes. The largest of (S x) / x,
    entry by entry, for any positive vector x bounds the norm (Collatz and Wielandt). It is far less than twice the
    product of both norms if doubts are large in other rows than sizes.

    sizes, doubt : (m, n), without negative entries.
    steps : number of power iterations, from ones.
    samples : the sample of each of the n unknowns.
    """
    vector = np.ones(sizes.shape[1])

    def product() -> np.ndarray:
        """Return (n,), the matrix sizes^T doubt + doubt^T sizes times `vector`."""
        found: np.ndarray = sizes.T @ (doubt @ vector) + doubt.T @ (sizes @ vector)
        return found

    for _ in range(steps):
        vector = product()
        vector = vector / np.maximum(samples.largest(vector), TINY)[samples.of] + EPS
    return samples.largest(product() / vector) * UP


def _least_eigenvalue(elimination: Elimination, factor: Factor, unit: np.ndarray | None = None) -> np.ndarray:
    """Return for each of R samples a rough value (R,) of the least eigenvalue of its matrix, by inverse iteration; 0
    where rounding hides it. Nothing about it is proven: proofs start from it as a guess.

    elimination : how the matrix is eliminated, which holds the unknowns of all samples.
    factor : its Cholesky factor.
    unit : (n,), units of the unknowns in which eigenvalues are meant; None for those of the matrix."""
    samples = elimination.samples
    if factor.failed.all():
        return np.zeros(samples.count)
    # each sample begins with the same vector, whether it is alone or beside others
    vector = np.random.default_rng(0).standard_normal(elimination.size)[samples.rank]
    for _ in range(POWER_ITERATIONS):
        vector = vector / samples.norms(vector)[samples.of]
        vector = factor.solve(vector) if unit is None else factor.solve(vector / unit) / unit
    found = 1 / samples.norms(vector)
    return np.where(np.isfinite(found) & ~factor.failed, found, 0.0)


def largest_eigenvalue(rows: sparse.csr_array, steps: int, samples: Samples) -> np.ndarray:
    """Return for each of R samples an upper bound (R,) of the largest eigenvalue of W^T W, for a matrix W without
    negative entries: the largest of (W^T W x) / x, entry by entry, for any positive vector x (Collatz and Wielandt).

    rows : W, (m, n).
    steps : number of power iterations that improve x, from ones.
    samples : the sample of each of the n unknowns."""
    columns, vector = rows.T, np.ones(rows.shape[1])
    for _ in range(steps):
        vector = columns @ (rows @ vector)
        vector = vector / np.maximum(samples.largest(vector), TINY)[samples.of] + EPS
    return samples.largest((columns @ (rows @ vector)) / vector) * UP
