"""The figures of one run by their names, whether it lies in a file or not."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.packing_structure import PackingStructure
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.errors import InputError
from taichi_bearings.packing import Packing
from taichi_bearings.plots.curves import draw_energy, draw_history
from taichi_bearings.plots.page import PAGE, Page, check_planes
from taichi_bearings.plots.spins import draw_power, draw_spins
from taichi_bearings.plots.structure import draw_domains, draw_domains_of_packing, draw_network, draw_network_of_packing
from taichi_bearings.plots.style import describe, driving, mathematics
from taichi_bearings.proof.contact_state import ContactState, by_threshold
from taichi_bearings.runs.structure_report import structure_of_any
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.words import meant


def _draw_domains(structure: Structure | PackingStructure, page: Page) -> Figure:
    if isinstance(structure, PackingStructure):
        return draw_domains_of_packing(structure, page)
    return draw_domains(structure.rigid_domains, page)


def _draw_network(structure: Structure | PackingStructure, page: Page) -> Figure:
    if isinstance(structure, PackingStructure):
        return draw_network_of_packing(structure, page)
    return draw_network(structure.network, structure.spin, *structure.scene.imposed, page)


FIGURES: dict[str, Callable[[Any, Page], Figure]] = {"domains": _draw_domains, "network": _draw_network}
"""How each figure of the structure of a sample is drawn."""


def _draw_spins(answer: Solution, sample: int, page: Page) -> Figure:
    one = answer.sample(sample)
    return draw_spins(one.system, one.spin[0], one.state[0], page)


OF_ANSWERS: dict[str, Callable[[Any, int, Page], Figure]] = {
    "spins": _draw_spins,
    "power": lambda answer, sample, page: draw_power(answer.sample(sample), page),
    "history": lambda answer, _, page: draw_history(answer, page),
    "energy": lambda answer, sample, page: draw_energy(answer.sample(sample), page),
}
"""How each figure of an answer is drawn."""
FIGURE_KINDS = (*OF_ANSWERS, *FIGURES)
STRETCHED_SLIP = 1e-3  # of R times the imposed jump: slower contacts may only stretch their springs
WITH_PLANES = ("spins", "power", "domains")
WITH_VIEW = ("spins", "domains", "network")


def draw_figure(
    kind: str,
    solution: Solution,
    sample: int = 0,
    time: float | None = None,
    slip_threshold: float | None = None,
    page: Page = PAGE,
) -> Figure:
    """The figure called `kind`; InputError if there is none, or nothing for it to show.

    time : of the snapshot whose spins are drawn; slip_threshold : that the run was asked for, if it was.
    page : how it is printed.
    """
    if kind not in FIGURE_KINDS:
        raise InputError(f"the figure is {kind!r}; allowed are {', '.join(FIGURE_KINDS)}{meant(kind, FIGURE_KINDS)}")
    if time is not None and kind != "spins":
        raise InputError(f"time is {time}, but {kind} does not depend on it; only spins have snapshots")
    if not 0 <= sample < len(solution.state):
        raise InputError(f"replica is {sample}; the run has {len(solution.state)}, counted from 0")
    if isinstance(solution.scene, Scene):
        _check_page(kind, solution.scene.lattice.shape, page)
    elif page.planes:
        raise InputError("plane is given, but a packing has no lattice planes to cut along; --view turns it")
    if time is not None:
        return draw_snapshot(solution, sample, time, slip_threshold, page)
    if kind in FIGURES:
        return FIGURES[kind](structure_of_any(solution, sample), page)
    return OF_ANSWERS[kind](solution, sample, page)


def _check_page(kind: str, shape: tuple[int, ...], page: Page) -> None:
    """InputError for planes or a view that the figure of a lattice does not have."""
    if page.planes and kind not in WITH_PLANES:
        raise InputError(f"plane is given, but {kind} shows no planes; these do: {', '.join(WITH_PLANES)}")
    if page.view and kind not in WITH_VIEW:
        raise InputError(f"view is given, but {kind} shows nothing in 3D; these do: {', '.join(WITH_VIEW)}")
    if page.view and len(shape) == 2:
        raise InputError("view is given, but the lattice is flat; only cubic ones are turned")
    check_planes(page.planes, shape)


def draw_snapshot(
    answer: Solution,
    replica: int,
    time: float,
    slip_threshold: float | None = None,
    page: Page = PAGE,
) -> Figure:
    """The snapshot nearest to a simulated time, which the title names, and the contacts that slip in it.

    A contact slips as :func:`moment_of` says. InputError if the run has no snapshots or does not reach that time.
    """
    one = answer.sample(replica)
    at, spin = _nearest(one, time)
    moment, note = moment_of(one, spin, slip_threshold), ""
    title = f"{describe(moment.system)}, $t = {mathematics(at)}$"
    if isinstance(scene := moment.system, Scene):
        unit, symbol = driving(scene)
        title += "" if unit == 1 else rf", ${symbol}\,t = {mathematics(unit * at)}$"
        fastest = scene.lattice.radius * scene.jump
        share = rf" = {mathematics(moment.threshold / fastest, 1)}\,R\,|\Delta\omega|" if fastest else ""
        note = f"black: contacts that slip faster than ${mathematics(moment.threshold, 2)}{share}$"
    return draw_spins(moment.system, spin, moment.state, page, title, note)


def _nearest(answer: Solution, time: float) -> tuple[float, np.ndarray]:
    """Time and spins of the snapshot of one sample nearest to a time; InputError if there are none or the run does not
    reach it."""
    if answer.snapshots is None:
        raise InputError("the run holds no snapshots; run a dynamics with --snapshots")
    kept = answer.snapshots.time
    end = float(max(kept.max(), answer.history["time"][-1]))
    if not 0 <= time <= end:
        raise InputError(
            f"time is {time:g}; the run goes from 0 to {end:g}, with snapshots from {kept.min():g} to {kept.max():g}"
        )
    nearest = int(np.abs(kept - time).argmin())
    return float(kept[nearest]), answer.snapshots.spin[nearest, 0]


@dataclass(frozen=True)
class Moment:
    """What slips with the spins of a snapshot. slip, threshold : length/time. slip, state : (E,).

    state : by slip alone: friction, which would tell more, is not kept with a snapshot.
    """

    system: Scene | Packing
    slip: np.ndarray
    state: np.ndarray
    threshold: float


def moment_of(answer: Solution, spin: np.ndarray, slip_threshold: float | None = None) -> Moment:
    """A sample with the spins of a snapshot: a contact slips that is faster than the threshold of the run.

    Springs give way, so with them that is at least a thousandth of R times the jump, of packings of the largest imposed
    R omega, unless the run was asked for `slip_threshold`. spin : laboratory frame, (*N) or (*N, 3), 1/time.
    """
    system, threshold = answer.system, answer.slip_threshold
    if isinstance(system, Packing):
        slip, idle = system.slips(spin), answer.state[0] == ContactState.DRIVEN
        threshold = threshold or STRETCHED_SLIP * float(np.linalg.norm(system.imposed, axis=1).max(initial=0.0))
    else:
        axes = system.lattice.all_spin_axes
        slip, idle = system.slips(system.staggered_spin(spin[None], axes), axes)[0], system.idle[0]
        if answer.method.endswith("cundall-strack") and slip_threshold is None:
            threshold = max(threshold, STRETCHED_SLIP * system.lattice.radius * system.jump)
    return Moment(system, slip, by_threshold(slip, np.where(idle, ContactState.DRIVEN, 0), threshold), threshold)
