"""Which samples a scan consists of: a TOML file with the keys of a run, and lists, ranges and grids of them."""

import hashlib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from sys import float_info
from types import MappingProxyType
from typing import Any

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.options import TRUTH, Kind, Option, bounded, real
from taichi_bearings.runs.run_file import refuse_run
from taichi_bearings.runs.settings import (
    MOST_SETTINGS_TEXT,
    RunSettings,
    parse_assignment,
    read_toml,
    settings_table,
    toml_value,
)
from taichi_bearings.scene.initial_spins import STARTS

MOST_SAMPLES = 5_000_000
RANGES = (
    "{ start, stop } with an optional step (stop excluded), or { start, stop, number } with spacing = "
    '"linear" or "log" (both ends included)'
)


@dataclass(frozen=True)
class Sample:
    """One point of a scan.

    key : 16 hexadecimal digits, the same for all samples with the same result. settings : replicas is 1.
    point : the scanned keys and their values, in the order of the file.
    """

    key: str
    settings: RunSettings
    point: Mapping[str, Any]

    @property
    def label(self) -> str:
        """The sample for people: ``seed = 3, spin_bottom = 0.1 (0123456789abcdef)``."""
        words = ", ".join(f"{name} = {written(value)}" for name, value in self.point.items())
        return f"{words} ({self.key})" if words else self.key


NAMED_FILES = ("coefficients", "packing", "initial")  # keys that name files
WISHES = {  # what may be asked of every sample beside the numbers of `run`
    "analyse": Option(None, TRUTH, "The numbers of `bearings analyse` too."),
    "keep_states": Option(None, TRUTH, "The full state too."),
    "sample_timeout": Option(
        None, Kind(bounded(real, 0, float_info.max, open_low=True), "a positive number of seconds", "SECONDS"),
        "Time that a sample may take.", unit="s",
    ),
}  # fmt: skip


def _wishes_in(document: dict[str, Any]) -> dict[str, Any]:
    """The wishes of a scan file by name, whose other keys stay in `document`; InputError for values not allowed."""
    return {name: item.read(name, document.pop(name)) for name, item in WISHES.items() if name in document}


@dataclass(frozen=True)
class ScanPlan:
    """The samples of a scan, no two with the same key. scanned : keys that vary. settings : the scan as TOML, but for
    the wishes. wishes : those of WISHES about which it says something."""

    scanned: tuple[str, ...]
    samples: tuple[Sample, ...]
    settings: str
    wishes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The scan as TOML."""
        return "".join(f"{name} = {toml_value(value)}\n" for name, value in self.wishes.items()) + self.settings

    def going_on_in(self, folder: Path) -> "ScanPlan":
        """The plan with what the scan in a folder was asked for before, where this one says nothing."""
        file = folder / "scan.toml"
        known = _wishes_in(read_toml(file)) if file.is_file() else {}
        known |= self.wishes
        return replace(self, wishes={name: known[name] for name in WISHES if name in known})


def groups_of(samples: Sequence[Sample]) -> list[list[Sample]]:
    """The samples whose settings differ in nothing but the seed, together; otherwise in their order."""
    groups: dict[tuple[Any, ...], list[Sample]] = {}
    for sample in samples:
        alike = tuple(value for name, value in vars(sample.settings).items() if name != "seed")
        groups.setdefault(alike, []).append(sample)
    return list(groups.values())


def written(value: Any) -> Any:
    """A value of a setting as a table holds it: a list such as a shape becomes ``10x10``, one of axes ``x,y``."""
    if isinstance(value, tuple):
        return ("," if all(isinstance(part, str) for part in value) else "x").join(
            format(part, ".12g") if isinstance(part, float) else str(part) for part in value
        )
    return value


def read_plan(path: Path, overrides: Sequence[str] = (), wishes: Mapping[str, Any] = MappingProxyType({})) -> ScanPlan:
    """The plan that a scan file describes.

    path : TOML; keys of `run` for all samples, those of WISHES, and a table ``[scan]`` with a list or a
        range for each key that varies. The samples are the grid over all of them, the last key fastest; keys in one
        table ``[[scan.zip]]`` advance together and count as one axis. Without ``[scan]`` there is one sample.
    overrides : ``key=value`` fixes a key for all samples, ``scan.key=list or range`` scans it; values as in TOML, other
        words are texts.
    wishes : some of WISHES; they win over the file and the overrides.
    Raises InputError in one sentence.
    """
    document, single, tables = _read(path, overrides)
    return _plan(path, document | dict(wishes), single, tables)


Tables = tuple[dict[str, Any], dict[str, Any], list[dict[str, Any]]]


def _read(path: Path, overrides: Sequence[str] = ()) -> Tables:
    """Keys for all samples; those that vary alone; those of each table that advance together."""
    refuse_run(path)
    if path.suffix in (".h5", ".hdf5"):
        raise FileError(f"{path} holds results and describes no scan; `bearings scan {path.parent}` goes on with one")
    document = read_toml(path)
    scan = document.pop("scan", {})
    if not isinstance(scan, Mapping):
        raise InputError(f"scan in {path} is {scan!r}; it must be a table [scan] of lists and ranges")
    zipped = scan.get("zip", [])
    if not isinstance(zipped, list) or not all(isinstance(table, Mapping) for table in zipped):
        raise InputError(f"zip in [scan] of {path} must be tables, each headed [[scan.zip]]")
    single = {key: _located(key, values, path.parent) for key, values in scan.items() if key != "zip"}
    tables = [{key: _located(key, values, path.parent) for key, values in table.items()} for table in zipped]
    for text in overrides:
        _override(text, document, single, tables)
    return document, single, [table for table in tables if table]


def count_samples(path: Path) -> tuple[int, tuple[str, ...], dict[str, Any]]:
    """How many samples a scan file asks for, over which keys, and the keys that all have alike; no sample is built."""
    document, single, tables = _read(path)
    axes = _axes(single, tables)
    return math.prod(len(values) for _, values in axes), tuple(key for keys, _ in axes for key in keys), document


def _located(key: str, values: Any, folder: Path) -> Any:
    """Names of files relative to where the program runs, no longer to the folder of the scan file."""
    if key not in NAMED_FILES or not isinstance(values, list):
        return values
    return [str(folder / v) if isinstance(v, str) and (folder / v).is_file() else v for v in values]


def _override(text: str, document: dict[str, Any], single: dict[str, Any], tables: list[dict[str, Any]]) -> None:
    """Change the scan as ``--set key=value`` says."""
    key, value = parse_assignment(text, "--set", "key=value or scan.key=list or range")
    name = key.removeprefix("scan.")
    document.pop(name, None)
    for table in (single, *tables):
        table.pop(name, None)
    (single if key.startswith("scan.") else document)[name] = value


def _plan(path: Path, document: dict[str, Any], single: dict[str, Any], tables: list[dict[str, Any]]) -> ScanPlan:
    wishes, table = _wishes_in(document), settings_table()
    axes = _axes(single, tables)
    scanned = tuple(key for keys, _ in axes for key in keys)
    for key in scanned:
        if key in table and table[key].not_scanned:
            raise InputError(f"{key} cannot be scanned: {table[key].not_scanned}")
        if key in document or scanned.count(key) > 1:
            raise InputError(f"{key} is given more than once in {path}; give it above [scan] or in one place of it")
    for key in ("replicas", "checkpoint_every"):
        if key in document:
            raise InputError(f"{key} is {document[key]!r} in a scan; leave it out: {table[key].not_scanned}")
    text = _text(document, single, tables)
    if len(text) > MOST_SETTINGS_TEXT - 1000:  # which wishes may take
        raise InputError(
            f"{path} takes {len(text):,} bytes written in full, and at most {MOST_SETTINGS_TEXT:,} are read; use ranges"
        )
    samples = tuple(_samples(path, document, scanned, [values for _, values in axes]))
    return ScanPlan(scanned, samples, text, wishes)


def _axes(
    single: Mapping[str, Any], tables: Sequence[Mapping[str, Any]]
) -> list[tuple[tuple[str, ...], list[tuple[Any, ...]]]]:
    """The keys of each axis of the grid, and their values at its points; not too many in all."""
    axes: list[tuple[tuple[str, ...], list[tuple[Any, ...]]]] = []
    number = 1
    for part in [*({key: given} for key, given in single.items()), *tables]:
        axes.append(_zip(part, MOST_SAMPLES // number))
        number *= len(axes[-1][1])
    return axes


def _samples(
    path: Path, document: Mapping[str, Any], scanned: tuple[str, ...], axes: Sequence[Sequence[tuple[Any, ...]]]
) -> Iterator[Sample]:
    base: RunSettings | None = None
    met: dict[str, Mapping[str, Any]] = {}
    for parts in itertools.product(*axes):
        given = dict(zip(scanned, itertools.chain.from_iterable(parts), strict=True))
        is_new = base is None or "coefficients" in given or given.get("packing", base.packing) != base.packing
        if base is None or is_new:  # checked for unknown keys; and files say more than their names
            base = RunSettings.from_mapping({**document, **given}, str(path))
        settings = replace(base, **given)
        point = {name: getattr(settings, name) for name in scanned}
        key = sample_key(settings)
        if key in met:
            both = " and ".join(str({name: written(value) for name, value in p.items()}) for p in (met[key], point))
            raise InputError(f"two samples of {path} are the same: {both}")
        met[key] = point
        yield Sample(key, settings, point)


def _zip(table: Mapping[str, Any], most: int) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Keys that advance together, as one axis: their names, and their values at each of its points, `most` of them."""
    columns = {key: _values(key, given, most) for key, given in table.items()}
    lengths = {key: len(values) for key, values in columns.items()}
    if len(set(lengths.values())) > 1:
        words = ", ".join(f"{key} has {length}" for key, length in lengths.items())
        raise InputError(f"keys of one [[scan.zip]] need equally many values, but {words}")
    return tuple(columns), list(zip(*columns.values(), strict=True))


def _values(key: str, given: Any, most: int) -> list[Any]:
    """The values of one scanned key."""
    values = _range(key, given, most) if isinstance(given, Mapping) else given
    if isinstance(values, list) and len(values) > most:
        raise _too_many(key, len(values))
    if not isinstance(values, list) or not values:
        raise InputError(f"{key} in [scan] is {given!r}; it must be a list with at least one value, or {RANGES}")
    return values


def _range(key: str, table: Mapping[str, Any], most: int) -> list[Any]:
    """A range written as a table. Whole numbers stay whole. No list of more than `most` is made."""
    form = {"start", "stop", "number", "spacing"} if "number" in table else {"start", "stop", "step"}
    bad = InputError(f"{key} in [scan] is {toml_value(table)}; a range is {RANGES}")
    if not {"start", "stop"} <= set(table) <= form:
        raise bad
    start, stop, step = table["start"], table["stop"], table.get("step", 1)
    if any(isinstance(v, bool) or not isinstance(v, (int, float)) or not math.isfinite(v) for v in (start, stop, step)):
        raise bad
    if "number" in table:
        return _spaced(key, table, bad, most)
    steps = (stop - start) / step if step else 0.0
    count = math.ceil(steps - 1e-9) if abs(steps) < math.inf else math.inf
    if count < 1 or not steps > 0:
        raise InputError(f"{key} in [scan] is {toml_value(table)}, which is empty; stop is excluded")
    if count > most:
        raise _too_many(key, count)
    return [start + i * step for i in range(int(count))]


def _spaced(key: str, table: Mapping[str, Any], bad: InputError, most: int) -> list[Any]:
    """``number`` values from start to stop, both included, evenly spaced in themselves or in their logarithm."""
    start, stop, number, spacing = table["start"], table["stop"], table["number"], table.get("spacing", "linear")
    if isinstance(number, bool) or not isinstance(number, int) or number < 2:
        raise bad
    if number > most:
        raise _too_many(key, number)
    if spacing not in ("linear", "log") or (spacing == "log" and min(start, stop) <= 0) or start == stop:
        raise bad
    shares = [i / (number - 1) for i in range(number)]
    if spacing == "linear":
        between = [start + (stop - start) * share for share in shares]
    else:
        between = [start * (stop / start) ** share for share in shares]
    return [start, *between[1:-1], stop]


def _too_many(key: str, count: float) -> InputError:
    return InputError(
        f"{key} in [scan] has {count:,} values and the scan too many samples; at most {MOST_SAMPLES:,} are allowed"
    )


def sample_key(settings: RunSettings) -> str:
    """Hash of what may shape the result of a sample: the settings that differ from their defaults, files by their
    content. An option that is added later renames no sample."""
    table = settings_table()
    values = {key: value for key, value in settings.given.items() if not table[key].not_scanned}
    for name in NAMED_FILES:
        if values.get(name) not in (None, *STARTS):
            values[name] = content_of(values[name])
    lines = [f"{name} = {value!r}" for name, value in sorted(values.items())]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def content_of(name: str) -> str:
    """Hash of a file's content; of a run directory, of its run.h5."""
    path = Path(name) / "run.h5" if Path(name).is_dir() else Path(name)
    if not path.is_file():
        raise FileError(f"{name} does not exist or is not a file")
    state = path.stat()
    return _content(name, path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=1024)
def _content(name: str, path: Path, *_: int) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            for piece in iter(lambda: file.read(2**20), b""):
                digest.update(piece)
    except OSError as error:
        raise FileError(f"{name} cannot be read: {error.strerror or error}") from None
    return digest.hexdigest()


def spheres_of(settings: RunSettings) -> int:
    """Spheres of a sample; FileError for a packing that cannot be read."""
    return (
        math.prod(settings.shape)
        if settings.packing is None
        else _spheres(settings.packing, content_of(settings.packing))
    )


@lru_cache(maxsize=1024)
def _spheres(name: str, _: str) -> int:
    from taichi_bearings.packing import Packing  # and with it much of SciPy

    return len(Packing.read(name)["center"])


def _text(document: Mapping[str, Any], single: Mapping[str, Any], tables: Sequence[Mapping[str, Any]]) -> str:
    """The scan as TOML, with what --set has changed."""
    lines = [f"{key} = {toml_value(value)}" for key, value in document.items()]
    if single:
        lines += ["[scan]", *(f"{key} = {toml_value(value)}" for key, value in single.items())]
    for table in tables:
        lines += ["[[scan.zip]]", *(f"{key} = {toml_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"
