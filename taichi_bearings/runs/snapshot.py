"""The spins of a dynamics at one of the times at which it kept them: `bearings plot spins --time`."""

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.errors import InputError
from taichi_bearings.plots.page import PAGE, Page
from taichi_bearings.plots.spins import draw_spins
from taichi_bearings.plots.symbols import describe, driving
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene, Solution

STRETCHED_SLIP = 1e-3  # of R times the imposed jump: slower contacts may only stretch their springs


def draw_snapshot(
    solution: Solution, replica: int, time: float, slip_threshold: float | None = None, page: Page = PAGE
) -> Figure:
    """The snapshot nearest to a simulated time, which the title names, and the contacts that slip in it.

    A contact slips as :func:`snapshot_threshold` says. InputError if the run has no snapshots or does not reach that
    time.
    """
    if solution.snapshots is None:
        raise InputError("the run holds no snapshots; run a dynamics with --snapshots")
    kept = solution.snapshots.time
    end = float(max(kept.max(), solution.history["time"][-1]))
    if not 0 <= time <= end:
        raise InputError(
            f"time is {time:g}; the run goes from 0 to {end:g}, with snapshots from {kept.min():g} to {kept.max():g}"
        )
    nearest = int(np.abs(kept - time).argmin())
    scene, spin = solution.sample(replica).scene, solution.snapshots.spin[nearest, replica]
    threshold = snapshot_threshold(solution, slip_threshold)
    slips = np.where(slips_of(scene, spin) > threshold, ContactState.SLIPPING, ContactState.SLIPLESS)
    state = scene.lattice.by_axis(np.where(scene.lattice.between_driven, ContactState.DRIVEN, slips))
    unit, symbol = driving(scene)
    when = f"$t = {kept[nearest]:.6g}$" + ("" if unit == 1 else rf", ${symbol}\,t = {unit * kept[nearest]:.6g}$")
    note = f"black: contacts that slip faster than {threshold:.1e}"
    if scene.jump:
        note += rf" $= {threshold / (scene.lattice.radius * scene.jump):.1g}\,R\,|\Delta\omega|$"
    return draw_spins(scene, spin, state, page, f"{describe(scene)}, {when}", note)


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
