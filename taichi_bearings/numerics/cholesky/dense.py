"""Eliminate the own unknowns of one front with LAPACK and BLAS, letting other threads run meanwhile.

SciPy exports the routines for use from compiled code (scipy.linalg.cython_blas); called through ctypes they release the
interpreter lock, so that independent fronts can be worked on side by side. The library's own threads are of no use
here: most fronts are small, and a thread that waits for a busy processor holds up every call.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from threading import Event
from typing import Any

from scipy.linalg import cython_blas, cython_lapack

from taichi_bearings.interrupts import look_up
from taichi_bearings.numerics.cholesky import tuning
from taichi_bearings.numerics.cholesky.layout import update_size


def _routine(module: object, name: str) -> Callable:
    capsule = module.__pyx_capi__[name]  # type: ignore[attr-defined]
    read_name, read_pointer = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    read_name.restype, read_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    read_pointer.restype, read_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return ctypes.CFUNCTYPE(None)(read_pointer(capsule, read_name(capsule)))


_dpotrf = _routine(cython_lapack, "dpotrf")
_dtrsm = _routine(cython_blas, "dtrsm")
_dsyrk = _routine(cython_blas, "dsyrk")
_dgemm = _routine(cython_blas, "dgemm")
_LEFT_OUT, _LOWER, _RIGHT, _TRANSPOSED = (ctypes.byref(ctypes.c_char(letter)) for letter in (b"N", b"L", b"R", b"T"))
_ONE, _MINUS_ONE = (ctypes.byref(ctypes.c_double(value)) for value in (1.0, -1.0))
_address = ctypes.c_void_p
DOUBLE_BYTES = 8  # bytes


@cache
def _count(number: int) -> Any:
    return ctypes.byref(ctypes.c_int(number))


@dataclass(frozen=True)
class Task:
    """work : True unless a pivot is not positive. Tasks are begun by urgency, then by turn: so panels of several fronts
    take turns, which wait for each other least, and what nothing waits for fills the end."""

    urgency: int
    turn: float
    work: Callable[[], bool]


Call = tuple[int | None, Callable, tuple]
"""The panel of the front that has to be done before, None where nothing is waited for; a routine; its arguments."""


class DenseFront:
    """Elimination of a front: of its own columns, and of the update of its border.

    Own columns are worked on in panels, too: each takes away what those before it have found, and is then divided. So
    several threads can share a front, and no call lasts long.
    """

    def __init__(self, own: int, border: int, height: int, pitch: int, columns: int, update: int) -> None:
        """height, pitch : numbers from one own column, and one of the update, to the next. columns, update : addresses
        of their diagonals. Only lower triangles count."""
        self.cost = own**3 / 3 + own**2 * border + own * border**2
        self._fault, self._stopped = ctypes.c_int(0), False
        firsts = range(0, own, tuning.PANEL_COLUMNS)
        self._panels = [_of_own(first, own, own + border - first, height, columns, self._fault) for first in firsts]
        self._sheets = []
        for first in range(0, border, tuning.SHEET_COLUMNS):
            left, place = columns + DOUBLE_BYTES * (own + first), update + DOUBLE_BYTES * update_size(first, pitch)
            self._sheets.append(_of_update(own, border - first, height, left, pitch - first, place))
        self._done = [Event() for _ in self._panels] if self.cost > tuning.SHARED_FRONT_OPERATIONS else []

    def tasks(self) -> list[Task]:
        """What eliminates the front. Any threads may share the tasks of fronts that are ready, if begun in order."""
        if not self._done:
            return [Task(2, -self.cost, lambda: all(map(self._work, self._panels + self._sheets)))]
        tasks = [Task(0, n, partial(self._work, calls, n)) for n, calls in enumerate(self._panels)]
        return tasks + [Task(1, -self.cost, partial(self._work, calls)) for calls in self._sheets]

    def get_ready(self) -> None:
        """Before the tasks are begun."""
        self._stopped = False
        for done in self._done:
            done.clear()

    def stop(self) -> None:
        """Let nobody wait for what does not come."""
        self._stopped = True
        for done in self._done:
            done.set()

    def _work(self, calls: list[Call], panel: int | None = None) -> bool:
        """Make these calls, which end a panel if one is given; False if a pivot is not positive."""
        for before, routine, arguments in calls:
            if self._done and before is not None:
                self._done[before].wait()
                look_up()
            if self._stopped:
                return False
            routine(*arguments)
            if self._fault.value:
                self.stop()
                return False
        if panel is not None:
            self._done[panel].set()
        return True


def _of_own(first: int, own: int, rows: int, height: int, columns: int, fault: ctypes.c_int) -> list[Call]:
    """Calls for the panel of own columns from `first` on, `rows` rows from its diagonal down: products with the panels
    before it, factorisation of its diagonal, division of what is below that.

    height : numbers from one column to the next. fault : what becomes of a pivot that is not positive."""
    width = min(tuning.PANEL_COLUMNS, own - first)
    corner = columns + DOUBLE_BYTES * first * (height + 1)
    ld, at = _count(height), _address(corner)
    calls: list[Call] = []
    for number, before in enumerate(range(0, first, tuning.PANEL_COLUMNS)):
        left = _address(columns + DOUBLE_BYTES * (before * height + first))
        calls.append((number, _dgemm, _product(rows, width, tuning.PANEL_COLUMNS, left, left, ld, at, ld)))
    calls.append((None, _dpotrf, (_LOWER, _count(width), at, ld, ctypes.byref(fault))))
    divide = (
        _RIGHT, _LOWER, _TRANSPOSED, _LEFT_OUT, _count(rows - width), _count(width), _ONE,
        at, ld, _address(corner + DOUBLE_BYTES * width), ld,
    )  # fmt: skip
    return [*calls, (None, _dtrsm, divide)] if rows > width else calls


def _of_update(own: int, rows: int, height: int, left: int, pitch: int, target: int) -> list[Call]:
    """Calls that take from a panel of the update what the own columns hold in its rows, from the address `left` on.

    height, pitch : numbers from one own column and one of the panel to the next."""
    width, ld, to = min(tuning.SHEET_COLUMNS, rows), _count(height), _address(target)
    square = (
        _LOWER, _LEFT_OUT, _count(width), _count(own), _MINUS_ONE, _address(left), ld, _ONE, to, _count(pitch)
    )  # fmt: skip
    if rows == width:
        return [(-1, _dsyrk, square)]
    below = _product(
        rows - width, width, own, _address(left + DOUBLE_BYTES * width), _address(left), ld,
        _address(target + DOUBLE_BYTES * width), _count(pitch),
    )  # fmt: skip
    return [(-1, _dsyrk, square), (None, _dgemm, below)]


def _product(rows: int, width: int, depth: int, left: Any, right: Any, ld: Any, target: Any, ld_target: Any) -> tuple:
    """target (rows, width) -= left (rows, depth) right (width, depth)^T."""
    return (
        _LEFT_OUT, _TRANSPOSED, _count(rows), _count(width), _count(depth), _MINUS_ONE, left, ld, right, ld, _ONE,
        target, ld_target,
    )  # fmt: skip
