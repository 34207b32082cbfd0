"""How many odd contacts stop a bearing of discs? Square lattices to which contacts across diagonals are added.

Around a loop of an odd number of discs neighbours cannot all turn in opposite ways, so there discs rest, or contacts
slip. Without such loops, the bottom at rest, half of the discs roll with the top on average. A contact across a
diagonal inside the part that rolls slips by twice the speed of the others, so it costs about twice a mean friction, and
the interface moves out of its way. How far depends on the landscape of interfaces: the least powers of those at
different heights differ by about L^(1/3). If that rules, n odd contacts act alike at equal n / L^(1/3), and in large
samples a vanishing density stops the bearing. Every sample is solved exactly, by a cut of the double cover.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.packing import Packing
from taichi_bearings.packing.planar import least_power
from taichi_bearings.packing.system import System

from ..plots.questions import draw_odd_loops
from .claims import Effort
from .fits import collapse
from .samples import Found, Table, drawn

FRICTION = (0.1, 1.0)  # uniform, the paper's
BLOCK = 10  # samples that are drawn together
SIZES, QUICK_SIZES = {16: 1.0, 32: 1.0, 64: 0.5, 128: 0.1}, {8: 1.0, 16: 1.0}  # L -> of the samples
NUMBERS, QUICK_NUMBERS = (0, 1, 2, 4, 8, 16, 32, 64), (0, 2, 8, 32)  # of odd contacts
BOTTOMS = (0.0, 0.25, 0.5, 1.0)  # omega_B / omega_T
TURNED = 16  # L of the samples in which the bottom turns
LANDSCAPE, DENSITY = 1 / 3, 2.0  # a of n / L^a, if the fluctuation of interfaces rules, or the density


def network(size: int, odd: int, bottom: float, seed: int) -> Packing:
    """A square lattice with `odd` contacts across diagonals at random places; the top turns with 1."""
    rng = np.random.default_rng([seed, size, odd])
    disc, bare = np.arange(size**2).reshape(size, size), Packing.lattice("square", (size, size))
    x, y = np.divmod(rng.choice((size - 1) ** 2, odd, replace=False), size - 1)
    rising = rng.random(odd) < 0.5
    low, high = np.where(rising, disc[x, y], disc[x, y + 1]), np.where(rising, disc[x + 1, y + 1], disc[x + 1, y])
    contact = np.concatenate([bare.contact, np.stack([low, high], axis=1)])
    step = bare.center[contact[:, 1]] - bare.center[contact[:, 0]]
    turn = 1.0 - 2.0 * (bare.center.sum(axis=1) % 2)  # neighbours turn in opposite ways
    return Packing(
        center=bare.center, contact=contact, normal=step / np.linalg.norm(step, axis=1)[:, None], driven=bare.driven,
        spin=turn * np.where(bare.driven == 1, 1.0, bottom), friction=rng.uniform(*FRICTION, len(contact)),
    )  # fmt: skip


def draw(size: int, odd: int, bottom: float, samples: int, seed: int) -> dict[str, Any]:
    """Share of the free discs that turn faster than half of the top, and of those that rest, at the exact minimum, and
    the least power over that of all free discs at rest; an entry a sample."""
    found: dict[str, list[float]] = {"rolling": [], "resting": [], "power_over_rest": []}
    for number in range(seed, seed + samples):
        packing = network(size, odd, bottom, number)
        system = System.of(packing)
        spins = least_power(system)[0]
        speed = np.abs(system.all_spins(spins)[packing.driven < 0, 0]) / packing.radius[packing.driven < 0]
        found["rolling"].append(float((speed > 0.5).mean()))
        found["resting"].append(float((speed == 0).mean()))
        at_rest = np.abs(system.difference(np.zeros_like(spins)))
        found["power_over_rest"].append(float((system.coefficients[0] * np.abs(system.difference(spins))).sum()
                                    / (system.coefficients[0] * at_rest).sum()))  # fmt: skip
    return found


def study(folder: Path, effort: Effort) -> Found:
    """Bearings by size, number of odd contacts and spin of the bottom."""
    sizes, numbers = (QUICK_SIZES, QUICK_NUMBERS) if effort.quick else (SIZES, NUMBERS)
    turned = max(sizes) if effort.quick else TURNED
    points = [(size, odd, 0.0) for size in sizes for odd in numbers]
    points += [(turned, odd, bottom) for bottom in BOTTOMS[1:] for odd in numbers]
    wanted = {point: max(BLOCK, round(effort.samples * sizes.get(point[0], 1.0))) for point in points}
    found = drawn(draw, wanted, BLOCK, effort.seed, folder / "odd-loops.jsonl")
    rows = []
    for (size, odd, bottom), of in found.items():
        row = {"size": size, "odd": odd, "omega_bottom": bottom, "samples": len(of["rolling"])}
        for name, values in of.items():
            row |= {name: values.mean(), f"{name}_error": values.std(ddof=1) / len(values) ** 0.5}
        rows.append(row)
    rolling = {size: {odd: found[size, odd, 0.0]["rolling"] for odd in numbers} for size in sizes}
    resting = {bottom: found[turned, max(numbers), bottom]["resting"] for bottom in BOTTOMS}
    ruled = collapse({size: {odd: values for odd, values in of.items() if odd} for size, of in rolling.items()})
    named = {
        "rolling": rolling, "rest": resting, "ruled": ruled, "few": min(odd for odd in numbers if odd >= 8),
        "most_odd": max(numbers), "size": turned, "drawn_samples": sum(wanted.values()),
        "landscape": LANDSCAPE, "density": DENSITY,
    }  # fmt: skip
    return Found({".csv": Table.of(rows)}, partial(draw_odd_loops, rolling, ruled, resting), named)
