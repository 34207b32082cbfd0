"""Makes the table of a scan from the records of its samples, and reads it from a folder.

The scan there may be running, killed or complete. All commands read scans by `open_scan`.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.analysis.histogram import SampleCounts
from taichi_bearings.errors import BearingsError, FileError, warn
from taichi_bearings.files.scan_file import (
    CONTACT_SETS,
    MISSING,
    StoredScan,
    as_stored,
    column,
    dense_histograms,
    read_scan,
)
from taichi_bearings.files.whole_file import Finding, layout_of
from taichi_bearings.hdf5 import open_hdf5
from taichi_bearings.plain_files import Json, read_lines, read_whole
from taichi_bearings.quantities import COLUMNS
from taichi_bearings.runs.run_file import refuse_run
from taichi_bearings.runs.settings import MOST_SETTINGS_TEXT, RunSettings, settings_table, users_of
from taichi_bearings.runs.writing import versions
from taichi_bearings.scans.parts import journal_bytes, read_journals
from taichi_bearings.scans.plan import Sample, ScanPlan, read_plan, written
from taichi_bearings.scene import Scene
from taichi_bearings.scene.law import COULOMB
from taichi_bearings.version import VERSION

DRAWN = ("seed", "coefficients")  # settings from which a disorder follows
CENSUS_COLUMNS = ("used", "asked", "left_out")  # last columns of the table that is written with a figure of a scan
FIRST_COLUMNS = ("power", "lower_bound", "gap", "status", "method", "slipping", "slipless", "seconds")
"""Columns that come after the scanned keys."""
# columns that have a value only if slipless contacts join bottom and top
OF_A_SPANNING_NETWORK = {"shortest_path", "mean_distance", "busiest_link_share"}
SETTING_COLUMNS = ("law", "shape", "seed", "spin_top", "spin_bottom", "normal_force", "radius")
"""Columns that failed samples have, too: their values are settings."""


def is_scan(path: Path) -> bool:
    """Return True if `path` is the folder of a scan, with or without scan.h5, or a file that holds one."""
    if path.is_dir():
        return (path / "scan.h5").is_file() or journal_bytes(path) is not None
    try:
        with open_hdf5(path) as file:
            return bool(file.attrs.get("schema") == layout_of("scan")["schema"])
    except FileError:
        return False


def open_scan(path: Path) -> StoredScan:
    """Return a scan with a row for each sample that it asks for; nothing is written.

    path : the folder of the scan, or the file scan.h5 in it.

    scan.h5 is read if it is complete and as new as the journals. Otherwise the table is made from the journals, and
    samples that are not computed yet have the status missing. Raises FileError if there is neither.
    """
    refuse_run(path)
    if path.suffix == ".toml" and path.is_file():
        raise FileError(f"{path} describes a scan and holds no result; give the folder that `bearings scan` filled")
    folder, file = (path, path / "scan.h5") if path.is_dir() else (path.parent, path)
    journals = journal_bytes(folder)
    if journals is None or file.name != "scan.h5":
        return read_scan(path)
    try:
        stored, why = read_scan(file), ""
    except FileError as error:
        stored, why = None, str(error)
    # scan.h5 is up to date if it was made of the journals and the scan.toml that are here now.
    scan = folder / "scan.toml"
    if stored is not None and stored.attributes.get("asked") == stored.samples and scan.is_file():
        made_of = stored.attributes.get("journals"), stored.attributes["scan"].encode()
        if made_of == (journals, read_whole(scan, MOST_SETTINGS_TEXT)):
            return stored
    try:
        plan = read_plan(scan)
        nothing = {sample.key: {"scalars": {"status": MISSING}, "bins": {}} for sample in plan.samples}
        records: dict[str, Json] = {**nothing, **read_journals(folder)}
    except BearingsError as error:
        if stored is None:
            raise FileError(
                f"{why}; nor can the scan be read from its journals, the files of finished samples: {error}"
            ) from None
        lacking = f"{file} is out of date and the journals beside it cannot be read ({error})"
        warn(f"{lacking}; {file.name} is used as it is")
        return stored
    attributes = attributes_of(plan, journals)
    table = {name: as_stored(item.values) for name, item in columns_of(plan, records).items()}
    return StoredScan(file, attributes, plan.scanned, table, histograms_of(plan, records))


def outdated_figures(folder: Path, journals: int) -> list[Path]:
    """Return the figures of a scan in its folder, and their tables, if the journals have grown since scan.h5 was
    written; else none.

    folder : folder of the scan.
    journals : size of all journals, bytes.
    """
    try:
        if read_scan(folder).attributes.get("journals") == journals:
            return []
    except FileError:
        pass  # no scan.h5, or one that says nothing
    # files of the user are left alone: only tables of figures have these last columns
    last_columns = ",".join(("plot_high", *CENSUS_COLUMNS)).encode()
    found = [table for table in folder.glob("*_against_*.csv") if table.is_file()]
    tables = [table for table in found if next(read_lines(table), b"").rstrip().endswith(last_columns)]
    endings = (".pdf", ".png", ".csv")
    return [file for table in tables for file in map(table.with_suffix, endings) if file.is_file()]


def attributes_of(plan: ScanPlan, journals: int) -> Json:
    """Return the attributes of scan.h5: the scan as TOML, what was scanned, how many samples, size of the journals,
    versions.

    plan : the plan of the scan.
    journals : size of the journals that the table is made from, bytes.
    """
    known = {"scan": plan.text, "scanned": list(plan.scanned), "asked": len(plan.samples), "journals": journals}
    return {**known, "taichi_bearings": VERSION, **versions()}


def columns_of(plan: ScanPlan, records: Mapping[str, Json]) -> dict[str, Finding]:
    """Return the table of a scan by column, one row for each sample that has a record.

    plan : the plan of the scan.
    records : records of samples, by the key of the sample.

    The scanned settings come first, then FIRST_COLUMNS, then whatever else the records hold. A result with the name of
    a scanned setting from which it may differ, such as the method, gets the column ``<name>_found``.
    """
    samples = [sample for sample in plan.samples if sample.key in records]
    scalars = [_scalars(sample, records[sample.key]) for sample in samples]
    names = dict.fromkeys([*FIRST_COLUMNS, *(name for numbers in scalars for name in numbers)])
    settings = {key: (item.unit, item.help) for key, item in settings_table().items()}
    meaning = {name: (row.unit, row.text) for name, row in COLUMNS.items()}
    columns = {key: column([written(sample.point[key]) for sample in samples], *settings[key]) for key in plan.scanned}
    for name in names:
        values = [numbers.get(name) for numbers in scalars]
        units, text = (settings | meaning).get(name, ("1", name.replace("_", " ")))
        if name not in plan.scanned:
            columns[name] = column(values, units, text)
        elif name in ("method", "slip_threshold"):
            columns[f"{name}_found"] = column(values, units, text)
    return columns | {"sample": column([sample.key for sample in samples], *meaning["sample"])}


def _scalars(sample: Sample, record: Json) -> Json:
    """Return numbers and texts of a sample by name: those of its record and, where the record lacks them because the
    sample failed, those of its settings.

    sample : the sample with its settings.
    record : record of the sample in the journal.
    """
    found, settings = dict(record["scalars"]), sample.settings
    known = set(SETTING_COLUMNS if settings.packing is None else ("law", "seed")) - found.keys()
    if (settings.top, settings.bottom) != (None, None):  # imposed bearing states replace the imposed spins
        known -= set(Scene.BY_SPINS)
    return found | {name: written(getattr(settings, name)) for name in SETTING_COLUMNS if name in known}


def histograms_of(plan: ScanPlan, records: Mapping[str, Json]) -> SampleCounts:
    """Return the numbers of contacts by power, one row for each sample that has a record.

    plan : the plan of the scan.
    records : records of samples, by the key of the sample.
    """
    chosen = [records[sample.key] for sample in plan.samples if sample.key in records]
    bins = [{int(number): many for number, many in record["bins"].items()} for record in chosen]
    return dense_histograms(bins, {name: [r["scalars"].get(name) or 0 for r in chosen] for name in CONTACT_SETS})


def disorder_of(columns: Mapping[str, np.ndarray], settings: RunSettings | None = None) -> list[tuple[Any, ...]]:
    """Return a name for each row of a table of samples; rows with equal names are the same system with the same
    coefficients, so they are no independent samples.

    They differ at most in how they were solved, and in settings that their methods or laws do not use. In a table
    without seeds all names differ.

    columns : the table, arrays (rows,) by name.
    settings : settings that all rows share and no column has; needed to compare the names of several tables.
    """
    rows, table = len(next(iter(columns.values()))), settings_table()
    of_system = [key for key, item in table.items() if key not in DRAWN and not item.of_solving]
    if settings is not None:
        values = {key: written(getattr(settings, key)) for key in of_system}
        columns = {**{key: np.full(rows, value, dtype=object) for key, value in values.items()}, **columns}
    seeds = columns.get("seed", np.arange(rows)).tolist()
    # parts of a name: seed and file of coefficients, then each setting of the system
    names = [seeds, columns["coefficients"].tolist() if "coefficients" in columns else seeds]
    methods = columns.get("method_found", columns.get("method", np.full(rows, None))).tolist()
    laws = columns.get("law", np.full(rows, COULOMB.name)).tolist()
    solved_by = list(zip(methods, laws, strict=True))
    for key in of_system:
        if key in columns:
            # a setting is part of the name only for the methods and laws that use it
            by_all_methods, (users, users_laws) = table[key].methods is None, users_of(table[key])
            is_used = {
                (method, law): method is None or ((by_all_methods or method in users) and law in users_laws)
                for method, law in set(solved_by)
            }
            values_of_key = columns[key].tolist()
            names.append([value if is_used[one] else None for value, one in zip(values_of_key, solved_by, strict=True)])
    return list(zip(*names, strict=True))


def numbered(names: Iterable[object]) -> np.ndarray:
    """Return an array (names,) with a whole number for each name: equal numbers for equal names, 0, 1, ... by first
    appearance.
    """
    place: dict[Any, int] = {}
    return np.array([place.setdefault(name, len(place)) for name in names], dtype=np.int64)
