"""A module constant has one meaning: no name in capitals is given to two different things in the package."""

import ast
from collections import defaultdict
from pathlib import Path

import taichi_bearings_cli

import taichi_bearings

ONE_MEANING = {
    "AXES", "EPS", "TINY",
}  # the same thing in each of its modules  # fmt: skip


def constants(source: Path) -> set[str]:
    """Names in capitals that a module binds at its top level."""
    targets = []
    for statement in ast.parse(source.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Assign):
            targets += statement.targets
        elif isinstance(statement, ast.AnnAssign):
            targets.append(statement.target)
    names = {node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)}
    return {name for name in names if name.isupper()}


def test_no_constant_has_two_meanings():
    homes = defaultdict(list)
    for package in (taichi_bearings, taichi_bearings_cli):
        root = Path(package.__path__[0])
        for source in sorted(root.rglob("*.py")):
            for name in constants(source):
                homes[name].append(source.relative_to(root.parent).as_posix())
    assert len(homes) > 300
    several = {name: found for name, found in homes.items() if len(found) > 1}
    assert several.keys() - ONE_MEANING == set(), several
    assert ONE_MEANING - several.keys() == set(), "names that stand once need no exception"
