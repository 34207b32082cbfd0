"""Numbers and axes of figures."""

from itertools import pairwise

import numpy as np

from taichi_bearings.analysis.histogram import power_histogram
from taichi_bearings.plots.curves import Curve, Look, draw_overlay, draw_scan
from taichi_bearings.plots.style import mathematics


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
