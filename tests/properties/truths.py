"""What encloses the least power (or potential) of a scene without the package: exact cuts, 140 digits, and Clarabel.

An enclosure is rigorous: exact numbers, or spins and forces of whatever origin that are judged in 80 digits, contact by
contact in the laboratory frame.
"""

from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction

import networkx
import numpy as np
from scipy import sparse
from taichi_bearings_studies.stress import truth as decimals

from tests.clarabel_twin import least as least_by_clarabel
from tests.kernels.twins import is_driven, neighbours
from tests.proof.laboratory import Laboratory
from tests.proof.samples import Samples
from tests.properties.scenes import arrays_of

EXACT = Fraction(1, 10**60)  # relative: what 80 digits lose on the way
BOTTOM, TOP = "bottom", "top"
NEVER, ALWAYS, SOMETIMES, DRIVEN = range(4)  # slips so at the minima, or takes no part; also the numbers of states


@dataclass(frozen=True)
class Enclosure:
    """Of the least objective, energy/time."""

    lower: Fraction
    upper: Fraction


def least(scene):
    """Enclosure of the least objective of a scene of one sample; the tightest there is."""
    if scene.law.name == "viscous" and (scene.coefficient > 0).all():
        truth = decimals.least(scene)
        return Enclosure(Fraction(truth.lower), Fraction(truth.upper))
    if scene.law.name == "coulomb" and len(turned(scene)) == 1:
        weight, _ = cut(scene)
        unit = Fraction(scene.normal_force) * Fraction(scene.lattice.radius) * jump_of(scene, turned(scene)[0])
        return Enclosure(weight * unit * (1 - EXACT), weight * unit * (1 + EXACT))
    laboratory = Laboratory(by_clarabel(scene))
    lower, upper = Fraction(laboratory.lower_bound()), laboratory.objective()
    speed = 1 + Fraction(scene.lattice.radius) * Fraction(scene.fastest)
    viscosity = scene.viscosity_beside_friction
    strength = float(scene.coefficient.sum() + (0 if viscosity is None else viscosity.sum()))
    lost = (
        EXACT * Fraction(strength) * (1 + Fraction(scene.normal_force)) * speed**2
    )  # where the bound is 0 but for that
    return Enclosure(max(lower * (1 - EXACT) - lost, Fraction(0)), Fraction(upper) * (1 + EXACT))


def turned(scene):
    """Components of the spins that the driving turns, less the one about the height, which costs nothing."""
    if scene.lattice.dimension == 2:
        return (2,)
    return tuple(k for k in (0, 1) if scene.direction[k])


def jump_of(scene, component):
    """|imposed difference| of a component, exact to 70 digits."""
    jump = abs(Fraction(scene.spin_top) - Fraction(scene.spin_bottom))
    if scene.lattice.dimension == 2:
        return jump
    parts = [Fraction(part) for part in scene.direction]
    square = parts[component] ** 2 / sum(part**2 for part in parts)
    return jump * Fraction((Decimal(square.numerator) / Decimal(square.denominator)).sqrt())


def cut(scene):
    """Weight of the lightest cut that parts top and bottom, and what every contact does at the minima: one component.

    Contacts along the axis of the spins do not feel them. A flow in whole numbers is exact for doubles.
    """
    (component,), shape = turned(scene), scene.lattice.shape
    weights = scene.lattice.by_axis(scene.coefficient[0])
    exact = {(axis, lower): Fraction(weights[axis][lower]) for lower, _, axis in neighbours(shape)}
    unit = max(weight.denominator for weight in exact.values())  # powers of two
    graph, contacts = networkx.DiGraph(), []
    graph.add_nodes_from((BOTTOM, TOP))
    for lower, upper, axis in neighbours(shape):
        if axis == component or (is_driven(lower, shape) and is_driven(upper, shape)):
            continue
        ends = [BOTTOM if s[-1] == 0 else TOP if s[-1] == shape[-1] - 1 else s for s in (lower, upper)]
        capacity = int(exact[axis, lower] * unit)
        if not capacity:
            continue
        contacts.append((axis, lower, *ends))
        for a, b in (ends, ends[::-1]):
            known = graph.edges[a, b]["capacity"] if graph.has_edge(a, b) else 0
            graph.add_edge(a, b, capacity=known + capacity)
    flow = networkx.algorithms.flow.dinitz(graph, BOTTOM, TOP)
    return Fraction(flow.graph["flow_value"], unit), _states(scene, flow, contacts)


def _states(scene, flow, contacts):
    """By Picard and Queyranne: a contact is cut by all lightest cuts if it joins what the rest of the flow can reach
    from the bottom to what can reach the top, and by none if flow can go on between its ends both ways."""
    rest = networkx.DiGraph([(a, b) for a, b, of in flow.edges(data=True) if of["flow"] < of["capacity"]])
    rest.add_nodes_from(flow)
    below, above = networkx.descendants(rest, BOTTOM) | {BOTTOM}, networkx.ancestors(rest, TOP) | {TOP}
    part = {site: number for number, group in enumerate(networkx.strongly_connected_components(rest)) for site in group}
    states = scene.lattice.by_axis(np.where(scene.idle[0], DRIVEN, NEVER))
    for axis, lower, *ends in contacts:
        a, b = ends
        if (a in below and b in above) or (b in below and a in above):
            states[axis][lower] = ALWAYS
        elif part[a] != part[b]:
            states[axis][lower] = SOMETIMES
    return states


@dataclass(frozen=True)
class Kinematics:
    """Slips (3E,) = turning @ spins + fixed of the contacts in the laboratory frame (paper Eq. 2), for spins (3M,) of
    the free spheres measured from the bearing state of the bottom in units of the jump, in units of radius * jump.

    acting : E contacts (lower, upper, axis). free : site -> number of the free spheres.
    """

    acting: list
    free: dict
    turning: sparse.csc_matrix
    fixed: np.ndarray


def kinematics(scene):
    """Contact by contact, with all components of the spins."""
    shape, flat = scene.lattice.shape, scene.lattice.dimension == 2
    direction = np.array([0.0, 0.0, 1.0] if flat else scene.direction)
    direction = direction / np.abs(direction).max()
    direction = direction / np.linalg.norm(direction)
    free = {site: n for n, site in enumerate(s for s in np.ndindex(shape) if not is_driven(s, shape))}
    held = scene.lattice.by_axis(scene.coefficient[0] > 0)
    there = (c for c in neighbours(shape) if held[c[2]][c[0]])
    acting = [c for c in there if not (is_driven(c[0], shape) and is_driven(c[1], shape))]
    turning, fixed = sparse.lil_matrix((3 * len(acting), 3 * len(free))), np.zeros(3 * len(acting))
    for row, (lower, upper, axis) in enumerate(acting):
        turn = -np.cross(np.eye(3), np.eye(3)[axis]).T  # of a spin: -w x n
        for site in (lower, upper):
            if site in free:
                turning[3 * row : 3 * row + 3, 3 * free[site] : 3 * free[site] + 3] = turn
            elif site[-1]:
                fixed[3 * row : 3 * row + 3] += (-1) ** sum(site) * turn @ direction
    return Kinematics(acting, free, turning.tocsc(), fixed)


def by_clarabel(scene):
    """Spins and forces of least objective as Clarabel finds them, all components free."""
    motion = kinematics(scene)
    held, viscosity = _strengths(scene, motion.acting)
    unit = float(np.max(held + viscosity))
    found = least_by_clarabel(motion.turning, motion.fixed.reshape(-1, 3), held / unit, viscosity / unit, 1e-13)
    return _stored(scene, motion, found.spins.reshape(-1, 3), found.force * unit)


def _strengths(scene, acting):
    """Friction that each contact bears, and viscosity in units of force over radius times jump."""
    first, *beside = (
        np.array([of[axis][0][lower] for lower, _, axis in acting]) for of in arrays_of(scene).values() if of
    )
    speed = scene.lattice.radius * abs(scene.spin_top - scene.spin_bottom)
    if scene.law.name == "viscous":
        return 0 * first, first * speed
    return first * scene.normal_force, sum(beside, 0 * first) * speed


def _stored(scene, motion, spins, forces):
    """As a run would store it, for the judges."""
    shape, flat = scene.lattice.shape, scene.lattice.dimension == 2
    parts = [Decimal(part) for part in ((0, 0, 1) if flat else scene.direction)]
    size = sum(part * part for part in parts).sqrt()
    spin = np.zeros((2, 1, *shape, 3))
    jump = Decimal(scene.spin_top) - Decimal(scene.spin_bottom)
    for site, number in motion.free.items():
        for k in range(3):
            turned_by = (-1) ** sum(site) * Decimal(scene.spin_bottom) * parts[k] / size
            exact = turned_by + Decimal(float(spins[number, k])) * jump
            spin[(0, 0, *site, k)] = float(exact)
            spin[(1, 0, *site, k)] = float(exact - Decimal(float(exact)))
    sign = 1.0 if jump > 0 else -1.0  # spins are in units of the jump with its sign, forces in units of force
    friction = [np.zeros((1, *scene.lattice.contact_shape(axis), 3)) for axis in range(scene.lattice.dimension)]
    for (lower, _, axis), force in zip(motion.acting, forces, strict=True):
        friction[axis][(0, *lower)] = -sign * force  # on the upper sphere, against its slip
    if flat:
        spin = spin[..., 2]
        friction = [f @ np.cross([0.0, 0.0, 1.0], np.eye(3)[axis]) for axis, f in enumerate(friction)]
    return samples_of(scene, spin[0], spin[1], tuple(friction))


def samples_of(scene, spin, spin_rounding, friction):
    """What judges take: arrays of the laboratory frame beside the numbers of the scene."""
    arrays = arrays_of(scene)
    return Samples(
        scene.lattice.shape, scene.law.name, arrays["coefficients"], scene.spin_top, scene.spin_bottom,
        scene.direction, scene.normal_force, scene.lattice.radius, spin, spin_rounding, friction, arrays["viscosity"],
    )  # fmt: skip
