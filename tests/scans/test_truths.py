"""Columns of truth values in the tables of a scan, where some samples have none."""

import csv

import h5py
import numpy as np

from taichi_bearings.files.scan_file import CONTACT_SETS, column, dense_histograms, write_scan


def test_truths_with_gaps_stay_truths(tmp_path):
    columns = {
        "status": column(["certified", "stalled", "certified"], "1", "how it ended"),
        "whole": column([True, False, True], "1", "every sample has one"),
        "unique": column([True, None, False], "1", "one sample has none"),
        "none": column([None, None, None], "1", "no sample has one"),
    }
    counts = dense_histograms([{}, {}, {}], {name: [0, 0, 0] for name in CONTACT_SETS})
    write_scan(tmp_path, columns, counts, {"scan": "", "scanned": []})
    with (tmp_path / "scan.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["whole"] for row in rows] == ["true", "false", "true"]
    assert [row["unique"] for row in rows] == ["true", "", "false"]
    assert [row["none"] for row in rows] == ["", "", ""]
    with h5py.File(tmp_path / "scan.h5") as file:
        np.testing.assert_array_equal(file["table/unique"][:], [1.0, np.nan, 0.0])
