"""A number that has changed since a file was written is not read as a result, whoever reads it."""

import hashlib
import json
import shutil

import h5py
import pytest

from taichi_bearings.errors import BearingsError, FileError
from taichi_bearings.files.scan_file import column, dense_histograms, read_scan, write_scan
from taichi_bearings.runs.analysis import analyse
from taichi_bearings.runs.lattice_run import solve_job
from taichi_bearings.runs.run import prepare, run
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings, read_toml
from taichi_bearings.runs.verify import verify
from taichi_bearings.scans.histogram import read_source
from taichi_bearings.scene.array_files import read_coefficients
from taichi_bearings.scene.initial_spins import initial_spin

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    run(RunSettings(shape=(3, 4, 5), seed=4, threads=1), folder)
    analyse(folder, figures=False)
    return folder


@pytest.fixture
def path(solved, tmp_path):
    """A run file of which each test has its own."""
    shutil.copy(solved / "run.h5", tmp_path)
    return tmp_path / "run.h5"


def everything(path):
    """Names of all data sets and of the attributes of the root and of the analysis."""
    with h5py.File(path) as file:
        names = []
        file.visititems(lambda name, item: names.append(name) if getattr(item, "size", 0) else None)
        groups = ("", "analysis")
        return names + [f"{group}@{name}" for group in groups for name in file[group or "/"].attrs if name != "sha256"]


def change(path, name):
    """One number, or an attribute."""
    with h5py.File(path, "r+") as file:
        place, is_attribute, attribute = name.partition("@")
        if is_attribute:
            file[place or "/"].attrs[attribute] = "another"
        else:
            values = file[place][()]
            first = (0,) * values.ndim
            values[first] = ~values[first] if values.dtype.kind in "biu" else 0.5 - 3 * values[first]
            file[place][...] = values


def test_any_change_is_refused_in_one_sentence(path, thorough):
    whole, names = path.read_bytes(), everything(path)
    assert len(names) > 80
    read_run(path)
    for name in names if thorough else names[::4]:
        path.write_bytes(whole)
        change(path, name)
        with pytest.raises(FileError) as refused:
            read_run(path)
        assert "\n" not in str(refused.value), name
        if "schema" not in name:
            assert "damaged" in str(refused.value), name


def test_a_file_that_lost_its_version_is_called_damaged(path):
    with h5py.File(path, "r+") as file:
        del file.attrs["schema_version"]
    with pytest.raises(FileError, match="is damaged or was changed: it lacks the attribute schema_version"):
        read_run(path)


def test_all_who_read_runs_refuse_what_was_changed(path, tmp_path):
    change(path, "contact/x/power")
    scene = prepare(RunSettings(shape=(3, 4, 5))).scene
    for read in (
        read_source,
        read_toml,
        lambda path: analyse(path, out=tmp_path / "out"),
        lambda path: read_coefficients(path),
        lambda path: initial_spin(scene, str(path)),
    ):
        with pytest.raises(FileError, match="contact/x/power does not match"):
            read(path)
    report = verify(path)
    assert report["unchanged"] is False
    assert "contact/x/power was changed after it was written" in report["contradictions"]


def test_damage_is_not_made_whole_by_an_analysis(path):
    change(path, "history/power")
    with pytest.raises(FileError, match="does not match"):
        analyse(path)
    with h5py.File(path, "r+") as file:
        assert "analysis" in file


def test_files_without_checksums_are_read(path):
    with h5py.File(path, "r+") as file:
        del file.attrs["sha256"], file["analysis"]
    change(path, "contact/x/power")
    assert read_run(path).solution.spin.shape == (1, 3, 4, 5, 3)
    assert verify(path)["unchanged"] is None
    assert verify(path.parent)["contradictions"]


def test_what_others_add_is_not_looked_at(path):
    with h5py.File(path, "r+") as file:
        file.attrs["note"], file["own"] = "mine", [1, 2]
    read_run(path)
    report = verify(path)
    assert report["verified"]
    assert report["unchanged"]


def test_the_checksums_are_made_as_the_documentation_says(path):
    with h5py.File(path) as file:
        stored, values = json.loads(file.attrs["sha256"]), file["spin"][()]
        assert stored["spin"] == hashlib.sha256(b"<f8 (3, 4, 5, 3)" + values.tobytes()).hexdigest()
        power = json.dumps(float(file.attrs["power"])).encode()
        assert stored["@power"] == hashlib.sha256(power).hexdigest()


def test_a_bound_above_the_power_is_an_error_everywhere(path, tmp_path):
    with h5py.File(path, "r+") as file:
        del file.attrs["sha256"]
        file.attrs["lower_bound"] = 1.001 * file.attrs["power"]
    with pytest.raises(FileError, match="a lower bound above the power"):
        read_run(path)
    contacts = {name: [0] for name in ("slipping", "slipless", "undecided", "tied")}
    scan, empty = tmp_path / "scan.h5", dense_histograms([{}], contacts)
    columns = {"status": column(["certified"], "", "end"), "gap": column([1e-9], "1", "gap")}
    write_scan(tmp_path, columns, empty, {"scan": "", "scanned": []})
    read_scan(scan)
    with h5py.File(scan, "r+") as file:
        file["table/gap"][0] = -1e-6
    with pytest.raises(FileError, match="table/gap does not match"):
        read_scan(scan)
    with h5py.File(scan, "r+") as file:
        del file.attrs["sha256"]
    with pytest.raises(FileError, match="a lower bound above the power"):
        read_scan(scan)


def test_a_solver_that_proves_too_much_has_no_result(monkeypatch):
    from taichi_bearings.proof.judgement import Judgement

    monkeypatch.setattr(Judgement, "lower_bound", property(lambda self: self.power * 1.01))
    with pytest.raises(BearingsError, match="lies above the power"):
        solve_job(prepare(RunSettings(shape=(3, 4), threads=1)))
