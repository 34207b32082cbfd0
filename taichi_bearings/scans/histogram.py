"""Pools the power per contact of runs and scans over their samples: `bearings histogram`.

Letters: S samples with a result.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.analysis.histogram import (
    ENERGY_PER_TIME,
    PowerHistogram,
    SampleCounts,
    count_powers,
    joined_counts,
    pool,
    rebinned,
)
from taichi_bearings.analysis.statistics import Census, groups
from taichi_bearings.errors import FileError, InputError, printable
from taichi_bearings.files.histogram_file import Histograms, write_arrays, write_table
from taichi_bearings.files.scan_file import BINS_PER_DECADE, StoredScan
from taichi_bearings.files.whole_file import refuse_standing
from taichi_bearings.interrupts import awaited
from taichi_bearings.plain_files import Json
from taichi_bearings.plots.page import PAGE, Page
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.run_directory import default_run_path, writable_folder
from taichi_bearings.runs.run_file import file_of, read_run
from taichi_bearings.runs.settings import RunSettings, parse_toml
from taichi_bearings.scans.conditions import meeting
from taichi_bearings.scans.stored_scans import disorder_of, is_scan, numbered, open_scan
from taichi_bearings.scene import Bearing
from taichi_bearings.stages import each, stage
from taichi_bearings.words import meant

POWER_UNITS = {"none": ENERGY_PER_TIME, "mean": "the mean power of a contact of the sample"}
"""Unit of the power of a contact for each choice of `--normalise`."""
MOST_GROUPS = 24  # most histograms in a figure


@dataclass(frozen=True)
class Source:
    """The samples of a run or a scan, as histograms need them. Of all samples that were asked for, S have a result.

    path : path of its file.
    reasons : (samples asked for,), why each sample has no result, in words; "" for the S samples that have one.
    whole_column : function that returns the values (samples asked for,) of a number or setting by its name, or raises
        InputError if there is none of this name.
    contacts : (S,), number of contacts of each sample, without those between driven spheres.
    counts : function that returns how many contacts have which power; its arguments are the number of bins a decade,
        and the unit of power of each sample, (S,).
    disorder : function that returns a name for each sample, (S,); the names of two samples are equal if their lattice
        and its coefficients are.
    scanned : names of the settings that the scan varies; a run varies none.
    scene : what a run has solved; None for a scan, which stores powers by bins alone.
    """

    path: Path
    reasons: np.ndarray
    whole_column: Callable[[str], np.ndarray]
    contacts: np.ndarray
    counts: Callable[[int, np.ndarray], SampleCounts]
    disorder: Callable[[], list[Any]]
    scanned: tuple[str, ...] = ()
    scene: Bearing | None = None

    @property
    def samples(self) -> np.ndarray:
        """(samples S,) numbers of the samples that have a result."""
        return np.flatnonzero(self.reasons == "")

    def column(self, name: str) -> np.ndarray:
        """Return the values (samples S,) of a scalar for the samples with a result, by its name; raise InputError if
        there is no such scalar.
        """
        found: np.ndarray = self.whole_column(name)[self.samples]
        return found

    def numbers(self, name: str) -> np.ndarray:
        """Return the values (samples S,) of a scalar as numbers, by its name; raise FileError if they are none."""
        values = self.column(name)
        if values.dtype.kind not in "biuf":
            raise FileError(f"{self.path} is damaged or was changed: its column {name} must hold numbers")
        return values.astype(float)

    def unit(self, normalise: str) -> np.ndarray:
        """Return the power (samples S,) that serves as unit in each sample.

        normalise : "none" for 1, "mean" for the mean power of the contacts of the sample.
        """
        if normalise == "none":
            return np.ones(len(self.samples))
        mean = self.numbers("power") / np.maximum(self.contacts, 1)
        return np.where(mean > 0, mean, 1.0)  # nothing slips where there is no power


def read_source(path: Path) -> Source:
    """Return the samples of a run or a scan; raise FileError if the path is neither.

    path : directory or HDF5 file.
    """
    return _source_of_scan(open_scan(path)) if is_scan(path) else _source_of_run(read_run(path))


def _source_of_scan(scan: StoredScan) -> Source:
    """Return the samples of a stored scan in the form that histograms are made from: columns of numbers, and counts of
    contacts by bins of power.
    """
    table, solved = scan.table, np.flatnonzero(scan.reasons == "")

    def column(name: str) -> np.ndarray:
        """Return the column `name` of the table, (samples,), with all samples that were asked for."""
        if name not in table:
            raise InputError(f"{scan.path} has no column {name!r}; it has {', '.join(table)}{meant(name, table)}")
        return table[name]

    def disorder() -> list[Any]:
        """Return for each sample with a result a name of its disorder: equal for samples with the same coefficients in
        the same system."""
        document = parse_toml(str(scan.attributes["scan"]))
        shared = RunSettings(**{key: value for key, value in document.items() if key in RunSettings.keys()})
        return disorder_of({name: values[solved] for name, values in table.items()}, shared)

    fine = scan.histograms.of(solved)
    contacts = fine.contacts.sum(axis=1)
    counts = partial(rebinned, fine)
    return Source(scan.path, scan.reasons, column, contacts, counts, disorder, scan.scanned)


def _source_of_run(run: Result) -> Source:
    """Return the samples of a run in the form that histograms are made from: columns of numbers, and counts of contacts
    by bins of power.

    run : the run, read from a file.
    """
    assert run.path is not None
    settings, path, replicas = run.asked, file_of(run.path), len(run.solution.state)
    attributes, power, state = run.attributes, run.solution.power_per_contact, run.solution.state
    has_lists = run.scene.network.lattice is None
    # arrays that identify the disorder of each replica, where its coefficients were not drawn from a seed: who touches
    # whom, unless it is a lattice, and the coefficients
    given = list[tuple[np.ndarray, ...]]()
    if has_lists or attributes.get("coefficients"):
        contacts_of_list = (run.scene.network.contact,) if has_lists else ()
        given = [(*contacts_of_list, *values) for values in zip(*run.solution.scene.material, strict=True)]
    known = {*attributes, *RunSettings.keys()} - {"scene", "command"} - ({"shape"} if has_lists else set())

    def column(name: str) -> np.ndarray:
        """Return the attribute or setting `name` of each replica, (replicas,)."""
        if name not in known:
            raise InputError(f"{path} has no setting {name!r}; it has {', '.join(sorted(known))}{meant(name, known)}")
        if name in ("shape", "direction"):
            value = "x".join(map(str, getattr(settings, name)))
        elif name in attributes:
            value = np.atleast_1d(attributes[name]).tolist()
            value = value if replicas > 1 and len(value) == replicas else value[0]
        elif (value := getattr(settings, name)) is None:
            value = ""
        values = value if isinstance(value, list) else [value] * replicas
        values = [printable(item) if isinstance(item, str) else item for item in values]
        return np.array(values, dtype=object if any(isinstance(item, str) for item in values) else None)

    def disorder() -> list[Any]:
        """Return a name for the disorder of each replica, (replicas,): its seed or, where the coefficients were given,
        their hash. Replicas with the same coefficients have the same name."""
        table = {"seed": settings.seed + np.arange(replicas), "method": np.full(replicas, run.solution.method)}
        if given:
            digests = [hashlib.sha256(b"".join(v.tobytes() for v in values)).hexdigest() for values in given]
            table["seed"] = np.array(digests, dtype=object)
        return disorder_of(table, settings)

    contacts = (state != ContactState.DRIVEN).sum(axis=1)
    counts = partial(count_powers, power, state)
    return Source(path, np.full(replicas, "", dtype=object), column, contacts, counts, disorder, scene=run.scene)


def pooled(
    sources: Sequence[Source],
    bins_per_decade: int = 5,
    normalise: str = "none",
    by: str | None = None,
    where: Sequence[str] = (),
) -> dict[Any, PowerHistogram]:
    """Return histograms of the power of contacts, all in the same bins: one for each value of a column, by this value;
    without a column one of all samples, by the key None.

    sources : runs and scans whose samples are pooled.
    bins_per_decade : bins for each factor of 10 of the power. For scans, which store powers in 20 bins a decade, it
        must divide 20; if the units of their samples differ, each sample is shifted by a whole number of stored bins,
        the nearest.
    normalise : unit of power: "none", or "mean" for the mean power of a contact of the sample.
    by : name of the column whose values tell the histograms apart, or None.
    where : conditions KEY=VALUE on columns; only samples that meet all of them are pooled.
    """
    if any(source.scene is None for source in sources) and BINS_PER_DECADE % bins_per_decade:
        raise InputError(f"bins_per_decade is {bins_per_decade}; for a scan it must be 1, 2, 4, 5, 10 or 20")
    reasons = np.concatenate([source.reasons for source in sources])
    chosen = np.flatnonzero(_meeting(sources, where))
    solved = chosen[reasons[chosen] == ""]
    if not len(solved):
        raise InputError(f"no sample has a result: {Census.of(reasons[chosen].tolist()).reasons}")
    laws = sorted(set(map(str, _whole(sources, "law")[solved])))
    if len(laws) > 1 and by != "law":
        raise InputError(f"the runs have different laws ({', '.join(laws)}); pool runs of one law, or add --by law")
    counts = joined_counts([source.counts(bins_per_decade, source.unit(normalise)) for source in sources])
    threshold = np.concatenate([source.numbers("slip_threshold") for source in sources])
    disorder = numbered(name for source in sources for name in source.disorder())
    place = np.cumsum(reasons == "") - 1  # number of each sample with a result among all with a result

    def of(rows: np.ndarray) -> PowerHistogram:
        """Return the histogram of some samples.

        rows : (n,) numbers of these samples among all that were asked for.
        """
        census, used = Census.of(reasons[rows].tolist()), place[rows[reasons[rows] == ""]]
        largest_threshold = float(threshold[used].max(initial=0.0))
        return pool(counts.of(used), largest_threshold, POWER_UNITS[normalise], disorder[used], census.left_out)

    if by is None:
        return {None: of(chosen)}
    parts = groups({by: _whole(sources, by)[chosen]}, [by])
    if len(parts) > MOST_GROUPS:
        raise InputError(
            f"--by is {by!r}, which has {len(parts)} values; one figure can hold at most {MOST_GROUPS} histograms"
        )
    return {value: of(chosen[rows]) for (value,), rows in parts.items()}


def _whole(sources: Sequence[Source], name: str) -> np.ndarray:
    """Return a column of all samples that were asked for, (samples,), by its name.

    sources : runs and scans.
    name : name of the column.
    """
    return np.concatenate([source.whole_column(name) for source in sources])


def _meeting(sources: Sequence[Source], where: Sequence[str]) -> np.ndarray:
    """Return a mask (samples,) over all samples that were asked for: True where a sample meets all conditions.

    sources : runs and scans.
    where : conditions KEY=VALUE.
    """
    keys = [condition.partition("=")[0] for condition in where]
    return meeting(where, {key: _whole(sources, key) for key in keys or ["law"]})  # a table needs a column


def histogram(
    paths: Sequence[Path],
    out: Path | None = None,
    force: bool = False,
    page: Page = PAGE,
    bins_per_decade: int = 5,
    normalise: str = "none",
    by: str | None = None,
    where: Sequence[str] = (),
) -> Json:
    """Pool the histograms of runs and scans, and write power_histogram.csv, .h5 and a figure. Return the report that
    `--json` prints.

    paths : run directories and scans.
    out : folder; None for a new one.
    force : True to replace files that stand there.
    page : how the figure is printed.
    bins_per_decade, normalise, by, where : what is pooled in which bins, as :func:`pooled` explains it.

    Raises InputError or FileError before anything is written.
    """
    sources = [read_source(path) for path in each(paths, "reading")]
    if len({source.path.resolve() for source in sources}) < len(sources):
        raise InputError(f"the same run is named twice among {', '.join(map(str, paths))}")
    folder = out or default_run_path("histogram")
    table, arrays, figure = (folder / f"power_histogram.{kind}" for kind in ("csv", "h5", page.ending))
    refuse_standing((table, arrays, figure), force)
    with stage("counting"):
        found = pooled(sources, bins_per_decade, normalise, by, where)
    with writable_folder(folder):
        with stage("drawing"):
            from taichi_bearings.plots.curves import draw_histogram, draw_overlay  # loads matplotlib
            from taichi_bearings.plots.style import as_text, describe, save

            runs = [describe(source.scene, None) for source in sources if source.scene is not None]
            of = [*(runs if len(sources) == 1 else []), *map(as_text, where)]
            drawn = draw_overlay(found, by, page, where) if by else draw_histogram(found[None], page, of)
        with stage("writing"), awaited():  # all three or none
            write_table(table, found, by, where)
            write_arrays(arrays, found, by, where)
            save(drawn, figure)
    over = pooled_over(sources, by, where)
    return _report(found, by) | {"pooled_over": over, "files": [str(path) for path in (table, arrays, figure)]}


def pooled_over(sources: Sequence[Source], by: str | None, where: Sequence[str] = ()) -> list[str]:
    """Return the names of the settings, other than seeds, that differ between samples of one histogram.

    sources : runs and scans whose samples are pooled.
    by : name of the column whose values tell the histograms apart, or None.
    where : conditions KEY=VALUE which the samples meet.
    """
    fixed = {"seed", by, *(condition.partition("=")[0] for condition in where)}
    names = dict.fromkeys(name for source in sources for name in source.scanned if name not in fixed)
    chosen = _meeting(sources, where)
    return [name for name in names if len(set(_whole(sources, name)[chosen].tolist())) > 1]


def _report(histograms: Histograms, by: str | None) -> Json:
    """Return the numbers that `--json` prints: of all histograms together and, with `by`, of each.

    histograms : by the value of the column `by`; None is the only key without a column.
    by : name of the column whose values tell the histograms apart, or None.
    """
    parts = list(histograms.values())
    edges = parts[0].edges
    report = _numbers_of(parts) | {
        "smallest_power": float(edges[0]) if len(edges) else None,
        "largest_power": float(edges[-1]) if len(edges) else None,
        "units": parts[0].units,
    }
    if by is not None:
        report |= {"by": by, "groups": [{by: value, **_numbers_of([part])} for value, part in histograms.items()]}
    return report


def _numbers_of(parts: Sequence[PowerHistogram]) -> Json:
    """Return numbers of contacts and samples in some histograms together, by name.

    parts : the histograms.

    * slipping, slipless, tied, undecided: numbers of contacts in these states.
    * samples, asked: numbers of samples that are pooled, and of all that were asked for.
    * left_out: number of samples that are not pooled, by reason.
    * census: the numbers of samples in words.
    """
    names = ("slipping", "slipless", "tied", "undecided", "samples")
    counted = {name: sum(getattr(part, name) for part in parts) for name in names}
    census = Census(counted["samples"], sum((Counter(part.left_out) for part in parts), Counter()))
    return counted | {"asked": census.asked, "left_out": dict(census.left_out), "census": str(census)}
