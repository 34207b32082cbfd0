"""What dynamics obey: energy balances close, powers fall, errors have an order in the step, resumed bits agree."""

import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers import METHODS, CundallStrack, GradientDescent, RigidLimit
from taichi_bearings.solvers.drive import Checkpoints, solve
from taichi_bearings.solvers.stopping import StopRule
from tests.properties.answers import laws_of
from tests.properties.scenes import DISCS, SPHERES, cases, decades, scenes

SMALL = (*DISCS[:4], *SPHERES[:4])
MOVING = tuple(name for name, row in METHODS.items() if row.is_dynamics)
STARTS = st.sampled_from(("random", "zero", "linear"))


def course(scene, method, steps, start="random", **how):
    return solve(scene, method.build(), initial_spin(scene, start), StopRule(1e-14, steps), **how)


@pytest.mark.parametrize(("laws", "contrast", "rise"), [(("coulomb", "viscous"), 3, 1e-13), (tuple(LAWS), 12, 1e-9)])
def test_what_is_least_at_rest_never_rises_in_the_rigid_limit(laws, contrast, rise):
    """However long the steps are and wherever it starts, but for what a step is solved to: rounding, and with contrasts
    that end the path early 1e-9. The energy balance closes likewise, or in long steps to 1e-10 of the turnover."""

    @cases(0.1)
    @given(scenes(laws, replicas=(1, 2), shapes=SMALL, contrast=contrast, scale=3), STARTS, decades(5))
    def holds(scene, start, span):
        step = float(np.clip(span * relaxation_time(scene), 1e-15, 1e15))
        history = course(scene, RigidLimit(time_step=step), 6, start).history
        found = history.get("potential", history["power"])
        assert (np.diff(found, axis=0) <= rise * found[:-1]).all()
        assert (np.abs(history["energy_residual"]) < (10 * rise if span <= 1 else 1e-9)).all()

    holds()


def relaxation_time(scene):
    """I omega / (R F): of one sphere under the forces of its contacts."""
    held = scene.coefficient.max() * scene.strength
    force = held if scene.law.has_friction else held * scene.lattice.radius * scene.jump
    return float(scene.lattice.radius * scene.jump / force)


@cases(0.5)
@given(scenes(("viscous",), replicas=(1, 2)), STARTS)
def test_the_viscous_power_never_rises_in_plain_gradient_descent(scene, start):
    found = course(scene, GradientDescent(momentum=False), 600, start).history["power"]
    assert (np.diff(found, axis=0) <= 1e-13 * found[:-1]).all()


@pytest.mark.parametrize("name", MOVING)
def test_a_course_that_is_resumed_has_the_same_bits(name):
    @cases(0.1)
    @given(scenes(laws_of(name), replicas=(1, 2), shapes=SMALL), STARTS, st.floats(0, 1))
    def holds(scene, start, where):
        written, steps = [], 6 if METHODS[name].cpu_only else 120
        whole = course(scene, METHODS[name](), steps, start, checkpoints=Checkpoints(0.0, written.append))
        resume = Checkpoints(np.inf, lambda arrays: None, written[round(where * (len(written) - 1))])
        again = course(scene, METHODS[name](), steps, start, checkpoints=resume)
        assert (again.status, again.iterations) == (whole.status, whole.iterations)
        assert (again.spin == whole.spin).all()
        assert (again.lower_bound == whole.lower_bound).all()
        assert (again.force == whole.force).all()
        for column in set(whole.history) - {"seconds"}:
            np.testing.assert_array_equal(again.history[column], whole.history[column], err_msg=column)

    holds()


@cases(0.1)
@given(scenes(contrast=3, scale=0, shapes=SMALL, directions=((1.0, 1.0, 0.0), (1.0, 0.0, 0.0))), decades(2), decades(2))
def test_energy_balance_of_springs_close_as_the_step_falls(scene, stiffness, damping):
    """Injected, dissipated, kinetic and spring energy come from data of their own."""
    missing = []
    for share in (0.4, 0.05):
        options = CundallStrack(energy=True, stiffness=1e3 * stiffness, damping=10 * damping)
        method = options.build()
        bound = solve(scene, method, initial_spin(scene, "random"), StopRule(1e-14, 2)) and method.stability_bound
        options = replace(options, time_step=share * bound)
        history = course(scene, options, round(100 / share)).history
        missing.append(float(np.abs(history["energy_residual"][-1]).max()))
    assert missing[1] < max(missing[0] / 4, 1e-9)


DRAWN = """
import hashlib, pickle, sys
from taichi_bearings import runtime
runtime.start("cpu", "f64", int(sys.argv[1]))
import taichi_bearings.fields.fields as fields
fields.LEAST_WORKER_NUMBERS = 1  # as many workers as there are threads, however small the scene
from tests.properties.answers import answer_of, methods_of
for scene in pickle.loads(sys.stdin.buffer.read()):
    for method in methods_of(scene):
        print(method, hashlib.sha256(answer_of(scene, method).spin.tobytes()).hexdigest())
"""


@pytest.mark.thorough
@settings(max_examples=2, phases=(Phase.generate,))
@given(st.lists(scenes(replicas=(1, 3)), min_size=20, max_size=40))
def test_threads_change_no_bit(drawn):
    words, given = [sys.executable, "-c", DRAWN], pickle.dumps(drawn)
    one, two = (subprocess.run([*words, str(n)], input=given, capture_output=True, check=True).stdout for n in (1, 2))
    assert one.count(b"\n") >= 3 * len(drawn)
    assert one == two
