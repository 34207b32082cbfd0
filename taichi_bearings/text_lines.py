"""Reads lines of texts that others have written, plain or packed; a text that may have lost its end is refused."""

import bz2
import io
import lzma
import re
import zlib
from collections.abc import Callable, Generator
from pathlib import Path
from typing import IO, Any

from taichi_bearings.errors import FileError
from taichi_bearings.plain_files import MOST_LINE, opened

PACKERS: dict[bytes, Callable[[], Any]] = {
    b"\x1f\x8b": lambda: zlib.decompressobj(31),
    b"BZh": bz2.BZ2Decompressor,
    b"\xfd7zXZ\0": lzma.LZMADecompressor,
}
"""For the first bytes of a packed file, what unpacks one stream of it."""
READ_AT_ONCE = 2**20  # packed bytes that are read at a time
UTF_8, UTF_16 = b"\xef\xbb\xbf", (b"\xff\xfe", b"\xfe\xff")  # marks of the byte order
NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d{1,5})?")


class CutOff(FileError):
    """Raised for a text that ends within a line, or within the stream that it is packed in.

    line : number of the line where it ends.
    """

    def __init__(self, path: Path, line: int, why: str) -> None:
        """Make the message.

        path : path of the file.
        line : number of the line where it ends.
        why : where and how it is cut off.
        """
        self.line = line
        super().__init__(f"{path} is cut off: {why}")


def read_text_lines(path: Path) -> Generator[bytes, None, None]:
    """Yield the lines of a text, plain or packed by gzip, bzip2 or xz, each with its end, without a byte order mark.

    path : the file.

    Raises CutOff where a line has no end or a packed stream stops within itself, after all lines that are whole: a
    number there may have lost its last digits. Raises FileError for what cannot be read, is damaged, or is no text.
    """
    number = 0
    try:
        with opened(path) as file:
            # the first bytes say how the file is packed, if it is
            head = file.read(6)
            file.seek(0)
            packer = next((make for magic, make in PACKERS.items() if head.startswith(magic)), None)
            unpacker = _Unpacker(file, packer) if packer is not None else None
            text: Any = file if unpacker is None else io.BufferedReader(unpacker)
            while line := text.readline(MOST_LINE):
                number += 1
                if number == 1 and line.startswith(UTF_16):
                    raise FileError(f"{path} is a text in UTF-16; save it in UTF-8")
                if len(line) == MOST_LINE and not line.endswith(b"\n"):
                    raise FileError(
                        f"line {number} of {path} is longer than {MOST_LINE:,} bytes, the most that is read"
                    )
                if not line.endswith(b"\n"):
                    words = f"line {number}, the last one, has no line break at its end; if it is complete, add one"
                    raise CutOff(path, number, words)
                yield line.removeprefix(UTF_8) if number == 1 else line
            if unpacker is not None and unpacker.is_torn:
                raise CutOff(path, number + 1, f"the compressed data are cut off after line {number}")
    except FileNotFoundError:
        raise FileError(f"{path} does not exist or is not a file") from None
    except (zlib.error, lzma.LZMAError, EOFError) as error:
        raise FileError(f"{path} is damaged after line {number}: {error}") from None
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from None


class _Unpacker(io.RawIOBase):
    """The unpacked content of a packed file, which may be several streams one after another.

    is_torn : True once the file was found to end in the middle of a stream.
    """

    def __init__(self, file: IO[bytes], make: Callable[[], Any]) -> None:
        """Begin with the first stream.

        file : the packed bytes.
        make : function that returns an object which unpacks one stream.
        """
        self.file, self.make, self.is_torn = file, make, False
        self.stream, self.packed = make(), b""

    def readable(self) -> bool:
        """Return True: it can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer with unpacked bytes; return how many there are, 0 at the end."""
        while True:
            if self.stream.eof:
                self.packed = self.stream.unused_data or self.file.read(READ_AT_ONCE)
                if not self.packed.strip(b"\0"):  # nothing, or what fills up blocks of a tape
                    return 0
                self.stream = self.make()
            self.packed = self.packed or self.file.read(READ_AT_ONCE)
            is_end = not self.packed
            found = self.stream.decompress(self.packed, len(buffer))
            self.packed = getattr(self.stream, "unconsumed_tail", b"")  # other streams keep it themselves
            if found:
                buffer[: len(found)] = found
                return len(found)
            if is_end and not self.stream.eof:
                self.is_torn = True
                return 0


def is_table(path: str | Path) -> bool:
    """Return True if `path` is named like a table of text: it ends in .csv, or in .csv and the ending of a packer."""
    name = Path(path).name.lower()
    return any(name.removesuffix(ending).endswith(".csv") for ending in (".gz", ".bz2", ".xz"))


def number_of(word: bytes) -> float:
    """Return the number that a word spells as C, Fortran (1.5D-01) or Python print it, not-a-number and infinities
    included; raise ValueError for other words.
    """
    if NUMBER.fullmatch(word):
        return float(word.replace(b"D", b"e").replace(b"d", b"e"))
    if word.lower().lstrip(b"+-") in (b"nan", b"inf", b"infinity"):
        return float(word)
    raise ValueError
