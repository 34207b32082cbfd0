"""Questions beyond the paper: samples against truths of other codes, fits against laws that are known."""

import itertools
from collections import Counter

import networkx
import numpy as np
import pytest
from scipy import sparse, stats
from scipy.optimize import linprog
from taichi_bearings_studies.paper import exponents, fits, odd_loops, reproduce, samples, surfaces, sweeps
from taichi_bearings_studies.paper.claims import Effort
from taichi_bearings_studies.paper.fits import collapse, exponent, growing_skewness, skewness, skewness_of_least

import taichi_bearings as tb
from taichi_bearings.errors import InputError
from taichi_bearings.numerics.planar import minimum_cuts
from taichi_bearings.runs.lattice_run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.plan import read_plan

pytestmark = pytest.mark.usefixtures("needs_f64")


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch):
    """Errors of fits from fewer resamples: known to 7 %, those of collapses to 16 %."""
    monkeypatch.setattr(fits, "RESAMPLES", 100)
    monkeypatch.setattr(fits, "COLLAPSES", 20)


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


def test_free_interfaces_are_those_of_the_example_scan():
    plan = read_plan(samples.SCANS / "exponents.toml", ["scan.seed=[5]", "scan.shape=[[6,7]]"])
    (scene,) = (build_scene(sample.settings) for sample in plan.samples)
    power = tb.solve(scene).power / (scene.normal_force * scene.lattice.radius)
    assert sweeps.crossings(*scene.lattice.by_axis(scene.coefficient), 3).min() == pytest.approx(power, rel=1e-12)


@pytest.mark.parametrize("lattice", ["square", "triangular"])
@pytest.mark.parametrize(("odd", "bottom"), [(0, 0.0), (3, 0.0), (5, 0.5), (4, 1.0)])
def test_minima_with_odd_contacts(lattice, odd, bottom):
    size, seed = 8, 7
    found = odd_loops.draw(lattice, size, odd, bottom, 1, seed)
    packing = odd_loops.network(lattice, size, odd, bottom, seed)
    if lattice == "square":
        assert packing.contacts == 2 * size * (size - 1) + odd
    else:
        assert np.bincount(packing.contact.ravel())[packing.spheres - odd :].tolist() == [6] * odd
    length = np.linalg.norm(np.diff(packing.center[packing.contact], axis=1)[:, 0], axis=1)
    assert length == pytest.approx(
        [1.0] * (packing.contacts - odd * (lattice == "square")) + [2**0.5] * odd * (lattice == "square")
    )
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


def test_no_more_odd_contacts_than_half_of_the_places():
    assert odd_loops.possible("square", 4, (0, 2, 4, 8)) == [0, 2, 4]  # of nine squares
    with pytest.raises(InputError, match=r"odd, .*, is 5; .* at most 4, since of the 9 places"):
        odd_loops.network("square", 4, 5, 0.0, 0)


def test_the_law_of_confined_interfaces_is_found():
    rng = np.random.default_rng(6)
    shares = {
        L: {
            n: 0.3 * n**-0.5 * (1 + (n / L ** (2 / 3)) ** -3) ** (1 / 6) * rng.gamma(2, 0.5, 400)
            for n in odd_loops.NUMBERS[1:]
        }
        for L in (64, 128, 256, 512)
    }
    told = odd_loops.held_by_odd_contacts(shares)
    assert all(2 / L < of.mean() < 0.25 for L, by in told.items() for of in by.values())
    assert 256 not in told[64]
    found = odd_loops.confined(shares)
    assert abs(found.value - 2 / 3) < 3 * found.error < 0.3
    assert found.misfit < 1.5
    many = odd_loops.fit_of_many(shares)
    assert abs(many["value"] - 0.5) < 3 * many["error"] < 0.1
    assert many["goodness"] > 0.01
    assert odd_loops.fit_of_many({64: {8: shares[64][8]}}) is None
    grown = {L: {n: of * (L / 64) ** 0.5 for n, of in by.items()} for L, by in shares.items()}
    assert odd_loops.fit_of_many(grown)["goodness"] < 1e-6


@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_an_exponent_is_found_with_its_error(offset):
    rng = np.random.default_rng(0)
    samples = {L: (L**0.8 + offset) ** 0.5 * rng.normal(size=4000) for L in (8, 16, 32, 64, 128, 256)}
    found = exponent(samples)
    assert abs(found.value - 0.4) < 3 * found.error < 0.1
    assert found.smallest == 8


def test_a_further_term_is_told_apart():
    rng = np.random.default_rng(8)
    sizes = (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
    samples = {L: (L**0.8 - 4 * L**-0.4 + 2) ** 0.5 * rng.normal(size=40_000) for L in sizes}
    plain, found = exponent(samples), exponent(samples, further=(0.0, -0.4))
    assert plain.smallest > found.smallest == 8
    assert abs(found.value - 0.4) < 3 * found.error < 0.05
    assert found.amplitude == pytest.approx(1, abs=0.3)


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


def test_skewness_of_what_grows():
    rng = np.random.default_rng(5)
    skewed = {L: (2 - rng.gamma(2.0, size=40_000)) / 2**0.5 for L in (8, 16, 32, 64, 128, 256)}  # of -2 / 2^(1/2)
    weight = {L: 0.5 * L ** (1 / 3) * of + rng.gamma(1.0, size=of.shape) for L, of in skewed.items()}
    found = growing_skewness(weight, 1 / 3)
    assert abs(found.value + 2**0.5) < 3 * found.error < 0.2
    assert found.amplitude == pytest.approx(0.25, rel=0.05)
    assert skewness(weight[8])[0] > found.value + 0.3


def test_skewness_of_the_least_of_several():
    rng = np.random.default_rng(7)
    value, error = skewness_of_least(rng.uniform(size=20_000), 4)  # of the beta distribution (1, 4)
    assert abs(value - stats.beta(1, 4).stats("s")) < 3 * error < 0.1
    few = rng.uniform(size=12)
    all_pairs = [min(pair) for pair in itertools.product(few, repeat=2)]
    assert skewness_of_least(few, 2)[0] == pytest.approx(stats.skew(all_pairs))
    one = rng.gamma(2.0, size=1000)
    assert skewness_of_least(one, 1)[0] == pytest.approx(stats.skew(one))


def test_curves_may_bend_between_their_points():
    of = {L: {n: np.array([-0.001, 0.001]) + 1 / (1 + n / L) ** 2 for n in (1, 2, 4, 8, 16, 32, 64)} for L in (4, 6, 9)}
    found = collapse(of)
    assert abs(found.value - 1) < 0.05
    assert found.misfit < 1.5


def test_studies_in_a_small_form(tmp_path, monkeypatch):
    monkeypatch.setattr(exponents, "QUICK_SIZES", dict.fromkeys((4, 6, 8), 100))
    monkeypatch.setattr(exponents, "QUICK_TALL", (8, 16))
    monkeypatch.setattr(exponents, "QUICK_LONG", 6)
    few = {"square": {8: 3.0, 10: 3.0}, "triangular": {8: 3.0, 10: 3.0}, "cubic": {3: 2.5, 4: 2.5}}
    monkeypatch.setattr(odd_loops, "QUICK_SIZES", few)
    monkeypatch.setattr(odd_loops, "QUICK_NUMBERS", (0, 2, 8))
    monkeypatch.setattr(odd_loops, "ENOUGH", 5)
    monkeypatch.setattr(surfaces, "QUICK_SIZES", {lowest: {4: 1.0, 6: 1.0} for lowest in (0.0, 0.1, 0.3)})
    scans = {"surfaces": "[[3, 3, 3], [4, 4, 4]]", "surfaces-large": "[[3, 3, 4]]", "surfaces-largest": "[[5, 5, 5]]"}
    for name, shapes in scans.items():
        (tmp_path / f"{name}.toml").write_text(f"[scan]\nshape = {shapes}\nseed = {{ start = 0, stop = 400 }}\n")
    monkeypatch.setattr(samples, "SCANS", tmp_path)
    for name, few in (("RESAMPLES", 20), ("TRIALS", 16), ("COLLAPSES", 3)):
        monkeypatch.setattr(fits, name, few)
    effort = Effort(samples=2, quick=True)
    asked = ("exponents", "surfaces", "odd-loops")
    (out := tmp_path / "out").mkdir()
    claims = [c for name in asked for c in reproduce.FIGURES[name].reproduce(out, effort)]
    assert len(claims) == 8 + 7 + 5
    assert {claim.verdict for claim in claims} >= {"too few samples"}
    written = {f"{name}.{ending}" for name in asked for ending in ("csv", "pdf", "png")}
    assert {path.name for path in out.iterdir()} == written | {"surfaces-minima.csv"}


def test_distances_are_those_of_other_codes():
    rng = np.random.default_rng(4)
    sideways, upward = (rng.uniform(0.1, 1, shape) ** 6 for shape in ((200, 8, 7), (200, 9, 6)))  # paths turn back
    paths = sweeps.crossings(sideways, upward, 4)
    ((_, cuts),) = minimum_cuts(sideways, upward)
    assert paths.min(axis=1) == pytest.approx(cuts.weight, rel=1e-12)
    crossed = np.diff(cuts.above[:, 4], axis=1) != 0
    assert (crossed.sum(axis=1) > 1).any()
    assert crossed[np.arange(200), paths.argmin(axis=1)].all()


def test_minima_of_surfaces_are_samples_of_scans():
    full = Counter(settings.shape for settings in samples.planned(surfaces.SCANS, Effort()))
    cubes = {(L, L, L): 600 for L in (4, 6, 8, 10, 12)}
    assert full == cubes | {(16, 16, 16): 400, (8, 8, 16): 400, (8, 8, 32): 400, (24, 24, 24): 200}
    quick = Counter(settings.shape for settings in samples.planned(surfaces.SCANS, Effort(samples=20, quick=True)))
    assert quick == {(L, L, L): 60 for L in (4, 6, 8)} | {(8, 8, 16): 40, (8, 8, 32): 40}


def test_held_surfaces_are_lightest_cuts_through_one_contact(monkeypatch):
    monkeypatch.setattr(surfaces, "HEIGHT", 4 / 2**surfaces.ROUGHNESS)  # two free planes
    found = surfaces.cuts(2, 0.1, 3, 6)
    rng = np.random.default_rng([6, 2, 100])
    x, y, z = (rng.uniform(0.1, 1.0, (3, 2, 2, height)) for height in (4, 4, 3))
    sides = np.zeros((2**8, 2, 2, 4), dtype=bool)
    sides[..., 1:3] = np.array(list(itertools.product((False, True), repeat=8))).reshape(-1, 2, 2, 2)
    sides[..., 3] = True
    sides = sides[~sides[:, 0, 0, 1] & sides[:, 0, 0, 2]]
    for sample in range(3):
        weight = (z[sample] * np.diff(sides, axis=3)).sum(axis=(1, 2, 3))
        for axis, contacts in ((1, x), (2, y)):
            weight += 0.5**0.5 * ((sides != np.roll(sides, -1, axis)) * contacts[sample]).sum(axis=(1, 2, 3))
        best = weight.argmin()
        assert found["weight"][sample] == pytest.approx(weight[best], rel=1e-12)
        assert found["roughness"][sample] == pytest.approx((~sides[best]).sum(axis=2).var(), rel=1e-12)


def test_minima_are_between_the_bounds_of_sheets_and_cuts():
    for seed in (2, 3):
        found = surfaces.numbers_of(samples.certified(RunSettings(shape=(3, 3, 4), seed=seed)))
        rng = np.random.default_rng(seed)
        x, y, z = (rng.uniform(0.1, 1.0, shape) for shape in ((2, 3, 4), (3, 2, 4), (3, 3, 3)))
        of_x = sum(lightest_path(y[layer], z[layer]) for layer in range(3)) / 2**0.5
        of_y = sum(lightest_path(x[:, layer], z[:, layer]) for layer in range(3)) / 2**0.5
        assert np.hypot(of_x, of_y) * (1 - 1e-9) <= found["power"] <= (of_x + of_y) * (1 + 1e-9)
        assert found["power"] <= found["cut"] * (1 + 1e-9)
        assert found["gap"] < 1e-9
        assert 1 <= found["layers"] <= 3


def test_a_power_law_without_a_constant():
    rng = np.random.default_rng(5)
    sides = {
        L: np.stack([L**-0.3 * (x := rng.normal(size=2000)), x + 0.3 * rng.normal(size=2000)], axis=1)
        for L in (4, 6, 8, 12, 16)
    }
    found = exponent(sides, lambda pairs: pairs[:, 0].var() / pairs[:, 1].var(), further=())
    assert abs(found.value + 0.3) < 3 * found.error < 0.1
    assert found.offset == 0
