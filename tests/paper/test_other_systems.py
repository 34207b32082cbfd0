"""Other distributions, drivings and parameters: what each verdict is made of, and small studies."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from taichi_bearings_studies.paper import distributions, drivings, parameters
from taichi_bearings_studies.paper.claims import Effort
from taichi_bearings_studies.paper.distributions import EQUAL, SPREAD, TIED, Sample
from taichi_bearings_studies.paper.drivings import OTHER, RATES, REFERENCE, SAME, Driven, axis_name, rate_name
from taichi_bearings_studies.paper.parameters import PAPER, VARIANTS, Courses
from taichi_bearings_studies.paper.samples import Run

from taichi_bearings.scene import Scene

LOW = Sample(
    power_over_cut=0.9, below_cut=True, gap=1e-12, states_proven=True, spans=True, reached_fraction=1.0,
    slipless_fraction=0.6, decades=5.0,
)  # fmt: skip
CUT = replace(LOW, power_over_cut=1.0, below_cut=False, spans=False)


def drawn(number=5, **changes):
    """Samples of all distributions: below the cut, but as `changes` says of the k-th of SPREAD."""
    found = {name: [LOW] * number for name in (*SPREAD, *TIED)} | {EQUAL: [CUT] * number}
    return found | {SPREAD[int(k[1:])]: samples for k, samples in changes.items()}


def test_a_distribution_that_fails_refines_and_all_others_refute():
    def verdict(found):
        return distributions._below_cut(found).verdict

    assert verdict(drawn()) == "confirmed"
    assert verdict(drawn(_2=[CUT] * 5)) == "refined"
    assert verdict(drawn(_0=[CUT] * 5)) == "refuted"
    assert verdict({name: [CUT] * 5 if name != SPREAD[0] else [LOW] * 5 for name in drawn()}) == "refuted"
    assert verdict(drawn(4)) == "too few samples"


def test_what_the_network_does_for_other_distributions():
    parted, unreached = replace(LOW, spans=False), replace(LOW, reached_fraction=0.97)
    assert distributions._reaches(drawn()).verdict == "confirmed"
    assert distributions._reaches(drawn(_1=[*[LOW] * 4, unreached])).verdict == "refuted"
    assert distributions._reaches(drawn(_1=[replace(LOW, states_proven=False)] * 5)).verdict == "too few samples"
    assert distributions._spans(drawn(_3=[parted] * 5)).verdict == "confirmed"
    assert distributions._spans(drawn(5)).verdict == "too few samples"
    assert distributions._equal([CUT]).verdict == "confirmed"
    assert distributions._equal([replace(CUT, power_over_cut=1 - 1e-6)]).verdict == "refuted"


def test_drivings_are_judged_by_their_contacts():
    own, other = np.array([True, True, False, True]), np.array([True, False, True, True])
    driven = Driven(own, power=2.0, over_cut=0.97, gap=1e-12, angle=45.0)
    found = {name: [driven] * 5 for name in (REFERENCE, *SAME, *map(axis_name, OTHER), *map(rate_name, RATES))}
    assert drivings.overlaps([replace(driven, slipless=other)], [driven]) == [0.5]
    assert drivings.changes([replace(driven, slipless=other)], [driven]) == [2]
    assert drivings._speeds(found, range(5)).verdict == "confirmed"
    assert drivings._axis(found, range(5)).verdict == "confirmed"
    assert drivings._rate(found, range(5)).verdict == "confirmed"
    assert drivings._axis({name: of[:2] for name, of in found.items()}, range(2)).verdict == "too few samples"
    for name, claim in (
        (next(iter(SAME)), drivings._speeds), (axis_name(OTHER[-1]), drivings._axis), (rate_name(1.0), drivings._rate)
    ):  # fmt: skip
        assert claim(found | {name: [*[driven] * 4, replace(driven, slipless=other)]}, range(5)).verdict == "refuted"
    assert drivings._speeds(found | {next(iter(SAME)): [replace(driven, power=2.1)] * 5}, range(5)).verdict == "refuted"
    assert drivings._one_component([[driven]]).verdict == "refuted"
    assert drivings._one_component([[replace(driven, over_cut=1 + 1e-12)]]).verdict == "confirmed"
    assert drivings._height([driven]).verdict == "refuted"


def test_small_cubes_under_all_drivings(tmp_path, monkeypatch, taichi_runtime, needs_f64):
    monkeypatch.setattr(drivings.runtime, "start", lambda *_: None)
    monkeypatch.setattr(drivings, "BULK", 4)
    claims = drivings.reproduce(tmp_path, Effort(0, 4))
    assert {path.name for path in tmp_path.iterdir()} == {"drivings.png", "drivings.pdf", "drivings.csv"}
    assert [claim.verdict for claim in claims] == ["confirmed", "refuted", "refuted", "confirmed", "confirmed"]
    assert all(claim.paper and claim.ours and claim.uncertainty for claim in claims)
    with (tmp_path / "drivings.csv").open(encoding="utf-8") as file:
        rows = {row["driving"]: row for row in csv.DictReader(file)}
    scene = Scene.random((4, 4, 4), 0, direction=(1, 0, 0))
    columns = np.array([np.min(scene.coefficients[2], axis=-1)])  # about x all contacts but those along x feel it
    assert float(rows["axis (1, 0, 0)"]["power_over_jump"]) >= columns.sum() - 1e-12
    assert float(rows["axis (1, 1, 0), omega_B = 0"]["power_over_cut"]) <= 1 + 1e-12


def course(*power, time=(0.0, 1.0, 2.0)):
    power, spins = np.repeat(np.array(power, dtype=float)[:, None], 5, axis=1), np.zeros((3, 5, 3, 3, 3))
    return Run("random", np.array(time), power, spins, spins)


class Minimum:
    """Stands in for a certified minimum: a power and its bound."""

    def __init__(self, power, states=(0, 1)):
        self.power = self.lower_bound = np.full(5, power)
        self.scene = Scene.random((3, 3, 3), 0, replicas=5, normal_force=power)
        self.state = np.array([states] * 5)
        self.states_proven = np.ones(5, dtype=bool)


def courses(**changes):
    """Powers that fall from 4 F_n to F_n at times that scale, but as `changes` says of the variants by their number."""
    names = list(VARIANTS)
    runs = {}
    for name, springs in VARIANTS.items():
        force = springs.force
        time = np.array([0.0, 1.0, 2.0]) * 50 / force
        runs[name] = course(4 * force, 2 * force, force, time=tuple(time))
    runs |= {names[int(key[1:])]: run for key, run in changes.items()}
    forces = dict.fromkeys(springs.force for springs in VARIANTS.values())
    return Courses(runs, {force: Minimum(force) for force in forces})


def test_courses_are_compared_at_scaled_times():
    same = courses()
    assert all(same.distance(name) == pytest.approx(np.zeros(5)) for name in VARIANTS)
    assert same.arrival(PAPER) == pytest.approx(np.full(5, 2.0))
    assert same.arrival("F_n = 500") == pytest.approx(np.full(5, 2.0))
    late = courses(_2=course(2000, 1400, 500, time=(0.0, 0.1, 0.2)))
    assert late.distance("F_n = 500") == pytest.approx(np.full(5, 0.2))


def test_parameters_refine_and_refute():
    assert parameters._same_way(courses()).verdict == "confirmed"
    assert parameters._same_way(courses(_2=course(2000, 1400, 500, time=(0.0, 0.1, 0.2)))).verdict == "refined"
    assert parameters._same_way(courses(_3=course(200, 140, 50))).verdict == "refuted"
    assert parameters._same_end(courses()).verdict == "confirmed"
    assert parameters._same_end(courses(_4=course(200, 100, 50.1))).verdict == "refuted"
    assert parameters._slower(courses(_3=course(200, 50, 50))).verdict == "confirmed"
    assert parameters._slower(courses()).verdict == "refuted"
    assert parameters._same_minimum(courses()).verdict == "confirmed"
    other = Courses(courses().runs, {50.0: Minimum(50.0), 5.0: Minimum(5.0, (1, 1))})
    assert parameters._same_minimum(other).verdict == "refuted"
    scene = Scene.random((3, 3, 3), 0, replicas=5)
    assert parameters._threshold(scene).verdict == "refined"
    weak = Scene.random((3, 3, 3), 0, replicas=5, distribution="uniform:0.1,0.2")
    assert parameters._threshold(weak).verdict == "confirmed"
    strong = Scene.random((3, 3, 3), 0, replicas=5, distribution="uniform:0.1,3")
    assert parameters._threshold(strong).verdict == "refuted"
