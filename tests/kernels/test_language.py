"""Which parts of the compiler's language the package uses: those that decision 8 lists, which both compilers have."""

import ast
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from taichi_bearings import compiler

ROOT = Path(__file__).parents[2]
LISTED = set(re.findall(r"`(ti\.[\w.]+)`", (ROOT / "docs/decisions.md").read_text(encoding="utf-8")))


def full_name(node):
    """`ti.a.b` of an expression that is just that, else None."""
    if isinstance(node, ast.Name):
        return "ti" if node.id == "ti" else None
    of = full_name(node.value) if isinstance(node, ast.Attribute) else None
    return of and f"{of}.{node.attr}"


def test_the_page_lists_what_kernels_use():
    used = set()
    for file in (ROOT / "taichi_bearings").rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        inner = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        used |= {full_name(node) for node in ast.walk(tree) if id(node) not in inner} - {None, "ti"}
    assert used == LISTED


@pytest.mark.parametrize("name", compiler.KERNEL_CACHES)
def test_compilers_have_it(name):
    if importlib.util.find_spec(name) is None:
        pytest.skip(f"{name} is not installed here")
    program = f"import operator, {name} as ti; [operator.attrgetter(n[3:])(ti) for n in {sorted(LISTED)}]"
    environment = os.environ | compiler.QUIET
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, timeout=300)
    assert done.returncode == 0, done.stderr
