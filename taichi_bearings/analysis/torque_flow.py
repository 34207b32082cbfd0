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

from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.lattice import Lattice
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
