"""What a slip threshold would have said: the structure seen by a solver that cannot tell tiny slips from none.

Contacts that slip no more than the threshold are taken for slipless. At the minimum of a large sample the slips span
many decades, so a coarse threshold merges slipping contacts into the network and domains into each other.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.analysis.domains import KINDS, RigidDomains, rigid_domains
from taichi_bearings.analysis.network import SliplessNetwork
from taichi_bearings.lattice import Lattice

THRESHOLDS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
"""Slips over R times the imposed jump, which is the largest slip there can be."""


@dataclass(frozen=True)
class View:
    """The structure in a few numbers.

    slipless : contacts. components : pieces of their network. reached_fraction, spanning_fraction : of the free
    spheres. domains : rigid domains. largest_intermediate : spheres of the largest one that is not locked to a plane in
    all components.
    """

    slipless: int
    components: int
    spans: bool
    reached_fraction: float
    spanning_fraction: float
    domains: int
    largest_intermediate: int


def view(network: SliplessNetwork, domains: RigidDomains) -> View:
    """The numbers of one sample."""
    intermediate = domains.spheres[domains.kind >= KINDS.index("mixed")]
    return View(
        slipless=len(network.axis),
        components=network.components,
        spans=network.spans,
        reached_fraction=network.reached_fraction,
        spanning_fraction=network.spanning_fraction,
        domains=domains.number,
        largest_intermediate=int(intermediate.max(initial=0)),
    )


def views_by_threshold(
    lattice: Lattice,
    slip: np.ndarray,
    largest_slip: float,
    staggered: np.ndarray,
    spin_axes: tuple[int, ...],
) -> list[View]:
    """The view of one sample for each of THRESHOLDS.

    slip : speed, (E,), length/time. largest_slip : the unit of the thresholds, length/time.
    staggered : (C, *N) spins, components as named by spin_axes, 1/time.
    """
    views: dict[int, View] = {}
    chosen = []
    for threshold in THRESHOLDS:
        slipless = (slip <= threshold * largest_slip) & ~lattice.between_driven
        count = int(slipless.sum())  # the sets are nested: the same number, the same set
        if count not in views:
            network = SliplessNetwork(lattice, slipless)
            views[count] = view(network, rigid_domains(network, staggered, spin_axes))
        chosen.append(views[count])
    return chosen


__all__ = ["THRESHOLDS", "View", "view", "views_by_threshold"]
