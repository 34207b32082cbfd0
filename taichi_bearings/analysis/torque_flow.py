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
saturations, distributions and participation, are one admissible choice: that of the method.

All arrays are of one sample. Forces are staggered, (C, E) (lattice/grid.py).
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components

from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import tangential
from taichi_bearings.lattice.incidence import torques
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene.scene import vector_length

STRONGEST = 0.1  # share of the contacts of a gap that counts as its strongest


@dataclass(frozen=True)
class TorqueFlow:
    """Torque that goes from the top to the bottom plane: C components as named by spin_axes, H - 1 gaps between layers.

    through_gap, slipless, slipping, undecided : (C, H - 1), force * length: the torque through the vertical contacts of
        a gap, and the parts of those in each state.
    through_plane : one array (n,) a component, force * length: the part of the total in each of the n planes normal to
        it, or all of it in 2D.
    sideways : (C, H), force * length: sum of |torque| over the contacts within each layer, driven planes left out.
    participation : (C, H - 1), (sum |t|)^2 / (N sum t^2) over the N vertical contacts of a gap: 1 if all carry alike,
        1 / N if one carries all.
    strongest : (C, H - 1), share of sum |t| that the strongest tenth of these contacts (one at least) carries.
    backwards : (C, H - 1), share of sum |t| that goes against the flow.
    left_over : (C,), largest torque that is left on a free sphere, force * length.
    power : that the driven planes spend, energy/time; for certifying forces of the Coulomb law a lower bound.
    slipless_power : the part of it that goes through slipless contacts, mean over the gaps.
    """

    spin_axes: tuple[int, ...]
    through_gap: np.ndarray
    slipless: np.ndarray
    slipping: np.ndarray
    undecided: np.ndarray
    through_plane: tuple[np.ndarray, ...]
    sideways: np.ndarray
    participation: np.ndarray
    strongest: np.ndarray
    backwards: np.ndarray
    left_over: np.ndarray
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


def torque_flow(
    lattice: Lattice, spin_axes: tuple[int, ...], force: np.ndarray, state: np.ndarray, jump: np.ndarray
) -> TorqueFlow:
    """The flow of torque through a sample.

    force : (C, E). state : values of ContactState, (E,). jump : (C, *plane), of the top above the bottom, 1/time.
    """
    height = lattice.height_axis
    gaps, components = lattice.shape[-1] - 1, len(spin_axes)
    flow = np.zeros((components, int(np.prod(lattice.shape[:-1])), gaps))
    sideways = np.zeros((components, gaps + 1))
    for axis, vectors in enumerate(lattice.by_axis(force)):
        for slot in tangential(axis, spin_axes):
            torque = (lattice.radius * vectors[slot]).reshape(-1, vectors.shape[-1])
            if axis == height:
                flow[slot] = torque
            else:
                sideways[slot] += np.abs(torque).sum(axis=0)
    sideways[:, [0, -1]] = 0.0
    kind = lattice.by_axis(state)[height].reshape(flow.shape[1:])
    slipless, slipping = (
        np.where(kind == which, flow, 0.0).sum(axis=1) for which in (ContactState.SLIPLESS, ContactState.SLIPPING)
    )
    through_gap, size = flow.sum(axis=1), np.abs(flow)
    spent = flow * jump.reshape(components, -1, 1)
    unmoved = np.where(kind == ContactState.SLIPLESS, spent, 0.0)
    sizes, squares = size.sum(axis=1), (flow**2).sum(axis=1)
    strong = max(1, round(STRONGEST * flow.shape[1]))
    most = np.sort(size, axis=1)[:, -strong:].sum(axis=1)
    against = (sizes - np.abs(through_gap)) / 2
    pull = torques(force[:, None], lattice, spin_axes)[:, 0, ..., 1:-1]
    return TorqueFlow(
        spin_axes=spin_axes,
        through_gap=through_gap,
        slipless=slipless,
        slipping=slipping,
        undecided=through_gap - slipless - slipping,
        through_plane=tuple(_by_plane(flow[n], lattice, k) for n, k in enumerate(spin_axes)),
        sideways=sideways,
        participation=_ratio(sizes**2, flow.shape[1] * squares),
        strongest=_ratio(most, sizes),
        backwards=_ratio(against, sizes),
        left_over=lattice.radius * np.abs(pull).reshape(components, -1).max(axis=1),
        power=float(spent.sum()) / gaps,
        slipless_power=float(unmoved.sum()) / gaps,
    )


def _by_plane(flow: np.ndarray, lattice: Lattice, component: int) -> np.ndarray:
    """Torque through each plane normal to the component, mean over the gaps. flow : (columns, H - 1)."""
    columns = flow.mean(axis=1).reshape(lattice.shape[:-1])
    if component >= lattice.height_axis:  # 2D, or about the height, which vertical contacts do not carry
        return np.array([columns.sum()])
    return np.asarray(columns.sum(axis=1 - component))


@dataclass(frozen=True)
class PlaneFlow:
    """The current of one component in one plane, a grid of m columns and H layers on its own.

    component : of the staggered spin. normal, index : axis and position of the plane; None and 0 in 2D.
    sideways, upright : (m - 1, H) and (m, H - 1), torque through the contacts within and between the layers, positive
        to the left and downwards, force * length.
    sideways_state, upright_state : values of ContactState.
    """

    component: int
    normal: int | None
    index: int
    sideways: np.ndarray
    upright: np.ndarray
    sideways_state: np.ndarray
    upright_state: np.ndarray


def plane_flow(
    lattice: Lattice,
    spin_axes: tuple[int, ...],
    force: np.ndarray,
    state: np.ndarray,
    component: int,
    index: int | None = None,
) -> PlaneFlow:
    """The current in the plane number `index` normal to a horizontal component; by default the middle one."""
    height = lattice.height_axis
    (side,) = (axis for axis in range(height) if axis != component)
    place = lattice.shape[component] // 2 if index is None and lattice.dimension == 3 else index or 0
    found = []
    torque = lattice.by_axis(lattice.radius * force[spin_axes.index(component)])
    states = lattice.by_axis(state)
    for axis in (side, height):
        for values in (torque[axis], states[axis]):
            found.append(np.take(values, place, axis=component) if lattice.dimension == 3 else values)
    normal = component if lattice.dimension == 3 else None
    return PlaneFlow(component, normal, place, found[0], found[2], found[1], found[3])


@dataclass(frozen=True)
class FrictionLoad:
    """Saturation |f| / (mu F_n) of the contacts: 0 unloaded, 1 at the limit of friction.

    edges : (B + 1,), 0 ... 1. slipless, slipping : (B,), contacts a bin; rounding above 1 counts as 1.
    saturation : (S,), of every slipless contact, rising.
    loaded_axis, loaded_contact, loaded_saturation : (L,), (L, dimension), (L,): axis, lower sphere and saturation of
        the most loaded slipless contacts, the closest to slipping first.
    """

    edges: np.ndarray
    slipless: np.ndarray
    slipping: np.ndarray
    saturation: np.ndarray
    loaded_axis: np.ndarray
    loaded_contact: np.ndarray
    loaded_saturation: np.ndarray

    @property
    def mean(self) -> float:
        """Mean saturation of the slipless contacts; NaN if there are none."""
        return float(self.saturation.mean()) if len(self.saturation) else np.nan

    @property
    def margin(self) -> float:
        """Safety margin: share of its friction limit that the most loaded slipless contact has left."""
        return 1.0 - float(self.saturation[-1]) if len(self.saturation) else 1.0

    def quantiles(self, shares: np.ndarray) -> np.ndarray:
        """Saturation that these shares of the slipless contacts do not exceed; NaN if there are none."""
        return np.quantile(self.saturation, shares) if len(self.saturation) else np.full(np.shape(shares), np.nan)

    def within(self, margin: float) -> int:
        """Number of slipless contacts with no more than this margin left."""
        return len(self.saturation) - int(np.searchsorted(self.saturation, 1.0 - margin))


def friction_load(
    lattice: Lattice, force: np.ndarray, limit: np.ndarray, state: np.ndarray, bins: int = 50, listed: int = 20
) -> FrictionLoad:
    """How close to slipping the contacts are (Coulomb law).

    force : (C, E). limit : mu F_n, (E,). state : (E,). bins : of the histograms, evenly spaced. listed : most loaded
    contacts to name.
    """
    size = vector_length(force)
    ratio = np.divide(size, limit, out=np.zeros_like(size), where=limit > 0)
    slipless = state == ContactState.SLIPLESS
    still, moving = ratio[slipless], ratio[state == ContactState.SLIPPING]
    edges = np.linspace(0.0, 1.0, bins + 1)
    first = np.argsort(-still, kind="stable")[:listed]
    loaded = np.flatnonzero(slipless)[first]
    return FrictionLoad(
        edges=edges,
        slipless=np.histogram(np.minimum(still, 1.0), edges)[0],
        slipping=np.histogram(np.minimum(moving, 1.0), edges)[0],
        saturation=np.sort(still),
        loaded_axis=lattice.axis[loaded],
        loaded_contact=np.stack(np.unravel_index(lattice.ends[0, loaded], lattice.shape), axis=1),
        loaded_saturation=still[first],
    )


@dataclass(frozen=True)
class ForceDistribution:
    """Probability density P(f / <f>) of the size of the contact forces, <f> being the mean of each population itself.

    edges : (B + 1,), evenly spaced from 0. density : (B,) each, 0 where there are no contacts. mean : force.
    """

    edges: np.ndarray
    slipless: np.ndarray
    slipping: np.ndarray
    every: np.ndarray
    mean_slipless: float
    mean_slipping: float
    mean_every: float


def force_distribution(force: np.ndarray, state: np.ndarray, width: float = 0.1) -> ForceDistribution:
    """Distribution of the sizes of the contact forces. width : of the bins, in means."""
    size = vector_length(force)
    kinds = (state == ContactState.SLIPLESS, state == ContactState.SLIPPING, state != ContactState.DRIVEN)
    groups = [size[chosen] for chosen in kinds]
    means = [float(values.mean()) if len(values) else 0.0 for values in groups]
    scaled = [values / mean if mean > 0 else values[:0] for values, mean in zip(groups, means, strict=True)]
    longest = max(float(values.max(initial=0.0)) for values in scaled)
    edges = width * np.arange(max(1, int(np.ceil(longest / width))) + 1)
    edges[-1] = max(edges[-1], longest)
    densities = [np.histogram(values, edges)[0] / (max(len(values), 1) * np.diff(edges)) for values in scaled]
    return ForceDistribution(edges, *densities, *means)


@dataclass(frozen=True)
class SelfStress:
    """How far the balance of torques leaves the forces of slipless contacts open: C components as named by spin_axes.

    contacts : (C,), slipless contacts that carry the component. bodies, domains : (C,), bodies that they join, each
        driven plane being one, and the connected pieces that these form.
    """

    spin_axes: tuple[int, ...]
    contacts: np.ndarray
    bodies: np.ndarray
    domains: np.ndarray

    @property
    def states(self) -> np.ndarray:
        """(C,) states of self-stress: independent loops of slipless contacts around which it can circulate."""
        return self.contacts - (self.bodies - self.domains)

    @property
    def total(self) -> int:
        """Free parameters of the forces while nothing is at its limit of friction; 0 if the forces are unique."""
        return int(self.states.sum())


def self_stress(network: SliplessNetwork, spin_axes: tuple[int, ...]) -> SelfStress:
    """Static indeterminacy of a slipless network.

    With the forces of slipping contacts and the total torque of each component given, balance is one equation for each
    body of a domain, one of them a consequence of the others, and one unknown for each slipless contact.
    """
    numbers = []
    for component in spin_axes:
        carries = network.axis != component
        joined = np.unique(network.body[network.ends[:, carries]])
        label = connected_components(network.graph(carries), directed=False)[1]
        numbers.append((int(carries.sum()), len(joined), len(np.unique(label[joined]))))
    contacts, bodies, domains = np.array(numbers, dtype=int).T
    return SelfStress(spin_axes, contacts, bodies, domains)


def _ratio(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    """above / below, and 0 where there is nothing."""
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0)
