"""Measures run time against error: every method, and general conic solvers, on the same scenes and by the same measure.

Each method runs as far as it gets within the time limit; its checks are the points of its curve. A conic solver gives
no checks that the certificate could judge, so it runs once for each tolerance asked for. What is quick runs again, in
turns with the others; the run of the median time is reported.

* The time is wall time with the set-up of the scene and without compilation: each method first makes a step on the
  scene, which compiles its kernels, and then starts afresh. The time by which the first start was longer is its compile
  time.
* The least power lies between the best lower bound and the best power of all runs. The reference is that bound, and the
  relative width of the interval is the reference gap. So (power - reference) / power is an upper bound of the true
  error. It never falls below the reference gap; where it comes near that, the true error may as well be 0.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from taichi_bearings import runtime
from taichi_bearings.errors import InputError
from taichi_bearings.memory import free_bytes
from taichi_bearings.plots.style import DOUBLE, in_our_style, new_figure
from taichi_bearings.runs.lattice_run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS, MethodOptions
from taichi_bearings.solvers.drive import solve, uninterrupted
from taichi_bearings.solvers.stopping import UNLIMITED, StopRule

from .harness import TARGETS, Measurements, Row, in_turns
from .peers import TOLERANCES, ConicProgramme, Peer, conic_programme, find_peers

TIGHTEST = 1e-14  # gap asked of every method; rounding ends it earlier
SLACK = 1e-13  # relative rounding of a power: a bound that exceeds a power by more contradicts it
ROUND_OFF = float(np.finfo(np.float64).eps)  # the least relative error that double precision can resolve
BRIEF = 3.0  # seconds; a run that takes longer is made once only
MOST_OF_PEERS = 20_000  # for more spheres conic solvers take minutes and gigabytes, and are left out
SPARE = 0.7  # share of the free memory that may be taken
PEERS = {"clarabel": ("black", "s"), "scs": ("#8a8a8a", "X")}  # colour and marker
PEER_DASHES = ("--", ":", "-.")  # one for each linear solver
MOST_MARKERS = 12  # on a curve, so that long histories stay lines
FEWEST_JOINED = 4  # so many points or more are joined by a line
MOST_COLUMNS = 3
LEAST = 1e-17  # lower end of the grey band, below all errors in double precision


def measure(settings: RunSettings, names: Sequence[str], with_peers: bool, rounds: int) -> Measurements:
    """Yield a row for each method and conic solver on one scene, and a sentence for each method that is left out.

    settings : settings of the scene; their time limit is that of each method (of a conic solver: for each tolerance).
    names : names of the methods.
    with_peers : measure conic solvers, too.
    rounds : how often those that take less than BRIEF seconds are run; the run of the median time is reported.

    Everything runs in this process.
    """
    runtime.start("cpu", "f64", settings.threads)
    scene = build_scene(settings)
    label, sites = f"{'x'.join(map(str, settings.shape))} {settings.law}", scene.lattice.sites
    seconds, calls = settings.time_limit or np.inf, dict[str, Callable[[int], Row]]()
    # functions that run once each method, and each conic solver, that can solve the scene
    for name in names:
        options = METHODS[name]()
        reason = options.refusal(scene)
        needed = options.bytes(scene.lattice.shape, scene.lattice.periodic)
        if not reason and needed > SPARE * free_bytes():
            reason = f"it needs {needed / 1e9:.1f} GB"
        if reason:
            yield f"{label}: {name} is left out: {reason}"
        else:
            calls[name] = partial(_by_method, scene, name, options, seconds)
    if with_peers and sites <= MOST_OF_PEERS and scene.law.has_viscosity != scene.law.has_friction:
        programme = conic_programme(scene)
        for peer in find_peers()[0]:
            calls[str(peer)] = partial(_by_peer, peer, programme, seconds, settings.threads)
    if not calls:
        raise InputError(f"none of the methods asked for can solve {label}; choose others by --methods")
    about = {"shape": settings.shape, "law": settings.law, "seed": settings.seed, "threads": settings.threads}
    # everything runs once; what is quick runs again, in rounds, and the run of the median time is kept
    runs = {name: [call(0)] for name, call in calls.items()}
    brief = {name: calls[name] for name, (first,) in runs.items() if first["seconds"][-1] < BRIEF}
    for name, again in in_turns(brief, rounds - 1).items():
        runs[name] += again
    found = []
    for several in runs.values():
        several.sort(key=lambda run: run["seconds"][-1])
        found.append(about | several[len(several) // 2] | {"rounds": len(several)})
    yield from judged(found)


def _by_method(scene: Scene, name: str, options: MethodOptions, seconds: float, _: int = 0) -> Row:
    """Return the course of one run of a method with its default options: a row whose lists have one entry for each time
    that its progress was read.

    scene : what is solved.
    name : name of the method.
    options : the method with its options.
    seconds : time limit.
    _ : number of the round, not used.

    In the row `power` is what the method would return (the potential, for laws that minimise that), and `lower_bound`
    what it has proven, energy/time.
    """
    spin = initial_spin(scene, "linear")
    first = uninterrupted(solve(scene, options.build(), spin, StopRule(TIGHTEST, iterations=1)))
    solution = uninterrupted(solve(scene, options.build(), spin, StopRule(TIGHTEST, UNLIMITED, seconds)))
    finite = np.isfinite(solution.history["power"][:, 0])
    history = {key: column[finite] for key, column in solution.history.items()}
    setup, power = solution.seconds_compile, history[scene.law.minimises][:, 0]
    return {
        "method": name, "what": name, "seconds_compile": max(first.seconds_compile - setup, 0.0),
        "status": solution.status.value, "setting": ["default"] * len(power),
        "seconds": (setup + history["seconds"]).tolist(),
        "power": (power if options.is_dynamics else np.minimum.accumulate(power)).tolist(),
        "lower_bound": history["lower_bound"][:, 0].tolist(), "iterations": history["iteration"].tolist(),
    }  # fmt: skip


def _by_peer(peer: Peer, programme: ConicProgramme, seconds: float, threads: int, _: int = 0) -> Row:
    """Return what a conic solver reaches at one tolerance after another: a row whose lists have one entry for each
    tolerance, up to the first that the solver does not reach.

    peer : the other solver.
    programme : the conic programme that it is given.
    seconds : time limit for each tolerance.
    threads : number of threads.
    _ : number of the round, not used.
    """
    answers, asked = [], []
    for tolerance in TOLERANCES:
        answers.append(peer.solve(programme, tolerance, seconds, threads))
        asked.append(f"{tolerance:.0e}")
        if not answers[-1].done:
            break
    columns = {key: [getattr(one, key) for one in answers] for key in ("seconds", "power", "lower_bound", "iterations")}
    return {"method": peer.name, "what": str(peer), "status": answers[-1].status, "setting": asked} | columns


def relative(power: Sequence[float], bound: Sequence[float] | float) -> list[float]:
    """Return the relative gaps (power - bound) / power as a list with an entry for each power; none is below the
    rounding of double precision.

    power : powers, energy/time.
    bound : lower bound in the same unit: one for all powers, or one for each.
    """
    high = np.array(power)
    found: list[float] = np.maximum((high - np.array(bound)) / high, ROUND_OFF).tolist()
    return found


def judged(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of one scene with further columns that compare each of them with the best of all.

    rows : a row for each run of a method, with the lists `seconds`, `power` and `lower_bound` at its checks.

    Added are:

    * `gap`: list, proven relative distance of power and lower bound at each check;
    * `error`: list, relative distance of the power from the best lower bound of all rows; the true error is no larger;
    * `reference_gap`: relative distance of that bound from the best power of all rows;
    * `proven_gap`, `true_error`, `after`: least gap, the error there, and the seconds until then;
    * `seconds_to`: for each of TARGETS the seconds until that gap was proven, or None.
    """
    reference, found = max(max(row["lower_bound"]) for row in rows), []
    reference_gap = relative([min(min(row["power"]) for row in rows)], reference)[0]
    for row in rows:
        gap, error = relative(row["power"], row["lower_bound"]), relative(row["power"], reference)
        best = int(np.argmin(gap))
        seconds_to = {
            f"{target:.0e}": min((s for s, g in zip(row["seconds"], gap, strict=True) if g <= target), default=None)
            for target in TARGETS
        }
        at_best = {"proven_gap": gap[best], "true_error": error[best], "after": row["seconds"][best]}
        more = {"gap": gap, "error": error, "reference_gap": reference_gap, "seconds_to": seconds_to}
        found.append(row | more | at_best)
    return found


def contradictions(rows: Sequence[Row]) -> list[str]:
    """Return a sentence for each run that proves a lower bound above the power of another run of the same scene, which
    shows a bug in one of them; an empty list if there is none.

    rows : one dictionary for each run, with lists of its `power` and `lower_bound`, energy/time, at its checks.
    """
    found = []
    for of_scene in _by_scene(rows):
        least = min(of_scene, key=lambda row: min(row["power"]))
        power = min(least["power"])
        found += [
            f"{_label(least)}: {row['what']} proves {max(row['lower_bound'])!r}, {least['what']} has {power!r}"
            for row in of_scene
            if max(row["lower_bound"]) > power * (1 + SLACK)
        ]
    return found


def _label(row: Row) -> str:
    """Return the name of a row's scene: lattice and law."""
    return f"{'x'.join(map(str, row['shape']))} {row['law']}"


def _by_scene(rows: Sequence[Row]) -> Iterator[list[Row]]:
    """Yield the rows of each scene as a list."""
    for _, of_scene in groupby(rows, key=lambda row: (row["shape"], row["law"])):
        yield list(of_scene)


@in_our_style
def draw_accuracy(rows: Sequence[Row]) -> Figure:
    """Draw error (above) and proven gap (below) against wall time, both axes logarithmic: a column for each scene,
    wrapped after MOST_COLUMNS.

    rows : a row for each method and scene, as :func:`judged` returns them. Used are the name `what`, `shape` and `law`
        of the scene, the lists `seconds`, `error` and `gap`, an entry for each check, and `reference_gap`. Errors in
        the grey band, below that, may as well be 0.
    """
    scenes = list(_by_scene(rows))
    columns = min(len(scenes), MOST_COLUMNS)
    blocks = [scenes[start : start + columns] for start in range(0, len(scenes), columns)]
    figure = new_figure(DOUBLE, 3.9 * len(blocks) + 0.7)
    looks = looks_of(rows)
    least = min(1e-6, *(min(*row["error"], *row["gap"]) for row in rows)) / 3
    for part, block in zip(figure.subfigures(len(blocks), 1, squeeze=False)[:, 0], blocks, strict=True):
        axes = part.subplots(2, columns, sharex="col", sharey=True, squeeze=False)
        for (error, gap), of_scene in zip(axes.T, block, strict=False):
            error.set_title(_label(of_scene[0]))
            error.axhspan(LEAST, of_scene[0]["reference_gap"], color="0.9", lw=0)
            gap.set_xlabel("time (s)")
            for one, key in ((error, "error"), (gap, "gap")):
                one.set(xscale="log", yscale="log", ylim=(least, 1.5))
                one.grid(True, which="major", lw=0.4, color="0.85")
                one.set_axisbelow(True)
                for row in of_scene:
                    every = -(-len(row["seconds"]) // MOST_MARKERS)
                    joined = {} if len(row["seconds"]) >= FEWEST_JOINED else {"ls": ""}
                    one.plot(row["seconds"], row[key], markevery=every, **looks[row["what"]] | joined)
        for unused in axes[:, len(block) :].flat:
            unused.set_axis_off()
        axes[0, 0].set_ylabel("relative error of the power")
        axes[1, 0].set_ylabel("relative gap that is proven")
    handles: list[Line2D | Patch] = [Line2D([], [], label=what, **look) for what, look in looks.items()]
    handles.append(Patch(color="0.9", lw=0, label="least power not known better"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 1 + columns))
    return figure


def looks_of(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Return the colour, marker and dashes of each method and of each conic solver with its linear solver, as
    arguments of matplotlib's plot by name.

    rows : one dictionary for each run; `what` is the label of its curve and key of the result, `method` the name of its
        method or solver.
    """
    looks: dict[str, dict[str, Any]] = {}
    for what, method in {row["what"]: row["method"] for row in rows}.items():
        if method in PEERS:
            colour, marker = PEERS[method]
            dashes = PEER_DASHES[sum(known.startswith(f"{method} ") for known in looks)]
        else:
            colour, marker, dashes = METHODS[method].colour, METHODS[method].marker, "-"
        looks[what] = {"color": colour, "marker": marker, "ls": dashes, "ms": 3, "lw": 1.0}
    return looks
