"""The sweep: its judge tells wrong answers from honest ones, and nothing that was found is lost."""

import json
from dataclasses import replace

import numpy as np
import pytest
from taichi_bearings_studies.stress.axes import Cell, Row
from taichi_bearings_studies.stress.cells import CRASH, NOT_REACHED, REFUSED, RIGHT, WRONG, Answer, Judge, solve_cells
from taichi_bearings_studies.stress.truth import least

from taichi_bearings.files.scan_journal import Journal, read_journal
from tests.cli.commands import bearings

LAWS = ("coulomb", "viscous", "coulomb-viscous")
CELL = Cell("friction-scale", 1.0, Row("planar-cut", "coulomb", 2), 0, True, 1.0)


@pytest.fixture(scope="module")
def truth():
    return least(CELL.case.scene)


@pytest.fixture
def answer(truth):
    value, state = float(truth.upper), CELL.case.scene.lattice.flat(truth.state)
    return Answer(
        "certified", True, True, value, value * (1 - 1e-12), 1e-12, 0.1, digits(np.where(state == 2, 0, state))
    )


JUDGE = Judge()


def digits(state):
    return "".join(map(str, state.tolist()))


def judged(answer, cell=CELL):
    return JUDGE.row(cell, {"answer": vars(answer)})


def test_the_truth_itself_is_right(answer):
    row = judged(answer)
    assert (row["outcome"], row["reason"], row["states_wrong"]) == (RIGHT, "", 0)
    assert row["error"] < 1e-15


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"lower_bound": 1 + 1e-9}, "is above the least value"),
        ({"objective": 1 - 1e-9}, "is below the least one"),
        ({"objective": 1 + 1e-7}, "certified with an error of 1.0e-07"),
        ({"objective": 1 + 1e-3, "status": "stationary"}, "stationary with an error of 1.0e-03"),
        ({"objective": None}, "certified with an error of nan"),
    ],
)
def test_answers_that_claim_what_is_not_true_are_wrong(answer, truth, changes, sentence):
    scaled = {key: value * float(truth.upper) if isinstance(value, float) else value for key, value in changes.items()}
    row = judged(replace(answer, **scaled))
    assert row["outcome"] == WRONG
    assert sentence in row["reason"]


def test_states_are_wrong_only_where_they_are_said_to_be_proven(answer):
    along_x = CELL.case.scene.lattice.axis == 0
    said = np.array([int(digit) for digit in answer.state])
    state = digits(np.where(along_x, said, 1 - said))
    row = judged(replace(answer, state=state))
    assert row["outcome"] == WRONG
    assert row["states_wrong"] > 0
    row = judged(replace(answer, state=state, states_proven=False))
    assert row["outcome"] == RIGHT
    assert row["states_unproven"] > 0


def test_an_answer_that_says_so_may_be_far_off(answer):
    far = replace(answer, objective=3 * answer.objective, status="time-limit", reached=False)
    assert judged(far)["outcome"] == NOT_REACHED
    assert judged(replace(far, objective=None, lower_bound=None, gap=None))["outcome"] == NOT_REACHED


def test_a_finished_dynamics_may_be_as_far_off_as_it_says(answer):
    far = replace(answer, objective=1.01 * answer.objective, status="finished", gap=0.0099)
    assert judged(far)["outcome"] == WRONG
    assert judged(replace(far, gap=0.0100))["outcome"] == NOT_REACHED
    assert judged(replace(answer, status="finished"))["outcome"] == RIGHT


def test_what_must_be_refused_is_wrong_if_it_is_not(answer):
    cell = replace(CELL, axis="start", value="NaN")
    assert judged(answer, cell)["outcome"] == WRONG
    assert JUDGE.row(cell, solve_cells([cell])[0])["outcome"] == REFUSED
    assert JUDGE.row(cell, {"crash": "the worker was ended by SIGSEGV"})["outcome"] == CRASH


def sweep(folder, *options):
    arguments = ["stress", "--quick", "--only", "start,ties", "--method", "linear-solver,planar-cut", "--workers", "1"]
    return bearings(*arguments, "--out", folder, *options)


def test_a_sweep_goes_on_from_its_journal_and_a_wrong_cell_fails_it(tmp_path):
    first = sweep(tmp_path, "--json")
    assert first.returncode == 0, first.stderr
    summary = json.loads(first.stdout)
    assert summary["done"] == summary["cells"] > 0
    assert summary["outcomes"]["wrong"] == summary["outcomes"]["crash"] == 0
    assert {path.name for path in tmp_path.iterdir()} >= {"stress.csv", "summary.json", "cells.jsonl"}
    assert any(path.suffix == ".png" for path in tmp_path.iterdir())
    kept = read_journal(tmp_path / "cells.jsonl")
    key, record = next((key, record) for key, record in kept.items() if "answer" in record)
    too_low = record | {"answer": record["answer"] | {"objective": -1.0}, "outcome": RIGHT}
    with Journal(tmp_path / "cells.jsonl") as journal:
        journal.append([too_low])
    again = sweep(tmp_path)
    assert again.returncode == 1  # it is judged anew, whatever the journal says
    assert f"RED {key}: the value -1.0 is below the least one" in again.stdout
    assert len(read_journal(tmp_path / "cells.jsonl")) == len(kept)
    strange = [record | of | {"key": one} for one, of in zip(kept, ({"version": "0.1"}, {"answer": 3}), strict=False)]
    with Journal(tmp_path / "cells.jsonl") as journal:
        journal.append(strange)
    again = sweep(tmp_path)
    assert again.returncode == 0, again.stderr  # solved anew
    assert len((tmp_path / "cells.jsonl").read_bytes().splitlines()) == len(kept) + 1 + 2 * len(strange)
