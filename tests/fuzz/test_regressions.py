"""What fuzzing has found, each input once."""

import json
import os
import shutil
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.cli.commands import bearings, refused
from tests.fuzz.damage import claiming, line_of

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="fuzzed on POSIX")
RUN, SCAN, CHECKPOINT = "flat/run.h5", "scan/scan.h5", "resumable/checkpoint.h5"
ANALYSE, VERIFY = ("analyse", "{}", "--no-figures"), ("verify", "{}")
RESUME = ("run", "--resume", "{}", "--time-limit", "100")
HISTOGRAM, FIGURE = ("histogram", "{}", "--out", "{}/out"), ("plot", "scan", "{}", "--y", "gap", "--x", "L")


@pytest.fixture
def changed(corpus, tmp_path):
    """A function that copies an HDF5 file of the corpus, without its checksums and changed by a function of it."""

    def change(name, function):
        copy = shutil.copyfile(corpus.folder / name, tmp_path / Path(name).name)
        with h5py.File(copy, "r+") as file:
            file.attrs.pop("sha256", None)
            function(file)
        return tmp_path

    return change


def put(name, value):
    """Another data set of that name; a group counts as one."""

    def change(file):
        marks = dict(file[name].attrs) if name in file else {}
        if name in file:
            del file[name]
        file[name] = value
        file[name].attrs.update(marks)

    return change


def mark(name, value):
    """Another attribute of that name, or none."""

    def change(file):
        file.attrs.pop(name, None)
        if value is not None:
            file.attrs[name] = value

    return change


def entry(name, value):
    return lambda file: file[name].__setitem__((1, 1), value)


def column(name, of):
    return lambda file: put(name, of(file[name][()]))(file)


def without_checkpoints(file):
    lines = file.attrs["scene"].splitlines()
    file.attrs["scene"] = "\n".join(line for line in lines if not line.startswith("checkpoint"))


NONE = [["a", "b"], "a", 1j, [np.nan, np.nan], h5py.Empty("f8")]
FORGED = [  # file, change, commands that refuse it, and their words
    *((CHECKPOINT, put(name, value), [RESUME], "checkpoint") for name, value in (
        ("snapshots/spin", np.zeros((2, 4))), ("snapshots/time", np.zeros(7)), ("history/power", np.zeros(3)),
        ("history/nothing", np.zeros((1, 1))), ("staggered", np.zeros((1, 1, 3, 4), dtype=int)),
        ("force", np.zeros((1, 1, 13))), ("proof", np.zeros(3)), ("proof", np.zeros((2, 1, 17))), ("work", np.zeros(2)),
        ("elapsed", np.zeros(2)),
    )),
    *((CHECKPOINT, lambda file, name=name: file.__delitem__(f"history/{name}"), [RESUME], "history has other columns")
      for name in ("iteration", "power")),
    (CHECKPOINT, without_checkpoints, [RESUME[:3]], "names no checkpoint_every"),
    *((RUN, entry(name, value), [ANALYSE, HISTOGRAM], "is damaged") for name, value in (
        ("contact/x/power", -1.0), ("contact/y/slip", np.nan), ("contact/x/force", np.inf), ("contact/y/state", 57),
        ("spin", np.inf), ("contact/x/friction", np.nan),
    )),
    *((RUN, lambda file, name=name: mark(name, file["spin"].ref)(file), [VERIFY, ANALYSE],
       f"{name} of / in it is neither a number nor a text") for name in ("slipping", "power")),
    *((RUN, mark("lower_bound", value), [ANALYSE], "lower_bound is ") for value in NONE),
    (RUN, mark("gap", "a"), [ANALYSE], "gap is "),
    *((SCAN, mark(name, value), [HISTOGRAM, FIGURE], f"its attribute {name} ") for name, value in (
        ("scan", None), ("scan", [3, 4]), ("asked", np.zeros(2)), ("journals", np.zeros(2000)), ("asked", "a"),
    )),
    *((SCAN, column(name, of), [HISTOGRAM], words) for name, of, words in (
        ("histogram/edges", lambda v: np.full(v.shape, np.inf), "bins of the histograms are not equally wide"),
        ("histogram/edges", lambda v: v.astype(complex), "bins of the histograms are not equally wide"),
        ("histogram/count", lambda v: -v - 1, "histograms count"),
        ("histogram/count", lambda v: v + 0.5, "histograms count"),
        ("histogram/slipless", lambda v: v.astype(complex), "histograms count"),
        ("table/power", lambda v: v.astype(complex), "column power"),
        ("table/seed", lambda v: np.zeros(v.shape, dtype="V8"), "column seed"),
        ("table/slip_threshold", lambda v: np.full(v.shape, b"text"), "column slip_threshold must hold numbers"),
    )),
]  # fmt: skip


@pytest.mark.parametrize(("name", "change", "commands", "words"), FORGED, ids=range(len(FORGED)))
def test_files_whose_numbers_are_something_else_are_refused(changed, name, change, commands, words):
    folder = changed(name, change)
    for command in commands:
        assert words in refused(*(word.format(folder) for word in command))


THINGS = ["contact/x/power", "contact/y/state", "coefficient/y", "spin", "history/power", "history"]
CHANGES = ["group", "empty", "shape", "kind", "lost", "cycle"]


@pytest.mark.parametrize(
    ("name", "change"), [(name, CHANGES[(i + n) % 6]) for n in (0, 3) for i, name in enumerate(THINGS)]
)
def test_things_of_a_run_that_are_something_else(changed, name, change):
    def replace(file):
        values = file[name][()] if name != "history" else np.zeros((2, 3))
        del file[name]
        if change == "group":
            file.create_group(name)
        elif change != "lost":
            made = {"empty": h5py.Empty("f8"), "shape": values[None, :-1], "kind": np.full(values.shape, b"text")}
            file[name] = h5py.SoftLink("/") if change == "cycle" else made[change]

    folder = changed(RUN, replace)
    for words in (VERIFY, ANALYSE, ("plot", "history", "{}", "--out", "{}/a.png")):
        answer = bearings(*(word.format(folder) for word in words))
        assert not answer.fault, answer.fault
        assert answer.returncode == 2 or words[0] == "verify"


@pytest.mark.parametrize("scanned", [["."], ["seed", "nowhere"]])
def test_a_scan_without_its_columns(changed, scanned):
    answer = bearings(*(word.format(changed(SCAN, mark("scanned", scanned))) for word in FIGURE))
    assert not answer.fault, answer.fault


def test_a_scan_whose_table_is_damaged_is_read_from_the_journal_beside_it(changed, corpus, tmp_path):
    changed(SCAN, mark("asked", "a"))
    for copied in ("samples.jsonl", "scan.toml"):
        shutil.copyfile(corpus.scan / copied, tmp_path / copied)
    assert bearings("histogram", tmp_path, "--out", tmp_path / "out").returncode == 0


SCENES = [
    "seed = 0x" + "f" * 5000, "seed = " + "9" * 5000, "record = " + "[" * 3000, "record = " + "[" * 90 + "]" * 90,
    "initial = 1979-05-27", "initial = 1979-05-27T07:32:00Z", "coefficients = 07:32:00", "out = 3",
    'distribution = "\\u0007\\u001b[2J"', "shape = [4, nan]", "shape = [1e400, 4]", "force = 1", "force = true",
]  # fmt: skip
RANGES = [
    "seed = { start = -1e308, stop = 1e308, step = 1e-308 }", "seed = { start = 0, stop = 9223372036854775807 }",
    "seed = { start = 0, stop = 0x" + "f" * 5000 + " }", "seed = { start = 0, stop = 3, step = -1 }",
    "\n".join(f"{key} = {{ start = 0, stop = 100000 }}" for key in ("seed", "iterations", "spin_top", "spin_bottom")),
    "seed = " + "[" * 90 + "]" * 90, "[[scan.zip]]\nzip = 3",
]  # fmt: skip


@pytest.mark.parametrize("line", SCENES, ids=lambda line: line[:30])
def test_scene_files(tmp_path, line):
    (tmp_path / "scene.toml").write_text(f"{line}\n")
    refused("run", tmp_path / "scene.toml", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("line", RANGES, ids=lambda line: line[:40])
def test_scan_files(tmp_path, line):
    (tmp_path / "scan.toml").write_text(f"shape = [4, 5]\n[scan]\n{line}\n")
    refused("scan", tmp_path / "scan.toml", "--dry-run")


def test_a_file_that_is_none_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "scan.toml").write_text("shape = [4, 5]\n[scan]\ncoefficients = ['fifo', '/dev/zero']\n")
    assert "is not a file" in refused("scan", tmp_path / "scan.toml", "--dry-run")
    assert "not exist" in refused("run", tmp_path / "fifo")
    assert "is not a file" in refused("run", "--coefficients", tmp_path / "fifo", "--out", tmp_path / "out")


def journal_with(corpus, folder, change):
    """A scan without its table whose first sample is changed, by a checksum that is right."""
    shutil.copyfile(corpus.scan / "scan.toml", folder / "scan.toml")
    first, *others = (corpus.scan / "samples.jsonl").read_bytes().splitlines(keepends=True)
    record = json.loads(first)["sample"]
    change(record)
    (folder / "samples.jsonl").write_bytes(line_of(json.dumps(record).encode()) + b"".join(others))


NO_SAMPLES = [
    ("scalars", "slipping", "failed"), ("scalars", "slipless", 1e308), ("scalars", "undecided", 2**70),
    ("scalars", "status", 3), ("scalars", "power", []), ("scalars", "power", "text"),
    ("scalars", "slip_threshold", "certified"), ("scalars", "normal_force", "x"), ("scalars", "shape", True),
    ("scalars", "law", 3), ("scalars", "method", 3), ("scalars", "error", "\ud800"), ("scalars", "method", "a\0"),
    ("scalars", "", 1), ("scalars", ".", 1), ("scalars", "a/b", 1), ("scalars", "\ud800", 1), ("scalars", "sample", 1),
    ("bins", "1000000000000", 1), ("bins", "-99999", 1), ("bins", "a", 1), ("bins", "3", 2**40), ("", "scalars", None),
    ("", "key", []), ("", "bins", [1]),
]  # fmt: skip


@pytest.mark.parametrize(("part", "name", "value"), NO_SAMPLES)
def test_lines_of_a_journal_that_are_no_samples_count_as_missing(corpus, tmp_path, part, name, value, caplog):
    journal_with(corpus, tmp_path, lambda record: (record[part] if part else record).update({name: value}))
    answer = bearings("scan", tmp_path, "--merge")
    assert not answer.fault, answer.fault
    assert answer.returncode == 1
    assert "is damaged; its sample is taken for missing" in caplog.text


@pytest.mark.parametrize(("name", "value"), [("law", "\x1b\n"), ("shape", "4x"), ("law", "springs")])
def test_a_journal_of_another_system_is_refused(corpus, tmp_path, name, value):
    journal_with(corpus, tmp_path, lambda record: record["scalars"].update({name: value}))
    assert f"column {name}" in refused("plot", "scan", tmp_path, "--y", "power", "--x", "L")


@pytest.mark.parametrize("header", [b"(", b"{" * 5000, b"[" * 9000, b"\x00" * 50, b"{'shape': (1,)}"])
def test_headers_of_arrays(tmp_path, header):
    content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    (tmp_path / "a.npy").write_bytes(content)
    assert "cannot be read" in refused(
        "run", "--shape", "4,5", "--initial", tmp_path / "a.npy", "--out", tmp_path / "b"
    )


@pytest.mark.parametrize("ending", ["npy", "npz"])
@pytest.mark.parametrize("kind", ["|V0", "|S0", "<U0"])
def test_numbers_of_no_size_are_without_number(tmp_path, ending, kind):
    file = claiming(tmp_path / f"a.{ending}", kind, (10**12,))
    assert "cannot be read" in refused("run", "--shape", "4,5", "--initial", file, "--out", tmp_path / "b")


@pytest.mark.parametrize("words", [(), ("--coefficients",), ("--initial",)])
def test_names_that_no_file_can_have(tmp_path, words):
    assert "too long" in refused("run", *words, "9" * 5000, "--shape", "4,5", "--out", tmp_path / "out")


@pytest.mark.parametrize("change", [b"\xe9", b"\xff\xfe"])
def test_texts_that_are_not_utf_8(corpus, tmp_path, change):
    content = (corpus.folder / RUN).read_bytes()
    assert b"shape = " in content
    (tmp_path / "run.h5").write_bytes(content.replace(b"shape = ", change + b"shape = "[len(change) :]))
    for words in (VERIFY, ANALYSE):
        said = refused(*(word.format(tmp_path) for word in words))
        assert "scene of / in it is neither a number nor a text in UTF-8" in said


def test_texts_of_data_sets_that_are_lost(changed, tmp_path):
    """Texts lie in a heap of their own, which HDF5 looks for only when it reads or copies."""

    def describe(file):
        for name in ("spin", "contact/x/slip"):
            file[name].attrs["description"] = "to be lost"

    changed(RUN, describe)
    content = (tmp_path / "run.h5").read_bytes()
    place = content.rindex(b"to be lost") - 16  # number of the text in its heap
    (tmp_path / "run.h5").write_bytes(content[:place] + b"\x07\x77" + content[place + 2 :])
    assert "is damaged" in refused("analyse", tmp_path, "--no-figures")
