"""Commands on a terminal: what each writing of its line says."""

import contextlib
import os
import re
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, field

CONTROL = re.compile(rb"\x1b\[[0-9;?]*[A-Za-z]")


@dataclass
class Session:
    """frames : (seconds since the start, text) of each writing. raw : all that stderr wrote."""

    returncode: int
    stdout: str
    frames: list[tuple[float, str]] = field(default_factory=list)
    raw: bytes = b""
    seconds: float = 0.0


def on_terminal(*words, columns=100, stop=None, by=2, report=False, cwd=None, program=("-m", "taichi_bearings_cli")):
    """Run `bearings` with stderr on a pseudo-terminal of that width.

    stop : ends it by Ctrl-C, or by another signal, once this is written. report : stdout is on the terminal too.
    program : words for Python that start another program instead.
    """
    import fcntl
    import pty
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    command = [sys.executable, *program, *map(str, words)]
    stdout = theirs if report else subprocess.PIPE
    began, session = time.monotonic(), Session(-1, "")
    with subprocess.Popen(
        command,
        stdout=stdout,
        stderr=theirs,
        text=True,
        env=environment | {"TERM": "xterm"},
        cwd=cwd,
    ) as process:
        os.close(theirs)
        with contextlib.suppress(OSError):  # EIO: the other end is closed
            while part := os.read(ours, 65536):
                session.raw += part
                text = CONTROL.sub(b"\r", part).decode(errors="replace")
                now = time.monotonic() - began
                session.frames += [(now, line.strip()) for line in re.split(r"[\r\n]+", text) if line.strip()]
                if stop is not None and any(stop in line for _, line in session.frames):
                    process.send_signal(by)
                    stop = None
        session.stdout = "" if report else process.stdout.read()
    os.close(ours)
    session.returncode, session.seconds = process.returncode, time.monotonic() - began
    return session
