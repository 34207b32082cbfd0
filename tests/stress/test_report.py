"""The sweep: its judge tells wrong answers from honest ones, and nothing that was found is lost."""

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from click.testing import CliRunner
from taichi_bearings_cli.main import bearings
from taichi_bearings_studies.stress import axes, cells
from taichi_bearings_studies.stress.axes import AXES, ROWS, Cell, Row, cells_of
from taichi_bearings_studies.stress.cells import CRASH, NOT_REACHED, REFUSED, RIGHT, WRONG, Judge, solve_cells
from taichi_bearings_studies.stress.report import draw_outcomes
from taichi_bearings_studies.stress.truth import least

from taichi_bearings.files.scan_journal import Journal, read_journal
from taichi_bearings.scene.law import LAWS

CELL = Cell("friction-scale", 1.0, Row("planar-cut", "coulomb", 2), 0, True, 1.0)


@pytest.fixture(scope="module")
def truth():
    return least(CELL.case.scene)


@pytest.fixture
def answer(truth):
    value, state = float(truth.upper), CELL.case.scene.lattice.flat(truth.state)
    return {
        "status": "certified", "reached": True, "states_proven": True, "objective": value, "gap": 1e-12, "seconds": 0.1,
        "lower_bound": value * (1 - 1e-12), "state": digits(np.where(state == 2, 0, state)),
    }  # fmt: skip


JUDGE = Judge()


def digits(state):
    return "".join(map(str, state.tolist()))


def judged(answer, cell=CELL):
    return JUDGE.row(cell, {"answer": answer})


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
    row = judged(answer | scaled)
    assert row["outcome"] == WRONG
    assert sentence in row["reason"]


def test_states_are_wrong_only_where_they_are_said_to_be_proven(answer):
    along_x = CELL.case.scene.lattice.axis == 0
    said = np.array([int(digit) for digit in answer["state"]])
    state = digits(np.where(along_x, said, 1 - said))
    row = judged(answer | {"state": state})
    assert row["outcome"] == WRONG
    assert row["states_wrong"] > 0
    row = judged(answer | {"state": state, "states_proven": False})
    assert row["outcome"] == RIGHT
    assert row["states_unproven"] > 0


def test_an_answer_that_says_so_may_be_far_off(answer):
    far = answer | {"objective": 3 * answer["objective"], "status": "time-limit", "reached": False}
    assert judged(far)["outcome"] == NOT_REACHED
    assert judged(far | dict.fromkeys(("objective", "lower_bound", "gap")))["outcome"] == NOT_REACHED


def test_a_finished_dynamics_may_be_as_far_off_as_it_says(answer):
    far = answer | {"objective": 1.01 * answer["objective"], "status": "finished", "gap": 0.0099}
    assert judged(far)["outcome"] == WRONG
    assert judged(far | {"gap": 0.0100})["outcome"] == NOT_REACHED
    assert judged(answer | {"status": "finished"})["outcome"] == RIGHT


def test_what_must_be_refused_is_wrong_if_it_is_not(answer):
    cell = replace(CELL, axis="start", value="NaN")
    assert judged(answer, cell)["outcome"] == WRONG
    assert JUDGE.row(cell, solve_cells([cell])[0])["outcome"] == REFUSED
    assert JUDGE.row(cell, {"crash": "the worker was ended by SIGSEGV"})["outcome"] == CRASH


def test_a_cell_beyond_the_memory_is_refused(monkeypatch):
    monkeypatch.setattr(cells, "MEMORY_SHARE", 1e-9)
    row = JUDGE.row(CELL, solve_cells([CELL])[0])
    assert row["outcome"] == REFUSED
    assert "the solve needs about 0.2 GB of memory; at most 0.0 GB is allowed" in row["reason"]


@pytest.mark.parametrize("name", [name for name in AXES if name.endswith("-scale")])
def test_scaled_samples_are_the_same_in_other_units(name):
    """Planar cuts and factorisations scale bit for bit, and so does the truth without its knowing."""
    for method, law in (("planar-cut", "coulomb"), ("linear-solver", "viscous")):
        if not AXES[name].rows(Row(method, law, 2)):
            continue
        plain, scaled = (Cell(name, value, Row(method, law, 2), 0, True, 60.0) for value in (1.0, 1e-12))
        found = [solve_cells([cell])[0]["answer"] for cell in (plain, scaled)]
        values = [one["objective"] for one in found]
        assert values[1] == values[0] * scaled.case.unit
        truths = [Fraction(least(cell.case.scene).upper) for cell in (plain, scaled)]
        assert abs(truths[1] / truths[0] / Fraction(scaled.case.unit) - 1) < 1e-40


def test_the_quick_form_of_one_axis_tries_every_method_and_that_of_all_stays_short():
    rows = [Row(method, law, 2) for method in ("interior-point", "planar-cut", "cundall-strack") for law in LAWS]
    tried = {(cell.row.method, cell.value) for cell in cells_of(rows, ["ties"], 0, True, 1.0)}
    assert tried == {(cell.row.method, cell.value) for cell in cells_of(rows, ["ties"], 0, False, 1.0)}
    everything = [Row(method, law, dimension) for method in ROWS for law in LAWS for dimension in (2, 3)]
    assert len(cells_of(everything, list(AXES), 0, True, 1.0)) < 150


def sweep(folder, *options):
    arguments = ["stress", "--quick", "--only", "start,ties", "--method", "linear-solver,planar-cut", "--workers", "1"]
    return CliRunner().invoke(bearings, [*arguments, "--out", str(folder), *options])


def test_a_sweep_goes_on_from_its_journal_and_a_wrong_cell_fails_it(tmp_path, monkeypatch):
    monkeypatch.setattr(axes, "QUICK_CELLS", 1)  # few cells
    first = sweep(tmp_path, "--json")
    assert first.exit_code == 0, first.output
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
    assert again.exit_code == 1  # it is judged anew, whatever the journal says
    assert f"WRONG {key}: the value -1.0 is below the least one" in again.stdout
    assert len(read_journal(tmp_path / "cells.jsonl")) == len(kept)
    strange = [record | of | {"key": one} for one, of in zip(kept, ({"version": "0.1"}, {"answer": 3}), strict=False)]
    with Journal(tmp_path / "cells.jsonl") as journal:
        journal.append(strange)
    again = sweep(tmp_path)
    assert again.exit_code == 0, again.output  # solved anew
    assert len((tmp_path / "cells.jsonl").read_bytes().splitlines()) == len(kept) + 1 + 2 * len(strange)


def test_the_columns_of_a_map_stand_in_order_and_cells_say_their_error():
    """Numbers grow from left to right whatever was done first; errors are powers of ten."""
    line = {"axis": "contrast", "method": "auto", "law": "coulomb", "dimension": 2, "arch": "cpu", "precision": "f64"}
    done = [("9", 3e-8), ("0", 1e-17), ("12", 2e-3)]
    lines = [line | {"value": value, "error": error, "outcome": RIGHT} for value, error in done]
    (axes,) = draw_outcomes(AXES["contrast"], lines).axes
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0", "9", "12"]
    assert {(text.get_position()[0], text.get_text()) for text in axes.texts} == {
        (0, "exact"),
        (1, "10⁻⁸"),
        (2, "10⁻³"),
    }
    assert AXES["driving"].columns == ["2", "1e-1", "1e-4", "1e-8", "1e-12", "1e-15", "an ulp", "equal"]
