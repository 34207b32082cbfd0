"""The table of a scan from the records of its samples: columns, their units and what they mean."""

from collections.abc import Mapping, Sequence
from typing import Any

from taichi_bearings.files.scan_file import MISSING, Column, SampleHistograms, column, dense_histograms
from taichi_bearings.runs.run import versions
from taichi_bearings.runs.settings import settings_table
from taichi_bearings.scans.plan import Sample, ScanPlan, written
from taichi_bearings.version import VERSION

FIRST = ("power", "lower_bound", "gap", "status", "method", "slipping", "slipless", "seconds")  # after the scanned keys
MEANING = {  # column -> (unit, description); others are described in docs/structure.md
    "power": ("energy/time", "power dissipated by the spins, an upper bound on the least power"),
    "lower_bound": ("energy/time", "proven lower bound on the least power"),
    "gap": ("1", "(power - lower_bound) / power"),
    "status": ("1", "how the solve ended: certified, stationary, finished, stalled, step-limit, ..., or failed"),
    "method": ("1", "method that solved the sample"),
    "slipping": ("1", "contacts that slip"),
    "slipless": ("1", "contacts that do not slip"),
    "undecided": ("1", "contacts that are neither: critical, tied, or not known"),
    "critical": ("1", "undecided contacts at the limit of their friction, with a slip below what the gap resolves"),
    "seconds": ("s", "wall time of the solve, compilation apart; its share in a block of seeds solved together"),
    "seconds_compile": ("s", "wall time to load and compile"),
    "iterations": ("1", "iterations of the method"),
    "contacts": ("1", "contacts that take part"),
    "power_normalised": ("1", "power / (normal_force radius spin_top)"),
    "largest_balance_residual": ("force*length", "largest torque left over on a free sphere"),
    "largest_slipless_slip": ("length/time", "largest slip of a slipless contact"),
    "smallest_slipping_slip": ("length/time", "smallest slip of a slipping contact"),
    "separation_decades": ("1", "decades of slip between slipping and slipless contacts"),
    "states_proven": ("1", "whether the contact states are proven to be those of every minimum"),
    "minimum_is_unique": ("1", "whether it is proven that no other slips have the least power, or that others do"),
    "tied_contacts": ("1", "contacts that slip at some minima and not at others"),
    "slip_threshold": ("length/time", "slip up to which a contact counts as slipless"),
    "time": ("time", "simulated time"),
    "elastic_share": ("1", "longest spring over the distance that the driven planes slid past each other"),
    "warnings": ("1", "where the result could be misread, in sentences with a number"),
    "energy_residual": ("1", "what the energy balance leaves unexplained"),
    "power_minimum_cut": ("energy/time", "power of the lightest interface of two rigid domains"),
    "power_over_cut": ("1", "power / power_minimum_cut"),
    "slipless_fraction": ("1", "slipless contacts over all that can slip"),
    "sample": ("1", "name of the sample, the same for the same settings"),
    "version": ("1", "version of the program that solved it"),
    "error": ("1", "why the sample has no result"),
}


OF_A_SPANNING_NETWORK = {"shortest_path", "mean_distance", "busiest_link_share", "busiest_link_current", "resistance"}
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
    """The scanned keys, then FIRST, then whatever else the records hold; one row a sample that has a record.

    A result that bears the name of a scanned key and may differ from it is called ``<name>_found``.
    """
    samples = [sample for sample in plan.samples if sample.key in records]
    scalars = [_scalars(sample, records[sample.key]) for sample in samples]
    names = dict.fromkeys([*FIRST, *(name for numbers in scalars for name in numbers)])
    settings = {key: (item.unit, item.help) for key, item in settings_table().items()}
    columns = [column(key, [written(sample.point[key]) for sample in samples], *settings[key]) for key in plan.scanned]
    for name in names:
        values = [numbers.get(name) for numbers in scalars]
        units, text = (settings | MEANING).get(name, ("1", name.replace("_", " ")))
        if name not in plan.scanned:
            columns.append(column(name, values, units, text))
        elif name in ("method", "slip_threshold"):
            columns.append(column(f"{name}_found", values, units, text))
    columns.append(column("sample", [sample.key for sample in samples], *MEANING["sample"]))
    return columns


def _scalars(sample: Sample, record: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers and texts of a sample: those of its record, and of its settings what a record without result lacks."""
    found = dict(record["scalars"])
    if found.get("spans") is False:  # journals of before may say 0
        found |= dict.fromkeys(found.keys() & OF_A_SPANNING_NETWORK)
    return found | {name: written(getattr(sample.settings, name)) for name in OF_SETTINGS if name not in found}


def histograms_of(plan: ScanPlan, records: Mapping[str, Mapping[str, Any]]) -> SampleHistograms:
    """Distributions of power, one row a sample as in :func:`columns_of`."""
    chosen = [records[sample.key] for sample in plan.samples if sample.key in records]
    bins = [{int(number): many for number, many in record["bins"].items()} for record in chosen]
    names: Sequence[str] = ("slipping", "slipless", "undecided")
    return dense_histograms(bins, {name: [r["scalars"].get(name) or 0 for r in chosen] for name in names})
