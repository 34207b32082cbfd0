"""A mistyped word of any kind is refused with the one that was likely meant."""

import doctest
from pathlib import Path

import pytest
from taichi_bearings_cli.main import COMMANDS
from taichi_bearings_studies.paper import claims
from taichi_bearings_studies.paper.reproduce import FIGURES, reproduce

import taichi_bearings as tb
from taichi_bearings import runtime, words
from taichi_bearings.errors import BearingsError
from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.options import chosen
from taichi_bearings.plots.page import read_width
from taichi_bearings.runs.figures import FIGURE_KINDS, draw_figure
from taichi_bearings.runs.settings import RunSettings, settings_table
from taichi_bearings.scans.figure import Request, columns_of
from taichi_bearings.scans.histogram import histogram
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scene.disorder import Distribution
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.scene.law import LAWS, law_named
from taichi_bearings.solvers import METHODS
from tests.cli.commands import refused
from tests.stored_scans import stored_scan


def mistyped(word):
    """The word as people type it: two letters of its middle changed over."""
    middle = max(1, len(word) // 2)
    changed = word[: middle - 1] + word[middle] + word[middle - 1] + word[middle + 1 :]
    return changed if changed != word else word + "x"


def test_the_examples_of_words():
    assert doctest.testmod(words).failed == doctest.testmod(claims).failed == 0


@pytest.mark.parametrize("name", [*METHODS, *LAWS, *Distribution.PARAMETERS, *STARTS, *FIGURE_KINDS, *COMMANDS])
def test_every_name_is_found_from_its_mistyping(name):
    known = [*METHODS, *LAWS, *Distribution.PARAMETERS, *STARTS, *FIGURE_KINDS, *COMMANDS]
    assert words.meant(mistyped(name), known) == f"; did you mean {name!r}?"
    assert words.meant(name.upper().replace("-", "_"), known) == f"; did you mean {name!r}?"


@pytest.mark.parametrize("key", settings_table())
def test_every_key_of_a_scene_is_found_from_its_mistyping(key):
    with pytest.raises(BearingsError) as refused:
        RunSettings.from_mapping({mistyped(key) if len(key) > 4 else key + "s": 1})
    assert str(refused.value).endswith(f"; did you mean {key!r}?")


SCENE = tb.Scene.random((3, 4), seed=1)


def of_scan(folder, **request):
    scan = stored_scan(folder, sides=(4,), seeds=1)
    columns_of(read_scan(scan.path), Request(**({"y": "power", "x": "L"} | request)))


def of_plan(folder, text):
    (folder / "scan.toml").write_text(text)
    read_plan(folder / "scan.toml")


def saved(folder):
    return tb.solve(SCENE, "planar-cut", threads=1).save(folder / "run")


@pytest.mark.parametrize(
    ("refuse", "meant"),
    [
        (lambda _: RunSettings(method="interior_pont"), "interior-point"),
        (lambda _: RunSettings(law="colomb"), "coulomb"),
        (lambda _: law_named("viscuos"), "viscous"),
        (lambda _: RunSettings(arch="cdua"), "cuda"),
        (lambda _: RunSettings(precision="f46"), "f64"),
        (lambda _: RunSettings(figures="nnoe"), "none"),
        (lambda _: runtime.start("vulcan"), "vulkan"),
        (lambda _: Distribution.parse("unifrom:0.1,1"), "uniform"),
        (lambda _: initial_spin(SCENE, "minimum-cutt"), "minimum-cut"),
        (lambda _: tb.solve(SCENE, "planar"), "planar-cut"),
        (lambda _: tb.solve(SCENE, duraton=1), "duration"),
        (lambda _: draw_figure("net-work", None), "network"),
        (lambda _: read_width("singel"), "single"),
        (lambda _: chosen("methods", "interior-point,rigid-limt", METHODS), "rigid-limit"),
        (lambda folder: reproduce(["fgi1"], folder, None), next(iter(FIGURES))),
        (lambda folder: of_plan(folder, "lwa = 'coulomb'\n[scan]\nseed = [1]\n"), "law"),
        (lambda folder: of_plan(folder, "[scan]\nspin_botom = [1]\n"), "spin_bottom"),
        (lambda folder: of_scan(folder, y="powr"), "power"),
        (lambda folder: of_scan(folder, x="spin_botom"), "spin_bottom"),
        (lambda folder: of_scan(folder, by=("lwa",)), "law"),
        (lambda folder: of_scan(folder, where=("sede=1",)), "seed"),
        (lambda folder: of_scan(folder, where=("status=certifed",)), "certified"),
        (lambda folder: histogram([saved(folder)], folder / "out", by="sede"), "seed"),
        (lambda folder: histogram([stored_scan(folder, sides=(4,), seeds=1).path], folder / "h", by="spin_botom"),
         "spin_bottom"),
    ],
)  # fmt: skip
def test_a_mistyped_word_of_any_kind_is_refused_with_what_was_meant(refuse, meant, tmp_path):
    with pytest.raises(BearingsError) as refused:
        refuse(tmp_path)
    assert f"; did you mean {meant!r}?" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("analyze x", "analyse"), ("rnu", "run"), ("lits", "list"), ("plot spin x", "spins"),
        ("plot net-work x", "network"),
        ("benchmark acuracy", "accuracy"),
        ("histogram x --normalise men", "mean"), ("run --shpae 3,3", "--shape"),
        ("run --methd auto", "--method"), ("plot spins x --palne x=1", "--plane"), ("run --law coulom", "coulomb"),
    ],
)  # fmt: skip
def test_a_mistyped_word_on_the_command_line_too(line, meant):
    said = refused(*line.split())
    assert meant in said[said.lower().index("did you mean") :]


def test_nothing_is_suggested_where_nothing_is_near():
    assert words.meant("zzz", METHODS) == ""
    assert words.meant("", METHODS) == ""
    assert words.meant(3.5, METHODS) == ""


def test_the_page_of_methods_has_a_row_for_each():
    page = (Path(__file__).parents[1] / "docs" / "methods.md").read_text(encoding="utf-8")
    ours = [name for name, row in METHODS.items() if row.implementation.startswith("taichi_bearings.")]
    assert [name for name in ours if f"\n| `{name}` |" not in page] == []
