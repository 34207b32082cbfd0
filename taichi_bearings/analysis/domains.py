"""Rigid domains: spheres that slipless contacts force to have the same spin, by component and as a whole.

Spins are *staggered*: with signs by which neighbours differ, measured from the bottom plane. A slipless contact along
an axis makes the components of the staggered spin perpendicular to it equal and does not couple the one along it. So
there are domains of each component k: spheres that slipless contacts join in k, each driven plane being one body. A
*rigid domain* is a class of the common refinement: spheres that share their domain in every component that the driving
needs. They have the same staggered spin, so they roll on each other as one bearing. In 2D, with its one component, the
two notions agree.

A domain is *locked* to a driven plane in component k if slipless contacts join it to that plane in k. At a minimum no
domain is locked to both planes in a component that they drive differently; slip thresholds can make it look so.

Where the imposed states differ in their dilation, the spins of a driven plane vary from layer to layer (a layer is a
plane across the axis k). Contacts that join bottom and top in a layer where both have the same spin then must not lock
other layers. So each layer of a driven plane is a body of its own; all spheres locked to the bottom, in whatever layer,
still are one domain of k, and so are all locked to the top.

Shapes: C components, D rigid domains, N spheres (the shape of a lattice, else their number), `sites` their number.
"""

from dataclasses import dataclass
from enum import IntFlag
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from taichi_bearings.analysis.slipless_network import MOST_BODIES, SliplessNetwork
from taichi_bearings.scene.interface import SAME_STATE


class Lock(IntFlag):
    """The driven planes to which a domain of one component is locked."""

    NEITHER = 0
    BOTTOM = 1
    TOP = 2
    BOTH = 3


LOCKS = ("bottom", "top", "both", "mixed", "partly", "neither")
"""Kinds of rigid domain. In every component it is locked to the bottom, to the top, or to both; mixed: in every
component to some plane, but not the same; partly: in some components only; neither: in none."""
INTERMEDIATE = LOCKS.index("mixed")  # the first of the kinds that are not locked to one plane in all components


@dataclass(frozen=True)
class RigidDomains:
    """The domains of one sample.

    spin_axes : numbers of the C components. component_domain : (C, *N), label of the domain of each component.
    domain : shape N, label of the rigid domain: 0, 1, ... by falling number of spheres.
    spheres : (D,), spheres of each, driven ones included. staggered : (D, C), mean staggered spin, 1/time.
    spread : largest difference between the spin of a sphere and the mean of its domain (the spin of the top where it is
        locked to that) over all components: 0 but for rounding.
    lock : (D, C), values of `Lock`, one bit for each body. jump : (D, C), staggered spin of the top in the layers of
    each domain, 1/time. bodies : names of the driven bodies.

    For a packing the spins are s R omega, length/time, with signs s by which neighbours differ.
    """

    spin_axes: tuple[int, ...]
    component_domain: np.ndarray
    domain: np.ndarray
    spheres: np.ndarray
    staggered: np.ndarray
    spread: float
    lock: np.ndarray
    jump: np.ndarray
    bodies: tuple[str, ...] = ("bottom", "top")

    @classmethod
    def of(
        cls, spin_axes: tuple[int, ...], labels: np.ndarray, tied: np.ndarray, spins: np.ndarray,
        jump: np.ndarray | None, shape: tuple[int, ...], bodies: tuple[str, ...] = ("bottom", "top"),
    ) -> "RigidDomains":  # fmt: skip
        """Return the rigid domains from the domains of each component.

        labels : (C, sites), label of the domain of each component. tied : (C, sites), what that domain is locked to, as
        `Lock`. spins : (C, sites), spins measured from the bottom. jump : (C, sites), spin of the top measured from the
        bottom; None where driven bodies are not in bearing states. shape : N. bodies : names of the driven bodies.
        """
        domain = refined(labels)
        spheres, first = np.bincount(domain), np.unique(domain, return_index=True)[1]
        mean = np.stack([np.bincount(domain, values) / spheres for values in spins])
        held = mean[:, domain] if jump is None else np.where(tied == Lock.TOP, jump, mean[:, domain])
        jump = np.zeros_like(spins) if jump is None else jump
        labels, spread = labels.reshape(-1, *shape), float(np.abs(spins - held).max())
        return cls(
            spin_axes, labels, domain.reshape(shape), spheres, mean.T, spread, tied[:, first].T, jump[:, first].T,
            bodies,
        )  # fmt: skip

    @property
    def locks(self) -> tuple[str, ...]:
        """Names of the kinds of rigid domain, like LOCKS, for these bodies."""
        return (*self.bodies, "both" if len(self.bodies) == 2 else "several", *LOCKS[INTERMEDIATE:])

    @property
    def number(self) -> int:
        """Number of rigid domains."""
        return len(self.spheres)

    @cached_property
    def kind(self) -> np.ndarray:
        """(D,) index into `locks`: what each rigid domain is locked to in all its components."""
        own = [(self.lock >> body & 1 > 0).all(axis=1) for body in range(len(self.bodies))]
        held, several = self.lock != Lock.NEITHER, np.sum(own, axis=0) > 1
        answers = [several, *own, held.all(axis=1), held.any(axis=1)]
        count = len(own)
        return np.select(answers, [count, *range(count), count + 1, count + 2], count + 3)

    @property
    def turn(self) -> np.ndarray:
        """(D, C), staggered spin of each domain as a fraction: 0 that of the bottom, 1 that of the top in its layers.

        It is 0 where bottom and top have the same spin.
        """
        share = np.divide(self.staggered, self.jump, out=np.zeros_like(self.staggered), where=self.jump != 0)
        return np.where(self.lock == Lock.TOP, 1.0, np.where(self.lock == Lock.NEITHER, share, 0.0))

    @property
    def largest_intermediate(self) -> int:
        """Spheres of the largest rigid domain that is not locked to one plane in all components."""
        return int(self.spheres[self.kind > len(self.bodies)].max(initial=0))

    def domains_of_kind(self) -> dict[str, int]:
        """Number of rigid domains of each kind."""
        return dict(zip(self.locks, np.bincount(self.kind, minlength=len(self.locks)).tolist(), strict=True))

    def spheres_of_kind(self, counted: np.ndarray) -> dict[str, int]:
        """Number of spheres in domains of each kind. counted : mask, shape N, of the spheres that are counted."""
        each = np.bincount(self.kind[self.domain[counted]], minlength=len(self.locks))
        return dict(zip(self.locks, each.tolist(), strict=True))


def rigid_domains(network: SliplessNetwork, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> RigidDomains:
    """Return the domains of a sample of a lattice, from the contacts that force spins to be equal.

    staggered : (C, *N), spins, 1/time. spin_axes : numbers of the C components.
    """
    top = staggered[..., -1].reshape(len(spin_axes), -1)
    uneven = bool((top != top[:, :1]).any())
    labels, tied = np.stack([_of_component(network, component, uneven) for component in spin_axes], axis=1)
    above = np.repeat(top, network.shape[-1], axis=1)  # each sphere
    return RigidDomains.of(spin_axes, labels, tied, staggered.reshape(len(spin_axes), -1), above, network.shape)


def turning_domains(
    network: SliplessNetwork, turned: np.ndarray, states: np.ndarray | None, near: float, axes: tuple[int, ...]
) -> RigidDomains:
    """Return the rigid domains of a sample of a packing, from its spins.

    A domain has spheres of one connected piece of slipless contacts with the same s R omega, where s are signs by which
    neighbours differ. It is locked to a driven body that is among them.

    turned : (N, C), s R omega, length/time. states : (2, N, C), s R omega if all spheres rotated with the first, or
    with the second, of two bodies; None without two bearing states. near : difference of speeds within a domain that is
    allowed for rounding, length/time. axes : numbers of the components that are compared.
    """
    piece, whole, largest = network.component, network.whole, np.abs(turned).max(initial=0.0)
    low, high = np.zeros((2, *turned.shape)) if states is None else states
    # spheres with the bearing state of a body are one domain, though their speeds may differ: two values stand for them
    apart = 4 * largest
    values = np.where(np.abs(turned - low) <= near, -apart, np.where(np.abs(turned - high) <= near, apart, turned))
    labels = np.stack([_alike(piece, (turned if states is None else values)[:, k], near) for k in axes])
    held = np.flatnonzero(~whole.free)
    bodies, body = np.unique(whole.body[held], return_inverse=True)
    tied = np.zeros((len(axes), len(turned)), dtype=np.int64)
    for lock, label in zip(tied, labels, strict=True):
        np.bitwise_or.at(lock, label[held], 1 << np.minimum(body, MOST_BODIES))
    tied = np.take_along_axis(tied, labels, axis=1)
    jump = (high - low)[:, axes].T
    jump[np.abs(jump) <= SAME_STATE * largest] = 0.0  # rounding of states that agree
    names = ("bottom", "top") if len(bodies) == 2 else tuple(f"body {number}" for number in bodies[:MOST_BODIES])
    above = (turned - low)[:, axes].T
    return RigidDomains.of(axes, labels, tied, above, None if states is None else jump, piece.shape, names)


def _alike(piece: np.ndarray, values: np.ndarray, near: float) -> np.ndarray:
    """Return labels (N,), equal for spheres of one piece whose sorted values have no gap above `near`.

    piece : (N,), label of the connected piece of each sphere. values : (N,).
    """
    order = np.lexsort([values, piece])
    new = (np.diff(piece[order], prepend=-1) != 0) | (np.diff(values[order], prepend=np.inf) > near)
    label = np.empty(len(piece), dtype=np.int64)
    label[order] = np.cumsum(new) - 1
    return label


def refined(labels: np.ndarray) -> np.ndarray:
    """Return labels (sites,) of the common refinement of C partitions, by falling number of spheres.

    labels : (C, sites). Two spheres are in one class if all their labels are equal.
    """
    together = np.unique(labels, axis=1, return_inverse=True)[1].ravel()
    order = np.argsort(-np.bincount(together), kind="stable")
    return np.asarray(np.argsort(order)[together])


def _of_component(network: SliplessNetwork, component: int, uneven: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return for each sphere the label (sites,) of its domain of one component, and what that is locked to, as `Lock`.

    uneven : the imposed spins vary along a driven plane, so that each layer across the component's axis has its own
    bottom and top body.
    """
    chosen = network.axis != component
    if not uneven:
        pieces = network.pieces(chosen)
        own, bottom, top = pieces[network.body], pieces[0], pieces[-1]
        return own, Lock.BOTTOM * (own == bottom) + Lock.TOP * (own == top)
    lattice = network.lattice
    layer = np.indices(lattice.shape)[component]
    body = np.arange(lattice.sites).reshape(lattice.shape)
    planes = lattice.sites + 2 * layer
    body[..., 0], body[..., -1] = planes[..., 0], planes[..., -1] + 1
    ends, bodies = body.ravel()[network.ends[:, chosen]], lattice.sites + 2 * lattice.shape[component]
    graph = csr_array((np.ones(ends.shape[1], dtype=np.int8), (ends[0], ends[1])), shape=(bodies, bodies))
    pieces = connected_components(graph, directed=False)[1]
    own, bottom, top = (pieces[of].ravel() for of in (body, planes, planes + 1))
    label = np.unique(np.where(own == bottom, 0, np.where(own == top, 1, own + 2)), return_inverse=True)[1]
    return label, Lock.BOTTOM * (own == bottom) + Lock.TOP * (own == top)
