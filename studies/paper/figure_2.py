"""Figure 2 of the paper: a 3x3x3 Coulomb bearing relaxes to a power below that of the minimum cut.

Samples are followed in time by the paper's Cundall-Strack dynamics (a spring and a damper at each contact) and, with
the same inertia, with rigid contacts.

Letters: R samples, T recorded times. Spins are staggered: with opposite signs on neighbours, so that spheres that roll
on each other have equal values. The jump is the difference of the imposed spins of top and bottom.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from taichi_bearings.plots.bearing import SPIN_COLOURS, colour_bar, frame_block, paint_spheres
from taichi_bearings.plots.page import View
from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, GREY, ORANGE, in_our_style, new_figure
from taichi_bearings.scene import Scene
from taichi_bearings.solvers import CundallStrack
from taichi_bearings.stages import each, stage
from taichi_bearings.words import counted

from .claims import Effort
from .samples import SAME, Run, StudyResult, Table, curves, joined, minima_of, relax, relax_rigidly

SHAPE, LARGER = (3, 3, 3), (6, 6, 6)
STARTS = {"random": "random spins", "minimum-cut": "the minimum cut"}
RUNS, RIGID_RUNS = 8, 3  # samples that are followed in time, by Cundall-Strack dynamics and without springs
LARGER_SAMPLES = 20
STIFFER, STIFFER_STEPS = 10.0, 30_000  # factor of the damping; time steps that are followed with it
SPRINGS: Any = tuple({"color": colour, "lw": 1.3} for colour in (BLUE, ORANGE))  # lines, one for each start
RIGID: Any = tuple({"color": colour, "lw": 0.8, "ls": (0, (4, 1.5))} for colour in ("#0b2545", "#6b2d00"))
DRAWN_RADIUS = 0.36  # of spheres, over the spacing: touching ones would hide those behind
SEEN = View(20, -60)  # elevation and azimuth from which spheres are seen, degrees
ARROW, LEAST_ARROW = 0.84, 0.02  # length of the arrow of the imposed spin; smaller spins have no arrow


def study(folder: Path, effort: Effort) -> StudyResult:
    """Follow samples from random spins and from the minimum cut, and find the minima of more samples; return tables,
    figure and values for the claims.

    folder : not used, since no sample takes long enough to be kept.
    effort : first seed and number of samples.
    """
    draw = partial(Scene.random, seed=effort.seed)
    scene, rigid_scene = (draw(SHAPE, replicas=min(most, effort.samples)) for most in (RUNS, RIGID_RUNS))
    stiff = CundallStrack(damping=STIFFER * CundallStrack().damping)
    runs = [relax(scene, start) for start in each(tuple(STARTS), "relaxation")]
    stiffer = [relax(scene, start, stiff, STIFFER_STEPS) for start in each(tuple(STARTS), "stiffer relaxation")]
    rigid = [relax_rigidly(rigid_scene, start) for start in each(tuple(STARTS), "rigid relaxation")]
    with stage(f"finding the minima of {counted(effort.samples, 'sample')}"):
        minima = minima_of(draw(SHAPE, replicas=effort.samples))
    with stage("finding the minima of larger samples"):
        larger = minima_of(draw(LARGER, replicas=min(LARGER_SAMPLES, effort.samples)))
    spheres = intermediate_spheres(scene, minima.spin[: scene.replicas])
    named = names_of(runs, stiffer, rigid, minima, larger) | {"intermediate": spheres, "seeds": scene.seeds}
    named |= {"free_spheres": int((~scene.lattice.is_driven).sum()), "apart": largest_difference(*runs) / scene.jump}
    dynamics = {"cundall-strack": runs, "rigid-limit": rigid}
    courses = {
        name: joined({run.start: course_of(run, scene.seeds, minima) for run in both}, "start")
        for name, both in dynamics.items()
    }
    named["fastest"] = scene.fastest
    return StudyResult({".csv": joined(courses, "dynamics")}, draw_relaxation, named)


def names_of(
    runs: Sequence[Run], stiffer: Sequence[Run], rigid: Sequence[Run], minima: Table, larger: Table
) -> dict[str, Any]:
    """Return the values that the figure and the claims use, by name.

    runs, stiffer, rigid : for each start (random spins, minimum cut) the relaxation with springs, with STIFFER times
        the damping, and with rigid contacts.
    minima, larger : tables of the minima of the samples, and of larger ones, as :func:`.samples.minima_of` returns
        them.

    Among the values:

    * `pairs`: for each start a dictionary with its three relaxations (`run`, `stiff`, `hard`) and the `distance`
      (samples,) between the power curves with springs and with rigid contacts;
    * `followed`, `rigidly`: the minima of the samples that `runs` and `rigid` follow;
    * `place`: index of the sample that the figure shows: the first one followed whose minimum has less power than its
      minimum cut.
    """
    samples, rigid_samples = (of[0].power.shape[1] for of in (runs, rigid))
    pairs = [
        {"start": STARTS[run.start], "run": run, "stiff": stiff, "hard": hard,
         "distance": run.distance(hard, hard.time[hard.time <= run.time[-1]])}
        for run, stiff, hard in zip(runs, stiffer, rigid, strict=True)
    ]  # fmt: skip
    return {
        "pairs": pairs, "runs": runs, "rigid": rigid, "rigid_samples": rigid_samples, "damping_factor": STIFFER,
        "minima": minima, "followed": minima[:samples], "rigidly": minima[:rigid_samples], "larger": larger,
        "same_power": SAME, "shape": LARGER, "place": int(np.argmax(minima.below_cut[:rigid_samples])),
        "falls": {STARTS[run.start]: {"ends": run.ends} for run in rigid},
    }  # fmt: skip


def largest_difference(run: Run, other: Run) -> float:
    """Return the largest difference of any spin between the ends of two relaxations of the same samples, `run` and
    `other`, 1/time. Left out is the mean spin of each layer about the height, which makes no contact slip.
    """
    return float(np.abs(without_idle_spin(run.last) - without_idle_spin(other.last)).max())


def course_of(run: Run, seeds: Sequence[int], minima: Table) -> Table:
    """Return the power of one relaxation against time, a table with a row for each sample and time.

    run : relaxation of R samples.
    seeds, minima : seeds, and table of minima with the column `power`, of these R samples and perhaps more after them.

    Columns: `time`, `power`, and the power over its initial value and over the least power.
    """
    samples, over = run.power.shape[1], {"power_over_initial": run.power / run.power[0]}
    over["power_over_minimum"] = run.power / minima.power[:samples]
    return curves(seeds[:samples], time=run.time, power=run.power, **over)


def without_idle_spin(staggered: np.ndarray) -> np.ndarray:
    """Return a copy of some spins in which the spins about the height have mean 0 in each layer that is not driven.
    That mean makes no contact slip and never changes (docs/equations.md, 3), so states can only be compared without it.

    staggered : (3 components, R samples, nx, ny, nz), spins with signs that alternate between neighbours.
    """
    found: np.ndarray = staggered.copy()
    about_height = found[2, ..., 1:-1]  # a view: free layers alone
    about_height -= about_height.mean(axis=(1, 2), keepdims=True)
    return found


def intermediate_spheres(scene: Scene, spin: np.ndarray) -> np.ndarray:
    """Return for each of R samples, (R,), the number of free spheres that rotate neither with the bottom nor with the
    top.

    scene : the lattice with its R samples.
    spin : (R, *N spheres, 3), laboratory frame, 1/time. A sphere rotates with a plane if its spin, staggered (with
        opposite signs on neighbours), differs from the plane's by less than 0.001 of the difference of the imposed
        spins: far above the error of the minimum.
    """
    axes = scene.minimum_spin_axes
    staggered = scene.staggered_spin(spin, axes)
    differs_from_bottom, differs_from_top = (
        np.linalg.norm(staggered - value, axis=0) > 1e-3 * scene.jump
        for value in (0.0, scene.top_spin(axes)[:, None, ..., None])
    )
    intermediate = differs_from_bottom & differs_from_top & ~scene.lattice.is_driven
    return np.asarray(intermediate.reshape(scene.replicas, -1).sum(axis=1))


@in_our_style
def draw_relaxation(named: Any) -> Figure:
    """Draw the figure for one sample.

    named : the values of :func:`names_of` as attributes. Used are `place`, index of the sample; `runs` and `rigid`: for
        each start the relaxation (a Run) with springs and with rigid contacts; `minima`, a table with the columns
        `power` and `cut_power`, energy/time; `fastest`, the larger one of the imposed spins, 1/time.

    (a) Power over its initial value, and (b) its excess over the least power, against time; an inset of (a) enlarges
    the end, around the power of the minimum cut. (c) Spins of the dynamics with springs at the beginning and at the
    end: with signs that alternate between neighbours, over the larger imposed one, and without the mean of each layer
    about the height.
    """
    figure, sample = new_figure(DOUBLE, 4.6), named.place
    parts: Any = figure.subfigures(1, 2, width_ratios=(1.12, 1.0), wspace=0.02)
    courses = [
        (run.time, run.power[:, sample], look | {"label": f"from {STARTS[run.start]}, {dynamics}"})
        for several, looks, dynamics in ((named.runs, SPRINGS, "Cundall-Strack"), (named.rigid, RIGID, "rigid"))
        for run, look in zip(several, looks, strict=True)
    ]
    _draw_curves(parts[0], courses, float(named.minima.power[sample]), float(named.minima.cut_power[sample]))
    grid = parts[1].subplots(len(named.runs), 2, squeeze=False)
    for row, run in zip(grid, named.runs, strict=True):
        for axes, spin, when in zip(row, (run.first, run.last), ("= 0", r"\to \infty"), strict=True):
            _draw_spheres(axes, np.moveaxis(without_idle_spin(spin)[:, sample], 0, -1) / named.fastest)
            axes.set_title(f"{STARTS[run.start]}, $t {when}$", pad=2)
    grid[0, 0].text(-0.02, 1.1, "(c)", transform=grid[0, 0].transAxes, va="top")
    label = r"$|\omega|\,/\,\omega_T$; arrows: $(-1)^{x+y+z}\,\omega$" + "\n(without the mean of each layer about $z$)"
    look: Any = {"location": "bottom", "shrink": 0.6, "aspect": 30, "extend": "max"}
    colour_bar(parts[1], grid, label, Normalize(0, 1), SPIN_COLOURS, **look)
    return figure


def _draw_curves(figure: Any, courses: Sequence[Any], least_power: float, cut_power: float) -> None:
    """Draw panels (a) and (b): power over the initial power P_0, and its excess over the least power, against time.

    figure : matplotlib figure, or part of one, that gets both panels.
    courses : for each relaxation the T times (T,), the powers (T,), and arguments of matplotlib's plot. P_0 is the
        first power of the first one.
    least_power, cut_power : power of the minimum, and of the minimum cut.
    """
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.3, 1))
    inset = top.inset_axes((0.57, 0.46, 0.42, 0.5))
    initial = courses[0][1][0]
    for time, power, look in courses:
        later, excess = time > 0, power / least_power - 1
        for axes in (top, inset):
            axes.plot(time[later], power[later] / initial, **look)
        shown = later & (excess > 0)
        bottom.plot(time[shown], excess[shown], **look)
    cut, least = cut_power / initial, least_power / initial
    for axes in (top, inset):
        axes.axhline(cut, color=GREEN, ls="-.", lw=1.2, label=rf"$P_{{\mathrm{{cut}}}} = {cut:.4f}\,P_0$, minimum cut")
        axes.axhline(least, color=GREY, ls=":", lw=1.2, label=rf"$P_{{\min}} = {least:.4f}\,P_0$, certified")
    if cut > least:
        bottom.axhline(cut / least - 1, color=GREEN, ls="-.", lw=1.2)
    figure.figure.legend(handles=top.lines, loc="outside upper center", ncols=3)
    first, last = (limit(float(time[place]) for time, *_ in courses[:2]) for limit, place in ((min, 1), (max, -1)))
    high = max(cut, 1.02 * least)
    inset.set(xscale="log", xlim=(last / 1e3, last), ylim=(1.2 * least - 0.2 * high, 2 * high - least))
    inset.tick_params(labelsize=7)
    top.set(xscale="log", xlim=(first / 2, 2 * last), ylabel=r"$P\,/\,P_0$", ylim=(0, 1.04))
    bottom.set(xscale="log", yscale="log", xlabel=r"time, $\omega_T\, t$", ylabel=r"$P\,/\,P_{\min} - 1$")
    bottom.set_ylim(1e-8, 10)
    for axes, letter in ((top, "a"), (bottom, "b")):
        axes.text(-0.17, 1.0, f"({letter})", transform=axes.transAxes, va="top")


def _draw_spheres(axes: Any, spin: np.ndarray) -> None:
    """Draw one sample as shaded spheres, those behind first, with an arrow for each spin and the driven planes in
    boxes.

    axes : panel of matplotlib.
    spin : (nx, ny, nz, 3), spin vectors in units of the largest imposed spin.
    """
    shape, spins = spin.shape[:-1], spin.reshape(-1, 3)
    frame_block(axes, shape, SEEN)
    seen, length = SEEN.seen(np.argwhere(np.ones(shape, dtype=bool))), np.linalg.norm(spins, axis=1)
    order = np.argsort(seen[:, 2])
    colour = colormaps[SPIN_COLOURS](np.minimum(length, 1.0))
    paint_spheres(axes, seen[order, :2], colour[order], DRAWN_RADIUS)
    turning = length > LEAST_ARROW
    axes.quiver(
        *seen[turning, :2].T, *SEEN.seen(spins[turning])[:, :2].T, pivot="mid", angles="xy", scale_units="xy",
        scale=1 / ARROW, units="xy", width=0.035, headwidth=4, headlength=5, zorder=5,
    )  # fmt: skip
