"""Exceptions that a user may see: each message is one sentence that names the offending value."""


class BearingsError(Exception):
    """Base of all errors raised on purpose by this package."""


class InputError(BearingsError):
    """A value that cannot be used; the message names it and says what is allowed."""


class DeviceError(InputError):
    """The requested device, precision or thread count is not available here."""


class FileError(InputError):
    """A file that is missing, damaged, of an unknown layout, or in the way."""


class WriteError(FileError):
    """A file that cannot be written: no room, no permission, or gone. Nothing is wrong with what was to be written."""
