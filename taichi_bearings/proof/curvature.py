"""The minimum near given spins, where nothing but the domains of contacts without slip may move: theorem 7.

The power is a convex function of u, the change of the domains from the given spins. Let g be its slope there, and its
curvature at least tau times a positive diagonal h, in variables v of which u are sums. A contact with slip z that
changes by w, |w| <= |z| / 4, resists: (n(z + w) - n(z)) . w >= 0.72 b^2 / |z|, with n the direction of slip and b the
part of w across it. So where sum h v^2 = rho^2, with rho > |g| / (0.72 tau) in the norm of 1 / h, the power rises
outwards if no slip changes by more than a quarter on the way there: all minima are inside. There directions of slip
differ by little. Two minima would differ by slips along these directions alone, which the curvature excludes: there is
just one. Damping eta adds eta w . w to what resists, whatever the slip.

It is a minimum of the whole power if the friction of the contacts that rest can be put in balance there.
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

MOST_SLIP_TURN = 0.25  # largest share by which a slip may change
CURVATURE_TRIALS = 4  # each from spins that Newton's method has improved
RIGID_STIFFNESS = 10.0  # stiffness of a contact, over that of most, from which it holds a cluster together
CURVATURE_SHARE = 1e-7  # of the least curvature
LEAST_CURVATURE, POWER_ITERATIONS = 1e-14, 6  # curvature that rounding hides, and steps of power iterations
TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Slipping:
    """The n contacts of a network that slip. A driven domain, and a component that is not felt, have the unknown -1.

    felt : (2, n), the components of each, -1 for none. lower, upper : (2, n), unknown of the domain at either end,
    component by component. curved : (m,), numbers of those that feel both of them; the difference of the others is
    exactly 0 in one.
    difference : of signed spins, two enclosures (n,). strength : friction that a contact bears. damping : None
    without. own : (n,), their numbers among all contacts. place : (d, n), where a contact is in its sample.
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
        """domain : numbers (n,) of the domains of each component, one of a driven sphere for what does not move; those
        of contacts that rest if not given."""
        network, unknowns, number = motion.network, 0, {}
        some = np.flatnonzero(network.counts & ~motion.rests)
        ends, felt = network.graph.contact[:, some], _slots(network, some)
        for k in network.needed:
            own = motion.domain[k] if domain is None else domain[k]
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
        """Length of the difference, (n,)."""
        first, second = (abs(part).parts for part in self.difference)
        size = Enclosure(*(a + b for a, b in zip(first, second, strict=True)))  # of which one is 0, exactly, if not
        size.put(self.curved, length([part.at(self.curved) for part in self.difference]))
        return size

    @cached_property
    def direction(self) -> tuple[Enclosure, Enclosure]:
        """Of slip, (m,) each: of the curved contacts."""
        size = self.size.at(self.curved)
        return self.difference[0].at(self.curved) / size, self.difference[1].at(self.curved) / size

    @cached_property
    def stiffness(self) -> Enclosure:
        """Friction over slip of the same, (m,)."""
        return self.strength.at(self.curved) / self.size.at(self.curved)

    @cached_property
    def pulls(self) -> tuple[Enclosure, Enclosure]:
        """Force along either component, (n,) each."""
        found = [self.strength.signed(np.sign(part.high)) for part in self.difference]
        for pull, along in zip(found, self.direction, strict=True):
            pull.put(self.curved, self.strength.at(self.curved) * along)
        if self.damping is not None:
            found = [pull + self.damping * part for pull, part in zip(found, self.difference, strict=True)]
        return found[0], found[1]

    def change(self, slot: int) -> sparse.csr_array:
        """(n, unknowns): how the difference of a component changes with the unknowns."""
        ends = np.stack([self.upper[slot], self.lower[slot]], axis=1)
        kept = (ends >= 0) & (ends[:, :1] != ends[:, 1:])  # but those with both ends in one domain
        begin = np.append(0, np.cumsum(kept[:, 0].astype(np.int8) + kept[:, 1]))
        signs = np.broadcast_to([1.0, -1.0], ends.shape)[kept]
        return sparse.csr_array((signs, ends[kept], begin), shape=(len(ends), self.unknowns))

    def moved(self, step: np.ndarray) -> Slipping:
        """After a change of the unknowns (unknowns,)."""
        by = np.append(step, 0.0)
        difference = tuple(
            part + (Enclosure.exact(by[upper]) - Enclosure.exact(by[lower]))
            for part, upper, lower in zip(self.difference, self.upper, self.lower, strict=True)
        )
        return replace(self, difference=(difference[0], difference[1]))

    def slope(self) -> Enclosure:
        """(unknowns,), g: what the slipping contacts leave over on each domain."""
        owner, pulls = [], []
        for slot in range(2):
            for pull, end in ((self.pulls[slot], self.upper[slot]), (-self.pulls[slot], self.lower[slot])):
                free = np.flatnonzero(end >= 0)
                owner.append(end[free])
                pulls.append(pull.at(free))
        return grouped_sum(joined(pulls), np.concatenate(owner), self.unknowns)

    def blocks(self) -> np.ndarray:
        """(unknowns,) number of the block of each unknown: contacts join only unknowns of one block."""
        ends = np.concatenate([self.lower, self.upper])
        some = ends.max(axis=0)  # an unknown if there is any
        pairs = [(end[end >= 0], some[end >= 0]) for end in ends]
        first, second = (np.concatenate([pair[i] for pair in pairs]) for i in range(2))
        return pieces(self.unknowns, first, second)


def _slots(network: JudgedNetwork, some: np.ndarray) -> np.ndarray:
    """(2, k), the two components of some contacts that take the places of the first and the second: those that are
    needed, or, of three, those across each contact; -1 where it feels none."""
    if len(network.needed) == 3:
        axis = np.argmax(np.abs(network.graph.normal[some]), axis=1)
        return np.stack([(axis + 1) % 3, (axis + 2) % 3])
    felt = [np.where(network.feels[k][some], k, -1) for k in network.needed]
    return np.stack([*felt, np.full(len(some), -1)][:2])


@np.errstate(all="ignore")  # what is not finite proves nothing
def nearest_minimum(contacts: Slipping) -> tuple[Slipping, np.ndarray] | None:
    """Contacts near the minimum, and the share (n,) by which each slip differs there at most; None if unknown."""
    if contacts.unknowns == 0:
        return contacts, np.zeros(len(contacts.place[0]))
    for number in range(CURVATURE_TRIALS):
        curvature = Curvature.of(contacts)
        if curvature is None:
            return None
        turn = _turns(contacts, curvature, number == CURVATURE_TRIALS - 1)
        if turn is not None:
            return contacts, turn
        step = curvature.newton_step(contacts.slope().value)
        if step is None:
            return None
        contacts = contacts.moved(step)
        if not (contacts.size.least > 0).all():
            return None
    return None


def _turns(contacts: Slipping, curvature: Curvature, last: bool) -> np.ndarray | None:
    """The same from these contacts as they are. Until the last trial curvature is proven only where it is likely to
    do."""
    root, block = np.sqrt(curvature.form.squares), contacts.blocks()
    slope = curvature.clusters.T @ contacts.slope().most

    def turn(tau: float) -> np.ndarray:
        radius = 1.5 * np.bincount(block, (slope / root) ** 2) ** 0.5 / tau * UP + TINY  # rho, block by block
        reach = radius[block] / root  # of each variable, at most
        return np.asarray(sum((e @ reach) ** 2 for e in curvature.entries) ** 0.5 / contacts.size.least * UP)

    if not (last or (turn(CURVATURE_SHARE / 2) <= MOST_SLIP_TURN).all()):
        return None
    found = turn(curvature.tau)
    return found if curvature.remains(contacts, found) else None


@np.errstate(all="ignore")
def rises(contacts: Slipping, turn: np.ndarray) -> bool:
    """True if the power has curvature in all directions where each slip differs by a share of up to `turn` (n,)."""
    curvature = Curvature.of(contacts) if contacts.unknowns else None
    return contacts.unknowns == 0 or (curvature is not None and curvature.remains(contacts, turn))


def bearable(motion: Motion, contacts: Slipping, turn: np.ndarray, unsure: dict[int, np.ndarray] | None = None) -> bool:
    """True if the friction of the contacts that rest in a motion can be put in balance inside all discs.

    contacts, turn : those that slip near a minimum, and the share by which each slip differs there. unsure : by
    component, (n,), how far the friction of others at each sphere may be from what it has to be.
    """
    network, left = motion.network, {}
    moment, torques = network.own_moment, network.own_torques
    off = _unsure(motion, contacts, turn)
    for k in network.needed:
        residual = np.where(network.free, torques[k].most if unsure is None else torques[k].most + unsure[k], 0.0)
        for slot in range(2):
            some = contacts.felt[slot] == k
            for end in network.graph.contact[:, contacts.own[some]]:
                residual += np.bincount(end, off[slot, some], len(residual))
        residual[~network.free] = 0.0
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
    """(2, n): how far the friction of slipping contacts in their components, as the file says, may be from that at the
    minimum."""
    network, found = motion.network, np.zeros(contacts.felt.shape)
    for slot in range(2):
        said = Enclosure.exact(np.zeros(len(contacts.own)))
        for k in network.needed:
            some = np.flatnonzero(contacts.felt[slot] == k)
            own = contacts.own[some]
            said.put(some, network.moment[k].at(own).signed(network.sign[k][network.graph.contact[1, own]]))
        found[slot] = (contacts.pulls[slot] - said).most
        found[slot, contacts.curved] += 2 * turn[contacts.curved] * contacts.strength.at(contacts.curved).most
        if contacts.damping is not None:
            found[slot] += turn * (contacts.damping * contacts.size).most
    return found


@dataclass(frozen=True)
class Form:
    """A quadratic form A^T A in n unknowns, each measured so that its own square counts as one. rows : about A, doubt :
    how far it may be off, entry by entry. squares : (n,), of each unknown in the rows as they were given."""

    rows: sparse.csr_array
    doubt: sparse.csr_array
    squares: np.ndarray
    elimination: Elimination

    @classmethod
    def of(
        cls, rows: sparse.csr_array, doubt: sparse.csr_array, place: np.ndarray, of_rows: bool = False
    ) -> Form | None:
        """place : (d, n), where each unknown is, or each row. None where an unknown is in no row."""
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
        """(n,), an unknown of each variable."""
        return 1 / np.sqrt(self.squares)

    def floor(self, sharp: bool = False) -> float | None:
        """Proven, of the eigenvalues."""
        return proven_floor(self.rows, self.doubt, self.elimination, sharp)


@dataclass(frozen=True)
class Curvature:
    """H >= tau h in variables v: sum over slipping contacts of (mu / |z|) (what u changes across them)^2.

    clusters : (unknowns, unknowns), u = clusters v. form : of H, h its squares. changes : (n, unknowns), how the
    difference of either component changes with v.
    """

    clusters: sparse.csr_array
    form: Form
    changes: list[sparse.csr_array]

    @classmethod
    def of(cls, contacts: Slipping) -> Curvature | None:
        """None if there is a direction without any."""
        clusters = _clusters(contacts)
        changes = [contacts.change(slot) @ clusters for slot in range(2)]  # exactly, without what both ends share
        rows, doubt, owner = _conditions(contacts, changes)
        form = Form.of(rows, doubt, contacts.place[:, owner], of_rows=True)
        return None if form is None else cls(clusters, form, changes)

    @cached_property
    def tau(self) -> float:
        """Proven; 0 if none can be."""
        return self.form.floor() or 0.0

    @cached_property
    def entries(self) -> list[sparse.csr_array]:
        """Sizes of `changes`, zeros and ones."""
        return [_with(change, np.abs(change.data)) for change in self.changes]

    def remains(self, contacts: Slipping, turn: np.ndarray) -> bool:
        """True if half of it is left where each slip differs by a share of up to `turn` (n,), a quarter at most."""
        # directions turn by 2 * turn at most, and |w|^2 <= sum of entries * sum of entries * v^2
        loss = np.zeros_like(turn)
        loss[contacts.curved] = (2 * turn[contacts.curved]) ** 2 * contacts.stiffness.most
        given_up = sum(e.T @ (loss * e.sum(axis=1)) for e in self.entries)
        return bool((turn <= MOST_SLIP_TURN).all() and (given_up * UP < self.tau * self.form.squares / 2).all())

    def newton_step(self, slope: np.ndarray) -> np.ndarray | None:
        """Change (unknowns,) that takes the slope away, roughly; None if rounding hides the curvature."""
        root, factor = np.sqrt(self.form.squares), self.form.elimination.factorised()
        return None if factor is None else -(self.clusters @ (factor.solve((self.clusters.T @ slope) / root) / root))


def _clusters(contacts: Slipping) -> sparse.csr_array:
    """(unknowns, unknowns), entries 0 and 1: unknowns as sums of changes along the trees of stiff contacts.

    Domains that a tiny slip keeps apart move together on the scale of larger slips. Each but one of such a cluster is
    counted from a neighbour, by trees of the stiffest contacts.
    """
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
    trees = minimum_spanning_tree(graph).tocoo()
    label = connected_components(trees, directed=False)[1]
    heads = np.unique(label[:source], return_index=True)[1]
    heads[label[heads] == label[driven]] = driven
    row, column = np.append(trees.row, np.full(len(heads), source)), np.append(trees.col, heads)
    linked = sparse.csr_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(source + 1, source + 1))
    before = breadth_first_order(linked, source, directed=False)[1][: contacts.unknowns]
    at = [np.arange(contacts.unknowns)] * 2  # each, and what is before it on the way to the head
    entries = []
    while len(at[0]):
        entries.append(at)
        ahead = before[at[1]]
        at = [at[0][ahead < contacts.unknowns], ahead[ahead < contacts.unknowns]]
    rows, columns = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(contacts.unknowns,) * 2)


def _with(matrix: sparse.csr_array, data: np.ndarray) -> sparse.csr_array:
    """Other numbers at the same entries."""
    return sparse.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


def _times(
    values: np.ndarray, matrix: sparse.csr_array, of: Callable[[np.ndarray], np.ndarray] = np.asarray
) -> sparse.csr_array:
    """Each row times its value, of what `of` makes of the entries."""
    return _with(matrix, np.repeat(values, np.diff(matrix.indptr)) * of(matrix.data))


def _conditions(
    contacts: Slipping, changes: list[sparse.csr_array]
) -> tuple[sparse.csr_array, sparse.csr_array, np.ndarray]:
    """Rows A with H = A^T A: the part of a change of slip across the slip, times the root of mu / |z|, and the whole
    change times the root of eta; how far they may be off, entry by entry; and the contact of each row. By friction
    alone slips of one component have no curvature."""
    across, stiffness = (-contacts.direction[1], contacts.direction[0]), contacts.stiffness
    root, inexact = np.sqrt(stiffness.value), stiffness.error / stiffness.most + 16 * EPS
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
    """A tau with A^T A >= tau for all rows A that differ from the given ones by `doubt` at most; None if none is found.
    elimination : of A^T A. The first guess saves a factorisation where it will do, and `sharp` need not be."""
    terms = int(np.bincount(rows.indices).max(initial=0)) + 4
    sizes = _with(rows, np.abs(rows.data)) + doubt
    guesses = (lambda: CURVATURE_SHARE, 1), (lambda: _least_eigenvalue(elimination) / 2, POWER_ITERATIONS)
    for guess, steps in guesses[sharp:]:
        most, off = (_largest_eigenvalue(part, steps) for part in (sizes, doubt))
        tau, error = guess(), 2 * np.sqrt(most * off) + (terms + 1) * EPS * most + EPS
        missed = elimination.distance_from_positive(tau)
        if missed is not None and tau - (missed + error) * UP > tau / 2:
            return tau / 2
    return None


def _least_eigenvalue(elimination: Elimination) -> float:
    """A rough value of the least eigenvalue, by inverse iteration."""
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
    """Upper bound of the largest eigenvalue of W^T W, W without negative entries (Collatz and Wielandt)."""
    columns, vector = rows.T, np.ones(rows.shape[1])
    for _ in range(steps):
        vector = columns @ (rows @ vector)
        vector = vector / max(float(vector.max(initial=0.0)), TINY) + EPS
    return float(((columns @ (rows @ vector)) / vector).max(initial=0.0)) * UP
