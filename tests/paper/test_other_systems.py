"""Other distributions, drivings and parameters: what each verdict is made of, and small studies."""

import numpy as np
import pytest
from taichi_bearings_studies.paper import parameters, reproduce, variants
from taichi_bearings_studies.paper.claims import Effort, judge
from taichi_bearings_studies.paper.parameters import PAPER, VARIANTS
from taichi_bearings_studies.paper.samples import Run, Table
from taichi_bearings_studies.paper.variants import EQUAL, REFERENCE, SPREAD, TIED, compared_with_reference

from taichi_bearings.scene import Scene
from tests.tables import rows_of

LOW = {
    "power_over_cut": 0.9, "below_cut": True, "gap": 1e-12, "states_proven": True, "spans": True,
    "reached_fraction": 1.0, "slipless_fraction": 0.6, "decades": 5.0,
}  # fmt: skip
CUT = LOW | {"power_over_cut": 1.0, "below_cut": False, "spans": False}


def drawn(number=5, **changes):
    """Samples of all distributions: below the cut, but as `changes` says of the k-th of SPREAD."""
    found = {name: [LOW] * number for name in (*SPREAD, *TIED)} | {EQUAL: [CUT] * number}
    found |= {SPREAD[int(k[1:])]: samples for k, samples in changes.items()}
    return {name: Table.of(rows) for name, rows in found.items()}


def of_drawn(name, found):
    return judge(f"distributions.{name}", **variants.names_of_distributions(found)).verdict


def test_a_distribution_that_fails_refines_and_all_others_refute():
    others = {f"_{k}": [CUT] * 5 for k in range(1, len(SPREAD))}
    tied = drawn(**others) | {TIED[0]: Table.of([CUT] * 5)}
    cases = (drawn(), drawn(_2=[CUT] * 5), drawn(_0=[CUT] * 5), tied, drawn(4))
    wanted = ["confirmed", "refined", "refuted", "refuted", "too few samples"]
    assert [of_drawn("below_cut", found) for found in cases] == wanted


def test_what_the_network_does_for_other_distributions():
    parted, unreached = LOW | {"spans": False}, LOW | {"reached_fraction": 0.97}
    assert of_drawn("reaches", drawn()) == "confirmed"
    assert of_drawn("reaches", drawn(_1=[*[LOW] * 4, unreached])) == "refuted"
    assert of_drawn("reaches", drawn(_1=[LOW | {"states_proven": False}] * 5)) == "too few samples"
    assert of_drawn("spans", drawn(_3=[parted] * 5)) == "confirmed"
    assert of_drawn("spans", drawn(5)) == "too few samples"
    assert of_drawn("equal", drawn()) == "confirmed"
    near = Table.of([CUT | {"power_over_cut": 1 - 1e-6}])
    assert of_drawn("equal", drawn() | {EQUAL: near}) == "refuted"


DRIVEN = {
    "seed": 0,
    "slipless": [1, 1, 0, 1],
    "power_over_jump": 2.0,
    "power_over_cut": 0.97,
    "gap": 1e-12,
    "angle": 45.0,
}
DIFFERENT = DRIVEN | {"slipless": [1, 0, 1, 1]}


def of_drivings(claim, number=5, **changes):
    tables = {name: Table.of([DRIVEN] * number) for name in variants.DRIVINGS}
    tables |= {name: Table.of(rows) for name, rows in changes.items()}
    found = compared_with_reference(tables)
    return judge(f"drivings.{claim}", **variants.names_of_drivings(found)).verdict


def test_drivings_are_judged_by_their_contacts():
    both = compared_with_reference({REFERENCE: Table.of([DRIVEN]), "other": Table.of([DIFFERENT])})["other"]
    assert (both.overlap.tolist(), both.changed.tolist()) == ([0.5], [2])
    for claim, of in (("speeds", variants.SAME), ("axis", variants.OTHER), ("rate", variants.RATES)):
        assert of_drivings(claim) == "confirmed"
        assert of_drivings(claim, **{list(of)[-1]: [*[DRIVEN] * 4, DIFFERENT]}) == "refuted"
    assert of_drivings("axis", 2) == "too few samples"
    assert of_drivings("speeds", **{next(iter(variants.SAME)): [DRIVEN | {"power_over_jump": 2.1}] * 5}) == "refuted"
    assert of_drivings("one_component") == of_drivings("height") == "refuted"
    along = {name: [DRIVEN | {"power_over_cut": 1 + 1e-12}] * 5 for name in variants.ALONG}
    assert of_drivings("one_component", **along) == "confirmed"


def test_small_cubes_under_all_drivings(tmp_path, monkeypatch, taichi_runtime, needs_f64):
    monkeypatch.setattr(variants, "BULK", 4)
    claims = reproduce.FIGURES["drivings"].reproduce(tmp_path, Effort(0, 4))
    assert {path.name for path in tmp_path.iterdir()} == {"drivings.png", "drivings.pdf", "drivings.csv"}
    assert [claim.verdict for claim in claims] == ["confirmed", "refuted", "refuted", "confirmed", "confirmed"]
    assert all(claim.paper and claim.ours and claim.uncertainty for claim in claims)
    rows = {row["driving"]: row for row in rows_of(tmp_path / "drivings.csv")}
    scene = Scene.random((4, 4, 4), 0, direction=(1, 0, 0))
    columns = np.array([np.min(scene.coefficients[2], axis=-1)])  # about x all contacts but those along x feel it
    assert float(rows["axis (1, 0, 0)"]["power_over_jump"]) >= columns.sum() - 1e-12
    assert float(rows["axis (1, 1, 0), omega_B = 0"]["power_over_cut"]) <= 1 + 1e-12


def course(force, *power):
    """Five samples whose power falls to `power` times the normal force, at times that scale; the minimum is 1."""
    power = force * np.repeat(np.array(power)[:, None], 5, axis=1)
    time = np.arange(len(power)) * parameters.FORCE / force
    return Run("random", time, power, np.zeros(0), np.zeros(0))


RUNS = {name: course(force, 4.0, 2.0, 1.0) for name, (*_, force) in VARIANTS.items()}
BOUNDS = {force: np.full(5, force) for *_, force in VARIANTS.values()}


def test_courses_are_compared_at_scaled_times():
    found = parameters.of_courses(
        RUNS | {"F_n = 500": course(500.0, 4.0, 2.8, 1.0), "K = 1e6": course(50.0, 4.0, 1.0, 1.0)}, BOUNDS
    )
    away = {"F_n = 500": 0.2, "K = 1e6": 0.25}
    for name, apart in found["apart"].items():
        assert apart == pytest.approx(np.full(5, away.get(name, 0.0)))
        assert found["ratio"][name] == pytest.approx(np.full(5, 0.5 if name == "K = 1e6" else 1.0))


@pytest.mark.parametrize(
    ("claim", "variant", "powers", "verdict"),
    [
        ("same_way", PAPER, (4.0, 2.0, 1.0), "confirmed"),
        ("same_way", "F_n = 500", (4.0, 2.8, 1.0), "refined"),
        ("same_way", "K = 1e6", (4.0, 2.8, 1.0), "refuted"),
        ("same_end", PAPER, (4.0, 2.0, 1.0), "confirmed"),
        ("same_end", "A = 1e4", (4.0, 2.0, 1.002), "refuted"),
        ("slower", "K = 1e6", (4.0, 1.0, 1.0), "confirmed"),
        ("slower", PAPER, (4.0, 2.0, 1.0), "refuted"),
    ],
)
def test_courses_refine_and_refute(claim, variant, powers, verdict):
    named = parameters.of_courses(RUNS | {variant: course(VARIANTS[variant][2], *powers)}, BOUNDS)
    assert judge(f"parameters.{claim}", **named).verdict == verdict


def test_states_and_thresholds_refine_and_refute():
    per_force = {50.0: np.ones(5), 5.0: np.ones(5)}
    for other, verdict in (((0, 1), "confirmed"), ((1, 1), "refuted")):
        states = [np.array([(0, 1)] * 5), np.array([other] * 5)]
        named = {"per_force": per_force, "states": states, "proven": 5, "slipless": 5}
        assert judge("parameters.same_minimum", **named).verdict == verdict
    heavier = named | {"per_force": per_force | {5.0: np.full(5, 1.1)}, "states": states[:1]}
    assert judge("parameters.same_minimum", **heavier).verdict == "refuted"
    for friction, verdict in (("0.1,1", "refined"), ("0.1,0.2", "confirmed"), ("0.1,3", "refuted")):
        scene = Scene.random((3, 3, 3), 0, replicas=5, distribution=f"uniform:{friction}")
        stretch = scene.coefficient * (parameters.FORCE / parameters.STIFFNESS)
        assert judge("parameters.threshold", stretch=stretch).verdict == verdict
