"""Draws one column of a scan against another, with error bars, as figure and table: `bearings plot scan`."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.analysis.statistics import (
    LEAST_SAMPLES,
    Census,
    groups,
    independent,
    mean_interval,
    ratio_interval,
)
from taichi_bearings.errors import BearingsError, InputError
from taichi_bearings.files.scan_file import StoredScan
from taichi_bearings.files.whole_file import refuse_ending, refuse_standing, write_csv
from taichi_bearings.plain_files import Json
from taichi_bearings.plots.curves import Curve, Look, draw_scan
from taichi_bearings.plots.page import PAGE, Page
from taichi_bearings.plots.style import ENDINGS, column_label, save
from taichi_bearings.quantities import STRUCTURE
from taichi_bearings.runs.run_directory import claimed
from taichi_bearings.runs.settings import parse_toml, settings_table
from taichi_bearings.scans.conditions import meeting, named
from taichi_bearings.scans.plan import written
from taichi_bearings.scans.stored_scans import (
    CENSUS_COLUMNS,
    OF_A_SPANNING_NETWORK,
    disorder_of,
    numbered,
    open_scan,
)
from taichi_bearings.words import meant

SIZE = "L"  # name of the height of the lattice as a column
REASON = "left out"  # column with the reason why a sample is in no point; empty for samples that are in one
MOST_CURVES = 24
NAMED_BY_VALUE = ("shape", "law", "distribution")  # settings whose values need no name in a title
DRAWN_COLUMNS = ("plot_x", "plot_y", "plot_low", "plot_high")
Point = Json
"""All samples of equal parameters: a point of the figure, and a row of its table.

x : value of the parameter.
number : number of samples with different coefficients.
mean and standard_error, or ratio : statistics of y.
low, high : ends of the 95 % confidence interval of mean or ratio.
plot_x, plot_y, plot_low, plot_high : x, y and the ends of the bar as drawn; not-a-number where no sample is left.
used, asked, left_out : numbers of samples in the point and of those that the scan asks for at it, and why others are
    left out, in words.
"""
Points = dict[tuple[Any, ...], list[Point]]  # points of each curve, by the values of the columns that tell curves apart


@dataclass(frozen=True)
class Request:
    """What a figure of a scan shows.

    y : name of a column, or A/B for the mean of column A over the mean of column B.
    x : name of a column.
    by : names of columns; each combination of their values is a curve.
    where : conditions KEY=VALUE that samples must meet.
    log : which axes are logarithmic: "", "x", "y" or "xy".

    The column L, where the scan has none of that name, is the height of the lattice: the last number of its shape.
    """

    y: str
    x: str
    by: tuple[str, ...] = ()
    where: tuple[str, ...] = ()
    log: str = ""

    @property
    def stem(self) -> str:
        """Name of the files, without ending."""
        return "_".join([self.y.replace("/", "_over_"), "against", self.x, *(f"by_{key}" for key in self.by)])


def plot_scan(
    path: Path,
    request: Request,
    out: Path | None = None,
    force: bool = False,
    tell: Callable[[str], None] = lambda _: None,
    page: Page = PAGE,
) -> list[Path]:
    """Draw a figure of a scan, write its numbers as CSV into the same folder, and return both paths.

    path : folder of the scan.
    request : what is drawn: the quantities on both axes, one curve for each value of which setting, conditions.
    out : PNG, PDF or SVG; None for a PDF in the folder of the scan, where an earlier one is replaced.
    force : True to replace a file `out`.
    tell : function that is called with sentences: how many samples are in the figure and how many are left out, and
        the same for each curve that lacks some.
    page : how the figure is printed.

    Raises InputError or FileError before anything is written.
    """
    scan = open_scan(path)
    figure = out or scan.path.parent / f"{request.stem}.pdf"
    refuse_ending(figure, *ENDINGS)
    table = figure.with_suffix(".csv")
    with claimed(figure, force or out is None):
        refuse_standing([table], force or out is None)
        columns = columns_of(scan, request)
        points, reasons = points_of(columns, request), columns[REASON]
        tell(str(Census.of(reasons.tolist())))
        for part, rows in groups(columns, request.by).items() if request.by else ():  # curve by curve
            if (census := Census.of(reasons[rows].tolist())).left_out:
                words = ", ".join(f"{key} {named(key, value)}" for key, value in zip(request.by, part, strict=True))
                tell(f"  {words}: {census}")
        save(draw_scan(curves_of(points, request), look_of(scan, columns, points, request), page), figure)
        write_csv(table, *rows_of(points, request))
    return [figure, table]


def columns_of(scan: StoredScan, request: Request) -> dict[str, np.ndarray]:
    """Return the table of all samples that meet the conditions of a request, with or without a result, by column.

    scan : a stored scan.
    request : what is drawn: names of columns, and conditions.

    Two columns are added: L, the height of the lattice, and REASON, why a sample is in no point of the figure ("" if it
    is). Raises InputError for a column that the scan lacks, and for a condition that no sample meets.
    """
    table = dict(scan.table)
    if SIZE not in table and "shape" in table:
        heights = [int(text.split("x")[-1]) if text else math.nan for text in table["shape"].tolist()]
        table[SIZE] = np.array(heights)
    for name in (*request.y.split("/"), request.x, *request.by):
        if name not in table:
            if name in STRUCTURE:
                raise InputError(
                    f"{scan.path} has no column {name!r}: it is a number of `bearings analyse`; "
                    f"`bearings scan {scan.path.parent} --analyse` adds it, and solves each sample anew for that"
                )
            raise InputError(f"{scan.path} has no column {name!r}; it has {', '.join(table)}{meant(name, table)}")
    chosen = meeting(request.where, table)
    return {name: values[chosen] for name, values in (table | {REASON: _reasons(scan, table, request)}).items()}


def points_of(columns: Mapping[str, np.ndarray], request: Request) -> Points:
    """Return the points of each curve of a figure: a dictionary by the curve's values of the columns `request.by`. A
    point is itself a dictionary, of a value x, the statistics of y over the samples with this x, and numbers of samples
    (see `Point`). Raises InputError if no sample has both x and y.

    columns : table of the samples, with the column REASON: why a sample is in no point, "" if it is in one.
    request : what is drawn: the columns x and y, and those whose values tell curves apart.
    """
    names, terms = request.y.split("/"), list[np.ndarray]()
    for name in names:
        if columns[name].dtype == object:
            raise InputError(f"--y is {name!r}, a column of texts; choose a column of numbers")
        terms.append(columns[name].astype(float))
    if len(terms) > 2:
        raise InputError(f"y is {request.y!r}; it must be a column, or one over another as in power/power_minimum_cut")
    # Samples without x or y are in no point; samples of one disorder count as one.
    reasons, disorder = columns[REASON], numbered(disorder_of(columns))
    if (reasons != "").all():
        raise InputError(f"no sample has both {request.y} and {request.x}: {Census.of(reasons.tolist()).reasons}")
    known = (value for (value,) in groups(columns, [request.x]) if value not in (None, ""))
    place = {value: float(n) for n, value in enumerate(known)}  # where texts are drawn along x: 0, 1, ...
    points: Points = {}
    for (*part, x), rows in groups(columns, [*request.by, request.x]).items():
        if x not in place:
            continue
        used, census = rows[reasons[rows] == ""], Census.of(reasons[rows].tolist())
        values = [independent(term[used], disorder[used]) for term in terms]
        at = float(x) if isinstance(x, (int, float)) else place[x]
        point: Point = {"x": x, "number": len(values[0]), **_statistics(values, at)}
        point |= zip(CENSUS_COLUMNS, (census.used, census.asked, census.reasons), strict=True)
        points.setdefault(tuple(part), []).append(point)
    # Logarithmic axes need positive numbers.
    every = list(itertools.chain(*points.values()))
    if "x" in request.log and any(isinstance(point["x"], str) for point in every):
        raise InputError(f"log is {request.log!r}, but the column {request.x} holds texts; for sizes use the column L")
    for name in request.log:
        least = min(point[f"plot_{name}"] for point in every if point["number"])
        if least <= 0:
            raise InputError(
                f"log is {request.log!r}, but the least {name} is {least:g}; a logarithmic axis needs numbers above 0"
            )
    return points


def _reasons(scan: StoredScan, table: Mapping[str, np.ndarray], request: Request) -> np.ndarray:
    """Return for each sample why it is in no point of the figure, (samples,), in words that can follow a number, such
    as "failed"; "" for samples that are in a point.

    scan : a stored scan.
    table : samples of the scan, by column.
    request : what is drawn.
    """
    reasons = np.full(scan.samples, "", dtype=object)
    for name in (request.x, *request.y.split("/")):
        values = table[name]
        lacking = values == "" if values.dtype == object else ~np.isfinite(values.astype(float))
        reasons[lacking] = f"without {name}"
        if name in OF_A_SPANNING_NETWORK and "spans" in table:
            reasons[lacking & (table["spans"] == 0)] = "that do not span"
    return np.where(scan.reasons == "", reasons, scan.reasons)


def _statistics(terms: Sequence[np.ndarray], x: float) -> Point:
    """Return by name the statistics of one point of a curve, and what is drawn of it: x, y and both ends of the error
    bar, which are not-a-number for fewer than LEAST_SAMPLES samples.

    terms : one array (samples,), of which the mean and its standard error are drawn; or two, of which the ratio of the
        means and its 95 % confidence interval are drawn.
    x : value on the x axis.
    """
    values, number = terms[0], len(terms[0])
    if len(terms) == 2:
        found = ratio_interval(values, terms[1])
        statistics, bar = {"ratio": found.value}, (found.low, found.high)
    else:
        found = mean_interval(values)
        error = float(values.std(ddof=1) / np.sqrt(number)) if number > 1 else np.nan
        statistics = {"mean": found.value, "standard_error": error}
        bar = (found.value - error, found.value + error)
    drawn = (x, found.value, *(bar if number >= LEAST_SAMPLES else (math.nan, math.nan)))
    return statistics | {"low": found.low, "high": found.high} | dict(zip(DRAWN_COLUMNS, drawn, strict=True))


def curves_of(points: Points, request: Request) -> list[Curve]:
    """Return the curves to be drawn, one for each combination of values of the columns `request.by`. Raises InputError
    for more than MOST_CURVES.

    points : by such combinations the points of the curve (see `Point`), with x, y and ends of error bars.
    request : what is drawn; only `by` is used.
    """
    if len(points) > MOST_CURVES:
        raise InputError(
            f"--by {', '.join(request.by)} makes {len(points)} curves; a figure can have at most {MOST_CURVES}, so "
            "choose samples by --where"
        )
    curves = []
    for part, of_curve in points.items():
        drawn = np.array([[p[name] for name in DRAWN_COLUMNS] for p in of_curve if p["number"]]).reshape(-1, 4)
        asked = sum(point["asked"] for point in of_curve)
        label = ", ".join(map(named, request.by, part))
        curves.append(Curve(label + f": none of {asked:,} samples" * (not len(drawn)), *drawn.T))
    return curves


def look_of(scan: StoredScan, columns: Mapping[str, np.ndarray], points: Points, request: Request) -> Look:
    """Return labels, legend and title of the figure. The title says over which settings the samples are averaged, and
    which settings all of them share.

    scan : where the samples come from.
    columns : table of the samples.
    points : what is drawn, by curve.
    request : which columns are shown.
    """
    # settings over which samples are averaged: those that vary and are neither on the x axis nor tell curves apart
    used = {request.x, *request.by, *(condition.partition("=")[0] for condition in request.where)}
    used |= {"shape"} if SIZE in used else set()
    over = [key for key in scan.scanned if key in columns and key not in used and len(groups(columns, [key])) > 1]
    census = Census.of(columns[REASON].tolist())
    every = sorted(itertools.chain(*points.values()), key=lambda point: point["plot_x"])
    number = sum(point["number"] for point in every)
    independents = f", {number:,} independent" if number < census.used else ""
    left_out = f"\nleft out: {census.reasons}" if census.left_out else ""
    shared = ", ".join(shared_by_all(scan, columns, request))
    bars = "ratios of means with 95 % intervals" if "/" in request.y else "means with standard errors"
    numbers = all(isinstance(point["x"], (int, float)) for point in every)
    return Look(
        x_label=column_label(request.x),
        y_label=column_label(request.y),
        title=f"{census.share}{independents}{' over ' + ', '.join(over) if over else ''}: {bars}{left_out}"
        + f"\n{shared}" * bool(shared),
        legend=", ".join(request.by),
        log=request.log,
        ticks=() if numbers else list(dict.fromkeys(named(request.x, point["x"]) for point in every)),
    )


def shared_by_all(scan: StoredScan, columns: Mapping[str, np.ndarray], request: Request) -> list[str]:
    """Return in words the settings that all samples of a figure share and that the figure does not show: size, law and
    distribution, and others that the scan or a condition of the request fixes.

    scan : where the samples come from.
    columns : table of the samples.
    request : which columns are shown.
    """
    try:
        given = {key: written(value) for key, value in parse_toml(scan.attributes["scan"]).items()}
    except BearingsError:  # the text is not TOML, as in a file that was changed
        given = {}
    table = settings_table()
    if not given.keys() & {"coefficients", "packing"} and scan.attributes["scan"]:
        given = {"distribution": table["distribution"].default} | given
    shown = {request.x, *request.by}
    found = []
    for key in dict.fromkeys([*NAMED_BY_VALUE, *scan.scanned, *given]):
        values = [value for (value,) in groups(columns, [key])] if key in columns else [given.get(key)]
        matters = key in table and (key == "method" or not table[key].of_solving)
        if matters and key not in shown and len(values) == 1 and values[0] not in (None, ""):
            name = "" if key in NAMED_BY_VALUE else f"{key.replace('_', ' ')} "
            words = named(key, values[0])
            found.append(name + (words.replace("coulomb", "Coulomb") if key == "law" else words))
    return found


def rows_of(points: Points, request: Request) -> tuple[list[str], list[list[Any]]]:
    """Return the table that is written with the figure: the names of its columns, and a row for each point. A row
    begins with the values of the columns `request.by`, which name the curve; then come x and all numbers of the point.

    points : the points of each curve, by these values.
    request : what is drawn.
    """
    rows = [[*part, *point.values()] for part, of_curve in points.items() for point in of_curve]
    _, *numbers = next(iter(points.values()))[0]  # names of what a point has after x
    cells = [["" if isinstance(v, float) and math.isnan(v) else v for v in row] for row in rows]
    return [*request.by, request.x, *numbers], cells
