"""The wheel in a folder, as a user meets it: `python -m tests.try_wheel dist`, a part of `make release`.

It must hold every file of the packages, install into an environment of its own, and answer there.
"""

import subprocess
import sys
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = {  # in the tree -> in the wheel
    "taichi_bearings": "taichi_bearings", "cli": "taichi_bearings_cli", "studies": "taichi_bearings_studies",
    "examples/studies": "taichi_bearings_studies/paper/scans",
}  # fmt: skip


def missing(wheel: Path) -> list[str]:
    """Files that git knows in the packages and that the wheel lacks."""
    listed = subprocess.run(["git", "ls-files", *FOLDERS], cwd=ROOT, capture_output=True, text=True, check=True)
    names = listed.stdout.splitlines()
    expected = {of + name.removeprefix(at) for at, of in FOLDERS.items() for name in names if name.startswith(f"{at}/")}
    return sorted(expected - set(zipfile.ZipFile(wheel).namelist()))


def main(folder: str) -> None:
    (wheel,) = Path(folder).glob("*.whl")
    if lacking := missing(wheel):
        sys.exit(f"{wheel.name} lacks {', '.join(lacking)}")
    with tempfile.TemporaryDirectory() as place:
        venv.create(place, with_pip=True)
        programs = Path(place, "Scripts" if sys.platform == "win32" else "bin")
        subprocess.run([programs / "python", "-m", "pip", "install", "--quiet", wheel.resolve()], check=True)
        for words in (["--version"], ["run", "--shape", "3,3,4", "--out", "a"], ["verify", "a"]):
            subprocess.run([programs / "bearings", *words], cwd=place, check=True)


if __name__ == "__main__":
    main(sys.argv[1])
