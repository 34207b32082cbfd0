"""What all figures of the paper need: the minimum of a scene, and a figure in both its kinds."""

from pathlib import Path

from matplotlib.figure import Figure

from taichi_bearings.plots.style import save
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import MethodOptions
from taichi_bearings.solvers.drive import solve, uninterrupted
from taichi_bearings.solvers.stopping import StopRule

TIGHT = StopRule(1e-12)


def solved(scene: Scene, method: MethodOptions, rule: StopRule = TIGHT, start: str = "linear") -> Solution:
    """Where a method ends; KeyboardInterrupt if it was stopped before."""
    return uninterrupted(solve(scene, method.build(), initial_spin(scene, start), rule))


def save_both(figure: Figure, folder: Path, name: str) -> None:
    """Write `name`.png and `name`.pdf."""
    for ending in ("png", "pdf"):
        save(figure, folder / f"{name}.{ending}")
