"""A stored run as a page, `bearings view`: one HTML file that holds all that it shows and the library that draws it."""

import base64
import gzip
import html
import json
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.files.whole_file import refuse_ending, write_text
from taichi_bearings.runs.points_and_lines import points_and_lines
from taichi_bearings.runs.run_file import opened_to_draw, replica_drawn
from taichi_bearings.stages import stage
from taichi_bearings.version import VERSION
from taichi_bearings.view.contents import arrays_of, facts_of

PAGE_NAME = "view.html"
SCRIPTS = ("words", "squares", "sample", "picture", "legend", "pointing", "controls", "start")
NUMBER_TYPES = {"float32": "f4", "int32": "i4", "uint8": "u1"}


def view(
    run: str | Path, out: str | Path | None = None, force: bool = False, replica: int = 0, analyse: bool = False
) -> dict[str, Any]:
    """Write the page of one sample of a run directory or its run.h5, and say where it is, how large, and whether it
    shows the structure of the sample.

    out : the file, an earlier one is replaced with `force` only; default: view.html in the run directory, which is.
    analyse : compute the structure; else the page has of it what the file of the run holds.
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


def page_of(facts: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
    """The text of a page that needs nothing else, of what :mod:`taichi_bearings.view.contents` finds."""
    packed, places = _together(arrays)
    words = json.dumps({**facts, "arrays": places}, allow_nan=False).replace("<", "\\u003c")
    parts = {
        "TITLE": html.escape(str(facts["title"])),
        "STYLE": _text("style.css"),
        "VERSION": VERSION,
        "LICENCE": _text("three.LICENSE.txt"),
        "SCRIPT": "\n".join(_text(f"{name}.js") for name in SCRIPTS),
        "LIBRARY": _packed(_text("three.js").encode()),
        "FACTS": words,
        "ARRAYS": _packed(packed),
    }
    return re.sub("@@([A-Z]+)@@", lambda found: parts[found[1]], _text("index.html"))  # once: texts may look like that


def _text(name: str) -> str:
    return (files("taichi_bearings.view") / "page" / name).read_text(encoding="utf-8")


def _packed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, mtime=0)).decode()


def _together(arrays: Mapping[str, np.ndarray]) -> tuple[bytes, list[dict[str, Any]]]:
    """All arrays one after the other, little-endian, those with longer numbers first, and where each lies."""
    together, places = b"", []
    for name, values in sorted(arrays.items(), key=lambda item: -item[1].dtype.itemsize):
        kind = NUMBER_TYPES[values.dtype.name]
        places.append({"name": name, "kind": kind, "offset": len(together), "length": values.size})
        together += np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()
    return together, places
