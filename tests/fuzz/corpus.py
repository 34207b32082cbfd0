"""Small good files of every kind, made once, that the mutations start from."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import taichi_bearings as tb
from tests.cli.commands import bearings

SCAN = """shape = [4, 5]
sample_timeout = 50
[scan]
seed = { start = 0, stop = 3 }
spin_bottom = [0.0, 0.1]
"""
SCENE = """shape = [3, 4]
law = "viscous"
method = "gradient-descent"
tolerance = 1e-6
distribution = "lognormal:1,0.5"
direction = [1.0, 0.5, 0.0]
threads = 1
"""


@dataclass(frozen=True)
class Corpus:
    """folder : holds all of it. runs : directories of runs. scan : folder of a scan with kept states."""

    folder: Path
    runs: tuple[Path, ...]
    resumable: Path
    scan: Path


def make_corpus(folder: Path) -> Corpus:
    dynamics = "--shape 3,4 --method rigid-limit --initial random --duration 0.01 --snapshots 0,0.005"
    runs = {
        "flat": "--shape 4,5 --seed 3",
        "cubic": "--shape 3,3,4 --seed 1",
        "block": "--shape 3,4 --replicas 2 --law viscous",
        "lubricated": "--shape 3,4 --law coulomb-viscous",
        "resumable": f"{dynamics} --checkpoint-every 1e-3",
        "springs": "--shape 3,4 --method cundall-strack --duration 0.001 --energy",
    }
    for name, words in runs.items():
        _made("run", *words.split(), "--figures", "none", "--threads", "1", "--out", folder / name)
    _made("analyse", folder / "cubic", "--no-figures")
    _made("histogram", folder / "flat", "--out", folder / "histogram")
    (folder / "scan.toml").write_text(SCAN)
    _made("scan", folder / "scan.toml", "--workers", "1", "--keep-states", "--out", folder / "scan")
    x, y = np.full((3, 5), 0.5), np.full((4, 4), 0.25)
    np.savez(folder / "coefficients.npz", x=x, y=y, x_viscosity=x, y_viscosity=y)
    np.savez_compressed(folder / "packed.npz", x=x, y=y)
    packing = tb.Packing.lattice("bcc", (2, 2, 2), law="coulomb-viscous", driven="planes", seed=1)
    np.savez_compressed(folder / "bearing.npz", **packing.arrays())
    packing.save(folder / "bearing.h5")
    _made("run", "--packing", folder / "bearing.npz", "--figures", "none", "--out", folder / "bearing")
    _made("analyse", folder / "bearing", "--no-figures")
    np.savez(folder / "spin.npz", spin=np.zeros((4, 5)))
    np.save(folder / "spin.npy", np.zeros((4, 5)))
    return Corpus(folder, tuple(folder / name for name in runs), folder / "resumable", folder / "scan")


def _made(*words: object) -> None:
    answer = bearings(*words)
    assert answer.returncode in (0, 1), answer
    assert not answer.fault, answer
