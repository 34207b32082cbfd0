"""Walks of the compiler through the source of kernels, kept from process to process: the same machine code is found."""

import json
import os
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
scene = tb.Scene.random((6, 6, 6), seed=3)
found = [tb.solve(scene, method=method, iterations=20, **{more}).power.hex() for method in {methods}]
print(json.dumps([found, repeated.count(True), repeated.count(False)]))
"""
METHODS = ["interior-point", "cundall-strack", "gradient-descent", "operator-splitting"]


def solved(home: Path, before: str = "", methods: list[str] = METHODS, **more: str) -> tuple[list[str], int, int]:
    """Powers by several methods in a new process, and how many walks it repeated and made anew."""
    code = SOLVES.format(before=before, methods=methods, more=more)
    environment = os.environ | {"XDG_CACHE_HOME": str(home)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    powers, repeated, made = json.loads(done.stdout.splitlines()[-1])
    return powers, repeated, made


def files(home: Path, kind: str) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in home.rglob(f"*.{kind}")}


def test_the_third_process_repeats_all_walks_and_finds_the_same_machine_code(tmp_path):
    """The first one has to compile everything, and leaves it to the second to keep walks."""
    first = solved(tmp_path)
    assert not files(tmp_path, "walk")
    powers, repeated, made = solved(tmp_path)
    assert first == (powers, repeated, made)
    kept, machine_code = files(tmp_path, "walk"), files(tmp_path, "tic")
    assert repeated == 0
    assert 10 < made == len(kept) <= len(machine_code)
    assert solved(tmp_path) == (powers, made, 0)
    assert files(tmp_path, "tic").keys() == machine_code.keys()  # by other code it would have compiled others
    assert files(tmp_path, "walk") == kept


def test_what_is_damaged_is_walked_anew(tmp_path):
    solved(tmp_path, methods=METHODS[1:2])
    powers, _, made = solved(tmp_path, methods=METHODS[1:2])
    places = sorted(tmp_path.rglob("*.walk"))
    whole = [place.read_bytes() for place in places]
    places[0].write_bytes(whole[0][:-5] + bytes([whole[0][-5] ^ 1]) + whole[0][-4:])
    for place, content in zip(places[1:], whole[1:], strict=True):
        place.write_bytes(content[: len(content) // 2])
    assert solved(tmp_path, methods=METHODS[1:2]) == (powers, 0, made)
    assert [place.read_bytes() for place in places] == whole
    assert solved(tmp_path, methods=METHODS[1:2]) == (powers, made, 0)


def test_a_walk_of_other_numbers_is_not_repeated(tmp_path):
    solved(tmp_path, methods=METHODS[1:2])
    _, _, made = solved(tmp_path, methods=METHODS[1:2])
    changed = "from taichi_bearings.kernels import {0}\n{0}.{1}"
    for before, more in (
        (changed.format("memory", "INDEX_MASK = 2**29 - 1"), {}),
        ("walks._surroundings = lambda: ['another version of the kernels']", {}),
        ("", {"precision": "f32"}),
    ):
        _, repeated, again = solved(tmp_path, before, METHODS[1:2], **more)
        assert (repeated, again) == (0, made), (before, more)


def test_a_setting_that_taichi_leaves_as_memory_was_changes_no_name(tmp_path):
    """It differs from process to process by what stood there before; half of them would read all sources anew."""
    told = "from functools import partial\nfrom taichi_bearings.compiler import ti\nti.init = partial(ti.init, {0})"
    solved(tmp_path, methods=METHODS[1:2])
    powers, _, made = solved(tmp_path, told.format("print_ir_dbg_info=False"), METHODS[1:2])
    assert solved(tmp_path, told.format("print_ir_dbg_info=True"), METHODS[1:2]) == (powers, made, 0)


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
def pull(spin_difference: ti.template(), coefficients: ti.template(), sharpness):
    return [FACTOR * d * coefficients[0] for d in ti.static(spin_difference)]
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


def test_nothing_is_kept_where_no_cache_may_be(tmp_path):
    powers, _, _ = solved(tmp_path, methods=METHODS[1:2])
    nowhere = "walks.keep = lambda *more, **named: None"
    assert solved(tmp_path, nowhere, methods=METHODS[1:2]) == (powers, 0, 0)


def test_whatever_goes_wrong_while_a_walk_is_kept_the_kernel_is_walked_all_the_same(tmp_path):
    """The errors are none that the module raises itself, they come before, amid and after the listening."""
    powers, _, _ = solved(tmp_path, methods=METHODS[1:2])
    for broken in (
        "walks._Record.walk = lambda record: {}['lost']",
        "walks._write = lambda *more: 1 / 0",
        "walks._Record = None",
        "walks._Record.listening = lambda *more: 1 / 0",
        "walks._Kept._name = lambda *more: [][0]",
    ):
        found, repeated, _ = solved(tmp_path, broken, methods=METHODS[1:2])
        assert (found, repeated) == (powers, 0), broken
        assert not files(tmp_path, "walk"), broken
    solved(tmp_path, methods=METHODS[1:2])
    assert files(tmp_path, "walk")


def test_the_workers_of_a_scan_keep_their_kernels_for_later_ones(tmp_path):
    (tmp_path / "scan.toml").write_text("shape = [5, 4, 6]\n[scan]\nseed = { start = 0, stop = 4 }\n")
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
