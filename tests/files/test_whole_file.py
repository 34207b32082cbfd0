"""Files appear in full or not at all."""

import pytest

from taichi_bearings.errors import FileError
from taichi_bearings.files.whole_file import write_csv, write_hdf5, write_text


def test_numbers_come_back_to_the_last_bit(tmp_path):
    values = [0.1 + 0.2, 1e-300, -1 / 3]
    write_csv(tmp_path / "t.csv", ["a", "b"], [[value, "x, y"] for value in values], notes=["made by hand"])
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert lines[:2] == ["# made by hand", "a,b"]
    assert [float(line.split(",")[0]) for line in lines[2:]] == values
    assert lines[2].endswith(',"x, y"')


def test_a_write_that_fails_leaves_what_was_there_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "t.txt"
    write_text(path, "old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(FileError, match=r"t\.txt cannot be written: No space left"):
        write_text(path, "new")
    with pytest.raises(FileError, match="No space left"):
        write_hdf5(path, lambda file: file.create_group("g"))
    assert [file.name for file in tmp_path.iterdir()] == ["t.txt"]
    assert path.read_text() == "old"


def test_a_folder_that_is_missing_is_named(tmp_path):
    with pytest.raises(FileError, match="cannot be written"):
        write_text(tmp_path / "none" / "t.txt", "new")
