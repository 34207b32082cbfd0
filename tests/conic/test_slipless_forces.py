"""What slipless contacts can bear, and what moves if they cannot: by hand, and in samples with slips below 1e-12."""

import numpy as np
import pytest

from taichi_bearings.conic import resolution
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.last_decades import LastDecades
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.shared import surroundings_of_lattice
from taichi_bearings.conic.slipless_forces import balanced_by_barrier, balanced_inside, nearly_borne
from taichi_bearings.lattice.incidence import contact_differences
from taichi_bearings.numerics.cholesky import Engine
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint, lattice_paths
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")
BOTTOM = TOP = -1


def chain(*contacts, unknowns=1):
    """Contacts (below, above, slip at rest) with one component each, over `unknowns` spins."""
    below, above, slip = np.array(contacts).T
    ends = np.stack([below, above]).astype(int)[:, None]
    return ContactSystem(unknowns, slip[None], np.ones_like(slip[None], bool), ends), np.arange(unknowns)


def borne(system, order, friction, dual, slipping, at_limit=None):
    """The dual of :func:`nearly_borne` and whether it will do, of one sample with one component."""
    never = np.zeros(len(friction), dtype=bool)
    values = (np.array(of) for of in (friction, [dual], slipping, never if at_limit is None else at_limit))
    heads = [np.zeros(system.unknowns, dtype=bool)]
    found, (inside,) = nearly_borne(system, NewtonMatrix(system, order), *values, heads)
    return found[0], inside


def pulled():
    """One sphere that two contacts hold to the bottom, while the third slips under the top."""
    return chain((BOTTOM, 0, 0.0), (BOTTOM, 0, 0.0), (0, TOP, 1.0))


@pytest.mark.parametrize("friction", [(0.4, 0.3, 0.5), (0.3, 0.2001, 0.5)], ids=["easily", "barely"])
def test_two_contacts_bear_what_a_third_pulls(friction):
    dual, inside = borne(*pulled(), friction, [-0.29, -0.19, -0.5], [False, False, True])
    assert inside
    assert dual[:2].sum() == pytest.approx(-0.5, abs=1e-11)
    assert (np.abs(dual[:2]) < friction[:2]).all()
    assert dual[2] == -0.5


@pytest.mark.parametrize("excess", [-1e-2, -1e-10, -1e-12, 0.0, 1e-12], ids=str)
def test_two_contacts_too_weak_for_it_or_at_their_limit_are_no_proof(excess):
    friction = (0.3, 0.2 + excess, 0.5)
    assert not borne(*pulled(), friction, [-0.29, -0.19, -0.5], [False, False, True])[1]


@pytest.mark.parametrize("beyond", [False, True])
def test_a_contact_at_its_limit_bears_its_friction_and_no_more(beyond):
    system = chain((BOTTOM, 0, 0.0), (BOTTOM, 0, 0.0), (BOTTOM, 0, 0.0), (0, TOP, 1.0))
    weak = 0.05 if beyond else 0.2
    friction, dual = (0.2, 0.3, weak, 0.5), [-0.2, -0.2, -0.05, -0.5]
    found, inside = borne(*system, friction, dual, [False] * 3 + [True], np.arange(4) == 0)
    assert inside != beyond
    assert beyond or found[0] == pytest.approx(-0.2, abs=1e-12)


def inside(system, friction, dual, slipping):
    """The forces of :func:`balanced_inside` of one sample with one component, None if there are none; and which
    contacts do not allow a whole step in a cluster in which no forces balance."""
    heads, order = np.zeros(system.unknowns, dtype=bool), np.arange(system.unknowns)[::-1]
    given = np.array(friction), np.array([dual]), np.array(slipping)
    found, allowed = balanced_inside(system, order, *given, heads)
    return found if found is None else found[0], np.flatnonzero(allowed < 1).tolist()


def side_by_side():
    """Two chains as in :func:`pulled`, of one sphere each, and a sphere that no slipless contact touches."""
    bottom = [(BOTTOM, n, 0.0) for n in (0, 0, 1, 1)]
    return chain(*bottom, (0, TOP, 1.0), (1, TOP, 1.0), unknowns=3)[0]


@pytest.mark.parametrize("start", [0.0, 0.299, -0.299])
def test_a_barrier_leads_to_balanced_forces_from_far_away(start):
    friction, slipping = (0.3, 0.2001, 0.3, 0.3, 0.5, 0.1), [False] * 4 + [True] * 2
    dual, overloaded = inside(side_by_side(), friction, [start, 0.0, start, 0.0, -0.5, -0.1], slipping)
    assert not overloaded
    assert (np.abs(dual[:4]) < friction[:4]).all()
    assert dual[:2].sum() == pytest.approx(-0.5, abs=1e-11)
    assert dual[2:4].sum() == pytest.approx(-0.1, abs=1e-11)
    assert tuple(dual[4:]) == (-0.5, -0.1)


@pytest.mark.parametrize("excess", [-1e-2, -1e-10, 0.0], ids=str)
def test_a_barrier_finds_no_forces_where_there_are_none(excess):
    friction, slipping = (0.3, 0.2 + excess, 0.3, 0.3, 0.5, 0.1), [False] * 4 + [True] * 2
    assert inside(side_by_side(), friction, [0.0, 0.0, 0.0, 0.0, -0.5, -0.1], slipping)[0] is None


@pytest.mark.parametrize(("second", "overloaded"), [(0.3, [0, 1]), (0.04, [0, 1, 2, 3])], ids=["one", "both"])
def test_contacts_are_overloaded_where_their_cluster_cannot_bear_what_others_pull(second, overloaded):
    friction, slipping = (0.3, 0.19, 0.04, second, 0.5, 0.1), [False] * 4 + [True] * 2
    assert inside(side_by_side(), friction, [0.0, 0.0, 0.0, 0.0, -0.5, -0.1], slipping) == (None, overloaded)


def by_barrier(second, wanted=(True, True)):
    """The forces of :func:`balanced_by_barrier` of two samples of :func:`pulled`, (2, contacts), and where they are
    found. The first sample is such that springs find no forces within friction.

    second : friction of the second contact in the second sample.
    wanted : mask of the samples whose forces are looked for.
    """
    system, order = pulled()
    friction, slipping = np.array([0.9, 1e-3, 0.5, 0.3, second, 0.5]), np.tile([False, False, True], 2)
    dual, heads = np.array([[-0.1, 0.9e-3, -0.5, -0.29, -0.19, -0.5]]), [np.zeros(1, dtype=bool)] * 2
    matrix = NewtonMatrix(system, order, engine=Engine.LAUNCH)
    given = system, matrix, friction, dual, slipping, heads, np.array(wanted)
    found, fine = balanced_by_barrier(*given)
    return found[0].reshape(2, -1), fine.tolist()


@pytest.mark.parametrize(("second", "enough"), [(0.3, True), (0.2001, True), (0.2, False), (0.1, False)])
def test_a_barrier_finds_the_forces_of_samples_side_by_side(second, enough):
    found, fine = by_barrier(second)
    assert fine == [True, enough]
    for dual, friction in ((found[0], (0.9, 1e-3)), (found[1], (0.3, second)))[: sum(fine)]:
        assert (np.abs(dual[:2]) < friction).all()
        assert dual[:2].sum() == pytest.approx(-0.5, abs=1e-11)
    assert (found[:, 2] == -0.5).all()


def test_what_a_barrier_finds_does_not_depend_on_other_samples():
    both, alone = by_barrier(0.3), by_barrier(0.3, (True, False))
    assert alone[1] == [True, False]
    assert (both[0][0] == alone[0][0]).all()
    assert (by_barrier(0.1)[0][0] == alone[0][0]).all()
    assert (alone[0][1] == [-0.29, -0.19, -0.5]).all()


def minimum_of(scene, start="linear"):
    return solve(scene, InteriorPoint().build(), initial_spin(scene, start), StopRule(1e-10))


HARD = [  # shape, seed, slipping contacts, order of the smallest slip: where the end of the central path tells wrongly
    ((12, 12, 12), 29, 1751, 1e-13),
    pytest.param((16, 16, 16), 1, 2992, 1e-11, marks=pytest.mark.thorough),
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


def test_states_are_proven_before_the_last_steps_of_the_path(monkeypatch):
    """Those cost as much as all that settling takes, and where no minima tie nothing is left for them to decide."""
    late = []
    monkeypatch.setattr(resolution, "_minimum_with_tied", lambda *given: late.append(given))
    solution = minimum_of(make_scene((12, 12, 12), seeds=(29,)))
    assert solution.states_proven[0]
    assert not late


@pytest.mark.parametrize("wrong", [0, 1, 3, 60])
def test_states_are_the_same_if_contacts_are_tied_before_the_last_decades(monkeypatch, wrong):
    """Also if some of them slip: then no forces balance near these, and the path is followed again with fewer tied."""
    scene, followed = make_scene((12, 12, 12), seeds=(29,)), []
    # from points with forces this path ends where all contacts that clearly stick can bear their forces
    monkeypatch.setattr(lattice_paths, "NEAR_PATH_UNKNOWNS", 3_000)
    tied, own = resolution._clearly_stick, LastDecades.decide
    one = minimum_of(scene)

    def with_more(iterate, before):
        slip = one.slip[0, iterate.system.contact]
        slowest = np.argsort(np.where(slip > 0, slip, np.inf))[:wrong]
        return tied(iterate, before) | np.isin(np.arange(len(slip)), slowest)

    def decide(path, *given):
        followed.append(len(path.point.friction))
        return own(path, *given)

    monkeypatch.setattr(resolution, "TIED_UNKNOWNS", 0)
    monkeypatch.setattr(resolution, "_clearly_stick", with_more)
    monkeypatch.setattr(LastDecades, "decide", decide)
    other = minimum_of(scene)
    assert other.states_proven[0]
    assert (one.state == other.state).all()
    assert one.objective == pytest.approx(other.objective, rel=1e-14)
    assert max(followed) < 0.8 * len(scene.coefficient[0])
    assert (len(followed) > 1) == (wrong > 0)


def test_where_contacts_that_are_tied_stay_overloaded_the_path_is_followed_with_all_of_them(monkeypatch):
    scene, followed, own = make_scene((12, 12, 12), seeds=(29,)), [], LastDecades.decide
    one = minimum_of(scene)

    def decide(path, *given):
        followed.append(len(path.point.friction))
        return own(path, *given)

    def unknown(system, order, friction, dual, slipping, heads):
        return None, np.full(len(friction), np.inf)

    monkeypatch.setattr(resolution, "TIED_UNKNOWNS", 0)
    monkeypatch.setattr(resolution, "balanced_inside", unknown)
    monkeypatch.setattr(LastDecades, "decide", decide)
    other = minimum_of(scene)
    assert (one.state == other.state).all()
    assert max(followed[:2]) < 0.8 * len(scene.coefficient[0]) < followed[2]


def test_samples_whose_forces_only_a_barrier_finds_are_settled_at_the_first_trial(monkeypatch):
    """Of 10^3 spheres, seed 1026: springs find no forces for the right states, and more steps along the path would."""
    scene = Scene.random((10, 10, 10), seed=1026)
    one = minimum_of(scene)
    monkeypatch.setattr(resolution, "balanced_by_barrier", lambda *given: (given[3], np.zeros(1, dtype=bool)))
    other = minimum_of(scene)
    assert one.states_proven[0]
    assert other.states_proven[0]
    assert (one.state == other.state).all()
    assert one.objective == pytest.approx(other.objective, rel=1e-14)
    assert one.own["iterations"][0] <= other.own["iterations"][0] - 2


def test_springs_of_a_large_lattice_fall_apart_into_planes():
    """They give the forces of the whole matrix at a small part of its operations."""
    scene = make_scene((17, 17, 17), seeds=(1,))
    top = scene.driving.top_in_units((0, 1))
    shared = surroundings_of_lattice(scene.lattice, (0, 1), top, small=False)
    system, count = shared.system, len(shared.system.contact)
    draw = np.random.default_rng(4711)
    friction, dual = draw.uniform(0.5, 1.0, count), 0.1 * draw.standard_normal(shared.system.offset.shape) * system.felt
    slipping, heads = np.zeros(count, dtype=bool), [np.zeros(system.unknowns, dtype=bool)]
    given = friction, dual, slipping, slipping, heads
    found, fine = nearly_borne(system, shared.springs, *given)
    whole, also_fine = nearly_borne(system, shared.matrix, *given)
    assert fine.all()
    assert also_fine.all()
    assert found == pytest.approx(whole, rel=1e-9, abs=1e-12)
    assert np.abs(system.torques(found)).max() < 1e-12
    operations = [matrix._choleskys[0].pattern.operations for matrix in (shared.springs, shared.matrix)]
    assert operations[0] < operations[1] / 20


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
