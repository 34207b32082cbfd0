"""Starts kernels quickly that are started again and again with the same arguments."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from taichi_bearings import compiler, runtime
from taichi_bearings.compiler import ti
from taichi_bearings.errors import warn


def prepared(kernel: Any, *arguments: np.ndarray | int) -> Callable[[], None]:
    """Return a function without arguments that does what ``kernel(*arguments)`` does, but starts faster.

    kernel : a kernel of Taichi.
    arguments : whole numbers, and arrays in C order that the kernel reads with one index. A kernel sees what the arrays
        contain when it is called, so their numbers may change between calls.

    Taichi inspects all arguments at every start, which takes 0.1 ms: as long as a pass over the contacts of a small
    sample. Its findings are kept here, through its inner functions. Where the compiler has other inner functions, the
    kernel is started in the ordinary way, and a warning says that small samples take longer.
    """
    runtime.current()  # starts it
    is_fork = _is_fork()
    try:
        primal = kernel._primal
        if is_fork:  # as it does at the start of each call
            primal.raise_on_templated_floats = ti.lang.impl.current_cfg().raise_on_templated_floats
        key = primal.ensure_compiled(*arguments)
        known = primal.materialized_kernels if is_fork else primal.compiled_kernels
        compiled = known[key]
        context, program = compiled.make_launch_context(), ti.lang.impl.get_runtime().prog
        for place, value in enumerate(arguments):
            at: Any = place if is_fork else (place,)
            if isinstance(value, np.ndarray):
                assert value.flags.c_contiguous
                context.set_arg_external_array_with_shape(at, value.ctypes.data, value.nbytes, value.shape[:1], 0)
            else:
                context.set_arg_int(at, int(value))
        made = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        machine_code = made.compiled_kernel_data if is_fork else made
        start = program.launch_kernel
    except (AttributeError, KeyError, TypeError):  # other names, keys or arguments of these inner functions
        _warn_of_slow_starts()
        return lambda: kernel(*arguments)

    def started(keep: tuple[np.ndarray | int, ...] = arguments) -> None:
        """Start the compiled kernel with the arguments that it was prepared for.

        keep : those arguments; as a default value they keep the arrays alive.
        """
        refuse_changed()
        start(machine_code, context)

    refuse_changed = runtime.refuse_changed
    return started


@cache
def _is_fork() -> bool:
    """Return True if the compiler is Quadrants, the fork of Taichi."""
    return compiler.name() == "quadrants"


@cache
def _warn_of_slow_starts() -> None:
    """Warn that starts are slow, once in a process."""
    warn(
        f"kernels of this version of {compiler.name()} cannot be prepared once, so each start takes 0.1 ms more: the "
        "results are the same, but small samples can take many times as long"
    )
