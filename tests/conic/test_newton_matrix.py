"""What a Newton matrix does where rounding makes a pivot negative: its diagonal is raised, by as little as helps."""

import numpy as np
import pytest

import taichi_bearings.conic.last_decades as last_decades
from taichi_bearings.conic.last_decades import LastDecades
from taichi_bearings.conic.newton_matrix import DIAGONAL_SHIFTS, _factorise_raising
from taichi_bearings.numerics.cholesky import Factor


class Rounded(Factor):
    """Matrices of one number each, which are regular once it is raised enough.

    calls : the numbers (S,) at each factorisation.
    """

    def __init__(self, needed: list[float]) -> None:
        """Take for each of S matrices the share by which its number has to be raised."""
        self.entries, self.needed, self.calls = np.ones((1, len(needed))), np.array(needed), list[list[float]]()

    def factorise(self) -> np.ndarray:
        """Return a mask (S,) of the matrices that are raised enough."""
        self.calls.append(self.entries[0].tolist())
        return self.entries[0] >= 1 + self.needed

    def substitute(self) -> None:
        """Do nothing: no system is solved here."""


def raised(needed: list[float], first: int) -> tuple[Rounded, list[bool], int]:
    """Return the matrices after :func:`_factorise_raising`, which of them are regular, and what was tried last."""
    factor = Rounded(needed)
    regular, tried = _factorise_raising(factor, np.array([0]), np.ones(len(needed), dtype=bool), first)
    return factor, regular.tolist(), tried


def test_each_matrix_is_raised_by_as_little_as_helps() -> None:
    factor, regular, tried = raised([0.0, 1e-13, 1e-14], 0)
    assert factor.calls == [[1, 1, 1], [1, 1 + 1e-14, 1 + 1e-14], [1, 1 + 1e-12, 1 + 1e-14]]
    assert (regular, DIAGONAL_SHIFTS[tried]) == ([True, True, True], 1e-12)


def test_what_helped_before_is_tried_first() -> None:
    factor, regular, tried = raised([1e-13], DIAGONAL_SHIFTS.index(1e-12))
    assert (factor.calls, regular, DIAGONAL_SHIFTS[tried]) == ([[1 + 1e-12]], [True], 1e-12)


def test_a_matrix_that_nothing_helps_is_not_regular() -> None:
    factor, regular, _ = raised([0.0, 1.0], 0)
    assert (regular, len(factor.calls)) == ([True, False], len(DIAGONAL_SHIFTS))


def test_the_last_decades_go_on_with_what_helped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step whose matrix had to be raised is followed by steps that begin with that."""

    class Point:
        """A point of a path of one contact, whose product falls tenfold in a step."""

        friction, smooth, unbalanced, margin = np.ones(1), None, 0.0, np.ones(1)

        def __init__(self, product: float) -> None:
            """Take the product of slip and margin."""
            self.complementarity, self.slip_over_margin, self.difference = product, np.ones(1), np.full((1, 1), product)

        def let_slip(self, _: np.ndarray) -> "Point":
            """Return the point itself: its contact stays in its cone."""
            return self

    class Matrix:
        """A matrix that has to be raised from the third step on."""

        raised, begun = 0, list[int]()

    def step(point: Point, matrix: Matrix, first: int) -> Point:
        """Return the next point, and keep what the step began with."""
        matrix.begun.append(first)
        matrix.raised = max(first, int(len(matrix.begun) > 2))
        return Point(point.complementarity / 10)

    monkeypatch.setattr(last_decades, "newton_step", step)
    path, matrix = object.__new__(LastDecades), Matrix()
    path.point, path._matrix, path._raised = Point(1e-20), matrix, 0  # type: ignore[assignment]
    path._ratios, path._product = np.ones(1), np.inf
    with np.errstate(divide="ignore"):
        path.decide(to_the_end=True)
    assert matrix.begun[:5] == [0, 0, 0, 1, 1]
