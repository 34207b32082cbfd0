"""What each number of an answer is by its sentence: plain formulas of stored arrays, in the laboratory frame.

NumPy and networkx alone: contact by contact, with cross products, without staggered spins or dropped components. Each
formula takes a `Laboratory` and returns what is expected: a value that must be met to the bit, a `Number` with what
rounding may leave, `OneOf` some values, or `UNKNOWN` where arrays do not hold what it needs.

Rounding. Spins are sums of two doubles and are added here with 64 bits, so u_i + u_j misses by 2^-62 of the larger one;
driven surfaces of a packing count as one speed up to 4 units in the last place, which is DRIVEN_ROUNDING of the fastest
of them. A sum of n numbers of either sign misses by (n + 8) 2^-53 of the sum of their sizes, whatever the order.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise, product

import networkx as nx
import numpy as np

EPS = 2.0**-53
DRIVEN_ROUNDING = 2.0**-49
SLIPLESS, SLIPPING, UNDECIDED, IDLE, TIED = range(5)
UNKNOWN = object()
MOST_PATHS = 5_000


@dataclass(frozen=True)
class Number:
    """What is expected, and by how much it may be missed, of the same shape or one for all."""

    value: object
    error: object = 0.0


@dataclass(frozen=True)
class OneOf:
    values: tuple


@dataclass(frozen=True)
class Range:
    low: float
    high: float


def summed(terms, scale=1.0):
    """A Number: the sum of terms (n, ...) that each may miss by some roundings, times a factor."""
    terms = np.asarray(terms, float)
    size = np.abs(terms).sum(axis=0) * abs(scale)
    return Number(terms.sum(axis=0) * scale, 4 * (len(terms) + 8) * EPS * size)


@dataclass(frozen=True)
class Laboratory:
    """One sample of an answer, R = 1. structure : of it. tolerance : that was asked for. duration, and
    inertia of the spheres : of a dynamics, or None."""

    answer: object
    structure: object
    tolerance: float
    duration: float | None = None
    inertia: float | None = None

    @cached_property
    def scene(self):
        return self.answer.scene

    @property
    def is_lattice(self):
        return self.answer.scene.network.lattice is not None

    @property
    def is_dynamics(self):
        return "time" in self.answer.history

    @property
    def law(self):
        return self.scene.law.name

    @property
    def flat(self):
        return (self.scene.lattice if self.is_lattice else self.scene).dimension == 2

    @cached_property
    def shape(self):
        return self.scene.lattice.shape

    @cached_property
    def contacts(self):
        """First and second sphere (E,) each, and unit vectors (E, 3)."""
        if not self.is_lattice:
            normal = np.zeros((self.scene.contacts, 3))
            normal[:, : self.scene.dimension] = self.scene.normal
            return (*np.asarray(self.scene.contact).T, normal)
        number, rows, shape = np.arange(np.prod(self.shape)).reshape(self.shape), [], self.shape
        for axis in range(len(shape)):
            sides = [n - (a == axis and "xyz"[a] not in self.scene.periodic) for a, n in enumerate(shape)]
            for low in np.ndindex(*sides):
                high = tuple((x + (a == axis)) % shape[a] for a, x in enumerate(low))
                rows.append((number[low], number[high], axis))
        first, second, axis = np.array(rows).T
        return first, second, np.eye(3)[axis]

    @cached_property
    def axis(self):
        return np.argmax(self.contacts[2], axis=1)

    @cached_property
    def place(self):
        """Of a lattice (N, 3), in steps from sphere (0, 0, 0)."""
        found = np.zeros((int(np.prod(self.shape)), 3))
        found[:, : len(self.shape)] = list(np.ndindex(*self.shape))
        return found

    @cached_property
    def driven(self):
        """(N,) -1 for free spheres."""
        if not self.is_lattice:
            return np.asarray(self.scene.driven)
        height = self.place[:, len(self.shape) - 1]
        return np.where(height == 0, 0, np.where(height == self.shape[-1] - 1, 1, -1))

    @cached_property
    def radius(self):
        return np.broadcast_to(np.asarray(self.scene.radius, float), self.driven.shape)

    @cached_property
    def coefficients(self):
        """Force that each contact bears at rest, and viscosity, (E,) each."""
        scene = self.scene
        if self.is_lattice:
            one = lambda parts: np.concatenate([np.ravel(part) for part in parts])  # noqa: E731
            first, second = one(scene.coefficients), one(scene.viscosity) if scene.viscosity else None
        else:
            first, second = scene.friction, scene.viscosity
        if self.law == "viscous":
            return 0 * first, first
        return first * scene.normal_force, 0 * first if second is None else second

    @cached_property
    def between_driven(self):
        first, second, _ = self.contacts
        return (self.driven[first] >= 0) & (self.driven[second] >= 0)

    @cached_property
    def acts(self):
        """(E,) True for contacts that take part."""
        held, viscosity = self.coefficients
        return ~self.between_driven & (held + viscosity > 0)

    @cached_property
    def spin(self):
        """(N, 3), 64 bits."""
        count, wide = len(self.driven), np.longdouble
        parts = [np.asarray(v[0], wide).reshape(count, -1) for v in (self.answer.spin, self.answer.spin_rounding)]
        found = np.zeros((2, count, 3), wide)
        found[..., 2 if self.flat else slice(None)] = np.stack(parts)[..., 0 if self.flat else slice(None)]
        return found

    @cached_property
    def slip(self):
        """A Number (E,): |u_i + u_j| across the contact."""
        first, second, normal = self.contacts
        u = self.spin * self.radius.astype(np.longdouble)[:, None]
        both = (u[0][first] + u[0][second]) + (u[1][first] + u[1][second])
        size = np.abs(u[0]).max()
        slip = np.sqrt((np.cross(both, normal.astype(np.longdouble)) ** 2).sum(axis=1)).astype(float)
        error = 2.0**-60 * float(size) + 16 * EPS * slip
        if not self.is_lattice:  # normals of unit length to rounding, and driven surfaces of one speed
            across = np.abs(both).max(axis=1).astype(float)
            error = error + 16 * EPS * across + DRIVEN_ROUNDING * self.fastest
        if self.answer.objective[0] == 0:  # a state without slip, but for what doubles cannot say
            error = error + DRIVEN_ROUNDING * self.fastest
        return Number(slip, error)

    @cached_property
    def fastest(self):
        return float(np.abs(self.spin[0] * self.radius[:, None])[self.driven >= 0].max(initial=0.0))

    def of_slip(self, share):
        """A Number (E,): friction times slip, and a share of viscosity times its square."""
        (held, viscosity), (slip, error) = self.coefficients, (self.slip.value, self.slip.error)
        value = held * slip + share * viscosity * slip**2
        return Number(value, held * error + share * viscosity * error * (2 * slip + error) + 8 * EPS * value)

    def total_of_slip(self, share, chosen):
        found = self.of_slip(share)
        value = found.value[chosen]
        return Number(value.sum(), found.error[chosen].sum() + 2 * (len(value) + 8) * EPS * value.sum())

    @cached_property
    def power(self):
        return self.total_of_slip(1.0, self.acts)

    @cached_property
    def objective(self):
        return self.total_of_slip(0.5 if self.law == "coulomb-viscous" else 1.0, self.acts)

    @cached_property
    def friction(self):
        """(E, 3) on the second sphere."""
        given, normal = self.answer.friction[0], self.contacts[2]
        return given[:, None] * np.cross([0.0, 0.0, 1.0], normal) if self.flat else np.asarray(given)

    @cached_property
    def force(self):
        size = np.sqrt((self.friction.astype(np.longdouble) ** 2).sum(axis=1)).astype(float)
        return Number(size, 32 * EPS * size)

    @cached_property
    def torque(self):
        """A Number (N, 3): of the friction of all contacts that take part. Both ends feel the same over the radius."""
        first, second, normal = self.contacts
        pull = np.where(self.acts[:, None], np.cross(-normal, self.friction), 0.0)
        found, size, degree = np.zeros((2, len(self.driven), 3)), 0, np.zeros(len(self.driven))
        size = found[1]
        for end in (first, second):
            np.add.at(found[0], end, pull)
            np.add.at(size, end, np.abs(pull))
            np.add.at(degree, end, self.acts)
        radius = self.radius[:, None]
        return Number(radius * found[0], 4 * (degree[:, None] + 8) * EPS * radius * size)

    @cached_property
    def state(self):
        return np.asarray(self.answer.state[0])

    @cached_property
    def proven(self):
        return np.asarray(self.answer.proven[0])

    def count(self, which):
        return int((self.state == which).sum())

    def slips_in(self, which):
        return np.asarray(self.answer.slip[0])[self.state == which]

    # networks

    @cached_property
    def node(self):
        """(N,) name of the node of each sphere: a driven body is one."""
        return [("body", int(body)) if body >= 0 else number for number, body in enumerate(self.driven)]

    @cached_property
    def slipless(self):
        return np.flatnonzero(self.state == SLIPLESS)

    @cached_property
    def held(self):
        return sorted({self.node[n] for n in np.flatnonzero(self.driven >= 0)})

    @cached_property
    def graph(self):
        """Slipless contacts, by number, between free spheres and driven bodies."""
        return self.joined(self.slipless, self.node)

    def joined(self, contacts, node):
        first, second, _ = self.contacts
        graph = nx.MultiGraph()
        graph.add_nodes_from(node)
        graph.add_edges_from((node[first[e]], node[second[e]], int(e)) for e in contacts)
        return graph

    @cached_property
    def piece(self):
        """Node -> the nodes of its piece."""
        return {node: frozenset(part) for part in nx.connected_components(self.graph) for node in part}

    @cached_property
    def spans(self):
        return any(self.piece[a] == self.piece[b] for a in self.held for b in self.held if a < b)

    @cached_property
    def spanning(self):
        """Nodes of pieces with several bodies."""
        return {node for node, part in self.piece.items() if sum(body in part for body in self.held) > 1}

    @cached_property
    def free(self):
        return np.flatnonzero(self.driven < 0).tolist()

    def winds(self, axis, spanning):
        """Whether a closed way of slipless contacts does not close in a lattice that is unrolled."""
        if not self.is_lattice or "xyz"[axis] not in self.scene.periodic:
            return None
        graph = self.joined(self.slipless, range(len(self.driven)))
        first, second, _ = self.contacts

        def turns(a, b, contact):
            over = self.axis[contact] == axis and self.place[first[contact], axis] == self.shape[axis] - 1
            return int(over) * (1 if (a, b) == (first[contact], second[contact]) else -1)

        for part in nx.connected_components(graph):
            if spanning and self.node[next(iter(part))] not in self.spanning:
                continue
            start = next(iter(part))
            at = {start: 0}
            for a, b in nx.bfs_edges(graph, start):
                at[b] = at[a] + turns(a, b, min(graph[a][b]))
            if any(at[a] + turns(a, b, key) != at[b] for a, b, key in graph.subgraph(part).edges(keys=True)):
                return True
        return False

    # two bearing states

    @cached_property
    def sign(self):
        """(N,) by which neighbours differ, that of the first sphere of each part +1; 0 in parts with odd loops."""
        first, second, _ = self.contacts
        graph = nx.Graph(zip(first.tolist(), second.tolist(), strict=True))
        graph.add_nodes_from(range(len(self.driven)))
        sign = np.zeros(len(self.driven))
        for part in nx.connected_components(graph):
            own = graph.subgraph(part)
            if nx.is_bipartite(own):
                sides = nx.bipartite.color(own)
                for sphere in part:
                    sign[sphere] = 1.0 if sides[sphere] == sides[min(part)] else -1.0
        return sign

    @cached_property
    def imposed(self):
        """R omega (N, 3) of driven spheres, double."""
        found = (self.spin.sum(axis=0) * self.radius[:, None]).astype(float)
        return np.where((self.driven >= 0)[:, None], found, 0.0)

    @cached_property
    def components(self):
        """Of a lattice: components of the spins in which the planes differ, but for that along the height, if any."""
        if self.flat:
            return [2]
        return [k for k in (0, 1) if self.jump_of_sites[:, k].any()] or [0]

    @cached_property
    def jump_of_sites(self):
        """Of a lattice (N, 3), 1/time: staggered spin of the top less that of the bottom, in the layers of a sphere."""
        scene, found = self.scene, np.zeros((len(self.driven), 3))
        if scene.top is None:
            axis = np.array([0.0, 0.0, 1.0] if self.flat else scene.direction, np.longdouble)
            axis = axis / np.abs(axis).max()
            jump = np.longdouble(scene.spin_top) - np.longdouble(scene.spin_bottom)
            found[:] = (jump * axis / np.sqrt((axis**2).sum())).astype(float)
            return found
        if self.flat:
            found[:, 2] = scene.top[0] - scene.bottom[0]
            return found
        difference = np.subtract(scene.top, scene.bottom)
        found[:] = difference[:3] + difference[3] * 2 * scene.radius * self.place
        return found

    @cached_property
    def jump(self):
        """(E, 3) R omega of the second body's state less that of the first, at the first sphere of each contact, in
        components that matter; None where bodies are in no two states that are the same all over."""
        first = self.contacts[0]
        if self.is_lattice:
            found = np.zeros((len(first), 3))
            found[:, self.components] = (self.scene.radius * self.jump_of_sites)[first][:, self.components]
            return found
        bodies = [b for _, b in self.held]
        if len(bodies) != 2 or not self.sign.all():
            return None
        turned = self.sign[:, None] * self.imposed
        low, high = (turned[self.driven == body] for body in bodies)
        if any(np.abs(own - own[0]).max() > 1e-12 * self.fastest for own in (low, high)):
            return None
        found = np.broadcast_to(high[0] - low[0], (len(first), 3)).copy()
        found[np.abs(found) < 1e-12 * self.fastest] = 0.0
        return found

    @cached_property
    def weights(self):
        """(E,) what each contact adds where an interface of two rigid domains crosses it, and its power there."""
        across = np.linalg.norm(np.cross(self.jump, self.contacts[2]), axis=1)
        if not self.is_lattice:  # normals along the jump to rounding
            across[across <= 1e-12 * np.linalg.norm(self.jump, axis=1)] = 0.0
        held, viscosity = self.coefficients
        share = 0.5 if self.law == "coulomb-viscous" else 1.0
        on = self.acts
        weight = np.where(on, held * across + share * viscosity * across**2, 0.0)
        return weight, np.where(on, held * across + viscosity * across**2, 0.0)

    @cached_property
    def cut(self):
        """Weight of the lightest interface, in exact whole numbers of a unit; None without two states or weights."""
        if self.jump is None or not self.weights[0].any():
            return None
        first, second, _ = self.contacts
        graph = nx.Graph()
        graph.add_nodes_from(self.held)
        exact = [Fraction(float(weight)) for weight in self.weights[0]]
        unit = max(weight.denominator for weight in exact)
        for e in np.flatnonzero(self.weights[0] > 0):
            a, b = self.node[first[e]], self.node[second[e]]
            if a != b:
                known = graph.edges[a, b]["capacity"] if graph.has_edge(a, b) else 0
                graph.add_edge(a, b, capacity=known + int(exact[e] * unit))
        return float(Fraction(nx.maximum_flow_value(graph, *self.held), unit))

    @cached_property
    def interface(self):
        """Contacts (E,) that the answer names as the lightest interface: they part the bodies and weigh as little."""
        named, first, second = self.structure.interface.contacts, *self.contacts[:2]
        weight = float(self.weights[0][named].sum())
        assert abs(weight - self.cut) <= 64 * (len(named) + 8) * EPS * self.cut
        graph = nx.Graph()
        graph.add_nodes_from(self.held)
        others = np.flatnonzero((self.weights[0] > 0) & ~named)
        graph.add_edges_from((self.node[first[e]], self.node[second[e]]) for e in others)
        assert not nx.has_path(graph, *self.held)
        return named

    # rigid domains of a lattice

    @cached_property
    def domains(self):
        """(N,) what each sphere is tied to in each component, one tuple each of its domain and of its locks."""
        each = []
        for k in self.components:
            jump = self.jump_of_sites[:, k]
            uneven = bool((jump != jump[0]).any())
            node = [
                (name[0], name[1], int(self.place[n, k]) if uneven else 0) if isinstance(name, tuple) else name
                for n, name in enumerate(self.node)
            ]
            graph = self.joined([e for e in self.slipless if self.axis[e] != k], node)
            piece = {one: frozenset(part) for part in nx.connected_components(graph) for one in part}
            found = []
            for n in range(len(self.driven)):
                layer = int(self.place[n, k]) if uneven else 0
                own = piece[node[n]]
                locks = tuple(("body", body, layer) in own for body in (0, 1))
                label = ("bottom",) if locks[0] else ("top",) if locks[1] else own
                found.append((label, locks))
            # a domain that joins both planes in one layer is locked to both
            whole = {}
            for label, locks in found:
                whole[label] = tuple(a or b for a, b in zip(locks, whole.get(label, locks), strict=True))
            each.append([(label, whole[label]) for label, _ in found])
        labels = [tuple(of[n][0] for of in each) for n in range(len(self.driven))]
        locks = [tuple(of[n][1] for of in each) for n in range(len(self.driven))]
        return labels, locks

    def kind(self, locks):
        bottom, top = (all(lock[body] for lock in locks) for body in (0, 1))
        if bottom and top:
            return "both"
        if bottom or top:
            return "bottom" if bottom else "top"
        held = [any(lock) for lock in locks]
        return "mixed" if all(held) else "partly" if any(held) else "neither"

    @cached_property
    def kinds(self):
        return [self.kind(locks) for locks in self.domains[1]]

    # shortest paths between driven spheres

    @cached_property
    def pairs(self):
        """(pairs, sum of their distances, load (E,)); UNKNOWN where there are too many paths."""
        if len(self.held) != 2:
            return UNKNOWN
        graph = self.joined(self.slipless, range(len(self.driven)))
        load, number, far, seen = np.zeros(len(self.state)), 0, 0, 0
        low, high = (np.flatnonzero(self.driven == body).tolist() for _, body in self.held)
        for s, t in product(low, high):
            own = graph.subgraph([*self.free, s, t])
            if not nx.has_path(own, s, t):
                continue
            ways = []
            for nodes in nx.all_shortest_paths(nx.Graph(own), s, t):
                ways += product(*(list(own[a][b]) for a, b in pairwise(nodes)))
                if (seen := seen + 1) > MOST_PATHS:
                    return UNKNOWN
            number, far = number + 1, far + len(ways[0])
            for way in ways:
                load[list(way)] += 1 / len(ways)
        return number, far, load

    @cached_property
    def backbone(self):
        """Contacts on a way from body to body: those that share a block with a link between these from outside."""
        simple = nx.Graph(self.graph)
        simple.add_edges_from((body, "outside") for body in self.held)
        found = set()
        for block in nx.biconnected_component_edges(simple):
            edges = {frozenset(edge) for edge in block}
            if any("outside" in edge for edge in edges):
                found |= edges
        return [e for a, b, e in self.graph.edges(keys=True) if frozenset((a, b)) in found] if self.spans else []

    @cached_property
    def parting(self):
        """Contacts whose removal alone parts two bodies that are joined."""
        joined, found = [(a, b) for a in self.held for b in self.held if a < b and b in self.piece[a]], []
        for a, b, e in list(self.graph.edges(keys=True)):
            if e in self.backbone:
                without = self.graph.copy()
                without.remove_edge(a, b, key=e)
                if not all(nx.has_path(without, *pair) for pair in joined):
                    found.append(e)
        return found


def slipless_state_exists(lab):
    """Whether some spins of free spheres slip nowhere, by least squares over all contacts."""
    matrix, fixed = turning(lab, np.flatnonzero(lab.acts))
    unit = np.abs(fixed).max(initial=0.0)
    if unit == 0 or not matrix.shape[1]:
        return unit == 0
    found = np.linalg.lstsq(matrix, -fixed / unit, rcond=1e-11)[0]
    return bool(np.abs(matrix @ found + fixed / unit).max() < 1e-8)


def turning(lab, contacts, components=(0, 1, 2)):
    """Slips (3 n,) = matrix @ u of free spheres in these components + fixed."""
    first, second, normal = lab.contacts
    parts = [2] if lab.flat else list(components)
    free = list(lab.free)
    number = {n: m for m, n in enumerate(free)}
    matrix, fixed = np.zeros((3 * len(contacts), len(parts) * len(free))), np.zeros(3 * len(contacts))
    for row, e in enumerate(contacts):
        turn = np.cross(np.eye(3), normal[e]).T
        for n in (int(first[e]), int(second[e])):
            rows = slice(3 * row, 3 * row + 3)
            if n in number:
                matrix[rows, len(parts) * number[n] : len(parts) * (number[n] + 1)] += turn[:, parts]
            else:
                fixed[rows] += turn @ lab.imposed[n]
    return matrix, fixed


def rank(matrix):
    return int(np.linalg.matrix_rank(matrix, tol=1e-9 * np.linalg.norm(matrix, 2))) if matrix.any() else 0


# numbers of samples


def gap(lab):
    objective, bound, said = lab.objective.value, float(lab.answer.lower_bound[0]), float(lab.answer.gap[0])
    value = float(lab.answer.objective[0])
    if value == 0:
        return 0.0
    if said == 0 and bound < value and slipless_state_exists(lab):
        return 0.0
    assert objective >= 0
    return Number((value - bound) / value, 16 * EPS * (1 + abs(bound) / value))


def status(lab):
    ended = lab.answer.status.value
    return "certified" if lab.answer.gap[0] <= lab.tolerance and lab.duration is None else ended


def separation(lab):
    still, moving = lab.slips_in(SLIPLESS), lab.slips_in(SLIPPING)
    if not (len(still) and len(moving) and lab.answer.gap[0] <= lab.tolerance):
        return np.nan
    rounding = 2 * EPS * lab.scene.radius * max(map(abs, lab.scene.imposed))
    least = max(still.max(), rounding)
    return Number(np.log10(moving.min() / least) if least else np.inf, 1e-12)


def torque_left_over(lab):
    if lab.is_dynamics:
        return UNKNOWN  # of the forces that act, which are not stored as vectors
    torque, free = lab.torque, lab.free
    over = 1.0 if lab.is_lattice else lab.radius[free]
    size, error = (np.abs(part[free]).max(axis=1) / over for part in (torque.value, torque.error))
    return Number(size.max(initial=0.0), error.max(initial=0.0))


def power_normalised(lab):
    if not lab.is_lattice or lab.law != "coulomb":
        return None
    unit = lab.scene.normal_force * lab.scene.radius * abs(lab.scene.imposed[0])
    found = lab.power
    return Number(found.value / unit, found.error / unit + 8 * EPS * found.value / unit) if unit else None


def energy_residual(lab):
    history = lab.answer.history
    if "energy_residual" not in history:
        return None
    if history["iteration"][0]:
        return UNKNOWN
    kinetic, spring, work, lost = (
        history[f"{name}_energy"][:, 0] for name in ("kinetic", "spring", "injected", "dissipated")
    )
    start = kinetic[0] + spring[0]
    turnover = max(start + abs(work[-1]), abs(lost[-1]))
    terms = np.array([start, work[-1], -lost[-1], -kinetic[-1], -spring[-1]])
    if not turnover > 0:
        return 0.0
    found = summed(terms)
    return Number(found.value / turnover, found.error / turnover + 4 * EPS)


def of_lattice(formula):
    return lambda lab: formula(lab) if lab.is_lattice else None


def of_packing(formula):
    return lambda lab: None if lab.is_lattice else formula(lab)


SAMPLES = {
    "power": lambda lab: lab.power,
    "potential": lambda lab: lab.objective if lab.law == "coulomb-viscous" else None,
    "gap": gap,
    "status": status,
    "law": lambda lab: lab.law,
    "shape": of_lattice(lambda lab: list(lab.shape)),
    "spheres": of_packing(lambda lab: len(lab.scene.center)),
    "driven_spheres": of_packing(lambda lab: int((lab.driven >= 0).sum())),
    "contacts": lambda lab: int(lab.acts.sum()),
    "slipping": lambda lab: lab.count(SLIPPING),
    "slipless": lambda lab: lab.count(SLIPLESS),
    "undecided": lambda lab: lab.count(UNDECIDED),
    "tied": lambda lab: int((lab.acts & (lab.state == TIED)).sum()),
    "states_proven": lambda lab: bool(lab.proven[lab.acts].all()),
    "unproven": lambda lab: int((lab.acts & ~lab.proven).sum()),
    "largest_slipless_slip": of_lattice(lambda lab: lab.slips_in(SLIPLESS).max() if lab.count(SLIPLESS) else np.nan),
    "smallest_slipping_slip": of_lattice(lambda lab: lab.slips_in(SLIPPING).min() if lab.count(SLIPPING) else np.nan),
    "separation_decades": of_lattice(separation),
    "slip_threshold": lambda lab: Range(lab.slips_in(SLIPLESS).max(initial=0.0), np.inf) if lab.is_lattice else UNKNOWN,
    "largest_balance_residual": torque_left_over,
    "spin_top": of_lattice(lambda lab: lab.scene.spin_top if lab.scene.top is None else UNKNOWN),
    "spin_bottom": of_lattice(lambda lab: lab.scene.spin_bottom if lab.scene.top is None else UNKNOWN),
    "normal_force": of_lattice(lambda lab: lab.scene.normal_force),
    "radius": of_lattice(lambda lab: lab.scene.radius),
    "power_normalised": power_normalised,
    "time": lambda lab: float(lab.answer.history["time"][-1]) if lab.is_dynamics else None,
    "duration": lambda lab: lab.duration if lab.is_dynamics else None,
    "energy_residual": energy_residual,
}


def state(lab):
    """Only where it is 3 is told by a formula."""
    return np.where(lab.acts, np.where(lab.state == IDLE, UNDECIDED, lab.state), IDLE)


def proven(lab):
    """What takes no part counts as proven, and what is undecided does not."""
    return ~lab.acts | (lab.proven & (lab.state != UNDECIDED))


CONTACTS = {
    "slip": lambda lab: lab.slip,
    "power": lambda lab: lab.of_slip(1.0),
    "force": lambda lab: UNKNOWN if lab.is_dynamics else lab.force,
    "state": state,
    "proven": proven,
}


def power_at_the_end(lab):
    """A dynamics has no better state than its last one."""
    return lab.power if lab.is_dynamics else UNKNOWN


def kinetic_energy(lab):
    """I omega^2 / 2 of free spheres."""
    if "kinetic_energy" not in lab.answer.history:
        return UNKNOWN
    spin = lab.spin.sum(axis=0).astype(float)[lab.free]
    return summed((spin**2).sum(axis=1), lab.inertia / 2)


CHECK_ROWS = {"power": power_at_the_end, "kinetic_energy": kinetic_energy, "energy_residual": energy_residual}
SPHERES = {"spin_rounding": lambda lab: Number(np.zeros(lab.answer.spin[0].shape), EPS * np.abs(lab.answer.spin[0]))}


def motions(lab):
    """Kernel of the slips by the free spheres that contacts join to a driven one."""
    graph = lab.joined(np.flatnonzero(lab.acts), range(len(lab.driven)))
    reached = [p for p in nx.connected_components(graph) if any(lab.driven[n] >= 0 for n in p)]
    moved = np.isin(lab.free, sorted(set().union(*reached)))
    matrix = turning(lab, np.flatnonzero(lab.acts))[0]
    matrix = matrix[:, np.repeat(moved, 1 if lab.flat else 3)]
    return matrix.shape[1] - rank(matrix)


FINDINGS = {
    "driven_power": lambda lab: lab.total_of_slip(1.0, lab.between_driven),
    "slipless_motions": motions,
}


# numbers of analyses


def cut_power(lab):
    if lab.cut is None:
        return None if lab.structure.interface is None else OneOf((0.0,))
    power = lab.weights[1][lab.interface]
    return Number(power.sum(), 64 * (len(power) + 8) * EPS * power.sum())


def over(number, unit):
    return Number(number / unit, 64 * EPS * abs(number / unit)) if unit else np.nan


def self_stress(lab):
    if lab.is_lattice:  # loops of slipless contacts around which a component can circulate
        total = 0
        for k in lab.components:  # top spheres without a jump turn as the bottom does
            alike = (lab.driven >= 0) & (lab.jump_of_sites[:, k] == 0)
            node = [lab.held[0] if same else own for same, own in zip(alike, lab.node, strict=True)]
            graph = lab.joined([e for e in lab.slipless if lab.axis[e] != k], node)
            total += graph.number_of_edges() - graph.number_of_nodes() + nx.number_connected_components(graph)
        return total
    return UNKNOWN


def signs_or_one(lab):
    return np.where(lab.sign == 0, 1.0, lab.sign)


def driving_torque(lab):
    if len(lab.held) != 2:
        return UNKNOWN
    on_top = np.flatnonzero(lab.driven == lab.held[-1][1])
    sign = signs_or_one(lab)[on_top, None]
    parts = lab.components if lab.is_lattice else [2] if lab.flat else [0, 1, 2]
    value = -(sign * lab.torque.value[on_top]).sum(axis=0)[parts]
    error = lab.torque.error[on_top].sum(axis=0)[parts] * (len(on_top) + 8)
    return Number(value, error)


def slipless_share(lab):
    if not lab.is_lattice:
        return UNKNOWN
    first, normal = lab.contacts[0], lab.contacts[2]
    upright = (lab.axis == len(lab.shape) - 1) & lab.acts
    pull = np.cross(normal, lab.friction)
    jump = np.zeros_like(pull)
    jump[:, lab.components] = lab.jump_of_sites[first][:, lab.components]
    carried = np.where(upright, lab.sign[first] * (pull * jump).sum(axis=1), 0.0)
    size = np.where(upright, np.abs(pull * jump).sum(axis=1), 0.0).sum()
    whole = carried.sum()
    if abs(whole) <= 1e3 * (len(carried) + 8) * EPS * size:
        return UNKNOWN
    part = carried[lab.state == SLIPLESS].sum()
    return Number(part / whole, 16 * (len(carried) + 8) * EPS * size / abs(whole) * (1 + abs(part / whole)))


def saturation(lab):
    if lab.law != "coulomb":
        return None
    held = lab.coefficients[0]
    loaded = (lab.state == SLIPLESS) & (held > 0)
    return summed(lab.force.value[loaded] / held[loaded], 1 / loaded.sum()) if loaded.any() else np.nan


def spread(lab):
    """Of staggered spins above those of the bottom, in units in which doubles hold them."""
    labels, locks = lab.domains
    bottom = np.zeros(3)
    sign, count = lab.sign[:, None], len(lab.driven)
    if lab.scene.top is not None and not lab.flat and lab.scene.bottom[3]:
        return UNKNOWN
    u = sign * lab.spin.sum(axis=0)
    u = (u - u[lab.driven == 0][0] - bottom).astype(float)
    largest = 0.0
    own = {}
    for n in range(count):
        own.setdefault(labels[n], []).append(n)
    for members in own.values():
        for slot, k in enumerate(lab.components):
            target = lab.jump_of_sites[members, k] if locks[members[0]][slot] == (False, True) else u[members, k].mean()
            largest = max(largest, np.abs(u[members, k] - target).max())
    fastest = float(np.abs(lab.spin[0]).max())
    return Number(largest, 4 * (count + 8) * EPS * fastest)


def largest_free(lab):
    sizes = {}
    for n in lab.free:
        sizes[lab.domains[0][n]] = sizes.get(lab.domains[0][n], 0) + 1
    return max(sizes.values(), default=0)


def largest_intermediate(lab):
    sizes = {}
    for label, kind in zip(lab.domains[0], lab.kinds, strict=True):
        if kind not in ("bottom", "top", "both"):
            sizes[label] = sizes.get(label, 0) + 1
    return max(sizes.values(), default=0)


KINDS = ("bottom", "top", "both", "mixed", "partly", "neither")


def domains_by_kind(lab):
    found = dict(zip(lab.domains[0], lab.kinds, strict=True))
    return {kind: list(found.values()).count(kind) for kind in KINDS}


def free_by_kind(lab):
    own = [lab.kinds[n] for n in lab.free]
    return {kind: own.count(kind) for kind in KINDS}


def only_lattices(formula):
    """Of a packing domains are told by speeds up to a threshold."""
    return lambda lab: formula(lab) if lab.is_lattice else UNKNOWN


def path_planes(lab):
    """The path is one of the shortest: it is checked, and its planes counted."""
    if not lab.is_lattice:
        return None
    path = lab.structure.network.path.tolist()
    graph = lab.joined(lab.slipless, range(len(lab.driven)))
    assert all(graph.has_edge(a, b) for a, b in pairwise(path))
    assert bool(path) == lab.spans
    return [len({int(lab.place[n, axis]) for n in path}) for axis in range(len(lab.shape) - 1)] if path else np.nan


def of_pairs(formula):
    return lambda lab: UNKNOWN if lab.pairs is UNKNOWN else formula(lab, *lab.pairs)


def mean_distance(lab, number, far, load):
    return Number(far / number, 1e-12 * far) if lab.spans else np.nan


def busiest(lab, number, far, load):
    return Number(load.max() / number, 1e-12) if lab.spans else np.nan


def effective(lab, number, far, load):
    return Number(load.sum() ** 2 / (load**2).sum(), 1e-9 * len(load)) if load.any() else 0.0


def most_loaded(lab, number, far, load):
    """Shares of the ten that carry most, the heaviest first."""
    share = np.sort(load / max(1, number))[::-1][:10]
    return Number(share[share > 1e-12], 1e-12)


def shortest(lab):
    if not lab.spans:
        return np.nan
    return min(
        nx.shortest_path_length(lab.graph, a, b)
        for a in lab.held
        for b in lab.held
        if a < b and nx.has_path(lab.graph, a, b)
    )


def disjoint(lab):
    graph = nx.Graph()
    graph.add_nodes_from(lab.graph)
    for a, b in lab.graph.edges():
        known = graph.edges[a, b]["capacity"] if graph.has_edge(a, b) else 0
        graph.add_edge(a, b, capacity=known + 1)
    return nx.maximum_flow_value(graph, *lab.held) if len(lab.held) == 2 else None


def slipping_are_cut(lab):
    if lab.structure.interface is None:
        return None
    return bool((lab.structure.interface.contacts == (lab.state == SLIPPING)).all())


def share_of_free(lab, chosen):
    return Number(sum(chosen(n) for n in lab.free) / len(lab.free), 2 * EPS) if lab.free else None


STRUCTURE = {
    "power_minimum_cut": cut_power,
    "power_over_cut": lambda lab: (
        None if lab.structure.interface is None else over(lab.structure.power, lab.structure.interface.power)
    ),
    "cut_contacts": lambda lab: (
        int(lab.interface.sum()) if lab.cut is not None else None if lab.structure.interface is None else 0
    ),
    "slipping_contacts_are_the_cut": slipping_are_cut,
    "slipless_fraction": lambda lab: Number(lab.count(SLIPLESS) / lab.acts.sum(), 2 * EPS) if lab.acts.any() else None,
    "components": lambda lab: sum(lab.graph.subgraph(p).number_of_edges() > 0 for p in set(lab.piece.values())),
    "spans": lambda lab: lab.spans,
    "reached_fraction": lambda lab: share_of_free(lab, lambda n: lab.graph.degree(n) > 0),
    "spanning_fraction": lambda lab: share_of_free(lab, lambda n: n in lab.spanning),
    "shortest_path": shortest,
    "planes_crossed": path_planes,
    "disjoint_paths": disjoint,
    "winds_x": lambda lab: lab.winds(0, False),
    "winds_y": lambda lab: lab.winds(1, False),
    "spanning_winds_x": lambda lab: lab.winds(0, True),
    "spanning_winds_y": lambda lab: lab.winds(1, True),
    "domains": only_lattices(lambda lab: len(set(lab.domains[0]))),
    "domains_locked_to": only_lattices(domains_by_kind),
    "free_spheres_locked_to": only_lattices(free_by_kind),
    "largest_intermediate_domain": only_lattices(largest_intermediate),
    "largest_domain": only_lattices(largest_free),
    "largest_spread_in_a_domain": only_lattices(spread),
    "connected_pairs": of_pairs(lambda lab, number, far, load: number),
    "mean_distance": of_pairs(mean_distance),
    "betweenness_is_exact": lambda lab: True,
    "busiest_link_share": of_pairs(busiest),
    "backbone_links": lambda lab: len(lab.backbone),
    "parting_links": lambda lab: len(lab.parting),
    "effective_links": of_pairs(effective),
    "most_loaded": of_pairs(most_loaded),
    "self_stress_states": self_stress,
    "driving_torque": driving_torque,
    "slipless_share_of_torque": slipless_share,
    "mean_saturation": saturation,
}
