"""Writes distributions of the power per contact as CSV and HDF5."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from taichi_bearings.analysis.histogram import ENERGY_PER_TIME, PowerHistogram
from taichi_bearings.files.whole_file import put, write_csv, write_hdf5

Histograms = Mapping[Any, PowerHistogram]  # by the value of the parameter in which they differ; {None: ...} for one

OF_BINS = {  # columns that tables have for each bin, apart from its edges
    "count": "slipping contacts in each bin",
    "standard_error": "of the count: over the samples, or Poisson with one sample",
    "density": "share of the slipping contacts per decade of power",
    "density_error": "standard error of the density",
}


def write_table(path: Path, histograms: Histograms, by: str | None = None, where: Sequence[str] = ()) -> None:
    """Write histograms of the power of contacts as CSV, with the columns power_low, power_high and count.

    path : path of the file.
    histograms : by the value of the parameter in which they differ; {None: histogram} for a single one.
    by : name of that parameter, the last column; None for a single histogram.
    where : conditions by which the samples were chosen, which the header names.

    The header says how many contacts are in no bin. Where several samples are pooled, the columns standard_error,
    density and density_error follow. Several histograms stand below each other.
    """
    # the header: what is in no bin, and how many samples were pooled
    notes = []
    for value, found in histograms.items():
        part = "" if by is None else f"{by} {value}: "
        others = f"slipless {found.slipless}, tied {found.tied}, undecided {found.undecided}"
        notes.append(f"{part}slipping {found.slipping}, {others}")
        why = f" ({found.census.reasons})" if found.left_out else ""
        samples = f"samples {found.samples} of {found.census.asked}{why}"
        notes.append(f"{part}slip_threshold {found.slip_threshold!r}, {samples}")
    units = next(iter(histograms.values())).units
    if units == ENERGY_PER_TIME:
        notes[-1] += f"; power in {units}"
    else:
        notes.append(f"power in units of {units}")
    notes += [f"where {condition}" for condition in where]
    names = [*OF_BINS] if any(found.samples > 1 for found in histograms.values()) else ["count"]
    rows = []
    for value, found in histograms.items():
        columns = [found.edges[:-1], found.edges[1:], *(getattr(found, name) for name in names)]
        rows += [[*row, *([] if by is None else [value])] for row in zip(*(c.tolist() for c in columns), strict=True)]
    write_csv(path, ["power_low", "power_high", *names, *([] if by is None else [by])], rows, notes)


def write_arrays(path: Path, histograms: Histograms, by: str | None = None, where: Sequence[str] = ()) -> None:
    """Write histograms of the power of contacts as HDF5: data sets edges, count, standard_error, density and
    density_error; the rest as attributes.

    path : path of the file.
    histograms : by the value of the parameter in which they differ; {None: histogram} for a single one.
    by : name of that parameter; None for a single histogram. With a name all data sets but the edges have a leading
        axis, and the data set `value` has the value of each histogram.
    where : conditions by which the samples were chosen, an attribute if there are any.
    """
    parts = list(histograms.values())

    def stacked(name: str) -> Any:
        """Return the attribute `name` of the histogram; with several histograms those of all, along a leading axis."""
        values = [getattr(part, name) for part in parts]
        return values[0] if by is None else np.array(values)

    def fill(file: h5py.File) -> None:
        """Write all data sets and attributes of the histograms into an open file."""
        for name, text in OF_BINS.items():
            put(file, name, stacked(name), "1", text)
        put(file, "edges", parts[0].edges, parts[0].units, "edges of the power bins")
        for name in ("slipping", "slipless", "tied", "undecided", "slip_threshold", "samples"):
            file.attrs[name] = stacked(name)
        file.attrs["asked"] = [part.census.asked for part in parts] if by else parts[0].census.asked
        file.attrs["left_out"] = [part.census.reasons for part in parts] if by else parts[0].census.reasons
        if where:
            file.attrs["where"] = list(where)
        if by is not None:
            texts = any(not isinstance(value, (int, float)) for value in histograms)
            values = ["" if v is None else str(v) for v in histograms] if texts else list(histograms)
            kind = h5py.string_dtype() if texts else None
            put(file, "value", values, "", f"{by}, the parameter of each histogram", dtype=kind)
            file.attrs["by"] = by

    write_hdf5(path, fill)
