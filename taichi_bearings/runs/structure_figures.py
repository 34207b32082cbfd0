"""The figures of `bearings analyse`: of the structure of one sample, and of all samples of a run."""

from collections.abc import Callable, Sequence

from matplotlib.figure import Figure

from taichi_bearings.analysis.bottlenecks import Loads
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.analysis.torque_flow import plane_flow
from taichi_bearings.plots.bottlenecks import draw_bottlenecks
from taichi_bearings.plots.cut_surface import draw_cut_surface
from taichi_bearings.plots.domains import draw_domains
from taichi_bearings.plots.load_distribution import draw_load_distribution
from taichi_bearings.plots.network import draw_network
from taichi_bearings.plots.plane_cuts import draw_plane_cuts
from taichi_bearings.plots.thresholds import draw_thresholds
from taichi_bearings.plots.torque_flow import draw_torque_flow
from taichi_bearings.proof.contact_state import ContactState


def _with_driving(draw: Callable[..., Figure]) -> Callable[[Structure], Figure]:
    return lambda s: draw(s.network, s.spin, s.scene.spin_top, s.scene.spin_bottom)


def _draw_cut_surface(structure: Structure) -> Figure:
    slips = tuple(values == ContactState.SLIPPING for values in structure.state)
    coefficient = tuple(values[0] for values in structure.scene.coefficient)
    return draw_cut_surface(structure.interface.above, coefficient, slips)


def _draw_torque_flow(structure: Structure) -> Figure | None:
    scene, force = structure.scene, structure.force
    if force is None or structure.friction_load is None or structure.force_distribution is None:
        return None
    axes = scene.minimum_spin_axes
    plane = plane_flow(scene.lattice, axes, force, structure.state, axes[0])
    return draw_torque_flow(structure.friction_load, structure.force_distribution, plane)


def _draw_thresholds(structure: Structure) -> Figure:
    return draw_thresholds(structure.views_by_threshold, structure.view)


FIGURES: dict[str, Callable[[Structure], Figure | None]] = {
    "domains": lambda s: draw_domains(s.domains),
    "network": _with_driving(draw_network),
    "plane_cuts": _with_driving(draw_plane_cuts),
    "cut_surface": _draw_cut_surface,
    "bottlenecks": lambda s: draw_bottlenecks(s.bottlenecks),
    "torque_flow": _draw_torque_flow,
    "thresholds": _draw_thresholds,
}
"""How each figure of one sample is drawn; None comes out where there is nothing to show."""

FIGURES_OF_ALL: dict[str, Callable[[Sequence[Loads]], Figure]] = {"load_distribution": draw_load_distribution}
"""How each figure of all samples is drawn."""
