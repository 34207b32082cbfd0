"""The architecture: a file imports from lower floors or its own folder, never upwards or sideways."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLOOR = {
    "errors": 0, "version": 0, "devices": 0, "stages": 0, "words": 0, "checksums": 1, "options": 1, "runtime": 1,
    "lattice": 1, "verifier": 2, "fields": 2, "kernels": 3, "numerics": 4, "scene": 5, "proof": 6, "conic": 7,
    "solvers": 8, "analysis": 9, "files": 10, "plots": 11, "runs": 12, "scans": 13, "paper": 14, "benchmarks": 14,
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


@pytest.mark.parametrize("floor", ["lattice", "scene", "proof", "analysis", "files", "plots"])
def test_taichi_stays_out_of(floor):
    for path in FILES:
        if floor_name(path) == floor:
            assert not any(m == "taichi" or m.startswith("taichi.") for m in imported_modules(path)), path
