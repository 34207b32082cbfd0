"""Figure 4 of the paper: the sample of Fig. 3 along the planes that hold most of its slipless path."""

from functools import partial
from pathlib import Path

import numpy as np

from ..plots.plane_cuts import draw_plane_cuts, planes_of
from .claims import Effort
from .figure_3 import minima
from .samples import Found


def study(folder: Path, effort: Effort) -> Found:
    """Which contacts of the path the planes drawn hold."""
    table, shown = minima(folder, effort)
    path = shown.network.shortest_path
    planes = planes_of(path) if len(path) else ()
    held = [(path[:-1, axis] == index) & (path[1:, axis] == index) for axis, index in planes]
    named = {"spanning": table[table.spans], "planes": planes, "held": np.any(held, axis=0)}
    draw = partial(draw_plane_cuts, shown.network, shown.spin, shown.scene.spin_top, shown.scene.spin_bottom)
    return Found({}, draw, named)
