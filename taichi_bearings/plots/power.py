"""Where the power is dissipated: every contact coloured by its power."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from taichi_bearings.plots.lattice import contacts_in_plane, draw_contacts, frame_plane, middle_cuts, name_cut
from taichi_bearings.plots.style import GREY, in_our_style, new_figure
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Solution


@in_our_style
def draw_power(solution: Solution, replica: int = 0) -> Figure:
    """2D: all contacts. 3D: the contacts in two cuts through the middle, and the power of each layer of the height."""
    shape = solution.scene.lattice.shape
    power = [p[replica] for p in solution.power_per_contact]
    state = [s[replica] for s in solution.state]
    slipping = np.concatenate([p[s == ContactState.SLIPPING] for p, s in zip(power, state, strict=True)])
    slipping = slipping[slipping > 0]
    norm = LogNorm(slipping.min(), slipping.max()) if len(slipping) else LogNorm(1e-1, 1)
    if len(shape) == 2:
        figure = new_figure(5.6, 4.9)
        axes = figure.add_subplot()
        drawn = _draw_plane(axes, power, state, shape, norm)
        figure.colorbar(drawn, ax=axes, label="power of a slipping contact", shrink=0.8)
        return figure
    nz = shape[-1]
    figure = new_figure(11.5, 3.9)
    *cuts, axes = figure.subplots(1, 3, width_ratios=(1, 1, 0.8))
    for cut, (axis, index) in zip(cuts, middle_cuts(shape), strict=True):
        powers, states = (contacts_in_plane(values, axis, index) for values in (power, state))
        drawn = _draw_plane(cut, powers, states, (shape[1 - axis], nz), norm)
        name_cut(cut, axis, index)
    figure.colorbar(drawn, ax=cuts, label="power of a slipping contact", shrink=0.8, location="left")
    layers = power[0].sum(axis=(0, 1)) + power[1].sum(axis=(0, 1))
    axes.step(layers, np.arange(nz), where="mid", label="contacts in the layer")
    axes.step(power[2].sum(axis=(0, 1)), np.arange(nz - 1) + 0.5, where="mid", label="contacts to the next layer")
    axes.set(xlabel="power", ylabel="height")
    axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def _draw_plane(
    axes: Any, power: Sequence[np.ndarray], state: Sequence[np.ndarray], shape: tuple[int, ...], norm: LogNorm
) -> Any:
    """Contacts of one plane as lines between the centres: slipping ones by power, the rest in grey."""
    slips = [(s == ContactState.SLIPPING) & (p > 0) for p, s in zip(power, state, strict=True)]
    width = float(np.clip(60.0 / max(shape), 0.3, 3.0))
    draw_contacts(axes, [~chosen for chosen in slips], colors=GREY, lw=0.25 * width)
    drawn = draw_contacts(axes, slips, cmap="viridis", norm=norm, lw=width)
    drawn.set_array(np.concatenate([p[chosen] for p, chosen in zip(power, slips, strict=True)]))
    frame_plane(axes, shape)
    return drawn
