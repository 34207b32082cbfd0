"""Puts numbers, values and mistyped words into sentences for people."""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

LIKE_LETTERS = 0.6  # least share of the letters that a mistyped word has in common with what was meant
MOST_SHOWN, LEAST_SHOWN = 100, 8  # most letters of a value in a sentence; letters at the end of one that is shortened
MOST_ROWS = 20  # of a table in a notebook
LEAST_LETTERS = 3  # a shorter word is not taken for the beginning of another


def counted(number: int, what: str) -> str:
    """Return a number with a noun.

    what : the noun in the singular.

    >>> counted(1, "iteration"), counted(1200, "sample")
    ('1 iteration', '1,200 samples')
    """
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def shown(value: Any) -> str:
    """Return a value as Python writes it, without the middle if it is long, for the sentence that refuses it.

    >>> shown("1,1"), shown(10**400)
    ("'1,1'", '1000000000000000...00000000')
    """
    try:
        is_numpy = hasattr(value, "tolist") and not hasattr(value, "mask")
        text = " ".join(repr(value.tolist() if is_numpy else value).split())
    except ValueError:  # more digits than Python writes
        return "a number of thousands of digits"
    return text if len(text) <= MOST_SHOWN else f"{text[: 2 * LEAST_SHOWN]}...{text[-LEAST_SHOWN:]}"


def meant(word: object, known: Iterable[str]) -> str:
    """Return the end of a sentence that refuses a word: the known word that was likely meant; "" if there is none.

    >>> meant("interior_pont", ["planar-cut", "interior-point"]), meant("gradient", ["gradient-descent"])
    ("; did you mean 'interior-point'?", "; did you mean 'gradient-descent'?")
    >>> meant("x", ["planar-cut"])
    ''
    """
    names = {_folded(name): name for name in known}
    text = _folded(word)
    near = difflib.get_close_matches(text, names, n=1, cutoff=LIKE_LETTERS)
    near = near or [name for name in names if len(text) >= LEAST_LETTERS and name.startswith(text)]
    return f"; did you mean {names[near[0]]!r}?" if near else ""


def html_table(title: str, rows: Iterable[Sequence[object]], head: Sequence[str] = ()) -> str:
    """Return a title, such as a `repr`, and a table as HTML for notebooks.

    title : the title.
    rows : values of each row. Without a head these are a name and a value, and rows whose value is no number, text or
        tuple are left out.
    head : titles of the columns.

    >>> html_table("<Scene>", [("law", "<b>")])
    '<p>Scene</p><table><tr><th>law</th><td>&lt;b&gt;</td></tr></table>'
    """
    import html  # whose table of entities commands do not need

    def cell(value: object, kind: str = "td") -> str:
        """Return a value as a cell of a table; kind : "th" for a title, "td" for others."""
        text = format(value, ".10g") if isinstance(value, float) else str(value)
        return f"<{kind}>{html.escape(text.replace('_', ' ') if kind == 'th' else text)}</{kind}>"

    lines = ["".join(cell(name, "th") for name in head)] if head else []
    chosen = [row for row in rows if head or isinstance(row[1], (str, int, float, tuple))]
    for first, *others in chosen[:MOST_ROWS]:
        lines.append(cell(first, "td" if head else "th") + "".join(map(cell, others)))
    more = f"<br>and {len(chosen) - MOST_ROWS:,} more" if len(chosen) > MOST_ROWS else ""
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<p>{html.escape(title.strip('<>'))}</p><table>{body}</table>{more}"


def _folded(word: object) -> str:
    """Return a word in small letters with - for _, for comparison."""
    return str(word).lower().replace("_", "-")


def other_contacts(tied: int, undecided: int) -> list[str]:
    """Return how many contacts are tied (slip at some minima only) and undecided, in words; nothing where none are.

    >>> other_contacts(56, 1), other_contacts(0, 0)
    (['56 tied', '1 undecided'], [])
    """
    return [f"{number:,} {kind}" for number, kind in ((tied, "tied"), (undecided, "undecided")) if number]


def driving_words(values: Mapping[str, object]) -> str:
    """Return periodic axes and driving of a run as the end of a list, named as its options; "" where none was given.

    values : options of the run by name.

    >>> driving_words({"periodic": ["x", "y"], "top": [1.0, 1.0, 0.0, 0.2], "bottom": [0.5], "driven": None})
    ', periodic x,y, top 1,1,0;0.2, bottom 0.5'
    """
    words = []
    for name in ("periodic", "top", "bottom", "driven"):
        value = values.get(name)
        parts = [f"{part:g}" if isinstance(part, float | int) else part for part in listed(value)]
        if value:
            state, rate = ",".join(parts[:3]), "".join(f";{part}" for part in parts[3:])
            words.append(f", {name} {state}{rate}")
    return "".join(words)


def sized(values: Mapping[str, Any]) -> str:
    """Return the size of what was solved, in words.

    values : options and numbers of the run by name, of which shape, or spheres and driven_spheres, are used.

    >>> sized({"shape": [10, 10]}), sized({"shape": None, "spheres": 256, "driven_spheres": 32})
    ('10x10', '256 spheres (32 driven),')
    """
    if values.get("spheres"):
        driven = f" ({values['driven_spheres']:,} driven)" if "driven_spheres" in values else ""
        return f"{counted(values['spheres'], 'sphere')}{driven},"
    return "x".join(map(str, values["shape"])) if isinstance(values["shape"], list) else str(values["shape"] or "")


def listed(value: object) -> list[Any]:
    """Return a value as a list: a list or tuple with its entries, anything else as the only entry."""
    return list(value) if isinstance(value, (list, tuple)) else [value]
