"""Version, licence, authors, address and requirements stand in several files that others' programs read: all equal."""

import json
import re

import yaml
from taichi_bearings_cli import cite

import taichi_bearings
from tests.cli.commands import bearings
from tests.handbook.pages import ROOT
from tests.handbook.test_site import tomllib

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
CODEMETA = json.loads((ROOT / "release/codemeta.json").read_text(encoding="utf-8"))
RECIPE = yaml.safe_load((ROOT / "release/recipe.yaml").read_text(encoding="utf-8"))
JOURNAL = yaml.safe_load((ROOT / "release/paper.md").read_text(encoding="utf-8").split("---\n")[1])


def test_version():
    said = {CITATION["version"], CODEMETA["version"], RECIPE["context"]["version"]}
    assert said == {taichi_bearings.__version__}
    assert re.search(rf"^## {re.escape(taichi_bearings.__version__)}\b", text("CHANGELOG.md"), re.MULTILINE)


def test_authors():
    authors = [author["name"] for author in PROJECT["authors"]]
    assert [author["name"] for author in CITATION["authors"]] == authors
    assert [author["name"] for author in CODEMETA["author"]] == authors
    assert [author["name"] for author in JOURNAL["authors"]] == authors


def test_address():
    address = PROJECT.get("urls", {}).get("Repository")
    assert [CITATION.get("repository-code"), CODEMETA.get("codeRepository")] == [address] * 2
    assert RECIPE["about"].get("repository") == address


def test_licence_and_description():
    said = {PROJECT["license"], CITATION["license"], RECIPE["about"]["license"], CODEMETA["license"].split("/")[-1]}
    assert said == {"MIT"}
    assert PROJECT["description"] == CODEMETA["description"] == RECIPE["about"]["summary"]
    assert PROJECT["description"] == CITATION["abstract"].removesuffix(".")
    assert PROJECT["keywords"] == CITATION["keywords"] == CODEMETA["keywords"]


def test_the_paper():
    paper, reference = CITATION["preferred-citation"], CODEMETA["referencePublication"]
    names = [(author["given-names"], author["family-names"], author.get("name-suffix")) for author in paper["authors"]]
    other = [(one["givenName"], one["familyName"], one.get("honorificSuffix")) for one in reference["author"]]
    assert (paper["title"], names) == (reference["name"], other)


def test_requirements_of_the_recipe():
    before = [item for item in PROJECT["dependencies"] if ">= '3.14'" not in item]  # a recipe for all has no markers
    wanted = {item.split(";")[0].strip().replace(" ", "") for item in before}
    needed = {item.replace(" ", "").replace("matplotlib-base", "matplotlib") for item in RECIPE["requirements"]["run"]}
    assert needed - wanted == {f"python{PROJECT['requires-python'].replace('3.15', '3.14')}"}
    assert not wanted - needed
    assert CODEMETA["runtimePlatform"] == f"Python {PROJECT['requires-python']}"
    assert RECIPE["build"]["python"]["entry_points"] == [f"bearings = {PROJECT['scripts']['bearings']}"]


def test_every_citation_of_the_journal_article_is_in_its_list():
    cited = set(re.findall(r"@(\w+)", text("release/paper.md").split("---\n", 2)[2]))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", text("release/paper.bib"), re.MULTILINE))


def test_the_package_carries_the_citation():
    assert cite.cff() == text("CITATION.cff")
    assert bearings("cite", "--format", "cff").stdout == cite.cff()


def test_bibtex_says_what_the_file_says():
    program, paper = entries(bearings("cite").stdout)
    assert program["author"] == "{The taichi\\_bearings authors}"
    assert program["version"] == CITATION["version"]
    assert paper["title"] == CITATION["preferred-citation"]["title"]
    assert paper["author"] == "Pires, R. S. and Moreira, A. A. and Herrmann, H. J. and Andrade, Jr., J. S."
    assert [program["kind"], paper["kind"]] == ["software", "misc"]


def entries(text):
    """Of BibTeX with a field a line."""
    found = re.findall(r"^@(\w+)\{\w+,\n(.*?)^\}", text, re.DOTALL | re.MULTILINE)
    return [{"kind": kind, **dict(re.findall(r"^  (\w+) = \{(.*)\},$", body, re.MULTILINE))} for kind, body in found]


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")
