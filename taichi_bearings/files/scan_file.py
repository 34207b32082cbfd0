"""Writes and reads scan.h5 and scan.csv: one row a sample, and the distribution of power of every sample.

The bins of these distributions are the same in all scans. The files are readable with plain h5py and pandas:

* ``/table/<column>``: 1-D, one entry a sample; attributes `units` and `description`. Texts are UTF-8 of variable
  length. The attribute `columns` of ``/table`` has the names in the order of scan.csv. A number that a sample lacks is
  not-a-number, a text that it lacks is empty; so a column of whole numbers is stored as float64 if one is missing.
* ``/histogram/edges`` (B + 1,): edges of the bins of power, 10^(i/20) energy/time, i whole. ``/histogram/count``
  (samples, B): slipping contacts in each bin. ``/histogram/slipping``, ``slipless``, ``tied``, ``undecided``: contacts
  of each sample. A failed sample has none.
* Attributes on the root: `schema`, `schema_version`, `scan` (TOML text), `scanned` (names of the columns that were
  varied), `samples`, `asked` (samples of the scan, those not computed yet too), `journals` (bytes of the journals that
  it was made from), and versions.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import h5py
import numpy as np

from taichi_bearings.analysis.histogram import SampleCounts
from taichi_bearings.errors import FileError, InputError, printable
from taichi_bearings.files.whole_file import Finding, attributes_of, layout_of, put, read_hdf5, write_csv, write_hdf5
from taichi_bearings.plain_files import Json
from taichi_bearings.scene.law import LAWS
from taichi_bearings.scene.solution import is_crossed

BINS_PER_DECADE = 20
FAILED = "failed"  # the status of a sample without a result
MISSING = "missing"  # the status of a sample that is not computed yet
CONTACT_SETS = {  # name -> description, in the order of COUNTED_STATES
    "slipless": "contacts of each sample that do not slip",
    "slipping": "contacts of each sample that slip",
    "undecided": "contacts of each sample that are undecided",
    "tied": "contacts of each sample that slip at some minima and not at others",
}


def dense_histograms(bins: Sequence[Mapping[int, int]], contacts: Mapping[str, Sequence[int]]) -> SampleCounts:
    """Return the counts of all samples in the same bins, from the lowest to the highest bin that any sample has.

    bins : one for each sample: number of slipping contacts by the number i of the bin [10^(i/20), 10^((i + 1)/20)).
    contacts : numbers of contacts, one a sample, by the state that CONTACT_SETS names.
    """
    met = [number for sample in bins for number in sample]
    low, high = (min(met), max(met) + 1) if met else (0, 0)
    count = np.zeros((len(bins), high - low), dtype=np.int32)
    for row, sample in enumerate(bins):
        for number, slipping in sample.items():
            count[row, number - low] = slipping
    of_states = np.array([contacts[name] for name in CONTACT_SETS], dtype=np.int64).T
    return SampleCounts(low, BINS_PER_DECADE, count, of_states)


def column(values: Sequence[Any], units: str, description: str) -> Finding:
    """Return a column of the table of a scan.

    values : one for each sample: texts, truth values, whole numbers or other numbers; None where a sample has none.
    units, description : units and description of the column.

    Truth values of which some are None become an array of objects, which :func:`write_scan` stores as numbers.
    """
    present = [value for value in values if value is not None]
    if any(isinstance(value, str) for value in present):
        array = np.array(["" if value is None else printable(str(value)) for value in values], dtype=object)
    elif present and len(present) < len(values) and all(isinstance(value, bool) for value in present):
        array = np.array(values, dtype=object)
    elif len(present) < len(values) or not present:
        array = np.array([math.nan if value is None else float(value) for value in values])
    else:
        array = np.array(present)
    return Finding(array, units, description)


TRUTHS_WITH_GAPS = "1 true, 0 false, not-a-number where a sample has none"


def holds_truths_with_gaps(values: np.ndarray) -> bool:
    """Return True if a column holds truth values, of which some are None."""
    return values.dtype == object and not any(isinstance(value, str) for value in values)


def as_stored(values: np.ndarray) -> np.ndarray:
    """Return a column (samples,) as scan.h5 holds it: truth values of which some are None become 1, 0 and NaN; all
    others stay.
    """
    return values.astype(float) if holds_truths_with_gaps(values) else values


def write_scan(
    folder: Path, columns: Mapping[str, Finding], histograms: SampleCounts, attributes: Mapping[str, object]
) -> None:
    """Write scan.h5 and then scan.csv into a folder, each in full or not at all.

    columns : numbers or texts (samples,) by name, made by :func:`column`; empty in scan.csv where a sample has no
        value.
    histograms : powers of the contacts of each sample.
    attributes : `scan`, `scanned`, versions and whatever else scan.h5 says on its root.
    """

    def fill(file: h5py.File) -> None:
        """Write table and histograms of the scan into an open file."""
        table = file.create_group("table")
        table.attrs["columns"] = list(columns)
        for name, item in columns.items():
            values, text = as_stored(item.values), item.description
            if holds_truths_with_gaps(item.values):
                text = f"{text} ({TRUTHS_WITH_GAPS})"
            kind = h5py.string_dtype() if values.dtype == object else values.dtype
            put(table, name, values, item.units, text, dtype=kind)
        group = file.create_group("histogram")
        sets = {
            "edges": (histograms.edges, "energy/time", "edges of the power bins, 20 a decade, the same in every scan"),
            "count": (histograms.count, "1", "slipping contacts of each sample in each bin"),
        }
        of_states = zip(histograms.contacts.T, CONTACT_SETS.items(), strict=True)
        sets |= {name: (values, "1", text) for values, (name, text) in of_states}
        for name, (values, units, text) in sets.items():
            packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if values.size > 1000 else {}
            put(group, name, values, units, text, dtype=values.dtype, **packed)

    def cell(value: object) -> str:
        """Return a value as a cell of scan.csv: true or false for truth values, empty for None and not-a-number."""
        if isinstance(value, bool):
            return str(value).lower()
        return "" if value is None or value != value else str(value)

    write_hdf5(folder / "scan.h5", fill, {**layout_of("scan"), "samples": len(histograms.count), **attributes})
    cells = (map(cell, item.values.tolist()) for item in columns.values())
    write_csv(folder / "scan.csv", list(columns), zip(*cells, strict=True))


@dataclass(frozen=True)
class StoredScan:
    """A scan as read from its file; every array has one entry for each sample, in the order of scan.csv.

    path : path of its scan.h5.
    attributes : attributes of the root of the file.
    scanned : names of the columns that were varied, in order.
    table : columns by name; texts are arrays of str.
    histograms : numbers of contacts by power.
    """

    path: Path
    attributes: Json
    scanned: tuple[str, ...]
    table: dict[str, np.ndarray]
    histograms: SampleCounts

    def __post_init__(self) -> None:
        """Raise FileError for a table that no scan writes, so that users of this object need not check it again."""
        table, counts = self.table, self.histograms

        def refuse(words: str) -> NoReturn:
            """Raise FileError with these words on what is wrong."""
            raise FileError(f"{self.path} is damaged or was changed: {words}")

        laws, shape = "|".join(map(re.escape, LAWS)), r"\d{1,9}(x\d{1,9}){1,2}"
        for name, form in (("status", "[a-z-]+"), ("law", f"({laws})?"), ("shape", f"({shape})?")):
            if not all(isinstance(text, str) and re.fullmatch(form, text) for text in table.get(name, ())):
                refuse(f"its column {name} holds something else")
        for name, kind in (("scan", str), ("asked", int | None), ("journals", int | None)):
            if not isinstance(self.attributes.get(name), kind):
                refuse(f"its attribute {name} holds something else")
        for name, values in table.items():
            texts = values.ravel().tolist() if values.dtype.kind == "O" else []
            if values.dtype.kind not in "biufO" or not all(isinstance(t, str) and t.isprintable() for t in texts):
                refuse(f"its column {name} holds something else")
        of_contacts = (counts.count, counts.contacts)
        if "status" not in table or any(values.ndim != 2 for values in of_contacts):
            refuse("it lacks statuses or histograms")
        lengths = {len(values) if values.ndim == 1 else -1 for values in table.values()}
        if len(lengths | {len(values) for values in of_contacts}) > 1:
            refuse("its columns differ in length")
        if any(values.dtype.kind not in "iu" or (values < 0).any() for values in of_contacts):
            refuse("its histograms count in something else than numbers")

    @property
    def samples(self) -> int:
        """Number of samples: rows of the table."""
        return len(self.histograms.count)

    @property
    def failed(self) -> np.ndarray:
        """(samples,) mask, True for a sample without a result because it failed."""
        found: np.ndarray = self.table["status"] == FAILED
        return found

    @property
    def reasons(self) -> np.ndarray:
        """(samples,) why each sample has no result, in words that follow a number, such as "failed"; "" for those that
        have one.
        """
        words = {FAILED: "failed", MISSING: "not computed yet"}
        return np.array([words.get(status, "") for status in self.table["status"]], dtype=object)


def read_scan(scan: Path) -> StoredScan:
    """Return the scan in a folder or a scan.h5; raise FileError if it is missing, damaged or of an unknown version.

    scan : the folder or the file.
    """
    path = scan / "scan.h5" if scan.is_dir() else scan
    if not path.is_file():
        raise FileError(f"{scan} is not a scan: there is no {path}")
    with read_hdf5(path, "scan") as file:
        # columns, then histograms: edges of bins, counts in bins, and numbers of contacts by state
        group = file["table"]
        sets = {str(name): group[str(name)] for name in group.attrs["columns"]}
        table = {name: (s.asstr() if h5py.check_string_dtype(s.dtype) else s)[()] for name, s in sets.items()}
        edges, count = (file[f"histogram/{name}"][()] for name in ("edges", "count"))
        zeros = np.zeros(len(count), dtype=np.int64)  # in layout 1 tied contacts are among the undecided ones
        lacks = {"tied"} if file.attrs["schema_version"] == 1 else set()
        of_states = [zeros if name in lacks else file[f"histogram/{name}"][()] for name in CONTACT_SETS]
        are_positive = edges.dtype.kind == "f" and edges.ndim == 1 and ((edges > 0) & (edges < np.inf)).all()
        place = BINS_PER_DECADE * np.log10(edges) if are_positive else np.full(1, np.nan)  # successive whole numbers
        first = round(float(place[0])) if are_positive and len(edges) else 0
        if len(place) and not np.allclose(place, first + np.arange(len(place)), rtol=0, atol=1e-6):
            raise InputError("the bins of the histograms are not equally wide on a logarithmic axis")
        counts = SampleCounts(first, BINS_PER_DECADE, count, np.stack(of_states, axis=1))
        if count.shape[1:] != (max(len(edges) - 1, 0),):
            raise InputError(f"the histograms have {count.shape[1]} bins but {len(edges)} edges of bins")
        found = StoredScan(path, attributes_of(file), tuple(map(str, file.attrs["scanned"])), table, counts)
    if any(isinstance(gap, float) and is_crossed(None, None, gap) for gap in found.table.get("gap", ())):
        raise FileError(f"{path} has a lower bound above the power, so it is damaged or was changed")
    return found
