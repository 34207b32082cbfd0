"""Measures how time and memory of a proven minimum, and of Clarabel, grow with a cubic lattice, and what bounds them.

Each lattice is solved in a process of its own, so that its memory can be measured. Our times include the proof of all
contact states. Clarabel solves to the same tolerance and proves nothing; the time in which its matrices are built is
left out. The power laws are fitted to processor times, the time of all threads, which other programs on the machine
lengthen least. A quick solve is repeated, and the median is taken, so that no compilation is measured. Larger lattices
are bounded by the factorisations of the interior point: the share of time that they take is measured, and operations
and memory of the largest one are counted.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings import runtime
from taichi_bearings.api import solve
from taichi_bearings.errors import InputError
from taichi_bearings.memory import bytes_by_linux
from taichi_bearings.numerics.cholesky.factor import Factor
from taichi_bearings.numerics.cholesky.fronts import Pattern
from taichi_bearings.plots.style import BLUE, DOUBLE, GREY, in_our_style, label_in_plain_text, new_figure
from taichi_bearings.runs.cost import refuse_too_large
from taichi_bearings.runs.lattice_run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Scene
from taichi_bearings.solvers import InteriorPoint

from .harness import Measurements, Row, Times, clocked
from .methods import relative
from .peers import conic_programme, find_peers

OF_PROCESS = "/proc/self/status"  # in which Linux reports the memory of this process
OURS, THEIRS = "this program, states proven", "clarabel, no proof"
TOLERANCE = 1e-8  # relative gap asked of both
BRIEF, ROUNDS = 10.0, 3  # a solve that takes fewer seconds of the processor is repeated so often
MOST_OF_PEERS = 40_000  # for more spheres Clarabel takes many minutes and gigabytes, and is left out
FROM = 4_000  # spheres from which on a power law is fitted: in smaller lattices calls take much of the time
FEWEST = 3  # lattices, so that a fit can be judged
COLUMNS = {"seconds_processor": "processor time", "memory": "memory"}  # of a row, and their name
BOUNDS = {
    "operations": "operations",
    "factor": "memory of the factor",
}  # columns of the largest factorisation, and their name


def measure(side: int, program: str, seed: int, threads: int) -> Measurements:
    """Yield a row for a cubic lattice of the paper, solved in this process: wall and processor time of a solve, and the
    memory that it took, GB. A sentence is yielded instead if the lattice is too large for the program.

    side : spheres along an edge.
    program : OURS or THEIRS.
    seed : seed of the sample.
    threads : number of threads.
    """
    runtime.start("cpu", "f64", threads)
    shape = (side, side, side)
    scene = build_scene(RunSettings(shape=shape, seed=seed, threads=threads))
    if program == THEIRS:
        if prod(shape) > MOST_OF_PEERS:
            yield f"{program}: lattices of more than {MOST_OF_PEERS} spheres are left out"
            return
        once = _solver_by_clarabel(scene, threads)
    else:
        refuse_too_large(InteriorPoint, scene)
        once = partial(_solved_by_us, scene, threads)
    answers = list[Row]()
    before, call = bytes_by_linux(OF_PROCESS, "VmRSS"), lambda _: answers.append(once())
    with watched() as factorising:
        found = [clocked(call)]
        if found[0][1] < BRIEF:  # the first one has compiled
            factorising.seconds = 0.0
            found = [clocked(call) for _ in range(ROUNDS)]
    times = Times(*np.array(found).T)
    yield {
        "what": program, "shape": shape, "spheres": prod(shape), "threads": threads, **times.row,
        "memory": (bytes_by_linux(OF_PROCESS, "VmHWM") - before) / 1e9, **answers[-1],
        **factorising.row(sum(seconds for _, seconds in found)),
    }  # fmt: skip


@dataclass
class Factorising:
    """The factorisations of a process.

    seconds : processor time that they have taken.
    operations, entries : operations of the largest one, and entries of its factor; 0 before the first.
    """

    seconds: float = 0.0
    operations: float = 0.0
    entries: int = 0

    def row(self, seconds: float) -> Row:
        """Return columns of a row: the share of processor time that factorisations take, and the operations and the
        memory, GB, of the largest one; none if there was no factorisation.

        seconds : processor time in all.
        """
        if not self.operations:
            return {}
        return {"factorising": self.seconds / seconds, "operations": self.operations, "factor": 8e-9 * self.entries}


@contextmanager
def watched() -> Iterator[Factorising]:
    """Yield an object that counts and times the factorisations of this program, in this process, until the block
    ends: the methods `__init__` and `factorise` of all kinds of Factor are replaced meanwhile.
    """
    found, kinds = Factorising(), Factor.__subclasses__()
    before = [(kind, kind.__init__, kind.factorise) for kind in kinds]

    def counting(begin: Callable[..., None]) -> Callable[..., None]:
        """Return a replacement of the `__init__` of a Factor (`begin`) that also notes the largest factor."""

        def begun(factor: Factor, pattern: Any, *others: Any) -> None:
            """Prepare a factor of a matrix with this pattern; the other arguments are those of `begin`."""
            if isinstance(pattern, Pattern) and pattern.operations > found.operations:
                found.operations, found.entries = pattern.operations, pattern.factor_entries
            begin(factor, pattern, *others)

        return begun

    def timing(factorise: Callable[[Any], np.ndarray]) -> Callable[[Any], np.ndarray]:
        """Return a replacement of the `factorise` of a Factor that also measures its processor time."""

        def factorised(factor: Factor) -> np.ndarray:
            """Factorise, and return a mask (matrices,): True where that succeeds."""
            began = time.process_time()
            succeeded = factorise(factor)
            found.seconds += time.process_time() - began
            return succeeded

        return factorised

    for kind, begin, factorise in before:
        setattr(kind, "__init__", counting(begin))  # noqa: B010
        setattr(kind, "factorise", timing(factorise))  # noqa: B010
    try:
        yield found
    finally:
        for kind, begin, factorise in before:
            setattr(kind, "__init__", begin)  # noqa: B010
            setattr(kind, "factorise", factorise)  # noqa: B010


def _solved_by_us(scene: Scene, threads: int) -> Row:
    """Solve a scene by this program, and return the relative gap that is proven (`proven_gap`) and the share of
    contacts whose state is proven (`proven`).

    scene : what is solved.
    threads : number of threads.
    """
    result = solve(scene, "interior-point", TOLERANCE, progress=False, threads=threads)
    return {"proven_gap": float(result.gap), "proven": 1 - float(result.unproven) / scene.lattice.contacts}


def _solver_by_clarabel(scene: Scene, threads: int) -> Callable[[], Row]:
    """Return a function that solves a scene by Clarabel and returns the relative gap that is proven of the answer. Of
    Clarabel's linear solvers it uses faer, the quickest for many unknowns, if that is installed. Raises InputError if
    Clarabel is not installed.

    scene : what is solved.
    threads : number of threads.
    """
    here = {peer.linear_solver: peer for peer in find_peers()[0] if peer.name == "clarabel"}
    if not here:
        raise InputError("clarabel is not installed; pip install clarabel")
    peer, programme = here.get("faer") or next(iter(here.values())), conic_programme(scene)

    def call() -> Row:
        """Solve, and return the proven relative gap."""
        answer = peer.solve(programme, TOLERANCE, np.inf, threads)
        return {"proven_gap": relative([answer.power], answer.lower_bound)[0]}

    return call


class PowerLaw(NamedTuple):
    """A power law fitted to points (x, y) by least squares of log y against log x.

    exponent : exponent of x.
    error : standard error of the exponent.
    factor : y = factor x^exponent.
    """

    exponent: float
    error: float
    factor: float


def fitted(x: Sequence[float], y: Sequence[float]) -> PowerLaw:
    """Return the power law through three or more points, fitted by least squares in the logarithms.

    x, y : (points,), coordinates, all positive.
    """
    (slope, start), covariance = np.polyfit(np.log(x), np.log(y), 1, cov="unscaled")
    residual = np.log(y) - start - slope * np.log(x)
    variance = (residual**2).sum() / (len(x) - 2)  # of a point, from the scatter around the line
    return PowerLaw(slope, float(np.sqrt(covariance[0, 0] * variance)), float(np.exp(start)))


def fits(rows: Sequence[Row]) -> dict[tuple[str, str], PowerLaw]:
    """Return the power laws in the number of spheres N, by program and column of COLUMNS or BOUNDS.

    rows : measurements, dictionaries with the keys `what` (the program), `spheres`, processor time and memory (keys of
        COLUMNS), and, if they are known, operations and memory of a factorisation (keys of BOUNDS).

    Only lattices of FROM spheres or more count; with fewer than FEWEST of them there is no fit.
    """
    found = {}
    for what in dict.fromkeys(row["what"] for row in rows):
        large = [row for row in rows if row["what"] == what and row["spheres"] >= FROM]
        for key in [*COLUMNS, *BOUNDS] if len(large) >= FEWEST else ():
            if all(key in row for row in large):
                found[what, key] = fitted([row["spheres"] for row in large], [row[key] for row in large])
    return found


def words(rows: Sequence[Row]) -> list[str]:
    """Return one sentence for each power law that `fits` finds, with its exponent and standard error, and one on what
    bounds time and memory of the largest lattice.

    rows : measurements, each with the program (`what`), the number of `spheres`, processor time and memory (the keys of
        COLUMNS).
    """
    found = fits(rows)
    said = [
        f"{what}: from {FROM} spheres on {COLUMNS[key]} grows as N^{law.exponent:.2f}, with N the number of spheres"
        f" (standard error {law.error:.2f})"
        for (what, key), law in found.items()
        if key in COLUMNS
    ]
    counted = [row for row in rows if "factorising" in row]
    if counted:
        last = max(counted, key=lambda row: row["spheres"])
        laws = [
            f"{name} as N^{found[last['what'], key].exponent:.2f}"
            for key, name in BOUNDS.items()
            if (last["what"], key) in found
        ]
        said.append(
            f"{last['what']}: with {last['spheres']} spheres factorisations take {last['factorising']:.0%} of the "
            f"processor time, and the factor {last['factor']:.2g} of {last['memory']:.2g} GB"
            + (f"; they bound larger lattices, as they grow fastest: {', '.join(laws)}" if laws else "")
        )
    return said


@in_our_style
def draw_growth(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw processor time (left) and memory (right) of a minimum against the number of spheres, both axes logarithmic.
    Each program has a colour, dots for what was measured, and a line for the power law fitted to it.

    rows : measurements, each with the program (`what`), the number of `spheres`, processor time and memory (the keys of
        COLUMNS).
    """
    figure = new_figure(DOUBLE, 0.42 * DOUBLE)
    laws, looks = fits([dict(row) for row in rows]), {OURS: (BLUE, "o"), THEIRS: (GREY, "s")}
    for axes, key, label in zip(
        figure.subplots(1, 2),
        COLUMNS,
        ("processor time of a solve (s)", "memory taken by a solve (GB)"),
        strict=True,
    ):
        for what, (colour, marker) in looks.items():
            of = [row for row in rows if row["what"] == what]
            if not of:
                continue
            x, y = np.array([(row["spheres"], row[key]) for row in of]).T
            law = laws.get((what, key))
            fit = "" if law is None else rf": $\propto N^{{{law.exponent:.2f}}}$"
            axes.plot(x, y, marker, color=colour, ms=4, label=f"{what}{fit}")
            if law is not None:
                ends = np.array([x[x >= FROM].min(), x.max()])
                axes.plot(ends, law.factor * ends**law.exponent, color=colour, lw=1.0)
        axes.set(xscale="log", yscale="log", xlabel="spheres $N$", ylabel=label)
        label_in_plain_text(axes.xaxis, axes.yaxis)
        axes.legend()
    return figure
