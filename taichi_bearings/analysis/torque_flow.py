"""How the driving torque goes from the top to the bottom plane, and how close the slipless contacts are to slipping.

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
saturations and distributions, are one admissible choice: that of the method.

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

    through_gap, slipless, slipping : (C, H - 1), force * length: the torque through the vertical contacts of a gap, and
        the parts of those in each state.
    power : that the driven planes spend, energy/time; for certifying forces of the Coulomb law a lower bound.
    slipless_power : the part of it that goes through slipless contacts, mean over the gaps.
    """

    through_gap: np.ndarray
    slipless: np.ndarray
    slipping: np.ndarray
    power: float
    slipless_power: float

    @property
    def total(self) -> np.ndarray:
        """(C,) torque that drives the top plane, and that holds the bottom plane, force * length."""
        return np.asarray(self.through_gap.mean(axis=1))

    @property
    def deviation(self) -> float:
        """Largest difference between a gap and the mean, relative to the largest total: 0 but for rounding."""
        largest = float(np.abs(self.total).max())
        difference = float(np.abs(self.through_gap - self.total[:, None]).max())
        return difference / largest if largest > 0 else difference

    @property
    def slipless_share(self) -> float:
        """Share of the power that goes through slipless contacts, mean over the gaps; 0 without power."""
        return self.slipless_power / self.power if self.power != 0 else 0.0


def torque_flow(lattice: Lattice, force: np.ndarray, state: np.ndarray, jump: np.ndarray) -> TorqueFlow:
    """The flow of torque through a sample. jump : (C, *plane), of the top above the bottom, 1/time."""
    upright = lattice.by_axis(lattice.radius * force)[-1]
    torque = upright.reshape(len(force), -1, upright.shape[-1])  # the same for all columns of spheres
    kind = lattice.by_axis(state)[-1].reshape(torque.shape[1:])
    slipless, slipping = (np.where(chosen, torque, 0.0) for chosen in _kinds(kind)[:2])
    power, unmoved = (float((of * jump.reshape(len(force), -1, 1)).sum()) / of.shape[-1] for of in (torque, slipless))
    return TorqueFlow(torque.sum(axis=1), slipless.sum(axis=1), slipping.sum(axis=1), power, unmoved)


@dataclass(frozen=True)
class Counted:
    """One number a bin, (B,), of the slipless contacts, the slipping ones and all; edges : (B + 1,) of the bins."""

    edges: np.ndarray
    slipless: np.ndarray
    slipping: np.ndarray
    every: np.ndarray


@dataclass(frozen=True)
class FrictionLoad:
    """Saturation |f| / (mu F_n) of the contacts: 0 unloaded, 1 at the limit of friction.

    saturation : (S,), of every slipless contact, rising. counted : contacts by saturation, in even bins from 0 to 1;
    rounding above 1 counts as 1.
    """

    saturation: np.ndarray
    counted: Counted

    @property
    def mean(self) -> float:
        """Mean saturation of the slipless contacts; NaN if there are none."""
        return float(self.saturation.mean()) if len(self.saturation) else np.nan

    @property
    def margin(self) -> float:
        """Safety margin: share of its friction limit that the most loaded slipless contact has left."""
        return 1.0 - float(self.saturation.max(initial=0.0))

    def within(self, margin: float) -> int:
        """Number of slipless contacts with no more than this margin left."""
        return int((self.saturation >= 1.0 - margin).sum())


def friction_load(force: np.ndarray, limit: np.ndarray, state: np.ndarray, bins: int = 50) -> FrictionLoad:
    """How close to slipping the contacts are (Coulomb law). limit : mu F_n, (E,); where it is 0 nothing is loaded."""
    size = vector_length(force)
    ratio = np.divide(size, limit, out=np.zeros_like(size), where=limit > 0)
    edges = np.linspace(0.0, 1.0, bins + 1)
    counted = (np.histogram(np.minimum(ratio[kind], 1.0), edges)[0] for kind in _kinds(state))
    return FrictionLoad(np.sort(ratio[state == ContactState.SLIPLESS]), Counted(edges, *counted))


def force_distribution(force: np.ndarray, state: np.ndarray, width: float = 0.1) -> Counted:
    """Probability density P(f / <f>) of the sizes of the contact forces, <f> being the mean of each population itself;
    0 where there are no contacts. width : of the bins from 0, in means."""
    groups = [vector_length(force)[kind] for kind in _kinds(state)]
    means = [float(values.mean()) if len(values) else 0.0 for values in groups]
    scaled = [values / mean if mean > 0 else values[:0] for values, mean in zip(groups, means, strict=True)]
    longest = max(float(values.max(initial=0.0)) for values in scaled)
    edges = width * np.arange(max(1, int(np.ceil(longest / width))) + 1)
    edges[-1] = max(edges[-1], longest)
    density = (np.histogram(values, edges)[0] / (max(len(values), 1) * np.diff(edges)) for values in scaled)
    return Counted(edges, *density)


def _kinds(state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contacts (E,) that are slipless, that slip, and all that can."""
    return state == ContactState.SLIPLESS, state == ContactState.SLIPPING, state != ContactState.DRIVEN


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
