"""A scan as it stands in its folder, be it running, killed or complete: the one way in which commands read scans."""

import logging
from pathlib import Path

from taichi_bearings.errors import BearingsError, FileError
from taichi_bearings.files.scan_file import SCAN_SCHEMA, StoredScan, read_scan
from taichi_bearings.hdf5 import UNREADABLE, open_hdf5
from taichi_bearings.plain_files import read_lines, read_whole
from taichi_bearings.runs.run_file import refuse_run
from taichi_bearings.runs.settings import MOST_SETTINGS_TEXT
from taichi_bearings.scans.parts import journal_bytes, read_journals
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.table import attributes_of, columns_of, histograms_of, with_missing

CENSUS_COLUMNS = ("used", "asked", "left_out")  # the last ones of the table beside a figure of a scan


def is_scan(path: Path) -> bool:
    """True for the folder of a scan, with or without scan.h5, and for a scan.h5."""
    if path.is_dir():
        return (path / "scan.h5").is_file() or journal_bytes(path) is not None
    try:
        with open_hdf5(path) as file:
            return bool(file.attrs.get("schema") == SCAN_SCHEMA)
    except (*UNREADABLE, FileError):
        return False


def open_scan(path: Path) -> StoredScan:
    """The scan in a folder or beside a scan.h5, a row for each sample that it asks for; nothing is written.

    scan.h5 is taken if it is complete and holds what the journals hold. Otherwise the table is made of the journals,
    and samples that are not computed yet are in it as missing. Raises FileError if there is neither.
    """
    refuse_run(path)
    if path.suffix == ".toml" and path.is_file():
        raise FileError(f"{path} describes a scan and holds no result; give the folder that `bearings scan` filled")
    folder, file = (path, path / "scan.h5") if path.is_dir() else (path.parent, path)
    journals = journal_bytes(folder)
    if journals is None or file.name != "scan.h5":
        return read_scan(path)
    try:
        stored, why = read_scan(file), "is older than the samples beside it"
    except FileError as error:
        stored, why = None, str(error)
    scan = folder / "scan.toml"
    if stored is not None and stored.is_complete and _is_of(stored, scan, journals):
        return stored
    try:
        plan = read_plan(scan)
        records = with_missing(plan, read_journals(folder))
    except BearingsError as error:
        if stored is None:
            raise FileError(f"{why}; and its journal cannot be used: {error}") from None
        logging.getLogger(__name__).warning("bearings: %s %s, which cannot be used: %s", file, why, error)
        return stored
    attributes = attributes_of(plan, journals)
    return StoredScan.of_columns(file, columns_of(plan, records), histograms_of(plan, records), attributes)


def _is_of(stored: StoredScan, scan: Path, journals: int) -> bool:
    """True if a table was made of this scan file and of journals of so many bytes."""
    same = stored.attributes.get("journals") == journals
    return same and scan.is_file() and read_whole(scan, MOST_SETTINGS_TEXT) == str(stored.attributes["scan"]).encode()


def outdated_figures(folder: Path, journals: int) -> list[Path]:
    """Figures in the folder of a scan, and the tables beside them, unless scan.h5 is of journals of so many bytes."""
    try:
        if read_scan(folder).attributes.get("journals") == journals:
            return []
    except FileError:
        pass  # no scan.h5, or one that says nothing
    tables = [table for table in folder.glob("*_against_*.csv") if _is_of_a_figure(table)]
    endings = (".pdf", ".png", ".csv")
    return [file for table in tables for file in map(table.with_suffix, endings) if file.is_file()]


def _is_of_a_figure(table: Path) -> bool:
    names = next(read_lines(table), b"") if table.is_file() else b""
    return names.rstrip().endswith(",".join(("plot_high", *CENSUS_COLUMNS)).encode())
