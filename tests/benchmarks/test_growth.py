"""How time and memory grow: the fits, and what is measured on one lattice."""

import resource
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import linregress
from taichi_bearings_studies.benchmarks import growth
from taichi_bearings_studies.benchmarks.harness import measure, text
from taichi_bearings_studies.benchmarks.table import BENCHMARKS, planned

from taichi_bearings.errors import InputError


def rows(sizes, exponent, noise=0.0):
    """Rows of one program whose processor time is 2e-5 N^exponent, but for a relative noise."""
    factors = np.exp(noise * np.random.default_rng(5).normal(size=len(sizes)))
    return [
        {"what": growth.OURS, "spheres": n, "seconds_processor": 2e-5 * n**exponent * factor, "memory": 1e-4 * n}
        for n, factor in zip(sizes, factors, strict=True)
    ]


def test_a_power_law_is_found_again_with_its_standard_error():
    sizes = [4096, 8000, 13824, 32768]
    found = growth.fits(rows(sizes, 1.8))
    assert found[growth.OURS, "seconds_processor"] == pytest.approx((1.8, 0, 2e-5), rel=1e-9, abs=1e-9)
    assert found[growth.OURS, "memory"].exponent == pytest.approx(1.0)
    noisy = rows(sizes, 1.8, noise=0.1)
    expected = linregress(np.log(sizes), np.log([row["seconds_processor"] for row in noisy]))
    law = growth.fits(noisy)[growth.OURS, "seconds_processor"]
    assert (law.exponent, law.error) == pytest.approx((expected.slope, expected.stderr))


def test_small_lattices_do_not_count_and_few_are_not_fitted():
    bent = [*rows([512, 1728], 0.2), *rows([4096, 8000, 13824], 2.0)]
    assert growth.fits(bent)[growth.OURS, "seconds_processor"].exponent == pytest.approx(2.0)
    assert growth.fits(rows([512, 4096, 8000], 2.0)) == {}
    assert any("N^2.00" in words for words in growth.words(bent))


def test_what_bounds_a_minimum_is_told_of_the_largest_lattice():
    counted = [
        row | {"factorising": 0.6, "operations": 2e-4 * row["spheres"] ** 2, "factor": 5e-5 * row["spheres"]}
        for row in rows([4096, 8000, 13824], 1.8)
    ]
    *_, said = growth.words(counted)
    assert "with 13824 spheres factorisations take 60% of the processor time, and the factor 0.69 of 1.4 GB" in said
    assert "operations as N^2.00, memory of the factor as N^1.00" in said


def test_a_lattice_is_measured_with_all_contacts_proven(needs_f64, taichi_runtime):
    (row,) = growth.measure(4, growth.OURS, seed=0, threads=1)
    assert row["spheres"] == 64
    assert row["proven"] == 1
    assert 0 <= row["proven_gap"] < growth.TOLERANCE
    assert row["rounds"] == growth.ROUNDS
    assert 0 < row["factorising"] < 1
    assert row["operations"] > 4 * 4 * 2 * 2  # unknowns: two spins of each free sphere
    assert 8e-9 * row["spheres"] < row["factor"] < 8e-9 * (2 * row["spheres"]) ** 2
    if sys.platform.startswith("linux"):
        assert 0 <= row["memory"] < resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    (left_out,) = growth.measure(40, growth.THEIRS, seed=0, threads=1)
    assert "left out" in left_out


def test_growth_is_planned_for_the_cubes_asked_for_and_reported_with_its_exponent():
    assert planned("quick", shape=["4,5,6", "6,6,6", "7,7"]).grown == (6,)
    assert planned(None, largest="18").grown == (8, 12, 16, 18)
    assert planned(None, largest="64").grown[-3:] == (40, 48, 64)
    with pytest.raises(InputError, match="largest is 'no'"):
        planned(None, largest="no")
    made = rows([4096, 8000, 13824], 1.8)
    one = replace(BENCHMARKS["growth"], tasks=lambda plan: [("made", lambda: made)], missing=dict)
    report = measure({"growth": one}, planned("quick"))
    said = text(BENCHMARKS, report, {"processor": "p", "threads": 1, "load": 0})
    assert "processor time grows as N^1.80" in said
