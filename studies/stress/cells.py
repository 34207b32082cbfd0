"""One cell of stress: solved in a worker process, and judged by a truth that shares nothing with what solved it."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from math import isfinite, nan, prod
from typing import Any

import numpy as np

from taichi_bearings import api
from taichi_bearings.errors import DeviceError, InputError
from taichi_bearings.files.scan_file import FAILED
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Scene, Status
from taichi_bearings.version import VERSION

from .axes import AXES, ROWS, Cell
from .truth import SLIPLESS, SLIPPING, Truth, layered, least

RIGHT, NOT_REACHED, REFUSED, WRONG, CRASH = OUTCOMES = ("right", "not reached", "refused", "wrong", "crash")
TOLERANCE = 1e-8
ROUNDING = 1e-13  # relative: of powers and bounds in double precision
BELIEVED = 1e-4  # relative error up to which a dynamics may say that it has come to rest, or to its duration
MEMORY_SHARE = 0.7  # of what the machine has, that a cell may be expected to need


@dataclass(frozen=True)
class Task:
    """A cell as the workers of scans take it."""

    cell: Cell

    @property
    def key(self) -> str:
        return self.cell.key

    label = key

    @property
    def settings(self) -> RunSettings:
        row = self.cell.row
        threads = self.cell.value if self.cell.axis == "threads" else 1
        return RunSettings(arch=row.arch, precision=row.precision, threads=threads)


@dataclass(frozen=True)
class Answer:
    """What a solve has claimed; energies in energy/time. state : of each contact, an array an axis."""

    status: str
    reached: bool
    objective: float
    lower_bound: float
    gap: float
    states_proven: bool
    state: tuple[np.ndarray, ...]
    seconds: float


def solve_tasks(tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """In a worker: the answer of each cell, or the sentence that refuses it; anything else ends the worker."""
    records = []
    for task in tasks:
        record: dict[str, Any] = {"key": task.key, "scalars": {"status": "solved"}}
        try:
            record["answer"] = _solve(task)
        except (InputError, DeviceError) as error:
            record["refusal"] = str(error)
        except BaseException as error:
            record |= {"scalars": {"status": FAILED}, "crash": f"{type(error).__name__}: {error}"}
        records.append(record)
    return records


def _solve(task: Task) -> Answer:
    cell, case, device = task.cell, task.cell.case, task.settings
    memory = bytes_of(cell)
    if memory > MEMORY_SHARE * _memory():
        raise InputError(f"it needs about {memory / 1e9:.1f} GB, more than {MEMORY_SHARE:.0%} of this machine's memory")
    method = "auto" if cell.row.method == "auto" else ROWS[cell.row.method](**case.options)
    settings = {"time_limit": cell.most_seconds, "tolerance": TOLERANCE, **case.settings}
    settings |= {"arch": device.arch, "precision": device.precision, "threads": device.threads}
    with one_thread():
        found = api.solve(case.scene, method, **settings)
    return Answer(found.status, found.reached, found.potential, found.lower_bound, found.gap, found.states_proven,
                  found.state, found.seconds)  # fmt: skip


NUMBERS = ("objective", "lower_bound", "gap", "seconds")


def stored(cell: Cell, record: dict[str, Any]) -> dict[str, Any]:
    """A record of :func:`solve_tasks` as a journal keeps it: what was claimed, with the version, and no verdict."""
    kept = {"key": cell.key, "version": VERSION}
    kept |= {name: record[name] for name in ("refusal", "crash") if name in record}
    answer = record.get("answer")
    if answer is None:
        return kept
    told = {"status": str(answer.status), "reached": bool(answer.reached), "states_proven": bool(answer.states_proven)}
    told |= {name: float(getattr(answer, name)).hex() for name in NUMBERS}
    if not cell.case.is_layered:  # whose truth has no states
        told["state"] = "".join(str(int(one)) for part in answer.state for one in part.ravel())
    return kept | {"answer": told}


def restored(cell: Cell, kept: dict[str, Any]) -> dict[str, Any] | None:
    """The record that was kept of a cell, to be judged anew; None if it is of another version or is no such record."""
    if kept.get("version") != VERSION:
        return None
    if "answer" not in kept:
        words = [kept[name] for name in ("refusal", "crash") if name in kept]
        return kept if words and all(isinstance(text, str) and text.isprintable() for text in words) else None
    try:
        told = kept["answer"]
        numbers = {name: float.fromhex(told[name]) for name in NUMBERS}
        reached, proven = ({True: True, False: False}[told[name]] for name in ("reached", "states_proven"))
        state = () if cell.case.is_layered else _states_of(cell.case.scene, told["state"])
        status = Status(told["status"]).value
        return {"answer": Answer(status, reached, states_proven=proven, state=state, **numbers)}
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError):
        return None


def _states_of(scene: Scene, digits: str) -> tuple[np.ndarray, ...]:
    """The states of all contacts, an array an axis, from a digit for each; ValueError if these are none."""
    state = np.array([int(digit) for digit in digits], dtype=np.uint8)
    if (state > max(ContactState)).any() or not digits.isascii():
        raise ValueError
    parts = np.split(state, np.cumsum([part.size for part in scene.coefficients])[:-1])
    return tuple(one.reshape(part.shape) for one, part in zip(parts, scene.coefficients, strict=True))


def bytes_of(cell: Cell) -> float:
    """Memory of a solve and of its proof, roughly."""
    sites = prod(cell.case.scene.lattice.shape)
    return 200e6 + 1500 * sites + ROWS[cell.row.method].bytes(sites)


def _memory() -> float:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 8e9


@dataclass
class Judge:
    """Says what a record of :func:`solve_tasks` is worth; truths are found once."""

    truths: dict[Any, Truth] = field(default_factory=dict)

    def row(self, cell: Cell, record: dict[str, Any]) -> dict[str, Any]:
        """A row of the report. reason : why it is wrong, refused or a crash."""
        of, answer = cell.row, record.get("answer")
        row: dict[str, Any] = {
            "key": cell.key, "axis": cell.axis, "value": cell.label, "method": of.method, "law": of.law,
            "dimension": of.dimension, "arch": of.arch, "precision": of.precision, "outcome": "", "status": "none",
            "error": None, "gap": None, "states_wrong": None, "states_unproven": None, "states_proven": None,
            "objective": None, "truth": None, "unit": cell.case.unit if answer else 1.0, "seconds": None, "reason": "",
        }  # fmt: skip
        if answer is None:
            row["reason"] = record.get("crash") or record["refusal"]
            late = row["reason"].startswith("no result within") and AXES[cell.axis].patience > 1
            return row | {"outcome": NOT_REACHED if late else CRASH if "crash" in record else REFUSED}
        finite = {"gap": answer.gap, "objective": answer.objective, "seconds": answer.seconds}
        row |= {name: value if isfinite(value) else None for name, value in finite.items()}
        row |= {"status": answer.status, "states_proven": bool(answer.states_proven)}
        if cell.case.refusal:
            return row | {"outcome": WRONG, "reason": "it was not refused"}
        truth = self._truth(cell)
        row |= {"truth": float(truth.upper), "error": _error(truth, answer.objective)}
        row |= dict(zip(("states_wrong", "states_unproven"), _states(truth, answer), strict=True))
        row["reason"] = _fault(truth, answer, row)
        at_rest = answer.reached and (answer.status != "finished" or row["error"] <= BELIEVED)
        return row | {"outcome": WRONG if row["reason"] else RIGHT if at_rest else NOT_REACHED}

    def _truth(self, cell: Cell) -> Truth:
        scene, unit = cell.case.in_plain_units, Decimal(cell.case.unit)
        arrays = (values.tobytes() for values in (*scene.coefficients, *scene.viscosity))
        key = (scene.law, *arrays, *(getattr(scene, name) for name in Scene.PARAMETERS))
        if key not in self.truths:
            self.truths[key] = (layered if cell.case.is_layered else least)(scene)
        plain = self.truths[key]
        return replace(plain, lower=plain.lower * unit, upper=plain.upper * unit, unit=plain.unit * unit)


def _error(truth: Truth, objective: float) -> float | None:
    """(objective - least) / objective, at least 0; None if it is no number. Over the unit of the truth if that is 0."""
    if not isfinite(objective):
        return None
    value = Decimal(objective)
    return float(max((value - truth.upper) / max(abs(value), truth.unit), Decimal(0))) if value else 0.0


def _states(truth: Truth, answer: Answer) -> tuple[int | None, int | None]:
    """Contacts whose state is not the true one, and contacts of which no state is proven; None where nobody knows."""
    if not truth.state:
        return None, None
    pairs = list(zip(truth.state, answer.state, strict=True))
    wrong = sum(int(((true == SLIPPING) & (said == SLIPLESS) | (true == SLIPLESS) & (said == SLIPPING)).sum())
                for true, said in pairs)  # fmt: skip
    return wrong, 0 if answer.states_proven else sum(int((said <= SLIPPING).sum() + (said == 2).sum())
                                                     for _, said in pairs)  # fmt: skip


def _fault(truth: Truth, answer: Answer, row: dict[str, Any]) -> str:
    """What is wrong with an answer that does not say so itself; empty if nothing is."""
    slack, error = Decimal(1 + ROUNDING), row["error"]
    if isfinite(answer.lower_bound) and Decimal(answer.lower_bound) > truth.upper * slack:
        return f"the bound {answer.lower_bound!r} is above the least value {float(truth.upper)!r}"
    if error is not None and Decimal(answer.objective) * slack < truth.lower:
        return f"the value {answer.objective!r} is below the least one {float(truth.lower)!r}"
    if answer.states_proven and row["states_wrong"]:
        return f"{row['states_wrong']} contact states are proven that are not true"
    if not answer.reached:
        return ""
    allowed = TOLERANCE if answer.status == "certified" else BELIEVED
    if answer.status == "finished":  # its time has passed: how far it still is from rest, it says itself
        allowed = max(allowed, answer.gap)
    if error is None or error > allowed * (1 + ROUNDING):
        return f"it is {answer.status} with an error of {error if error is not None else nan:.1e}"
    return ""
