"""The spins of a dynamics at one of the times at which it kept them: `bearings plot spins --time`."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from taichi_bearings.errors import InputError
from taichi_bearings.files.run_file import StoredRun
from taichi_bearings.plots.spins import draw_spins
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.analyse import scene_of
from taichi_bearings.runs.run import settings_of

ELASTIC = 1e-3  # of R times the imposed jump: slower contacts may only stretch their springs


def draw_snapshot(run: StoredRun, replica: int, time: float) -> Figure:
    """The snapshot nearest to a simulated time, which the title names, and the contacts that slip in it.

    Friction is not kept with a snapshot: a contact slips if it does so faster than the slip threshold of the run.
    Springs give way, so with them and without a threshold that was asked for, it is a thousandth of R times the jump.
    InputError if the run has no snapshots or does not reach that time.
    """
    if not run.snapshots:
        raise InputError(f"{run.path} holds no snapshots; run a dynamics with --snapshots")
    kept = run.snapshots["time"][replica]
    end = float(max(kept.max(), run.attributes.get("time", 0.0)))
    if not 0 <= time <= end:
        raise InputError(
            f"time is {time:g}; {run.path} goes from 0 to {end:g}, with snapshots from {kept.min():g} to {kept.max():g}"
        )
    nearest = int(np.abs(kept - time).argmin())
    spin = run.snapshots["spin"][replica, nearest][None]
    scene = scene_of(run, replica)
    threshold = float(run.attribute("slip_threshold"))
    if str(run.attribute("method")).endswith("cundall-strack") and settings_of(run).slip_threshold is None:
        threshold = max(threshold, ELASTIC * scene.lattice.radius * scene.jump)
    axes = scene.lattice.all_spin_axes
    speeds = scene.slips(scene.staggered_spin(spin, axes), axes)
    state = tuple(
        np.where(scene.lattice.between_driven(axis), ContactState.DRIVEN, speed > threshold)
        for axis, speed in enumerate(speeds)
    )
    figure = draw_spins(replace(run, spin=spin, state=state))
    figure.suptitle(f"t = {kept[nearest]:.6g}; black: contacts that slip faster than {threshold:.1e}", fontsize=9)
    return figure
