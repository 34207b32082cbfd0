"""A small scan as `bearings scan` would leave it, with powers that the test knows."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taichi_bearings.files.scan_file import FAILED, column, dense_histograms, write_scan
from taichi_bearings.proof.contact_state import ContactState

SLIPLESS_SHARE, UNDECIDED_SHARE = 0.4, 0.05


def bin_of(power):
    """Whole number i of the bin [10^(i/20), 10^((i + 1)/20)) of each positive power."""
    return np.floor(20 * np.log10(power)).astype(np.int64)


@dataclass(frozen=True)
class KnownScan:
    """path : of scan.h5. power, state : one array (contacts,) a sample. table : columns by name."""

    path: Path
    power: list[np.ndarray]
    state: list[np.ndarray]
    table: dict[str, list]

    def slipping(self, sample: int) -> np.ndarray:
        """Powers of the slipping contacts."""
        return self.power[sample][self.state[sample] == ContactState.SLIPPING]


def stored_scan(
    folder: Path, sides=(4, 8, 16), bottoms=(0.0, 0.1), seeds=12, tops=(1.0,), failed=(), law="coulomb"
) -> KnownScan:
    """Squares of given sides; P = L^1.5 |spin_top - spin_bottom|, give or take 10 %. failed : samples without result.

    Powers of contacts are drawn from a log-normal distribution, not from physics.
    """
    folder.mkdir(parents=True, exist_ok=True)
    points = [
        (side, top, bottom, seed) for side in sides for top in tops for bottom in bottoms for seed in range(seeds)
    ]
    table: dict[str, list] = {name: [] for name in ("shape", "spin_top", "spin_bottom", "seed")}
    powers, states, bins, contacts = [], [], [], {name: [] for name in ("slipping", "slipless", "tied", "undecided")}
    totals: list[float | None] = []
    for number, (side, top, bottom, seed) in enumerate(points):
        rng = np.random.default_rng([side, seed, int(100 * bottom)])
        lost = number in failed
        size = 0 if lost else 2 * side * (side - 1)
        total = side**1.5 * abs(top - bottom) * rng.uniform(0.9, 1.1)
        power = rng.lognormal(0, 3, size)
        state = rng.choice(3, size, p=[SLIPLESS_SHARE, 1 - SLIPLESS_SHARE - UNDECIDED_SHARE, UNDECIDED_SHARE])
        power *= total / max(power[state == ContactState.SLIPPING].sum(), 1e-300)
        for name, value in zip(table, (f"{side}x{side}", top, bottom, seed), strict=True):
            table[name].append(value)
        number_of, count = np.unique(bin_of(power[state == ContactState.SLIPPING]), return_counts=True)
        bins.append(dict(zip(number_of.tolist(), count.tolist(), strict=True)))
        for name in contacts:
            contacts[name].append(int((state == ContactState[name.upper()]).sum()))
        powers.append(power)
        states.append(state)
        totals.append(None if lost else total)
    lost = [total is None for total in totals]
    table |= {
        "power": totals,
        "power_minimum_cut": [None if total is None else 1.25 * total for total in totals],
        "law": [law] * len(points),
        "status": [FAILED if gone else "certified" for gone in lost],
        "normal_force": [None if gone else 50.0 for gone in lost],
        "radius": [None if gone else 0.5 for gone in lost],
        "slip_threshold": [None if gone else 1e-9 for gone in lost],
        **{
            name: [None if gone else n for n, gone in zip(values, lost, strict=True)]
            for name, values in contacts.items()
        },
    }
    columns = {name: column(values, "1", name) for name, values in table.items()}
    attributes = {"scan": "", "scanned": ["shape", "spin_top", "spin_bottom", "seed"]}
    write_scan(folder, columns, dense_histograms(bins, contacts), attributes)
    return KnownScan(folder / "scan.h5", powers, states, table)
