"""What a notebook shows: a table of everything that can be shown, and while it waits how far a solve is."""

import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings import progress
from taichi_bearings.words import MOST_ROWS, html_table


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


class Notebook:
    """Stands for the kernel: keeps what one line is told to show."""

    def __init__(self):
        self.told = []

    def display(self, data, raw, display_id):
        assert raw
        assert display_id
        self.update(data, raw)
        return self

    def update(self, data, raw):
        self.told.append(data["text/plain"])


@pytest.fixture
def notebook(monkeypatch):
    made = Notebook()
    monkeypatch.setattr(progress, "QUIET_SECONDS", 0.0)
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=made.display))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=1)))
    return made


def slowly(check):
    """So that there is time to look."""
    return np.isfinite(check.power) and not progress.threading.Event().wait(0.05) and check.iteration > 300


def test_a_notebook_is_told_how_far_a_solve_is_until_it_ends(notebook, needs_f64, capfd):
    scene = tb.Scene.random((5, 5), seed=1)
    tb.solve(scene, "gradient-descent", 1e-9, callback=slowly, threads=1)
    assert notebook.told[-1] == ""
    assert any(re.search(r"solving.*iterations, P = [\d.]+, gap", line) for line in notebook.told)
    assert capfd.readouterr() == ("", "")
    before = len(notebook.told)
    tb.solve(scene, "gradient-descent", 1e-9, callback=slowly, progress=False, threads=1)
    assert len(notebook.told) == before


def test_nothing_is_shown_in_a_pipe(monkeypatch, capfd, needs_f64):
    monkeypatch.setattr(progress, "QUIET_SECONDS", 0.0)
    tb.solve(tb.Scene.random((5, 5), seed=1), "gradient-descent", 1e-9, callback=slowly, threads=1)
    assert capfd.readouterr() == ("", "")
