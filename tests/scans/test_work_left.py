"""The time left of a scan comes from the cost of the samples that remain: recorded scans played again, single cases.

A recording has of each unit its first sample in the plan, how many, when it began and ended, and the seconds of its
solves.
"""

import math
from pathlib import Path

import pytest

from taichi_bearings.runs.settings import RunSettings, read_toml
from taichi_bearings.scans.estimate import WorkLeft, seconds_in_all, seconds_of
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


def finish(work, samples, seconds):
    for sample in samples:
        work.finish(sample, {"scalars": {"seconds": seconds}})


def test_nothing_is_known_before_something_is_measured(plan_of):
    samples = plan_of("shape = [8, 8, 8]\n[scan]\nseed = { start = 0, stop = 96 }\n").samples
    work = WorkLeft(samples)
    assert seconds_in_all(samples, 1) == pytest.approx(96 * seconds_of(samples[0].settings))
    assert work.seconds_left([], 1, 0.0) is None
    finish(work, samples[:24], 0.25)
    assert work.seconds_left([], 1, 6.0) == pytest.approx(72 * 0.25, rel=0.01)
    assert work.seconds_left([], 2, 3.0) == pytest.approx(36 * 0.25, rel=0.01)


def test_samples_without_an_estimate_are_learnt_kind_by_kind(plan_of):
    samples = plan_of(
        'shape = [4, 4]\nmethod = "cundall-strack"\n[scan]\nduration = [1.0, 10.0]\nseed = { start = 0, stop = 10 }\n'
    ).samples
    work = WorkLeft(samples)
    assert seconds_in_all(samples, 1) == math.inf
    finish(work, samples[:1], 1.0)
    assert work.seconds_left([], 1, 1.0) is None  # most of the work is of a kind that is not measured
    finish(work, samples[10:11], 30.0)
    assert work.seconds_left([], 1, 31.0) == pytest.approx(9 * 1 + 9 * 30, rel=0.01)


MEASURED = {7: 0.0089, 10: 0.030, 16: 0.385, 24: 3.04}  # seconds of a core for a sample of so many spheres a side


@pytest.mark.parametrize("side", MEASURED)
def test_a_sample_takes_half_to_twice_of_what_is_estimated(side):
    assert 0.5 < seconds_of(RunSettings(shape=(side, side, side))) / MEASURED[side] < 2
