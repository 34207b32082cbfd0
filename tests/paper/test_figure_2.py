"""Figure 2: what each verdict is made of, and that it can be refuted."""

from dataclasses import replace

import numpy as np
import pytest
from taichi_bearings_studies.paper import figure_2
from taichi_bearings_studies.paper.claims import judge
from taichi_bearings_studies.paper.figure_2 import intermediate_spheres, names_of, without_idle_spin
from taichi_bearings_studies.paper.samples import Run, Table, minima_of, relax, relax_rigidly

from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin


def run_of(*powers, samples=1):
    """A run of samples with the given powers."""
    power, spins = np.array(powers, dtype=float)[:, None], np.zeros((3, samples, 3, 3, 3))
    return Run("random", np.arange(len(power), dtype=float), np.repeat(power, samples, axis=1), spins, spins)


def minima_like(power, cut, samples=1):
    power, cut = np.full(samples, power), np.full(samples, cut)
    bound = power * (1 - 1e-11)
    columns = {"power": power, "lower_bound": bound, "cut_power": cut, "below_cut": power < cut * (1 - 1e-6)}
    return Table(columns | {"cut_is_minimum": cut - bound <= 1e-6 * cut})


def claim(name, runs=None, minima=None, rigid=None, samples=1):
    runs, minima = runs or [run_of(10, 1)], minima if minima is not None else minima_like(1.0, 2.0, samples)
    rigid = rigid or runs
    named = names_of(runs, runs, rigid, minima, minima) | {"seeds": list(range(samples)), "apart": 0.0}
    return judge(f"fig2.{name}", **named)


def test_the_largest_rise_is_measured_from_the_lowest_power_before():
    assert run_of(10, 4, 3, 3.5, 3.2, 3.9, 1).largest_rise == pytest.approx([0.09])
    assert run_of(10, 4, 3, 1).largest_rise == 0


def test_verdicts_follow_the_numbers():
    falls, least = run_of(10, 4, 3, 1), minima_like(1.0, 2.0)
    assert claim("falls_rigidly", [falls, run_of(10, 5, 5 + 1e-12, 1)]).confirmed
    assert not claim("falls_rigidly", [falls, run_of(10, 5, 5 + 1e-10, 1)]).confirmed
    assert claim("same_rigid_end", [falls, falls], least).confirmed
    assert not claim("same_rigid_end", [falls, run_of(10, 1 + 1e-8)], least).confirmed
    assert claim("same_end", [falls, falls], least).confirmed
    assert not claim("same_end", [falls, falls], minima_like(0.9999, 2.0)).confirmed
    assert claim("leaves_cut", [falls, run_of(2, 1)], least).verdict == "confirmed"
    assert claim("leaves_cut", [falls, run_of(2, 2)], least).verdict == "refuted"
    assert claim("leaves_cut", [falls, run_of(2, 2)], minima_like(2.0, 2.0)).verdict == "too few samples"


@pytest.mark.parametrize("samples", [1, 5])
@pytest.mark.parametrize("name", ["below_cut", "larger_systems"])
def test_what_most_samples_do_takes_samples_to_judge(name, samples):
    lower, equal = (claim(name, minima=minima_like(power, 1.1, samples), samples=samples) for power in (1.0, 1.1))
    wanted = ("confirmed", "refuted") if samples == 5 else ("too few samples",) * 2
    assert (lower.verdict, equal.verdict) == wanted
    assert lower.samples_needed == 5


def falling(run, stiff, hard, samples=5):
    cases = [{"start": "", "run": run, "stiff": stiff, "hard": hard, "distance": np.zeros(1)}]
    named = {"pairs": cases, "seeds": range(samples), "same_power": 1e-6, "damping_factor": 10.0}
    return judge("fig2.falls", **named).verdict


def test_a_rise_is_measured_against_the_fall():
    """Of 10 to 9.9, where 0.05 is half a per cent of the power but half of the fall."""
    falls, creeps, less, still = (
        run_of(10, *of, samples=5) for of in ((9.95, 9.9), (10.05, 9.9), (10.005, 9.9), (10.05, 10))
    )
    assert falling(falls, falls, falls) == "confirmed"
    assert falling(creeps, less, falls) == "refined"
    assert falling(creeps, creeps, falls) == "refuted"  # no creep: stiffer contacts rise as much
    assert falling(creeps, less, creeps) == "refuted"  # nor do rigid ones
    assert falling(still, still, falls) == "too few samples"  # no fall to compare with
    assert falling(*[run_of(10, 9.95, 9.9)] * 3) == "too few samples"


def test_powers_are_compared_at_equal_times():
    rigid = replace(run_of(10, 6, 0), time=np.array([0.0, 1.5, 9.0]))
    assert run_of(10, 8, 5).distance(rigid, np.array([0.0, 1.5])) == pytest.approx([0.05])  # 6.5 and 6 at 1.5


def test_a_minimum_is_below_its_cut_or_is_the_cut(needs_f64):
    minima = minima_of(Scene.random((3, 3, 3), 0, replicas=12))
    assert (minima.lower_bound <= minima.cut_power).all()
    assert (minima.below_cut ^ minima.cut_is_minimum).all()
    assert 0 < minima.below_cut.sum() < 12  # both kinds are common at this size


def test_only_spins_of_neither_plane_count_as_intermediate():
    scene = Scene.random((3, 4, 5), 3, replicas=2)
    assert (intermediate_spheres(scene, initial_spin(scene, "minimum-cut")) == 0).all()
    assert (intermediate_spheres(scene, initial_spin(scene, "linear")) == 3 * 4 * 3).all()


def test_idle_spin_makes_nothing_slip():
    scene = Scene.random((3, 4, 5), 3, replicas=2)
    axes = scene.lattice.all_spin_axes
    staggered = scene.staggered_spin(initial_spin(scene, "random"), axes)
    rest = without_idle_spin(staggered)
    assert scene.power(rest, axes) == pytest.approx(scene.power(staggered, axes), rel=1e-13)
    assert np.abs(rest[2, ..., 1:-1].mean(axis=(1, 2))).max() < 1e-15
    assert (rest[:2] == staggered[:2]).all()


def test_relaxations_are_seen_from_their_first_step_to_their_certified_end(needs_f64):
    scene = Scene.random((3, 3, 3), 0, replicas=1)
    minima, run = minima_of(scene), relax(scene, "minimum-cut")
    assert run.power[0] == pytest.approx(minima.cut_power, rel=1e-13)
    assert minima.lower_bound[0] <= run.power[-1, 0] <= minima.power[0] * (1 + 2e-8)
    assert run.time[0] == 0
    assert run.time[1] < 1e-4
    for start in figure_2.STARTS:
        rigid = relax_rigidly(scene, start)
        assert len(rigid.time) > 30  # steps
        assert rigid.largest_rise[0] < 1e-14
        assert rigid.power[-1] == pytest.approx(minima.power, rel=1e-9)
        assert rigid.power[-1] < 0.96 * minima.cut_power
        assert all((of.last[..., [0, -1]] == of.first[..., [0, -1]]).all() for of in (run, rigid))
