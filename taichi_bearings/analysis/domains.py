"""Rigid domains: spheres that slipless contacts force to turn alike, component by component and as a whole.

A slipless contact along an axis ties the components of the staggered spin perpendicular to it and leaves the one along
it free. So there are domains of each component k: spheres that contacts tie in k, each driven plane being one body. A
*rigid domain* is a common refinement: spheres that share their domain in every component that the driving needs. They
have the same staggered spin, so they roll on each other as one bearing. In 2D, with its one component, the two notions
agree.

A domain is locked to a driven plane in component k if contacts tie it to that plane in k. At a minimum no domain is
locked to both planes in a component that they drive differently; slip thresholds can make it look so. Where the imposed
states differ in their dilation, planes turn unevenly, and what joins them in a layer without a jump is no lock of
others: then a plane is a body a layer of component k, and all that turns with the bottom, or with the top as it turns
there, still is one domain of k.
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
    """What a domain of one component is tied to."""

    NEITHER = 0
    BOTTOM = 1
    TOP = 2
    BOTH = 3


LOCKS = ("bottom", "top", "both", "mixed", "partly", "neither")
"""Rigid domains locked in every component to the bottom, to the top, to both, to the one or the other; in some
components only, in none."""
INTERMEDIATE = LOCKS.index("mixed")  # the first of the kinds that are not locked to one plane in all components


@dataclass(frozen=True)
class RigidDomains:
    """Domains of one sample; C components as named by spin_axes, D rigid domains; N the shape of the spheres.

    component_domain : (C, *N) label of the domain of each component.
    domain : N, label of the rigid domain: 0, 1, ... by falling number of spheres.
    spheres : (D,) spheres of each, driven ones included. staggered : (D, C) mean staggered spin, 1/time.
    spread : largest distance of a sphere from the mean of its domain, or from the top where it is locked to that, over
        all components: 0 but for rounding.
    lock : (D, C) values of Lock, a bit for each body. jump : (D, C) staggered spin of the top in the layers of each
    domain, 1/time. bodies : what is driven.

    Of a packing the spins are s R omega, s the signs by which neighbours differ.
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
        """From what each sphere has of each component: the label of its domain, what that is tied to, its spin above
        the bottom's, and that of the top, if bodies turn as one; (C, sites)."""
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
        """As LOCKS, for these bodies."""
        return (*self.bodies, "both" if len(self.bodies) == 2 else "several", *LOCKS[INTERMEDIATE:])

    @property
    def number(self) -> int:
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
        """(D, C) staggered spin between that of the bottom (0) and that of the top (1) in its layers, 0 where these
        agree."""
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
        """Number of spheres of each kind among those where `counted` (shape N) is True."""
        each = np.bincount(self.kind[self.domain[counted]], minlength=len(self.locks))
        return dict(zip(self.locks, each.tolist(), strict=True))


def rigid_domains(network: SliplessNetwork, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> RigidDomains:
    """The domains of one sample.

    staggered : (C, *N) spins, components as named by spin_axes, 1/time.
    """
    top = staggered[..., -1].reshape(len(spin_axes), -1)
    uneven = bool((top != top[:, :1]).any())
    labels, tied = np.stack([_of_component(network, component, uneven) for component in spin_axes], axis=1)
    above = np.repeat(top, network.shape[-1], axis=1)  # each sphere
    return RigidDomains.of(spin_axes, labels, tied, staggered.reshape(len(spin_axes), -1), above, network.shape)


def turning_domains(
    network: SliplessNetwork, turned: np.ndarray, states: np.ndarray | None, near: float, axes: tuple[int, ...]
) -> RigidDomains:
    """Rigid domains of one sample by its spins: spheres of one connected piece of slipless contacts that turn as fast.
    Those of one piece with a body that turn as it does are locked to it.

    turned : (N, C) s R omega, length/time. states : (2, N, C), what it would be if all turned with the first or with
    the second of two bodies; None without two bearing states. near : by how much speeds of one domain may differ,
    length/time. axes : components that are looked at.
    """
    piece, whole, largest = network.component, network.whole, np.abs(turned).max(initial=0.0)
    low, high = np.zeros((2, *turned.shape)) if states is None else states
    apart = 4 * largest  # with bodies that turn unevenly all is one domain that turns as they do
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
    """(N,) one label for the spheres of each piece whose values follow each other by no more than `near`."""
    order = np.lexsort([values, piece])
    new = (np.diff(piece[order], prepend=-1) != 0) | (np.diff(values[order], prepend=np.inf) > near)
    label = np.empty(len(piece), dtype=np.int64)
    label[order] = np.cumsum(new) - 1
    return label


def refined(labels: np.ndarray) -> np.ndarray:
    """Label (sites,) of the common refinement of classes (C, sites), by falling number of spheres."""
    together = np.unique(labels, axis=1, return_inverse=True)[1].ravel()
    order = np.argsort(-np.bincount(together), kind="stable")
    return np.asarray(np.argsort(order)[together])


def _of_component(network: SliplessNetwork, component: int, uneven: bool) -> tuple[np.ndarray, np.ndarray]:
    """Label (sites,) of the domain of one component that each sphere is in, and what it is locked to.

    uneven : the planes are a body a layer along the component.
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
