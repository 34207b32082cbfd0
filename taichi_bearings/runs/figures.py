"""The figures of one answer by their names, whether it was read from a file or solved just now."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.options import OneOf
from taichi_bearings.plots.coefficients import draw_coefficients
from taichi_bearings.plots.curves import draw_energy, draw_history
from taichi_bearings.plots.page import PAGE, Page, check_planes
from taichi_bearings.plots.spins import draw_power, draw_spins
from taichi_bearings.plots.structure import draw_domains, draw_network
from taichi_bearings.plots.style import describe, driving, mathematics
from taichi_bearings.scene import Solution
from taichi_bearings.words import counted

FIGURES: dict[str, Callable[[Structure, Page], Figure]] = {"domains": draw_domains, "network": draw_network}
"""Functions that draw the figures of `bearings analyse`, by name, from the structure of a sample."""
OF_STRUCTURES = {"spins": draw_spins, "power": draw_power, "coefficients": draw_coefficients} | FIGURES
"""Functions that draw all figures that need the structure of a sample, by name."""
OF_ANSWERS: dict[str, Callable[[Solution, int, Page], Figure]] = {
    "history": lambda answer, _, page: draw_history(answer, page),
    "energy": lambda answer, sample, page: draw_energy(answer.sample(sample), page),
}
"""Functions that draw the figures of an answer, by name; the number is that of the sample."""
FIGURE_KINDS = ("spins", "power", "coefficients", *OF_ANSWERS, *FIGURES)
STRETCHED_SLIP = 1e-3  # slower contacts, relative to the largest imposed R omega, may only stretch their springs
WITH_PLANES = ("spins", "power", "coefficients", "domains")  # figures that show planes of a cubic lattice
WITH_VIEW = ("spins", "domains", "network")  # figures that show a cubic lattice in 3D


def draw_figure(
    kind: str,
    solution: Solution,
    sample: int = 0,
    time: float | None = None,
    slip_threshold: float | None = None,
    page: Page = PAGE,
) -> Figure:
    """Draw a figure of an answer; raise InputError if there is none of this name, or nothing to show.

    kind : name of the figure.
    solution : the answer.
    sample : number of the sample that is drawn.
    time : simulated time of the snapshot whose spins are drawn; None for the answer itself.
    slip_threshold : slip speed, length/time, up to which contacts of a snapshot count as slipless; None if the run was
        not given one.
    page : how the figure is printed: width, planes and view.
    """
    OneOf(*FIGURE_KINDS).named("the figure", kind)
    if time is not None and kind != "spins":
        raise InputError(f"time is {time}, but {kind} does not depend on it; only spins have snapshots")
    if not 0 <= sample < len(solution.state):
        raise InputError(
            f"replica is {sample}; the run has {counted(len(solution.state), 'replica')}, numbered from 0 to "
            f"{len(solution.state) - 1}"
        )
    _check_page(kind, solution.scene.network.shape, page)
    if time is not None:
        return draw_snapshot(solution, sample, time, slip_threshold, page)
    if kind in OF_STRUCTURES:
        return OF_STRUCTURES[kind](structure_of(solution, sample), page)
    return OF_ANSWERS[kind](solution, sample, page)


def _check_page(kind: str, shape: tuple[int, ...], page: Page) -> None:
    """Raise InputError if the page asks for planes or a view that the figure `kind` does not have.

    shape : numbers of spheres along each axis of a lattice; (number of spheres,) for another packing, which has no
        planes.
    page : how the figure is to be printed.
    """
    if len(shape) == 1:
        if page.planes:
            raise InputError(
                "plane is given, but a packing has no lattice planes to cut along; leave it out (--view turns the "
                "packing)"
            )
        return
    if page.planes and kind not in WITH_PLANES:
        raise InputError(f"plane is given, but {kind} shows no planes; these do: {', '.join(WITH_PLANES)}")
    if page.view and kind not in WITH_VIEW:
        raise InputError(f"view is given, but {kind} shows nothing in 3D; these do: {', '.join(WITH_VIEW)}")
    if page.view and len(shape) == 2:
        raise InputError("view is given, but the lattice is two-dimensional; leave it out")
    check_planes(page.planes, shape)


def draw_snapshot(
    answer: Solution,
    replica: int,
    time: float,
    slip_threshold: float | None = None,
    page: Page = PAGE,
) -> Figure:
    """Draw the spins of the snapshot that is nearest to a simulated time, and the contacts that slip in it.

    answer : what was solved.
    replica : number of the sample.
    time : simulated time; the title has that of the snapshot.
    slip_threshold : slip speed, length/time, up to which contacts count as slipless; None if the run was not given one.
    page : how the figure is printed: width, planes and view.

    Raises InputError if the run has no snapshots or does not reach that time.
    """
    structure = structure_of(answer, replica)
    at, nearest = _nearest_snapshot(structure.answer, time)
    moment = moment_of(structure, structure.snapshots[nearest], slip_threshold)
    threshold = moment.threshold or 0.0
    title, note = f"{describe(moment.scene)}, $t = {mathematics(at, 4)}$", ""
    if moment.scene.natural_spin is not None:
        unit, symbol = driving(moment.scene)
        title += "" if unit == 1 else rf", ${symbol}\,t = {mathematics(unit * at, 4)}$"
        fastest = moment.fastest
        share = rf" = {mathematics(threshold / fastest, 1)}\,R\,|\Delta\omega|" if fastest else ""
        note = f"black: slip above ${mathematics(threshold, 2)}{share}$"
    return draw_spins(moment, page, title, note)


def _nearest_snapshot(answer: Solution, time: float) -> tuple[float, int]:
    """Return the simulated time and the number of the snapshot that is nearest to a given time. Raises InputError if
    there are no snapshots, or if the run does not reach that time.

    answer : one sample.
    time : simulated time.
    """
    if answer.snapshots is None:
        raise InputError("the run holds no snapshots; run a dynamics with --snapshots")
    kept = answer.snapshots.time
    end = float(max(kept.max(), answer.history["time"][-1]))
    if not 0 <= time <= end:
        raise InputError(
            f"time is {time:g}; the run goes from 0 to {end:g}, with snapshots from {kept.min():g} to {kept.max():g}"
        )
    nearest = int(np.abs(kept - time).argmin())
    return float(kept[nearest]), nearest


def moment_of(structure: Structure, spin: np.ndarray, slip_threshold: float | None = None) -> Structure:
    """Return the structure of a sample with the spins of a snapshot in place of those of the answer.

    spin : spins of the snapshot, (spheres *N) of discs or (*N, 3) of spheres, 1/time.
    slip_threshold : the slip speed, length/time, up to which the user lets contacts count as slipless; None if not
        given.

    A contact counts as slipping if its slip is above the threshold of the run. Friction would be a better criterion,
    but snapshots do not hold it. Springs that stretch look like slip. So in a dynamics with springs the threshold is at
    least STRETCHED_SLIP times the largest imposed radius * spin, unless `slip_threshold` is given.
    """
    threshold = float(structure.answer.slip_threshold)
    if structure.answer.method.endswith("cundall-strack") and slip_threshold is None:
        threshold = max(threshold, STRETCHED_SLIP * structure.fastest)
    return replace(structure, spin=spin, slip=structure.slips_of(spin), threshold=threshold)
