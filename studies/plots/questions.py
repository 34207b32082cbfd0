"""Questions beyond the paper: how minimum cuts and minima fluctuate with their size, and what odd contacts make of a
bearing."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, ScalarFormatter

from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, new_figure, shades

from .minima import mean_and_error


@in_our_style
def draw_exponents(
    weight: Mapping[int, np.ndarray], middle: Mapping[int, np.ndarray], theta: Any, zeta: Any, held: Any, free: Any
) -> Figure:
    """(a) standard deviations of the weight and of the height in the middle of held cuts against their length, with the
    fitted laws; (b) skewness of the weight, held ends against the length and free ends against the height.

    weight, middle : length -> (samples,). theta, zeta : Exponent. held, free : the points of paper.exponents.
    """
    figure = new_figure(7.1, 2.8)
    left, right = figure.subplots(1, 2)
    for found, fit, color, text in (
        (weight, theta, BLUE, r"weight, $\theta$"),
        (middle, zeta, ORANGE, r"middle, $\zeta$"),
    ):
        sizes = np.array(sorted(found))
        left.errorbar(sizes, *_spread([found[L] for L in sizes]), fmt="o", ms=3, color=color, lw=0.8)
        _law(left, sizes, fit, color, f"{text} = {fit.value:.3f} ± {fit.total:.3f}")
    left.set(xscale="log", yscale="log", xlabel="length of the cut, discs", ylabel="standard deviation")
    few = sizes[:: max(1, len(sizes) // 5)]
    left.set_xticks(few, few.astype(str))
    left.minorticks_off()
    left.set_title("(a) held ends")
    left.legend(loc="upper left")
    for table, x, color, text in (
        (held, held.length, BLUE, "held ends, against the length"),
        (free, free.height, ORANGE, f"free ends, length {free.length[0]}, against the height"),
    ):
        right.errorbar(x, table.skewness, table.its_error, fmt="o-", ms=3, lw=0.8, color=color, label=text)
    for value, text in ((-0.2241, "Tracy–Widom"), (-1.1395, "Gumbel")):
        right.axhline(value, color=GREY, lw=0.8)
        right.annotate(
            text, (1.0, value), xycoords=("axes fraction", "data"), ha="right", va="bottom", color=GREY, fontsize=7
        )
    right.set(xscale="log", xlabel="length or height, discs", ylabel="skewness of the weight")
    right.set_title("(b) distribution of the weight")
    right.set_ylim(-1.7, 0.3)
    right.legend(loc="lower left")
    return figure


@in_our_style
def draw_surfaces(
    weight: Mapping[int, np.ndarray], theta: Any, zeta: Any, flat: Mapping[float, Mapping[int, np.ndarray]],
    cubes: Mapping[int, Mapping[str, np.ndarray]], towers: Mapping[int, Mapping[str, np.ndarray]],
) -> Figure:  # fmt: skip
    """(a) standard deviation of the weight of cut surfaces, (b) their width by the lowest friction, against the side;
    (c) standard deviations of the least power and of that of the cut, (d) layers in which the spin changes, of minima.

    weight : L -> (samples,). flat : lowest friction -> L -> variances of the height (samples,). cubes, towers : by side
    and by height the samples of paper.surfaces.
    """
    figure = new_figure(7.1, 5.0)
    (a, b), (c, d) = figure.subplots(2, 2)
    sizes = np.array(sorted(weight))
    a.errorbar(sizes, *_spread([weight[L] for L in sizes]), fmt="o", ms=3, color=BLUE, lw=0.8)
    _law(a, sizes, theta, BLUE, rf"$\theta$ = {theta.value:.2f} ± {theta.total:.2f}")
    a.set(ylabel="sd of the weight of cuts", title="(a) friction in [0, 1]")
    for (lowest, of), color in zip(flat.items(), shades(len(flat)), strict=True):
        mean, error = mean_and_error(of.values())
        width = np.sqrt(mean)
        above = np.sqrt(mean + error) - width
        b.errorbar(list(of), width, above, fmt="o-", ms=3, lw=0.8, color=color, label=f"[{lowest:g}, 1]")
    _law(b, np.array(sorted(flat[0.0])), zeta, GREY, rf"$\zeta$ = {zeta.value:.2f} ± {zeta.total:.2f}")
    b.set(ylabel="width of cuts, spheres", title="(b) by the friction")
    sides = np.array(sorted(cubes))
    for name, color, text in (("cut", ORANGE, "minimum cut"), ("power", BLUE, "minimum")):
        spread = _spread([cubes[L][name] for L in sides])
        c.errorbar(sides, *spread, fmt="o-", ms=3, lw=0.8, color=color, label=text)
    c.set(ylabel="sd of the power", title="(c) friction in [0.1, 1], cubes")
    for found, color, text in (
        (cubes, BLUE, "cubes, against the side"),
        (towers, ORANGE, "towers, against the height"),
    ):
        x = np.array(sorted(found))
        d.errorbar(x, *mean_and_error([found[L]["layers"] for L in x]), fmt="o-", ms=3, lw=0.8, color=color, label=text)
    d.set(ylabel="layers in which the spin changes", title="(d) minima")
    for axes, ticks in ((a, sizes), (b, sizes), (c, sides), (d, sorted({*cubes, *towers}))):
        axes.set(xscale="log", yscale="linear" if axes is b else "log", xlabel="spheres")
        axes.set_xticks(ticks, [str(size) for size in ticks])
        axes.minorticks_off()
        if axes is not b:
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5)))
            axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.legend()
    return figure


def _spread(samples: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations and their errors."""
    pairs = [(of.std(), of.std() / (2 * len(of)) ** 0.5) for of in samples]
    return np.array([spread for spread, _ in pairs]), np.array([error for _, error in pairs])


def _law(axes: Any, sizes: np.ndarray, fit: Any, color: str, text: str) -> None:
    """The fitted growth of a standard deviation; fit : Exponent."""
    sizes = sizes[sizes >= fit.smallest]
    law = np.sqrt(np.maximum(fit.amplitude * sizes ** (2 * fit.value) + fit.offset, 0.0))
    axes.plot(sizes, law, color=color, lw=1, label=text)


@in_our_style
def draw_odd_loops(
    rolling: Mapping[str, Mapping[int, Mapping[int, np.ndarray]]],
    ruled: Mapping[str, Any],
    resting: Mapping[str, Mapping[float, np.ndarray]],
) -> Figure:
    """A row a lattice: (a) share of the discs that roll with the top against the number n of odd contacts, (b) against
    n / L^a, with the exponent a at which three or more sizes lie closest together; (c) share of the discs that rest,
    against the bottom's speed.

    rolling : L -> n -> (samples,). ruled : Collapse. resting : omega_B / omega_T -> (samples,), with as many odd
    contacts as are drawn in (a) at most; all by lattice.
    """
    figure = new_figure(7.1, 2.4 * len(rolling))
    rows: Any = figure.subplots(len(rolling), 3, squeeze=False)
    for panels, (lattice, curves) in zip(rows, rolling.items(), strict=True):
        rule = ruled[lattice].value
        for (L, of), color in zip(curves.items(), shades(len(curves)), strict=True):
            n = np.array([odd for odd in of if odd])
            mean, error = mean_and_error([of[odd] for odd in n])
            panels[0].axhline(of[0].mean(), color=color, lw=0.6, ls=":")
            for axes, x in ((panels[0], n), (panels[1], n / L**rule))[: 1 + (len(curves) > 2)]:
                axes.errorbar(x, mean, error, fmt="o-", ms=3, lw=0.8, color=color, label=f"L = {L}")
        panels[0].set(xscale="log", xlabel="odd contacts n", ylabel="share of discs that roll", ylim=(0, 0.85))
        panels[0].set_xticks(n, [str(number) for number in n])
        panels[0].minorticks_off()
        panels[0].set_title(f"{lattice}; dotted: none")
        panels[0].legend(loc="upper right", ncols=2)
        if len(curves) > 2:
            panels[1].set(xscale="log", xlabel=f"$n / L^{{{rule:.2f}}}$", ylim=(0, None))
            panels[1].set_title("the sizes together")
        else:
            panels[1].set_axis_off()
        if lattice not in resting:
            panels[2].set_axis_off()
            continue
        bottoms = np.array(list(resting[lattice]))
        panels[2].plot(bottoms, [values.mean() for values in resting[lattice].values()], "o-", color=BLUE, ms=3)
        panels[2].axhline(1.0, color=GREY, lw=0.8)
        panels[2].set(xlabel=r"$\omega_B / \omega_T$", ylabel="share of discs that rest", ylim=(0, 1.05))
        panels[2].set_title("most odd contacts")
    return figure
