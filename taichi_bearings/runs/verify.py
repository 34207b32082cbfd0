"""Independent verification of a run from its file alone."""

import time
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.checksums import ATTRIBUTE, changed
from taichi_bearings.errors import InputError
from taichi_bearings.hdf5 import open_hdf5
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.runs.run_file import file_of, refuse_scan
from taichi_bearings.scene.disorder import Distribution, draw_coefficients
from taichi_bearings.stages import stage
from taichi_bearings.verifier.claims import is_drawn
from taichi_bearings.verifier.samples import Samples
from taichi_bearings.verifier.stored_run import StoredRun, read_stored_run
from taichi_bearings.verifier.verdict import report_of, together


def verify(path: str | Path) -> dict[str, Any]:
    """Report on a run directory or its run.h5, as in `--json` of `verify`; "verified" is True without contradictions.

    Raises FileError if the file cannot be read.
    """
    began, path = time.perf_counter(), Path(path)
    size: dict[str, Any]
    with stage("reading"):
        refuse_scan(path)
        unlike = None
        if (file_of(path)).is_file():
            with open_hdf5(file_of(path), "a run") as file:  # what is not as it was written, where it has checksums
                unlike = [*changed(path, file)] if ATTRIBUTE in file.attrs else None
        run, *others = read_stored_run(path)
    samples, seeds, drawn = run.samples, np.asarray(run.attributes.get("seed", -1)).tolist(), False
    with stage("proving"), one_thread():
        report = report_of(run)
        if others:
            report = together([report, *map(report_of, others)])
            seeds = [int(one.claimed("seed")[0]) for one in (run, *others)]
    if isinstance(samples, Samples):
        size, drawn = {"shape": list(samples.shape)}, is_drawn(run)
        with stage("drawing the coefficients again"):
            lattice = Lattice(samples.shape, periodic=samples.periodic)
            sets = [("coefficients", "distribution", samples.coefficient)]
            sets += [("viscosities", "viscosity", samples.viscosity)] if samples.viscosity else []
            report["contradictions"] += [said for one in sets * drawn for said in _redrawn(run, lattice, *one)]
    else:
        size = {"shape": None, "spheres": len(samples.spin), "contacts": len(samples.arrays["contact"])}
    status = [word for one in (run, *others) for word in one.claimed("status")]
    report["contradictions"] += [f"{name} was changed after it was written" for name in unlike or ()]
    return {
        "verified": not report["contradictions"],
        **report,
        "unchanged": None if unlike is None else not unlike,
        "status": status if len(status) > 1 else status[0],
        "law": samples.law,
        **size,
        "seed": seeds,
        "coefficients": "drawn" if drawn else "given",
        "run": str(path),
        "seconds": time.perf_counter() - began,
    }


def _redrawn(run: StoredRun, lattice: Lattice, kind: str, key: str, values: tuple[np.ndarray, ...]) -> list[str]:
    """Sentences on the arrays of a kind of coefficient that are not those of their seeds."""
    try:
        distribution, seeds = Distribution.parse(str(run.settings[key])), map(int, run.claimed("seed"))
        samples = [draw_coefficients(lattice, distribution, seed, key == "viscosity") for seed in seeds]
    except (KeyError, InputError, TypeError, ValueError):
        return ["the scene names no distribution and seed that coefficients can be drawn from"]
    found = []
    for number, (seed, sample) in enumerate(zip(run.claimed("seed"), samples, strict=True)):
        for axis, drawn in enumerate(sample):
            stored = values[axis][number]
            if not np.array_equal(stored, drawn):
                found.append(f"{kind} along {'xyz'[axis]} are not those of seed {seed}, to the bit")
    return found
