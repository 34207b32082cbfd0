"""Every example of the README, the handbook and its notebooks does what the page says, in a quick form."""

import re
import shlex
import shutil

import click
import numpy as np
import pytest
from taichi_bearings_cli.main import bearings as program

from tests.cli.commands import bearings, script
from tests.handbook.pages import NOTEBOOKS, PAGES, ROOT, files, matches, steps

SMALLER = {  # in commands, files of scans and Python: the same with less work, where it can be without Taichi
    r"--shape 10,10,10( .*--out outputs/cube)": r"--shape 3,3,4 --direction 1,0,0\1",
    r"--shape 10,10,10( --top)": r"--shape 3,3,4\1",
    r"--shape 10,10,10( --periodic)": r"--shape 4,4,4\1",
    r"--law coulomb-viscous": r"--law coulomb-viscous --method gradient-descent --tolerance 0.1",
    r"--shape 4,4,4( --torque)": r"--shape 4,5\1",
    r"\b10,10,10\b": "4,5",
    r"\b200,100\b": "6,5",
    r"\b32,32,32\b": "4,5",
    r"\[4, 4, 4\].*\]\]": "[3, 4]]",
    r'"uniform:0.1,1.0", "lognormal:0.4,0.8"': '"uniform:0.1,1.0"',
    r"\bstart ?= ?0, stop ?= ?\d+": "start = 0, stop = 2",
    r"\((10, 10, 10|3, 3, 3)\)": "(3, 3, 4), direction=(1, 0, 0)",
    r"\(L, L, L\)": "(L, L, L), direction=(1, 0, 0)",
    r"\(4, 6, 8, 10\), 12": "(3, 4), 2",
    r"solve_many\(([^()]+)\)": r"solve_many(\1, workers=1)",
    r"duration=2\b": "duration=0.002",
    r"log:1e-4,2,80": "log:1e-4,0.002,5",
    r"duration=0.03": "duration=0.001",
    r"log:1e-3,3e-2,12": "log:5e-4,1e-3,2",
    r"error_tolerance=1e-4": "error_tolerance=1e-2",
    r"\(1, 10, 100\)": "(1,)",
    r"--replicas 100\b": "--replicas 2",
    r"--duration [0-9.]+": "--duration 0.001",
    r"--record log:1e-4,\d+,\d+": "--record log:1e-4,1e-3,5",
    r"(run examples/coulomb.toml)": r"\1 --shape 4,5",
    r"(run examples/coulomb-viscous.toml)": r"\1 --shape 4,5 --method gradient-descent --tolerance 0.1",
    r"(run examples/viscous.toml)": r"\1 --shape 6,5",
    r"(run examples/dynamics.toml)": r"\1 --duration 0.001 --record 0.001 --snapshots 0,0.001",
    r"(scan examples/scan.toml)": r"\1 --set scan.seed=[0] --set scan.shape=[[3,4]]",
    r"(scan examples/studies/(limits|surfaces|exponents).toml)": r"\1 --set scan.seed=[0] --set scan.shape=[[3,4]]",
    r"(scan examples/packings/driven.toml)": r"\1 --set scan.seed=[0]",
    r'"bcc", \([34], [34], 4\)|"bcc", \(3, 3, 3\)': '"bcc", (2, 2, 3)',
    r"--shape 11,11,4 (.*) shaft:2.5": r"--shape 5,5,3 \1 shaft:1",
    r"(lattice.py cubic) 8,8,8": r"\1 3,3,3",
    r"(lattice.py bcc) 6,6,7": r"\1 2,2,3",
    r"(lattice.py triangular) 30,17": r"\1 5,4",
    r"(random_packing.py) 400": r"\1 80",
    r"(space_filling.py 1 1) 0.005": r"\1 0.05",
    r"(100_lines.py) 6 6 6": r"\1 3 3 3",
    r"^bearings scan( .*) --workers \d+": r"bearings scan\1",
    r"^bearings scan": "bearings scan --workers 1",
    r"^bearings run(?!.*--resume)": "bearings run --figures none",
    r"^bearings analyse": "bearings analyse --no-figures",
}
NOT_RUN = {  # only read by the parser of the command line, and why
    r"--scheduler|/shared/": "needs a queue, a scheduler or a folder that machines share",
    r"examples/studies/yield": "tests/paper/test_yield_surface.py runs small forms",
    r"outputs/sizes": "scans.md has the same commands",
    r"bearings (reproduce|benchmark|stress)": "takes minutes; tests of the commands run small forms",
    r"--arch vulkan": "needs a GPU",
    r"--method rigid-limit": "takes 3 s; the notebook on a dynamics uses this method",
}
DYNAMICS = (  # a run that has everything: planes, snapshots, energies, a checkpoint
    *("--shape", "2,2,6", "--method", "cundall-strack", "--energy"),
    *("--duration", "1e-4", "--snapshots", "0,1e-4", "--checkpoint-every", "1e-9"),
)
SCAN = """
analyse = true
[scan]
shape = [[3, 4], [4, 5], [4, 6]]
distribution = ["uniform:0.1,1.0", "uniform:0.5,0.6"]
seed = { start = 0, stop = 2 }
"""


def smaller(text):
    for pattern, replacement in SMALLER.items():
        text = re.sub(pattern, replacement, text)
    return text


@pytest.fixture(scope="module")
def prepared(tmp_path_factory, needs_f64):
    """A folder with what the pages take for granted: runs, a scan, their files, the examples."""
    folder = tmp_path_factory.mktemp("prepared")
    shutil.copytree(ROOT / "examples", folder / "examples")
    (folder / "SCAN.toml").write_text(SCAN)
    (folder / "sizes.toml").write_text(SCAN)
    rng = np.random.default_rng(3)
    np.savez(folder / "mine.npz", x=rng.uniform(0.1, 1.0, (9, 10)), y=rng.uniform(0.1, 1.0, (10, 9)))
    done = bearings("run", *DYNAMICS, "--figures", "none", "--out", "RUN", cwd=folder)
    assert done.returncode == 0, done.stderr
    for name in ("a", "b", "some-run", "my-run"):
        shutil.copytree(folder / "RUN", folder / "outputs" / name)
    done = bearings("scan", "SCAN.toml", "--workers", "1", "--out", "outputs/scan", cwd=folder)
    assert done.returncode == 0, done.stderr
    for name in ("some-scan", "my-scan"):
        shutil.copytree(folder / "outputs/scan", folder / "outputs" / name)
    return folder


@pytest.mark.parametrize("page", [page for page in PAGES + NOTEBOOKS if steps(page)], ids=lambda page: page.stem)
def test_examples_of_a_page(page, prepared, tmp_path):
    folder = tmp_path / "here"
    shutil.copytree(prepared, folder)
    for name, text in files(page).items():
        (folder / name).write_text(smaller(text))
    for number, step in enumerate(steps(page)):
        if step.code:
            (folder / f"step{number}.py").write_text(smaller(step.code), encoding="utf-8")
            done = script(folder / f"step{number}.py", cwd=folder)
            assert done.returncode == 0, f"{step.code}\n{done.stderr}"
        elif step.words[0] == "python":
            _, name, *words = shlex.split(smaller(shlex.join(step.words)))
            assert script(ROOT / name, *words, cwd=folder, alone="100_lines" in name).returncode == 0
        else:
            check_command(step, folder)


def check_command(step, folder):
    line = shlex.join(step.words)
    if any(re.search(pattern, line) for pattern in NOT_RUN):
        assert_is_understood(step.words[1:])
        return
    words = shlex.split(smaller(line))[1:]
    if words[0] == "run" and "--out" in words:  # another page may take what is there for granted
        shutil.rmtree(folder / words[words.index("--out") + 1], ignore_errors=True)
    done = bearings(*words, cwd=folder)
    assert done.returncode == 0, f"{line}\n{done.stderr}"
    assert matches(step.printed, done.stdout), f"{line} prints\n{done.stdout}not\n{step.printed}"


def assert_is_understood(words):
    """The command is there, and all of its options."""
    command, context = program, click.Context(program, info_name="bearings")
    while isinstance(command, click.Group):
        name, *words = words
        command = command.get_command(context, name)
        assert command is not None, name
        context = click.Context(command, info_name=name, parent=context)
    command.parse_args(context, list(words))


def test_the_parser_refuses_what_is_not_there():
    with pytest.raises(click.NoSuchOption):
        assert_is_understood(["stress", "--quicker"])
    with pytest.raises(click.BadParameter):
        assert_is_understood(["benchmark", "nothing"])


def test_printed_lines_are_compared():
    assert matches("a ... c\nd", "x\na b c\nd\n")
    assert not matches("a ... c\nd", "x\na b c\ne\n")


def test_the_stored_coefficients_are_those_of_their_script(tmp_path):
    assert script(ROOT / "examples/layers.py", "layers.npz", cwd=tmp_path).returncode == 0
    with np.load(tmp_path / "layers.npz") as made, np.load(ROOT / "examples/layers.npz") as stored:
        assert sorted(made) == sorted(stored) == ["x", "y"]
        assert all((made[axis] == stored[axis]).all() for axis in "xy")
