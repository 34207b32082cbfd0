"""Thirty problems for other solvers, 6^3 to 64^3, with their optima proven as closely as doubles allow.

    python -m taichi_bearings_studies.benchmarks.instances FOLDER --most 10 --peers 10

writes NAME.cbf and NAME.hdf5 (fclib) up to 10^3, and table.csv: bounds on the optimum, their relative distance, how
many contact states are not proven, our time, and what Clarabel and SCS find at 1e-8, where they are installed, and in
which time. An instance that the table has is left alone, so that large ones can follow another day.
"""

import argparse
import csv
import time
from pathlib import Path
from typing import Any

from taichi_bearings.api import solve
from taichi_bearings.export.problems import write_problem
from taichi_bearings.files.whole_file import make_folder, write_csv
from taichi_bearings.scene import Scene

from ..report import markdown
from .peers import conic_programme, find_peers

SIDES = (6, 8, 10, 16, 32, 64)
KINDS: dict[str, dict[str, Any]] = {
    "uniform": {},
    "closed": {"periodic": ("x", "y"), "spin_bottom": 0.1},  # no side walls
    "contrast": {"distribution": "power-law:1e-6,1,-1"},  # six decades of friction
    "bimodal": {"distribution": "bimodal:0.1,1,0.5"},  # many ties
    "equal": {"distribution": "constant:0.5"},  # whole layers tie
}
CLOSEST, ASKED_OF_PEERS = 1e-14, 1e-8  # tolerances that our method, and other solvers, are given
LONGEST = 3600.0  # seconds that another solver may take
COLUMNS = ("name", "unknowns", "contacts", "power", "lower_bound", "gap", "unproven", "seconds", "processor")


def instances() -> dict[str, Scene]:
    """Return the problems by name. The seed is the side of the lattice, so that problems of different sides differ in
    their friction.
    """
    return {
        f"{kind}-{side}": Scene.random((side, side, side), seed=side, **options)
        for side in SIDES
        for kind, options in KINDS.items()
    }


def made(name: str, scene: Scene, folder: Path, peers: int) -> dict[str, Any]:
    """Write the files of one problem, solve it by this program and perhaps by other solvers, and return its row of the
    table.

    name, scene : name and scene of the problem.
    folder : folder in which the files are written.
    peers : largest side of a problem that other solvers are given.
    """
    write_problem(scene, "fclib", folder / f"{name}.hdf5")
    written = write_problem(scene, "cbf", folder / f"{name}.cbf")
    began, used = time.perf_counter(), time.process_time()
    found = solve(scene, method="interior-point", tolerance=CLOSEST, threads=1)  # at 64^3 it takes an hour
    row = {
        "name": name,
        **{key: written[key] for key in ("unknowns", "contacts")},
        **{key: getattr(found, key) for key in ("power", "lower_bound", "gap")},
        "unproven": found.summary["unproven"],
        "seconds": round(time.perf_counter() - began, 3),
        "processor": round(time.process_time() - used, 3),
    }
    if scene.lattice.shape[0] <= peers:
        programme = conic_programme(scene)
        for peer in find_peers()[0]:
            answer = peer.solve(programme, ASKED_OF_PEERS, LONGEST, threads=1)
            title = f"{peer.name} {peer.linear_solver}"
            row |= {title: answer.power, f"{title} seconds": round(answer.seconds, 3)}
    return row


def main() -> None:
    """Make the problems that the folder lacks, as the command line asks, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--most", type=int, default=max(SIDES), help="largest side of the cubes that are solved")
    parser.add_argument(
        "--peers", type=int, default=16, help="largest side of the cubes that Clarabel and SCS solve, too"
    )
    asked = parser.parse_args()
    make_folder(asked.folder)
    table = asked.folder / "table.csv"
    rows: list[dict[str, Any]] = []
    if table.exists():
        with table.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    solve(Scene.random((3, 3, 3)), threads=1)  # compiles kernels, so that no instance pays for that
    for name, scene in instances().items():
        if scene.lattice.shape[0] <= asked.most and name not in {row["name"] for row in rows}:
            rows.append(made(name, scene, asked.folder, asked.peers))
            columns = list(dict.fromkeys([*COLUMNS, *(key for row in rows for key in row)]))
            write_csv(table, columns, [[row.get(key, "") for key in columns] for row in rows])
            print(", ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
    print(markdown([COLUMNS, *([f"{row[key]}" for key in COLUMNS] for row in rows)]))


if __name__ == "__main__":
    main()
