"""The yield surface of bearings of several sizes, and how its shape and its flat parts depend on the size."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.plots.style import BLUE, DOUBLE, GREEN, GREY, ORANGE, in_our_style, new_figure, shades

from .minima import mean_and_error

SHOWN = 3  # sizes of which the surface is drawn


@in_our_style
def draw_yield_surface(named: Mapping[str, Any], directions: np.ndarray, plane: int) -> Figure:
    """(a) the torques (T_x, T_y) and (b) (T_x, T_c) that a mean bearing holds: between those of its directions (points)
    and the half-spaces of its powers (thin), with the circle and the square of the largest size; (c) what crossed
    driving takes of the yield torque, and by how much the power falls short of the sum about x and about y, against the
    size; (d) the power an area against 1 / L.

    named : as names_of in paper.yield_surface has it. directions : (D, 3), the first `plane` about x and y.
    """
    figure = new_figure(DOUBLE, 5.2)
    axes: Any = figure.subplots(2, 2)
    sides = sorted(named["body"])
    shown = [sides[k] for k in np.unique(np.linspace(0, len(sides) - 1, SHOWN).round().astype(int))]
    for side, color in zip(shown, shades(len(shown)), strict=True):
        power, torque = named["body"][side]
        for panel, here, pair in (
            (axes[0, 0], np.arange(plane), [0, 1]),
            (axes[0, 1], np.r_[0, plane : len(power)], [0, 2]),
        ):
            normal, reached = directions[here][:, pair], power[here]
            corners = [np.linalg.solve(normal[k : k + 2], reached[k : k + 2]) for k in range(len(here) - 1)]
            _closed(panel, np.array(corners), "-", color=color, lw=0.4)
            _closed(panel, torque[here][:, pair], "o-", color=color, ms=2, lw=0.9, label=f"L = {side}")
    x = power[0]
    angle = np.linspace(0, 2 * np.pi, 200)
    axes[0, 0].plot(x * np.cos(angle), x * np.sin(angle), ":", color=GREY, lw=0.8)
    _closed(axes[0, 0], np.array([[x, 0], [x, x], [0, x]]), "--", color=GREY, lw=0.8)
    for panel, name in zip(axes[0], "yc", strict=True):
        panel.set(xlabel="$T_x / (F_n R L^2)$", ylabel=f"$T_{name} / (F_n R L^2)$", aspect="equal")
    axes[0, 0].set_title("(a) turning about x and y")
    axes[0, 1].set_title("(b) turning about x, and C")
    axes[0, 0].legend(loc="center")
    for name, fit, color, text in (
        ("crossed", named["fading"], BLUE, "yield torque, crossed"),
        ("square", named["squaring"], ORANGE, "power about x + y"),
    ):
        mean, error = mean_and_error([1 - named[name][side] for side in sides])
        axes[1, 0].errorbar(sides, mean, error, fmt="o", ms=3, lw=0.8, color=color)
        far = np.array([fit.smallest, sides[-1]])
        label = f"{text}: $L^{{{fit.slope:.2f} \\pm {fit.slope_error:.2f}}}$"
        axes[1, 0].plot(far, np.exp(fit.value) * far**fit.slope, color=color, label=label)
    axes[1, 0].set(xscale="log", yscale="log", xlabel="side of the cube, $L$", ylabel="share that is missing")
    axes[1, 0].set_xticks(sides, list(map(str, sides)))
    axes[1, 0].set_yticks([0.1, 0.2, 0.3, 0.5, 0.7], ["0.1", "0.2", "0.3", "0.5", "0.7"])
    axes[1, 0].minorticks_off()
    axes[1, 0].set_title("(c) what is missing")
    axes[1, 0].legend()
    for (name, of), color in zip(named["per_area"].items(), (BLUE, ORANGE, GREEN), strict=True):
        mean, error = mean_and_error([of[side] for side in sides])
        axes[1, 1].errorbar(1 / np.array(sides), mean, error, fmt="o", ms=3, lw=0.8, color=color, label=name)
        fit = named["limits_of"][name]
        near = np.array([0, 1 / fit.smallest])
        axes[1, 1].plot(near, fit.value + fit.slope * near, color=color)
    axes[1, 1].set(xlabel="$1 / L$", ylabel=r"$P / (F_n R L^2 |\Delta\omega|)$", xlim=(0, None))
    axes[1, 1].set_title("(d) power an area")
    axes[1, 1].legend()
    return figure


def _closed(panel: Any, points: np.ndarray, *look: Any, **more: Any) -> None:
    """A curve from one axis to the other and its mirror images in both, as the mean bearing has them."""
    quarters = [points, points[::-1] * [-1, 1], -points, points[::-1] * [1, -1]]
    panel.plot(*np.concatenate([*quarters, points[:1]]).T, *look, **more)
