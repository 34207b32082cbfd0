"""`bearings scan` as scripts use it: exit codes, kills, Ctrl-C, a full disk, progress in logs, one JSON object."""

import csv
import json
import os
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from taichi_bearings.files.scan_journal import read_journal
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.scan import scan
from tests.cli.commands import bearings, refused
from tests.scans.scan_faults import Here, asking
from tests.scans.test_scan import assert_same_but_for_the_clock

COMMAND = [sys.executable, "-m", "taichi_bearings_cli", "scan"]
SLOW = 'shape = [12, 12]\nlaw = "viscous"\n[scan]\nseed = { start = 0, stop = 5000 }\n'  # many seconds in many units


@pytest.fixture
def scan_file(tmp_path):
    def write(text):
        (tmp_path / "scan.toml").write_text(text)
        return tmp_path / "scan.toml"

    return write


def rows(folder):
    with (folder / "scan.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def journalled(folder):
    journal = folder / "samples.jsonl"
    return journal.read_bytes().count(b"\n") if journal.exists() else 0


def wait_for(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_the_table_has_the_promised_columns_and_the_numbers_of_run(scan_file, tmp_path):
    file = scan_file("[scan]\nshape = [[6, 7], [4, 4, 5]]\nseed = { start = 3, stop = 5 }\n")
    done = bearings("scan", file, "--set", "spin_bottom=0.1", "--out", tmp_path / "s", "--workers", "1", "--json")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    report = json.loads(done.stdout)
    assert (report["samples"], report["reached"], report["failed"], report["missing"]) == (4, 4, 0, 0)
    table = rows(tmp_path / "s")
    names = ["shape", "seed", "power", "lower_bound", "gap", "status", "method", "slipping", "slipless", "seconds"]
    assert list(table[0])[: len(names)] == names
    assert [(row["shape"], row["seed"]) for row in table] == [
        ("6x7", "3"),
        ("6x7", "4"),
        ("4x4x5", "3"),
        ("4x4x5", "4"),
    ]
    words = ("--shape", "4,4,5", "--seed", 4, "--spin-bottom", 0.1, "--out", tmp_path / "r", "--json")
    summary = json.loads(bearings("run", *words).stdout)
    for name in ("power", "lower_bound", "gap", "largest_balance_residual", "smallest_slipping_slip"):
        assert float(table[3][name]) == summary[name]
    assert table[3]["slipping"] == str(summary["slipping"])


def test_a_dry_run_writes_nothing(scan_file, tmp_path):
    file = scan_file(SLOW)
    done = bearings("scan", file, "--dry-run", "--out", tmp_path / "s", "--json")
    assert done.returncode == 0, done.stderr
    expected = json.loads(done.stdout)
    assert (expected["samples"], expected["missing"], expected["scanned"]) == (5000, 5000, ["seed"])
    assert 0.5 < expected["seconds"] < 20
    assert "5,000 samples over seed" in bearings("scan", file, "--dry-run").stdout
    part = bearings("scan", file, "--dry-run", "--part", "1/4", "--json")
    assert json.loads(part.stdout)["samples"] == 1250, part.stderr
    assert [entry.name for entry in tmp_path.iterdir()] == ["scan.toml"]


def test_samples_that_stop_short_are_exit_code_1(scan_file, tmp_path):
    file = scan_file('shape = [4, 4]\nmethod = "gradient-descent"\niterations = 4\n[scan]\nseed = [1, 2]\n')
    done = bearings("scan", file, "--out", tmp_path / "s", "--workers", "1")
    assert done.returncode == 1
    assert "2 samples stopped short" in done.stdout
    assert [row["status"] for row in rows(tmp_path / "s")] == ["step-limit"] * 2


def test_failed_samples_are_named_and_exit_code_1(scan_file, tmp_path):
    np.savez(tmp_path / "start.npz", spin=np.ones((3, 4)))
    file = scan_file('shape = [4, 4]\n[scan]\ninitial = ["start.npz", "linear"]\n')
    done = bearings("scan", file, "--out", tmp_path / "s")
    assert done.returncode == 1
    assert "start.npz" in done.stderr
    assert "1 sample failed" in done.stdout
    assert "goes on" not in done.stderr
    assert [row["status"] for row in rows(tmp_path / "s")] == ["failed", "certified"]


def test_bad_input_is_one_sentence_and_exit_code_2(scan_file, tmp_path):
    for text, expected in (("[scan]\nsed = [1]\n", "did you mean"), ("[scan]\nshape = [[5, 5, 2]]\n", "3 or more")):
        assert expected in refused("scan", scan_file(text), "--out", tmp_path / "s")
    refused("scan", tmp_path / "none.toml")
    assert not (tmp_path / "s").exists()


KILLED = """
import os, signal, sys
from taichi_bearings.files.scan_journal import Journal
from taichi_bearings_cli.__main__ import main
kill, left, append = getattr(os, sys.argv.pop(1)), int(sys.argv.pop(1)), Journal.append

def append_some(self, samples):
    global left
    append(self, samples[:left])
    left -= len(samples[:left])
    if left == 0:
        kill(os.getpid(), signal.SIGKILL)

Journal.append = append_some
main()
"""


def test_kills_lose_nothing_and_double_nothing(scan_file, tmp_path):
    """Killed without its worker and with it, resumed by its folder alone, extended: no empty column, every state."""
    scanned = "spin_bottom = [0.0, 0.1, 0.2, 0.3, 0.4]\nseed = { start = 0, stop = 5 }\n"  # five units of work
    file, folder = scan_file(f"shape = [3, 3, 4]\n[scan]\n{scanned}"), tmp_path / "s"
    words = ["scan", file, "--out", folder, "--analyse", "--keep-states", "--workers", "1"]
    for kill, samples in (("kill", "1"), ("killpg", "6")):  # that are written down before
        command = [sys.executable, "-c", KILLED, kill, samples, *words]
        done = subprocess.run(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True)
        assert done.returncode == -signal.SIGKILL
    assert journalled(folder) == 7
    for more, samples in ((folder,), 25), ((file, "--out", folder, "--set", "scan.seed={start=0, stop=6}"), 30):
        done = bearings("scan", *more, "--json")
        assert done.returncode == 0, done.stderr
        assert 0 < json.loads(done.stdout)["solved_now"] <= 18
        table = rows(folder)
        assert len(table) == samples == len(list((folder / "states").glob("*.h5")))
        assert all(row["power_minimum_cut"] and row["domains"] and row["spans"] for row in table)
    whole = read_plan(file, ["scan.seed={start=0, stop=6}"])
    scan(asking(whole, analyse=True), tmp_path / "undisturbed", engine=Here(analyse=True))
    assert_same_but_for_the_clock(folder, tmp_path / "undisturbed")


def test_an_interrupted_scan_keeps_its_samples(scan_file, tmp_path):
    file, folder = scan_file(SLOW), tmp_path / "s"
    process = subprocess.Popen(
        [*COMMAND, file, "--out", folder, "--workers", "1", "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip
    wait_for(lambda: journalled(folder) > 0)
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does: to the workers too
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert err == ""
    report = json.loads(out)
    assert report["interrupted"]
    assert 0 < report["done"] == journalled(folder) == len(rows(folder)) < 5000


def test_a_full_disk_is_told_and_loses_nothing(scan_file, tmp_path):
    """A limit on the size of files stands for the disk."""
    file, folder = scan_file(SLOW), tmp_path / "s"

    def fill():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))

    words = [*COMMAND, file, "--out", folder, "--workers", "1"]
    done = subprocess.run(words, capture_output=True, text=True, preexec_fn=fill)
    assert done.returncode == 2
    assert "samples.jsonl cannot be written" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    kept = journalled(folder)
    assert f"{kept} samples are kept" in done.stderr
    assert len(read_journal(folder / "samples.jsonl")) == kept > 0
