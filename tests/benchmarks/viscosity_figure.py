"""From the smooth profile of viscous contacts to the fragmented state of dry friction: a figure and its numbers.

python -m tests.benchmarks.viscosity_figure FIGURE.png [--shapes 10,10,10 16,16,16] [--seeds 3]

Contacts with friction and viscosity (`coulomb-viscous`), both uniform in [0.1, 1], in units of F_n and of `strength`
F_n / (R omega_T): with strength 1 the two forces are alike where the whole jump slips. At the stationary state,
certified to 1e-12: the share of contacts that do not slip, the number of rigid domains, the power over that of the
lightest interface of two domains, and how far it is above the least power, that of the stationary state of twice the
viscosity.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.plots.style import BLUE, ORANGE, in_our_style, new_figure, save
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin, minimum_cut_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule

STRENGTHS = 10.0 ** np.arange(-4, 4.1, 0.5)
PANELS = ("slipless share", "rigid domains / spheres", "P / P of the minimum cut", "P / least P - 1")


def stationary(scene):
    solution = solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-12))
    assert solution.status.value == "certified", solution.gap
    return solution


def numbers(shape, seed, strength):
    """One value a panel."""
    scene = Scene.random(shape, seed, law="coulomb-viscous")
    unit = strength * scene.normal_force / (scene.lattice.radius * scene.jump)
    scene = replace(scene, viscosity=tuple(unit * values for values in scene.viscosity))
    solution, axes = stationary(scene), scene.minimum_spin_axes
    structure = structure_of(solution)
    least = stationary(replace(scene, viscosity=tuple(2 * values for values in scene.viscosity)))
    least_power = scene.power(scene.staggered_spin(least.spin, axes), axes)[0]
    cut = scene.power(scene.staggered_spin(minimum_cut_spin(scene), axes), axes)[0]
    return (
        structure.contacts_in(ContactState.SLIPLESS) / scene.lattice.contacts,
        structure.domains.number / scene.lattice.sites,
        solution.power[0] / cut,
        solution.power[0] / least_power - 1,
    )


@in_our_style
def draw(found):
    """found : shape -> values (strengths, seeds, panels)."""
    figure = new_figure(7.0, 5.2)
    for panel, axes in enumerate(figure.subplots(2, 2, sharex=True).flat):
        for (shape, values), colour in zip(found.items(), (BLUE, ORANGE), strict=False):
            axes.plot(STRENGTHS, values[..., panel], ".", color=colour, ms=3, alpha=0.6)
            axes.plot(STRENGTHS, values[..., panel].mean(axis=1), color=colour, label="x".join(map(str, shape)))
        axes.set(xscale="log", ylabel=PANELS[panel])
        if panel > 1:
            axes.set_xlabel(r"$\eta\,R\,\omega_T\,/\,F_n$ over $\mu$")
    figure.axes[0].legend()
    return figure


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figure")
    parser.add_argument("--shapes", nargs="+", default=["10,10,10", "16,16,16"])
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    runtime.start("cpu", "f64")
    found = {}
    for shape in (tuple(map(int, text.split(","))) for text in arguments.shapes):
        values = [[numbers(shape, seed, s) for seed in range(arguments.seeds)] for s in STRENGTHS]
        found[shape] = np.array(values)
        print(f"\n| eta R omega_T / F_n over mu, {shape} | {' | '.join(PANELS)} |\n|{'---|' * 5}")
        for strength, of_seeds in zip(STRENGTHS, found[shape], strict=True):
            print(f"| {strength:.2g} | {' | '.join(format(v, '.4g') for v in of_seeds.mean(axis=0))} |")
    save(draw(found), Path(arguments.figure))


if __name__ == "__main__":
    main()
