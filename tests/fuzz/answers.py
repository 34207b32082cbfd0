"""What the program answers to a command line, within this process, and whether that is an answer at all."""

import contextlib
import io
import os
import re
import sys
import traceback
from dataclasses import dataclass
from pathlib import Path

LIMIT = 300_000_000  # bytes of memory beyond what a process has before a small file, as docs/files.md promises


@dataclass(frozen=True)
class Answer:
    """grown : bytes of memory that this process took meanwhile at its height."""

    words: tuple[str, ...]
    code: int
    errors: str
    traceback: str
    grown: int

    @property
    def fault(self) -> str:
        """What is wrong with it; empty if it is a result or one clear sentence."""
        if self.traceback:
            return self.traceback
        if self.code not in (0, 1, 2):
            return f"exit code {self.code}"
        if self.grown > LIMIT:
            return f"{self.grown:,} bytes of memory"
        if "not enough memory" in self.errors:
            return self.errors
        if self.code == 2 and self.errors.startswith("Usage: ") and "\nError: " in self.errors:  # the user's own words
            return ""
        lines = [line for line in self.errors.splitlines() if not line.startswith(("Usage: ", "Try ")) and line]
        said = [line for line in lines if line.startswith(("bearings: ", "Error: "))]
        if self.code == 2 and (
            not said
            or len(said) != len(lines)
            or any(line.startswith("bearings") and len(line) > 2000 for line in said)
        ):
            return f"no clear sentence: {self.errors!r}"
        return "control characters" if re.search(r"[\x00-\x09\x0b-\x1f\x7f]", self.errors) else ""


def answer_to(*words: object) -> Answer:
    """Run `bearings` with these words, as its entry point does."""
    from taichi_bearings_cli.main import main

    given, before, trace, code = tuple(map(str, words)), sys.argv, "", 0
    outputs, errors, start = io.StringIO(), io.StringIO(), _start_of_memory()
    sys.argv = ["bearings", *given]
    with contextlib.redirect_stdout(outputs), contextlib.redirect_stderr(errors):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
        except Exception:
            trace = traceback.format_exc()
        finally:
            sys.argv = before
    return Answer(given, code, errors.getvalue(), trace, _memory("VmHWM") - start)


def _start_of_memory() -> int:
    """Bytes in use now, the mark of the height set back to them."""
    if not Path("/proc/self/clear_refs").exists():
        return 0
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as marks:
        marks.write("5")
    return _memory("VmRSS")


def _memory(name: str) -> int:
    if not os.path.exists("/proc/self/status"):
        return 0
    return 1024 * int(re.search(rf"{name}:\s+(\d+)", Path("/proc/self/status").read_text())[1])  # type: ignore[index]
