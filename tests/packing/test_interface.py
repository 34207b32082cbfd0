"""The lightest interface of packings: against networkx and the same lattice as a scene, and where there is none."""

import networkx as nx
import numpy as np
import pytest

from taichi_bearings.analysis.structure import find_interface
from taichi_bearings.scene.interface import Interface
from taichi_bearings.scene.packing import Packing
from tests.scenes import BIPARTITE, cells_of, make_scene, some_of


def between_states(kind, cells, number, law="coulomb", constant=False):
    """A packing whose first and last bodies are in bearing states A + c x, and the jump (N, 3) of these states."""
    rng = np.random.default_rng([number, 23])
    draw = (
        "constant:0.3" if constant else ("uniform:0.1,1.0", "bimodal:0.1,1.0,0.5", "power-law:1e-9,1.0,-1")[number % 3]
    )
    packing = Packing.lattice(kind, cells, seed=number, law=law, distribution=draw)
    x = np.pad(packing.center, ((0, 0), (0, 3 - packing.dimension)))
    states = rng.normal(size=(2, 4)) * [1, 1, 1, number % 2]
    graph = nx.Graph(map(tuple, packing.contact))
    side = {}
    for part in nx.connected_components(graph):
        side |= nx.bipartite.color(graph.subgraph(part))
    sign = np.array([1 - 2 * side.get(n, 0) for n in range(packing.spheres)])
    if packing.dimension == 2:
        states *= [0, 0, 1, 0]
    both = [state[:3] + state[3] * x for state in states]
    spin = (
        sign[:, None] * np.where((packing.driven == 1)[:, None], both[1], both[0]) / np.reshape(packing.radius, (-1, 1))
    )
    spin = np.where((packing.driven >= 0)[:, None], spin, 0.0)
    arrays = packing.arrays() | {"spin": spin if packing.dimension == 3 else spin[:, 2]}
    return Packing(**arrays, law=law), both[1] - both[0]


@pytest.mark.parametrize("number", some_of(60, 4))
@pytest.mark.parametrize("kind", BIPARTITE)
def test_the_lightest_interface_of_a_packing_is_that_of_networkx(kind, number):
    packing, jump = between_states(kind, cells_of(kind), number)
    if kind == "cubic":
        jump = jump * [1, 1, 0]  # a layer may turn about the height as it likes
    normal = np.pad(np.asarray(packing.normal), ((0, 0), (0, 3 - packing.dimension)))
    size = np.linalg.norm(np.cross(jump[packing.contact[:, 0]], normal), axis=1)
    weight = packing.friction * np.broadcast_to(packing.normal_force, packing.contacts) * size
    graph = nx.Graph()
    name = {-1: None, 0: "bottom", 1: "top"}
    for (one, other), w in zip(packing.contact.tolist(), weight.tolist(), strict=True):
        ends = [name[packing.driven[n]] or n for n in (one, other)]
        if ends[0] != ends[1]:
            before = graph[ends[0]][ends[1]]["capacity"] if graph.has_edge(*ends) else 0
            graph.add_edge(*ends, capacity=before + int(w * 2**80))
    least = nx.minimum_cut_value(graph, "bottom", "top") / 2**80
    found = Interface.of(packing)
    assert found.power == pytest.approx(least, rel=1e-9)
    slips = packing.slip_speeds(found.spins / np.reshape(packing.radius, (-1, 1)))
    both = (packing.driven[packing.contact] >= 0).all(axis=1)
    spent = packing.friction * np.broadcast_to(packing.normal_force, packing.contacts) * slips
    assert spent[~both].sum() == pytest.approx(least, rel=1e-9)


def test_a_cubic_packing_has_the_interface_of_the_scene():
    scene = make_scene((3, 4, 4), top=(1.0, 0.5, 2.0, 0.75), bottom=(0.0, 0.25, -1.0, 0.0))
    packing = Packing.lattice("cubic", (3, 4, 4))
    top = (packing.driven == 1)[:, None]
    spin = np.where(top, [1.0, 0.5, 2.0] + 0.75 * packing.center, [0.0, 0.25, -1.0])
    parity = 1 - 2 * (np.rint(packing.center).astype(int).sum(axis=1) % 2)
    arrays = packing.arrays() | {"spin": np.where((packing.driven >= 0)[:, None], parity[:, None] * spin, 0.0)}
    place = np.rint(packing.center).astype(int)[packing.contact].min(axis=1)
    axis = np.abs(np.asarray(packing.normal)).argmax(axis=1)
    arrays["friction"] = np.array(
        [scene.coefficients[a][(..., *at)].item() for a, at in zip(axis, place.tolist(), strict=True)]
    )
    assert Interface.of(Packing(**arrays)).power == pytest.approx(find_interface(scene).power, rel=1e-12)


def test_states_that_slip_across_a_periodic_side_have_no_interface():
    packing = Packing.lattice("bcc", (2, 2, 3), periodic=("x",), seed=1)
    arrays, top = packing.arrays(), (packing.driven == 1)[:, None]
    sign = np.array([1.0 - 2 * n for _, n in sorted(nx.bipartite.color(nx.Graph(map(tuple, packing.contact))).items())])
    for rate, some in ((0.0, True), (0.5, False)):
        spin = sign[:, None] * np.where(top, [1.0, 0.0, 0.0] + rate * packing.center, 0.0)
        held = Packing(**arrays | {"spin": np.where((packing.driven >= 0)[:, None], spin, 0.0)})
        assert (Interface.of(held) is not None) == some
