"""Lists what the run and scan folders below a folder hold, from summaries and journals alone: `bearings list`."""

import contextlib
import re
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from taichi_bearings.errors import BearingsError, InputError
from taichi_bearings.files.scan_file import FAILED
from taichi_bearings.plain_files import Json, read_json, read_lines
from taichi_bearings.scans.parts import journals_in
from taichi_bearings.scans.plan import count_samples
from taichi_bearings.words import counted, driving_words, listed, sized

RUN_KIND, SCAN_KIND = "run", "scan"
RUN_FILES = ("run.h5", "summary.json", "checkpoint.h5")  # files that hold its results
STRESS_TABLE = "stress.csv"  # in the folder of `bearings stress`, which has a summary of its own
# key and status of a sample in a line of a journal, found without reading the JSON
RECORD = re.compile(rb'\{"crc32": "[0-9a-f]{8}", "sample": \{"key": "([^"]+)".*?"status": "([^"]*)"')
SUMMARY_KEYS = {  # keys of a summary that are listed: their type, and whether None is allowed
    "law": (str, False), "method": (str, False), "seed": (int, False), "status": (str, False), "power": (float, True),
    "shape": (int, True), "spheres": (int, True), "gap": (float, True), "power_normalised": (float, True),
    "states_proven": (bool, True), "coefficients": (str, True), "periodic": (str, True), "top": (float, True),
    "bottom": (float, True), "driven": (str, True),
}  # fmt: skip
LARGEST_NUMBER = 1e300  # a summary with a larger number is damaged


@dataclass(frozen=True)
class Entry:
    """One folder in the list of runs and scans.

    path : path of the folder.
    kind : "run" or "scan"; "folder" if that cannot be found out.
    values : what is listed, by name: of a run from its summary, of a scan the scanned keys and numbers of samples.
    modified : time at which its results were written, seconds since 1970.
    problem : why its content cannot be read; "" if it can.
    """

    path: str
    kind: str
    values: Json
    modified: float
    problem: str = ""

    def as_dict(self) -> Json:
        """Return all fields and values in one dictionary of types that JSON has."""
        found = asdict(self)
        found |= found.pop("values")
        return found | {"modified": time.strftime("%Y-%m-%dT%H:%M:%S", time.localtime(self.modified))}

    def words(self) -> str:
        """Return one line that says what the folder holds."""
        if self.problem:
            return f"cannot be read: {self.problem}"
        return _words_of_scan(self.values) if self.kind == SCAN_KIND else _words_of_run(self.values)


def entries(folder: Path) -> list[Entry]:
    """Return entries for the runs and scans directly in a folder, or for the folder itself if it is one; newest first.

    Other folders are left out, and their subfolders are not searched. Raises InputError for a path that is no folder.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; name one that holds runs or scans")
    try:
        inside = [folder] if _kind_of(folder) else sorted(p for p in folder.iterdir() if not p.name.startswith("."))
    except OSError as error:
        raise InputError(f"{folder} cannot be read: {error.strerror or error}") from None
    return sorted(filter(None, map(_entry, inside)), key=lambda entry: entry.modified, reverse=True)


def _kind_of(path: Path) -> str:
    """Return what the folder `path` is: "run", "scan", or "" for anything else, such as a report of `bearings
    stress`.
    """
    if (path / STRESS_TABLE).is_file():
        return ""
    if any((path / name).is_file() for name in RUN_FILES):
        return RUN_KIND
    return SCAN_KIND if (path / "scan.h5").is_file() or journals_in(path) else ""


def _entry(path: Path) -> Entry | None:
    """Return the entry of the folder `path`, with a problem if it cannot be read; None if it is neither a run nor a
    scan.
    """
    kind, values, problem, times = "", {}, "", [0.0]
    try:
        kind = _kind_of(path)
        if not kind:
            return None
        for file in (*(path / name for name in (*RUN_FILES, "scan.h5")), *journals_in(path)):
            with contextlib.suppress(FileNotFoundError):  # not there, or on its way to another name
                times.append(file.stat().st_mtime)
        values = _values_of_scan(path) if kind == SCAN_KIND else _values_of_run(path)
    except (BearingsError, OSError) as error:
        problem = str(error) if isinstance(error, BearingsError) else error.strerror or str(error)
    return Entry(str(path), kind or "folder", values, max(times), problem)


def _values_of_run(path: Path) -> Json:
    """Return what is listed of the run in the folder `path`, by name, from its summary. Raises InputError if a file is
    missing or the summary holds something else.
    """
    has_summary, has_run = ((path / name).is_file() for name in ("summary.json", "run.h5"))
    if not has_summary and not has_run:
        return {"status": "unfinished"}
    if not has_summary or not has_run:
        raise InputError(f"the folder has no {'run.h5' if has_summary else 'summary.json'}")
    summary = read_json(path / "summary.json")
    if not isinstance(summary, dict):
        raise InputError("summary.json does not hold a JSON object")
    for name, (kind, can_lack) in SUMMARY_KEYS.items():
        if not _has_type(summary.get(name), kind, can_lack):
            raise InputError(f"the value of {name} in summary.json is missing or of the wrong type")
    return {name: summary.get(name) for name in SUMMARY_KEYS}


def _has_type(value: object, kind: type, can_lack: bool) -> bool:
    """Return True if a value, or each value of a list, has a type; whole numbers count as float.

    value : the value or list.
    kind : the type.
    can_lack : True if None is allowed.
    """
    kinds, parts = {float, int} if kind is float else {kind}, listed(value)
    return bool(parts) and all(
        can_lack if part is None else type(part) in kinds and (kind is not float or abs(part) < LARGEST_NUMBER)
        for part in parts
    )


def _values_of_scan(path: Path) -> Json:
    """Return what is listed of the scan in the folder `path`, by name: its scanned keys, how many samples it asks for,
    and how many its journals hold by status.
    """
    asked, scanned, fixed = count_samples(path / "scan.toml")
    statuses: dict[bytes, bytes] = {}  # by key; the last record of a sample counts
    for journal in journals_in(path):
        lines = (line for line in read_lines(journal) if line.endswith(b"}}\n"))
        statuses.update((found[1], found[2]) for line in lines if (found := RECORD.match(line)))
    states = Counter(status.decode(errors="replace") for status in statuses.values())
    failed = states.pop(FAILED, 0)
    shared = {name: fixed.get(name) for name in ("shape", "law", "method", "seed")}
    shared = {name: value if _has_type(value, int, True) else str(value) for name, value in shared.items()}
    samples = {"samples_asked": asked, "samples_done": states.total(), "samples_failed": failed}
    return {**shared, "scanned": list(scanned), **samples, "statuses": dict(states)}


def _words_of_run(values: Mapping[str, object]) -> str:
    """Return one line that says what a run holds.

    values : numbers and words of its summary, by name.
    """
    if "power" not in values:
        return "unfinished; `bearings run --resume` goes on from its checkpoint"
    powers, gaps, states, proven, seeds = (
        listed(values[k]) for k in ("power", "gap", "status", "states_proven", "seed")
    )
    seed = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]}-{seeds[-1]}"
    seed = "coefficients given" if values["coefficients"] else seed
    mean = "not finite" if None in powers else f"{sum(powers) / len(powers):.9g}"
    power = f"{'mean ' * (len(powers) > 1)}P = {mean}"
    gap = "no gap" if None in gaps else f"gap {max(gaps):.1e}"
    decided = "states proven" if all(value is True for value in proven) else "not all states proven"
    status = ", ".join(f"{many} {state}" if len(states) > 1 else state for state, many in Counter(states).items())
    what = f"{sized(values)} {values['law']}, {values['method']}, {seed}{driving_words(values)}"
    return f"{what}: {status}; {power}, {gap}, {decided}"


def _words_of_scan(values: Json) -> str:
    """Return one line that says what a scan holds.

    values : its scanned keys and numbers of samples, by name.
    """
    known = " ".join(str(part) for part in (sized(values), values["law"], values["method"]) if part)
    over = " x ".join(values["scanned"]) or "one sample"
    done = f"{values['samples_done']:,} of {counted(values['samples_asked'], 'sample')}"
    failed = f", {values['samples_failed']:,} failed" if values["samples_failed"] else ""
    states = ", ".join(f"{many:,} {state}" for state, many in values["statuses"].items())
    return f"{known + ', ' if known else ''}over {over}: {done}{failed}{'; ' + states if states else ''}"
