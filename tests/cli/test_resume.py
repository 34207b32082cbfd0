"""Runs that are killed and go on: the same bits, no half-written file, clear words for what cannot be resumed."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest
from taichi_bearings_cli.run import _how_to_go_on

import taichi_bearings as tb
from taichi_bearings import compiler
from taichi_bearings.runs import packing_run
from tests.cli.commands import bearings, refused

SPRINGS = ("--method", "cundall-strack", "--initial", "random", "--threads", "1")
SCENE = ("--shape", "3,3,4", *SPRINGS, "--figures", "none")
COURSE = ("--duration", "2", "--record", "linear:0,2,16", "--snapshots", "0,1,2", "--checkpoint-every", "0.02")


def arrays_of(run):
    found = {}
    with h5py.File(run / "run.h5") as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if hasattr(item, "shape") else None)
    del found["history/seconds"]
    return found


def kill_after(words, checkpoint, writings):
    """Start a run and SIGKILL it after so many new checkpoints; True if it was killed before it ended."""
    process = subprocess.Popen([sys.executable, "-m", "taichi_bearings_cli", *map(str, words)], stderr=subprocess.PIPE)
    last, seen = checkpoint.stat().st_mtime_ns if checkpoint.exists() else None, 0
    while process.poll() is None and seen < writings:
        time.sleep(0.005)
        now = checkpoint.stat().st_mtime_ns if checkpoint.exists() else last
        seen, last = seen + (now != last), now
    process.kill()
    process.communicate()
    return process.returncode != 0


def packing_scene(folder, *method):
    """Options of a course of a packing, two replicas, of as many snapshots as that of COURSE."""
    arrays = tb.Packing.lattice("bcc", (2, 2, 3), spin_bottom=0.2).arrays()
    del arrays["friction"]
    np.savez(folder / "bcc.npz", **arrays)
    words = ("--packing", folder / "bcc.npz", "--replicas", "2", "--initial", "random", "--threads", "1", *method)
    words = (*words, "--figures", "none")
    return *words, "--record", "linear:0,0.02,9", "--snapshots", "0,0.006,0.02", "--checkpoint-every", "0.02"


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize(
    "words", [("--shape", "13,12,12"), ("--shape", "10,10,10", "--method", "operator-splitting", "--tolerance", "1e-5")]
)
def test_a_minimisation_that_is_killed_goes_on_to_the_answer_of_an_undisturbed_one(tmp_path, words):
    common = (*words, "--threads", "1", "--figures", "none")
    assert bearings("run", *common, "--out", tmp_path / "whole").returncode == 0
    killed = ("run", *common, "--checkpoint-every", "0.01", "--out", tmp_path / "a")
    checkpoint = tmp_path / "a" / "checkpoint.h5"
    if kill_after(killed, checkpoint, 3):
        assert not (tmp_path / "a" / "run.h5").exists()
        done = bearings("run", "--resume", tmp_path / "a", "--json")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["status"] == "certified"
    whole, again = arrays_of(tmp_path / "whole"), arrays_of(tmp_path / "a")
    assert whole["spin"] == pytest.approx(again["spin"], abs=1e-12)
    assert np.array_equal(whole["contact/x/state"], again["contact/x/state"])


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize(("kind", "cells", "replicas"), [("square", (75, 75), 2), ("triangular", (90, 46), 1)])
def test_a_minimum_of_a_packing_that_is_killed_goes_on_to_the_same_bits(tmp_path, kind, cells, replicas):
    """Where contact states are settled exactly, and where that is left to springs."""
    arrays = tb.Packing.lattice(kind, cells).arrays()
    del arrays["friction"]
    np.savez(tmp_path / "discs.npz", **arrays)
    words = ("--packing", tmp_path / "discs.npz", "--method", "interior-point", "--replicas", replicas, "--seed", "3")
    words = (*words, "--threads", "1", "--figures", "none", "--checkpoint-every", "0.001")
    assert bearings("run", *words, "--out", tmp_path / "whole").returncode == 0
    killed, draw = tmp_path / "killed", random.Random(len(kind))
    call = ["run", *words, "--out", killed]
    for writings in (draw.randint(4, 9), draw.randint(2, 4)):
        assert kill_after(call, killed / "checkpoint.h5", writings), "the run ended before it was killed"
        assert not (killed / "run.h5").exists()
        call = ["run", "--resume", killed]
    with h5py.File(killed / "checkpoint.h5") as file:
        kept = []
        file.visit(kept.append)
    assert any(name.endswith("now/spins") for name in kept)
    done = bearings("run", "--resume", killed, "--json")
    assert done.returncode == 0, done.stderr
    assert set(np.ravel(json.loads(done.stdout)["status"])) == {"certified"}
    one, other = arrays_of(tmp_path / "whole"), arrays_of(killed)
    assert set(one) == set(other)
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("method", ["", "cundall-strack"])
def test_a_run_killed_at_random_moments_gives_the_same_bits(tmp_path, method):
    """Of a lattice and of a packing."""
    scene, count = (*SCENE, *COURSE), (16,)
    if method:
        scene, count = packing_scene(tmp_path, "--method", method, "--duration", "0.02"), (2, 9)
    undisturbed = bearings("run", *scene, "--out", tmp_path / "undisturbed", "--json")
    assert undisturbed.returncode == 0, undisturbed.stderr
    killed, draw = tmp_path / "killed", random.Random(7)
    words = ["run", *scene, "--out", killed]
    for _ in range(2):
        assert kill_after(words, killed / "checkpoint.h5", draw.randint(1, 3)), "the run ended before it was killed"
        assert not (killed / "run.h5").exists()
        words = ["run", "--resume", killed]
    done = bearings("run", "--resume", killed, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["power"] == json.loads(undisturbed.stdout)["power"]
    one, other = arrays_of(tmp_path / "undisturbed"), arrays_of(killed)
    assert set(one) == set(other)
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    assert one["history/time"].shape == count
    assert one["snapshots/time"].shape == (*count[:-1], 3)
    assert one["snapshots/spin"].shape[: len(count)] == (*count[:-1], 3)


def test_a_finished_run_can_go_on_for_longer(tmp_path):
    short = ("--duration", "1", "--checkpoint-every", "100")
    assert bearings("run", *SCENE, *short, "--out", tmp_path / "a").returncode == 0
    (tmp_path / "a" / "notes.txt").write_text("mine")
    done = bearings("run", "--resume", tmp_path / "a" / "run.h5", "--duration", "2")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a" / "notes.txt").read_text() == "mine"
    assert bearings("run", *SCENE, "--duration", "2", "--out", tmp_path / "b").returncode == 0
    np.testing.assert_array_equal(arrays_of(tmp_path / "a")["spin"], arrays_of(tmp_path / "b")["spin"])


def test_a_run_ends_at_its_duration_and_stays_resumable_as_it_is(tmp_path):
    """Though the duration is no multiple of the step."""
    run = tmp_path / "run"
    words = (*SCENE, "--duration", "0.50001", "--record", "linear:0,0.5,6", "--checkpoint-every", "100")
    assert bearings("run", *words, "--out", run).returncode == 0
    once = arrays_of(run)
    assert once["history/time"][-1] == 0.50001
    for changes in (("--tolerance", "1e-3"), ("--duration", "0.50001")):
        done = bearings("run", "--resume", run, *changes)
        assert done.returncode == 0, done.stderr
        again = arrays_of(run)
        assert set(again) == set(once)
        for name in once:
            np.testing.assert_array_equal(again[name], once[name], err_msg=name)
    assert "is at the time 0.5000" in refused("run", "--resume", run, "--duration", "0.500009")


def test_what_was_drawn_of_the_answer_before_goes_and_nothing_else(tmp_path):
    stopped = ("--shape", "4,5", *SPRINGS, "--duration", "1", "--checkpoint-every", "100", "--out", tmp_path / "run")
    assert bearings("run", *stopped).returncode == 0
    written = {file.name for file in (tmp_path / "run").iterdir()}
    resume = ("run", "--resume", tmp_path / "run", "--duration")
    for kind in ("spins", "domains"):
        assert bearings("plot", kind, tmp_path / "run").returncode == 0
    old = (tmp_path / "run" / "history.png").read_bytes()
    assert bearings(*resume, "2").returncode == 0
    assert {file.name for file in (tmp_path / "run").iterdir()} == written
    assert (tmp_path / "run" / "history.png").read_bytes() != old

    assert bearings("analyse", tmp_path / "run").returncode == 0
    assert {file.name for file in (tmp_path / "run").iterdir()} == written | {"network.png", "domains.png"}
    (tmp_path / "run" / "own.png").write_text("mine")
    assert bearings(*resume, "3").returncode == 0
    assert {file.name for file in (tmp_path / "run").iterdir()} == written | {"own.png"}
    with h5py.File(tmp_path / "run" / "run.h5") as file:
        assert "analysis" not in file


def test_what_cannot_be_resumed_is_said_in_one_sentence(tmp_path):
    def refuses(*words):
        return refused("run", *words, cwd=tmp_path)

    assert "no nothing/checkpoint.h5" in refuses("--resume", "nothing")
    stopped = (*SCENE, "--iterations", "500", "--checkpoint-every", "100", "--out", "run")
    assert bearings("run", *stopped, cwd=tmp_path).returncode == 1
    assert "seed cannot change" in refuses("--resume", "run", "--seed", "4")
    assert "leave out SCENE, --out, --force" in refuses("scene.toml", "--resume", "run")
    assert "does not use it; it needs --method interior-point or" in refuses(
        "--shape", "4,4", "--checkpoint-every", "5"
    )
    assert "does not use it; it needs --method rigid-limit" in refuses("--shape", "3,3,4", "--duration", "5")
    assert "record is 'soon'" in refuses(*SCENE, "--record", "soon")
    longer = ("--iterations", "1000000", "--duration")
    assert bearings("run", "--resume", "run", *longer, "0.5", cwd=tmp_path).returncode == 0
    assert "is at the time 0.5; it must be longer" in refuses("--resume", "run", "--duration", "0.1")
    before = (tmp_path / "run" / "run.h5").read_bytes()
    assert "iterations is 5, but the checkpoint of run is at iteration" in refuses(
        "--resume", "run", "--iterations", "5"
    )
    assert "time_limit is 1e-09 s, but the checkpoint of run is reached after" in refuses(
        "--resume", "run", "--time-limit", "1e-9"
    )
    assert (tmp_path / "run" / "run.h5").read_bytes() == before
    with h5py.File(tmp_path / "run" / "checkpoint.h5", "a") as file:
        del file["gear_0"]
    assert "incomplete" in refuses("--resume", "run", "--duration", "1")
    (tmp_path / "run" / "checkpoint.h5").write_bytes(b"damaged")
    assert "cannot be read as a checkpoint" in refuses("--resume", "run")


def test_coefficients_and_spins_from_files_are_kept_for_the_resumed_run(tmp_path):
    source = bearings("run", *SCENE, "--iterations", "500", "--out", tmp_path / "source")
    assert source.returncode == 1
    files = ("--coefficients", tmp_path / "source/run.h5", "--initial", tmp_path / "source/run.h5")
    common = ("--shape", "3,3,4", "--method", "cundall-strack", "--figures", "none", *files, "--duration", "0.5")
    assert bearings("run", *common, "--out", tmp_path / "a").returncode == 0
    assert bearings(
        "run", *common, "--iterations", "700", "--checkpoint-every", "9", "--out", tmp_path / "b"
    ).returncode
    (tmp_path / "source" / "run.h5").unlink()
    (tmp_path / "b").rename(tmp_path / "c")
    done = bearings("run", "--resume", tmp_path / "c", "--iterations", "1000000")
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(arrays_of(tmp_path / "a")["spin"], arrays_of(tmp_path / "c")["spin"])


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits and locks of POSIX")
def test_a_full_disk_costs_the_file_and_not_the_run(tmp_path, tmp_path_factory):
    import resource

    elsewhere, kernels = tmp_path_factory.mktemp("cache"), compiler.cache_folder()
    if kernels and kernels.exists():
        shutil.copytree(kernels.parent, elsewhere / kernels.parent.name)  # no kernel is cut short

    def small_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))

    words = (*SCENE, "--duration", "0.2", "--checkpoint-every", "0.02", "--snapshots", "linear:0,0.2,60")
    done = bearings("run", *words, "--out", tmp_path / "run", preexec_fn=small_files,
                    env=os.environ | {"XDG_CACHE_HOME": str(elsewhere)})  # fmt: skip
    assert done.returncode == 2
    assert "the run goes on" in done.stderr
    assert f"`bearings run --resume {tmp_path / 'run'}` goes on from the last checkpoint" in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(file.name for file in (tmp_path / "run").iterdir()) == ["checkpoint.h5", "scene.toml"]
    assert len(list(tmp_path.iterdir())) == 1
    done = bearings("run", "--resume", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    assert len(arrays_of(tmp_path / "run")["snapshots/time"]) == 60


def test_a_checkpoint_that_was_changed_proves_nothing(tmp_path):
    words = ("--shape", "3,3,4", "--method", "rigid-limit", "--initial", "random", "--iterations", "20")
    words = (*words, "--figures", "none", "--checkpoint-every", "0.001")
    assert bearings("run", *words, "--out", tmp_path / "run").returncode == 1
    whole = (tmp_path / "run" / "checkpoint.h5").read_bytes()
    for name in ("staggered", "proof", "history/lower_bound", "elapsed"):
        (tmp_path / "run" / "checkpoint.h5").write_bytes(whole)
        with h5py.File(tmp_path / "run" / "checkpoint.h5", "r+") as file:
            file[name][...] = file[name][()] + 0.5
        said = refused("run", "--resume", tmp_path / "run", "--iterations", "1000")
        assert f"the checksum of {name} does not match" in said


def test_an_interrupted_run_says_how_it_goes_on(tmp_path):
    words = "run --shape 4,5,4 --method cundall-strack --duration 1e6 --figures none --checkpoint-every 0.2 --out run"
    command = [sys.executable, "-m", "taichi_bearings_cli", *words.split()]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    checkpoint = tmp_path / "run" / "checkpoint.h5"
    first = None
    while first is None or checkpoint.stat().st_mtime_ns == first:  # the first one is written before any step
        assert process.poll() is None
        time.sleep(0.02)
        first = first or (checkpoint.stat().st_mtime_ns if checkpoint.exists() else None)
    process.send_signal(signal.SIGINT)
    last = process.communicate()[0].splitlines()[-1].strip()
    assert (process.returncode, last) == (130, "`bearings run --resume run` goes on from the last checkpoint")
    assert tb.load(tmp_path / "run").status == "interrupted"
    checkpoint.unlink()
    assert (
        _how_to_go_on(tmp_path / "run", False).strip().startswith("this run cannot be resumed; with --checkpoint-every")
    )
    assert _how_to_go_on(tmp_path / "run", True).strip().startswith("the result is complete; only figures are missing")


KINDS = {"lattice": (), "packing": ("--driven", "shaft:1")}


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_that_is_interrupted_while_figures_are_drawn_is_complete(kind, tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("taichi_bearings.runs.run.draw_figures", interrupted)
    words = ("run", "--shape", "4,4,4", "--replicas", "2", *KINDS[kind], "--out", tmp_path / "run")
    told = bearings(*words)
    assert told.returncode == 130
    assert "the result is complete; only figures are missing" in told.stdout
    assert len(tb.load(tmp_path / "run")) == 2


def test_a_packing_of_which_some_samples_are_missing_is_not_called_complete(tmp_path, monkeypatch):
    solve, count = packing_run.solved_packing, []

    def solved(*given, **others):
        count.append(1)
        if len(count) > 1:
            raise KeyboardInterrupt
        return solve(*given, **others)

    monkeypatch.setattr(packing_run, "solved_packing", solved)
    words = ("--shape", "4,4,4", "--driven", "shaft:1", "--replicas", "2", "--torque", "0.1", "--figures", "none")
    told = bearings("run", *words, "--out", tmp_path / "run")
    assert told.returncode == 130
    assert "this run cannot be resumed" in told.stdout
    assert len(tb.load(tmp_path / "run")) == 1
