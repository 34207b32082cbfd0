"""Eliminate the own unknowns of one front with LAPACK and BLAS, letting other threads run meanwhile.

SciPy exports the routines for use from compiled code (scipy.linalg.cython_blas); called through ctypes they release the
interpreter lock, so that fronts of one depth can be eliminated side by side. The library's own threads are of no use
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
_LEFT_OUT = ctypes.c_char(b"N")
_LOWER, _RIGHT, _TRANSPOSED = ctypes.c_char(b"L"), ctypes.c_char(b"R"), ctypes.c_char(b"T")
_ONE, _MINUS_ONE = ctypes.c_double(1.0), ctypes.c_double(-1.0)


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
