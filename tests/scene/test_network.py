"""Who touches whom: of lattices and packings the same network, and what follows from it, by plain loops."""

import networkx
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.errors import InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.scene.network import Network
from taichi_bearings.scene.packing import Packing
from tests.packing.twins import pair


@pytest.mark.parametrize(("kind", "shape", "closed"), [("cubic", (3, 4, 5), (1,)), ("square", (4, 5), (0,))])
def test_a_lattice_and_the_packing_of_its_kind_have_one_network(kind, shape, closed):
    found = Network.of(Lattice(shape, periodic=closed))
    packing = Packing.lattice(kind, shape, periodic=tuple("xyz"[axis] for axis in closed)).network
    for name in ("center", "radius", "contact", "normal", "body"):
        assert np.array_equal(getattr(found, name), getattr(packing, name)), name
    assert (found.shape, packing.shape) == (shape, (np.prod(shape),))
    assert (found.dimension, found.components) == (packing.dimension, packing.components)


def test_a_lattice_makes_arrays_only_when_they_are_asked_for():
    scene = tb.Scene.random((4, 4, 5), seed=1)
    tb.solve(scene, threads=1)
    assert not {"center", "radius", "contact", "normal", "body"} & vars(scene.network).keys()


@pytest.mark.parametrize("make", [
    lambda: Packing.lattice("bcc", (2, 2, 2), seed=1), lambda: Packing.random(40, dimension=2, seed=2),
])  # fmt: skip
def test_differences_and_torques_are_those_of_each_contact(make):
    """|y| is |(u_i + u_j) x n|, and what forces take from the spins is what torques take, contact by contact."""
    network, rng = make().network, np.random.default_rng(3)
    u = rng.standard_normal((network.components, 2, network.spheres))
    axes = tuple(range(network.components))
    y = network.differences(u, axes)
    for replica in range(2):
        for e, (i, j) in enumerate(network.contact.T):
            both = u[:, replica, i] + u[:, replica, j]
            size = np.linalg.norm(np.cross(both, network.normal[e])) if network.dimension == 3 else abs(both[0])
            assert np.linalg.norm(y[:, replica, e]) == pytest.approx(size, abs=1e-12)
    force = rng.standard_normal(y.shape)
    taken = (force * y).sum(axis=(0, 2))
    assert -(network.pulls(force, axes) * u).sum(axis=(0, 2)) == pytest.approx(taken, rel=1e-12)
    assert network.slips(u[:, 1].T) == pytest.approx(np.linalg.norm(y[:, 1], axis=0), rel=1e-12)


@pytest.mark.parametrize("shape", [(3, 4, 5), (4, 5)])
@pytest.mark.parametrize("driving", [{"spin_bottom": 0.3}, {"top": (0.4,), "bottom": (-0.2,)}])
def test_a_lattice_carries_spins_as_the_packing_of_its_kind_sees_them(shape, driving):
    """Slips, powers and pulls of the same laboratory spins: with strides of staggered spins measured from the bottom,
    and from the list of contacts."""
    if "top" in driving and len(shape) == 3:
        driving = {"top": (0.4, 0.1, -0.3, 0.2), "bottom": (0.1, 0.0, 0.2, -0.1)}
    scene, packing = pair(shape, 5, **driving)
    inside = np.random.default_rng(1).standard_normal((1, *scene.imposed_spins()[0].shape))
    found = []
    for bearing in (scene, packing):
        axes = bearing.driving.every
        spin = inside.reshape(1, *bearing.imposed_spins()[0].shape)
        carried = bearing.staggered_spin(spin, axes)
        seen, rest = bearing.laboratory_pair(carried, None, axes)
        held = bearing.is_driven
        assert (seen[0][held] + rest[0][held]) == pytest.approx(np.add(*bearing.imposed_spins())[held], abs=1e-15)
        assert seen[0][~held] == pytest.approx(spin[0][~held], abs=1e-15)
        found.append(
            (bearing.slips(carried, axes), bearing.power(carried, axes), seen.ravel(), bearing.first(1).arrays())
        )
    assert found[0][0] == pytest.approx(found[1][0], abs=1e-14)
    assert found[0][1] == pytest.approx(found[1][1], rel=1e-13)
    assert found[0][2] == pytest.approx(found[1][2], abs=1e-14)
    own, other = (one[3] for one in found)
    assert own.keys() == other.keys()
    for name, values in own.items():
        some = packing.is_driven if name == "spin" else slice(None)
        one, two = (np.reshape(of, (len(other[name]), -1))[some] for of in (values, other[name]))
        assert one == pytest.approx(two, abs=1e-15), name


def test_signs_and_reach_are_those_of_networkx():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        pairs = np.unique(np.sort(rng.integers(0, 14, (13, 2)), axis=1), axis=0)
        pairs = pairs[pairs[:, 0] < pairs[:, 1]]
        body = np.where(np.arange(14) < 2, 0, -1)
        network = Network(np.zeros((14, 2)), np.ones(14), pairs.T, np.zeros((len(pairs), 2)), body)
        graph = networkx.Graph()  # old ones look for pandas where edges are given here
        graph.add_edges_from(pairs.tolist())
        graph.add_nodes_from(range(14))
        odd, sign = network.sublattices
        reached = network.reached(np.flatnonzero(network.has_free_end))
        for piece in networkx.connected_components(graph):
            two = networkx.is_bipartite(graph.subgraph(piece))
            assert {bool(odd[node]) for node in piece} == {not two}
            assert not two or all(sign[i] == -sign[j] for i, j in graph.subgraph(piece).edges)
        inner = graph.subgraph([node for node in graph if node >= 2])
        for piece in networkx.connected_components(inner):
            touches = any(set(graph[node]) & {0, 1} for node in piece)
            assert {bool(reached[node]) for node in piece} == {touches}


def test_samples_of_a_packing_are_its_axis_of_replicas():
    ones = [Packing.lattice("bcc", (2, 2, 2), seed=seed, law="coulomb-viscous") for seed in (4, 5)]
    both = Packing.together(ones)
    assert (both.replicas, both.seeds) == (2, (4, 5))
    for number, one in enumerate(ones):
        alone = both.sample(number)
        assert alone.seeds == one.seeds
        for name in ("friction", "viscosity", "normal_force", "center", "driven"):
            assert np.array_equal(getattr(alone, name), getattr(one, name)), name
        for whole, part in zip(both.material, one.material, strict=True):
            assert np.array_equal(whole[number], part[0])
    with pytest.raises(InputError, match="spin differs between samples"):
        Packing.together([ones[0], Packing.lattice("bcc", (2, 2, 2), spin_top=2.0, law="coulomb-viscous")])
