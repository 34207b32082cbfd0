"""Figure 3 of the paper: a 10x10x10 sample with omega_T = 10 omega_B, its slipless network and a path through it.

The paper shows one sample. Shown here is the first seed whose slipless contacts join bottom and top; what holds for how
many samples, and for other sizes, is the business of paper/network.py.
"""

from functools import lru_cache, partial
from pathlib import Path

from taichi_bearings.analysis.structure import Structure
from taichi_bearings.plots.structure import draw_network
from taichi_bearings.runs.settings import RunSettings

from .claims import Effort
from .network import PRACTICALLY_ALL, sample_of
from .samples import Found, Table, certified, measured

SHAPE, SPIN_BOTTOM = (10, 10, 10), 0.1
MOST_SAMPLES = 40


def study(folder: Path, effort: Effort) -> Found:
    """Certified samples of the paper's size, and the spheres of the path of the one that is shown."""
    table, shown = minima(folder, effort)
    path, scene = shown.network.shortest_path, shown.scene
    columns = [*path.T, *shown.spin[tuple(path.T)].T]
    spheres = Table(dict(zip(("x", "y", "z", "spin_x", "spin_y", "spin_z"), columns, strict=True)))
    named = {
        "table": table, "spanning": table[table.spans], "practically": PRACTICALLY_ALL,
        "free": int((~scene.lattice.is_driven).sum()), "contacts": scene.lattice.contacts,
    }  # fmt: skip
    draw = partial(draw_network, shown.network, shown.spin, scene.spin_top, scene.spin_bottom)
    return Found({".csv": spheres}, draw, named)


@lru_cache(maxsize=1)  # for Fig. 4
def minima(folder: Path, effort: Effort) -> tuple[Table, Structure]:
    """Certified samples of the paper's size, and the first one that spans, else the first."""
    seeds = range(effort.seed, effort.seed + min(MOST_SAMPLES, effort.samples))
    chosen = [RunSettings(shape=SHAPE, seed=seed, spin_bottom=SPIN_BOTTOM) for seed in seeds]
    table = Table.of(measured(chosen, sample_of, folder / "fig3.jsonl"))
    return table, certified(chosen[int(table.spans.argmax())])
