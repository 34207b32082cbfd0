"""`bearings analyse` as scripts use it."""

import json
import re
import sys

import numpy as np
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


def test_a_line_has_name_value_meaning_and_unit(solved):
    done = bearings("analyse", solved, "--no-figures")
    report = json.loads(bearings("analyse", solved, "--no-figures", "--json").stdout)
    rows = [re.split(r" {2,}", line.strip(), maxsplit=2) for line in done.stdout.splitlines() if line[:2] == "  "]
    shown = {row[0]: row[1:] for row in rows if len(row) == 3}
    assert shown["power_minimum_cut"][0] == f"{report['power_minimum_cut']:.10g}"
    assert shown["power_minimum_cut"][1].startswith("power of the minimum cut")
    assert shown["power_minimum_cut"][1].endswith(" [energy/time]")
    assert shown["spans"] == ["yes" if report["spans"] else "no", "whether slipless contacts join bottom and top"]
    assert shown["slipping"][0] == f"{report['slipping']:,}"
    lines = done.stdout.splitlines()
    first, last = (next(n for n, line in enumerate(lines) if line.startswith(title)) for title in ("minimum", "slipl"))
    starts = {re.match(r"  \S+ +\S+  ", line).end() for line in lines[first + 1 : last]}
    assert len(starts) == 1  # the meanings stand below each other


def test_several_samples_are_summed_up(tmp_path):
    assert bearings("run", "--shape", "6,6", "--replicas", 5, "--out", tmp_path / "run").returncode == 0
    done = bearings("analyse", tmp_path / "run", "--no-figures")
    assert "  5 of 5  whether exactly the contacts of the minimum cut slip\n" in done.stdout
    assert "planes_crossed" not in done.stdout  # no path joins bottom and top
    report = json.loads(bearings("analyse", tmp_path / "run", "--no-figures", "--json").stdout)
    assert report["slipping_contacts_are_the_cut"] == [True] * 5


def test_samples_whose_coefficients_are_given_have_no_seeds_and_proven_states_are_not_called_unproven(tmp_path):
    rng = np.random.default_rng(1)
    np.savez(tmp_path / "own.npz", x=rng.uniform(0.1, 1.0, (2, 4, 5)), y=rng.uniform(0.1, 1.0, (2, 5, 4)))
    given = ("--coefficients", tmp_path / "own.npz", "--replicas", 2, "--figures", "none")
    few = ("--method", "interior-point", "--iterations", 1)  # too few steps to prove all states
    assert bearings("run", *given, *few, "--out", tmp_path / "run").returncode == 1
    unproven = json.loads((tmp_path / "run" / "summary.json").read_text())["unproven"]
    assert 0 < sum(unproven) < 2 * 31
    first, _, second = bearings("analyse", tmp_path / "run", "--no-figures").stdout.splitlines()[:3]
    assert first.endswith("contact states: not all proven, the others decided by slip and friction")
    assert second.startswith("2 samples: of each number")


@pytest.mark.parametrize("replicas", [1, 2])
def test_a_run_that_did_not_reach_the_minimum_is_said_to(replicas, tmp_path):
    words = ("--shape", "4,4,5", "--method", "gradient-descent", "--iterations", 4, "--replicas", replicas)
    assert bearings("run", *words, "--out", tmp_path / "run").returncode == 1
    done = bearings("analyse", tmp_path / "run", "--no-figures")
    beyond = "not certified (least power or potential not proven within the tolerance)"
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


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are of Unix")
def test_on_a_terminal_a_meaning_goes_on_below_itself(solved):
    from tests.cli.terminal import on_terminal

    session = on_terminal("analyse", solved, "--no-figures", columns=100, report=True)
    lines = session.raw.decode().replace("\r", "").split("\n")
    first = next(n for n, line in enumerate(lines) if line.startswith("  power_minimum_cut "))
    start = lines[first].index("power of the minimum cut")
    assert len(lines[first]) <= 100
    assert lines[first + 1].index(lines[first + 1].strip()) == start
