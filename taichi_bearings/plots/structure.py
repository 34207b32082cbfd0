"""Draws rigid domains and the slipless network: where they are, how they rotate, and a path from bottom to top.

These are paper Figs. 3b and 3c, and its intermediate bearing states. The *turn* of a domain is its spin as a fraction
of the way from that of the bottom (0) to that of the top (1), one number for each component that the driving needs.
Colours of domains show it; with two components the panel of all turns is the key to the colours.

Letters: C spin components, E contacts, N spheres.
"""

from functools import partial
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from taichi_bearings.analysis.domains import LOCKS, RigidDomains
from taichi_bearings.analysis.slipless_network import SliplessNetwork
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.lattice import Lattice
from taichi_bearings.plots import bearing
from taichi_bearings.plots.bearing import SPIN_COLOURS, Sheet
from taichi_bearings.plots.page import AXES, BELOW, PAGE, VIEW, Page, View, columns_on, middle_planes
from taichi_bearings.plots.style import GREEN, GREY, describe, in_our_style, label_in_plain_text, panels, put_title
from taichi_bearings.scene.scene import of_lattice

# colours of domains whose first, or second, component alone is that of the top
FIRST_AHEAD, SECOND_AHEAD = to_rgb("#e8b400"), to_rgb("#0d8a6f")
LOCK_COLOURS = {"bottom": colormaps[SPIN_COLOURS](0.0), "top": colormaps[SPIN_COLOURS](1.0)}
MARKS = dict(zip(LOCKS, "v^Dsdo", strict=True))  # marker of each kind of domain
KEY_WIDTH = 2.2  # least width in inches of the panel of turns
DOMAIN_LETTERS = "bcdefghijklmnopqrstuvwxyz"
NO_PATH = "no path from bottom to top"
PANELS = {"spheres": "from outside", "contacts": "slipless contacts", "path": "spheres of the path, their spins"}
REACHED_COLOURS = {"bottom": colormaps[SPIN_COLOURS](0.05), "top": colormaps[SPIN_COLOURS](0.95)}


@in_our_style
def draw_domains(structure: Structure, page: Page = PAGE) -> Figure:
    """Draw the spheres coloured by rigid domain, in 3D from outside and in cuts, and how the domains rotate.

    structure : the sample.
    page : how the figure is printed: width, planes and view.

    Black lines are boundaries of rigid domains. Black dots mark spheres that slipless contacts join to a driven plane
    in some spin components only.
    """
    domains = structure.rigid_domains
    if structure.network.whole.lattice is None:
        return _draw_domains_of_packing(structure, page)
    lattice = structure.network.lattice
    shape, colour = lattice.shape, colour_of_turn(domains.turn)[domains.domain]
    planes = () if len(shape) == 2 else page.planes or middle_planes(shape)
    tall = float(np.clip(shape[-1] / max(shape[:-1]), 0.8, 1.5))
    figure, (block, *cuts, values), width = panels(page, 2 + len(planes), (0.85 * tall, 0.6), least=KEY_WIDTH)
    if planes:
        bearing.paint_block(block, colour, page.view or VIEW)
    else:
        _paint(block, Sheet.of_lattice(lattice), colour, structure, 0.85 * width)
    block.set_title("(a) rigid domains" + ("" if planes else ", their boundaries in black"))
    for letter, axes, plane in zip(DOMAIN_LETTERS, cuts, planes, strict=False):
        _paint(axes, Sheet.of_lattice(lattice, plane), colour, structure, 0.85 * width)
        bearing.name_cut(axes, *plane, f"({letter}) ")
    _draw_values(values, domains)
    values.set_title(f"({DOMAIN_LETTERS[len(planes)]}) rotation: key to the colours")
    put_title(figure, describe(structure.scene), page)
    return figure


def _draw_domains_of_packing(structure: Structure, page: Page) -> Figure:
    """Draw the rigid domains of a packing in colours.

    With two driven bodies in bearing states the colour shows how a domain rotates: blue like the first, red like the
    second, others in between. Otherwise each of the largest domains has a colour of its own.

    structure : the sample.
    page : how the figure is printed.
    """
    domains = structure.rigid_domains
    figure, axes, sheet, _, look = bearing.one_panel(structure.network.whole, page)
    differing = np.flatnonzero(domains.jump.any(axis=0))  # components in which the driven bodies differ
    if len(differing):
        colour = colour_of_turn(domains.turn[:, differing])
    else:
        by_size = colormaps["tab20"](np.minimum(np.arange(domains.number), 19))
        colour = np.where((domains.spheres > 1)[:, None], by_size, bearing.PALE)
    _paint(axes, sheet, colour[domains.domain], structure, page.inches("single"))
    if len(differing):
        label = "rotation, from the first driven body's to the second's"
        label += "\nyellow, green: one component alone is nearer to the second" if len(differing) > 1 else ""
        bearing.colour_bar(figure, axes, label, Normalize(0, 1), SPIN_COLOURS, **look)
    kinds = ", ".join(f"{count:,} {kind}" for kind, count in domains.domains_of_kind().items() if count)
    put_title(figure, f"{describe(structure.scene)}\n{domains.number:,} rigid domains, turning with: {kinds}", page)
    return figure


def colour_of_turn(turn: np.ndarray) -> np.ndarray:
    """Return colours (..., 4) that show how a domain rotates between bottom, blue, and top, red. Yellow is mixed in if
    the first component is nearer to the top than the second, green if the second is.

    turn : (..., C components), spin by component as a fraction: 0 is that of the bottom, 1 that of the top.
    """
    turn = np.clip(turn, 0.0, 1.0)
    colour: np.ndarray = colormaps[SPIN_COLOURS](turn.mean(axis=-1))
    ahead = turn[..., 0] - turn[..., -1]
    for share, target in ((ahead, FIRST_AHEAD), (-ahead, SECOND_AHEAD)):
        part = np.clip(share, 0.0, None)[..., None]
        colour[..., :3] += part * (np.array(target) - colour[..., :3])
    return colour


def _paint(axes: Axes, sheet: Sheet, colour: np.ndarray, structure: Structure, width: float) -> None:
    """Draw the spheres of a picture, coloured by rigid domain, with lines between discs of two domains.

    axes : axes of matplotlib.
    sheet : N discs and their contacts on paper.
    colour : colours of all spheres of the sample, in the shape of the lattice or (spheres,), and 4.
    structure : what the contacts of the sample form, with the domain of each sphere.
    width : width of the picture in inches.
    """
    domains = structure.rigid_domains
    site, (first, second) = sheet.site(width), domains.domain.ravel()[structure.network.whole.contact]
    sheet.paint(axes, colour.reshape(-1, 4)[sheet.sphere])
    sheet.box_driven(axes)
    if not sheet.is_flat:
        return
    sheet.draw(axes, first != second, across=True, colors="black", lw=bearing.line_on_site(site, 0.1, 0.25, 1.0))
    partly = domains.kind[domains.domain.ravel()[sheet.sphere]] == domains.locks.index("partly")
    axes.plot(*sheet.place[partly].T, ".", color="black", ms=max(0.35 * site, 0.8), mew=0)


def _draw_values(axes: Axes, domains: RigidDomains) -> None:
    """Draw every rigid domain as a point at its spin, as a fraction between bottom, 0, and top, 1.

    axes : axes of matplotlib.
    domains : the rigid domains of a sample. With two spin components one is drawn against the other; a single one is
        drawn against the number of spheres.
    """
    turn, margin = domains.turn, 0.04
    along = np.linspace(-margin, 1 + margin, 200)
    has_two = turn.shape[1] > 1
    # ends of the vertical axis, height of each domain on it, and turns whose colours are the background
    if has_two:
        low, high, height, key = -margin, 1 + margin, turn[:, 1], np.stack(np.meshgrid(along, along), axis=-1)
    else:
        low, high, height, key = 0.7, 1.5 * domains.spheres.max(), domains.spheres, along[None, :, None]
        axes.set_yscale("log")
    axes.imshow(colour_of_turn(key), extent=(-margin, 1 + margin, low, high), origin="lower", aspect="auto")
    sphere = 4.0 if domains.number < 2000 else 0.5  # area of a marker for each sphere of the domain, points squared
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
            alpha, many = 0.7 if sphere > 2 else 0.35, domains.number > bearing.MOST_LINES
            draw(s=sphere * domains.spheres[chosen], color="black", lw=0, alpha=alpha, rasterized=many)
    names = [AXES[component] for component in domains.spin_axes]
    labels = [rf"$(\Omega_{n} - \Omega_{{B{n}}})\,/\,(\Omega_{{T{n}}} - \Omega_{{B{n}}})$" for n in names]
    axes.set(xlabel=labels[0], ylabel=labels[1] if has_two else "spheres of the domain")
    axes.set(xlim=(-margin, 1 + margin), ylim=(low, high), box_aspect=1)
    if not has_two:
        label_in_plain_text(axes.yaxis)
    look: dict[str, Any] = {"ncols": 4, "title": "domains that turn with", "loc": "outside lower center"}
    legend = axes.figure.legend(*axes.get_legend_handles_labels(), **look)
    handles: list[Any] = legend.legend_handles
    for handle in handles:  # markers in the legend have one size, however small the domains are
        handle.set_sizes([40.0])
        handle.set_alpha(1.0)


@in_our_style
def draw_network(structure: Structure, page: Page = PAGE) -> Figure:
    """Draw the slipless contacts and a shortest path through them from bottom to top.

    structure : the sample.
    page : how the figure is printed: width and view.

    In 3D there are three panels: the spheres from outside; slipless contacts in grey and the path in green; the spheres
    of the path with their spins. In 2D there are the last two. Of a packing its slipless contacts are drawn.

    Where there are too many contacts to see each, only those on the sides of the lattice behind the path are drawn, so
    that nothing hides it. Where no path joins bottom and top, the figure says so; then contacts joined to the bottom
    are blue, and those joined to the top red.
    """
    network, spin = structure.network, structure.scene.driving.shown(structure.spin)
    if structure.whole.lattice is None:
        return _draw_network_of_packing(structure, page)
    (spin_top, spin_bottom), path = of_lattice(structure.scene).imposed, network.shortest_path
    speed = bearing.speed_of(spin, spin_top, spin_bottom)
    is_flat, has_contacts = spin.ndim == 2, network.ends.shape[1] > 0
    drawn = ["spheres"] * (not is_flat) + ["contacts"] * (is_flat or has_contacts) + ["path"] * (len(path) > 0)
    view, bar_is_below = page.view or VIEW, columns_on(page, len(drawn)) == 1
    figure, each, width = panels(page, len(drawn), (0.9, 0.3), 0.4 if bar_is_below else 0.0, widest="single")
    words = f"{network.ends.shape[1]:,} slipless contacts, {f'a path of {len(path) - 1}' if len(path) else NO_PATH}"
    for letter, panel, axes in zip("abc", drawn, each, strict=False):
        axes.set_title(f"({letter}) {PANELS[panel]}" if len(drawn) > 1 else "")
        if panel == "spheres":
            bearing.paint_block(axes, colormaps[SPIN_COLOURS](speed), view)
        elif panel == "contacts":
            words += _draw_contacts(axes, network, view, 0.85 * width)
        else:
            _draw_path_spins(axes, network, spin / (max(abs(spin_top), abs(spin_bottom)) or 1.0), speed, view)
    if not is_flat or len(path):
        bearing.draw_speed_bar(figure, each, structure.scene, **({"shrink": 0.6} | (BELOW if bar_is_below else {})))
    if has_contacts and not network.spans:
        colours: dict[str, Any] = {**REACHED_COLOURS, "neither": to_rgba(GREY)}
        drawn_in = {tuple(colour) for colour in contact_colours(network)}
        marks = [Line2D([], [], color=c, label=end) for end, c in colours.items() if tuple(c) in drawn_in]
        figure.legend(handles=marks, title="joined to", loc="outside lower center", ncols=3)
    put_title(figure, f"{describe(structure.scene)}\n{words}", page)
    return figure


def _draw_network_of_packing(structure: Structure, page: Page) -> Figure:
    """Draw the slipless contacts of a packing over its spheres.

    structure : the sample.
    page : how the figure is printed: width and view.
    """
    network = structure.network
    figure, axes, sheet, site, _ = bearing.one_panel(network.whole, page)
    sheet.paint(axes, bearing.PALE if sheet.is_flat else bearing.PALE * [1, 1, 1, 0.25])
    sheet.draw(axes, network.slipless, colors=GREY, lw=bearing.line_on_site(site, 0.12, 0.3))
    words = f"{network.ends.shape[1]:,} of {structure.movable:,} contacts do not slip"
    put_title(figure, f"{describe(structure.scene)}\n{words}", page)
    return figure


def contact_colours(network: SliplessNetwork) -> np.ndarray:
    """Return the colour (edges, 4) of each slipless contact: grey; where no path joins bottom and top, blue if it is
    joined to the bottom and red if it is joined to the top.

    network : the slipless contacts.
    """
    colour = np.tile(to_rgba(GREY), (network.ends.shape[1], 1))
    if not network.spans:
        piece = network.component.ravel()
        of_edge = piece[network.ends[0]]
        colour[of_edge == piece[0]] = REACHED_COLOURS["bottom"]
        colour[of_edge == piece[-1]] = REACHED_COLOURS["top"]
    return colour


def on_rear_sides(lattice: Lattice, view: View) -> np.ndarray:
    """Return a mask (contacts E,) of the contacts that lie within one of the three sides of a cubic lattice that do not
    face the reader.

    lattice : the lattice.
    view : direction from which the lattice is seen.
    """
    rear = np.array([0 if view.faces(axis) else n - 1 for axis, n in enumerate(lattice.shape)])
    is_on_side = np.argwhere(np.ones(lattice.shape, dtype=bool)) == rear  # (spheres, 3)
    are_both: np.ndarray = is_on_side[lattice.ends].all(axis=0).any(axis=1)
    return are_both


def _draw_contacts(axes: Axes, network: SliplessNetwork, view: View, width: float) -> str:
    """Draw the contacts that do not slip and, in green, the shortest path over them from the bottom to the top. Return
    words that say which contacts are drawn, "" for all.

    axes : axes of matplotlib.
    network : the spheres and these contacts.
    view : from where the lattice is seen.
    width : width of the picture in inches.
    """
    lattice, chosen, words = network.lattice, network.slipless, ""
    sheet = Sheet.of_lattice(lattice, view=view)
    colour = np.ones((lattice.all_contacts, 4))
    colour[chosen] = contact_colours(network)
    if lattice.dimension == 2:
        sheet.frame(axes)
        sheet.box_driven(axes)
        line = bearing.line_on_site(sheet.site(width, width), 0.12, 0.2)
    else:
        bearing.frame_block(axes, lattice.shape, view)
        line = bearing.line_on_site(72 * width / max(lattice.shape) / 1.6, 0.12, 0.3, 1.0)
        depth = sheet.depth[sheet.ends].mean(axis=0)
        rank = np.argsort(np.argsort(depth[chosen]))
        colour[chosen, 3] = 0.2 + 0.6 * rank / max(chosen.sum() - 1, 1)  # contacts in front are more opaque
        if chosen.sum() > bearing.MOST_LINES:
            chosen, words = chosen & on_rear_sides(lattice, view), "; drawn: the sides behind"
            colour[:, 3] = 0.7
    if not chosen.any():
        axes.text(0.5, 0.5, "no contact is slipless", transform=axes.transAxes, ha="center", va="center")
    sheet.draw(axes, chosen, colors=colour, lw=line, label="slipless contacts")
    if len(path := network.shortest_path):
        wide = float(np.clip(20.0 / max(lattice.shape), 0.9, 1.8))
        look: dict[str, Any] = {"capstyle": "round"}
        sheet.draw(axes, network.on_path, colors="white", lw=2 * wide, zorder=3, **look)
        sheet.draw(axes, network.on_path, colors=GREEN, lw=wide, zorder=4, label="path", **look)
        ends = sheet.place[np.ravel_multi_index(tuple(path[[0, -1]].T), lattice.shape)]
        axes.plot(*ends.T, "o", color=GREEN, mec="white", mew=0.8, ms=3 * wide, zorder=4)
    return words


def _draw_path_spins(axes: Axes, network: SliplessNetwork, spin: np.ndarray, speed: np.ndarray, view: View) -> None:
    """Draw the spheres of the shortest slipless path of a network, coloured by speed, with their spins. In 3D: spheres
    from the back to the front, an arrow for each spin, and the shadow of the path on the floor. In 2D: discs, each with
    a symbol of the sense in which it turns.

    axes : axes of matplotlib.
    network : the slipless contacts of a lattice, with the path.
    spin : laboratory spins, 1/time: (nx, ny, nz, 3) in 3D, (nx, ny) in 2D.
    speed : (nx, ny, nz) or (nx, ny), the place of each sphere on the scale of colours, 0 to 1.
    view : from where the lattice is seen, in 3D.
    """
    path, lattice, shape = network.shortest_path, network.lattice, network.lattice.shape
    of_path, sheet = tuple(path.T), Sheet.of_lattice(network.lattice, view=view)
    colour = colormaps[SPIN_COLOURS](speed[of_path])
    if len(shape) == 2:
        every = np.ones((*shape, 4))
        every[of_path] = colour
        sheet.paint(axes, every.reshape(-1, 4))
        sheet.box_driven(axes)
        for (x, y), value in zip(path, spin[of_path], strict=True):
            turn = "" if value == 0 else "↺" if value > 0 else "↻"
            axes.text(x, y, turn, ha="center", va="center", fontsize=max(3.0, 60 / max(shape)))
        return
    bearing.frame_block(axes, shape, view)
    # the shadow: horizontal contacts of the path, moved down to the floor
    horizontal, which = sheet.lines(network.on_path & (lattice.axis < 2))
    height = np.unravel_index(lattice.ends[0, which], shape)[2] + 0.5
    shadow = horizontal - (height[:, None] * view.seen(np.eye(3)[2])[:2])[:, None]
    axes.add_collection(LineCollection(list(shadow), colors=GREEN, alpha=0.4, lw=1.0, zorder=1))
    placed = view.seen(path)
    order = np.argsort(placed[:, 2])
    bearing.paint_spheres(axes, placed[order][:, :2], colour[order])
    arrow = 1.6 * view.seen(spin[of_path])[order]
    axes.quiver(
        *placed[order][:, :2].T, *arrow[:, :2].T, angles="xy", scale_units="xy", scale=1, zorder=5, units="xy",
        width=0.02 * np.sqrt(max(shape)), color="black", edgecolor="white", lw=0.3, headwidth=3.5, headlength=4,
        minlength=0.5,
    )  # fmt: skip
