"""A run directory is one process's at a time, whenever others come and go."""

import sys

import pytest

from taichi_bearings.errors import FileError
from taichi_bearings.studies import run_directory
from taichi_bearings.studies.run_directory import in_use

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="where an open file cannot be removed")


@pytest.fixture
def between_opening_and_locking(monkeypatch):
    """A function that has something happen after the next process has opened the lock file and before it locks it."""

    def meanwhile(happen):
        lock = run_directory._lock

        def happen_first(descriptor):
            monkeypatch.setattr(run_directory, "_lock", lock)
            happen()
            lock(descriptor)

        monkeypatch.setattr(run_directory, "_lock", happen_first)

    return meanwhile


def test_a_second_user_is_refused_and_the_lock_file_goes(tmp_path):
    with in_use(tmp_path):
        with pytest.raises(FileError, match="is in use"), in_use(tmp_path):
            pass
        with in_use(tmp_path, "part"):
            assert len(list(tmp_path.iterdir())) == 2
    assert not list(tmp_path.iterdir())


def test_the_file_of_a_user_who_leaves_meanwhile_is_not_taken_for_the_lock(tmp_path, between_opening_and_locking):
    (tmp_path / ".in-use").touch()
    between_opening_and_locking((tmp_path / ".in-use").unlink)
    with in_use(tmp_path), pytest.raises(FileError, match="is in use"), in_use(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_one_leaves_and_another_comes_meanwhile(tmp_path, between_opening_and_locking):
    other = in_use(tmp_path)

    def leave_and_come():
        (tmp_path / ".in-use").unlink()
        other.__enter__()

    between_opening_and_locking(leave_and_come)
    with pytest.raises(FileError, match="is in use"), in_use(tmp_path):
        pass
    other.__exit__(None, None, None)
    with in_use(tmp_path):
        pass
