"""The program in a hundred lines finds the least power of the package, and its page quotes all of it."""

import ast
import re

import pytest

import taichi_bearings as tb
from tests.cli.commands import script
from tests.handbook.pages import ROOT, blocks, text_of

TOY = ROOT / "examples/bearings_in_100_lines.py"


@pytest.mark.parametrize(("shape", "words"), [((4, 5, 6), ("4", "5", "6", "2")), ((8, 7), ("8", "1", "7", "3"))])
def test_it_agrees_with_the_package(shape, words, tmp_path, needs_f64):
    least = tb.solve(tb.Scene.random(shape, seed=int(words[-1])), tolerance=1e-10, threads=1)
    done = script(TOY, *words, cwd=tmp_path, alone=True)
    assert done.returncode == 0, done.stderr
    power, bound = map(float, re.search(r"power (\S+), and no less than (\S+) is", done.stdout).groups())
    digits = 1e-8 * least.power  # that are not printed
    assert bound - digits <= least.power <= power + digits
    assert power == pytest.approx(least.power, rel=1e-6)
    assert bound == pytest.approx(least.power, rel=1e-6)
    assert (tmp_path / "bearing.png").read_bytes().startswith(b"\x89PNG")


def test_it_is_a_hundred_lines_of_taichi_and_numpy():
    text = TOY.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 100
    imported = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import | ast.ImportFrom)]
    assert {name.name for node in imported for name in node.names} == {"sys", "numpy", "taichi"}


def test_the_page_explains_every_line():
    quoted = [text for language, text in blocks(text_of(ROOT / "docs/toy.md")) if language == "py"]
    lines = [line for line in TOY.read_text(encoding="utf-8").splitlines() if line]
    assert [line for text in quoted for line in text.splitlines() if line] == lines
