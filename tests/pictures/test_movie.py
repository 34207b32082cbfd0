"""`bearings movie`: a frame a snapshot, as GIF by Pillow and as MP4 by ffmpeg where that is installed."""

import shutil
import subprocess
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

import taichi_bearings as tb
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.runs.figures import draw_snapshot
from taichi_bearings.runs.movie import movie
from taichi_bearings.runs.run import run
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings


@pytest.fixture
def whirl(solved):
    """A dynamics of discs with three snapshots."""
    return solved(
        shape=(5, 4), method="cundall-strack", initial="random", seed=5, duration=0.05, snapshots="0,0.001,0.05"
    )


def test_a_gif_shows_each_snapshot_for_its_time(whirl, tmp_path):
    report = movie(whirl, tmp_path / "a.gif", frames_per_second=5)
    solution = read_run(whirl).solution
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == report["frames"] == len(solution.snapshots.time) == 3
        frames = []
        for number, time in enumerate(solution.snapshots.time):
            film.seek(number)
            assert film.info["duration"] == 200
            figure = draw_snapshot(solution, 0, time)
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
            drawn = np.asarray(canvas.buffer_rgba())[..., :3].astype(float)
            shown = np.asarray(film.convert("RGB"), dtype=float)
            height, width = shown.shape[:2]
            frames.append(shown)
            assert np.abs(drawn[:height, :width] - shown).mean() < 2  # of 255
        assert all(np.abs(before - after).mean() > 2 for before, after in pairwise(frames))


def test_a_film_of_a_packing_shows_its_snapshots(tmp_path):
    """Of the replica that is asked for; contacts slip in a frame as its spins say."""
    arrays = tb.Packing.lattice("triangular", (4, 3)).arrays()
    del arrays["friction"]
    np.savez(tmp_path / "bare.npz", **arrays)
    settings = {"packing": str(tmp_path / "bare.npz"), "replicas": 2, "method": "cundall-strack", "threads": 1}
    settings |= {"initial": "random", "duration": 0.05, "snapshots": "0,0.001,0.05", "figures": "none"}
    path = run(RunSettings(**settings), tmp_path / "run").path
    report = movie(path, tmp_path / "a.gif", replica=1)
    one, other = tb.load(path)
    assert report["frames"] == len(other.snapshots.time) == 3
    for seed, found in enumerate((one, other)):
        assert np.abs(found.snapshots.spin[-1] - found.spin).max() < 1e-12
        assert found.packing.slip_speeds(found.spin) == pytest.approx(found.slip, abs=1e-15)
        title = " ".join(found.plot("spins", time=0.0).get_suptitle().split())
        slips = found.packing.slip_speeds(found.snapshots.spin[0])[found.state != 3] > 1e-3 * 0.5  # of R omega_T
        assert title.endswith(f", $t = 0$ {slips.sum()} of {len(slips)} contacts slip, in black"), seed
    with Image.open(tmp_path / "a.gif") as film:
        frames = [np.asarray(film.convert("RGB"), dtype=float) for n in range(3) if film.seek(n) is None]
    assert all(np.abs(before - after).mean() > 1 for before, after in pairwise(frames))
    with pytest.raises(InputError, match=r"time is 1; the run goes from 0 to 0\.05"):
        one.plot("spins", time=1.0)
    with pytest.raises(InputError, match="replica is 2; the run has 2 replicas, numbered from 0"):
        movie(path, tmp_path / "b.gif", replica=2)


@pytest.mark.skipif(not shutil.which("ffprobe"), reason="ffmpeg, which makes MP4, is not installed")
def test_an_mp4_lasts_as_long_as_its_snapshots(whirl, tmp_path):
    movie(whirl, tmp_path / "a.mp4", frames_per_second=2)
    words = ["ffprobe", "-v", "error", "-show_entries", "stream=codec_name,pix_fmt,duration", "-of", "csv=p=0"]
    told = subprocess.run([*words, tmp_path / "a.mp4"], capture_output=True, text=True).stdout.strip().split(",")
    assert told[:2] == ["h264", "yuv420p"]
    assert float(told[2]) == pytest.approx(3 / 2, abs=0.1)


def test_what_cannot_be_filmed_is_said_before_anything_is_drawn(discs, whirl, tmp_path):
    with pytest.raises(InputError, match="holds no snapshots to film; run a dynamics with --snapshots"):
        movie(discs, tmp_path / "a.gif")
    for fps in (0.0, -1.0, 61.0, float("nan")):
        with pytest.raises(InputError, match=f"fps is {fps:g}; it must be above 0 and at most 60"):
            movie(whirl, tmp_path / "a.gif", frames_per_second=fps)
    with pytest.raises(InputError, match=r"must end in \.mp4 or \.gif"):
        movie(whirl, tmp_path / "a.avi")
    with pytest.raises(InputError, match="replica is 2; the run has 1 replica"):
        movie(whirl, tmp_path / "a.gif", replica=2)
    (tmp_path / "mine.gif").write_text("mine")
    with pytest.raises(FileError, match="already exists"):
        movie(whirl, tmp_path / "mine.gif")
