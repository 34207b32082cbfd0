"""What a notebook shows: a table of everything that can be shown, and while it waits how far a solve is."""

import re

import taichi_bearings as tb
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
