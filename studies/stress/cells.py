"""One cell of stress (a sample, a method and one extreme value): solved in a worker process, and judged by an exact
minimum that shares no code with what solved it.

A *record* is what a worker returns on a cell, as the journal keeps it; a *row* is a line of the report. The truth of a
cell is the exact minimum of its sample (:mod:`.truth`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from math import inf, nan
from typing import Any

import numpy as np

from taichi_bearings import api
from taichi_bearings.errors import DeviceError, InputError, printable
from taichi_bearings.files.scan_file import FAILED
from taichi_bearings.memory import free_bytes
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import plain
from taichi_bearings.scene import Status
from taichi_bearings.version import VERSION

from .axes import AXES, ROWS, Cell
from .truth import SLIPLESS, SLIPPING, Truth, layered, least

RIGHT, NOT_REACHED, REFUSED, WRONG, CRASH = OUTCOMES = ("right", "not reached", "refused", "wrong", "crash")
TOLERANCE = 1e-8
ROUNDING = 1e-13  # relative rounding of powers and bounds in double precision
BELIEVED = 1e-4  # largest relative error of a dynamics that is at the minimum: at rest, or when its time has passed
MEMORY_SHARE = 0.7  # most of the free memory that a cell may be expected to need


def solve_cells(cells: Sequence[Cell]) -> list[dict[str, Any]]:
    """Solve cells in a worker process, and return a record of each: a dictionary with its key and version, and one of

    * `answer`: what the solve claims (see :func:`_solve`);
    * `refusal`: the sentence with which the input was refused;
    * `crash`: any other error, in words.
    """
    records = []
    for cell in cells:
        record: dict[str, Any] = {"key": cell.key, "version": VERSION, "scalars": {"status": "solved"}}
        try:
            record["answer"] = _solve(cell)
        except (InputError, DeviceError) as error:
            record["refusal"] = str(error)
        except BaseException as error:
            record |= {"scalars": {"status": FAILED}, "crash": f"{type(error).__name__}: {error}"}
        records.append(record)
    return records


def _solve(cell: Cell) -> dict[str, Any]:
    """Return what a solve claims, in types that JSON has.

    status, reached, states_proven, seconds : attributes of the Result.
    objective, lower_bound : energy/time; None where they are not finite.
    gap : relative gap.
    state : a digit for each contact, its state; "" where the truth of the cell has no states.

    Raises InputError if the cell needs more than MEMORY_SHARE of the free memory.
    """
    case, device, most = cell.case, cell.settings, MEMORY_SHARE * free_bytes()
    if (needed := bytes_of(cell)) > most:
        wanted, allowed = f"{needed / 1e9:.1f} GB", f"{most / 1e9:.1f} GB"
        raise InputError(f"the solve needs about {wanted} of memory; at most {allowed} is allowed")
    method = "auto" if cell.row.method == "auto" else ROWS[cell.row.method](**case.options)
    settings = {"time_limit": cell.most_seconds, "tolerance": TOLERANCE, **case.settings}
    settings |= {"arch": device.arch, "precision": device.precision, "threads": device.threads}
    with one_thread():
        found = api.solve(case.scene, method, **settings)
    claimed = {
        name: plain(getattr(found, name)) for name in ("reached", "states_proven", "lower_bound", "gap", "seconds")
    }
    state = "" if case.is_layered else "".join(str(int(one)) for part in found.state for one in part.flat)
    return claimed | {"status": str(found.status), "objective": plain(found.potential), "state": state}


def bytes_of(cell: Cell) -> float:
    """Return roughly the bytes of memory that the solve of a cell and its proof need."""
    lattice = cell.case.scene.lattice
    return 200e6 + cell.case.scene.replicas * ROWS[cell.row.method].bytes(lattice.shape, lattice.periodic)


@dataclass
class Judge:
    """Compares what worker processes have found with the exact minimum (the truth) of each cell, one extreme value of a
    parameter for one method.

    truths : the exact minima found so far. The key is all that determines the sample, so that each is found once.
    """

    truths: dict[Any, Truth] = field(default_factory=dict)

    def row(self, cell: Cell, record: Mapping[str, Any]) -> dict[str, Any]:
        """Return the row of the report on a cell (a method on a sample with one extreme value of a parameter), by
        column. Columns that are not known are None.

        cell : the cell.
        record : what the worker has returned: the `answer` of the solve, its `refusal` in words, or its `crash` in
            words.

        * key, axis, value, and what `Row` has: which cell it is.
        * outcome: one of OUTCOMES.
        * reason: why it is wrong, refused or a crash; else "".
        * status, objective, gap, seconds, states_proven: those of the answer.
        * unit: energy/time, the unit of its objective.
        * truth, error: the true least objective, and the relative error of the answer.
        * states_wrong: number of slipless contacts that are said to slip, and the other way round.
        * states_unproven: number of contacts without a proven state.
        """
        unknown = ("error", "gap", "states_wrong", "states_unproven", "states_proven", "objective", "truth")
        row: dict[str, Any] = {
            "key": cell.key, "axis": cell.axis, "value": cell.column, **vars(cell.row), "outcome": "", "status": "none",
            **dict.fromkeys(unknown), "unit": 1.0, "seconds": None, "reason": "",
        }  # fmt: skip
        if "answer" not in record:
            row["reason"] = printable(record["crash"] if "crash" in record else record["refusal"])
            late = row["reason"].startswith("no result within") and AXES[cell.axis].patience > 1
            return row | {"outcome": NOT_REACHED if late else CRASH if "crash" in record else REFUSED}
        answer = record["answer"]
        row |= {name: answer[name] for name in ("objective", "gap", "seconds", "states_proven")}
        row |= {"unit": cell.case.unit, "status": Status(answer["status"]).value}
        if cell.case.refusal:
            return row | {"outcome": WRONG, "reason": "it was not refused"}
        truth = self._truth(cell)
        row |= {"truth": float(truth.upper), "error": _error(truth, answer["objective"])}
        if truth.state:
            true, found = cell.case.scene.lattice.flat(truth.state), np.array([int(digit) for digit in answer["state"]])
            wrong = (true == SLIPPING) & (found == SLIPLESS) | (true == SLIPLESS) & (found == SLIPPING)
            unproven = 0 if answer["states_proven"] else int((found != ContactState.DRIVEN).sum())
            row |= {"states_wrong": int(wrong.sum()), "states_unproven": unproven}
        row["reason"] = _fault(truth, answer, row)
        # a dynamics that has reached its duration need not be at the minimum
        at_minimum = answer["reached"] and (answer["status"] != "finished" or row["error"] <= BELIEVED)
        return row | {"outcome": WRONG if row["reason"] else RIGHT if at_minimum else NOT_REACHED}

    def _truth(self, cell: Cell) -> Truth:
        """Return bounds of the least objective of a cell's sample, and the contact states at its minimum, in the units
        of the cell. If they were found before, of the same sample perhaps in other units, they are used again.

        cell : the cell.
        """
        scene, unit = cell.case.in_plain_units, Decimal(cell.case.unit)
        arrays = (values.tobytes() for values in (*scene.coefficients, *scene.viscosity))
        key = (scene.law, *arrays, *(getattr(scene, name) for name in scene.PARAMETERS))
        if key not in self.truths:
            self.truths[key] = (layered if cell.case.is_layered else least)(scene)
        truth = self.truths[key]
        return replace(truth, lower=truth.lower * unit, upper=truth.upper * unit, unit=truth.unit * unit)


def _error(truth: Truth, objective: float | None) -> float | None:
    """Return the relative error (objective - least value) / |objective|, at least 0; None without an objective. If
    |objective| is below the unit of the truth, that unit is the divisor.
    """
    if objective is None:
        return None
    value = Decimal(objective)
    return float(max((value - truth.upper) / max(abs(value), truth.unit), Decimal(0))) if value else 0.0


def _fault(truth: Truth, answer: Mapping[str, Any], row: dict[str, Any]) -> str:
    """Return in words what is wrong with an answer; "" if nothing is. An answer is wrong if

    * its bound is above the least value, or its objective is below it;
    * it calls contact states proven that are not true;
    * it claims to have reached the minimum, and its error is too large.

    truth : bounds of the least objective.
    answer : what the solve claims: objective and lower bound, energy/time, gap, status, and whether states are proven.
    row : row of the report with `status`, `error` and `states_wrong`.
    """
    slack, value, bound, error = Decimal(1 + ROUNDING), answer["objective"], answer["lower_bound"], row["error"]
    if bound is not None and Decimal(bound) > truth.upper * slack:
        return f"the bound {bound!r} is above the least value {float(truth.upper)!r}"
    if value is not None and Decimal(value) * slack < truth.lower:
        return f"the value {value!r} is below the least one {float(truth.lower)!r}"
    if answer["states_proven"] and row["states_wrong"]:
        return f"{row['states_wrong']} contact states are proven that are not true"
    if not answer["reached"]:
        return ""
    allowed = TOLERANCE if answer["status"] == "certified" else BELIEVED
    if answer["status"] == "finished":  # a dynamics at its duration: its gap says how far from the minimum it may be
        allowed = inf if answer["gap"] is None else max(allowed, answer["gap"])
    if error is None or error > allowed * (1 + ROUNDING):
        return f"it is {row['status']} with an error of {nan if error is None else error:.1e}"
    return ""
