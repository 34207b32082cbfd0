"""The claims about the spanning network: what each verdict is made of, that it can be refuted, and the files."""

import csv
from dataclasses import fields, replace

import numpy as np
import pytest
from taichi_bearings_studies.paper import figure_3, network, samples
from taichi_bearings_studies.paper.claims import Effort, mean
from taichi_bearings_studies.paper.network import Sample

from taichi_bearings.lattice import Lattice

GOOD = Sample(
    side=24, seed=0, power=1.0, gap=1e-12, power_over_cut=0.97, below_cut=True, slipless_fraction=0.6,
    states_proven=True, unique=True, spans=True, reached_fraction=0.999, reached_by_chance=0.98,
    spanning_fraction=0.999, intermediate=0.9, domains=1000, largest_intermediate=8, shortest_path=60, planes_x=5,
    planes_y=6, disjoint_paths=2, busiest_link_share=0.8, effective_links=50.0, parting_links=0, plane_spans=False,
)  # fmt: skip
MANY = [GOOD] * 5
PARTED = replace(GOOD, side=10, spans=False, spanning_fraction=0.0, shortest_path=0, planes_x=0, planes_y=0)
CUT = replace(PARTED, side=3, below_cut=False, power_over_cut=1.0)


@pytest.fixture
def small(taichi_runtime, precision, monkeypatch):
    """Small samples, and the tests' own runtime."""
    if precision != "f64":
        pytest.skip("minima in double precision")
    monkeypatch.setattr(network.runtime, "start", lambda *_: None)
    monkeypatch.setattr(network, "SHARE_OF_SAMPLES", {3: 1.0, 5: 1.0})
    monkeypatch.setattr(network, "BULK", 5)
    monkeypatch.setattr(network, "LARGE", 6)
    monkeypatch.setattr(figure_3, "SHAPE", (6, 5, 5))


def test_verdicts_follow_the_samples():
    assert network._below_cut([*MANY, PARTED]).verdict == "confirmed"
    assert network._below_cut([*MANY, PARTED, CUT]).verdict == "refined"
    assert network._below_cut([*MANY, replace(PARTED, below_cut=False)]).verdict == "refuted"
    assert network._spans(MANY).verdict == "confirmed"
    assert network._spans([*MANY, PARTED]).verdict == "refined"
    assert network._spans([replace(GOOD, spans=False)] * 5).verdict == "refuted"
    assert network._reaches([*MANY, PARTED]).verdict == "confirmed"
    assert network._reaches([*MANY, replace(PARTED, reached_fraction=0.97)]).verdict == "refuted"
    assert network._reaches([replace(GOOD, reached_by_chance=0.999)] * 5).verdict == "refined"
    assert network._intermediate([*MANY, replace(GOOD, intermediate=0.05)]).verdict == "refuted"
    assert network._crosses_planes([GOOD, PARTED]).verdict == "confirmed"
    assert network._crosses_planes([replace(GOOD, plane_spans=True)]).verdict == "refuted"
    assert network._crosses_planes([replace(GOOD, planes_x=1)]).verdict == "refuted"
    assert network._few_links([*MANY, PARTED]).verdict == "confirmed"
    assert network._few_links([*MANY, replace(GOOD, busiest_link_share=0.3)]).verdict == "refuted"


@pytest.mark.parametrize("claim", ["_below_cut", "_spans", "_reaches", "_intermediate", "_few_links"])
def test_few_samples_are_too_few(claim):
    found = getattr(network, claim)(MANY[:2])
    assert found.verdict == "too few samples"
    assert "No verdict: this needs 5 such samples and has 2." in found.as_dict()["finding"]


def test_chance_touches_spheres_by_their_contacts():
    """A sphere of a 2x2x3 lattice's middle layer has four contacts; every free sphere is there."""
    assert network.reached_by_chance(Lattice((2, 2, 3)), 0.5) == pytest.approx(1 - 0.5**4)
    assert network.reached_by_chance(Lattice((3, 3)), 0.25) == pytest.approx(1 - (2 * 0.75**3 + 0.75**4) / 3)


def view(**changes):
    seen = {"slipless": 10, "components": 1, "spans": True, "reached_fraction": 1.0, "spanning_fraction": 1.0}
    return seen | {"domains": 9, "largest_intermediate": 3} | changes


def test_thresholds_matter_where_they_change_what_is_seen():
    same = [[view()] * (len(network.THRESHOLDS) + 1)] * 5
    assert network._spans_by_threshold(10, same).verdict == "refuted"
    assert network._spans_by_threshold(10, same[:4]).verdict == "too few samples"
    assert network._domains_by_threshold(10, same).verdict == "refuted"
    merged = [view(domains=4)] + [view(spans=False)] * len(network.THRESHOLDS)
    assert network._spans_by_threshold(10, [*same[:1], merged]).verdict == "confirmed"
    assert network._domains_by_threshold(10, [merged] * 5).verdict == "confirmed"
    assert network._domains_by_threshold(10, [merged]).verdict == "too few samples"


def test_means_come_with_their_standard_errors():
    assert mean([1.0, 2.0, 3.0]) == "2.0 +- 0.6"
    assert [mean(values) for values in ([1.0, 1.0], [100.0, 170.0], [1.0] * 3)] == ["1", "135", "1"]
    assert mean([4.0]) == "4"
    columns = network.columns_of([GOOD, replace(GOOD, power_over_cut=0.95), CUT])["power_over_cut"]
    assert columns.side.tolist() == [3, 24]
    assert columns.mean == pytest.approx([1.0, 0.96])
    assert columns.standard_error == pytest.approx([0.0, 0.01])


def test_the_study_writes_its_table_and_figure(small, tmp_path):
    claims = network.reproduce(tmp_path, Effort(seed=3, samples=2))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["network.csv", "network.pdf", "network.png"]
    with (tmp_path / "network.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [item.name for item in fields(Sample)]
    assert [(row["side"], row["seed"]) for row in rows] == [("3", "3"), ("3", "4"), ("5", "3"), ("5", "4")]
    assert all(float(row["gap"]) < 1e-9 and float(row["power_over_cut"]) <= 1 + 1e-9 for row in rows)
    assert all(row["unique"] == "True" for row in rows)
    assert all(claim.paper and claim.ours and claim.uncertainty for claim in claims)


def numbers_of(structure):
    return {"seed": structure.scene.seeds[0], "sides": list(structure.scene.lattice.shape), "power": structure.power}


def test_samples_that_an_interrupted_study_has_kept_are_not_solved_again(small, tmp_path):
    chosen = [network.RunSettings(shape=(side,) * 3, seed=seed) for side in (3, 4) for seed in (0, 1)]
    undisturbed = samples.measured(chosen, numbers_of, tmp_path / "undisturbed")
    solved = []

    def interrupted(structure):
        if len(solved) == 3:
            raise KeyboardInterrupt
        solved.append(structure.scene.lattice.shape[0])
        return numbers_of(structure)

    with pytest.raises(KeyboardInterrupt):
        samples.measured(chosen, interrupted, tmp_path / "a")
    with (tmp_path / "a").open("ab") as file:
        file.write(b'{"torn')
    solved.clear()
    assert samples.measured(chosen, interrupted, tmp_path / "a") == undisturbed
    assert solved == [4]
    assert list(tmp_path.iterdir()) == []


def test_workers_find_the_same_numbers_in_the_same_order(small, tmp_path, monkeypatch):
    chosen = [network.RunSettings(shape=(3, 3, 4), seed=seed) for seed in range(4)]
    here = samples.measured(chosen, numbers_of, tmp_path / "a")
    monkeypatch.setattr(samples, "paying_workers", lambda *_, **__: 2)
    assert samples.measured(chosen, numbers_of, tmp_path / "a") == here


def test_figures_3_and_4_show_a_sample_that_spans(small, tmp_path):
    claims = figure_3.reproduce(tmp_path, Effort(seed=0, samples=4)) + figure_3.reproduce_planes(tmp_path, Effort(0, 4))
    assert {path.name for path in tmp_path.iterdir()} == {
        "fig3.png", "fig3.pdf", "fig3.csv", "fig4.png", "fig4.pdf"
    }  # fmt: skip
    assert all(claim.finding and claim.numbers for claim in claims)
    shown = figure_3.minima(tmp_path, Effort(0, 4))[1]
    assert shown.scene.seeds == (1,)  # seed 0 does not span
    with (tmp_path / "fig3.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(shown.network.shortest_path)
    first, last = rows[0], rows[-1]
    assert (first["z"], last["z"]) == ("0", "4")
    speed = [np.hypot(float(row["spin_x"]), float(row["spin_y"])) for row in (first, last)]
    assert speed == pytest.approx([0.1, 1.0])


def test_without_a_sample_that_spans_there_is_no_path_to_judge(small, tmp_path):
    claims = figure_3.reproduce(tmp_path, Effort(seed=0, samples=1))
    assert [claim.verdict for claim in claims] == ["too few samples"] * 2
    assert claims[1].needed == 29
    assert figure_3.reproduce_planes(tmp_path, Effort(0, 1)) == []
