"""What is written of one replica of a run: its own history, and files and sentences that name it."""

import json
import os

import numpy as np
import pytest

from taichi_bearings.export.vtkhdf import export
from taichi_bearings.runs.lattice_run import solve_job
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.run import prepare, run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from taichi_bearings.view.view import view
from tests.cli.commands import bearings

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")


def test_the_history_of_a_replica_ends_with_its_own_last_iteration(tmp_path):
    """Though those that are solved beside it take longer."""
    whole = solve_job(prepare(RunSettings(shape=(4, 4, 4), replicas=6, threads=1)))
    assert len(set(whole.own["iterations"].tolist())) > 1
    for number in range(6):
        one = whole.sample(number)
        alone = solve_job(prepare(RunSettings(shape=(4, 4, 4), seed=number, threads=1)))
        assert one.iterations == one.history["iteration"][-1] == alone.iterations
        np.testing.assert_array_equal(one.history["iteration"], alone.history["iteration"])
        np.testing.assert_array_equal(one.history["power"], alone.history["power"])
        path = run_of(one).save(tmp_path / f"{number}")
        assert verify(path)["contradictions"] == []


def run_of(solution):
    return Result(RunSettings(shape=(4, 4, 4), seed=solution.scene.seeds[0], threads=1), solution)


def test_files_of_a_replica_bear_its_number(tmp_path):
    path = run(RunSettings(shape=(4, 5), replicas=3, threads=1, figures="none"), tmp_path / "run").path
    for make, name in ((export, "run{}.vtkhdf"), (view, "view{}.html")):
        first, third = make(path), make(str(path), replica=2)
        assert (first["replica"], third["replica"], third["replicas"]) == (0, 2, 3)
        assert first["file"] == str(path / name.format(""))
        assert third["file"] == str(path / name.format("-replica-2"))


def test_commands_say_which_replica_they_show(tmp_path):
    words = ("--shape", "4,5", "--replicas", "2", "--figures", "none", "--out", tmp_path / "run")
    assert bearings("run", *words).returncode == 0
    done = bearings("export", tmp_path / "run")
    assert "this is replica 0 of 2, counted from 0, which --replica chooses" in done.stdout
    done = bearings("plot", "spins", tmp_path / "run", "--replica", "1")
    assert done.stdout.strip().endswith("spins-replica-1.pdf")
    assert "replica 1 of 2" in done.stderr


def test_a_method_in_double_precision_is_said_to_be_one(tmp_path):
    words = ("--shape", "4,4,4", "--precision", "f32", "--figures", "none", "--json", "--out", tmp_path / "run")
    done = bearings("run", *words, env=dict(os.environ))  # in a process of its own, with a runtime in f32
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["method"], found["precision"]) == ("interior-point", "f64")
    assert found["gap"] < 1e-10
    words = (*words, "--force", "--method", "gradient-descent", "--tolerance", "1e-2")
    assert json.loads(bearings("run", *words, env=dict(os.environ)).stdout)["precision"] == "f32"


def test_the_settings_of_a_replica_are_those_that_it_would_have_alone():
    whole = RunSettings(shape=(4, 4, 4), seed=5, replicas=3, method="gradient-descent", iterations=7)
    one = whole.of_replica(7)
    assert one == RunSettings(shape=(4, 4, 4), seed=7, method="gradient-descent", iterations=7)
    assert (whole.seed, whole.replicas, one.owned) == (5, 3, whole.owned)
