"""How many odd contacts stop a bearing of discs? Square lattices to which contacts across diagonals are added.

Around a loop of an odd number of discs neighbours cannot all turn in opposite ways, so there discs rest, or contacts
slip. Without such loops, the bottom at rest, half of the discs roll with the top on average. A contact across a
diagonal inside the part that rolls slips by twice the speed of the others, so it costs about twice a mean friction, and
the interface moves out of its way. How far depends on the landscape of interfaces: the least powers of those at
different heights differ by about L^(1/3). If that rules, n odd contacts act alike at equal n / L^(1/3), and in large
samples a vanishing density stops the bearing. Every sample is solved exactly, by a cut of the double cover.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.packing import Packing
from taichi_bearings.packing.planar import least_power
from taichi_bearings.packing.system import System
from taichi_bearings.stages import stage

from ..plots.odd_loops import draw_odd_loops
from .blocks import drawn
from .claims import Claim, Effort, judge
from .fits import collapse
from .samples import save_both

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
    found: dict[str, list[float]] = {"rolling": [], "resting": [], "power": []}
    for number in range(seed, seed + samples):
        packing = network(size, odd, bottom, number)
        system = System.of(packing)
        spins = least_power(system)[0]
        speed = np.abs(system.all_spins(spins)[packing.driven < 0, 0]) / packing.radius[packing.driven < 0]
        found["rolling"].append(float((speed > 0.5).mean()))
        found["resting"].append(float((speed == 0).mean()))
        at_rest = np.abs(system.difference(np.zeros_like(spins)))
        found["power"].append(float((system.coefficients[0] * np.abs(system.difference(spins))).sum()
                                    / (system.coefficients[0] * at_rest).sum()))  # fmt: skip
    return found


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write odd-loops.png, .pdf and .csv into `folder`; returns the claims with their verdicts."""
    sizes, numbers = (QUICK_SIZES, QUICK_NUMBERS) if effort.quick else (SIZES, NUMBERS)
    turned = max(sizes) if effort.quick else TURNED
    points = [(size, odd, 0.0) for size in sizes for odd in numbers]
    points += [(turned, odd, bottom) for bottom in BOTTOMS[1:] for odd in numbers]
    wanted = {point: max(BLOCK, round(effort.samples * sizes.get(point[0], 1.0))) for point in points}
    found = drawn(draw, wanted, BLOCK, effort.seed, folder / "odd-loops.jsonl")
    rows = []
    for point, of in found.items():
        told = [number for values in of.values() for number in (values.mean(), values.std(ddof=1) / len(values) ** 0.5)]
        rows.append([*point, wanted[point], *told])
    names = [f"{name}{ending}" for name in ("rolling", "resting", "power_over_rest") for ending in ("", "_error")]
    write_csv(folder / "odd-loops.csv", ["size", "odd", "omega_bottom", "samples", *names], rows)
    count = sum(wanted.values())
    rolling = {size: {odd: found[size, odd, 0.0]["rolling"] for odd in numbers if odd} for size in sizes}
    none = {size: found[size, 0, 0.0]["rolling"] for size in sizes}
    few = min(odd for odd in numbers if odd >= 8)
    stopped = {size: found[size, few, 0.0]["rolling"] for size in sizes}
    ruled = collapse(rolling)
    resting = {bottom: found[turned, max(numbers), bottom]["resting"] for bottom in BOTTOMS}
    with stage("drawing"):
        save_both(draw_odd_loops(rolling, none, ruled, resting), folder, "odd-loops")
    return [
        judge("odd-loops.few", {"without": means(none), "stopped": means(stopped)}, few=few,
              bare={f"L = {L}": {"share": values} for L, values in none.items()},
              after={f"L = {L}": {"share": values} for L, values in stopped.items()},
              least=min(means(none).values()), most=max(means(stopped).values()),
              samples=min(map(len, none.values()))),
        judge("odd-loops.rule", {"exponent": ruled.value, "error": ruled.error, "misfit": ruled.misfit},
              landscape=LANDSCAPE, density=DENSITY, samples=count),
        judge("odd-loops.equal", {"resting": means(resting)}, odd=max(numbers), size=turned,
              rest={f"omega_B / omega_T = {bottom:g}": {"share": values} for bottom, values in resting.items()},
              equal=float(resting[1.0].mean()), samples=len(resting[1.0])),
    ]  # fmt: skip


def means(found: Mapping[Any, np.ndarray]) -> dict[str, float]:
    return {str(name): float(values.mean()) for name, values in found.items()}
