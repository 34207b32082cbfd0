"""The kinds of input, each a function (corpus, folder, draw) -> the answer that it met."""

import contextlib
import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest import mock

from taichi_bearings.runs.settings import settings_table
from tests.cli.commands import Answer, bearings
from tests.fuzz.corpus import SCAN, SCENE, Corpus
from tests.fuzz.damage import bytes_changed, hdf5_changed, journal_changed, npy_made, npz_made, toml_changed

KEYS = [*settings_table(), "out", "force", "analyse", "keep_states", "sample_timeout", "scan", "nonsense"]
WORDS = [
    "", "0", "-1", "1", "2", "3", "1e-3", "nan", "inf", "1e999", "9" * 5000, "true", "4,5", "3,3,4", "4x5", "-4,5",
    "1,1", "100000,100000,100000", "4,5,6,7", "random", "zero", "minimum-cut", "auto", "gradient-descent",
    "cundall-strack", "coulomb", "viscous", "none", "cpu", "f32", "uniform:1,2", "constant:0", "lognormal:1,0.5",
    "log:1e-4,1,5",
    "linear:0,1,1e18", "0.1,0.2", "/", ".", "/dev/zero", "\x00", "\x1b[0m", "é", "a\nb", "0x10", "1_000", "٣", "1e18",
    "4294967296",
]  # fmt: skip
FIGURES = ["spins", "power", "coefficients", "history", "energy", "domains", "network"]


@contextlib.contextmanager
def unsolved() -> Iterator[None]:
    """A run ends where its solve would begin, with exit code 2."""
    from taichi_bearings.errors import InputError

    def refuse(*_: object, **__: object) -> None:
        raise InputError("it would be solved now")

    with mock.patch("taichi_bearings.runs.lattice_run.solve_job", refuse):
        yield


def options(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    words = ["run", "--shape", draw.choice(["4,5", "3,3,4"]), "--out", str(folder / "out")]
    for key in draw.sample(KEYS[:-7], draw.choice([1, 2, 3, 6])):
        words += [f"--{key.replace('_', '-')}", draw.choice(WORDS)]
    if draw.random() < 0.2:
        scan = draw.choice([corpus.scan, corpus.folder / "scan.toml"])
        setting = f"{draw.choice(['', 'scan.'])}{draw.choice(KEYS)}={draw.choice(WORDS)}"
        words = ["scan", str(scan), "--dry-run", "--set", setting]
        words += [draw.choice(["--part", "--sample-timeout", "--workers", "--out"]), draw.choice(WORDS)]
    with unsolved():
        return bearings(*words)


def other_options(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    """Of the commands that read, with values that they may not have."""
    run = str(draw.choice([*corpus.runs, corpus.scan, corpus.folder, folder / "nowhere"]))
    y, x = draw.choice(["power", "power/gap", "x", "/", "status"]), draw.choice(["seed", "spin_bottom", "L", "law"])
    kinds = [
        ["verify", run],
        ["histogram", run, "--by", draw.choice(WORDS)],
        ["plot", draw.choice([*FIGURES, "x"]), run, "--replica", draw.choice(WORDS)],
        ["plot", "scan", str(corpus.scan), "--y", y, "--x", x],
        ["analyse", run, "--threshold", draw.choice(WORDS)],
        ["plot", "spins", run, "--time", draw.choice(WORDS)],
    ]
    words = draw.choice(kinds)
    given = {"histogram": ["--bins-per-decade", "--normalise"], "plot": ["--by", "--where", "--log"]}
    if words[0] in given and draw.random() < 0.7:
        words += [
            draw.choice(given[words[0]]),
            draw.choice([*WORDS, "unit", "mean", "seed=1", "power=nan", "1,2", "xy"]),
        ]
    where = {"verify": [], "plot": ["--out", folder / "out.png"]}.get(words[0], ["--out", folder / "out"])
    return bearings(*words, *where)


def tiny_runs(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    """True runs with random options."""
    words = ["run", "--shape", draw.choice(["2,3", "3,4", "2,2,3"])]
    words += ["--figures", "none", "--threads", "1", "--time-limit", "1", "--iterations", "200"]
    for key in draw.sample(KEYS[1:-7], 2):
        if key not in ("replicas", "threads", "time_limit", "arch", "precision", "iterations", "figures", "duration"):
            words += [f"--{key.replace('_', '-')}", draw.choice(WORDS)]
    return bearings(*words, "--out", folder / "out")


def scene_toml(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    return _of_text(folder, toml_changed(SCENE, KEYS, draw), draw, "run", "--out", folder / "out")


def scan_toml(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    return _of_text(folder, toml_changed(SCAN, KEYS, draw), draw, "scan", "--dry-run")


def _of_text(folder: Path, text: str, draw: random.Random, command: str, *words: object) -> Answer:
    content = text.encode()
    file = folder / "in.toml"
    file.write_bytes(bytes_changed(content, draw) if draw.random() < 0.2 else content)
    with unsolved():
        return bearings(command, file, *words)


def arrays(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    name = draw.choice(["coefficients.npz", "packed.npz", "spin.npz", "spin.npy"])
    file, good = folder / f"in{Path(name).suffix}", (corpus.folder / name).read_bytes()
    if file.suffix == ".npy":
        file.write_bytes(draw.choice([npy_made(draw, (4, 5)), bytes_changed(good, draw)]))
    else:
        file.write_bytes(npz_made(draw, good))
    return _as_arrays(file, folder, draw)


def _as_arrays(file: Path, folder: Path, draw: random.Random) -> Answer:
    law = draw.choice([[], ["--law", "coulomb-viscous"]])
    with unsolved():
        words = ["run", "--shape", draw.choice(["4,5", "3,3,4"]), draw.choice(["--coefficients", "--initial"]), file]
        return bearings(*words, *law, "--out", folder / "out")


def stored_runs(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    return _as_run(_changed(draw.choice(corpus.runs) / "run.h5", corpus, folder, draw), folder, draw)


def _changed(good: Path, corpus: Corpus, folder: Path, draw: random.Random) -> Path:
    """A copy of a good HDF5 file with its content changed, or its bytes."""
    file = folder / good.name
    file.write_bytes(good.read_bytes())
    if draw.random() < 0.6:
        hdf5_changed(file, draw, corpus.folder / "flat" / "run.h5")
    else:
        file.write_bytes(bytes_changed(file.read_bytes(), draw))
    return file


def _as_run(file: Path, folder: Path, draw: random.Random) -> Answer:
    if draw.random() < 0.05:
        return bearings("plot", draw.choice(FIGURES), file, "--out", folder / "out.png")
    match draw.randrange(6):
        case 0:
            return bearings("verify", file)
        case 1:
            return bearings("analyse", file, "--no-figures", *draw.choice([["--out", folder / "out"], []]))
        case 2:
            with mock.patch("taichi_bearings.plots.style.save"):
                return bearings("histogram", file, "--out", folder / "out")
        case 3:
            with unsolved():
                return bearings("run", file, "--out", folder / "out")
        case 4:
            return _as_arrays(file, folder, draw)
        case _:
            with (
                mock.patch("taichi_bearings.runs.figures.draw_figure"),
                mock.patch("taichi_bearings.plots.style.save"),
            ):
                return bearings("plot", draw.choice(FIGURES), file, "--out", folder / "out.png")


def checkpoints(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    _changed(corpus.resumable / "checkpoint.h5", corpus, folder, draw)
    return bearings("run", "--resume", folder, "--time-limit", "1")


def stored_scans(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    _changed(corpus.scan / "scan.h5", corpus, folder, draw)
    return _as_scan(corpus, folder, draw)


def _as_scan(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    if draw.random() < 0.2:
        for name in ("samples.jsonl", "scan.toml"):
            shutil.copyfile(corpus.scan / name, folder / name)
    with mock.patch("taichi_bearings.scans.figure.save"), mock.patch("taichi_bearings.plots.style.save"):
        if draw.random() < 0.5:
            how = draw.choice([[], ["--by", "seed"], ["--normalise", "mean"]])
            return bearings("histogram", folder, "--out", folder / "out", *how)
        y, x = draw.choice(["power", "gap", "power/slipping"]), draw.choice(["seed", "spin_bottom", "L"])
        return bearings("plot", "scan", folder, "--y", y, "--x", x, *draw.choice([[], ["--by", "spin_bottom"]]))


def kept_states(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    shutil.copytree(corpus.scan, folder / "scan")
    states = folder / "scan" / "states"
    _changed(draw.choice(sorted((corpus.scan / "states").iterdir())), corpus, states, draw)
    return bearings("scan", folder / "scan", "--dry-run")


def journals(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    shutil.copyfile(corpus.scan / "scan.toml", folder / "scan.toml")
    name = draw.choice(["samples.jsonl", "samples.jsonl", "part-1-of-2.jsonl"])
    (folder / name).write_bytes(journal_changed((corpus.scan / "samples.jsonl").read_bytes(), draw))
    match draw.randrange(4):
        case 0:
            return bearings("scan", folder, "--dry-run")
        case 1:
            return bearings("scan", folder, "--merge")
        case _:
            return _as_scan(corpus, folder, draw)


def histogram_files(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    """power_histogram.h5, which no command reads, where a run or a scan should be."""
    return _as_run(_changed(corpus.folder / "histogram" / "power_histogram.h5", corpus, folder, draw), folder, draw)


def packings(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    name = draw.choice(["bearing.npz", "bearing.h5"])
    file, good = folder / name, (corpus.folder / name).read_bytes()
    if name.endswith(".npz"):
        file.write_bytes(npz_made(draw, good))
    else:
        file.write_bytes(good)
        hdf5_changed(file, draw, corpus.folder / "flat" / "run.h5")
    if draw.random() < 0.3:
        file.write_bytes(bytes_changed(file.read_bytes(), draw))
    words = ["info", file] if draw.random() < 0.3 else ["run", "--packing", file, "--out", folder / "out"]
    return bearings(*words, *(["--figures", "none"] if words[0] == "run" else []))


def packing_runs(corpus: Corpus, folder: Path, draw: random.Random) -> Answer:
    file = _changed(corpus.folder / "bearing" / "run.h5", corpus, folder, draw)
    words = [
        ("verify", file), ("analyse", file, "--no-figures"), ("export", file), ("list", folder), ("view", file),
        ("run", file, "--out", folder / "out", "--figures", "none"),
    ]  # fmt: skip
    if draw.random() < 0.05:
        return bearings("plot", draw.choice(["spins", "power", "network"]), file, "--out", folder / "out.png")
    return bearings(*draw.choice(words))


KINDS: dict[str, tuple[Callable[[Corpus, Path, random.Random], Answer], int]] = {  # name -> (function, share of 1000)
    "options": (options, 300),
    "other options": (other_options, 4),
    "tiny runs": (tiny_runs, 2),
    "scene.toml": (scene_toml, 330),
    "scan.toml": (scan_toml, 190),
    "npz and npy": (arrays, 80),
    "packings": (packings, 60),
    "run.h5 of a packing": (packing_runs, 40),
    "journals": (journals, 30),
    "run.h5": (stored_runs, 35),
    "scan.h5": (stored_scans, 16),
    "checkpoint.h5": (checkpoints, 7),
    "kept states": (kept_states, 3),
    "histogram.h5": (histogram_files, 3),
}
