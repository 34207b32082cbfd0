"""The structure of a run: `bearings analyse`."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.files.analysis_file import Finding, write_analysis
from taichi_bearings.files.whole_file import refuse_standing
from taichi_bearings.plots.style import save
from taichi_bearings.runs.run import Run, settings_of
from taichi_bearings.runs.run_directory import writable_folder
from taichi_bearings.runs.run_file import read_run_file
from taichi_bearings.runs.structure_figures import FIGURES, FIGURES_OF_ALL
from taichi_bearings.runs.structure_report import findings_of, numbers_of
from taichi_bearings.scene import Solution
from taichi_bearings.stages import alike, each, stage
from taichi_bearings.version import VERSION


class Analysis:
    """What the contacts of a solved run form: minimum cut, slipless network, rigid domains, bottlenecks, forces.

    Every number of `bearings analyse --json` is an attribute, such as `spans` or `power_over_cut`: one value, or with
    several samples a list with one value each; None where there is no such number. docs/structure.md defines them all.

    power, lower_bound, power_minimum_cut : energy/time. power_over_cut : their ratio.
    cut_is_unique : bool. cut_contacts : number of contacts of the minimum cut.
    slipping, slipless, undecided : numbers of contacts. slipless_fraction : share of slipless ones.
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
        if not all(np.isfinite(values).all() for values in (solution.spin, *solution.slip)):
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
        raise AttributeError(f"an analysis has no {name!r}; it has {', '.join(self.__dict__.get('report', {}))}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.report]

    def __repr__(self) -> str:
        names = ("power_over_cut", "slipless_fraction", "spans", "domains") if len(self.arrays) == 1 else ()
        words = ", ".join(f"{name} = {self.report[name]}" for name in names) or f"{len(self.arrays)} samples"
        return f"<Analysis of {'x'.join(map(str, self.report['shape']))} {self.report['law']}: {words}>"

    @property
    def figures(self) -> list[str]:
        """Names of the figures that :meth:`plot` draws."""
        return [*FIGURES, *(FIGURES_OF_ALL if len(self.arrays) > 1 else ())]

    def plot(self, kind: str) -> Figure | None:
        """One of `figures`, as a matplotlib Figure; None if there is nothing to show."""
        return FIGURES_OF_ALL[kind](self._loads) if kind in FIGURES_OF_ALL else FIGURES[kind](self.structure)


def draw(kind: str, solution: Solution, sample: int) -> Figure:
    """One figure of the structure of a sample, or of all samples; InputError if there is nothing to show."""
    if kind in FIGURES_OF_ALL:
        loads = [structure_of(solution, number).bottlenecks.loads for number in range(solution.scene.replicas)]
        return FIGURES_OF_ALL[kind](loads)
    figure = FIGURES[kind](structure_of(solution, sample))
    if figure is None:
        raise InputError(f"the run has nothing for {kind} to show: it holds no friction forces of the Coulomb law")
    return figure


def analyse(
    path: Path,
    out: Path | None = None,
    force: bool = False,
    replica: int = 0,
    threshold: float | None = None,
    figures: bool = True,
) -> dict[str, Any]:
    """Analyse every sample of a stored run, write /analysis and the figures, and return the report.

    path : a run directory or its run.h5. out : folder for analysis.h5 and the figures; default: into the run itself,
    where an earlier analysis is replaced. replica : the sample that is drawn alone. threshold : as of
    :class:`Analysis`.
    Raises InputError or FileError before anything is computed.
    """
    with stage("reading"):
        run = read_run_file(path)
        ended = Run(settings_of(run), run.solution).status
    target = run.path if out is None else out / "analysis.h5"
    paths = [target.parent / f"{name}.png" for name in ((*FIGURES, *FIGURES_OF_ALL) if figures else ())]
    refuse_standing((target, *paths), force or out is None)
    with writable_folder(target.parent):
        found = Analysis(run.solution, [status.value for status in ended], threshold, replica)
        if out is None or force:
            for name in (*FIGURES, *FIGURES_OF_ALL):  # of an earlier analysis; not all need come back
                (target.parent / f"{name}.png").unlink(missing_ok=True)
        with stage("writing"):
            write_analysis(target, found.arrays, _flat(found.report), into_run=out is None)
        files = [target]
        for name in each(found.figures if figures else [], "drawing figure"):
            figure = found.plot(name)
            if figure is not None:
                files.append(target.parent / f"{name}.png")
                save(figure, files[-1])
    return found.report | {"run": str(path), "files": [str(file) for file in files]}


def _report(
    solution: Solution, status: Sequence[str], numbers: Sequence[Mapping[str, Any]], threshold: float | None
) -> dict[str, Any]:
    """Numbers of all samples; with several of them lists, one entry a sample."""
    scene, together = solution.scene, {key: [sample[key] for sample in numbers] for key in numbers[0]}
    proven = "proven" if solution.resolved.all() else "decided"
    return {
        **(together if len(numbers) > 1 else numbers[0]),
        "threshold": solution.slip_threshold if threshold is None else threshold,
        "states": proven if threshold is None else "threshold",
        "status": list(status) if len(numbers) > 1 else status[0],
        "method": solution.method,
        "law": str(scene.law),
        "contacts": scene.lattice.contacts,
        "spin_top": scene.spin_top,
        "spin_bottom": scene.spin_bottom,
        "shape": list(scene.lattice.shape),
        "version": VERSION,
    }


def _flat(report: Mapping[str, Any]) -> dict[str, Any]:
    """What HDF5 can hold as attributes: numbers, texts, and lists of numbers."""
    return {key: value for key, value in report.items() if not isinstance(value, dict) and not _is_nested(value)}


def _is_nested(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(item, (dict, list)) for item in value)
