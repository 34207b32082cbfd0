"""Files appear in full or not at all."""

import pytest

from taichi_bearings.errors import FileError
from taichi_bearings.files.whole_file import write_csv, write_text


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
