"""Matrices factorised side by side: each as if it were alone, to the last bit, and each as SciPy solves it."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from taichi_bearings.conic.contact_system import stacked
from taichi_bearings.conic.matrices import NewtonMatrices
from taichi_bearings.numerics.cholesky import dissect
from tests.numerics.test_cholesky import SCENES, assembled, random_stiffness, system_of
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("taichi_runtime")


def matrices_of(options, leaf, samples=8, seed=4):
    """Matrices over a scene, stiffnesses (entries, samples), and their groups."""
    scene, rng = make_scene(**options), np.random.default_rng(seed)
    system = system_of(scene)
    stiffness = [random_stiffness(system, rng) for _ in range(samples)]
    matrices = NewtonMatrices(system, dissect(scene.lattice.free_shape, scene.minimum_spin_axes, leaf))
    right = rng.standard_normal((system.unknowns, samples))
    return system, matrices, stiffness, np.stack([stacked(k) for k in stiffness], axis=1), right


@pytest.mark.parametrize("leaf", [3, 20, 10_000])
@pytest.mark.parametrize("options", SCENES.values(), ids=SCENES)
def test_solutions_equal_those_of_scipy_and_those_of_each_alone(options, leaf):
    system, matrices, stiffness, entries, right = matrices_of(options, leaf)
    assert matrices.factorise_each(entries).all()
    together = matrices.solve_each(right)
    for sample in range(8):
        one = slice(sample, sample + 1)
        expected = spsolve(assembled(system, stiffness[sample]), right[:, sample])
        assert together[:, sample] == pytest.approx(expected, rel=1e-8, abs=1e-9 * abs(expected).max())
        assert matrices.factorise_each(entries[:, one]).all()
        assert (matrices.solve_each(right[:, one]) == together[:, one]).all()


def test_three_of_them_do_as_well_as_eight():
    _, matrices, _, entries, right = matrices_of(SCENES["two components"], 20)
    matrices.factorise_each(entries)
    eight = matrices.solve_each(right)
    matrices.factorise_each(entries[:, 3:6])
    assert (matrices.solve_each(right[:, 3:6]) == eight[:, 3:6]).all()


@pytest.mark.parametrize("fault", [0.0, np.nan, np.inf])
def test_what_is_singular_is_no_matter_to_the_others(fault):
    """A sphere that nothing holds, or numbers that are none: a raised diagonal mends neither."""
    _, matrices, _, entries, right = matrices_of(SCENES["two components"], 20)
    matrices.factorise_each(entries)
    sound = matrices.solve_each(right)
    entries[:, 5] = entries[:, 5] * fault
    regular = matrices.factorise_each(entries)
    assert regular.tolist() == [sample != 5 for sample in range(8)]
    assert (matrices.solve_each(right) == sound)[:, regular].all()


def test_springs_of_every_spin_count():
    system, matrices, stiffness, entries, right = matrices_of(SCENES["one component"], 20)
    assert matrices.factorise_each(entries, 0.3).all()
    solved = matrices.solve_each(right)
    for sample in range(8):
        left = assembled(system, stiffness[sample]) @ solved[:, sample] + 0.3 * solved[:, sample]
        assert left == pytest.approx(right[:, sample], abs=1e-8 * abs(right).max())
