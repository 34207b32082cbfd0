"""The lattice factorisation against SciPy's sparse solver, on every kind of lattice and component."""

import platform
import subprocess
import sys
from queue import SimpleQueue

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from taichi_bearings.conic.contact_system import lattice_system
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.interrupts import GivenUp, while_wanted
from taichi_bearings.numerics.cholesky import Engine, NotPositiveDefinite, dissect, factor, tuning
from taichi_bearings.numerics.cholesky.fronts import analyse
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
    """Symmetric positive definite (d, d, n), over six decades."""
    d, n = system.offset.shape
    root = rng.standard_normal((d, d, n))
    return np.einsum("ikn,jkn->ijn", root, root) * 10 ** rng.uniform(-3, 3, n)


def assembled(system, stiffness):
    """The same Laplacian by sparse products, D^T K D."""
    blocks = sparse.bmat([[sparse.diags(of) for of in row] for row in stiffness])
    return (system.operator.T @ blocks @ system.operator).tocsc()


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
        "BRANCH_OPERATIONS": 3000,
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
    pattern = analyse(dissect(scene.lattice, scene.minimum_spin_axes, 20), *system.terms()[:2], price)
    assert sorted(pattern.order) == list(range(system.unknowns))
    owner = np.repeat(np.arange(len(pattern.own)), pattern.own)
    ancestors = {}
    for number in range(len(pattern.own)):
        chain, at = {number}, number
        while pattern.parent[at] >= 0:
            at = pattern.parent[at]
            chain.add(at)
        ancestors[number] = chain
    for a, b in zip(*(owner[pattern.place[ends]] for ends in system.terms()[:2]), strict=True):
        assert a in ancestors[b] or b in ancestors[a]


@pytest.mark.parametrize("engine", Engine)
def test_an_indefinite_matrix_is_refused(engine):
    scene = make_scene((4, 4, 5))
    system = system_of(scene)
    matrix = NewtonMatrix(system, dissect(scene.lattice, scene.minimum_spin_axes), engine=engine)
    with pytest.raises(NotPositiveDefinite):
        matrix.factorise(-random_stiffness(system, np.random.default_rng(0)))


@pytest.mark.parametrize("threads", [1, 2])
def test_one_negative_pivot_is_refused_wherever_it_is(monkeypatch, threads):
    """In branches and in fronts above them, also where nothing is coupled to the unknown any more."""
    narrow_panels(monkeypatch, threads)
    matrix, stiffness, right = random_system((4, 5, 6))
    matrix.factorise(stiffness)
    expected, order = matrix.solve(right), matrix._choleskys[0].pattern.order
    for unknown in [*order[::7].tolist(), order[-1]]:
        with pytest.raises(NotPositiveDefinite):
            matrix.factorise(stiffness, np.where(np.arange(len(order)) == unknown, -1e9, 0.0))
    matrix.factorise(stiffness)
    assert (matrix.solve(right) == expected).all()


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


@pytest.mark.parametrize(("threads", "asked"), [(1, 0), (2, 1)])
def test_memory_of_a_large_factor_is_provided_before_it_is_needed_if_there_are_several_threads(
    monkeypatch, threads, asked
):
    narrow_panels(monkeypatch, threads)
    matrix, stiffness, right = random_system()
    matrix.factorise(stiffness)
    expected, provided = matrix.solve(right), SimpleQueue()
    monkeypatch.setattr(factor, "provide", provided.put)
    matrix, *_ = random_system()
    matrix.reserve()
    arrays = [provided.get(timeout=60) for _ in range(asked)]
    matrix.factorise(stiffness)
    assert all(numbers is matrix._choleskys[0].factor()._numbers for numbers in arrays)
    assert provided.empty()
    assert (matrix.solve(right) == expected).all()


PROVIDED = """
import resource
import numpy as np
from taichi_bearings.memory import provide
numbers = np.zeros(400_000)  # less than NumPy asks large pages for
numbers[::1000] = 3.0
before = numbers.copy()
provide(numbers)
assert (numbers == before).all()
first = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
numbers[:] = 2.0
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - first)
"""


@pytest.mark.skipif(
    sys.platform != "linux" or tuple(map(int, platform.release().split(".")[:2])) < (5, 14),
    reason="Linux provides memory on request from 5.14 on",
)
def test_memory_that_was_provided_keeps_its_numbers_and_causes_no_page_faults():
    """3.2 MB are 780 pages."""
    found = subprocess.run([sys.executable, "-c", PROVIDED], capture_output=True, check=True)
    assert int(found.stdout) < 20
