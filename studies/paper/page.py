"""Writes the report as one HTML file: figures inside, nothing to load, readable on paper."""

import base64
import re
from collections.abc import Iterable, Iterator, Mapping
from html import escape
from typing import Any

from taichi_bearings.plots.style import SUPERSCRIPTS
from taichi_bearings.words import counted

from .claims import KINDS, VERDICTS

STYLE = """
body { font: 16px/1.5 Georgia, 'Times New Roman', serif; color: #1a1a1a; max-width: 74rem; margin: 2rem auto; }
body { padding: 0 1.5rem; } h1, h2, h3, th, .verdict, .facts { font-family: 'Helvetica Neue', Arial, sans-serif; }
h1 { font-size: 1.7rem; } h2 { font-size: 1.25rem; margin-top: 2.5rem; border-bottom: 1px solid #ccc; }
h3 { font-size: 1rem; margin: 0 0 .4rem; } a { color: inherit; text-decoration: none; }
table { border-collapse: collapse; width: 100%; font-size: .85rem; line-height: 1.35; }
th, td { text-align: left; vertical-align: top; padding: .3rem .6rem .3rem 0; border-bottom: 1px solid #e3e3e3; }
tr.figure th { padding-top: 1rem; border-bottom: 1px solid #999; break-after: avoid; }
img { max-width: 100%; height: auto; display: block; margin: 1rem auto; }
article { margin: 1.4rem 0; padding-left: 1rem; border-left: 4px solid #bbb; break-inside: avoid; }
dl.facts { display: grid; grid-template-columns: max-content 1fr; gap: .1rem 1rem; font-size: .85rem; margin: .4rem 0; }
dl.facts dt { color: #666; } dl.facts dd { margin: 0; } .note { color: #555; font-size: .9rem; }
.verdict { font-size: .78rem; font-weight: bold; white-space: nowrap; }
.confirmed { border-color: #1b6e33; } .verdict.confirmed { color: #1b6e33; }
.refined { border-color: #c08a00; } .verdict.refined { color: #9a6700; }
.refuted { border-color: #b3261e; } .verdict.refuted { color: #b3261e; } .verdict.too-few-samples { color: #666; }
p.finding { margin: .3rem 0; overflow-wrap: anywhere; }
@media print { body { font-size: 10pt; margin: 0; max-width: none; } section.figure { break-before: page; } }
"""
# proper symbols for what is typed in plain text
SYMBOLS = {"<=": "\u2264", ">=": "\u2265", "+-": "\u00b1", "omega_": "\u03c9_", "Omega_": "\u03a9_"}


def page(report: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Return the whole report as an HTML text.

    report : the report as plain data, as :func:`.reproduce.describe` returns it.
    pictures : for each figure by name the bytes of its PNG.
    """
    title = "Frustrated bearings: the figures and claims of the paper, computed anew"
    parts = [
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{title}</title><style>{STYLE}</style></head><body><h1>{title}</h1>",
        *_summary(report),
        *(part for name in report["figures"] for part in _section(name, report["figures"][name], pictures.get(name))),
        *_environment(report),
        "</body></html>",
    ]
    return "\n".join(parts) + "\n"


def typeset(text: str) -> str:
    """Return a text in which what was typed as plain ASCII is replaced by proper symbols: <= and >=, +-, powers such
    as 10^6, Greek letters, and the cross of 3x3.
    """
    for plain, symbol in SYMBOLS.items():
        text = text.replace(plain, symbol)
    text = re.sub(r"\bmu\b", "\u03bc", re.sub(r"(?<=\d)x(?=\d)", "\u00d7", text))
    return re.sub(r"\^(-?\d+)", lambda found: found[1].translate(SUPERSCRIPTS), text)


def _html_text(text: str) -> str:
    """Return a text with proper symbols, escaped for HTML."""
    return escape(typeset(text))


def _verdict(claim: Mapping[str, Any]) -> str:
    """Return the HTML of the verdict of a claim, coloured by its CSS class.

    claim : the claim as plain data, with its `verdict`.
    """
    name = escape(claim["verdict"])
    return f'<span class="verdict {name.replace(" ", "-")}">{name}</span>'


def _row(cells: Iterable[str], kind: str = "td") -> str:
    """Return the HTML of a table row.

    cells : HTML of its cells, from left to right.
    kind : tag of its cells, "td" or "th".
    """
    return f"<tr>{''.join(f'<{kind}>{cell}</{kind}>' for cell in cells)}</tr>"


def _facts(facts: Mapping[str, Any]) -> str:
    """Return the HTML of a list of facts, values by name; empty values are left out."""
    rows = (f"<dt>{escape(key)}</dt><dd>{_html_text(str(text))}</dd>" for key, text in facts.items() if text != "")
    return f'<dl class="facts">{"".join(rows)}</dl>'


def _summary(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield the HTML of the summary of a report (plain data): the number of claims with each verdict, and a table of
    all claims.
    """
    found = [f"{report[name.replace(' ', '_')]} <strong>{name}</strong> ({text})" for name, text in VERDICTS.items()]
    yield f"<p>{'; '.join(found)}.</p>"
    form = ", the quick form: fewer samples, sizes and iterations" if report["quick"] else ""
    kinds = "; ".join(f"<em>{kind}</em>, {text}" for kind, text in KINDS.items())
    yield f'<p class="note">{counted(report["samples"], "sample")} from seed {report["seed"]}{form}. What a verdict'
    yield f"rests on: {kinds}. Limits that were chosen with results in view are named.</p>"
    if report["missing"]:
        yield f"<p><strong>Not done yet: {', '.join(report['missing'])}.</strong></p>"
    yield "<h2>All claims</h2><table><thead>"
    yield _row(("claim", "paper", "here", "samples", "rests on", "verdict"), "th") + "</thead><tbody>"
    for name, figure in report["figures"].items():
        head = f'<a href="#{name}">{name}: {_html_text(figure["title"])}</a>'
        yield f'<tr class="figure"><th colspan="6">{head}</th></tr>'
        for number, claim in enumerate(figure["claims"], start=1):
            words = [_html_text(claim[key]) for key in ("claim", "paper", "ours")]
            words[0] = f'<a href="#{name}-{number}">{words[0]}</a>'
            yield _row((*words, f"{claim['samples']:,}", _html_text(claim["kind"]), _verdict(claim)))
    yield "</tbody></table>"


def _section(name: str, figure: Mapping[str, Any], picture: bytes | None) -> Iterator[str]:
    """Yield the HTML of one figure: its picture, and each claim with verdict, numbers and grounds.

    name : name of the figure.
    figure : entry of the figure in the report.
    picture : bytes of its PNG, or None if there is none.
    """
    yield f'<section class="figure" id="{name}"><h2>{name}: {_html_text(figure["title"])}</h2>'
    if picture is not None:
        data = base64.b64encode(picture).decode("ascii")
        yield f'<img alt="{_html_text(figure["title"])}" src="data:image/png;base64,{data}">'
        yield f'<p class="note">Shown: {_html_text(figure["shown"])}</p>'
    for number, claim in enumerate(figure["claims"], start=1):
        facts = {
            "paper": claim["paper"],
            "here": claim["ours"],
            "uncertainty": claim["uncertainty"],
            "samples": f"{claim['samples']:,}; a verdict needs {claim['samples_needed']:,}",
            "rests on": f"{claim['kind']}: {KINDS[claim['kind']]}",
            "chosen after the data": claim["chosen_after_the_data"],
        }
        style = escape(claim["verdict"]).replace(" ", "-")
        yield f'<article class="{style}" id="{name}-{number}"><h3>{_html_text(claim["claim"])}</h3>'
        yield f'{_verdict(claim)}{_facts(facts)}<p class="finding">{_html_text(claim["finding"])}</p></article>'
    yield "</section>"


def _environment(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield the HTML of the last section of a report (plain data): the command, the machine, versions of programs, and
    the times that figures took.
    """
    yield '<section class="figure" id="environment"><h2>How it was computed</h2>'
    yield _facts({"command": report["command"], "first seed": report["seed"], **report["environment"]})
    yield f"<table><thead>{_row(('figure', 'wall time, s', 'processor time, s'), 'th')}</thead><tbody>"
    times = {name: [figure["seconds"], figure["seconds_processor"]] for name, figure in report["figures"].items()}
    together = {"together": [sum(column) for column in zip(*times.values(), strict=True)]} if times else {}
    yield from (_row((name, *(f"{time:.0f}" for time in of))) for name, of in (times | together).items())
    yield "</tbody></table></section>"
