"""Minimum cuts of discs as directed polymers: how their weight and their course fluctuate with the length.

The interface of two rigid domains of discs in a plane is the lightest path from one side of the lattice to the other,
in the random friction of the contacts that it crosses: a directed polymer at zero temperature, of the class of Kardar,
Parisi and Zhang. Its weight E fluctuates like L^theta and the path wanders like L^zeta with theta = 1/3 and zeta = 2/3
(Huse and Henley, Phys. Rev. Lett. 54, 1985). With both ends held, -E follows the Tracy-Widom law of unitary matrices
(Johansson, Commun. Math. Phys. 209, 2000), whose skewness is 0.2241. With free ends in a tall lattice the path is the
lightest of many that are nearly independent, and extreme-value statistics take over: Gumbel, skewness -1.1395.

A cut has held ends if the path must begin and end in the middle of both sides, else free ends.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, new_figure

from .claims import Effort
from .drawing import draw_deviations, draw_growth, name_sizes
from .fits import exponent, growing_skewness, skewness, skewness_of_least
from .samples import StudyResult, Table, drawn
from .sweeps import crossings

FRICTION = (0.1, 1.0)  # uniform, the paper's
HELD = 1e3  # friction that no lightest path crosses: it fixes the ends of paths
WIDTH = 2.5  # half the height of the lattice over L^(2/3): seven standard deviations of a held path's middle
BLOCK = 100  # samples whose numbers are kept together
AT_ONCE = 2**20  # most discs of all samples that are drawn together, unless one sample has more
# length of held cuts -> samples for each sample of the effort
SIZES = dict.fromkeys((8, 12, 16, 24, 32, 48, 64), 500) | {
    96: 250, 128: 250, 192: 200, 256: 200, 384: 100, 512: 100, 768: 50, 1024: 50,
}  # fmt: skip
QUICK_SIZES = dict.fromkeys((8, 12, 16, 24, 32, 48), 500)
TALL, QUICK_TALL = (16, 64, 256, 1024), (16, 64, 256)  # heights of free scenes of length FREE
FREE, OF_FREE = 16, 500  # length of free cuts, and samples of them for each sample of the effort
LONG, QUICK_LONG = 96, 32  # length of cuts whose weights are compared with the law of Tracy and Widom
TRACY_WIDOM, GUMBEL = -0.2241, -1.1395  # skewness of E
THETA = 1 / 3  # exponent of directed polymers; the next term of the variance goes like L^-THETA


def draw(kind: str, length: int, height: int, samples: int, seed: int) -> dict[str, Any]:
    """Return two lists with one entry for each of some random square lattices of discs, by name: `weight`, the friction
    coefficients of the contacts of its minimum cut, summed; and `middle`, the height at which this cut crosses the
    middle column, in discs.

    kind : "held" if the cut must begin and end in the middle of both sides, else "free".
    length, height : numbers of discs along the cut and across it.
    samples, seed : number of lattices, and seed from which the friction of all of them is drawn.
    """
    rng = np.random.default_rng([seed, length, height])
    found: dict[str, list[float]] = {"weight": [], "middle": []}
    at_once = max(1, AT_ONCE // (length * height))
    for first in range(0, samples, at_once):
        count = min(at_once, samples - first)
        sideways = rng.uniform(*FRICTION, (count, length - 1, height))
        upward = rng.uniform(*FRICTION, (count, length, height - 1))
        if kind == "held":
            # in the first and the last column only the middle contact can be crossed
            upward[:, [0, -1]] += np.where(np.arange(height - 1) == (height - 1) // 2, 0.0, HELD)[None, None]
        through = crossings(sideways, upward, length // 2)
        found["weight"] += through.min(axis=1).tolist()
        found["middle"] += (through.argmin(axis=1) + 1).tolist()
    return found


def study(folder: Path, effort: Effort) -> StudyResult:
    """Compute the lightest cuts of random lattices; return table, figure and values for the claims.

    Some cuts have held ends (they begin and end in the middle of both sides), for several lengths of the cut; others
    have free ends, for several heights of the lattice.

    folder : where finished samples are stored until the study ends.
    effort : first seed, number of samples, and whether it is the quick form.
    """
    sizes, tall, long = (QUICK_SIZES, QUICK_TALL, QUICK_LONG) if effort.quick else (SIZES, TALL, LONG)
    # kinds and sizes of lattices, and samples of each
    points = {("held", size, 2 * int(WIDTH * size ** (2 / 3)) + 3): several for size, several in sizes.items()}
    points |= {("free", FREE, height): OF_FREE for height in tall}
    wanted = {point: max(BLOCK, several * effort.samples) for point, several in points.items()}
    found = drawn(draw, wanted, BLOCK, effort.seed, folder / "exponents.jsonl")
    rows = [row_of(point, of) for point, of in found.items()]
    held, free = (Table.of([row for row in rows if row["ends"] == kind]) for kind in ("held", "free"))
    weight, middle = ({p[1]: of[name] for p, of in found.items() if p[0] == "held"} for name in ("weight", "middle"))
    theta, zeta = exponent(weight), exponent(middle)
    # skewness of the least of several weights of the next lower lattice, to compare with that of this height
    lightest = {
        high: skewness_of_least(found["free", FREE, low]["weight"], high // low) for low, high in pairwise(tall)
    }
    named = {
        "theta": theta, "zeta": zeta, "further": exponent(weight, further=(0.0, -THETA)),
        "grown": growing_skewness(weight, THETA), "lightest": lightest,
        "held": held, "free": free, "pinned": held[held.length >= long], "free_length": FREE,
        "law_of_tracy_and_widom": TRACY_WIDOM, "law_of_gumbel": GUMBEL, "weight": weight, "middle": middle,
    }  # fmt: skip
    return StudyResult({".csv": Table.of(rows)}, draw_exponents, named)


def row_of(point: tuple[Any, ...], found: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return a row of the table for one kind and size of lattice: number of samples, mean and standard deviations of
    weight and middle height, and skewness of the weight with its error.

    point : ends ("held" or "free"), length and height.
    found : `weight` and `middle` (samples,), as :func:`draw` returns them.
    """
    numbers = (len(found["weight"]), found["weight"].mean(), found["weight"].std(), found["middle"].std())
    names = ("ends", "length", "height", "samples", "mean_weight", "sd_weight", "sd_middle", "skewness", "its_error")
    return dict(zip(names, (*point, *numbers, *skewness(found["weight"])), strict=True))


@in_our_style
def draw_exponents(named: Any) -> Figure:
    """Draw the figure of random cuts.

    named : the values that :func:`study` names, as attributes. Used are `weight` and `middle`: by length, (samples,)
        weights and middle heights of cuts with held ends; `theta`, `zeta` and `further`: fits of their growth; `held`
        and `free`: tables with columns `length`, `height`, `skewness`, `its_error`; `free_length`, in discs.

    (a) Standard deviations of weight and middle height of cuts with held ends against their length, with the fitted
        laws.
    (b) Skewness of the weight: with held ends against the length, with free ends against the height.
    """
    figure = new_figure(7.1, 2.8)
    left, right = figure.subplots(1, 2)
    further = f",\nwith the next term {named.further.value:.3f} ± {named.further.total:.3f}"
    for found, fit, color, text, more in (
        (named.weight, named.theta, BLUE, r"weight, $\theta$", further),
        (named.middle, named.zeta, ORANGE, r"middle, $\zeta$", ""),
    ):
        draw_deviations(left, found, color=color)
        draw_growth(left, found, fit, color, f"{text} = {fit.value:.3f} ± {fit.total:.3f}{more}")
    left.set(yscale="log", ylabel="standard deviation")
    name_sizes(left, list(named.weight)[:: max(1, len(named.weight) // 5)], "length of the cut, discs")
    left.set_title("(a) held ends")
    left.legend(loc="upper left")
    for table, x, color, text in (
        (named.held, named.held.length, BLUE, "held ends, against the length"),
        (named.free, named.free.height, ORANGE, f"free ends, length {named.free_length}, against the height"),
    ):
        right.errorbar(x, table.skewness, table.its_error, fmt="o-", ms=3, lw=0.8, color=color, label=text)
    for value, text in ((TRACY_WIDOM, "Tracy–Widom"), (GUMBEL, "Gumbel")):
        right.axhline(value, color=GREY, lw=0.8)
        right.annotate(
            text, (1.0, value), xycoords=("axes fraction", "data"), ha="right", va="top", color=GREY, fontsize=7
        )
    right.set(xscale="log", xlabel="length or height, discs", ylabel="skewness of the weight")
    right.set_title("(b) distribution of the weight")
    right.set_ylim(-1.7, 0.3)
    right.legend(loc="lower left")
    return figure
