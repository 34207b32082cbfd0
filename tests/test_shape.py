"""The shape of the code: short functions with few arguments, no circles of imports, no documents that nobody has."""

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "taichi_bearings": ROOT / "taichi_bearings", "taichi_bearings_cli": ROOT / "cli",
    "taichi_bearings_studies": ROOT / "studies",
}  # fmt: skip
MODULES = {
    ".".join((package, *path.relative_to(folder).with_suffix("").parts)).removesuffix(".__init__"): path
    for package, folder in FOLDERS.items()
    for path in sorted(folder.rglob("*.py"))
}
MOST_LINES, MOST_ARGUMENTS = 60, 8
ABSENT = "PHYS" + "ICS"


@cache
def trees():
    """Syntax tree of every module."""
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}


@cache
def functions():
    """Full name and syntax tree of every function."""
    return [
        (f"{name}.{node.name}", node)
        for name, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    ]


def test_functions_are_short():
    lengths = {name: node.end_lineno - node.lineno + 1 for name, node in functions()}
    assert {name: length for name, length in lengths.items() if length >= MOST_LINES} == {}


def arguments(node):
    """Names of the arguments that a caller gives."""
    names = [argument.arg for argument in node.args.posonlyargs + node.args.args + node.args.kwonlyargs]
    return names[1:] if names[:1] in (["self"], ["cls"]) else names


def test_functions_take_few_arguments():
    """But kernels, which take numbers one by one."""
    numbers = {name: len(arguments(node)) for name, node in functions() if not re.search(r"\.kernels\.", name)}
    assert {name: number for name, number in numbers.items() if number > MOST_ARGUMENTS} == {}


def executed(node):
    """The parts of a module that run: all but what is for type checkers alone."""
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING"):
            yield child
            yield from executed(child)


def imported(name, tree):
    """Modules of ours that a module imports, within functions too."""
    for node in executed(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom):
            above = [name.rsplit(".", node.level)[0]] if node.level else []
            module = ".".join(filter(None, [*above, node.module]))
            parts = [f"{module}.{alias.name}" for alias in node.names] if module in MODULES else []
            yield from (part if part in MODULES else module for part in parts)


def test_no_imports_go_in_circles():
    graph = {name: {there for there in imported(name, tree) if there != name} for name, tree in trees().items()}
    try:
        list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_nothing_points_to_a_document_that_is_not_here():
    files = [*MODULES.values(), *(ROOT / "tests").rglob("*.py")]
    assert [path for path in files if ABSENT in path.read_text(encoding="utf-8")] == []
