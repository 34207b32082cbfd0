"""A run directory is one process's at a time, whenever others come and go."""

import subprocess
import sys

import pytest

import taichi_bearings as tb
from taichi_bearings import plain_files
from taichi_bearings.errors import FileError
from taichi_bearings.runs.run_directory import completed, in_use
from taichi_bearings.runs.run_directory import run_directory as directory_at

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="where an open file cannot be removed")


def test_a_second_user_is_refused_and_the_lock_file_goes(tmp_path):
    with in_use(tmp_path):
        with pytest.raises(FileError, match="is in use"), in_use(tmp_path):
            pass
        with in_use(tmp_path, "part"):
            assert len(list(tmp_path.iterdir())) == 2
    assert not list(tmp_path.iterdir())


def write_run(folder, text):
    folder.mkdir(exist_ok=True)
    (folder / "run.h5").write_text(text)


def names(folder):
    return sorted(file.name for file in folder.iterdir())


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("kind", ["run", "file", "link"])
def test_what_appears_meanwhile_stays(tmp_path, kind, force):
    with directory_at(tmp_path / "a", force) as directory:
        write_run(directory.partial, "ours")
        if kind == "run":
            write_run(tmp_path / "a", "theirs")
        elif kind == "file":
            (tmp_path / "a").write_text("theirs")
        else:
            (tmp_path / "a").symlink_to("nowhere")
        with pytest.raises(FileError, match="a cannot be written"):
            directory.publish()
    assert names(tmp_path) == ["a"]
    assert kind == "link" or (tmp_path / "a" / ("run.h5" if kind == "run" else "")).read_text() == "theirs"


def test_with_force_another_run_that_came_for_the_old_one_stays(tmp_path):
    write_run(tmp_path / "a", "old")
    with directory_at(tmp_path / "a", force=True) as directory:
        write_run(directory.partial, "ours")
        (tmp_path / "a").rename(tmp_path / "b")
        write_run(tmp_path / "a", "theirs")
        with pytest.raises(FileError, match="another program created a file or folder of this name in the meantime"):
            directory.publish()
    assert [(tmp_path / name / "run.h5").read_text() for name in ("a", "b")] == ["theirs", "old"]


def test_a_name_is_one_run_s_at_a_time(tmp_path):
    with directory_at(tmp_path / "a"):
        for force in (False, True):
            with pytest.raises(FileError, match=r"a is in use"), directory_at(tmp_path / "a", force):
                pass
        with directory_at(tmp_path / "b"):
            assert len(names(tmp_path)) == 4  # folders and locks of both
    assert names(tmp_path) == []


def test_force_spares_a_directory_that_is_held_and_what_is_no_run(tmp_path):
    write_run(tmp_path / "a", "old")
    with in_use(tmp_path / "a"), pytest.raises(FileError, match="in use"), directory_at(tmp_path / "a", force=True):
        pass
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "letter.txt").touch()
    with pytest.raises(FileError, match="is not a run directory"), directory_at(tmp_path / "b", force=True):
        pass
    with pytest.raises(FileError, match="already exists"), directory_at(tmp_path / "a"):
        pass
    assert names(tmp_path) == ["a", "b"]
    assert names(tmp_path / "a") == ["run.h5"]


def test_force_replaces_what_a_link_points_to(tmp_path):
    write_run(tmp_path / "a", "old")
    (tmp_path / "link").symlink_to(tmp_path / "a")
    with directory_at(tmp_path / "link", force=True) as directory:
        write_run(directory.partial, "new")
        directory.publish()
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "a" / "run.h5").read_text() == "new"


@pytest.mark.parametrize("kind", ["exchange", "rename", "complete"])
def test_a_kill_at_any_step_leaves_the_old_or_the_new_run_and_the_next_call_tidies_up(tmp_path, kind):
    command = [sys.executable, "-m", "tests.runs.kills", str(tmp_path), kind]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) > 15


def test_leftovers_of_the_living_and_files_of_others_stay(tmp_path):
    left = ".a.partial-7-00ff00"
    for name in (left, ".b.partial-7-00ff00", ".c.partial-7-00ff00-replaced", ".own.partial", "d.partial-7-00ff00"):
        (tmp_path / name).mkdir()
    with plain_files.locked(tmp_path / ".a.in-use", "a"), directory_at(tmp_path / "y"):
        assert (tmp_path / left).is_dir()
        assert not (tmp_path / ".b.partial-7-00ff00").exists()
    with directory_at(tmp_path / "x"):
        pass
    assert names(tmp_path) == [".own.partial", "c", "d.partial-7-00ff00"]


def test_files_that_cannot_go_together_do_not_go_at_all(tmp_path):
    write_run(tmp_path / "a", "old")

    def complete():
        with in_use(tmp_path / "a"), completed(tmp_path / "a") as folder:
            write_run(folder, "new")
            raise OSError(28, "No space left on device")

    with pytest.raises(FileError, match="cannot be written: No space left"):
        complete()
    assert names(tmp_path / "a") == ["run.h5"]
    assert (tmp_path / "a" / "run.h5").read_text() == "old"


def test_a_file_where_a_folder_is_wanted_is_named(tmp_path):
    (tmp_path / "notes").write_text("mine")
    with pytest.raises(FileError, match=r"notes/a cannot be written: \S*notes is no folder$"):
        tb.solve(tb.Scene.random((3, 4), seed=1), threads=1).save(tmp_path / "notes" / "a")
