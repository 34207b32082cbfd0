"""Which contacts slip at every minimum of the Coulomb law, proven from approximate spins and friction.

Let T be the contacts without any slip and S the others. Spheres joined by T are one domain of a component.

1. Over motions that keep every domain in one piece the power is a convex function of u, the change from these spins. Let
   its slope here be g, and its curvature at least tau times a positive diagonal h. A contact with slip z that changes by
   w, |w| <= |z| / 4, resists: (n(z + w) - n(z)) . w >= 0.72 b^2 / |z|, n being the direction of slip and b the part of w
   across it. So where sum h u^2 = rho^2, rho > |g| / (0.72 tau) in the norm of 1 / h, the power rises outwards, if no slip
   changes by more than a quarter there: all minima are inside. There directions of slip differ by little, two minima
   would differ by slips along them, and that the curvature excludes: there is just one.
2. At that minimum every contact of S still slips and exerts its friction along the slip; this is known closely. What
   the contacts of T bear, as the file says, balances it up to E_D, the sum of the torques left over in a domain D. Each
   domain is in balance as a whole, or held by a driven plane: so forces along the contacts that join it, none larger
   than E_D, take away what is left over. If then every contact of T stays inside its friction disc, the result is in
   balance and admissible, and it agrees with the law at every contact: the minimum of step 1 is one of the whole power.
3. All minima share all optimal forces (PHYSICS 4): where the friction is below its limit nothing slips. So T rests at
   every minimum; every minimum then is one of step 1, where there is only one, and S slips at it.

With one component (all of 2D, and cubic lattices driven about x or y) step 1 has no curvature. There minima are
mixtures of lightest cuts, and friction in balance leaves room on them for no more than the gap G between the bounds: a
cut that crosses from u to v has mu F_n - f <= G there. Spheres from which and to which one can go with more room than G
are on one side of every lightest cut. That decides contacts one by one, ties or not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.sparse.linalg import splu

from taichi_bearings.verifier.bounds import torques
from taichi_bearings.verifier.enclosure import UP, Enclosure, grouped_sum, joined
from taichi_bearings.verifier.motion import Motion, ends_of, length, whole_planes
from taichi_bearings.verifier.samples import Samples

UNPROVEN, SLIPLESS, SLIPPING = 0, 1, 2
TURN = 0.25  # largest share by which a slip may change in step 1
LEAST_CURVATURE, STEPS = 1e-13, 6  # tau below which rounding of the factorisation hides it; of its inverse iteration
EPS = np.finfo(np.float64).eps


@dataclass(frozen=True)
class States:
    """Of one sample. proven : one array (*contacts,) an axis of UNPROVEN, SLIPLESS or SLIPPING. unique : is there only one
    minimum? None if that is not known. reason : why not all is proven, or "".
    """

    proven: tuple[np.ndarray, ...]
    unique: bool | None
    reason: str = ""


def proven_states(motion: Motion, gap: np.ndarray) -> list[States]:
    """gap : (R,), upper bound of power - least power, in the units of `Motion.power`."""
    samples = motion.samples
    if samples.law == "viscous":
        return _by_distance(motion, gap)
    if not samples.needed:
        return [States(tuple(np.full(c.shape[1:], SLIPLESS) for c in samples.coefficient), True)] * samples.count
    decided = _by_cuts(motion, gap) if len(samples.needed) == 1 else _by_curvature(motion)
    idle = {k: _rests(motion, k) for k in set(samples.components) - set(samples.needed)}
    found = []
    for number, states in enumerate(decided):
        varies = [k for k, rests in idle.items() if not rests[number]]
        if motion.torn[number]:
            states = _nothing(samples, "contacts without slip join the two driven planes")
        elif varies:
            states = _nothing(samples, f"the spin component about {'xyz'[varies[0]]} varies, which it does at no minimum")
        found.append(states)
    return found


def _nothing(samples: Samples, reason: str) -> States:
    return States(tuple(np.full(c.shape[1:], UNPROVEN) for c in samples.coefficient), None, reason)


def _rests(motion: Motion, component: int) -> np.ndarray:
    """(R,), True if a component that the driving does not need is equal at both ends of every contact that feels it."""
    samples, rests = motion.samples, np.ones(motion.samples.count, dtype=bool)
    for axis in range(samples.dimension):
        if component in samples.felt(axis):
            low, high = samples.ends(axis)
            for part in samples.signed_spin[component]:
                rests &= (part[low] == part[high]).reshape(samples.count, -1).all(axis=1)
    return rests


def _by_distance(motion: Motion, gap: np.ndarray) -> list[States]:
    """Viscous: the power exceeds the least one by the sum of eta |z - z*|^2, so slips that would cost more do not end."""
    found = []
    for still, size, strength in zip(motion.still, motion.size, motion.samples.strength, strict=True):
        states = np.full(still.shape, UNPROVEN)
        costs = strength[~still].least * size.least**2 / UP
        states[~still] = np.where(costs > gap[np.nonzero(~still)[0]], SLIPPING, UNPROVEN)
        found.append(states)
    return [States(tuple(states[r] for states in found), True) for r in range(motion.samples.count)]


def _by_cuts(motion: Motion, gap: np.ndarray) -> list[States]:
    """One component: what is on the same side, or on opposite sides, of all lightest cuts."""
    samples, place = motion.samples, whole_planes(motion.samples)
    (k,) = samples.needed
    sign = samples.sublattice[None] * (1.0 if samples.jump[k].high[0] > 0 else -1.0)
    below, above, up, down, owner = [], [], [], [], []
    for axis in range(samples.dimension):
        if k in samples.felt(axis):
            low, high = samples.ends(axis)
            bears = Enclosure.exact(sign[high] * samples.turning[axis][k])
            up.append((samples.strength[axis] - bears).reshaped((-1,)))
            down.append((samples.strength[axis] + bears).reshaped((-1,)))
            below.append(place[low].ravel())
            above.append(place[high].ravel())
            owner.append(np.indices(bears.high.shape, sparse=True)[0].repeat(bears.high[0].size).ravel())
    lower, upper, of_sample = (np.concatenate(parts) for parts in (below, above, owner))
    slack = joined(up), joined(down)
    excess = sum(
        np.bincount(of_sample, np.maximum(s.error - s.high - s.low, 0.0), samples.count) for s in slack
    )
    room = ((gap / samples.jump[k].least + excess) * UP)[of_sample]
    # with more room than all have together: if the first sphere is above a lightest cut, so is the second
    held = [s.least * (s.high > 0) > room for s in slack]
    first = np.concatenate([upper[held[0]], lower[held[1]]])
    second = np.concatenate([lower[held[0]], upper[held[1]]])
    size = place.size
    follows = sparse.csr_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(size, size))
    together = connected_components(follows, directed=True, connection="strong")[1]
    bottom, top = (end.ravel() for end in ends_of(place))
    is_above, is_below = _reached(follows, top), _reached(follows.T.tocsr(), bottom)
    found = []
    for axis, coefficient in enumerate(samples.coefficient):
        a, b = (place[end] for end in samples.ends(axis))
        alike = (together[a] == together[b]) | (is_above[a] & is_above[b]) | (is_below[a] & is_below[b])
        apart = (is_above[a] & is_below[b]) | (is_below[a] & is_above[b])
        states = np.where(alike, SLIPLESS, np.where(apart, SLIPPING, UNPROVEN))
        found.append(states if k in samples.felt(axis) else np.full(coefficient.shape, SLIPLESS))
    return [_of_cuts(samples, tuple(states[r] for states in found), not is_above[bottom[r]]) for r in range(samples.count)]


def _of_cuts(samples: Samples, states: tuple[np.ndarray, ...], consistent: bool) -> States:
    if not consistent:
        return _nothing(samples, "the friction contradicts itself")
    done = all((axis_states != UNPROVEN).all() for axis_states in states)
    return States(states, True if done else None, "" if done else "cuts (nearly) tie")


def _reached(follows: sparse.csr_array, starts: np.ndarray) -> np.ndarray:
    """Mask of the nodes that can be reached from any of the starts."""
    size = follows.shape[0]
    ends = (np.full(len(starts), size), starts)
    source = sparse.csr_array((np.ones(len(starts), dtype=np.int8), ends), shape=(size + 1, size + 1))
    whole = sparse.block_diag([follows, sparse.csr_array((1, 1), dtype=np.int8)], format="csr") + source
    reached = np.zeros(size + 1, dtype=bool)
    reached[breadth_first_order(whole, size, return_predecessors=False)] = True
    return reached[:-1]


def _by_curvature(motion: Motion) -> list[States]:
    """Two components: steps 1 to 3 of the module docstring, sample by sample."""
    count = motion.samples.count
    return [_steps(motion if count == 1 else Motion(motion.samples.one(r))) for r in range(count)]


def _steps(motion: Motion) -> States:
    """Of a single sample."""
    samples, contacts = motion.samples, Slipping.of(motion)
    if not (contacts.size.least > 0).all():
        return _nothing(samples, "slips are lost in the rounding of the spins")
    turn = _largest_turns(contacts)
    if turn is None:
        return _nothing(samples, "the power is not known to rise in all directions")
    if not _bearable(motion, contacts, turn):
        return _nothing(samples, "slipless contacts are not known to bear what the others leave to them")
    return States(tuple(np.where(still[0], SLIPLESS, SLIPPING) for still in motion.still), True)


@dataclass(frozen=True)
class Slipping:
    """The n contacts that slip. A driven domain, and a component that a contact does not feel, have the unknown -1.

    lower, upper : (2, n), unknown of the domain at either end, component by component. two : (n,), feels both of them.
    direction : of slip, two enclosures (n,). size : length of the slip. strength : friction that it bears.
    spheres : (2, n), flat numbers of the lower and the upper sphere.
    """

    unknowns: int
    lower: np.ndarray
    upper: np.ndarray
    two: np.ndarray
    direction: tuple[Enclosure, Enclosure]
    size: Enclosure
    strength: Enclosure
    spheres: np.ndarray

    @classmethod
    def of(cls, motion: Motion) -> Slipping:
        """Of a single sample."""
        samples = motion.samples
        number, unknowns = [], 0
        for k in samples.needed:
            labels, inverse = np.unique(motion.domain[k], return_inverse=True)
            new = np.where(labels > 1, np.cumsum(labels > 1) - 1 + unknowns, -1)
            number.append(new[inverse.reshape(motion.domain[k].shape)])
            unknowns += int((labels > 1).sum())
        place = np.arange(int(np.prod(samples.shape))).reshape(1, *samples.shape)
        lower, upper, two, spheres, sizes, strengths = [], [], [], [], [], []
        parts: list[list[Enclosure]] = [[], []]
        for axis, still in enumerate(motion.still):
            slips, felt = ~still, [k in samples.felt(axis) for k in samples.needed]
            low, high = samples.ends(axis)
            nowhere, none = np.full(int(slips.sum()), -1), Enclosure.exact(np.zeros(int(slips.sum())))
            lower.append(np.stack([n[low][slips] if f else nowhere for n, f in zip(number, felt, strict=True)]))
            upper.append(np.stack([n[high][slips] if f else nowhere for n, f in zip(number, felt, strict=True)]))
            for found, k, f in zip(parts, samples.needed, felt, strict=True):
                found.append(motion.difference[axis][k] if f else none)
            two.append(np.full(int(slips.sum()), all(felt)))
            spheres.append(np.stack([place[low][slips], place[high][slips]]))
            sizes.append(motion.size[axis])
            strengths.append(samples.strength[axis][slips])
        size = joined(sizes)
        known = size if (size.least > 0).all() else Enclosure.exact(np.ones(len(size.high)))
        return cls(
            unknowns,
            np.concatenate(lower, axis=1),
            np.concatenate(upper, axis=1),
            np.concatenate(two),
            (joined(parts[0]) / known, joined(parts[1]) / known),
            size,
            joined(strengths),
            np.concatenate(spheres, axis=1),
        )

    @property
    def ends(self) -> list[tuple[np.ndarray, float, int]]:
        """(unknowns (n,), sign in the difference, component) of the four ends of every contact."""
        return [(end[slot], sign, slot) for end, sign in ((self.upper, 1.0), (self.lower, -1.0)) for slot in range(2)]


def _largest_turns(contacts: Slipping) -> np.ndarray | None:
    """Step 1: the share (n,) by which the slip of each contact at the minimum may differ at most; None if unknown."""
    if contacts.unknowns == 0:
        return np.zeros(len(contacts.two))
    conditions, inexact = _conditions(contacts)
    scale = np.asarray(conditions.multiply(conditions).sum(axis=0)).ravel()  # h
    if not (scale > 0).all():
        return None
    root = np.sqrt(scale)
    tau = _curvature((conditions @ sparse.diags_array(1 / root)).tocsr(), inexact)
    if tau is None:
        return None
    block = _blocks(contacts)
    slope = np.bincount(block, (_slope(contacts) / root) ** 2) ** 0.5 * UP
    radius = 1.5 * slope / tau + np.finfo(float).tiny  # rho, block by block
    reach = np.append(radius[block] / root, 0.0)  # |u_i| at most; the last one for what is driven
    change = sum((reach[contacts.lower[slot]] + reach[contacts.upper[slot]]) ** 2 for slot in range(2)) ** 0.5
    turn = change / contacts.size.least * UP
    loss, given_up = np.where(contacts.two, 8 * turn**2 * (contacts.strength / contacts.size).most, 0.0), np.zeros(len(reach))
    for end, _, _ in contacts.ends:
        np.add.at(given_up, end, loss)
    return turn if (turn <= TURN).all() and (given_up[:-1] * UP < tau * scale / 2).all() else None


def _conditions(contacts: Slipping) -> tuple[sparse.csr_array, np.ndarray]:
    """Rows A with H = A^T A: the part of a change of slip across the slip, times the root of mu / |z|; and relative
    errors of the rows. Slips of one component have no curvature."""
    across = (-contacts.direction[1], contacts.direction[0])
    weight = contacts.strength / contacts.size
    inexact = weight.error / weight.most + 16 * np.finfo(float).eps
    row, column, value = [], [], []
    for end, sign, slot in contacts.ends:
        there = (end >= 0) & contacts.two & (across[slot].high != 0)
        row.append(np.flatnonzero(there))
        column.append(end[there])
        value.append(sign * across[slot].value[there] * np.sqrt(weight.value[there]))
    for part in across:
        size = np.where(part.high == 0, 1.0, np.abs(part.high))  # no part at all, or one of that size
        inexact = np.maximum(inexact, inexact + 2 * part.error / size)
    shape = (len(contacts.two), contacts.unknowns)
    rows = sparse.coo_array((np.concatenate(value), (np.concatenate(row), np.concatenate(column))), shape=shape)
    return rows.tocsr(), inexact


def _curvature(rows: sparse.csr_array, inexact: np.ndarray) -> float | None:
    """A tau with A^T A >= tau for the exact rows A, whose columns have the length one; None if none is found."""
    matrix = (rows.T @ rows).tocsc()
    size, ones = matrix.shape[0], np.ones(matrix.shape[0])
    sizes = abs(rows)
    terms = int(np.diff(rows.tocsc().indptr).max(initial=0)) + 4
    doubt = float((sizes.T @ ((3 * inexact + terms * EPS) * (sizes @ ones))).max(initial=0.0)) * UP
    estimate = _least_eigenvalue(matrix)
    for share in (0.5, 0.1):
        tau = share * estimate
        if tau < LEAST_CURVATURE:
            return None
        shifted = (matrix - tau * sparse.eye_array(size, format="csc")).tocsc()
        missed = _distance_from_positive(shifted)
        if missed is not None and tau - missed - doubt - EPS > tau / 2:
            return tau / 2
    return None


def _least_eigenvalue(matrix: sparse.csc_array) -> float:
    """A rough value of the least eigenvalue, by inverse iteration."""
    factor = _factorised((matrix + LEAST_CURVATURE * sparse.eye_array(matrix.shape[0], format="csc")).tocsc())
    if factor is None:
        return 0.0
    vector = np.random.default_rng(0).standard_normal(matrix.shape[0])
    for _ in range(STEPS):
        vector = factor.solve(vector / np.linalg.norm(vector))
        if not np.isfinite(vector).all():
            return 0.0
    vector /= np.linalg.norm(vector)
    return float(np.linalg.norm(matrix @ vector))


def _factorised(matrix: sparse.csc_array) -> Any:
    try:
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # singular
        return None


def _distance_from_positive(matrix: sparse.csc_array) -> float | None:
    """How far, in the maximum norm, a symmetric matrix may be from a positive semidefinite one: L D L^T, with the factors
    that elimination in floating point has found. None where a pivot is not positive.

    The product of the computed factors L and U differs from the matrix by at most gamma |L| |U| (Higham, Accuracy and
    Stability of Numerical Algorithms, 2002, theorem 9.3), and U from D L^T by what is seen. Up to rounding |L| |U| is
    |L| D |L|^T, whose norm is bounded.
    """
    factor = _factorised(matrix)
    if factor is None or (factor.perm_r != factor.perm_c).any():
        return None
    lower, upper = factor.L.tocsr(), factor.U.tocsr()
    pivots = upper.diagonal()
    if not (pivots > 0).all():
        return None
    terms = np.diff(lower.indptr) + 2
    gamma = terms * EPS / (1 - terms * EPS)
    # gamma |L| |U|, with the smaller of the gammas of row and column: at most W W^T, entry by entry
    rounding = sparse.diags_array(np.sqrt(gamma)) @ abs(lower) @ sparse.diags_array(np.sqrt(pivots))
    apart = abs(upper - sparse.diags_array(pivots) @ lower.T)
    seen = abs(lower) @ (apart @ np.ones(len(pivots)) + 8 * EPS * (abs(upper) @ np.ones(len(pivots))))
    return (_largest_eigenvalue(rounding.tocsr()) + float(seen.max())) * UP


def _largest_eigenvalue(root: sparse.csr_array) -> float:
    """Upper bound of the largest eigenvalue of W W^T, W without negative entries (Collatz and Wielandt)."""
    other, vector = root.T.tocsr(), np.ones(root.shape[0])
    for _ in range(STEPS):
        vector = root @ (other @ vector)
        vector = vector / vector.max() + EPS
    return float(((root @ (other @ vector)) / vector).max())


def _blocks(contacts: Slipping) -> np.ndarray:
    """(unknowns,) number of the block of each unknown: slipping contacts join only unknowns of one block."""
    ends = np.concatenate([contacts.lower, contacts.upper])
    some = ends.max(axis=0)  # an unknown if there is any
    pairs = [(end[end >= 0], some[end >= 0]) for end in ends]
    first, second = (np.concatenate([pair[i] for pair in pairs]) for i in range(2))
    graph = sparse.coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(contacts.unknowns,) * 2)
    return connected_components(graph, directed=False)[1]


def _slope(contacts: Slipping) -> np.ndarray:
    """(unknowns,), |g|, rounded up: what the slipping contacts leave over on each domain."""
    owner, pulls = [], []
    for end, sign, slot in contacts.ends:
        free, pull = end >= 0, contacts.strength * contacts.direction[slot]
        owner.append(end[free])
        pulls.append(pull[free].signed(sign))
    return grouped_sum(joined(pulls), np.concatenate(owner), contacts.unknowns).most


def _bearable(motion: Motion, contacts: Slipping, turn: np.ndarray) -> bool:
    """Step 2: True if the friction of the contacts that do not slip can be put in balance inside all discs."""
    samples = motion.samples
    left = {k: _left_over(motion, contacts, turn, slot) for slot, k in enumerate(samples.needed)}
    for axis, still in enumerate(motion.still):
        rests, felt = still & ~samples.between_driven(axis), [k for k in samples.needed if k in samples.felt(axis)]
        if felt:
            low, _ = samples.ends(axis)
            borne = length([Enclosure.exact(samples.turning[axis][k][rests]) for k in felt]).most
            correction = np.sqrt(sum(left[k][low][rests] ** 2 for k in felt))
            if not ((borne + correction) * UP < samples.strength[axis][rests].least).all():
                return False
    return True


def _left_over(motion: Motion, contacts: Slipping, turn: np.ndarray, slot: int) -> np.ndarray:
    """E_D of the domain of each sphere in a component, (1, *N): the torques left over in it, summed."""
    samples = motion.samples
    component, spheres = samples.needed[slot], contacts.spheres.ravel()
    side = samples.sublattice.ravel()[contacts.spheres[1]]
    exerted = (contacts.strength * contacts.direction[slot]).signed(side)
    of_slipping = grouped_sum(joined([exerted, exerted]), spheres, samples.sublattice.size)
    pull = torques(samples, component, motion.still) + of_slipping.reshaped((1, *samples.shape))
    unsure = np.where(contacts.two, 2 * turn * contacts.strength.most, 0.0)
    residual = pull.most.ravel() + np.bincount(spheres, np.tile(unsure, 2), samples.sublattice.size)
    residual = residual.reshape(pull.high.shape)
    residual[..., [0, -1]] = 0.0
    labels, inverse = np.unique(motion.domain[component].ravel(), return_inverse=True)
    of_domain = np.bincount(inverse, residual.ravel(), len(labels)) * UP
    return of_domain[inverse].reshape(residual.shape)
