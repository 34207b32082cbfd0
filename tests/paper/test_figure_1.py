"""Figure 1: what each verdict is made of, and that it can be refuted."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import colormaps
from taichi_bearings_studies.paper import figure_1
from taichi_bearings_studies.paper.claims import Effort, sentences
from taichi_bearings_studies.paper.figure_1 import Descent, Minimum, Settled
from taichi_bearings_studies.paper.samples import TIMES, Run, solved
from taichi_bearings_studies.plots.configurations import draw_configurations

from taichi_bearings.plots.lattice import SPIN_COLOURS
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import LinearSolver, PlanarCut

SHAPE = (5, 6)


@pytest.fixture(scope="module")
def minimum():
    return Minimum.of(Scene.random(SHAPE, 3, replicas=12))


@pytest.fixture(scope="module")
def settled(taichi_runtime, precision):
    if precision != "f64":
        pytest.skip("a statement about double precision")
    return Settled.of(Scene.random(SHAPE, 3, replicas=12))


def moved(cut, replica=0):
    """The same cuts, but one sample parted at another level."""
    above = cut.above.copy()
    above[replica] = False
    above[replica, :, 2 if above[replica, 0, 2] != cut.above[replica, 0, 2] else 3 :] = True
    return replace(cut, above=above)


def test_a_viscous_state_is_continuous_and_a_coulomb_state_is_not():
    flat = solved(Scene.random(SHAPE, 1, replicas=3, law="viscous"), LinearSolver())
    cube = solved(Scene.random((3, 4, 5), 1, replicas=2, law="viscous"), LinearSolver())
    assert figure_1._continuous(flat, cube).confirmed
    domains = solved(Scene.random(SHAPE, 1, replicas=3), PlanarCut())
    assert not figure_1._continuous(domains, cube).confirmed
    assert figure_1.slip_range(domains) == (0.0, 1.0)


def test_the_rise_is_that_of_the_layer_means_whatever_the_driving():
    for shape in (SHAPE, (3, 4, 5)):
        scene = Scene.random(shape, 1, replicas=2, spin_bottom=0.25)
        state = solved(scene, PlanarCut()) if len(shape) == 2 else None
        spin = initial_spin(scene, "linear")
        if state is None:
            flat = solved(Scene.random(SHAPE, 1, replicas=2), PlanarCut())
            state = replace(flat, scene=scene)
        assert figure_1.least_rise(replace(state, spin=spin)) == pytest.approx(1 / (shape[-1] - 1), rel=1e-13)


def test_powers_that_differ_refute(minimum, settled):
    assert figure_1._least_power(minimum, settled).confirmed
    heavier = replace(minimum.by_flow, weight=minimum.by_flow.weight * (1 + 1e-8))
    assert not figure_1._least_power(replace(minimum, by_flow=heavier), settled).confirmed
    lower = replace(settled.solution, lower_bound=settled.solution.lower_bound * (1 - 1e-8))
    assert not figure_1._least_power(minimum, replace(settled, solution=lower)).confirmed
    elsewhere = replace(minimum, by_flow=moved(minimum.by_flow))
    assert not figure_1._least_power(elsewhere, settled).confirmed


def test_contacts_that_differ_refute(minimum, settled):
    assert figure_1._interface(minimum, settled).confirmed
    assert figure_1._any_bottom([settled, settled]).confirmed
    assert figure_1._any_distribution([settled] * 3).confirmed
    other = replace(settled, cut=moved(settled.cut))
    assert other.differing[0] > 0
    assert not other.differing[1:].any()
    assert not figure_1._interface(minimum, other).confirmed
    assert not figure_1._any_bottom([settled, other]).confirmed
    assert not figure_1._any_distribution([settled, other, settled]).confirmed


def test_ties_may_slip_elsewhere(settled):
    tied = replace(settled.cut, between=settled.cut.above & (np.arange(12) == 0)[:, None, None])
    assert figure_1._any_distribution([replace(settled, cut=tied)] * 3).confirmed


def descent_with(minimum, failed, excess):
    return Descent(minimum.contacts, np.full(len(failed), excess), failed)


def test_a_descent_that_errs_where_cuts_nearly_tie_is_explained(minimum, monkeypatch):
    rank = minimum.distance.argsort().argsort()
    enough = figure_1.VISIBLE * minimum.distance.min() * 1.01
    assert figure_1._counted(minimum, descent_with(minimum, rank == 0, enough)).verdict == "too few samples"
    assert figure_1._counted(minimum, descent_with(minimum, rank >= 0, 1.0)).verdict == "refuted"
    monkeypatch.setitem(sentences("fig1")["counted"]["limits"], "most", 0.7)
    assert figure_1._counted(minimum, descent_with(minimum, rank == 0, enough)).verdict == "refined"
    assert figure_1._counted(minimum, descent_with(minimum, rank == 0, enough / 2)).verdict == "refuted"
    assert figure_1._counted(minimum, descent_with(minimum, rank < 5, 1.0)).verdict == "refined"
    assert figure_1._counted(minimum, descent_with(minimum, rank >= 7, 1.0)).verdict == "refuted"


def test_a_start_that_leads_elsewhere_refutes(minimum, monkeypatch):
    scene, ends = minimum.solution.scene, minimum.cut.above.astype(float)[None]
    monkeypatch.setattr(figure_1, "relax", lambda scene, start: Run(start, TIMES, TIMES, ends, ends))
    assert figure_1._any_start(scene).confirmed
    elsewhere = ends.copy()
    elsewhere[0, 3, 2, 2] += 1e-5
    monkeypatch.setattr(figure_1, "relax", lambda scene, start: Run(start, TIMES, TIMES, ends, elsewhere))
    assert not figure_1._any_start(scene).confirmed


def test_pairs_in_order():
    assert figure_1.share_above(np.array([3.0, 1.0]), np.array([2.0, 0.5])) == 0.75
    assert figure_1.share_above(np.array([3.0]), np.zeros(0)) == 1.0


def test_two_boundaries_are_the_lightest_two_cuts(minimum):
    scene = minimum.solution.scene
    weight = scene.lattice.by_axis(figure_1.cut_weights(scene))
    second = figure_1.contacts_between(figure_1.next_cut(weight, minimum.cut)[0])
    both = tuple(first | other for first, other in zip(minimum.contacts, second, strict=True))
    failed, excess = np.arange(12) < 5, np.ones(12)
    assert figure_1._two_boundaries(minimum, Descent(both, excess, failed)).confirmed
    everywhere = tuple(np.ones_like(values) for values in both)
    assert not figure_1._two_boundaries(minimum, Descent(everywhere, excess, failed)).confirmed
    assert not figure_1._two_boundaries(minimum, Descent(minimum.contacts, excess, failed)).confirmed
    none = figure_1._two_boundaries(minimum, Descent(both, excess, np.zeros(12, dtype=bool)))
    assert (none.verdict, none.samples, none.needed) == ("too few samples", 0, 5)


def test_an_excess_of_power_bounds_the_slip_off_the_cut(minimum, monkeypatch, needs_f64):
    """(1 + s e) P_min <= P, at any stage of a descent: no contact off the cut slips by more than s = excess / e."""
    for steps in (200, 2000):
        monkeypatch.setattr(figure_1, "DESCENT", steps)
        share = None
        for visible in (0.5, 0.1, 0.02):
            monkeypatch.setattr(figure_1, "VISIBLE", visible)
            descent = Descent.of(minimum)
            share = descent.excess / minimum.distance
            assert (share[descent.differs] >= visible).all()
        assert (share < 0.02).any() or steps == 200


def test_the_figure_shows_the_numbers(minimum):
    spin = np.abs(minimum.solution.spin)
    failed = np.arange(12) == 4
    figure = draw_configurations(spin[0], spin[1], [values[1] for values in minimum.contacts], minimum.distance, failed)
    viscous, coulomb = figure.subfigs[0].axes[:2]
    for axes, values in ((viscous, spin[0]), (coulomb, spin[1])):
        assert np.allclose(axes.collections[0].get_facecolor(), colormaps[SPIN_COLOURS](values.ravel()))
    assert len(viscous.collections) == 1
    assert len(coulomb.collections[1].get_segments()) == figure_1.count(minimum.contacts)[1]
    assert [len(axes.patches) for axes in (viscous, coulomb)] == [2, 2]
    [ranks] = figure.subfigs[1].axes
    assert np.sort(np.concatenate([line.get_ydata() for line in ranks.lines[:2]])) == pytest.approx(
        np.sort(minimum.distance)
    )
    assert ranks.lines[1].get_ydata() == minimum.distance[4]


def test_the_shown_sample_is_the_first_whose_cut_is_not_level(minimum):
    shown = figure_1.shown_sample(minimum, 12)
    level = [not np.diff(above, axis=0).any() for above in minimum.cut.above]
    assert shown == level.index(False)


def test_files_and_claims_of_a_small_effort(tmp_path, monkeypatch, needs_f64):
    monkeypatch.setattr(figure_1, "DESCENT", 4000)
    monkeypatch.setattr(figure_1, "STARTS", ("linear",))  # the nearest
    monkeypatch.setattr(figure_1.runtime, "start", lambda *_: None)  # the tests' own is running
    claims = figure_1.reproduce(tmp_path, Effort(seed=0, samples=2))
    assert len(claims) == 8
    verdicts = {claim.text.split(":")[0]: claim.verdict for claim in claims}
    assert "refuted" not in verdicts.values()
    assert all((claim.verdict == "confirmed") == (claim.kind == "theorem") for claim in claims)
    assert verdicts["Viscous"] == "too few samples"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig1-samples.csv", "fig1.csv", "fig1.pdf", "fig1.png"]
    with (tmp_path / "fig1.csv").open(encoding="utf-8") as file:
        discs = list(csv.DictReader(file))
    coulomb = [abs(float(row["spin_over_top"])) for row in discs if row["law"] == "coulomb"]
    assert sorted(set(coulomb)) == [0, 1]
    assert len(discs) == 200
    with (tmp_path / "fig1-samples.csv").open(encoding="utf-8") as file:
        samples = list(csv.DictReader(file))
    assert [row["seed"] for row in samples] == [str(seed) for seed in range(10)]
    for row in samples:
        assert (
            float(row["lower_bound"]) <= float(row["power"]) <= float(row["power"]) * (1 + float(row["descent_excess"]))
        )
        assert float(row["cut_power_by_flow"]) == pytest.approx(float(row["power"]), rel=1e-13)
