"""Workers that stop answering or are interrupted together with their scan."""

import multiprocessing
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.interrupts import SIGNALS
from taichi_bearings.scans.engine import LocalEngine
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.scan import scan
from tests.scans import scan_faults

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


@pytest.fixture
def scan_file(tmp_path):
    file = tmp_path / "scan.toml"
    file.write_text(f"shape = [4, 5]\n[scan]\nseed = [1, {scan_faults.HANGS}, 2]\n")
    return file


def test_a_worker_that_is_stopped_is_ended_and_costs_its_sample_alone(scan_file, tmp_path):
    engine = LocalEngine(scan_faults.halt, 1, partial(scan_faults.allowed, seconds=1.0))
    report = scan(read_plan(scan_file), tmp_path / "scan", engine=engine)
    assert (report["done"], report["failed"]) == (2, 1)
    stored = read_scan(tmp_path / "scan")
    assert stored.table["seed"][stored.failed].tolist() == [scan_faults.HANGS]
    assert "no result within 1 s" in report["failures"][0]["error"]
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize("what", SIGNALS)
def test_an_interrupt_of_all_processes_while_workers_start_is_quiet(scan_file, tmp_path, what):
    """Ctrl-C reaches the whole group; a worker that is loading would print a traceback."""
    words = [sys.executable, "-m", "taichi_bearings_cli", "scan", scan_file, "--workers", "2", "--out", tmp_path / "s"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    end, threads = time.monotonic() + 60, Path(f"/proc/{process.pid}/task")
    while sys.platform.startswith("linux") and time.monotonic() < end:
        children = [pid for file in threads.glob("*/children") for pid in file.read_text().split()]
        if len(children) >= 2:  # the first is a tracker of multiprocessing
            break
        time.sleep(0.005)
    time.sleep(0.1)
    os.killpg(process.pid, what)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert err == ""
    assert "done" in out or "result" in out
    assert not [name for name in os.listdir(tmp_path / "s") if "in-use" in name]
