"""Lattices and distributions are named wherever users look for them."""

from pathlib import Path

import taichi_bearings as tb
from taichi_bearings.options import options_of
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene.disorder import Distribution
from taichi_bearings.scene.generators.lattices import KINDS


def test_lattices_and_distributions_are_named_wherever_users_look_for_them():
    page = (Path(__file__).parents[2] / "docs" / "packings.md").read_text()
    for kind in KINDS:
        assert f'"{kind}"' in tb.Packing.lattice.__doc__, kind
        assert f"`{kind}`" in page, kind
    options, known = options_of(RunSettings)["distribution"].help, tb.Scene.random.__doc__
    scenes = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text()
    for form in Distribution.forms():
        assert form in options, form
        assert f'"{form}"' in known, form
        assert f"`{form}`" in scenes, form
        assert f"``{form.split(':')[0]}:" in Distribution.__doc__, form
