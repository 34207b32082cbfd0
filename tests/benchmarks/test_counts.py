"""What the benchmark counts is what the kernels do: seen in the rows that results depend on."""

import numpy as np
import pytest
from taichi_bearings_studies.benchmarks import counts

from taichi_bearings.fields import Fields
from taichi_bearings.lattice.layout import Layout
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack, GradientDescent, OperatorSplitting
from tests.benchmarks.one_block import OneBlock
from tests.scenes import make_scene

DRAWS = 20
SHAPE = (4, 5, 6)  # with contacts of one component and of two
PASSES = {
    "sweep": (GradientDescent(momentum=False), lambda s: counts.descent_sweep(s, momentum=False)),
    "sweep with momentum": (GradientDescent(), lambda s: counts.descent_sweep(s, momentum=True)),
    "contact": (CundallStrack(), counts.contact_pass),
    "sphere": (CundallStrack(), counts.sphere_pass),
    "limit": (OperatorSplitting(), counts.limit_pass),
    "gather": (OperatorSplitting(), counts.gather_pass),
}


@pytest.mark.parametrize("name", PASSES)
def test_rows_are_those_that_results_depend_on(name):
    """A pass on a site in the middle. A row is written if it changes; it is read if the others, or what it becomes
    itself, depend on it: in some of the states, with friction large and small beside all else."""
    options, count = PASSES[name]
    scene, method = make_scene(SHAPE, seeds=(0,)), options.build()
    spin = initial_spin(scene, "linear")
    method.begin(scene, spin, Fields(Layout(1, SHAPE, 1), method.plan(scene, spin)))
    fields, layout = method.fields, method.fields.layout
    kernels = next(getattr(method, name) for name in ("sweeps", "steps", "contacts") if hasattr(method, name))
    kernel = getattr(OneBlock(kernels), name.split()[0])
    row, margin, _, stride_x, stride_y, _ = layout.measures
    place = (row, margin + layout.sites // 2, stride_x, stride_y)
    values = fields.values.reshape(-1, row)
    rng = np.random.default_rng(5)

    def after(state):
        values[:] = state
        kernel(fields.values, fields.blocks, *place, 0.3, 1.1)
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
    work = count(method.stencil)
    assert (len(read), len(written)) == (work.read, work.written)
