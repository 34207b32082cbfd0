"""The distribution of loads counts links as it says, of the samples that have a path."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.plots.load_distribution import SHARES, carrying, draw_load_distribution
from taichi_bearings.plots.style import save
from tests.analysis.networks import APART, CHAIN, DUMBBELL, EMPTY, HEXAGONS, LADDER


def loads_of(*networks):
    return [Bottlenecks(network).loads for network in networks]


def drawn(figure):
    """For each panel the curve of all links and those of the samples."""
    for axes in figure.axes:
        (alone,) = [item for item in axes.collections if isinstance(item, LineCollection)]
        (together,) = axes.lines
        yield together.get_ydata(), [segment[:, 1] for segment in alone.get_segments()]


def test_the_part_of_links_that_carry_a_share_is_counted_with_ties_and_rounding():
    part = carrying(np.array([0.0, 0.25, 0.25, 1.0 - 1e-13]))
    assert (part[SHARES <= 0.25] == 0.75).all()
    assert (part[SHARES > 0.25] == 0.25).all()
    assert part[-1] == 0.25
    assert np.isnan(carrying(np.array([0.0, 0.5]))[SHARES > 0.5]).all()


def test_links_of_all_samples_with_a_path_are_pooled_and_the_others_counted():
    figure = draw_load_distribution(loads_of(LADDER, APART, DUMBBELL, EMPTY, HEXAGONS))
    joined = loads_of(LADDER, DUMBBELL, HEXAGONS)
    for (together, alone), parts in zip(drawn(figure), zip(*joined, strict=True), strict=True):
        expected = [[np.mean(load >= s - 1e-9) for s in SHARES] for load in (*parts, np.concatenate(parts))]
        for curve, values in zip((*alone, together), expected, strict=True):
            np.testing.assert_allclose(curve[np.isfinite(curve)], [value for value in values if value > 0])
    assert figure.get_suptitle() == "3 of 5 samples with a path from bottom to top; 2 without one are not drawn"


def test_every_link_of_a_chain_carries_everything():
    for together, alone in drawn(draw_load_distribution(loads_of(CHAIN, CHAIN))):
        assert len(alone) == 2
        assert (together == 1).all()


@pytest.mark.parametrize("samples", [loads_of(APART, EMPTY), loads_of(EMPTY), [(np.zeros(0), np.zeros(0))]])
def test_without_any_path_the_figure_says_so(samples, tmp_path):
    figure = draw_load_distribution(samples)
    save(figure, tmp_path / "loads.png")
    assert figure.get_suptitle().startswith("No path joins the planes")
    assert not any(axes.lines for axes in figure.axes)
