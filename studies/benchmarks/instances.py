"""Thirty problems for other solvers, 6^3 to 64^3, with their optima proven as closely as doubles allow.

    python -m taichi_bearings_studies.benchmarks.instances FOLDER --most 10

writes NAME.cbf and NAME.hdf5 (fclib) up to 10^3, and table.csv: bounds on the optimum, how near they are, how many
contact states are not proven, our time, and what conic solvers find at 1e-8, where they are installed, and in which
time. What the journal in the folder has is left alone, so that large ones can follow another day.
"""

import argparse
import time
from pathlib import Path
from typing import Any

from taichi_bearings.api import solve
from taichi_bearings.export.problems import lattice_as_packing, write_problem
from taichi_bearings.files.scan_journal import Journal, read_journal
from taichi_bearings.files.whole_file import make_folder, write_csv
from taichi_bearings.scene import Scene

from .conic import conic_programme
from .methods import MOST_OF_PEERS
from .peers import find_peers

SIDES = (6, 8, 10, 16, 32, 64)
KINDS: dict[str, dict[str, Any]] = {
    "uniform": {},
    "closed": {"periodic": ("x", "y"), "spin_bottom": 0.1},  # no side walls
    "contrast": {"distribution": "power-law:1e-6,1,-1"},  # six decades of friction
    "bimodal": {"distribution": "bimodal:0.1,1,0.5"},  # many ties
    "equal": {"distribution": "constant:0.5"},  # whole layers tie
}
CLOSEST, ASKED_OF_PEERS, LONGEST = 1e-14, 1e-8, 3600.0  # relative gaps; seconds
NUMBERS = ("power", "lower_bound", "gap")


def instances() -> dict[str, Scene]:
    """By name; the side is the seed, so that no two share their friction."""
    kinds = [(side, kind, options) for side in SIDES for kind, options in KINDS.items()]
    return {f"{kind}-{side}": Scene.random((side,) * 3, seed=side, **options) for side, kind, options in kinds}


def made(name: str, scene: Scene, folder: Path) -> dict[str, Any]:
    """Write the files of an instance; its row."""
    packing = lattice_as_packing(scene)
    write_problem(packing, "fclib", folder / f"{name}.hdf5")
    told = write_problem(packing, "cbf", folder / f"{name}.cbf")
    began, used = time.perf_counter(), time.process_time()
    found = solve(scene, tolerance=CLOSEST, time_limit=LONGEST, threads=1)
    row = {"key": name, **{key: told[key] for key in ("unknowns", "contacts")}}
    row |= {key: getattr(found, key) for key in NUMBERS} | {"unproven": found.summary["unproven"]}
    row |= {"seconds": time.perf_counter() - began, "processor": time.process_time() - used}
    if scene.lattice.sites <= MOST_OF_PEERS:
        programme = conic_programme(scene)
        for peer in find_peers()[0]:
            answer = peer.solve(programme, ASKED_OF_PEERS, LONGEST, threads=1)
            row |= {str(peer): answer.power, f"{peer} seconds": answer.seconds}
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--most", type=int, default=max(SIDES), help="largest side that is made")
    asked = parser.parse_args()
    make_folder(asked.folder)
    kept = asked.folder / "instances.jsonl"
    rows = read_journal(kept)
    solve(Scene.random((3, 3, 3)), threads=1)  # what is compiled first counts for none
    with Journal(kept) as journal:
        for name, scene in instances().items():
            if scene.lattice.shape[0] <= asked.most and name not in rows:
                rows[name] = made(name, scene, asked.folder)
                journal.append([rows[name]])
                print(", ".join(f"{key} {value}" for key, value in rows[name].items()), flush=True)
    columns = list(dict.fromkeys(key for row in rows.values() for key in row))
    write_csv(asked.folder / "table.csv", columns, [[row.get(key, "") for key in columns] for row in rows.values()])


if __name__ == "__main__":
    main()
