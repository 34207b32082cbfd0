"""Every method of the table that says it solves a scene, against the others: what any agreement test asks."""

from taichi_bearings import runtime
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule

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
