"""The page: one HTML file that holds everything it shows and the library that draws it."""

import base64
import gzip
import html
import json
import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from taichi_bearings.version import VERSION

SCRIPTS = ("words", "squares", "sample", "picture", "legend", "pointing", "controls", "start")
NUMBER_TYPES = {"float32": "f4", "int32": "i4", "uint8": "u1"}


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
