"""Commands and choices that say which word was likely meant."""

from typing import Any

import click

from taichi_bearings.words import meant


class Group(click.Group):
    """A group of commands that suggests the one whose name was mistyped."""

    def resolve_command(self, context: click.Context, words: list[str]) -> Any:
        known = self.list_commands(context)
        if words and words[0] not in known and not words[0].startswith("-"):
            context.fail(f"No such command {words[0]!r}{meant(words[0], known)}")
        return super().resolve_command(context, words)


class Choice(click.Choice):
    """A choice of words that suggests the one that was mistyped."""

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Any:
        try:
            return super().convert(value, parameter, context)
        except click.BadParameter as error:
            error.message = error.message.rstrip(".") + meant(value, map(str, self.choices))
            raise
