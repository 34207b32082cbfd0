"""The structure of all samples of an answer, in numbers and arrays: what `bearings analyse` prints and writes.

The structure of a sample is what its contacts form: its slipless network, rigid domains, minimum cut and bottlenecks.
"""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.files.whole_file import Finding, put, put_attributes, refuse_standing, replace_group, write_hdf5
from taichi_bearings.options import OneOf
from taichi_bearings.plain_files import Json
from taichi_bearings.runs.result import Result, together
from taichi_bearings.runs.run_directory import writable_folder
from taichi_bearings.runs.run_file import file_of, read_run
from taichi_bearings.runs.stored_structure import GROUP
from taichi_bearings.runs.structure_report import findings_of
from taichi_bearings.stages import alike, each, stage
from taichi_bearings.words import html_table, meant, sized

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taichi_bearings.plots.page import Page


FILL = {"b": 0, "i": -1, "u": 255, "f": np.nan}
"""Numbers that fill up shorter arrays where samples are stacked, by NumPy's letter for the kind of number."""
REPEATED_OF_RUN = (
    "status",
    "method",
    "law",
    "shape",
    "spheres",
    "contacts",
    "seed",
    "spin_top",
    "spin_bottom",
    "version",
)
"""Numbers and words of the run that the report of an analysis repeats."""


class Analysis:
    """What the contacts of an answer form: minimum cut, slipless network, rigid domains, bottlenecks, forces.

    An analysis adds rows to the numbers of a `Result`. Each is an attribute, such as `spans` or `power_over_cut`: one
    value, or with several samples a list with one value each; None where there is no such number. They are the table
    STRUCTURE of :mod:`taichi_bearings.quantities`, and docs/structure.md defines them all.

    Parameters
    ----------
    result : Result
        The answer.
    threshold : float, optional
        Slip speed, length/time, up to which contacts count as slipless. Default: the contact states of the answer.
    sample : int
        The one of several samples that is shown.

    Attributes
    ----------
    structure : Structure
        That of the sample shown: `structure.network`, `.rigid_domains`, `.interface`, `.bottlenecks` and others, which
        are attributes of the analysis too.
    arrays : list of dict
        For each sample all that is no number, by name, with units: the data sets of the group /analysis of run.h5.
    report : dict
        All rows by name, with some of those of the answer, as `bearings analyse --json` prints them.

    Raises
    ------
    InputError
        For a threshold or a sample that cannot be, or an answer that is not finite.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> found = tb.analyse(tb.solve(tb.Scene.random((4, 5), seed=3), threads=1))
    >>> found.spans, found.domains, round(found.power_over_cut, 9)
    (False, 2, 1.0)
    """

    def __init__(self, result: Result, threshold: float | None = None, sample: int = 0) -> None:
        """Analyse all samples of a result; the class explains the arguments."""
        began, solution, is_one = time.perf_counter(), result.solution, len(result.solution.state) == 1
        if threshold is not None and not 0 < threshold < np.inf:
            raise InputError(f"threshold is {threshold}; it must be a positive, finite slip speed")
        result.sample(sample)
        if not all(np.isfinite(values).all() for values in (solution.spin, solution.slip)):
            raise InputError("the spins or slips of the run are not finite; there is nothing to analyse")
        self.arrays: list[dict[str, Finding]] = []
        numbers = []
        for number in each(range(len(solution.state)), "analysing" if is_one else "analysing sample", alike):
            structure = structure_of(solution, number, threshold)
            if number == sample:
                self.structure = structure
            numbers.append(structure.numbers)
            self.arrays.append(findings_of(structure))
        # the threshold behind the contact states of the result, if slips are unique, and what is known of these states
        of_states = solution.slip_threshold if result.scene.driving.slips_are_unique else None
        proven = "proven" if np.all(result.numbers["states_proven"]) else "decided"
        self.report: Json = {
            **together(numbers),
            "threshold": of_states if threshold is None else threshold,
            "states": proven if threshold is None else "threshold",
            **{name: result.numbers[name] for name in REPEATED_OF_RUN if name in result.numbers},
            **({"coefficients": result.asked.coefficients} if result.asked.coefficients else {}),
            **result.asked.driving,
            "seconds": time.perf_counter() - began,
        }

    def __getattr__(self, name: str) -> Any:
        """Return a row of the report by its name, or else an attribute of the structure of the sample that is shown."""
        known = self.__dict__.get("report", {})
        if name in known:
            return known[name]
        if known and not name.startswith("_") and hasattr(self.structure, name):
            return getattr(self.structure, name)
        raise AttributeError(f"an analysis has no {name!r}; it has {', '.join(known)}{meant(name, known)}")

    def __dir__(self) -> list[str]:
        """Return the names of all attributes, with those of the rows of the report."""
        return [*super().__dir__(), *self.report]

    def __repr__(self) -> str:
        """Return one line with size, law and four numbers, or the number of samples."""
        names = ("power_over_cut", "slipless_fraction", "spans", "domains") if len(self.arrays) == 1 else ()
        words = ", ".join(f"{name} = {self.report[name]}" for name in names) or f"{len(self.arrays)} samples"
        return f"<Analysis of {sized(self.report)} {self.report['law']}: {words}>"

    def _repr_html_(self) -> str:
        """Return a table for notebooks: all numbers of a single sample, or some numbers of each of several."""
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
        """Draw a figure of the sample that is shown.

        Parameters
        ----------
        kind : str
            One of `figures`.
        page : taichi_bearings.plots.page.Page, optional
            How it is printed: width, planes and view.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        Raises
        ------
        InputError
            For another kind.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> found = tb.analyse(tb.solve(tb.Scene.random((4, 5), seed=3), threads=1))
        >>> found.figures
        ['domains', 'network']
        >>> figure = found.plot("domains")
        """
        from taichi_bearings.plots.page import PAGE
        from taichi_bearings.runs.figures import FIGURES

        return FIGURES[OneOf(table=FIGURES).named("the figure", kind)](self.structure, page or PAGE)


def analyse(
    path: Path,
    out: Path | None = None,
    force: bool = False,
    replica: int = 0,
    threshold: float | None = None,
    figures: bool = True,
    title: bool = True,
) -> Json:
    """Analyse every sample of a stored run, write the findings and figures, and return the report.

    path : a run directory or its run.h5.
    out : folder for analysis.h5 and the figures. Default: the run itself, whose group /analysis and figures are
        replaced.
    force : True to replace files that exist in `out`.
    replica : number of the sample that the figures show.
    threshold : slip speed, length/time, up to which contacts count as slipless. Default: the contact states of the run.
    figures : True to draw figures.
    title : True for words above them.

    Raises InputError or FileError before anything is computed.
    """
    from taichi_bearings.plots.page import Page
    from taichi_bearings.plots.style import save
    from taichi_bearings.runs.figures import FIGURES

    with stage("reading"):
        run = read_run(path)
    target = file_of(path) if out is None else out / "analysis.h5"
    pictures = [target.parent / f"{name}.png" for name in FIGURES]
    refuse_standing((target, *(pictures if figures else ())), force or out is None)
    with writable_folder(target.parent):
        found = Analysis(run, threshold, replica)
        for picture in pictures if out is None or force else ():  # of an earlier analysis
            picture.unlink(missing_ok=True)
        with stage("writing"):
            write_analysis(target, found.arrays, found.report, into_run=out is None)
        for picture in each(pictures if figures else [], "drawing figure"):
            save(found.plot(picture.stem, Page(title=title)), picture)
    return found.report | {"run": str(path), "files": [str(target), *(map(str, pictures) if figures else ())]}


def write_analysis(
    path: Path, samples: Sequence[Mapping[str, Finding]], attributes: Mapping[str, object], into_run: bool
) -> None:
    """Write the findings of all samples as the group /analysis of an HDF5 file.

    path : the file.
    samples : arrays of each sample, by name, with units.
    attributes : numbers and words, by name; those that are dictionaries, or lists of lists or dictionaries, are left
        out.
    into_run : True if the file is a run.h5 to which the group is added; False to write a file with the group alone.

    With several samples every array has a leading axis of samples; shorter arrays are filled up with FILL.
    """

    def fill(group: h5py.Group) -> None:
        """Write the arrays of all samples and the attributes into a group of an HDF5 file."""
        listed = {key: value if isinstance(value, list) else [value] for key, value in attributes.items()}
        nested = {key for key, parts in listed.items() if any(isinstance(part, (dict, list)) for part in parts)}
        put_attributes(group, {key: value for key, value in attributes.items() if key not in nested})
        for name, finding in samples[0].items():
            values = [sample[name].values for sample in samples]
            together = values[0]
            if len(values) > 1:
                longest = tuple(max(sizes) for sizes in zip(*(array.shape for array in values), strict=True))
                together = np.full((len(values), *longest), FILL[together.dtype.kind], dtype=together.dtype)
                for place, array in zip(together, values, strict=True):
                    place[tuple(slice(0, size) for size in array.shape)] = array
            packed = {"compression": "gzip", "shuffle": True} if together.dtype.kind in "biu" and together.size else {}
            put(group, name, together, finding.units, finding.description, **packed)

    if into_run:
        replace_group(path, GROUP, fill)
    else:
        write_hdf5(path, lambda file: fill(file.create_group(GROUP)))
