"""Figure 4 of the paper: the sample of Fig. 3 cut along the planes that its path goes through."""

from pathlib import Path

import numpy as np

from taichi_bearings.plots.plane_cuts import draw_plane_cuts, planes_of
from taichi_bearings.stages import stage

from .claims import Claim, Effort
from .figure_3 import spanning_samples
from .samples import save_both


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write fig4.png and fig4.pdf into `folder`; returns the claim with its verdict."""
    samples = spanning_samples(effort)
    shown = samples[0]
    scene, path = shown.scene, shown.network.shortest_path
    with stage("drawing"):
        figure = draw_plane_cuts(shown.network, shown.spin, scene.spin_top, scene.spin_bottom)
        save_both(figure, folder, "fig4")
    if not shown.network.spans:
        return []
    within = [bool(sample.network.spans_within_planes(axis).any()) for sample in samples for axis in (0, 1)]
    planes = planes_of(path) if len(path) else ()
    held = np.zeros(max(len(path) - 1, 0), dtype=bool)
    for axis, index in planes:
        held |= (path[:-1, axis] == index) & (path[1:, axis] == index)
    return [
        Claim(
            "A connecting path of slipless contacts cannot stay in one plane.",
            f"No plane across x or y joins bottom and top by its own slipless contacts in any of {len(samples)} "
            f"samples that span: within it they tie one component of the spins from end to end. The planes drawn hold "
            f"{held.sum()} of the {len(held)} contacts of the path.",
            not any(within),
            {"samples": len(samples), "planes": [[int(axis), int(index)] for axis, index in planes]},
            samples=len(samples),
            kind="theorem",
            paper="several planes",
            ours=f"{len(planes)} planes drawn hold {held.sum()} of {len(held)} contacts",
            uncertainty="none: a theorem",
        )
    ]
