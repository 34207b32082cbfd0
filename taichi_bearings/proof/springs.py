"""Springs that take leftover torques away where components mix, and the largest spins of some minimum: theorem 2.

Symbols
    N spheres, E contacts. n : number of unknowns, the components of the spins of free spheres.
    K : matrix (3 E, n) of slips. b : slips of what is imposed. u*, y* = K u* + b : spins and slips of a minimum.
    q : (E,), stiffnesses of the springs. D : diagonal scale of the unknowns. sigma : proven floor of singular values.
    r : torques that the friction F leaves over. w = mu F_n : friction limits. Phi : potential of any spins.

Why. A lower bound pays for leftover torques at the largest spins that a minimum can have (theorem 1). Where components
mix, no box of imposed spins contains a minimum.

What is done
1. Springs take r away: the friction becomes F - q (K z), where z solves K^T q K z = r. Only torques of rounding, some
   1e-30, are left over.
2. These are paid for at the largest spins of u*. Choose q = w w_min / Phi^2, or q = eta / (2 Phi), whichever is larger.
   Then each contact has q |y*|^2 <= phi(y*) / Phi: for friction as w |y*| <= Phi and w_min <= w, for damping as phi(y*)
   >= eta |y*|^2 / 2. As the potentials phi(y*) add up to at most Phi, the norm of q^1/2 y* is at most 1, and
       |D^-1 u*| <= (1 + |q^1/2 b|) / sigma,    sigma^2 <= least eigenvalue of D K^T q K D.
   An elimination proves sigma^2. All minima have the same potential, so this holds at each of them, if those spheres
   that can turn freely (below) are turned first until the component held at 0 is 0. That changes no slip and no work of
   r.
3. Where frictions differ by many decades, so do these q, and rounding may hide sigma. Then it is tried with q = 1:
   |y*| is at most Phi / w and at most (2 Phi / eta)^1/2 at each contact, so its norm is known as well.

Motions without any slip would make sigma 0. Two kinds are removed first:
* Spheres whose contacts all have one direction can turn about it without slip. The largest component of this direction
  is held at 0.
* Spheres whose contacts bear (nearly) no friction, and whose spins can give any slips to these contacts: the rows of K
  of these contacts are independent, by a floor of K K^T. These contacts roll at every minimum whatever the other
  spheres do, so the spheres are left out (`rolling`).
If other motions slip by no more than rounding, no floor is found. Then the bound holds only for spins up to a multiple
of the fastest imposed one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from taichi_bearings.dissection import Part, dissected, restricted
from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.curvature import Floor, Form, proven_floor
from taichi_bearings.proof.enclosure import UP, Enclosure
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.listed import moments
from taichi_bearings.proof.rounded_elimination import EPS, REGION_UNKNOWNS, Elimination, Samples

# How the forces of springs are solved for; leftover torques are computed anew, so no proof depends on these numbers.
ROUNDS, MOST_SOLVES = 2, 30  # number of solves, and the most where stiffnesses differ so much that solves are inexact
SHIFT = -1e-13  # minus what is added to the diagonal, so that pivots stay positive
LEAST_POWER = 1e-3  # share of the natural potential; springs are made for no smaller one
# Force over mu F_n, or over the largest force, below which a contact is tried as one that rolls. A wrong choice only
# makes the proof fail.
UNSTRESSED = 1e-6


def natural(network: JudgedNetwork) -> np.ndarray:
    """Return for each of R samples a potential (R,) to compare with, in units of the network: that of all contacts if
    they slip as fast as `natural_speed` of the network says (in packings the largest imposed spin component times
    radius).

    network : the R samples."""
    fastest = network.graph.natural_speed(network.largest_imposed, network.speed_unit)
    acts = np.flatnonzero(network.acts)
    limit, damping = (
        network.by_sample(values.at(acts), acts).value for values in (network.friction_limit, network.damping)
    )
    return np.asarray(limit * fastest + damping * fastest**2 / 2)


@dataclass(frozen=True)
class Springs:
    """Fictitious springs at the E contacts of a packing with N spheres, whose normals have any direction. Each resists
    a slip y with the force q y. Their forces are used to balance torques that friction leaves over.

    network : the packing.
    weight : (E,), the stiffness q of each spring.
    fastest : (E,), bound on the slip of each contact at every minimum; 0 for contacts that cannot dissipate.
    number : (N, 3), the index of each spin component among n unknowns; -1 for those that are none.
    form : the quadratic form x^T K^T q K x of the changes x of unknowns, with K the matrix (3 E, n) of slips; unknowns
        are scaled so that it has a diagonal of 1."""

    network: JudgedNetwork
    weight: np.ndarray
    fastest: np.ndarray
    number: np.ndarray
    form: Form

    @classmethod
    def of(cls, network: JudgedNetwork, upper: np.ndarray) -> Springs | None:
        """Return springs so stiff that at every minimum the sum of q |slip|^2 over the contacts of a sample is at most
        1 (step 2 at the head of this file). Return None if some unknown spin component changes no slip.

        upper : (R,), for each of R samples a number above 0 that the potential of minima does not exceed, in units of
            the network. Springs are made for no less than LEAST_POWER of the natural potential."""
        limit, damping = (np.where(network.counts, v.value, 0.0) for v in (network.friction_limit, network.damping))
        least_limit = np.where(limit > 0, limit, np.inf).reshape(network.count, -1).min(axis=1, initial=np.inf)
        least_limit, potential = network.on_contacts(least_limit), network.on_contacts(upper)
        most = network.on_contacts(np.maximum(upper, LEAST_POWER * natural(network)))
        # q is w w_min / Phi^2 or eta / (2 Phi), with the friction limit w, the damping eta and the potential Phi. Slips
        # of minima are at most Phi / w and (2 Phi / eta)^1/2.
        with np.errstate(all="ignore"):
            of_friction = np.where(least_limit < np.inf, limit * (least_limit / most) / most, 0.0)
            weight = np.maximum(of_friction, damping / most / 2)
            fastest = np.where(network.counts, np.minimum(potential / limit, np.sqrt(2 * potential / damping)), 0.0)
        number = np.full((len(network.free), 3), -1)
        is_unknown = network.reached[:, None] & ~turning_freely(network)
        number[is_unknown] = np.arange(is_unknown.sum())
        form = weighed(network, slip_rows(network, number), np.sqrt(np.tile(weight, 3)), number)
        return None if form is None else cls(network, weight, fastest, number, form)

    def balanced(self, goes_on: Callable[[list[Enclosure]], np.ndarray]) -> tuple[list[Enclosure], list[Enclosure]]:
        """Return the stored friction plus forces of the springs, which balance all torques but for rounding; and the
        torques over radius that are still left over. Both by component: 3 enclosures (E,), and 3 enclosures (N,).

        goes_on : function of these torques that returns the mask (R,) of the samples in which they are too large, so
            that another solve is needed. It is called from ROUNDS solves on. Solves end in samples in which the last
            one did not halve the torques."""
        network, factor = self.network, self.form.elimination.factorised_samples(SHIFT)
        torques, is_unknown, friction = network.own_torques, self.number >= 0, network.own_friction
        ended, before, samples = factor.failed.copy(), np.full(network.count, np.inf), self.form.elimination.samples
        spring_force, root = np.zeros_like(network.graph.friction), np.sqrt(np.tile(self.weight, 3))
        for number in range(MOST_SOLVES):
            left = np.stack([part.value for part in torques], axis=1)[is_unknown]
            size = samples.norms(left)
            if number >= ROUNDS:
                ended |= ~goes_on(torques) | (size > before / 2)
            if ended.all():
                break
            # Forces q K z, where z solves K^T q K z = (the torques that are left over).
            left, before = np.where(ended[samples.of], 0.0, left), size
            spring_force += (root * (self.form.rows @ factor.solve(left * self.form.scale))).reshape(3, -1).T
            friction = [Enclosure.exact(f.high, -x) for f, x in zip(network.own_friction, spring_force.T, strict=True)]
            torques = network.torques(moments(friction, network.graph.normal))
        return friction, torques

    @property
    def reach(self) -> np.ndarray:
        """Upper bound (R,), for each of R samples, on the size of every component of free spins (times radius) at some
        minimum; infinite if the springs are not proven to resist all motions of the unknowns."""
        return self._reach(self.form, self.weight, np.ones(self.network.count))

    @property
    def even_reach(self) -> np.ndarray:
        """Upper bound (R,), for each of R samples, on the size of every component of free spins (times radius) at some
        minimum, proven by springs that are all equally stiff. It may be finite where :attr:`reach` is not: where
        stiffnesses differ by so many decades that rounding hides the least eigenvalue."""
        equal, by_sample = self.network.counts.astype(float), self.fastest.reshape(self.network.count, -1)
        form = weighed(self.network, slip_rows(self.network, self.number), np.tile(equal, 3), self.number)
        assert form is not None  # it is None only if a column is 0, and then `self.form` would not have been made
        with np.errstate(all="ignore"):
            return self._reach(form, equal, np.sqrt((by_sample**2).sum(axis=1)))

    def _reach(self, form: Form, weight: np.ndarray, most: np.ndarray) -> np.ndarray:
        """Return an upper bound (R,), for each of R samples, on the size of every component of free spins (times
        radius) at some minimum; infinite if springs are not proven to resist all motions of the unknowns.

        form : the quadratic form of changes of the unknowns, made with these springs.
        weight : (E,), stiffness q of the spring at each contact.
        most : (R,), bound on the norm of q^1/2 slip at every minimum."""
        slips, largest = self.network.slips(self.network.imposed), form.elimination.samples.largest
        squares = sum((weight * part.most**2).reshape(self.network.count, -1).sum(axis=1) for part in slips)
        with np.errstate(all="ignore"):
            floor = form.floor()
            # |D^-1 u*| <= (|q^1/2 y*| + |q^1/2 b|) / sigma for the free spins u* of a minimum in units D, its slips y*
            # and the slips b of the imposed spins alone. sigma^2 is the floor (step 2 at the head of this file).
            found = largest(form.scale) * (most + np.sqrt(squares)) / np.sqrt(floor) * UP**2
        return np.where((floor > 0) & (found >= 0), found, np.inf)


def weighed(
    network: JudgedNetwork,
    rows: sparse.csr_array,
    weight: np.ndarray,
    number: np.ndarray,
    sizes: sparse.csr_array | None = None,
) -> Form | None:
    """Return the quadratic form |A x|^2 of n unknowns x, with the matrix A = `rows` (3 E, n) after each row is
    multiplied by its `weight` (3 E,). The form is stored for unknowns that are scaled so that each column of A gets the
    length 1. Return None if a column of A is 0.

    network : a packing with N spheres and E contacts.
    number : (N, 3), the index of each spin component among the n unknowns; -1 for those that are none.
    sizes : (3 E, n) or None. Each entry of `rows` is a sum of products, and that of `sizes` the sum of their absolute
        values, from which the rounding error is bounded. None if `rows` are exact."""
    by_weight = sparse.diags_array(weight)
    rows = sparse.csr_array(by_weight @ rows)
    rows.eliminate_zeros()
    # An entry has some five roundings (weight, its root, products), or ten where it is a sum of two products with
    # rounded factors; 16 are allowed for. The rounding of a sum is a share of the sizes of its terms.
    doubt = abs(rows) if sizes is None else sparse.csr_array(by_weight @ sizes)
    doubt = sparse.csr_array((16 * EPS * doubt.data, doubt.indices, doubt.indptr), shape=rows.shape)
    sphere = np.nonzero(number >= 0)[0]
    samples = network.samples_of(sphere)
    return Form.of(rows, doubt, network.graph.place[sphere].T, parts=network.parts_of(sphere), samples=samples)


def rolling(network: JudgedNetwork) -> np.ndarray:
    """Return the mask (N,) of free spheres that are proven to have spins at which all their contacts roll, whatever the
    spins of the other spheres: the slips at these contacts are independent, so spins can give any slips. Candidates are
    spheres whose contacts all bear nearly no friction. In a sample where this is not proven of all candidates together,
    connected pieces of candidates are tried one by one.

    network : a packing with N spheres, and the friction of its contacts."""
    size = np.sqrt((network.graph.friction**2).sum(axis=1))
    largest = network.on_contacts(size.reshape(network.count, -1).max(axis=1, initial=0.0))
    small = UNSTRESSED * np.where(network.friction_limit.high > 0, network.friction_limit.high, largest)
    ends = network.graph.contact[:, network.counts & (size > small)]
    candidates = network.reached.copy()
    candidates[ends.ravel()] = False
    first, second = network.graph.contact[:, network.counts]
    inner = candidates[first] & candidates[second]
    label = pieces(len(candidates), first[inner], second[inner])
    independent = _independent(network, candidates)
    unproven = candidates & ~np.repeat(independent, len(candidates) // network.count)
    for piece in np.unique(label[unproven]):
        members = candidates & (label == piece)
        if not _independent(network, members).all():
            candidates &= ~members
    found: np.ndarray = candidates
    return found


def _independent(network: JudgedNetwork, spheres: np.ndarray) -> np.ndarray:
    """Return the mask (R,) of the samples in which the slips at some spheres are proven to be independent: the spins of
    these spheres can give any slips to all of their contacts that can dissipate.

    network : R samples of a packing, with N spheres in all.
    spheres : (N,) mask of the spheres."""
    number = np.full((len(spheres), 3), -1)
    number[spheres] = np.arange(3 * spheres.sum()).reshape(-1, 3)
    own = network.counts & spheres[network.graph.contact].any(axis=0)
    slips = _Slips.of(network, number, own)
    if isinstance(slips, np.ndarray):
        return slips > 0
    # Is a floor of K K^T above 0, with K the matrix of these slips? A floor without units is found more quickly.
    with np.errstate(all="ignore"):
        return proven_floor(slips.columns, rounding_of(slips.columns), slips.elimination) > 0


def floor_by_contact(network: JudgedNetwork, number: np.ndarray, contacts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays that bound the spins which are needed to give any slips to some contacts:

    1. tau : (R,), above 0 in samples in which it is proven that spins can give any slips to all of these contacts (else
       0); infinite in samples without any of them;
    2. unit : (E,), a scale of the slip of each of these contacts, 1 for all others.

    Slips y can be given by spins of the norm ((sum of (unit |y|)^2) / tau)^1/2 or less. And if friction on the contacts
    exerts torques of the norm |r|, it is at each contact at most unit |r| / tau^1/2.

    network : R samples of a packing, with N spheres and E contacts in all.
    number : (N, 3), the index of each spin component among the unknowns; -1 for those that are none.
    contacts : (E,) mask of the contacts.

    Why. Let M give two components of each slip, y' = M x, and let tau be a floor of |M^T g|^2 over the sum of (g /
    unit)^2. The shortest spins with given y' are x = M^T (M M^T)^-1 y', so |x|^2 <= sum of (unit y')^2 / tau. The two
    components fix the whole slip y = P y' of a contact, as it is across its normal, and |P y'| >= |y'|. Friction f
    exerts K^T f = M^T P^T f = M^T g with g = P^T f. As f is across the normal as well, f = P a for some a, and |g| >=
    |f|, since no singular value of P is below 1. So |f| / unit is at most |r| over the root of tau.
    """
    unit, slips = np.ones(len(contacts)), _Slips.of(network, number, contacts)
    if isinstance(slips, np.ndarray):
        return slips, unit
    with np.errstate(all="ignore"):
        floor = Floor.of(slips.columns, rounding_of(slips.columns), slips.elimination)
    unit[slips.contact] = 0.0
    np.maximum.at(unit, slips.contact, floor.unit)
    return floor.tau, unit


@dataclass(frozen=True)
class _Slips:
    """The matrix K that gives the slips of some contacts from n unknown spin components, and an order of elimination of
    K K^T. K has two rows for each contact, q in all. A slip is at right angles to its normal, so two components fix it;
    the one along which the normal is largest is left out.

    columns : K^T, (n, q).
    elimination : of K K^T.
    contact : (q,), the contact of each row of K."""

    columns: sparse.csr_array
    elimination: Elimination
    contact: np.ndarray

    @classmethod
    def of(cls, network: JudgedNetwork, number: np.ndarray, contacts: np.ndarray) -> _Slips | np.ndarray:
        """Return the matrix with an order of elimination, unless floors of the eigenvalues of K K^T are known without
        one. Then return these, (R,): infinity if there is no such contact, 0 if every sample has more rows than
        unknowns.

        network : R samples of a packing, with N spheres and E contacts in all.
        number : (N, 3), the index of each spin component among the unknowns; -1 for those that are none.
        contacts : (E,) mask of the contacts.
        """
        count = len(contacts)
        own = np.ones((3, count), dtype=bool) & contacts
        own[np.argmax(np.abs(network.graph.normal), axis=1), np.arange(count)] = False
        chosen = np.flatnonzero(own.ravel())
        if not len(chosen):
            return np.full(network.count, np.inf)
        columns = sparse.csr_array(slip_rows(network, number)[chosen].T)
        columns.eliminate_zeros()
        # More slips than unknowns, or one that no unknown changes, are not independent.
        samples = Samples(network.sample_of(chosen % count), network.count)
        unknowns = (number >= 0).reshape(network.count, -1).sum(axis=1)
        if (np.bincount(samples.of, minlength=network.count) > unknowns).all():
            return np.zeros(network.count)
        place = network.graph.place[network.graph.contact[0, chosen % count]].T
        parts = _parts_of_slips(network, np.asarray((number >= 0).any(axis=1)), chosen % count)
        return cls(columns, Elimination.of((columns.T @ columns).tocsc(), place, parts, samples), chosen % count)


def _parts_of_slips(network: JudgedNetwork, moves: np.ndarray, contact: np.ndarray) -> list[Part]:
    """Return n slip components in groups, in the order in which they are eliminated from a matrix that couples two
    contacts if they share a moving sphere. Groups come from nested dissection of the graph of these contacts.

    network : a packing with N spheres.
    moves : (N,) mask of the spheres that move.
    contact : (n,), the contact of each slip component."""
    own, node = np.unique(contact, return_inverse=True)
    ends = network.graph.contact[:, own]
    at = np.nonzero(moves[ends])
    touches = sparse.csr_array((np.ones(len(at[0])), (ends[at], at[1])), shape=(len(moves), len(own)))
    place = network.graph.place[ends[0]].T
    return restricted(dissected(touches.T @ touches, place, REGION_UNKNOWNS // 2), node, REGION_UNKNOWNS)


def rounding_of(rows: sparse.csr_array) -> sparse.csr_array:
    """Return bounds on the errors of the entries of a sparse matrix, as a sparse matrix of the same shape.

    rows : the matrix; each of its entries was rounded once.
    """
    return sparse.csr_array((EPS * np.abs(rows.data), rows.indices, rows.indptr), shape=rows.shape)


def slip_rows(network: JudgedNetwork, number: np.ndarray) -> sparse.csr_array:
    """Return the matrix (3 E, n) that gives the slips (u_i + u_j) x n of E contacts from unknown spins, exactly: first
    the x components of all contacts, then y, then z. Here u is spin times radius, n (in the formula) the normal. Rows
    of contacts that cannot dissipate are 0.

    network : a packing with N spheres and E contacts.
    number : (N, 3), the index of each component of u among the n unknowns, which is its column; -1 for those that are
        none.
    """
    # Component k of u x n is u_a n_b - u_b n_a; four entries a row, for a and for b of either sphere.
    a, b, normal = [1, 2, 0], [2, 0, 1], network.graph.normal
    ends = number[network.graph.contact]
    column = np.concatenate([ends[..., a], ends[..., b]]).transpose(2, 1, 0)
    value = np.stack([normal[:, b], -normal[:, a]])[[0, 0, 1, 1]].transpose(2, 1, 0)
    there = (column >= 0) & network.counts[:, None]
    begin = np.append(0, np.cumsum(there.sum(axis=2)))
    shape = (3 * len(normal), int(number.max(initial=-1)) + 1)
    found = sparse.csr_array((value[there], column[there], begin), shape=shape)
    found.sort_indices()
    return found


def numbered(mask: np.ndarray) -> np.ndarray:
    """Return an array of the shape of `mask`: for True entries their number, counted from 0 in order; -1 for the
    others."""
    return np.where(mask, np.cumsum(mask).reshape(mask.shape) - 1, -1)


def turning_freely(network: JudgedNetwork) -> np.ndarray:
    """Return a mask (N, 3) of spin components that shall be held at 0, since their spheres can turn without any slip: a
    sphere whose contacts all have the same normal or its opposite, bit by bit, can turn about this direction. One
    component of it is marked, along which the direction is largest.

    network : a packing with N spheres, with the normals of its contacts."""
    normal = network.graph.normal[network.counts]
    large = np.argmax(np.abs(normal), axis=1)
    direction = normal * np.sign(normal[np.arange(len(normal)), large])[:, None]  # the same for opposite normals
    low, high = np.full((len(network.free), 3), np.inf), np.full((len(network.free), 3), -np.inf)
    for end in network.graph.contact[:, network.counts]:
        np.minimum.at(low, end, direction)
        np.maximum.at(high, end, direction)
    found = np.zeros(low.shape, dtype=bool)
    alike = np.flatnonzero((low == high).all(axis=1))
    found[alike, np.argmax(np.abs(low[alike]), axis=1)] = True
    return found
