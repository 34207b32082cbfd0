"""The supplement's distribution of power over the contacts of 32x32x32 spheres: the certified one beside the descent's.

At the minimum a contact slips or rests, and which does is proven. A descent that has not ended lets all of them slip a
little, so its histogram has decades that are not there at the minimum. Here the states of the minimum tell how many of
the contacts in each decade of the descent really slip. The range of the minimum itself is proven, too: every slip is
enclosed (proof/curvature.py), so the smallest and the largest power are.
"""

import zlib
from base64 import b64decode, b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, GREY, ORANGE, in_our_style, label_in_plain_text, new_figure, shades
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.proof.curvature import Slipping, nearest_minimum
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.scene.scene import of_lattice
from taichi_bearings.solvers import GradientDescent, InteriorPoint
from taichi_bearings.solvers.answer import judged
from taichi_bearings.solvers.stopping import StopRule

from .claims import Effort
from .samples import Found, Part, Table, computed, joined, solved

SHAPE, SPIN_BOTTOM = (32, 32, 32), 0.1
SHARE_OF_SAMPLES = 0.04
PAPER_ITERATIONS = 1_000_000
ITERATIONS, QUICK_ITERATIONS = (10_000, 100_000, PAPER_ITERATIONS), (10_000, 100_000)
BUDGET, QUICK_BUDGET = 1500.0, 90.0  # seconds of a descent
BINS_PER_DECADE = 5
POWER = r"power, $P_e\,/\,(F_n R\,\omega_T)$"
COUNT = "contacts per bin"


@dataclass(frozen=True)
class Ending:
    """Where a method has ended in one sample, of the n contacts that can slip.

    power : (n,), over F_n R omega_T. slips : (n,), whether it does at the minimum (certified) or moves at all
    (descent). iterations : done. slip_error : share by
    which any slip differs from that of the minimum at most, proven; None where that is not known.
    """

    power: np.ndarray
    slips: np.ndarray
    total: float
    iterations: int
    slip_error: float | None

    @property
    def decades(self) -> float:
        """Orders of magnitude from the smallest to the largest power of the contacts that slip."""
        found = self.power[self.slips]
        return float(np.log10(found.max() / found.min()))

    @property
    def central_decades(self) -> float:
        """The same without the lowest and the highest twentieth of them."""
        low, high = np.quantile(np.log10(self.power[self.slips]), (0.05, 0.95))
        return float(high - low)


def study(folder: Path, effort: Effort) -> Found:
    """Descents of the first sample, and the minima of some."""
    lengths, budget = (QUICK_ITERATIONS, QUICK_BUDGET) if effort.quick else (ITERATIONS, BUDGET)
    parts = [Part(f"descent-{length}", descended, (effort.seed, length, budget)) for length in lengths]
    seeds = effort.seeds(max(1, int(SHARE_OF_SAMPLES * effort.samples)))
    parts += [Part(f"minimum-{seed}", minimum, (seed,)) for seed in seeds]
    found = computed(parts, folder / "supplement.jsonl", "descent or minimum", workers=1)
    kinds = {"power": float, "slips": bool}
    endings = [Ending(**of | {name: unpacked(of[name], kind) for name, kind in kinds.items()}) for of in found]
    descents, minima = endings[: len(lengths)], endings[len(lengths) :]
    decades = [by_decade(descent, minima[0]) for descent in descents]
    table = joined({f"{of.iterations}": table for of, table in zip(descents, decades, strict=True)}, "iterations")
    return Found({".csv": table}, draw_decades, names_of(descents, minima))


def names_of(descents: Sequence[Ending], minima: Sequence[Ending]) -> dict[str, Any]:
    """What the claims name; proven : minima of which every slip is enclosed. Of others the smallest slips may be the
    method's."""
    return {
        "descents": descents, "descent": descents[-1] if descents else None, "minima": minima, "minimum": minima[0],
        "decade": by_decade(descents[-1], minima[0]) if descents else None, "paper_iterations": PAPER_ITERATIONS,
        "proven": [ending for ending in minima if ending.slip_error is not None], "none": "no sample with proven slips",
    }  # fmt: skip


def scene_of(seed: int) -> Scene:
    return Scene.random(SHAPE, seed, spin_bottom=SPIN_BOTTOM)


def descended(seed: int, iterations: int, seconds: float) -> dict[str, Any]:
    """The paper's method: descent without momentum, from random spins, for so many iterations or so long."""
    rule = StopRule(1e-12, iterations, seconds)
    ended = solved(scene_of(seed), GradientDescent(momentum=False), rule, "random")
    return _ending(ended, lambda power, _: power > 0, None)


def minimum(seed: int) -> dict[str, Any]:
    """The certified minimum, with the states of its contacts."""
    solution = solved(scene_of(seed), InteriorPoint(), StopRule(1e-9))
    return _ending(solution, lambda _, state: state == ContactState.SLIPPING, largest_slip_error(solution))


def _ending(
    solution: Solution, slips: Callable[[np.ndarray, np.ndarray], np.ndarray], slip_error: float | None
) -> dict[str, Any]:
    """An Ending as plain numbers."""
    scene = of_lattice(solution.scene)
    free = ~scene.lattice.between_driven
    power, state = solution.power_per_contact[0, free], solution.state[0, free]
    unit = scene.normal_force * scene.lattice.radius * abs(scene.spin_top)
    numbers = {"total": float(solution.power[0]) / unit, "iterations": solution.iterations}
    contacts = {"power": packed(power / unit), "slips": packed(slips(power, state))}
    return contacts | numbers | {"slip_error": slip_error}


def packed(values: np.ndarray) -> str:
    """Numbers as a text: as digits those of 32x32x32 spheres would be too long for a line of a journal."""
    return b64encode(zlib.compress(values.tobytes())).decode()


def unpacked(text: str, kind: type) -> np.ndarray:
    return np.frombuffer(zlib.decompress(b64decode(text)), kind)


def largest_slip_error(solution: Solution) -> float | None:
    """Share by which any slip differs from that of every minimum at most; None where the states are not proven."""
    if not solution.states_proven.all():
        return None
    judgement = judged(of_lattice(solution.scene), solution.spin, solution.spin_rounding, solution.friction)
    contacts = None if judgement is None else Slipping.of(judgement.network.motion)
    if contacts is None or (near := nearest_minimum(contacts)) is None:
        return None
    improved, turn = near
    moved = np.abs(improved.size.value / contacts.size.value - 1)  # by Newton's method, before it was enclosed
    return float((moved + turn * (1 + moved)).max(initial=0.0))


def by_decade(descent: Ending, minimum: Ending) -> Table:
    """From the lowest to the highest decade of a descent: its contacts with powers in [10^exponent, 10^(exponent + 1)),
    how many of them slip at the minimum, and the contacts that slip there with such powers."""
    of_contact, of_minimum = (_exponents(ending.power, ending.slips) for ending in (descent, minimum))
    used = of_contact[descent.slips]
    exponent = np.arange(used.min(), used.max() + 1)
    inside = of_contact == exponent[:, None]
    columns = {
        "exponent": exponent,
        "contacts": inside.sum(axis=1),
        "slipping": (inside & minimum.slips).sum(axis=1),
        "at_minimum": (of_minimum == exponent[:, None]).sum(axis=1),
    }
    return Table(columns)


def _exponents(power: np.ndarray, slips: np.ndarray) -> np.ndarray:
    """Decade of each contact; a number below all others where it does not slip."""
    return np.floor(np.log10(power, out=np.full(len(power), -9999.0), where=slips)).astype(int)


@in_our_style
def draw_decades(of: Any) -> Figure:
    """(a) histograms of the minimum and of the descents; (b) the longest descent, and which of its contacts rest at the
    minimum; (c) power by power, of those that slip."""
    figure = new_figure(7.1, 2.6)
    panels: Any = figure.subplots(1, 3)
    slips, longest, descents = of.minimum.slips, of.descent.power, of.descents
    powers = [of.minimum.power[slips], *(descent.power for descent in descents)]
    low = min(float(values[values > 0].min()) for values in powers)
    high = max(float(values.max()) for values in powers)
    first, last = np.floor(np.log10(low) * BINS_PER_DECADE), np.ceil(np.log10(high) * BINS_PER_DECADE)
    edges = 10.0 ** (np.arange(first, last + 1) / BINS_PER_DECADE)
    panels[0].hist(powers[0], edges, color=BLUE, alpha=0.3, label="minimum, certified")
    for descent, colour in zip(descents, reversed(shades(len(descents))), strict=True):
        label = f"descent, {descent.iterations:,}"
        panels[0].hist(descent.power, edges, histtype="step", color=colour, lw=1.0, label=label)
    panels[0].set_title("(a) all histograms")
    for values, colour, label in ((longest[slips], BLUE, "slip"), (longest[~slips], ORANGE, "rest")):
        label = f"{len(values):,} {label} at min."
        panels[1].hist(values, edges, histtype="stepfilled", color=colour, alpha=0.35, label=label)
        panels[1].hist(values, edges, histtype="step", color=colour, lw=1.0)
    panels[1].set_title("(b) longest descent")
    for axes in panels[:2]:
        axes.set(xscale="log", yscale="log", xlabel=POWER, ylabel=COUNT)
        axes.set_ylim(0.5, 300 * axes.dataLim.ymax)  # room for the legend
        axes.legend(loc="upper left", fontsize="small")
    panels[2].plot(longest[slips], powers[0], ".", color=BLUE, ms=1.2, alpha=0.25, mew=0, rasterized=True)
    ends = [powers[0].min(), max(powers[0].max(), longest.max())]
    panels[2].plot(ends, ends, color=GREY, lw=0.8)
    panels[2].set(xscale="log", yscale="log", xlabel=POWER, ylabel="the same at the minimum")
    panels[2].set_title("(c) those that slip")
    for axes in panels:
        label_in_plain_text(axes.xaxis, axes.yaxis)
    return figure
