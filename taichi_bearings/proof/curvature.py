"""The only minimum near given spins, where only the domains of contacts that do not slip may move: theorem 7.

Letters: n slipping contacts, m of them with two components of slip; u (unknowns,), the change of the spins of all free
domains from the given spins; v, other unknowns of which u are sums; z (two components) the slip of a contact, w its
change; g the slope of the power at the given spins; h the squares by which changes v are measured; tau a proven floor;
rho a radius. A domain is a set of spheres that contacts without slip make turn as one in a component. A contact is
"curved" if it slips in two components: only then can the direction of its slip change.

The power is a convex function of u. Let its curvature at the given spins be at least tau times the positive diagonal h,
in the variables v. While |w| <= |z| / 4, friction of size 1 resists by (n(z + w) - n(z)) . w >= 0.72 b^2 / |z|, where n
is the direction of a slip and b the part of w across z. So on the surface sum h v^2 = rho^2, with rho > |g| / (0.72
tau) in the norm of 1 / h, the power rises outwards if no slip changes by more than a quarter on the way there: all
minima are inside. Inside, directions of slip differ little. Two minima would differ by slips along these directions
alone, which the curvature excludes: there is just one. Damping eta adds eta w . w to what resists, whatever the slip.

This minimum, with resting contacts held at rest, is the minimum of the whole power if the friction of the resting
contacts can be put in balance there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.proof.enclosure import UP, Enclosure, grouped_sum, joined, length
from taichi_bearings.proof.judged_network import JudgedNetwork, Motion
from taichi_bearings.proof.rounded_elimination import EPS, Elimination

MOST_SLIP_TURN = 0.25  # largest change of a slip, over its size, for which 0.72 above holds
CURVATURE_TRIALS = 4  # number of trials, each but the first from spins that a step of Newton's method has improved
RIGID_STIFFNESS = 10.0  # stiffness mu F_n / |z| over the median, beyond which a contact holds a cluster together
CURVATURE_SHARE = 1e-7  # first guess of tau, which most networks exceed by far
LEAST_CURVATURE, POWER_ITERATIONS = 1e-14, 6  # curvature that rounding hides, and number of power iterations
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Slipping:
    """The n contacts of a network that slip, and the unknowns that change their slips: one for each free domain of each
    component. The number -1 stands for a driven domain, and for a component in which a contact does not slip.

    unknowns : their number.
    felt : (2, n), the one or two components in which each contact slips, -1 for none.
    lower, upper : (2, n), unknown of the domain at the first and at the second sphere, for either component in `felt`.
    curved : (m,), numbers (0 to n - 1) of the contacts that slip in two components; of the other contacts one entry of
        `difference` is exactly 0.
    difference : signed spin of the second sphere less that of the first, one enclosure (n,) for each row of `felt`: the
        slip.
    strength : (n,), mu F_n.
    damping : (n,), eta; None for laws without damping.
    own : (n,), numbers of these contacts among all of the network.
    place : (d, n), where a contact is in its sample.
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
    def of(cls, motion: Motion, domain: dict[int, np.ndarray] | None = None) -> Slipping:
        """Collect the contacts that take part and do not rest in a motion.

        motion : says which contacts rest, and how spheres turn.
        domain : by component, the number (N,) of the domain of each sphere, where what does not move has the domain of
            a driven sphere; if not given, the domains that the resting contacts of `motion` make.
        """
        network, unknowns, number = motion.network, 0, {}
        some = np.flatnonzero(network.counts & ~motion.rests)
        ends, felt = network.graph.contact[:, some], _slots(network, some)
        for k in network.needed:
            own = motion.domain[k] if domain is None else domain[k]
            # A domain gets an unknown if a slipping contact joins it to another domain and no sphere of it is driven.
            joins = own[ends[:, network.feels[k][some]]]
            free = np.zeros(int(own.max()) + 1, dtype=bool)
            free[joins[:, joins[0] != joins[1]]] = True
            free[own[~network.free]] = False
            number[k] = np.where(free, unknowns + np.cumsum(free) - 1, -1)[own]
            unknowns += int(free.sum())
        lower, upper = np.full((2, len(some)), -1), np.full((2, len(some)), -1)
        difference = [Enclosure.exact(np.zeros(len(some))) for _ in range(2)]
        for slot in range(2):
            for k in network.needed:
                mine = np.flatnonzero(felt[slot] == k)
                if not len(mine):
                    continue
                lower[slot, mine], upper[slot, mine] = number[k][ends[:, mine]]
                difference[slot].put(mine, motion.difference(k, some[mine]))
        strength, damping = network.holding.at(some), network.slope.at(some) if network.law.flows else None
        place = network.graph.middle(some).T
        curved, pair = np.flatnonzero((felt >= 0).all(axis=0)), (difference[0], difference[1])
        return cls(unknowns, felt, lower, upper, curved, pair, strength, damping, some, place)

    @cached_property
    def size(self) -> Enclosure:
        """Slip speed |z| of each contact, (n,)."""
        first, second = (abs(part).parts for part in self.difference)
        size = Enclosure(*(a + b for a, b in zip(first, second, strict=True)))  # one is exactly 0 unless curved
        size.put(self.curved, length([part.at(self.curved) for part in self.difference]))
        return size

    @cached_property
    def direction(self) -> tuple[Enclosure, Enclosure]:
        """The two components of the unit vector along the slip of each curved contact, (m,) each."""
        size = self.size.at(self.curved)
        return self.difference[0].at(self.curved) / size, self.difference[1].at(self.curved) / size

    @cached_property
    def stiffness(self) -> Enclosure:
        """Friction over slip speed, mu F_n / |z|, of each curved contact, (m,)."""
        return self.strength.at(self.curved) / self.size.at(self.curved)

    @cached_property
    def pulls(self) -> tuple[Enclosure, Enclosure]:
        """The two components of the force of each contact, friction along the slip and damping times the slip, (n,)
        each."""
        found = [self.strength.signed(np.sign(part.high)) for part in self.difference]
        for pull, along in zip(found, self.direction, strict=True):
            pull.put(self.curved, self.strength.at(self.curved) * along)
        if self.damping is not None:
            found = [pull + self.damping * part for pull, part in zip(found, self.difference, strict=True)]
        return found[0], found[1]

    def change(self, slot: int) -> sparse.csr_array:
        """Matrix (n, unknowns) with entries 1, -1 and 0: how the difference of spins of each contact changes with the
        unknowns. slot : 0 or 1, which of the two components in `felt`."""
        ends = np.stack([self.upper[slot], self.lower[slot]], axis=1)
        kept = (ends >= 0) & (ends[:, :1] != ends[:, 1:])  # a contact within one domain has no difference
        begin = np.append(0, np.cumsum(kept[:, 0].astype(np.int8) + kept[:, 1]))
        signs = np.broadcast_to([1.0, -1.0], ends.shape)[kept]
        return sparse.csr_array((signs, ends[kept], begin), shape=(len(ends), self.unknowns))

    def moved(self, step: np.ndarray) -> Slipping:
        """The same contacts after the unknowns have changed by `step` (unknowns,)."""
        by = np.append(step, 0.0)
        difference = tuple(
            part + (Enclosure.exact(by[upper]) - Enclosure.exact(by[lower]))
            for part, upper, lower in zip(self.difference, self.upper, self.lower, strict=True)
        )
        return replace(self, difference=(difference[0], difference[1]))

    def slope(self) -> Enclosure:
        """The slope g of the power, (unknowns,): the torque that the slipping contacts exert on each free domain."""
        owner, pulls = [], []
        for slot in range(2):
            for pull, end in ((self.pulls[slot], self.upper[slot]), (-self.pulls[slot], self.lower[slot])):
                free = np.flatnonzero(end >= 0)
                owner.append(end[free])
                pulls.append(pull.at(free))
        return grouped_sum(joined(pulls), np.concatenate(owner), self.unknowns)

    def blocks(self) -> np.ndarray:
        """(unknowns,), the number of the block of each unknown: contacts join only unknowns of one block."""
        ends = np.concatenate([self.lower, self.upper])
        some = ends.max(axis=0)  # an unknown of the contact if it has any
        pairs = [(end[end >= 0], some[end >= 0]) for end in ends]
        first, second = (np.concatenate([pair[i] for pair in pairs]) for i in range(2))
        return pieces(self.unknowns, first, second)


def _slots(network: JudgedNetwork, some: np.ndarray) -> np.ndarray:
    """(2, k), the components in which contacts may slip, in two places: the components that are needed, or, if all
    three are, the two across the normal of each contact; -1 where a contact does not slip in a component. some :
    numbers (k,) of contacts."""
    if len(network.needed) == 3:
        axis = np.argmax(np.abs(network.graph.normal[some]), axis=1)
        return np.stack([(axis + 1) % 3, (axis + 2) % 3])
    felt = [np.where(network.feels[k][some], k, -1) for k in network.needed]
    return np.stack([*felt, np.full(len(some), -1)][:2])


@np.errstate(all="ignore")  # what is not finite proves nothing
def nearest_minimum(contacts: Slipping) -> tuple[Slipping, np.ndarray] | None:
    """The contacts at spins near the minimum, and the share (n,) by which each slip there differs from them at most;
    None if no such share can be proven. contacts : those of the given spins; the returned ones may have been moved by
    steps of Newton's method."""
    if contacts.unknowns == 0:
        return contacts, np.zeros(len(contacts.place[0]))
    for number in range(CURVATURE_TRIALS):
        curvature = Curvature.of(contacts)
        if curvature is None:
            return None
        turn = _changes_of_slips(contacts, curvature, number == CURVATURE_TRIALS - 1)
        if turn is not None:
            return contacts, turn
        step = curvature.newton_step(contacts.slope().value)
        if step is None:
            return None
        contacts = contacts.moved(step)
        if not (contacts.size.least > 0).all():
            return None
    return None


def _changes_of_slips(contacts: Slipping, curvature: Curvature, last: bool) -> np.ndarray | None:
    """The share (n,) of its size by which each slip at the minimum may differ from that of `contacts`; None if it is
    not proven. curvature : that at `contacts`. last : whether there is no further trial. Before the last one, tau is
    proven (which is costly) only if the radius that it would give looks small enough."""
    root, block = np.sqrt(curvature.form.squares), contacts.blocks()
    slope = curvature.clusters.T @ contacts.slope().most

    # Theorem: sum h v^2 <= rho^2 at the minimum. 1.5 is above 1 / 0.72, and each block has a radius of its own, as no
    # contact joins two of them.
    def turn(tau: float) -> np.ndarray:
        """(n,), bound on the change of each slip over its size, if `tau` is a floor."""
        radius = 1.5 * np.bincount(block, (slope / root) ** 2) ** 0.5 / tau * UP + TINY  # rho, block by block
        reach = radius[block] / root  # largest change of each variable
        return np.asarray(sum((e @ reach) ** 2 for e in curvature.entries) ** 0.5 / contacts.size.least * UP)

    if not (last or (turn(CURVATURE_SHARE / 2) <= MOST_SLIP_TURN).all()):
        return None
    found = turn(curvature.tau)
    return found if curvature.remains(contacts, found) else None


@np.errstate(all="ignore")
def rises(contacts: Slipping, turn: np.ndarray) -> bool:
    """True if the power has curvature in all directions wherever each slip differs from that of `contacts` by a share
    of up to `turn` (n,)."""
    curvature = Curvature.of(contacts) if contacts.unknowns else None
    return contacts.unknowns == 0 or (curvature is not None and curvature.remains(contacts, turn))


def bearable(motion: Motion, contacts: Slipping, turn: np.ndarray, unsure: dict[int, np.ndarray] | None = None) -> bool:
    """True if the friction of the contacts that rest in a motion can be put in balance inside all friction discs.

    contacts, turn : those that slip near a minimum, and the share (n,) by which each slip there differs.
    unsure : by component, (N,), how far the friction of other contacts at each sphere may be from what it has to be.
    """
    network, left = motion.network, {}
    moment, torques = network.own_moment, network.own_torques
    off = _unsure(motion, contacts, turn)
    for k in network.needed:
        # Bound the torque on each sphere that resting contacts have to take up: what the given friction leaves over,
        # and how far friction of slipping contacts may be from that at the minimum.
        residual = np.where(network.free, torques[k].most if unsure is None else torques[k].most + unsure[k], 0.0)
        for slot in range(2):
            some = contacts.felt[slot] == k
            for end in network.graph.contact[:, contacts.own[some]]:
                residual += np.bincount(end, off[slot, some], len(residual))
        residual[~network.free] = 0.0
        # It travels through contacts of the domain, along a tree, so no contact carries more than the sum over the
        # domain.
        domain = motion.domain[k]
        left[k] = np.bincount(domain, residual)[domain] * UP
    still = np.flatnonzero(motion.rests & network.counts)
    feels = {k: network.feels[k][still] for k in network.needed}
    borne = length([moment[k].at(still).where(feels[k]) for k in network.needed])
    room = network.holding.at(still) - borne
    first = network.graph.contact[0, still]
    more = np.sqrt(sum(np.where(feels[k], left[k][first], 0.0) ** 2 for k in network.needed))
    bears = np.any(list(feels.values()), axis=0)
    return bool((~bears | ((room.high > 0) & (room.least > more * UP))).all())


def _unsure(motion: Motion, contacts: Slipping, turn: np.ndarray) -> np.ndarray:
    """(2, n), how far each component of the friction of slipping contacts, as it was given, may be from that at the
    minimum. contacts, turn : as of :func:`bearable`."""
    network, found = motion.network, np.zeros(contacts.felt.shape)
    for slot in range(2):
        said = Enclosure.exact(np.zeros(len(contacts.own)))
        for k in network.needed:
            some = np.flatnonzero(contacts.felt[slot] == k)
            own = contacts.own[some]
            said.put(some, network.moment[k].at(own).signed(network.sign[k][network.graph.contact[1, own]]))
        found[slot] = (contacts.pulls[slot] - said).most
        # A slip that changes by a share t of its size changes its unit vector by at most 2 t.
        found[slot, contacts.curved] += 2 * turn[contacts.curved] * contacts.strength.at(contacts.curved).most
        if contacts.damping is not None:
            found[slot] += turn * (contacts.damping * contacts.size).most
    return found


@dataclass(frozen=True)
class Form:
    """A quadratic form A^T A in n unknowns, scaled such that every column of A has length 1, up to rounding.

    rows : A, in doubles.
    doubt : entry by entry, how far the exact A may be from it.
    squares : (n,), the squared length of each column before it was scaled.
    elimination : of A^T A.
    """

    rows: sparse.csr_array
    doubt: sparse.csr_array
    squares: np.ndarray
    elimination: Elimination

    @classmethod
    def of(
        cls, rows: sparse.csr_array, doubt: sparse.csr_array, place: np.ndarray, of_rows: bool = False
    ) -> Form | None:
        """Scale the columns of `rows` and of `doubt`, and order the elimination; None where a column is 0 or not
        finite.

        place : (d, n), where each unknown is; with `of_rows` where each row is, and unknowns are put at the mean of
            their rows.
        """
        squares = np.bincount(rows.indices, rows.data**2, rows.shape[1])
        if not ((squares > 0) & (squares < np.inf)).all():
            return None
        inverse = 1 / np.sqrt(squares)
        rows, doubt = (_with(part, part.data * inverse[part.indices]) for part in (rows, doubt))
        if of_rows:
            place = place @ _with(rows, rows.data**2)
        return cls(rows, doubt, squares, Elimination.of((rows.T @ rows).tocsc(), place))

    @cached_property
    def scale(self) -> np.ndarray:
        """(n,), by which the scaled unknowns are multiplied to give the original ones."""
        return 1 / np.sqrt(self.squares)

    def floor(self, sharp: bool = False) -> float | None:
        """Proven lower bound tau of the eigenvalues of the scaled form; None if none is found. sharp : as of
        :func:`proven_floor`."""
        return proven_floor(self.rows, self.doubt, self.elimination, sharp)


@dataclass(frozen=True)
class Curvature:
    """The curvature H of the power in variables v, the sum over slipping contacts of (mu F_n / |z|) (change of the slip
    across it)^2 + eta (change of the slip)^2, and a floor H >= tau h.

    clusters : (unknowns, unknowns), entries 0 and 1, with u = clusters v.
    form : H in scaled variables; its `squares` are h.
    changes : two matrices (n, unknowns), how either component of the slips changes with v.
    """

    clusters: sparse.csr_array
    form: Form
    changes: list[sparse.csr_array]

    @classmethod
    def of(cls, contacts: Slipping) -> Curvature | None:
        """The curvature at the slips of `contacts`; None if some variable changes no slip across."""
        clusters = _clusters(contacts)
        changes = [contacts.change(slot) @ clusters for slot in range(2)]  # exact; what both ends share cancels
        rows, doubt, owner = _conditions(contacts, changes)
        form = Form.of(rows, doubt, contacts.place[:, owner], of_rows=True)
        return None if form is None else cls(clusters, form, changes)

    @cached_property
    def tau(self) -> float:
        """The proven floor, H >= tau h; 0 if none is proven."""
        return self.form.floor() or 0.0

    @cached_property
    def entries(self) -> list[sparse.csr_array]:
        """The sizes of the entries of `changes`: zeros and ones."""
        return [_with(change, np.abs(change.data)) for change in self.changes]

    def remains(self, contacts: Slipping, turn: np.ndarray) -> bool:
        """True if at least half of tau is proven to remain where each slip differs by a share of up to `turn` (n,) of
        its size, a quarter at most."""
        # a unit vector along a slip changes by at most 2 * turn; with the entries e of the row of a contact,
        # |w|^2 <= (sum of e) (sum of e v^2) by Cauchy and Schwarz
        loss = np.zeros_like(turn)
        loss[contacts.curved] = (2 * turn[contacts.curved]) ** 2 * contacts.stiffness.most
        given_up = sum(e.T @ (loss * e.sum(axis=1)) for e in self.entries)
        return bool((turn <= MOST_SLIP_TURN).all() and (given_up * UP < self.tau * self.form.squares / 2).all())

    def newton_step(self, slope: np.ndarray) -> np.ndarray | None:
        """Change (unknowns,) of the unknowns that makes `slope` (unknowns,) vanish to first order; None if rounding
        hides the curvature. Nothing is proven of it."""
        root, factor = np.sqrt(self.form.squares), self.form.elimination.factorised()
        return None if factor is None else -(self.clusters @ (factor.solve((self.clusters.T @ slope) / root) / root))


def _clusters(contacts: Slipping) -> sparse.csr_array:
    """Matrix (unknowns, unknowns) with entries 0 and 1 by which unknowns u are sums of variables v, as Newton's method
    and the floor tau are better behaved in v.

    Domains that only a tiny slip keeps apart form a cluster: they move together when larger slips change. All domains
    of a cluster but one are measured from a neighbour, along a tree of the stiffest contacts.
    """
    # Graph of the stiff contacts between unknowns, all driven domains being one node and a source another.
    driven, source = contacts.unknowns, contacts.unknowns + 1
    stiffness = contacts.stiffness.value
    stiff = stiffness > RIGID_STIFFNESS * (np.median(stiffness) if len(stiffness) else np.inf)
    ends = (end[:, contacts.curved[stiff]] for end in (contacts.lower, contacts.upper))
    first, second = (np.where(end < 0, driven, end).ravel() for end in ends)
    slip = np.tile(1 / stiffness[stiff], 2)
    apart = first != second
    order = np.argsort(-slip[apart], kind="stable")  # of parallel contacts the last entry, the stiffest, is kept
    low, high = np.minimum(first, second)[apart][order], np.maximum(first, second)[apart][order]
    last = np.unique((low * source + high)[::-1], return_index=True)[1]
    low, high, slip = low[::-1][last], high[::-1][last], slip[apart][order][::-1][last]
    places = (low.astype(np.int32), high.astype(np.int32))  # which SciPy before 1.17 asks for
    graph = sparse.csr_array((slip, places), shape=(source + 1, source + 1))
    # A tree of the stiffest contacts in each cluster, with a head: the driven node if it is there, else the first
    # unknown.
    trees = minimum_spanning_tree(graph).tocoo()
    label = connected_components(trees, directed=False)[1]
    heads = np.unique(label[:source], return_index=True)[1]
    heads[label[heads] == label[driven]] = driven
    row, column = np.append(trees.row, np.full(len(heads), source)), np.append(trees.col, heads)
    linked = sparse.csr_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(source + 1, source + 1))
    # The neighbour of each unknown that is next on the way to the head of its cluster.
    before = breadth_first_order(linked, source, directed=False)[1][: contacts.unknowns]
    at = [np.arange(contacts.unknowns)] * 2  # pairs: an unknown, and a variable on its way to the head, itself first
    entries = []
    while len(at[0]):
        entries.append(at)
        ahead = before[at[1]]
        at = [at[0][ahead < contacts.unknowns], ahead[ahead < contacts.unknowns]]
    rows, columns = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(contacts.unknowns,) * 2)


def _with(matrix: sparse.csr_array, data: np.ndarray) -> sparse.csr_array:
    """A sparse matrix with entries at the same places as those of `matrix`, whose values are `data`."""
    return sparse.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


def _times(
    values: np.ndarray, matrix: sparse.csr_array, of: Callable[[np.ndarray], np.ndarray] = np.asarray
) -> sparse.csr_array:
    """The matrix with each row multiplied by its number in `values`. of : function that is applied to the entries
    first."""
    return _with(matrix, np.repeat(values, np.diff(matrix.indptr)) * of(matrix.data))


def _conditions(
    contacts: Slipping, changes: list[sparse.csr_array]
) -> tuple[sparse.csr_array, sparse.csr_array, np.ndarray]:
    """Rows A with H = A^T A, a bound on the error of each entry, and the contact (0 to n - 1) of each row. changes : as
    of :class:`Curvature`.

    A row of a curved contact is the change of its slip across the slip times the root of mu F_n / |z|; with damping
    every contact has two more rows, both components of the change of its slip times the root of eta. A contact that
    slips in one component has no curvature by friction.
    """
    across, stiffness = (-contacts.direction[1], contacts.direction[0]), contacts.stiffness
    root, inexact = np.sqrt(stiffness.value), stiffness.error / stiffness.most + 16 * EPS  # 16: a few roundings, amply
    rows, doubt = [], []
    for part, change in zip(across, (whole[contacts.curved] for whole in changes), strict=True):
        rows.append(_times(root * part.value, change))
        doubt.append(_times(root * (part.error + inexact * part.most), change, np.abs))
    found, unsure, owner = rows[0] + rows[1], doubt[0] + doubt[1], [contacts.curved]
    found.eliminate_zeros()
    if contacts.damping is None:
        return found, unsure, contacts.curved
    root, inexact = np.sqrt(contacts.damping.value), contacts.damping.error / contacts.damping.most + 16 * EPS
    whole, off = [found], [unsure]
    for change in changes:
        whole.append(_times(root, change))
        off.append(_times(root * inexact, change, np.abs))
        owner.append(np.arange(len(root)))
    found, unsure = (sparse.csr_array(sparse.vstack(parts, format="csr")) for parts in (whole, off))
    return found, unsure, np.concatenate(owner)


def proven_floor(
    rows: sparse.csr_array, doubt: sparse.csr_array, elimination: Elimination, sharp: bool = False
) -> float | None:
    """A tau such that A^T A >= tau, as an inequality of eigenvalues, for all A that differ from `rows` by no more than
    `doubt` in each entry; None if none is found. elimination : of A^T A.

    The first guess, CURVATURE_SHARE, saves an estimate of the least eigenvalue where it is enough. sharp : leave it
    out, as the floor should be as large as can be.
    """
    terms = int(np.bincount(rows.indices).max(initial=0)) + 4
    sizes = _with(rows, np.abs(rows.data)) + doubt
    guesses = (lambda: CURVATURE_SHARE, 1), (lambda: _least_eigenvalue(elimination) / 2, POWER_ITERATIONS)
    for guess, steps in guesses[sharp:]:
        most, off = (_largest_eigenvalue(part, steps) for part in (sizes, doubt))
        # All A^T A differ by 2 |A| |doubt| at most; forming the product rounds each entry (terms + 1) times at most,
        # shifting its diagonal once.
        tau, error = guess(), 2 * np.sqrt(most * off) + (terms + 1) * EPS * most + EPS
        missed = elimination.distance_from_positive(tau)
        # A^T A - tau is positive but for `missed` and `error`: if these take less than half of tau, tau / 2 is a floor.
        if missed is not None and tau - (missed + error) * UP > tau / 2:
            return tau / 2
    return None


def _least_eigenvalue(elimination: Elimination) -> float:
    """A rough value, of which nothing is proven, of the least eigenvalue of the eliminated matrix, by inverse
    iteration; 0 where rounding hides it."""
    factor, vector = (
        elimination.factorised(-LEAST_CURVATURE),
        np.random.default_rng(0).standard_normal(elimination.size),
    )
    if factor is None:
        return 0.0
    for _ in range(POWER_ITERATIONS):
        vector = factor.solve(vector / np.linalg.norm(vector))
        if not np.isfinite(vector).all():
            return 0.0
    return float(1 / np.linalg.norm(vector))


def _largest_eigenvalue(rows: sparse.csr_array, steps: int) -> float:
    """Upper bound of the largest eigenvalue of W^T W, for `rows` W without negative entries: the largest of (W^T W x) /
    x for any positive x (Collatz and Wielandt). steps : power iterations by which x is improved."""
    columns, vector = rows.T, np.ones(rows.shape[1])
    for _ in range(steps):
        vector = columns @ (rows @ vector)
        vector = vector / max(float(vector.max(initial=0.0)), TINY) + EPS
    return float(((columns @ (rows @ vector)) / vector).max(initial=0.0)) * UP
