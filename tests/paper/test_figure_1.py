"""Figure 1: what each verdict is made of, and that it can be refuted."""

from dataclasses import replace

import numpy as np
import pytest
from taichi_bearings_studies.paper import figure_1, reproduce
from taichi_bearings_studies.paper.claims import Effort, judge, sentences
from taichi_bearings_studies.paper.samples import solved

from taichi_bearings.numerics.minimum_cut import flow_cut, next_cut
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.interface import cut_of, cut_weights
from taichi_bearings.solvers import GradientDescent, LinearSolver, PlanarCut
from taichi_bearings.solvers.stopping import StopRule
from tests.tables import rows_of

SHAPE = (5, 6)


@pytest.fixture(scope="module")
def cuts():
    scene = Scene.random(SHAPE, 3, replicas=12)
    return solved(scene, PlanarCut()), cut_of(scene), flow_cut(scene.lattice.by_axis(cut_weights(scene)))


@pytest.fixture(scope="module")
def exact(cuts):
    return figure_1.cuts_of(*cuts)


@pytest.fixture(scope="module")
def settled(taichi_runtime, precision):
    if precision != "f64":
        pytest.skip("a statement about double precision")
    return figure_1.compared_with_cut(Scene.random(SHAPE, 3, replicas=12))


def spoilt(table, name, change):
    """The same samples, but one number of the first one."""
    values = getattr(table, name).copy()
    values[0] = change(values[0])
    return table | {name: values}


def test_a_viscous_state_is_continuous_and_a_coulomb_state_is_not():
    flat = solved(Scene.random(SHAPE, 1, replicas=5, law="viscous"), LinearSolver())
    domains = solved(Scene.random(SHAPE, 1, replicas=5), PlanarCut())
    numbers = [figure_1.viscous_numbers(of) for of in (flat, domains)]
    assert judge("fig1.continuous", sizes={"a": numbers[0]}).verdict == "confirmed"
    assert judge("fig1.continuous", sizes=dict(zip("ab", numbers, strict=True))).verdict == "refuted"
    assert (numbers[1]["least_slip"], numbers[1]["largest_slip"]) == (0.0, 1.0)


@pytest.mark.parametrize("shape", [SHAPE, (3, 4, 5)])
def test_the_rise_is_that_of_the_layer_means_whatever_the_driving(shape):
    scene = Scene.random(shape, 1, replicas=2, spin_bottom=0.25)
    rise = figure_1.least_rise(scene, initial_spin(scene, "linear"))
    assert rise == pytest.approx(1 / (shape[-1] - 1), rel=1e-13)


def test_powers_that_differ_refute(cuts, exact, settled):
    minimum, cut, by_flow = cuts
    assert judge("fig1.least_power", exact=exact, settled=settled).confirmed
    heavier = figure_1.cuts_of(minimum, cut, replace(by_flow, weight=by_flow.weight * (1 + 1e-8)))
    above = by_flow.above.copy()
    above[0, 2, 2] ^= True
    elsewhere = figure_1.cuts_of(minimum, cut, replace(by_flow, above=above))
    for other in (heavier, elsewhere):
        assert not judge("fig1.least_power", exact=other, settled=settled).confirmed
    lower = spoilt(settled, "spread", lambda spread: spread + 1e-8)
    assert not judge("fig1.least_power", exact=exact, settled=lower).confirmed


def test_contacts_that_differ_refute(exact, settled):
    other = spoilt(settled, "differing", lambda _: 2)
    tied = spoilt(other, "unique", lambda _: False)
    assert judge("fig1.interface", exact=exact, settled=settled).confirmed
    assert not judge("fig1.interface", exact=exact, settled=other).confirmed
    for found, verdict in ((settled, True), (other, False)):
        assert judge("fig1.any_bottom", driven={"0.5": settled, "-0.5": found}).confirmed == verdict
        assert judge("fig1.any_distribution", others={"a": settled, "b": found}).confirmed == verdict
    assert judge("fig1.any_distribution", others={"a": tied}).confirmed  # ties may slip elsewhere


def counted(exact, differs, excess):
    table = exact | {"differs": differs, "excess": np.full(len(exact), excess)}
    named = {"iterations": 1, "visible_slip": figure_1.VISIBLE, "paper_others": figure_1.PAPER_OTHERS}
    return judge("fig1.counted", exact=table, **named).verdict


def test_a_descent_that_errs_where_cuts_nearly_tie_is_explained(exact, monkeypatch):
    rank = exact.distance.argsort().argsort()
    enough = figure_1.VISIBLE * exact.distance.min() * 1.01
    assert counted(exact, rank == 0, enough) == "too few samples"
    assert counted(exact, rank >= 0, 1.0) == "refuted"
    monkeypatch.setitem(sentences("fig1")["counted"]["limits"], "most", 0.7)
    assert counted(exact, rank == 0, enough) == "refined"
    assert counted(exact, rank == 0, enough / 2) == "refuted"
    assert counted(exact, rank < 5, 1.0) == "refined"
    assert counted(exact, rank >= 7, 1.0) == "refuted"


def test_two_boundaries_are_the_lightest_two_cuts(cuts, exact):
    minimum, cut, _ = cuts
    scene = minimum.scene
    second = next_cut(scene.lattice.by_axis(cut_weights(scene)), cut)[0]
    first, other = (figure_1.contacts_between(scene, above) for above in (cut.above, second))
    table = exact | {"differs": np.arange(12) < 5, "excess": np.ones(12)}

    def verdict(slips, table=table):
        ended = replace(minimum, slip=slips * scene.jump)
        claim = judge("fig1.two_boundaries", boundaries=figure_1.two_boundaries(table, cut, ended))
        return claim.verdict, claim.samples, claim.samples_needed

    assert verdict(first | other)[0] == "confirmed"
    assert verdict(np.ones_like(first))[0] == verdict(first)[0] == "refuted"
    none = table | {"differs": np.zeros(12, dtype=bool)}
    assert verdict(first | other, none) == ("too few samples", 0, 5)


@pytest.mark.parametrize("steps", [200, 2000])
def test_an_excess_of_power_bounds_the_slip_off_the_cut(steps, cuts, exact, monkeypatch, needs_f64):
    """(1 + s e) P_min <= P, at any stage of a descent: no contact off the cut slips by more than s = excess / e."""
    ended = solved(cuts[0].scene, GradientDescent(), StopRule(1e-12, steps), "random")
    for visible in (0.5, 0.1, 0.02):
        monkeypatch.setattr(figure_1, "VISIBLE", visible)
        found = figure_1.compared_with_descent(exact, cuts[1], ended)
        share = found.excess / found.distance
        assert (share[found.differs] >= visible).all()
    assert (share < 0.02).any() or steps == 200


def test_files_and_claims_of_a_small_effort(tmp_path, monkeypatch, needs_f64):
    monkeypatch.setattr(figure_1, "DESCENT", 4000)
    monkeypatch.setattr(figure_1, "STARTS", ("linear",))  # the nearest
    claims = reproduce.FIGURES["fig1"].reproduce(tmp_path, Effort(seed=0, samples=2))
    assert len(claims) == 8
    verdicts = {claim.claim.split(":")[0]: claim.verdict for claim in claims}
    assert "refuted" not in verdicts.values()
    assert all((claim.verdict == "confirmed") == (claim.kind == "theorem") for claim in claims)
    assert verdicts["Viscous"] == "too few samples"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig1-samples.csv", "fig1.csv", "fig1.pdf", "fig1.png"]
    discs = rows_of(tmp_path / "fig1.csv")
    assert {abs(float(row["spin_over_top"])) for row in discs if row["law"] == "coulomb"} == {0, 1}
    assert len(discs) == 200
    samples = rows_of(tmp_path / "fig1-samples.csv")
    assert [row["seed"] for row in samples] == [str(seed) for seed in range(10)]
    for row in samples:
        assert float(row["lower_bound"]) <= float(row["power"])
        assert float(row["excess"]) >= 0
        assert float(row["cut_power_by_flow"]) == pytest.approx(float(row["power"]), rel=1e-13)
