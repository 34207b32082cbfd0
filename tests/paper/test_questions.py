"""Questions beyond the paper: samples against truths of other codes, fits against laws that are known."""

import networkx
import numpy as np
import pytest
from scipy import sparse, stats
from scipy.optimize import linprog
from taichi_bearings_studies.paper import exponents, odd_loops, reproduce
from taichi_bearings_studies.paper.claims import Effort
from taichi_bearings_studies.paper.fits import collapse, exponent, skewness

from taichi_bearings import runtime

pytestmark = pytest.mark.usefixtures("needs_f64")


def lightest_path(sideways, upward):
    """Weight of the minimum cut between the bottom and the top row, by a largest flow in floating point."""
    graph = networkx.Graph()
    columns, rows = upward.shape[0], upward.shape[1] + 1

    def name(i, k):
        return "bottom" if k == 0 else "top" if k == rows - 1 else (i, k)

    for i in range(columns):
        for k in range(rows - 1):
            ends = name(i, k), name(i, k + 1)
            before = graph.get_edge_data(*ends, {"capacity": 0.0})["capacity"]
            graph.add_edge(*ends, capacity=before + upward[i, k])
    for i in range(columns - 1):
        for k in range(1, rows - 1):
            graph.add_edge((i, k), (i + 1, k), capacity=sideways[i, k])
    return networkx.minimum_cut_value(graph, "bottom", "top")


@pytest.mark.parametrize("kind", ["held", "free"])
def test_weights_of_cuts(kind):
    length, height, samples, seed = 6, 7, 3, 5
    found = exponents.draw(kind, length, height, samples, seed)
    rng = np.random.default_rng([seed, length, height])
    sideways = rng.uniform(0.1, 1.0, (samples, length - 1, height))
    upward = rng.uniform(0.1, 1.0, (samples, length, height - 1))
    if kind == "held":
        upward[:, [0, -1], :3] += 1e3
        upward[:, [0, -1], 4:] += 1e3
    truth = [lightest_path(*sample) for sample in zip(sideways, upward, strict=True)]
    assert found["weight"] == pytest.approx(truth, rel=1e-12)
    assert all(1 <= middle <= height - 1 for middle in found["middle"])


@pytest.mark.parametrize(("odd", "bottom"), [(0, 0.0), (3, 0.0), (5, 0.5)])
def test_minima_with_odd_contacts(odd, bottom):
    size, seed = 6, 7
    found = odd_loops.draw(size, odd, bottom, 1, seed)
    packing = odd_loops.network(size, odd, bottom, seed)
    assert packing.contacts == 2 * size * (size - 1) + odd
    free = np.flatnonzero(packing.driven < 0)
    rows = sparse.csr_array(np.eye(packing.spheres)[packing.contact].sum(axis=1))
    acts = (packing.driven[packing.contact] < 0).any(axis=1)
    matrix, known = rows[acts][:, free], rows[acts] @ np.where(packing.driven < 0, 0.0, packing.spin)
    friction, count = np.asarray(packing.friction)[acts], int(acts.sum())
    both = sparse.block_array([[matrix, -sparse.eye_array(count)], [-matrix, -sparse.eye_array(count)]])
    least = linprog(
        np.append(np.zeros(len(free)), friction), both, np.append(-known, known), bounds=[(None, None)] * both.shape[1]
    )
    assert found["power_over_rest"][0] == pytest.approx(least.fun / (friction @ np.abs(known)), rel=1e-9)


@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_an_exponent_is_found_with_its_error(offset):
    rng = np.random.default_rng(0)
    samples = {L: (L**0.8 + offset) ** 0.5 * rng.normal(size=4000) for L in (8, 16, 32, 64, 128, 256)}
    found = exponent(samples)
    assert abs(found.value - 0.4) < 3 * found.error < 0.1
    assert found.smallest == 8


def test_small_sizes_that_do_not_fit_are_left_out():
    rng = np.random.default_rng(1)
    samples = {L: L**0.4 * (1 + 40 / L**2) * rng.normal(size=4000) for L in (4, 8, 16, 32, 64, 128, 256, 512)}
    found = exponent(samples)
    assert found.smallest > 4
    assert abs(found.value - 0.4) < 3 * found.total


@pytest.mark.parametrize("rule", [0.0, 1 / 3, 2.0])
def test_curves_are_brought_together(rule):
    rng = np.random.default_rng(2)
    curves = {
        L: {n: 1 / (1 + n / L**rule) + 0.1 * rng.normal(size=200) for n in 2.0 ** np.arange(0, 13)} for L in (8, 32)
    }
    found = collapse(curves)
    assert abs(found.value - rule) < 3 * found.error + 0.01
    assert found.error < 0.1
    assert found.misfit < 2


def test_skewness_and_its_error():
    rng = np.random.default_rng(3)
    values = rng.exponential(size=5000)
    value, error = skewness(values)
    assert value == pytest.approx(stats.skew(values), rel=1e-12)
    assert abs(value - 2) < 4 * error
    normal = rng.normal(size=5000)
    assert skewness(normal)[1] == pytest.approx((6 / 5000) ** 0.5, rel=0.2)


def test_studies_in_a_small_form(tmp_path, monkeypatch):
    monkeypatch.setattr(exponents, "QUICK_SIZES", (4, 6, 8))
    monkeypatch.setattr(exponents, "QUICK_TALL", (8, 16))
    monkeypatch.setattr(exponents, "QUICK_LONG", 6)
    monkeypatch.setattr(odd_loops, "QUICK_SIZES", {4: 1.0, 6: 1.0})
    monkeypatch.setattr(odd_loops, "QUICK_NUMBERS", (0, 2, 8))
    monkeypatch.setattr(runtime, "available_threads", lambda: 1)
    effort = Effort(samples=2, quick=True)
    claims = [c for name in ("exponents", "odd-loops") for c in reproduce.FIGURES[name].reproduce(tmp_path, effort)]
    assert len(claims) == 8
    assert {claim.verdict for claim in claims} >= {"too few samples"}
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {f"{name}.{ending}" for name in ("exponents", "odd-loops") for ending in ("csv", "pdf", "png")}


def test_long_cuts_are_among_those_that_are_drawn():
    assert max(exponents.SIZES) >= exponents.LONG
    assert max(exponents.QUICK_SIZES) >= exponents.QUICK_LONG
