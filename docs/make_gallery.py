"""Draws the pictures of the gallery in packings.md: runs its commands in a new folder and copies the figures here."""

import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent


def make() -> None:
    page = (HERE / "packings.md").read_text(encoding="utf-8").partition("## Gallery")[2]
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(HERE.parent / "examples", Path(folder) / "examples")
        for line in page.splitlines():
            program, *words = shlex.split(line) if line.startswith("    ") else [""]
            if program == "python":
                subprocess.run([sys.executable, *words], cwd=folder, check=True)
            elif program == "bearings":
                subprocess.run([sys.executable, "-m", "taichi_bearings_cli", *words], cwd=folder, check=True)
        for picture in Path(folder).glob("gallery-*.png"):
            shutil.copy(picture, HERE / picture.name)


if __name__ == "__main__":
    make()
