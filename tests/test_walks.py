"""Walks of the compiler through the source of kernels, kept from process to process: the same machine code is found."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from taichi_bearings import compiler

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.skipif(compiler.name() != "taichi", reason="only walks of Taichi are kept")
SOLVES = """
import json
from taichi_bearings import runtime, walks
repeated = []
repeat = walks._Kept._repeated
walks._Kept._repeated = lambda kept, kernel, *more: repeated.append(repeat(kept, kernel, *more)) or repeated[-1]
{before}
import taichi_bearings as tb
from taichi_bearings.conic import by_numpy
by_numpy.kernels_are_loaded()  # so that passes over the contacts use kernels from the first on
scene = tb.Scene.random((6, 6, 6), seed=3)
found = [tb.solve(scene, method=method, iterations=20, **{more}).power.hex() for method in {methods}]
{after}
print(json.dumps([found, repeated.count(True), repeated.count(False)]))
"""
METHODS = ["cundall-strack", "interior-point", "gradient-descent", "operator-splitting"]
ONE = METHODS[:1]


def solved(
    home: Path, before: str = "", methods: list[str] = METHODS, after: str = "", **more: str
) -> tuple[list[str], int, int]:
    """Powers by several methods in a new process, and how many walks it repeated and made anew."""
    code = SOLVES.format(before=before, methods=methods, after=after, more=more)
    environment = os.environ | {"XDG_CACHE_HOME": str(home)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    powers, repeated, made = json.loads(done.stdout.splitlines()[-1])
    return powers, repeated, made


def files(home: Path, kind: str) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in home.rglob(f"*.{kind}")}


Solved = tuple[Path, tuple[list[str], int, int]]


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Solved:
    """The caches that a process leaves which has to compile everything, and what it found."""
    home = tmp_path_factory.mktemp("first")
    return home, solved(home)


@pytest.fixture(scope="module")
def second(first: Solved, tmp_path_factory: pytest.TempPathFactory) -> Solved:
    """Those that another process leaves after it, and what that found."""
    home = shutil.copytree(first[0], tmp_path_factory.mktemp("second") / "home")
    return home, solved(home)


def test_the_third_process_repeats_all_walks_and_finds_the_same_machine_code(first, second, tmp_path):
    """The first one has to compile everything, and leaves it to the second to keep walks."""
    assert not files(first[0], "walk")
    powers, repeated, made = second[1]
    assert first[1] == (powers, repeated, made)
    kept, machine_code = files(second[0], "walk"), files(second[0], "tic")
    assert repeated == 0
    assert 10 < made == len(kept) <= len(machine_code)
    third = shutil.copytree(second[0], tmp_path / "third")
    assert solved(third) == (powers, made, 0)
    assert files(third, "tic").keys() == machine_code.keys()  # by other code it would have compiled others
    assert files(third, "walk") == kept


def test_what_is_damaged_is_walked_anew(second, tmp_path):
    home = shutil.copytree(second[0], tmp_path / "home")
    powers, _, made = second[1]
    places = sorted(home.rglob("*.walk"))
    whole = [place.read_bytes() for place in places]
    for number, (place, content) in enumerate(zip(places, whole, strict=True)):
        flipped = content[:-5] + bytes([content[-5] ^ 1]) + content[-4:]
        place.write_bytes(flipped if number % 2 else content[: len(content) // 2])
    assert solved(home) == (powers, 0, made)
    assert [place.read_bytes() for place in places] == whole


def test_a_walk_of_other_numbers_is_not_repeated(second, tmp_path):
    home = shutil.copytree(second[0], tmp_path / "home")
    changed = "from taichi_bearings.kernels import {0}\n{0}.{1}"
    for before, more in (
        (changed.format("memory", "INDEX_MASK = 2**29 - 1"), {}),
        ("walks._surroundings = lambda: ['another version of the kernels']", {}),
        ("", {"precision": "f32"}),
    ):
        _, repeated, made = solved(home, before, ONE, **more)
        assert repeated == 0 < made, (before, more)


def test_a_setting_that_taichi_leaves_as_memory_was_changes_no_name(first, tmp_path):
    """It differs from process to process by what stood there before; half of them would read all sources anew."""
    home = shutil.copytree(first[0], tmp_path / "home")
    told = "from functools import partial\nfrom taichi_bearings.compiler import ti\nti.init = partial(ti.init, {0})"
    powers, _, made = solved(home, told.format("print_ir_dbg_info=False"), ONE)
    assert made > 0
    assert solved(home, told.format("print_ir_dbg_info=True"), ONE) == (powers, made, 0)


OWN_LAW = """
import numpy as np
from taichi_bearings.compiler import ti
from taichi_bearings.kernels.contact import FORCES
from taichi_bearings.scene.law import LAWS, Law, Quantity
import taichi_bearings as tb
from taichi_bearings import walks
class Linear(Law):
    def force(self, of, slip): return FACTOR * of[0] * slip
    def power(self, of, slip): return FACTOR * of[0] * slip**2
    def potential(self, of, slip): return FACTOR * of[0] * slip**2 / 2
    def conjugate(self, of, force):
        return np.divide(force**2, 2 * FACTOR * of[0], out=np.zeros_like(force), where=of[0] > 0)
    def steepest(self, of, slip): return FACTOR * of[0]
LAWS["linear"] = Linear("linear", (Quantity("damping", "force*time/length"),), minimises="potential")
@ti.func
def pull(spin_difference: ti.template(), coefficients: ti.template(), radius):
    return [FACTOR * radius * d * coefficients[0] for d in ti.static(spin_difference)]
FORCES["linear"] = pull
kept = []
write = walks._write
walks._write = lambda place, *more: kept.append(place) or write(place, *more)
scene = tb.Scene.random((5, 5), seed=1, law="linear")
print(tb.solve(scene, "gradient-descent", tolerance=1e-9).power, len(kept))
"""


def test_kernels_with_a_law_of_ones_own_are_walked_each_time(tmp_path):
    """Its source is elsewhere, so nobody would see that it has changed."""
    found = []
    for factor in (1.0, 3.0):
        (tmp_path / "law.py").write_text(OWN_LAW.replace("FACTOR", str(factor)))
        environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "home")}
        code = [sys.executable, str(tmp_path / "law.py")]
        done = subprocess.run(code, capture_output=True, text=True, env=environment, cwd=ROOT)
        assert done.returncode == 0, done.stderr
        power, kept = done.stdout.split()[-2:]
        assert int(kept) == 0
        found.append(float(power))
    assert found[1] == pytest.approx(3 * found[0], rel=1e-6)  # the spins are the same


def test_nothing_is_kept_where_no_cache_may_be(second, tmp_path):
    home = shutil.copytree(second[0], tmp_path / "home")
    nowhere = "walks.keep = lambda *more, **named: None"
    assert solved(home, nowhere, ONE) == (second[1][0][:1], 0, 0)


FAULTS = """
from itertools import cycle
from unittest import mock
met = set()
def faulty(owner, name, mistake):
    def fail(*more):
        met.add(name)
        mistake()
    return mock.patch.object(owner, name, fail)
faults = cycle([
    faulty(walks._Record, "walk", lambda: {}["lost"]),
    faulty(walks, "_write", lambda: 1 / 0),
    faulty(walks, "_Record", lambda: None()),
    faulty(walks._Record, "listening", lambda: 1 / 0),
    faulty(walks._Kept, "_name", lambda: [][0]),
])
materialize = walks._Kept.materialize
def broken(kept):
    materialized = materialize(kept)
    def of_each_kernel(*arguments, **named):
        with next(faults):
            materialized(*arguments, **named)
    return of_each_kernel
walks._Kept.materialize = broken
"""


def test_whatever_goes_wrong_while_a_walk_is_kept_the_kernel_is_walked_all_the_same(first, tmp_path):
    """The errors, another one for each kernel in turn, are none that the module raises itself; they come before, amid
    and after the listening."""
    home = shutil.copytree(first[0], tmp_path / "home")
    met = "assert met == {'walk', '_write', '_Record', 'listening', '_name'}, met"
    powers, repeated, _ = solved(home, FAULTS, after=met)
    assert (powers, repeated) == (first[1][0], 0)
    assert not files(home, "walk")


def test_the_workers_of_a_scan_keep_their_kernels_for_later_ones(tmp_path):
    cheap = 'method = "gradient-descent"\ntolerance = 0.01\n'
    (tmp_path / "scan.toml").write_text(f"shape = [5, 4, 6]\n{cheap}[scan]\nseed = {{ start = 0, stop = 4 }}\n")
    kept = []
    for number in range(3):
        environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
        words = ["scan", "scan.toml", "--workers", "2", "--out"]
        command = [sys.executable, "-m", "taichi_bearings_cli", *words, f"{number}"]
        subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True)
        kept.append([len(list((tmp_path / "cache").rglob(f"*.{kind}"))) for kind in ("tic", "walk", "lock")])
    compiled, walked, _ = kept[1]
    assert compiled > 0 < walked  # the first leaves what is compiled, the second the walks
    assert kept == [[compiled, 0, 0], [compiled, walked, 0], [compiled, walked, 0]]
