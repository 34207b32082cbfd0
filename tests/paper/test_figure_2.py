"""Figure 2: what each verdict is made of, and that it can be refuted."""

from dataclasses import replace

import numpy as np
import pytest
from taichi_bearings_studies.paper import figure_2
from taichi_bearings_studies.paper.figure_2 import intermediate_spheres, without_idle_spin
from taichi_bearings_studies.paper.samples import Minima, Run, minima_of, relax, relax_rigidly
from taichi_bearings_studies.plots.relaxation import Relaxation, draw_relaxation

from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin


def run_of(*powers):
    """A run of one sample with the given powers."""
    power, spins = np.array(powers, dtype=float)[:, None], np.zeros((3, 1, 3, 3, 3))
    return Run("random", np.arange(len(power), dtype=float), power, spins, spins)


def repeated(run, samples=5):
    """The same run of that many samples."""
    return replace(run, power=np.repeat(run.power, samples, axis=1))


def minima_like(power, cut, samples=1):
    power, cut = np.full(samples, power), np.full(samples, cut)
    return Minima(power, power * (1 - 1e-11), cut, cut * (1 - 1e-13), np.zeros((samples, 3, 3, 3, 3)))


def test_the_largest_rise_is_measured_from_the_lowest_power_before():
    assert run_of(10, 4, 3, 3.5, 3.2, 3.9, 1).largest_rise == pytest.approx([0.09])
    assert run_of(10, 4, 3, 1).largest_rise == 0


def test_verdicts_follow_the_numbers():
    scene = Scene.random((3, 3, 3), 0, replicas=1)
    falls = run_of(10, 4, 3, 1)
    assert figure_2._falls_rigidly(scene, [falls, run_of(10, 5, 5 + 1e-12, 1)]).confirmed
    assert not figure_2._falls_rigidly(scene, [falls, run_of(10, 5, 5 + 1e-10, 1)]).confirmed
    assert figure_2._same_rigid_end(scene, [falls, falls], minima_like(1.0, 2.0)).confirmed
    assert not figure_2._same_rigid_end(scene, [falls, run_of(10, 1 + 1e-8)], minima_like(1.0, 2.0)).confirmed
    assert figure_2._same_end(scene, [falls, falls], minima_like(1.0, 2.0)).confirmed
    assert not figure_2._same_end(scene, [falls, falls], minima_like(0.9999, 2.0)).confirmed
    assert figure_2._leaves_cut(scene, run_of(2, 1), minima_like(1.0, 2.0)).verdict == "confirmed"
    assert figure_2._leaves_cut(scene, run_of(2, 2), minima_like(1.0, 2.0)).verdict == "refuted"
    assert figure_2._leaves_cut(scene, run_of(2, 2), minima_like(2.0, 2.0)).verdict == "too few samples"


@pytest.mark.parametrize("samples", [1, 5])
def test_what_most_samples_do_takes_samples_to_judge(samples):
    scene = Scene.random((3, 3, 3), 0, replicas=1)
    for claim in (lambda minima: figure_2._below_cut(minima, scene, 0), figure_2._larger_systems):
        lower, equal = minima_like(1.0, 1.1, samples), minima_like(1.1, 1.1, samples)
        wanted = ("confirmed", "refuted") if samples == 5 else ("too few samples",) * 2
        assert (claim(lower).verdict, claim(equal).verdict) == wanted
        assert claim(lower).needed == 5


def test_a_rise_is_measured_against_the_fall():
    """Of 10 to 9.9, where 0.05 is half a per cent of the power but half of the fall."""
    scene = Scene.random((3, 3, 3), 0, replicas=5)
    falls, creeps = repeated(run_of(10, 9.95, 9.9)), repeated(run_of(10, 10.05, 9.9))
    less = repeated(run_of(10, 10.005, 9.9))
    assert figure_2._falls(scene, falls, falls, falls).verdict == "confirmed"
    assert figure_2._falls(scene, creeps, less, falls).verdict == "refined"
    assert figure_2._falls(scene, creeps, creeps, falls).verdict == "refuted"  # no creep: stiffer contacts rise as much
    assert figure_2._falls(scene, creeps, less, creeps).verdict == "refuted"  # nor do rigid ones
    still = repeated(run_of(10, 10.05, 10))
    assert figure_2._falls(scene, still, still, falls).verdict == "too few samples"  # no fall to compare with
    one = run_of(10, 9.95, 9.9)
    assert figure_2._falls(Scene.random((3, 3, 3), 0, replicas=1), one, one, one).verdict == "too few samples"


def test_powers_are_compared_at_equal_times_as_long_as_both_runs_last():
    rigid = replace(run_of(10, 6, 0), time=np.array([0.0, 1.5, 9.0]))
    assert figure_2.distance_of_power(run_of(10, 8, 5), rigid) == pytest.approx([0.05])  # 6.5 and 6 at 1.5


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


def test_a_relaxation_is_seen_from_its_first_step_to_its_certified_end(needs_f64):
    scene = Scene.random((3, 3, 3), 0, replicas=1)
    run, minima = relax(scene, "minimum-cut"), minima_of(scene)
    assert run.power[0] == pytest.approx(minima.cut_power, rel=1e-13)
    assert minima.lower_bound[0] <= run.power[-1, 0] <= minima.power[0] * (1 + 2e-8)
    assert run.time[0] == 0
    assert run.time[1] < 1e-4
    assert (run.last[..., [0, -1]] == run.first[..., [0, -1]]).all()


@pytest.mark.parametrize("start", ["random", "minimum-cut"])
def test_rigid_friction_lowers_the_power_in_every_step_to_the_same_end(start, needs_f64):
    scene = Scene.random((3, 3, 3), 0, replicas=1)
    run, minima = relax_rigidly(scene, start), minima_of(scene)
    assert len(run.time) > 30  # steps
    assert run.largest_rise[0] < 1e-14
    assert run.power[-1] == pytest.approx(minima.power, rel=1e-9)
    assert run.power[-1] < 0.96 * minima.cut_power
    assert (run.last[..., [0, -1]] == run.first[..., [0, -1]]).all()


def test_the_figure_shows_the_numbers():
    time, power = np.array([0.0, 1.0, 10.0]), np.array([8.0, 4.0, 2.0])
    rigid_time, rigid_power = np.array([0.0, 0.5, 2.0, 3.0]), np.array([8.0, 6.0, 3.0, 2.0])
    spins = np.random.default_rng(5).uniform(-1, 1, (2, 3, 2, 3))
    start = Relaxation("random spins", time, power, rigid_time, rigid_power, spins, spins)
    figure = draw_relaxation([start, replace(start, name="minimum cut", power=power / 2)], 1.0, 1.5)
    curves = figure.subfigs[0].axes[0].lines
    assert (curves[0].get_xdata() == time[1:]).all()
    assert (curves[0].get_ydata() == power[1:] / 8).all()
    assert (curves[1].get_xdata() == rigid_time[1:]).all()
    assert (curves[1].get_ydata() == rigid_power[1:] / 8).all()
    assert (curves[2].get_ydata() == power[1:] / 16).all()
    assert [line.get_ydata()[0] for line in curves[4:]] == [1.5 / 8, 1.0 / 8]
    [legend] = figure.legends
    assert [text.get_text().split(",")[0] for text in legend.get_texts()[:2]] == [
        "from random spins",
        "from minimum cut",
    ]
    snapshots = [axes for axes in figure.subfigs[1].axes if axes.images]
    assert len(snapshots) == 4
    assert all(len(axes.images) == 2 * 3 * 2 for axes in snapshots)
