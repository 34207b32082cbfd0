"""Writes a stored run as a page, `bearings view`: one HTML file with all that it shows and the library that draws
it.
"""

import base64
import gzip
import html
import json
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

import numpy as np

from taichi_bearings.files.whole_file import refuse_ending, write_text
from taichi_bearings.plain_files import Json
from taichi_bearings.runs.points_and_lines import points_and_lines
from taichi_bearings.runs.run_file import opened_to_draw, replica_drawn
from taichi_bearings.stages import stage
from taichi_bearings.version import VERSION
from taichi_bearings.view.contents import arrays_of, facts_of

PAGE_NAME = "view.html"
SCRIPTS = ("words", "squares", "sample", "picture", "legend", "pointing", "controls", "start")
NUMBER_TYPES = {"float32": "f4", "int32": "i4", "uint8": "u1"}  # types of arrays in a page, and their short names


def view(
    run: str | Path, out: str | Path | None = None, force: bool = False, replica: int = 0, analyse: bool = False
) -> Json:
    """Write one sample of a run as an interactive HTML page. Return by name the path of the file, its size in bytes,
    the number of snapshots, and whether the page shows the structure.

    run : a run directory or its run.h5.
    out : the file; an earlier one is replaced only with `force`. None for view.html in the run directory, where an
        earlier one is replaced.
    force : True to replace a file `out`.
    replica : number of the sample, from 0.
    analyse : True to compute the structure of the sample (domains, network, cut); False to show of it only what the run
        file holds.

    Raises InputError or FileError before anything is computed.
    """
    out = None if out is None else Path(out)
    refuse_ending(out, ".html", ".htm")
    with opened_to_draw(run, out, PAGE_NAME, force, replica) as (found, path):
        drawn = points_and_lines(found, replica, analyse)
        with stage("writing"):
            write_text(path, page_of(facts_of(drawn), arrays_of(drawn)))
    moments = drawn.moments
    shown = {"snapshots": 0 if moments is None else len(moments.time), "analysed": drawn.drawn.is_known}
    return {"file": str(path), "bytes": path.stat().st_size, **shown, **replica_drawn(found, replica)}


def page_of(facts: Mapping[str, object], arrays: Mapping[str, np.ndarray]) -> str:
    """Return the HTML text of a page that needs no other file.

    facts : numbers and words by name.
    arrays : what is drawn, by name. Both come from :mod:`taichi_bearings.view.contents`.
    """
    packed, places = _joined_bytes(arrays)
    words = json.dumps({**facts, "arrays": places}, allow_nan=False).replace("<", "\\u003c")
    parts = {
        "TITLE": html.escape(str(facts["title"])),
        "STYLE": _text("style.css"),
        "VERSION": VERSION,
        "LICENCE": _text("three.LICENSE.txt"),
        "SCRIPT": "\n".join(_text(f"{name}.js") for name in SCRIPTS),
        "LIBRARY": _compressed_text(_text("three.js").encode()),
        "FACTS": words,
        "ARRAYS": _compressed_text(packed),
    }
    # all parts are put in at once: their texts may hold what looks like the name of another part
    return re.sub("@@([A-Z]+)@@", lambda found: parts[found[1]], _text("index.html"))


def _text(name: str) -> str:
    """Return the content of one of the files from which the page is made, such as a script.

    name : name of the file.
    """
    return (files("taichi_bearings.view") / "page" / name).read_text(encoding="utf-8")


def _compressed_text(content: bytes) -> str:
    """Return bytes compressed by gzip and written as base64 text."""
    return base64.b64encode(gzip.compress(content, mtime=0)).decode()


def _joined_bytes(arrays: Mapping[str, np.ndarray]) -> tuple[bytes, list[Json]]:
    """Return the bytes of all arrays in one piece, little-endian, and a list with name, type, offset in bytes and
    length of each array. Longer numbers come first, so that every array begins at a multiple of its number's size.
    """
    joined, places = b"", []
    for name, values in sorted(arrays.items(), key=lambda item: -item[1].dtype.itemsize):
        kind = NUMBER_TYPES[values.dtype.name]
        places.append({"name": name, "kind": kind, "offset": len(joined), "length": values.size})
        joined += np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()
    return joined, places
