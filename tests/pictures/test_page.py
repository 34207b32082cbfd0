"""The page of `bearings view` as a file: what it holds, to which digits, and that it asks for nothing else."""

import base64
import gzip
import json
import re

import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.runs.points_and_lines import points_and_lines
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.view.view import view


def held_by(page):
    """Facts and arrays of the text of a page."""
    block = {name: re.search(rf'id="{name}">([^<]*)<', page)[1] for name in ("facts", "arrays", "library")}
    facts, packed = json.loads(block["facts"]), gzip.decompress(base64.b64decode(block["arrays"]))
    places = {place["name"]: place for place in facts["arrays"]}
    arrays = {n: np.frombuffer(packed, f"<{p['kind']}", p["length"], p["offset"]) for n, p in places.items()}
    return facts, arrays, gzip.decompress(base64.b64decode(block["library"])).decode()


def page_of(run, folder):
    path = folder / "page.html"
    assert view(run, path, analyse=True)["bytes"] == path.stat().st_size
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["minimum", "discs", "dynamics"])
def test_a_page_holds_the_rows_to_the_digits_that_it_shows(name, request, tmp_path):
    run = request.getfixturevalue(name)
    facts, arrays, _ = held_by(page_of(run, tmp_path))
    rows = points_and_lines(read_run(run), analyse=True)
    for key in ("slip", "power", "force", "coefficient", "betweenness"):
        assert arrays[key] == pytest.approx(rows.contacts[key].values, rel=1e-7, abs=1e-37)
    shown = rows.structure.scene.driving.shown(rows.structure.spin)
    spin = arrays["spin"].reshape(-1, 3)[:, 2 if shown.ndim == 2 else 0 :]
    assert spin.ravel() == pytest.approx(shown.ravel(), rel=1e-7, abs=1e-37)
    assert arrays["state"].tolist() == rows.contacts["state"].values.tolist()
    assert arrays["path"].tolist() == rows.structure.network.path.tolist()
    assert facts["shape"] == list(rows.answer.scene.lattice.shape)
    assert facts["proven"] == (name != "dynamics")
    assert facts["subtitle"].endswith("contact states proven") == (name != "dynamics")
    assert facts["title"].endswith(f", seed {rows.answer.scene.seeds[0]}")
    if name == "dynamics":
        assert arrays["snapshot_slip"].reshape(3, -1) == pytest.approx(rows.moments.slip, rel=1e-7)


def test_a_page_names_no_address_and_carries_the_licence_of_its_library(minimum, tmp_path):
    page = page_of(minimum, tmp_path)
    assert "://" not in page
    assert not re.findall(r"\b(?:src|href)=\"(?!data:,)", page)
    assert "The MIT License" in page
    assert "three.js authors" in page
    assert "Copyright 2010-2026 Three.js Authors" in held_by(page)[2]
    assert "@@" not in page


def test_a_run_of_a_packing_has_one_sample(packed, tmp_path):
    with pytest.raises(InputError, match="replica is 1; the run has 1 replica, numbered from 0"):
        view(packed, tmp_path / "page.html", replica=1)
    assert not list(tmp_path.iterdir())
