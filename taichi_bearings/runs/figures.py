"""The figures of one run by their names, whether it lies in a file or not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.analysis.packing_structure import PackingStructure
from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.packing import PackingSolution
from taichi_bearings.plots.curves import draw_energy, draw_history
from taichi_bearings.plots.page import PAGE, Page, check_planes
from taichi_bearings.plots.spins import draw_power, draw_spins
from taichi_bearings.plots.structure import draw_domains, draw_domains_of_packing, draw_network, draw_network_of_packing
from taichi_bearings.plots.style import describe, driving, mathematics
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.solved import Packed
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.words import meant

FIGURES: dict[str, Callable[[Structure, Page], Figure]] = {
    "domains": lambda s, page: draw_domains(s.rigid_domains, page),
    "network": lambda s, page: draw_network(s.network, s.spin, *s.scene.imposed, page),
}
"""How each figure of the structure of a sample is drawn."""


def _draw_spins(solution: Solution, sample: int, page: Page) -> Figure:
    one = solution.sample(sample)
    return draw_spins(one.scene, one.spin[0], one.state[0], page)


OF_ANSWERS: dict[str, Callable[[Solution, int, Page], Figure]] = {
    "spins": _draw_spins,
    "power": draw_power,
    "history": lambda solution, _, page: draw_history(solution, page),
    "energy": draw_energy,
}
FIGURE_KINDS = (*OF_ANSWERS, *FIGURES)
FIGURES_OF_PACKINGS: dict[str, Callable[..., Figure]] = {
    "spins": lambda result, page: draw_spins(result.packing, result.spin, result.state, page),
    "power": draw_power,
    "network": draw_network_of_packing,
    "history": draw_history,
    "energy": lambda result, page: draw_energy(result, 0, page),
    "domains": lambda result, page: draw_domains_of_packing(result, PackingStructure.of(result).rigid_domains, page),
}
STRETCHED_SLIP = 1e-3  # of R times the imposed jump: slower contacts may only stretch their springs
WITH_PLANES = ("spins", "power", "domains")
WITH_VIEW = ("spins", "domains", "network")


def draw_figure(
    kind: str,
    solution: Solution | Packed,
    sample: int = 0,
    time: float | None = None,
    slip_threshold: float | None = None,
    page: Page = PAGE,
) -> Figure:
    """The figure called `kind`; InputError if there is none, or nothing for it to show.

    time : of the snapshot whose spins are drawn; slip_threshold : that the run was asked for, if it was.
    page : how it is printed.
    """
    kinds = FIGURES_OF_PACKINGS if isinstance(solution, Packed) else FIGURE_KINDS
    if kind not in kinds:
        raise InputError(f"the figure is {kind!r}; allowed are {', '.join(kinds)}{meant(kind, kinds)}")
    if time is not None and kind != "spins":
        raise InputError(f"time is {time}, but {kind} does not depend on it; only spins have snapshots")
    if not 0 <= sample < len(solution.state):
        raise InputError(f"replica is {sample}; the run has {len(solution.state)}, counted from 0")
    if isinstance(solution, Packed):
        if page.planes:
            raise InputError("plane is given, but a packing has no lattice planes to cut along; --view turns it")
        result = solution.results[sample]
        if time is not None:
            return draw_moment(result, time, page)
        return FIGURES_OF_PACKINGS[kind](solution.results if kind == "history" else result, page=page)
    shape = solution.scene.lattice.shape
    if page.planes and kind not in WITH_PLANES:
        raise InputError(f"plane is given, but {kind} shows no planes; these do: {', '.join(WITH_PLANES)}")
    if page.view and kind not in WITH_VIEW:
        raise InputError(f"view is given, but {kind} shows nothing in 3D; these do: {', '.join(WITH_VIEW)}")
    if page.view and len(shape) == 2:
        raise InputError("view is given, but the lattice is flat; only cubic ones are turned")
    check_planes(page.planes, shape)
    if time is not None:
        return draw_snapshot(solution, sample, time, slip_threshold, page)
    if kind in FIGURES:
        return FIGURES[kind](structure_of(solution, sample), page)
    return OF_ANSWERS[kind](solution, sample, page)


def draw_snapshot(
    solution: Solution, replica: int, time: float, slip_threshold: float | None = None, page: Page = PAGE
) -> Figure:
    """The snapshot nearest to a simulated time, which the title names, and the contacts that slip in it.

    A contact slips as :func:`snapshot_threshold` says. InputError if the run has no snapshots or does not reach that
    time.
    """
    at, spins = _nearest(solution, time)
    scene, spin = solution.sample(replica).scene, spins[replica]
    threshold = snapshot_threshold(solution, slip_threshold)
    slips = np.where(slips_of(scene, spin) > threshold, ContactState.SLIPPING, ContactState.SLIPLESS)
    state = np.where(scene.lattice.between_driven, ContactState.DRIVEN, slips)
    unit, symbol = driving(scene)
    when = f"$t = {mathematics(at)}$" + ("" if unit == 1 else rf", ${symbol}\,t = {mathematics(unit * at)}$")
    note = f"black: contacts that slip faster than ${mathematics(threshold, 2)}"
    note += (
        rf" = {mathematics(threshold / (scene.lattice.radius * scene.jump), 1)}\,R\,|\Delta\omega|"
        if scene.jump
        else ""
    )
    return draw_spins(scene, spin, state, page, f"{describe(scene)}, {when}", f"{note}$")


def _nearest(solution: Solution | PackingSolution, time: float) -> tuple[float, np.ndarray]:
    """Time and spins of the snapshot nearest to a time; InputError if there are none or the run does not reach it."""
    if solution.snapshots is None:
        raise InputError("the run holds no snapshots; run a dynamics with --snapshots")
    kept = solution.snapshots.time
    end = float(max(kept.max(), solution.history["time"][-1]))
    if not 0 <= time <= end:
        raise InputError(
            f"time is {time:g}; the run goes from 0 to {end:g}, with snapshots from {kept.min():g} to {kept.max():g}"
        )
    nearest = int(np.abs(kept - time).argmin())
    return float(kept[nearest]), solution.snapshots.spin[nearest]


def draw_moment(result: PackingSolution, time: float, page: Page = PAGE) -> Figure:
    """The same of a packing."""
    at, spin = _nearest(result, time)
    moment, title = at_moment(result, spin), f"{describe(result.packing)}, $t = {mathematics(at)}$"
    return draw_spins(moment.packing, moment.spin, moment.state, page, title)


def at_moment(result: PackingSolution, spin: np.ndarray) -> PackingSolution:
    """A packing with the spins of a snapshot. Contacts slip in it that are faster than the threshold of the run, with
    springs than a thousandth of the largest imposed surface speed."""
    springs = STRETCHED_SLIP * float(np.linalg.norm(result.packing.imposed, axis=1).max(initial=0.0))
    return replace(result, spin=spin, slip=result.packing.slips(spin)).by_threshold(result.slip_threshold or springs)


def snapshot_threshold(solution: Solution, slip_threshold: float | None) -> float:
    """Slip speed beyond which a contact of a snapshot slips; friction, which would tell more, is not kept with it.

    That of the run. Springs give way, so with them it is at least a thousandth of R times the jump, unless the run was
    asked for `slip_threshold`.
    """
    if solution.method.endswith("cundall-strack") and slip_threshold is None:
        return max(solution.slip_threshold, STRETCHED_SLIP * solution.scene.lattice.radius * solution.scene.jump)
    return solution.slip_threshold


def slips_of(scene: Scene, spin: np.ndarray) -> np.ndarray:
    """Slip speeds (E,) of spins in the laboratory frame, (*N) or (*N, 3); length/time."""
    axes = scene.lattice.all_spin_axes
    return scene.slips(scene.staggered_spin(spin[None], axes), axes)[0]
