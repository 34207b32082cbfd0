"""One timestep of a dump of LAMMPS or LIGGGHTS (manual: dump, dump_modify).

The file may be damaged, so what it says of its length is not trusted: lines are read one by one, and only numbers that
are there take memory. A timestep is used only if every line of it is there with its end.
"""

from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.scene.checks import MOST_INTEGER
from taichi_bearings.scene.periods import Box
from taichi_bearings.text_lines import CutOff, number_of, read_text_lines

TIMESTEP = b"ITEM: TIMESTEP"
FLAGS = {0: "", 3: "", 5: "abc origin", 6: "xy xz yz"}  # words before the three flags, by the number of all words


@dataclass(frozen=True)
class Frame:
    """One timestep of a dump, a text file of LAMMPS.

    path : path of the file.
    step : number of the timestep.
    names : names of all columns.
    box : the box; None if the dump has none.
    table : (rows, columns), the columns that were asked for.
    line : number of the line of the file before the first row.
    is_rounded : True if whole numbers are printed like 1e+06, so that they may have lost digits.
    """

    path: Path
    step: int
    names: list[str]
    box: Box | None
    table: np.ndarray
    line: int
    is_rounded: bool

    def at(self, row: int) -> str:
        """Return where a row of the table stands, "line 12 of atoms.dump", for messages."""
        return f"line {self.line + row + 1} of {self.path}"


@dataclass(frozen=True)
class Frames:
    """The timesteps in a dump, a text file of LAMMPS, and where they begin.

    path : path of the file.
    starts : pairs of a timestep and the number of lines before it, in the order of the file.
    cut : the error for what is missing at the end of the file; None if nothing is.
    """

    path: Path
    starts: list[tuple[int, int]]
    cut: CutOff | None

    @classmethod
    def of(cls, path: Path) -> "Frames":
        """Return where the timesteps of the dump `path` begin; raise FileError for a file that cannot be read or has no
        timestep.
        """
        starts, line, cut = list[tuple[int, int]](), 0, None
        with closing(read_text_lines(path)) as lines:
            try:
                for line, text in enumerate(lines, start=1):
                    begins, awaited = text.startswith(TIMESTEP), bool(starts) and starts[-1][0] < 0
                    if begins and awaited:  # one program was killed here, and another one continued the file
                        starts[-1] = -1, line
                    elif begins:
                        starts.append((-1, line))
                    elif awaited:
                        starts[-1] = _integer(path, line, text, 0, MOST_INTEGER), line - 2
            except CutOff as error:
                cut = error
        if starts and starts[-1][0] < 0:
            cut = cut or CutOff(path, line, f"it ends at line {line}, where a timestep must follow")
            starts.pop()
        if not starts and cut is None:
            raise FileError(f'{path} is no LAMMPS dump: it has no line "ITEM: TIMESTEP"')
        return cls(path, starts, cut)

    def of_step(self, step: int) -> list[int]:
        """Return, for each copy of the timestep `step` in the file, the number of lines before it; the last copy comes
        first. A dump can hold a timestep several times.
        """
        return [line for own, line in reversed(self.starts) if own == step]


def read_frame(
    path: Path, step: int, start: int, items: str, most: int, wanted: Callable[[Sequence[str]], list[str]], whole: int
) -> Frame:
    """Return the timestep of a dump that begins after line `start`.

    path : path of the file.
    step : number of the timestep.
    items : "ATOMS", or "" for whatever a dump of local data calls its rows.
    most : largest number of rows that is read.
    wanted : function that is given the names of all columns and returns the names of those to read; the first `whole`
        of them hold whole numbers.

    Raises CutOff if a part of the timestep is missing, and FileError with the line at fault if it is damaged.
    """
    with closing(read_text_lines(path)) as lines:
        return _Reader(path, islice(lines, start, None), start).read(step, items, most, wanted, whole)


def _integer(path: Path, line: int, text: bytes, least: int, most: int) -> int:
    """Return the whole number in the text of a line; raise FileError if there is none from `least` to `most`.

    path, line : file and number of the line, for messages.
    text : what the line says.
    """
    digits = text.strip()
    if not digits.isdigit() or len(digits) > 20 or not least <= int(digits) <= most:
        raise FileError(
            f"{path} is not a LAMMPS dump, or is damaged: line {line} must be a whole number from {least} to {most}"
        )
    return int(digits)


@dataclass
class _Reader:
    """Reader of the lines of one timestep.

    path : path of the file, for messages.
    lines : the lines that follow.
    line : number of lines read so far.
    is_rounded : True once a whole number was printed like 1e+06.
    """

    path: Path
    lines: Iterator[bytes]
    line: int
    is_rounded: bool = False

    def read(self, step: int, items: str, most: int, wanted: Callable[[Sequence[str]], list[str]], whole: int) -> Frame:
        """Return the timestep whose lines come next.

        step : number of the timestep.
        items : "ATOMS", or "" for whatever a dump of local data calls its rows.
        most : largest number of rows that is read.
        wanted : function that is given the names of all columns and returns the names of those to read; the first
            `whole` of them hold whole numbers.
        """
        self._next_line("ITEM: TIMESTEP")
        self._next_line("a timestep")
        kind = self._header("NUMBER OF ", f"ITEM: NUMBER OF {items or 'ENTRIES'}")[0]
        if items and kind != items:
            raise self._error_at_line(f'the line "ITEM: NUMBER OF {items}" is expected')
        count = _integer(self.path, self.line + 1, self._next_line("a number"), 0, most)
        text = self._next_line(f"ITEM: BOX BOUNDS or ITEM: {kind}").decode("latin-1").strip()
        box = None
        if text.startswith("ITEM: BOX BOUNDS"):
            box = self._box(text[len("ITEM: BOX BOUNDS") :].split())
            text = self._next_line(f"ITEM: {kind} and names of columns").decode("latin-1").strip()
        if not text.startswith(f"ITEM: {kind} "):
            raise self._error_at_line(f'the line "ITEM: {kind}" with the names of the columns is expected')
        names = text[len(f"ITEM: {kind}") :].split()
        line, table = self.line, self._rows(names, count, wanted(names), whole)
        return Frame(self.path, step, names, box, table, line, self.is_rounded)

    def _next_line(self, expected: str) -> bytes:
        """Return the next line; raise CutOff if the file or the timestep ends before it.

        expected : what the line should be, for the message.
        """
        line = next(self.lines, None)
        self.line += 1
        if line is None or (line.startswith(TIMESTEP) and not expected.startswith("ITEM: TIMESTEP")):
            raise CutOff(
                self.path,
                self.line,
                f"the file ends or a new timestep begins at line {self.line}, where {expected} is expected",
            )
        return line

    def _error_at_line(self, expected: str) -> FileError:
        """Return the error for the line read last, which is not what it should be.

        expected : words for what the line should be.
        """
        return FileError(f"{self.path} is not a LAMMPS dump, or is damaged: at line {self.line} {expected}")

    def _header(self, begin: str, expected: str) -> list[str]:
        """Return the words of the next line after "ITEM: " and `begin`; raise FileError for another line.

        begin : words that must follow "ITEM: ", or "".
        expected : what the line should be, for the message.
        """
        words = self._next_line(expected).decode("latin-1").strip()
        found = words[len(f"ITEM: {begin}") :].split()
        if not words.startswith(f"ITEM: {begin}") or not found:
            raise self._error_at_line(f'the line "{expected}" is expected')
        return found

    def _box(self, words: list[str]) -> Box:
        """Return the box that the next three lines describe.

        words : what follows ITEM: BOX BOUNDS; nothing in older dumps.
        """
        flags, kind = words[-3:], " ".join(words[:-3])
        if FLAGS.get(len(words)) != kind or any(len(flag) != 2 or set(flag) - set("pfsm") for flag in flags):
            raise self._error_at_line(
                'the line "ITEM: BOX BOUNDS" must end with three boundary flags, such as "pp ff pp"'
            )
        width = {"": 2, "xy xz yz": 3, "abc origin": 4}[kind]
        rows = [self._numbers(self._next_line("bounds"), list(range(width)), width, 0) for _ in range(3)]
        box = Box.of_bounds(np.array(rows), [flag == "pp" for flag in flags] if flags else None)
        if box is None:
            raise self._error_at_line(
                "the last of three lines with the bounds of the box is expected; each must have a lower and a larger "
                "upper bound"
            )
        return box

    def _numbers(self, line: bytes, places: list[int], width: int, whole: int) -> list[float]:
        """Return the numbers at some places of a line; raise FileError if the line is damaged.

        line : the line, whose words are separated by spaces.
        places : indices of the words to read.
        width : number of words that the line must have.
        whole : so many of the first numbers must be whole.
        """
        words = line.split()
        try:
            if len(words) != width:
                raise ValueError
            try:
                numbers = [float(words[place]) for place in places]
            except ValueError:
                numbers = [number_of(words[place]) for place in places]
            # Python would take 1_000 for a number
            if b"_" in line and any(b"_" in words[place] for place in places):
                raise ValueError
            if any(not (value.is_integer() and 0 <= value <= MOST_INTEGER) for value in numbers[:whole]):
                raise ValueError
        except ValueError:
            raise self._error_at_line(
                f"a row of {width} numbers is expected, with whole ones for ids and types"
            ) from None
        if not self.is_rounded and any(b"e" in words[place].lower() for place in places[:whole]):
            self.is_rounded = True
        return numbers

    def _rows(self, names: list[str], count: int, wanted: list[str], whole: int) -> np.ndarray:
        """Return the wanted columns of the rows that come next, (count, columns).

        names : names of all columns.
        count : number of rows.
        wanted : names of the columns to read; the first `whole` of them hold whole numbers.

        Raises FileError if a column is missing, or if more rows follow than the timestep says.
        """
        if lacking := [name for name in wanted if names.count(name) != 1]:
            columns = " ".join(names)
            raise FileError(f"{self.path} must have exactly one column {lacking[0]}; its columns are {columns}")
        places, values = [names.index(name) for name in wanted], array("d")
        for number in range(count):
            line = self._next_line(f"row {number + 1} of {count}")
            values.extend(self._numbers(line, places, len(names), whole))
        with suppress(CutOff):  # of a timestep that follows
            after = next(self.lines, b"ITEM: ")
            if not after.startswith(b"ITEM: ") and after.strip():
                self.line += 1
                raise self._error_at_line(
                    f'the line "ITEM: TIMESTEP" must follow the {count} rows that the header announces'
                )
        return np.frombuffer(values, dtype=np.float64).reshape(count, len(wanted))
