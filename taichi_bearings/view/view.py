"""A stored run as a page: `bearings view`."""

from pathlib import Path
from typing import Any

from taichi_bearings.errors import InputError
from taichi_bearings.files.whole_file import refuse_standing, write_text
from taichi_bearings.runs.points_and_lines import points_and_lines
from taichi_bearings.runs.run_file import read_run_file
from taichi_bearings.stages import stage
from taichi_bearings.view.contents import arrays_of, facts_of
from taichi_bearings.view.page import page_of

NAME = "view.html"


def view(run: Path, out: Path | None = None, force: bool = False, replica: int = 0) -> dict[str, Any]:
    """Write the page of one sample of a run directory or its run.h5, and say where it is and how large.

    out : the file, an earlier one is replaced with `force` only; default: view.html in the run directory, which is.
    Raises InputError or FileError before anything is computed.
    """
    if out is not None and out.suffix not in (".html", ".htm"):
        raise InputError(f"out is {str(out)!r}; it must end in .html")
    with stage("reading"):
        stored = read_run_file(run)
    path = stored.path.parent / NAME if out is None else out
    refuse_standing([path], force or out is None)
    drawn = points_and_lines(stored, replica)
    with stage("writing"):
        write_text(path, page_of(facts_of(drawn), arrays_of(drawn)))
    return {
        "file": str(path),
        "bytes": path.stat().st_size,
        "snapshots": 0 if drawn.moments is None else len(drawn.moments.time),
    }
