"""Exceptions that a user may see: each message is one sentence that names the offending value."""

MOST_LETTERS = 1000  # most letters of a message; the middle of a longer one is left out


class BearingsError(Exception):
    """Base of all errors raised on purpose by this package.

    Its text is one line that does nothing to a terminal: control characters, which names and files may hold, are
    escaped, and the middle of a long text is left out.
    """

    def __str__(self) -> str:
        """Return the text of the error as one line, escaped and shortened."""
        text = super().__str__()
        if len(text) > MOST_LETTERS:
            text = f"{text[: 2 * MOST_LETTERS // 3]} ... {text[-MOST_LETTERS // 3 :]}"
        return printable(text)


def printable(text: str) -> str:
    """Return a text as one line that does nothing to a terminal or a table: control characters and line ends are
    escaped.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def warn(sentence: object) -> None:
    """Log a sentence as a warning, after "bearings: "."""
    import logging  # which --help does without

    logging.getLogger("taichi_bearings").warning("bearings: %s", sentence)


class InputError(BearingsError):
    """Raised for a value that cannot be used; the message names it and says what is allowed."""


class DeviceError(InputError):
    """Raised if the requested device, precision or number of threads is not available here."""


class FileError(InputError):
    """Raised for a file that is missing, damaged, of an unknown layout, or in the way."""


class WriteError(FileError):
    """Raised for a file that cannot be written, since the disk is full, access is denied, or the folder is gone. The
    data to be written are not to blame.
    """
