"""The command `bearings cite`."""

import re
from importlib.resources import files
from textwrap import dedent

import click
from taichi_bearings_cli.options import Choice

BIBTEX = {  # a key of CITATION.cff -> a field of BibTeX
    "title": "title", "journal": "journal", "volume": "volume", "issue": "number", "start": "pages", "year": "year",
    "version": "version", "doi": "doi", "repository-code": "url", "license": "license",
}  # fmt: skip


@click.command()
@click.option(
    "--format",
    "form",
    type=Choice(["bibtex", "cff"]),
    default="bibtex",
    help="Format of the citation; cff is the Citation File Format. [default: bibtex]",
)
def command(form: str) -> None:
    """Print how to cite the program, and the paper whose systems it solves.

    \b
    Examples:
      bearings cite >> my-thesis.bib
      bearings cite --format cff
    """
    click.echo(cff() if form == "cff" else bibtex(cff()), nl=False)


def cff() -> str:
    """Return the content of the package's CITATION.cff, which is equal to the one at the root, where sites look."""
    return (files("taichi_bearings") / "CITATION.cff").read_text(encoding="utf-8")


def bibtex(text: str) -> str:
    """Return two BibTeX entries: the program and the paper.

    text : a CITATION.cff, one line a value, names without quotes.
    """
    program, _, paper = text.partition("\npreferred-citation:\n")
    return _entry(program, "taichi_bearings", "software") + "\n" + _entry(dedent(paper), "frustrated_bearings", "misc")


def _entry(block: str, key: str, kind: str) -> str:
    """Return one BibTeX entry.

    block : lines of CITATION.cff on what is cited.
    key : word by which texts cite it.
    kind : @software or @misc.
    """
    known = dict(re.findall(r"^([a-z-]+): (\S.*)$", block, re.MULTILINE))
    people = re.findall(r"^ *- (?:family-)?name.*\n(?: +[a-z-]+: .*\n?)*", block, re.MULTILINE)
    names = [dict(re.findall(r"([a-z-]+): (.+)", person)) for person in people]
    order = ("name", "family-names", "name-suffix", "given-names")
    words = [", ".join(name[part] for part in order if part in name) for name in names]
    fields = {"author": " and ".join(f"{{{word}}}" if "," not in word else word for word in words)}
    fields |= {BIBTEX[word]: value for word, value in known.items() if word in BIBTEX}
    escaped = {
        name: value if "://" in value else re.sub(r"([_&%#$])", r"\\\1", value) for name, value in fields.items()
    }
    lines = "".join(f"  {name} = {{{value}}},\n" for name, value in escaped.items())
    return f"@{'article' if 'journal' in known else kind}{{{key},\n{lines}}}\n"
