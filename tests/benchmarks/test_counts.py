"""What the benchmark counts is what the kernels do: seen in their programs, their data and their calls."""

import numpy as np
import pytest
from taichi_bearings_studies.benchmarks import counts

from taichi_bearings.compiler import name as compiler_name
from taichi_bearings.fields import Fields
from taichi_bearings.lattice.layout import Layout
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack, GradientDescent, OperatorSplitting
from tests.benchmarks.compiled_counts import counted, printed_program
from tests.benchmarks.one_block import OneBlock
from tests.scenes import make_scene

BLOCK, DRAWS = 4, 20
SHAPE = (4, 5, 6)  # with contacts of one component and of two
PASSES = {
    "sweep": (GradientDescent(momentum=False), lambda s: counts.descent_sweep(s, momentum=False)),
    "sweep with momentum": (GradientDescent(), lambda s: counts.descent_sweep(s, momentum=True)),
    "contact": (CundallStrack(), counts.contact_pass),
    "sphere": (CundallStrack(), counts.sphere_pass),
    "limit": (OperatorSplitting(), counts.limit_pass),
    "gather": (OperatorSplitting(), counts.gather_pass),
}


def begun(options, block, shape=SHAPE):
    """A method at its start, in blocks of so many sites, from spins with as many components as its start has."""
    scene = make_scene(shape, seeds=(0,))
    spin = initial_spin(scene, "linear")
    method = options.build()
    fields = Fields(Layout(1, shape, block), method.plan(scene, spin))
    method.begin(scene, spin, fields)
    return method


def kernels_of(method):
    return next(getattr(method, name) for name in ("sweeps", "steps", "contacts") if hasattr(method, name))


def one_pass(name, block):
    """A pass on a block in the middle: its work as it is counted, its kernel and their arguments."""
    options, count = PASSES[name]
    method = begun(options, block)
    fields, layout = method.fields, method.fields.layout
    kernel = getattr(OneBlock(kernels_of(method)), name.split()[0])
    row, margin, _, stride_x, stride_y, _ = layout.measures
    first = (margin + layout.sites // 2) // block
    arguments = fields.values, fields.blocks, row, first, stride_x, stride_y, 0.3, 1.1
    return count(method.stencil), kernel, arguments


# operations and roots that a block takes beside those of its sites: the contact below its first, constants of the pass
ONCE = {
    "sweep with momentum": (9, 2),
    "contact": (5, 0),
    "sphere": (0, 0),
    "limit": (4, 0),
    "gather": (0, 0),
}


@pytest.mark.skipif(compiler_name() != "taichi", reason="reads what Taichi's compiler prints")
@pytest.mark.parametrize("name", ONCE)
def test_operations_are_those_of_the_compiled_program(name, capfd):
    work, kernel, arguments = one_pass(name, BLOCK)
    operations, roots = ONCE[name]
    found = counted(printed_program(kernel, arguments, capfd), BLOCK)
    assert found == (work.operations + operations / BLOCK, work.roots + roots / BLOCK)


@pytest.mark.parametrize("name", PASSES)
def test_rows_are_those_that_results_depend_on(name):
    """A row is written if it changes; it is read if the others, or what it becomes itself, depend on it: in some of the
    states, with friction large and small beside all else."""
    work, kernel, arguments = one_pass(name, 1)
    values = arguments[0].reshape(-1, arguments[2])
    rng = np.random.default_rng(5)

    def after(state):
        values[:] = state
        kernel(*arguments)
        return values.copy()

    read, written = set(), set()
    for _ in range(DRAWS):
        before = rng.uniform(0.5, 1.0, values.shape) * 10.0 ** rng.uniform(-2, 2, (len(values), 1))
        found = after(before)
        written |= set(np.flatnonzero((found != before).any(axis=1)))
        for n in range(len(values)):
            changed = before.copy()
            changed[n] *= 1.01
            expected = found.copy()
            expected[n] = np.where(found[n] == before[n], changed[n], found[n])  # what is not written stays
            if (after(changed) != expected).any():
                read.add(n)
    assert (len(read), len(written)) == (work.read, work.written)
