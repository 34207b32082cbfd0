"""Seconds from shell to prompt of first and later small runs: python -m tests.benchmarks.start_table [COMMAND...]

For each method in 2D and 3D, with the seconds to compile in brackets: with an empty cache of kernels, again, with a
shape that is new to it, and with another number of threads. COMMAND is what calls the program, `bearings` unless given.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

METHODS = (
    ("planar-cut",),
    ("interior-point",),
    ("operator-splitting",),
    ("gradient-descent",),
    ("gradient-descent", "--no-momentum", "--tolerance", "0.1"),
    ("linear-solver", "--law", "viscous"),
    ("cundall-strack",),
    ("cundall-strack", "--initial", "random"),
    ("cundall-strack", "--law", "viscous", "--energy"),
    ("implicit-cundall-strack", "--tolerance", "1e-4"),
    ("rigid-limit", "--tolerance", "1e-4"),
)
SHAPES = {"2D": ("10,10", "12,9"), "3D": ("3,3,4", "4,3,5")}


def seconds(command: list[str], cache: str, *options: str) -> str:
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        done = subprocess.run(
            [*command, "run", *options, "--iterations", "2000", "--out", f"{folder}/run", "--json"],
            capture_output=True,
            text=True,
            env=os.environ | {"XDG_CACHE_HOME": cache},
        )
        took = time.perf_counter() - began
    if done.returncode > 1:
        return "-"
    return f"{took:.1f} ({json.loads(done.stdout)['seconds_compile']:.1f})"


def main(command: list[str]) -> None:
    print("| method | | cold | warm | new shape | other threads |\n|---|---|---|---|---|---|")
    for method in METHODS:
        for dimension, (first, second) in SHAPES.items():
            with tempfile.TemporaryDirectory() as cache:
                cells = [
                    seconds(command, cache, "--method", *method, "--shape", shape, "--threads", threads)
                    for shape, threads in ((first, "1"), (first, "1"), (second, "1"), (first, "2"))
                ]
            if cells[0] != "-":
                print(f"| {' '.join(method)} | {dimension} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:] or [str(Path(sys.executable).with_name("bearings"))])
