"""scan.h5, scan.csv and other tables as others read them; files appear in full or not at all."""

import csv
import math

import h5py
import numpy as np
import pytest

from taichi_bearings.analysis.histogram import count_powers
from taichi_bearings.errors import FileError
from taichi_bearings.files.scan_file import column, dense_histograms, read_scan, write_scan
from taichi_bearings.files.whole_file import write_csv, write_text
from tests.stored_scans import bin_of

COLUMNS = {
    "seed": column([1, 2, 3], "1", "seed of the disorder"),
    "shape": column(["4x4", "6x6", "6x6"], "1", "shape"),
    "power": column([1 / 3, None, 2.5], "energy/time", "power"),
    "status": column(["certified", "failed", "certified"], "1", "status"),
    "unique": column([True, False, True], "1", "a truth value"),
    "iterations": column([1, None, 3], "1", "whole numbers of which one is missing"),
    "error": column([None, "größer, \"als\"\nerlaubt", None], "1", "texts"),
}  # fmt: skip
CONTACTS = {"slipping": [3, 0, 2], "slipless": [5, 0, 6], "undecided": [0, 0, 1], "tied": [1, 0, 0]}


@pytest.fixture
def path(tmp_path):
    histograms = dense_histograms([{-3: 2, 5: 1}, {}, {4: 2}], CONTACTS)
    write_scan(tmp_path, COLUMNS, histograms, {"scan": "seed = 1\n", "scanned": ["seed", "shape"]})
    return tmp_path


def test_what_is_written_is_read_back(path):
    scan = read_scan(path)
    assert scan.samples == 3
    assert scan.scanned == ("seed", "shape")
    assert list(scan.table) == list(COLUMNS)
    for name, item in COLUMNS.items():
        assert np.array_equal(scan.table[name], item.values, equal_nan=item.values.dtype == np.float64)
    assert scan.failed.tolist() == [False, True, False]
    assert scan.table["seed"].dtype == np.int64
    assert scan.histograms.count.sum(axis=1).tolist() == [3, 0, 2]
    assert len(scan.histograms.edges) == 10


def test_plain_h5py_can_read_it(path):
    with h5py.File(path / "scan.h5") as file:
        assert file.attrs["schema"] == "taichi_bearings.scan"
        assert file["table/status"].asstr()[1] == "failed"
        for name, item in COLUMNS.items():
            assert dict(file["table"][name].attrs) == {"units": item.units, "description": item.description}
        assert file["histogram/count"].dtype == np.int32


def test_the_csv_has_one_row_a_sample(path):
    with (path / "scan.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["seed"] for row in rows] == ["1", "2", "3"]
    assert [row["power"] for row in rows] == [repr(1 / 3), "", "2.5"]
    assert [row["unique"] for row in rows] == ["true", "false", "true"]
    assert rows[1]["error"] == 'größer, "als"\\nerlaubt'


def test_every_power_lies_in_its_bin():
    power = np.exp(np.random.default_rng(5).uniform(-30, 30, 10_000))
    number = bin_of(power)
    assert (10 ** (number / 20) <= power * (1 + 1e-12)).all()
    assert (power <= 10 ** ((number + 1) / 20) * (1 + 1e-12)).all()
    low, high = int(number.min()), int(number.max())
    counts = count_powers(power[None], np.ones((1, len(power)), dtype=np.uint8), 20)
    assert counts.first == low
    assert np.array_equal(counts.count[0], np.bincount(number - low))
    whole = dense_histograms([{int(n): 1 for n in number}], {name: [0] for name in CONTACTS})
    assert len(whole.edges) == high - low + 2
    assert math.isclose(whole.edges[0], 10 ** (low / 20))


def test_a_scan_without_slipping_contacts_has_no_bins(tmp_path):
    write_scan(tmp_path, COLUMNS, dense_histograms([{}, {}, {}], CONTACTS), {"scan": "", "scanned": []})
    scan = read_scan(tmp_path)
    assert scan.histograms.count.shape == (3, 0)
    assert scan.scanned == ()


def test_other_files_are_refused_by_name(path, tmp_path):
    for name, content, expected in (
        ("torn.h5", (path / "scan.h5").read_bytes()[:3000], "cannot be read"),
        ("text.h5", b"hello", "cannot be read"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileError, match=expected):
            read_scan(tmp_path / name)
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.attrs["schema"] = "taichi_bearings.run"
    with pytest.raises(FileError, match="its attribute `schema` is"):
        read_scan(tmp_path / "run.h5")
    with pytest.raises(FileError, match="is not a scan"):
        read_scan(tmp_path / "none")
    with h5py.File(path / "scan.h5", "a") as file:
        file.attrs["schema_version"] = 99
    with pytest.raises(FileError, match="version 99"):
        read_scan(path)


def test_numbers_come_back_to_the_last_bit(tmp_path):
    values = [0.1 + 0.2, 1e-300, -1 / 3]
    write_csv(tmp_path / "t.csv", ["a", "b"], [[value, "x, y"] for value in values], notes=["made by hand"])
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert lines[:2] == ["# made by hand", "a,b"]
    assert [float(line.split(",")[0]) for line in lines[2:]] == values
    assert lines[2].endswith(',"x, y"')


def test_a_folder_that_is_missing_is_named(tmp_path):
    with pytest.raises(FileError, match="cannot be written"):
        write_text(tmp_path / "none" / "t.txt", "new")
