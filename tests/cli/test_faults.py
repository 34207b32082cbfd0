"""Faults while a run is made: rivals, kills, full disks, strange names. No result is lost, each is one sentence."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from taichi_bearings.runs.run_file import read_run
from tests.cli.commands import bearings, refused

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals, mounts and names of POSIX")


# Its time step is fixed, so it never ends by itself; the rigid limit takes ever longer steps and reaches any time.
LONG = ("--shape", "3,3,4", "--method", "cundall-strack", "--duration", "1e9")
SHORT = ("--shape", "4,5")
PLAIN = (*SHORT, "--figures", "none")


def start(*words, until, **kwargs):
    """A run that has come so far that there is a file `until`."""
    command = [sys.executable, "-m", "taichi_bearings_cli", "run", *map(str, words)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **kwargs)
    began = time.monotonic()
    while not list(until.parent.glob(until.name)):
        goes_on(process)
        assert time.monotonic() - began < 60
        time.sleep(0.01)
    return process


def goes_on(process):
    """A process has not ended; else its exit code and what it wrote are shown."""
    code = process.poll()
    assert code is None, (code, *process.communicate())


def hidden(folder):
    return sorted(file.name for file in folder.iterdir() if file.name.startswith("."))


def test_of_two_runs_into_one_directory_the_second_is_refused_and_a_kill_leaves_nothing(tmp_path):
    first = start(*LONG, "--out", tmp_path / "a", until=tmp_path / ".a.partial-*")
    for force in ((), ("--force",)):
        assert "a is in use by another process" in refused("run", *SHORT, "--out", tmp_path / "a", *force)
    goes_on(first)
    first.kill()
    first.communicate()
    assert len(hidden(tmp_path)) == 2
    assert bearings("run", *PLAIN, "--out", tmp_path / "b").returncode == 0
    assert [file.name for file in tmp_path.iterdir()] == ["b"]


def test_a_directory_with_checkpoints_is_one_run_s(tmp_path):
    words = (*LONG, "--checkpoint-every", "0.01", "--out", tmp_path / "a")
    first = start(*words, until=tmp_path / "a" / "checkpoint.h5")
    for force in ((), ("--force",)):
        assert "in use" in refused("run", *words, *force)
    goes_on(first)
    assert "in use" in refused("run", "--resume", tmp_path / "a")
    first.kill()
    first.communicate()
    checkpoint = tmp_path / "a" / "checkpoint.h5"
    before = checkpoint.stat().st_mtime_ns
    resumed = start("--resume", tmp_path / "a", until=checkpoint)
    while checkpoint.stat().st_mtime_ns == before:  # it has not come so far
        goes_on(resumed)
        time.sleep(0.01)
    assert "in use" in refused("run", *SHORT, "--out", tmp_path / "a", "--force")
    resumed.kill()
    resumed.communicate()
    assert bearings("run", *PLAIN, "--out", tmp_path / "a", "--force").returncode == 0
    assert hidden(tmp_path) == hidden(tmp_path / "a") == []


def test_what_appears_meanwhile_is_not_replaced(tmp_path):
    words = (*LONG, "--time-limit", "1", "--figures", "none")
    run = start(*words, "--out", tmp_path / "a", until=tmp_path / ".a.partial-*")
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "mine").touch()
    errors = run.communicate()[1]
    assert run.returncode == 1
    assert [file.name for file in (tmp_path / "a").iterdir()] == ["mine"]
    (elsewhere,) = re.findall(r"a cannot be written: .*; the result is in (\S+)", " ".join(errors.split()))
    assert read_run(Path(elsewhere)).attributes["run"] == elsewhere


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can mount a small file system")
@pytest.mark.parametrize(("size", "kept"), [("16k", "elsewhere"), ("64k", "without figures")])
def test_a_full_disk_at_the_end_of_a_solve(tmp_path, size, kept):
    disk, temporary = tmp_path / "disk", tmp_path / "temporary"
    disk.mkdir()
    temporary.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "none", disk], capture_output=True).returncode:
        pytest.skip("this system lets not even root mount a small file system")
    try:
        environment = os.environ | {"TMPDIR": str(temporary)}
        done = bearings("run", *SHORT, "--out", disk / "a", "--json", env=environment)
        assert "No space left on device" in done.stderr
        assert "Traceback" not in done.stderr
        assert len(done.stderr.splitlines()) == 1
        path = json.loads(done.stdout)["run"]
        if kept == "elsewhere":
            assert path.startswith(str(temporary))
            assert path in done.stderr
            assert done.returncode == 1
            assert list(disk.iterdir()) == []
        else:
            assert path == str(disk / "a")
            assert done.returncode == 0
            assert list(temporary.iterdir()) == []
        assert read_run(
            disk / "a" if kept != "elsewhere" else next(temporary.iterdir()) / "a"
        ).solution.scene.lattice.shape == (4, 5)
    finally:
        subprocess.run(["umount", disk], check=True)


def test_a_result_that_no_disk_takes_is_one_sentence(tmp_path):
    import resource

    def small_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000))

    assert "the result is lost" in refused("run", *PLAIN, "--out", tmp_path / "a", preexec_fn=small_files)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["--out", "--coefficients", "--initial", "--distribution"])
def test_a_name_that_is_not_utf_8_is_refused_before_anything_is_computed(tmp_path, option):
    assert "UTF-8" in refused("run", *SHORT, option, os.fsdecode(b"caf\xe9"), cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


NO_UTF_8 = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


@pytest.mark.parametrize("locale", [{"PYTHONIOENCODING": "ascii:strict"}, NO_UTF_8], ids=str)
def test_locales_lose_nothing(tmp_path, locale):
    environment = os.environ | locale
    if locale is NO_UTF_8:
        assert "UTF-8" in refused("run", *SHORT, "--out", "café", cwd=tmp_path, env=environment)
    name = "plain" if locale is NO_UTF_8 else "café €"
    done = bearings("run", *PLAIN, "--out", name, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
    assert read_run(tmp_path / name).attributes["run"] == name


def test_a_scene_file_and_a_folder_with_any_name_are_written_down(tmp_path):
    folder = tmp_path / os.fsdecode(b"f\xe9\n")
    folder.mkdir()
    scene = folder / os.fsdecode(b"caf\xe9.toml")
    scene.write_text("shape = [4, 5]\n")
    done = bearings("run", scene.name, "--out", "a", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert r"caf\udce9.toml" in read_run(folder / "a").attributes["command"]
