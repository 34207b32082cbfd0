"""Files of solved packings, and packings that hurt."""

import h5py
import numpy as np

import taichi_bearings as tb
from tests.packing.twins import random_packing

LAWS = ("coulomb", "coulomb-viscous", "viscous")
KINDS = {
    "square": (5, 4), "triangular": (4, 3), "honeycomb": (3, 3), "cubic": (3, 4, 4), "bcc": (3, 3, 3),
    "fcc": (2, 2, 3), "diamond": (2, 2, 2),
}  # fmt: skip


def drawn(seed):
    """A random packing; loops odd or even, dangling and floating parts, several bodies, contrasts, ties."""
    rng = np.random.default_rng([91, seed])
    law, dimension = LAWS[seed % 3], 2 + seed // 3 % 2
    if seed % 5 == 4:  # a lattice
        kind = list(KINDS)[seed // 5 % len(KINDS)]
        values = {"distribution": "bimodal:1,2,0.5"} if seed % 10 == 9 else {}
        return tb.Packing.lattice(kind, KINDS[kind], seed=seed, law=law, spin_bottom=0.25 * (seed % 4), **values)
    return random_packing(rng, dimension, law, levels=5 if seed % 7 == 0 else None)


def write_run(folder, found):
    """run.h5 of a result without its checksums, so that what is forged contradicts itself."""
    path = found.save(folder / "run") / "run.h5"
    with h5py.File(path, "a") as file:
        del file.attrs["sha256"]
    return path
