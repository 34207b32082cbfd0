"""A stored run as a page: `bearings view`."""

from pathlib import Path
from typing import Any

from taichi_bearings.files.whole_file import refuse_ending, write_text
from taichi_bearings.runs.packing_run import is_packing_run, packing_to_draw
from taichi_bearings.runs.points_and_lines import opened_to_draw, points_and_lines
from taichi_bearings.stages import stage
from taichi_bearings.view.contents import arrays_of, arrays_of_packing, facts_of, facts_of_packing
from taichi_bearings.view.page import page_of

PAGE_NAME = "view.html"


def view(run: Path, out: Path | None = None, force: bool = False, replica: int = 0) -> dict[str, Any]:
    """Write the page of one sample of a run directory or its run.h5, and say where it is and how large.

    out : the file, an earlier one is replaced with `force` only; default: view.html in the run directory, which is.
    Raises InputError or FileError before anything is computed.
    """
    refuse_ending(out, ".html", ".htm")
    if is_packing_run(run):
        with packing_to_draw(run, out, PAGE_NAME, force, replica) as (found, path), stage("writing"):
            write_text(path, page_of(facts_of_packing(found), arrays_of_packing(found)))
        moments = None
    else:
        with opened_to_draw(run, out, PAGE_NAME, force) as (stored, path):
            drawn = points_and_lines(stored, replica)
            moments = drawn.moments
            with stage("writing"):
                write_text(path, page_of(facts_of(drawn), arrays_of(drawn)))
    return {
        "file": str(path),
        "bytes": path.stat().st_size,
        "snapshots": 0 if moments is None else len(moments.time),
    }
