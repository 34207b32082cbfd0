"""Everything a run can be told, once: the command line, the TOML file and the stored scene all read this table."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.options import (
    COUNT,
    FILE,
    NOT_NEGATIVE,
    POSITIVE,
    REAL,
    SEED,
    TEXT,
    TRUTH,
    Kind,
    bounded,
    integer,
    numbers,
    one_of,
    real,
)
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers import METHODS

METHOD_NAMES = ("auto", *METHODS)


def _times(value: Any) -> str:
    from taichi_bearings.solvers.recording import parse_times

    if isinstance(value, bool) or (isinstance(value, list) and any(isinstance(part, bool) for part in value)):
        raise ValueError
    parts = [value] if isinstance(value, (int, float)) else value
    text = parts if isinstance(parts, str) else ",".join(repr(float(part)) for part in parts)
    parse_times(text)
    return text


SHAPE = Kind(numbers(integer, (2, 3)), "two or three whole numbers such as 32,32,32", "NX,NY[,NZ]")
VECTOR = Kind(numbers(real, (3,)), "three finite numbers such as 1,1,0", "X,Y,Z")
TIMES = Kind(_times, "times such as 0.1,0.2,1 or linear:0,10,101 or log:1e-4,10,50 (start,stop,count)", "TIMES")


def setting(default: Any, kind: Kind, help: str) -> Any:
    return field(default=default, metadata={"kind": kind, "help": help})


@dataclass(frozen=True)
class RunSettings:
    """One run, fully described. Values are checked when it is built; InputError names the key and what is allowed."""

    shape: tuple[int, ...] = setting((32, 32, 32), SHAPE, "Spheres along each axis, height last.")
    law: str = setting("coulomb", one_of(*LAWS), "Contact law.")
    method: str = setting("auto", one_of(*METHOD_NAMES), "auto is the fastest certified route for the scene.")
    tolerance: float = setting(
        1e-8,
        Kind(bounded(real, 0, 1, True), "above 0 and at most 1", "NUMBER"),
        "Relative gap (P - lower bound)/P at which the run counts as done.",
    )
    seed: int = setting(0, SEED, "Seed of the disorder.")
    replicas: int = setting(1, COUNT, "Solve seeds seed ... seed + replicas - 1 together.")
    spin_top: float = setting(1.0, REAL, "Imposed spin of the top.")
    spin_bottom: float = setting(0.0, REAL, "Imposed spin of the bottom.")
    direction: tuple[float, ...] = setting((1.0, 1.0, 0.0), VECTOR, "Axis of the driven spins in 3D, normalised.")
    coefficients: str | None = setting(
        None,
        FILE,
        "Read the coefficients instead of drawing them: an npz file with arrays x (NX-1,NY,NZ), y (NX,NY-1,NZ) and z "
        "(NX,NY,NZ-1), or a run. docs/scenes.md says more.",
    )
    distribution: str = setting(
        "uniform:0.1,1.0",
        TEXT,
        "Distribution of the coefficients: uniform:low,high, lognormal:median,sigma, "
        "power-law:low,high,exponent, bimodal:low,high,fraction or constant:value.",
    )
    viscosity: str = setting(
        "uniform:0.1,1.0", TEXT, "coulomb-viscous: distribution of the viscosities, as that of the coefficients."
    )
    initial: str = setting(
        "linear", TEXT, "Spins to start from: random, zero, linear, minimum-cut, or a file with an array `spin`."
    )
    normal_force: float = setting(50.0, POSITIVE, "Normal force at every contact.")
    radius: float = setting(0.5, POSITIVE, "Radius of the spheres.")
    iterations: int | None = setting(
        None,
        SEED,
        "Limit on iterations (sweeps, which come in pairs, or time steps). Default: 1000000, none with --duration.",
    )
    time_limit: float | None = setting(None, POSITIVE, "Limit on the wall time of the solve, in seconds.")
    duration: float | None = setting(
        None, POSITIVE, "dynamics: simulated time to go on for, whatever is reached. Default: until done."
    )
    record: str | None = setting(
        None,
        TIMES,
        "dynamics: simulated times of the rows of the history; the end gets one too. Default: at every check.",
    )
    snapshots: str | None = setting(None, TIMES, "dynamics: simulated times at which the spins are kept.")
    energy: bool = setting(False, TRUTH, "cundall-strack with gear: keep energy books; a step takes a third longer.")
    checkpoint_every: float | None = setting(
        None, POSITIVE, "dynamics: seconds between checkpoints, from which `bearings run --resume RUN` goes on."
    )
    slip_threshold: float | None = setting(
        None, POSITIVE, "Slip speed up to which a contact counts as slipless. Default: what the method can resolve."
    )
    settle: bool = setting(
        True, TRUTH, "interior-point: once certified, go on until every contact is known to slip or not."
    )
    momentum: bool = setting(True, TRUTH, "gradient-descent: accelerate; --no-momentum is the paper's plain method.")
    stiffness: float = setting(1e5, POSITIVE, "cundall-strack: tangential stiffness K_t.")
    damping: float = setting(1e3, NOT_NEGATIVE, "cundall-strack: tangential damping A_t.")
    mass: float = setting(1.0, POSITIVE, "dynamics: mass of a sphere.")
    inertia: float | None = setting(
        None, POSITIVE, "dynamics: moment of inertia. Default: m R^2/2 (disc), 2 m R^2/5 (sphere)."
    )
    static_ratio: float = setting(
        1.0, Kind(bounded(real, 1), "1 or more", "NUMBER"), "cundall-strack: static over kinetic friction, mu_s/mu_k."
    )
    slipping_spring: str = setting(
        "reset",
        one_of("reset", "relax"),
        "cundall-strack: while a contact slips its spring is reset to carry the friction alone, as in the paper, or "
        "relaxes to that through its damper.",
    )
    integrator: str = setting(
        "gear",
        one_of("gear", "implicit"),
        "cundall-strack: gear is explicit, implicit has no stability limit and chooses its steps.",
    )
    gear_order: int = setting(
        2,
        Kind(bounded(integer, 2, 5), "a whole number from 2 to 5", "N"),
        "cundall-strack with gear: derivatives kept by the predictor-corrector.",
    )
    time_step: float | None = setting(
        None, POSITIVE, "dynamics: fixed step. Default: 0.8 of the computed stability bound with gear, else by error."
    )
    error_tolerance: float | None = setting(
        None,
        POSITIVE,
        "dynamics with steps chosen by error: root mean square error of the spins in a step, relative to the largest "
        "spin. Default: 1e-3.",
    )
    rest_tolerance: float | None = setting(
        None, POSITIVE, "dynamics: change of P that counts as rest. Default: 1e-9, rigid-limit 1e-12."
    )
    arch: str = setting("cpu", one_of("cpu", "cuda", "vulkan", "metal", "auto"), "Device.")
    precision: str = setting("f64", one_of("f64", "f32"), "Precision of the fields; bounds are always f64.")
    threads: int = setting(0, SEED, "CPU threads; 0 for all.")
    figures: str = setting("all", one_of("all", "none"), "Figures to draw into the run directory.")

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if value is None and item.default is None:
                continue
            kind: Kind = item.metadata["kind"]
            try:
                object.__setattr__(self, item.name, kind.read(value))
            except (ValueError, TypeError, KeyError, OverflowError):
                shown = ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
                raise InputError(f"{item.name} is {shown!r}; it must be {kind.allowed}") from None

    @classmethod
    def keys(cls) -> tuple[str, ...]:
        return tuple(item.name for item in fields(cls))

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], source: str = "the settings") -> "RunSettings":
        """Settings from key-value pairs; an unknown key is refused, with the nearest known one."""
        for key in values:
            if key not in cls.keys():
                near = difflib.get_close_matches(key, cls.keys(), n=1)
                hint = f"; did you mean {near[0]!r}?" if near else f"; known keys are {', '.join(cls.keys())}"
                raise InputError(f"unknown key {key!r} in {source}{hint}")
        return cls(**values)

    def to_toml(self) -> str:
        """The same settings as TOML, every key with its resolved value; keys without a value are left out."""
        lines = [f"{key} = {toml_value(getattr(self, key))}" for key in self.keys() if getattr(self, key) is not None]
        return "\n".join(lines) + "\n"


def toml_value(value: Any) -> str:
    """A text, number, truth value, list or (inline) table as it is written in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + "".join(_escaped(letter) for letter in value) + '"'
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(part) for part in value) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {toml_value(part)}" for key, part in value.items()) + " }"
    return repr(value)


def _escaped(letter: str) -> str:
    is_control = ord(letter) < 0x20 or ord(letter) == 0x7F
    return f"\\u{ord(letter):04x}" if is_control else f"\\{letter}" if letter in '"\\' else letter


def read_toml(path: Path) -> dict[str, Any]:
    """Key-value pairs of a scene file; names of files in it are taken relative to its folder.

    path : a TOML file, a run directory (its scene.toml), or a run.h5 (its attribute `scene`).
    """
    if path.is_dir():
        path = path / "scene.toml"
    if not path.is_file():
        raise FileError(f"scene file {path} does not exist")
    try:
        text = _scene_of_run(path) if path.suffix in (".h5", ".hdf5") else path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"scene file {path} cannot be read: {error}") from None
    return parse_toml(text, path)


def parse_assignment(text: str, option: str, allowed: str) -> tuple[str, Any]:
    """Key and value of ``key=value`` on the command line, the value as in TOML, other words as a text.

    option, allowed : for the InputError, what it was given to and what it must be.
    """
    key, equals, word = text.partition("=")
    key = key.strip().replace("-", "_")
    if not equals or not key:
        raise InputError(f"{option} is {text!r}; it must be {allowed}")
    try:
        return key, parse_toml(f"value = {word}")["value"]
    except FileError:
        return key, word.strip()


def parse_toml(text: str, path: Path | None = None) -> dict[str, Any]:
    """Key-value pairs of a scene; names of files in it are taken relative to the folder of `path`, or to it if it is
    one; without it they stay as they are."""
    import sys

    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    try:
        values = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # too many digits or brackets too
        raise FileError(f"scene file {path} is not valid TOML: {error}") from None
    if path is None:
        return values
    folder = path if path.is_dir() else path.parent
    for key in ("coefficients", "initial"):
        value = values.get(key)
        if isinstance(value, str) and (folder / value).is_file():
            values[key] = str(folder / value)
    return values


def _scene_of_run(path: Path) -> str:
    import h5py

    from taichi_bearings.checksums import check

    with h5py.File(path, "r") as file:
        check(path, file)
        if "scene" not in file.attrs:
            raise FileError(f"{path} holds no scene; it was not written by `bearings run`")
        return str(file.attrs["scene"])
