"""Honest runs with a single field forged: a number, a word or a type. Checksums are removed first: a forger would make
them anew. What proves and what is proven is held against the judgement made anew; the rest only checksums hold.
"""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.runs.verify import verify
from taichi_bearings.scene import Status
from tests.proof.honest import METHODS_OR_AUTO, contradictions
from tests.scenes import KNOWN_LAWS

RUNS = {
    "discs": {"shape": (4, 5)},
    "spheres": {"shape": (3, 3, 4), "spin_bottom": 0.1},
    "dampers": {"shape": (3, 3, 4), "law": "viscous"},
    "both": {"law": "coulomb-viscous", "shape": (3, 3, 4), "viscosity": "uniform:5,60"},
    "samples": {"shape": (3, 4), "replicas": 3, "distribution": "bimodal:1,2,0.5"},
    "descent": {"shape": (3, 3, 4), "method": "gradient-descent", "tolerance": 1e-3},
    "cut short": {"shape": (4, 4, 4), "method": "operator-splitting", "iterations": 20},
    "springs": {"shape": (3, 3, 4), "method": "cundall-strack", "duration": 0.2, "slip_threshold": 1e-4},
    "dashpots": {"shape": (4, 5), "law": "viscous", "method": "cundall-strack", "duration": 0.2},
    "rigid": {"shape": (3, 4), "method": "rigid-limit"},
    "states": {"shape": (3, 3, 4), "top": (1.0, 0.5, 0.0, 0.2), "bottom": (0.0, 0.0, 0.0, -0.4)},
    "ring": {"shape": (2, 4, 4), "periodic": ("x",)},
}
STATUSES = [status.value for status in Status]
WORDS = ("", "x", "Certified", "certified (gap 1e-16)", "uniform:0.1,1.1", *STATUSES, *KNOWN_LAWS, *METHODS_OR_AUTO)
ROUNDED = 1e-15  # what docs/proofs.md allows a gap to be off
PERIODIC_LISTS = ("[]", '["x"]', '["y"]', '["x", "y"]', '["z"]', '"x"', "4", "[[]]", "true")
FACTORS = (1 + 1e-9, 1 - 1e-9, 1 + 1e-6, 0.5, 2.0, -1.0)
Forgery = tuple[str, str, Callable[[h5py.File], None]]
"""What is done, the field, and the function of an open file that does it."""


def fields_of(path: Path) -> tuple[list[str], list[str]]:
    """Names of the attributes and of the data sets."""
    with h5py.File(path, "r") as file:
        sets: list[str] = []
        file.visititems(lambda name, item: sets.append(name) if isinstance(item, h5py.Dataset) else None)
        return [name for name in file.attrs if name not in ("scene", "sha256")], sets


def forged(path: Path, rng: np.random.Generator, field: str = "") -> Forgery | None:
    """One forgery of the run in this file, of this field or of any; None where what was drawn changes nothing."""
    attributes, sets = fields_of(path)
    chosen = [attributes, ["scene"], sets][rng.choice(3, p=[0.5, 0.2, 0.3])]
    name = field or str(rng.choice(chosen))
    with h5py.File(path, "r") as file:
        if name in attributes:
            old = file.attrs[name]
            new = _other(old.item() if np.ndim(old) == 0 and not isinstance(old, str) else old, rng)
            rounded = name == "gap" and _is_within_rounding(old, new)
            return (
                None
                if new is None or rounded
                else (f"{old!r} as {new!r}", name, lambda f: f.attrs.__setitem__(name, new))
            )
        if name == "scene":
            return _line_changed(str(file.attrs["scene"]), rng)
        return _data_changed(name, file[name][()], rng)


def _is_within_rounding(old, new) -> bool:
    kinds = {np.asarray(values).dtype.kind for values in (old, new)}
    return kinds == {"f"} and np.shape(new) == np.shape(old) and bool((np.abs(np.subtract(new, old)) < ROUNDED).all())


def _other(old, rng: np.random.Generator):
    """Another number, word or type in place of this one; None if it is the same."""
    if isinstance(old, np.ndarray):
        if old.size and rng.random() < 0.7:
            at, new = rng.integers(len(old)), old.copy()
            try:
                new[at] = rng.choice(WORDS) if old.dtype == object else _other(old[at].item(), rng)
            except (TypeError, ValueError):
                return None
            return None if new[at] == old[at] else new
        return rng.choice([0.0, 7.0, np.inf]) if rng.random() < 0.5 else np.append(old, old[:1]) if old.size else ["x"]
    if isinstance(old, str):
        new = [rng.choice(WORDS).item(), np.bytes_(old.encode() or b"x"), 1.0, [old, old]][
            rng.choice(4, p=[0.7] + [0.1] * 3)
        ]
        return None if isinstance(new, str) and new == old else new
    if rng.random() < 0.4:
        return [str(old), repr(old).encode(), [old, old], complex(old), not old, np.nan][rng.integers(6)]
    if isinstance(old, bool):
        return not old
    if isinstance(old, int):
        return [old + 1, old - 1, old + 0.9, float(old), -old - 1][rng.integers(5)]
    new = [*(old * factor for factor in FACTORS), old + 1.0, 0.0, np.inf, -np.inf][rng.integers(len(FACTORS) + 4)]
    return None if new == old else new


def _line_changed(scene: str, rng: np.random.Generator) -> Forgery | None:
    lines = scene.splitlines()
    number = int(rng.integers(len(lines)))
    key, _, value = lines[number].partition(" = ")
    if re.fullmatch(r'".*"', value):
        new = f'"{rng.choice(WORDS)}"' if rng.random() < 0.8 else "1.5"
    elif value in ("true", "false"):
        new = "true" if value == "false" else "false"
    elif key == "periodic":
        new = str(rng.choice(PERIODIC_LISTS))
    else:
        digits = list(re.finditer(r"-?\d+(\.\d+)?(e[-+]?\d+)?", value))
        one = digits[rng.integers(len(digits))]
        old = float(one[0])
        other = ['"4"', f"{old + 0.9!r}", "true", "inf", f"{int(old) + 1}", f"{-old - 1!r}", f"{old * (1 + 1e-9)!r}"]
        new = value[: one.start()] + other[rng.integers(7)] + value[one.end() :]
    if new == value:
        return None
    lines[number] = f"{key} = {new}"
    text = "\n".join(lines) + "\n"
    return f"{value} as {new}", f"scene.{key}", lambda file: file.attrs.__setitem__("scene", text)


def _data_changed(name: str, old: np.ndarray, rng: np.random.Generator) -> Forgery | None:
    if rng.random() < 0.1:
        kind = str(rng.choice(["S8", "i8", "c16"] if old.dtype.kind == "f" else ["S8", "f8"]))
        values = old.astype(kind)

        def replaced(file: h5py.File) -> None:
            del file[name]
            file[name] = values

        return f"as {kind}", name, replaced
    if not old.size:
        return None
    new, at = old.copy(), tuple(int(rng.integers(n)) for n in old.shape)
    if old.dtype.kind in "ui":
        new[at] = (int(old[at]) + int(rng.integers(1, 4))) % 4 if old.dtype.kind == "u" else old[at] + 1
    else:
        new[at] = [*(old[at] * factor for factor in FACTORS), 0.0, old[at] + 1, np.nan, np.inf][rng.integers(10)]
    if new[at] == old[at]:
        return None
    return f"{old[at]!r} as {new[at]!r} at {at}", name, lambda file: file[name].__setitem__(at, new[at])


def outcome(path: Path, forgery: Forgery, copy: Path) -> str:
    """What becomes of a forgery of the run at `path`: found, refused or missed."""
    change = forgery[2]
    shutil.copy(path, copy)
    with h5py.File(copy, "r+") as file:
        change(file)
    try:
        with np.errstate(invalid="ignore"):  # of infinite slips where nothing resists them
            report = verify(copy)
    except FileError:
        return "refused"
    return "missed" if report["verified"] else "found"


def honest_file(name: str, folder: Path) -> Path:
    """One of the RUNS, written into `folder` and without checksums."""
    assert contradictions(RUNS[name] | {"seed": 5}, folder) == []
    with h5py.File(folder / "run.h5", "r+") as file:
        del file.attrs["sha256"]
    return folder / "run.h5"
