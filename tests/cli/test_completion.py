"""What the Tab key offers, by the very protocol that click's scripts for bash, zsh and fish speak."""

import pytest
from click.shell_completion import BashComplete, FishComplete, ZshComplete
from taichi_bearings_cli.main import bearings

from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers.table import METHODS


def offered(*words, shell=BashComplete):
    *before, last = words
    complete = shell(bearings, {}, "bearings", "_BEARINGS_COMPLETE")
    return [(item.type, item.value) for item in complete.get_completions(list(before), last)]


@pytest.mark.parametrize("shell", [BashComplete, ZshComplete, FishComplete])
def test_commands_options_and_names_of_tables_are_completed(shell):
    assert ("plain", "verify") in offered("ve", shell=shell)
    assert offered("run", "--meth", shell=shell) == [("plain", "--method")]
    assert [name for _, name in offered("run", "--law", "", shell=shell)] == list(LAWS)
    assert [name for _, name in offered("run", "--method", "", shell=shell)] == ["auto", *METHODS]
    assert ("plain", "network") in offered("plot", "n", shell=shell)


@pytest.mark.parametrize(
    "words",
    [("run", ""), ("run", "--coefficients", ""), ("scan", ""), ("plot", "spins", ""), ("analyse", ""), ("verify", "")]
    + [("histogram", "a", ""), ("run", "--out", ""), ("run", "--resume", "")]
    + [("view", ""), ("view", "a", "--out", ""), ("export", ""), ("movie", ""), ("list", "")],
)
def test_files_are_completed_where_files_are_wanted(words):
    assert offered(*words) == [("file", "")]


def test_numbers_are_not_completed():
    assert offered("run", "--seed", "") == []
