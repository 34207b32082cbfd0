"""Exceptions that a user may see: each message is one sentence that names the offending value."""

MOST_LETTERS = 1000


class BearingsError(Exception):
    """Base of all errors raised on purpose by this package. As a text it is one line that does nothing to a terminal:
    control characters, which names and files may hold, are escaped, and the middle of a long one is left out."""

    def __str__(self) -> str:
        text = super().__str__()
        if len(text) > MOST_LETTERS:
            text = f"{text[: 2 * MOST_LETTERS // 3]} ... {text[-MOST_LETTERS // 3 :]}"
        return printable(text)


def printable(text: str) -> str:
    """A text as one line that does nothing to a terminal or a table: control characters and line ends are escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class InputError(BearingsError):
    """A value that cannot be used; the message names it and says what is allowed."""


class DeviceError(InputError):
    """The requested device, precision or thread count is not available here."""


class FileError(InputError):
    """A file that is missing, damaged, of an unknown layout, or in the way."""


class WriteError(FileError):
    """A file that cannot be written: no room, no permission, or gone. Nothing is wrong with what was to be written."""
