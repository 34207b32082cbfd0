"""The yield surface: which torques a frustrated bearing withstands, over the directions in which its top can be
driven.

The top rotates in the bearing state a + c (x - x_0) / rho, the bottom rests: a lies in the plane, x_0 is the middle of
the top and rho the root mean square distance from it, so that |(a, c)| is that of the jump. The least power P(a, c) is
convex and homogeneous of degree one: the support function of a convex set, of all torques (T_x, T_y, T_c) that forces
in balance within their friction can hold (plastic limit analysis: Andersen, Christiansen, Conn, Overton 1998; the set
of Moreau's sweeping process). A torque that drives is a subgradient of P (normality), and P = torque . (a, c). The set
lies between the proven torques and the proven half-spaces T . (a, c) <= P.

If the top rotates about x alone, no layer y = const is driven: together these layers carry any T_y up to some t, the
yield torque about y while the top rotates about x. So the surface has flat parts there, of the width 2 t, and t < P(y)
shows how much the rotation about x weakens the bearing. Where top and bottom differ in both components in each layer
the torque is unique (see analysis/structure), so the surface has no flat part there.

A direction is (a_x, a_y, c). Powers are energy/time at a spin of 1, so torques and powers have the same numbers.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.lattice.grid import staggered_forces
from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, GREY, ORANGE, in_our_style, new_figure, shades
from taichi_bearings.runs.lattice_run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.plan import sample_key
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.stopping import StopRule

from .claims import Effort
from .drawing import draw_means, name_sizes
from .fits import exponent, limit
from .samples import Part, StudyResult, Table, computed, solved

SHARES = {4: 1.0, 6: 1.0, 8: 0.5, 12: 0.25, 16: 0.25, 24: 0.05}  # by side of the cube, share of the effort's samples
QUICK_SIDES = (4, 6, 8)
FEWEST = 5  # least samples of a side, so that their spread is known
BESIDE = 1e-4  # small rotation about a second axis, by which the torque is at the end of a flat part of the surface
SLOPES = (0.0, BESIDE, 0.1, 0.25, 0.5, 1.0)
PLANE = [(1.0, slope, 0.0) for slope in SLOPES] + [(slope, 1.0, 0.0) for slope in reversed(SLOPES[:-1])]
DILATING = [(1.0, 0.0, c) for c in (BESIDE, 0.5, 1.0)] + [(a, 0.0, 1.0) for a in (0.5, BESIDE, 0.0)]
DIRECTIONS = PLANE + DILATING  # (a_x, a_y, c), by their angles
PROVEN_GAP = StopRule(1e-10)
SHOWN = 3  # number of sizes whose surface is drawn


def offsets(side: int) -> np.ndarray:
    """Return (side,), one coordinate of the spheres of a square plane of `side` x `side` spheres, measured from its
    middle. The unit is rho, the root mean square distance of these spheres from the middle.
    """
    found: np.ndarray = (np.arange(side) - (side - 1) / 2) / ((side**2 - 1) / 6) ** 0.5
    return found


def settings_of(side: int, seed: int, direction: tuple[float, float, float]) -> RunSettings:
    """Return the settings of one sample: a cube whose bottom is at rest and whose top is driven.

    side, seed : spheres along each edge, and seed of the friction.
    direction : (a_x, a_y, c), 1/time. The spin of the top at (x, y) from its middle is (a_x, a_y) + c (x, y) / rho,
        with signs that alternate between neighbours; rho is the root mean square distance from the middle.
    """
    a_x, a_y, c = direction
    first, rate = offsets(side)[0] * c, np.diff(offsets(side))[0] * c  # the spacing is 1
    return RunSettings(shape=(side,) * 3, seed=seed, top=(a_x + first, a_y + first, 0.0, rate), bottom=(0.0,) * 4)


def power_and_torque(settings: RunSettings) -> dict[str, Any]:
    """Return by name three results for one sample at its minimum.

    power, lower_bound : least power and its proven lower bound, energy/time.
    torque : [T_x, T_y, T_c], energy: torque on the top by the contact forces that prove the bound. Its components do
        work on a_x, a_y and c of the driving (:func:`settings_of`).

    settings : settings of the sample.
    """
    scene = build_scene(settings)
    structure = structure_of(solved(scene, InteriorPoint(settle=False), PROVEN_GAP))
    force = staggered_forces(structure.answer.friction, scene.lattice, scene.minimum_spin_axes)[:, 0]
    upright = scene.lattice.by_axis(scene.lattice.radius * force)[-1].mean(axis=-1)  # (C, nx, ny)
    # row k: torques about axis k on the layers across that axis
    of_layers = np.zeros((2, scene.lattice.shape[0]))
    for slot, component in enumerate(scene.minimum_spin_axes):
        of_layers[component] = upright[slot].sum(axis=1 - component)
    torque = [*of_layers.sum(axis=1), (of_layers @ offsets(scene.lattice.shape[0])).sum()]
    return {"power": structure.power, "lower_bound": structure.lower_bound, "torque": list(map(float, torque))}


def study(folder: Path, effort: Effort) -> StudyResult:
    """Find the least power and the torque of samples of several sizes under all directions; return table, figure and
    values for the claims.

    folder : folder where finished samples are kept until the study ends.
    effort : first seed, number of samples, and whether it is the quick form.
    """
    shares = {side: share for side, share in SHARES.items() if not effort.quick or side in QUICK_SIDES}
    points = [
        (side, seed)
        for side, share in shares.items()
        for seed in effort.seeds(max(FEWEST, round(share * effort.samples)))
    ]
    chosen = [settings_of(*point, direction) for point in points for direction in DIRECTIONS]
    parts = [Part(sample_key(settings), power_and_torque, (settings,), settings) for settings in chosen]
    found = Table.of(computed(parts, folder / "yield.jsonl", "sample"))
    asked = [(*point, *direction) for point in points for direction in DIRECTIONS]
    columns = dict(zip(("side", "seed", "a_x", "a_y", "c"), zip(*asked, strict=True), strict=True))
    torques = dict(zip(("torque_x", "torque_y", "torque_c"), found.torque.T, strict=True))
    rows = Table({**columns, "power": found.power, "lower_bound": found.lower_bound, **torques})
    named = names_of(np.array(points), found.power.reshape(len(points), -1), found.torque.reshape(len(points), -1, 3))
    return StudyResult({".csv": rows}, draw_yield_surface, named)


def names_of(points: np.ndarray, power: np.ndarray, torque: np.ndarray) -> dict[str, Any]:
    """Return the values that figure and claims use, by name. Values of single samples are arrays by side L of the cube.

    points : (samples n, 2) side and seed of the samples.
    power : (n, directions) least power P, energy/time, if the top is driven in each of DIRECTIONS, (a_x, a_y, c).
    torque : (n, directions, 3) torque (T_x, T_y, T_c) on the top at each minimum: its components for a_x, a_y and c.

    * `above`: largest relative excess of torque . direction over P(direction), over all torques and directions; 0 if
      all torques lie inside the yield surface.
    * `apart`: largest relative difference of P and torque . direction, with each torque in its own direction.
    * `crossed`: share of the yield torque about y that is left while the top rotates about x, and with x and y
      exchanged; the mean of both.
    * `square`, `circle`: P(1, 1) / (P(1, 0) + P(0, 1)) and P(1, 1) / sqrt(P(1, 0)^2 + P(0, 1)^2), with c = 0.
    * `steps`: change of T_x if a small rotation about x is added to the direction c, over P(c).
    * `per_area`: P / (F_n R L^2 |direction|), by direction.
    * `body`: by side, the means over samples of P and of the torques, over F_n R L^2.
    * `fading`, `squaring`: fits of 1 - crossed and 1 - square by A L^(2 value).
    * `square_limit`, `limits_of`: limits of `square` and of `per_area` for infinite size.
    """
    at, settings = {direction: k for k, direction in enumerate(DIRECTIONS)}, RunSettings()
    unit = settings.normal_force * settings.radius * points[:, 0] ** 2

    def of(values: np.ndarray) -> dict[int, np.ndarray]:
        """Return values (samples,) as a dictionary of arrays by side of the cube."""
        return Table({"side": points[:, 0], "value": values}).by("value")

    x, y, both, c = (power[:, at[direction]] for direction in ((1, 0, 0), (0, 1, 0), (1, 1, 0), (0, 0, 1)))
    # torque about one axis while the top rotates about the other, over the yield torque about it
    crossed = (torque[:, at[1, BESIDE, 0], 1] / y + torque[:, at[BESIDE, 1, 0], 0] / x) / 2
    step = np.abs(torque[:, at[BESIDE, 0, 1], 0] - torque[:, at[0, 0, 1], 0]) / c
    work = torque @ np.transpose(DIRECTIONS)  # (n, directions of the torques, directions in which they do work)
    per_area = {
        name: of(values / unit) for name, values in (("x or y", (x + y) / 2), ("x + y", both / 2**0.5), ("C", c))
    }
    square = of(both / (x + y))
    return {
        "samples_of": {side: len(values) for side, values in square.items()}, "directions": len(DIRECTIONS),
        "beside": BESIDE, "above": float((work / power[:, None] - 1).max()),
        "apart": float(np.abs(np.einsum("ndd->nd", work) / power - 1).max()),
        "crossed": of(crossed), "fading": exponent(of(1 - crossed), np.mean, further=()), "steps": of(step),
        "square": square, "circle": of(both / np.hypot(x, y)), "square_limit": limit(square),
        "squaring": exponent(of(1 - both / (x + y)), np.mean, further=()), "per_area": per_area,
        "limits_of": {name: limit(values) for name, values in per_area.items()},
        "body": {
            side: ((power / unit[:, None])[here].mean(axis=0), (torque / unit[:, None, None])[here].mean(axis=0))
            for side in square
            for here in [points[:, 0] == side]
        },
    }  # fmt: skip


@in_our_style
def draw_yield_surface(named: Any) -> Figure:
    """Draw the figure of the torques (T_x, T_y, T_c) that bearings of L^3 spheres withstand, averaged over samples.

    named : the values of :func:`names_of`, where they are defined, as attributes. Used are `body`, `crossed`, `square`,
        `per_area`, and the fits `fading`, `squaring` and `limits_of`.

    (a) Yield surface in the plane (T_x, T_y), (b) in (T_x, T_c). Points are torques of the directions solved, an inner
        bound; thin lines follow from their powers, an outer bound. The circle and the square of (a) are for comparison:
        radius and half side are T_x of the largest L.
    (c) 1 - crossed, the share of the yield torque about one axis that is lost while the top rotates about the other;
        and 1 - square, the share by which the power about x + y is below the sum of those about x and about y.
    (d) Power per area against 1 / L.
    """
    directions, plane, sides = np.array(DIRECTIONS), len(PLANE), sorted(named.body)
    figure = new_figure(DOUBLE, 5.2)
    axes: Any = figure.subplots(2, 2)
    shown = [sides[k] for k in np.unique(np.linspace(0, len(sides) - 1, SHOWN).round().astype(int))]
    for side, color in zip(shown, shades(len(shown)), strict=True):
        power, torque = named.body[side]
        for panel, here, pair in (
            (axes[0, 0], np.arange(plane), [0, 1]),
            (axes[0, 1], np.r_[0, plane : len(power)], [0, 2]),
        ):
            normal, least = directions[here][:, pair], power[here]  # no torque T has T . normal > least
            corners = [np.linalg.solve(normal[k : k + 2], least[k : k + 2]) for k in range(len(here) - 1)]
            _draw_closed(panel, np.array(corners), "-", color=color, lw=0.4)
            _draw_closed(panel, torque[here][:, pair], "o-", color=color, ms=2, lw=0.9, label=f"L = {side}")
    x = power[0]
    angle = np.linspace(0, 2 * np.pi, 200)
    axes[0, 0].plot(x * np.cos(angle), x * np.sin(angle), ":", color=GREY, lw=0.8)
    _draw_closed(axes[0, 0], np.array([[x, 0], [x, x], [0, x]]), "--", color=GREY, lw=0.8)
    for panel, name in zip(axes[0], "yc", strict=True):
        panel.set(xlabel="$T_x / (F_n R L^2)$", ylabel=f"$T_{name} / (F_n R L^2)$", aspect="equal")
    axes[0, 0].set_title("(a) rotation about x and y")
    axes[0, 1].set_title("(b) rotation about x, and C")
    axes[0, 0].legend(loc="center")
    for share, fit, color, text in (
        (named.crossed, named.fading, BLUE, "yield torque, crossed"),
        (named.square, named.squaring, ORANGE, "power about x + y"),
    ):
        draw_means(axes[1, 0], {side: 1 - share[side] for side in sides}, fmt="o", color=color)
        ends = np.array([fit.smallest, sides[-1]])
        label = f"{text}: $L^{{{2 * fit.value:.2f} \\pm {2 * fit.total:.2f}}}$"
        axes[1, 0].plot(ends, fit.amplitude * ends ** (2 * fit.value), color=color, label=label)
    axes[1, 0].set(yscale="log", ylabel="share that is missing")
    axes[1, 0].set_yticks([0.1, 0.2, 0.3, 0.5, 0.7], ["0.1", "0.2", "0.3", "0.5", "0.7"])
    name_sizes(axes[1, 0], sides, "side of the cube, $L$")
    axes[1, 0].set_title("(c) what is missing")
    axes[1, 0].legend()
    for (name, of), color in zip(named.per_area.items(), (BLUE, ORANGE, GREEN), strict=True):
        draw_means(axes[1, 1], of, 1 / np.array(list(of)), fmt="o", color=color, label=name)
        fit = named.limits_of[name]
        inverse = np.array([0, 1 / fit.smallest])
        axes[1, 1].plot(inverse, fit.value + fit.amplitude * inverse, color=color)
    axes[1, 1].set(xlabel="$1 / L$", ylabel=r"$P / (F_n R L^2 |\Delta\omega|)$", xlim=(0, None))
    axes[1, 1].set_title("(d) power an area")
    axes[1, 1].legend()
    return figure


def _draw_closed(panel: Any, points: np.ndarray, *look: Any, **more: Any) -> None:
    """Draw a closed curve: a quarter, which leads from one axis to the other, and its mirror images in both axes. A
    mean bearing has these symmetries.

    panel : panel of matplotlib.
    points : (points, 2), those of the quarter, from one axis to the other.
    look, more : further arguments of matplotlib's plot.
    """
    quarters = [points, points[::-1] * [-1, 1], -points, points[::-1] * [1, -1]]
    panel.plot(*np.concatenate([*quarters, points[:1]]).T, *look, **more)
