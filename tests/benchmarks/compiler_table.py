"""Taichi and Quadrants in turns: python -m tests.benchmarks.compiler_table [ROUNDS]

Medians of the rounds: seconds to import and start the compiler, to compile a method's kernels with an empty cache and
again, microseconds of a step at 32^3 with one thread, and whether all spins are the same to the last bit.
"""

import hashlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time

from taichi_bearings import compiler, runtime

METHODS = ("gradient-descent", "cundall-strack")
STEPS = 400


def measure_here() -> dict[str, object]:
    began = time.perf_counter()
    runtime.start("cpu", "f64", 1)
    found: dict[str, object] = {"import and start, s": time.perf_counter() - began}
    from taichi_bearings.runs.run import prepare, solve_job
    from taichi_bearings.runs.settings import RunSettings

    for method in METHODS:
        for iterations in (STEPS, 2 * STEPS):
            solution = solve_job(prepare(RunSettings(method=method, threads=1, iterations=iterations, tolerance=1e-15)))
            found.setdefault(f"{method}: compile, s", solution.seconds_compile)
            found[f"{method}: step, us"] = 1e6 * solution.seconds / solution.iterations
        found[f"{method}: bits"] = hashlib.sha256(solution.spin.tobytes()).hexdigest()[:12]
    return found


def measure(name: str, cache: str) -> dict[str, object]:
    done = subprocess.run(
        [sys.executable, "-m", "tests.benchmarks.compiler_table", "here"],
        env=os.environ | {"XDG_CACHE_HOME": cache, compiler.VARIABLE: name},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def main(rounds: int) -> None:
    rows: dict[str, dict[str, list[object]]] = {}
    for _ in range(rounds):
        for name in compiler.KERNEL_CACHES:
            with tempfile.TemporaryDirectory() as cache:
                for state in ("cold", "warm"):
                    for what, value in measure(name, cache).items():
                        label = f"{what} ({state})" if what.endswith("compile, s") else what
                        rows.setdefault(label, {}).setdefault(name, []).append(value)
    print(f"| | {' | '.join(compiler.KERNEL_CACHES)} |\n|---|---|---|")
    for label, values in rows.items():
        cells = [
            ", ".join(sorted({*found})) if isinstance(found[0], str) else f"{statistics.median(found):.3g}"
            for found in values.values()
        ]
        print(f"| {label} | {' | '.join(cells)} |")


if __name__ == "__main__":
    if sys.argv[1:] == ["here"]:
        print(json.dumps(measure_here()))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
