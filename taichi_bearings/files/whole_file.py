"""Writes files in full or not at all, and reads HDF5 files only if their checksums are right."""

import contextlib
import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import h5py
import numpy as np

from taichi_bearings.checksums import open_checked, seal
from taichi_bearings.errors import FileError, InputError, printable
from taichi_bearings.hdf5 import LAYOUT
from taichi_bearings.plain_files import Json, replace_file, writing
from taichi_bearings.words import shown

NO_ATTRIBUTES: Mapping[str, Any] = MappingProxyType({})


def make_folder(path: Path) -> None:
    """Make the folder `path`, with those above it, unless it exists; raise WriteError if that fails."""
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)


def refuse_ending(out: Path | None, *endings: str) -> None:
    """Raise InputError if the name of a file asked for has an ending other than `endings`.

    out : the name; None if none is asked for.
    """
    if out is not None and out.suffix not in endings:
        names = " or ".join(filter(None, (", ".join(endings[:-1]), endings[-1])))
        raise InputError(f"out is {str(out)!r}; it must end in {names}")


def refuse_standing(paths: Iterable[Path], force: bool = False) -> None:
    """Raise FileError for the first of the files `paths` that exists, unless `force` is True."""
    standing = [] if force else [path for path in paths if path.exists()]
    if standing:
        raise FileError(f"{standing[0]} already exists; choose another --out or add --force")


def write_text(path: Path, text: str) -> None:
    """Write a text as the file `path` in UTF-8, in full or not at all; line ends stay as they are."""
    replace_file(path, text.encode())


def write_csv(path: Path, names: Sequence[str], rows: Iterable[Sequence[Any]], notes: Sequence[str] = ()) -> None:
    """Write a table as CSV: a line of names and the rows below it, floating-point numbers with all their digits.

    path : the file, which is replaced.
    names : titles of the columns.
    rows : cells of each row, in the order of the columns.
    notes : lines that go before the names, each after "# ".
    """
    text = io.StringIO()
    text.writelines(f"# {printable(line)}\n" for line in notes)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)

    def harmless(cell: object) -> Any:
        """Return a cell as it is, but a text that spreadsheets would take for a formula with an apostrophe in front."""
        if isinstance(cell, str) and cell.startswith(("=", "+", "-", "@", "\t", "\r")):
            try:
                float(cell)
            except ValueError:
                return f"'{cell}"
        return cell

    writer.writerows(map(harmless, row) for row in rows)
    write_text(path, text.getvalue())


def write_hdf5(path: Path, fill: Callable[[h5py.File], None], attributes: Mapping[str, object] = NO_ATTRIBUTES) -> None:
    """Write an HDF5 file with checksums, in full or not at all, replacing an earlier one; raise WriteError if that
    fails.

    path : the file.
    fill : function that puts the content into the opened file.
    attributes : attributes of the file, by name.
    """

    with _new_hdf5(path) as file:
        put_attributes(file, attributes)
        fill(file)
        seal(file)


@contextlib.contextmanager
def _new_hdf5(path: Path) -> Iterator[h5py.File]:
    """Yield a new HDF5 file in memory, and write it to `path` when the block ends. On a full disk HDF5 itself would
    leave a damaged file.
    """
    whole = io.BytesIO()
    with h5py.File(whole, "w", libver=("v108", "v108")) as file:  # older layouts allow attributes of 64 KB at most
        yield file
    with whole.getbuffer() as content:  # no second copy
        replace_file(path, content)


def layout_of(kind: str) -> Json:
    """Return the attributes, by name, that say what a file is and in which version of the layout.

    kind : "run", "scan" or "checkpoint".
    """
    return {"schema": f"taichi_bearings.{kind}", "schema_version": LAYOUT}


@contextlib.contextmanager
def read_hdf5(path: Path, kind: str, changed: list[str] | None = None) -> Iterator[h5py.File]:
    """Yield an opened HDF5 file whose checksums are right.

    path : the file.
    kind : "run", "scan" or "checkpoint".
    changed : a list that gets the names of data sets and attributes that were changed after the file was written; None
        to raise FileError for that.

    Raises FileError if the file cannot be read, is of another kind or version, or was changed. An InputError that is
    raised inside the block becomes a FileError, as the content of the file must then be wrong.
    """
    try:
        with open_checked(path, f"a {kind}", changed) as file:
            stored, schema = file.attrs.get("schema"), layout_of(kind)["schema"]
            if stored != schema:
                raise FileError(f"{path} is not a {kind}: its attribute `schema` is {shown(stored)}, not {schema!r}")
            if "schema_version" not in file.attrs:
                raise FileError(f"{path} is damaged or was changed: it lacks the attribute schema_version")
            yield file
    except FileError:
        raise
    except InputError as error:
        raise FileError(f"{path} is damaged or was changed: {error}") from None


def replace_group(path: Path, name: str, fill: Callable[[h5py.Group], None]) -> None:
    """Replace one group of an HDF5 file; everything else in the file stays. The new file takes the place of the old one
    in one move.

    path : the file.
    name : name of the group.
    fill : function that puts the content into the empty group.
    """

    with _new_hdf5(path) as whole:
        with open_checked(path) as old:
            for key, value in old.attrs.items():
                whole.attrs[key] = value
            for key in old:
                if key != name:
                    old.copy(key, whole)
        group = whole.create_group(name)
        fill(group)
        seal(group)


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays into an npz file, in full or not at all.

    path : the file, which is replaced.
    arrays : what it holds, by name.
    """
    whole = io.BytesIO()
    np.savez(whole, **{name: np.asarray(values) for name, values in arrays.items()})  # type: ignore[arg-type]
    with whole.getbuffer() as content:
        replace_file(path, content)


@dataclass(frozen=True)
class Finding:
    """An array as files store it.

    values : the array.
    units : its unit, such as "force*length"; "1" for pure numbers.
    description : what it is, in words.
    """

    values: np.ndarray
    units: str
    description: str


def put(group: h5py.Group, name: str, values: object, unit: str, text: str, **packing: object) -> None:
    """Write a data set into a group, with its unit and a description.

    name, values : name and values of the data set; None for values that are written later.
    unit, text : attributes `units` and `description`.
    packing : further arguments of h5py for a new data set, such as those on compression.
    """
    stored = group.create_dataset(name, data=values, **packing)
    stored.attrs["units"], stored.attrs["description"] = unit, text


def put_attributes(group: h5py.Group, values: Mapping[str, Any]) -> None:
    """Write attributes of a group or a file.

    values : the attributes, by name.

    None becomes an empty text, and not-a-number within a list of numbers. Bytes of a text that are not UTF-8, as in
    names of files, are escaped.
    """
    for key, value in values.items():
        if isinstance(value, list) and None in value:
            value = [np.nan if item is None else item for item in value]
        is_text = isinstance(value, str)
        group.attrs[key] = (
            value.encode(errors="backslashreplace").decode() if is_text else "" if value is None else value
        )


def attributes_of(group: h5py.Group) -> Json:
    """Return the attributes of a group by name: numbers as Python numbers, texts, and arrays."""
    return {key: value.item() if isinstance(value, np.generic) else value for key, value in group.attrs.items()}
