"""The time left of a scan comes from the cost of the samples that remain: recorded scans played again, single cases.

A recording is made by ``python -m tests.scans.test_work_left SCAN.toml RECORDING.toml``: what each unit was (its first
sample in the plan, how many), when it began and ended, and the seconds of its solves.
"""

import math
import sys
import time
from pathlib import Path

import pytest

from taichi_bearings.runs.settings import read_toml
from taichi_bearings.scans.engine import LocalEngine
from taichi_bearings.scans.estimate import WorkLeft, seconds_in_all, seconds_of
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.sample import solve_samples
from taichi_bearings.scans.scan import scan

RECORDINGS = sorted((Path(__file__).parent / "recorded").glob("*.toml"))
WORKERS = 2
LOOKS = 400
FROM, TO = 0.25, 0.95  # of the whole time; its end hangs on single units


class Recorder(LocalEngine):
    """Notes of each unit its samples, begin, end, and the seconds of its solves."""

    def __init__(self, *given):
        super().__init__(*given)
        self.since, self.rows, self.sent = time.monotonic(), [], {}

    def submit(self, unit):
        self.sent[unit[0].key] = time.monotonic() - self.since
        super().submit(unit)

    def collect(self, seconds):
        outcomes = super().collect(seconds)
        for outcome in outcomes:
            solving = sum(record["scalars"]["seconds"] for record in outcome.records)
            self.rows.append((outcome.unit, self.sent[outcome.unit[0].key], time.monotonic() - self.since, solving))
        return outcomes


def record(path, folder, monitor=lambda _: None):
    """The text of a recording of a scan."""
    plan, engine = read_plan(path), Recorder(solve_samples, WORKERS)
    report = scan(plan, folder, monitor=monitor, engine=engine)
    index = {sample.key: number for number, sample in enumerate(plan.samples)}
    rows = [
        f"  [{index[unit[0].key]}, {len(unit)}, {begin:.2f}, {end:.2f}, {solving:.2f}],\n"
        for unit, begin, end, solving in engine.rows
    ]
    return f'seconds = {report["seconds"]:.2f}\nunits = [\n{"".join(rows)}]\nscan = """\n{path.read_text()}"""\n'


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


def test_the_number_of_samples_says_nothing_where_sizes_are_mixed(tmp_path):
    (path,) = [path for path in RECORDINGS if path.stem == "sizes"]
    shown, total, end = played(path, tmp_path)
    now, done, _ = next(look for look in shown if look[0] >= end / 4)
    assert (total - done) * now / done < (end - now) / 4


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


def test_kinds_that_are_not_measured_take_what_others_of_their_method_say(plan_of):
    samples = plan_of("[scan]\nshape = [[6, 6, 6], [24, 24, 24]]\nseed = [1, 2, 3]\n").samples
    work, small, large = WorkLeft(samples), *(seconds_of(samples[number].settings) for number in (0, 3))
    assert seconds_in_all(samples, 1) == pytest.approx(3 * (small + large))
    assert seconds_in_all(samples, 100) == pytest.approx(large)  # the longest sample is not shared by idle workers
    finish(work, samples[3:4], 10 * large)
    assert work.seconds_left([], 1, 0.0) == pytest.approx(10 * (3 * small + 2 * large), rel=0.02)


def test_a_sample_that_failed_needs_no_more_work_and_says_nothing(plan_of):
    samples = plan_of("shape = [16, 16, 16]\n[scan]\nseed = { start = 0, stop = 8 }\n").samples
    work = WorkLeft(samples)
    work.finish(samples[0], {"scalars": {"status": "failed"}})
    assert work.seconds_left([], 1, 0.0) is None
    finish(work, samples[1:2], 2.0)
    assert work.seconds_left([], 1, 0.0) == pytest.approx(6 * 2.0, rel=0.01)


if __name__ == "__main__":
    Path(sys.argv[2]).write_text(record(Path(sys.argv[1]), Path(sys.argv[2]).with_suffix("")))
