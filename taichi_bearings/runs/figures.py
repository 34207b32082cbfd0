"""The figures of one run by their names, whether it lies in a file or not."""

from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.plots.energy import draw_energy
from taichi_bearings.plots.history import draw_history
from taichi_bearings.plots.power import draw_power
from taichi_bearings.plots.spins import draw_spins
from taichi_bearings.runs.snapshot import draw_snapshot
from taichi_bearings.runs.structure_figures import FIGURES, FIGURES_OF_ALL
from taichi_bearings.scene import Solution

KINDS = ("spins", "power", "history", "energy", *FIGURES, *FIGURES_OF_ALL)


def draw_figure(
    kind: str, solution: Solution, sample: int = 0, time: float | None = None, slip_threshold: float | None = None
) -> Figure:
    """The figure called `kind`; InputError if there is none, or nothing for it to show.

    time : of the snapshot whose spins are drawn; slip_threshold : that the run was asked for, if it was.
    """
    if kind not in KINDS:
        raise InputError(f"the figure is {kind!r}; allowed are {', '.join(KINDS)}")
    if time is not None and kind != "spins":
        raise InputError(f"time is {time}, but {kind} does not depend on it; only spins have snapshots")
    if not 0 <= sample < solution.scene.replicas:
        raise InputError(f"replica is {sample}; the run has {solution.scene.replicas}, counted from 0")
    if kind == "spins":
        if time is not None:
            return draw_snapshot(solution, sample, time, slip_threshold)
        return draw_spins(solution.scene, solution.spin[sample], [state[sample] for state in solution.state])
    if kind == "power":
        return draw_power(solution, sample)
    if kind == "history":
        return draw_history(solution)
    return draw_energy(solution, sample) if kind == "energy" else _draw_structure(kind, solution, sample)


def _draw_structure(kind: str, solution: Solution, sample: int) -> Figure:
    """One figure of the structure of a sample, or of all samples; InputError if there is nothing to show."""
    if kind in FIGURES_OF_ALL:
        loads = [structure_of(solution, number).bottlenecks.loads for number in range(solution.scene.replicas)]
        return FIGURES_OF_ALL[kind](loads)
    figure = FIGURES[kind](structure_of(solution, sample))
    if figure is None:
        raise InputError(f"the run has nothing for {kind} to show: it holds no friction forces of the Coulomb law")
    return figure
