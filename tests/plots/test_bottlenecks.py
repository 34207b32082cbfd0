"""The map of bottlenecks can be drawn of any network, and colours the links that carry paths."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.plots.bottlenecks import draw_bottlenecks
from taichi_bearings.plots.style import save
from tests.analysis.networks import APART, DUMBBELL, EMPTY, HEXAGONS, LADDER


@pytest.mark.parametrize("network", [LADDER, DUMBBELL, HEXAGONS, APART, EMPTY])
def test_links_that_carry_paths_are_coloured(network, tmp_path):
    found = Bottlenecks(network)
    figure = draw_bottlenecks(found)
    save(figure, tmp_path / "bottlenecks.png")
    lines = [item for item in figure.axes[0].collections if isinstance(item, (LineCollection, Line3DCollection))]
    coloured = [item.get_array() for item in lines if item.get_array() is not None]
    assert len(coloured) == 1
    np.testing.assert_allclose(np.sort(coloured[0]), np.sort(found.share[found.share > 0]))
    shown = [text.get_text() for text in figure.axes[0].get_legend().get_texts()] if network.spans else []
    assert any("alone" in text for text in shown) == found.parting.any()
