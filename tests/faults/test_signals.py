"""Ctrl-C and SIGTERM at random moments of a command: it ends soon, says one sentence, and leaves whole files.

A moment is so much processor time of the command after it has its handlers, so that other programs do not matter. With
--thorough 300 signals are sent to each command, and to all of them.
"""

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from taichi_bearings.runs.run import run
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
SOON, HANGS = 2.0, 60.0  # seconds of the processor or of the clock, whichever are fewer; seconds of the clock
COMMANDS = {
    "analyse": "analyse run --no-figures",
    "export": "export run --force",
    "run": "run --shape 6,6,6 --out out",
    "view": "view run --force",
    "verify": "verify run",
    "histogram": "histogram run --out counts",
    "plot": "plot spins run --out a.png",
    "list": "list .",
    "info": "info",
    "packing": "run --driven walls --shape 3,3,3 --out out",
    "scan": "scan scan.toml --workers 2 --out scan",
}
OFTEN = ("analyse", "export", "run")  # those of every suite
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1"}


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A folder with a run and a scan to be made."""
    folder = tmp_path_factory.mktemp("stored")
    run(RunSettings(shape=(6, 6, 6), figures="none", threads=1), folder / "run")
    (folder / "scan.toml").write_text("shape = [4, 5]\n[scan]\nseed = { start = 0, stop = 6 }\n")
    return folder


def hears(process):
    """Whether a process has a handler of its own for SIGTERM."""
    found = re.search(r"SigCgt:\s+(\w+)", Path(f"/proc/{process.pid}/status").read_text())
    return found is not None and bool(int(found[1], 16) & 1 << signal.SIGTERM - 1)


def processor_time(process):
    """Seconds that a process has had."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def struck(words, folder, what, moment):
    """Exit code, stderr, and seconds to the end after the signal; None if the command was over before."""
    command = [sys.executable, "-m", "taichi_bearings_cli", *words.split()]
    temporary = folder.with_name(f"{folder.name}-temporary")
    temporary.mkdir()
    environment = ENVIRONMENT | {"TMPDIR": str(temporary)}
    with open(folder / ".said", "w+") as said:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=said)
        while process.poll() is None and not hears(process):
            time.sleep(0.002)
        begun = processor_time(process) if process.poll() is None else 0.0
        while process.poll() is None and processor_time(process) - begun < moment:
            time.sleep(0.002)
        if process.poll() is not None:
            return None
        wall, used = time.monotonic(), processor_time(process)
        process.send_signal(what)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall, used = time.monotonic() - wall, usage.ru_utime + usage.ru_stime - used
        assert wall < HANGS
        said.seek(0)
        return process.returncode, said.read(), min(wall, used)


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in OFTEN else pytest.mark.thorough) for n in COMMANDS])
def test_a_signal_at_any_moment_ends_a_command_soon_and_leaves_whole_files(stored, tmp_path, name, thorough):
    draw, ended = random.Random(f"signals to {name}"), []
    for number in range(300 if thorough else 2):
        what, moment, found = draw.choice([signal.SIGINT, signal.SIGTERM]), draw.uniform(0, 2.0), None
        while found is None:  # over before the signal, which comes earlier the next time
            folder = tmp_path / f"{number}-{moment}"
            shutil.copytree(stored, folder)
            found, moment = struck(COMMANDS[name], folder, what, moment), moment / 2
        code, said, seconds = found
        ended.append(code)
        assert code in (0, 130), (what, said)  # 0 where all was done
        assert seconds < SOON, (what, said)
        assert "Traceback" not in said
        assert "ignored" not in said.replace("-ignored", "")
        assert code == 0 or len(re.findall("^bearings: (?!warning: )", said, re.M)) <= 1
        assert not [file for file in folder.rglob(".*") if file.name != ".said"]
        assert read_run(folder / "run").solution.power > 0
        for file in folder.rglob("run.h5"):
            read_run(file)
        assert not list(folder.with_name(f"{folder.name}-temporary").glob("pymp-*"))  # folders of multiprocessing
        shutil.rmtree(folder)
    assert 130 in ended
