"""Packings out of LAMMPS: a `dump custom` of atoms and a `dump local` of their contacts, read as files of strangers.

After the manual's pages dump and compute pair/local. Nothing is believed that a file says of its length: lines are read
one by one, and only numbers that are there take memory.
"""

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.packing.checks import MOST_CONTACTS, MOST_SIZE, MOST_SPHERES, directions
from taichi_bearings.plain_files import read_lines
from taichi_bearings.words import shown

SPIN = ("omegax", "omegay", "omegaz")
MOST_INTEGER = 2**53  # the largest up to which floats hold every whole number


def read_dumps(
    atoms: Path, contacts: Path, columns: Sequence[str], *, step: int | None = None, driven: Any = None,
    driven_types: Mapping[int, int] | None = None, spin: Mapping[int, Any] | None = None, dimension: int = 3,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Arrays of a packing by name; spheres in the order of their ids.

    atoms : has columns id, x y z (or xu yu zu), radius or diameter. contacts : has the columns named by `columns`, as
    ("c_pair[1]", "c_pair[2]", "c_force"): the ids of both atoms of a contact, and if there is a third one the normal
    force; pairs with force 0 are left out. step : timestep, the last one of `atoms` if None.
    driven : body of driven atoms by id, or (N,) in the order of the ids, -1 for free ones; or driven_types : body of
    all atoms of a type. spin : of each body, 1/time, a vector, of discs a number; if None columns omegax, omegay,
    omegaz. dimension : 2 for discs in the plane z = const. Normals go the shortest way around periodic sides ("pp").

    Raises FileError or InputError, one sentence, with the line of the file at fault.
    """
    if dimension not in (2, 3):
        raise InputError(f"dimension is {shown(dimension)}; it must be 2 or 3")
    if isinstance(columns, str) or len(columns) not in (2, 3):
        raise InputError(f"columns is {shown(columns)}; it must be two or three names of columns of {contacts}")
    rates = list(SPIN if dimension == 3 else SPIN[2:]) if spin is None else []
    kinds = ["type"] if driven_types is not None else []

    def wanted(names: Sequence[str]) -> list[str]:
        axes = [name if "x" in names else f"{name}u" for name in "xyz"[:dimension]]
        return ["id", *kinds, "radius" if "radius" in names else "diameter", *axes, *rates]

    frame = _Frame(atoms, "ATOMS", step, MOST_SPHERES, wanted, whole=1 + len(kinds))
    table = frame.table[np.argsort(frame.table[:, 0], kind="stable")]
    number, (radius, *place) = table[:, 0].astype(np.int64), table[:, 1 + len(kinds) : 2 + len(kinds) + dimension].T
    if (twice := number[1:] == number[:-1]).any():
        raise FileError(f"{atoms} has atom {number[1:][twice][0]} twice at timestep {frame.step}")
    if not (np.abs(table) <= max(MOST_SIZE, MOST_INTEGER)).all():
        raise FileError(f"{atoms} has numbers that are not finite at timestep {frame.step}")
    body = _bodies(number, driven, driven_types, table[:, 1].astype(np.int64))
    found: dict[str, Any] = {"center": np.column_stack(place), "driven": body}
    found["radius"] = radius * (1.0 if "radius" in frame.names else 0.5)
    found["spin"] = _imposed(body, spin, dimension) if spin is not None else table[:, -len(rates) :]
    if dimension == 2:
        found["spin"] = found["spin"].reshape(-1)
    return found | _contacts(contacts, columns, frame, number, found["center"], found["radius"])


def _contacts(
    path: Path, columns: Sequence[str], frame: "_Frame", number: np.ndarray, center: np.ndarray, radius: np.ndarray
) -> dict[str, np.ndarray]:
    """Contacts, normals and, of a third column, normal forces, of atoms with these numbers (N,), at the same time."""
    rows = _Frame(path, "", frame.step, MOST_CONTACTS, lambda _: list(columns), whole=2).table
    rows = rows[rows[:, 2] != 0] if len(columns) > 2 else rows
    ids = rows[:, :2].astype(np.int64)
    where = np.minimum(np.searchsorted(number, ids), len(number) - 1)
    if not len(number) or (number[where] != ids).any():
        lost = ids[number[where] != ids] if len(number) else [0]
        raise FileError(f"{path} has a contact of atom {lost[0]}, which {frame.path} lacks at timestep {frame.step}")
    vector = center[where[:, 1]] - center[where[:, 0]]
    for axis, length in enumerate(frame.sides[: center.shape[1]]):
        if not length:
            continue
        if len(where) and length <= 2 * (radius[where[:, 0]] + radius[where[:, 1]]).max():
            side = "xyz"[axis]
            raise InputError(
                f"the periodic side {side} is {length:g} long, so that spheres may touch both ways around it"
            )
        vector[:, axis] -= length * np.round(vector[:, axis] / length)
    found = {"contact": where, "normal": directions(where, vector, radius)}
    return found | ({"normal_force": rows[:, 2]} if len(columns) > 2 else {})


def _bodies(number: np.ndarray, driven: Any, driven_types: Mapping[int, int] | None, kind: np.ndarray) -> np.ndarray:
    """Body of each atom (N,), -1 for free ones."""
    if (driven is None) == (driven_types is None):
        raise InputError("one of driven and driven_types must say which atoms are driven")
    if driven is not None and not isinstance(driven, Mapping):
        return np.asarray(driven)
    table, keys = (driven_types or {}, kind) if driven is None else (driven, number)
    body = np.full(len(number), -1)
    for key, own in table.items():
        if not (keys == key).any():
            raise InputError(f"driven is {shown(key)}, but there is no such atom or type")
        body[keys == key] = own
    return body


def _imposed(body: np.ndarray, spin: Mapping[int, Any], dimension: int) -> np.ndarray:
    values = np.zeros((len(body), 3) if dimension == 3 else len(body))
    for own in np.unique(body[body >= 0]).tolist():
        if own not in spin:
            raise InputError(f"spin lacks body {own}; it must give the spin of each driven body")
        values[body == own] = spin[own]
    return values


class _Frame:
    """One timestep of a dump. names : of its columns. sides : (3,), lengths of periodic sides of the box, else 0.

    table : (count, columns), the columns that `wanted` says of their names; the first `whole` are whole numbers.
    """

    lines: Iterator[bytes]

    def __init__(
        self, path: Path, items: str, step: int | None, most: int, wanted: Callable[[Sequence[str]], list[str]],
        whole: int,
    ) -> None:  # fmt: skip
        if not path.is_file():
            raise FileError(f"{path} does not exist or is not a file")
        self.path, self.line = path, 0
        with closing(read_lines(path)) as self.lines:  # an error may be kept, and with it an open file
            self.step, start = self._last(step)
        with closing(read_lines(path)) as lines:
            self.lines, self.line = islice(lines, start, None), start
            self._read_header(items, most)
            self.table = self._columns(wanted(self.names), whole)

    def _read_header(self, items: str, most: int) -> None:
        self._next("a timestep")
        kind = self._header("NUMBER OF ", f"ITEM: NUMBER OF {items or 'ENTRIES'}")[0]
        if items and kind != items:
            raise self._wrong(f"ITEM: NUMBER OF {items}")
        self.count = self._integer(self._next("a number"), 0, most)
        flags = self._header("BOX BOUNDS", "ITEM: BOX BOUNDS with three flags such as pp ff pp")
        if len(flags) != 3 or any(len(flag) != 2 or set(flag) - set("pfsm") for flag in flags):
            raise self._wrong("ITEM: BOX BOUNDS with three flags such as pp ff pp, a box that is not triclinic")
        bounds = [self._numbers(self._next("two bounds"), [0, 1], 2, 0) for _ in range(3)]
        self.sides = [high - low if flag == "pp" else 0.0 for (low, high), flag in zip(bounds, flags, strict=True)]
        if not all(0 <= side <= MOST_SIZE for side in self.sides):
            raise self._wrong("bounds in order above")
        self.names = self._header(kind, f"ITEM: {kind} and names of columns")

    def _last(self, step: int | None) -> tuple[int, int]:
        """The timestep, and the number of the line before it."""
        found = None
        for line in self.lines:
            self.line += 1
            if line.startswith(b"ITEM: TIMESTEP"):
                start = self.line
                own = self._integer(self._next("a timestep"), 0, MOST_INTEGER)
                if step is None or own == step:
                    found = own, start
        if found is None:
            raise FileError(f"{self.path} has no timestep{'' if step is None else f' {step}'}; it is no dump with that")
        return found

    def _next(self, expected: str) -> bytes:
        line = next(self.lines, None)
        self.line += 1
        if line is None:
            raise FileError(f"{self.path} ends at line {self.line}, where {expected} must follow")
        return line

    def _wrong(self, expected: str) -> FileError:
        return FileError(f"{self.path} is damaged or no dump: line {self.line} must be {expected}")

    def _header(self, begin: str, expected: str) -> list[str]:
        words = self._next(expected).decode("latin-1").strip()
        if not words.startswith(f"ITEM: {begin}"):
            raise self._wrong(expected)
        return words[len(f"ITEM: {begin}") :].split()

    def _integer(self, text: bytes, least: int, most: int) -> int:
        digits = text.strip()
        if not digits.isdigit() or len(digits) > 20 or not least <= int(digits) <= most:
            raise self._wrong(f"a whole number from {least} to {most}")
        return int(digits)

    def _numbers(self, line: bytes, places: list[int], width: int, whole: int) -> list[float]:
        """The numbers at these places of a line of so many words, the first `whole` of them whole."""
        words = line.split()
        try:
            if len(words) != width or b"_" in line:
                raise ValueError
            numbers = [float(words[place]) for place in places]
            if any(not (value.is_integer() and 0 <= value <= MOST_INTEGER) for value in numbers[:whole]):
                raise ValueError
        except ValueError:
            raise self._wrong(f"{width} numbers, ids and types whole") from None
        return numbers

    def _columns(self, names: list[str], whole: int) -> np.ndarray:
        if lacking := [name for name in names if self.names.count(name) != 1]:
            raise FileError(f"{self.path} must have one column {lacking[0]}; it has {' '.join(self.names)}")
        places, values = [self.names.index(name) for name in names], array("d")
        for number in range(self.count):
            line = self._next(f"row {number + 1} of {self.count}")
            values.extend(self._numbers(line, places, len(self.names), whole))
        after = next(self.lines, b"ITEM: ")
        if not after.startswith(b"ITEM: ") and after.strip():
            self.line += 1
            raise self._wrong(f"the next timestep after {self.count} rows")
        return np.frombuffer(values, dtype=np.float64).reshape(self.count, len(names))
