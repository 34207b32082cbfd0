"""The time left of a scan comes from the cost of the samples that remain: recorded scans played again, single cases.

A recording has of each unit its first sample in the plan, how many, when it began and ended, and the seconds of its
solves.
"""

from pathlib import Path

import pytest

from taichi_bearings.runs.settings import read_toml
from taichi_bearings.scans.estimate import WorkLeft
from taichi_bearings.scans.plan import read_plan

RECORDINGS = sorted((Path(__file__).parent / "recorded").glob("*.toml"))


WORKERS = 2


LOOKS = 400


FROM, TO = 0.25, 0.95  # of the whole time; its end hangs on single units


def played(path, tmp_path):
    """(seconds, samples done, time left that is shown) of a recorded scan, and its samples and seconds in all."""
    recording = read_toml(path)
    (tmp_path / "scan.toml").write_text(recording["scan"])
    samples, end, done = read_plan(tmp_path / "scan.toml").samples, recording["seconds"], 0
    rows = sorted(recording["units"], key=lambda row: row[3])
    work, shown = WorkLeft(samples), []
    for now in sorted({row[3] for row in rows} | {end * look / LOOKS for look in range(LOOKS)}):
        while rows and rows[0][3] <= now:
            first, number, _, _, solving = rows.pop(0)
            for sample in samples[first : first + number]:
                work.finish(sample, {"scalars": {"seconds": solving / number}})
            done += number
        running = [samples[first : first + number] for first, number, begin, *_ in rows if begin <= now]
        shown.append((now, done, work.seconds_left(running, WORKERS, now)))
    return shown, len(samples), end


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_the_time_left_is_within_a_factor_of_two_from_a_quarter_on(path, tmp_path):
    shown, _, end = played(path, tmp_path)
    for now, _, left in shown:
        if FROM * end <= now < TO * end:
            assert left is not None
            assert (end - now) / 2 < left < 2 * (end - now), f"{left:.0f} s left at {now:.0f} of {end:.0f} s"
    assert all(left is None or left < 2 * end for _, _, left in shown)
