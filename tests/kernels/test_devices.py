"""What a device shares with the CPU: the answer; and how often it is asked. With --arch, these run on that device."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from taichi_bearings import runtime
from taichi_bearings.kernels import team
from taichi_bearings.scene.law import LAWS
from tests.kernels.courses import course

ROOT = Path(__file__).parents[2]


PLANE, CUBE = (12, 10), (6, 5, 7)


COURSES = [  # each kernel in 2D and in 3D, under each law that it has a branch for, and over closed sides
    *((method, law, (PLANE, CUBE)[(i + n) % 2]) for i, method in enumerate(("gradient-descent", "with energy"))
      for n, law in enumerate(LAWS)),
    ("plain descent", "coulomb", PLANE), ("cundall-strack", "coulomb", CUBE),
    ("operator-splitting", "coulomb", PLANE), ("operator-splitting", "coulomb", CUBE),
    *((method, "coulomb", (6, 4, 7), "xy") for method in ("gradient-descent", "with energy", "operator-splitting")),
]  # fmt: skip


COURSES += [("descent of a packing", "coulomb", (4, 4, 5)), ("steps of a packing", "viscous", (4, 4, 5))]


@pytest.fixture(scope="module")
def on_the_cpu(precision):
    """The courses on the CPU in double precision, by a process of their own."""
    if precision == "f64" and not runtime.current().is_gpu:
        pytest.skip("the CPU in double precision is what others are compared with")
    code = f"import json; from tests.kernels.courses import courses; print(json.dumps(courses({COURSES!r})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=300)
    assert done.returncode == 0, done.stderr
    return dict(zip(COURSES, json.loads(done.stdout), strict=True))


@pytest.mark.parametrize("case", COURSES, ids=lambda case: "-".join(map(str, case)))
def test_two_hundred_iterations_end_where_those_of_the_cpu_do(case, on_the_cpu, precision):
    found, expected = np.array(course(*case)), np.array(on_the_cpu[case])
    # across the kinks of |slip|: rounding decides to which side
    chatters = case[0] == "plain descent" and case[1] != "viscous"
    single = 1e-2 if chatters else 1e-4
    assert found == pytest.approx(expected, rel=1e-11 if precision == "f64" else single)


def test_several_turns_of_one_launch_end_where_single_ones_do(monkeypatch, on_the_cpu, precision):
    """As on CUDA; 100 steps are no multiple of 3."""
    if not runtime.current().is_gpu:
        pytest.skip("a CPU makes all turns in one launch")
    monkeypatch.setattr(team, "TURNS_A_LAUNCH", {runtime.current().arch: 3})
    team.made_once.cache_clear()  # kernels of single turns
    case = next(case for case in COURSES if case[0] == "cundall-strack")
    found, expected = np.array(course(*case)), np.array(on_the_cpu[case])
    team.made_once.cache_clear()
    assert found == pytest.approx(expected, rel=1e-11 if precision == "f64" else 1e-4)
