"""States that scans keep, dynamics, torques, blocks of seeds, packings, single precision: what they say is proven."""

import os

import h5py
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.runs.verify import verify
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.sample import solve_samples
from tests.cli.commands import bearings

pytestmark = pytest.mark.usefixtures("taichi_runtime")
SCANS = {
    "seeds side by side": "shape = [3, 3, 4]\n[scan]\nseed = { start = 3, stop = 6 }\n",
    "laws": 'shape = [4, 5]\n[scan]\nlaw = ["coulomb", "viscous", "coulomb-viscous"]\nseed = [1, 5]\n',
    "ties": 'shape = [4, 4, 4]\ndistribution = "bimodal:1,2,0.5"\n[scan]\nseed = { start = 0, stop = 3 }\n',
    "torques": "shape = [3, 3, 4]\n[scan]\ntorque = [10.0, 1e4]\nspin_bottom = [0.0, 0.1]\n",
    "dynamics": 'shape = [3, 3, 4]\nmethod = "cundall-strack"\nduration = 0.05\n[scan]\nseed = [1, 2]\n',
    "rigid": 'shape = [4, 4]\nmethod = "rigid-limit"\n[scan]\nlaw = ["coulomb", "coulomb-viscous"]\n',
    "thresholds": "shape = [3, 3, 4]\n[scan]\nslip_threshold = [1e-3, 1e-1]\n",
    "methods": 'shape = [3, 3, 4]\niterations = 200\n[scan]\nmethod = ["gradient-descent", "operator-splitting"]\n',
    "packings": 'packing = "bcc.npz"\n[scan]\nlaw = ["coulomb", "viscous"]\nseed = [1, 2]\n',
    "dynamics of packings": 'packing = "bcc.npz"\nmethod = "cundall-strack"\nduration = 0.05\n[scan]\nseed = [1, 2]\n',
    "descent of packings": 'packing = "bcc.npz"\nmethod = "gradient-descent"\niterations = 99\n[scan]\nseed = [1, 2]\n',
    "torques on packings": 'packing = "bcc.npz"\n[scan]\ntorque = [1.0, 1e4]\n',
    "walls": 'shape = [3, 3, 4]\ndriven = "walls"\n[scan]\nseed = [1, 2]\n',
}


@pytest.mark.parametrize("name", SCANS)
def test_a_state_that_a_scan_keeps_is_verified(name, tmp_path, needs_f64):
    arrays = tb.Packing.lattice("bcc", (2, 2, 3)).arrays()
    np.savez(tmp_path / "bcc.npz", **{key: v for key, v in arrays.items() if key not in ("friction", "normal_force")})
    (tmp_path / "scan.toml").write_text(SCANS[name])
    plan = read_plan(tmp_path / "scan.toml")
    records = solve_samples(plan.samples, states=tmp_path / "states")
    assert not any("error" in record["scalars"] for record in records)
    files = sorted((tmp_path / "states").glob("*.h5"))
    assert len(files) == len(plan.samples) > 1
    for path in files:
        assert verify(path)["contradictions"] == []
        with h5py.File(path, "r+") as file:
            file.attrs["power"] = 0.9 * file.attrs["power"]
        assert len(verify(path)["contradictions"]) == 2  # the number, and its checksum


@pytest.mark.parametrize("words", [[], ["--method", "cundall-strack", "--duration", "0.05"], ["--replicas", "2"]])
def test_runs_in_single_precision_are_verified(words, tmp_path):
    descent = [] if "--method" in words else ["--method", "gradient-descent", "--tolerance", "1e-2"]
    where = ["--precision", "f32", "--out", tmp_path / "run", "--figures", "none", "--verify"]
    done = bearings(
        "run", "--shape", "4,4,4", *words, *descent, *where, env=dict(os.environ)
    )  # in a process of its own
    assert "the file proves what it claims" in done.stdout, done.stdout + done.stderr
