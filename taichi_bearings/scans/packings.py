"""Samples that are packings: out of a file, or lattices with other driven bodies than planes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.packing import Packing
from taichi_bearings.packing.system import System, acting
from taichi_bearings.runs.packing_run import fitting, packings_of
from taichi_bearings.scans.plan import Sample

OF_A_NETWORK = ("center", "contact", "driven", "spin", "radius", "normal")


def refuse_packing(group: Sequence[Sample]) -> None:
    """InputError for what cannot be solved, or is the same for all of a group of seeds."""
    settings = fitting(group[0].settings, strict=False)
    law = packings_of(settings).law
    if len(group) == 1 or settings.packing is None or settings.initial == "random":
        return
    if set(("friction", "viscosity")[: len(law.quantities)]) <= Packing.read(settings.packing).keys():
        raise InputError(
            f"seed is scanned, but {settings.packing} holds all coefficients, so nothing is drawn; leave out seed, or "
            "friction from the file"
        )


_last: list[System] = []  # of this worker


def system_of(packing: Packing) -> System:
    """That of the last packing, with the coefficients of this one, if they differ in nothing else."""
    if not _last or not _alike(_last[0].packing, packing):
        _last[:] = [System.of(packing)]
    of = tuple(values[_last[0].contact] for values in packing.coefficients)
    return replace(_last[0], packing=packing, coefficients=of)


def _alike(one: Packing, other: Packing) -> bool:
    same = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in OF_A_NETWORK)
    return same and np.array_equal(acting(one), acting(other))
