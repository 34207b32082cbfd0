"""The figures of `bearings analyse`: of the structure of one sample, and of all samples of a run."""

from collections.abc import Callable, Sequence

from matplotlib.figure import Figure

from taichi_bearings.analysis.bottlenecks import Loads
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.errors import InputError
from taichi_bearings.plots.bottlenecks import draw_bottlenecks
from taichi_bearings.plots.cut_surface import draw_cut_surface
from taichi_bearings.plots.domains import draw_domains
from taichi_bearings.plots.lattice import contacts_in_plane
from taichi_bearings.plots.load_distribution import draw_load_distribution
from taichi_bearings.plots.network import draw_network
from taichi_bearings.plots.page import AXES, Page
from taichi_bearings.plots.plane_cuts import draw_plane_cuts
from taichi_bearings.plots.thresholds import draw_thresholds
from taichi_bearings.plots.torque_flow import draw_torque_flow
from taichi_bearings.proof.contact_state import ContactState


def _with_driving(draw: Callable[..., Figure]) -> Callable[[Structure, Page], Figure]:
    return lambda s, page: draw(s.network, s.spin, *s.scene.imposed, page)


def _draw_cut_surface(structure: Structure, page: Page) -> Figure:
    by_axis = structure.scene.lattice.by_axis
    slips, coefficient = by_axis(structure.state == ContactState.SLIPPING), by_axis(structure.scene.coefficient[0])
    symbol = r"\mu_{ij}" if structure.scene.law.holds else r"\eta_{ij}"
    return draw_cut_surface(structure.interface.above, coefficient, slips, page, symbol)


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
