"""The Python front door: scenes and answers without files, saved and read back, many at a time; tables in notebooks."""

import contextlib
import pickle
import re
import subprocess
import sys
import threading
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.lattice import Lattice
from taichi_bearings.plots.style import SCREEN_DPI
from taichi_bearings.runs.verify import verify
from taichi_bearings.words import MOST_ROWS, html_table

ROOT = Path(__file__).parents[2]
SCENES = {  # name -> how it is made
    "2D": lambda: tb.Scene.random((4, 5), seed=3),
    "3D": lambda: tb.Scene.random((3, 4, 5), seed=3, spin_bottom=0.1),
    "2D replicas": lambda: tb.Scene.random((4, 5), seed=3, replicas=3),
    "3D replicas": lambda: tb.Scene.random((3, 4, 5), seed=3, replicas=2, law="viscous"),
    "both": lambda: tb.Scene.random((3, 3, 4), seed=3, law="coulomb-viscous", viscosity="uniform:0.5,1"),
    "given": lambda: tb.Scene(tuple(values[0] for values in drawn((3, 4, 5), 7)), direction=(1, 0, 0), seeds=(9,)),
}


def drawn(shape, *seeds):
    """Coefficients by the contract: one draw an axis from the seed, with an axis of replicas."""
    lattice = Lattice(shape)
    rngs = [np.random.default_rng(seed) for seed in seeds]
    return [
        np.stack([rng.uniform(0.1, 1.0, lattice.contact_shape(axis)) for rng in rngs]) for axis in range(len(shape))
    ]


def same(one, other):
    """True if two values of a field are the same to the last bit."""
    if isinstance(one, (tuple, list)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return set(one) == set(other) and all(same(one[name], other[name]) for name in one)
    if hasattr(one, "spin"):
        return same(one.time, other.time) and same(one.spin, other.spin)
    return np.array_equal(one, other, equal_nan=np.asarray(one).dtype.kind == "f") and type(one) is type(other)


def public(kind):
    return [name for name, value in vars(kind).items() if isinstance(value, property)]


@pytest.fixture(params=SCENES)
def solved(request, needs_f64):
    return tb.solve(SCENES[request.param](), threads=1, tolerance=1e-8)


def test_fields_have_the_shapes_that_help_tells(solved):
    scene, samples = solved.scene, len(solved)
    shape, lead = scene.lattice.shape, () if samples == 1 else (samples,)
    vector = () if len(shape) == 2 else (3,)
    for name in ("power", "lower_bound", "gap", "potential", "states_proven", "largest_balance_residual", "slipless"):
        value = getattr(solved, name)
        assert isinstance(value, (float, bool, int)) if samples == 1 else value.shape == (samples,), name
    assert isinstance(solved.status, str) if samples == 1 else len(solved.status) == samples
    assert solved.spin.shape == solved.spin_rounding.shape == (*lead, *shape, *vector)
    for axis in range(len(shape)):
        contacts = (*lead, *scene.lattice.contact_shape(axis))
        for name in ("slip", "power_per_contact", "force", "state"):
            assert getattr(solved, name)[axis].shape == contacts, name
        assert solved.friction[axis].shape == (*contacts, *vector)
        assert scene.coefficients[axis].shape == contacts
    for name, column in solved.history.items():
        of_all = name in ("iteration", "seconds", "time")
        assert column.shape == ((len(solved.history["iteration"]),) if of_all else (*lead, len(column.T))), name


def test_units_are_those_that_help_tells():
    """With speeds twice as large and forces three times, everything scales as its unit says."""
    x, y, z = (values[0] for values in drawn((3, 3, 4), 5))
    one = tb.solve(tb.Scene((x, y, z), radius=0.5, normal_force=50.0), threads=1, tolerance=1e-8)
    other = tb.solve(tb.Scene((x, y, z), spin_top=2.0, normal_force=150.0, radius=1.0), threads=1, tolerance=1e-8)
    units = {"force": 3, "length": 2, "1/time": 2, "energy/time": 3 * 2 * 2, "length/time": 2 * 2}
    for name, unit in (("power", "energy/time"), ("lower_bound", "energy/time"), ("spin", "1/time"),
                       ("slip_threshold", "length/time")):  # fmt: skip
        assert unit in getattr(tb.Result, name).__doc__, name
        assert getattr(other, name) == pytest.approx(units[unit] * np.asarray(getattr(one, name)), rel=1e-6), name
    for name, unit in (("slip", "length/time"), ("power_per_contact", "energy/time"), ("force", "force")):
        assert unit in getattr(tb.Result, name).__doc__, name
        for ours, theirs in zip(getattr(one, name), getattr(other, name), strict=True):
            assert theirs == pytest.approx(units[unit] * ours, rel=1e-6, abs=1e-5), name


def test_help_tells_of_every_field():
    for name in public(tb.Result):
        assert len(getattr(tb.Result, name).__doc__ or "") > 20, name
    text = tb.Scene.__doc__
    for item in fields(tb.Scene):
        assert re.search(rf"\b{item.name}\b", text), item.name


def test_what_is_loaded_is_what_was_solved_field_by_field(solved, tmp_path):
    path = solved.save(str(tmp_path / "mine"))
    assert path == solved.path
    for place in (path, str(path), path / "run.h5"):
        again = tb.load(place)
        for name in public(tb.Result):
            if name not in ("scene", "path", "summary"):
                assert same(getattr(solved, name), getattr(again, name)), name
        assert {**again.summary, "run": ""} == {**solved.summary, "run": ""}
        assert repr(again.scene) == repr(solved.scene)
        assert same(again.scene.coefficient, solved.scene.coefficient)
        assert repr(again) == repr(solved)
    assert verify(path)["contradictions"] == []
    assert tb.analyse(path).report["domains"] == tb.analyse(solved).report["domains"]


def test_one_of_several_samples_is_that_sample_alone(needs_f64):
    together = tb.solve(tb.Scene.random((4, 5), seed=3, replicas=3), threads=1)
    for number, one in enumerate(together):
        alone = tb.solve(tb.Scene.random((4, 5), seed=3 + number), threads=1)
        for name in ("power", "lower_bound", "spin", "slip", "state", "status", "settings"):
            assert same(getattr(one, name), getattr(alone, name)), name
    assert together[-1].power == together.power[2]
    with pytest.raises(IndexError):
        together[3]


def test_a_course_in_time_keeps_its_snapshots_and_is_saved_with_its_start(tmp_path, needs_f64):
    scene = tb.Scene.random((3, 4), seed=2, replicas=2)
    start = np.random.default_rng(1).uniform(-1, 1, (2, 3, 4))
    way = tb.solve(scene, tb.RigidLimit(error_tolerance=1e-2), start=start, duration=0.5, snapshots=[0, 0.1], threads=1)
    assert way.reached
    assert way.history["time"][-1] == pytest.approx(0.5)
    assert way.snapshots.spin.shape == (2, 2, 3, 4)
    assert same(way[1].snapshots.spin, way.snapshots.spin[1])
    assert same(way.snapshots.spin[:, 0, :, 1], start[:, :, 1])
    path = way.save(tmp_path / "way")
    again = tb.load(path)
    assert same(again.snapshots, way.snapshots)
    with np.load(again.save(tmp_path / "copy") / "initial_spin.npz") as stored:
        assert (stored["spin"] == start).all()
    assert again.settings["error_tolerance"] == 1e-2


def test_a_callback_hears_of_each_check_and_may_stop():
    scene, heard = tb.Scene.random((4, 4, 5), seed=1), []

    def enough(check):
        heard.append(check)
        return check.gap < 0.1

    stopped = tb.solve(scene, "gradient-descent", callback=enough, threads=1)
    assert stopped.status == "interrupted"
    assert heard[-1].gap < 0.1 <= min(check.gap for check in heard[:-1])
    assert isinstance(heard[0].power, float)
    assert [check.iteration for check in heard] == sorted(check.iteration for check in heard)
    assert not stopped.reached


def test_a_distribution_of_ones_own(needs_f64):
    own = tb.Scene.random((4, 5), seed=8, distribution=lambda rng, shape: rng.uniform(0.1, 1.0, shape))
    ours = tb.Scene.random((4, 5), seed=8)
    assert same(own.coefficients, ours.coefficients)
    assert same(tb.Scene(own.coefficients).coefficients, tuple(values[0] for values in drawn((4, 5), 8)))
    assert (dict(own.drawn), "seed 8" in repr(ours)) == ({}, True)
    with pytest.raises(tb.InputError, match=r"returned an array of shape \(3,\); it must return shape \(3, 5\)"):
        tb.Scene.random((4, 5), distribution=lambda rng, shape: np.ones(3))


@pytest.mark.parametrize(("call", "words"), [
    (lambda s: tb.solve("scene"), "the scene is a str"),
    (lambda s: tb.analyse(3), "the result is 3; it must be an answer of solve or load, or the path of a run"),
    (lambda s: tb.solve(s, threads=1).save("."), "already exists; save into another directory, or with force=True"),
    (lambda s: tb.solve(s, "newton"), "method is 'newton'"),
    (lambda s: tb.solve(s, tolerance=0), "tolerance is '0'"),
    (lambda s: tb.solve(s, stiffness=1e6), "options of a method belong to it"),
    (lambda s: tb.solve(s, duration=1.0), "does not use it; it needs --method rigid-limit"),
    (lambda s: tb.solve(s, start=np.zeros(3)), "spin in start has shape"),
    (lambda s: tb.solve(s, tb.LinearSolver()), "does not solve the law 'coulomb'"),
    (lambda s: tb.solve_many([s], tb.LinearSolver()), "does not solve the law 'coulomb'"),
    (lambda s: tb.solve_many([s], workers=-1), "workers is '-1'"),
    (lambda s: tb.CundallStrack(stiffness=-1), "stiffness is '-1'"),
    (lambda s: tb.load("nowhere"), "nowhere is not a run"),
    (lambda s: tb.solve(s, threads=1).plot("colours"), "the figure is 'colours'"),
    (lambda s: tb.analyse(tb.solve(s, threads=1), threshold=-1), "threshold is -1"),
    (lambda s: tb.Scene((np.ones((3, 5)), np.ones((4, 4)), 1)), "coefficients along x have shape"),
    (lambda s: tb.Scene((np.ones((3, 5)),)), "coefficients are 1 arrays"),
    (lambda s: tb.Scene(s.coefficients, viscosity=s.coefficients), "viscosities must not be given"),
    (lambda s: tb.Scene(("a", "b")), "must be real numbers"),
    (lambda s: tb.Scene.random((4, 5), distribution="normal"), "distribution is 'normal'"),
    (lambda s: tb.Scene.random((4, 5), replicas=0), "replicas is '0'"),
    (lambda s: tb.Scene.random("4x5y"), "shape is '4x5y'"),
    (lambda s: tb.Scene.random(10), "shape is '10'"),
    (lambda s: tb.Scene.random((4, 5), seed=-1), "seed is '-1'"),
    (lambda s: tb.Scene.random((4, 5), seed=0.5), "seed is '0.5'"),
    (lambda s: tb.Scene.random((4, 5), law="newton"), "law is 'newton'"),
    (lambda s: tb.Scene.random((4, 5), spin_top="fast"), "spin_top is 'fast'"),
    (lambda s: tb.Scene.random((4, 5), direction=(0, 0, 0)), "direction is [0, 0, 0]"),
    (lambda s: tb.Scene.random((4, 5), radius=-1), "radius is -1"),
    (lambda s: tb.Scene.random((4, 5), spin_top=10**400), "spin_top is 1000"),
    (lambda s: tb.Scene.random((10**5000, 5)), "shape is a number of thousands of digits"),
    (lambda s: tb.Scene.random((4, 5), direction="1,1,0"), "direction is '1,1,0'"),
    (lambda s: tb.Scene.random((4, 5), direction=("1", "1", "0")), "direction is ['1', '1', '0']"),
    (lambda s: tb.Scene.random((4, 5), viscosity="constant:1"), "the law coulomb does not use it"),
    (lambda s: tb.Scene.random((4, 5), distribution=5), "distribution is 5"),
    (lambda s: tb.Scene.random((4, 5), law=["viscous"]), "law is ['viscous']"),
    (lambda s: tb.Scene((np.ma.masked_less(np.ones((3, 5)), 2), np.ones((4, 4)))), "along x have masked entries"),
    (lambda s: tb.Scene(([[10**400] * 5] * 3, np.ones((4, 4)))), "along x are of type object"),
    (lambda s: tb.Scene(([[1.0], [1.0, 2.0]], np.ones((4, 4)))), "along x are lists of unequal lengths"),
    (lambda s: tb.Scene(np.ones((3, 5))), "coefficients along x have shape"),
    (lambda s: tb.Scene(5), "coefficients are 5"),
    (lambda s: tb.Scene(s.coefficients, seeds=("a",)), "seeds are ('a',)"),
    (lambda s: tb.Scene(s.coefficients, spin_top=np.ma.masked), "spin_top is masked"),
    (lambda s: tb.solve(s, start=np.ma.masked_all((4, 5))), "the spins in start have masked entries"),
    (lambda s: tb.solve(s, iterations=np.float32(2.7)), "iterations is '2.7'"),
    (lambda s: tb.solve_many([s], workers="two"), "workers is 'two'"),
    (lambda s: tb.solve_many(s), "scenes is a Scene"),
    (lambda s: tb.solve(s, callback=5), "callback is 5"),
    (lambda s: tb.load(5), "5 is not a path"),
    (lambda s: tb.analyse(tb.solve(s, threads=1), threshold="a"), "threshold is 'a'"),
])  # fmt: skip
def test_what_cannot_be_is_refused_in_one_sentence(call, words):
    with pytest.raises(tb.InputError) as refused:
        call(tb.Scene.random((4, 5), seed=1))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_figures_need_no_file(needs_f64):
    found = tb.solve(tb.Scene.random((4, 4, 5), seed=1, spin_bottom=0.1), "gradient-descent", 1e-3, threads=1)
    for kind in ("spins", "power", "history", "domains", "network"):
        assert found.plot(kind).axes
        drawn, size = (figure := found.plot(kind))._repr_png_()
        assert drawn.startswith(b"\x89PNG")
        assert size["width"] == int(SCREEN_DPI * figure.get_figwidth())
        assert figure.dpi == 300  # as it is saved


def test_many_scenes_come_as_they_are_solved_in_processes_of_their_own():
    scenes = [tb.Scene.random((4, 5), seed=seed) for seed in range(3)]
    answers = list(tb.solve_many(scenes, "gradient-descent", 1e-3, workers=2, precision="f32"))
    assert {id(answer.scene) for answer in answers} == {id(scene) for scene in scenes}
    for answer in answers:
        assert answer.summary["precision"] == "f32"
        assert answer.gap <= 1e-3
    assert list(tb.solve_many([])) == []


OWN_LAW = """
import numpy as np
from taichi_bearings.scene.law import LAWS, Law, Quantity
import taichi_bearings as tb

class Square(Law):
    def force(self, of, slip): return of[0] * slip
    def power(self, of, slip): return of[0] * slip**2
    def potential(self, of, slip): return of[0] * slip**2 / 2
    def conjugate(self, of, force): return np.where(of[0] > 0, force**2 / np.where(of[0] > 0, 2 * of[0], 1), 0)
    def steepest(self, of, slip): return of[0]

LAWS["square"] = Square("square", (Quantity("damping", "force*time/length"),), minimises="potential")
"""
MANY = 'list(tb.solve_many([tb.Scene.random((4, 5), law="square")], "gradient-descent", workers=1))'


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"study.py": f"{OWN_LAW}\n{MANY}"}, "the law Square is defined in the script itself"),
        (
            {"own.py": f"{OWN_LAW}\n{MANY}", "study.py": "import own"},
            "the module own, which defines the law Square, calls solve_many while it is imported; put the call under "
            "`if __name__ == '__main__'`",
        ),
    ],
    ids=["in the script", "in a module"],
)
def test_a_law_that_workers_cannot_import_is_refused_with_the_cause(files, words, tmp_path):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    done = subprocess.run([sys.executable, "study.py"], cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert words in done.stderr.splitlines()[-1]


def test_a_thread_that_is_not_the_main_one_solves(precision):
    found, scene = [], tb.Scene.random((4, 5), seed=1)
    solving = threading.Thread(
        target=lambda: found.append(tb.solve(scene, "gradient-descent", 1e-3, threads=1, precision=precision))
    )
    solving.start()
    solving.join()
    assert found[0].reached


def test_scenes_and_answers_are_pickled(solved):
    again = pickle.loads(pickle.dumps(solved))
    assert same(again.power, solved.power)
    assert repr(again.scene) == repr(solved.scene)


def shown_things():
    scene, many = tb.Scene.random((3, 4), seed=3), tb.Scene.random((3, 4), replicas=3)
    packing = tb.Packing.lattice("triangular", (4, 4), periodic="x", seed=2)
    answers = [tb.solve(one, threads=1) for one in (scene, many)] + [tb.solve(packing)]
    turned = tb.Scene.random((3, 3, 3), top=(1, 1, 0, 0.2), periodic=())
    return [scene, many, turned, packing, *answers, *map(tb.analyse, answers)]


def test_everything_has_a_short_table_of_whole_rows(needs_f64):
    for thing in shown_things():
        table = thing._repr_html_()
        rows = re.findall("<tr>(.*?)</tr>", table)
        assert 1 < len(rows) <= MOST_ROWS + 1, thing
        assert len({len(re.findall("<t[hd]>", row)) for row in rows}) == 1, thing
        assert "array(" not in table
        for tag in ("p", "table", "tr", "th", "td"):
            assert table.count(f"<{tag}>") == table.count(f"</{tag}>"), thing


def test_what_is_shown_is_escaped_and_long_tables_end():
    table = html_table("<a> & b", [("<script>", "<i>")] * (MOST_ROWS + 7))
    assert not re.search("<(script|i|a)>", table)
    assert table.count("&lt;script&gt;") == MOST_ROWS
    assert table.endswith("and 7 more")


@pytest.mark.parametrize(
    "thing", [tb.Scene.random((3, 3, 4), seed=1, replicas=2), tb.Packing.lattice("bcc", (2, 2, 3))], ids=repr
)
def test_arrays_of_an_answer_cannot_be_written_into(thing, tmp_path):
    """What is proven of them would be said of others."""
    found = tb.solve(thing, threads=1)
    found.save(tmp_path / "run")
    for answer in (found, found[0], tb.load(tmp_path / "run")):
        one = answer[0]
        given = tb.analyse(one).structure
        whole = [answer.spin, answer.slip, answer.force, answer.state, answer.friction, answer.power_per_contact,
                 one.spin, one.slip, *answer.history.values(), given.domain, given.slipless, given.spin]  # fmt: skip
        whole += [answer.packing.spin, answer.packing.friction] if answer.packing else [*answer.scene.coefficients]
        parts = [part for values in whole for part in (values if isinstance(values, tuple) else (values,))]
        for values in parts:
            with pytest.raises(ValueError, match="read-only"):
                values[...] = 0


def test_paths_are_texts_or_paths(tmp_path):
    from taichi_bearings.runs.verify import verify

    found = tb.solve(tb.Scene.random((3, 4)), threads=1)
    for number, kind in enumerate((str, type(tmp_path))):
        path = kind(tmp_path / f"run {number}")
        found.save(path)
        assert tb.load(path).power == found.power
        assert verify(path)["contradictions"] == []
        assert tb.analyse(path).numbers["power"] == found.power


LISTS = {
    "center": [[0.0, 0], [1, 0], [2, 0]], "contact": [[0, 1], [1, 2]], "driven": [0, -1, 1], "spin": [0.0, 0, 1],
    "friction": [0.5, 1.0], "radius": [0.5, 0.5, 0.5], "normal": [[1.0, 0], [1, 0]], "normal_force": [1, 2],
}  # fmt: skip
STRANGE = [
    None, "a", [], [[]], [[1, 2], [3]], {}, {"a": 1}, 1j, [1j], [None], ["a"], object(), float("nan"), [float("inf")],
    True, b"x", [[[1.0]]], 10**400, [10**400], -1, range(3), {1.0, 2.0}, lambda *_: None, np.array("a"),
    np.zeros((0, 0)),
]  # fmt: skip


def test_lists_do_for_arrays_and_what_does_not_is_one_sentence():
    """Of every argument of the constructors, whatever it is given."""
    arrays = {name: np.array(values) for name, values in LISTS.items()}
    one, other = tb.Packing(**LISTS), tb.Packing(**arrays)
    assert all(np.array_equal(getattr(one, name), getattr(other, name)) for name in LISTS)
    x, y = np.full((2, 4), 0.5), np.full((3, 3), 0.5)
    assert np.array_equal(tb.Scene([x.tolist(), y.tolist()]).coefficients[0], x)
    makers = [(tb.Packing, LISTS, ("law", "viscosity", "distribution", "seed")),
              (tb.Scene, {"coefficients": (x, y)}, ("viscosity", "seeds", "law", *tb.Scene.PARAMETERS)),
              (tb.Scene.random, {"shape": (3, 4)}, ("seed", "distribution", "law", "replicas", *tb.Scene.PARAMETERS)),
              (tb.Packing.lattice, {"kind": "bcc", "cells": (2, 2, 2)}, ("periodic", "seed", "radius"))]  # fmt: skip
    for make, good, others in makers:
        for name in (*good, *others):
            for strange in STRANGE:
                with contextlib.suppress(tb.BearingsError):  # any other error fails
                    make(**{**good, name: strange})
