"""Spheres and contacts from tables of text (CSV), which may be damaged: each error names the line at fault."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.scene.checks import MOST_CONTACTS, MOST_INTEGER, MOST_SPHERES
from taichi_bearings.text_lines import number_of, read_text_lines
from taichi_bearings.words import meant

SPHERE_COLUMNS = {
    "x": "x", "y": "y", "z": "z", "radius": "radius", "r": "radius", "diameter": "diameter", "d": "diameter",
    "driven": "driven", "spin": "spin", "spin_x": "spin_x", "spin_y": "spin_y", "spin_z": "spin_z", "id": "id",
}  # fmt: skip
CONTACT_COLUMNS = {
    "first": "first", "i": "first", "second": "second", "j": "second", "nx": "nx", "ny": "ny", "nz": "nz",
    "friction": "friction", "mu": "friction", "viscosity": "viscosity", "normal_force": "normal_force",
    "fn": "normal_force",
}  # fmt: skip
"""Names of columns that a table may have, in lower case, and the names of the arrays that they become."""
WHOLE_COLUMNS = {"driven", "id", "first", "second"}  # columns of whole numbers
DELIMITERS = (",", ";", "\t")


def read_spheres(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a table of spheres by name; raise FileError if it cannot be read.

    path : the table, a text with a header and cells separated by commas, semicolons or tabs; it may be packed.

    The table needs the columns x, y and, for spheres, z. It may have radius or diameter, driven, spin (for spheres
    spin_x, spin_y and spin_z), and id, the numbers by which a table of contacts refers to spheres.
    """
    columns = _read(path, SPHERE_COLUMNS, MOST_SPHERES, ("x", "y"))
    axes = [name for name in "xyz" if name in columns]
    found = {"center": np.column_stack([columns.pop(name) for name in axes])}
    if "diameter" in columns:
        if "radius" in columns:
            raise FileError(f"{path} has a column radius and a column diameter; leave one of the two out")
        columns["radius"] = columns.pop("diameter") / 2
    rates = ["spin"] if len(axes) == 2 else ["spin_x", "spin_y", "spin_z"]
    given = [name for name in columns if name.startswith("spin")]
    if given and sorted(given) != sorted(rates):
        raise FileError(
            f"{path} has a column {given[0]}; spins in {len(axes)}D need exactly the columns {', '.join(rates)}"
        )
    if given:
        spins = np.column_stack([columns.pop(name) for name in rates])
        found["spin"] = spins if len(axes) == 3 else spins[:, 0]
    if "id" in columns:
        ids = columns["id"]
        order = np.argsort(ids, kind="stable")
        twice = ids[order[1:]] == ids[order[:-1]]
        if twice.any():
            raise FileError(f"{path} has the id {ids[order[1:]][twice][0]} twice; each sphere must be there once")
    return found | columns


def read_contacts(path: Path, ids: np.ndarray | None, spheres: int) -> dict[str, np.ndarray]:
    """Return the arrays of a table of contacts by name; raise FileError if it cannot be read.

    path : the table, a text with a header and cells separated by commas, semicolons or tabs; it may be packed.
    ids : (N,) ids of the spheres, or None.
    spheres : their number N.

    The table needs the columns first and second, or i and j: the ids of the two spheres of a contact, or without ids
    their numbers from 0. It may have nx, ny, nz, friction, viscosity and normal_force.
    """
    columns = _read(path, CONTACT_COLUMNS, MOST_CONTACTS, ("first", "second"))
    contact = np.column_stack([columns.pop("first"), columns.pop("second")])
    normal = [columns.pop(name) for name in ("nx", "ny", "nz") if name in columns]
    found = {"contact": contact, **columns} | ({"normal": np.column_stack(normal)} if normal else {})
    if ids is None:
        return found
    order = np.argsort(ids, kind="stable")
    where = np.minimum(np.searchsorted(ids[order], contact), spheres - 1)
    if (lost := ids[order[where]] != contact).any():
        row = int(np.argmax(lost.any(axis=1)))
        missing = contact[row][lost[row]][0]
        raise FileError(f"row {row + 1} of {path} has a contact of sphere {missing}, but no sphere has this id")
    return found | {"contact": order[where]}


def _read(path: Path, names: Mapping[str, str], most: int, needed: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the columns of a table by the names of the arrays that they become, (rows,) each; raise FileError if it
    cannot be read.

    path : the table.
    names : columns that the table may have, each with the name of its array.
    most : largest number of rows.
    needed : names of arrays that it must have.
    """
    head, rows, delimiter = None, list[list[float]](), None
    for line, text in enumerate(read_text_lines(path), start=1):
        try:
            words = text.decode().strip()
        except UnicodeDecodeError:
            raise FileError(f"line {line} of {path} is not text in UTF-8") from None
        if not words:
            continue
        if head is None:
            delimiter = next((mark for mark in DELIMITERS if mark in words), None)
            cells = _cells(words.removeprefix("#"), delimiter)
            if not words.startswith("#") or all(cell.lower() in names for cell in cells):
                head = _head(path, line, cells, names, needed)
        elif not words.startswith("#"):
            rows.append(_row(path, line, _cells(words, delimiter), head))
            if len(rows) > most:
                raise FileError(f"{path} has more than {most:,} rows, the most that this program reads")
    if head is None:
        raise FileError(f"{path} has no header such as {','.join(needed)}, so its columns have no names")
    table = np.array(rows, dtype=float).reshape(len(rows), len(head))
    return {name: table[:, k].astype(np.int64) if name in WHOLE_COLUMNS else table[:, k] for k, name in enumerate(head)}


def _cells(words: str, delimiter: str | None) -> list[str]:
    """Return the words of a line that a delimiter separates, without spaces and quotes around them."""
    return [cell.strip().strip('"').strip() for cell in words.split(delimiter)]


def _head(path: Path, line: int, cells: list[str], names: Mapping[str, str], needed: Sequence[str]) -> list[str]:
    """Return the names of the arrays for the cells of a header line.

    path, line : file and line, for messages.
    cells : the words of the header.
    names : columns that the table may have, each with the name of its array.
    needed : names of arrays that it must have.

    Raises FileError for a column that is unknown, missing, or there twice.
    """
    known = [cell.lower() for cell in cells]
    if strange := [name for name in known if name not in names]:
        allowed = ", ".join(names)
        raise FileError(
            f"line {line} of {path} names an unknown column {strange[0]!r}{meant(strange[0], names)}; it must be a "
            f"header with some of {allowed}"
        )
    found = [names[name] for name in known]
    if lacking := [name for name in needed if name not in found]:
        raise FileError(f"{path} must have a column {lacking[0]}; its header is {','.join(known)}")
    if twice := [name for name in found if found.count(name) > 1]:
        raise FileError(f"{path} has the column {twice[0]} twice")
    return found


def _row(path: Path, line: int, cells: list[str], names: Sequence[str]) -> list[float]:
    """Return the numbers of a row; raise FileError for anything else, with the line and what is wrong in it.

    path, line : file and line, for messages.
    cells : the words of the row.
    names : names of the arrays, one for each cell.
    """
    if len(cells) != len(names):
        raise FileError(
            f"line {line} of {path} has {len(cells)} cells; it must have {len(names)}, as many as the header"
        )
    numbers = []
    for name, cell in zip(names, cells, strict=True):
        try:
            value = number_of(cell.encode())
        except ValueError:
            hint = "; write decimal points" if "," in cell else ""
            raise FileError(f"line {line} of {path} has {cell!r} for {name}; it must be a number{hint}") from None
        if name in WHOLE_COLUMNS and not (value.is_integer() and abs(value) <= MOST_INTEGER):
            raise FileError(f"line {line} of {path} has {cell!r} for {name}; it must be a whole number")
        if not np.isfinite(value):
            raise FileError(f"line {line} of {path} has {cell!r} for {name}; it must be finite")
        numbers.append(value)
    return numbers
