"""Entry point of the console script `bearings`. Commands load what they need only when they run."""

import errno
import importlib
import io
import logging
import os
import sys
from collections.abc import Callable
from typing import Any

import click

from taichi_bearings import interrupts, leaving
from taichi_bearings.errors import BearingsError
from taichi_bearings.version import VERSION
from taichi_bearings.words import meant

COMMANDS = {  # name -> one line for --help
    "run": "Solve one system, or one for each of several seeds, and write a run directory.",
    "scan": "Solve systems over a grid of parameters, on all processors; can be resumed.",
    "verify": "Check what the file of a run proves about its power and its contacts.",
    "analyse": "Find minimum cut, slipless network, rigid domains, bottlenecks and forces of a run.",
    "histogram": "Draw the distribution of the power per contact of runs and scans.",
    "plot": "Draw one figure from a run or a scan.",
    "list": "List the runs and scans in a folder, with what they hold.",
    "view": "Make an interactive 3D page of a run, in one HTML file.",
    "export": "Write a run as a file for ParaView, or its problem for other solvers.",
    "movie": "Make a film of the snapshots of a dynamics.",
    "reproduce": "Draw the figures of the paper, with a verdict for each of its claims.",
    "benchmark": "Measure speed and accuracy, beside other programs.",
    "stress": "Try every method at extreme inputs, judged by exact truths.",
    "cite": "Print how to cite the program and its paper.",
    "info": "Show versions, devices, precision and cache; or what a packing file holds.",
}
GROUPS = {
    "Solve": ("run", "scan"),
    "Look": ("list", "plot", "histogram", "view", "movie", "export"),
    "Check and understand": ("verify", "analyse"),
    "Study": ("reproduce", "benchmark", "stress"),
    "About the program": ("info", "cite"),
}
"""The commands as `bearings --help` lists them."""
INTERRUPTED = f"bearings: {leaving.NOTHING_KEPT}"


class LazyGroup(click.Group):
    """A group that lists its commands without importing them, so that --help answers at once.

    For an unknown command it suggests the one that was likely meant.

    prepare : function that is called before a command is imported.
    """

    prepare: Callable[[], None] = staticmethod(lambda: None)

    def resolve_command(self, context: click.Context, words: list[str]) -> Any:
        """Return what click's own method returns: name, command and the other words. The error for an unknown command
        names the one that was likely meant.

        context : of click.
        words : the words of the command line from the name of the command on.
        """
        if words and words[0] not in COMMANDS and not words[0].startswith("-"):
            context.fail(f"No such command {words[0]!r}{meant(words[0], COMMANDS)}")
        return super().resolve_command(context, words)

    def list_commands(self, context: click.Context) -> list[str]:
        """Return the names of all commands, whatever the context of click."""
        return list(COMMANDS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """Return the command with this name, imported now; None if there is none. The context of click is not used."""
        if name not in COMMANDS:
            return None
        self.prepare()
        return importlib.import_module(f"taichi_bearings_cli.{name}").command

    def format_commands(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands of the help into `formatter`, group by group; the context of click is not used."""
        for title, names in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name, COMMANDS[name]) for name in names], col_max=12)


@click.command(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(VERSION, prog_name="bearings", message="%(prog)s %(version)s")
def bearings() -> None:
    """Solve frustrated bearings: touching spheres whose driven planes rotate differently, so that contacts must slip.

    The state of least dissipated power is found with a proven bound, and the dynamics that leads to it. A contact is
    slipless if the two spheres roll on each other without slip.

    \b
    Example:
      bearings run --shape 10,10,10 --seed 1 --tolerance 1e-5
    """


def main(prepare: Callable[[], None] | None = None) -> None:
    """Run the command line, and exit. An error made by the user is one sentence and exit code 2, never a traceback.

    prepare : function that is called before a command is imported; None for none.
    """
    if prepare is not None:
        bearings.prepare = prepare
    interrupts.raise_at_signals()
    os.environ["MPLBACKEND"] = "agg"  # a notebook's shell names its own, which need not be installed here
    os.environ.setdefault(
        "HDF5_USE_FILE_LOCKING", "FALSE"
    )  # files are replaced in one move; some systems have no locks
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # users need no messages on its font cache
    if os.path.lexists("matplotlibrc"):  # it may come from somebody else, and some settings start programs
        click.echo(
            "bearings: the file matplotlibrc in this folder is ignored; to use one, name it in the environment "
            "variable MATPLOTLIBRC",
            err=True,
        )
        here = os.getcwd()
        os.chdir(os.sep)
        try:
            importlib.import_module("matplotlib")
        finally:
            os.chdir(here)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # letters that the locale lacks are escaped, and raise no error
            stream.reconfigure(errors="backslashreplace")
    try:
        code = _exit_code()
    except KeyboardInterrupt:
        code = _interrupted(INTERRUPTED)
    except Exception:
        if not leaving.has_raised():
            raise
        code = _interrupted(INTERRUPTED)  # a library has turned the KeyboardInterrupt into another error
    interrupts.ignore_signals()
    if code == leaving.EXIT_CODE:
        leaving.end_now()
    leaving.note_exit_code(code)
    sys.exit(code)


def _interrupted(sentence: str) -> int:
    """Print that a command was interrupted, and return the exit code. If the process is the command's own, it ends
    here at once, without waiting for its threads.

    sentence : what is printed.
    """
    interrupts.ignore_signals()
    leaving.end_now(sentence)
    click.echo(sentence, err=True)
    return leaving.EXIT_CODE


def _exit_code() -> int:
    """Run the command that the arguments of this process name, print its error if there is one, and return the exit
    code.
    """
    try:
        code = bearings.main(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return 2
    except click.Abort as error:  # which click makes of a KeyboardInterrupt
        return _interrupted(str(error.__cause__ or "") or INTERRUPTED)
    except BearingsError as error:
        click.echo(f"bearings: {error}", err=True)
        return 2
    except MemoryError as error:
        click.echo(f"bearings: not enough memory for this scene: {error}", err=True)
        return 1
    except (BrokenPipeError, SystemExit):  # the reader of our output has closed it; click may raise SystemExit for that
        sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno())
        return 0
    except OSError as error:
        click.echo(f"bearings: {BearingsError(str(error))}", err=True)
        return 2 if error.errno == errno.ENAMETOOLONG else 1  # too long a name is an error of the user
    return code if isinstance(code, int) else 0
