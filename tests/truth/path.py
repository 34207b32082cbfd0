"""The way to the minimum along the central path."""

from flint import arb, arb_mat

from tests.truth.cones import divided, dot, exact, inverse_reach, least, length, middle, most, product
from tests.truth.problem import Problem
from tests.truth.scaling import Scaling

FASTEST = 15  # most decades of the gap in a step, so that slips are seen at several gaps
CENTRED = 0.5  # relative distance from the central path up to which a step goes along it


class Path:
    """Primal and dual point, strictly inside all cones."""

    def __init__(self, problem: Problem):
        self.problem = problem
        tau = max(float(c.friction) for c in problem.contacts)
        self.spins = problem.height_profile()
        self.difference = problem.differences(self.spins)
        self.height = [
            (tau / c.friction + ((tau / c.friction) ** 2 + dot(d, d)).sqrt()).mid()
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
        return [length(d).mid() for d in self.difference]

    def gap(self) -> tuple[arb, arb]:
        """sum s'z, and the power."""
        contacts = self.problem.contacts
        total = sum(
            (
                c.friction * s + dot(d, z)
                for c, s, d, z in zip(contacts, self.height, self.difference, self.dual, strict=True)
            ),
            arb(0),
        )
        power = sum((c.friction * length(d) for c, d in zip(contacts, self.difference, strict=True)), arb(0))
        return total.mid(), power.mid()

    def advance(self):
        """A step to the central path where it is far away, else Mehrotra's step along it.

        The directions of Nesterov and Todd converge fast only close to the path (as those of semidefinite programmes:
        Kojima, Shida, Shindoh, Math. Program. 80, 1998).
        """
        s = [[h, *d] for h, d in zip(self.height, self.difference, strict=True)]
        z = [[c.friction, *y] for c, y in zip(self.problem.contacts, self.dual, strict=True)]
        scalings = [Scaling(a, b) for a, b in zip(s, z, strict=True)]
        squares = [product(w.point, w.point) for w in scalings]
        matrix = self._matrix(scalings)
        pull = self.problem.gathered(self.dual)
        tau = (self.gap()[0] / len(s)).mid()
        if max(float(max(abs(q[0] / tau - 1), *(abs(x / tau) for x in q[1:]))) for q in squares) > CENTRED:
            right = [
                w.inverse_times(divided(w.point, [tau - q[0], *(-x for x in q[1:])]))
                for w, q in zip(scalings, squares, strict=True)
            ]
            ds, dz = self._direction(scalings, matrix, pull, right)
            self._move(ds, dz, least(1, 0.9 / _reaches(s, ds, z, dz)))
            return
        ds, dz = self._direction(scalings, matrix, pull, [[-x for x in v] for v in z])
        sigma = (1 - least(1, 1 / _reaches(s, ds, z, dz))) ** 3
        right = []
        for w, q, a, b in zip(scalings, squares, ds, dz, strict=True):
            second = product(w.inverse_times(a), w.times(b))
            r = middle(-x - y for x, y in zip(q, second, strict=True))
            r[0] += sigma * tau
            right.append(w.inverse_times(divided(w.point, r)))
        ds, dz = self._direction(scalings, matrix, pull, right)
        longest = least(1, 1 / _reaches(s, ds, z, dz))
        self._move(ds, dz, longest * (1 - least(exact(0.05), most(1 - longest, arb(10) ** -FASTEST))))

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
            middle(g - h * r[0] / w.h00 for g, h in zip(r[1:], w.h01, strict=True))
            for w, r in zip(scalings, right, strict=True)
        ]
        wanted = [a + b for a, b in zip(pull, self.problem.gathered(reduced), strict=True)]
        solved = matrix.solve(arb_mat([[x.mid()] for x in wanted]), algorithm="approx")
        self.step = [x.mid() for x in solved.entries()]
        ds, dz = [], []
        for w, r, g, change in zip(scalings, right, reduced, self.problem.changes(self.step), strict=True):
            change = middle(change)
            ds.append(middle([(r[0] - dot(w.h01, change)) / w.h00, *change]))
            dz.append(middle([arb(0), *(x - dot(row, change) for x, row in zip(g, w.stiffness, strict=True))]))
        return ds, dz


def _reaches(s, ds, z, dz) -> arb:
    """1 over the longest step that keeps both points in all cones, at least a tiny number."""
    longest = arb(10) ** -30
    for v, dv in zip([*s, *z], [*ds, *dz], strict=True):
        longest = most(longest, inverse_reach(v, dv))
    return longest
