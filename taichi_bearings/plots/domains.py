"""Rigid domains: where they are and how they turn (the paper's intermediate bearing states).

Colours say how a domain turns between the two driven planes, in every component that the driving needs: 0 with the
bottom, 1 with the top. With two components the values panel is the key to the colours.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from taichi_bearings.analysis.domains import LOCKS, RigidDomains
from taichi_bearings.plots import lattice
from taichi_bearings.plots.page import AXES, PAGE, VIEW, Page, middle_planes
from taichi_bearings.plots.style import in_our_style, label_in_plain_text, panels

FIRST_AHEAD, SECOND_AHEAD = to_rgb("#e8b400"), to_rgb("#0d8a6f")  # one component has followed the top, the other not
LOCK_COLOURS = {"bottom": colormaps[lattice.SPIN_COLOURS](0.0), "top": colormaps[lattice.SPIN_COLOURS](1.0)}
MARKS = dict(zip(LOCKS, "v^Dsdo", strict=True))
OF_A_KEY = 2.2  # inches that the values need
DOMAIN_LETTERS = "bcdefghijklmnopqrstuvwxyz"


@in_our_style
def draw_domains(domains: RigidDomains, page: Page = PAGE) -> Figure:
    """2D: discs by domain. 3D: the block from outside and cuts. Below: how they turn.

    Black lines are boundaries of rigid domains. Black dots mark spheres that are locked in some components only.
    """
    assert domains.lattice is not None
    colour = colour_of_turn(domains.turn)[domains.domain]
    shape, walls = domains.domain.shape, lattice.walls_between(domains.domain, domains.lattice)
    planes = () if len(shape) == 2 else page.planes or middle_planes(shape)
    tall = float(np.clip(shape[-1] / max(shape[:-1]), 0.8, 1.5))
    figure, (block, *cuts, values), width = panels(page, 2 + len(planes), (0.85 * tall, 0.6), least=OF_A_KEY)
    block.set_title("(a) rigid domains" + ("" if planes else ", their boundaries in black"))
    if planes:
        lattice.paint_block(block, colour, page.view or VIEW)
    else:
        _paint(block, colour, domains.domain, walls, domains, lattice.site_on_paper(0.85 * width, shape))
        lattice.box_driven_rows(block, shape)
    for letter, axes, (axis, index) in zip(DOMAIN_LETTERS, cuts, planes, strict=False):
        plane, labels = (np.take(every, index, axis) for every in (colour, domains.domain))
        inside = lattice.contacts_in_plane(walls, axis, index)
        _paint(axes, plane, labels, inside, domains, lattice.site_on_paper(0.85 * width, labels.shape))
        lattice.name_cut(axes, axis, index, f"({letter}) ")
    _draw_values(values, domains)
    values.set_title(f"({DOMAIN_LETTERS[len(planes)]}) turn: the key to the colours")
    return figure


def colour_of_turn(turn: np.ndarray) -> np.ndarray:
    """Colour (..., 4) of turn (..., C): blue with the bottom, red with the top; yellow or green as the first or the
    second component is nearer to the top than the other."""
    turn = np.clip(turn, 0.0, 1.0)
    colour: np.ndarray = colormaps[lattice.SPIN_COLOURS](turn.mean(axis=-1))
    ahead = turn[..., 0] - turn[..., -1]
    for share, target in ((ahead, FIRST_AHEAD), (-ahead, SECOND_AHEAD)):
        part = np.clip(share, 0.0, None)[..., None]
        colour[..., :3] += part * (np.array(target) - colour[..., :3])
    return colour


def _paint(
    axes: Any, colour: np.ndarray, domain: np.ndarray, walls: Sequence[np.ndarray], domains: RigidDomains, site: float
) -> None:
    lattice.paint_plane(axes, colour)
    lattice.draw_contacts(axes, walls, across=True, colors="black", lw=lattice.line_on_site(site, 0.1, 0.25, 1.0))
    partly = np.argwhere(domains.kind[domain] == LOCKS.index("partly"))
    axes.plot(*partly.T, ".", color="black", ms=max(0.35 * site, 0.8), mew=0)


def _draw_values(axes: Any, domains: RigidDomains) -> None:
    """Every domain at its turn: two components against each other, or one against the number of spheres."""
    turn, margin = domains.turn, 0.04
    along = np.linspace(-margin, 1 + margin, 200)
    plane = turn.shape[1] > 1
    if plane:
        low, high, height, key = -margin, 1 + margin, turn[:, 1], np.stack(np.meshgrid(along, along), axis=-1)
    else:
        low, high, height, key = 0.7, 1.5 * domains.spheres.max(), domains.spheres, along[None, :, None]
        axes.set_yscale("log")
    axes.imshow(colour_of_turn(key), extent=(-margin, 1 + margin, low, high), origin="lower", aspect="auto")
    sphere = 4.0 if domains.number < 2000 else 0.5  # area of one, points squared
    spheres = domains.spheres_of_kind(np.ones(domains.domain.shape, dtype=bool))
    for kind, name in reversed(list(enumerate(LOCKS))):
        chosen = domains.kind == kind
        if not chosen.any():
            continue
        label = f"{name}\n{spheres[name]:,} spheres\ndomains: {int(chosen.sum()):,}"
        draw = partial(axes.scatter, turn[chosen, 0], height[chosen], marker=MARKS[name], label=label)
        if name in LOCK_COLOURS:
            draw(s=45, color=LOCK_COLOURS[name], edgecolors="white", clip_on=False, zorder=3)
        else:
            alpha, many = 0.7 if sphere > 2 else 0.35, domains.number > lattice.MOST_LINES
            draw(s=sphere * domains.spheres[chosen], color="black", lw=0, alpha=alpha, rasterized=many)
    names = [AXES[component] for component in domains.spin_axes]
    labels = [rf"$(\Omega_{n} - \Omega_{{B{n}}})\,/\,(\Omega_{{T{n}}} - \Omega_{{B{n}}})$" for n in names]
    axes.set(xlabel=labels[0], ylabel=labels[1] if plane else "spheres of the domain")
    axes.set(xlim=(-margin, 1 + margin), ylim=(low, high), box_aspect=1)
    if not plane:
        label_in_plain_text(axes.yaxis)
    look: dict[str, Any] = {"ncols": 2, "labelspacing": 0.8, "title": "locked to"}
    legend = axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), **look)
    for handle in legend.legend_handles:  # of one size, however small the domains are
        handle.set_sizes([40.0])
        handle.set_alpha(1.0)
