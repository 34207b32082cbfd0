"""Draws curves: how a run went, the distribution of power over the contacts, and numbers of the samples of a scan."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator

from taichi_bearings.analysis.histogram import ENERGY_PER_TIME, PowerHistogram
from taichi_bearings.errors import InputError
from taichi_bearings.plots import style
from taichi_bearings.plots.page import PAGE, Page
from taichi_bearings.plots.style import as_text, describe, driving, energy_unit, over, power_unit, time_label
from taichi_bearings.scene import Solution
from taichi_bearings.words import counted, other_contacts

ACCOUNTS = {
    "injected": (style.BLUE, "-"),
    "dissipated": (style.ORANGE, "-"),
    "kinetic": (style.GREEN, "--"),
    "spring": (style.GREY, (0, (4, 1, 1, 1))),
}
MOST_DECADES = 6  # most decades on each side of zero of an axis that is linear around 0 and logarithmic beyond
MOST_TICKS = 9
LEAST_RATIO = 30.0  # an axis is logarithmic if its last iteration, or time, is more than so many times its first one


@style.in_our_style
def draw_history(answer: Solution, page: Page = PAGE) -> Figure:
    """Draw power and proven lower bound against iterations (or simulated time, for a dynamics), and below them their
    relative gap, for every sample.

    answer : the solution of one or several samples.
    page : size and resolution of the figure.

    Raises InputError for a method without steps.
    """
    courses = courses_of(answer)  # solutions with a history of their own
    if not courses:
        steps = counted(_steps(answer.sample(0)), "step")
        raise InputError(
            f"the history of the run, by method {answer.method}, has only {steps}, its answer; its figure needs 2 or "
            "more, which a dynamics, gradient-descent or operator-splitting makes"
        )
    course, scene = courses[0], courses[0].scene
    width = page.inches("single")
    figure = style.plain_figure(width, 0.85 * width, page.dpi)
    top, bottom = figure.subplots(2, 1, sharex=True)
    spin, spin_symbol = driving(scene)
    unit, symbol = power_unit(scene)
    is_dynamics, has_gap, decades = "time" in course.history, False, 1.0
    for one in courses:
        x = one.history["time"] * spin if is_dynamics else one.history["iteration"]
        power, bound, started = one.history["power"], one.history["lower_bound"], x > 0
        above, *_ = top.plot(x[started], power[started] / unit, color=style.BLUE)
        below, *_ = top.plot(x[started], bound[started] / unit, "--", color=style.ORANGE)
        gap = (np.minimum.accumulate(power) - bound) / np.where(power > 0, power, 1.0)  # of the best power so far
        shown = started & (gap > 0).any(axis=1)
        bottom.plot(x[shown], np.where(gap > 0, gap, np.nan)[shown], color=style.GREY)
        has_gap, decades = has_gap or bool(shown.any()), max(decades, x[-1] / x[started][0])
    top.set(ylabel=over("P", symbol, "energy / time"))
    top.legend([above, below], ["power", "proven lower bound"], frameon=True, framealpha=0.85, edgecolor="none")
    bottom.set(xscale="log" if decades > LEAST_RATIO else "linear", yscale="log" if has_gap else "linear")
    name = time_label(spin_symbol) if is_dynamics else "iteration"
    bottom.set(xlabel=name, ylabel=r"gap, $(P - P_\mathrm{low})\,/\,P$")
    style.label_in_plain_text(*[axis for axis in (bottom.xaxis, bottom.yaxis) if axis.get_scale() == "log"])
    figure.align_ylabels()
    style.put_title(figure, f"{describe(scene, None)}\n{course.method}", page)
    return figure


def courses_of(solution: Solution) -> list[Solution]:
    """Return a list of solutions whose history can be drawn: one for all samples of a lattice, one for each sample of a
    packing. A solution whose history has no more than a start and an answer is left out.

    solution : the answer to all samples.
    """
    whole, replicas = solution.scene.network.lattice is not None, solution.scene.replicas
    each = [solution] if whole or replicas == 1 else [solution.sample(number) for number in range(replicas)]
    return [one for one in each if _steps(one) > 1]


def _steps(solution: Solution) -> int:
    """Return the number of rows of a solution's history after the start. Samples of a packing have rows of their own,
    which are added up.
    """
    return int((solution.history.get("iteration", np.zeros(0)) > 0).sum())


@style.in_our_style
def draw_energy(solution: Solution, page: Page = PAGE) -> Figure:
    """Draw the energy balance of a dynamics against time, and below it the relative error of the balance.

    solution : the solution of one sample.
    page : size and resolution of the figure.

    Drawn are the work put in, the energy dissipated, and kinetic and spring energy. If one of them is negative at
    times, the axis is linear around 0 and logarithmic beyond. Raises InputError if the run has no energy balance.
    """
    history, scene = solution.history, solution.scene
    if "energy_residual" not in history:
        raise InputError("the run has recorded no energy balance; run a dynamics with --energy")
    width = page.inches("single")
    figure = style.new_figure(width, 0.95 * width, page.dpi)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1))
    unit, symbol = energy_unit(scene)
    spin, spin_symbol = driving(scene)
    later = history["time"] > 0
    time = history["time"][later] * spin
    accounts = {name: history[f"{name}_energy"][later, 0] / unit for name in ACCOUNTS}
    for name, (colour, dashes) in ACCOUNTS.items():
        top.plot(time, accounts[name], color=colour, ls=dashes, lw=1.2, label=name)
    if later.any():
        top.set_xscale("log")
        _scale_of_energies(top, np.concatenate(list(accounts.values())))
    top.set(ylabel=over("E", symbol, "energy"))
    style.put_title(figure, f"{describe(scene)}\n{solution.method}", page)
    figure.legend(*top.get_legend_handles_labels(), ncols=4, loc="outside lower center", columnspacing=1.0)
    missing = np.abs(history["energy_residual"][later, 0])
    if (missing > 0).any():
        bottom.plot(time[missing > 0], missing[missing > 0], color="black", lw=1.0)
        bottom.set_yscale("log")
    bottom.set(xlabel=time_label(spin_symbol), ylabel="unexplained\nshare")
    every = (bottom.xaxis, top.yaxis, bottom.yaxis)
    style.label_in_plain_text(*[axis for axis in every if axis.get_scale() == "log"])
    return figure


def _scale_of_energies(axes: Axes, energy: np.ndarray) -> None:
    """Make the vertical axis logarithmic or, if some energies are negative, linear around 0 and logarithmic beyond.

    axes : axes of matplotlib.
    energy : (numbers,), all energies that are drawn.
    """
    size = np.abs(energy[energy != 0])
    if not len(size):
        return
    if (energy >= 0).all():
        axes.set_yscale("log", nonpositive="mask")
        return
    # linear up to a tenth of the largest negative energy, or up to the lowest of MOST_DECADES decades
    most, least = math.ceil(math.log10(size.max())), math.floor(math.log10(-energy.min())) - 1
    least = max(least, most - MOST_DECADES)
    axes.set_yscale("symlog", linthresh=10.0**least, linscale=0.5)
    ticks: Any = axes.yaxis.get_major_locator()
    ticks.set_params(numticks=MOST_TICKS)
    axes.yaxis.set_minor_locator(NullLocator())
    axes.axhline(0.0, color="black", lw=0.6)
    axes.set_ylim(1.6 * energy.min(), 1.6 * energy.max())


POWER_SYMBOL = "P_{ij}"
PLAIN_POWER_SYMBOL = "P\u1d62\u2c7c"  # P_ij in plain text: mathematics would take matplotlib 40 ms more
MATHEMATICS = {  # symbols of the units of histograms
    "F_n R omega_T": r"F_n R\,\omega_T",
    "the mean power of a contact of the sample": r"\langle P_{ij} \rangle",
}


@style.in_our_style
def draw_histogram(histogram: PowerHistogram, page: Page = PAGE, of: Sequence[str] = ()) -> Figure:
    """Draw the number of slipping contacts against their power, both logarithmic, with standard errors. Empty bins are
    left out.

    histogram : what is drawn.
    page : size and resolution of the figure.
    of : first lines of the title: size and seed of a run, and conditions by which samples were chosen.
    """
    figure = style.plain_figure(page.inches("single"), 2.2, page.dpi)
    axes = figure.add_subplot()
    axes.set(xscale="log", yscale="log", xlabel=_label(histogram), ylabel="slipping contacts per bin")
    style.label_in_plain_text(axes.xaxis, axes.yaxis)
    filled = histogram.count > 0
    if filled.any():
        centre, count, error = _centre(histogram)[filled], histogram.count[filled], histogram.standard_error[filled]
        low, width = histogram.edges[:-1][filled], np.diff(histogram.edges)[filled]
        axes.bar(low, count, width, align="edge", color=style.BLUE, alpha=0.25, linewidth=0)
        axes.errorbar(centre, count, error, fmt="o", ms=2.5, color=style.BLUE, elinewidth=0.8)
        axes.set_ylim(0.5, 2 * histogram.count.max())
    else:
        axes.text(0.5, 0.5, "no slipping contacts", transform=axes.transAxes, ha="center")
    style.fix_minor_ticks(axes)
    whose = f" in {histogram.census}\n" if histogram.census.asked > 1 else " "
    threshold = histogram.slip_threshold
    limit = f"\nslipless below a slip of {threshold:.1e} (length / time)" if threshold > 0 else ""
    outside = f"({_unbinned_in_words(histogram)})"
    words = f"{histogram.slipping:,} slipping contacts{whose}{outside}{limit}"
    style.put_title(figure, "\n".join([*of, words]), page)
    return figure


@style.in_our_style
def draw_overlay(
    histograms: Mapping[object, PowerHistogram], by: str, page: Page = PAGE, where: Sequence[str] = ()
) -> Figure:
    """Draw the share of slipping contacts per decade of their power, one curve for each histogram, with bands of one
    standard error.

    histograms : the histograms, by the value of a parameter.
    by : name of the parameter.
    page : size and resolution of the figure.
    where : conditions by which the samples were chosen, for the title.
    """
    columns = 1 if len(histograms) < 9 else 2  # of the legend
    rows = math.ceil(len(histograms) / columns)
    width = page.inches("double") if page.width is not None or len(histograms) > 8 else 5.0
    figure = style.new_figure(width, 3.0 + 0.15 * rows, page.dpi)
    axes = figure.add_subplot()
    first = next(iter(histograms.values()))
    axes.set(xscale="log", yscale="log", xlabel=_label(first), ylabel="share of slipping contacts per decade")
    for (value, found), colour in zip(histograms.items(), style.shades(len(histograms)), strict=True):
        empty, centre, error = found.count == 0, _centre(found), found.density_error
        density = np.where(empty, np.nan, found.density)  # no line leads over empty bins
        label = f"{as_text(value)}: {found.slipping:,} slipping, {_unbinned_in_words(found)}; {found.census}"
        axes.plot(centre, density, "o-", ms=2.5, lw=1.2, color=colour, label=label)
        low = np.maximum(density - error, 0.1 * density)  # a band that reaches zero has no end on this scale
        axes.fill_between(centre, low, density + error, color=colour, alpha=0.2, linewidth=0)
    figure.legend(title=as_text(by), loc="outside lower center", ncols=columns)
    if where:
        style.put_title(figure, "\n".join(map(as_text, where)), page)
    return figure


def _centre(histogram: PowerHistogram) -> np.ndarray:
    """Return the middle (bins,) of each bin of power of a histogram on a logarithmic scale."""
    found: np.ndarray = np.sqrt(histogram.edges[:-1] * histogram.edges[1:])
    return found


def _label(histogram: PowerHistogram) -> str:
    """Return the label of the axis of power, with the unit in which the histogram has powers."""
    if histogram.units == ENERGY_PER_TIME:
        return f"power of a contact, {PLAIN_POWER_SYMBOL} (energy / time)"
    return "power of a contact, " + over(POWER_SYMBOL, MATHEMATICS[histogram.units], "")


def _unbinned_in_words(histogram: PowerHistogram) -> str:
    """Return in words how many contacts are in no bin of a histogram: those that are slipless, tied (slip at some
    minima only) or undecided.
    """
    return ", ".join([f"{histogram.slipless:,} slipless", *other_contacts(histogram.tied, histogram.undecided)])


MARKERS = "osD^vP*X"
MOST_NAMED_TICKS = 8  # values of a logarithmic axis that are named one by one
SPREAD_OF_CURVES = 0.5  # share of the distance between two named ticks over which points of several curves are spread


@dataclass(frozen=True)
class Curve:
    """A curve of P points with error bars.

    label : name of the curve in the legend.
    x, y : (points P,), the points.
    low, high : (P,), y at the ends of the bars; not-a-number where there are none.
    """

    label: str
    x: np.ndarray
    y: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True)
class Look:
    """Words and axes of a figure of a scan.

    x_label, y_label : names of the axes.
    title : words above the figure.
    legend : title of the legend.
    log : which axes are logarithmic: "", "x", "y" or "xy".
    ticks : names of the places x = 0, 1, ..., if the quantity along x has names in place of numbers.
    """

    x_label: str
    y_label: str
    title: str = ""
    legend: str = ""
    log: str = ""
    ticks: Sequence[str] = ()


@style.in_our_style
def draw_scan(curves: Sequence[Curve], look: Look, page: Page = PAGE) -> Figure:
    """Return a figure of curves: points with error bars, joined by a line where x has numbers. The legend, if there are
    several curves, is below, in as many columns as fit.

    curves : what is drawn; each has its points, the ends of their error bars, and a name.
    look : title, names of axes and legend, which axes are logarithmic, and the names at x if it has no numbers.
    page : size, resolution and title lines of the figure.
    """
    width = page.inches("single")
    entries = len(curves) if len(curves) > 1 else 0
    longest = max(len(curve.label) for curve in curves)
    columns = max(1, min(entries, int(style.LETTERS_AN_INCH * width / (longest + 6))))
    rows = math.ceil(entries / columns) + (entries > 0)  # of the legend, with its title
    figure = style.new_figure(width, 0.68 * min(width, 5.0) + 0.15 * rows, page.dpi)
    axes = figure.add_subplot()
    for name in look.log:
        axes.set(**{f"{name}scale": "log"})
        style.label_in_plain_text(getattr(axes, f"{name}axis"))
    colours = style.shades(len(curves)) if len(curves) > 1 else [style.BLUE]
    # at named ticks the points of different curves stand side by side
    shift = SPREAD_OF_CURVES * (np.arange(len(curves)) / len(curves) - 0.5 + 0.5 / len(curves)) * bool(look.ticks)
    for number, (curve, colour) in enumerate(zip(curves, colours, strict=True)):
        bars = np.nan_to_num([curve.y - curve.low, curve.high - curve.y])
        axes.errorbar(
            curve.x + shift[number], curve.y, bars, color=colour, label=as_text(curve.label or "samples"),
            lw=0.0 if look.ticks else 0.9, elinewidth=0.8, capsize=1.5, marker=MARKERS[number % len(MARKERS)], ms=3.5,
            mfc="none" if number % 2 else colour,
        )  # fmt: skip
    axes.set(xlabel=look.x_label, ylabel=look.y_label)
    values = np.unique(np.concatenate([curve.x for curve in curves]))
    if look.ticks:
        # names are slanted where they do not fit side by side
        are_long = sum(map(len, look.ticks)) + 2 * len(look.ticks) > style.LETTERS_AN_INCH * (width - 0.8)
        slant: dict[str, Any] = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if are_long else {}
        axes.set_xticks(range(len(look.ticks)), [as_text(tick) for tick in look.ticks], **slant)
        axes.set_xlim(-0.5, len(look.ticks) - 0.5)
    elif len(values) == 1 and "x" not in look.log:
        axes.set_xticks(values, [style.short(values[0])])  # a single tick, at the only value
    elif "x" in look.log and len(values) <= MOST_NAMED_TICKS:
        axes.set_xticks(values, [style.short(value) for value in values.tolist()])
        axes.xaxis.set_minor_locator(NullLocator())
    elif "x" not in look.log and (values == np.round(values)).all():
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))  # no tick at 2.5 spheres
    if entries:
        figure.legend(title=as_text(look.legend) or None, loc="outside lower center", ncols=columns)
    style.put_title(figure, as_text(look.title), page)
    return figure
