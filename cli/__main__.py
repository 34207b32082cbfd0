"""The console script, and python -m taichi_bearings_cli: listens to Ctrl-C before anything large is loaded."""

import os
import signal
import sys
from typing import NoReturn

BEFORE = "bearings: interrupted before a first result was reached; nothing is kept"


def _end(*_: object) -> NoReturn:
    """Print that nothing is kept, and end the process: the handler of Ctrl-C while the program loads."""
    os.write(2, f"{BEFORE}\n".encode())
    os._exit(130)


for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, _end)

from taichi_bearings import interrupts, leaving  # noqa: E402


def _prepare() -> None:
    """Have commands load less, and keep the memory that arrays give back: before NumPy is loaded, which --version and
    --help do without."""
    from taichi_bearings.later import postpone

    postpone()
    from taichi_bearings.memory import keep_freed

    keep_freed()


def main() -> None:
    """Run the command line. Ctrl-C ends it with a sentence and exit code 130 at any time."""
    try:
        interrupts.end_at_signals()
        from taichi_bearings.later import collect_cycles_seldom

        collect_cycles_seldom()
        from taichi_bearings_cli.main import main as bearings

        bearings(_prepare)
    except KeyboardInterrupt:
        interrupts.ignore_signals()
        leaving.end_now(BEFORE)
        print(BEFORE, file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
