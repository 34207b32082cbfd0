"""Where the energy of a dynamics came from, where it is and where it went."""

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.errors import InputError
from taichi_bearings.plots.style import BLUE, GREEN, GREY, ORANGE, in_our_style, new_figure
from taichi_bearings.scene import Solution

ACCOUNTS = {"injected": BLUE, "dissipated": ORANGE, "kinetic": GREEN, "spring": GREY}


@in_our_style
def draw_energy(solution: Solution, replica: int = 0) -> Figure:
    """The four accounts, and below them what they leave unexplained, against time.

    InputError if the run keeps no energy books.
    """
    history = solution.history
    if "energy_residual" not in history:
        raise InputError("the run keeps no energy books; run a dynamics with --energy")
    figure = new_figure(5.5, 5.0)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    time = history["time"]
    for name, colour in ACCOUNTS.items():
        energy = history[f"{name}_energy"][:, replica]
        shown = (time > 0) & (energy > 0)
        if shown.any():
            top.plot(time[shown], energy[shown], color=colour, lw=1.2, label=name)
    top.set(xscale="log", yscale="log", ylabel="energy")
    top.set_title(f"{'x'.join(map(str, solution.scene.lattice.shape))} {solution.scene.law}, {solution.method}")
    top.legend(fontsize=8)
    missing = np.abs(history["energy_residual"][:, replica])
    shown = (time > 0) & (missing > 0)
    if shown.any():
        bottom.plot(time[shown], missing[shown], color=GREY, lw=1.2)
        bottom.set(xscale="log", yscale="log")
    bottom.set(xlabel="time", ylabel="residual / turnover")
    return figure
