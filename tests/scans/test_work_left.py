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
    samples, end, records = read_plan(tmp_path / "scan.toml").samples, recording["seconds"], {}
    rows = [(samples[first : first + number], *times) for first, number, *times in recording["units"]]
    rows.sort(key=lambda row: row[1])
    work, waiting, shown = WorkLeft([unit for unit, *_ in rows], records), list(rows), []
    for now in sorted({t for _, *times, _ in rows for t in times} | {end * look / LOOKS for look in range(LOOKS)}):
        for row in [row for row in waiting if row[2] <= now]:
            waiting.remove(row)
            records |= {sample.key: {"scalars": {"seconds": row[3] / len(row[0])}} for sample in row[0]}
            for sample in row[0]:
                work.finish(sample)
        work.look([unit for unit, begin, *_ in waiting if begin <= now], WORKERS, now)
        shown.append((now, len(records), work.seconds_left(WORKERS, now)))
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


def begin_and_end(work, unit, begin, end, records=None):
    work.look([unit], 1, begin)
    records is None or records.update({s.key: {"scalars": {"seconds": (end - begin) / len(unit)}} for s in unit})
    for sample in unit:
        work.finish(sample)
    work.look([], 1, end)


def test_nothing_is_known_before_something_is_measured(plan_of):
    units = units_of(plan_of("shape = [8, 8, 8]\n[scan]\nseed = { start = 0, stop = 96 }\n").samples)
    records = {}
    work = WorkLeft(units, records)
    assert work.expected(1) == pytest.approx(96 * seconds_of(units[0][0].settings))
    assert work.seconds_left(1, 0.0) is None
    work.look(units[:1], 1, 0.0)
    assert work.seconds_left(1, 5.0) is None
    begin_and_end(work, units[0], 0.0, 6.0, records)
    assert work.seconds_left(1, 6.0) == pytest.approx(6.0 * (96 / len(units[0]) - 1))


def test_samples_without_an_estimate_are_learnt_kind_by_kind(plan_of):
    plan = plan_of(
        'shape = [4, 4]\nmethod = "cundall-strack"\n[scan]\nduration = [1.0, 10.0]\nseed = { start = 0, stop = 10 }\n'
    )
    units, records = units_of(plan.samples), {}
    work = WorkLeft(units, records)
    assert work.expected(1) is None
    assert [unit[0].point for unit in units[:2]] == [{"duration": 1.0, "seed": 0}, {"duration": 10.0, "seed": 0}]
    begin_and_end(work, units[0], 0.0, 1.0, records)
    assert work.seconds_left(1, 1.0) is None  # most of the work is of a kind that is not measured
    begin_and_end(work, units[1], 1.0, 31.0, records)
    assert work.seconds_left(1, 31.0) == pytest.approx(9 * 1 + 9 * 30, rel=0.3)
    for number in range(2, 11):
        begin_and_end(work, units[number], 29.0 + number, 30.0 + number)
    assert work.seconds_left(1, 40.0) == pytest.approx(9 * 30, rel=0.1)


def test_the_last_long_sample_is_not_shared_by_idle_workers(plan_of):
    units = units_of(plan_of("[scan]\nshape = [[24, 24, 24], [6, 6, 6]]\nseed = [1, 2, 3]\n").samples, workers=4)
    work, seconds = WorkLeft(units, {}), seconds_of(units[0][0].settings)
    assert work.expected(100) == pytest.approx(seconds)
    assert work.expected(1) == pytest.approx(3 * seconds, rel=0.01)
    assert work.expected(2) == pytest.approx(2 * seconds, rel=0.01)


def test_units_that_wait_at_their_worker_take_no_time_yet(plan_of):
    units = units_of(plan_of("shape = [16, 16, 16]\n[scan]\nseed = { start = 0, stop = 8 }\n").samples, workers=8)
    records = {}
    work = WorkLeft(units, records)
    for number in range(4):
        work.look(units[number : number + 2], 1, 10.0 * number)
        records[units[number][0].key] = {"scalars": {"seconds": 10.0}}
        work.finish(units[number][0])
    work.look(units[4:6], 1, 40.0)
    assert work.seconds_left(1, 40.0) == pytest.approx(40.0)
    assert work.seconds_left(1, 45.0) == pytest.approx(35.0)


def test_a_unit_that_is_overdue_says_that_its_kind_takes_longer(plan_of):
    units = units_of(plan_of("shape = [16, 16, 16]\n[scan]\nseed = { start = 0, stop = 8 }\n").samples, workers=8)
    records = {}
    work = WorkLeft(units, records)
    begin_and_end(work, units[0], 0.0, 10.0, records)
    work.look(units[1:2], 1, 10.0)
    assert work.seconds_left(1, 10.0) == pytest.approx(70.0)
    assert work.seconds_left(1, 20.0) > 60.0
    assert 6 * 25.0 < work.seconds_left(1, 50.0) < 6 * 50.0


def test_samples_that_are_tried_again_come_last_and_alone(plan_of):
    units = units_of(plan_of("shape = [16, 16, 16]\n[scan]\nseed = { start = 0, stop = 8 }\n").samples, workers=8)
    work = WorkLeft(units, {})
    (seconds,) = {seconds_of(unit[0].settings) for unit in units}
    assert work.expected(4) == pytest.approx(2 * seconds)
    for unit in units[:3]:
        work.retry(unit[0])
    assert work.expected(4) == pytest.approx((2 + 3) * seconds)
    for unit in units[3:]:
        work.finish(unit[0])
    work.look(units[:1], 4, 0.0)
    assert work.expected(4) == pytest.approx(3 * seconds + work.start)


if __name__ == "__main__":
    Path(sys.argv[2]).write_text(record(Path(sys.argv[1]), Path(sys.argv[2]).with_suffix("")))
