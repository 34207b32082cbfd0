"""Workers that stop answering or are interrupted together with their scan."""

import contextlib
import multiprocessing
import os
import subprocess
import sys
import time
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from taichi_bearings import copies
from taichi_bearings.copies import CAN_COPY
from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.interrupts import SIGNALS
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.engine import LocalEngine, run_samples
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.scan import scan
from tests.scans import scan_faults

psutil = pytest.importorskip("psutil")  # which distributed needs
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


@pytest.fixture
def scan_file(tmp_path):
    file = tmp_path / "scan.toml"
    file.write_text(f"shape = [4, 5]\n[scan]\nseed = [1, {scan_faults.HANGS}, 2]\n")
    return file


def test_a_worker_that_is_stopped_is_ended_and_costs_its_sample_alone(scan_file, tmp_path):
    engine = LocalEngine(scan_faults.halt, 1, partial(scan_faults.allowed, seconds=0.3))
    report = scan(read_plan(scan_file), tmp_path / "scan", engine=engine)
    assert (report["done"], report["failed"]) == (2, 1)
    stored = read_scan(tmp_path / "scan")
    assert stored.table["seed"][stored.failed].tolist() == [scan_faults.HANGS]
    assert "no result within 0.3 s" in report["failures"][0]["error"]
    assert multiprocessing.active_children() == []


def begun(words, generation):
    """A command in a group of its own, once it has started a worker (generation 2) or at least the process of which
    workers are copies (1)."""
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    end, command = time.monotonic() + 60, psutil.Process(process.pid)
    while time.monotonic() < end:
        found = [child for child in command.children() if is_of_multiprocessing(child)]
        if CAN_COPY and generation == 2:
            found = [of for original in found for of in original.children() if is_at_work(of)]
        if found:
            break
        time.sleep(0.005)
    return process


def is_of_multiprocessing(process):
    """True for a process that multiprocessing has started, but for its tracker of resources."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return any("forkserver" in word or "spawn_main" in word for word in process.cmdline())
    return False


def is_at_work(process):
    """True for a worker that is about to take samples: it has offered itself to Linux as the first to be killed."""
    with contextlib.suppress(OSError):
        return int(Path(f"/proc/{process.pid}/oom_score_adj").read_text()) >= 500
    return False


@pytest.mark.parametrize("generation", [1, 2])
@pytest.mark.parametrize("what", SIGNALS)
def test_an_interrupt_of_all_processes_while_workers_start_is_quiet(tmp_path, what, generation):
    """Ctrl-C reaches the whole group; a process that is loading would print a traceback."""
    scan_file = tmp_path / "scan.toml"
    scan_file.write_text("shape = [8, 8]\n[scan]\nseed = { start = 0, stop = 20000 }\n")  # it cannot end by itself
    words = [sys.executable, "-m", "taichi_bearings_cli", "scan", scan_file, "--workers", "2", "--out", tmp_path / "s"]
    process = begun(words, generation)
    time.sleep(0.1)
    os.killpg(process.pid, what)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    if generation == 1:  # perhaps it has no folder yet
        assert err == "" or (err.strip().startswith("bearings: interrupted") and "\n" not in err.strip())
    else:
        assert err == ""
        assert "done" in out or "result" in out
    if (tmp_path / "s").exists():
        assert not [name for name in os.listdir(tmp_path / "s") if "in-use" in name]
    assert not left_in_group(process.pid)


def left_in_group(group):
    """Processes of a group that still run a moment later."""
    end = time.monotonic() + 20
    while time.monotonic() < end:
        left = []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, ProcessLookupError):
                if os.getpgid(process.pid) == group and process.status() != psutil.STATUS_ZOMBIE:
                    left.append(process.pid)
        if not left:
            return []
        time.sleep(0.1)
    return left


def test_the_process_whose_copies_are_workers_ends_with_them(scan_file, tmp_path):
    before = {child.pid for child in psutil.Process().children() if is_of_multiprocessing(child)}
    scan(read_plan(scan_file), tmp_path / "scan", workers=2)
    assert {child.pid for child in psutil.Process().children() if is_of_multiprocessing(child)} <= before


@pytest.mark.skipif(not CAN_COPY, reason="workers are no copies here")
def test_what_is_copied_has_neither_threads_nor_a_runtime():
    """A copy would lack the threads, and a runtime without its threads would wait for ever."""
    asks = (
        "import os, taichi_bearings.scans.loaded; from taichi_bearings import runtime; pid = os.fork()\n"
        "if pid: os.waitpid(pid, 0)\n"
        "print(len(os.listdir('/proc/self/task')), runtime.running_program())"
    )
    answers = subprocess.run([sys.executable, "-c", asks], capture_output=True, text=True, check=True).stdout
    assert answers.split("\n")[:2] == ["1 None", "1 None"]  # of the copy, and of what was copied, once it was


@pytest.mark.skipif(not CAN_COPY, reason="workers are no copies here")
def test_workers_have_the_environment_of_their_scan(monkeypatch):
    for value in ("first", "second"):
        monkeypatch.setenv("BEARINGS_TEST", value)
        engine = LocalEngine(scan_faults.tell_environment, 1)
        task = SimpleNamespace(key="BEARINGS_TEST", label="", settings=RunSettings())
        with closing(engine):
            found = [record for records in run_samples([(task,)], engine) for record in records]
        assert found[0]["scalars"]["value"] == value


def test_workers_start_anew_where_nothing_can_be_copied(scan_file, tmp_path, monkeypatch):
    """As under macOS and Windows: there a scan gives the same bits."""
    scan(read_plan(scan_file), tmp_path / "copied", workers=2)
    monkeypatch.setattr(copies, "CAN_COPY", False)
    scan(read_plan(scan_file), tmp_path / "anew", workers=2)
    one, two = (read_scan(tmp_path / name).table for name in ("copied", "anew"))
    for name in ("power", "lower_bound"):
        assert (one[name] == two[name]).all()
