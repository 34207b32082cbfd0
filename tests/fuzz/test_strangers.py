"""Files from strangers are data: they run no code, lead nowhere else, and ask for no more memory than they can fill."""

import io
import json
import os
import pickle
import sys
import zipfile
import zlib

import h5py
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings import hdf5
from taichi_bearings.errors import BearingsError, FileError
from tests.fuzz.answers import answer_to
from tests.fuzz.damage import claiming

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links and limits of POSIX")


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strangers") / "run"
    tb.solve(tb.Scene.random((4, 5), seed=3)).save(folder)
    return folder


@pytest.fixture
def stranger(solved, tmp_path):
    """A run.h5 of our own to spoil."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.h5").write_bytes((solved / "run.h5").read_bytes())
    return folder


def refused(*words):
    answer = answer_to(*words)
    assert not answer.fault, answer
    assert answer.code == 2
    return answer.errors


def test_a_scene_file_replaces_nothing_by_itself(solved, tmp_path):
    content, scene = (solved / "run.h5").read_bytes(), tmp_path / "scene.toml"
    scene.write_text(f'shape = [4, 5]\nout = "{solved}"\nforce = true\n')
    assert "--force on the command line" in refused("run", scene)
    scene.write_text(f'shape = [4, 5]\nout = "{solved}"\n')
    assert "already exists" in refused("run", scene)
    assert (solved / "run.h5").read_bytes() == content


class Mischief:
    def __init__(self, mark):
        self.mark = str(mark)

    def __reduce__(self):
        return os.mkdir, (self.mark,)


def test_nothing_is_unpickled(tmp_path):
    mark, whole = tmp_path / "mark", io.BytesIO()
    np.save(whole, np.array([Mischief(mark)], dtype=object), allow_pickle=True)
    (tmp_path / "a.npy").write_bytes(whole.getvalue())
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        for name in "xy":
            file.writestr(f"{name}.npy", whole.getvalue())
        file.writestr("spin", pickle.dumps(Mischief(mark)))
    for option, name in (("--initial", "a.npy"), ("--initial", "a.npz"), ("--coefficients", "a.npz")):
        refused("run", "--shape", "4,5", option, tmp_path / name, "--out", tmp_path / "out")
    assert not mark.exists()


@pytest.mark.parametrize("key", ["distribution", "initial", "record", "direction", "threads"])
def test_settings_are_no_code(tmp_path, key):
    mark = tmp_path / "mark"
    (tmp_path / "scene.toml").write_text(f"{key} = \"__import__('os').mkdir('{mark}')\"\nshape = [4, 5]\n")
    refused("run", tmp_path / "scene.toml", "--out", tmp_path / "out")
    assert not mark.exists()


def lead_out(file, name, other):
    del file[name]
    file[name] = h5py.ExternalLink(str(other), name)


def lie_outside(file, name, other):
    shape = file[name].shape
    del file[name]
    file.create_dataset(name, shape=shape, dtype="f8", external=[(str(other), 0, 8 * int(np.prod(shape)))])


def be_virtual(file, name, other):
    layout = h5py.VirtualLayout(shape=file[name].shape, dtype="f8")
    layout[...] = h5py.VirtualSource(str(other), name, shape=file[name].shape)
    del file[name]
    file.create_virtual_dataset(name, layout)


@pytest.mark.parametrize("way", [lead_out, lie_outside, be_virtual])
@pytest.mark.parametrize("reader", ["verify", "analyse", "histogram", "run"])
def test_no_other_file_is_read_through_hdf5(solved, stranger, tmp_path, way, reader):
    with h5py.File(stranger / "run.h5", "r+") as file:
        way(file, "coefficient/x", solved / "run.h5")
        del file.attrs["sha256"]
    out = [] if reader == "verify" else ["--out", tmp_path / "out"]
    given = ["--shape", "4,5", "--coefficients", stranger / "run.h5"] if reader == "run" else [stranger / "run.h5"]
    assert "which are not read" in (said := refused(reader, *given, *out)) or "not followed" in said


def test_what_a_folder_holds_removes_nothing_outside_of_it(stranger, tmp_path):
    """A stranger's folder may look like one whose completion was killed, with a list of files that go."""
    (tmp_path / "mine").touch()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "file").touch()
    (stranger / ".complete").mkdir()
    (stranger / ".complete" / ".outdated").write_text(f"../mine\n{tmp_path / 'mine'}\n\0\n..\n")
    assert answer_to("analyse", stranger, "--no-figures").code == 0
    assert not (stranger / ".complete").exists()
    (stranger / ".complete").symlink_to(tmp_path / "elsewhere")
    assert answer_to("analyse", stranger, "--no-figures").code == 0
    assert (tmp_path / "mine").exists()
    assert (tmp_path / "elsewhere" / "file").exists()


@pytest.mark.parametrize("name", ["run.h5", "domains.png", "spins.pdf", ".in-use"])
def test_nothing_is_written_through_a_link_out_of_a_run(stranger, tmp_path, name):
    mine = tmp_path / "mine"
    mine.write_bytes((stranger / "run.h5").read_bytes())
    (stranger / name).unlink(missing_ok=True)
    (stranger / name).symlink_to(mine)
    before, answer = (
        mine.read_bytes(),
        answer_to(*(["plot", "spins"] if name == "spins.pdf" else ["analyse"]), stranger),
    )
    assert "link out of its folder" in answer.errors or name == "domains.png"  # a figure that is drawn anew goes first
    assert mine.read_bytes() == before


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strange-scans")
    (folder / "scan.toml").write_text("shape = [4, 5]\n[scan]\nseed = { start = 0, stop = 2 }\n")
    assert answer_to("scan", folder / "scan.toml", "--workers", "1", "--out", folder / "scan").code == 0
    return folder / "scan"


@pytest.mark.parametrize("name", ["scan.toml", "scan.h5", "scan.csv", "samples.jsonl", "states", ".in-use"])
def test_nothing_is_written_through_a_link_out_of_a_scan(scanned, tmp_path, name):
    folder, mine = tmp_path / "scan", tmp_path / "mine"
    folder.mkdir()
    for file in scanned.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    if name == "states":
        mine.mkdir()
    else:
        mine.write_bytes((folder / name).read_bytes() if (folder / name).exists() else b"mine")
        (folder / name).unlink(missing_ok=True)
    before = mine.read_bytes() if mine.is_file() else b""
    (folder / name).symlink_to(mine)
    assert "link out of its folder" in refused("scan", folder, "--workers", "1")
    assert (mine.read_bytes() if mine.is_file() else b"".join(map(bytes, mine.iterdir()))) == before


def test_a_journal_names_no_file(scanned, tmp_path):
    folder = tmp_path / "scan"
    folder.mkdir()
    (folder / "scan.toml").write_bytes((scanned / "scan.toml").read_bytes())
    record = json.loads((scanned / "samples.jsonl").read_bytes().splitlines()[0])["sample"] | {"key": "../../mine"}
    text = json.dumps(record).encode()
    (folder / "samples.jsonl").write_bytes(b'{"crc32": "%08x", "sample": ' % zlib.crc32(text) + text + b"}\n")
    assert "does not ask for" in refused("scan", folder, "--keep-states", "--workers", "1")
    assert {file.name for file in tmp_path.iterdir()} == {"scan"}


def claim_terabytes(file):
    file.create_dataset("coefficient/x", shape=(10**4, 10**4, 10**4), dtype="f8", chunks=(10, 10, 10))


def be_a_bomb(file):
    file.create_dataset("coefficient/x", shape=(2**28,), dtype="f8", chunks=(2**17,), compression="gzip")[: 2**22] = 0


@pytest.mark.parametrize("make", [claim_terabytes, be_a_bomb])
@pytest.mark.parametrize("reader", ["verify", "analyse", "plot", "run"])
def test_a_small_file_takes_little_memory(stranger, tmp_path, make, reader):
    with h5py.File(stranger / "run.h5", "r+") as file:
        del file["coefficient/x"]
        make(file)
    words = {"plot": ["plot", "spins"], "run": ["run", "--shape", "4,5", "--coefficients"]}.get(reader, [reader])
    assert "claims to hold" in refused(*words, stranger / "run.h5")


@pytest.mark.parametrize("claim", [(10**12,), (10**5, 10**5), (2**40, 2**40)])
@pytest.mark.parametrize("ending", ["npy", "npz"])
def test_an_array_that_claims_too_much_is_not_allocated(tmp_path, claim, ending):
    file = claiming(tmp_path / f"a.{ending}", "<f8", claim)
    assert "cannot be read" in refused("run", "--shape", "4,5", "--initial", file, "--out", tmp_path / "out")


def test_a_list_without_end_is_seen(stranger):
    """HDF5 2.0 reads an entry of no length in its list of texts over and over, deaf to Ctrl-C."""
    content = (stranger / "run.h5").read_bytes()
    heap = content.index(b"GCOL\x01\0\0\0")
    (stranger / "run.h5").write_bytes(content[: heap + 16] + bytes(64) + content[heap + 80 :])
    for words in (("verify",), ("plot", "spins"), ("analyse",), ("histogram",)):
        assert "comes to no end" in refused(*words, stranger)


@pytest.mark.skipif(sys.platform != "linux", reason="played in a fork")
@pytest.mark.parametrize(("harm", "words"), [("hang", "comes to no end"), ("crash", "crashes on it")])
def test_what_hdf5_does_to_a_damaged_file_stays_in_a_child(stranger, monkeypatch, harm, words):
    """HDF5 that hangs or crashes at a file, played by a faulty reader."""

    def fail(*_):
        if harm == "crash":
            os.abort()
        while True:
            pass

    monkeypatch.setattr(hdf5, "SECONDS", 0.2)
    monkeypatch.setattr(hdf5, "reason_against", fail)
    hdf5._reason_found.cache_clear()
    with pytest.raises(FileError, match=words):
        tb.load(stranger)
    monkeypatch.undo()
    hdf5._reason_found.cache_clear()
    assert tb.load(stranger).power > 0


def test_where_there_is_no_fork_a_file_is_looked_through_all_the_same(solved, stranger, monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    hdf5._reason_found.cache_clear()
    assert tb.load(stranger).power > 0
    with h5py.File(stranger / "run.h5", "r+") as file:
        lead_out(file, "spin", solved / "run.h5")
    with pytest.raises(FileError, match="not followed"):
        tb.load(stranger)


def test_a_message_does_nothing_to_a_terminal():
    text = str(BearingsError("\x1b[2J\x07 in\n" + "x" * 10**6))
    assert text.startswith(r"\x1b[2J\x07 in\nxx")
    assert len(text) < 1100
