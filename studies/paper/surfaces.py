"""Cut surfaces and minima of spheres: how their weight, their roughness and their power grow with the size.

The interface of two rigid domains of spheres is a surface of least weight in random friction. On length scales beyond
those of the lattice it is rough, W ~ L^zeta, and its weight fluctuates like L^theta, with zeta = 0.41 +- 0.01, theta =
0.84 +- 0.03 and theta = 2 zeta (Middleton, Phys. Rev. E 52, R3337, 1995); where the friction varies little it stays in
one lattice plane up to large sizes (Alava and Duxbury, Phys. Rev. B 54, 14990, 1996). The minimum is no cut: its
spins are vectors and may change little by little. If its slip stays near a surface, its power fluctuates like the
weight of one and its spin changes within a share L^(zeta - 1) of the layers; if all the bulk slips, each of L^3
contacts by 1/L, the power fluctuates like L^(1/2), and the spin changes within a constant share of the layers.
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, ScalarFormatter

from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.numerics.minimum_cut import minimum_cut
from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, new_figure, shades
from taichi_bearings.runs.run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.stopping import StopRule

from .claims import Effort
from .drawing import draw_growth, draw_means, mean_and_error, name_sizes, spread_and_error
from .fits import exponent
from .samples import Found, Table, drawn, solved

SIDEWAYS = 0.5**0.5  # weight of a contact along x or y over that of one along z: of a jump along x + y
ROUGHNESS, ENERGY = 0.41, 0.84  # zeta and theta of surfaces
HEIGHT = 4.0  # of lattices that are cut, over L^ROUGHNESS: so all hold as many independent surfaces
PAPER_LOWEST = 0.1  # the paper's friction is uniform in [0.1, 1]
BLOCK = 10  # samples that are drawn together
SIZES = {8: 8.0, 12: 8.0, 16: 8.0, 24: 4.0, 32: 3.0, 48: 1.0, 64: 0.6}  # L of cuts, lowest friction 0 -> of the samples
FLAT = {  # lowest friction -> L of cuts
    0.1: {8: 2.0, 16: 2.0, 32: 0.5, 64: 0.1},
    0.2: {8: 2.0, 16: 2.0, 32: 0.5},
    0.3: {8: 2.0, 16: 2.0, 32: 0.5},
}
SIDES = {4: 4.0, 6: 4.0, 8: 4.0, 10: 3.0, 12: 2.0, 16: 0.6}  # L of minima
TALL, HEIGHTS = 8, {16: 0.5, 32: 0.5}  # L and H of minima in tall lattices
QUICK_SIZES = {6: 10.0, 8: 10.0, 12: 10.0, 16: 10.0, 24: 2.0}
QUICK_FLAT = {0.1: {8: 5.0, 16: 5.0}, 0.3: {8: 5.0, 16: 5.0}}
QUICK_SIDES, QUICK_HEIGHTS = {4: 5.0, 6: 5.0, 8: 2.0}, {16: 0.5}


def draw(kind: str, length: int, other: float, samples: int, seed: int) -> dict[str, Any]:
    """A block of surfaces or of minima; see :func:`cuts` and :func:`minima`."""
    return {"cut": cuts, "minimum": minima}[kind](length, other, samples, seed)


def cuts(length: int, lowest: float, samples: int, seed: int) -> dict[str, Any]:
    """Weights of the minimum cuts between the planes of L x L spheres, periodic in both, in units of the largest
    friction, and the variance of their height within a sample; friction is uniform in [lowest, 1]."""
    height = cut_height(length)
    rng = np.random.default_rng([seed, length, round(1000 * lowest)])
    x, y, z = (rng.uniform(lowest, 1.0, (samples, length, length, rows)) for rows in (height, height, height - 1))
    cut = minimum_cut((SIDEWAYS * x, SIDEWAYS * y, z))
    course = np.count_nonzero(~cut.above, axis=3)
    return {"weight": cut.weight.tolist(), "roughness": course.var(axis=(1, 2)).tolist()}


def cut_height(length: int) -> int:
    return round(HEIGHT * length**ROUGHNESS)


def minima(length: int, height: float, samples: int, seed: int) -> dict[str, Any]:
    """Minima of the paper's L x L x H spheres in certified numbers.

    power, cut : least power and that of the minimum cut, over F_n R omega_T. layers : in how many layers the spin
    changes, one over the sum of the squares of the shares that each has in the change of the mean staggered spin.
    intermediate : share of the free spheres that are locked to neither plane. largest : spheres of the largest such
    domain. spans, proven : whether slipless contacts join the planes, and whether their states are proven.
    """
    settings = RunSettings(shape=(length, length, int(height)), seed=seed, replicas=samples, threads=1)
    scene = build_scene(settings)
    solution, unit = (
        solved(scene, InteriorPoint(), StopRule(1e-9)),
        scene.normal_force * scene.lattice.radius * scene.jump,
    )
    found: dict[str, list[Any]] = {}
    for number in range(samples):
        structure = structure_of(solution, number)
        free = ~scene.lattice.is_driven
        locked = structure.rigid_domains.spheres_of_kind(free)
        spin = scene.staggered_spin(solution.spin[[number]], scene.minimum_spin_axes)[:, 0]
        share = np.diff(spin.mean(axis=(0, 1, 2)))
        numbers = {
            "power": structure.power / unit, "gap": 1 - structure.lower_bound / structure.power,
            "cut": structure.interface.power / unit, "layers": float(share.sum() ** 2 / (share**2).sum()),
            "intermediate": 1 - (locked["bottom"] + locked["top"]) / int(free.sum()),
            "largest": structure.rigid_domains.largest_intermediate, "spans": structure.network.spans,
            "proven": structure.states_proven,
        }  # fmt: skip
        for name, value in numbers.items():
            found.setdefault(name, []).append(value)
    return found


def points(quick: bool) -> dict[tuple[str, int, float], float]:
    """What is drawn -> of how many samples, as a share of those that a claim may take."""
    sizes, flat = (QUICK_SIZES, QUICK_FLAT) if quick else (SIZES, FLAT)
    sides, heights = (QUICK_SIDES, QUICK_HEIGHTS) if quick else (SIDES, HEIGHTS)
    return {
        **{("minimum", side, side): part for side, part in sides.items()},
        **{("minimum", TALL, height): part for height, part in heights.items()},
        **{("cut", size, 0.0): part for size, part in sizes.items()},
        **{("cut", size, lowest): part for lowest, of in flat.items() for size, part in of.items()},
    }


def study(folder: Path, effort: Effort) -> Found:
    """Surfaces by their size and the lowest friction, and minima by side and height."""
    wanted = {point: max(BLOCK, round(part * effort.samples)) for point, part in points(effort.quick).items()}
    found = drawn(draw, wanted, BLOCK, effort.seed, folder / "surfaces.jsonl")
    surfaces = {point[1:]: of for point, of in found.items() if point[0] == "cut"}
    cubes = {side: of for (kind, side, height), of in found.items() if kind == "minimum" and side == height}
    towers = {height: of for (kind, side, height), of in found.items() if kind == "minimum" and side == TALL}
    rough = {L: of for (L, lowest), of in surfaces.items() if lowest == 0}
    flat = {
        lowest: {L: of["roughness"] for (L, least), of in surfaces.items() if least == lowest}
        for lowest in dict.fromkeys(lowest for _, lowest in surfaces)
    }
    theta, zeta = exponent({L: of["weight"] for L, of in rough.items()}), exponent(flat[0.0], np.mean)
    both = {side: np.stack([of["power"], of["cut"]], axis=1) for side, of in cubes.items()}
    weaker = exponent(both, lambda powers: powers[:, 0].var() / powers[:, 1].var(), offset=False)
    layers = exponent({side: of["layers"] for side, of in cubes.items()}, lambda of: (of**2).mean(), offset=False)
    named = {
        "theta": theta, "zeta": zeta, "flat": flat, "weaker": weaker, "layers": layers, "cubes": cubes,
        "towers": towers, "roughness": ROUGHNESS, "energy": ENERGY, "tall": TALL, "paper_lowest": PAPER_LOWEST,
        "cut_samples": sum(len(of["weight"]) for of in rough.values()), "side_of_largest": max(cubes),
    }  # fmt: skip
    draw_all = partial(draw_surfaces, {L: of["weight"] for L, of in rough.items()}, theta, zeta, flat, cubes, towers)
    return Found({".csv": Table.of([row_of(point, of) for point, of in found.items()])}, draw_all, named)


COLUMNS = ("weight", "roughness", "power", "cut", "layers", "intermediate", "largest", "spans")


def row_of(point: tuple[Any, ...], found: dict[str, np.ndarray]) -> dict[str, Any]:
    """A point in numbers: of each column the mean and the standard deviation over the samples, where it has that."""
    kind, length, other = point
    row = {"kind": kind, "length": length, "lowest_friction": other if kind == "cut" else PAPER_LOWEST}
    row |= {"height": cut_height(length) if kind == "cut" else int(other)}
    row |= {"samples": len(next(iter(found.values())))}
    for name in COLUMNS:
        of = found.get(name)
        row |= {f"mean_{name}": None if of is None else of.mean(), f"sd_{name}": None if of is None else of.std()}
    return row


@in_our_style
def draw_surfaces(
    weight: Mapping[int, np.ndarray], theta: Any, zeta: Any, flat: Mapping[float, Mapping[int, np.ndarray]],
    cubes: Mapping[int, Mapping[str, np.ndarray]], towers: Mapping[int, Mapping[str, np.ndarray]],
) -> Figure:  # fmt: skip
    """(a) standard deviation of the weight of cut surfaces, (b) their width by the lowest friction, against the side;
    (c) standard deviations of the least power and of that of the cut, (d) layers in which the spin changes, of minima.

    weight : L -> (samples,). flat : lowest friction -> L -> variances of the height (samples,). cubes, towers : by side
    and by height the samples.
    """
    figure = new_figure(7.1, 5.0)
    (a, b), (c, d) = figure.subplots(2, 2)
    sizes = np.array(sorted(weight))
    a.errorbar(sizes, *spread_and_error([weight[L] for L in sizes]), fmt="o", ms=3, color=BLUE, lw=0.8)
    draw_growth(a, sizes, theta, BLUE, rf"$\theta$ = {theta.value:.2f} ± {theta.total:.2f}")
    a.set(ylabel="sd of the weight of cuts", title="(a) friction in [0, 1]")
    for (lowest, of), color in zip(flat.items(), shades(len(flat)), strict=True):
        mean, error = mean_and_error(of.values())
        width = np.sqrt(mean)
        above = np.sqrt(mean + error) - width
        b.errorbar(list(of), width, above, fmt="o-", ms=3, lw=0.8, color=color, label=f"[{lowest:g}, 1]")
    draw_growth(b, np.array(sorted(flat[0.0])), zeta, GREY, rf"$\zeta$ = {zeta.value:.2f} ± {zeta.total:.2f}")
    b.set(ylabel="width of cuts, spheres", title="(b) by the friction")
    sides = np.array(sorted(cubes))
    for name, color, text in (("cut", ORANGE, "minimum cut"), ("power", BLUE, "minimum")):
        spread = spread_and_error([cubes[L][name] for L in sides])
        c.errorbar(sides, *spread, fmt="o-", ms=3, lw=0.8, color=color, label=text)
    c.set(ylabel="sd of the power", title="(c) friction in [0.1, 1], cubes")
    for found, color, text in (
        (cubes, BLUE, "cubes, against the side"),
        (towers, ORANGE, "towers, against the height"),
    ):
        x = sorted(found)
        draw_means(d, {L: found[L]["layers"] for L in x}, color=color, label=text)
    d.set(ylabel="layers in which the spin changes", title="(d) minima")
    for axes, ticks in ((a, sizes), (b, sizes), (c, sides), (d, sorted({*cubes, *towers}))):
        axes.set_yscale("linear" if axes is b else "log")
        name_sizes(axes, ticks, "spheres")
        if axes is not b:
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5)))
            axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.legend()
    return figure
