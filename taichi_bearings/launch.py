"""Kernels that are started again and again with the same arguments."""

import logging
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from taichi_bearings import compiler, runtime
from taichi_bearings.compiler import ti


def prepared(kernel: Any, *arguments: np.ndarray | int) -> Callable[[], None]:
    """``kernel(*arguments)``, to be called often. It sees what is in the arrays then; they have one index.

    Taichi looks at all arguments anew for every start, for 0.1 ms, in which a pass over the contacts of a small sample
    could be done. What it finds out is kept here, by its inner functions; where the compiler has others, the kernel is
    started as ever, and a warning says that small samples take longer.
    """
    runtime.current()  # starts it
    try:
        primal = kernel._primal
        compiled = primal.compiled_kernels[primal.ensure_compiled(*arguments)]
        context, program = compiled.make_launch_context(), ti.lang.impl.get_runtime().prog
        for place, value in enumerate(arguments):
            if isinstance(value, np.ndarray):
                assert value.flags.c_contiguous
                context.set_arg_external_array_with_shape((place,), value.ctypes.data, value.nbytes, value.shape[:1], 0)
            else:
                context.set_arg_int((place,), int(value))
        machine_code = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        start = program.launch_kernel
    except AttributeError:
        _warn_of_slow_starts()
        return lambda: kernel(*arguments)

    def started(keep: tuple = arguments) -> None:
        start(machine_code, context)

    return started


@cache
def _warn_of_slow_starts() -> None:
    """Once in a process."""
    logging.getLogger(__name__).warning(
        "bearings: kernels of this version of %s cannot be prepared once, so each start takes 0.1 ms more: the results "
        "are the same, but small samples can take many times as long",
        compiler.name(),
    )
