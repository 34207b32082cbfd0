"""The structure of all samples of an answer, in numbers and arrays, whether it lies in a file (`bearings analyse`) or
not."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.files.analysis_file import Finding, write_analysis
from taichi_bearings.files.whole_file import refuse_standing
from taichi_bearings.quantities import SAMPLES, Answered
from taichi_bearings.runs.packing_run import analysed
from taichi_bearings.runs.run_directory import writable_folder
from taichi_bearings.runs.run_file import file_of, read_run
from taichi_bearings.runs.structure_report import findings_of, numbers_of
from taichi_bearings.scene import Solution
from taichi_bearings.stages import alike, each, stage
from taichi_bearings.words import html_table, meant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taichi_bearings.plots.page import Page


TOLD_OF_ANSWER = ("method", "law", "contacts", "spin_top", "spin_bottom", "shape", "version")


class Analysis:
    """What the contacts of a solved run form: minimum cut, slipless network, rigid domains, bottlenecks, forces.

    Every number of `bearings analyse --json` is an attribute, such as `spans` or `power_over_cut`: one value, or with
    several samples a list with one value each; None where there is no such number. `taichi_bearings.quantities` has
    them in its table STRUCTURE, and docs/structure.md defines them all.

    structure : of the sample shown: `structure.network`, `.rigid_domains`, `.interface`, `.bottlenecks` and others.
    arrays : for each sample everything else by name, with units: the data sets of the group /analysis of run.h5.
    report : all numbers by name.
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
        numbers = []
        for number in each(range(samples), "analysing sample" if samples > 1 else "analysing", alike):
            structure = structure_of(solution, number, threshold)
            if number == sample:
                self.structure: Structure = structure
            numbers.append(numbers_of(structure) | {"status": status[number]})
            self.arrays.append(findings_of(structure))
        proven = "proven" if solution.states_proven.all() else "decided"
        together = {key: [one[key] for one in numbers] for key in numbers[0]} if samples > 1 else numbers[0]
        answered = Answered(solution, 0.0, None)
        self.report: dict[str, Any] = {
            **together,
            "threshold": solution.slip_threshold if threshold is None else threshold,
            "states": proven if threshold is None else "threshold",
            **{name: SAMPLES[name].of(answered) for name in TOLD_OF_ANSWER},
            **{name: list(value) for name in ("periodic", "top", "bottom") if (value := getattr(solution.scene, name))},
            "seconds": time.perf_counter() - began,
        }

    def __getattr__(self, name: str) -> Any:
        known = self.__dict__.get("report", {})
        if name in known:
            return known[name]
        raise AttributeError(f"an analysis has no {name!r}; it has {', '.join(known)}{meant(name, known)}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.report]

    def __repr__(self) -> str:
        names = ("power_over_cut", "slipless_fraction", "spans", "domains") if len(self.arrays) == 1 else ()
        words = ", ".join(f"{name} = {self.report[name]}" for name in names) or f"{len(self.arrays)} samples"
        return f"<Analysis of {'x'.join(map(str, self.report['shape']))} {self.report['law']}: {words}>"

    def _repr_html_(self) -> str:
        """For notebooks: the numbers of a sample, or some of each of several."""
        if len(self.arrays) == 1:
            return html_table(repr(self), self.report.items())
        names = ("seed", "power", "power_over_cut", "slipless_fraction", "spans", "domains")
        return html_table(repr(self), zip(*(self.report[name] for name in names), strict=True), names)

    @property
    def figures(self) -> list[str]:
        """Names of the figures that :meth:`plot` draws."""
        from taichi_bearings.runs.figures import FIGURES

        return [*FIGURES]

    def plot(self, kind: str, page: "Page | None" = None) -> "Figure":
        """One of `figures`, as a matplotlib Figure. page : how it is printed."""
        from taichi_bearings.plots.page import PAGE
        from taichi_bearings.runs.figures import FIGURES

        if kind not in self.figures:
            raise InputError(
                f"the figure is {kind!r}; allowed are {', '.join(self.figures)}{meant(kind, self.figures)}"
            )
        return FIGURES[kind](self.structure, page or PAGE)


def analyse(
    path: Path,
    out: Path | None = None,
    force: bool = False,
    replica: int = 0,
    threshold: float | None = None,
    figures: bool = True,
    title: bool = True,
) -> dict[str, Any]:
    """Analyse every sample of a stored run, write /analysis and the figures, and return the report.

    path : a run directory or its run.h5. out : folder for analysis.h5 and the figures; default: into the run itself,
    where an earlier analysis is replaced. replica : the sample that is drawn alone. threshold : as of
    :class:`Analysis`. title : whether words stand above the figures.
    Raises InputError or FileError before anything is computed.
    """
    from taichi_bearings.plots.page import Page
    from taichi_bearings.plots.style import save
    from taichi_bearings.runs.figures import FIGURES

    with stage("reading"):
        run = read_run(path)
    target = file_of(path) if out is None else out / "analysis.h5"
    pictures = [target.parent / f"{name}.png" for name in (("network",) if run.is_packing else FIGURES)]
    refuse_standing((target, *(pictures if figures else ())), force or out is None)
    with writable_folder(target.parent):
        if run.is_packing:
            report, arrays, draw = analysed(run, threshold, replica)
        else:
            found = Analysis(run.solution, [status.value for status in run.status], threshold, replica)
            report, arrays, draw = found.report, found.arrays, found.plot
        for picture in pictures if out is None or force else ():  # of an earlier analysis
            picture.unlink(missing_ok=True)
        with stage("writing"):
            write_analysis(target, arrays, report, into_run=out is None)
        for picture in each(pictures if figures else [], "drawing figure"):
            save(draw(picture.stem, page=Page(title=title)), picture)
    return report | {"run": str(path), "files": [str(target), *(map(str, pictures) if figures else ())]}
