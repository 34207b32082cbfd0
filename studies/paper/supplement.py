"""The supplement's distribution of power over the contacts of 32x32x32 spheres: that of a gradient descent, compared
with that of the certified minimum.

At the minimum a contact either slips or does not, and which of the two is proven. A descent that has not ended lets all
of them slip a little, so its histogram has decades that are not there at the minimum. The states of the minimum show
how many of the contacts in each decade of the descent really slip. The range of the minimum itself is proven, too:
every slip is enclosed (proof/curvature.py), so the smallest and the largest power are.

Letters: n contacts that can slip, those of a lattice less those between two driven spheres.
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
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.scene.scene import of_lattice
from taichi_bearings.solvers import GradientDescent, InteriorPoint
from taichi_bearings.solvers.stopping import StopRule

from .claims import Effort
from .samples import Part, StudyResult, Table, computed, joined, solved

SHAPE, SPIN_BOTTOM = (32, 32, 32), 0.1
SHARE_OF_SAMPLES = 0.04  # minima that are found, over the samples of the effort
PAPER_ITERATIONS = 1_000_000  # of the paper's descent
ITERATIONS, QUICK_ITERATIONS = (10_000, 100_000, PAPER_ITERATIONS), (10_000, 100_000)
BUDGET, QUICK_BUDGET = 1500.0, 90.0  # most seconds of a descent
BINS_PER_DECADE = 5
POWER = r"power, $P_e\,/\,(F_n R\,\omega_T)$"
COUNT = "contacts per bin"


@dataclass(frozen=True)
class Ending:
    """The state of one sample at the end of a method, for the n contacts that can slip.

    power : (n,), dissipated power of each contact, over F_n R omega_T.
    slips : (n,), True if the contact slips at the minimum; for a descent, if it slips at all.
    total : power of all contacts, in the same unit.
    iterations : number of iterations made.
    slip_error : proven bound on the relative difference of any slip from that of the minimum; None if it is not known.
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
        """Orders of magnitude of the power of contacts that slip, without the lowest and the highest 5 % of them."""
        low, high = np.quantile(np.log10(self.power[self.slips]), (0.05, 0.95))
        return float(high - low)


def study(folder: Path, effort: Effort) -> StudyResult:
    """Follow descents of the first sample for 10^4, 10^5 and 10^6 iterations, and find the minima of some samples;
    return table, figure and values for the claims.

    folder : folder where finished descents and minima are kept until the study ends.
    effort : first seed, number of samples, and whether it is the quick form.
    """
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
    return StudyResult({".csv": table}, draw_decades, names_of(descents, minima))


def names_of(descents: Sequence[Ending], minima: Sequence[Ending]) -> dict[str, Any]:
    """Return the values that the figure and the claims use, by name.

    descents : endings of gradient descents of the first sample, from the shortest to the longest.
    minima : certified minima; the first one is of the same sample.

    * `descent`, the longest of the descents (None without any), and `minimum`, the minimum of the same sample;
    * `decade`, the table of :func:`by_decade` for these two;
    * `paper_iterations`, the length of the paper's descent;
    * `proven`, those minima in which every slip is enclosed: the smallest slips of others may be errors of the method.
    """
    return {
        "descents": descents, "descent": descents[-1] if descents else None, "minima": minima, "minimum": minima[0],
        "decade": by_decade(descents[-1], minima[0]) if descents else None, "paper_iterations": PAPER_ITERATIONS,
        "proven": [ending for ending in minima if ending.slip_error is not None], "none": "no sample with proven slips",
    }  # fmt: skip


def scene_of(seed: int) -> Scene:
    """Return the sample with this seed: 32x32x32 spheres, driven as in the paper."""
    return Scene.random(SHAPE, seed, spin_bottom=SPIN_BOTTOM)


def descended(seed: int, iterations: int, seconds: float) -> dict[str, Any]:
    """Return the state at which the paper's method ends, gradient descent without momentum from random spins: the
    fields of an :class:`Ending`, with arrays packed into texts.

    seed : seed of the sample.
    iterations, seconds : it ends after so many iterations, or after so many seconds.
    """
    rule = StopRule(1e-12, iterations, seconds)
    ended = solved(scene_of(seed), GradientDescent(momentum=False), rule, "random")
    return _packed_ending(ended, lambda power, _: power > 0, None)


def minimum(seed: int) -> dict[str, Any]:
    """Return the certified minimum of the sample with this seed: the fields of an :class:`Ending`, with arrays packed
    into texts.
    """
    solution = solved(scene_of(seed), InteriorPoint(), StopRule(1e-9))
    return _packed_ending(solution, lambda _, state: state == ContactState.SLIPPING, largest_slip_error(solution))


def _packed_ending(
    solution: Solution, slips: Callable[[np.ndarray, np.ndarray], np.ndarray], slip_error: float | None
) -> dict[str, Any]:
    """Return the fields of an :class:`Ending` in a form that JSON can store; arrays are packed into texts.

    solution : state at the end of a method, of one sample.
    slips : function that returns the mask (contacts,) of those that slip, from their powers and states (contacts,).
    slip_error : proven bound on the relative difference of any slip from that of the minimum, None where it is not
        known.
    """
    scene = of_lattice(solution.scene)
    free = ~scene.lattice.between_driven
    power, state = solution.power_per_contact[0, free], solution.state[0, free]
    unit = scene.normal_force * scene.lattice.radius * abs(scene.spin_top)
    numbers = {"total": float(solution.power[0]) / unit, "iterations": solution.iterations}
    contacts = {"power": packed(power / unit), "slips": packed(slips(power, state))}
    return contacts | numbers | {"slip_error": slip_error}


def packed(values: np.ndarray) -> str:
    """Return an array (`values`) as a compressed text. As digits the numbers of 32x32x32 spheres would be too long for
    a line of a journal.
    """
    return b64encode(zlib.compress(values.tobytes())).decode()


def unpacked(text: str, kind: type) -> np.ndarray:
    """Return the array from a text that :func:`packed` has made.

    kind : type of its entries.
    """
    return np.frombuffer(zlib.decompress(b64decode(text)), kind)


def largest_slip_error(solution: Solution) -> float | None:
    """Return a proven bound on the relative difference of any slip in a solution of one sample from the same contact's
    slip at every minimum; None where not all contact states are proven, or no minimum can be enclosed.
    """
    if not solution.states_proven.all():
        return None
    judgement = Judgement.of(of_lattice(solution.scene), solution.spin, solution.spin_rounding, solution.friction)
    contacts = None if judgement is None else Slipping.of(judgement.network.motion)
    if contacts is None or (nearest := nearest_minimum(contacts)) is None:
        return None
    # relative changes of each slip: by Newton's method, and a bound on that from its result to the minimum
    improved, to_minimum = nearest
    by_newton = np.abs(improved.size.value / contacts.size.value - 1)
    return float((by_newton + to_minimum * (1 + by_newton)).max(initial=0.0))


def by_decade(descent: Ending, minimum: Ending) -> Table:
    """Return how the contacts are distributed over the decades of power in a descent: a table with a row for each
    decade, from the lowest on.

    descent, minimum : the end of a gradient descent of a sample, and the certified minimum of the same sample.

    Columns: `exponent`, of the decade [10^exponent, 10^(exponent + 1)) of power over F_n R omega_T; `contacts`, whose
    power in the descent is in the decade; `slipping`, those of them that slip at the minimum; `at_minimum`, contacts
    whose power at the minimum is in the decade.
    """
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
    """Return the decade of power of each contact, (contacts,): the exponent floor(log10(power)), or -9999, which is
    below all others, if the contact does not slip.

    power : (contacts,), dissipated power of each, over F_n R omega_T.
    slips : (contacts,), True if the contact slips.
    """
    found: np.ndarray = np.floor(np.log10(power, out=np.full(len(power), -9999.0), where=slips)).astype(int)
    return found


@in_our_style
def draw_decades(named: Any) -> Figure:
    """Draw the figure: (a) histograms of the power of single contacts, at the certified minimum and at the end of each
    gradient descent; (b) that of the longest descent, divided into contacts that slip at the minimum and others;
    (c) for each contact that slips at the minimum, its power there against that in the longest descent.

    named : the values of :func:`names_of` as attributes. Used are `minimum`, `descent` (the longest one) and `descents`
        (all of them, shortest first), each an Ending with two arrays for the n contacts that can slip: `power` (n,), in
        units of F_n R omega_T, and the mask `slips` (n,).
    """
    figure = new_figure(7.1, 2.6)
    panels: Any = figure.subplots(1, 3)
    slips, longest, descents = named.minimum.slips, named.descent.power, named.descents
    powers = [named.minimum.power[slips], *(descent.power for descent in descents)]
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
        axes.set_ylim(0.5, 300 * axes.dataLim.ymax)  # the legend is above the data
        axes.legend(loc="upper left", fontsize="small")
    panels[2].plot(longest[slips], powers[0], ".", color=BLUE, ms=1.2, alpha=0.25, mew=0, rasterized=True)
    ends = [powers[0].min(), max(powers[0].max(), longest.max())]
    panels[2].plot(ends, ends, color=GREY, lw=0.8)
    panels[2].set(xscale="log", yscale="log", xlabel=POWER, ylabel="the same at the minimum")
    panels[2].set_title("(c) those that slip")
    for axes in panels:
        label_in_plain_text(axes.xaxis, axes.yaxis)
    return figure
