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


def write_run(path, found, tolerance=1e-8):
    """A run.h5 of a PackingResult."""
    packing, state = found.packing, found.state
    held = packing.kind.holding_force(packing.coefficients)
    full = (
        np.zeros(len(state), bool)
        if held is None
        else (found.force >= (1 - 1e-6) * held) & (held * found.slip <= found.potential - found.lower_bound)
    )
    with h5py.File(path, "w") as file:
        file.attrs.update({
            "schema": "taichi_bearings.run", "schema_version": 1, "command": "bearings run",
            "scene": f'law = "{packing.law.name}"\ntolerance = {tolerance!r}\npacking = "run.h5"\n',
            "power": found.power, "lower_bound": found.lower_bound, "gap": found.gap, "proof": found.proof,
            "status": found.status, "method": found.method, "law": packing.law.name, "shape": "",
            "spheres": packing.spheres, "driven_spheres": int((packing.driven >= 0).sum()),
            "contacts": int((state != 3).sum()), "slipping": int((state == 1).sum()),
            "slipless": int((state == 0).sum()), "undecided": int((state == 2).sum()),
            "critical": int((full & (state == 2)).sum()), "driven_power": found.driven_power,
            "slipless_motions": found.slipless_motions if found.slipless_motions is not None else "",
            "largest_balance_residual": found.unbalanced,
        })  # fmt: skip
        if packing.law.name == "coulomb-viscous":
            file.attrs["potential"] = found.potential
        for name, values in packing.arrays().items():
            file[f"packing/{name}"] = values
        file["spin"] = found.spin
        for name in ("slip", "power_per_contact", "force", "state", "friction", "proven", "slip_bound"):
            file[f"contact/{name.removesuffix('_per_contact')}"] = getattr(found, name)
    return path
