"""The structure of all samples of an answer, in numbers and arrays, whether it lies in a file or not."""

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.files.analysis_file import Finding
from taichi_bearings.runs.structure_report import findings_of, numbers_of
from taichi_bearings.scene import Solution
from taichi_bearings.stages import alike, each
from taichi_bearings.version import VERSION
from taichi_bearings.words import meant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taichi_bearings.plots.page import Page


class Analysis:
    """What the contacts of a solved run form: minimum cut, slipless network, rigid domains, bottlenecks, forces.

    Every number of `bearings analyse --json` is an attribute, such as `spans` or `power_over_cut`: one value, or with
    several samples a list with one value each; None where there is no such number. docs/structure.md defines them all.

    power, lower_bound, power_minimum_cut : energy/time. power_over_cut : their ratio.
    cut_is_unique : bool. cut_contacts : number of contacts of the minimum cut.
    slipping, slipless, undecided, critical, tied_contacts : numbers of contacts. slipless_fraction : share of slipless
        ones.
    spans : True if slipless contacts join the driven planes. reached_fraction, spanning_fraction : shares of the free
        spheres that the slipless network touches, and that its spanning piece holds.
    shortest_path : contacts. disjoint_paths : number of paths that share no contact.
    domains : number of rigid domains. minimum_is_unique : True or False if that is proven.
    resistance : of the network of equal resistors. busiest_link_share : share of the pairs of driven spheres.
    driving_torque : from top to bottom, one number a component, force * length.
    threshold : slip speed up to which contacts count as slipless, length/time.
    structure : of the sample shown; `structure.network`, `.domains`, `.interface`, `.bottlenecks`, `.torque_flow`, ...
    arrays : for each sample everything else by name, with units: the data sets of the group /analysis of run.h5.
    """

    def __init__(
        self, solution: Solution, status: Sequence[str], threshold: float | None = None, sample: int = 0
    ) -> None:
        """status : of each sample. sample : the one that is shown. InputError for a threshold or sample that cannot be.

        threshold : slip speed up to which contacts count as slipless. Default: the contact states of the run.
        """
        samples = solution.scene.replicas
        if threshold is not None and not 0 < threshold < np.inf:
            raise InputError(f"threshold is {threshold}; it must be a positive, finite slip speed")
        if not 0 <= sample < samples:
            raise InputError(f"replica is {sample}; the run has {samples}, counted from 0")
        if not all(np.isfinite(values).all() for values in (solution.spin, solution.slip)):
            raise InputError("the spins or slips of the run are not finite; there is nothing to analyse")
        began = time.perf_counter()
        self.arrays: list[dict[str, Finding]] = []
        self._loads, numbers = [], []
        for number in each(range(samples), "analysing sample" if samples > 1 else "analysing", alike):
            structure = structure_of(solution, number, threshold)
            if number == sample:
                self.structure: Structure = structure
            numbers.append(numbers_of(structure))
            self.arrays.append(findings_of(structure))
            self._loads.append(structure.bottlenecks.loads)
        self.report: dict[str, Any] = _report(solution, status, numbers, threshold)
        self.report["seconds"] = time.perf_counter() - began

    def __getattr__(self, name: str) -> Any:
        if name in self.__dict__.get("report", {}):
            return self.report[name]
        known = self.__dict__.get("report", {})
        raise AttributeError(f"an analysis has no {name!r}; it has {', '.join(known)}{meant(name, known)}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.report]

    def __repr__(self) -> str:
        names = ("power_over_cut", "slipless_fraction", "spans", "domains") if len(self.arrays) == 1 else ()
        words = ", ".join(f"{name} = {self.report[name]}" for name in names) or f"{len(self.arrays)} samples"
        return f"<Analysis of {'x'.join(map(str, self.report['shape']))} {self.report['law']}: {words}>"

    @property
    def figures(self) -> list[str]:
        """Names of the figures that :meth:`plot` draws."""
        from taichi_bearings.runs.structure_figures import FIGURES, FIGURES_OF_ALL

        return [*FIGURES, *(FIGURES_OF_ALL if len(self.arrays) > 1 else ())]

    def plot(self, kind: str, page: "Page | None" = None) -> "Figure | None":
        """One of `figures`, as a matplotlib Figure; None if there is nothing to show. page : how it is printed."""
        from taichi_bearings.plots.page import PAGE
        from taichi_bearings.runs.structure_figures import FIGURES, FIGURES_OF_ALL

        if kind not in self.figures:
            raise InputError(
                f"the figure is {kind!r}; allowed are {', '.join(self.figures)}{meant(kind, self.figures)}"
            )
        page = page or PAGE
        return (
            FIGURES_OF_ALL[kind](self._loads, page) if kind in FIGURES_OF_ALL else FIGURES[kind](self.structure, page)
        )


def _report(
    solution: Solution, status: Sequence[str], numbers: Sequence[Mapping[str, Any]], threshold: float | None
) -> dict[str, Any]:
    """Numbers of all samples; with several of them lists, one entry a sample."""
    scene, together = solution.scene, {key: [sample[key] for sample in numbers] for key in numbers[0]}
    proven = "proven" if solution.states_proven.all() else "decided"
    return {
        **(together if len(numbers) > 1 else numbers[0]),
        "threshold": solution.slip_threshold if threshold is None else threshold,
        "states": proven if threshold is None else "threshold",
        "status": list(status) if len(numbers) > 1 else status[0],
        "method": solution.method,
        "law": str(scene.law),
        "contacts": scene.lattice.contacts,
        "spin_top": scene.imposed[1],
        "spin_bottom": scene.imposed[0],
        "shape": list(scene.lattice.shape),
        "version": VERSION,
    }
