"""What the machine does not give: memory, folders, streams. One sentence each, and nothing is lost."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

import taichi_bearings as tb
from taichi_bearings import checksums
from taichi_bearings.errors import FileError
from taichi_bearings.runs.run_file import read_run
from tests.cli.commands import bearings

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="limits and streams of POSIX")


PROGRAM = [sys.executable, "-m", "taichi_bearings_cli"]


SMALL = ("--shape", "4,5", "--figures", "none")


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A run with a checkpoint."""
    run = tmp_path_factory.mktemp("stored") / "run"
    words = ("--shape", "3,4", "--method", "cundall-strack", "--duration", "0.001", "--checkpoint-every", "100")
    assert bearings("run", *words, "--figures", "none", "--out", run).returncode == 0
    return run


def said(done, code):
    """The one sentence."""
    assert done.returncode == code, done.stderr
    (sentence,) = done.stderr.splitlines()
    assert done.stdout.strip() == ""  # Taichi says nothing in two lines
    return sentence


def test_a_file_of_another_layout_is_refused_by_its_number(stored, tmp_path):
    run, version = tmp_path / "run", 3
    shutil.copytree(stored, run)
    for name in ("run.h5", "checkpoint.h5"):
        with h5py.File(run / name, "a") as file:
            file.attrs["schema_version"] = version
            checksums.seal(file)
    for words in (
        ("analyse", run),
        ("plot", "spins", run),
        ("verify", run),
        ("histogram", run),
        ("run", "--resume", run),
        ("run", "--shape", "3,4", "--coefficients", run / "run.h5"),
        ("run", "--shape", "3,4", "--initial", run / "run.h5"),
    ):
        done = bearings(*words, cwd=tmp_path)
        assert f"layout version {version}; this program reads versions 1 and 2" in said(done, 2), words
    with pytest.raises(FileError, match=f"layout version {version}"):
        tb.load(run)
    assert [file.name for file in tmp_path.iterdir()] == ["run"]


def limited(bytes_of_memory):
    def limit():
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (bytes_of_memory, bytes_of_memory))

    return limit


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--shape", "4,4,5"), "Virtual memory allocation (1073741824 B) failed"),  # Taichi's own
        (("--shape", "64,64,64", "--method", "interior-point"), "of 262,144 spheres needs some"),
    ],
    ids=["Taichi", "estimated"],
)
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="where memory can be limited")
def test_too_little_memory_is_one_sentence(tmp_path, words, sentence):
    done = bearings("run", *words, "--out", tmp_path / "a", preexec_fn=limited(1_000_000_000))
    told = said(done, 1 if "Taichi" in sentence or "Virtual" in sentence else 2)
    assert sentence in told
    assert told.startswith("bearings: ")
    assert list(tmp_path.iterdir()) == []


def test_no_home_no_cache_and_a_backend_of_no_meaning_cost_nothing(tmp_path):
    nowhere = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"), "/proc/nowhere")
    done = bearings(
        "run", "--shape", "3,3,3", "--out", tmp_path / "a", env=os.environ | nowhere | {"MPLBACKEND": "nonsense"}
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "a" / "power_histogram.png").exists()


def test_warnings_that_are_errors_cost_nothing(tmp_path):
    """Those of Python, which what we import makes; in the command, and in a program that imports us."""
    done = bearings("run", *SMALL, "--out", tmp_path / "a", env=os.environ | {"PYTHONWARNINGS": "error"})
    assert (done.returncode, done.stderr) == (0, "")
    code = "import taichi_bearings as tb; print(tb.solve(tb.Scene.random((3, 3, 3), seed=1), 'gradient-descent').power)"
    alone = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert (alone.returncode, alone.stderr) == (0, "")


HOSTILE = """text.usetex: True
font.family: Comic Nothing
savefig.format: svg
axes.formatter.use_locale: True
backend: TkAgg
figure.dpi: 7
axes.facecolor: red
"""


def test_figures_are_alike_whatever_the_matplotlibrc_says(tmp_path):
    """LaTeX is asked for, which is not there."""
    pictures = []
    for name, text in (("ours", ""), ("hostile", HOSTILE)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "matplotlibrc").write_text(text)
        words = ("run", "--shape", "4,5", "--out", tmp_path / f"{name}-run")
        done = bearings(*words, env=os.environ | {"MPLCONFIGDIR": str(tmp_path / name), "PATH": ""})
        assert (done.returncode, done.stderr) == (0, "")
        pictures.append((tmp_path / f"{name}-run" / "power_histogram.png").read_bytes())
    assert pictures[0] == pictures[1]


def test_where_matplotlib_cannot_be_loaded_the_run_is_kept(tmp_path):
    (tmp_path / "matplotlibrc").write_bytes(b"font.family: \xff\xfe\n")
    environment = os.environ | {"MPLCONFIGDIR": str(tmp_path)}
    done = bearings("run", "--shape", "4,5", "--out", tmp_path / "a", env=environment)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert read_run(tmp_path / "a").solution.power > 0
    assert (tmp_path / "a" / "power_histogram.png").exists() or "the run is kept without them" in done.stderr


@pytest.mark.parametrize("place", ["ticache", ".", ".."], ids=["ticache", "taichi", "cache"])
def test_a_file_where_the_cache_should_be_costs_one_sentence(tmp_path, place):
    """And no crash at the end of the process."""
    file = Path(os.path.normpath(tmp_path / ".cache" / "taichi" / place))
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("mine")
    ours = {"HOME": str(tmp_path), "TMPDIR": str(tmp_path), "TAICHI_BEARINGS_COMPILER": "taichi"}
    environment = {key: value for key, value in os.environ.items() if key != "XDG_CACHE_HOME"} | ours
    done = bearings("run", "--shape", "3,3", "--method", "gradient-descent", "--tolerance", "1e-2", "--figures", "none",
                    "--out", tmp_path / "a", env=environment)  # fmt: skip
    assert done.returncode == 0, done.stderr
    sentence = f"bearings: {file} is no folder; compiled kernels are kept in a temporary folder instead\n"
    assert done.stderr == (sentence if place == "ticache" else "")
    assert file.read_text() == "mine"


@pytest.mark.parametrize("streams", [(1,), (0, 1, 2)], ids=str)
def test_closed_streams_cost_nothing(tmp_path, streams):
    def close():
        for stream in streams:
            os.close(stream)

    done = subprocess.run([*PROGRAM, "run", *SMALL, "--out", tmp_path / "a"], preexec_fn=close)
    assert done.returncode == 0
    assert read_run(tmp_path / "a").solution.power > 0


def test_a_reader_that_goes_away_is_no_fault(tmp_path):
    ours, theirs = os.pipe()
    os.close(ours)
    done = subprocess.run([*PROGRAM, "run", *SMALL, "--out", tmp_path / "a"], stdout=theirs, stderr=subprocess.PIPE)
    os.close(theirs)
    assert (done.returncode, done.stderr) == (0, b"")
    assert read_run(tmp_path / "a").solution.power > 0


def test_a_file_system_without_locks_is_read_and_written(stored, tmp_path, monkeypatch):
    """A library that has locked its files until now meets a folder that has no locks: HDF5 and the system say so."""
    plain = h5py.File

    def without_locks(name, mode="r", locking=None, **more):
        if locking is not False and not hasattr(name, "read"):
            raise OSError("unable to lock file, errno = 37, error message = 'No locks available'")
        return plain(name, mode, locking=locking, **more)

    def no_lock(*_):
        raise OSError(37, "No locks available")

    run = tmp_path / "run"
    shutil.copytree(stored, run)
    monkeypatch.setattr(h5py, "File", without_locks)
    monkeypatch.setattr("fcntl.flock", no_lock)
    power = tb.load(run).power
    best = tb.solve(tb.Scene.random((4, 5), seed=2), "planar-cut", progress=False)
    best.save(tmp_path / "saved")
    assert tb.load(tmp_path / "saved").power == best.power
    assert power > 0


CLEARED = """
import sys, threading, time
class Kept:
    def __del__(self):
        print("cleared")
sys.modules["kept"] = Kept()
sys.argv = ["bearings", *{words}]
from taichi_bearings_cli import __main__
threading.Thread(target=lambda: (time.sleep(0.3), print("thread"))).start()
__main__.main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="commands are not watched there")
def test_a_command_ends_with_its_code_and_all_its_output_and_does_not_clear_memory():
    for words, code in (["--version"], 0), (["info", "nowhere"], 2):
        done = subprocess.run([sys.executable, "-c", CLEARED.format(words=words)], capture_output=True, text=True)
        assert done.returncode == code
        assert done.stdout.splitlines()[-1:] == ["thread"]
        assert len(done.stdout.splitlines()) == 2 - code // 2
