"""How to cite the program and the paper whose systems it solves: CITATION.cff, as it stands or as BibTeX."""

import re
from pathlib import Path
from textwrap import dedent

CITATION_FILE = Path(__file__).with_name(
    "CITATION.cff"
)  # equal to the one at the root of the repository, which sites look for
BIBTEX = {  # a key of the file -> a field of BibTeX
    "title": "title", "journal": "journal", "volume": "volume", "issue": "number", "start": "pages", "year": "year",
    "date-released": "year", "version": "version", "doi": "doi", "repository-code": "url", "url": "url",
    "license": "license",
}  # fmt: skip


def cff() -> str:
    """The file."""
    return CITATION_FILE.read_text(encoding="utf-8")


def bibtex(text: str) -> str:
    """Its two entries: the program and the paper. text : a CITATION.cff, one line a value, names without quotes."""
    program, _, paper = text.partition("\npreferred-citation:\n")
    return _entry(program, "taichi_bearings", "software") + "\n" + _entry(dedent(paper), "frustrated_bearings", "")


def _entry(block: str, key: str, kind: str) -> str:
    known = dict(re.findall(r"^([a-z-]+): (\S.*)$", block, re.MULTILINE))
    listed = re.search(r"^authors:\n((?:[ -].*\n?)+)", block, re.MULTILINE)
    people = [dict(re.findall(r"([a-z-]+): (.+)", person)) for person in listed[1].split("- ")[1:]] if listed else []
    fields = {"author": " and ".join(map(_name, people))}
    for word, field in BIBTEX.items():
        if word in known:
            fields.setdefault(field, _escaped(known[word][:4] if field == "year" else known[word]))
    kind = kind or ("article" if "journal" in fields else "misc")
    lines = "".join(f"  {field} = {{{value}}},\n" for field, value in fields.items())
    return f"@{kind}{{{key},\n{lines}}}\n"


def _name(person: dict[str, str]) -> str:
    if "name" in person:
        return f"{{{_escaped(person['name'])}}}"
    return ", ".join(person[part] for part in ("family-names", "name-suffix", "given-names") if part in person)


def _escaped(text: str) -> str:
    return text if "://" in text else re.sub(r"([_&%#$])", r"\\\1", text)
