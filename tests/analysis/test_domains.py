"""Rigid domains: which components a slipless contact ties, and what the domains are locked to."""

import networkx
import numpy as np
import pytest

from taichi_bearings.analysis.domains import Lock, rigid_domains
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.analysis.networks import APART, RANDOM, TWO_CHAINS, drawn, network_of
from tests.scenes import make_scene

CORNER = drawn(  # the sphere (0, 0, 2) hangs on the bottom by an x-contact and on the top by a y-contact
    (2, 2, 5),
    [(1, 0, 0), (1, 0, 1), (1, 0, 2), (0, 0, 2), (0, 1, 2), (0, 1, 3), (0, 1, 4)],
)


def domains_of(network, axes=None):
    axes = axes or ((2,) if network.lattice.dimension == 2 else (0, 1))
    return rigid_domains(network, np.zeros((len(axes), *network.lattice.shape)), axes)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_contact_does_not_tie_the_component_along_it(axis):
    here = np.array([1, 1, 1])
    there = here + np.eye(3, dtype=int)[axis]
    found = domains_of(drawn((3, 3, 4), [tuple(here), tuple(there)]), (0, 1, 2))
    for component, label in enumerate(found.component_domain):
        assert (label[tuple(here)] == label[tuple(there)]) == (component != axis)
    assert found.domain[tuple(here)] != found.domain[tuple(there)]
    assert found.number == 2 + 9 * 2


def test_an_upright_contact_ties_both_components_of_the_driving():
    found = domains_of(drawn((3, 3, 4), [(1, 1, 1), (1, 1, 2)]))
    assert found.domain[1, 1, 1] == found.domain[1, 1, 2]
    assert found.number == 2 + 9 * 2 - 1
    assert found.spheres.tolist() == [9, 9, 2] + [1] * 16


def test_a_square_of_contacts_across_the_height_binds_nothing_rigidly():
    square = [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1), (0, 0, 1)]
    found = domains_of(drawn((2, 2, 3), square))
    x, y = found.component_domain[:, :, :, 1]
    assert len(np.unique(x)) == len(np.unique(y)) == 2
    np.testing.assert_array_equal(x[:, 0], x[:, 1])
    np.testing.assert_array_equal(y[0], y[1])
    assert found.number == 2 + 4


def test_locks_by_hand():
    found = domains_of(CORNER)
    lock = {place: found.lock[found.domain[place]].tolist() for place in np.ndindex(2, 2, 5)}
    assert lock[1, 0, 1] == lock[1, 0, 2] == lock[0, 0, 0] == [Lock.BOTTOM, Lock.BOTTOM]
    assert lock[0, 1, 2] == lock[0, 1, 3] == lock[1, 1, 4] == [Lock.TOP, Lock.TOP]
    assert lock[0, 0, 2] == [Lock.TOP, Lock.BOTTOM]  # x by the y-contact, y by the x-contact
    assert lock[1, 1, 2] == [Lock.NEITHER, Lock.NEITHER]
    free = ~CORNER.lattice.is_driven
    assert found.spheres_of_kind(free) == {"bottom": 2, "top": 2, "both": 0, "mixed": 1, "partly": 0, "neither": 7}
    assert found.domains_of_kind() == {"bottom": 1, "top": 1, "both": 0, "mixed": 1, "partly": 0, "neither": 7}
    assert found.domain[0, 0, 0] in (0, 1)
    assert found.spheres.sum() == CORNER.lattice.sites


def test_the_largest_intermediate_domain_may_be_of_any_kind_that_is_not_locked_to_one_plane():
    assert domains_of(CORNER).largest_intermediate == 1
    chain = [(0, 0, 2), (0, 0, 3), (0, 0, 4)]  # hangs on the corner, so x on the top and y on the bottom
    mixed = drawn(
        (2, 2, 7), [(1, 0, h) for h in range(3)] + chain, [(0, 0, 2), (0, 1, 2)], [(0, 1, h) for h in range(2, 7)]
    )
    assert domains_of(mixed).largest_intermediate == 3
    alone = drawn((2, 2, 7), [(0, 0, 2), (0, 0, 3)])
    assert domains_of(alone).largest_intermediate == 2


def test_a_sphere_locked_in_one_component_is_partly_locked():
    found = domains_of(drawn((2, 2, 5), [(1, 0, 0), (1, 0, 1), (1, 0, 2), (0, 0, 2)]))
    assert found.lock[found.domain[0, 0, 2]].tolist() == [Lock.NEITHER, Lock.BOTTOM]
    assert found.domains_of_kind() == {"bottom": 1, "top": 1, "both": 0, "mixed": 0, "partly": 1, "neither": 9}


def test_what_joins_the_planes_in_all_components_is_locked_to_both():
    column = drawn((2, 2, 4), [(0, 0, h) for h in range(4)])
    found = domains_of(column)
    assert found.lock[found.domain[0, 0, 1]].tolist() == [Lock.BOTH, Lock.BOTH]
    assert found.domains_of_kind() == {"bottom": 0, "top": 0, "both": 1, "mixed": 0, "partly": 0, "neither": 6}
    half = drawn((2, 2, 4), [(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 2), (1, 0, 3)])  # joins y alone
    found = domains_of(half)
    assert found.lock[found.domain[0, 0, 1]].tolist() == [Lock.BOTTOM, Lock.BOTH]
    assert found.lock[found.domain[1, 0, 1]].tolist() == [Lock.TOP, Lock.BOTH]
    assert found.domains_of_kind()["bottom"] == found.domains_of_kind()["top"] == 1


def test_in_two_dimensions_domains_are_the_pieces():
    found = domains_of(APART)
    domain, piece = found.domain.ravel(), APART.component.ravel()
    np.testing.assert_array_equal(domain[:, None] == domain[None, :], piece[:, None] == piece[None, :])
    assert found.number == APART.component.max() + 1
    assert found.spheres_of_kind(~APART.lattice.is_driven) == {
        "bottom": 2, "top": 2, "both": 0, "mixed": 0, "partly": 0, "neither": 5
    }  # fmt: skip


def test_domains_of_equal_size_are_numbered_by_first_appearance():
    found = domains_of(TWO_CHAINS)
    assert found.spheres.tolist() == [10, 1, 1]
    assert found.domain[1].tolist() == [0, 1, 2, 0]


@pytest.mark.parametrize("network", [network for network in RANDOM if network.lattice.dimension == 3])
def test_domains_of_components_agree_with_networkx(network):
    found = domains_of(network)
    assert (np.diff(found.spheres) <= 0).all()
    flat, number = found.domain.ravel(), network.lattice.sites
    labels = found.component_domain.reshape(2, -1)
    for component in (0, 1):
        graph = networkx.Graph()
        graph.add_nodes_from(range(number))
        graph.add_edges_from(network.ends[:, network.axis != component].T.tolist())
        planes = np.arange(number).reshape(network.lattice.shape)
        for plane in (planes[..., 0].ravel(), planes[..., -1].ravel()):
            networkx.add_path(graph, plane.tolist())
        expected = {frozenset(piece) for piece in networkx.connected_components(graph)}
        assert {frozenset(np.flatnonzero(labels[component] == label)) for label in set(labels[component])} == expected
    together = (labels[:, :, None] == labels[:, None, :]).all(axis=0)
    np.testing.assert_array_equal(together, flat[:, None] == flat[None, :])


@pytest.mark.usefixtures("needs_f64")
def test_spins_within_a_domain_are_equal_at_a_minimum():
    scene = make_scene((4, 5, 6), seeds=(7,), spin_bottom=0.1)
    solution = solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-10))
    network = network_of(scene.lattice, solution.state[0])
    staggered = scene.lattice.parity * np.moveaxis(solution.spin[0], -1, 0)[:2]
    found = rigid_domains(network, staggered, (0, 1))
    assert 2 < found.number < scene.lattice.sites
    assert found.spread < 1e-12
    kinds = np.array(found.kind)
    for lock, plane in ((0, 0), (1, -1)):
        np.testing.assert_allclose(found.staggered[kinds == lock], [staggered[:, 0, 0, plane]], atol=1e-12)
    spun = staggered.copy()
    spun[0, 1, 1, 0] += 0.5
    assert rigid_domains(network, spun, (0, 1)).spread > 0.1
