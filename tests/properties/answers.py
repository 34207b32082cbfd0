"""Answers of methods, and what may be said of any two of them."""

from fractions import Fraction

from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import fastest

TOLERANCE = 1e-10
NEAREST = Fraction(1, 2**52)  # relative: two roundings of a double
LIMITS = {"rigid-limit": 15, "interior-point": 200}
ENOUGH = 300  # iterations of the other methods, if they are named: a proof must hold wherever they end


def answer_of(scene, method=None, start="linear"):
    """By some steps of the method of this name, else to the end by the one that `auto` takes."""
    row = METHODS[method] if method else fastest(scene, TOLERANCE, on_gpu=False)
    iterations = LIMITS.get(method, ENOUGH) if method else 20_000
    return solve(scene, row().build(), initial_spin(scene, start), StopRule(TOLERANCE, iterations))


def laws_of(method):
    return tuple(name for name, law in LAWS.items() if METHODS[method].solves(law))


def methods_of(scene):
    return [name for name, row in METHODS.items() if not row.refusal(scene)]


def between(answer, factor=1, replica=0):
    """Where an answer says that the least objective lies, times a factor; exact."""
    lower, upper = Fraction(answer.lower_bound[replica]), Fraction(answer.objective[replica]) * (1 + NEAREST)
    return lower * Fraction(factor), upper * Fraction(factor)


def assert_meet(first, second):
    """Two enclosures of one number."""
    assert first[0] <= second[1], float(first[0] / second[1] - 1)
    assert second[0] <= first[1], float(second[0] / first[1] - 1)
