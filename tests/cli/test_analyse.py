"""`bearings analyse` as scripts use it."""

import json

import pytest

from tests.cli.commands import bearings, refused


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    assert bearings("run", "--shape", "5,4,6", "--seed", 3, "--out", folder).returncode == 0
    return folder


def test_json_is_one_object_with_the_promised_keys(solved):
    done = bearings("analyse", solved, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    promised = {
        "power", "power_minimum_cut", "power_over_cut", "cut_is_unique", "slipless_fraction", "spans",
        "reached_fraction", "spanning_fraction", "domains", "threshold",
    }  # fmt: skip
    assert promised <= set(report)
    assert all(not isinstance(report[key], (list, dict)) for key in promised)
    assert 0 < report["power_over_cut"] <= 1
    assert report["files"][0] == str(solved / "run.h5")
    assert done.stderr == ""  # quiet in a pipe


def test_several_samples_are_summed_up(tmp_path):
    assert bearings("run", "--shape", "6,6", "--replicas", 5, "--out", tmp_path / "run").returncode == 0
    done = bearings("analyse", tmp_path / "run", "--no-figures")
    assert "whether exactly the contacts of the minimum cut slip: 5 of 5" in done.stdout
    report = json.loads(bearings("analyse", tmp_path / "run", "--no-figures", "--json").stdout)
    assert report["slipping_contacts_are_the_cut"] == [True] * 5


@pytest.mark.parametrize("replicas", [1, 2])
def test_a_run_that_did_not_reach_the_minimum_is_said_to(replicas, tmp_path):
    words = ("--shape", "4,4,5", "--method", "gradient-descent", "--iterations", 4, "--replicas", replicas)
    assert bearings("run", *words, "--out", tmp_path / "run").returncode == 1
    done = bearings("analyse", tmp_path / "run", "--no-figures")
    beyond = "not certified (least power not proven within the tolerance)"
    assert f"{beyond}: {replicas} of {replicas} sample{'s' * (replicas > 1)} (step-limit)" in done.stdout
    report = json.loads(bearings("analyse", tmp_path / "run", "--no-figures", "--json").stdout)
    assert report["status"] == ("step-limit" if replicas == 1 else ["step-limit"] * 2)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["nowhere"], "not a run"),
        (["{run}", "--replica", "4"], "replica is 4"),
        (["{run}", "--threshold", "0"], "threshold"),
        (["{run}", "--threshold", "nan"], "threshold"),
        (["{run}", "--threshold", "inf"], "threshold"),
        (["{run}", "--out", "{run}/run.h5"], "cannot be written"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(solved, words, complaint):
    assert complaint in refused("analyse", *(word.format(run=solved) for word in words))
