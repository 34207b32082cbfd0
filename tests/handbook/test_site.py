"""What the handbook shows is what there is: names, links, drawings, notebooks, the package and its citation."""

import json
import re
import shutil
import subprocess
import sys
from fnmatch import fnmatch

import pytest

import taichi_bearings
from tests.cli.commands import script
from tests.handbook.pages import NOTEBOOKS, PAGES, ROOT, text_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def test_every_public_name_has_a_place_in_the_reference():
    listed = set(re.findall(r"auto\w+:: (\w+)", (ROOT / "docs/api.md").read_text(encoding="utf-8")))
    assert set(taichi_bearings.__all__) - listed == {"__version__"}


@pytest.mark.parametrize("page", [*PAGES, *NOTEBOOKS, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.stem)
def test_links_lead_to_files_of_this_repository(page):
    text = re.sub(r"```.*?```|`[^`\n]*`", "", text_of(page), flags=re.DOTALL)
    for target in re.findall(r"\]\((?!https?:)([^)#\s]+)", text):
        assert (page.parent / target).exists(), target


def test_pages_that_code_names_are_there():
    texts = [
        path.read_text(encoding="utf-8")
        for folder in ("taichi_bearings", "cli")
        for path in (ROOT / folder).rglob("*.py")
    ]
    for name in set(re.findall(r"docs/[\w/-]+(?:\.md)?", "\n".join(texts))):
        assert list(ROOT.glob(f"{name}*")), name


def test_every_page_is_in_the_contents():
    contents = (ROOT / "docs/index.md").read_text(encoding="utf-8")
    for page in [*(ROOT / "docs").glob("*.md"), *NOTEBOOKS]:
        name = page.relative_to(ROOT / "docs").with_suffix("").as_posix()
        assert name == "index" or re.search(rf"^({name}|.* <{name}>)$", contents, re.MULTILINE), name


def test_drawings_are_those_of_their_script(tmp_path):
    shutil.copy(ROOT / "docs/drawings.py", tmp_path)
    assert script(tmp_path / "drawings.py").returncode == 0
    for drawn in (tmp_path / f"{name}.svg" for name in ("contact", "bearing", "gap")):
        assert drawn.read_text(encoding="utf-8") == (ROOT / "docs" / drawn.name).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", NOTEBOOKS, ids=lambda page: page.stem)
def test_notebooks_have_been_run_to_the_end(page):
    cells = [cell for cell in json.loads(page.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert not [output for cell in cells for output in cell["outputs"] if output["output_type"] == "error"]
    assert page.stat().st_size < 500_000


def test_every_file_of_the_packages_is_in_the_wheel():
    listed = subprocess.run(["git", "ls-files", "taichi_bearings"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a checkout of git")
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    data = [f"{name.replace('.', '/')}/{end}" for name, ends in settings["package-data"].items() for end in ends]
    for name in listed.stdout.splitlines():
        is_code = name.endswith(".py") and name.rpartition("/")[0].replace("/", ".") in settings["packages"]
        assert is_code or any(fnmatch(name, pattern) for pattern in data), name
