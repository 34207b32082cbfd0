"""The claims about the spanning network: what each verdict is made of, that it can be refuted, and the files."""

import numpy as np
import pytest
from taichi_bearings_studies.paper import figure_3, network, reproduce, samples
from taichi_bearings_studies.paper.claims import Effort, judged
from taichi_bearings_studies.paper.samples import Table

from taichi_bearings.lattice import Lattice
from tests.tables import rows_of

GOOD = {
    "side": 24, "seed": 0, "power": 1.0, "gap": 1e-12, "power_over_cut": 0.97, "below_cut": True,
    "slipless_fraction": 0.6, "states_proven": True, "unique": True, "spans": True, "reached_fraction": 0.999,
    "reached_by_chance": 0.98, "spanning_fraction": 0.999, "intermediate": 0.9, "domains": 1000,
    "largest_intermediate": 8, "shortest_path": 60, "planes_x": 5, "planes_y": 6, "disjoint_paths": 2,
    "busiest_link_share": 0.8, "effective_links": 50.0, "parting_links": 0, "plane_spans": False,
}  # fmt: skip


MANY = [GOOD] * 5


PARTED = GOOD | {"side": 10, "spans": False, "spanning_fraction": 0.0, "shortest_path": 0, "planes_x": 0, "planes_y": 0}


CUT = PARTED | {"side": 3, "below_cut": False, "power_over_cut": 1.0}


@pytest.fixture
def small(taichi_runtime, precision, monkeypatch):
    """Small samples."""
    if precision != "f64":
        pytest.skip("minima in double precision")
    monkeypatch.setattr(network, "SHARE_OF_SAMPLES", {3: 1.0, 5: 1.0})
    monkeypatch.setattr(network, "BULK", 5)
    monkeypatch.setattr(network, "LARGE", 6)
    monkeypatch.setattr(figure_3, "SHAPE", (6, 5, 5))
    figure_3.minima.cache_clear()


def verdicts(name, rows):
    return [claim.verdict for claim in judged(f"network.{name}", **network.names_of(Table.of(rows)))]


@pytest.mark.parametrize(
    ("name", "rows", "verdict"),
    [
        ("below_cut", [*MANY, PARTED], "confirmed"),
        ("below_cut", [*MANY, PARTED, CUT], "refined"),
        ("below_cut", [*MANY, PARTED | {"below_cut": False}], "refuted"),
        ("spans", MANY, "confirmed"),
        ("spans", [*MANY, PARTED], "refined"),
        ("spans", [GOOD | {"spans": False}] * 5, "refuted"),
        ("reaches", [*MANY, PARTED], "confirmed"),
        ("reaches", [*MANY, PARTED | {"reached_fraction": 0.97}], "refuted"),
        ("reaches", [GOOD | {"reached_by_chance": 0.999}] * 5, "refined"),
        ("intermediate", [*MANY, GOOD | {"intermediate": 0.05}], "refuted"),
        ("crosses_planes", [GOOD, PARTED], "confirmed"),
        ("crosses_planes", [GOOD | {"plane_spans": True}], "refuted"),
        ("crosses_planes", [GOOD | {"planes_x": 1}], "refuted"),
        ("few_links", [*MANY, PARTED], "confirmed"),
        ("few_links", [*MANY, GOOD | {"busiest_link_share": 0.3}], "refuted"),
        *((n, MANY[:2], "too few samples") for n in ("below_cut", "spans", "reaches", "intermediate", "few_links")),
    ],
)  # fmt: skip
def test_verdicts_follow_the_samples(name, rows, verdict):
    assert verdicts(name, rows) == [verdict]


@pytest.mark.parametrize(("name", "rows"), [("below_cut", [CUT]), ("spans", [PARTED]), ("few_links", [PARTED])])
def test_a_claim_of_which_samples_say_nothing_is_left_out(name, rows):
    assert verdicts(name, rows) == []


def test_chance_touches_spheres_by_their_contacts():
    """A sphere of a 2x2x3 lattice's middle layer has four contacts; every free sphere is there."""
    assert network.reached_by_chance(Lattice((2, 2, 3)), 0.5) == pytest.approx(1 - 0.5**4)
    assert network.reached_by_chance(Lattice((3, 3)), 0.25) == pytest.approx(1 - (2 * 0.75**3 + 0.75**4) / 3)


def test_thresholds_matter_where_they_change_what_is_seen():
    view = {"slipless": 10, "spans": True, "reached_fraction": 1.0, "spanning_fraction": 1.0, "domains": 9}
    view["largest_intermediate"] = 3
    same = [view] * (len(network.THRESHOLDS) + 1)
    merged = [view | {"domains": 4}] + [view | {"spans": False}] * len(network.THRESHOLDS)

    def found(views):
        rows = [GOOD | {f"{name}_seen": [seen[name] for seen in sample] for name in network.VIEWED} for sample in views]
        rows = [row | {"side": 10} for row in rows]
        return [verdicts(f"{name}_by_threshold", rows)[0] for name in ("spans", "domains")]

    assert found([same] * 5) == ["refuted", "refuted"]
    assert found([same] * 4) == ["too few samples"] * 2
    assert found([same, merged]) == ["confirmed", "too few samples"]
    assert found([merged] * 5) == ["confirmed", "confirmed"]


def test_the_study_writes_its_table_and_figure(small, tmp_path):
    claims = reproduce.FIGURES["network"].reproduce(tmp_path, Effort(seed=3, samples=2))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["network.csv", "network.pdf", "network.png"]
    rows = rows_of(tmp_path / "network.csv")
    assert set(rows[0]) == set(GOOD)
    assert [(row["side"], row["seed"]) for row in rows] == [("3", "3"), ("3", "4"), ("5", "3"), ("5", "4")]
    assert all(float(row["gap"]) < 1e-9 and float(row["power_over_cut"]) <= 1 + 1e-9 for row in rows)
    assert all(row["unique"] == "True" for row in rows)
    assert all(claim.paper and claim.ours and claim.uncertainty for claim in claims)


def numbers_of(structure):
    return {"seed": structure.scene.seeds[0], "sides": list(structure.scene.lattice.shape), "power": structure.power}


def test_samples_that_an_interrupted_study_has_kept_are_not_solved_again(small, tmp_path):
    chosen = [network.RunSettings(shape=(side,) * 3, seed=seed) for side in (3, 4) for seed in (0, 1)]
    undisturbed = samples.measured(chosen, numbers_of, tmp_path / "undisturbed").only("seed sides power")
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
    assert samples.measured(chosen, interrupted, tmp_path / "a").only("seed sides power") == undisturbed
    assert solved == [4]


def test_figures_3_and_4_show_a_sample_that_spans(small, tmp_path):
    effort = Effort(seed=0, samples=4)
    claims = [claim for name in ("fig3", "fig4") for claim in reproduce.FIGURES[name].reproduce(tmp_path, effort)]
    assert {path.name for path in tmp_path.iterdir()} == {"fig3.png", "fig3.pdf", "fig3.csv", "fig4.png", "fig4.pdf"}
    assert len(claims) == 5
    assert all(claim.finding and claim.numbers for claim in claims)
    shown = figure_3.minima(tmp_path, effort)[1]
    assert shown.scene.seeds == (1,)  # seed 0 does not span
    rows = rows_of(tmp_path / "fig3.csv")
    assert len(rows) == len(shown.network.shortest_path)
    first, last = rows[0], rows[-1]
    assert (first["z"], last["z"]) == ("0", "4")
    speed = [np.hypot(float(row["spin_x"]), float(row["spin_y"])) for row in (first, last)]
    assert speed == pytest.approx([0.1, 1.0])


def test_without_a_sample_that_spans_there_is_no_path_to_judge(small, tmp_path):
    claims = reproduce.FIGURES["fig3"].reproduce(tmp_path, Effort(seed=0, samples=1))
    assert [claim.verdict for claim in claims] == ["too few samples"] * 2
    assert claims[1].samples_needed == 29
    assert reproduce.FIGURES["fig4"].reproduce(tmp_path, Effort(0, 1)) == []
