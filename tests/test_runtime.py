"""The runtime: one choice a process, honest errors, quiet start, same bits for any number of workers."""

import importlib.util
import inspect
import os
import subprocess
import sys
from pathlib import Path

import pytest

from taichi_bearings import runtime
from taichi_bearings.errors import DeviceError

ROOT = Path(__file__).parents[1]


def python(code: str, **environment: str) -> subprocess.CompletedProcess:
    env = {k: v for k, v in os.environ.items() if k not in environment} | {k: v for k, v in environment.items() if v}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env, cwd=ROOT, timeout=300)


def test_the_same_choice_may_be_repeated_and_another_is_refused(taichi_runtime):
    assert runtime.start(taichi_runtime.arch, taichi_runtime.precision, 1, taichi_runtime.debug) is taichi_runtime
    other = "f32" if taichi_runtime.precision == "f64" else "f64"
    with pytest.raises(DeviceError, match="already runs"):
        runtime.start("cpu", other, 1)


@pytest.mark.parametrize(
    ("choice", "message"),
    [({"arch": "tpu"}, "allowed are"), ({"precision": "f16"}, "allowed are"), ({"threads": -1}, "threads is -1")],
)
def test_unknown_choices_are_refused(choice, message):
    with pytest.raises(DeviceError, match=message):
        runtime.start(**choice)


@pytest.mark.parametrize("arch", runtime.GPUS)
def test_an_absent_device_is_an_error_and_not_a_fall_back(arch):
    if runtime.usable(arch):
        pytest.skip(f"there is a {arch} device here")
    with pytest.raises(DeviceError, match=r"device was found here|no double precision"):
        runtime.start(arch)


SMALL_RUN = """
import hashlib
import taichi_bearings as tb
from taichi_bearings import runtime
from taichi_bearings.fields import fields
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene
runtime.start("cpu", "f64", {threads})
fields.LEAST_WORKER_NUMBERS = 1  # as many workers as there are threads, however small the scene
for law in ("coulomb", "viscous"):
    scene = make_scene((7, 6, 9), law)
    for method in (tb.GradientDescent().build(), tb.CundallStrack().build()):
        found = solve(scene, method, initial_spin(scene, "random"), StopRule(1e-14, 150))
        print(hashlib.sha256(found.spin.tobytes()).hexdigest(), method.team.size)
for method in ("cundall-strack", "gradient-descent"):
    packing = tb.Packing.lattice("bcc", (3, 3, 4), seed=4)
    found = tb.solve(packing, method, start="random", iterations=30, threads={threads})
    print(hashlib.sha256(found.spin.tobytes() + found.force.tobytes()).hexdigest(), {threads})
"""


def test_one_and_two_workers_give_the_same_bits():
    found = []
    for threads in range(1, min(2, runtime.available_threads()) + 1):
        done = python(SMALL_RUN.format(threads=threads))
        assert done.returncode == 0, done.stderr
        spins, workers = zip(*map(str.split, done.stdout.splitlines()), strict=True)
        assert workers == (str(threads),) * 6
        found.append(spins)
    assert found[0] == found[-1]


THEIRS = """
import {compiler} as ti
from taichi_bearings.errors import DeviceError
import taichi_bearings as tb
scene = tb.Scene.random((4, 4, 4), seed=1)


def words(call):
    try:
        return "P = %r" % call().power
    except DeviceError as error:
        return str(error)


def theirs():
    ti.init(arch=ti.cpu, default_fp=ti.f32)
    field = ti.field(ti.f32, 3)
    field.fill(7)
    return field


def run(method):
    given = dict(start="random", duration=1e-3) if method == "cundall-strack" else dict(tolerance=1e-6)
    return words(lambda: tb.solve(scene, method, **given))


{script}
"""
METHODS = "('auto', 'cundall-strack', 'gradient-descent', 'operator-splitting')"
SCRIPTS = {
    "before": ("field = theirs()\nfor method in {}:\n    print(run(method))\nassert (field.to_numpy() == 7).all()",
               4 * ["was already started in this process"]),
    "after": ("print(run('gradient-descent'))\nfield = theirs()\nfor method in {0}:\n    print(run(method))\n"
              "assert (field.to_numpy() == 7).all()\nti.reset()\nfor method in {0}:\n    print(run(method))",
              ["P = ", *8 * ["was reset or restarted"]]),
    "meanwhile": ("def meddle(*_):\n    ti.init()\n"
                  "print(words(lambda: tb.solve(scene, 'gradient-descent', tolerance=1e-12, callback=meddle)))",
                  ["was reset or restarted"]),
}  # fmt: skip


@pytest.mark.parametrize("compiler", ["taichi", "quadrants"])
@pytest.mark.parametrize("when", SCRIPTS)
def test_a_runtime_of_other_code_is_neither_reset_nor_computed_with(compiler, when):
    if importlib.util.find_spec(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    script, expected = SCRIPTS[when]
    code = THEIRS.format(compiler=compiler, script=script.format(METHODS))
    done = python(code, TAICHI_BEARINGS_COMPILER=compiler, TI_LOG_LEVEL="error", QD_LOG_LEVEL="error")
    said = [line for line in done.stdout.splitlines() if not line.startswith("[")]
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert [words in line for words, line in zip(expected, said, strict=True)] == [True] * len(expected), said


def test_an_unknown_or_absent_compiler_is_named():
    code = "import sys; {}from taichi_bearings_cli.main import main; sys.argv = ['bearings', 'info']; main()"
    unknown = python(code.format(""), TAICHI_BEARINGS_COMPILER="numba")
    assert unknown.returncode == 2
    assert "TAICHI_BEARINGS_COMPILER is 'numba'; allowed are taichi, quadrants" in unknown.stderr
    absent = "import importlib.util; importlib.util.find_spec = lambda name: None; "
    assert "quadrants is not installed" in python(code.format(absent), TAICHI_BEARINGS_COMPILER="quadrants").stderr


def test_a_mistake_in_a_kernel_is_named_with_its_line(taichi_runtime):
    """That line is longer than the 80 columns to which compilers would wrap it."""
    from taichi_bearings.compiler import ti

    @ti.kernel
    def mistaken() -> ti.f64:
        the_number_that_this_kernel_gives_back_is_the_sum_of_two_others = 1.0 + a_number_that_nobody_has_ever_heard_of  # noqa: F821
        return the_number_that_this_kernel_gives_back_is_the_sum_of_two_others

    with pytest.raises(Exception, match="a_number_that_nobody_has_ever_heard_of") as error:
        mistaken()
    assert "two_others = 1.0 + a_number_that_nobody_has_ever_heard_of  #" in str(error.value)


def test_a_mistake_in_a_function_is_named_with_its_line_however_often_it_was_read(taichi_runtime):
    from taichi_bearings.compiler import ti

    @ti.func
    def first(sound: ti.template()):
        if ti.static(not sound):
            nobody_has_ever_heard_of_it()  # noqa: F821
        return 1.0

    @ti.func
    def second(sound: ti.template()):
        if ti.static(not sound):
            nobody_has_ever_heard_of_it()  # noqa: F821
        return 1.0

    @ti.kernel
    def called(which: ti.template(), sound: ti.template()) -> ti.f32:
        result = second(True)
        if ti.static(which == 1):
            result += first(sound)
        else:
            result += second(sound)
        return result

    def line_of(function):
        return inspect.unwrap(function).__code__.co_firstlineno + 3

    assert called(1, True) == called(2, True) == 2.0
    for which, function in ((1, first), (2, second)):
        with pytest.raises(Exception, match="nobody_has_ever_heard_of_it") as error:
            called(which, False)
        assert f"line {line_of(function)}, in {function.__name__}" in str(error.value)
