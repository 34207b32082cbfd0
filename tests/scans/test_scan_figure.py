"""Figures of a scan: which samples make a point, and what its bar is."""

import csv

import numpy as np
import pytest

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.scans.figure import DRAWN_COLUMNS, Request, columns_of, plot_scan, points_of
from tests.stored_scans import stored_scan

SEEDS, BOTTOMS = 9, (0.0, 0.1)
FAILED = (1, 30)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return stored_scan(tmp_path_factory.mktemp("scan"), bottoms=BOTTOMS, seeds=SEEDS, failed=FAILED)


def points(scan, *words, **more):
    """Values of the parting columns, and the point, of each."""
    request = Request(*words, **more)
    found = points_of(columns_of(read_scan(scan.path), request), request)
    return [(part, point) for part, own in found.items() for point in own]


def plotted(point):
    return [point[name] for name in DRAWN_COLUMNS]


def power(scan, shape, bottom):
    table = scan.table
    chosen = zip(table["shape"], table["spin_bottom"], table["power"], strict=True)
    return np.array([p for s, b, p in chosen if (s, b) == (shape, bottom) and p is not None])


def test_a_point_is_the_mean_of_its_samples_and_failed_ones_are_missing(scan):
    found = points(scan, "power", "spin_bottom", by=("shape",))
    assert [(part, point["x"]) for part, point in found] == [
        ((shape,), bottom) for shape in ("4x4", "8x8", "16x16") for bottom in BOTTOMS
    ]
    assert sum(point["number"] for _, point in found) == 3 * 2 * SEEDS - len(FAILED)
    for part, point in found:
        values = power(scan, *part, point["x"])
        mean, error = values.mean(), values.std(ddof=1) / np.sqrt(len(values))
        assert point["number"] == len(values)
        assert plotted(point) == pytest.approx([point["x"], mean, mean - error, mean + error])


def test_bars_are_what_was_asked_for(scan):
    values = power(scan, "8x8", 0.1)
    only = {"where": ("spin_bottom=0.1", "shape=8x8")}
    ((_, point),) = points(scan, "power", "L", **only)
    low, mean, high = (point[name] for name in ("low", "mean", "high"))  # of the interval
    assert mean == pytest.approx(values.mean())
    assert values.min() < low < point["plot_low"] < mean < point["plot_high"] < high < values.max()
    ((_, point),) = points(scan, "power/power_minimum_cut", "L", **only)
    assert plotted(point) == pytest.approx([8, 0.8, 0.8, 0.8])
    ((_, alone),) = points(scan, "power", "L", where=("seed=4", *only["where"]))
    assert alone["number"] == 1
    assert np.isnan(plotted(alone)[2:]).all()  # one sample has no bar


def test_two_samples_have_no_bar(tmp_path):
    two, three = (stored_scan(tmp_path / str(n), sides=(4,), bottoms=(0.0,), seeds=n) for n in (2, 3))
    for y in ("power", "power/power_minimum_cut"):
        ends = [plotted(points(known, y, "L")[0][1])[2:] for known in (two, three)]
        assert np.isnan(ends).tolist() == [[True, True], [False, False]]


def test_figure_and_table_hold_the_same_points(scan, tmp_path):
    request = Request("power", "spin_bottom", by=("L",), log="y")
    files = plot_scan(scan.path.parent, request, tmp_path / "figure.png")
    assert files == [tmp_path / "figure.png", tmp_path / "figure.csv"]
    assert files[0].read_bytes()[:4] == b"\x89PNG"
    with files[1].open() as file:
        rows = list(csv.DictReader(file))
    found = points(scan, "power", "spin_bottom", by=("L",))
    assert [(int(row["L"]), float(row["spin_bottom"])) for row in rows] == [(*part, p["x"]) for part, p in found]
    assert [float(row["mean"]) for row in rows] == [p["mean"] for _, p in found]
    assert [float(row["plot_high"]) for row in rows] == [p["plot_high"] for _, p in found]
    with pytest.raises(FileError, match="already exists"):
        plot_scan(scan.path, request, tmp_path / "figure.png")
    plot_scan(scan.path, request, tmp_path / "figure.png", force=True)
    own = plot_scan(scan.path, Request("power/slipping", "L", by=("spin_bottom",)))
    assert own[0] == scan.path.parent / "power_over_slipping_against_L_by_spin_bottom.pdf"
    assert plot_scan(scan.path, Request("power/slipping", "L", by=("spin_bottom",))) == own


@pytest.mark.parametrize(
    ("words", "more", "sentence"),
    [
        (("colour", "L"), {}, "no column 'colour'"),
        (("power", "L"), {"by": ("colour",)}, "no column 'colour'"),
        (("law", "L"), {}, "texts"),
        (("power/slipping/slipless", "L"), {}, "one over another"),
        (("power", "L"), {"where": ("spin_bottom",)}, "KEY=VALUE"),
        (("power", "L"), {"where": ("spin_bottom=x",)}, "holds numbers"),
        (("power", "L"), {"where": ("spin_bottom=0.5",)}, r"one of 0.0, 0.1"),
        (("power", "L"), {"where": ("status=failed",)}, "no sample"),
        (("power", "spin_bottom"), {"log": "x"}, "above 0"),
        (("power", "shape"), {"log": "x"}, "the column shape holds texts"),
    ],
    ids=str,
)
def test_what_cannot_be_drawn_is_refused_in_a_sentence(scan, words, more, sentence):
    with pytest.raises(InputError, match=sentence):
        points(scan, *words, **more)
