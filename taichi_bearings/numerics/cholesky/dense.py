"""Eliminates the own unknowns of dense fronts with LAPACK and BLAS, on several threads.

A front is a dense symmetric matrix: rows of its own unknowns first, then rows of its border, the later unknowns that
they are coupled to. Elimination factorises the own columns and subtracts their product from the border's block, which
is called the update. Own columns are divided into panels, the update into sheets, each of some columns.

SciPy exports the routines for use from compiled code (scipy.linalg.cython_blas). Called through ctypes they release the
interpreter lock, so that several threads can eliminate independent fronts at the same time. The library's own threads
are of no use here: most fronts are small, and a thread that waits for a busy processor delays every call.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from threading import Event
from typing import Any

from taichi_bearings.interrupts import look_up
from taichi_bearings.numerics.blas import COMPILED_BLAS, COMPILED_LAPACK
from taichi_bearings.numerics.cholesky import tuning
from taichi_bearings.numerics.cholesky.layout import begin_of_column, size_in_panels


@cache
def _routine(name: str) -> Callable[..., None]:
    """Return a routine of SciPy's compiled LAPACK ("dpotrf") or BLAS (any other name, such as "dgemm") as a function of
    ctypes."""
    capsule = (COMPILED_LAPACK if name == "dpotrf" else COMPILED_BLAS).__pyx_capi__[name]
    read_name, read_pointer = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    read_name.restype, read_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    read_pointer.restype, read_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return ctypes.CFUNCTYPE(None)(read_pointer(capsule, read_name(capsule)))


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
    """A piece of work on a front (a dense block of the sparse matrix) that one thread can do.

    urgency : 0 for a panel (some own columns of a large front), 1 for a sheet (some columns of its update, the block of
        later unknowns), 2 for a whole small front. Tasks with the smallest number are begun first.
    position : order of tasks of the same urgency, smallest first. For a panel its number in the front, so that the
        panels of several fronts alternate; otherwise minus the operations of its front, so that the largest come first.
    work : does the task; returns False if a pivot is not positive or the elimination was stopped.

    Panels come first since other tasks wait for them; small fronts come last since no task waits for them.
    """

    urgency: int
    position: float
    work: Callable[[], bool]


Call = tuple[int | None, Callable[..., None], tuple[Any, ...]]
"""A call of LAPACK or BLAS on a front: number of the panel (group of own columns) that has to be complete before it, -1
for the last panel, None for no wait; the routine; its arguments."""


class DenseFront:
    """Elimination of one front, a dense symmetric matrix whose own unknowns come first and then the unknowns of its
    border: factorises the own columns, and subtracts their product from the update, the block of the border.

    Own columns are divided into panels of some columns: the product of the panels before it is subtracted from each,
    which is then divided by its diagonal block. The update is divided into sheets of some columns. So several threads
    can share a front, and no call lasts long.

    cost : operations of the elimination.
    """

    def __init__(self, own: int, border: int, height: int, pitch: int, columns: int, update: int) -> None:
        """Prepare the calls of LAPACK and BLAS; nothing is computed yet.

        own : number of own unknowns, which are eliminated in this front.
        border : number of later unknowns that they are coupled to.
        height : doubles from one own column to the next in the first SHEET_COLUMNS columns; fewer in later ones.
        pitch : doubles from one column of the update (the block of the border) to the next in its first sheet.
        columns : address of the first diagonal entry of the own columns; only their lower triangle is used.
        update : address of the first diagonal entry of the update; only its lower triangle is used.
        """
        # `_fault` : set by LAPACK to a number other than 0 at a pivot that is not positive
        # `_stopped` : True once the elimination is given up
        self.cost = own**3 / 3 + own**2 * border + own * border**2
        self._fault, self._stopped = ctypes.c_int(0), False
        firsts = range(0, own, tuning.PANEL_COLUMNS)
        # `_panels` : for each panel (PANEL_COLUMNS own columns) the calls that factorise it
        # `_sheets` : for each sheet (SHEET_COLUMNS columns of the update) the calls that subtract from it
        self._panels = [
            _panel_calls(first, own, own + border - first, height, columns, self._fault) for first in firsts
        ]
        self._sheets = []
        for first in range(0, border, tuning.SHEET_COLUMNS):
            place = update + DOUBLE_BYTES * size_in_panels(first, pitch, tuning.SHEET_COLUMNS)
            self._sheets.append(_sheet_calls(own, border - first, own + first, height, columns, pitch - first, place))
        # `_done` : for each panel an event that is set when it is complete; empty for a small front, all of which is
        # done by one thread
        self._done = [Event() for _ in self._panels] if self.cost > tuning.SHARED_FRONT_OPERATIONS else []

    def tasks(self) -> list[Task]:
        """Return the tasks that eliminate the front: a single one for a small front, else one for each panel (some own
        columns) and one for each sheet (some columns of the update, the block of the later unknowns).

        Threads may share the tasks of several fronts, if the tasks are begun in the order of urgency and position.
        """
        if not self._done:
            return [Task(2, -self.cost, lambda: all(map(self._work, self._panels + self._sheets)))]
        tasks = [Task(0, n, partial(self._work, calls, n)) for n, calls in enumerate(self._panels)]
        return tasks + [Task(1, -self.cost, partial(self._work, calls)) for calls in self._sheets]

    def get_ready(self) -> None:
        """Prepare a further elimination, before its tasks are begun: no panel (group of own columns) counts as done."""
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
    """Return the calls that factorise one panel, up to PANEL_COLUMNS own columns of a front: they subtract products
    with the panels before it, factorise its diagonal block, and divide the rows below by that block.

    A front is a dense symmetric matrix: the columns of its own unknowns first, then those of the later unknowns that
    they are coupled to. Each call is a tuple: number of the panel that it waits for, or None; routine; arguments.

    first : number of the panel's first column in the front.
    own : number of own columns of the front.
    rows : number of rows from the panel's first diagonal entry down.
    height : doubles from one own column to the next in the first SHEET_COLUMNS columns; fewer in later ones.
    columns : address of the first diagonal entry of all own columns.
    fault : set by LAPACK where a pivot is not positive.
    """
    width = min(tuning.PANEL_COLUMNS, own - first)
    corner, pitch = _entry(first, first, height, columns)
    ld, at = _count(pitch), _address(corner)
    calls: list[Call] = []
    for number, before in enumerate(range(0, first, tuning.PANEL_COLUMNS)):
        start, pitch = _entry(first, before, height, columns)
        left, ld_left = _address(start), _count(pitch)
        calls.append(
            (number, _routine("dgemm"), _product(rows, width, tuning.PANEL_COLUMNS, left, left, ld_left, at, ld))
        )
    calls.append((None, _routine("dpotrf"), (_LOWER, _count(width), at, ld, ctypes.byref(fault))))
    divide = (
        _RIGHT, _LOWER, _TRANSPOSED, _LEFT_OUT, _count(rows - width), _count(width), _ONE,
        at, ld, _address(corner + DOUBLE_BYTES * width), ld,
    )  # fmt: skip
    return [*calls, (None, _routine("dtrsm"), divide)] if rows > width else calls


def _sheet_calls(own: int, rows: int, first: int, height: int, columns: int, pitch: int, target: int) -> list[Call]:
    """Return the calls that subtract the product of the own columns of a front from one sheet, up to SHEET_COLUMNS
    columns of its update: for each SHEET_COLUMNS own columns one for the triangle at the diagonal and one for the rest.

    A front is a dense symmetric matrix: the columns of its own unknowns first, then those of the later unknowns that
    they are coupled to; the block of the later ones is the update. Each call is a tuple: number of the panel of own
    columns that it waits for, -1 for the last one, None for none; routine; arguments.

    own : number of own columns of the front.
    rows : number of rows from the sheet's first diagonal entry down.
    first : row of the front in which the sheet begins.
    height : doubles from one own column to the next in the first SHEET_COLUMNS columns; fewer in later ones.
    columns : address of the first diagonal entry of all own columns.
    pitch : doubles from one column of the sheet to the next.
    target : address of the sheet's first diagonal entry.
    """
    width, to, ld_to, calls = min(tuning.SHEET_COLUMNS, rows), _address(target), _count(pitch), list[Call]()
    for before in range(0, own, tuning.SHEET_COLUMNS):
        depth = min(tuning.SHEET_COLUMNS, own - before)
        left, pitch_left = _entry(first, before, height, columns)
        ld, last = _count(pitch_left), (before + depth - 1) // tuning.PANEL_COLUMNS
        square = (
            _LOWER, _LEFT_OUT, _count(width), _count(depth), _MINUS_ONE, _address(left), ld, _ONE, to, ld_to
        )  # fmt: skip
        calls.append((last, _routine("dsyrk"), square))
        if rows > width:
            below = _product(
                rows - width, width, depth, _address(left + DOUBLE_BYTES * width), _address(left), ld,
                _address(target + DOUBLE_BYTES * width), ld_to,
            )  # fmt: skip
            calls.append((None, _routine("dgemm"), below))
    return calls


def _entry(row: int, column: int, height: int, columns: int) -> tuple[int, int]:
    """Return the address of an entry among the own columns of a front, and how many doubles further on the next column
    stands of the SHEET_COLUMNS columns that are stored together.

    row, column : place of the entry in the front.
    height : doubles from one own column to the next in the first SHEET_COLUMNS columns; fewer in later ones.
    columns : address of the first diagonal entry of all own columns.
    """
    width = tuning.SHEET_COLUMNS
    return columns + DOUBLE_BYTES * (begin_of_column(column, height, width) + row), height - column // width * width


def _product(
    rows: int, width: int, depth: int, left: object, right: object, ld: object, target: object, ld_target: object
) -> tuple[Any, ...]:
    """Return the arguments of BLAS' `dgemm` for target (rows, width) -= left (rows, depth) right (width, depth)^T.

    rows, width, depth : the numbers in these shapes.
    left, right, target : addresses of the three matrices, each stored column by column.
    ld : distance from one column of `left`, and of `right`, to the next, in doubles.
    ld_target : distance from one column of `target` to the next, in doubles.
    """
    return (
        _LEFT_OUT, _TRANSPOSED, _count(rows), _count(width), _count(depth), _MINUS_ONE, left, ld, right, ld, _ONE,
        target, ld_target,
    )  # fmt: skip
