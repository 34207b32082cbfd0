"""A law and a method are added in one file each: tests/agreement/toy.py has both, and nothing else knows them."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.runs.run import run as run_settings
from taichi_bearings.runs.settings import RunSettings, read_toml
from taichi_bearings.scans.plan import sample_key
from taichi_bearings.scene import LAWS, Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import METHODS, LinearSolver, register
from tests.agreement.methods import assert_agreement
from tests.scenes import make_scene

BEARINGS = "import tests.agreement.toy; from taichi_bearings_cli.main import main; main()"


@pytest.fixture(scope="module")
def toy():
    """The tables have both of them, as long as the tests of this file run."""
    from tests.agreement import toy

    yield toy
    del LAWS["shear-thinning"], METHODS["minimise"]


@pytest.mark.parametrize("shape", [(5, 6), (3, 4, 5)], ids=str)
def test_a_new_law_is_certified_by_a_new_method(toy, shape):
    scene = Scene.random(shape, seed=3, law="shear-thinning", spin_bottom=0.3)
    solution = solve(scene, toy.Minimise().build(), initial_spin(scene, "random"), StopRule(1e-4))
    assert solution.status is Status.CERTIFIED
    assert 0 < solution.lower_bound[0] <= solution.power[0]
    assert solution.power[0] == pytest.approx(float(solution.power_per_contact.sum()))
    axes = scene.minimum_spin_axes
    assert solution.power[0] < scene.power(scene.staggered_spin(initial_spin(scene, "linear"), axes), axes)[0]


def test_a_new_method_agrees_with_the_old_ones(toy):
    scene = Scene.random((4, 5, 6), seed=1, law="viscous")
    ours = solve(scene, toy.Minimise().build(), initial_spin(scene, "random"), StopRule(1e-8))
    theirs = solve(scene, LinearSolver().build(), initial_spin(scene, "linear"), StopRule(1e-8))
    assert ours.status is Status.CERTIFIED
    assert ours.power == pytest.approx(theirs.power, rel=1e-8)
    assert "minimise" in assert_agreement(make_scene((4, 3, 4), "viscous"))
    with pytest.raises(InputError, match="method 'minimise' does not solve the law 'coulomb'; it solves viscous"):
        solve(make_scene((4, 3)), toy.Minimise().build(), initial_spin(make_scene((4, 3)), "zero"))


def test_a_name_is_given_once_and_options_are_checked(toy):
    with pytest.raises(InputError, match="one of that name already"):
        register(toy.Minimise)
    with pytest.raises(InputError, match="leftover is '-1'; it must be a positive number"):
        toy.Minimise(leftover=-1)


def test_files_hold_its_options_and_they_rename_no_sample_of_others(toy, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('shape = [4, 4]\nlaw = "viscous"\nmethod = "minimise"\nleftover = 1e-11\nfigures = "none"\n')
    summary = run_settings(RunSettings.from_mapping(read_toml(scene)), tmp_path / "run").summary
    assert (summary["method"], summary["status"]) == ("minimise", "certified")
    assert RunSettings.from_mapping(read_toml(tmp_path / "run")).values["leftover"] == 1e-11
    with pytest.raises(InputError, match=r"leftover is 1e-11, but linear-solver with the law viscous does not use it"):
        run_settings(RunSettings(shape=(4, 4), law="viscous", leftover=1e-11), tmp_path / "other")
    own = [RunSettings(law="viscous", method="minimise", **of) for of in ({}, {"leftover": 1e-12}, {"leftover": 1e-11})]
    assert sample_key(own[0]) == sample_key(own[1]) != sample_key(own[2])  # it counts where it is not the default
    assert sample_key(RunSettings(shape=(4, 4), spin_bottom=0.5, seed=0)) == "95c48ffef6932d74"  # as without it


def run(*words):
    command = [sys.executable, "-c", BEARINGS, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2], timeout=120)


def test_the_command_line_has_both(tmp_path):
    done = run(
        "run", "--shape", "5,6", "--law", "shear-thinning", "--method", "minimise", "--tolerance", "1e-4",
        "--leftover", "1e-11", "--figures", "none", "--json", "--out", tmp_path / "a",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["law"], summary["method"], summary["status"]) == ("shear-thinning", "minimise", "certified")
    assert np.isfinite(summary["gap"])
    refused = run("run", "--shape", "5,6", "--law", "shear-thinning", "--method", "planar-cut", "--out", tmp_path / "b")
    assert refused.returncode == 2
    assert "it solves coulomb" in refused.stderr
    assert "Options of minimise:\n  --leftover NUMBER  Slope at which" in run("run", "--help").stdout
