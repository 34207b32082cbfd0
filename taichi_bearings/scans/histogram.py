"""The power per contact of runs and scans, pooled over their samples: `bearings histogram`."""

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.analysis.histogram import (
    ENERGY_PER_TIME,
    PowerHistogram,
    SampleCounts,
    count_powers,
    pool,
    rebinned,
    together,
)
from taichi_bearings.analysis.statistics import Census, groups
from taichi_bearings.errors import FileError, InputError, printable
from taichi_bearings.files.histogram_file import Histograms, write_arrays, write_table
from taichi_bearings.files.scan_file import BINS_PER_DECADE, StoredScan
from taichi_bearings.files.whole_file import refuse_standing
from taichi_bearings.interrupts import awaited
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.run import settings_of
from taichi_bearings.runs.run_directory import default_run_path, writable_folder
from taichi_bearings.runs.run_file import StoredRun, read_run_file
from taichi_bearings.runs.settings import RunSettings, parse_toml
from taichi_bearings.scans.stored_scans import is_scan, open_scan
from taichi_bearings.scans.systems import disorder_of, numbered
from taichi_bearings.scene.law import COULOMB
from taichi_bearings.stages import each, stage
from taichi_bearings.words import meant

POWER_UNITS = {"none": ENERGY_PER_TIME, "unit": "F_n R omega_T", "mean": "the mean power of a contact of the sample"}
"""What the power of a contact is counted in, by `--normalise`."""
MOST_GROUPS = 24


@dataclass(frozen=True)
class Source:
    """A run or a scan as arrays with one entry a sample (S): power in `counts`, and what its unit and groups need."""

    stored: StoredRun | StoredScan
    reasons: np.ndarray  # (asked,) why each sample has no result; empty texts for those that have

    @property
    def samples(self) -> np.ndarray:
        """Numbers (S,) of the samples that have a result."""
        return np.flatnonzero(self.reasons == "")

    def column(self, name: str) -> np.ndarray:
        """Values (S,) of a scalar; InputError if there is no such scalar."""
        return self.whole_column(name)[self.samples]

    def numbers(self, name: str) -> np.ndarray:
        """Values (S,) of a scalar that is a number; FileError if it is none."""
        values = self.column(name)
        if values.dtype.kind not in "biuf":
            raise FileError(f"{self.stored.path} is damaged or was changed: its {name} is no number")
        return values.astype(float)

    def whole_column(self, name: str) -> np.ndarray:
        """Values (asked,) of a scalar, where samples have no result too."""
        if isinstance(self.stored, StoredScan):
            table = self.stored.table
            if name not in table:
                raise InputError(
                    f"{self.stored.path} has no column {name!r}; it has {', '.join(table)}{meant(name, table)}"
                )
            return table[name]
        value = _scalar_of_run(self.stored, name)
        listed = value if isinstance(value, list) else [value] * len(self.reasons)
        listed = [printable(item) if isinstance(item, str) else item for item in listed]
        return np.array(listed, dtype=object if any(isinstance(item, str) for item in listed) else None)

    def disorder(self) -> list[Any]:
        """(S,) names, equal for samples of one disorder in one system."""
        if isinstance(self.stored, StoredScan):
            table = {name: values[self.samples] for name, values in self.stored.table.items()}
            return disorder_of(table, _settings_of_scan(self.stored))
        return _disorders_of_run(self.stored)

    def mean_power(self) -> np.ndarray:
        """Power of a sample over its contacts, those between driven spheres apart."""
        if isinstance(self.stored, StoredScan):
            found = self.stored.histograms
            contacts = (found.slipping + found.slipless + found.undecided)[self.samples]
        else:
            contacts = (self.stored.solution.state != ContactState.DRIVEN).sum(axis=1)
        return self.numbers("power") / np.maximum(contacts, 1)

    def unit(self, normalise: str) -> np.ndarray:
        """Power that counts as 1, (S,)."""
        if normalise == "none":
            return np.ones(len(self.samples))
        if normalise == "mean":
            mean = self.mean_power()
            return np.where(mean > 0, mean, 1.0)  # nothing slips where there is no power
        if flowing := sorted(set(self.column("law").tolist()) - {COULOMB.name}):
            raise InputError(
                f"normalise is 'unit', F_n R omega_T, which measures powers of the law {COULOMB.name} alone, not of "
                f"{' or '.join(map(str, flowing))}; use 'mean'"
            )
        if (
            isinstance(self.stored, StoredScan)
            and not {"normal_force", "radius", "spin_top"} <= self.stored.table.keys()
        ):
            raise InputError("normalise is 'unit', F_n R omega_T, which packings out of files lack; use 'mean'")
        with np.errstate(over="ignore"):
            unit = self.numbers("normal_force") * self.numbers("radius") * np.abs(self.numbers("spin_top"))
        if not ((unit > 0) & (unit < np.inf)).all():
            raise InputError("normalise is 'unit', F_n R omega_T, but a top has spin 0 or no finite one; use 'mean'")
        return unit

    def counts(self, bins_per_decade: int, unit: np.ndarray, anchor: float) -> SampleCounts:
        if isinstance(self.stored, StoredRun):
            solution = self.stored.solution
            return count_powers(solution.power_per_contact, solution.state, bins_per_decade, unit, anchor)
        found = self.stored.histograms
        first = round(BINS_PER_DECADE * float(np.log10(found.edges[0]))) if len(found.edges) else 0
        fine = SampleCounts(first, BINS_PER_DECADE, 1.0, found.count, found.slipless, found.undecided)
        return rebinned(fine.of(self.samples), bins_per_decade, unit, anchor)


def read_source(path: Path) -> Source:
    """A run directory, the directory of a scan, or their HDF5 files; FileError if it is none of them."""
    if is_scan(path):
        scan = open_scan(path)
        reasons = np.full(scan.samples, "", dtype=object)
        reasons[scan.failed], reasons[scan.missing] = "failed", "not computed yet"
        return Source(scan, reasons)
    run = read_run_file(path)
    return Source(run, np.full(run.solution.scene.replicas, "", dtype=object))


def _scalar_of_run(run: StoredRun, name: str) -> Any:
    """An attribute or setting of a run: one value, 10x10 for a list, or a list with a value for each replica."""
    replicas = run.solution.scene.replicas
    settings = settings_of(run)
    if name in ("shape", "direction"):
        return "x".join(map(str, getattr(settings, name)))
    if name in run.attributes:
        value = run.attributes[name]
        listed = np.atleast_1d(value).tolist()
        return listed if replicas > 1 and len(listed) == replicas else listed[0]
    if name in RunSettings.keys():
        value = getattr(settings, name)
        return "" if value is None else value
    known = sorted({*run.attributes, *RunSettings.keys()} - {"scene", "command"})
    raise InputError(f"{run.path} has no {name!r}; it has {', '.join(known)}{meant(name, known)}")


def _settings_of_scan(scan: StoredScan) -> RunSettings:
    """What a scan says of all samples alike."""
    document = parse_toml(str(scan.attributes["scan"]))
    return RunSettings(**{key: value for key, value in document.items() if key in RunSettings.keys()})


def _disorders_of_run(run: StoredRun) -> list[Any]:
    """Names of the disorder of each replica: by its seed, or by its coefficients where they were given."""
    settings, replicas = settings_of(run), run.solution.scene.replicas
    table = {"seed": settings.seed + np.arange(replicas), "method": np.full(replicas, run.solution.method)}
    if run.attributes.get("coefficients"):
        digests = [hashlib.sha256(values.tobytes()).hexdigest() for values in run.solution.scene.coefficient]
        table["seed"] = np.array(digests, dtype=object)
    return disorder_of(table, settings)


def pooled(
    sources: Sequence[Source], bins_per_decade: int = 5, normalise: str = "none", by: str | None = None
) -> dict[Any, PowerHistogram]:
    """Histograms in the same bins by the values of `by`, in their order; {None: histogram} without it.

    normalise : a key of POWER_UNITS. Powers of a run are binned anew. Those of a scan are known by the bin, 20 a
        decade: `bins_per_decade` must divide 20, and where samples have different units each moves by whole such bins.
    """
    scans = [source for source in sources if isinstance(source.stored, StoredScan)]
    if scans and BINS_PER_DECADE % bins_per_decade:
        raise InputError(f"bins_per_decade is {bins_per_decade}; for a scan it must be 1, 2, 4, 5, 10 or 20")
    if not any(len(source.samples) for source in sources):
        census = Census.of(reason for source in sources for reason in source.reasons)
        raise InputError(f"no sample has a result: {census.reasons}")
    laws = sorted({str(law) for source in sources for law in source.column("law")})
    if len(laws) > 1 and by != "law":
        raise InputError(f"the runs have different laws ({', '.join(laws)}); pool runs of one law, or add --by law")
    units = [source.unit(normalise) for source in sources]
    inside = [unit for source, unit in zip(sources, units, strict=True) if source in scans and len(unit)]
    anchor = float(inside[0][0]) if inside and normalise == "unit" else 1.0
    counts = together(
        [source.counts(bins_per_decade, unit, anchor) for source, unit in zip(sources, units, strict=True)]
    )
    threshold = np.concatenate([source.numbers("slip_threshold") for source in sources])
    disorder = numbered(name for source in sources for name in source.disorder())
    reasons = np.concatenate([source.reasons for source in sources])
    place = np.cumsum(reasons == "") - 1  # of those with a result among themselves

    def of(rows: np.ndarray) -> PowerHistogram:
        census, own = Census.of(reasons[rows].tolist()), place[rows[reasons[rows] == ""]]
        coarsest = float(threshold[own].max(initial=0.0))
        return pool(counts.of(own), coarsest, POWER_UNITS[normalise], disorder[own], census.left_out)

    if by is None:
        return {None: of(np.arange(len(reasons)))}
    values = {by: np.concatenate([source.whole_column(by) for source in sources])}
    parts = groups(values, [by])
    if len(parts) > MOST_GROUPS:
        raise InputError(f"by is {by!r}, which has {len(parts)} values; at most {MOST_GROUPS} can be overlaid")
    return {value: of(rows) for (value,), rows in parts.items()}


def histogram(
    paths: Sequence[Path],
    out: Path | None = None,
    force: bool = False,
    bins_per_decade: int = 5,
    normalise: str = "none",
    by: str | None = None,
    title: bool = True,
) -> dict[str, Any]:
    """Pool the histograms of runs and scans, write power_histogram.csv, .h5 and .png into `out`; returns the report.

    title : whether words stand above the figure.

    Raises InputError or FileError before anything is written.
    """
    sources = [read_source(path) for path in each(paths, "reading")]
    if len({source.stored.path.resolve() for source in sources}) < len(sources):
        raise InputError(f"the runs {', '.join(map(str, paths))} name the same run twice")
    folder = out or default_run_path("histogram")
    table, arrays, figure = (folder / f"power_histogram.{ending}" for ending in ("csv", "h5", "png"))
    refuse_standing((table, arrays, figure), force)
    with stage("counting"):
        found = pooled(sources, bins_per_decade, normalise, by)
    with writable_folder(folder):
        with stage("drawing"):
            from taichi_bearings.plots.histogram import draw_histogram, draw_overlay  # loads matplotlib
            from taichi_bearings.plots.page import Page
            from taichi_bearings.plots.style import save

            drawn = draw_overlay(found, by) if by else draw_histogram(found[None], Page(title=title))
        with stage("writing"), awaited():  # all three or none
            write_table(table, found, by)
            write_arrays(arrays, found, by)
            save(drawn, figure)
    return _report(found, by) | {"files": [str(path) for path in (table, arrays, figure)]}


def _report(histograms: Histograms, by: str | None) -> dict[str, Any]:
    """Numbers for `--json`; those of all histograms together and, with `by`, of each."""
    parts = list(histograms.values())
    edges = parts[0].edges
    names = ("slipping", "slipless", "undecided", "samples")
    report: dict[str, Any] = {name: sum(getattr(part, name) for part in parts) for name in names}
    left_out = sum((Counter(part.left_out) for part in parts), Counter())
    report |= _census_numbers(Census(report["samples"], dict(left_out)))
    report |= {
        "smallest_power": float(edges[0]) if len(edges) else None,
        "largest_power": float(edges[-1]) if len(edges) else None,
        "units": parts[0].units,
    }
    if by is not None:
        report["by"] = by
        report["groups"] = [
            {by: value, **{name: getattr(part, name) for name in names}, **_census_numbers(part.census)}
            for value, part in histograms.items()
        ]
    return report


def _census_numbers(census: Census) -> dict[str, Any]:
    """`asked`, samples that were asked for; `left_out`, why some are not pooled -> how many; `census`, in words."""
    return {"asked": census.asked, "left_out": dict(census.left_out), "census": str(census)}
