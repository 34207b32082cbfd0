"""Eliminate and solve for the own unknowns of one front with LAPACK and BLAS, letting other threads run meanwhile.

SciPy exports the routines for use from compiled code (scipy.linalg.cython_blas); called through ctypes they release the
interpreter lock, so that independent fronts can be worked on side by side. The library's own threads are of no use
here: most fronts are small, and a thread that waits for a busy processor holds up every call.
"""

import ctypes
from collections.abc import Callable

import numpy as np
from scipy.linalg import cython_blas, cython_lapack


def _routine(module: object, name: str) -> Callable:
    capsule = module.__pyx_capi__[name]  # type: ignore[attr-defined]
    read_name, read_pointer = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    read_name.restype, read_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    read_pointer.restype, read_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return ctypes.CFUNCTYPE(None)(read_pointer(capsule, read_name(capsule)))


_dpotrf = _routine(cython_lapack, "dpotrf")
_dtrsm = _routine(cython_blas, "dtrsm")
_dsyrk = _routine(cython_blas, "dsyrk")
_dtrsv = _routine(cython_blas, "dtrsv")
_dgemv = _routine(cython_blas, "dgemv")
_LEFT_OUT = ctypes.c_char(b"N")
_LOWER, _RIGHT, _TRANSPOSED = ctypes.c_char(b"L"), ctypes.c_char(b"R"), ctypes.c_char(b"T")
_ZERO, _ONE, _MINUS_ONE = ctypes.c_double(0.0), ctypes.c_double(1.0), ctypes.c_double(-1.0)
_STEP = ctypes.c_int(1)


class DenseFront:
    """diagonal (m, m), below (b, m), update (b, b): Fortran-ordered float64 views; lower triangles count."""

    def __init__(self, diagonal: np.ndarray, below: np.ndarray, update: np.ndarray) -> None:
        m, b = len(diagonal), len(below)
        self._keep = (diagonal, below, update)
        self._fault = ctypes.c_int(0)
        own, border = ctypes.c_int(max(m, 1)), ctypes.c_int(max(b, 1))
        ref = ctypes.byref
        to = [ctypes.c_void_p(a.ctypes.data) for a in (diagonal, below, update)]
        m_, b_ = ctypes.c_int(m), ctypes.c_int(b)
        self._factor = (ref(_LOWER), ref(m_), to[0], ref(own), ref(self._fault))
        self._divide = (
            ref(_RIGHT), ref(_LOWER), ref(_TRANSPOSED), ref(_LEFT_OUT), ref(b_), ref(m_), ref(_ONE),
            to[0], ref(own), to[1], ref(border),
        )  # fmt: skip
        self._subtract = (
            ref(_LOWER), ref(_LEFT_OUT), ref(b_), ref(m_), ref(_MINUS_ONE), to[1], ref(border), ref(_ONE),
            to[2], ref(border),
        )  # fmt: skip
        self.cost = m**3 / 3 + m**2 * b + m * b**2
        self._empty, self._root = m == 0, b == 0

    def eliminate(self) -> bool:
        """diagonal = L L^T, below = below L^-T, update = update - below below^T; False if a pivot is not positive."""
        if self._empty:
            return True
        _dpotrf(*self._factor)
        if self._fault.value:
            return False
        if not self._root:
            _dtrsm(*self._divide)
            _dsyrk(*self._subtract)
        return True


class DenseSolve:
    """Forward and backward substitution of one eliminated front in a vector that stays where it is in memory.

    diagonal (m, m), below (b, m) : as eliminated. vector : all unknowns, first : the front's first one, border : (b,).
    work : at least b numbers that no other thread uses.
    """

    def __init__(
        self,
        diagonal: np.ndarray,
        below: np.ndarray,
        vector: np.ndarray,
        first: int,
        border: np.ndarray,
        work: np.ndarray,
    ) -> None:
        m, b = len(diagonal), len(below)
        self._vector, self._border, self._work = vector, border, work[:b]
        self._keep = (diagonal, below)
        ref = ctypes.byref
        m_, b_, own = ctypes.c_int(m), ctypes.c_int(b), vector.ctypes.data + first * vector.itemsize
        to = [ctypes.c_void_p(address) for address in (diagonal.ctypes.data, below.ctypes.data, own, work.ctypes.data)]
        end = (ref(m_), to[0], ref(m_), to[2], ref(_STEP))
        self._divide = (ref(_LOWER), ref(_LEFT_OUT), ref(_LEFT_OUT), *end)
        self._divide_transposed = (ref(_LOWER), ref(_TRANSPOSED), ref(_LEFT_OUT), *end)
        start = (ref(b_), ref(m_))
        self._spread = (
            ref(_LEFT_OUT), *start, ref(_ONE), to[1], ref(b_), to[2], ref(_STEP), ref(_ZERO), to[3], ref(_STEP)
        )  # fmt: skip
        self._gather = (
            ref(_TRANSPOSED), *start, ref(_MINUS_ONE), to[1], ref(b_), to[3], ref(_STEP), ref(_ONE), to[2], ref(_STEP)
        )  # fmt: skip

    def forward(self) -> None:
        """own = L^-1 own, border -= below own."""
        _dtrsv(*self._divide)
        if len(self._border):
            _dgemv(*self._spread)
            self._vector[self._border] -= self._work

    def backward(self) -> None:
        """own = L^-T (own - below^T border)."""
        if len(self._border):
            self._work[:] = self._vector[self._border]
            _dgemv(*self._gather)
        _dtrsv(*self._divide_transposed)
