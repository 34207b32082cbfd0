"""Reads which samples a scan consists of: a TOML file with the keys of a run, and lists, ranges and grids of them.

*Options of the scan* (`runs.settings.SCAN_OPTIONS`) change no result; to keep full states is one. An *axis* of the grid
is a key, or several keys that advance together.
"""

import hashlib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.plain_files import Json
from taichi_bearings.runs.run_file import file_of, refuse_run
from taichi_bearings.runs.settings import (
    MOST_SETTINGS_TEXT,
    NAMED_FILES,
    SCAN_OPTIONS,
    RunSettings,
    parse_assignment,
    placed,
    read_toml,
    refuse_unknown,
    settings_table,
    toml_text,
    toml_value,
)
from taichi_bearings.scene.initial_spins import STARTS

MOST_SAMPLES = 5_000_000  # most samples of a scan
RANGES = (
    "{ start, stop } with an optional step (stop excluded), or { start, stop, number } with spacing = "
    '"linear" or "log" (both ends included)'
)


@dataclass(frozen=True)
class Sample:
    """One sample of a scan.

    key : 16 hexadecimal digits, equal for samples that must have equal results.
    settings : settings of a run of this sample alone (replicas is 1).
    point : the scanned settings and their values, in the order of the file.
    """

    key: str
    settings: RunSettings
    point: Mapping[str, Any]

    @property
    def label(self) -> str:
        """The sample in words: ``seed = 3, spin_bottom = 0.1 (0123456789abcdef)``."""
        words = ", ".join(f"{name} = {written(value)}" for name, value in self.point.items())
        return f"{words} ({self.key})" if words else self.key


def _scan_options_in(document: Json) -> Json:
    """Remove the options of the scan itself (SCAN_OPTIONS, which change no result) from the content of a scan file, and
    return them by name. Raise InputError for values that are not allowed.

    document : keys and values of the file, changed in place.
    """
    return {name: item.read(name, document.pop(name)) for name, item in SCAN_OPTIONS.items() if name in document}


@dataclass(frozen=True)
class ScanPlan:
    """The samples of a scan, no two of them with the same key.

    scanned : names of the settings that vary.
    samples : all samples.
    settings : the scan as TOML, without the options of the scan itself.
    options : options of the scan itself that were given, by name; they change no result.
    """

    scanned: tuple[str, ...]
    samples: tuple[Sample, ...]
    settings: str
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The scan as TOML."""
        return toml_text(self.options) + self.settings

    def with_options_of(self, folder: Path) -> "ScanPlan":
        """Return this plan, with options of the scan (SCAN_OPTIONS) that it lacks taken from the scan.toml in a folder,
        where an earlier call has written them.

        folder : folder of the scan.
        """
        file = folder / "scan.toml"
        known = _scan_options_in(read_toml(file)) if file.is_file() else {}
        known |= self.options
        return replace(self, options={name: known[name] for name in SCAN_OPTIONS if name in known})


def groups_of(samples: Sequence[Sample]) -> list[list[Sample]]:
    """Return the samples in groups; within a group settings differ in the seed only. The order is that of `samples`."""
    groups: dict[tuple[object, ...], list[Sample]] = {}
    for sample in samples:
        alike = tuple(value for name, value in vars(sample.settings).items() if name != "seed")
        groups.setdefault(alike, []).append(sample)
    return list(groups.values())


def written(value: object) -> Any:
    """Return the value of a setting as tables show it: a list of numbers such as a shape becomes ``10x10``, one of axes
    ``x,y``.
    """
    if isinstance(value, tuple):
        return ("," if all(isinstance(part, str) for part in value) else "x").join(
            format(part, ".12g") if isinstance(part, float) else str(part) for part in value
        )
    return value


def read_plan(
    path: Path, overrides: Sequence[str] = (), options: Mapping[str, object] = MappingProxyType({})
) -> ScanPlan:
    """Return the plan that a scan file describes.

    path : TOML; settings of a run for all samples, options of the scan itself, and a table ``[scan]`` with a list or a
        range for each key that varies. The samples are the grid over all of them, the last key fastest; keys in one
        table ``[[scan.zip]]`` advance together. Without ``[scan]`` there is one sample.
    overrides : ``key=value`` fixes a key for all samples, ``scan.key=list or range`` scans it; values as in TOML, other
        words are texts.
    options : options of the scan itself, by name; they win over the file and the overrides.

    Raises InputError in one sentence.
    """
    document, axes = _read(path, overrides)
    document, scanned, table = document | dict(options), tuple(key for axis in axes for key in axis), settings_table()
    scan_options = _scan_options_in(document)
    for key in scanned:
        if key in table and table[key].not_scanned:
            raise InputError(f"{key} cannot be scanned: {table[key].not_scanned}")
        if key in document or scanned.count(key) > 1:
            raise InputError(f"{key} is given more than once in {path}; give it above [scan] or in one place of it")
    for key in ("replicas", "checkpoint_every"):
        if key in document:
            raise InputError(f"{key} is {document[key]!r} in a scan; leave it out: {table[key].not_scanned}")
    text = _text(document, axes)
    if len(text) > MOST_SETTINGS_TEXT - 1000:  # the rest is for the options of the scan
        raise InputError(
            f"{path} with its values written out takes {len(text):,} bytes, and at most {MOST_SETTINGS_TEXT:,} are "
            "read; use ranges instead of lists"
        )
    return ScanPlan(scanned, tuple(_samples(path, document, scanned, _points(axes))), text, scan_options)


Axis = Json  # keys that advance together, with the list or range of each


def _read(path: Path, overrides: Sequence[str] = ()) -> tuple[Json, list[Axis]]:
    """Return what a scan file says: the settings that all samples share, by key, and the axes of the grid, those of
    single keys first. An axis is a dictionary of keys that advance together, with the list or range of each.

    path : path of the TOML file.
    overrides : ``key=value`` texts of the option --set, which win over the file.
    """
    refuse_run(path)
    if path.suffix in (".h5", ".hdf5"):
        raise FileError(f"{path} holds results, not a scan file; `bearings scan {path.parent}` continues a scan there")
    document = read_toml(path)
    scan = document.pop("scan", {})
    if not isinstance(scan, dict):
        raise InputError(f"scan in {path} is {scan!r}; it must be a table [scan] of lists and ranges")
    # keys of [scan] that are scanned singly, and tables [[scan.zip]] of keys that advance together
    zipped = scan.pop("zip", [])
    if not isinstance(zipped, list) or not all(isinstance(table, Mapping) for table in zipped):
        raise InputError(f"zip in [scan] of {path} must be tables, each headed [[scan.zip]]")
    single, *zipped = (dict(table) for table in (scan, *zipped))
    for table in (single, *zipped):
        table |= {key: placed(table[key], path.parent) for key in NAMED_FILES if key in table}
    # an override replaces a key wherever the file has it
    for text in overrides:
        key, value = parse_assignment(text, "--set", "key=value or scan.key=list or range")
        name = key.removeprefix("scan.")
        refuse_unknown(name, f"--set {text!r}", SCAN_OPTIONS)
        for table in (document, single, *zipped):
            table.pop(name, None)
        (single if key.startswith("scan.") else document)[name] = value
    axes = [{key: given} for key, given in single.items()] + [table for table in zipped if table]
    return document, axes


def count_samples(path: Path) -> tuple[int, tuple[str, ...], Json]:
    """Return how many samples the scan file `path` asks for, the names of the scanned settings, and the settings that
    all samples share, by key. No sample is built.
    """
    document, axes = _read(path)
    return math.prod(map(len, _points(axes))), tuple(key for axis in axes for key in axis), document


def _samples(
    path: Path, document: Mapping[str, object], scanned: tuple[str, ...], axes: Sequence[Sequence[tuple[Any, ...]]]
) -> Iterator[Sample]:
    """Yield the samples of the grid.

    path : path of the scan file.
    document : settings that all samples share, by name.
    scanned : names of the settings that vary.
    axes : for each axis of the grid, the values of its settings, point by point.
    """
    base: RunSettings | None = None
    met: dict[str, Mapping[str, Any]] = {}
    for parts in itertools.product(*axes):
        given = dict(zip(scanned, itertools.chain.from_iterable(parts), strict=True))
        is_new = base is None or "coefficients" in given or given.get("packing", base.packing) != base.packing
        # unknown keys are refused here; a file of coefficients or a packing determines further settings
        if base is None or is_new:
            base = RunSettings.from_mapping({**document, **given}, str(path))
        settings = replace(base, **given)
        point = {name: getattr(settings, name) for name in scanned}
        key = sample_key(settings)
        if key in met:
            both = " and ".join(str({name: written(value) for name, value in p.items()}) for p in (met[key], point))
            raise InputError(f"two samples of {path} are the same: {both}; leave one of them out")
        met[key] = point
        yield Sample(key, settings, point)


def _points(axes: Sequence[Axis]) -> list[list[tuple[Any, ...]]]:
    """Return for each axis of the grid its points: tuples with the value of each of its settings. Raise InputError for
    more than MOST_SAMPLES samples.

    axes : for each axis a dictionary of settings that advance together, with the list or range of each.
    """
    points: list[list[tuple[Any, ...]]] = []
    for axis in axes:
        # Values of each setting of this axis; `most` is the number of points that MOST_SAMPLES leaves for the axis.
        columns, most = dict[str, list[Any]](), MOST_SAMPLES // math.prod(map(len, points))
        for key, given in axis.items():
            if isinstance(given, Mapping):
                count, value = _range(key, given)
            elif isinstance(given, list) and given:
                count, value = len(given), given.__getitem__
            else:
                raise InputError(
                    f"{key} in [scan] is {given!r}; it must be a list with at least one value, or {RANGES}"
                )
            if count > most:
                raise InputError(
                    f"{key} in [scan] has {count:,} values; with it the scan has more than {MOST_SAMPLES:,} samples,"
                    " the most that are allowed"
                )
            columns[key] = [value(number) for number in range(int(count))]
        if len(set(map(len, columns.values()))) > 1:
            words = ", ".join(f"{key} has {len(values)}" for key, values in columns.items())
            raise InputError(f"keys of one [[scan.zip]] need equally many values, but {words}")
        points.append(list(zip(*columns.values(), strict=True)))
    return points


def _range(key: str, table: Mapping[str, object]) -> tuple[float, Callable[[int], Any]]:
    """Return how many values a range has, and a function that gives each of them by its number from 0; whole numbers
    stay whole.

    key : name of the setting, for messages.
    table : the range: start and stop, with an optional step (stop excluded); or with a number of values, at least 2,
        and a spacing, "linear" or "log" (both ends included, and different; for "log" above 0).

    Raises InputError for anything else, and for a range without values.
    """
    get: Any = table.get
    is_spaced = "number" in table
    form = {"start", "stop", "number", "spacing"} if is_spaced else {"start", "stop", "step"}
    start, stop, step = get("start"), get("stop"), get("step", 1)
    number, spacing = get("number", 2), get("spacing", "linear")
    if (
        not {"start", "stop"} <= set(table) <= form
        or any(type(v) not in (int, float) or not math.isfinite(v) for v in (start, stop, step))
        or (type(number) is not int or number < 2 or spacing not in ("linear", "log"))
        or (is_spaced and (start == stop or (spacing == "log" and min(start, stop) <= 0)))
    ):
        raise InputError(f"{key} in [scan] is {toml_value(table)}; a range is {RANGES}")
    if is_spaced:  # both ends are exactly as they are given
        between: dict[str, Callable[[float], float]]  # value at a share, 0 to 1, of the way from start to stop
        between = {"linear": lambda share: start + (stop - start) * share, "log": lambda s: start * (stop / start) ** s}
        ends = {0: start, number - 1: stop}
        return number, lambda i: ends[i] if i in ends else between[spacing](i / (number - 1))
    steps = (stop - start) / step if step else 0.0
    count = math.ceil(steps - 1e-9) if abs(steps) < math.inf else math.inf  # 1.1 / 0.1 is rounded to more than 11
    if count < 1 or not steps > 0:
        raise InputError(f"{key} in [scan] is {toml_value(table)}, which has no values, since stop is excluded")
    return count, lambda i: start + i * step


def files_of(settings: RunSettings) -> list[tuple[str, str]]:
    """Return the files that a sample needs, as pairs: name of the setting that names the file, and name of the file.

    settings : settings of the sample.
    """
    return [(name, file) for name in NAMED_FILES if (file := getattr(settings, name)) not in (None, *STARTS)]


def sample_key(settings: RunSettings) -> str:
    """Return the key of a sample: a hash of all settings that may change its result.

    Only settings that differ from their defaults are hashed, so that an option that is added to the program later
    changes no key. Files are hashed by their content.
    """
    table = settings_table()
    values = {key: value for key, value in settings.given.items() if not table[key].not_scanned}
    values |= {name: content_of(file) for name, file in files_of(settings)}
    lines = [f"{name} = {value!r}" for name, value in sorted(values.items())]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def content_of(name: str) -> str:
    """Return a hash of the content of a file, or of the run.h5 in a run directory.

    name : name of the file or directory.
    """
    path = file_of(Path(name))
    if not path.is_file():
        raise FileError(f"{name} does not exist or is not a file")
    state = path.stat()
    return _content(name, path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=1024)
def _content(name: str, path: Path, *_: int) -> str:
    """Return the hash of a file's content. It is computed again only if time or size of the file has changed: these are
    the last arguments, so that the cache compares them.

    name : what the user calls the file, for messages.
    path : path of the file itself.
    """
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while piece := file.read(2**20):
                digest.update(piece)
    except OSError as error:
        raise FileError(f"{name} cannot be read: {error.strerror or error}") from None
    return digest.hexdigest()


def spheres_of(settings: RunSettings) -> int:
    """Return the number of spheres of a sample with these settings; raise FileError for a packing that cannot be read.

    settings : settings of one sample.
    """
    packing = settings.packing
    return math.prod(settings.shape) if packing is None else _spheres(packing, content_of(packing))


@lru_cache(maxsize=1024)
def _spheres(name: str, _: str) -> int:
    """Return the number of spheres in the packing file `name`.

    _ : hash of the content of the file: the cache keeps the result for each pair of name and hash.
    """
    from taichi_bearings.scene.packing import Packing  # and with it much of SciPy

    return len(Packing.read(name)["center"])


def _text(document: Mapping[str, object], axes: Sequence[Axis]) -> str:
    """Return a scan as TOML, including what --set has changed.

    document : settings that all samples share, by name.
    axes : axes of the grid, dictionaries of settings that advance together with the list or range of each.
    """
    text, is_zipped = toml_text(document), False
    for number, axis in enumerate(axes):
        is_zipped |= len(axis) > 1
        text += "[[scan.zip]]\n" if is_zipped else "[scan]\n" if number == 0 else ""
        text += toml_text(axis)
    return text or "\n"
