"""Limits of large samples: the law against limits that are known, the scans that anybody can start, the study."""

import numpy as np
import pytest
from taichi_bearings_studies.paper import limits, reproduce, samples
from taichi_bearings_studies.paper.claims import Effort, judged
from taichi_bearings_studies.paper.fits import limit
from taichi_bearings_studies.paper.samples import Table, planned

from tests.tables import rows_of

pytestmark = pytest.mark.usefixtures("needs_f64")

SIZES = (4, 6, 8, 12, 16, 24, 32)


def drawn(law, samples=100, noise=0.05, seed=0):
    rng = np.random.default_rng(seed)
    return {L: law(L) + noise * rng.normal(size=samples) for L in SIZES}


def test_a_limit_is_found_with_its_error():
    found = [limit(drawn(lambda L: 0.6 + 0.8 / L, seed=seed)) for seed in range(40)]
    away = np.array([(each.value - 0.6) / each.error for each in found])
    assert 0.6 < np.mean(away**2) < 1.6  # 40 squares of normal numbers: 1 +- 0.22
    assert np.median([each.goodness for each in found]) == pytest.approx(0.5, abs=0.25)
    assert sum(each.smallest == 4 for each in found) >= 34  # of one in twenty it is so by chance that not all sizes fit
    assert sum(each.follows for each in found) >= 37
    assert found[0].amplitude == pytest.approx(0.8, abs=0.2)


def test_small_samples_that_do_not_fit_are_left_out():
    found = limit(drawn(lambda L: 0.6 + 0.8 / L - 9 / L**2, noise=0.02))
    assert found.smallest >= 12
    assert found.sizes == sum(found.smallest <= L for L in SIZES)
    assert abs(found.value - 0.6) < 3 * found.total
    assert found.systematic >= abs(found.fits[found.smallest] - found.fits[12 if found.smallest == 16 else 8])
    assert abs(found.fits[4] - 0.6) > 0.05


@pytest.mark.parametrize("w", [0.5, 2.0])
def test_another_law_is_within_the_systematic_error(w):
    found = limit(drawn(lambda L: 0.6 + 0.5 / L**w))
    assert found.follows
    assert abs(found.value - 0.6) < 2 * found.total
    assert found.systematic > found.error


def test_what_follows_no_law_has_no_limit():
    found = limit(drawn(lambda L: float(np.cos(3 * np.log(L))), noise=0.01))
    assert not found.follows


def test_too_little_to_fit():
    samples = drawn(lambda L: 0.6)
    assert limit({L: samples[L] for L in SIZES[:2]}) is None
    assert limit({L: samples[L][:2] if L > 6 else samples[L] for L in SIZES}) is None
    assert limit({L: np.ones(9) if L == 8 else samples[L] for L in SIZES}) is None


SYSTEMS = (
    "as in the paper", "periodic sides", "state (1, 0.5)", "uniform:0.5,1", "uniform:0.9,1", "lognormal:0.4,1",
    "power-law:0.001,1,-1", "bimodal:0.1,1,0.5", "C (L - 1) = 1",
)  # fmt: skip


def test_the_scans_have_what_is_asked():
    found = {}
    for settings in planned(limits.QUICK, Effort()):
        system = found.setdefault(limits.system_of(settings), {})
        system.setdefault(settings.shape[0], []).append(settings.seed)
    assert tuple(found) == SYSTEMS
    assert set(found["as in the paper"]) == {4, 6, 8, 12, 16, 24, 32, 48}
    assert all(seeds == list(range(len(seeds))) for system in found.values() for seeds in system.values())
    quick = list(planned(limits.QUICK, Effort(seed=7, samples=20, quick=True)))
    assert {settings.shape[0] for settings in quick} == {4, 6, 8, 12, 16, 24, 32}
    assert {settings.seed for settings in quick if settings.shape[0] == 24} == {7, 8, 9, 10}
    assert {limits.system_of(settings) for settings in quick} == set(SYSTEMS)


SHARES = (
    "slipless_fraction", "intermediate", "domains_a_sphere", "largest_share", "busiest_link_share", "reached_fraction"
)  # fmt: skip


@pytest.fixture
def small(taichi_runtime, monkeypatch):
    """The smallest samples of each scan."""
    monkeypatch.setattr(limits, "QUICK", {"limits": 8, "limits-variants": 4, "limits-rate": 4})
    monkeypatch.setattr(samples, "LEAST_SEEDS", 3)
    return Effort(seed=2, samples=1, quick=True)


def test_the_study_in_a_small_form(small, tmp_path):
    claims = reproduce.FIGURES["limits"].reproduce(tmp_path, small)
    assert {path.name for path in tmp_path.iterdir()} == {
        f"limits{end}" for end in (".csv", "-limits.csv", ".png", ".pdf")
    }
    rows = rows_of(tmp_path / "limits.csv")
    assert {row["system"] for row in rows} == set(SYSTEMS)
    assert len(rows) == 3 * (3 + 8)
    for row in rows:
        assert float(row["gap"]) < 1e-9
        assert 0 < float(row["power_over_cut"]) <= 1 + 1e-9
        assert all(0 <= float(row[name]) <= 1 for name in SHARES)
        assert float(row["path_over_height"]) >= 1 if row["spans"] == "True" else float(row["shortest_path"]) == 0
    assert {(row["system"], row["quantity"]) for row in rows_of(tmp_path / "limits-limits.csv")} >= {
        ("as in the paper", name) for name in ("power_over_cut", "slipless_fraction")
    }
    assert "too few samples" in {claim.verdict for claim in claims}
    assert all(claim.finding and claim.ours and claim.uncertainty for claim in claims)


ROW = {
    "seed": 0, "spans": True, "below_cut": True, "intermediate": 0.9, "largest_intermediate": 3, "disjoint_paths": 2,
    "effective_links": 50.0, "parting_links": 0, "busiest_link_share": 0.8,
}  # fmt: skip


def tables(power=lambda L: 0.96 + 0.1 / L, slipless=lambda L: 0.6, growth=1.0, variants=None, **changed):
    """Samples of the paper's bearing and of others, with laws of the size and some noise."""
    rng, rows = np.random.default_rng(4), []
    for L in (8, 12, 16, 24):
        for _ in range(20):
            noise = rng.normal(size=3)
            shares = {"power_over_cut": power(L) + 0.004 * noise[0], "slipless_fraction": slipless(L) + 0.01 * noise[1]}
            path = (L - 1) * (1 + growth * L / 8 + 0.1 * noise[2])
            rows.append(ROW | shares | {"side": L, "domains": L**3 // 2, "shortest_path": path} | changed)
    paper = limits.with_ratios(Table.of(rows))
    others = {name: Table({**paper.columns, **of}) for name, of in (variants or {"periodic sides": {}}).items()}
    found = {"as in the paper": paper, **others}
    return limits.names_of(found, {name: limits.limits_of(of) for name, of in found.items()})


ABOVE = {"power_over_cut": 0.99 + np.tile([-0.003, 0.003], 40)}
VAGUE = {"power_over_cut": 0.9 + np.tile([-0.2, 0.1], 40)}
APART = {"spans": np.zeros(80, dtype=bool)}
CUT = {"below_cut": np.zeros(80, dtype=bool)}


@pytest.mark.parametrize(
    ("name", "changed", "verdict"),
    [
        ("below_cut", {}, "confirmed"),
        ("below_cut", {"power": lambda L: 1 - 0.2 / L}, "refuted"),
        ("slipless", {}, "confirmed"),
        ("slipless", {"slipless": lambda L: 5 / L}, "refuted"),
        ("spans", {}, "confirmed"),
        ("spans", {"spans": False}, "refuted"),
        ("domains", {}, "confirmed"),
        ("domains", {"largest_intermediate": 600}, "refuted"),
        ("domains", {"intermediate": 0.3}, "refuted"),
        ("paths", {}, "confirmed"),
        ("paths", {"growth": 0.0}, "refuted"),
        ("few_links", {}, "confirmed"),
        ("few_links", {"busiest_link_share": 0.3}, "refuted"),
        ("sides", {}, "confirmed"),
        ("sides", {"variants": {"periodic sides": ABOVE}}, "refuted"),
        ("sides", {"variants": {"periodic sides": VAGUE}}, "too few samples"),
        ("sides_span", {"variants": {"periodic sides": APART}}, "confirmed"),
        ("sides_span", {}, "refuted"),
        ("broad", {"variants": {"bimodal:0.1,1,0.5": {"busiest_link_share": np.full(80, 0.1)}}}, "confirmed"),
        ("broad", {"variants": {"bimodal:0.1,1,0.5": {}}}, "refuted"),
        ("variants", {}, "confirmed"),
        ("variants", {"variants": {"a": APART}}, "refined"),
        ("variants", {"variants": {"a": {}, "uniform:0.9,1": CUT}}, "confirmed"),
        ("variants", {"variants": {"a": CUT, "uniform:0.9,1": {}}}, "refuted"),
    ],
)  # fmt: skip
def test_verdicts_follow_the_samples(name, changed, verdict):
    assert [claim.verdict for claim in judged(f"limits.{name}", **tables(**changed))] == [verdict]
