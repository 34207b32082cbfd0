"""The architecture: a file imports from lower floors or its own folder, never upwards or sideways."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLOOR = {
    "errors": 0, "version": 0, "devices": 0, "stages": 0, "words": 0, "runtime": 1, "lattice": 1, "scene": 2,
    "certificate": 3, "contact_state": 4, "fields": 2, "kernels": 4, "cholesky": 5, "solvers": 6, "analysis": 7,
    "files": 7, "plots": 8, "studies": 9, "blas": 0, "checksums": 1, "double_double": 0,
    "verifier": 1, "nested_dissection": 1,
    "planar": 0, "minimum_cut": 1,
}  # fmt: skip
FILES = sorted((ROOT / "taichi_bearings").rglob("*.py"))


def floor_name(path: Path) -> str:
    first = path.relative_to(ROOT / "taichi_bearings").parts[0]
    return first.removesuffix(".py")


def imported_modules(path: Path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} uses a relative import"
            yield node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


@pytest.mark.parametrize(
    "path", [f for f in FILES if f.parent.name != "taichi_bearings" or f.stem != "__init__"], ids=str
)
def test_imports_only_go_down(path):
    here = floor_name(path)
    for module in imported_modules(path):
        if not module.startswith("taichi_bearings."):
            assert not module.startswith("taichi_bearings_cli"), f"{path} must not know the command line"
            continue
        there = module.split(".")[1]
        assert there == here or FLOOR[there] < FLOOR[here], f"{path}: {here} must not import {there}"


@pytest.mark.parametrize(
    "floor", ["lattice", "minimum_cut", "scene", "certificate", "contact_state", "analysis", "files", "plots"]
)
def test_taichi_stays_out_of(floor):
    for path in FILES:
        if floor_name(path) == floor:
            assert not any(m == "taichi" or m.startswith("taichi.") for m in imported_modules(path)), path
