"""Loads what most samples of scans need: the process whose copies solve them imports this module (see copies.py)."""

import contextlib
import gc
import importlib

from taichi_bearings.later import postpone

MODULES = (
    "taichi_bearings.scans.sample", "taichi_bearings.solvers.minimisers", "taichi_bearings.solvers.lattice_paths",
    "taichi_bearings.solvers.on_strides", "taichi_bearings.solvers.answer", "taichi_bearings.proof.states",
    "scipy.linalg.lapack",
)  # fmt: skip

postpone()
gc.disable()  # modules make many objects and hardly any cycles: the search for cycles takes a tenth of the time
for name in MODULES:
    with contextlib.suppress(Exception):  # a worker that needs it will say what is wrong
        importlib.import_module(name)
gc.freeze()  # copies leave these objects out of their search for cycles, which would copy their memory
gc.enable()
