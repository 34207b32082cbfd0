"""The table of a scan from the records of its samples: columns, their units and what they mean."""

from collections.abc import Mapping, Sequence
from typing import Any

from taichi_bearings.files.scan_file import MISSING, Column, SampleHistograms, column, dense_histograms
from taichi_bearings.quantities import COLUMNS
from taichi_bearings.runs.run import versions
from taichi_bearings.runs.settings import settings_table
from taichi_bearings.scans.plan import Sample, ScanPlan, written
from taichi_bearings.version import VERSION

FIRST_COLUMNS = ("power", "lower_bound", "gap", "status", "method", "slipping", "slipless", "seconds")
"""What comes after the scanned keys."""
OF_A_SPANNING_NETWORK = {"shortest_path", "mean_distance", "busiest_link_share"}
OF_SETTINGS = ("law", "shape", "seed", "spin_top", "spin_bottom", "normal_force", "radius")  # known without a result


def with_missing(plan: ScanPlan, records: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """The records, and one without a result for each sample that has none yet."""
    missing = {sample.key: {"scalars": {"status": MISSING}, "bins": {}} for sample in plan.samples}
    return {**missing, **records}


def attributes_of(plan: ScanPlan, journals: int) -> dict[str, Any]:
    """What a table says of itself. journals : bytes of those that it was made from."""
    known = {"scan": plan.text, "scanned": list(plan.scanned), "asked": len(plan.samples), "journals": journals}
    return {**known, "taichi_bearings": VERSION, **versions()}


def columns_of(plan: ScanPlan, records: Mapping[str, Mapping[str, Any]]) -> list[Column]:
    """The scanned keys, then FIRST_COLUMNS, then whatever else the records hold; one row a sample that has a record.

    A result that bears the name of a scanned key and may differ from it is called ``<name>_found``.
    """
    samples = [sample for sample in plan.samples if sample.key in records]
    scalars = [_scalars(sample, records[sample.key]) for sample in samples]
    names = dict.fromkeys([*FIRST_COLUMNS, *(name for numbers in scalars for name in numbers)])
    settings = {key: (item.unit, item.help) for key, item in settings_table().items()}
    meaning = {name: (row.unit, row.text) for name, row in COLUMNS.items()}
    columns = [column(key, [written(sample.point[key]) for sample in samples], *settings[key]) for key in plan.scanned]
    for name in names:
        values = [numbers.get(name) for numbers in scalars]
        units, text = (settings | meaning).get(name, ("1", name.replace("_", " ")))
        if name not in plan.scanned:
            columns.append(column(name, values, units, text))
        elif name in ("method", "slip_threshold"):
            columns.append(column(f"{name}_found", values, units, text))
    columns.append(column("sample", [sample.key for sample in samples], *meaning["sample"]))
    return columns


def _scalars(sample: Sample, record: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers and texts of a sample: those of its record, and of its settings what a record without result lacks."""
    found = dict(record["scalars"])
    return found | {name: written(getattr(sample.settings, name)) for name in OF_SETTINGS if name not in found}


def histograms_of(plan: ScanPlan, records: Mapping[str, Mapping[str, Any]]) -> SampleHistograms:
    """Distributions of power, one row a sample as in :func:`columns_of`."""
    chosen = [records[sample.key] for sample in plan.samples if sample.key in records]
    bins = [{int(number): many for number, many in record["bins"].items()} for record in chosen]
    names: Sequence[str] = ("slipping", "slipless", "undecided")
    return dense_histograms(bins, {name: [r["scalars"].get(name) or 0 for r in chosen] for name in names})
