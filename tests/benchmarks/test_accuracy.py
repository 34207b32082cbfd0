"""The study of run time against error: what it claims is true of the exact minima, and it says so in every form."""

import csv

import numpy as np
import pytest
from taichi_bearings_studies.benchmarks import accuracy
from taichi_bearings_studies.benchmarks.accuracy import Entry, SceneResult, choose_methods, choose_scenes, measure_all
from taichi_bearings_studies.benchmarks.accuracy_report import COLUMNS, NAMES, fastest, panel, summarise, table, write
from taichi_bearings_studies.benchmarks.peers import find_peers
from taichi_bearings_studies.plots.accuracy import PEERS, Curve, Panel, draw_accuracy, style_of
from taichi_bearings_studies.report import Files

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.solvers import METHODS, PlanarCut
from tests.scenes import make_scene, minima

FIRST_TWO = ("gradient-descent", "cundall-strack")


@pytest.fixture(scope="module")
def results(needs_f64):
    scenes = [
        RunSettings(shape=shape, law=law, threads=1, time_limit=0.3)
        for shape, law in (((3, 3, 3), "coulomb"), ((5, 4), "viscous"))
    ]
    found, interrupted = measure_all(scenes, FIRST_TWO, find_peers()[0][:1])
    assert not interrupted
    return found


def made_up(method, seconds, power, bound, variant=""):
    n = len(seconds)
    return Entry(
        method, variant, ["default"] * n, np.array(seconds), 0.0, np.array(power), np.array(bound), np.arange(n),
        ["done"] * n,
    )  # fmt: skip


def test_errors_are_upper_bounds_and_gaps_are_proven(results):
    exact = next(e["power_minimum"] for e in minima((3, 3, 3)) if e["seed"] == 0)
    for result in results:
        assert result.contradictions() == []
        assert [entry.method for entry in result.entries][:2] == list(FIRST_TWO)
        for entry in result.entries:
            errors = result.errors(entry.power)
            assert (errors >= result.reference_gap).all()
            assert (errors <= result.gaps(entry) + 1e-15).all()
            assert (np.diff(entry.seconds) >= 0).all() or entry.variant
            assert (entry.seconds > 0).all()
    coulomb = results[0]
    assert coulomb.reference <= exact <= min(entry.power.min() for entry in coulomb.entries)
    for entry in coulomb.entries:
        assert (coulomb.errors(entry.power) >= (entry.power - exact) / entry.power - 1e-15).all()


def test_the_error_never_falls_below_what_the_reference_leaves_open():
    scene = make_scene((3, 4))
    result = SceneResult(scene, [made_up("a", [1, 2], [20.0, 11.0], [5.0, 9.0]), made_up("b", [1], [10.0], [9.5])])
    assert result.reference == 9.5
    assert result.reference_gap == pytest.approx(0.05)
    assert result.errors(np.array([20.0, 10.0])) == pytest.approx([10.5 / 20, 0.05])
    assert result.gaps(result.entries[0]) == pytest.approx([0.75, 2 / 11])
    assert result.seconds_to(result.entries[0], 0.2) == 2
    assert result.seconds_to(result.entries[0], 0.1) is None
    assert "–" in table([result])


def test_an_exact_answer_shows_round_off_and_not_zero():
    result = SceneResult(make_scene((3, 4)), [made_up("a", [1.0], [10.0], [10.0])])
    assert result.reference_gap == result.gaps(result.entries[0])[0] == np.finfo(float).eps


def test_a_bound_above_a_power_is_a_contradiction():
    entries = [made_up("a", [1.0], [10.0], [9.0]), made_up("b", [1.0], [12.0], [11.0])]
    (line,) = SceneResult(make_scene((3, 4)), entries).contradictions()
    assert "b proves 11.0, a has 10.0" in line


def test_a_method_that_cannot_solve_a_scene_is_left_out_with_its_reason(monkeypatch):
    class OnlyDiscs(PlanarCut):
        name = "only-discs"

        @classmethod
        def refusal(cls, scene):
            return "method is 'only-discs'; it needs two dimensions"

    monkeypatch.setitem(METHODS, "only-discs", OnlyDiscs)
    scenes = choose_scenes(["3,3,3"], [])
    with pytest.raises(InputError, match="needs two dimensions"):
        measure_all(scenes, ["only-discs"], [])
    monkeypatch.setattr(accuracy, "run_peer", lambda *_: made_up("peer", [1.0], [10.0], [9.0], "x"))
    said = []
    (result,), _ = measure_all(scenes, ["only-discs"], [accuracy.Peer("peer", "x")], said.append)
    assert result.left_out == {"only-discs": "method is 'only-discs'; it needs two dimensions"}
    assert "Left out: only-discs" in table([result])
    assert any("left out" in line for line in said)


def test_an_interrupted_study_keeps_what_it_has(monkeypatch):
    def run_method(scene, name, settings):
        if scene.lattice.dimension == 3 and name == "cundall-strack":
            raise KeyboardInterrupt
        return made_up(name, [1.0], [10.0], [9.0])

    monkeypatch.setattr(accuracy, "run_method", run_method)
    results, interrupted = measure_all(choose_scenes(["3,4", "3,3,3"], []), FIRST_TWO, [])
    assert interrupted
    assert [len(result.entries) for result in results] == [2, 1]


def test_files_hold_every_checkpoint(results, tmp_path):
    files = Files(tmp_path / "new" / "folder", NAMES)
    write(files, results)
    stored, text, figure = files.paths
    rows = list(csv.DictReader(stored.read_text(encoding="utf-8").splitlines()))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == sum(len(entry.seconds) for result in results for entry in result.entries)
    for row in rows:
        power, bound = float(row["power"]), float(row["lower_bound"])
        assert float(row["proven_gap"]) == pytest.approx((power - bound) / power, abs=1e-12)
        assert float(row["true_error"]) >= float(row["reference_gap"]) > 0
    assert {row["shape"] for row in rows} == {"3x3x3", "5x4"}
    assert figure.read_bytes()[:4] == b"\x89PNG"
    assert text.read_text(encoding="utf-8") == table(results)
    assert sorted(p.name for p in files.folder.iterdir()) == ["accuracy.csv", "accuracy.md", "accuracy.png"]
    with pytest.raises(FileError, match="already exists"):
        Files(files.folder, NAMES)
    write(Files(files.folder, NAMES, force=True), results)
    with pytest.raises(FileError, match="cannot be written"):
        Files(stored / "below", NAMES)


def test_the_summary_agrees_with_the_entries(results):
    report = summarise(results[0])
    assert report["shape"] == [3, 3, 3]
    for item, entry in zip(report["entries"], results[0].entries, strict=True):
        assert item["method"] == entry.method
        assert item["proven_gap"] == results[0].gaps(entry).min()
        assert list(item["seconds_to_gap"]) == ["1e-02", "1e-04", "1e-06", "1e-08", "1e-10"]
        assert item["lower_bound"] <= item["power"]


def test_the_figure_shows_the_fastest_linear_solver_and_its_progress_only():
    slow = made_up("clarabel", [2.0, 4.0, 3.0], [11.0, 10.001, 10.5], [9.0, 10.0, 9.9], "qdldl")
    quick = made_up("clarabel", [1.0, 9.0, 2.0], [11.0, 10.5, 10.001], [9.0, 9.0, 10.0], "faer")
    loose = made_up("clarabel", [0.1], [11.0], [9.0], "mkl")
    result = SceneResult(make_scene((3, 4)), [slow, quick, loose])
    assert fastest(result, result.entries) is quick
    (curve,) = panel(result).curves
    assert curve.label == "clarabel (faer)"
    assert list(curve.seconds) == [1.0, 2.0]


@pytest.mark.parametrize("scenes", [1, 3, 4])
def test_every_scene_has_two_panels(scenes):
    x = np.geomspace(1e-3, 1, 50)
    curves = [Curve(name, name, x, 1e-3 * x**-1, 1e-2 * x**-1) for name in ("gradient-descent", "clarabel")]
    figure = draw_accuracy([Panel(f"scene {n}", 1e-9, curves) for n in range(scenes)])
    shown = [axes for axes in figure.get_axes() if axes.axison]
    assert len(shown) == 2 * scenes
    assert all(axes.get_xscale() == axes.get_yscale() == "log" for axes in shown)
    figure.canvas.draw()


def test_every_method_has_a_look_of_its_own():
    looks = [style_of(name) for name in (*METHODS, *PEERS)]
    assert len(set(looks)) == len(looks)


def test_scenes_are_chosen_by_shape_and_law():
    assert [(s.shape, s.law) for s in choose_scenes(["3,4", "5x6x7"], ["coulomb", "viscous"])] == [
        ((3, 4), "coulomb"), ((5, 6, 7), "coulomb"), ((3, 4), "viscous"), ((5, 6, 7), "viscous"),
    ]  # fmt: skip
    assert {s.law for s in choose_scenes([], ["viscous"])} == {"viscous"}
    assert {s.law for s in choose_scenes([], [])} == {"coulomb", "viscous"}
    assert all(s.seed == 5 for s in choose_scenes([], [], seed="5"))
    assert choose_methods(None) == tuple(METHODS)
    for shapes in ([], ["3,4"]):
        with pytest.raises(InputError, match="law is 'dry'; it must be one of coulomb, viscous"):
            choose_scenes(shapes, ["dry"])
    with pytest.raises(InputError, match="'magic' is none of"):
        choose_methods("gradient-descent,magic")
