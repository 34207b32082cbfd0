"""Stages: who is told, that times add up, and that nothing is left behind by what fails."""

import threading
import time

import pytest

from taichi_bearings.stages import Watch, each, stage, watched


class Notes(Watch):
    def __init__(self):
        super().__init__()
        self.told = []

    def begin(self, new):
        super().begin(new)
        self.told.append(" / ".join(one.name for one in self.stages))

    def hear(self, stage):
        self.told.append((stage.number, stage.total, stage.report))


def test_stages_within_stages_are_told_outermost_first():
    with watched(Notes()) as notes, stage("solving") as solving:
        solving.tell("gap 1")
        with stage("settling"):
            assert [one.name for one in notes.stages] == ["solving", "settling"]
    assert notes.told == ["solving", (0, 0, "gap 1"), "solving / settling"]
    assert notes.stages == []


def test_times_add_up_and_each_moment_counts_once():
    began = time.perf_counter()
    with watched(Watch()) as watch:
        time.sleep(0.02)
        with stage("solving"):
            time.sleep(0.02)
            with stage("settling"):
                time.sleep(0.04)
            time.sleep(0.02)
        with stage("solving"):
            time.sleep(0.02)
    watch.book()
    took = time.perf_counter() - began
    assert list(watch.seconds) == ["loading", "solving", "settling"]
    assert sum(watch.seconds.values()) == pytest.approx(took, abs=2e-3)
    assert watch.seconds["solving"] >= 0.06
    assert watch.seconds["settling"] >= 0.04
    assert watch.seconds["solving"] < took - 0.06


def test_each_tells_which_of_how_many_and_what_share_of_the_work_is_done():
    with watched(Notes()) as notes:
        for _ in each((2, 4, 2), "sample", float):
            (under_way,) = notes.stages
            assert under_way.total == 3
        assert [share for _, share in under_way.done] == [0, 0.25, 0.75]
    assert [told[:2] for told in notes.told[1:]] == [(1, 3), (2, 3), (3, 3)]


def test_what_fails_inside_leaves_no_stage_behind():
    def fail():
        with stage("writing"):
            for _ in each(range(3), "sample"):
                raise ValueError("lost")

    with watched(Watch()) as watch:
        with pytest.raises(ValueError, match="lost"):
            fail()
        assert watch.stages == []


def test_without_a_listener_and_in_other_threads_a_stage_is_nothing():
    with stage("alone") as alone:
        alone.tell("unheard")
    with watched(Notes()) as notes:
        worker = threading.Thread(target=lambda: list(each(range(3), "sample")))
        worker.start()
        worker.join()
    assert notes.told == []
