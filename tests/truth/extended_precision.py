"""The least Coulomb power to 80 digits, and what every contact does there; shares no code with the package.

Mehrotra's predictor-corrector method with the scaling of Nesterov and Todd (Vandenberghe, "The CVXOPT linear and
quadratic cone program solvers", 2010) in numbers of 700 bits or more (python-flint). Unknowns are the staggered spins
of the free spheres from the bottom, in units of the imposed jump; only components that the minimum needs (PHYSICS 3.3).

    primal:  min sum_e mu_e s_e  with |d_e| <= s_e, d = A u + b      dual:  max f . b  with A' f = 0, |f_e| <= mu_e

The coefficients count exactly as the doubles they are, the direction is normalised in extended precision. The path goes
to the middle of all minimisers: a contact slips at *some* minimum just if its slip has a limit above 0 there. The slips
of all minimisers point the same way, along f_e, so the minimisers are a polyhedron: d_e = t_e f_e / |f_e|, t_e >= 0. If
it is more than a point, a linear programme for each contact tells whether t_e can be 0, and if not it slips at *every*
minimum. Its rows are in units of the slips in the middle, which makes the polyhedron round, so doubles will do.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import arb, arb_mat, ctx, fmpq

SLIPLESS, SLIPPING, EITHER, DRIVEN, UNKNOWN = range(5)  # at every minimum; EITHER: slips at some, rests at others
TARGETS = ((-90, 700), (-150, 1100), (-220, 1500))  # log10 of the relative gap, bits; the next if limits are unclear
STEADY, FALLING = 0.5, 0.2  # a slip has its limit if it keeps this share; is zero if it falls as gap^FALLING or faster
RANK = 1e-25  # pivots below count as zero: directions are known to 1e-35 or better
MOST_ITERATIONS = 600
CENTRED = 0.5  # relative distance from the central path up to which a step goes along it
NEVER = 1e-7  # share of its slip in the middle that a contact must be able to lose for EITHER, minus 1


@dataclass(frozen=True)
class Truth:
    """The minimum. Arrays: one an axis, (*contacts).

    power : arb that contains P_min (energy/time), from spins above and from balanced forces below.
    gap : (upper - lower) / upper, rigorous. slip : length/time, at the middle of the minimisers.
    margin : (mu F_n - |f|) / (mu F_n) there. state : SLIPLESS ... UNKNOWN. freedom : dimension of the minimisers.
    """

    power: arb
    gap: float
    slip: tuple[np.ndarray, ...]
    margin: tuple[np.ndarray, ...]
    state: tuple[np.ndarray, ...]
    freedom: int
    iterations: int

    @property
    def digits(self) -> str:
        return self.power.str(50, radius=False)


@dataclass
class _Contact:
    axis: int
    index: tuple[int, ...]
    friction: arb
    lower: list[int]  # unknown of each felt component at the lower sphere, -1 at the bottom, -2 at the top
    upper: list[int]
    offset: list[arb]


def exact(value: float) -> arb:
    return _ball(Fraction(float(value)))


def _ball(value: Fraction) -> arb:
    return arb(fmpq(value.numerator, value.denominator))


class Problem:
    """Contacts and unknowns of one sample.

    coefficient : one array (*contacts) an axis. perturbation : seed and size; coefficients times 1 + size * u, |u| < 1.
    """

    def __init__(
        self, coefficient, normal_force, radius, spin_top, spin_bottom, direction=(1, 1, 0), perturbation=None
    ):
        self.coefficient = [np.asarray(c, dtype=np.float64) for c in coefficient]
        self.dimension = len(self.coefficient)
        self.shape = tuple(n + (a == 0) for a, n in enumerate(self.coefficient[0].shape))
        self.normal_force, self.radius = Fraction(float(normal_force)), Fraction(float(radius))
        self.speed = Fraction(float(spin_top)) - Fraction(float(spin_bottom))
        self.direction = (
            [Fraction(0), Fraction(0), Fraction(1)] if self.dimension == 2 else [Fraction(float(v)) for v in direction]
        )
        candidates = (2,) if self.dimension == 2 else (0, 1)
        self.components = [k for k in candidates if self.direction[k] and self.speed]
        self.perturbation = perturbation

    def build(self):
        """All numbers in the precision that is set now."""
        length = _ball(sum(v * v for v in self.direction)).sqrt()
        self.unit_jump = [_ball(self.direction[k]) / length for k in self.components]
        values = [Fraction(v) for c in self.coefficient for v in c.ravel().tolist()]
        self.scale = sum(values) / len(values)
        rng = None if self.perturbation is None else np.random.default_rng(self.perturbation[0])
        free = self.shape[:-1] + (self.shape[-1] - 2,)
        order = np.arange(int(np.prod(free))).reshape(free[-1:] + free[:-1])  # layer by layer
        order = np.moveaxis(order, 0, -1)
        count, self.unknowns = len(self.components), int(np.prod(free)) * len(self.components)
        number = np.full((count, *self.shape), -1)
        number[..., -1] = -2
        for slot in range(count):
            number[slot][..., 1:-1] = order * count + slot
        self.contacts, self.unfelt = [], []
        for axis, values in enumerate(self.coefficient):
            felt = [slot for slot, k in enumerate(self.components) if k != axis]
            for index in np.ndindex(values.shape):
                u = 0.0 if rng is None else rng.uniform(-1, 1)
                above = tuple(i + (a == axis) for a, i in enumerate(index))
                if axis < self.dimension - 1 and index[-1] in (0, self.shape[-1] - 1):
                    continue
                if not felt:
                    self.unfelt.append((axis, index))
                    continue
                friction = _ball(Fraction(float(values[index])) / self.scale)
                if rng is not None:
                    friction = (friction * (1 + arb(self.perturbation[1]) * exact(u))).mid()
                lower = [int(number[(slot, *index)]) for slot in felt]
                upper = [int(number[(slot, *above)]) for slot in felt]
                offset = [
                    self.unit_jump[slot] * ((up == -2) - (low == -2))
                    for slot, low, up in zip(felt, lower, upper, strict=True)
                ]
                self.contacts.append(_Contact(axis, index, friction, lower, upper, offset))

    def height_profile(self):
        """Spins (unknowns,) that go linearly from bottom to top: where the path begins."""
        free, count = self.shape[-1] - 2, len(self.components)
        layer = self.unknowns // (free * count)
        return [self.unit_jump[i % count].mid() * (i // (layer * count) + 1) / (free + 1) for i in range(self.unknowns)]

    def differences(self, spins):
        return [
            [
                b + (spins[up] if up >= 0 else 0) - (spins[low] if low >= 0 else 0)
                for b, low, up in zip(c.offset, c.lower, c.upper, strict=True)
            ]
            for c in self.contacts
        ]

    def changes(self, steps):
        return [
            [
                (steps[up] if up >= 0 else 0) - (steps[low] if low >= 0 else arb(0))
                for low, up in zip(c.lower, c.upper, strict=True)
            ]
            for c in self.contacts
        ]

    def gathered(self, forces):
        """A' f, (unknowns,)."""
        total = [arb(0)] * self.unknowns
        for c, force in zip(self.contacts, forces, strict=True):
            for f, low, up in zip(force, c.lower, c.upper, strict=True):
                if up >= 0:
                    total[up] += f
                if low >= 0:
                    total[low] -= f
        return total

    def unit(self) -> arb:
        """What turns the power of the problem in its own units into energy/time."""
        return _ball(self.normal_force * self.radius * abs(self.speed) * self.scale)

    def bounds(self, spins, forces) -> tuple[arb, arb]:
        """Power of the spins, and what the forces prove: scaled into the discs, leftover torques paid for."""
        power = sum(
            (c.friction * _length(d) for c, d in zip(self.contacts, self.differences(spins), strict=True)), arb(0)
        )
        worst = arb(1)
        for c, f in zip(self.contacts, forces, strict=True):
            worst = worst.max(_length(f) / c.friction)
        work = sum(
            (
                f * b
                for c, force in zip(self.contacts, forces, strict=True)
                for f, b in zip(force, c.offset, strict=True)
            ),
            arb(0),
        )
        count = len(self.components)
        torque = self.gathered(forces)
        paid = sum((abs(t) * abs(self.unit_jump[i % count]) for i, t in enumerate(torque)), arb(0))
        return power, (work - paid) / worst


def _length(vector) -> arb:
    if len(vector) == 1:
        return abs(vector[0])
    square = vector[0] * vector[0] + vector[1] * vector[1]
    return square.nonnegative_part().sqrt()


def _middle(values):
    """The numbers without their error bounds, which would grow much faster than the errors."""
    return [x.mid() for x in values]


def _dot(a, b):
    return sum((x * y for x, y in zip(a[1:], b[1:], strict=True)), a[0] * b[0])


def _determinant(a):
    """a0^2 - |a1|^2."""
    return a[0] * a[0] - _dot(a[1:], a[1:])


def _product(a, b):
    """Jordan product of two vectors of the cone."""
    return [_dot(a, b), *(a[0] * y + b[0] * x for x, y in zip(a[1:], b[1:], strict=True))]


class _Scaling:
    """W of Nesterov and Todd with W z = W^-1 s = point, for one cone."""

    def __init__(self, s, z):
        det_s, det_z = _determinant(s).mid(), _determinant(z).mid()
        root_s, root_z = det_s.sqrt().mid(), det_z.sqrt().mid()
        s, z = _middle(x / root_s for x in s), _middle(x / root_z for x in z)
        gamma = ((1 + _dot(s, z)) / 2).sqrt().mid()
        gamma *= 2
        self.w = _middle([(s[0] + z[0]) / gamma, *((x - y) / gamma for x, y in zip(s[1:], z[1:], strict=True))])
        self.beta_square = (root_s / root_z).mid()
        self.beta = self.beta_square.sqrt().mid()
        self.point = self.times([x * root_z for x in z])
        w0 = self.w[0]
        self.h00 = ((2 * w0 * w0 - 1) / self.beta_square).mid()  # of W^-2
        self.h01 = _middle(-2 * w0 * x / self.beta_square for x in self.w[1:])
        shrink = (2 / (2 * w0 * w0 - 1)).mid()
        self.stiffness = [
            _middle(((i == j) - shrink * x * y) / self.beta_square for j, y in enumerate(self.w[1:]))
            for i, x in enumerate(self.w[1:])
        ]

    def _turned(self, v, sign):
        w0, w1 = self.w[0], self.w[1:]
        along = _dot(w1, v[1:])
        factor = sign * v[0] + along / (1 + w0)
        return [w0 * v[0] + sign * along, *(y + factor * x for x, y in zip(w1, v[1:], strict=True))]

    def times(self, v):
        return _middle(self.beta * x for x in self._turned(v, 1))

    def inverse_times(self, v):
        return _middle(x / self.beta for x in self._turned(v, -1))


def _divided(point, r):
    """x with point o x = r."""
    det = _determinant(point).mid()
    first = ((point[0] * r[0] - _dot(point[1:], r[1:])) / det).mid()
    return _middle([first, *((y - first * x) / point[0] for x, y in zip(point[1:], r[1:], strict=True))])


def _inverse_reach(v, dv) -> arb:
    """1 over the longest step that stays in the cone."""
    a, b, c = _middle([_determinant(v), v[0] * dv[0] - _dot(v[1:], dv[1:]), _determinant(dv)])
    disc = (b * b - a * c).mid()
    return ((disc.sqrt() - b) / a).mid() if disc > 0 else arb(0)


def _least(a, b) -> arb:
    return arb(a).min(b).mid()


def _most(a, b) -> arb:
    return arb(a).max(b).mid()


class _Path:
    """Primal and dual point, strictly inside all cones."""

    def __init__(self, problem: Problem):
        self.problem = problem
        tau = max(float(c.friction) for c in problem.contacts)
        self.spins = problem.height_profile()
        self.difference = problem.differences(self.spins)
        self.height = [
            (tau / c.friction + ((tau / c.friction) ** 2 + _dot(d, d)).sqrt()).mid()
            for c, d in zip(problem.contacts, self.difference, strict=True)
        ]
        self.dual = [[arb(0)] * len(d) for d in self.difference]  # -f
        self._tidy()

    def _tidy(self):
        self.spins = [x.mid() for x in self.spins]
        self.difference = [[x.mid() for x in d] for d in self.problem.differences(self.spins)]
        self.height = [x.mid() for x in self.height]
        self.dual = [[x.mid() for x in z] for z in self.dual]

    def slips(self):
        return [_length(d).mid() for d in self.difference]

    def gap(self) -> tuple[arb, arb]:
        """sum s'z, and the power."""
        contacts = self.problem.contacts
        total = sum(
            (
                c.friction * s + _dot(d, z)
                for c, s, d, z in zip(contacts, self.height, self.difference, self.dual, strict=True)
            ),
            arb(0),
        )
        power = sum((c.friction * _length(d) for c, d in zip(contacts, self.difference, strict=True)), arb(0))
        return total.mid(), power.mid()

    def advance(self):
        """A step to the central path where it is far away, else Mehrotra's step along it.

        The directions of Nesterov and Todd converge fast only close to the path (as those of semidefinite programmes:
        Kojima, Shida, Shindoh, Math. Program. 80, 1998).
        """
        s = [[h, *d] for h, d in zip(self.height, self.difference, strict=True)]
        z = [[c.friction, *y] for c, y in zip(self.problem.contacts, self.dual, strict=True)]
        scalings = [_Scaling(a, b) for a, b in zip(s, z, strict=True)]
        squares = [_product(w.point, w.point) for w in scalings]
        matrix = self._matrix(scalings)
        pull = self.problem.gathered(self.dual)
        tau = (self.gap()[0] / len(s)).mid()
        if max(float(max(abs(q[0] / tau - 1), *(abs(x / tau) for x in q[1:]))) for q in squares) > CENTRED:
            right = [
                w.inverse_times(_divided(w.point, [tau - q[0], *(-x for x in q[1:])]))
                for w, q in zip(scalings, squares, strict=True)
            ]
            ds, dz = self._direction(scalings, matrix, pull, right)
            self._move(ds, dz, _least(1, 0.9 / _reaches(s, ds, z, dz)))
            return
        ds, dz = self._direction(scalings, matrix, pull, [[-x for x in v] for v in z])
        sigma = (1 - _least(1, 1 / _reaches(s, ds, z, dz))) ** 3
        right = []
        for w, q, a, b in zip(scalings, squares, ds, dz, strict=True):
            second = _product(w.inverse_times(a), w.times(b))
            r = _middle(-x - y for x, y in zip(q, second, strict=True))
            r[0] += sigma * tau
            right.append(w.inverse_times(_divided(w.point, r)))
        ds, dz = self._direction(scalings, matrix, pull, right)
        longest = _least(1, 1 / _reaches(s, ds, z, dz))
        self._move(ds, dz, longest * (1 - _least(exact(0.05), _most(1 - longest, arb(10) ** -40))))

    def _move(self, ds, dz, step):
        self.spins = [u + step * du for u, du in zip(self.spins, self.step, strict=True)]
        self.height = [h + step * a[0] for h, a in zip(self.height, ds, strict=True)]
        self.dual = [
            [y + step * dy for y, dy in zip(v, b[1:], strict=True)] for v, b in zip(self.dual, dz, strict=True)
        ]
        self._tidy()

    def _matrix(self, scalings):
        n = self.problem.unknowns
        rows = [[arb(0)] * n for _ in range(n)]
        for c, w in zip(self.problem.contacts, scalings, strict=True):
            for i, (low, up) in enumerate(zip(c.lower, c.upper, strict=True)):
                for j, (low_j, up_j) in enumerate(zip(c.lower, c.upper, strict=True)):
                    k = w.stiffness[i][j]
                    if up >= 0 and up_j >= 0:
                        rows[up][up_j] += k
                    if low >= 0 and low_j >= 0:
                        rows[low][low_j] += k
                    if up >= 0 and low_j >= 0:
                        rows[up][low_j] -= k
                    if low >= 0 and up_j >= 0:
                        rows[low][up_j] -= k
        return arb_mat(rows).mid()

    def _direction(self, scalings, matrix, pull, right):
        """Change of every s and z if W dz + W^-1 ds is W times `right`."""
        reduced = [
            _middle(g - h * r[0] / w.h00 for g, h in zip(r[1:], w.h01, strict=True))
            for w, r in zip(scalings, right, strict=True)
        ]
        wanted = [a + b for a, b in zip(pull, self.problem.gathered(reduced), strict=True)]
        solved = matrix.solve(arb_mat([[x.mid()] for x in wanted]), algorithm="approx")
        self.step = [x.mid() for x in solved.entries()]
        ds, dz = [], []
        for w, r, g, change in zip(scalings, right, reduced, self.problem.changes(self.step), strict=True):
            change = _middle(change)
            ds.append(_middle([(r[0] - _dot(w.h01, change)) / w.h00, *change]))
            dz.append(_middle([arb(0), *(x - _dot(row, change) for x, row in zip(g, w.stiffness, strict=True))]))
        return ds, dz


def _reaches(s, ds, z, dz) -> arb:
    """1 over the longest step that keeps both points in all cones, at least a tiny number."""
    longest = arb(10) ** -30
    for v, dv in zip([*s, *z], [*ds, *dz], strict=True):
        longest = _most(longest, _inverse_reach(v, dv))
    return longest


def solve(coefficient, normal_force, radius, spin_top, spin_bottom, direction=(1, 1, 0), perturbation=None) -> Truth:
    """The minimum of one sample; see Problem and Truth."""
    problem = Problem(coefficient, normal_force, radius, spin_top, spin_bottom, direction, perturbation)
    if not problem.components:
        return _at_rest(problem)
    for target, bits in TARGETS:
        before = ctx.prec
        ctx.prec = bits
        try:
            truth = _solve(problem, target)
        finally:
            ctx.prec = before
        if not any((s == UNKNOWN).any() for s in truth.state):
            break
    return truth


def _solve(problem: Problem, target: int) -> Truth:
    problem.build()
    path, seen, iterations = _Path(problem), [], 0
    while True:
        gap, power = path.gap()
        relative = gap / power
        seen.append((relative, path.slips()))
        if relative.mid() < arb(10) ** target or iterations >= MOST_ITERATIONS:
            break
        path.advance()
        iterations += 1
    forces = [[-y for y in z] for z in path.dual]
    power, bound = problem.bounds(path.spins, forces)
    early = next((g, slips) for g, slips in seen if g.mid() < arb(10) ** (target // 2))
    limits = _limits(early, seen[-1])
    direction = [
        [x / (_length(d) if limit == SLIPPING else arb(1)) for x in d]
        for d, limit in zip(path.difference, limits, strict=True)
    ]
    freedom = 0
    if UNKNOWN not in limits:
        freedom, limits = _settle(problem, limits, direction, seen[-1][1])
    unit = problem.unit()
    slip, margin, state = _empty(problem)
    length = _ball(problem.radius * abs(problem.speed))
    for c, limit, s, f in zip(problem.contacts, limits, seen[-1][1], forces, strict=True):
        slip[c.axis][c.index] = float(s * length)
        margin[c.axis][c.index] = float((1 - _length(f) / c.friction).mid())
        state[c.axis][c.index] = limit
    gap = float(((power - bound) / power).upper())
    return Truth((bound.union(power)) * unit, gap, slip, margin, state, freedom, iterations)


def _limits(early, late) -> list[int]:
    """SLIPPING or SLIPLESS at the middle of the minimisers, UNKNOWN if the slips at two gaps do not tell."""
    fall = float(((late[0] / early[0]).log() * FALLING).mid())
    found = []
    for before, now in zip(early[1], late[1], strict=True):
        if not now > 0:
            found.append(SLIPLESS)
            continue
        ratio = float((now / before).log().mid()) if before > 0 else 0.0
        found.append(SLIPPING if abs(ratio) < -np.log(STEADY) else SLIPLESS if ratio < fall else UNKNOWN)
    return found


def _empty(problem: Problem):
    arrays = [(np.zeros(c.shape), np.ones(c.shape), np.zeros(c.shape, np.uint8)) for c in problem.coefficient]
    slip, margin, state = (tuple(parts) for parts in zip(*arrays, strict=True))
    for axis in range(problem.dimension - 1):
        state[axis][..., 0] = state[axis][..., -1] = DRIVEN
    return slip, margin, state


def _at_rest(problem: Problem) -> Truth:
    """Nothing that the minimum needs is imposed: no power, and every contact rests."""
    slip, margin, state = _empty(problem)
    return Truth(arb(0), 0.0, slip, margin, state, 0, 0)


def _settle(problem: Problem, limits, direction, slips) -> tuple[int, list[int]]:
    """Dimension of the minimisers, and SLIPPING turned into EITHER where some minimiser rests."""
    basis = _freedom(problem, limits, direction)
    moving = [e for e, limit in enumerate(limits) if limit == SLIPPING]
    columns = []
    for spins in basis:
        changes = problem.changes(spins)
        columns.append([(_dot(direction[e], changes[e]) / slips[e]).mid() for e in moving])
    columns = _orthonormal(columns)
    if not columns:
        return len(basis), limits
    from scipy.optimize import linprog

    rows = np.array([[float(x) for x in column] for column in columns]).T
    limits = list(limits)
    for number, e in enumerate(moving):
        if np.abs(rows[number]).max() < 1e-12:
            continue
        # t_e / t_e(middle) = 1 + rows @ y >= 0: the least value of one of them
        found = linprog(rows[number], A_ub=-rows, b_ub=np.ones(len(rows)), bounds=(None, None), method="highs")
        limits[e] = UNKNOWN if found.status not in (0, 3) else EITHER if found.fun < -1 + NEVER else SLIPPING
    return len(basis), limits


def _orthonormal(columns):
    """The same space, columns of length 1 at right angles; columns of no length are left out."""
    kept = []
    for column in columns:
        for _ in range(2):
            for other in kept:
                along = _dot(other, column)
                column = [(x - along * y).mid() for x, y in zip(column, other, strict=True)]
        norm = _dot(column, column).sqrt()
        if norm.mid() > RANK:
            kept.append([(x / norm).mid() for x in column])
    return kept


def _freedom(problem: Problem, limits, direction):
    """Basis of the changes of the spins that keep resting contacts at rest and slips along their directions."""
    parent = list(range(problem.unknowns + 1))  # the last one: driven
    driven = problem.unknowns

    def root(i):
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for c, limit in zip(problem.contacts, limits, strict=True):
        if limit == SLIPLESS:
            for low, up in zip(c.lower, c.upper, strict=True):
                parent[root(up if up >= 0 else driven)] = root(low if low >= 0 else driven)
    clusters = sorted({root(i) for i in range(problem.unknowns)} - {root(driven)})
    place = {cluster: number for number, cluster in enumerate(clusters)}

    def column(i):
        return place.get(root(i)) if i >= 0 else None

    rows = []
    for c, limit, d in zip(problem.contacts, limits, direction, strict=True):
        if limit == SLIPPING and len(d) == 2:
            row = [arb(0)] * len(clusters)
            for part, low, up in zip((-d[1], d[0]), c.lower, c.upper, strict=True):
                if column(up) is not None:
                    row[column(up)] += part
                if column(low) is not None:
                    row[column(low)] -= part
            rows.append([x.mid() for x in row])
    basis = []
    for vector in _null_space(rows, len(clusters)):
        basis.append([vector[column(i)] if column(i) is not None else arb(0) for i in range(problem.unknowns)])
    return basis


def _null_space(rows, width):
    """Vectors x with rows . x = 0, by elimination with complete pivoting of rows scaled to largest entry 1."""
    rows = [row for row in (_scaled(row) for row in rows) if row is not None]
    pivots, left = [], list(range(width))
    done = []
    while rows and left:
        size, r, c = max((abs(float(row[c])), r, c) for r, row in enumerate(rows) for c in left)
        if size < RANK:
            break
        pivot = rows.pop(r)
        pivot = [(x / pivot[c]).mid() for x in pivot]
        rows = [
            [(x - row[c] * y).mid() for x, y in zip(row, pivot, strict=True)] if row[c] != 0 else row for row in rows
        ]
        done = [[(x - row[c] * y).mid() for x, y in zip(row, pivot, strict=True)] for row in done] + [pivot]
        pivots.append(c)
        left.remove(c)
    vectors = []
    for c in left:
        vector = [arb(0)] * width
        vector[c] = arb(1)
        for p, row in zip(pivots, done, strict=True):
            vector[p] = -row[c]
        vectors.append(vector)
    return vectors


def _scaled(row):
    size = max((abs(float(x)) for x in row), default=0.0)
    return [x / exact(size) for x in row] if size > RANK else None


def least_viscous_power(coefficient, radius, spin_top, spin_bottom, direction=(1, 1, 0)) -> arb:
    """Least power R^2 sum eta |d|^2 of viscous contacts, by Gaussian elimination with error bounds."""
    problem = Problem(coefficient, 1, radius, spin_top, spin_bottom, direction)
    if not problem.components:
        return arb(0)
    before = ctx.prec
    ctx.prec = 700
    try:
        problem.build()
        n = problem.unknowns
        rows, right = [[arb(0)] * n for _ in range(n)], [arb(0)] * n
        for c in problem.contacts:
            for b, low, up in zip(c.offset, c.lower, c.upper, strict=True):
                for here, sign in ((up, 1), (low, -1)):
                    if here >= 0:
                        right[here] -= sign * c.friction * b
                        rows[here][here] += c.friction
                        if min(up, low) >= 0:
                            rows[here][up + low - here] -= c.friction
        spins = arb_mat(rows).solve(arb_mat([[x] for x in right])).entries()
        total = sum(
            (c.friction * _dot(d, d) for c, d in zip(problem.contacts, problem.differences(spins), strict=True)), arb(0)
        )
        return total * _ball((problem.radius * problem.speed) ** 2 * problem.scale)
    finally:
        ctx.prec = before
