"""Eliminates the own unknowns of one dense front with LAPACK and BLAS, on several threads.

A front is a dense symmetric matrix: rows of its own unknowns first, then rows of its border, the later unknowns that
they are coupled to. Elimination factorises the own columns and subtracts their product from the border's block, which
is called the update. Own columns are worked on in panels, the update in sheets, some columns at a time each.

SciPy exports the routines for use from compiled code (scipy.linalg.cython_blas). Called through ctypes they release the
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


def _routine(module: object, name: str) -> Callable[..., None]:
    """Return a routine of SciPy's compiled BLAS or LAPACK as a function of ctypes. module : cython_blas or
    cython_lapack.
    """
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
    """Return a whole number as Fortran wants it: a reference of ctypes to it."""
    return ctypes.byref(ctypes.c_int(number))


@dataclass(frozen=True)
class Task:
    """A piece of work on a front, that a thread can do.

    urgency, position : tasks are begun in order of urgency, then position, smallest first. Urgency 0: panels; 1: sheets
        of large fronts; 2: whole small fronts. Panels of several fronts so alternate and wait for each other least;
        tasks that nothing waits for fill the end.
    work : does the task; returns False if a pivot is not positive.
    """

    urgency: int
    position: float
    work: Callable[[], bool]


Call = tuple[int | None, Callable[..., None], tuple[Any, ...]]
"""A call of LAPACK or BLAS: the panel that has to be done before (-1 the last one, None none); routine; arguments."""


class DenseFront:
    """Elimination of one front, a dense symmetric matrix whose own unknowns come first and then the unknowns of its
    border: factorises the own columns, and subtracts their product from the update, the block of the border.

    Own columns are worked on in panels of some columns: each subtracts the product of the panels before it, and is then
    divided by its diagonal block. The update is worked on in sheets of some columns. So several threads can share a
    front, and no call lasts long.

    cost : operations of the elimination.
    """

    def __init__(self, own: int, border: int, height: int, pitch: int, columns: int, update: int) -> None:
        """Prepare the calls of LAPACK and BLAS; nothing is computed yet.

        own, border : numbers of own unknowns, and of unknowns of the border.
        height, pitch : distance from one own column, and from one column of the update, to the next, in doubles.
        columns, update : addresses of the first diagonal entry of the own columns, and of the update. Only lower
            triangles are used.
        """
        # `cost` counts operations; `_fault` is set by LAPACK at a pivot that is not positive
        self.cost = own**3 / 3 + own**2 * border + own * border**2
        self._fault, self._stopped = ctypes.c_int(0), False
        firsts = range(0, own, tuning.PANEL_COLUMNS)
        # calls by panel (some own columns) and by sheet (some columns of the update)
        self._panels = [
            _panel_calls(first, own, own + border - first, height, columns, self._fault) for first in firsts
        ]
        self._sheets = []
        for first in range(0, border, tuning.SHEET_COLUMNS):
            left, place = columns + DOUBLE_BYTES * (own + first), update + DOUBLE_BYTES * update_size(first, pitch)
            self._sheets.append(_sheet_calls(own, border - first, height, left, pitch - first, place))
        # events, set when the panel is complete; none for a small front, all of which is done by one thread
        self._done = [Event() for _ in self._panels] if self.cost > tuning.SHARED_FRONT_OPERATIONS else []

    def tasks(self) -> list[Task]:
        """Return the tasks that eliminate the front: a single one for a small front, else one for each panel of own
        columns and for each sheet of the update. Threads may share the tasks of several fronts, if they are begun in
        their order."""
        if not self._done:
            return [Task(2, -self.cost, lambda: all(map(self._work, self._panels + self._sheets)))]
        tasks = [Task(0, n, partial(self._work, calls, n)) for n, calls in enumerate(self._panels)]
        return tasks + [Task(1, -self.cost, partial(self._work, calls)) for calls in self._sheets]

    def get_ready(self) -> None:
        """Make the front ready to be eliminated again, before its tasks are begun: no panel counts as done."""
        self._stopped = False
        for done in self._done:
            done.clear()

    def stop(self) -> None:
        """Let no thread wait for panels that will never be done, because the elimination is given up."""
        self._stopped = True
        for done in self._done:
            done.set()

    def _work(self, calls: list[Call], panel: int | None = None) -> bool:
        """Make some calls of LAPACK and BLAS for this front, one after the other; return False if a pivot is not
        positive or the elimination was stopped.

        calls : tuples (panel whose completion to await: its number, -1 the last panel, None no wait; routine; its
            arguments). A panel is some of the front's own columns, those of the unknowns that are eliminated in it.
        panel : number of the panel that is complete after the calls, None if none is; its event is then set, which
            lets waiting calls go on.

        Raises GivenUp after a wait if the work is no longer wanted.
        """
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


def _panel_calls(first: int, own: int, rows: int, height: int, columns: int, fault: ctypes.c_int) -> list[Call]:
    """Return the calls that factorise a panel: some own columns of a front, from `first` on. They subtract products
    with the panels before it, factorise its diagonal block, and divide what is below by that.

    A front is a dense symmetric matrix: the columns of its own unknowns first, then those of the later unknowns that
    they are coupled to. Each call is a tuple: number of the panel that it waits for, or None; routine; arguments.

    own, rows : number of own columns, and of rows from the diagonal of this panel down.
    height : doubles from one column to the next.
    columns : address of the first diagonal entry of all own columns.
    fault : set by LAPACK where a pivot is not positive.
    """
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


def _sheet_calls(own: int, rows: int, height: int, left: int, pitch: int, target: int) -> list[Call]:
    """Return the calls that subtract the product of the own columns of a front from one sheet: some columns of its
    update.

    A front is a dense symmetric matrix: the columns of its own unknowns first, then those of the later unknowns that
    they are coupled to; the block of the later ones is the update. Each call is a tuple: number of the panel of own
    columns that it waits for, -1 for the last one, None for none; routine; arguments.

    own, rows : number of own columns, and of rows of the sheet.
    height, pitch : doubles from one own column, and from one column of the sheet, to the next.
    left, target : addresses of the sheet's first row in the own columns, and of the sheet.
    """
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


def _product(
    rows: int, width: int, depth: int, left: object, right: object, ld: object, target: object, ld_target: object
) -> tuple[Any, ...]:
    """Return the arguments of BLAS' `dgemm` for target (rows, width) -= left (rows, depth) right (width, depth)^T.

    left, right, target : addresses of the three matrices, stored column by column. ld, ld_target : distance from one
        column of left and right, and of target, to the next, in doubles.
    """
    return (
        _LEFT_OUT, _TRANSPOSED, _count(rows), _count(width), _count(depth), _MINUS_ONE, left, ld, right, ld, _ONE,
        target, ld_target,
    )  # fmt: skip
