"""The lightest interface of two rigid domains, and how it is found in a packing, with the spins of its two sides.

Where the network has no odd loops and two driven bodies, each in a bearing state s u = A + c x of its own, a contact on
the interface slips with their jump across its normal. Where normals lie along the axes, components of spins that can be
the same everywhere are not needed, and the jump has none of them: of a cubic lattice that along its height.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.numerics.exact_cuts import with_exact_ties
from taichi_bearings.numerics.minimum_cut import WEIGHT_ROUNDING, MinimumCut, graph_cut, minimum_cut, number_bodies
from taichi_bearings.scene.bearing import Bearing, vector_length
from taichi_bearings.scene.scene import Scene, of_lattice

SAME_STATE = 1e-9  # of the largest R omega, by which spins may miss a bearing state
ACROSS = 1e-12  # of the jump, what rounding leaves of it across a normal along it
STATE_ROUNDING = 2.0**-48  # of R omega: a dozen roundings of 2^-53 each


def bearing_states(bearing: Bearing) -> tuple[np.ndarray, np.ndarray] | None:
    """Signs (N,) by which neighbours differ, and s u (2, N, C) of all spheres if they turned with the first or with the
    second of two driven bodies in bearing states; None where it has odd loops, or others, or where a state slips at a
    contact, as across a periodic side."""
    (odd, sign), bodies = bearing.network.sublattices, bearing.network.bodies
    if odd.any() or len(bodies) != 2:
        return None
    turned = sign[:, None] * bearing.driven_speed
    low, high = (_state(bearing.network.center, turned, bearing.network.body == body) for body in bodies)
    if low is None or high is None:
        return None
    for state in (low, high):
        contact = bearing.acting
        first, second = bearing.network.contact[:, contact]
        missed = bearing.network.across(state[second] - state[first], contact)
        if missed.max(initial=0.0) > SAME_STATE * np.abs(state).max(initial=0.0):
            return None
    return sign, np.stack([low, high])


def _state(center: np.ndarray, turned: np.ndarray, own: np.ndarray) -> np.ndarray | None:
    """A + c x, (N, C), of the bearing state that these spheres have, with c = 0 where that does; None if none."""
    value = turned[own][0]
    if (turned[own] == value).all():
        return np.broadcast_to(value, turned.shape)
    if turned.shape[1] == 1:
        return None
    rows = np.concatenate([np.tile(np.eye(3), (own.sum(), 1)), center[own].reshape(-1, 1)], axis=1)
    found = np.linalg.lstsq(rows, turned[own].ravel(), rcond=None)[0]
    missed = np.abs(rows @ found - turned[own].ravel()).max()
    return found[:3] + found[3] * center if missed <= SAME_STATE * np.abs(turned).max(initial=0.0) else None


@dataclass(frozen=True)
class Interface:
    """The lightest interface of two rigid domains of one sample: a minimum cut.

    If every sphere turned with the bottom or with the top, of a packing with the first or with the second body, all
    slip would be at the interface of the two domains, and the lightest one would dissipate least. In 2D with Coulomb
    friction that is the minimum itself; in 3D, and for the viscous law, states between the two dissipate less
    (equations.md, 5).

    power : energy/time, if the two domains are rigid. contacts : (E,) True for those that slip.
    above : N, True for the spheres that turn with the top or the second body.
    between : N, True for the spheres that another cut that is as light, or to rounding, may put on the other side; if
        there are none every other interface is proven to dissipate more.
    lower_bound : of a lattice: no two rigid domains dissipate less, or have less of what the stationary state minimises
        if that is not the power; proven.
    next_power : the same of the cheapest other interface that leaves either domain in one piece; NaN in 3D and of
        packings, where it is not known (see :func:`taichi_bearings.numerics.minimum_cut.next_cut`).
    spins : of a packing, u (N, C) of the two rigid domains.
    """

    power: float
    contacts: np.ndarray
    above: np.ndarray
    between: np.ndarray
    lower_bound: float = np.nan
    next_power: float = np.nan
    spins: Any = None

    @property
    def unique(self) -> bool:
        """Every other one is proven to be heavier."""
        return self.power > 0 and not self.between.any()

    @classmethod
    def of(cls, bearing: Bearing) -> "Interface | None":
        """Of the least power, or what else the stationary state minimises; None without two bearing states."""
        states = bearing_states(bearing)
        if states is None:
            return None
        sign, (low, high) = states
        known, needed = _needed_components(bearing)
        jump = ((high - low) * needed)[bearing.network.contact[0]]
        across = bearing.network.across(jump)
        across[across <= ACROSS * np.linalg.norm(jump, axis=1)] = 0.0
        material = tuple(values[0] for values in bearing.material)
        weight = bearing.law.objective(material, across)
        node, taken = number_bodies(bearing.network.body), np.zeros(bearing.network.contacts, dtype=bool)
        ends = node[bearing.network.contact]
        taken[bearing.acting] = True
        taken &= (ends[0] != ends[1]) & (weight > 0)
        ends, weight = ends[:, taken], weight[taken]
        if not weight.sum() > 0:
            return None
        size = int(node.max()) + 1
        edges = np.append(ends, [[0], [size - 1]], axis=1)  # one of no weight, so that both ends are there
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
    """Spins u (N, C) at which the components that are not needed slip nowhere; and (C,) True for those that are needed:
    all but those that can turn without any slip where normals lie along the axes."""
    known, wanted, _ = bearing.network.needed(bearing.driven_speed, bearing.acting, bearing.network.free)
    return known, np.asarray(wanted.any(axis=0))


def _slack(bearing: Bearing, contact: np.ndarray, across: np.ndarray, states: np.ndarray) -> float:
    """What the weights of contacts (n,) may differ in all from those of the bearing states that are meant: these
    (2, N, C) are known from spins to rounding, or to what these miss a state by. across : (E,) of the jump."""
    bodies, sign = bearing.network.bodies, bearing.network.sublattices[1]
    turned, largest = sign[:, None] * bearing.driven_speed, np.abs(states).max()
    missed = [
        np.abs(turned - state)[bearing.network.body == body].max() for state, body in zip(states, bodies, strict=True)
    ]
    off = 4 * (sum(missed) + STATE_ROUNDING * largest)
    of = tuple(values[0, contact] for values in bearing.material)
    near, far = (bearing.law.objective(of, np.maximum(across[contact] + by, 0.0)) for by in (-off, off))
    return float((far - near).sum())


def find_interface(bearing: Bearing, replica: int = 0) -> Interface | None:
    """The cheapest interface of one sample: of the least power, or what else the stationary state minimises; None where
    there are no two bearing states, as there are in every lattice.

    replica : number of the sample.
    """
    bearing = bearing.sample(replica)
    if bearing.network.lattice is None:
        return Interface.of(bearing)
    scene = of_lattice(bearing)
    weight, cut, unit = cut_weights(scene), cut_of(scene), cut_unit(scene)
    low, high = cut.above[0].ravel()[scene.lattice.ends]
    contacts = (low != high) & (weight[0] > 0) & (scene.jump > 0)  # without a jump nothing slips
    power = unit * float(cut.weight[0])
    if scene.law.minimises != "power":
        power = float(scene.law.power(scene.material, _interface_slips(scene)[None])[0, contacts].sum())
    return Interface(
        power,
        contacts,
        cut.above[0],
        cut.between[0],
        unit * float(cut.lower_bound[0]) * (1 - WEIGHT_ROUNDING),
        unit * float(cut.next_weight[0]),
    )


def _interface_slips(scene: Scene) -> np.ndarray:
    """(E,) slips of contacts on an interface of two rigid domains, length/time; of the jump itself, as spins in the
    laboratory lose the digits of a jump that is small beside them."""
    axes = scene.minimum_spin_axes
    jump = scene.top_spin(axes).reshape(len(axes), -1)[:, scene.lattice.column]
    return scene.lattice.radius * vector_length(np.where(scene.lattice.tangential_mask(axes), jump, 0.0))


def cut_of(scene: Scene) -> MinimumCut:
    """The lightest interface between spheres that turn with the bottom and spheres that turn with the top."""
    weight, rounding = scene.lattice.by_axis(cut_weights(scene)), cut_rounding(scene)
    cut = minimum_cut(weight, rounding)
    return with_exact_ties(cut, weight, rounding) if rounding or scene.periodic else cut


def cut_rounding(scene: Scene) -> float:
    """Share by which the weights of :func:`cut_weights` may miss the exact ones; 0 of discs with one coefficient, which
    is the weight."""
    return 0.0 if scene.lattice.dimension == 2 and len(scene.law.quantities) == 1 else WEIGHT_ROUNDING


def _cut_speed(scene: Scene) -> float:
    """Unit of the jump, 1/time: of discs the jump itself, if there is one."""
    if scene.lattice.dimension == 2 and scene.jump:
        return scene.jump
    return float(scene.driving.unit[0][0])


def cut_weights(scene: Scene) -> np.ndarray:
    """Share of each contact in the objective of such an interface, over :func:`cut_unit`; (R, E).

    A contact of the interface slips by R |J x n|, J the jump of the imposed states at its place and n its axis. Of J
    only the components that a minimum needs count: the one along the height can change from bottom to top layer by
    layer, where no contact feels it. Viscous contacts weigh by the square of their slip, and viscosities beside a
    friction by their share in it. How far rounding takes them from the exact ones says :func:`cut_rounding`.
    """
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
    """Objective of an interface over its weight: strength * R unit with friction, else (R unit)^2; energy/time."""
    speed = scene.lattice.radius * _cut_speed(scene)
    return scene.strength * (speed if scene.law.holds else speed**2)


def spins_of_two_domains(bearing: Bearing) -> np.ndarray | None:
    """Carried spins (C, R, *N), in the components that a minimum needs, of the two rigid domains beside the lightest
    interface of each sample; None where there are no two bearing states."""
    if bearing.network.lattice is not None:
        scene = of_lattice(bearing)
        return np.where(cut_of(scene).above, scene.top_spin(scene.minimum_spin_axes)[:, None, ..., None], 0.0)
    cuts = [Interface.of(bearing.sample(number)) for number in range(bearing.replicas)]
    spins = [cut.spins.T for cut in cuts if cut is not None]
    return np.stack(spins, axis=1) if len(spins) == len(cuts) else None
