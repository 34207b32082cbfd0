"""What fuzzing has found, each input once."""

import json
import os
import shutil
import sys
import zlib

import h5py
import numpy as np
import pytest

from tests.fuzz.answers import answer_to
from tests.fuzz.damage import claiming

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="fuzzed on POSIX")


def refused(*words):
    answer = answer_to(*words)
    assert not answer.fault, answer.fault
    assert answer.code == 2, answer
    return answer.errors


@pytest.mark.parametrize(
    "line",
    [
        "seed = 0x" + "f" * 5000,
        "seed = " + "9" * 5000,
        "record = " + "[" * 3000,
        "record = " + "[" * 90 + "]" * 90,
        "initial = 1979-05-27",
        "initial = 1979-05-27T07:32:00Z",
        "coefficients = 07:32:00",
        "out = 3",
        'distribution = "\\u0007\\u001b[2J"',
        "shape = [4, nan]",
        "shape = [1e400, 4]",
        "force = 1",
        "force = true",
    ],
    ids=lambda line: line[:30],
)
def test_scene_files(tmp_path, line):
    (tmp_path / "scene.toml").write_text(f"{line}\n")
    refused("run", tmp_path / "scene.toml", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "line",
    [
        "seed = { start = -1e308, stop = 1e308, step = 1e-308 }",
        "seed = { start = 0, stop = 9223372036854775807 }",
        "seed = { start = 0, stop = 0x" + "f" * 5000 + " }",
        "seed = { start = 0, stop = 3, step = -1 }",
        "\n".join(
            f"{key} = {{ start = 0, stop = 100000 }}" for key in ("seed", "iterations", "spin_top", "spin_bottom")
        ),
        "seed = " + "[" * 90 + "]" * 90,
        "[[scan.zip]]\nzip = 3",
    ],
    ids=lambda line: line[:40],
)
def test_scan_files(tmp_path, line):
    (tmp_path / "scan.toml").write_text(f"shape = [4, 5]\n[scan]\n{line}\n")
    refused("scan", tmp_path / "scan.toml", "--dry-run")


def test_a_file_that_is_none_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "scan.toml").write_text("shape = [4, 5]\n[scan]\ncoefficients = ['fifo', '/dev/zero']\n")
    assert "is not a file" in refused("scan", tmp_path / "scan.toml", "--dry-run")
    assert "not exist" in refused("run", tmp_path / "fifo")
    assert "is not a file" in refused("run", "--coefficients", tmp_path / "fifo", "--out", tmp_path / "out")


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("scalars", "slipping", "failed"),
        ("scalars", "slipless", 1e308),
        ("scalars", "undecided", 2**70),
        ("scalars", "status", 3),
        ("scalars", "power", []),
        ("scalars", "power", "text"),
        ("scalars", "slip_threshold", "certified"),
        ("scalars", "normal_force", "x"),
        ("scalars", "shape", True),
        ("scalars", "law", 3),
        ("scalars", "method", 3),
        ("scalars", "error", "\ud800"),
        ("scalars", "method", "a\0"),
        ("scalars", "", 1),
        ("scalars", ".", 1),
        ("scalars", "a/b", 1),
        ("scalars", "\ud800", 1),
        ("scalars", "sample", 1),
        ("bins", "1000000000000", 1),
        ("bins", "-99999", 1),
        ("bins", "a", 1),
        ("bins", "3", 2**40),
        ("", "scalars", None),
        ("", "key", []),
        ("", "bins", [1]),
    ],
)
def test_lines_of_a_journal_that_are_no_samples_count_as_missing(corpus, tmp_path, part, name, value, caplog):
    shutil.copyfile(corpus.scan / "scan.toml", tmp_path / "scan.toml")
    first, *others = (corpus.scan / "samples.jsonl").read_bytes().splitlines(keepends=True)
    record = json.loads(first)["sample"]
    (record[part] if part else record)[name] = value
    text = json.dumps(record).encode()
    changed = b'{"crc32": "%08x", "sample": ' % zlib.crc32(text) + text + b"}\n"
    (tmp_path / "samples.jsonl").write_bytes(changed + b"".join(others))
    commands = [["scan", tmp_path, "--merge"]]
    commands += [["histogram", tmp_path, "--out", tmp_path / "out"]] if part == "bins" else []
    for words in commands:
        answer = answer_to(*words)
        assert not answer.fault, answer.fault
        assert answer.code == (1 if "--merge" in words else 0)
        assert "is damaged; its sample counts as missing" in caplog.text
        caplog.clear()


@pytest.mark.parametrize(("name", "value"), [("law", "\x1b\n"), ("shape", "4x"), ("law", "springs")])
def test_a_journal_of_another_system_is_refused(corpus, tmp_path, name, value):
    shutil.copyfile(corpus.scan / "scan.toml", tmp_path / "scan.toml")
    first, *others = (corpus.scan / "samples.jsonl").read_bytes().splitlines(keepends=True)
    record = json.loads(first)["sample"]
    record["scalars"][name] = value
    text = json.dumps(record).encode()
    changed = b'{"crc32": "%08x", "sample": ' % zlib.crc32(text) + text + b"}\n"
    (tmp_path / "samples.jsonl").write_bytes(changed + b"".join(others))
    assert f"column {name}" in refused("plot", "scan", tmp_path, "--y", "power", "--x", "L")


def unsealed(file):
    file.attrs.pop("sha256", None)
    return file


@pytest.mark.parametrize("scanned", [["."], ["seed", "nowhere"]])
def test_a_scan_without_its_columns(corpus, tmp_path, scanned):
    shutil.copyfile(corpus.scan / "scan.h5", tmp_path / "scan.h5")
    with h5py.File(tmp_path / "scan.h5", "r+") as file:
        unsealed(file).attrs["scanned"] = scanned
    answer = answer_to("plot", "scan", tmp_path, "--y", "gap", "--x", "L")
    assert not answer.fault, answer.fault


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("snapshots/spin", np.zeros((2, 4))),
        ("snapshots/time", np.zeros(7)),
        ("history/power", np.zeros(3)),
        ("history/nothing", np.zeros((1, 1))),
        ("staggered", np.zeros((1, 1, 3, 4), dtype=int)),
        ("force", np.zeros((1, 1, 13))),
        ("proof", np.zeros(3)),
        ("proof", np.zeros((2, 1, 17))),
        ("work", np.zeros(2)),
        ("elapsed", np.zeros(2)),
    ],
)
def test_checkpoints_of_something_else(corpus, tmp_path, name, values):
    shutil.copyfile(corpus.resumable / "checkpoint.h5", tmp_path / "checkpoint.h5")
    with h5py.File(tmp_path / "checkpoint.h5", "r+") as file:
        if name in unsealed(file):
            del file[name]
        file[name] = values
    assert "checkpoint" in refused("run", "--resume", tmp_path, "--time-limit", "1")


@pytest.mark.parametrize("name", ["iteration", "power"])
@pytest.mark.parametrize("duration", [[], ["--duration", "0.02"]])
def test_a_checkpoint_whose_history_lacks_a_column(corpus, tmp_path, name, duration):
    shutil.copyfile(corpus.resumable / "checkpoint.h5", tmp_path / "checkpoint.h5")
    with h5py.File(tmp_path / "checkpoint.h5", "r+") as file:
        del unsealed(file)[f"history/{name}"]
    assert "history has other columns" in refused("run", "--resume", tmp_path, "--time-limit", "1", *duration)


def test_a_checkpoint_whose_scene_has_none(corpus, tmp_path):
    shutil.copyfile(corpus.resumable / "checkpoint.h5", tmp_path / "checkpoint.h5")
    with h5py.File(tmp_path / "checkpoint.h5", "r+") as file:
        lines = unsealed(file).attrs["scene"].splitlines()
        file.attrs["scene"] = "\n".join(line for line in lines if not line.startswith("checkpoint"))
    assert "names no checkpoint_every" in refused("run", "--resume", tmp_path)


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


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("contact/x/power", -1.0), ("contact/y/slip", np.nan), ("contact/x/force", np.inf), ("contact/y/state", 57),
        ("spin", np.inf), ("contact/x/friction", np.nan),
    ],
)  # fmt: skip
def test_numbers_that_no_solve_leaves(corpus, tmp_path, name, value):
    shutil.copyfile(corpus.folder / "flat" / "run.h5", tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        unsealed(file)[name][1, 1] = value
    for words in (["analyse"], ["plot", "power"], ["histogram"]):
        assert "is damaged" in refused(*words, tmp_path, "--out", tmp_path / "out.png")


THINGS = ["contact/x/power", "contact/y/state", "coefficient/y", "spin", "history/power", "history"]
CHANGES = ["group", "empty", "shape", "kind", "lost", "cycle"]


@pytest.mark.parametrize(
    ("name", "change"), [(name, CHANGES[(i + n) % 6]) for n in (0, 3) for i, name in enumerate(THINGS)]
)
def test_things_of_a_run_that_are_something_else(corpus, tmp_path, name, change):
    shutil.copyfile(corpus.folder / "flat" / "run.h5", tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        values = unsealed(file)[name][()] if name != "history" else np.zeros((2, 3))
        del file[name]
        if change == "group":
            file.create_group(name)
        elif change == "cycle":
            file[name] = h5py.SoftLink("/")
        elif change != "lost":
            made = {"empty": h5py.Empty("f8"), "shape": values[None, :-1], "kind": np.full(values.shape, b"text")}
            file[name] = made[change]
    for words in (["verify"], ["analyse", "--out", tmp_path / "out"], ["plot", "history", "--out", tmp_path / "a.png"]):
        answer = (
            answer_to(words[0], *words[1:2], tmp_path, *words[2:])
            if words[0] == "plot"
            else answer_to(words[0], tmp_path, *words[1:])
        )
        assert not answer.fault, answer.fault
        assert answer.code == 2 or words[0] == "verify"


@pytest.mark.parametrize("words", [(), ("--coefficients",), ("--initial",)])
def test_names_that_no_file_can_have(tmp_path, words):
    assert "too long" in refused("run", *words, "9" * 5000, "--shape", "4,5", "--out", tmp_path / "out")


@pytest.mark.parametrize("number", ["slipping", "power"])
def test_numbers_that_are_references(corpus, tmp_path, number):
    shutil.copyfile(corpus.folder / "flat" / "run.h5", tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        unsealed(file).attrs[number] = file["spin"].ref
    for command in ("verify", "analyse"):
        assert f"{number} of / in it is neither a number nor a text" in refused(command, tmp_path)


@pytest.mark.parametrize("change", [b"\xe9", b"\xff\xfe"])
def test_texts_that_are_not_utf_8(corpus, tmp_path, change):
    content = (corpus.folder / "flat" / "run.h5").read_bytes()
    assert b"shape = " in content
    (tmp_path / "run.h5").write_bytes(content.replace(b"shape = ", change + b"shape = "[len(change) :]))
    for words in (("verify",), ("analyse", "--no-figures")):
        assert "scene of / in it is neither a number nor a text in UTF-8" in refused(words[0], tmp_path, *words[1:])


def test_texts_of_data_sets_that_are_lost(corpus, tmp_path):
    """Texts lie in a heap of their own, which HDF5 looks for only when it reads or copies."""
    shutil.copyfile(corpus.folder / "flat" / "run.h5", tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        for item in (file["spin"], file["contact/x/slip"]):
            item.attrs["description"] = "to be lost"
    content = (tmp_path / "run.h5").read_bytes()
    place = content.rindex(b"to be lost") - 16  # number of the text in its heap
    (tmp_path / "run.h5").write_bytes(content[:place] + b"\x07\x77" + content[place + 2 :])
    assert "is damaged" in refused("analyse", tmp_path, "--no-figures")


NONE = [["a", "b"], "a", 1j, [np.nan, np.nan], h5py.Empty("f8")]


@pytest.mark.parametrize(
    ("name", "value"),
    [*(("lower_bound", value) for value in NONE), ("gap", "a"), ("states_proven", ["a", "b"])],
    ids=str,
)
def test_numbers_of_a_run_that_are_none(corpus, tmp_path, name, value):
    shutil.copyfile(corpus.folder / "flat" / "run.h5", tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        unsealed(file).attrs[name] = value
    assert f"{name} is " in refused("analyse", tmp_path, "--no-figures")


@pytest.mark.parametrize(
    ("name", "value"),
    [("scan", None), ("scan", [3, 4]), ("asked", np.zeros(2)), ("journals", np.zeros(2000)), ("asked", "a")],
    ids=["lost", "list", "asked", "journals", "text"],
)
def test_a_scan_whose_attributes_are_something_else(corpus, tmp_path, name, value):
    shutil.copyfile(corpus.scan / "scan.h5", tmp_path / "scan.h5")
    with h5py.File(tmp_path / "scan.h5", "r+") as file:
        del unsealed(file).attrs[name]
        if value is not None:
            file.attrs[name] = value
    for words in (
        ["histogram", tmp_path, "--out", tmp_path / "out"],
        ["plot", "scan", tmp_path, "--y", "gap", "--x", "L"],
    ):
        assert f"its attribute {name} " in refused(*words)
    for copied in ("samples.jsonl", "scan.toml"):
        shutil.copyfile(corpus.scan / copied, tmp_path / copied)
    assert answer_to("histogram", tmp_path, "--out", tmp_path / "out").code == 0  # from the journal beside it


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("histogram/edges", lambda v: np.full(v.shape, np.inf), "edges of its histograms"),
        ("histogram/edges", lambda v: v.astype(complex), "edges of its histograms"),
        ("histogram/count", lambda v: -v - 1, "histograms count"),
        ("histogram/count", lambda v: v + 0.5, "histograms count"),
        ("histogram/slipless", lambda v: v.astype(complex), "histograms count"),
        ("table/power", lambda v: v.astype(complex), "column power"),
        ("table/seed", lambda v: np.zeros(v.shape, dtype="V8"), "column seed"),
        ("table/slip_threshold", lambda v: np.full(v.shape, b"text"), "slip_threshold is no number"),
    ],
)  # fmt: skip
def test_a_scan_whose_columns_are_something_else(corpus, tmp_path, name, change, words):
    shutil.copyfile(corpus.scan / "scan.h5", tmp_path / "scan.h5")
    with h5py.File(tmp_path / "scan.h5", "r+") as file:
        values, marks = unsealed(file)[name][()], dict(file[name].attrs)
        del file[name]
        file[name] = change(values)
        file[name].attrs.update(marks)
    assert words in refused("histogram", tmp_path, "--out", tmp_path / "out")
