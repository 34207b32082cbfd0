"""Pages that are made from the code: the help of every command, and docstrings with the options of the methods."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, NumpyDocstring
from sphinx.util.logging import getLogger
from taichi_bearings_cli.main import bearings
from taichi_bearings_cli.options import EVERYTHING

from taichi_bearings.options import Option, options_of
from taichi_bearings.solvers import MethodOptions

LOGGER = getLogger(__name__)
WIDTH = 84  # columns of the help
SECTIONS = Config(napoleon_use_ivar=True)  # attributes are a list, not entries of the index


class Commands(Directive):
    """`--help` of every command, in the words of the code: a section each."""

    def run(self) -> list[nodes.Node]:
        return [
            _section(context)
            for context in contexts(click.Context(bearings, info_name="bearings", **bearings.context_settings))
        ]


def contexts(context: click.Context) -> Iterator[click.Context]:
    """Of the command and of all below it."""
    yield context
    if isinstance(context.command, click.Group):
        for name in context.command.list_commands(context):
            command = context.command.get_command(context, name)
            assert command is not None
            yield from contexts(click.Context(command, parent=context, info_name=name))


def _section(context: click.Context) -> nodes.section:
    context.terminal_width = context.max_content_width = WIDTH
    context.meta[EVERYTHING] = True
    words = context.command_path
    title, text = nodes.title(text=words), context.command.get_help(context)
    help = nodes.literal_block(text, text, language="text")
    return nodes.section("", title, help, ids=[nodes.make_id(words)], names=[words])


def written_as_rst(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Rewrite the lines of a docstring for Sphinx: sections as NumPy has them, and plain text in which
    `name : meaning` begins an entry of a list."""
    if any(set(line.strip()) == {"-"} for line in lines):
        lines[:] = str(NumpyDocstring(lines, SECTIONS, app, what, name, thing)).splitlines()
    if isinstance(thing, type) and issubclass(thing, MethodOptions):
        lines += ["", *(_of_option(name, option) for name, option in options_of(thing).items())]
    found: list[str] = []
    for line in re.sub(r"(?<=[.;]) (?=[a-z]\w*(, \w+)* : )", "\n", "\n".join(lines)).split("\n"):
        line = re.sub(r"(?<![:`\w])`([^`<>]+)`(?!`)", r"``\1``", line)
        line = re.sub(r"([*|])(?=(?:[^`]*`[^`]*`)*[^`]*$)", r"\\\1", line)
        entry = re.match(r"([a-z]\w*(?:, \w+)*) : (.*)", line)
        if entry:
            line = f"* **{entry[1]}**: {entry[2]}"
        elif line.startswith(" ") and any(before.startswith("* ") for before in found[-12:]):
            line = f"  {line.lstrip()}"
        if (entry and found and not found[-1].startswith(("* ", "  "))) or (not entry and _ends_list(found, line)):
            found.append("")
        found.append(line)
    lines[:] = found


def _ends_list(found: list[str], line: str) -> bool:
    return bool(found and found[-1].startswith(("* ", "  ")) and line.strip() and not line.startswith("  "))


def _of_option(name: str, option: Option) -> str:
    unit = f" [{option.unit}]" if option.unit != "1" else ""
    return f"{name} : {option.help}{unit} Default: {'none' if option.default is None else option.default}."


FETCHED = re.compile(
    r"""(<script[^>]*\ssrc=|<img[^>]*\ssrc=|<link[^>]*\shref=|url\(|@import)\s*["']?(https?:)?//[^"')]+"""
)


def warn_of_remote_resources(app: Sphinx, exception: Exception | None) -> None:
    """Warns, and so fails, where a page loads anything from elsewhere. Links that readers follow are none."""
    if exception or app.builder.format != "html":
        return
    pages = [page for kind in ("html", "css", "js") for page in Path(app.outdir).rglob(f"*.{kind}")]
    for page in pages:
        for match in FETCHED.finditer(page.read_text(encoding="utf-8")):
            LOGGER.warning("the site must load nothing from elsewhere; %s has %s", page, match[0])


def setup(app: Sphinx) -> None:
    app.add_directive("commands", Commands)
    app.connect("autodoc-process-docstring", written_as_rst)
    app.connect("build-finished", warn_of_remote_resources)
