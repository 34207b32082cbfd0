"""The figures of one run by their names, whether it lies in a file or not."""

from collections.abc import Callable, Sequence

from matplotlib.figure import Figure

from taichi_bearings.analysis.bottlenecks import Loads
from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.plots.bottlenecks import draw_bottlenecks
from taichi_bearings.plots.cut_surface import draw_cut_surface
from taichi_bearings.plots.domains import draw_domains
from taichi_bearings.plots.energy import draw_energy
from taichi_bearings.plots.history import draw_history
from taichi_bearings.plots.lattice import contacts_in_plane, walls_between
from taichi_bearings.plots.load_distribution import draw_load_distribution
from taichi_bearings.plots.network import draw_network
from taichi_bearings.plots.page import AXES, PAGE, Page, check_planes
from taichi_bearings.plots.plane_cuts import draw_plane_cuts
from taichi_bearings.plots.power import draw_power
from taichi_bearings.plots.spins import draw_spins
from taichi_bearings.plots.thresholds import draw_thresholds
from taichi_bearings.plots.torque_flow import draw_torque_flow
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.snapshot import draw_snapshot
from taichi_bearings.scene import Solution
from taichi_bearings.words import meant


def _with_driving(draw: Callable[..., Figure]) -> Callable[[Structure, Page], Figure]:
    return lambda s, page: draw(s.network, s.spin, *s.scene.imposed, page)


def _draw_cut_surface(structure: Structure, page: Page) -> Figure:
    by_axis = structure.scene.lattice.by_axis
    slips, coefficient = by_axis(structure.state == ContactState.SLIPPING), by_axis(structure.scene.coefficient[0])
    symbol = r"\mu_{ij}" if structure.scene.law.holds else r"\eta_{ij}"
    above = structure.interface.above
    return draw_cut_surface(above, walls_between(above, structure.scene.lattice), coefficient, slips, page, symbol)


def _draw_torque_flow(structure: Structure, page: Page) -> Figure | None:
    scene, force = structure.scene, structure.force
    if structure.friction_load is None:
        return None
    axes, by_axis = scene.minimum_spin_axes, scene.lattice.by_axis
    component, index = (page.planes or ((axes[0], None),))[0]
    if component not in axes or len(page.planes) > 1:
        names = " or ".join(AXES[axis] for axis in axes)
        raise InputError(f"torque_flow shows one plane, across a component of the spins: {names}")
    torque, state = by_axis(scene.lattice.radius * force[axes.index(component)]), by_axis(structure.state)
    if scene.lattice.dimension == 3:
        index = scene.lattice.shape[component] // 2 if index is None else index
        torque, state = (contacts_in_plane(values, component, index) for values in (torque, state))
    title = f"torque about ${AXES[component]}$" + ("" if index is None else f", plane ${AXES[component]} = {index}$")
    return draw_torque_flow(structure.friction_load, structure.force_distribution, torque, state, title, page)


FIGURES: dict[str, Callable[[Structure, Page], Figure | None]] = {
    "domains": lambda s, page: draw_domains(s.domains, page),
    "network": _with_driving(draw_network),
    "plane_cuts": _with_driving(draw_plane_cuts),
    "cut_surface": _draw_cut_surface,
    "bottlenecks": lambda s, page: draw_bottlenecks(s.bottlenecks, page=page),
    "torque_flow": _draw_torque_flow,
    "thresholds": lambda s, page: draw_thresholds(s.views_by_threshold, s.view, page),
}
"""How each figure of one sample is drawn; None comes out where there is nothing to show."""

FIGURES_OF_ALL: dict[str, Callable[[Sequence[Loads], Page], Figure]] = {"load_distribution": draw_load_distribution}
"""How each figure of all samples is drawn."""

FIGURE_KINDS = ("spins", "power", "history", "energy", *FIGURES, *FIGURES_OF_ALL)
WITH_PLANES = ("spins", "power", "domains", "plane_cuts", "cut_surface", "torque_flow")
WITH_VIEW = ("spins", "domains", "network", "cut_surface", "bottlenecks")


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
    return draw_energy(solution, sample, page) if kind == "energy" else _draw_structure(kind, solution, sample, page)


def _check_page(kind: str, shape: tuple[int, ...], page: Page) -> None:
    """InputError for a plane or a view that the figure does not have."""
    if page.planes and kind not in WITH_PLANES:
        raise InputError(f"plane is given, but {kind} shows no planes; these do: {', '.join(WITH_PLANES)}")
    if page.view and kind not in WITH_VIEW:
        raise InputError(f"view is given, but {kind} shows nothing in 3D; these do: {', '.join(WITH_VIEW)}")
    if page.view and len(shape) == 2:
        raise InputError("view is given, but the lattice is flat; only cubic ones are turned")
    check_planes(page.planes, shape)


def _draw_structure(kind: str, solution: Solution, sample: int, page: Page) -> Figure:
    """One figure of the structure of a sample, or of all samples; InputError if there is nothing to show."""
    if kind in FIGURES_OF_ALL:
        loads = [structure_of(solution, number).bottlenecks.loads for number in range(solution.scene.replicas)]
        return FIGURES_OF_ALL[kind](loads, page)
    figure = FIGURES[kind](structure_of(solution, sample), page)
    if figure is None:
        raise InputError(f"the run has nothing for {kind} to show: it holds no friction forces of the Coulomb law")
    return figure
