"""Matrices factorised side by side: each as if it were alone, to the last bit, and each as SciPy solves it."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.kernels import central_path as kernels
from taichi_bearings.numerics.cholesky import Engine, dissect
from tests.numerics.test_cholesky import SCENES, assembled, random_stiffness, system_of
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("taichi_runtime")


def matrices_of(options, leaf, samples=8, seed=4):
    """Matrices over a scene, stiffnesses of the samples, and right-hand sides."""
    scene, rng = make_scene(**options), np.random.default_rng(seed)
    system = system_of(scene)
    stiffness = [random_stiffness(system, rng) for _ in range(samples)]
    order = dissect(scene.lattice, scene.minimum_spin_axes, leaf)
    matrices = NewtonMatrix(system, order, engine=Engine.LAUNCH)
    return system, matrices, stiffness, rng.standard_normal((system.unknowns, samples))


def solved(matrices, stiffness, right, inertia=0.0):
    """Which samples are regular, and solutions (unknowns, S)."""
    rows, count = matrices.rows(1 if len(stiffness) == 1 else 8), len(stiffness)
    for sample, of_sample in enumerate(stiffness):
        rows.put(kernels.STIFFNESS, sample, of_sample[np.triu_indices(len(of_sample))])
    regular = matrices.factorise_rows(rows, np.arange(rows.samples) < count, inertia)
    assert not regular[count:].any()
    rows.spins[rows.place, :count] = right
    matrices.solve_rows(rows)
    return regular[:count], rows.spins[rows.place, :count].copy()


@pytest.mark.parametrize("leaf", [3, 20, 10_000])
@pytest.mark.parametrize("options", SCENES.values(), ids=SCENES)
def test_solutions_equal_those_of_scipy_and_those_of_each_alone(options, leaf):
    system, matrices, stiffness, right = matrices_of(options, leaf)
    regular, together = solved(matrices, stiffness, right)
    assert regular.all()
    for sample in range(8):
        one = slice(sample, sample + 1)
        expected = spsolve(assembled(system, stiffness[sample]), right[:, sample])
        assert together[:, sample] == pytest.approx(expected, rel=1e-8, abs=1e-9 * abs(expected).max())
        regular, alone = solved(matrices, stiffness[one], right[:, one])
        assert regular.all()
        assert (alone == together[:, one]).all()


def test_three_of_them_do_as_well_as_eight():
    _, matrices, stiffness, right = matrices_of(SCENES["two components"], 20)
    _, eight = solved(matrices, stiffness, right)
    _, three = solved(matrices, stiffness[3:6], right[:, 3:6])
    assert (three == eight[:, 3:6]).all()


@pytest.mark.parametrize("fault", [0.0, np.nan, np.inf])
def test_what_is_singular_is_no_matter_to_the_others(fault):
    """A sphere that nothing holds, or numbers that are none: a raised diagonal mends neither."""
    _, matrices, stiffness, right = matrices_of(SCENES["two components"], 20)
    _, sound = solved(matrices, stiffness, right)
    stiffness[5] = stiffness[5] * fault
    regular, found = solved(matrices, stiffness, right)
    assert regular.tolist() == [sample != 5 for sample in range(8)]
    assert (found == sound)[:, regular].all()


def test_springs_of_every_spin_count():
    system, matrices, stiffness, right = matrices_of(SCENES["one component"], 20)
    regular, found = solved(matrices, stiffness, right, 0.3)
    assert regular.all()
    for sample in range(8):
        left = assembled(system, stiffness[sample]) @ found[:, sample] + 0.3 * found[:, sample]
        assert left == pytest.approx(right[:, sample], abs=1e-8 * abs(right).max())
