"""A process in which nothing can be written: what opens, makes or moves a file fails as on a read-only disk."""

import contextlib
import errno
import os
import resource
import sys

MAKING = (
    "os.mkdir",
    "os.rename",
    "os.remove",
    "os.rmdir",
    "os.link",
    "os.symlink",
    "shutil.rmtree",
    "tempfile.mkstemp",
)
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_forbidden = False


def _hook(event, arguments):
    if not _forbidden or event not in ("open", *MAKING):
        return
    path = arguments[0]
    if event == "open" and (isinstance(path, int) or not (arguments[2] or 0) & WRITING or str(path) == os.devnull):
        return
    if event == "os.mkdir" and os.path.isdir(path):
        return  # the system says that it is there, whatever the disk
    raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))


sys.addaudithook(_hook)


@contextlib.contextmanager
def no_writing():
    """Python's ways to write fail, and no file can be given a byte, which holds for other code too, but for none that
    children write (they inherit the limit)."""
    global _forbidden
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    _forbidden = True
    try:
        yield
    finally:
        _forbidden = False
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
