"""Files from strangers are data: they run no code, lead nowhere else, and ask for no more memory than they can fill."""

import io
import json
import os
import pickle
import shutil
import struct
import subprocess
import sys
import time
import zipfile

import h5py
import numpy as np
import pytest
from taichi_bearings_cli.verify import describe

import taichi_bearings as tb
from taichi_bearings import compiler
from taichi_bearings.errors import BearingsError, FileError
from taichi_bearings.files.scan_journal import read_journal
from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.plain_files import read_lines
from taichi_bearings.runs.verify import verify
from taichi_bearings.scans.listing import entries
from tests.cli.commands import bearings, refused
from tests.fuzz.damage import claiming, line_of

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


def test_a_scene_file_replaces_nothing_by_itself(solved, tmp_path):
    content, scene = (solved / "run.h5").read_bytes(), tmp_path / "scene.toml"
    scene.write_text(f'shape = [4, 5]\nout = "{solved}"\nforce = true\n')
    assert "only the command line can allow to overwrite files, by --force" in refused("run", scene)
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
    """A stranger's folder may look like one whose completion was killed."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "file").touch()
    (stranger / ".complete").symlink_to(tmp_path / "elsewhere")
    assert bearings("analyse", stranger, "--no-figures").returncode == 0
    assert (tmp_path / "elsewhere" / "file").exists()


@pytest.mark.parametrize("name", ["run.h5", "domains.png", "spins.pdf", ".in-use"])
def test_nothing_is_written_through_a_link_out_of_a_run(stranger, tmp_path, name):
    mine = tmp_path / "mine"
    mine.write_bytes((stranger / "run.h5").read_bytes())
    (stranger / name).unlink(missing_ok=True)
    (stranger / name).symlink_to(mine)
    before = mine.read_bytes()
    answer = bearings(*(["plot", "spins"] if name == "spins.pdf" else ["analyse"]), stranger)
    assert "link out of its folder" in answer.stderr or name == "domains.png"  # a figure that is drawn anew goes first
    assert mine.read_bytes() == before


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strange-scans")
    (folder / "scan.toml").write_text("shape = [4, 5]\n[scan]\nseed = { start = 0, stop = 2 }\n")
    assert bearings("scan", folder / "scan.toml", "--workers", "1", "--out", folder / "scan").returncode == 0
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
    (folder / "samples.jsonl").write_bytes(line_of(json.dumps(record).encode()))
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


def test_a_message_does_nothing_to_a_terminal():
    text = str(BearingsError("\x1b[2J\x07 in\n" + "x" * 10**6))
    assert text.startswith(r"\x1b[2J\x07 in\nxx")
    assert len(text) < 1100


WRITERS = {
    "view": ("view", "{}", "--out", "{}/a.html"),
    "export": ("export", "{}", "--out", "{}/a.vtkhdf"),
    "plot": ("plot", "power", "{}", "--out", "{}/a.png"),
    "histogram": ("histogram", "{}", "--out", "{}"),
    "analyse": ("analyse", "{}", "--no-figures"),
    "run": ("run", "--shape", "4,5", "--figures", "none", "--out", "{}/a"),
}


@pytest.mark.parametrize(("command", "kind"), list(zip(WRITERS, 3 * ("link", "pipe"), strict=True)))
def test_what_waits_under_a_temporary_name_is_neither_followed_nor_waited_for(stranger, tmp_path, command, kind):
    """Also under the names that this program once gave to files that it was writing."""
    (tmp_path / "mine").write_text("mine")
    written = ["a.html", "a.vtkhdf", "a.png", "run.h5", *(f"power_histogram.{end}" for end in ("csv", "h5", "png"))]
    planted = [f"{name}.partial" for name in written] + [f".{name}.partial-7-00ff00" for name in (*written, "a")]
    for name in [*planted, ".partial", ".complete", ".b.in-use"]:
        os.symlink(tmp_path / "mine", stranger / name) if kind == "link" else os.mkfifo(stranger / name)
    answer = bearings(*(word.format(stranger) for word in WRITERS[command]))
    assert (answer.returncode, answer.fault) == (0, ""), answer
    assert (tmp_path / "mine").read_text() == "mine"
    assert not any((stranger / name).exists() for name in planted if name.startswith(".a."))


@pytest.mark.parametrize(("command", "kind"), list(zip(WRITERS, 2 * ("link", "pipe", "folder"), strict=True)))
def test_a_lock_is_a_regular_file(stranger, tmp_path, command, kind):
    for name in (".in-use", ".a.in-use"):
        place = stranger / name
        if kind == "folder":
            place.mkdir()
        else:
            place.symlink_to("/dev/null") if kind == "link" else os.mkfifo(place)
    said = refused(*(word.format(stranger) for word in WRITERS[command]))
    assert "is a link out of its folder" in said or "is not a regular file" in said or "Is a directory" in said


BOMBS = {
    "dots": "a." * 30_000 + "a = 1",
    "dots between": "[" + " . ".join(["a", '"b"', "'c'"] * 20_000) + "]",
    "many dots": "\n".join(f"a{n}.b.c.d.e.f.g.h = 1" for n in range(10_000)),
    "length": "a = 1 #" + 2**23 * "x",
    "brackets": "a = " + "[" * 5000 + "]" * 5000,
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_scene_costs_no_more_than_it_is_long(tmp_path, bomb):
    (tmp_path / "scan").mkdir()
    (tmp_path / "scan" / "scan.toml").write_text(BOMBS[bomb])
    (tmp_path / "scan" / "samples.jsonl").touch()
    began = time.process_time()
    for words in (["run", tmp_path / "scan" / "scan.toml"], ["scan", tmp_path / "scan", "--dry-run"]):
        assert "scan.toml" in refused(*words)
    assert "cannot be read" in next(iter(entries(tmp_path))).words()
    assert time.process_time() - began < 3


@pytest.mark.parametrize(
    ("name", "kind"),
    [("samples.jsonl", "pipe"), ("samples.jsonl", "device"), ("scan.toml", "pipe"), ("x_against_y.csv", "device")],
)
def test_what_a_scan_holds_is_neither_waited_for_nor_endless(scanned, tmp_path, name, kind):
    shutil.copytree(scanned, tmp_path / "scan")
    place = tmp_path / "scan" / name
    place.unlink(missing_ok=True)
    os.mkfifo(place) if kind == "pipe" else place.symlink_to("/dev/zero")
    (tmp_path / "scan" / "scan.h5").unlink()
    for words in (
        ["list", tmp_path],
        ["scan", tmp_path / "scan", "--workers", "1"],
        ["scan", tmp_path / "scan", "--merge"],
        ["plot", "scan", tmp_path / "scan", "--y", "power", "--x", "seed", "--out", tmp_path / "a.png", "--force"],
    ):
        answer = bearings(*words)
        assert not answer.fault, answer


def test_a_line_of_a_journal_has_an_end(scanned, tmp_path, caplog):
    journal = tmp_path / "samples.jsonl"
    journal.write_bytes(b"x" * 2**25 + b"\n" + (scanned / "samples.jsonl").read_bytes())
    assert len(read_journal(journal)) == 2
    assert "line 1 of" in caplog.text
    assert max(map(len, read_lines(journal))) < 2**20


@pytest.mark.parametrize("changes", [{"lower_bound": 1e3}, {"gap": -1e-3}, {f"a{n}": n for n in range(500)}])
def test_no_sample_has_a_bound_above_its_power(scanned, tmp_path, changes):
    shutil.copytree(scanned, tmp_path / "scan")
    journal = tmp_path / "scan" / "samples.jsonl"
    record = json.loads(journal.read_bytes().splitlines()[0])["sample"]
    record["scalars"] |= changes
    journal.write_bytes(line_of(json.dumps(record).encode()))
    answer = bearings("scan", tmp_path / "scan", "--merge")
    assert answer.returncode == 2
    assert "holds no samples" in answer.stderr


def test_texts_in_tables_are_no_formulas(tmp_path):
    texts = ["=1+1", "@sum", "+cmd", "-x", "\t=1", "plain", "-1.5", "+inf"]
    write_csv(tmp_path / "a.csv", ["number", "text"], [[-1.5, text] for text in texts])
    cells = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()[1:]]
    assert {number for number, _ in cells} == {"-1.5"}
    assert [text for _, text in cells] == ["'=1+1", "'@sum", "'+cmd", "'-x", "'\t=1", "plain", "-1.5", "+inf"]


SCRIPT = "<script>alert(1)</script>@@ARRAYS@@"


def test_texts_of_a_run_do_nothing_to_its_page(stranger):
    with h5py.File(stranger / "run.h5", "r+") as file:
        del file.attrs["sha256"]
        file.attrs["method"] = SCRIPT
        file.attrs["version"] = SCRIPT
    assert bearings("view", stranger).returncode == 0
    assert "alert(1)</script>" not in (stranger / "view.html").read_text()


@pytest.mark.parametrize("spoil", [lambda folder: folder.chmod(0o777), lambda folder: os.chown(folder, 12345, 12345)])
def test_kernels_are_kept_where_nobody_else_can_write(tmp_path, monkeypatch, spoil):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    ours = compiler.cache_folder()
    assert ours.is_relative_to(tmp_path / "home")
    try:
        spoil(ours.parent)
    except PermissionError:
        pytest.skip("only root gives folders away")
    second = compiler.cache_folder()
    assert second.parent.parent.name == f"taichi_bearings-cache-{os.getuid()}"
    spoil(second.parent.parent)
    assert compiler.cache_folder() is None


def test_a_lock_that_a_killed_compiler_has_left_goes(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = compiler.cache_folder()
    folder.mkdir()
    old, new = folder / "ticache.lock", folder / "other.lock"
    old.touch()
    new.touch()
    os.utime(old, (1e9, 1e9))
    assert compiler.cache_folder() == folder
    assert (old.exists(), new.exists()) == (False, True)


def unsealed(folder, change):
    with h5py.File(folder / "run.h5", "r+") as file:
        file.attrs.pop("sha256", None)
        change(file)


@pytest.mark.parametrize(
    "text", ["a." * 12_000 + "a = 1", "[" + "a." * 12_000 + "a]", "a = {" + "a." * 12_000 + "a = 1}"]
)
def test_the_scene_in_a_file_costs_verify_no_more_than_it_is_long(stranger, text):
    """Keys of that many dots took 0.6 GB and 7 s."""
    unsealed(stranger, lambda file: file.attrs.__setitem__("scene", f"{file.attrs['scene']}{text}\n"))
    began = time.process_time()
    assert "may have at most 20 dots" in refused("verify", stranger)
    assert time.process_time() - began < 3


@pytest.mark.parametrize(
    ("command", "text"), [("view", "[" + "[]," * 300_000 + "[]]"), ("verify", "[]"), ("view", "null")]
)
def test_checksums_are_a_table_of_texts(stranger, text, command):
    with h5py.File(stranger / "run.h5", "r+", libver="latest") as file:
        file.attrs["sha256"] = text
    said = refused(command, stranger)
    assert "checksums" in said or "lists and tables" in said


@pytest.mark.parametrize("command", ["verify", "view"])
def test_lists_that_many_entries_share_are_not_read(stranger, command):
    """4000 entries that all name one list of 8 MB: 32 GB from a file of 8 MB."""

    def share(file):
        lists = file.create_dataset("v", (4000,), dtype=h5py.vlen_dtype("f8"))
        lists[0] = np.zeros(10**6)
        file.attrs["sha256"] = '{"v": "0"}'

    unsealed(stranger, share)
    with h5py.File(stranger / "run.h5") as file:
        place, size = file["v"].id.get_offset(), file["v"].id.get_storage_size()
    content = bytearray((stranger / "run.h5").read_bytes())
    content[place : place + size] = content[place : place + size // 4000] * 4000
    (stranger / "run.h5").write_bytes(content)
    assert "holds lists, which can be of any length" in refused(command, stranger)


def test_a_packed_array_and_its_header_take_little_memory(tmp_path):
    np.savez_compressed(tmp_path / "array.npz", spin=np.zeros(2**23))
    with (
        zipfile.ZipFile(tmp_path / "header.npz", "w", zipfile.ZIP_DEFLATED) as packed,
        packed.open("spin.npy", "w") as file,
    ):
        file.write(b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**29))
        for _ in range(2**9):
            file.write(b" " * 2**20)
    said = {
        name: refused("run", "--shape", "4,5", "--initial", tmp_path / f"{name}.npz") for name in ("array", "header")
    }
    assert "claims to hold more than" in said["array"]
    assert "cannot be read" in said["header"]


EVIL = "=cmd\n=1+1, $\\frac{$ \x1b[2J"


def test_what_verify_says_of_a_file_does_nothing_to_a_terminal(stranger, capsys):
    def name_evil(file):
        file["\x1b]0;x\x07\nverified"] = np.zeros(3)
        file.attrs["version"], file.attrs["power"] = EVIL, 1.0

    def end_evil(file):
        file.attrs["status"] = EVIL

    unsealed(stranger, name_evil)
    report = describe(verify(stranger))
    assert all(line.isprintable() for line in report.split("\n"))
    assert not any(line.startswith("verified") for line in report.split("\n"))
    unsealed(stranger, end_evil)
    with pytest.raises(FileError) as refused:
        verify(stranger)
    assert str(refused.value).isprintable()


def test_texts_of_a_scan_are_lines_and_no_mathematics(scanned, tmp_path):
    shutil.copytree(scanned, tmp_path / "scan")
    journal = tmp_path / "scan" / "samples.jsonl"
    records = [json.loads(line)["sample"] for line in journal.read_bytes().splitlines()]
    for record in records:
        record["scalars"]["method"] = EVIL
    journal.write_bytes(b"".join(line_of(json.dumps(record).encode()) for record in records))
    (tmp_path / "scan" / "scan.h5").unlink()
    figure = ["plot", "scan", tmp_path / "scan", "--y", "power", "--out", tmp_path / "a.png", "--force"]
    for words in (
        ["histogram", tmp_path / "scan", "--by", "method", "--out", tmp_path / "counts", "--force"],
        [*figure, "--x", "seed", "--by", "method"],
        [*figure, "--x", "method"],
        ["scan", tmp_path / "scan", "--merge"],
    ):
        answer = bearings(*words)
        assert (answer.returncode, answer.fault) == (0, ""), answer
    for table in (tmp_path / "counts" / "power_histogram.csv", tmp_path / "a.csv", tmp_path / "scan" / "scan.csv"):
        assert not any(line.startswith("=") for line in table.read_text().split("\n")), table


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 cannot be told to leave out the working folder")
def test_workers_load_no_module_of_the_working_folder(tmp_path):
    (tmp_path / "multiprocessing.py").write_text("open('loaded', 'w').close()\n")
    (tmp_path / "scan.toml").write_text("shape = [4, 5]\n[scan]\nseed = [1, 2]\n")
    as_installed = "import sys; sys.path.remove(''); from taichi_bearings_cli.main import main; main()"
    words = [sys.executable, "-c", as_installed, "scan", "scan.toml", "--workers", "2", "--out", "s"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "loaded").exists()


def test_no_matplotlibrc_of_the_working_folder_is_read(stranger, tmp_path):
    os.mkfifo(tmp_path / "matplotlibrc")  # which would wait for ever
    words = ["-c", "from taichi_bearings_cli.main import main; main()", "plot", "power", stranger, "--out", "a.png"]
    done = subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "is ignored" in done.stderr
    assert (tmp_path / "a.png").exists()
