"""Shows on a terminal how far a command is. If the output goes into a pipe, nothing is shown."""

import os
import re
import shutil
import stat
import sys
import textwrap
import time
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from taichi_bearings_cli import STARTED

from taichi_bearings import progress
from taichi_bearings.progress import TerminalLine, duration

if TYPE_CHECKING:
    from taichi_bearings.scans.scan import ScanProgress

COLUMN_GAP = re.compile(r"(?<=\S) {2,}(?=\S)")
Display = partial(progress.Display, STARTED)  # its times begin with the process


def in_lines(text: str, err: bool = False) -> str:
    """Return a report for printing: as it is, or for a terminal with long lines broken between words. The rest of a
    line then begins below its last column, or is indented where it has no columns.

    text : the report.
    err : True if it is printed on stderr.
    """
    stream = sys.stderr if err else sys.stdout  # None where it is closed
    if stream is None or not stream.isatty():
        return text
    look: Any = {"break_long_words": False, "break_on_hyphens": False, "replace_whitespace": False}
    width = shutil.get_terminal_size().columns
    lines = ((line, " " * _indent(line, width)) for line in text.splitlines())
    return "\n".join(textwrap.fill(line, width, subsequent_indent=indent, **look) for line, indent in lines)


def _indent(line: str, width: int) -> int:
    """Return by how many letters the continuation of a long line is indented: up to the last column of the line if a
    third of the width is left there, else by four letters more than the line. Two spaces separate columns.

    line : the line.
    width : letters in a line of the terminal.
    """
    column = max((gap.end() for gap in COLUMN_GAP.finditer(line)), default=width)
    return column if column <= 2 * width // 3 else len(line) - len(line.lstrip()) + 4


HEARTBEAT = 30.0  # seconds between two lines in a log file


class ScanDisplay(TerminalLine):
    """Shows how far a scan is: as one line that changes, if stderr is a terminal; as a new line every HEARTBEAT
    seconds, if it is a log file.
    """

    def __init__(self) -> None:
        """Begin to show; until the first call of the display the line says "reading"."""
        self.progress: ScanProgress | None = None
        super().__init__(lambda: "reading" if self.progress is None else describe_scan(self.progress, samples=True))
        self.is_logged, self.last_line = False, time.monotonic()
        with suppress(OSError, ValueError, AttributeError):  # the log of a batch queue is a regular file
            self.is_logged = stat.S_ISREG(os.fstat(sys.stderr.fileno()).st_mode)

    def __call__(self, progress: "ScanProgress") -> None:
        """Take note of how far the scan is now, and write a line if the log is due for one.

        progress : a `ScanProgress`: numbers of samples, rate, time left.
        """
        self.progress = progress
        if self.is_logged and time.monotonic() - self.last_line >= HEARTBEAT:
            self.last_line = time.monotonic()
            stamp = time.strftime("%Y-%m-%d %H:%M:%S")
            print(f"{stamp}  {describe_scan(progress)}", file=sys.stderr, flush=True)


def describe_scan(progress: "ScanProgress", samples: bool = False) -> str:
    """Return how far a scan is, in one line.

    progress : a :class:`taichi_bearings.scans.scan.ScanProgress`: numbers of samples, rate, time left, and what is
        being solved.
    samples : True to name samples that are being solved, too.
    """
    words = [f"{progress.done:,} of {progress.total:,} samples"]
    words += [f"{progress.failed:,} failed"] if progress.failed else []
    words += [f"{progress.rate:.3g}/s"] if progress.rate else []
    left = progress.seconds_left
    if progress.done + progress.failed == progress.total:
        return "  ".join([*words, "writing"])
    words += [f"{duration(left)} left"] if left is not None else []
    if samples and progress.running:
        words.append("now " + "; ".join(sample.label for sample in progress.running[:2]))
        words += [f"and {len(progress.running) - 2} more"] if len(progress.running) > 2 else []
    return "  ".join(words)
