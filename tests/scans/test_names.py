"""Names of samples in folders of users: whatever is added to a run, they stay, and scans of before go on."""

import shutil
from pathlib import Path

import pytest

from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.parts import Part
from taichi_bearings.scans.plan import read_plan, sample_key
from taichi_bearings.scans.scan import merge, scan
from tests.scans.scan_faults import Here

BEFORE = Path(__file__).parent / "before"
NAMES = {  # as the first version gave them
    "79ba95396bbe1dd8": {},
    "aa478816baceaf09": {"shape": [10, 10], "seed": 3},
    "cda13a37ca8d5364": {"law": "viscous", "method": "linear-solver"},
    "4f953f93b8189b9b": {"stiffness": 200000.0, "damping": 5.0, "method": "cundall-strack"},
    "a7254ebda4dc250a": {
        "method": "cundall-strack",
        "integrator": "implicit",
        "error_tolerance": 0.0001,
        "duration": 2.0,
        "record": "0.1,1",
    },
    "bf540b9e705b94b3": {
        "method": "cundall-strack",
        "energy": True,
        "gear_order": 3,
        "inertia": 0.2,
        "static_ratio": 1.2,
        "slipping_spring": "relax",
    },
    "402cbc15a3bae557": {
        "method": "rigid-limit",
        "error_tolerance": 0.001,
        "rest_tolerance": 1e-09,
        "mass": 2.0,
        "time_step": 0.001,
    },
    "cd2706f16c15a595": {"momentum": False, "method": "gradient-descent"},
    "18e07b44e1076fc6": {"settle": False, "normal_force": 10.0, "slip_threshold": 1e-09},
    "2f9e7a330eef0b22": {
        "direction": [1, 0, 0],
        "iterations": 5,
        "time_limit": 3.0,
        "initial": "random",
        "precision": "f32",
        "arch": "auto",
        "snapshots": "1",
        "distribution": "constant:1",
        "radius": 1.0,
        "spin_top": 2.0,
        "spin_bottom": -1.0,
        "tolerance": 1e-05,
        "threads": 3,
        "figures": "none",
    },
}


@pytest.mark.parametrize("name", NAMES)
def test_names_are_those_of_before(name):
    assert sample_key(RunSettings(**NAMES[name])) == name


def test_the_implicit_integrator_is_one_method_by_two_names():
    one = RunSettings(method="implicit-cundall-strack", stiffness=2e5)
    assert sample_key(one) == sample_key(RunSettings(method="cundall-strack", integrator="implicit", stiffness=2e5))


def test_a_law_owns_its_options():
    settings = [{"law": "coulomb-viscous", "viscosity": f"constant:{value}"} for value in (1, 2)]
    assert len({sample_key(RunSettings(**given)) for given in settings}) == 2
    assert sample_key(RunSettings(viscosity="constant:1")) == sample_key(RunSettings())


@pytest.fixture
def folder(tmp_path):
    """A scan as the first version has left it: 24 samples by six methods, some with options that they did not use."""
    shutil.copytree(BEFORE, tmp_path / "scan")
    return tmp_path / "scan"


def test_a_scan_of_before_is_complete_and_grows(folder):
    assert scan(read_plan(folder / "scan.toml"), folder, engine=Here())["solved_now"] == 0
    larger = read_plan(folder / "scan.toml", ["scan.seed=[0, 1, 2]"])
    report = scan(larger, folder, engine=Here())
    assert (report["samples"], report["solved_now"], report["reached"]) == (36, 12, 36)
    assert read_scan(folder).samples == 36


def test_a_scan_of_before_that_was_killed_goes_on(folder):
    journal = folder / "samples.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[:20]))
    assert scan(read_plan(folder / "scan.toml"), folder, engine=Here())["solved_now"] == 4


def test_a_scan_of_before_is_merged(folder):
    plan = read_plan(folder / "scan.toml")
    whole = (folder / "samples.jsonl").read_text().splitlines(keepends=True)
    (folder / "samples.jsonl").unlink()
    for number in (1, 2):
        (folder / f"part-{number}-of-2.jsonl").write_text("".join(whole[number - 1 :: 2]))
    report = merge(plan, folder)
    assert (report["reached"], report["missing"], report["incomplete_parts"]) == (24, 0, [])
    assert scan(plan, folder, part=Part(2, 1), engine=Here())["solved_now"] == 0
