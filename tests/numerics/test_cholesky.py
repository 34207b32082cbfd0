"""The lattice factorisation against SciPy's sparse solver, on every kind of lattice and component."""

import weakref

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from taichi_bearings.conic.contact_system import lattice_system, stacked
from taichi_bearings.conic.grouped import Grouped
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.interrupts import GivenUp, while_wanted
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky import Engine, NotPositiveDefinite, dissect, factor, tuning
from taichi_bearings.numerics.cholesky.dense import DenseFront
from taichi_bearings.numerics.cholesky.fronts import analyse
from taichi_bearings.numerics.cholesky.layout import Layout, update_size
from taichi_bearings.runtime import Runtime
from tests.scenes import make_scene

SCENES = {
    "two components": {"shape": (6, 7, 8)},
    "one component": {"shape": (4, 9, 6), "direction": (0, 1, 0)},
    "two dimensions": {"shape": (13, 9)},
    "height of three": {"shape": (9, 8, 3)},
    "two wide": {"shape": (2, 2, 12)},
    "a single sphere high and two wide": {"shape": (2, 3, 3)},
}


def system_of(scene):
    return lattice_system(scene.lattice, scene.minimum_spin_axes, scene.top_spin(scene.minimum_spin_axes) / scene.jump)


def random_stiffness(system, rng):
    """Symmetric positive definite (d, d, n) a group, over six decades."""
    stiffness = []
    for group in system.groups:
        d, n = group.below.shape
        root = rng.standard_normal((d, d, n))
        stiffness.append(np.einsum("ikn,jkn->ijn", root, root) * 10 ** rng.uniform(-3, 3, n))
    return Grouped(stiffness)


def assembled(system, stiffness):
    """The same Laplacian by sparse products, D^T K D."""
    total = sparse.csr_matrix((system.unknowns,) * 2)
    for group, k in zip(system.groups, stiffness, strict=True):
        blocks = [[sparse.diags(k[i, j]) for j in range(len(k))] for i in range(len(k))]
        total = total + group.operator.T @ sparse.bmat(blocks) @ group.operator
    return total.tocsc()


def narrow_panels(monkeypatch, threads=1):
    """Fronts of many panels, all of them shared by so many threads."""
    for name, value in {
        "SHEET_COLUMNS": 8,
        "PANEL_COLUMNS": 4,
        "SHARED_FRONT_OPERATIONS": 0,
        "SHARED_BATCH_OPERATIONS": 0,
        "SHARED_ASSEMBLY_NUMBERS": 0,
        "ASSEMBLY_NUMBERS": 100,
        "GROVE_NUMBERS": 2000,
    }.items():
        monkeypatch.setattr(tuning, name, value)
    monkeypatch.setattr(factor.runtime, "current", lambda: Runtime("cpu", "f64", threads))


@pytest.mark.parametrize("leaf", [3, 40, 10_000])
@pytest.mark.parametrize("options", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("engine", Engine)
@pytest.mark.parametrize("narrow", [False, True])
def test_solutions_equal_those_of_scipy(monkeypatch, options, leaf, engine, narrow):
    if narrow:
        narrow_panels(monkeypatch)
    rng = np.random.default_rng(8)
    scene = make_scene(**options)
    system = system_of(scene)
    stiffness = random_stiffness(system, rng)
    order = dissect(scene.lattice, scene.minimum_spin_axes, leaf)
    matrix = NewtonMatrix(system, order, engine=engine)
    matrix.factorise(stiffness)
    right = rng.standard_normal(system.unknowns)
    expected = spsolve(assembled(system, stiffness), right)
    assert matrix.solve(right) == pytest.approx(expected, rel=1e-8, abs=1e-9 * abs(expected).max())


def test_a_small_system_is_one_dense_block():
    rng, scene = np.random.default_rng(4), make_scene(shape=(4, 4, 7))
    system = system_of(scene)
    stiffness, right = random_stiffness(system, rng), rng.standard_normal(system.unknowns)
    matrix = NewtonMatrix(system, np.arange(system.unknowns))
    matrix.factorise(stiffness, inertia=np.full(system.unknowns, 0.5))
    expected = spsolve(assembled(system, stiffness) + 0.5 * sparse.eye(system.unknowns, format="csc"), right)
    assert system.unknowns == 160
    assert Engine.quickest(system.unknowns) is Engine.BLOCK
    assert matrix.solve(right) == pytest.approx(expected, rel=1e-8, abs=1e-9 * abs(expected).max())
    with pytest.raises(NotPositiveDefinite):
        matrix.factorise(-stiffness)


@pytest.mark.parametrize("engine", Engine)
@pytest.mark.parametrize("shape", [(5, 6, 7), (2, 3, 3), (2, 2, 9)])
def test_three_components_with_a_spring_at_every_spin(shape, engine):
    """Contacts do not hold the mean about the height of a layer; the springs do."""
    rng = np.random.default_rng(2)
    scene = make_scene(shape)
    system = lattice_system(scene.lattice, (0, 1, 2), np.ones(3))
    stiffness = random_stiffness(system, rng)
    matrix = NewtonMatrix(system, dissect(scene.lattice, (0, 1, 2), 30), engine=engine)
    matrix.factorise(stiffness, 0.3)
    right = rng.standard_normal(system.unknowns)
    expected = spsolve(assembled(system, stiffness) + 0.3 * sparse.identity(system.unknowns, format="csc"), right)
    assert matrix.solve(right) == pytest.approx(expected, rel=1e-8, abs=1e-9 * abs(expected).max())


@pytest.mark.parametrize("engine", Engine)
def test_a_second_factorisation_leaves_nothing_of_the_first(engine):
    rng = np.random.default_rng(3)
    scene = make_scene((5, 6, 7))
    system = system_of(scene)
    order = dissect(scene.lattice, scene.minimum_spin_axes, 30)
    first, second = random_stiffness(system, rng), random_stiffness(system, rng)
    right = rng.standard_normal(system.unknowns)
    used, fresh = (NewtonMatrix(system, order, engine=engine) for _ in range(2))
    used.factorise(first)
    used.solve(right)
    used.factorise(second)
    fresh.factorise(second)
    assert (used.solve(right) == fresh.solve(right)).all()


@pytest.mark.parametrize("price", [tuning.LAUNCH_PRICE, tuning.CALLS_PRICE])
def test_every_unknown_is_eliminated_once_and_separators_separate(price):
    scene = make_scene((7, 6, 8))
    system = system_of(scene)
    pattern = analyse(dissect(scene.lattice, scene.minimum_spin_axes, 20), *system.couplings(), price)
    assert sorted(pattern.order) == list(range(system.unknowns))
    owner = np.repeat(np.arange(len(pattern.own)), pattern.own)
    ancestors = {}
    for number in range(len(pattern.own)):
        chain, at = {number}, number
        while pattern.parent[at] >= 0:
            at = pattern.parent[at]
            chain.add(at)
        ancestors[number] = chain
    for a, b in zip(*(owner[pattern.place[ends]] for ends in system.couplings()), strict=True):
        assert a in ancestors[b] or b in ancestors[a]


def test_the_middle_plane_separates_with_one_component_alone():
    """Contacts along y do not feel the component along y: half an ordinary separator."""
    last = dissect(Lattice((32, 32, 32)), (0, 1))[-32 * 30 :]
    x, y, component = last // 2 // 30 // 32, last // 2 // 30 % 32, last % 2
    assert len(set(component.tolist())) == 1
    assert len({(x, y)[1 - c][n] for n, c in enumerate(component.tolist())}) == 1


@pytest.mark.parametrize("engine", Engine)
def test_an_indefinite_matrix_is_refused(engine):
    scene = make_scene((4, 4, 5))
    system = system_of(scene)
    matrix = NewtonMatrix(system, dissect(scene.lattice, scene.minimum_spin_axes), engine=engine)
    with pytest.raises(NotPositiveDefinite):
        matrix.factorise(-random_stiffness(system, np.random.default_rng(0)))


def test_stacked_stiffnesses_reach_the_entries_they_belong_to():
    scene = make_scene((3, 4, 5))
    system = system_of(scene)
    stiffness = random_stiffness(system, np.random.default_rng(5))
    pattern = analyse(dissect(scene.lattice, (0, 1), 10), *system.couplings(), tuning.LAUNCH_PRICE)
    first, second, source, sign = system.terms()
    values = np.bincount(pattern.entry(first, second), stacked(stiffness)[source] * sign, pattern.entries)
    expected = assembled(system, stiffness)
    assert values == pytest.approx(np.asarray(expected[pattern.order[pattern.row], pattern.order[pattern.column]])[0])


def random_system(shape=(6, 7, 8), leaf=20, memory=None):
    scene = make_scene(shape)
    system = system_of(scene)
    order = dissect(scene.lattice, scene.minimum_spin_axes, leaf)
    matrix = NewtonMatrix(system, order, memory, Engine.CALLS)
    return matrix, random_stiffness(system, np.random.default_rng(4)), np.ones(system.unknowns)


def test_threads_that_share_fronts_leave_the_bits_as_they_are(monkeypatch):
    solutions = []
    for threads in (1, 2, 2, 5):
        narrow_panels(monkeypatch, threads)
        matrix, stiffness, right = random_system()
        matrix.factorise(stiffness)
        solutions.append(matrix.solve(right))
    assert all((solution == solutions[0]).all() for solution in solutions)


def test_threads_that_share_a_front_hear_of_a_pivot_that_is_not_positive(monkeypatch):
    narrow_panels(monkeypatch, 3)
    matrix, stiffness, right = random_system()
    matrix.factorise(stiffness)
    expected = matrix.solve(right)
    with pytest.raises(NotPositiveDefinite):
        matrix.factorise(-stiffness)
    matrix.factorise(stiffness)
    assert (matrix.solve(right) == expected).all()


@pytest.mark.parametrize("looks", [0, 3, 30])
def test_a_factorisation_given_up_amid_a_shared_front_ends_and_the_next_is_whole(monkeypatch, looks):
    narrow_panels(monkeypatch, 3)
    matrix, stiffness, right = random_system()
    matrix.factorise(stiffness)
    expected, left = matrix.solve(right), iter(range(looks))
    with pytest.raises(GivenUp), while_wanted(lambda: next(left, None) is None):
        matrix.factorise(stiffness)
    matrix.factorise(stiffness)
    assert (matrix.solve(right) == expected).all()


def test_no_call_on_a_shared_front_takes_a_tenth_of_its_work():
    """Of the largest front at 64^3, 21 Gflop: so interrupts are heard, and threads have something to share."""
    front = DenseFront(3968, 0, 3968, 0, 0, 0)
    assert len(front.tasks()) == 62
    calls = [2 * n.value * m.value * k.value for _, _, m, n, k in products_of(front)]
    assert sum(calls) > 0.9 * front.cost
    assert max(calls) < 0.02 * front.cost


def products_of(front):
    for panel in front._own:
        for product in panel.products:
            yield tuple(argument._obj for argument in product[:5])


def pattern_of(free_shape):
    scene = make_scene((*free_shape[:2], free_shape[2] + 2))
    return analyse(dissect(scene.lattice, (0, 1)), *system_of(scene).couplings(), tuning.CALLS_PRICE)


@pytest.mark.parametrize(("grove", "unit", "apart"), [(0, 1, True), (3000, 1, True), (10**9, 1, True), (0, 8, False)])
def test_no_update_lies_where_another_waits_to_be_used(monkeypatch, grove, unit, apart):
    monkeypatch.setattr(tuning, "GROVE_NUMBERS", grove)
    pattern = pattern_of((9, 10, 11))
    layout, waiting = Layout(pattern, unit, apart), {}
    size = update_size(layout.border, layout.update_height)
    batches = [batch.fronts for batch in layout.batches] if apart else np.arange(len(size))[:, None]
    for members in batches:
        children = set(np.flatnonzero(np.isin(pattern.parent, members)).tolist())
        assert children <= set(waiting)
        waiting.update((int(n), (layout.update[n], layout.update[n] + size[n])) for n in members)
        ends = [layout.columns[-1], *np.ravel(sorted(waiting.values())), layout.size]
        assert (np.diff(ends) >= 0).all()
        for child in children:
            del waiting[child]
    assert len(waiting) == 1


def test_few_updates_wait_at_a_time(monkeypatch):
    """At 32^3: 16 million numbers of the factor, and 34 of all updates."""
    pattern = pattern_of((32, 32, 30))
    assert pattern.factor_entries == 16_374_710
    assert update_size(pattern.width, pattern.width).sum() > 33_000_000
    assert Layout(pattern, apart=True).size < 16_374_710 + 17_000_000
    monkeypatch.setattr(tuning, "GROVE_NUMBERS", 4_000_000)  # as large as that of 64^3 is for the 40 million
    assert Layout(pattern, apart=True).size < 16_374_710 + 6_000_000


def test_a_factor_that_is_forgotten_gives_its_memory_back(monkeypatch):
    monkeypatch.setattr(tuning, "LARGE_FACTOR_NUMBERS", 0)
    matrix, stiffness, right = random_system()
    matrix.compile()  # the compiler keeps what a kernel is first started with
    matrix.factorise(stiffness)
    expected, reals = matrix.solve(right), weakref.ref(numbers_of(matrix))
    matrix.forget()
    assert reals() is None
    matrix.factorise(stiffness)
    assert (matrix.solve(right) == expected).all()


def numbers_of(matrix):
    return matrix._choleskys[0].factor()._numbers


def test_matrices_that_share_memory_take_it_from_each_other():
    """The large one first: there is room for the small one in what it has, and nothing else is asked for."""
    alone = [random_system(shape) for shape in ((6, 7, 8), (4, 5, 5))]
    expected = []
    for matrix, stiffness, right in alone:
        matrix.factorise(stiffness)
        expected.append(matrix.solve(right))
    large = random_system()[0]
    small = random_system((4, 5, 5), memory=large.memory)[0]
    for _ in range(2):
        for matrix, other, (_, stiffness, right), solution in zip(
            (large, small), (small, large), alone, expected, strict=True
        ):
            matrix.factorise(stiffness)
            assert (matrix.solve(right) == solution).all()
            assert numbers_of(matrix) is numbers_of(large)
            with pytest.raises(AssertionError):
                other.solve(np.ones(other._system.unknowns))


def test_a_matrix_that_needs_more_memory_than_another_had_gets_it():
    small = random_system((4, 5, 5))
    large = random_system(memory=small[0].memory)
    solutions = []
    for matrix, stiffness, right in (small, large, small):
        matrix.factorise(stiffness)
        solutions.append(matrix.solve(right))
    assert (solutions[0] == solutions[2]).all()
    for (matrix, stiffness, right), solution in zip((small, large), solutions, strict=False):
        matrix.factorise(stiffness)
        assert (matrix.solve(right) == solution).all()
