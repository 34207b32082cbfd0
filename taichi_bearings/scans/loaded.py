"""Loads what most samples of scans need: the process whose copies solve them imports this module (see copies.py)."""

import contextlib
import gc
import importlib

from taichi_bearings.later import postpone

MODULES = (
    "scans.sample", "solvers.interior_point", "solvers.lattice_paths", "solvers.on_strides", "solvers.answer",
    "proof.states",
)  # fmt: skip

postpone()
gc.disable()  # modules make many objects and hardly any cycles: looking for them takes a tenth of the time
for name in MODULES:
    with contextlib.suppress(Exception):  # a worker that needs it will say what is wrong
        importlib.import_module(f"taichi_bearings.{name}")
gc.freeze()  # no copy looks through all this for cycles, which would copy its memory
gc.enable()
