"""The only iteration loop: it owns the clock, the history, the monitors and the stopping."""

import signal
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np

from taichi_bearings.certificate import relative_gap, slip_bound
from taichi_bearings.contact_state import ContactState, classify
from taichi_bearings.fields import borrow
from taichi_bearings.fields.workspace import make_layout
from taichi_bearings.scene import Progress, Scene, Solution, Status
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.stopping import StopRule


@dataclass(frozen=True)
class Report:
    """What a monitor hears at each check. power, gap : (R,), of the best state so far."""

    progress: Progress
    power: np.ndarray
    gap: np.ndarray
    seconds: float
    stop: StopRule


Monitor = Callable[[Report], None]
STALL_PATIENCE = 20_000  # iterations before a minimisation can count as stalled


def solve(
    scene: Scene,
    method: Method,
    spin: np.ndarray,
    stop: StopRule | None = None,
    monitors: Sequence[Monitor] = (),
    slip_threshold: float | None = None,
) -> Solution:
    """Run `method` on `scene` from the laboratory spins `spin` until `stop` says so.

    slip_threshold : length/time; contacts slipping less count as slipless. Default: what the method can resolve.
    Ctrl-C ends the run with status INTERRUPTED and everything reached so far.
    """
    stop = stop or StopRule()
    began = time.perf_counter()
    spec = method.plan(scene, spin)
    workspace = borrow(make_layout(scene.replicas, scene.lattice.shape), spec) if method.needs_taichi else nullcontext()
    with _Interrupt() as interrupt, workspace as fields:
        method.begin(scene, spin, fields)
        compiled = time.perf_counter()
        best = _Best(method.keeps_best)
        history = _History()
        pace = _Pace()
        progress = method.progress()
        while True:
            best.take(progress)
            elapsed = time.perf_counter() - compiled
            history.add(progress, best, elapsed)
            gap = relative_gap(scene, best.power, best.bound)
            for monitor in monitors:
                monitor(Report(progress, best.power, gap, elapsed, stop))
            stalled = progress.exhausted or best.has_stalled(progress.iteration, float(gap.max()))
            status = stop.judge(scene, progress, best.power, best.bound, elapsed, stalled)
            if status is None and interrupt.heard:
                status = Status.INTERRUPTED
            if status is not None:
                break
            wanted = min(method.next_check(progress.iteration), stop.iterations) - progress.iteration
            pace.advance(method, wanted, lambda: interrupt.heard or time.perf_counter() - compiled >= stop.seconds)
            progress = method.progress()
        seconds = time.perf_counter() - compiled
        final = replace(best.progress, iteration=progress.iteration)
    return _collect(scene, method.name, status, final, best.bound, history, seconds, compiled - began, slip_threshold)


class _Interrupt:
    """Hears Ctrl-C or a batch queue's SIGTERM without being torn out of a step; a second one ends the process."""

    def __init__(self) -> None:
        self.heard = False
        self._main = threading.current_thread() is threading.main_thread()

    def __enter__(self) -> "_Interrupt":
        if self._main:
            self._before = {number: signal.signal(number, self._hear) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        if self._main:
            for number, handler in self._before.items():
                signal.signal(number, handler)

    def _hear(self, *_: object) -> None:
        if self.heard:
            raise KeyboardInterrupt
        self.heard = True


class _Pace:
    """Splits the iterations between two checks into launches of about half a second."""

    def __init__(self) -> None:
        self.size = 64

    def advance(self, method: Method, steps: int, ended: Callable[[], bool]) -> None:
        while steps > 0 and not ended():
            now = min(self.size, steps)
            began = time.perf_counter()
            method.advance(now)
            steps -= now
            took = time.perf_counter() - began
            if took > 1.0:
                self.size = max(64, self.size // 2)
            elif took < 0.25 and now == self.size:
                self.size *= 2


class _Best:
    """The state that counts, replica by replica, and the best lower bound seen."""

    def __init__(self, keeps_best: bool) -> None:
        self.keeps_best = keeps_best
        self.progress: Progress
        self.bound = np.zeros(0)
        self._gap, self._improved_at = np.inf, 0

    @property
    def power(self) -> np.ndarray:
        return self.progress.power

    def has_stalled(self, iteration: int, gap: float) -> bool:
        """True if a minimisation has not brought the worst gap down by 1 % in the last four fifths of its iterations:
        the precision of the fields allows no more. A dynamics may linger as long as it likes."""
        if gap < 0.99 * self._gap:
            self._gap, self._improved_at = gap, iteration
        return self.keeps_best and iteration > max(STALL_PATIENCE, 5 * self._improved_at)

    def take(self, new: Progress) -> None:
        if len(self.bound) == 0:
            self.progress, self.bound = new, new.lower_bound
            return
        self.bound = np.maximum(self.bound, new.lower_bound)
        if not self.keeps_best:
            self.progress = new
            return
        old = self.progress
        better = new.power <= old.power  # False for NaN, so a failed step never counts
        if new.settled is not None:  # settled contact states are worth more than the last digit of the power
            better |= new.settled & (new.power <= old.power * (1 + 1e-11))
        if better.all():
            self.progress = new
            return
        pick = better.reshape(1, -1, *(1,) * (new.staggered.ndim - 2))
        state = resolved = None
        if new.state is not None and old.state is not None:
            state = tuple(np.where(pick[0], a, b) for a, b in zip(new.state, old.state, strict=True))
        if new.resolved is not None and old.resolved is not None:
            resolved = np.where(better, new.resolved, old.resolved)
        self.progress = replace(
            new,
            state=state,
            resolved=resolved,
            staggered=np.where(pick, new.staggered, old.staggered),
            force=tuple(np.where(pick, a, b) for a, b in zip(new.force, old.force, strict=True)),
            power=np.where(better, new.power, old.power),
            unbalanced_torque=np.where(better, new.unbalanced_torque, old.unbalanced_torque),
            resolution=new.resolution if better.any() else old.resolution,
        )


class _History:
    def __init__(self) -> None:
        self.columns: dict[str, list] = {}

    def add(self, progress: Progress, best: _Best, seconds: float) -> None:
        row = {
            "iteration": progress.iteration,
            "seconds": seconds,
            "power": progress.power,
            "lower_bound": best.bound,
            "unbalanced_torque": progress.unbalanced_torque,
        }
        if progress.time is not None:
            row["time"] = progress.time
        for name, value in row.items():
            self.columns.setdefault(name, []).append(value)

    def arrays(self) -> dict[str, np.ndarray]:
        return {name: np.asarray(values) for name, values in self.columns.items()}


def _states(scene: Scene, slip: tuple[np.ndarray, ...], final: Progress, threshold: float) -> tuple[np.ndarray, ...]:
    """Contact states as the method has established them, else by slip and friction; none slips below the threshold."""
    if final.state is None:
        return classify(scene, slip, final.force, threshold)
    return tuple(
        np.where((state == ContactState.SLIPPING) & (speed <= threshold), ContactState.SLIPLESS, state).astype(np.uint8)
        for state, speed in zip(final.state, slip, strict=True)
    )


def _collect(
    scene: Scene,
    method: str,
    status: Status,
    final: Progress,
    bound: np.ndarray,
    history: _History,
    seconds: float,
    seconds_compile: float,
    slip_threshold: float | None,
) -> Solution:
    slip = scene.slips(final.staggered, final.spin_axes)
    default = max(final.resolution, 1e-12 * scene.lattice.radius * scene.jump)
    threshold = default if slip_threshold is None else slip_threshold
    return Solution(
        scene=scene,
        method=method,
        status=status,
        iterations=final.iteration,
        spin=scene.laboratory_spin(final.staggered, final.spin_axes),
        slip=slip,
        power_per_contact=tuple(scene.power_of(values, axis) for axis, values in enumerate(slip)),
        force=tuple(vector_length(values) for values in final.force),
        state=_states(scene, slip, final, threshold),
        slip_bound=slip_bound(scene, final.force, final.spin_axes, final.power) if scene.law == "coulomb" else (),
        resolved=np.zeros(scene.replicas, dtype=bool) if final.resolved is None else final.resolved,
        power=final.power,
        lower_bound=bound,
        gap=relative_gap(scene, final.power, bound),
        slip_threshold=threshold,
        unbalanced_torque=final.unbalanced_torque,
        seconds=seconds,
        seconds_compile=seconds_compile,
        history=history.arrays(),
        findings=final.findings,
    )
