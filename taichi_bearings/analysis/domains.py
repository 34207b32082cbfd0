"""Rigid domains: spheres that slipless contacts force to have the same spin, by component and as a whole.

Spins are *staggered*: with signs by which neighbours differ, measured from the bottom plane. A slipless contact along
an axis makes the components of the staggered spin perpendicular to it equal and does not couple the one along it. So
there are domains of each component k: spheres that slipless contacts join in k, each driven plane being one body. A
*rigid domain* is a class of the common refinement: spheres that share their domain in every component that the driving
needs. They have the same staggered spin, so they roll on each other as one bearing. In 2D, with its one component, the
two notions agree.

A domain is *locked* to a driven plane in component k if slipless contacts join it to that plane in k. At a minimum no
domain is locked to both planes in a component that they drive differently; slip thresholds can make it look so.

The imposed bearing states A + C x of bottom and top may differ in C. Then component k of the spins of a driven plane
varies from layer to layer (a layer is a plane across the axis k), and contacts that join bottom and top in a layer
where both have the same spin must not lock other layers. So each layer of a driven plane is a body of its own. All
spheres locked to the bottom, in whatever layer, still are one domain of k, and so are all locked to the top.

Shapes: C components, D rigid domains, N spheres (the shape of a lattice, else their number), `sites` their number.
"""

from dataclasses import dataclass
from enum import IntFlag
from functools import cached_property

import numpy as np

from taichi_bearings.analysis.slipless_network import MOST_BODIES, SliplessNetwork
from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.scene.interface import SAME_STATE


class Lock(IntFlag):
    """Driven planes to which a domain is locked (joined by slipless contacts), as bits: 1 for the bottom, 2 for the
    top.
    """

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
    """The rigid domains of one sample: sets of spheres that slipless contacts force to roll on each other as one
    bearing.

    spin_axes : numbers of the C spin components that the driving needs.
    component_domain : (components C, spheres *N), number of the domain of each sphere by component k: spheres that
        slipless contacts force to have the same component k, whatever the others are.
    domain : (*N), number of the rigid domain of each sphere: 0, 1, ... by falling number of spheres.
    spheres : (domains D,), number of spheres of each of the D rigid domains, driven ones included.
    staggered : (D, C), mean spin of each domain, 1/time, with opposite signs for neighbours and measured from the
        bottom plane.
    spread : largest deviation of a sphere's spin component from the spin of its domain: from that of the top where the
        domain is locked to the top, else from the mean of the domain. It is 0 but for rounding.
    lock : (D, C), driven bodies to which slipless contacts join each domain by each component: one bit a body (`Lock`).
    jump : (D, C), spin of the top plane in the layers of each domain, with signs and origin as in `staggered`.
    bodies : names of the driven bodies.

    For a packing spins are sign * radius * spin, length/time, with signs by which neighbours differ.
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
        """Return the rigid domains, given the domains in each of C spin components. Spheres that slipless contacts
        force to have the same component k, up to signs, are a domain of k; a rigid domain is a set of spheres that
        share their domain in all C components.

        spin_axes : numbers of the components.
        labels : (C, spheres), number of the domain of each sphere in each component.
        tied : (C, spheres), driven bodies to which that domain is locked, one bit a body (`Lock`).
        spins : (C, spheres), spins with opposite signs for neighbours, measured from the bottom.
        jump : (C, spheres), spin of each sphere if it turned with the top, with signs and origin as in `spins`; None if
            driven bodies are not in bearing states.
        shape : shape of arrays over the spheres.
        bodies : names of the driven bodies.
        """
        # sizes and mean spins of the domains; a domain locked to the top has the spin of the top
        domain = refined(labels)
        spheres, first = np.bincount(domain), np.unique(domain, return_index=True)[1]
        mean = np.stack([np.bincount(domain, values) / spheres for values in spins])
        expected = mean[:, domain] if jump is None else np.where(tied == Lock.TOP, jump, mean[:, domain])
        jump = np.zeros_like(spins) if jump is None else jump
        labels, spread = labels.reshape(-1, *shape), float(np.abs(spins - expected).max())
        return cls(
            spin_axes, labels, domain.reshape(shape), spheres, mean.T, spread, tied[:, first].T, jump[:, first].T,
            bodies,
        )  # fmt: skip

    @property
    def locks(self) -> tuple[str, ...]:
        """Names of the kinds of rigid domain, which `kind` numbers: each driven body, "both" (of more than two bodies
        "several"), "mixed", "partly" and "neither"."""
        return (*self.bodies, "both" if len(self.bodies) == 2 else "several", *LOCKS[INTERMEDIATE:])

    @property
    def number(self) -> int:
        """Number of rigid domains."""
        return len(self.spheres)

    @cached_property
    def kind(self) -> np.ndarray:
        """(domains D,), kind of each rigid domain, as an index in `locks`: the driven body to which it is locked in all
        components; "both" or "several" if there are more such bodies; "mixed" if it is locked in all components, but to
        different bodies; "partly" if in some components only; "neither" if in none."""
        count = len(self.bodies)
        to_body = [(self.lock >> body & 1 > 0).all(axis=1) for body in range(count)]  # in all components
        is_locked, to_several = self.lock != Lock.NEITHER, np.sum(to_body, axis=0) > 1
        # the first condition that holds decides
        conditions = [to_several, *to_body, is_locked.all(axis=1), is_locked.any(axis=1)]
        return np.select(conditions, [count, *range(count), count + 1, count + 2], count + 3)

    @property
    def turn(self) -> np.ndarray:
        """(domains D, components C), spin of each rigid domain on a scale from the spin of the bottom, 0, to that of
        the top, 1. Where imposed spins vary over a plane, those in the layers of the domain are taken.

        A domain that is locked to neither plane has 0 where bottom and top have the same spin.
        """
        share = np.divide(self.staggered, self.jump, out=np.zeros_like(self.staggered), where=self.jump != 0)
        return np.where(self.lock == Lock.TOP, 1.0, np.where(self.lock == Lock.NEITHER, share, 0.0))

    @property
    def largest_intermediate(self) -> int:
        """Number of spheres of the largest rigid domain that is not locked to one driven plane in all components."""
        return int(self.spheres[self.kind > len(self.bodies)].max(initial=0))

    def domains_of_kind(self) -> dict[str, int]:
        """Return the number of rigid domains of each kind, by the name of the kind."""
        return dict(zip(self.locks, np.bincount(self.kind, minlength=len(self.locks)).tolist(), strict=True))

    def spheres_of_kind(self, counted: np.ndarray) -> dict[str, int]:
        """Return the number of spheres in domains of each kind, by name.

        counted : mask of the spheres that are counted, in the shape of the lattice or (spheres,).
        """
        number = np.bincount(self.kind[self.domain[counted]], minlength=len(self.locks))
        return dict(zip(self.locks, number.tolist(), strict=True))


def rigid_domains(network: SliplessNetwork, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> RigidDomains:
    """Return the rigid domains of a sample of a lattice: spheres whose spins slipless contacts force to be equal.

    network : the slipless contacts of the sample.
    staggered : (C, spheres *N), spins with opposite signs for neighbours, measured from the bottom, 1/time.
    spin_axes : numbers of the C components.
    """
    top = staggered[..., -1].reshape(len(spin_axes), -1)
    is_uneven = bool((top != top[:, :1]).any())
    labels, tied = np.stack([_domains_of_component(network, k, is_uneven) for k in spin_axes], axis=1)
    jump = np.repeat(top, network.shape[-1], axis=1)  # for each sphere that of the driven sphere above it
    return RigidDomains.of(spin_axes, labels, tied, staggered.reshape(len(spin_axes), -1), jump, network.shape)


def domains_of_packing(
    network: SliplessNetwork,
    signed_speeds: np.ndarray,
    states: np.ndarray | None,
    tolerance: float,
    axes: tuple[int, ...],
) -> RigidDomains:
    """Return the rigid domains of a sample of a packing, found from its spins.

    A domain consists of the spheres of one connected piece of slipless contacts that have the same sign * radius *
    spin, with signs by which neighbours differ. It is locked to a driven body if that has spheres among them.

    network : the slipless contacts.
    signed_speeds : (spheres N, components C), sign * radius * spin, length/time.
    states : (2, N, C), sign * radius * spin of all spheres if they rotated with the first, or with the second, of two
        driven bodies; None if there are not two bodies in bearing states.
    tolerance : difference of speeds within a domain that rounding may cause, length/time.
    axes : numbers of the components that are compared.
    """
    piece, whole, largest = network.component, network.whole, np.abs(signed_speeds).max(initial=0.0)
    low, high = np.zeros((2, *signed_speeds.shape)) if states is None else states
    # spheres in the bearing state of a body are one domain though their speeds differ: all of them get one value, which
    # lies beyond all speeds
    beyond = 4 * largest
    values = np.where(
        np.abs(signed_speeds - low) <= tolerance,
        -beyond,
        np.where(np.abs(signed_speeds - high) <= tolerance, beyond, signed_speeds),
    )
    compared = signed_speeds if states is None else values
    labels = np.stack([_near_values_grouped(piece, compared[:, k], tolerance) for k in axes])
    # a domain is locked to the bodies of the driven spheres in it, one bit for each body
    driven = np.flatnonzero(~whole.free)
    bodies, body = np.unique(whole.body[driven], return_inverse=True)
    tied = np.zeros((len(axes), len(signed_speeds)), dtype=np.int64)
    for lock, label in zip(tied, labels, strict=True):
        np.bitwise_or.at(lock, label[driven], 1 << np.minimum(body, MOST_BODIES))
    tied = np.take_along_axis(tied, labels, axis=1)  # from domains to their spheres
    jump = (high - low)[:, axes].T
    jump[np.abs(jump) <= SAME_STATE * largest] = 0.0  # rounding of states that agree
    names = ("bottom", "top") if len(bodies) == 2 else tuple(f"body {number}" for number in bodies[:MOST_BODIES])
    above_low = (signed_speeds - low)[:, axes].T
    return RigidDomains.of(axes, labels, tied, above_low, None if states is None else jump, piece.shape, names)


def _near_values_grouped(piece: np.ndarray, values: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the group (spheres,) of each sphere: spheres of one connected piece with nearly equal values.

    piece : (spheres,), number of the connected piece of each sphere.
    values : (spheres,), the values that are compared.
    tolerance : largest gap between successive values of a group, once those of a piece are sorted.
    """
    order = np.lexsort([values, piece])
    begins = (np.diff(piece[order], prepend=-1) != 0) | (np.diff(values[order], prepend=np.inf) > tolerance)
    label = np.empty(len(piece), dtype=np.int64)
    label[order] = np.cumsum(begins) - 1
    return label


def refined(labels: np.ndarray) -> np.ndarray:
    """Return the class (spheres,) of each sphere in the common refinement of several divisions: two spheres share it
    if they share their part in every division. Classes are numbered by falling size.

    labels : (components C, spheres), number of the part of each sphere in each of the C divisions.
    """
    together = np.unique(labels, axis=1, return_inverse=True)[1].ravel()
    by_size = np.argsort(-np.bincount(together), kind="stable")
    rank = np.argsort(by_size)  # the inverse permutation
    return np.asarray(rank[together])


def _domains_of_component(network: SliplessNetwork, component: int, is_uneven: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays (spheres,) for one spin component: the number of the domain of each sphere, and the driven
    planes to which this domain is locked, as `Lock`. A domain is locked to a plane if it contains a sphere of it.

    network : the slipless contacts.
    component : number of the component.
    is_uneven : True if the imposed spins vary along a driven plane. Then each layer across the axis of the component
        has a bottom body and a top body of its own.
    """
    # contacts along the axis of the component do not slip by it and join nothing
    chosen = network.axis != component
    if not is_uneven:
        number = network.pieces(chosen)
        piece, bottom, top = number[network.body], number[0], number[-1]
        return piece, Lock.BOTTOM * (piece == bottom) + Lock.TOP * (piece == top)
    # two nodes for each layer across the axis stand for its bottom and its top spheres
    shape, spheres = network.shape, network.whole.spheres
    layer = np.indices(shape)[component]
    node = np.arange(spheres).reshape(shape)
    bottom_node = spheres + 2 * layer
    top_node = bottom_node + 1
    node[..., 0], node[..., -1] = bottom_node[..., 0], top_node[..., -1]
    ends, nodes = node.ravel()[network.ends[:, chosen]], spheres + 2 * shape[component]
    number = pieces(nodes, *ends)
    piece, bottom, top = (number[of].ravel() for of in (node, bottom_node, top_node))
    # all spheres locked to the bottom are one domain, and all locked to the top another
    label = np.unique(np.where(piece == bottom, 0, np.where(piece == top, 1, piece + 2)), return_inverse=True)[1]
    # the domain of the bottom is locked to the top, too, if a layer in which both have the same spin joins them
    lock = np.zeros(label.max() + 1, dtype=np.int64)
    np.bitwise_or.at(lock, label, Lock.BOTTOM * (piece == bottom) + Lock.TOP * (piece == top))
    return label, lock[label]
