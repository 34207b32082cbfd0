"""The time left of a scan comes from the cost of the samples that remain: recorded scans played again, single cases.

A recording is made by ``python -m tests.scans.test_work_left SCAN.toml RECORDING.toml``: what each unit was (its first
sample in the plan, how many), when it began and ended, and the seconds of its solves.
"""

import sys
import time
from pathlib import Path

import pytest

from taichi_bearings.runs.settings import read_toml
from taichi_bearings.scans.engine import LocalEngine
from taichi_bearings.scans.estimate import WorkLeft, seconds_of, units_of
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
    samples, end = read_plan(tmp_path / "scan.toml").samples, recording["seconds"]
    rows = [(samples[first : first + number], *times) for first, number, *times in recording["units"]]
    rows.sort(key=lambda row: row[1])
    work, waiting, shown, done = WorkLeft([sample for unit, *_ in rows for sample in unit]), list(rows), [], 0
    left, told = None, 0.0
    for now in sorted({t for _, *times, _ in rows for t in times} | {end * look / LOOKS for look in range(LOOKS)}):
        for row in [row for row in waiting if row[2] <= now]:
            waiting.remove(row)
            for sample in row[0]:
                work.finish(sample, row[3] / len(row[0]))
            done, left, told = done + len(row[0]), work.seconds_left(WORKERS, now), now
        shown.append((now, done, None if left is None else left - (now - told)))
    return shown, len(samples), end


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_the_time_left_is_within_a_factor_of_three_from_a_quarter_on(path, tmp_path):
    shown, _, end = played(path, tmp_path)
    for now, _, left in shown:
        if FROM * end <= now < TO * end:
            assert left is not None
            assert (end - now) / 3 < left < 3 * (end - now), f"{left:.0f} s left at {now:.0f} of {end:.0f} s"
    assert all(left is None or left < 2 * end for _, _, left in shown)


def test_the_number_of_samples_says_nothing_where_sizes_are_mixed(tmp_path):
    (path,) = [path for path in RECORDINGS if path.stem == "sizes"]
    shown, total, end = played(path, tmp_path)
    now, done, _ = next(look for look in shown if look[0] >= end / 4)
    assert (total - done) * now / done < (end - now) / 4


def test_nothing_is_known_before_something_is_measured(plan_of):
    samples = plan_of("shape = [8, 8, 8]\n[scan]\nseed = { start = 0, stop = 96 }\n").samples
    work = WorkLeft(samples)
    assert work.expected(1) == pytest.approx(96 * seconds_of(samples[0].settings))
    assert work.seconds_left(1, 0.0) is None
    for sample in samples[:24]:
        work.finish(sample, 0.25)
    assert work.seconds_left(1, 0.0) == pytest.approx(72 * 0.25, rel=0.01)
    assert work.seconds_left(4, 0.0) == pytest.approx(18 * 0.25, rel=0.01)


def test_samples_without_an_estimate_are_learnt_kind_by_kind(plan_of):
    plan = plan_of(
        'shape = [4, 4]\nmethod = "cundall-strack"\n[scan]\nduration = [1.0, 10.0]\nseed = { start = 0, stop = 10 }\n'
    )
    samples, work = plan.samples, WorkLeft(plan.samples)
    assert work.expected(1) is None
    assert [unit[0].point for unit in units_of(samples)[:2]] == [
        {"duration": 1.0, "seed": 0},
        {"duration": 10.0, "seed": 0},
    ]
    work.finish(samples[0], 1.0)
    assert work.seconds_left(1, 0.0) is None  # most of the work is of a kind that is not measured
    work.finish(samples[10], 30.0)
    assert work.seconds_left(1, 0.0) == pytest.approx(9 * 1 + 9 * 30, rel=0.3)
    for sample in samples[1:10]:
        work.finish(sample, 1.0)
    assert work.seconds_left(1, 0.0) == pytest.approx(9 * 30, rel=0.1)


def test_the_last_long_sample_is_not_shared_by_idle_workers(plan_of):
    samples = plan_of("[scan]\nshape = [[24, 24, 24], [6, 6, 6]]\nseed = [1, 2, 3]\n").samples
    work, seconds = WorkLeft(samples), seconds_of(samples[0].settings)
    assert work.expected(100) == pytest.approx(seconds)
    assert work.expected(1) == pytest.approx(3 * seconds, rel=0.01)


def test_a_sample_that_has_failed_says_nothing_of_the_time_of_others(plan_of):
    samples = plan_of("shape = [16, 16, 16]\n[scan]\nseed = { start = 0, stop = 8 }\n").samples
    work = WorkLeft(samples)
    work.finish(samples[0], None)
    assert work.seconds_left(1, 0.0) is None
    assert work.expected(1) == pytest.approx(7 * seconds_of(samples[0].settings))


if __name__ == "__main__":
    Path(sys.argv[2]).write_text(record(Path(sys.argv[1]), Path(sys.argv[2]).with_suffix("")))
