"""What a scan file says: grids, ranges, keys that advance together, and names of samples that mean their results."""

import itertools

import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.plan import sample_key, written


def points(plan):
    return [tuple(sample.point.values()) for sample in plan.samples]


def test_the_example_of_the_contract_is_the_grid_over_all_keys(plan_of):
    plan = plan_of(
        'shape = [10, 10]\nlaw = "coulomb"\n[scan]\nseed = { start = 0, stop = 1000 }\nspin_bottom = [0.0, 0.1]\n'
    )
    assert plan.scanned == ("seed", "spin_bottom")
    assert points(plan) == list(itertools.product(range(1000), (0.0, 0.1)))
    assert all(sample.settings.shape == (10, 10) for sample in plan.samples)
    assert all(sample.settings.seed == sample.point["seed"] for sample in plan.samples)
    assert len({sample.key for sample in plan.samples}) == 2000


def test_keys_of_one_zip_advance_together_within_the_grid(plan_of):
    plan = plan_of(
        "[scan]\nseed = [3, 4]\n[[scan.zip]]\nshape = [[4, 4], [6, 6]]\ntolerance = [1e-4, 1e-6]\n"
        '[[scan.zip]]\nlaw = ["coulomb", "viscous"]\n'
    )
    assert plan.scanned == ("seed", "shape", "tolerance", "law")
    expected = itertools.product((3, 4), (((4, 4), 1e-4), ((6, 6), 1e-6)), ("coulomb", "viscous"))
    assert points(plan) == [(seed, *pair, law) for seed, pair, law in expected]
    assert written(plan.samples[0].point["shape"]) == "4x4"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{ start = 2, stop = 9, step = 3 }", [2, 5, 8]),
        ("{ start = 9, stop = 2, step = -3 }", [9, 6, 3]),
        ("{ start = 0.0, stop = 0.3, step = 0.1 }", [0.0, 0.1, 0.2]),
        ("{ start = 1, stop = 3, number = 5 }", [1, 1.5, 2, 2.5, 3]),
        ('{ start = 1e-3, stop = 1e1, number = 5, spacing = "log" }', [1e-3, 1e-2, 1e-1, 1, 10]),
    ],
)
def test_ranges(plan_of, text, expected):
    plan = plan_of(f"shape = [4, 4]\n[scan]\nspin_top = {text}\n")
    assert np.allclose([point[0] for point in points(plan)], expected, rtol=1e-14)


def test_without_a_table_there_is_one_sample(plan_of):
    plan = plan_of("shape = [4, 4]\n")
    assert plan.scanned == ()
    assert points(plan) == [()]


def test_set_fixes_a_key_or_scans_it(plan_of):
    text = (
        "shape = [4, 4]\nspin_top = 2.0\n[scan]\nseed = [1, 2]\n[[scan.zip]]\nradius = [0.5, 1.0]\nmass = [1.0, 2.0]\n"
    )
    fixed = plan_of(text, "seed=7", "law=viscous", "shape=5x6", "spin-top = 3")
    assert {(s.settings.seed, s.settings.law, s.settings.shape, s.settings.spin_top) for s in fixed.samples} == {
        (7, "viscous", (5, 6), 3.0)
    }
    assert fixed.scanned == ("radius", "mass")
    scanned = plan_of(text, "scan.spin_top=[1.0, 5.0]", "radius=0.25", "scan.seed={start = 0, stop = 3}")
    assert scanned.scanned == ("spin_top", "seed", "mass")
    assert points(scanned)[0] == (1.0, 0, 1.0)
    assert len(scanned.samples) == 12


def test_the_stored_text_is_the_same_plan(plan_of):
    text = (
        "shape = [4, 4]\n[scan]\nseed = { start = 1, stop = 4 }\n[[scan.zip]]\nmass = [1.0, 2.0]\nradius = [0.5, 1.0]\n"
    )
    plan = plan_of(text, 'distribution="lognormal:0.5,1"', "scan.law=['coulomb', 'viscous']")
    assert [s.key for s in plan_of(plan.text).samples] == [s.key for s in plan.samples]


def test_the_name_of_a_sample_is_that_of_its_result():
    """The name is written down in folders of users: it must never change for the same settings."""
    settings = RunSettings(shape=(10, 10), seed=3)
    same = RunSettings(shape=(10, 10), seed=3, threads=7, checkpoint_every=5.0)
    assert sample_key(settings) == sample_key(same)
    others = [RunSettings(shape=(10, 10), seed=3, **change) for change in (
        {"spin_bottom": 0.1}, {"tolerance": 1e-9}, {"distribution": "constant:1"}, {"precision": "f32"},
        {"method": "gradient-descent"}, {"settle": False}, {"time_limit": 1.0},
    )]  # fmt: skip
    assert len({sample_key(s) for s in [settings, *others, RunSettings(shape=(10, 10), seed=4)]}) == 9


def test_files_count_by_their_content_and_lie_beside_the_scan(plan_of, tmp_path):
    for name, value in (("a", 0.5), ("b", 0.5), ("c", 0.7)):
        np.savez(tmp_path / f"{name}.npz", x=np.full((3, 4), value), y=np.full((4, 3), value))
    keys = {
        name: plan_of(f'shape = [4, 4]\ncoefficients = "{name}.npz"\n').samples[0].key for name in ("a", "c")
    }  # fmt: skip
    assert keys["a"] != keys["c"]
    scanned = plan_of('shape = [4, 4]\n[scan]\ncoefficients = ["a.npz", "c.npz"]\n')
    assert [s.key for s in scanned.samples] == [keys["a"], keys["c"]]
    with pytest.raises(InputError, match="the same"):
        plan_of('shape = [4, 4]\n[scan]\ncoefficients = ["a.npz", "b.npz"]\n')


def test_an_unknown_key_of_an_override_is_named_with_it(plan_of):
    for override in ("sed=1", "scan.sed=[1, 2]"):
        with pytest.raises(InputError, match="did you mean 'seed'") as caught:
            plan_of("shape = [3, 3]\n", override)
        assert f"unknown key 'sed' in --set {override!r}" in str(caught.value)
        assert "scan.toml" not in str(caught.value)


BAD = {
    "unknown key": ("[scan]\nsed = [1]\n", "did you mean 'seed'"),
    "unknown fixed key": ("shpe = [3, 3]\n[scan]\nseed = [1]\n", "did you mean 'shape'"),
    "single value": ("[scan]\nseed = 5\n", "must be a list"),
    "no value": ("[scan]\nseed = []\n", "at least one value"),
    "empty range": ("[scan]\nseed = { start = 5, stop = 5 }\n", "which has no values"),
    "step of 0": ("[scan]\nseed = { start = 0, stop = 5, step = 0 }\n", "which has no values"),
    "unknown word in a range": ("[scan]\nseed = { start = 0, end = 5 }\n", "a range is"),
    "step and number": ("[scan]\nseed = { start = 0, stop = 5, step = 1, number = 3 }\n", "a range is"),
    "range of texts": ('[scan]\nseed = { start = "a", stop = "b" }\n', "a range is"),
    "logarithm of 0": ('[scan]\nmass = { start = 0, stop = 1, number = 3, spacing = "log" }\n', "a range is"),
    "value that is not allowed": ("[scan]\nseed = [1, -1]\n", "seed is '-1'"),
    "flat shape": ("[scan]\nshape = [10, 10]\n", "shape is '10'"),
    "twice": ("seed = 1\n[scan]\nseed = [1]\n", "seed is given more than once"),
    "twice in zips": ("[scan]\nseed = [1]\n[[scan.zip]]\nseed = [1]\n", "more than once"),
    "unequal zip": ("[[scan.zip]]\nseed = [1, 2]\nmass = [1.0]\n", "seed has 2, mass has 1"),
    "zip of lists": ("[scan]\nzip = [1]\n", "[[scan.zip]]"),
    "zip in a zip": ("[[scan.zip]]\nseed = [1]\nzip = [2]\n", "'zip'"),
    "scan of lists": ("scan = [1]\n", "must be a table"),
    "equal samples": ("[scan]\nseed = [1, 2, 1]\n", "the same"),
    "replicas": ("replicas = 4\n", "give seed a range"),
    "scanned threads": ("[scan]\nthreads = [1, 2]\n", "changes no result"),
    "checkpoints": ("checkpoint_every = 4.0\n", "leave it out"),
    "too many": ("[scan]\nseed = { start = 0, stop = 3000 }\nmass = { start = 1, stop = 3000 }\n", "samples, the most"),
    "far too many": ("[scan]\nseed = { start = 0, stop = 1e300 }\n", "the most that are allowed"),
    "missing file": ('[scan]\ncoefficients = ["nowhere.npz"]\n', "nowhere.npz"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_scan_is_refused_in_one_sentence(plan_of, name):
    text, expected = BAD[name]
    with pytest.raises(InputError) as caught:
        plan_of(text)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["seed", "=3", "scan.seed=5", "scan.seed=", "sed=4"])
def test_a_bad_override_is_refused(plan_of, text):
    with pytest.raises(InputError):
        plan_of("shape = [4, 4]\n", text)
