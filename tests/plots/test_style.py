"""Figures come and go without a trace in matplotlib's settings."""

import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

from taichi_bearings.analysis.histogram import power_histogram
from taichi_bearings.plots.histogram import draw_overlay
from taichi_bearings.plots.scan import Curve, Look, draw_scan
from taichi_bearings.plots.symbols import mathematics

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
CliRunner().invoke(run, [*"--shape 3,4,5 --method cundall-strack --iterations 500 --energy --out".split(), folder])
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


def test_small_numbers_are_powers_of_ten_within_mathematics():
    assert [mathematics(x) for x in (5e-12, -2.5e20, 0.25, 1234567.0, 0.0)] == [
        r"5\times10^{-12}", r"-2.5\times10^{20}", "0.25", r"1.23457\times10^{6}", "0",
    ]  # fmt: skip


def test_a_logarithmic_axis_names_few_ticks_and_no_line_crosses_an_empty_bin():
    x = np.arange(1.0, 4.0)
    figure = draw_scan([Curve("", x, 20 * x, 19 * x, 21 * x)], Look("x", "P", log="y"))
    figure.draw_without_rendering()
    boxes = [t.get_window_extent() for t in figure.axes[0].get_yticklabels(which="both") if t.get_text()]
    boxes.sort(key=lambda box: box.y0)
    assert 1 < len(boxes) < 8
    assert all(low.y1 < high.y0 for low, high in pairwise(boxes))
    power, state = np.array([[1.0, 1.1, 500.0, 550.0]]), np.ones((1, 4), dtype=int)
    (curve,) = draw_overlay({1: power_histogram(power, state, 0.0)}, "seed").axes[0].lines
    gaps = np.isnan(curve.get_ydata())
    assert gaps.any()
    assert not gaps[[0, -1]].any()
