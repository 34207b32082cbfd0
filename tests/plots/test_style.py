"""Figures come and go without a trace in matplotlib's settings."""

import subprocess
import sys
from pathlib import Path

DRAW_ALL = """
import sys
import matplotlib
folder = sys.argv[1]
def state():
    return dict.__getitem__(matplotlib.rcParams, "backend"), dict(matplotlib.rcParams.copy())
matplotlib.rcParams["font.size"] = 13.0
before = state()
from click.testing import CliRunner
from taichi_bearings_cli.plot import command
from taichi_bearings_cli.run import command as run
kinds = next(p for p in command.params if p.name == "kind").type.choices
CliRunner().invoke(run, [*"--shape 3,4,5 --method cundall-strack --iterations 50 --energy --out".split(), folder])
drawn = []
for kind in kinds:
    done = CliRunner().invoke(command, [kind, folder], catch_exceptions=False) if kind != "scan" else None
    drawn += [kind] if done and not done.exit_code else []
import numpy as np
from taichi_bearings.plots.scan import Curve, Look, draw_scan
x = np.arange(3.0)
draw_scan([Curve("", x, x, x, x)], Look("x", "y"))
after = state()
print(len(kinds) - len(drawn), "matplotlib.pyplot" in sys.modules, after == before)
"""


def test_drawing_every_kind_leaves_backend_and_settings_as_they_were(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", DRAW_ALL, str(tmp_path / "run")],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert done.stderr == ""
    assert done.stdout.split() == ["1", "False", "True"]  # all but scan, which is drawn beside it
