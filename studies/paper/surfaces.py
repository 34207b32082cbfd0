"""Cut surfaces and minima of spheres: how their weight, their roughness and their power grow with the size.

The interface of two rigid domains of spheres is a surface of least weight in random friction. On length scales beyond
those of the lattice it is rough, W ~ L^zeta, and its weight fluctuates like L^theta, with zeta = 0.41 +- 0.01, theta =
0.84 +- 0.03 and theta = 2 zeta (Middleton, Phys. Rev. E 52, R3337, 1995); where the friction varies little it stays in
one lattice plane up to large sizes (Alava and Duxbury, Phys. Rev. B 54, 14990, 1996). The minimum is no cut: its spins
are vectors and may change little by little. If its slip stays near a surface, its power fluctuates like the weight of
one and its spin changes within a share L^(zeta - 1) of the layers; if all the bulk slips, each of L^3 contacts by 1/L,
the power fluctuates like L^(1/2), and the spin changes within a constant share of the layers.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, ScalarFormatter

from taichi_bearings.analysis.structure import Structure
from taichi_bearings.numerics.minimum_cut import minimum_cut
from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, new_figure, shades
from taichi_bearings.scene.scene import of_lattice

from .claims import Effort
from .drawing import draw_deviations, draw_growth, draw_means, mean_and_error, name_sizes
from .fits import exponent
from .samples import StudyResult, Table, drawn, measured, planned, shared_numbers

SIDEWAYS = 0.5**0.5  # weight of a contact along x or y over that of one along z, for a jump along x + y
ROUGHNESS, ENERGY = 0.41, 0.84  # zeta and theta of surfaces
HELD = 1e3  # friction that a held cut cannot cross
HEIGHT = 6.0  # height of lattices that are cut, over L^ROUGHNESS: in units of the width of cuts it is the same for all
PAPER_LOWEST = 0.1  # the paper's friction is uniform in [0.1, 1]
BLOCK = 10  # cuts that are drawn together
SIZES = {  # by lowest friction and by L of the cuts, samples for each sample of the effort
    0.0: {8: 40.0, 12: 40.0, 16: 40.0, 24: 40.0, 32: 15.0, 48: 2.5, 64: 0.75, 96: 0.1},
    0.1: {8: 2.0, 16: 2.0, 32: 1.0, 64: 0.25},
    0.2: {8: 2.0, 16: 2.0, 32: 1.0},
    0.3: {8: 2.0, 16: 2.0, 32: 1.0},
}
QUICK_SIZES = {0.0: {6: 10.0, 8: 10.0, 12: 10.0, 16: 10.0, 24: 5.0}, 0.1: {8: 5.0, 16: 5.0}, 0.3: {8: 5.0, 16: 5.0}}
# scan files with the samples whose minima are found, and the largest side that the quick form takes
SCANS = {"surfaces": 8, "surfaces-large": 8, "surfaces-largest": 8}


def cuts(length: int, lowest: float, samples: int, seed: int) -> dict[str, Any]:
    """Return numbers of minimum cuts between the bottom and top planes of random lattices of L x L spheres a layer:
    lists with one entry for each sample.

    length : L.
    lowest : the friction is uniform in [lowest, 1].
    samples, seed : number of samples, and seed from which all of them are drawn.

    `weight`: of the contacts of the cut, in units of the largest friction. `roughness`: variance of the height of the
    cut over its L x L columns, in spheres squared.

    The lattice is periodic in both sides, and the cut is held: it must pass through one given contact in the middle. A
    free cut would be the lightest of many surfaces; their number falls with their roughness, which changes the law up
    to large sizes. A held cut that departs from its contact has to cross the contacts of a spike around it.
    """
    middle = round(HEIGHT / 2 * length**ROUGHNESS)  # half the height
    rng = np.random.default_rng([seed, length, round(1000 * lowest)])
    heights = (2 * middle, 2 * middle, 2 * middle - 1)
    x, y, z = (rng.uniform(lowest, 1.0, (samples, length, length, height)) for height in heights)
    z[:, 0, 0] += np.where(np.arange(2 * middle - 1) == middle - 1, 0.0, HELD)  # one column has one contact to cross
    cut = minimum_cut((SIDEWAYS * x, SIDEWAYS * y, z))
    height_of_cut = np.count_nonzero(~cut.above, axis=3)
    return {"weight": cut.weight.tolist(), "roughness": height_of_cut.var(axis=(1, 2)).tolist()}


def numbers_of(structure: Structure) -> dict[str, Any]:
    """Return the columns of one sample at its minimum, by name.

    structure : network, domains and cut of the sample.

    Columns that several studies have (side, seed, gap, ...) are followed by:

    power, cut : least power, and power of the minimum cut, over F_n R omega_T.
    height : number of layers.
    layers : effective number of layers over which the spin changes: 1 / sum of share^2, where the share of a gap
        between two layers is its part of the change of the mean spin, with signs that alternate between neighbours. It
        is 1 if all of the change is between two layers.
    """
    scene, cut = of_lattice(structure.scene), structure.interface
    assert cut is not None  # as a lattice has two planes
    unit = scene.normal_force * scene.lattice.radius * scene.jump
    spin = scene.staggered_spin(structure.spin[None], scene.minimum_spin_axes)[:, 0]
    share = np.diff(spin.mean(axis=(0, 1, 2)))
    return shared_numbers(structure) | {
        "height": scene.lattice.shape[2], "power": structure.power / unit, "cut": cut.power / unit,
        "layers": float(share.sum() ** 2 / (share**2).sum()),
    }  # fmt: skip


def study(folder: Path, effort: Effort) -> StudyResult:
    """Find cut surfaces for several sizes and lowest frictions, and minima for several sides and heights; return
    tables, figure and values for the claims.

    folder : folder where finished samples are kept until the study ends.
    effort : first seed, number of samples, and whether it is the quick form.
    """
    sizes = QUICK_SIZES if effort.quick else SIZES
    wanted = {
        (L, lowest): max(BLOCK, round(part * effort.samples)) for lowest, of in sizes.items() for L, part in of.items()
    }
    # minima of cubes and of towers, which are higher than wide; and cut surfaces, of other samples
    minima = measured(planned(SCANS, effort), numbers_of, folder / "surfaces.jsonl")
    found = drawn(cuts, wanted, BLOCK, effort.seed, folder / "surfaces-cuts.jsonl")
    is_cube = minima.side == minima.height
    cubes = {side: minima[is_cube & (minima.side == side)] for side in np.unique(minima.side[is_cube]).tolist()}
    towers = minima[~is_cube].by("layers", "height")
    weight = {L: of["weight"] for (L, lowest), of in found.items() if lowest == 0}
    flat = {lowest: {L: found[L, lowest]["roughness"] for L in of} for lowest, of in sizes.items()}
    # exponents: of the weight and the width of cuts; of power over cut, and of the layers, at minima of cubes
    theta, zeta = exponent(weight), exponent(flat[0.0], np.mean)
    both = {side: np.stack([of.power, of.cut], axis=1) for side, of in cubes.items()}
    weaker = exponent(both, lambda powers: powers[:, 0].var() / powers[:, 1].var(), further=())
    layers = exponent({side: of.layers for side, of in cubes.items()}, lambda of: (of**2).mean(), further=())
    named = {
        "theta": theta, "zeta": zeta, "flat": flat, "weaker": weaker, "layers": layers, "cubes": cubes,
        "towers": towers, "roughness": ROUGHNESS, "energy": ENERGY, "tall": minima.side[~is_cube].min(),
        "paper_lowest": PAPER_LOWEST, "cut_samples": sum(map(len, weight.values())), "side_of_largest": max(cubes),
        "weight": weight,
    }  # fmt: skip
    rows = Table.of([row_of(point, of) for point, of in found.items()])
    return StudyResult({".csv": rows, "-minima.csv": minima}, draw_surfaces, named)


def row_of(point: tuple[int, float], found: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return a row of the table: number of samples, and mean and standard deviation of weight and roughness.

    point : side L and lowest friction.
    found : `weight` and `roughness` (samples,), as :func:`cuts` returns them.
    """
    row = {"side": point[0], "lowest_friction": point[1], "samples": len(found["weight"])}
    return row | {f"{how}_{name}": getattr(of, how)() for name, of in found.items() for how in ("mean", "std")}


@in_our_style
def draw_surfaces(named: Any) -> Figure:
    """Draw the figure, four panels against the side.

    named : the values that :func:`study` names, as attributes. Used are `weight`: by side, weights (samples,) of cuts;
        `flat`: by lowest friction and side, roughness (samples,) of cuts, spheres^2; `theta` and `zeta`: fits of the
        growth of these two; `cubes`: by side, a table of minima with the columns `power`, `cut` and `layers`; `towers`:
        by height, `layers` (samples,).

    (a) Standard deviation of the weight of cut surfaces.
    (b) Their width (root of the mean roughness), for each lowest friction.
    (c) Standard deviations of the least power, and of the power of the minimum cut.
    (d) Effective number of layers over which the spin of minima changes.
    """
    weight, theta, zeta = named.weight, named.theta, named.zeta
    flat, cubes, towers = named.flat, named.cubes, named.towers
    figure = new_figure(7.1, 5.0)
    (a, b), (c, d) = figure.subplots(2, 2)
    draw_deviations(a, weight, color=BLUE)
    draw_growth(a, weight, theta, BLUE, rf"$\theta$ = {theta.value:.2f} ± {theta.total:.2f}")
    a.set(ylabel="sd of the weight of cuts", title="(a) friction in [0, 1]")
    for (lowest, squares), color in zip(flat.items(), shades(len(flat)), strict=True):
        mean, error = mean_and_error(squares.values())
        width = np.sqrt(mean)
        above = np.sqrt(mean + error) - width
        b.errorbar(list(squares), width, above, fmt="o-", ms=3, lw=0.8, color=color, label=f"[{lowest:g}, 1]")
    draw_growth(b, flat[0.0], zeta, GREY, rf"$\zeta$ = {zeta.value:.2f} ± {zeta.total:.2f}")
    b.set(ylabel="width of cuts, spheres", title="(b) by the friction")
    for name, color, text in (("cut", ORANGE, "minimum cut"), ("power", BLUE, "minimum")):
        powers = {side: getattr(of_side, name) for side, of_side in cubes.items()}
        draw_deviations(c, powers, fmt="o-", color=color, label=text)
    c.set(ylabel="sd of the power", title="(c) friction in [0.1, 1], cubes")
    draw_means(
        d, {side: of_side.layers for side, of_side in cubes.items()}, color=BLUE, label="cubes, against the side"
    )
    draw_means(d, towers, color=ORANGE, label="towers, against the height")
    d.set(ylabel="layers in which the spin changes", title="(d) minima")
    for axes, ticks in ((a, list(weight)), (b, list(weight)), (c, list(cubes)), (d, sorted({*cubes, *towers}))):
        axes.set_yscale("linear" if axes is b else "log")
        name_sizes(axes, ticks, "spheres")
        if axes is not b:
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5)))
            axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.legend()
    return figure
