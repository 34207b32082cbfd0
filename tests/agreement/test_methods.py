"""The table of methods on small scenes: each against the least that the others reach, and by its own proof."""

from dataclasses import replace

import pytest

from taichi_bearings import memory, runtime
from taichi_bearings.errors import InputError
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import fastest
from tests.own_laws import PowerLaw

CLOSE = 1e-4  # relative gap that every method proves on a small scene


def answers_of(scene):
    """The solution by each method, at its default options, that does not refuse the scene."""
    on_gpu = runtime.current().is_gpu
    rows = [row for row in METHODS.values() if not row.refusal(scene) and not (row.cpu_only and on_gpu)]
    start = initial_spin(scene, "linear")
    return {row.name: solve(scene, row().build(), start, StopRule(CLOSE, 300_000)) for row in rows}


def assert_agreement(scene):
    """All proofs are below the least that any method reached, and every method is that close to it."""
    answers = answers_of(scene)
    least = min(answer.objective[0] for answer in answers.values())
    for name, answer in answers.items():
        assert answer.status.reached, f"{name}: {answer.status}"
        assert answer.gap[0] <= CLOSE, name
        assert answer.lower_bound[0] <= least * (1 + 1e-12), name
        assert answer.objective[0] <= least * (1 + 1.1 * CLOSE), name
    return answers


DRIVINGS = {
    "discs, rotating bottom": {"shape": (3, 6), "spin_bottom": -0.4},
    "spheres about x": {"shape": (3, 2, 4), "direction": (1, 0, 0), "spin_bottom": 0.3},
    "spheres about an odd axis": {"shape": (2, 3, 4), "direction": (1, -2, 3)},
}
LEAST_METHODS = {"coulomb": 5, "viscous": 4, "coulomb-viscous": 3}


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize(
    ("law", "driving"),
    [
        (law, driving)
        for law in LAWS
        for driving in DRIVINGS
        if law == "coulomb" or driving.split()[-1] in ("bottom", "axis")
    ],
)
def test_every_method_agrees_with_the_others(law, driving):
    answers = assert_agreement(Scene.random(law=law, seed=4711, **DRIVINGS[driving]))
    assert len(answers) >= LEAST_METHODS[law]


def test_every_method_solves_some_law_and_names_itself():
    for name, row in METHODS.items():
        assert row.name == name
        assert any(row.solves(law) for law in LAWS.values())
        assert row().build().options == row()


def test_a_gpu_splits_friction_and_descends_where_that_flows_too():
    assert fastest(Scene.random((3, 4, 5)), 1e-8, on_gpu=True).name == "operator-splitting"
    assert fastest(Scene.random((3, 4, 5), direction=(1, 0, 0)), 1e-8, on_gpu=True).name == "planar-cut"
    assert fastest(Scene.random((3, 4, 5), law="coulomb-viscous"), 1e-8, on_gpu=True).name == "gradient-descent"


@pytest.mark.parametrize(
    ("side", "tolerance", "gigabytes", "name"),
    [
        (48, 1e-8, 1, "interior-point"),
        (48, 1e-4, 100, "operator-splitting"),
        (64, 1e-8, 100, "interior-point"),
        (64, 1e-8, 2, "operator-splitting"),  # the factor alone takes 3 GB
        (64, 1e-6, 100, "operator-splitting"),
        (112, 1e-8, 1e6, "operator-splitting"),  # more numbers than 32 bits can count
    ],
)
def test_large_lattices_are_factorised_where_memory_allows(monkeypatch, side, tolerance, gigabytes, name):
    monkeypatch.setattr(memory, "free_bytes", lambda: 1e9 * gigabytes)
    assert fastest(Scene.random((side, side, side)), tolerance, on_gpu=False).name == name


def test_no_method_takes_a_law_that_it_is_not_made_for():
    # its force is known to no method here
    cubic = PowerLaw("cubic", LAWS["viscous"].quantities, minimises="potential")
    assert [name for name, row in METHODS.items() if row.solves(cubic)] == []
    scene = replace(Scene.random((3, 4), law="viscous"), law=cubic)
    with pytest.raises(InputError, match="law is 'cubic'; auto knows no method for this law"):
        fastest(scene, 1e-8, on_gpu=False)
