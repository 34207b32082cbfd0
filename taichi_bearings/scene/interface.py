"""The lightest interface between two rigid domains of a bearing, found as a minimum cut, and the spins of the domains.

A bearing state is a set of spins at which no contact slips: s u = A + c x at each sphere, with u = R omega its surface
speed, x its centre, and s = +1 or -1 its sublattice. If the network has no odd loops and two driven bodies, each in a
bearing state of its own, every sphere may follow one of the two states. Then only contacts between the two domains
slip, by the part of the jump across their normals. The jump is the second state less the first.

Where normals lie along the axes, a component of the spins by which no contact has to slip is left out of the jump: on
a cubic lattice that along the height.

The weight of a contact is its share of the objective, if it is on the interface. The objective is what the stationary
state minimises, the power or the dissipation potential. Letters: R samples, N spheres, E contacts, C spin components.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.numerics.exact_cuts import with_exact_ties
from taichi_bearings.numerics.minimum_cut import WEIGHT_ROUNDING, MinimumCut, graph_cut, minimum_cut, number_bodies
from taichi_bearings.scene.bearing import Bearing, vector_length
from taichi_bearings.scene.scene import Scene

SAME_STATE = 1e-9  # spins may miss a bearing state by this, relative to the largest R omega
ACROSS = 1e-12  # a part of the jump across a normal that is smaller than this, relative to the jump, is rounding
STATE_ROUNDING = 2.0**-48  # relative rounding of R omega: a dozen roundings of 2^-53 each, and some margin


def bearing_states(bearing: Bearing) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the signs of the sublattices, (spheres N,), +1 or -1, and the two bearing states of a bearing with two
    driven bodies, (2, N, components C).

    bearing : a lattice or a packing, with its driven bodies.

    A bearing state is a set of spins at which no contact slips, given as sign * radius * spin of all spheres,
    length/time. The first state is that of the first driven body, continued to all spheres; the second that of the
    second body.

    Return None in one of these cases:

    * the network has odd loops (closed chains of an odd number of contacts), or the number of driven bodies is not two;
    * a body is in no bearing state;
    * a contact slips in one of the states, as some do across a periodic side.
    """
    (odd, sign), bodies = bearing.network.sublattices, bearing.network.bodies
    if odd.any() or len(bodies) != 2:
        return None
    signed_speeds = sign[:, None] * bearing.driven_speed
    low, high = (_state(bearing.network.center, signed_speeds, bearing.network.body == body) for body in bodies)
    if low is None or high is None:
        return None
    for state in (low, high):
        contact = bearing.acting
        first, second = bearing.network.contact[:, contact]
        missed = bearing.network.across(state[second] - state[first], contact)
        if missed.max(initial=0.0) > SAME_STATE * np.abs(state).max(initial=0.0):
            return None
    return sign, np.stack([low, high])


def _state(center: np.ndarray, signed_speeds: np.ndarray, own: np.ndarray) -> np.ndarray | None:
    """Return the bearing state A + c x that fits the spheres of a driven body, with c = 0 if that fits, continued to
    all spheres: (spheres N, components C), length/time. None if no state fits; for discs c is always 0.

    center : (N, dimensions D), positions x, length.
    signed_speeds : (N, C), sign * radius * spin, length/time.
    own : (N,) mask of the spheres of the body.
    """
    value = signed_speeds[own][0]
    if (signed_speeds[own] == value).all():
        return np.broadcast_to(value, signed_speeds.shape)
    if signed_speeds.shape[1] == 1:
        return None
    rows = np.concatenate([np.tile(np.eye(3), (own.sum(), 1)), center[own].reshape(-1, 1)], axis=1)
    found = np.linalg.lstsq(rows, signed_speeds[own].ravel(), rcond=None)[0]
    missed = np.abs(rows @ found - signed_speeds[own].ravel()).max()
    return found[:3] + found[3] * center if missed <= SAME_STATE * np.abs(signed_speeds).max(initial=0.0) else None


@dataclass(frozen=True)
class Interface:
    """The lightest interface between two rigid domains of one sample: a minimum cut.

    Suppose that every sphere turned with the bottom or with the top; in a packing, with the first or the second driven
    body. Then all slip would be at the interface of the two domains, and the lightest interface would dissipate least.
    In 2D with Coulomb friction that is the minimum itself; in 3D, and for the viscous law, other states dissipate less
    (docs/equations.md, 5). The head of this file says what the objective is.

    power : energy/time, that the two rigid domains dissipate.
    contacts : (contacts E,) mask of the contacts that slip between them.
    above : mask over the spheres, in the shape of the lattice or (spheres N,): those that turn with the top or second
        body.
    between : mask of the same shape: spheres that may be on the other side of another interface that is equally light,
        or so nearly that rounding hides the difference. If there are none, every other interface is proven heavier.
    lower_bound : energy/time, proven, of lattices alone: no two rigid domains have a smaller objective.
    next_over : objective of the lightest other interface of which both domains are in one piece, divided by that of
        this one; NaN if it is not known, as in 3D and in packings.
    spins : spins of packings alone: radius * spin of the two rigid domains, (N, components C), length/time.
    """

    power: float
    contacts: np.ndarray
    above: np.ndarray
    between: np.ndarray
    lower_bound: float = np.nan
    next_over: float = np.nan
    spins: np.ndarray | None = None

    @property
    def unique(self) -> bool:
        """True if this interface has a power above 0 and every other one is proven to have a larger objective."""
        return self.power > 0 and not self.between.any()

    @classmethod
    def of(cls, bearing: Bearing) -> "Interface | None":
        """Return the lightest interface of a packing with one sample, between domains that rotate with either driven
        body.

        bearing : the packing.

        None if there are not two driven bodies in bearing states (spins at which no contact would slip), or if every
        contact between the domains has the weight 0. The weight is what a contact adds to the objective if it slips.
        """
        states = bearing_states(bearing)
        if states is None:
            return None
        sign, (low, high) = states
        known, needed = _needed_components(bearing)
        jump = ((high - low) * needed)[bearing.network.contact[0]]
        across = bearing.network.across(jump)
        across[across <= ACROSS * np.linalg.norm(jump, axis=1)] = 0.0  # (E,) slip of each contact on the interface
        material = tuple(values[0] for values in bearing.material)
        weight = bearing.law.objective(material, across)
        # nodes of the graph are free spheres and driven bodies, edges the contacts that can slip and have a weight
        node, taken = number_bodies(bearing.network.body), np.zeros(bearing.network.contacts, dtype=bool)
        ends = node[bearing.network.contact]
        taken[bearing.acting] = True
        taken &= (ends[0] != ends[1]) & (weight > 0)
        ends, weight = ends[:, taken], weight[taken]
        if not weight.sum() > 0:
            return None
        size = int(node.max()) + 1
        edges = np.append(ends, [[0], [size - 1]], axis=1)  # one more, without weight: both bodies are in the graph
        slack = _slack(bearing, np.flatnonzero(taken), across, states[1])
        found = graph_cut(edges, np.append(weight, 0.0), np.arange(size) > 0, STATE_ROUNDING, slack)
        above, between = found.above[node], found.between[node]
        cut = np.flatnonzero(taken)[found.above[ends[0]] != found.above[ends[1]]]
        contacts = np.zeros(bearing.network.contacts, dtype=bool)
        contacts[cut] = True
        power = bearing.law.power(tuple(of[cut] for of in material), across[cut])
        spins = np.where(needed, sign[:, None] * np.where(above[:, None], high, low), known)
        return cls(float(power.sum()), contacts, above, between, spins=spins)


def _needed_components(bearing: Bearing) -> tuple[np.ndarray, np.ndarray]:
    """Return surface speeds radius * spin that are known beforehand, (spheres N, components C), length/time, and a mask
    (C,) of the spin components that have to be solved for.

    A component need not be solved for if all free spheres can have values in it by which no contact slips. These values
    are the known speeds; driven spheres have their imposed ones. Such components are sought only if all contact normals
    lie along the axes.

    bearing : a lattice or a packing.
    """
    known, wanted, _ = bearing.network.needed(bearing.driven_speed, bearing.acting, bearing.network.free)
    return known, np.asarray(wanted.any(axis=0))


def _slack(bearing: Bearing, contact: np.ndarray, across: np.ndarray, states: np.ndarray) -> float:
    """Return a bound, energy/time, on the error of the sum of the weights of some contacts: the difference of the sums
    for slips that are larger and smaller by an error of the slip. The head of this file says what a weight is.

    bearing : a lattice or a packing.
    contact : (n,) numbers of the contacts.
    across : (contacts E,) slip of each contact if it is on the interface, length/time.
    states : (2, spheres N, components C), the two bearing states as sign * radius * spin, length/time.

    As the states are fitted to the imposed spins, a slip may be wrong by rounding and by the largest difference between
    a fitted state and an imposed spin. Four times their sum is taken as the error.
    """
    bodies, sign = bearing.network.bodies, bearing.network.sublattices[1]
    signed_speeds, largest = sign[:, None] * bearing.driven_speed, np.abs(states).max()
    missed = [
        np.abs(signed_speeds - state)[bearing.network.body == body].max()
        for state, body in zip(states, bodies, strict=True)
    ]
    error = 4 * (sum(missed) + STATE_ROUNDING * largest)
    material = tuple(values[0, contact] for values in bearing.material)
    low, high = (bearing.law.objective(material, np.maximum(across[contact] + by, 0.0)) for by in (-error, error))
    return float((high - low).sum())


def find_interface(bearing: Bearing, replica: int = 0) -> Interface | None:
    """Return the lightest interface between two rigid domains of one sample: the minimum cut, with the least objective.
    The result is None for packings without two driven bodies in bearing states; the two planes of a lattice always are
    in such states.

    bearing : a lattice or a packing.
    replica : number of the sample, from 0.
    """
    scene = bearing.sample(replica)
    if not isinstance(scene, Scene):
        return Interface.of(scene)
    weight, cut, unit = cut_weights(scene), cut_of(scene), cut_unit(scene)
    low, high = cut.above[0].ravel()[scene.lattice.ends]
    contacts = (low != high) & (weight[0] > 0) & (scene.jump > 0)  # without a jump nothing slips
    power = unit * float(cut.weight[0])
    if scene.law.minimises != "power":
        power = float(scene.law.power(scene.material, _interface_slips(scene))[0, contacts].sum())
    return Interface(
        power,
        contacts,
        cut.above[0],
        cut.between[0],
        unit * float(cut.lower_bound[0]) * (1 - WEIGHT_ROUNDING),
        float(cut.next_weight[0] / cut.weight[0]) if cut.weight[0] > 0 else np.nan,
    )


def _interface_slips(scene: Scene) -> np.ndarray:
    """Return the slip (1, contacts E), length/time, that each contact of a lattice has if one of its spheres rolls with
    the bottom and the other with the top.

    scene : the lattice, with what is imposed on its planes.

    It is computed from the difference of the two imposed states: laboratory spins would lose its digits where it is
    small.
    """
    axes = scene.minimum_spin_axes
    jump = scene.top_spin(axes).reshape(len(axes), -1)[:, scene.lattice.column]
    return scene.lattice.radius * vector_length(np.where(scene.lattice.tangential_mask(axes), jump, 0.0))[None]


def cut_of(scene: Scene) -> MinimumCut:
    """Return the minimum cuts of all samples of a lattice: the lightest interfaces between a domain that rolls with the
    bottom and one that rolls with the top. Weights times :func:`cut_unit` are energy/time. If weights are rounded, or
    an axis is periodic, spheres that may lie on either side of a lightest cut are looked for with exact weights.

    scene : the lattice with its R samples.
    """
    weight, rounding = scene.lattice.by_axis(cut_weights(scene)), cut_rounding(scene)
    cut = minimum_cut(weight, rounding)
    return with_exact_ties(cut, weight, rounding) if rounding or scene.periodic else cut


def cut_rounding(scene: Scene) -> float:
    """Return the relative rounding error of the weights that :func:`cut_weights` gives contacts of a lattice.

    scene : the lattice, with its law.

    It is 0 for discs with friction or viscosity alone, as the weight then is the coefficient.
    """
    is_coefficient = scene.lattice.dimension == 2 and scene.law.is_sum and len(scene.law.quantities) == 1
    return 0.0 if is_coefficient else WEIGHT_ROUNDING


def _cut_speed(scene: Scene) -> float:
    """Return the unit, 1/time, of the spin differences from which the weights of contacts in a cut are computed.

    scene : the lattice, with what is imposed on its planes.

    For discs it is the difference between top and bottom itself, if that is not 0; else a number near it.
    """
    if scene.lattice.dimension == 2 and scene.jump:
        return scene.jump
    return float(scene.driving.unit[0][0])


def cut_weights(scene: Scene) -> np.ndarray:
    """Return the weight (samples R, contacts E) of each contact of a lattice: what the contact adds to the objective if
    one of its spheres rolls with the bottom and the other with the top. Weights are in units of :func:`cut_unit`.

    scene : the lattice with its R samples of E contacts.

    Such a contact slips by r |J x n|, with r the radius, n its axis, and J the jump at its place (head of this file),
    without the component along the height. :func:`cut_rounding` bounds the rounding errors of the weights.
    """
    if not scene.law.is_sum:
        return scene.law.objective(scene.material, _interface_slips(scene)) / cut_unit(scene)
    # friction, viscosity and their sum: slips in units of r * unit and coefficients in units that fit, so that for
    # friction or viscosity alone in 2D the weight is the coefficient itself, without rounding
    unit = _cut_speed(scene)
    units = (1.0, scene.lattice.radius * unit / scene.normal_force)
    coefficients = tuple(unit * values for unit, values in zip(units, scene.named_coefficients.values(), strict=False))
    axes = scene.minimum_spin_axes
    jump = scene.driving.top_in_units(axes)[0].reshape(len(axes), -1)[:, scene.lattice.column]
    if scene.lattice.dimension == 2:
        jump = np.where(jump != 0, 1.0, 0.0)
    across = vector_length(np.where(scene.lattice.tangential_mask(axes), jump, 0.0))
    return scene.law.objective(coefficients, across)


def cut_unit(scene: Scene) -> float:
    """Return the factor that turns the weights of contacts in a cut into the objective, energy/time. The weights are
    pure numbers for laws with friction, and in force * time/length for viscosity alone.

    scene : the lattice, with its law and what is imposed on its planes.

    With w the unit of spin differences, 1/time, and r the radius it is `scene.strength` * r w with friction, and (r
    w)^2 without.
    """
    speed = scene.lattice.radius * _cut_speed(scene)
    return scene.strength * (speed if scene.law.has_friction else speed**2)


def spins_of_two_domains(bearing: Bearing) -> np.ndarray | None:
    """Return the spins of the two rigid domains at the lightest interface of each sample, as solvers store them:
    (components C, samples R, spheres *N). The result is None if some sample has no such interface.

    bearing : a lattice or a packing, with its R samples. The C components are its `minimum_spin_axes`. On lattices
        solvers store spins with signs that alternate between neighbours, less those of the bottom, 1/time; in packings
        radius * spin, length/time.
    """
    if isinstance(bearing, Scene):
        return np.where(cut_of(bearing).above, bearing.top_spin(bearing.minimum_spin_axes)[:, None, ..., None], 0.0)
    cuts = [Interface.of(bearing.sample(number)) for number in range(bearing.replicas)]
    spins = [cut.spins.T for cut in cuts if cut is not None and cut.spins is not None]
    return np.stack(spins, axis=1) if len(spins) == len(cuts) else None
