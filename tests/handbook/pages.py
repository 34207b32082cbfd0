"""What the pages tell a reader to type, taken from their text: commands, what they are said to print, and Python."""

import json
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))


@dataclass
class Step:
    """A command, `words`, with the lines that it is said to print; or Python, `code`."""

    words: list[str] | None = None
    printed: str = ""
    code: str = ""


def steps(page: Path) -> list[Step]:
    """In their order. Pieces of Python with no command between them are one script."""
    found: list[Step] = []
    for language, text in blocks(text_of(page)):
        if language == "python":
            if not (found and found[-1].code):
                found.append(Step())
            found[-1].code += text
        elif language in ("", "sh", "console"):
            found += commands(text)
    return found


def text_of(page: Path) -> str:
    """Of a page, or of a notebook as one."""
    text = page.read_text(encoding="utf-8")
    if page.suffix != ".ipynb":
        return text
    cells = ((cell["cell_type"], "".join(cell["source"])) for cell in json.loads(text)["cells"])
    return "\n\n".join(f"```python\n{source}\n```\n" if kind == "code" else source for kind, source in cells)


def files(page: Path) -> dict[str, str]:
    """Text files that the page shows: `name.toml`, a colon, and a block of TOML; or the same of csv."""
    return dict(re.findall(r"`(\S+\.(?:toml|csv))`:\s*```(?:toml|text)\n(.*?)```", text_of(page), re.DOTALL))


def blocks(text: str) -> list[tuple[str, str]]:
    """Language and text of each block of code, fenced or indented by four."""
    fenced = r"^```(?P<language>[a-z]*)\n(?P<text>.*?)^```"
    indented = r"(?:\A|\n\n)(?P<lines>(?: {4}[^\n]*(?:\n|\Z))+)"
    found = re.finditer(f"{fenced}|{indented}", text, re.DOTALL | re.MULTILINE)
    return [
        ("", re.sub(r"^ {4}", "", match["lines"], flags=re.MULTILINE))
        if match["lines"]
        else (match["language"], match["text"])
        for match in found
    ]


def commands(text: str) -> list[Step]:
    """Calls of `bearings` and of the scripts in examples/; lines below a prompt are what the call prints."""
    found: list[Step] = []
    prompted = re.search(r"^\$ ", text, re.MULTILINE)
    for line in text.replace("\\\n", " ").splitlines():
        line, is_output = line.removeprefix("$ "), bool(prompted and not line.startswith("$ "))
        if is_output:
            found[-1].printed += line + "\n"
        elif re.match(r"bearings |python examples/", line):
            words = shlex.split(re.split(r" 2> | \| | > |; ", line)[0], comments=True)
            found.append(Step(words))
    return found


def matches(pattern: str, text: str) -> bool:
    """Whether the text has the lines of the pattern, in which ... stands for anything."""
    return bool(re.search(re.escape(pattern.strip()).replace(r"\.\.\.", ".*?"), text, re.DOTALL))
