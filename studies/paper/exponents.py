"""Minimum cuts of discs as directed polymers: how their weight and their course fluctuate with the length.

The interface of two bearing states in a plane is the lightest path from one side of the lattice to the other, in the
random friction of the contacts that it crosses: a directed polymer at no temperature, of the class of Kardar, Parisi
and Zhang. Its weight E fluctuates like L^theta and the path wanders like L^zeta with theta = 1/3 and zeta = 2/3 (Huse
and Henley, Phys. Rev. Lett. 54, 1985). With both ends held, -E follows the Tracy-Widom law of unitary matrices
(Johansson, Commun. Math. Phys. 209, 2000), whose skewness is 0.2241. With free ends in a tall lattice the path is the
lightest of many that are nearly independent, and extreme-value statistics take over: Gumbel, skewness -1.1395.
"""

from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.files.whole_file import write_csv
from taichi_bearings.numerics.planar import minimum_cuts
from taichi_bearings.stages import stage

from ..plots.exponents import draw_exponents
from .blocks import drawn
from .claims import Claim, Effort, judge
from .fits import exponent, skewness
from .samples import save_both

FRICTION = (0.1, 1.0)  # uniform, the paper's
HELD = 1e3  # friction that the ends of a path cannot cross
WIDTH = 2.5  # half the height beside a held path, over L^(2/3): seven standard deviations of its middle
BLOCK = 100  # samples that are drawn together
SIZES, QUICK_SIZES = (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256), (8, 12, 16, 24, 32, 48)
TALL, QUICK_TALL = (16, 64, 256, 1024), (16, 64, 256)  # heights of free scenes of length FREE
FREE = 16
LONG, QUICK_LONG = 96, 32  # length of cuts whose weights are compared with the law of Tracy and Widom
PER_SEED = 20  # samples of a held length for each of `Effort.samples`, fewer where they are large
TRACY_WIDOM, GUMBEL = -0.2241, -1.1395  # skewness of E


def draw(kind: str, length: int, height: int, samples: int, seed: int) -> dict[str, Any]:
    """Weights of the minimum cuts of a block, in units of the largest friction, and their heights in the middle."""
    rng = np.random.default_rng([seed, length, height])
    sideways = rng.uniform(*FRICTION, (samples, length - 1, height))
    upward = rng.uniform(*FRICTION, (samples, length, height - 1))
    if kind == "held":
        upward[:, [0, -1]] += np.where(np.arange(height - 1) == (height - 1) // 2, 0.0, HELD)[None, None]
    weight, middle = [], []
    for _, cuts in minimum_cuts(sideways, upward):
        weight += cuts.weight.tolist()
        middle += np.count_nonzero(~cuts.above, axis=2)[:, length // 2].tolist()
    return {"weight": weight, "middle": middle}


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write exponents.png, .pdf and .csv into `folder`; returns the claims with their verdicts."""
    sizes, tall, long = (QUICK_SIZES, QUICK_TALL, QUICK_LONG) if effort.quick else (SIZES, TALL, LONG)
    points = [("held", size, 2 * int(WIDTH * size ** (2 / 3)) + 3) for size in sizes]
    points += [("free", FREE, height) for height in tall]
    most = PER_SEED * effort.samples
    wanted = {
        point: max(BLOCK, most if point[1] <= 64 else most // 2 if point[1] <= 128 else most // 4) for point in points
    }
    found = drawn(draw, wanted, BLOCK, effort.seed, folder / "exponents.jsonl")
    skewed = {point: skewness(of["weight"]) for point, of in found.items()}
    rows = [[*point, len(of["weight"]), of["weight"].mean(), of["weight"].std(), of["middle"].std(), *skewed[point]]
            for point, of in found.items()]  # fmt: skip
    names = ["ends", "length", "height", "samples", "mean_weight", "sd_weight", "sd_middle", "skewness", "its_error"]
    write_csv(folder / "exponents.csv", names, rows)
    weight, middle = ({p[1]: of[name] for p, of in found.items() if p[0] == "held"} for name in ("weight", "middle"))
    own = {length: of for (kind, length, _), of in skewed.items() if kind == "held"}
    free = {height: of for (kind, _, height), of in skewed.items() if kind == "free"}
    theta, zeta = exponent(weight), exponent(middle)
    with stage("drawing"):
        save_both(draw_exponents(weight, middle, theta, zeta, own, free, FREE), folder, "exponents")
    count = sum(map(len, weight.values()))
    together = {length: values for length, values in own.items() if length >= long}
    share = np.array([1 / error**2 for _, error in together.values()])
    pinned = float(np.average([value for value, _ in together.values()], weights=share))
    return [
        judge("exponents.theta", told(theta), samples=count, exact=1 / 3),
        judge("exponents.zeta", told(zeta), samples=count, exact=2 / 3),
        judge(
            "exponents.relation",
            {"difference": theta.value - 2 * zeta.value + 1, "error": float(np.hypot(theta.total, 2 * zeta.total))},
            samples=count,
        ),
        judge(
            "exponents.tracy_widom",
            {"skewness": pinned, "error": float(share.sum() ** -0.5)},
            exact=TRACY_WIDOM,
            least=min(together),
            samples=sum(len(weight[L]) for L in together),
        ),
        judge(
            "exponents.gumbel",
            {"skewness": [value for value, _ in free.values()], "error": [error for _, error in free.values()]},
            heights=list(free),
            length=FREE,
            exact=GUMBEL,
            samples=wanted["free", FREE, tall[-1]],
        ),
    ]


def told(found: Any) -> dict[str, Any]:
    """Of an Exponent, for programs and sentences."""
    names = ("value", "error", "systematic", "total", "smallest", "goodness", "offset")
    return {name: getattr(found, name) for name in names} | {"fits": list(found.fits.values())}
