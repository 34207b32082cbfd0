"""Ctrl-C, SIGTERM and limits of time end work wherever it is, and what was reached before is whole."""

import importlib
import itertools
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from taichi_bearings import interrupts, leaving, plain_files
from taichi_bearings.conic import descent
from taichi_bearings.numerics.cholesky.factor import DenseFactor
from taichi_bearings.runs import run as runs
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.scan import scan
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import lattice_states
from taichi_bearings.solvers.drive import Checkpoints, solve
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import InteriorPoint, RigidLimit
from tests.scans.scan_faults import Here

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


SCENE = Scene.random((4, 4, 4), seed=2)


def strike(what=signal.SIGINT):
    signal.raise_signal(what)


def for_ever(*_):
    while True:
        time.sleep(0.01)


def minimum(stop=None):
    return solve(SCENE, InteriorPoint().build(), initial_spin(SCENE, "linear"), stop)


@pytest.fixture(autouse=True)
def heard():
    """SIGINT as Python hears it, though a shell that starts tests in the background would have it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def own_handlers():
    """Those of the command line, for this test."""
    before = {number: signal.getsignal(number) for number in interrupts.SIGNALS}
    interrupts.raise_at_signals()
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("what", interrupts.SIGNALS)
def test_a_module_that_swallows_exceptions_while_it_is_loaded_does_not_swallow_an_interrupt(
    tmp_path, monkeypatch, own_handlers, what
):
    """Compiled modules do; or they end as "initialization failed"."""
    text = f"import signal\nloaded = False\ntry:\n    signal.raise_signal({what})\nexcept BaseException:\n    pass\n"
    (tmp_path / f"swallows_{what}.py").write_text(text + "loaded = True\n")
    monkeypatch.syspath_prepend(tmp_path)

    def load_and_wait():
        assert importlib.import_module(f"swallows_{what}").loaded
        for_ever()

    with pytest.raises(KeyboardInterrupt):
        load_and_wait()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
@pytest.mark.parametrize(("command", "what"), list(zip(("verify", "export"), interrupts.SIGNALS, strict=True)))
def test_a_file_that_is_never_read_to_its_end_can_be_left(tmp_path, command, what):
    """HDF5 2.0 reads an entry of no length in its list of texts over and over."""
    assert runs.run(RunSettings(shape=(4, 5), figures="none"), tmp_path / "run").path is not None
    file = tmp_path / "run" / "run.h5"
    content = file.read_bytes()
    heap = content.index(b"GCOL\x01\0\0\0")
    file.write_bytes(content[: heap + 16] + bytes(64) + content[heap + 80 :])
    words = [sys.executable, "-m", "taichi_bearings_cli", command, tmp_path / "run"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    for wanted in (True, False):  # loading, then in HDF5
        while hears(process.pid) is not wanted and process.poll() is None:
            time.sleep(0.01)
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(what)
    out, err = process.communicate(timeout=10)
    assert (process.returncode, out, err) == (-what, "", "")  # a shell says 130 or 143
    assert file.read_bytes()[:8] == content[:8]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs a handler that is forgotten once it was called")
@pytest.mark.parametrize("what", interrupts.SIGNALS)
def test_what_reads_for_ever_and_seems_whole_is_left_at_the_second_signal(tmp_path, what):
    assert runs.run(RunSettings(shape=(4, 5), figures="none"), tmp_path / "run").path is not None
    endless = (
        "import itertools, sys\nfrom taichi_bearings import hdf5\nfrom taichi_bearings_cli.__main__ import main\n"
        "def read(*_):\n    print('reading', flush=True)\n    sum(itertools.repeat(0))\n"  # keeps Python's lock
        "hdf5.reason_against = read\nsys.argv = ['bearings', 'verify', sys.argv[1]]\nmain()\n"
    )
    command = [sys.executable, "-c", endless, tmp_path / "run"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "reading\n"
    time.sleep(1.0)  # until it does
    process.send_signal(what)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=0.5)
    process.send_signal(what)
    out, err = process.communicate(timeout=10)
    assert (process.returncode, out, err) == (-what, "", "")


SWALLOWED = """
import signal, sys, time
from taichi_bearings import interrupts, leaving

class Left:
    def __del__(self):
        signal.raise_signal(int(sys.argv[1]))

interrupts.end_at_signals()
try:
    with leaving.by_default_next_time():
        Left()
        time.sleep(10 * interrupts.SOON)
    time.sleep(leaving.GRACE / 2)
except KeyboardInterrupt:
    print("heard")
"""


@pytest.mark.parametrize("what", interrupts.SIGNALS)
def test_a_signal_that_is_swallowed_while_a_file_is_read_is_heard_after_it(what):
    done = subprocess.run([sys.executable, "-c", SWALLOWED, f"{int(what)}"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "heard\n", "")


def test_a_second_signal_changes_nothing_after_a_file_was_read(monkeypatch):
    monkeypatch.setattr(leaving, "_watched", True)
    with leaving.handled(signal.default_int_handler):
        for _ in range(2):
            with leaving.by_default_next_time(), pytest.raises(KeyboardInterrupt):
                strike()
        with pytest.raises(KeyboardInterrupt):
            strike()


def test_a_scan_that_is_interrupted_while_its_workers_end_writes_its_files(tmp_path, monkeypatch):
    (tmp_path / "scan.toml").write_text("shape = [4, 5]\n[scan]\nseed = [1, 2]\n")
    engine = Here()
    monkeypatch.setattr(engine, "close", lambda: strike() or time.sleep(0.05))
    report = scan(read_plan(tmp_path / "scan.toml"), tmp_path / "scan", engine=engine)
    assert (report["done"], report["interrupted"]) == (2, False)  # nothing is left to do
    assert (tmp_path / "scan" / "scan.h5").exists()


def hears(process):
    """Whether a process has a handler of its own for SIGTERM."""
    status = Path(f"/proc/{process}/status").read_text()
    return bool(int(re.search(r"SigCgt:\s+(\w+)", status)[1], 16) & 1 << signal.SIGTERM - 1)


def test_a_limit_of_time_ends_the_proof_too_and_is_no_interrupt(monkeypatch):
    minimum()  # compiled
    monkeypatch.setattr(lattice_states.LatticeReached, "known", for_ever)
    began = time.monotonic()
    found = minimum(StopRule(seconds=1.0))
    assert time.monotonic() - began < 4
    assert not found.interrupted
    assert not found.states_proven.any()
    time.sleep(0.1)  # no late signal


def test_settling_is_given_up_where_it_factorises_and_the_minimum_stays(monkeypatch, needs_f64):
    settle, undisturbed = descent.resolve, minimum()
    monkeypatch.setattr(descent, "resolve", lambda *given: (strike(), settle(*given))[1])
    found = minimum()
    assert found.interrupted
    assert found.gap.max() < descent.FIRST_SETTLING_GAP  # from which small samples are settled
    assert undisturbed.states_proven.all()
    assert not found.states_proven.any()
    assert (abs(found.power - undisturbed.power) <= found.gap * found.power).all()


def test_dynamics_given_up_amid_a_step_go_on_to_the_same_bits(monkeypatch):
    options, duration, strikes = RigidLimit(), 0.01, (3, 20, 50)
    scene, stop = Scene.random((3, 3, 3), seed=5), StopRule(duration=duration)
    recording = Recording(np.linspace(0, duration, 3))
    spin, factorise, written = initial_spin(scene, "random"), DenseFactor.factorise, []
    undisturbed = solve(scene, options.build(), spin, stop, (), None, recording, Checkpoints(1e9, lambda _: None))
    count = itertools.count()

    def struck(self, *given):
        if interrupts._ended.get() is not None and next(count) in strikes:
            strike()
        return factorise(self, *given)

    monkeypatch.setattr(DenseFactor, "factorise", struck)
    found, state = None, None
    for _ in range(len(strikes) + 1):
        found = solve(scene, options.build(), spin, stop, (), None, recording, Checkpoints(1e9, written.append, state))
        if not found.interrupted:
            break
        state = written[-1]
    assert next(count) > strikes[-1]
    assert not found.interrupted
    assert found.status is undisturbed.status
    assert np.array_equal(found.spin, undisturbed.spin)
    for name in set(undisturbed.history) - {"seconds"}:
        assert np.array_equal(found.history[name], undisturbed.history[name], equal_nan=True), name


def test_an_interrupt_while_files_are_written_waits_for_them_and_spares_the_figures(tmp_path, monkeypatch):
    publish = runs.publish
    monkeypatch.setattr(runs, "publish", lambda *given: (strike(signal.SIGTERM), publish(*given))[1])
    found = runs.run(RunSettings(shape=(4, 5)), tmp_path / "a")
    assert found.interrupted
    assert read_run(tmp_path / "a").solution.power == found.solution.power
    assert not list((tmp_path / "a").glob("*.png"))


@pytest.mark.parametrize("loads", [False, True])
def test_a_limit_of_time_is_not_taken_for_a_wish_to_end(tmp_path, loads):
    """What ends by its limit goes on to its answer, however long that takes, also where a module was being loaded."""
    (tmp_path / "slowly.py").write_text("import time\ntime.sleep(0.6)\n")
    first = "import slowly" if loads else "pass"
    program = f"""
import time
from contextlib import suppress
from taichi_bearings import interrupts
interrupts.end_at_signals()
with interrupts.Interrupt() as interrupt:
    with suppress(interrupts.GivenUp), interrupt.at_once(0.3):
        {first}
        while True:
            time.sleep(0.01)
    assert not interrupt.heard
    time.sleep(1.6)
print("answered")
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "answered\n", "")


def test_an_error_that_a_library_makes_of_an_interrupt_is_an_interrupt(tmp_path):
    """Compiled code may turn what a handler raises into another exception, before the thread that listens has run."""
    program = """
import signal, sys
sys.setswitchinterval(30)  # no other thread runs meanwhile
from taichi_bearings_cli import __main__, main
def command(**more):
    try:
        signal.raise_signal(signal.SIGTERM)
    except KeyboardInterrupt:
        raise SystemError("returned a result with an exception set") from None
main.bearings.main = command
__main__.main()
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "bearings: interrupted; only files that were complete are kept\n"


@pytest.mark.parametrize("given_up", [False, True])
def test_an_error_after_a_signal_that_was_noted_and_before_a_result_is_told(tmp_path, given_up):
    """Of a solve, which a signal ends between two steps; or after work that the signal has broken off."""
    program = f"""
import signal, time
from contextlib import suppress
from taichi_bearings import interrupts
from taichi_bearings_cli import __main__, main
def command(**more):
    with interrupts.keeping(), interrupts.Interrupt() as interrupt:
        if {given_up}:
            with suppress(interrupts.GivenUp), interrupt.at_once():
                signal.raise_signal(signal.SIGTERM)
        else:
            signal.raise_signal(signal.SIGTERM)
        assert interrupt.heard
        time.sleep(0.2)  # in which the thread that listens notes it too
        raise ValueError("the packing is upside down")
main.bearings.main = command
__main__.main()
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.endswith("ValueError: the packing is upside down\n")


@pytest.mark.filterwarnings("ignore:Exception ignored in. <_io.FileIO")  # closed when it is forgotten
@pytest.mark.parametrize("what", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_at_any_step_of_a_lock_leaves_no_file_that_the_end_would_not_remove(tmp_path, what):
    path, steps, ended = tmp_path / ".out.in-use", 0, False
    plain = {plain_files.__file__, leaving.__file__}

    def use(moment):
        """Hold the lock, and send a signal at the step of this number; False if there are not so many."""
        left = moment

        def tracer(frame, event, _):
            nonlocal left
            frame.f_trace_opcodes = True
            if event == "opcode" and frame.f_code.co_filename in plain:
                left -= 1
                if left == 0:
                    sys.settrace(None)
                    signal.raise_signal(what)
            return tracer

        sys.settrace(tracer)
        try:
            with plain_files.locked(path, "out"):
                pass
        finally:
            sys.settrace(None)
        return left <= 0

    before = {number: signal.signal(number, signal.default_int_handler) for number in leaving.SIGNALS}
    try:
        while not ended:
            steps += 1
            try:
                ended = not use(steps)
            except KeyboardInterrupt:
                assert not path.exists() or str(path) in leaving._temporary, steps
            path.unlink(missing_ok=True)
            leaving.forget_temporary(path)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert steps > 100
