"""The figures of one run by their names, whether it lies in a file or not."""

from collections.abc import Callable

from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.plots.course import draw_energy, draw_history
from taichi_bearings.plots.domains import draw_domains
from taichi_bearings.plots.network import draw_network
from taichi_bearings.plots.page import PAGE, Page, check_planes
from taichi_bearings.plots.power import draw_power
from taichi_bearings.plots.spins import draw_spins
from taichi_bearings.runs.snapshot import draw_snapshot
from taichi_bearings.scene import Solution
from taichi_bearings.words import meant

FIGURES: dict[str, Callable[[Structure, Page], Figure]] = {
    "domains": lambda s, page: draw_domains(s.domains, page),
    "network": lambda s, page: draw_network(s.network, s.spin, *s.scene.imposed, page),
}
"""How each figure of the structure of a sample is drawn."""

FIGURE_KINDS = ("spins", "power", "history", "energy", *FIGURES)
WITH_PLANES = ("spins", "power", "domains")
WITH_VIEW = ("spins", "domains", "network")


def draw_figure(
    kind: str,
    solution: Solution,
    sample: int = 0,
    time: float | None = None,
    slip_threshold: float | None = None,
    page: Page = PAGE,
) -> Figure:
    """The figure called `kind`; InputError if there is none, or nothing for it to show.

    time : of the snapshot whose spins are drawn; slip_threshold : that the run was asked for, if it was.
    page : how it is printed.
    """
    if kind not in FIGURE_KINDS:
        raise InputError(f"the figure is {kind!r}; allowed are {', '.join(FIGURE_KINDS)}{meant(kind, FIGURE_KINDS)}")
    if time is not None and kind != "spins":
        raise InputError(f"time is {time}, but {kind} does not depend on it; only spins have snapshots")
    if not 0 <= sample < solution.scene.replicas:
        raise InputError(f"replica is {sample}; the run has {solution.scene.replicas}, counted from 0")
    _check_page(kind, solution.scene.lattice.shape, page)
    if kind == "spins":
        if time is not None:
            return draw_snapshot(solution, sample, time, slip_threshold, page)
        one = solution.sample(sample)
        return draw_spins(one.scene, one.spin[0], one.scene.lattice.by_axis(one.state[0]), page)
    if kind == "power":
        return draw_power(solution, sample, page)
    if kind == "history":
        return draw_history(solution, page)
    if kind == "energy":
        return draw_energy(solution, sample, page)
    return FIGURES[kind](structure_of(solution, sample), page)


def _check_page(kind: str, shape: tuple[int, ...], page: Page) -> None:
    """InputError for a plane or a view that the figure does not have."""
    if page.planes and kind not in WITH_PLANES:
        raise InputError(f"plane is given, but {kind} shows no planes; these do: {', '.join(WITH_PLANES)}")
    if page.view and kind not in WITH_VIEW:
        raise InputError(f"view is given, but {kind} shows nothing in 3D; these do: {', '.join(WITH_VIEW)}")
    if page.view and len(shape) == 2:
        raise InputError("view is given, but the lattice is flat; only cubic ones are turned")
    check_planes(page.planes, shape)
