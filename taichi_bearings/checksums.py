"""Checksums of what an HDF5 file holds, in the file itself, so that numbers that were changed are not read as results.

The attribute `sha256` of the root is JSON text, name -> SHA-256 in hexadecimal digits: ``contact/x/slip`` for a data
set (:func:`digest_of_array`), ``path@attribute`` for an attribute of a group, ``attribute`` for one of the root
(:func:`digest_of_attribute`). A group that was added later, `/analysis`, has such an attribute of its own. Files of
old versions have none and are read unchecked. Whoever changes a file on purpose removes the attribute, or writes it
anew with :func:`seal`; what others add to a file is not checked.
"""

import contextlib
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.hdf5 import LAYOUT, READ_LAYOUTS, open_hdf5
from taichi_bearings.plain_files import parse_json

ATTRIBUTE = "sha256"


def digest_of_array(values: np.ndarray) -> str:
    """Return the checksum of an array, a text of hexadecimal digits: the SHA-256 of its type and shape, such as ``<f8
    (3, 4, 5)``, followed by its bytes in C order.

    values : the array; for an array of texts the list as JSON takes the place of the bytes.
    """
    digest = hashlib.sha256(f"{values.dtype.str} {values.shape}".encode())
    if values.dtype == object:
        digest.update(json.dumps(values.tolist(), default=bytes.decode).encode())
    else:
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


def digest_of_attribute(value: object) -> str:
    """Return the checksum (SHA-256, hexadecimal digits) of the value of an attribute: of a number, a text or a list in
    JSON, of anything else as text.
    """
    return hashlib.sha256(json.dumps(np.asarray(value).tolist(), default=str).encode()).hexdigest()


def _digest(item: Any, attribute: str | None) -> str:
    """Return the checksum of an attribute of `item`, or, if None is named, of `item` itself, a data set."""
    return digest_of_array(np.asarray(item[()])) if attribute is None else digest_of_attribute(item.attrs[attribute])


def _parts(group: h5py.Group) -> Iterator[tuple[str, Any, str | None]]:
    """Yield everything in a group that has a checksum, as tuples of three: the name under which the checksum is stored;
    the data set, or the group that has the attribute; and the name of the attribute, None for a data set.
    """
    items: list[tuple[str, Any]] = [("", group)]
    group.visititems(lambda path, item: items.append((path, item)))
    for path, item in items:
        if isinstance(item, h5py.Dataset):
            yield path, item, None
        else:
            yield from ((f"{path}@{attribute}", item, attribute) for attribute in item.attrs if attribute != ATTRIBUTE)


def seal(group: h5py.Group) -> None:
    """Write the checksums of everything in a file or a group into its attribute `sha256`."""
    group.attrs[ATTRIBUTE] = json.dumps({name: _digest(*part) for name, *part in _parts(group)})


def changed_in(path: Path, group: h5py.Group) -> Iterator[str]:
    """Yield the names of the data sets and attributes, in an open file or a group of it, that have another checksum
    than when they were written. Those that are missing, or have no stored checksum, are not named.

    path : path of the file, for the error.
    group : the file, or a group of it.

    Raises FileError where the table of checksums is unreadable.
    """
    digests = parse_json(str(group.attrs.get(ATTRIBUTE, "{}")))
    if not isinstance(digests, dict):
        raise FileError(f"{path} is damaged or was changed: its attribute {ATTRIBUTE} is no table of checksums")
    for name, *part in _parts(group):  # each thing once, whatever names it is given
        if name in digests and digests[name] != _digest(*part):
            yield f"{group.name.strip('/')}/{name}".strip("/")


@contextlib.contextmanager
def open_checked(path: Path, kind: str = "an HDF5 file", changed: list[str] | None = None) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading as a context, and check its checksums.

    path : path of the file.
    kind : what it is read as, in words, for errors.
    changed : a list that gets the names of what was changed after the file was written; None to raise FileError for a
        change.

    Raises FileError for a layout of another version.
    """
    with open_hdf5(path, kind) as file:
        found = file.attrs.get("schema_version", LAYOUT)
        if found not in READ_LAYOUTS:
            known = " and ".join(map(str, READ_LAYOUTS))
            raise FileError(f"{path} has layout version {found}; this program reads versions {known}")
        for group in [file, *(item for item in file.values() if isinstance(item, h5py.Group))]:
            for name in changed_in(path, group):
                if changed is None:
                    raise FileError(f"{path} is damaged or was changed: the checksum of {name} does not match")
                changed.append(name)
        yield file
