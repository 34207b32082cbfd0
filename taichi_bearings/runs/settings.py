"""The settings of a run in one flat table, which the command line, TOML files and stored scenes all read.

Settings of every run are declared here. The options of a method are declared by its class in solvers/table.py.

key : the name of a setting. row : as a name, the class of a method.
"""

import json
import re
from collections.abc import Collection, Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import accumulate
from operator import attrgetter
from pathlib import Path
from sys import float_info
from typing import Any

from taichi_bearings.checksums import open_checked
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.options import (
    COUNT,
    FILE,
    POSITIVE,
    REAL,
    SEED,
    SHAPE,
    TEXT,
    TRUTH,
    Kind,
    OneOf,
    Option,
    bounded,
    how,
    numbers,
    option,
    options_of,
    real,
)
from taichi_bearings.plain_files import Json, read_whole
from taichi_bearings.runtime import ARCHITECTURES, PRECISIONS
from taichi_bearings.scene import Scene
from taichi_bearings.scene.array_files import read_coefficients
from taichi_bearings.scene.disorder import Distribution
from taichi_bearings.scene.law import LAWS
from taichi_bearings.scene.scene import periodic_axes
from taichi_bearings.solvers.table import METHODS, MethodOptions, row_of_packing
from taichi_bearings.text_lines import is_table
from taichi_bearings.words import meant, shown


def _read_times(value: Any) -> str:
    """Return simulated times as a text, such as "0.1,0.2" or "log:1e-4,10,50" (start, stop, count); raise ValueError
    for anything else.

    value : such a text, a number, or a list of numbers.
    """
    from taichi_bearings.solvers.recording import parse_times

    if isinstance(value, bool) or (isinstance(value, list) and any(isinstance(part, bool) for part in value)):
        raise ValueError
    parts = [value] if isinstance(value, (int, float)) else value
    text = parts if isinstance(parts, str) else ",".join(repr(float(part)) for part in parts)
    parse_times(text)
    return text


def _read_bearing_state(value: object) -> tuple[float, ...]:
    """Return a bearing state, (A_x, A_y, A_z, C) of spheres or (A_z,) of discs. A is the spin of a driven plane,
    1/time. C, 1/(time length), is the growth of component k of the spin for each unit of length along axis k; it is 0
    if three numbers are given. Raises ValueError unless the value is one, three or four real numbers.

    value : a text such as "1,1,0;0.2", or a list of numbers.
    """
    parts = numbers(REAL.read, (1, 3, 4))(value.replace(";", ",") if isinstance(value, str) else value)
    return (*parts, 0.0) if len(parts) == 3 else parts


BEARING_STATE = Kind(
    _read_bearing_state,
    "three numbers and C such as 1,1,0;0.2, in 2D one number, each 0 or of size 1e-15 to 1e15",
    "AX,AY,AZ[;C]",
)
PERIODIC_AXES = Kind(periodic_axes, "x, y or x,y, the axes that close on themselves", "x|y|x,y")
THREE_NUMBERS = Kind(numbers(real, (3,)), "three finite numbers such as 1,1,0", "X,Y,Z")
TIME_LIST = Kind(
    _read_times, "times such as 0.1,0.2,1 or linear:0,10,101 or log:1e-4,10,50 (start,stop,count)", "TIMES"
)


BETWEEN_PLANES = "planes"  # value of `driven` for a lattice between its bottom and its top plane
SIZES = ("radius", "normal_force")
OF_DRIVEN = ("shape", "periodic", "spin_top", "spin_bottom", "direction", "top", "bottom", "driven", "coefficients")
"""Keys that describe a lattice and what drives it; a packing from a file does not use them."""
OF_TABLES, OF_SIDES = ("contacts", "touching"), ("spin_top", "spin_bottom", "direction")
"""Keys that only a table of centres uses; and keys of a lattice that such a table uses too."""
MOST_TOUCHING = 0.05  # the largest gap at which spheres may touch, the same as that of contacts that are given
NAMED_FILES = ("coefficients", "packing", "contacts", "initial")  # keys that name files
DRIVING_KEYS = ("periodic", "top", "bottom", "driven")  # keys that summaries name where they are not the defaults

ALSO_CALLED = {
    "friction": "distribution", "mu": "distribution", "size": "shape", "lattice": "shape", "samples": "replicas",
    "output": "out", "solver": "method", "axis": "direction", "radii": "radius",
}  # fmt: skip
"""Words that users try for a setting, and the name that it has."""
motion = partial(option, methods=attrgetter("is_dynamics"))  # declares an option of dynamics alone


FORMS = Distribution.forms()  # how each distribution is written


@dataclass(frozen=True, init=False)
class RunSettings:
    """All settings of one run. They are checked when it is made; an InputError names the key and what is allowed.

    The options of methods are attributes as well.

    owned : names and values of the options of methods that are stored: all options of the method, and others that
        differ from their defaults. The method auto has no options of its own; all that were given are stored then.
    """

    shape: tuple[int, ...] = option((32, 32, 32), SHAPE, "Numbers of spheres along each axis, the height last.")
    law: str = option("coulomb", OneOf(table=LAWS), "Contact law.")
    method: str = how(
        "auto",
        OneOf("auto", table=METHODS),
        "Method that solves the scene; auto takes the fastest that can prove the result.",
    )
    tolerance: float = how(
        1e-8,
        Kind(bounded(real, 0, 1, True), "above 0 and at most 1", "NUMBER"),
        "The run is done when the relative gap (P - lower bound)/P of the power P is at most this.",
    )
    seed: int = option(0, SEED, "Seed from which the friction is drawn: the same seed gives the same sample.")
    replicas: int = how(
        1,
        COUNT,
        "Number of samples solved together, with the seeds seed ... seed + replicas - 1.",
        not_scanned="every seed is a sample of its own, so give seed a range",
    )
    spin_top: float = option(1.0, REAL, "Imposed spin of the top plane.", unit="1/time")
    spin_bottom: float = option(0.0, REAL, "Imposed spin of the bottom plane.", unit="1/time")
    direction: tuple[float, ...] = option(
        (1.0, 1.0, 0.0),
        THREE_NUMBERS,
        "Axis about which driven spheres rotate in 3D; its length does not matter.",
        dimensions=(3,),
    )
    top: tuple[float, ...] | None = option(
        None,
        BEARING_STATE,
        "Motion of the top plane, instead of spin_top and direction: AX,AY,AZ;C gives a sphere at the position r, a "
        "vector from the first sphere of the lattice, the spin vector A + C r, with opposite signs for neighbours. A "
        "is in 1/time, the number C in 1/(time*length). In 2D A alone, one number.",
        unit="1/time",
    )
    bottom: tuple[float, ...] | None = option(
        None,
        BEARING_STATE,
        "Motion of the bottom plane, in the form of --top. If only one of the two is given, the other plane is at "
        "rest.",
        unit="1/time",
    )
    periodic: tuple[str, ...] = option(
        (),
        PERIODIC_AXES,
        "Periodic axes, along which the last spheres touch the first. The height cannot be periodic. The number of "
        "spheres along a periodic axis must be even.",
    )
    driven: str = option(
        BETWEEN_PLANES,
        TEXT,
        "Which spheres are driven, as bottom and as top: planes, the lowest and the highest layer; walls, the first "
        "and the last layer along x; or shaft:r, all side walls, and the spheres within r diameters of the vertical "
        "axis in the middle. With walls or a shaft the lattice is solved as a packing (docs/packings.md).",
    )
    torque: float | None = how(
        None,
        REAL,
        "Drive the top by this torque about its axis instead of by a spin. The run finds whether friction "
        "holds the top at rest and, if not, how fast it rotates.",
        unit="force*length",
        methods=lambda method: not method.is_dynamics,
    )
    coefficients: str | None = option(
        None,
        FILE,
        "Read the coefficients of the contacts (friction or damping) instead of drawing them: an npz file with arrays "
        "x (NX-1,NY,NZ), y (NX,NY-1,NZ) and z (NX,NY,NZ-1), or a run. The file fixes the shape, too. docs/scenes.md "
        "says more.",
    )
    packing: str | None = option(
        None,
        FILE,
        "Spheres and contacts of any kind instead of a lattice: an npz or HDF5 file with arrays center, contact, "
        "driven and spin, a run of a packing, or a table of centres (.csv with the columns x,y[,z][,radius][,driven]). "
        "docs/packings.md says more.",
    )
    contacts: str | None = option(
        None,
        FILE,
        "File (.csv) with the contacts of a table of centres: columns first,second with the ids of two spheres, or "
        "without ids their numbers from 0. Default: contacts are found from the distances of the centres.",
    )
    touching: float | None = option(
        None,
        Kind(bounded(real, 0, MOST_TOUCHING), f"from 0 to {MOST_TOUCHING:g}", "NUMBER"),
        "Spheres of a table of centres touch where the distance of their centres differs from the sum of their radii "
        "by no more than this share of the sum. Default: 0.001.",
    )
    distribution: str = option(
        "uniform:0.1,1.0",
        TEXT,
        f"Distribution from which the coefficients of the contacts are drawn: {', '.join(FORMS[:-1])} or {FORMS[-1]}.",
    )
    viscosity: str = option(
        "uniform:0.1,1.0",
        TEXT,
        "Distribution from which the viscosities of the contacts are drawn, in the form of --distribution.",
        unit="force*time/length",
        laws=lambda law: len(law.quantities) > 1,
    )
    initial: str = how(
        "linear",
        TEXT,
        "Spins to start from: random, zero, linear (from bottom to top), minimum-cut (each sphere turns with the "
        "bottom or the top), or a file with an array `spin`.",
    )
    normal_force: float = option(
        50.0, POSITIVE, "Normal force at every contact.", unit="force", laws=attrgetter("has_friction")
    )
    radius: float = option(0.5, POSITIVE, "Radius of the spheres.", unit="length", rare=True)
    iterations: int | None = how(
        None,
        SEED,
        "Limit on iterations (of a dynamics: time steps; of gradient-descent: sweeps over all contacts, made two at a "
        "time). Default: 1000000, none with --duration.",
    )
    time_limit: float | None = how(
        None, POSITIVE, "Limit on the wall time of the solve, after which the result so far is written.", unit="s"
    )
    duration: float | None = motion(
        None,
        POSITIVE,
        "Simulated time at which a dynamics ends, whatever gap it has reached. Default: it ends once its gap is within "
        "--tolerance or the motion is at rest.",
        unit="time",
    )
    record: str | None = motion(
        None,
        TIME_LIST,
        "Simulated times at which a row is added to the history; one at the end of the run is added in any case. "
        "Default: a row at each check for convergence.",
        unit="time",
        of_solving=True,
    )
    snapshots: str | None = motion(
        None, TIME_LIST, "Simulated times at which all spins are stored.", unit="time", of_solving=True
    )
    checkpoint_every: float | None = option(
        None,
        POSITIVE,
        "Seconds between two checkpoints, from which `bearings run --resume RUN` continues.",
        unit="s",
        methods=attrgetter("keeps_checkpoints"),
        of_solving=True,
        not_scanned="a scan keeps whole samples, not checkpoints",
    )
    slip_threshold: float | None = how(
        None,
        POSITIVE,
        "Slip speed up to which a contact counts as slipless, whatever is proven of it. Default: the smallest slip "
        "that the method can tell from 0, used only where no proof decides.",
        unit="length/time",
        rare=True,
    )
    arch: str = how(
        "cpu",
        OneOf(*ARCHITECTURES),
        "Device on which the iterations run; auto takes a GPU if one can be used, else the CPU.",
    )
    precision: str = how(
        "f64",
        OneOf(*PRECISIONS),
        "Precision of the iterations: f64 (double) or f32 (single). Bounds are always computed in f64, as is "
        "everything by planar-cut, interior-point, linear-solver and rigid-limit.",
        rare=True,
    )
    threads: int = how(
        0,
        SEED,
        "Number of CPU threads; 0 for all.",
        not_scanned="it changes no result, so set it for all samples",
        rare=True,
    )
    figures: str = how(
        "all",
        OneOf("all", "none"),
        "Figures drawn into the run directory: all, which are power_histogram.png and, for methods with iterations, "
        "history.png; or none.",
    )
    owned: tuple[tuple[str, Any], ...] = ()

    def __init__(self, owned: tuple[tuple[str, Any], ...] = (), **given: object) -> None:
        """Read and check all settings; those that are not given have their defaults.

        owned : names and values of options of methods, which are no fields of this class.
        given : values by key, as texts or numbers. An unknown key raises TypeError, a wrong value InputError.
        """
        given, table = dict(owned) | given, settings_table()
        values = {key: item.read(key, given.get(key, item.default)) for key, item in table.items()}
        if unknown := given.keys() - table.keys():
            raise TypeError(f"a run has no setting {', '.join(sorted(unknown))}")
        # stored are values that differ from their defaults, and all options of the method; for "auto" those given
        method = values["method"]
        kept = {key for key, value in values.items() if value != table[key].default}
        kept |= options_of(METHODS[method]).keys() if method in METHODS else given.keys()
        vars(self).update(values, owned=self._owned(values, kept))

    @classmethod
    def _owned(cls, values: Mapping[str, Any], kept: Collection[str]) -> tuple[tuple[str, Any], ...]:
        """Return names and values of the options of methods that are stored, in the order of `values`.

        values : all settings by key.
        kept : keys that are stored; those of settings of every run are left out here.
        """
        return tuple((key, values[key]) for key in values if key in kept and key not in cls.__dataclass_fields__)

    @classmethod
    def keys(cls) -> tuple[str, ...]:
        """Return all keys, those of methods included."""
        return tuple(settings_table())

    def of_replica(self, seed: int) -> "RunSettings":
        """Return the settings of one sample, which has this seed. No value is checked again."""
        one = copy(self)
        vars(one).update(seed=seed, replicas=1)
        return one

    @property
    def values(self) -> Json:
        """Values of all keys: the settings of every run, and the options of methods that are stored."""
        return {key: getattr(self, key) for key in self.__dataclass_fields__ if key != "owned"} | dict(self.owned)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], source: str = "the settings") -> "RunSettings":
        """Return the settings that key-value pairs describe.

        values : the pairs, as in a scene file or from options.
        source : where the pairs come from, for messages.

        Raises InputError for an unknown key, with the nearest known one. A file of coefficients determines the shape,
        and the periodic sides unless some are given; a packing file with viscosity the law coulomb-viscous unless a law
        is given.
        """
        for key in values:
            refuse_unknown(key, source)
        settings = cls(**values)
        if settings.packing is not None:
            from taichi_bearings.scene.packing import Packing  # and with it much of SciPy

            viscous = "law" not in values and "viscosity" in Packing.read(settings.packing, settings.contacts)
            return replace(settings, law="coulomb-viscous") if viscous else settings
        if "shape" in values or settings.coefficients is None:
            return settings
        lattice = Lattice.of(read_coefficients(Path(settings.coefficients)))
        return replace(settings, shape=lattice.shape, periodic=settings.periodic or lattice.periodic_names)

    def to_toml(self) -> str:
        """Return the settings as TOML, in which defaults are written out; keys whose value is None are left out."""
        return toml_text({key: value for key, value in self.described.items() if value is not None})

    @property
    def seeds(self) -> range:
        """The seeds of all replicas."""
        return range(self.seed, self.seed + self.replicas)

    @property
    def is_packing(self) -> bool:
        """True for a packing from a file, and for a lattice whose driven bodies are no planes."""
        return self.packing is not None or self.driven != BETWEEN_PLANES

    @property
    def has_table(self) -> bool:
        """True for a packing from a table of centres (.csv)."""
        return self.packing is not None and is_table(self.packing)

    @property
    def drawn(self) -> dict[str, str]:
        """Distributions from which the coefficients of the law are drawn, by key, unless the coefficients are given."""
        return {key: getattr(self, key) for key in ("distribution", "viscosity")[: len(LAWS[self.law].quantities)]}

    @property
    def described(self) -> Json:
        """Keys and values that describe the run: all of them for a lattice; for a packing from a file the law, the
        seed, and what differs from its default.
        """
        return self.values if self.packing is None else {"law": self.law, "seed": self.seed} | self.given

    @property
    def given(self) -> Json:
        """The keys whose values differ from their defaults, with these values."""
        table = settings_table()
        return {key: value for key, value in self.values.items() if value != table[key].default}

    @property
    def driving(self) -> Json:
        """Keys and values of the driving that differ from their defaults: periodic sides, imposed states and driven
        bodies.
        """
        given = self.given
        return {key: list(v) if isinstance(v := given[key], tuple) else v for key in DRIVING_KEYS if key in given}

    def unused(self, method: type[MethodOptions]) -> dict[str, str]:
        """Return the keys that the user has set but that have no effect with this method, law or packing, each with a
        sentence that says why.

        method : class of the method in the table of methods.
        """
        table, law, unused = settings_table(), LAWS[self.law], {}
        has_states = self.top is not None or self.bottom is not None
        minimises = self.is_packing and row_of_packing(self.method) is None
        for key, value in self.given.items():
            methods, laws = users_of(table[key])
            needs = [] if method.name in methods else [f"--method {' or '.join(methods)}"]
            needs += [] if law.name in laws else [f"--law {' or '.join(laws)}"]
            # the first reason that applies
            if self.has_table and key in OF_SIDES:
                continue
            if self.packing is not None and key in OF_DRIVEN:
                why = "a packing does not use it"
            elif key in OF_TABLES and not self.has_table:
                why = "only a packing that is a table of centres (.csv) uses it"
            elif key == "touching" and self.contacts is not None:
                why = f"contacts are those of {self.contacts}; leave one of the two out"
            elif needs:
                why = f"{method.name} with the law {law.name} does not use it; it needs {' and '.join(needs)}"
            elif minimises and key == "initial":
                why = f"method {self.method} of a packing does not use it"
            elif len(self.shape) not in table[key].dimensions:
                why = "spins of discs point along z; it needs three sides"
            elif key in Scene.BY_SPINS and has_states:
                why = "the planes have the states top and bottom; leave one of the two out"
            elif key in ("distribution", "viscosity") and self.coefficients is not None:
                why = f"the coefficients are those of {self.coefficients}; leave one of the two out"
            else:
                continue
            unused[key] = f"{key} is {shown(value)}, but {why}"
        return unused

    def fitting(self, method: type[MethodOptions], strict: bool = True) -> "RunSettings":
        """Return the settings with unused keys set to their defaults. Options of other methods than this one are not
        stored.

        method : class of the method whose options are used.
        strict : True to raise InputError instead if a key was given that is not used.
        """
        unused = self.unused(method)
        if unused and strict:
            raise InputError(next(iter(unused.values())))
        one = replace(self, **{key: settings_table()[key].default for key in unused}) if unused else copy(self)
        vars(one).update(owned=self._owned(vars(one), options_of(method)))
        return one


def users_of(item: Option) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return two tuples of names: the methods, and the laws, that use an option of a run.

    item : the option. If it has no condition on methods (laws), all of them use it.
    """
    methods = tuple(name for name, row in METHODS.items() if item.methods is None or item.methods(row))
    return methods, tuple(name for name, law in LAWS.items() if item.laws is None or item.laws(law))


SCAN_OPTIONS = {  # options of a scan that apply to every sample
    "analyse": Option(
        None, TRUTH,
        "Add the numbers of `bearings analyse` for every sample, as columns. [default: as in "
        "an earlier call for this folder]",
    ),
    "keep_states": Option(
        None, TRUTH,
        "Keep spins, slips and forces of every sample too, as states/<sample>.h5 in the layout of run.h5. "
        "[default: as in an earlier call for this folder]",
    ),
    "sample_timeout": Option(
        None, Kind(bounded(real, 0, float_info.max, open_low=True), "a positive number of seconds", "SECONDS"),
        "End the solve of a sample that takes longer. [default: 100 times the expected time, at least 600; "
        "dynamics: none]",
    ),
}  # fmt: skip


def settings_table() -> dict[str, Option]:
    """Return the options of a run by key: those of every run, then those of the methods, in the order of these."""
    return _options_by_key(tuple(METHODS.values()))


@lru_cache(maxsize=8)
def _options_by_key(rows: tuple[type[MethodOptions], ...]) -> dict[str, Option]:
    """Return the options of a run by key. If several methods have an option with different defaults, its default here
    is None.

    rows : the classes of all methods.
    """
    owners: dict[str, dict[type[MethodOptions], Option]] = {}
    for row in rows:
        for key, item in options_of(row).items():
            owners.setdefault(key, {})[row] = item
    found = options_of(RunSettings)
    for key, items in owners.items():
        first, defaults = next(iter(items.values())), {item.default for item in items.values()}
        default = first.default if len(defaults) == 1 and not first.unset else None
        found[key] = replace(first, default=default, methods=frozenset(items).__contains__)
    return found


def refuse_unloaded(scene: Mapping[str, object], path: Path) -> None:
    """Raise FileError for a stored scene that names a law, a method or an option of a method that is not loaded.

    scene : its settings by key, as the program has written them.
    path : the file that stores it, for the message.
    """
    for key, table, define in (("law", LAWS, "defines"), ("method", {"auto": None, **METHODS}, "registers")):
        name = scene.get(key)
        if isinstance(name, str) and name not in table:
            raise FileError(
                f"{path} has the {key} {shown(name)}; known are {', '.join(table)}, and {key}s of one's own once the "
                f"file that {define} them is imported"
            )
    if unknown := [key for key in scene if key not in RunSettings.keys()]:
        raise FileError(
            f"{path}: its scene has the option {unknown[0]!r} of a method that is not loaded; import the file that "
            "registers it"
        )


def without_unloaded(scene: Mapping[str, object]) -> Json:
    """Return a stored scene in which a method that is not loaded has become "auto", and without options that are not
    known: what its numbers prove depends on neither.

    scene : its settings by key.
    """
    found = {key: value for key, value in scene.items() if key in RunSettings.keys()}
    if isinstance(name := found.get("method"), str) and name not in METHODS:
        found["method"] = "auto"
    return found


def toml_text(values: Mapping[str, object]) -> str:
    """Return keys and values as TOML, one line for each key."""
    return "".join(f"{key} = {toml_value(value)}\n" for key, value in values.items())


def toml_value(value: object) -> str:
    """Return a text, number, truth value, list or (inline) table as it is written in TOML."""
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(part) for part in value) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {toml_value(part)}" for key, part in value.items()) + " }"
    written = json.dumps(value, ensure_ascii=False, default=str)  # as in JSON, but for one letter that must be escaped
    return written.replace("\x7f", "\\u007f")


MOST_SETTINGS_TEXT = 2**22  # the largest file of settings, bytes
MOST_NESTED = 20  # depth of nested lists and tables, and number of dots in a key
MOST_DOTS = 20_000  # dots in all dotted keys together
PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')"""  # part of a dotted key, bare or quoted
DOTTED = re.compile(rf"(?<![\w-]){PART}(?:[ \t]*\.[ \t]*{PART}){{2,}}")  # keys of three parts and more; no number has


def read_toml(path: Path) -> Json:
    """Return the key-value pairs of a file of settings; names of files in it are taken relative to its folder.

    path : a TOML file; a run directory, whose scene.toml is read; or a run.h5, whose attribute `scene` is read.

    Raises FileError for a file that is missing or cannot be read.
    """
    if path.is_dir():
        path = path / "scene.toml"
    if not path.is_file():
        raise FileError(f"scene file {path} does not exist")
    if path.suffix in (".h5", ".hdf5"):
        with open_checked(path, "a run") as file:
            if "scene" not in file.attrs:
                raise FileError(f"{path} holds no scene; it was not written by `bearings run`")
            return parse_toml(str(file.attrs["scene"]), path)
    try:
        return parse_toml(read_whole(path, MOST_SETTINGS_TEXT).decode(), path)
    except UnicodeDecodeError:
        hint = "; --coefficients or --packing reads arrays" if path.suffix == ".npz" else ""
        raise FileError(f"scene file {path} is not a text in UTF-8{hint}") from None


def refuse_unknown(key: str, source: str, others: Collection[str] = ()) -> None:
    """Raise InputError, with the nearest known key, for a key that is no setting of a run.

    key : the key.
    source : where it comes from, for the message.
    others : keys that are known there, too.
    """
    if key not in RunSettings.keys() and key not in others:
        likely = ALSO_CALLED.get(key.replace("-", "_"), key)
        hint = meant(likely, RunSettings.keys()) or f"; known keys are {', '.join(RunSettings.keys())}"
        raise InputError(f"unknown key {key!r} in {source}{hint}")


def parse_assignment(text: str, option: str, allowed: str) -> tuple[str, Any]:
    """Return key and value of a text ``key=value`` from the command line.

    The value is read as TOML; what is no TOML is taken as a text.

    option, allowed : for messages, the option and what its value must be.

    Raises InputError for other texts.
    """
    key, equals, word = text.partition("=")
    key = key.strip().replace("-", "_")
    if not equals or not key:
        raise InputError(f"{option} is {text!r}; it must be {allowed}")
    try:
        return key, parse_toml(f"value = {word}")["value"]
    except FileError:
        return key, word.strip()


def parse_toml(text: str, path: Path | None = None) -> Json:
    """Return the key-value pairs in a text of TOML; raise FileError if it is not valid.

    path : the file that the text was read from, or a folder: names of files in the text are taken relative to that
        folder. None to leave them as they are.
    """
    import sys

    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    try:  # texts that would exhaust Python's stack, or take too much memory or time, are refused
        if len(text) > MOST_SETTINGS_TEXT:
            raise ValueError(f"it is longer than {MOST_SETTINGS_TEXT:,} characters, the most that this program reads")
        is_deep = text.count("[") + text.count("{") > 5 * MOST_NESTED
        if is_deep and max(accumulate((letter in "[{") - (letter in "]}") for letter in text)) > 5 * MOST_NESTED:
            raise ValueError("the brackets of lists and tables do not close")
        dots = [found[0].count(".") for found in DOTTED.finditer(text)]
        if max(dots, default=0) > MOST_NESTED or sum(dots) > MOST_DOTS:
            raise ValueError(f"a key may have at most {MOST_NESTED} dots, and all keys together {MOST_DOTS:,}")
        values = tomllib.loads(text)
        _refuse_unwritable(values)
    except (ValueError, RecursionError) as error:  # too many digits or brackets too
        where = "the scene" if path is None else f"scene file {path}"
        raise FileError(f"{where} is not valid TOML: {error}") from None
    if path is None:
        result: Json = values
        return result
    folder = path if path.is_dir() else path.parent
    result = values | {key: placed(values[key], folder) for key in NAMED_FILES if key in values}
    return result


def placed(value: object, folder: Path) -> Any:
    """Return the name of a file with a folder put before it, if the folder has such a file; else the name as it is. A
    list of names gives a list.

    value : a name or a list of names; anything else is returned as it is.
    folder : the folder.
    """
    if isinstance(value, list):
        return [placed(part, folder) for part in value]
    return str(folder / value) if isinstance(value, str) and (folder / value).is_file() else value


def _refuse_unwritable(value: object, depth: int = 0) -> None:
    """Raise ValueError for integers of more than 64 bits, and for values nested too deeply, which TOML allows.

    value : a value as TOML may have it, such as a number, a text, a list or a table.
    depth : how deep the value itself is nested.
    """
    if isinstance(value, int) and value.bit_length() > 64:
        raise ValueError("a whole number needs more than 64 bits, the most that is read")
    if depth > MOST_NESTED:
        raise ValueError(f"lists and tables are nested more than {MOST_NESTED} deep")
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _refuse_unwritable(part, depth + 1)
