"""The spins of a dynamics at a time: which snapshot is drawn, what slips in it, and which times there are."""

import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.runs.figures import draw_snapshot
from taichi_bearings.runs.run import run
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "run"
    run(RunSettings(shape=(4, 5), method="rigid-limit", initial="random", seed=5, replicas=2, duration=2.0,
                    snapshots="0,0.01,1", threads=1, figures="none"), folder)  # fmt: skip
    return read_run(folder).solution


@pytest.mark.parametrize(("time", "nearest"), [(0.0, 0), (0.012, 1), (2.0, 2)])
def test_a_snapshot_shows_its_time_and_its_own_slipping_contacts(stored, time, nearest):
    spin = stored.snapshots.spin[nearest, 1]  # discs that turn alike and oppositely roll on each other
    speeds = [0.5 * np.abs(spin[1:] + spin[:-1])[:, 1:-1], 0.5 * np.abs(spin[:, 1:] + spin[:, :-1])]
    slipping = sum(int((speed > stored.slip_threshold).sum()) for speed in speeds)
    figure = draw_snapshot(stored, 1, time)
    (lines,) = (c for c in figure.axes[0].collections if type(c).__name__ == "LineCollection")
    assert len(lines.get_segments()) == slipping
    when, what = figure.get_suptitle().split("\n", 1)
    assert f"$t = {stored.snapshots.time[nearest]:.6g}$" in when
    assert what.startswith("black: ")


def test_less_slips_as_time_goes_on(stored):
    first, last = (
        len(draw_snapshot(stored, 0, time).axes[0].collections[1].get_segments()) for time in (0.0, 2.0)
    )  # fmt: skip
    assert 4 <= last < first


@pytest.mark.parametrize("time", [-0.1, 2.1, 1e9, float("nan")])
def test_times_outside_the_run_are_refused_with_its_range(stored, time):
    with pytest.raises(InputError, match=r"goes from 0 to 2, with snapshots from 0 to 1$"):
        draw_snapshot(stored, 0, time)
