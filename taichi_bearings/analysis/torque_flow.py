"""How the driving torque goes from the top to the bottom plane, and what friction the slipless contacts bear.

In staggered spins the component k of the torque is a current: a contact that is not along k carries R f_k from its
upper to its lower sphere, no free sphere stores any of it, and it enters at the top plane and leaves at the bottom. So
the same torque T_k goes through every gap between two layers, along its vertical contacts, and the driven planes spend
the power sum_k T_k (Omega_top - Omega_bottom)_k. Contacts within a layer only spread it. On a cubic lattice the current
of component k even stays within each plane normal to k, because contacts along k do not carry it.

**What is unique** (Coulomb law, at the minimum). The friction of a slipping contact is mu F_n along the slip, the same
for all balanced and admissible forces that prove the minimum. T_k is unique if top and bottom differ in component k:
spheres with Omega_k above and below some level are parted by a surface through which all contacts that carry k slip. So
is what the slipless contacts carry of a gap as a whole. The force of a single slipless contact is not, as long as there
are loops of slipless contacts around which torque can circulate: states of self-stress, as in frames (Pellegrino and
Calladine, Int. J. Solids Struct. 22, 1986) and in packings of grains with friction. Then these forces, and with them
saturations, are one admissible choice: that of the method.

All arrays are of one sample. Forces are staggered, (C, E) (lattice/grid.py); states are values of ContactState, (E,).
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, laplacian
from scipy.sparse.linalg import spsolve

from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.lattice import Lattice
from taichi_bearings.packing import Packing
from taichi_bearings.packing.interface import bearing_states
from taichi_bearings.packing.system import acting
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene.scene import vector_length


@dataclass(frozen=True)
class TorqueFlow:
    """Torque that goes from the top to the bottom plane: C components, H - 1 gaps between layers.

    through_gap, slipless : (C, H - 1), force * length: the torque through the vertical contacts of a gap, and the part
        of those that are slipless.
    power : that the driven planes spend, energy/time; for certifying forces of the Coulomb law a lower bound.
    slipless_power : the part of it that goes through slipless contacts, mean over the gaps.
    """

    through_gap: np.ndarray
    slipless: np.ndarray
    power: float
    slipless_power: float

    @property
    def total(self) -> np.ndarray:
        """(C,) torque that drives the top plane, and that holds the bottom plane, force * length."""
        return np.asarray(self.through_gap.mean(axis=1))

    @property
    def slipless_share(self) -> float:
        """Share of the power that goes through slipless contacts, mean over the gaps; 0 without power."""
        return self.slipless_power / self.power if self.power != 0 else 0.0


def torque_flow(lattice: Lattice, force: np.ndarray, state: np.ndarray, jump: np.ndarray) -> TorqueFlow:
    """The flow of torque through a sample. jump : (C, *plane), of the top above the bottom, 1/time."""
    upright = lattice.by_axis(lattice.radius * force)[-1]
    torque = upright.reshape(len(force), -1, upright.shape[-1])  # the same for all columns of spheres
    kind = lattice.by_axis(state)[-1].reshape(torque.shape[1:])
    slipless = np.where(kind == ContactState.SLIPLESS, torque, 0.0)
    power, unmoved = (float((of * jump.reshape(len(force), -1, 1)).sum()) / of.shape[-1] for of in (torque, slipless))
    return TorqueFlow(torque.sum(axis=1), slipless.sum(axis=1), power, unmoved)


@dataclass(frozen=True)
class PackingFlow:
    """total : torque, signs of a sublattice taken away, that drives the second of two bodies, by component (C,); with
    fewer or more that of each, (bodies, C); force * length. power : that each body spends, (bodies,), energy/time.
    slipless_share : of the power from the first of two bodies to the second what slipless contacts carry, None where
    these are in no bearing states of their own; 0 without power.
    """

    total: np.ndarray
    power: np.ndarray
    slipless_share: float | None


def flow_through(
    packing: Packing, node: np.ndarray, sign: np.ndarray, pull: np.ndarray, slipless: np.ndarray
) -> PackingFlow:
    """node : (N,) of each sphere, a body being one. sign : (N,) of the sublattice. pull : (E, C) of each contact on
    R omega of both its ends; force, 0 between driven spheres. slipless : (E,).

    s pull is a current of each component, from one end of a contact to the other, as T_k of lattices, and layers are
    those of a height that is 0 on the first body, 1 on the second and in between the mean of that of the neighbours.
    """
    held, (first, second) = np.flatnonzero(packing.driven >= 0), packing.contact.T
    drive = np.zeros(packing.imposed.shape)
    for end in (first, second):
        np.add.at(drive, end, pull)
    bodies, body = np.unique(packing.driven[held], return_inverse=True)
    total, spent = np.zeros((len(bodies), pull.shape[1])), (drive * packing.imposed).sum(axis=1)
    np.add.at(total, body, (sign * packing.radius)[held, None] * drive[held])
    power, states, share = np.bincount(body, spent[held], len(bodies)), bearing_states(packing), None
    if states is not None:
        height = _height(node, node[packing.contact[acting(packing)]].T)
        fall = (sign[first] * (height[first] - height[second]))[:, None] * (states[1][1] - states[1][0])[first]
        carried = (pull * fall).sum(axis=1)
        share = float(carried[slipless].sum() / carried.sum()) if carried.sum() else 0.0
    return PackingFlow(total[-1] if len(bodies) == 2 else total, power, share)


def _height(node: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(N,) 0 at node 0, 1 at the last node, elsewhere the mean of the neighbours; 0 where these two do not reach."""
    size = int(node.max()) + 1
    ones = np.ones(ends.shape[1])
    graph = csr_array((np.tile(ones, 2), np.append(ends, ends[::-1], axis=1)), shape=(size, size))
    label = connected_components(graph, directed=False)[1]
    inside = np.flatnonzero(np.isin(label, label[[0, -1]])[1:-1]) + 1
    matrix, height = (laplacian(graph))[inside], np.zeros(size)
    height[-1] = 1.0
    if len(inside):
        height[inside] = spsolve(matrix[:, inside].tocsc(), -matrix[:, [-1]].toarray()[:, 0])
    return height[node]


def saturation(force: np.ndarray, limit: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Share |f| / (mu F_n) of its friction limit (Coulomb law) that each slipless contact bears, (S,): 0 unloaded, 1 at
    the limit. limit : mu F_n, (E,); where it is 0 nothing is loaded."""
    size = vector_length(force)
    ratio = np.divide(size, limit, out=np.zeros_like(size), where=limit > 0)
    return np.asarray(ratio[state == ContactState.SLIPLESS])


def self_stress(network: SliplessNetwork, spin_axes: tuple[int, ...]) -> np.ndarray:
    """(C,) states of self-stress: independent loops of slipless contacts around which a component can circulate.

    With the forces of slipping contacts and the total torque of each component given, balance is one equation for each
    body of a connected piece, one of them a consequence of the others, and one unknown for each slipless contact. So
    the sum is the number of free parameters of the forces while nothing is at its limit of friction.
    """
    states = []
    for component in spin_axes:
        carries = network.axis != component
        joined = np.unique(network.body[network.ends[:, carries]])
        domains = np.unique(network.pieces(carries)[joined])
        states.append(int(carries.sum()) - (len(joined) - len(domains)))
    return np.array(states)
