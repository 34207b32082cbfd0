"""The journal of a scan keeps whole lines whatever happens to the file."""

import resource
import signal

import pytest

from taichi_bearings.errors import FileError
from taichi_bearings.files.scan_journal import Journal, read_journal

SAMPLES = [
    {"key": f"{number:016x}", "scalars": {"status": "finished", "power": number / 3, "name": "ä\n"}, "bins": {}}
    for number in range(5)
]


@pytest.fixture
def path(tmp_path):
    with Journal(tmp_path / "samples.jsonl") as journal:
        journal.append(SAMPLES[:3])
        journal.append(SAMPLES[3:])
    return tmp_path / "samples.jsonl"


def test_a_missing_journal_is_empty(tmp_path):
    assert read_journal(tmp_path / "none") == {}


def test_a_torn_line_costs_its_sample_alone(path, caplog):
    """Wherever a kill has cut the file, the whole lines before it stay, and appending goes on after them."""
    whole = path.read_bytes()
    ends = [i + 1 for i, byte in enumerate(whole) if byte == ord("\n")]
    for length in range(0, len(whole), 17):
        path.write_bytes(whole[:length])
        kept = sum(end <= length for end in ends)
        assert list(read_journal(path).values()) == SAMPLES[:kept]
        with Journal(path) as journal:
            journal.append(SAMPLES[kept:])
        assert path.read_bytes() == whole
    assert not caplog.records


def test_a_changed_line_is_named_and_its_sample_missing(path, caplog):
    lines = path.read_bytes().splitlines(keepends=True)
    for damage in (lines[1].replace(b"0.333", b"0.334"), b"nonsense\n", b"\n", lines[1][:40] + b"\n"):
        caplog.clear()
        path.write_bytes(lines[0] + damage + b"".join(lines[2:]))
        assert list(read_journal(path).values()) == [SAMPLES[0], *SAMPLES[2:]]
        assert "line 2" in caplog.text
        assert str(path) in caplog.text


def test_a_changed_line_goes_once_the_journal_goes_on(path, caplog):
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([lines[0], lines[1].replace(b"0.333", b"0.334"), *lines[2:]]))
    with Journal(path) as journal:
        journal.append(SAMPLES[1:2])
    assert path.read_bytes() == b"".join([lines[0], *lines[2:], lines[1]])
    assert len(read_journal(path)) == 5
    assert not caplog.records


def test_a_full_disk_is_told_and_keeps_the_samples_that_fit(path):
    """A limit on the size of files stands for the disk: the write that crosses it stores a part and fails."""
    whole, limits = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    lines = whole.splitlines(keepends=True)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with Journal(path) as journal:
            for room, fitting in (50, []), (len(lines[0]) + len(lines[1]) + 9, lines[:2]):
                resource.setrlimit(resource.RLIMIT_FSIZE, (len(whole) + room, limits[1]))
                with pytest.raises(FileError, match="cannot be written"):
                    journal.append(SAMPLES)
                assert path.read_bytes() == b"".join([whole, *fitting])
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            journal.append(SAMPLES[:1])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert path.read_bytes() == b"".join([whole, *lines[:2], lines[0]])


def test_a_folder_in_its_place_is_named(tmp_path):
    with pytest.raises(FileError, match="is not a regular file"):
        Journal(tmp_path)
    with pytest.raises(FileError, match="is not a regular file"):
        read_journal(tmp_path)
