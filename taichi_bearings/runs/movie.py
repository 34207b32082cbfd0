"""The snapshots of a dynamics as a film: `bearings movie`. MP4 by ffmpeg where that is installed, else GIF."""

import contextlib
import io
import itertools
import math
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from taichi_bearings import leaving
from taichi_bearings.errors import InputError, WriteError
from taichi_bearings.files.whole_file import refuse_ending
from taichi_bearings.plain_files import Json, replace_file
from taichi_bearings.plots.page import Page
from taichi_bearings.plots.style import in_our_style
from taichi_bearings.runs.figures import draw_snapshot
from taichi_bearings.runs.run_file import opened_to_draw, replica_drawn
from taichi_bearings.stages import alike, each

FILM_ENDINGS = (".mp4", ".gif")  # endings of file names
MOST_FRAMES_PER_SECOND = 60


def movie(
    run: str | Path,
    out: str | Path | None = None,
    force: bool = False,
    replica: int = 0,
    frames_per_second: float = 4.0,
    title: bool = True,
) -> Json:
    """Write a film of the snapshots of one sample, each drawn as by `bearings plot spins --time`, and return a report.

    run : a run directory or its run.h5.
    out : the file, MP4 or GIF by its ending. Default: movie.mp4 in the run directory, or movie.gif without ffmpeg; for
        a sample other than the first the name has its number, as in movie-replica-2.mp4.
    force : True to replace a file that exists.
    replica : number of the sample.
    frames_per_second : frames per second of the film.
    title : True for words above each picture.

    Raises InputError or FileError before anything is drawn.
    """
    out = None if out is None else Path(out)
    refuse_ending(out, *FILM_ENDINGS)
    ending, encoder = out.suffix if out else "", shutil.which("ffmpeg")
    if ending == ".mp4" and encoder is None:
        raise InputError(f"out is {str(out)!r}, but there is no ffmpeg on this machine; name it .gif, which needs none")
    if not 0 < frames_per_second <= MOST_FRAMES_PER_SECOND:
        raise InputError(f"fps is {frames_per_second:g}; it must be above 0 and at most {MOST_FRAMES_PER_SECOND}")
    ending = ending or (".gif" if encoder is None else ".mp4")
    with opened_to_draw(run, out, f"movie{ending}", force, replica) as (stored, path):
        solution, threshold = stored.sample(replica).solution, stored.asked.slip_threshold
        if solution.snapshots is None:
            raise InputError(f"{run} holds no snapshots to film; run a dynamics with --snapshots, such as 0,0.1,1")
        draw = partial(draw_snapshot, solution, 0, slip_threshold=threshold, page=Page(title=title))
        times = np.sort(solution.snapshots.time).tolist()
        moments = each(times, "drawing snapshot", alike)
        height = draw(times[0]).get_figheight()  # titles differ in length
        frames = (_picture(draw(time), height) for time in moments)
        film = _mp4(str(encoder), frames, frames_per_second) if ending == ".mp4" else _gif(frames, frames_per_second)
        replace_file(path, film)
    frames_made = {"frames": len(times), "fps": frames_per_second, **replica_drawn(stored, replica)}
    return {"file": str(path), "bytes": path.stat().st_size, **frames_made}


@in_our_style
def _picture(figure: Figure, inches: float) -> np.ndarray:
    """Return the pixels of a figure, (height, width, 3) bytes, with even height and width.

    inches : height of the picture.
    """
    figure.set_figheight(inches)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    height, width = (2 * (side // 2) for side in pixels.shape[:2])  # films need even sides
    return np.ascontiguousarray(pixels[:height, :width])


def _mp4(encoder: str, frames: Iterator[np.ndarray], frames_per_second: float) -> bytes:
    """Return the bytes of an MP4 film, H.264 in colours that every player can show. Raises WriteError if ffmpeg fails.

    Each picture is repeated so that the file has at least 10 frames a second, as some players need.

    encoder : path of ffmpeg.
    frames : pictures of equal size, (height, width, 3) bytes.
    frames_per_second : frames per second of the film.
    """
    first = next(frames)
    height, width = first.shape[:2]
    repeated = max(1, math.ceil(10 / frames_per_second))
    with tempfile.TemporaryDirectory() as folder:
        leaving.add_temporary(Path(folder))
        film, said = Path(folder) / "movie.mp4", Path(folder) / "said"
        words = [encoder, "-loglevel", "error", "-f", "rawvideo", "-pixel_format", "rgb24",
                 "-video_size", f"{width}x{height}", "-framerate", f"{frames_per_second:g}", "-i", "-",
                 "-r", f"{repeated * frames_per_second:g}", "-pix_fmt", "yuv420p", "-movflags", "+faststart",
                 str(film)]  # fmt: skip
        with said.open("wb") as errors, subprocess.Popen(words, stdin=subprocess.PIPE, stderr=errors) as process:
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):  # it says itself why it stopped
                for frame in itertools.chain([first], frames):
                    process.stdin.write(frame.tobytes())
                process.stdin.close()
        if process.returncode or not film.is_file():
            reason = said.read_text(errors="replace").strip().splitlines()[-1:] or ["it says nothing"]
            raise WriteError(f"ffmpeg made no film: {reason[0]}; name the film .gif, which needs no ffmpeg")
        return film.read_bytes()


def _gif(frames: Iterator[np.ndarray], frames_per_second: float) -> bytes:
    """Return the bytes of a GIF film that starts again at its end, without limit.

    frames : pictures, one for each moment.
    frames_per_second : frames per second of the film.
    """
    first, *rest = [Image.fromarray(frame).quantize(256) for frame in frames]
    film, milliseconds = io.BytesIO(), max(20, round(1000 / frames_per_second))
    first.save(film, "GIF", save_all=True, append_images=rest, duration=milliseconds, loop=0)
    return film.getvalue()
