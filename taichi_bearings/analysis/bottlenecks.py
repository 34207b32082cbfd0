"""Bottlenecks: the few links that carry most of what goes from bottom to top.

Three ways to look for them: the loads by shortest paths (`betweenness`) and by a current (`current`), and the links and
spheres whose removal alone parts the planes (`backbone`). Where several links share the load there is the smallest set
that parts the planes (`SliplessNetwork.disjoint_paths`).
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.analysis.backbone import Backbone, find_backbone
from taichi_bearings.analysis.betweenness import Betweenness, betweenness
from taichi_bearings.analysis.current import CurrentFlow, current_flow
from taichi_bearings.analysis.network import SliplessNetwork

ROUNDING = 1e-12  # a load that is less is none


@dataclass(frozen=True)
class LoadedLink:
    """A link and its load. contact : position of its lower sphere; axis : direction of the contact.

    share : of the pairs whose shortest paths it carries. current : share of the current.
    """

    contact: tuple[int, ...]
    axis: int
    share: float
    share_error: float
    current: float
    is_bridge: bool
    parts_the_planes: bool


@dataclass(frozen=True)
class Loads:
    """What the links (E,) of one sample carry: of its shortest paths, and of its current; nothing if it has no path."""

    share: np.ndarray
    current: np.ndarray


@dataclass(frozen=True)
class Concentration:
    """How unevenly loads (links,) are spread; all 0 if nothing is loaded.

    largest : load of the top link. loaded : number of links with a load beyond rounding. effective : participation
    number (sum load)^2 / sum load^2, as many links as would bear it if they all bore the same. half : fewest links that
    together bear half the sum of the loads. nearly_all : number of links with nine tenths of all pairs or current.
    """

    largest: float
    loaded: int
    effective: float
    half: int
    nearly_all: int


@dataclass(frozen=True)
class Bottlenecks:
    """All of it for one sample; links (E,) and spheres (sites,) are those of `network`."""

    network: SliplessNetwork
    backbone: Backbone
    betweenness: Betweenness
    current: CurrentFlow

    @property
    def share(self) -> np.ndarray:
        """Share (E,) of the connected pairs that each link carries; 0 without pairs."""
        return self.betweenness.link / max(1, self.betweenness.pairs)

    @property
    def loads(self) -> Loads:
        return Loads(self.share, self.current.link)

    @property
    def concentration(self) -> Concentration:
        """Of the shortest paths."""
        return concentration(self.share)

    @property
    def current_concentration(self) -> Concentration:
        return concentration(self.current.link)

    def most_loaded(self, number: int) -> tuple[LoadedLink, ...]:
        """The links that carry most pairs, the heaviest first; of equal ones that with more current."""
        rank = np.lexsort((-self.current.link.round(12), -self.share.round(12)))
        rank = rank[self.share[rank] > ROUNDING][:number]
        return tuple(self._link(edge) for edge in rank)

    def _link(self, edge: int) -> LoadedLink:
        return LoadedLink(
            contact=tuple(self.network.contact[edge].tolist()),
            axis=int(self.network.axis[edge]),
            share=float(self.share[edge]),
            share_error=float(self.betweenness.link_error[edge] / max(1, self.betweenness.pairs)),
            current=float(self.current.link[edge]),
            is_bridge=bool(self.backbone.bridges[edge]),
            parts_the_planes=bool(self.backbone.parting_links[edge]),
        )


def find_bottlenecks(network: SliplessNetwork, sources: int | None = None, seed: int = 0) -> Bottlenecks:
    """The bottlenecks of one sample; sources, seed : as in `betweenness`."""
    backbone = find_backbone(network)
    return Bottlenecks(
        network=network,
        backbone=backbone,
        betweenness=betweenness(network, backbone.links, sources, seed),
        current=current_flow(network, backbone.links),
    )


def concentration(load: np.ndarray) -> Concentration:
    """Of loads (E,) that are at most 1."""
    if not load.any():
        return Concentration(0.0, 0, 0.0, 0, 0)
    falling = np.sort(load)[::-1]
    gathered = np.cumsum(falling)
    return Concentration(
        largest=float(falling[0]),
        loaded=int((load > ROUNDING).sum()),
        effective=float(gathered[-1] ** 2 / (load**2).sum()),
        half=int(np.searchsorted(gathered, gathered[-1] / 2 * (1 - ROUNDING)) + 1),
        nearly_all=int((load >= 0.9).sum()),
    )
