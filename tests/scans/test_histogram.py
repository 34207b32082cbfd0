"""Histograms of runs and of scans together: what is pooled, normalised and overlaid."""

import csv

import h5py
import numpy as np
import pytest

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.runs.run import run
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.histogram import histogram, pooled, read_source
from tests.stored_scans import stored_scan


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return stored_scan(tmp_path_factory.mktemp("scan"), seeds=5, failed=(2, 17))


@pytest.fixture(scope="module")
def block(tmp_path_factory, precision):
    """A run of three seeds."""
    folder = tmp_path_factory.mktemp("run") / "block"
    run(RunSettings(shape=(4, 3, 4), replicas=3, tolerance=1e-3, precision=precision, threads=1), folder)
    return folder


def test_a_scan_is_pooled_over_its_samples(scan):
    found = pooled([read_source(scan.path)], 4)[None]
    values = np.concatenate([scan.slipping(sample) for sample in range(len(scan.power))])
    assert found.slipping == len(values) > 1000
    assert (found.count == np.histogram(values, found.edges)[0]).all()
    assert found.samples == len(scan.power) - 2
    assert found.slipless == sum((state == 0).sum() for state in scan.state)
    assert found.undecided == sum((state == 2).sum() for state in scan.state)


def test_overlays_part_the_samples_and_share_their_bins(scan):
    whole = pooled([read_source(scan.path)])[None]
    parts = pooled([read_source(scan.path.parent)], by="shape")
    assert list(parts) == ["4x4", "8x8", "16x16"]
    assert [part.samples for part in parts.values()] == [9, 9, 10]
    assert (sum(part.count for part in parts.values()) == whole.count).all()
    for part in parts.values():
        assert (part.edges == whole.edges).all()
    with pytest.raises(InputError, match="at most 24"):
        pooled([read_source(stored_scan(scan.path.parent / "many", sides=(4,), seeds=25).path)], by="seed")
    with pytest.raises(InputError, match=r"no column 'colour'.*spin_bottom"):
        pooled([read_source(scan.path)], by="colour")


def test_power_is_counted_in_the_mean_of_each_sample(scan):
    found = pooled([read_source(scan.path)], 20, "mean")[None]
    own = [
        scan.slipping(n) * len(scan.power[n]) / scan.slipping(n).sum()
        for n in range(len(scan.power))
        if n not in (2, 17)
    ]
    values = np.log10(np.concatenate(own))
    assert found.slipping == len(values)
    reached = np.searchsorted(np.sort(values), np.log10(found.edges[1:])) - np.cumsum(found.count)
    nearby = np.histogram(values, np.log10(found.edges))[0].max()
    assert abs(reached).max() <= nearby  # contacts stray to the next bin at most


def test_runs_and_scans_pool_together(scan, block):
    one, other = read_source(block), read_source(scan.path)
    stored = read_run(block).solution
    both = pooled([one, other])[None]
    assert both.samples == 3 + other.samples.size
    assert both.slipping == pooled([one])[None].slipping + pooled([other])[None].slipping
    assert list(pooled([one, other], by="shape")) == ["4x3x4", "4x4", "8x8", "16x16"]
    assert [part.samples for part in pooled([one], by="seed").values()] == [1, 1, 1]
    assert list(pooled([one], by="initial")) == ["linear"]
    power, state = stored.power_per_contact, stored.state
    values = power[state == 1]
    raw = pooled([one], 3)[None]
    assert (raw.count == np.histogram(values, raw.edges)[0]).all()
    mean = pooled([one], 3, "mean")[None]
    own = [power[r, state[r] == 1] / (stored.power[r] / (state[r] != 3).sum()) for r in range(3)]
    assert (mean.count == np.histogram(np.concatenate(own), mean.edges)[0]).all()
    with pytest.raises(InputError, match="20"):
        pooled([one, other], 7)
    with pytest.raises(InputError, match="no setting 'colour'"):
        pooled([one], by="colour")


@pytest.mark.parametrize("law", ["coulomb", "coulomb-viscous"])
def test_given_coefficients_are_one_disorder_where_all_of_them_are_the_same(law, tmp_path):
    x, y = (np.random.default_rng(1).uniform(0.1, 1.0, shape).repeat(3, axis=0) for shape in ((1, 3, 5), (1, 4, 4)))
    damping = {"x_viscosity": x.copy(), "y_viscosity": y.copy()} if law == "coulomb-viscous" else {}
    last = damping.get("y_viscosity", y)
    last[2, 3, 3] += 1e-9
    np.savez(tmp_path / "given.npz", x=x, y=y, **damping)
    settings = RunSettings(shape=(4, 5), law=law, replicas=3, coefficients=str(tmp_path / "given.npz"), threads=1)
    run(settings, tmp_path / "run")
    first, same, other = read_source(tmp_path / "run").disorder()
    assert first == same != other


def test_laws_are_pooled_apart(tmp_path):
    viscous = read_source(stored_scan(tmp_path / "v", sides=(4,), seeds=2, law="viscous").path)
    assert pooled([viscous], normalise="mean")[None].slipping
    still = read_source(stored_scan(tmp_path / "s", sides=(4,), seeds=2, bottoms=(0.1,), tops=(0.0, 1.0)).path)
    with pytest.raises(InputError, match="different laws"):
        pooled([viscous, still])
    assert list(pooled([viscous, still], by="law")) == ["coulomb", "viscous"]


def rows_of(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def test_the_files_of_an_overlay_hold_the_same_numbers(scan, tmp_path):
    report = histogram([scan.path], tmp_path / "h", by="spin_bottom")
    found = pooled([read_source(scan.path)], by="spin_bottom")
    rows = rows_of(tmp_path / "h" / "power_histogram.csv")
    assert list(rows[0]) == [
        "power_low", "power_high", "count", "standard_error", "density", "density_error", "spin_bottom",
    ]  # fmt: skip
    with h5py.File(tmp_path / "h" / "power_histogram.h5") as file:
        assert file["value"][()].tolist() == [0.0, 0.1] == [group["spin_bottom"] for group in report["groups"]]
        for place, (value, part) in enumerate(found.items()):
            mine = [row for row in rows if float(row["spin_bottom"]) == value]
            for name in ("count", "standard_error", "density", "density_error"):
                assert [float(row[name]) for row in mine] == getattr(part, name).tolist() == file[name][place].tolist()
            for name in ("slipping", "slipless", "tied", "undecided"):
                assert file.attrs[name][place] == getattr(part, name)
            assert part.slipless == report["groups"][place]["slipless"]
    text = (tmp_path / "h" / "power_histogram.csv").read_text()
    words = "slipping", "slipless", "tied", "undecided"
    assert f"# spin_bottom 0.1: {', '.join(f'{word} {getattr(found[0.1], word)}' for word in words)}\n" in text
    assert (tmp_path / "h" / "power_histogram.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(FileError, match="already exists"):
        histogram([scan.path], tmp_path / "h")
    histogram([scan.path], tmp_path / "h", force=True, by="shape")
    with h5py.File(tmp_path / "h" / "power_histogram.h5") as file:
        assert file["value"].asstr()[()].tolist() == ["4x4", "8x8", "16x16"]


def test_the_histogram_of_a_run_directory_has_the_three_columns_of_the_contract(tmp_path, precision):
    run(RunSettings(shape=(4, 5), tolerance=1e-3, precision=precision, threads=1), tmp_path / "r")
    histogram([tmp_path / "r"], tmp_path / "h")
    texts = [(tmp_path / name / "power_histogram.csv").read_text() for name in ("r", "h")]
    assert texts[0] == texts[1]
    assert texts[0].splitlines()[2] == "power_low,power_high,count"


def test_conditions_choose_the_samples_that_are_pooled(scan, tmp_path):
    source = read_source(scan.path)
    whole, parts = pooled([source])[None], pooled([source], by="spin_bottom")
    for value, part in parts.items():
        (found,) = pooled([source], where=(f"spin_bottom={value}",)).values()
        assert (found.slipping, found.slipless) == (part.slipping, part.slipless)
        assert found.census == part.census
    both = pooled([source], by="spin_bottom", where=("shape=8x8",))
    one = pooled([source], where=("spin_bottom=0.1", "shape=8x8"))[None]
    assert one.slipping == both[0.1].slipping < parts[0.1].slipping < whole.slipping
    for condition, sentence in (
        ("shape", "it must be KEY=VALUE, such as shape=4x4"),
        ("shape=9x9", "one of 4x4, 8x8, 16x16"), ("shap=4x4", "did you mean 'shape'"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=sentence):
            pooled([source], where=(condition,))
    report = histogram([scan.path], tmp_path / "h", where=("shape=8x8",))
    assert report["slipping"] == sum(part.slipping for part in both.values())
    assert report["pooled_over"] == ["spin_bottom"]
    assert histogram([scan.path], tmp_path / "i", by="spin_bottom")["pooled_over"] == ["shape"]
    header = [line for line in (tmp_path / "h" / "power_histogram.csv").read_text().splitlines() if line[0] == "#"]
    assert header[1].endswith("; power in energy/time")
    assert header[2:] == ["# where shape=8x8"]
    with h5py.File(tmp_path / "h" / "power_histogram.h5") as file:
        assert file.attrs["where"].tolist() == ["shape=8x8"]
