"""What is written is what is read, to the last bit; and all front doors agree."""

import json
import tempfile
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

import taichi_bearings as tb
from taichi_bearings import options
from taichi_bearings.files.scan_journal import Journal, read_journal
from taichi_bearings.runs import settings as keys
from taichi_bearings.runs.settings import RunSettings, read_toml
from taichi_bearings.scene import Scene
from taichi_bearings.scene.array_files import read_coefficients
from taichi_bearings.solvers import METHODS
from tests.api.test_front_door import public, same
from tests.cli.commands import bearings
from tests.properties.answers import LIMITS
from tests.properties.scenes import DISCS, SPHERES, cases, scenes

SMALL = (*DISCS[:4], *SPHERES[:4])
NORMAL = {
    "allow_nan": False,
    "allow_infinity": False,
    "allow_subnormal": False,
}  # Taichi has its process flush the rest
SIZES = st.floats(options.LEAST_NUMBER, options.MOST_NUMBER)
SIGNED = st.one_of(st.just(0.0), SIZES, SIZES.map(lambda size: -size))
WORDS = st.text(st.characters(codec="utf-8"), min_size=1).filter(lambda text: not text.startswith("/"))
TIMES = st.lists(st.floats(0, 1e6, allow_subnormal=False), min_size=1, max_size=4, unique=True).map(sorted)
VALUES = {  # what an option of each kind can be
    options.REAL: SIGNED,
    options.POSITIVE: SIZES,
    options.NOT_NEGATIVE: st.one_of(st.just(0.0), SIZES),
    options.COUNT: st.integers(1, 2**31),
    options.SEED: st.integers(0, 2**62),
    options.TRUTH: st.booleans(),
    options.TEXT: WORDS,
    options.FILE: WORDS,
    keys.SHAPE: st.lists(st.integers(-5, 10**9), min_size=2, max_size=3),
    keys.BEARING_STATE: st.one_of(*(st.lists(SIGNED, min_size=n, max_size=n) for n in (1, 3, 4))),
    keys.THREE_NUMBERS: st.lists(st.floats(**NORMAL), min_size=3, max_size=3),
    keys.TIME_LIST: TIMES,
}
OTHERS = {"tolerance": st.floats(1e-300, 1.0), "static_ratio": st.floats(1, 1e9), "gear_order": st.integers(2, 5)}


@contextmanager
def folder():
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def contents(path):
    """Every data set and attribute of a run file but for where and when it was written."""
    found = {}
    with h5py.File(path / "run.h5") as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
        found |= {f"@{name}": value for name, value in file.attrs.items() if name not in ("command", "run", "sha256")}
    return found


def without_figures(answer):
    return replace(answer, asked=replace(answer.asked, figures="none"))


@cases(0.2)
@given(scenes(replicas=(1, 2), shapes=SMALL, scale=3), st.sampled_from(tuple(METHODS)))
def test_a_run_that_is_saved_and_loaded_is_the_same_twice(scene, method):
    assume(not METHODS[method].refusal(scene))
    answer = without_figures(tb.solve(scene, method, 1e-10, iterations=LIMITS.get(method, 100), threads=1))
    with folder() as place:
        once = tb.load(answer.save(place / "once"))
        again = tb.load(once.save(place / "again"))
        for name in set(public(tb.Result)) - {"scene", "path", "summary"}:
            assert same(getattr(answer, name), getattr(once, name)), name
            assert same(getattr(once, name), getattr(again, name)), name
        one, two = contents(place / "once"), contents(place / "again")
        assert set(one) == set(two)
        for name in one:
            np.testing.assert_array_equal(one[name], two[name], err_msg=name)
        assert same(once.scene.material, scene.material)
        for name in Scene.PARAMETERS:
            assert getattr(once.scene, name) == getattr(scene, name)


def value_of(name, item):
    if name in OTHERS:
        return OTHERS[name]
    return (
        st.sampled_from((*item.kind.names, *item.kind.table))
        if isinstance(item.kind, options.OneOf)
        else VALUES[item.kind]
    )


@cases(0.5)
@given(st.data())
def test_settings_survive_their_text(data):
    """Any options, written as scene.toml, read, and written again."""
    table = keys.settings_table()
    chosen = data.draw(st.lists(st.sampled_from(sorted(table)), unique=True, max_size=8))
    settings = RunSettings.from_mapping({name: data.draw(value_of(name, table[name])) for name in chosen})
    with folder() as place:
        (place / "scene.toml").write_text(settings.to_toml(), encoding="utf-8", newline="")
        again = RunSettings.from_mapping(read_toml(place / "scene.toml"))
    assert again == settings
    assert again.values == settings.values
    assert again.to_toml() == settings.to_toml()


NAMES = {"coefficient": "{}", "viscosity": "{}_viscosity"}  # of the arrays along an axis, in npz files


def short_names(scene):
    return {
        NAMES[kind].format(a): v
        for kind, of in scene.named_coefficients.items()
        for a, v in zip("xyz", scene.lattice.by_axis(of), strict=False)
    }


@cases()
@given(scenes(replicas=(1, 2)))
def test_coefficients_survive_their_file(scene):
    with folder() as place:
        np.savez(place / "short.npz", **short_names(scene))
        with h5py.File(place / "long.h5", "w") as file:
            for kind, of in scene.named_coefficients.items():
                for axis, values in zip("xyz", scene.lattice.by_axis(of), strict=False):
                    file[f"{kind}/{axis}"] = values
        for file in ("short.npz", "long.h5"):
            for kind, of in scene.named_coefficients.items():
                assert same(read_coefficients(place / file, kind), scene.lattice.by_axis(of))


COUNTS = st.integers(0, 2**31 - 1)
SCALARS = st.one_of(st.none(), st.booleans(), st.integers(-(2**61), 2**61), st.floats(**NORMAL), st.text())
OWN = {"status": st.text(), "slipping": st.none() | COUNTS, "power": st.none() | st.floats(**NORMAL)}
SAMPLES = st.fixed_dictionaries(
    {
        "key": st.text(),
        "scalars": st.builds(dict.__or__, st.dictionaries(st.text(), SCALARS, max_size=3), st.fixed_dictionaries(OWN)),
        "bins": st.dictionaries(st.integers(-300, 300).map(str), COUNTS, max_size=3),
    }
)


@cases()
@given(st.lists(SAMPLES, max_size=4), st.lists(SAMPLES, max_size=4))
def test_a_journal_gives_back_the_last_sample_of_each_key(before, after):
    with folder() as place:
        for samples in (before, after):
            with Journal(place / "samples.jsonl") as journal:
                journal.append(samples)
        wanted = {sample["key"]: sample for sample in (*before, *after)}
        found = read_journal(place / "samples.jsonl")
    assert found == wanted
    assert json.dumps(sorted(found.items())) == json.dumps(sorted(wanted.items()))  # -0.0 and 1 are not 0.0 and 1.0


@cases(0.1)
@given(scenes(shapes=SMALL, scale=3))
def test_the_command_line_the_scene_in_arrays_and_the_scene_in_a_file_are_one(scene):
    """The same bits, whichever door a scene comes in by."""
    answer = tb.solve(scene, tolerance=1e-9, threads=1)
    with folder() as place:
        np.savez(place / "c.npz", **{name: values[0] for name, values in short_names(scene).items()})
        words = {
            name: getattr(scene, name) for name in Scene.PARAMETERS if name != "normal_force" or scene.law.has_friction
        }
        words |= {"law": scene.law, "shape": scene.lattice.shape, "coefficients": place / "c.npz", "out": place / "run"}
        words |= {"tolerance": 1e-9, "threads": 1, "figures": "none"}
        given = [f"--{name.replace('_', '-')}={_word(value)}" for name, value in words.items() if value is not None]
        done = bearings("run", *given, "--json")
        told = json.loads(done.stdout)
        stored = tb.load(place / "run")
    assert done.returncode == (0 if answer.reached else 1)
    for name in ("power", "lower_bound", "spin", "slip", "state", "friction", "status", "iterations"):
        assert same(getattr(stored, name), getattr(answer, name)), name
    assert told["power"] == answer.power
    assert told["lower_bound"] == answer.lower_bound


def _word(value):
    return ",".join(map(repr, value)) if isinstance(value, tuple) else str(value)
