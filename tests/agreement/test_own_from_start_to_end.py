"""A law and a method of one's own, with an option: solve, solve_many, run, resume, load, verify, and a new process."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
JOURNEYS = """
import json, sys
from pathlib import Path
from tests.agreement.own import CASES, journey

if __name__ == "__main__":
    Path(sys.argv[2]).write_text(json.dumps({"-".join(case): journey(Path(sys.argv[1]), *case) for case in CASES}))
"""
BEARINGS = "from taichi_bearings_cli.main import main; main()"
OWN = ["bounded-accelerated", "bounded-gradient-descent"]
KNOWN = ["viscous-accelerated", "viscous-gradient-descent", "viscous-auto"]


@pytest.fixture(scope="module")
def found(tmp_path_factory, needs_f64):
    """What the journeys found, all in one process, by law and method."""
    folder = tmp_path_factory.mktemp("journeys")
    (folder / "script.py").write_text(JOURNEYS)
    environment = {"PYTHONPATH": str(ROOT)}
    done = python(folder / "script.py", folder, folder / "found.json", env=environment)
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "found.json").read_text())


def python(*words, env):
    import os

    command = [sys.executable, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, env=os.environ | env, timeout=240)


def bearings(*words, code=BEARINGS):
    return python("-c", code, *words, env={"PYTHONPATH": str(ROOT)})


@pytest.mark.parametrize("name", OWN + KNOWN)
def test_all_ways_lead_to_the_same_power(found, name):
    way = found[name]
    assert way["status"] == "certified"
    for power in (*way["many"], way["resumed"], way["loaded"]):
        assert power == pytest.approx(way["power"], rel=1e-6)


def test_only_runs_of_the_method_keep_its_option(found):
    assert {name for name, way in found.items() if way["kept"]} == {"bounded-accelerated", "viscous-accelerated"}


@pytest.mark.parametrize("name", KNOWN)
def test_a_known_law_is_verified_whatever_method_solved_it(found, name):
    assert found[name]["verified"] is True
    done = bearings("verify", found[name]["path"], code=f"import tests.agreement.own; {BEARINGS}")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", OWN)
def test_a_law_of_ones_own_is_not_verified(found, name):
    assert "has the law 'bounded'; only coulomb, viscous, coulomb-viscous can be verified" in found[name]["verified"]


WHY = {
    "viscous-gradient-descent": None,
    "viscous-auto": None,
    "viscous-accelerated": "has the method 'accelerated'; known are auto, planar-cut, ",
    "bounded-gradient-descent": "has the law 'bounded'; known are coulomb, viscous, coulomb-viscous, and laws of one's",
}


@pytest.mark.parametrize("name", WHY)
def test_a_process_that_does_not_know_them_says_what_to_import(found, name):
    done = bearings("verify", found[name]["path"])
    if WHY[name] is None or "method" in WHY[name]:  # a proof does not need the method
        assert done.returncode == 0, done.stderr
    if WHY[name] is None:
        return
    for words in (("analyse",), ("run", "--resume")):
        done = bearings(*words, found[name]["path"])
        assert done.returncode == 2
        assert WHY[name] in done.stderr
        assert "once the file that" in done.stderr


def test_an_option_alone_is_named(found, tmp_path):
    """As in the files of runs that were made while the method was loaded."""
    import h5py

    path = Path(found["viscous-gradient-descent"]["path"]) / "run.h5"
    (tmp_path / "run.h5").write_bytes(path.read_bytes())
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file.attrs["scene"] = str(file.attrs["scene"]) + "restart = true\n"
        del file.attrs["sha256"]
    assert bearings("verify", tmp_path / "run.h5").returncode == 0
    done = bearings("analyse", tmp_path / "run.h5")
    assert done.returncode == 2
    assert "its scene has the option 'restart' of a method that is not loaded; import the file that" in done.stderr
