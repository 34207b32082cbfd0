"""What slipless contacts can bear, and what moves if they cannot: by hand, and in samples with slips below 1e-12."""

import numpy as np
import pytest

from taichi_bearings.conic.contact_system import ContactGroup, ContactSystem
from taichi_bearings.conic.grouped import Grouped
from taichi_bearings.conic.slipless_forces import bear, borne_nearby
from taichi_bearings.lattice.incidence import contact_differences
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")
BOTTOM = TOP = -1


def chain(*contacts, unknowns=1):
    """Contacts (below, above, slip at rest) with one component each, over `unknowns` spins."""
    below, above, slip = np.array(contacts).T
    ends = below.astype(int)[None], above.astype(int)[None]
    group = ContactGroup(*ends, slip[None], unknowns)
    return ContactSystem(unknowns, (group,)), np.arange(unknowns)


def pulled(friction, slip=1.0):
    """One sphere that two contacts hold to the bottom, while the third slips under the top."""
    system, order = chain((BOTTOM, 0, 0.0), (BOTTOM, 0, 0.0), (0, TOP, slip))
    mu, slipping = np.array(friction), np.array([False, False, True])
    dual = np.where(slipping, -mu, np.nan)[None]  # that of slipless contacts is not looked at
    return system, order, mu, dual, slipping


def borne(system, order, *of_contacts):
    return bear(system, order, *(Grouped([values]) for values in of_contacts))


@pytest.mark.parametrize("friction", [(0.4, 0.3, 0.5), (0.3, 0.2001, 0.5)], ids=["easily", "barely"])
def test_two_contacts_bear_what_a_third_pulls(friction):
    system, order, mu, dual, slipping = pulled(friction)
    (found,) = borne(system, order, mu, dual, slipping).dual
    assert system.torques(Grouped([found])) == pytest.approx([0.0], abs=1e-11)
    assert (np.abs(found[0, :2]) < mu[:2]).all()
    assert found[0, 2] == -mu[2]


def test_two_contacts_too_weak_for_it_slip():
    system, order, mu, dual, slipping = pulled((0.25, 0.24, 0.5))
    motion = borne(system, order, mu, dual, slipping).motion
    assert motion[0] > 0  # after the top, as the third contact pulls


@pytest.mark.parametrize("excess", [0.0, -1e-12, -1e-10, 1e-12], ids=str)
def test_contacts_at_their_limit_are_no_proof(excess):
    system, order, mu, dual, slipping = pulled((0.3, 0.2 + excess, 0.5))
    assert borne(system, order, mu, dual, slipping).dual is None


def test_a_free_domain_turns_as_a_whole_at_no_cost():
    """Two spheres tied to each other, both dragged: up by the top, down by the bottom, with the same friction."""
    system, order = chain((BOTTOM, 0, 0.5), (0, 1, 0.0), (1, TOP, 0.5), unknowns=2)
    mu, slipping = np.array([0.4, 0.5, 0.4]), np.array([True, False, True])
    dual = np.where(slipping, -mu, 0.0)[None]
    (found,) = borne(system, order, mu, dual, slipping).dual
    assert found[0] == pytest.approx([-0.4, -0.4, -0.4], abs=1e-10)
    motion = borne(system, order, np.array([0.4, 0.3, 0.4]), dual, slipping).motion
    assert motion[1] > motion[0]  # apart


NONE_CRITICAL = Grouped([np.zeros(6, dtype=bool)])


def two_pulled(friction, forces):
    """Two spheres, each held to the bottom by two contacts and dragged by the top with 0.5."""
    ends = [(BOTTOM, 0, 0.0), (BOTTOM, 0, 0.0), (0, TOP, 1.0), (BOTTOM, 1, 0.0), (BOTTOM, 1, 0.0), (1, TOP, 1.0)]
    system, order = chain(*ends, unknowns=2)
    slipping = np.array([False, False, True] * 2)
    mu, dual = np.array([*friction, 0.5, 0.4, 0.4, 0.5]), -np.array([[*forces, 0.5, 0.2, 0.3, 0.5]])
    return system, order, *(Grouped([values]) for values in (mu, dual, slipping))


def test_what_one_contact_cannot_bear_its_neighbours_do():
    system, *of = two_pulled((0.4, 0.3), (0.45, 0.05))
    (dual,), (mu,), (given,) = borne_nearby(system, *of, NONE_CRITICAL).dual, of[1], of[2]
    assert system.torques(Grouped([dual])) == pytest.approx([0.0, 0.0], abs=1e-11)
    assert (np.abs(dual[0, :2]) < mu[:2]).all()
    assert (dual[:, 2:] == given[:, 2:]).all()


def test_what_no_neighbour_can_bear_moves():
    system, *of = two_pulled((0.25, 0.24), (0.3, 0.2))
    found = borne_nearby(system, *of, NONE_CRITICAL)
    assert found.dual is None
    assert found.motion[0] > 0
    assert found.motion[1] == 0


def test_a_sphere_whose_contacts_bear_enough_is_left_alone():
    system, *of = two_pulled((0.4, 0.3), (0.3, 0.2))
    found = borne_nearby(system, *of, NONE_CRITICAL)
    assert (found.dual, found.motion) == (None, None)


@pytest.mark.parametrize("beyond", [False, True])
def test_nothing_is_borne_where_a_critical_contact_bears_more_than_its_friction(beyond):
    system, order, mu, dual, slipping = two_pulled((0.4, 0.3), (0.45, 0.05))
    mu.parts[0][3], critical = 0.15 if beyond else 0.2, Grouped([np.arange(6) == 3])
    found = borne_nearby(system, order, mu, dual, slipping, critical)
    assert (found.dual is None, found.motion) == (beyond, None)


@pytest.mark.parametrize(
    ("steps", "among", "found"),
    [(0, 4, 1), (1, 4, 2), (2, 4, 3), (9, 4, 4), (9, 2, 2), (9, 0, 1)],
)
def test_contacts_lead_from_spin_to_spin_but_not_through_driven_planes(steps, among, found):
    """Of a chain from plane to plane: from its first contact on, among so many."""
    system, _ = chain((BOTTOM, 0, 0.0), (0, 1, 0.0), (1, 2, 0.0), (2, TOP, 0.0), unknowns=3)
    first, allowed = (Grouped([np.arange(4) < count]) for count in (1, among))
    (around,) = system.around(first, steps, allowed)
    assert around.tolist() == [number < found for number in range(4)]


def test_contacts_at_a_spin():
    system, _ = chain((BOTTOM, 0, 0.0), (0, 1, 0.0), (1, 2, 0.0), (2, TOP, 0.0), unknowns=3)
    assert [part.tolist() for part in system.at(np.array([False, False, True]))] == [[False, False, True, True]]


def minimum_of(scene, start="linear"):
    return solve(scene, InteriorPoint().build(), initial_spin(scene, start), StopRule(1e-10))


HARD = [  # shape, seed, slipping contacts, order of the smallest slip: where the end of the central path tells wrongly
    ((12, 12, 12), 29, 1751, 1e-13),
    pytest.param((16, 16, 16), 1, 2992, 1e-11, marks=pytest.mark.slow),
    pytest.param((16, 16, 16), 4, 4143, 1e-14, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("shape", "seed", "slipping", "smallest"), HARD)
def test_states_with_tiny_slips_are_proven_and_the_same_from_any_start(shape, seed, slipping, smallest):
    scene = make_scene(shape, seeds=(seed,))
    one, other = minimum_of(scene), minimum_of(scene, "random")
    assert one.states_proven[0]
    assert other.states_proven[0]
    slips = one.slip[one.state == ContactState.SLIPPING]
    assert len(slips) == slipping
    assert slips.min() < smallest * scene.lattice.radius
    assert (one.state == other.state).all()
    assert one.slip == pytest.approx(other.slip, rel=1e-3, abs=1e-14)


def test_a_threshold_that_changes_states_leaves_none_proven():
    scene = make_scene((6, 6, 6), seeds=(1, 2))
    start, stop = initial_spin(scene, "linear"), StopRule(1e-10)
    assert solve(scene, InteriorPoint().build(), start, stop, slip_threshold=0.0).states_proven.all()
    assert not solve(scene, InteriorPoint().build(), start, stop, slip_threshold=0.05).states_proven.any()


def test_proven_states_obey_the_law_of_friction_at_every_contact():
    """In the staggered frame, by hand: slipping contacts oppose their slip with mu F_n, others hold with less."""
    scene = make_scene((12, 12, 12), seeds=(29,))
    method = InteriorPoint().build()
    solution = solve(scene, method, initial_spin(scene, "linear"), StopRule(1e-10))
    progress = method.progress()
    difference = contact_differences(progress.staggered, scene.lattice, progress.spin_axes)
    limit, size = scene.normal_force * scene.coefficient, np.sqrt((progress.force**2).sum(axis=0))
    slipping, slipless = solution.state == ContactState.SLIPPING, solution.state == ContactState.SLIPLESS
    assert size[slipping] == pytest.approx(limit[slipping], rel=1e-9)
    assert (size[slipless] < limit[slipless] * (1 - 1e-9)).all()
    fast = slipping & (solution.slip > 1e-9)  # slower ones are lost in the rounding of the spins
    along = (progress.force * difference).sum(axis=0)[fast]
    assert np.abs(along) == pytest.approx(size[fast] * np.sqrt((difference**2).sum(axis=0))[fast], rel=1e-6)
    assert (np.sign(along) == np.sign(along[0])).all()
    assert progress.largest_balance_residual[0] < 1e-10 * scene.normal_force
