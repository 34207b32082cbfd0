"""The journal of a scan: one line a finished sample, appended and synchronised, so that no kill loses any of them.

A line is JSON, ``{"crc32": "01234567", "sample": {...}}``, with the checksum of what follows ``"sample": ``. An
incomplete last line, left by a kill or a full disk, is dropped. A line that has changed since is named in a warning:
its sample is missing, and the line is removed when the journal is next opened for appending.
"""

import contextlib
import json
import os
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from taichi_bearings.errors import FileError, warn
from taichi_bearings.plain_files import Json, opened, read_lines, refuse_link_out, replace_file, write_all, writing
from taichi_bearings.scene.solution import is_crossed

JOURNAL_NAME = "samples.jsonl"
RECORD_HEAD = '{"crc32": "%08x", "sample": '
RECORD_HEAD_LENGTH = len(RECORD_HEAD % 0)
TEXT_SCALARS = {"status", "method", "law", "shape", "proof", "version", "warnings", "error"}  # values that are texts
OWN_COLUMN_NAMES = {"sample", "method_found", "slip_threshold_found"}  # names that the table keeps for itself
MOST_JOURNAL_BINS = 10_000  # largest number of a bin: powers of 1e-500 to 1e500, more than doubles have
MOST_SCALARS = 300  # most values of a sample; a solve with its structure has some 80


def _line(text: bytes) -> bytes:
    """Return the line of the journal for one sample: checksum, record and line end.

    text : record of the sample in JSON.
    """
    return (RECORD_HEAD % zlib.crc32(text)).encode() + text + b"}\n"


def _is_whole(line: bytes) -> bool:
    """Return True if the checksum of a line fits its content."""
    return line == _line(line[RECORD_HEAD_LENGTH:-2])


def _has_key(record: object) -> bool:
    """Return True for a record that has a key, which is a text."""
    return isinstance(record, dict) and isinstance(record.get("key"), str)


@lru_cache(maxsize=4096)
def _names_a_column(name: str) -> bool:
    """Return True if a value of this name can become a column of the table of the scan."""
    return name not in OWN_COLUMN_NAMES and re.fullmatch(r"[A-Za-z]\w{0,99}", name, re.ASCII) is not None


def is_sample(sample: Any) -> bool:
    """Return True if a record read from a journal has the form that a solve leaves: key, scalars and bins (numbers of
    slipping contacts by bin of power) of the right types and sizes.

    sample : the record, as JSON has it.

    It is also False for what no table can hold: too many scalars, names that cannot be columns, texts with a null byte,
    or numbers that are too large, such as those of bins whose arrays would not fit into memory; and for a lower bound
    that exceeds what it bounds by more than rounding. Raises ValueError for a text that is no Unicode.
    """
    if not _has_key(sample):
        return False
    scalars, bins = sample.get("scalars"), sample.get("bins")
    if not isinstance(scalars, dict) or not isinstance(scalars.get("status"), str) or not isinstance(bins, dict):
        return False
    texts = {name: scalars[name] for name in TEXT_SCALARS & scalars.keys() if scalars[name] is not None}
    numbers = {name: value for name, value in scalars.items() if name not in TEXT_SCALARS}
    get = {name: value for name, value in numbers.items() if value is not None}.get
    return (
        len(scalars) <= MOST_SCALARS
        and all(isinstance(text, str) and b"\0" not in text.encode() for text in texts.values())
        and all(isinstance(v, bool | int | float | None) and _names_a_column(name) for name, v in numbers.items())
        and all(isinstance(numbers.get(name), int | None) for name in ("slipping", "slipless", "tied", "undecided"))
        and all(abs(value) < 2**62 for value in numbers.values() if type(value) is int)
        and not is_crossed(get("potential" if "potential" in numbers else "power"), get("lower_bound"), get("gap"))
        and all(abs(int(n)) < MOST_JOURNAL_BINS and type(v) is int and 0 <= v < 2**31 for n, v in bins.items())
    )


def read_journal(path: Path, fits: Callable[[Any], bool] = _has_key) -> dict[str, Json]:
    """Return the records of samples in a journal by their keys; of several lines with one key the last counts.

    path : path of the journal.
    fits : function that says whether a record has the right form. Lines that are damaged, or have another form, are
        named in a warning and left out.
    """
    samples: dict[str, Json] = {}
    for number, line in enumerate(read_lines(path), start=1):
        sample = None
        with contextlib.suppress(ValueError, RecursionError):
            found = json.loads(line[RECORD_HEAD_LENGTH:-2]) if _is_whole(line) else None
            sample = found if fits(found) else None
        if sample is not None:
            samples[sample["key"]] = sample
        elif line.endswith(b"\n"):
            warn(f"line {number} of {path} is damaged; its sample is taken for missing")
    return samples


class Journal:
    """The journal of a scan, open for appending; used in a `with` statement, by one process at a time."""

    def __init__(self, path: Path) -> None:
        """Drop damaged lines of the journal at a path, and open it for appending."""
        self.path = path
        refuse_link_out(path)
        with writing(path):
            self._length = self._drop_damaged_lines()
            self._file = opened(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def _drop_damaged_lines(self) -> int:
        """Remove damaged lines from the journal, and return its size in bytes.

        The file is replaced in one move, and a second name (hard link) of it keeps the earlier content. If only the
        last line is incomplete, it is cut off instead, which is possible on a full disk, too.
        """
        whole = b"".join(line for line in read_lines(self.path) if _is_whole(line))
        if not self.path.exists():
            return 0
        status = self.path.stat()
        with opened(self.path) as file:
            is_start = file.read(len(whole)) == whole
        if not is_start or status.st_nlink > 1:
            replace_file(self.path, whole)
        elif status.st_size != len(whole):
            os.truncate(self.path, len(whole))
        return len(whole)

    def append(self, samples: Sequence[Mapping[str, object]]) -> None:
        """Append samples, and return once they are on the disk. On a full disk FileError is raised; samples that did
        fit are kept.
        """
        lines = b"".join(_line(json.dumps(sample, allow_nan=False).encode()) for sample in samples)
        try:
            write_all(self._file, lines)
        except OSError as error:
            written = os.fstat(self._file.fileno()).st_size - self._length
            self._length += lines.rfind(b"\n", 0, written) + 1  # the whole lines that were written
            self._file.truncate(self._length)
            raise FileError(f"{self.path} cannot be written: {error.strerror or error}") from None
        self._length += len(lines)

    def __enter__(self) -> "Journal":
        """Return the journal itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._file.close()
