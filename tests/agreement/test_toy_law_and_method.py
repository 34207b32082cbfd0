"""A law and a method are added in one file each: tests/agreement/toy.py has both, and nothing else knows them."""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.options import Kind, bounded, how, real
from taichi_bearings.runs import run as runs
from taichi_bearings.runs.settings import RunSettings, read_toml
from taichi_bearings.scans.plan import read_plan, sample_key
from taichi_bearings.scans.scan import scan
from taichi_bearings.scene import LAWS, Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import METHODS, LinearSolver, MethodOptions, register
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
    with pytest.raises(InputError, match="method 'minimise' does not solve the law 'coulomb'; it solves viscous"):
        solve(make_scene((4, 3)), toy.Minimise().build(), initial_spin(make_scene((4, 3)), "zero"))


@dataclass(frozen=True, kw_only=True)
class HeavyBall(MethodOptions):
    """A method whose option is called as one of gradient descent that is true or false."""

    name = "heavy-ball"
    momentum: float = how(0.9, Kind(bounded(real, 0, 1, open_low=True), "above 0 and at most 1", "NUMBER"), "Momentum.")


def test_a_name_is_given_once_and_options_are_checked(toy):
    with pytest.raises(InputError, match="a method of that name exists already"):
        register(toy.Minimise)
    with pytest.raises(InputError, match="option momentum of method 'heavy-ball' must be above 0 and at most 1, "):
        register(HeavyBall)
    assert "heavy-ball" not in METHODS
    with pytest.raises(InputError, match="corrections is '-1'; it must be a positive whole number"):
        toy.Minimise(corrections=-1)


@pytest.mark.usefixtures("needs_f64")
def test_files_hold_the_options_of_a_method(toy, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('shape = [4, 4]\nlaw = "viscous"\nmethod = "minimise"\ncorrections = 5\nfigures = "none"\n')
    summary = runs.run(RunSettings.from_mapping(read_toml(scene)), tmp_path / "run").summary
    assert (summary["method"], summary["status"]) == ("minimise", "certified")
    assert RunSettings.from_mapping(read_toml(tmp_path / "run")).values["corrections"] == 5
    with pytest.raises(InputError, match="corrections is 5, but linear-solver with the law viscous does not use it"):
        runs.run(RunSettings(shape=(4, 4), law="viscous", corrections=5), tmp_path / "other")


def test_a_method_renames_no_sample(toy):
    """An option counts in a name only where it is given."""
    settings = [{}, {"law": "viscous"}, {"method": "cundall-strack", "stiffness": 2e5}, {"law": "coulomb-viscous"}]
    row = METHODS.pop("minimise")
    before = [sample_key(RunSettings(shape=(4, 4), **given)) for given in settings]
    METHODS["minimise"] = row
    assert [sample_key(RunSettings(shape=(4, 4), **given)) for given in settings] == before
    own = [sample_key(RunSettings(law="viscous", method="minimise", **of)) for of in ({}, {"corrections": 5})]
    assert own[0] != own[1]
    assert own[0] == sample_key(RunSettings(law="viscous", method="minimise", corrections=10))


def test_a_scan_refuses_a_method_that_its_processes_would_not_know(toy, tmp_path):
    (tmp_path / "scan.toml").write_text('shape = [4, 5]\nlaw = "viscous"\nmethod = "minimise"\n[scan]\nseed = [0, 1]\n')
    with pytest.raises(InputError, match="method is 'minimise', a method of your own, which scans do not allow"):
        scan(read_plan(tmp_path / "scan.toml"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def run(*words):
    command = [sys.executable, "-c", BEARINGS, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2], timeout=120)


def test_the_command_line_has_both(tmp_path):
    done = run(
        "run", "--shape", "5,6", "--law", "shear-thinning", "--method", "minimise", "--tolerance", "1e-4",
        "--corrections", 5, "--figures", "none", "--json", "--out", tmp_path / "a",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["law"], summary["method"], summary["status"]) == ("shear-thinning", "minimise", "certified")
    assert np.isfinite(summary["gap"])
    assert "Options of minimise:\n  --corrections N  Changes that it remembers" in run("run", "--help").stdout
    refused = run("run", "--shape", "5,6", "--law", "shear-thinning", "--method", "planar-cut", "--out", tmp_path / "b")
    assert refused.returncode == 2
    assert "it solves coulomb" in refused.stderr
