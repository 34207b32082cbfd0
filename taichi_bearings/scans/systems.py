"""Which samples are of one disorder in one system."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from taichi_bearings.options import Option
from taichi_bearings.runs.settings import RunSettings, settings_table
from taichi_bearings.scans.plan import written
from taichi_bearings.scene.law import COULOMB, LAWS
from taichi_bearings.solvers import METHODS

DRAWN = ("seed", "coefficients")  # what a disorder comes from


def of_system() -> dict[str, Option]:
    """The settings that say which system a sample is: samples depend on each other whatever the others are."""
    return {key: item for key, item in settings_table().items() if key not in DRAWN and not item.of_solving}


def system_columns(columns: Mapping[str, np.ndarray]) -> dict[str, list[Any]]:
    """The columns that say which system a sample is, with None where its method or law does not use the setting."""
    found = {key: columns[key].tolist() for key in of_system() if key in columns}
    methods = columns.get("method_found", columns.get("method"))
    if methods is None:
        return found
    laws = columns["law"].tolist() if "law" in columns else [COULOMB.name] * len(methods)
    solved = list(zip(methods.tolist(), laws, strict=True))
    for key, values in found.items():
        item = settings_table()[key]
        used = {pair: item.is_used_by(METHODS.get(pair[0]), LAWS[pair[1]]) for pair in set(solved)}
        found[key] = [value if used[pair] else None for value, pair in zip(values, solved, strict=True)]
    return found


def disorder_of(columns: Mapping[str, np.ndarray], settings: RunSettings | None = None) -> list[tuple[Any, ...]]:
    """Names of the disorder of each row of a table of samples, equal for those of one disorder in one system.

    Such samples depend on each other: they differ at most in how they were solved and in settings that their methods
    know nothing of. Where a table has no seeds every row is alone. settings : of all rows, where no column says them;
    needed to compare the names of several tables.
    """
    rows = len(next(iter(columns.values())))
    if settings is not None:
        values = {key: written(getattr(settings, key)) for key in of_system()}
        columns = {**{key: np.full(rows, value, dtype=object) for key, value in values.items()}, **columns}
    seeds = columns.get("seed", np.arange(rows))
    drawn = (seeds.tolist(), columns.get("coefficients", seeds).tolist())
    return list(zip(*drawn, *system_columns(columns).values(), strict=True))


def numbered(names: Iterable[Any]) -> np.ndarray:
    """Equal numbers for equal names."""
    listed = list(names)
    place = {name: number for number, name in enumerate(dict.fromkeys(listed))}
    return np.array([place[name] for name in listed], dtype=np.int64)
