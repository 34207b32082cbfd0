"""Scans on a real Dask cluster of two processes: the same bits as on this machine, whatever dies."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from functools import partial

import pytest

from taichi_bearings.copies import CAN_COPY
from taichi_bearings.errors import BearingsError
from taichi_bearings.scans.cluster import DaskEngine, connected
from taichi_bearings.scans.scan import scan
from tests.scans import scan_faults
from tests.scans.test_scan import MIXED, assert_same_but_for_the_clock

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")  # which distributed needs
COMMAND = [sys.executable, "-m", "taichi_bearings_cli", "scan"]


@contextlib.contextmanager
def cluster_of(workers):
    """A Dask cluster on this machine, whose scheduler moves a unit once."""
    with dask.config.set({"distributed.scheduler.allowed-failures": 1}):
        cluster = distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0", silence_logs=50
        )
    with cluster:
        yield cluster


@pytest.fixture(scope="module")
def client():
    with cluster_of(2) as cluster, connected(cluster.scheduler_address) as client:
        yield client


@pytest.fixture
def plan(plan_of):
    return plan_of("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 14 }\n")


def solvers(client):
    """Processes that solve, of all Dask workers: copies of a child of each worker, or where none are made (copies.py)
    its children themselves. There may be a tracker of resources beside them."""
    found, depth = [], 2 if CAN_COPY else 1
    for pid in client.run(os.getpid).values():
        level = [psutil.Process(pid)]
        for _ in range(depth):
            with contextlib.suppress(psutil.NoSuchProcess):
                level = [child for process in level for child in process.children()]
        with contextlib.suppress(psutil.NoSuchProcess):
            found += [of.pid for of in level if "resource_tracker" not in " ".join(of.cmdline())]
    return found


def test_the_same_bits_as_on_this_machine(client, plan_of, tmp_path):
    plan = plan_of(MIXED)
    report = scan(plan, tmp_path / "cluster", client=client)
    assert (report["reached"], report["workers"]) == (12, 2)
    scan(plan, tmp_path / "local", engine=scan_faults.Here())
    assert_same_but_for_the_clock(tmp_path / "cluster", tmp_path / "local")
    assert scan(plan, tmp_path / "cluster")["solved_now"] == 0
    assert solvers(client) == []  # they end with their scan


@pytest.mark.parametrize("whom", ["solver", "Dask worker"])
def test_killed_workers_lose_nothing(client, plan_of, tmp_path, whom):
    plan = plan_of("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 40 }\n")
    engine = DaskEngine(client, partial(scan_faults.dawdle, seconds=0.05))
    kills = []

    def kill_once(progress):
        if not kills and progress.done > 5:
            victims = solvers(client) if whom == "solver" else list(client.run(os.getpid).values())
            kills.append(victims[0])
            os.kill(victims[0], signal.SIGKILL)

    def units(samples, structure, workers):
        return [tuple(samples[start : start + 2]) for start in range(0, len(samples), 2)]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("taichi_bearings.scans.estimate.units_of", units)
        report = scan(plan, tmp_path / "scan", engine=engine, monitor=kill_once)
    assert len(kills) == 1
    assert (report["reached"], report["failed"], report["missing"]) == (40, 0, 0)
    scan(plan, tmp_path / "undisturbed", engine=scan_faults.Here())
    assert_same_but_for_the_clock(tmp_path / "scan", tmp_path / "undisturbed")


@pytest.mark.slow
def test_a_scheduler_that_goes_away_is_told_and_loses_nothing(plan, tmp_path):
    with contextlib.ExitStack() as stack:
        cluster = stack.enter_context(
            distributed.LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=":0", silence_logs=50)
        )
        there = stack.enter_context(connected(cluster.scheduler_address))
        there._timeout = 0.5  # seconds for which it tries to find the scheduler again
        engine = DaskEngine(there, partial(scan_faults.dawdle, seconds=0.3))

        def leave(progress):
            if progress.done:
                cluster.close()

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("taichi_bearings.scans.estimate.units_of", lambda samples, *_: [(s,) for s in samples])
            with pytest.raises(BearingsError, match="connection to the Dask scheduler is lost"):
                scan(plan, tmp_path / "scan", engine=engine, monitor=leave)
    report = scan(plan, tmp_path / "scan")
    assert report["reached"] == 14
    assert 0 < report["solved_now"] < 14


def test_the_command_on_a_cluster_and_its_interruption(client, tmp_path):
    (tmp_path / "scan.toml").write_text("shape = [8, 8, 8]\n[scan]\nseed = { start = 0, stop = 400 }\n")
    words = [
        *COMMAND,
        tmp_path / "scan.toml",
        "--scheduler",
        client.scheduler.address,
        "--json",
        "--out",
        tmp_path / "s",
    ]
    process = subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )  # fmt: skip
    journal, end = tmp_path / "s" / "samples.jsonl", time.monotonic() + 180
    while not (journal.exists() and journal.read_bytes().count(b"\n")):
        assert time.monotonic() < end
        assert process.poll() is None
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert err == ""
    report = json.loads(out)
    assert report["interrupted"]
    assert 0 < report["done"] == journal.read_bytes().count(b"\n") < 400
