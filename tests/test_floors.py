"""The architecture: a file imports from lower floors or its own folder, never upwards or sideways."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLOOR = {
    "errors": 0, "version": 0, "devices": 0, "stages": 0, "words": 0, "read_only": 0, "later": 0,
    "leaving": 0, "dissection": 0,
    "interrupts": 1, "memory": 1, "plain_files": 1, "progress": 1, "text_lines": 2, "walks": 2,
    "compiler": 2, "copies": 2, "hdf5": 2, "options": 2, "lattice": 2, "runtime": 3,
    "checksums": 3, "fields": 4, "launch": 4,
    "kernels": 5, "numerics": 6, "scene": 7, "proof": 8, "conic": 8, "quantities": 9,
    "solvers": 10, "analysis": 11, "files": 12, "plots": 13, "runs": 14, "export": 15, "view": 15, "scans": 15,
    "api": 16,
}  # fmt: skip
FILES = sorted((ROOT / "taichi_bearings").rglob("*.py"))
STUDIES = sorted((ROOT / "studies").rglob("*.py"))
SHARED = {"report"}  # by all studies, which otherwise do not know each other


def floor_name(path: Path) -> str:
    first = path.relative_to(ROOT / "taichi_bearings").parts[0]
    return first.removesuffix(".py")


@cache
def imported_modules(path: Path) -> tuple[str, ...]:
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0 or path in STUDIES, f"{path} uses a relative import"
            found.append("." * node.level + (node.module or ""))
        elif isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
    return tuple(found)


def imports_of(files):
    """(file, module) of every import."""
    return [(path, module) for path in files for module in imported_modules(path)]


def test_imports_only_go_down():
    for path, module in imports_of([f for f in FILES if f.parent.name != "taichi_bearings" or f.stem != "__init__"]):
        here = floor_name(path)
        if not module.startswith("taichi_bearings."):
            beside = module.startswith(("taichi_bearings_cli", "taichi_bearings_studies"))
            assert not beside, f"{path} must not know the command line and the studies"
            continue
        there = module.split(".")[1]
        assert there == here or FLOOR[there] < FLOOR[here], f"{path}: {here} must not import {there}"


def test_studies_know_the_package_and_what_they_share():
    """By relative imports: as a folder beside the package they have another name than installed."""
    for path, module in imports_of(STUDIES):
        assert not module.startswith(("taichi_bearings_", "studies")), f"{path} must import {module} by a relative name"
        beyond = module.startswith("..") and module.lstrip(".").split(".")[0] not in {"", *SHARED}
        assert not beyond, f"{path} must not import {module}"


@pytest.mark.parametrize("floor", ["lattice", "scene", "proof", "analysis", "files", "plots"])
def test_taichi_stays_out_of(floor):
    for path in FILES:
        assert floor_name(path) != floor or "taichi_bearings.compiler" not in imported_modules(path), path


def test_taichi_is_imported_in_one_place():
    for path in FILES + STUDIES:
        assert not {"taichi", "quadrants"} & {module.split(".")[0] for module in imported_modules(path)}, path


ORACLES = ("proof/laboratory.py", "cuts.py", "exact_interfaces.py", "clarabel_twin.py")


@pytest.mark.parametrize("name", ORACLES)
def test_oracles_of_proofs_share_no_code_with_them(name):
    shared = {
        module for module in imported_modules(ROOT / "tests" / name) if module.startswith("taichi_bearings.proof")
    }
    assert not shared


FILES_AND_FIGURES = {"export", "files", "kernels", "lattice", "numerics", "plots", "view"}
"""Floors whose arrays or pictures have the shape of a lattice, or that work on its strides."""
OF_INPUT = {"api": 3, "runs.lattice_run": 2, "runs.run": 1, "runs.settings": 1, "scene.packing": 1, "scene.scene": 1}
"""Files that tell lattices from packings when input is read, with the number of their questions of kind."""
SLICES = {"proof.on_lattice": 1, "proof.slices": 1, "scene.interface": 2}
"""Modules that work on the slices of a lattice: its lightest cuts, and two of the proofs."""
FILES_OF_RUNS = {
    "runs.points_and_lines": 2, "runs.run_layout": 2, "runs.stored_structure": 4, "runs.structure_report": 1,
    "runs.writing": 1,
}  # fmt: skip
"""Modules that write or read arrays in files, in which those of a lattice have its shape or are split by axis."""
BEYOND = {
    "analysis.slipless_network": 1, "analysis.structure": 2, "runs.result": 2, "scans.histogram": 1,
    "solvers.method": 2,
}  # fmt: skip
"""Other modules."""
KIND = re.compile(
    r"\bof_(lattice|packing)\(|\b(network|whole|place)\.lattice\b|\bis_packing\b|cast\(Packing"
    r"|isinstance\([^()]*, \(?(Grid|Bearing|Scene|Packing)\b"
)
"""What asks whether something is a lattice or a packing, or takes it for one."""


def test_what_is_behind_the_front_doors_takes_any_bearing():
    """A question of kind is one more place to change for a third kind: what differs is said by the network, the driving
    and the graph of what is judged. The numbers get smaller."""
    heads, asked = re.compile(r"def \w+\("), {}
    for file in FILES:
        name = ".".join(file.relative_to(ROOT / "taichi_bearings").with_suffix("").parts)
        questions = len(KIND.findall(heads.sub("def (", file.read_text())))
        if questions and not name.startswith(tuple(f"{floor}." for floor in FILES_AND_FIGURES)):
            asked[name] = questions
    assert asked == OF_INPUT | SLICES | FILES_OF_RUNS | BEYOND
    assert not {name for name in BEYOND if name.startswith(("proof.", "conic."))}, "these take any network"
