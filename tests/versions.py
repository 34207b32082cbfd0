"""Every Python and every package promised, tried: `make versions`, or `python -m tests.versions [3.10 ...]`.

Each interpreter that pyproject.toml promises and this machine has gets a new environment with the newest packages, and
the oldest promised also an environment with each package exactly at its floor. Both come from pyproject.toml, with the
compiler of each Python: there is no other list. Every environment does the main work in small: all modules, runs, a
resume, a scan, a packing, proofs and a figure; the floors run the quick tests of the physics, too.
"""

import glob
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

try:
    import tomllib
except ModuleNotFoundError:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
TOOLS = {"pytest", "hypothesis", "networkx"}  # of `dev`, for the quick tests
QUICK = [
    "-m", "pytest", "-q", "-m", "not slow", "-p", "no:cacheprovider",
    "-W", "ignore::DeprecationWarning",  # of packages that call each other by names that are going out of use
    *(f"tests/{name}" for name in ("laws", "lattice", "scene", "proof")),
]  # fmt: skip
SCAN = "[scan]\nshape = [[6, 6], [3, 3, 4]]\nseed = { start = 0, stop = 3 }\n"
STEPS = {  # column of the table -> commands of `bearings`, each of which must end well and complain about nothing
    "run": ["run --shape 10,10 --out plane --json", "run --shape 6,6,7 --out block --json"],
    "resume": [
        "run --shape 4,5 --method cundall-strack --duration 0.2 --checkpoint-every 60 --figures none --out course",
        "run --resume course --duration 0.3",
    ],
    "scan": ["scan scan.toml --out scan"],
    "packing": ["run --packing bcc.npz --out packing --json", "verify packing"],
    "verify": ["verify block", "analyse block --no-figures"],
    "figure": ["plot network block"],
}
IMPORTS = """
import importlib, pkgutil
for package in ("taichi_bearings", "taichi_bearings_studies", "taichi_bearings_cli"):
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
"""
PACKING = "import taichi_bearings as tb; tb.Packing.lattice('bcc', (2, 2, 3), seed=1).save('bcc.npz')"
LONGEST = 900  # seconds


@dataclass
class Trial:
    """One environment, and what became of it: seconds of each step, None of one that failed; answers of the runs."""

    python: str
    packages: str
    seconds: dict[str, float | None] = field(default_factory=dict)
    answers: list[tuple] = field(default_factory=list)

    @property
    def name(self) -> str:
        return f"Python {self.python}, {self.packages}"

    @property
    def passed(self) -> bool:
        return None not in self.seconds.values()


def promised() -> list[str]:
    """The versions of Python that the project promises, oldest first."""
    (oldest, beyond) = re.fullmatch(r">=3\.(\d+),<3\.(\d+)", PROJECT["requires-python"]).groups()
    return [f"3.{minor}" for minor in range(int(oldest), int(beyond))]


def interpreter(version: str) -> str | None:
    """One of this version that runs and can make environments: on the path, or one of pyenv's."""
    pyenv = os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv"
    places = [shutil.which(f"python{version}"), *glob.glob(f"{pyenv}/versions/{version}.*/bin/python{version}")]
    asked = "import ensurepip, sys, venv; print('%d.%d' % sys.version_info[:2])"
    for place in filter(None, places):
        if subprocess.run([place, "-c", asked], capture_output=True, text=True).stdout.strip() == version:
            return place
    return None


def requirements(packages: str) -> list[str]:
    """What pip is to install: tools for the tests, and with `floors` every package of the core, each at its floor."""
    tools = [line for line in PROJECT["optional-dependencies"]["dev"] if re.match(r"[\w-]+", line).group() in TOOLS]
    if packages == "newest":
        return [line.partition(">=")[0] for line in tools]
    listed = PROJECT["dependencies"] + tools
    if lacking := [line for line in listed if not re.match(r"[\w-]+>=[\d.]+(;|$)", line)]:
        sys.exit(f"pyproject.toml gives no floor for {', '.join(lacking)}")
    return [line.replace(">=", "==", 1) for line in listed]


def build_wheel(folder: Path) -> Path:
    """The wheel of this tree, built from a copy, so that nothing is left in it."""
    for name in ("taichi_bearings", "cli", "studies", "examples"):
        shutil.copytree(ROOT / name, folder / "tree" / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder / "tree")
    words = ["wheel", "--quiet", "--no-deps", "--wheel-dir", folder, folder / "tree"]
    subprocess.run([sys.executable, "-m", "pip", *words], check=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def attempt(trial: Trial, place: str, wheel: Path) -> None:
    """Make the environment and take every step in it, up to the first that fails. Of its packages the modules that are
    used are compiled, when they are imported; to compile all takes a quarter of the whole installation."""
    with tempfile.TemporaryDirectory(prefix="versions-") as folder:
        home = Path(folder, "environment")
        programs = home / ("Scripts" if sys.platform == "win32" else "bin")
        pip = [programs / "python", "-m", "pip", "install", "--quiet", "--only-binary", ":all:", "--no-compile", wheel]
        commands = {
            "install": [[place, "-m", "venv", home], [*pip, *requirements(trial.packages)]],
            "import": [[programs / "python", "-c", IMPORTS]],
            **{step: [[programs / "bearings", *line.split()] for line in lines] for step, lines in STEPS.items()},
        }
        commands["packing"].insert(0, [programs / "python", "-c", PACKING])
        if trial.packages == "floors":
            commands["quick tests"] = [[programs / "python", *QUICK]]
        Path(folder, "scan.toml").write_text(SCAN)
        for step, listed in commands.items():
            began = time.monotonic()
            well = all(call(trial, command, Path(folder), step) for command in listed)
            trial.seconds[step] = time.monotonic() - began if well else None
            if not well:
                break
    took = sum(filter(None, trial.seconds.values()))
    print(f"{trial.name}: {'passed' if trial.passed else 'FAILED'} in {took:.0f} s", flush=True)


def call(trial: Trial, command: list, folder: Path, step: str) -> bool:
    """Whether the command ends well and, of ours, says nothing on its standard error but how far it is."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    new = {} if step == "install" else {"XDG_CACHE_HOME": f"{folder}/cache", "MPLCONFIGDIR": f"{folder}/matplotlib"}
    words = [str(word) for word in command]
    where = ROOT if step == "quick tests" else folder
    try:
        done = subprocess.run(words, cwd=where, env=kept | new, capture_output=True, text=True, timeout=LONGEST)
        told = f"exit code {done.returncode}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        well = done.returncode == 0 and (step not in STEPS or not re.search("ignored in|[Ww]arning", done.stderr))
    except subprocess.TimeoutExpired:
        told, well = f"not done after {LONGEST} s", False
    if not well:
        print(f"{trial.name}: {' '.join(words)}\n{told}", flush=True)
    elif "--json" in words:
        answer = json.loads(done.stdout)
        trial.answers.append((answer["method"], answer["status"], float(f"{answer['power']:.9e}")))
    return well


def table(trials: list[Trial]) -> str:
    """Seconds of each step in each environment."""
    steps = ["install", "import", *STEPS, "quick tests"]
    rows = [["Python", "packages", *steps]]
    for trial in trials:
        taken = {step: "FAILED" if value is None else f"{value:.1f} s" for step, value in trial.seconds.items()}
        rows.append([trial.python, trial.packages, *(taken.get(step, "-") for step in steps)])
    wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(word.ljust(width) for word, width in zip(row, wide, strict=True)) for row in rows)


def main(wanted: list[str]) -> None:
    found = {version: interpreter(version) for version in wanted or promised()}
    for version in (version for version, place in found.items() if place is None):
        print(f"Python {version} is not here, so nothing is tried under it", flush=True)
    here = [version for version, place in found.items() if place]
    if not here:
        sys.exit("no Python that is promised is here")
    oldest = promised()[0]  # what comes later needs later packages
    floors = [Trial(oldest, "floors")] if oldest in here else []
    if not floors:
        print(f"each package at its floor is tried under Python {oldest} alone, so not here", flush=True)
    trials = [*floors, *(Trial(version, "newest") for version in here)]  # the longest first
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
        wheel = build_wheel(Path(folder))
        list(pool.map(lambda trial: attempt(trial, found[trial.python], wheel), trials))
    print(table(trials))
    answers = {trial.name: trial.answers for trial in trials if trial.passed}
    if len(set(map(tuple, answers.values()))) > 1:
        sys.exit(f"methods, states or powers differ: {answers}")
    sys.exit(not all(trial.passed for trial in trials))


if __name__ == "__main__":
    main(sys.argv[1:])
