"""What is read from lattices whose sides close on themselves: counted by hand, and the same wherever a ring begins."""

from types import SimpleNamespace

import numpy as np
import pytest

from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.analysis.domains import rigid_domains
from taichi_bearings.analysis.slipless_network import SliplessNetwork
from taichi_bearings.analysis.structure import Structure, self_stress
from taichi_bearings.lattice import Lattice
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.structure_report import columns_of
from taichi_bearings.scene.network import Network
from tests.analysis.networks import drawn
from tests.scenes import KNOWN_LAWS, make_scene

CLOSED = [((6, 5), "x"), ((4, 3, 6), "x"), ((4, 4, 5), "xy"), ((2, 4, 5), "xy"), ((2, 6), "x")]
RING = drawn((4, 5), [(0, 2), (1, 2), (2, 2), (3, 2), (0, 2)], [(1, 2), (1, 3)], periodic=(0,))
OVER = drawn((4, 5), [(0, 0), (0, 1), (3, 1), (3, 2), (2, 2), (2, 3), (2, 4)], periodic=(0,))


def test_a_ring_of_slipless_contacts_is_one_domain_with_one_state_of_self_stress():
    found = rigid_domains(RING, np.zeros((1, 4, 5)), (2,))
    assert found.spheres.tolist() == [5, 4, 4, 1, 1, 1, 1, 1, 1, 1]
    assert len(np.unique(found.domain[:, 2])) == 1
    assert (RING.components, RING.spans, RING.reached_fraction) == (1, False, 5 / 12)
    assert self_stress(RING, (2,)).tolist() == [1]
    assert RING.contact.tolist() == [[0, 2], [1, 2], [2, 2], [3, 2], [1, 2]]


def test_a_path_may_lead_over_a_periodic_side():
    found = Bottlenecks(OVER)
    assert OVER.shortest_path.tolist() == [[0, 0], [0, 1], [3, 1], [3, 2], [2, 2], [2, 3], [2, 4]]
    assert np.array_equal(OVER.on_path, OVER.slipless)
    assert OVER.path_planes == [3]
    assert found.parting.all()
    assert (OVER.disjoint_paths, found.betweenness.mean_distance) == (1, 6)


def test_the_two_contacts_of_a_ring_of_two_are_two_links():
    lattice = Lattice((2, 4), periodic=(0,))
    slipless = np.zeros(lattice.all_contacts, dtype=bool)
    along_x, upwards = lattice.by_axis(slipless)
    upwards[0, 0] = upwards[1, 1] = upwards[1, 2] = along_x[0, 1] = along_x[1, 1] = True
    network = SliplessNetwork(Network.of(lattice), slipless)
    found = Bottlenecks(network)
    assert network.axis.tolist() == [0, 0, 1, 1, 1]
    assert found.share.tolist() == [0.5, 0.5, 1, 1, 1]
    assert found.parting.tolist() == [False, False, True, True, True]
    assert network.disjoint_paths == 1
    assert self_stress(network, (2,)).tolist() == [1]
    assert network.on_path[slipless].tolist() == [True, False, True, True, True]  # by the first of the two
    along_x[0, 1] = False
    assert SliplessNetwork(Network.of(lattice), slipless).on_path[slipless].all()


def rolled(values, lattice, axis):
    """Values (E, ...) of the contacts two spheres further along an axis."""
    parts = lattice.by_axis(np.moveaxis(values, 0, -1))
    return np.moveaxis(lattice.flat([np.roll(part, 2, axis - lattice.dimension) for part in parts]), -1, 0)


def any_answer(shape, sides, law):
    """Spins, slips, states and forces at random: what is read from an answer need not be one."""
    scene, random = make_scene(shape, law, periodic=tuple(sides), spin_bottom=0.1), np.random.default_rng(4)
    lattice, vectors = scene.lattice, () if len(shape) == 2 else (3,)
    axes = scene.minimum_spin_axes
    staggered = random.choice([0.1, 0.4, 1.0], (len(axes), 1, *shape))
    states = [ContactState.SLIPLESS, ContactState.SLIPPING, ContactState.UNDECIDED]
    state = np.where(
        lattice.between_driven, ContactState.DRIVEN, random.choice(states, lattice.all_contacts, p=[0.6, 0.3, 0.1])
    )
    slip, friction = random.random(lattice.all_contacts), random.normal(size=(lattice.all_contacts, *vectors))
    spin = scene.laboratory_spin(scene.impose_driving(staggered, axes), axes)[0]
    return of_answer(scene, spin, slip, state.astype(np.uint8), friction)


def of_answer(scene, spin, slip, state, friction):
    """Structure of an answer with these spins, slips, states and friction."""
    known = {"slip": slip[None], "state": state[None], "proven": state[None], "force": np.zeros((1, len(slip)))}
    known |= dict.fromkeys(("objective", "power", "lower_bound"), np.ones(1))
    answer = SimpleNamespace(scene=scene, findings={}, minimum_is_unique=[None], **known)
    return Structure(answer, spin, slip, state, friction, slip, 2.0, 1.0)


def shifted(structure, axis):
    scene, lattice = structure.scene, structure.scene.lattice
    parts = {
        name: tuple(np.roll(values, 2, axis - lattice.dimension) for values in getattr(scene, name))
        for name in ("coefficients", "viscosity")
    }
    moved = {name: rolled(getattr(structure, name), lattice, axis) for name in ("slip", "state", "friction")}
    return of_answer(
        type(scene)(**parts, law=scene.law, periodic=scene.periodic, spin_bottom=scene.spin_bottom, seeds=scene.seeds),
        np.roll(structure.spin, 2, axis), moved["slip"], moved["state"], moved["friction"],
    )  # fmt: skip


@pytest.mark.parametrize(("shape", "sides"), CLOSED[:-1], ids=str)
@pytest.mark.parametrize("law", KNOWN_LAWS)
def test_nothing_depends_on_where_a_ring_begins(shape, sides, law):
    """Two spheres further on, where the sublattices are the same, is the same structure, rolled."""
    structure = any_answer(shape, sides, law)
    lattice, numbers = structure.scene.lattice, structure.numbers
    assert numbers["spans"]
    for axis in map("xyz".index, sides):
        other = shifted(structure, axis)
        found = other.numbers
        for name in set(numbers) - {"planes_crossed", "most_loaded"}:
            one, first = found[name], numbers[name]
            assert one == first or one == pytest.approx(first, rel=1e-9, abs=1e-12), name
        for name, column in columns_of(structure)[1].items():
            expected = rolled(column.values, lattice, axis)
            assert name == "on_path" or columns_of(other)[1][name].values == pytest.approx(expected, abs=1e-9), name
        assert other.bottlenecks.visits == pytest.approx(np.roll(structure.bottlenecks.visits, 2, axis), abs=1e-12)
        assert np.array_equal(other.interface.above, np.roll(structure.interface.above, 2, axis))
        size, expected = (s.rigid_domains.spheres[s.rigid_domains.domain] for s in (other, structure))
        assert np.array_equal(size, np.roll(expected, 2, axis))
