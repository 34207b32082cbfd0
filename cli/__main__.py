"""The console script, and python -m taichi_bearings_cli: Ctrl-C is heard before anything large is loaded."""

import sys

from taichi_bearings import interrupts


def main() -> None:
    """Run the command line."""
    interrupts.heard_at_once()
    try:
        from taichi_bearings_cli.main import main as bearings

        bearings()
    except KeyboardInterrupt:
        interrupts.ignored()
        print("bearings: interrupted before a first result was reached; nothing is kept", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
