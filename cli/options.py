"""Options that commands share; those of a run come from the one table in runs/settings.py."""

import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from taichi_bearings.errors import InputError
from taichi_bearings.options import FILE, TRUTH, OneOf, Option, options_of
from taichi_bearings.plain_files import Json
from taichi_bearings.runs.settings import ALSO_CALLED, settings_table, users_of
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers.table import METHODS
from taichi_bearings.words import meant

FILE_SUFFIXES = (".csv", ".gif", ".h5", ".hdf5", ".html", ".json", ".mp4", ".pdf", ".png", ".svg", ".toml", ".txt")


class Text(click.types.StringParamType):
    """The type of a text option; the shell completes it to one of the names or, without names, to a file."""

    def __init__(self, *names: str) -> None:
        """Take the words (`names`) to which the shell completes what is typed; without any it completes to a file."""
        self.names = names

    def shell_complete(self, context: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return what the shell can complete the typed text `incomplete` to: names that begin with it, or files. Click
        calls this with its own context and option, which are not used.

        param : the option, not used.
        """
        if not self.names:
            return [CompletionItem(incomplete, type="file")]
        return [CompletionItem(name) for name in self.names if name.startswith(incomplete)]


class FileName(Text):
    """The type of a path; an option whose value is an empty text counts as not given."""

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Any:
        """Return the value as a path; None for an empty text, unless the parameter is an argument, which is not
        optional. Click calls this for each value, with its own context.
        """
        return Path(value) if value or isinstance(parameter, click.Argument) else None


class FolderName(FileName):
    """The type of a path of a folder that a command writes into; a name that ends like that of a file is refused."""

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Any:
        """Return the value as a path, None for an empty text. Click calls this for each value, with its own context.

        Raises InputError for a name that ends like that of a file, unless something of this name exists.
        """
        path = super().convert(value, parameter, context)
        if path is not None and path.suffix.lower() in FILE_SUFFIXES and not path.exists():
            raise InputError(
                f"--out is {value!r}; it is a folder for several files, so give a name without {path.suffix}"
            )
        return path


class Choice(click.Choice):
    """A choice of words that suggests the one that was likely meant by a mistyped word."""

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Any:
        """Return the word that a value chooses; for a mistyped one the error names the word that was likely meant.
        Click calls this for each value, with its own parameter and context.
        """
        try:
            return super().convert(value, parameter, context)
        except click.BadParameter as error:
            error.message = error.message.rstrip(".") + meant(value, map(str, self.choices))
            raise


FILES = Text()  # type of a name of a file that stays a text
FILE_PATH, FOLDER_PATH = FileName(), FolderName()  # types of paths


class SettingsCommand(click.Command):
    """A command that takes all settings of a run and further options.

    Values stay texts, which RunSettings reads. Its help has sections: what is solved, how, files, and a section for
    options that only some methods have. `--help` leaves out options that few need; `--help-all` shows everything.
    """

    def get_params(self, context: click.Context) -> list[click.Parameter]:
        """Return all options of the command: the settings of a run, further ones, and --help-all. Click calls this with
        its own context.
        """
        everything = click.Option(
            ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_everything,
            help="Show all options, those that few people need too, and exit.",
        )  # fmt: skip
        return [*_settings_options((*METHODS, *LAWS)), *super().get_params(context), everything]

    def parse_args(self, context: click.Context, words: list[str]) -> list[str]:
        """Return what click's own method returns: those `words` of a command line that are no options. The error for an
        option that has another name here says that name.
        """
        try:
            return super().parse_args(context, words)
        except click.NoSuchOption as error:
            if key := ALSO_CALLED.get(error.option_name.lstrip("-").replace("-", "_")):
                error.possibilities = [f"--{key.replace('_', '-')}"]
            raise

    def format_options(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of the help into `formatter`, section by section; the context of click says whether all are
        wanted.
        """
        sections = dict[str, list[tuple[str, str]]](
            (title, []) for title in ("What is solved", "How", "Files and output")
        )
        table = settings_table()
        for parameter in self.get_params(context):
            record = parameter.get_help_record(context) if isinstance(parameter, click.Option) else None
            item = table.get(parameter.name or "")
            if record and not (item and item.rare and not context.meta.get(EVERYTHING)):
                sections.setdefault(_section_of(item), []).append(record)
        for title, records in sections.items():
            with formatter.section(title):
                formatter.write_dl(records)


EVERYTHING = "taichi_bearings_cli.everything"  # key in a context's `meta`: True if its help leaves nothing out


def _show_everything(context: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print the help with all options and exit the context of the command, if `asked`: the callback of --help-all.

    _ : the option of click, not used.
    """
    if asked:
        context.meta[EVERYTHING] = True
        click.echo(context.get_help())
        context.exit()


def _section_of(item: Option | None) -> str:
    """Return the title of the section of the help in which an option stands.

    item : the setting of a run that the option gives; None for an option that is no such setting.
    """
    if item is None:
        return "Files and output"
    owners = users_of(item)[0]
    if owners != tuple(METHODS):
        return f"Options of {', '.join(owners)}"
    return "How" if item.of_solving else "What is solved"


@lru_cache(maxsize=8)
def _settings_options(_: tuple[str, ...]) -> list[click.Option]:
    """Return the settings of a run as options.

    _ : names of methods and laws. Users can register their own, so the cache has to depend on them.
    """
    options = []
    for key, item in settings_table().items():
        laws = users_of(item)[1]
        facts = [item.unit] if item.unit != "1" else []
        facts += [f"law {' or '.join(laws)}"] if len(laws) < len(LAWS) else []
        of_methods = {name: options_of(row)[key].default for name, row in METHODS.items() if key in options_of(row)}
        defaults = {_shown(default) for default in of_methods.values()} or {_shown(item.default)}
        if len(defaults) > 1:
            words = (f"{_shown(default)} with {name}" for name, default in of_methods.items())
            facts.append("default: " + ", ".join(words))
        elif defaults != {""}:
            facts.append(f"default: {defaults.pop()}")
        if key == "method":
            facts.insert(0, "; ".join(_laws_of_methods()))
        options.append(_click_option(key, item, f"{item.help} [{'; '.join(facts)}]" if facts else item.help))
    return options


def _laws_of_methods() -> list[str]:
    """Return in words which laws each method solves, without the methods that solve all laws."""
    solved = {name: [law.name for law in LAWS.values() if row.solves(law)] for name, row in METHODS.items()}
    return [f"{name}: law {' or '.join(laws)}" for name, laws in solved.items() if len(laws) < len(LAWS)]


def _click_option(key: str, item: Option, text: str) -> click.Option:
    """Return one setting as an option of the command line.

    key : name of the setting, with underscores.
    item : how its value is read, and which values are allowed.
    text : its help.
    """
    name = key.replace("_", "-")
    if item.kind is TRUTH:
        return click.Option([f"--{name}/--no-{name}", key], default=None, help=text)
    names = Text(*item.kind.known) if isinstance(item.kind, OneOf) else click.STRING
    completed = FILES if item.kind is FILE else names
    return click.Option([f"--{name}", key], default=None, metavar=item.kind.metavar, help=text, type=completed)


def options_in(table: Mapping[str, Option]) -> list[click.Parameter]:
    """Return some settings as options of the command line, whose values stay texts.

    table : settings by name, with underscores.
    """
    return [_click_option(key, item, item.help) for key, item in table.items()]


def _shown(default: object) -> str:
    """Return a default value of an option as the help shows it; "" for None."""
    if isinstance(default, bool):
        return "on" if default else "off"
    return "" if default is None else ",".join(map(str, default)) if isinstance(default, tuple) else str(default)


def answer(report: Json, as_json: bool, words: Callable[[], str]) -> None:
    """Print what a command has found: one JSON object, or a text.

    report : what was found, by name.
    as_json : True for the JSON object.
    words : function that returns the text.
    """
    click.echo(json.dumps(report, allow_nan=False) if as_json else words() + replica_shown(report))


def replica_shown(report: Json) -> str:
    """Return the end of a sentence that says which of several replicas a report is about; "" if there is only one."""
    if "replicas" not in report or not isinstance(report.get("replica"), int):
        return ""
    return f"; this is replica {report['replica']} of {report['replicas']}, counted from 0, which --replica chooses"


run_argument = click.argument("run", metavar="RUN", type=FILE_PATH)
replica_option = click.option(
    "--replica",
    type=click.IntRange(0),
    default=0,
    help="Number of the sample, counted from 0, if the run solved several seeds together.",
)
analyse_option = click.option(
    "--analyse", is_flag=True,
    help="First find what `bearings analyse` finds (slipless network, rigid domains, minimum cut). [default: show what "
    "it has written into the run, if anything]",
)  # fmt: skip
json_option = click.option("--json", "as_json", is_flag=True, help="Print exactly one JSON object on stdout.")


width_option = click.option(
    "--width",
    metavar="CM",
    default=None,
    help="Width of the printed figure: single (8.6 cm), double (17.8 cm) or a number of cm.",
)
dpi_option = click.option(
    "--dpi", type=click.IntRange(30, 2400), default=300, show_default=True,
    help="Resolution in dots an inch of PNG, and of images inside PDF and SVG.",
)  # fmt: skip
title_option = click.option("--title/--no-title", default=True, help="Put titles above figures. [default: on]")


def out_options(
    out: str, metavar: str = "DIR", force: str = "Replace existing files.", kind: click.ParamType | None = None
) -> Callable[[Any], Any]:
    """Return a decorator that adds the options --out and --force to a command.

    out, force : help texts.
    metavar : "DIR" if the value of --out is a folder, "FILE" if it is a file.
    kind : type of that value; None for a path that is refused if a folder is called like a file.
    """
    kind = kind or (FOLDER_PATH if metavar == "DIR" else FILE_PATH)

    def with_options(command: Any) -> Any:
        """Return the command with both options."""
        command = click.option("--force", is_flag=True, help=force)(command)
        return click.option("--out", metavar=metavar, type=kind, help=out)(command)

    return with_options
