"""The only iteration loop: it owns the clock, the history, the monitors and the stopping."""

import _thread
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from types import FrameType

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.errors import DeviceError, FileError, InputError
from taichi_bearings.fields import CPU_BLOCK, Fields, FieldSpec, make_layout
from taichi_bearings.interrupts import GivenUp, handled, is_loading, while_wanted
from taichi_bearings.lattice.grid import laboratory_forces
from taichi_bearings.proof.certificate import Forces, certifying_forces, lower_bound, relative_gap
from taichi_bearings.proof.contact_state import ContactState, classify, separate
from taichi_bearings.scene import Progress, Scene, Solution, Status
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.method import Method, is_dynamics
from taichi_bearings.solvers.recording import Recorder, Recording
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import stage
from taichi_bearings.verifier.judgement import Judgement
from taichi_bearings.verifier.samples import LAWS, Samples
from taichi_bearings.verifier.states import SLIPPING


@dataclass(frozen=True)
class Report:
    """What a monitor hears at each check. objective, gap : (R,), of the best state so far; see `Progress`."""

    progress: Progress
    objective: np.ndarray
    gap: np.ndarray
    seconds: float
    stop: StopRule


Monitor = Callable[[Report], bool | None]
"""Hears of each check; the solve ends as if interrupted where it returns True."""
IMPATIENCE = 5.0  # seconds
STALL_PATIENCE = 20_000  # iterations before a minimisation can count as stalled


@dataclass(frozen=True)
class Checkpoints:
    """Where and how often a dynamics writes down all that it needs to go on from there with the same bits.

    every : seconds of wall time. write : takes the arrays by name. resume : what an earlier call has written.
    """

    every: float
    write: Callable[[dict[str, np.ndarray]], None]
    resume: Mapping[str, np.ndarray] | None = None


def solve(
    scene: Scene,
    method: Method,
    spin: np.ndarray,
    stop: StopRule | None = None,
    monitors: Sequence[Monitor] = (),
    slip_threshold: float | None = None,
    recording: Recording | None = None,
    checkpoints: Checkpoints | None = None,
) -> Solution:
    """Run `method` on `scene` from the laboratory spins `spin` until `stop` says so.

    slip_threshold : length/time; contacts slipping less count as slipless. Default: what the method can resolve.
    recording, checkpoints : for a dynamics.
    Ctrl-C ends the run with status INTERRUPTED and everything reached so far, unless the answer is reached already;
    before the first step KeyboardInterrupt. It and the limit on time end the proof of the contact states too.
    Raises InputError for a scene that the method cannot solve.
    """
    stop, recording = stop or StopRule(), recording or Recording()
    began = time.perf_counter()
    if reason := method.options.refusal(scene):
        raise InputError(reason)
    if method.options.cpu_only and runtime.current().is_gpu:
        raise DeviceError(f"{method.options.name} works in the memory of the CPU; use --arch cpu")
    spec = method.plan(scene, spin)
    with _Interrupt() as interrupt:
        with stage("compiling" if method.options.needs_taichi else "preparing"), interrupt.at_once():
            method.begin(scene, spin, _fields(scene, method, spec) if spec else None)
        if interrupt.heard:  # nothing is reached yet
            raise KeyboardInterrupt
        compiled = time.perf_counter()
        course = _Course(scene, method, stop, recording, checkpoints, interrupt)
        with stage("solving") as solving:
            status, progress, seconds = course.follow([solving.tell, *monitors])
        with stage("proving contact states"):
            solution = course.answer(status, progress.iteration, seconds, compiled - began, slip_threshold)
    running = runtime.current() if method.options.needs_taichi else runtime.HOST
    return replace(solution, interrupted=interrupt.heard, running=running)


def uninterrupted(solution: Solution) -> Solution:
    """The same solution; KeyboardInterrupt if Ctrl-C was heard meanwhile, even if too late to change it."""
    if solution.interrupted:
        raise KeyboardInterrupt
    return solution


def with_forces_of(answer: Solution, other: Solution) -> Solution:
    """An answer with the friction of another one to its scene in replicas where that proves more of it."""
    scene, more = answer.scene, other.lower_bound > answer.lower_bound

    def picked(new: Forces, old: Forces) -> Forces:
        return tuple(np.where(more.reshape(-1, *(1,) * (b.ndim - 1)), a, b) for a, b in zip(new, old, strict=True))

    friction = picked(other.friction, answer.friction)
    judgement = _judged(scene, answer.spin, answer.spin_rounding, friction) if more.any() else None
    if judgement is None:
        return answer
    return replace(
        answer,
        friction=friction,
        force=picked(other.force, answer.force),
        resolved=answer.resolved & ~more,
        slip_bound=judgement.slip_bound,
        unbalanced_torque=judgement.largest_torque,
        lower_bound=judgement.lower_bound,
        gap=relative_gap(scene, answer.objective, judgement.lower_bound),
    )


def _fields(scene: Scene, method: Method, spec: FieldSpec) -> Fields:
    """The fields of a method, in blocks of the size that suits it."""
    return Fields(make_layout(scene.replicas, scene.lattice.shape, getattr(method, "block", CPU_BLOCK)), spec)


def _refuse_unlike(stored: Mapping[str, np.ndarray], fresh: Mapping[str, np.ndarray]) -> None:
    """ValueError for arrays of a checkpoint that cannot be the state of a method, which is `fresh` at the start."""
    for name, own in fresh.items():
        found, like = stored[name], np.asarray(own)
        if found.dtype.kind != like.dtype.kind or (like.dtype.kind == "f" and found.shape != like.shape):
            raise ValueError(f"{name} has {found.dtype} of shape {found.shape}, not {like.dtype} of {like.shape}")


class _Course:
    """The loop of :func:`solve` from the start, or from a checkpoint, to the end."""

    def __init__(
        self,
        scene: Scene,
        method: Method,
        stop: StopRule,
        recording: Recording,
        checkpoints: Checkpoints | None,
        interrupt: "_Interrupt",
    ) -> None:
        self.scene, self.method, self.stop, self.recording = scene, method, stop, recording
        self.checkpoints, self.interrupt = checkpoints, interrupt
        self.best, self.recorder, self.pace = _Best(scene, not is_dynamics(method)), Recorder(scene, recording), _Pace()
        self.target = 0  # iteration of the next look at the progress
        self.began = self.called = self.written_at = time.perf_counter()
        resume = checkpoints.resume if checkpoints else None
        if resume is not None and is_dynamics(method):
            try:
                _refuse_unlike(resume, method.state())
                method.restore(resume)
                self.recorder.restore(resume)
                self.best.restore(resume)
                self.began = time.perf_counter() - float(resume["elapsed"])
                looked = bool(resume["looked"])
            except (KeyError, ValueError, IndexError, TypeError, OverflowError) as error:
                raise FileError(f"the checkpoint is incomplete or of another scene: {error}") from None
            self.target = method.iteration
            if not looked:
                self._aim(method.iteration)

    @property
    def elapsed(self) -> float:
        """Seconds of wall time, those before a checkpoint included."""
        return time.perf_counter() - self.began

    @property
    def _seconds_of_this_call(self) -> float:
        return time.perf_counter() - self.called

    def follow(self, monitors: Sequence[Monitor]) -> tuple[Status, Progress, float]:
        """How it ended, the last state, and the seconds it took."""
        scene, method, stop, best = self.scene, self.method, self.stop, self.best
        iteration = method.iteration if is_dynamics(method) else 0
        while True:
            with suppress(GivenUp):
                self.pace.advance(method, self.target - iteration, self._is_ended, self._write_if_due)
            progress = method.progress()
            iteration = progress.iteration
            on_the_way = iteration < self.target
            if on_the_way:
                self._write(looked=False)  # before anything is recorded that an undisturbed run would not record
            best.take(progress)
            elapsed = self.elapsed
            self.recorder.take(progress, best.bound, elapsed)
            gap = relative_gap(scene, best.objective, best.bound)
            report = Report(progress, best.objective, gap, elapsed, stop)
            unwanted = [monitor(report) for monitor in monitors].count(True) > 0
            stalled = progress.exhausted or best.has_stalled(iteration, float(gap.max()))
            status = stop.judge(scene, progress, best.objective, best.bound, self._seconds_of_this_call, stalled)
            if status is None and (self.interrupt.heard or unwanted):
                status = Status.INTERRUPTED
            if status is not None:
                if not on_the_way:
                    self._write(looked=True)
                self.recorder.add_row(progress, best.bound, elapsed)
                return status, progress, elapsed
            self._write_if_due(looked=True)
            self._aim(iteration)

    def _aim(self, iteration: int) -> None:
        """Choose the iteration of the next look. It depends on the state of a dynamics only, not on earlier looks."""
        if is_dynamics(self.method):
            if self.method.time >= self.stop.duration:
                self.target = iteration
                return
            self.method.aim_at(min(self.recording.next_time(self.method.time), self.stop.duration))
        self.target = min(self.method.next_check(iteration), self.stop.iterations)

    def _is_ended(self) -> bool:
        return self.interrupt.heard or self._seconds_of_this_call >= self.stop.seconds

    def _write_if_due(self, looked: bool = False) -> None:
        if self.checkpoints is not None and time.perf_counter() - self.written_at >= self.checkpoints.every:
            self._write(looked)

    def _write(self, looked: bool) -> None:
        """Write a checkpoint. looked : this state has been recorded and judged."""
        if self.checkpoints is None or not is_dynamics(self.method):
            return
        own = {"elapsed": np.array(self.elapsed), "looked": np.array(looked)}
        self.checkpoints.write(self.method.state() | self.recorder.state() | self.best.state() | own)
        self.written_at = time.perf_counter()

    def answer(
        self, status: Status, iteration: int, seconds: float, compiled: float, threshold: float | None
    ) -> Solution:
        """What the best state and the best forces amount to.

        iteration, seconds : in all. compiled : seconds before the first. threshold : slip speed up to which a contact
        counts as slipless, or None for what the method can resolve.
        """
        scene, final = self.scene, replace(self.best.progress, iteration=iteration)
        spin, spin_rounding = scene.laboratory_pair(final.staggered, final.rest, final.spin_axes)
        proof = certifying_forces(scene, self.best.proof, final.spin_axes, self.best.bound)
        friction = laboratory_forces(proof, scene.lattice, final.spin_axes)
        judgement = _judged(scene, spin, spin_rounding, friction)
        slip = _slips(scene, final) if judgement is None else judgement.slip
        state, resolves = _told_apart(scene, slip, final, threshold)
        per_contact = tuple(scene.power_of(values, axis) for axis, values in enumerate(slip))
        objective, bound, residual = final.objective, self.best.bound, final.unbalanced_torque
        power = objective if scene.law.minimises == "power" else scene.total(per_contact)
        force = _acting(scene, final, slip) if is_dynamics(self.method) else _sizes(proof)
        if judgement is None:  # the bounds of a law that is not known to the verifier are the method's word
            bound = np.zeros_like(bound) if scene.law.name in LAWS else bound
        else:  # what the answer proves is what is reported
            power, objective, bound = judgement.power, judgement.objective, judgement.lower_bound
            residual = residual if is_dynamics(self.method) else judgement.largest_torque
            if scene.law.flows and scene.law.holds and threshold is None:  # unique slips, some of them proven
                state = _with_proven_slips(state, judgement)
        resolved = np.zeros(scene.replicas, dtype=bool)
        with suppress(GivenUp), self.interrupt.at_once(self.stop.seconds - self._seconds_of_this_call):
            resolved = _proven(scene, final, judgement, state)
        gap = relative_gap(scene, objective, bound)
        if status in (Status.CERTIFIED, Status.STALLED):
            status = Status.CERTIFIED if (gap <= self.stop.tolerance).all() else Status.STALLED
        return Solution(
            scene=scene,
            method=self.method.options.name,
            status=status,
            iterations=iteration,
            spin=spin,
            spin_rounding=spin_rounding,
            slip=slip,
            power_per_contact=per_contact,
            force=force,
            friction=friction,
            state=state,
            slip_bound=() if judgement is None else judgement.slip_bound,
            resolved=resolved,
            power=power,
            objective=objective,
            lower_bound=bound,
            gap=gap,
            slip_threshold=resolves,
            unbalanced_torque=residual,
            seconds=seconds,
            seconds_compile=compiled,
            history=self.recorder.history(),
            snapshots=self.recorder.snapshots(),
            findings=final.findings,
        )


class _Interrupt:
    """Hears Ctrl-C or a batch queue's SIGTERM without being torn out of a step.

    A second one ends the process, unless it comes so soon that the step cannot have ended.
    """

    def __init__(self) -> None:
        self.heard, self._first, self._at_once, self._too_late = False, 0.0, False, False
        self._context = handled(self._hear)

    def __enter__(self) -> "_Interrupt":
        self._context.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._context.__exit__(None, None, None)

    @contextmanager
    def at_once(self, seconds: float = math.inf) -> Iterator[None]:
        """What is inside ends with GivenUp where it is, by an interrupt or after so many seconds."""
        timer = threading.Timer(min(seconds, threading.TIMEOUT_MAX), self._end)
        try:
            if threading.current_thread() is threading.main_thread() and seconds < math.inf:
                timer.start()
            self._at_once = True
            if self.heard or not seconds > 0:
                raise GivenUp
            yield
        finally:
            self._at_once = False
            timer.cancel()
            if timer.ident is not None:
                timer.join()  # it is too late for the last time

    def _end(self) -> None:
        self._too_late = True
        _thread.interrupt_main()

    def _hear(self, _: int, frame: FrameType | None) -> None:
        if self._too_late:
            self._too_late = False
        elif not self.heard:
            self.heard, self._first = True, time.monotonic()
        elif time.monotonic() - self._first > IMPATIENCE:
            raise KeyboardInterrupt
        if self._at_once and not is_loading(frame):
            self._at_once = False
            raise GivenUp


class _Pace:
    """Splits the iterations between two checks into launches of about half a second."""

    def __init__(self) -> None:
        self.size = 64

    def advance(self, method: Method, steps: int, ended: Callable[[], bool], between: Callable[[], None]) -> None:
        while steps > 0 and not ended():
            now = min(self.size, steps)
            began = time.perf_counter()
            with while_wanted(ended):
                method.advance(now)
            steps -= now
            took = time.perf_counter() - began
            if took > 1.0:
                self.size = max(64, self.size // 2)
            elif took < 0.25 and now == self.size:
                self.size *= 2
            if steps > 0:
                between()


class _Best:
    """The state that counts, replica by replica, and the best lower bound seen.

    proof : forces (T, R, *contacts) an axis from which that bound follows.
    """

    def __init__(self, scene: Scene, keeps_best: bool) -> None:
        self.scene, self.keeps_best = scene, keeps_best
        self.progress: Progress
        self.proof: Forces = ()
        self.bound = np.zeros(0)  # none yet
        self._gap, self._improved_at = np.inf, 0

    @property
    def objective(self) -> np.ndarray:
        return self.progress.objective

    def has_stalled(self, iteration: int, gap: float) -> bool:
        """True if a minimisation has not brought the worst gap down by 1 % in the last four fifths of its iterations:
        the precision of the fields allows no more. A dynamics may linger as long as it likes."""
        if gap < 0.99 * self._gap:
            self._gap, self._improved_at = gap, iteration
        return self.keeps_best and iteration > max(STALL_PATIENCE, 5 * self._improved_at)

    def take(self, new: Progress) -> None:
        first = len(self.bound) == 0
        if first and self.proof:  # restored: what was proven before is proven anew
            self.bound = lower_bound(self.scene, self.proof, new.spin_axes)
        self._take_proof(new)
        self.bound = np.maximum(self.bound, new.lower_bound) if len(self.bound) else new.lower_bound
        if first or not self.keeps_best:
            self.progress = new
            return
        better = new.objective <= self.objective  # False for NaN, so a failed step never counts
        if new.settled is not None:  # settled contact states are worth more than the last digit
            better |= new.settled & (new.objective <= self.objective * (1 + 1e-11))
        self.progress = new.where(better, self.progress)

    def state(self) -> dict[str, np.ndarray]:
        """The forces that prove the bound, for a checkpoint; the bound itself is not believed."""
        return {f"proof_{axis}": force for axis, force in enumerate(self.proof)}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        lattice = self.scene.lattice
        self.proof = tuple(np.array(state[f"proof_{axis}"], dtype=float) for axis in range(lattice.dimension))
        for axis, force in enumerate(self.proof):
            if force.shape[1:] != (self.scene.replicas, *lattice.contact_shape(axis)) or not np.isfinite(force).all():
                raise ValueError(f"proof_{axis} holds something else than the forces of its contacts")

    def _take_proof(self, new: Progress) -> None:
        proof = new.force if new.proof is None else new.proof
        if len(self.bound) == 0:
            self.proof = proof
            return
        better = new.lower_bound >= self.bound
        if new.resolved is not None:  # forces that prove contact states are worth more than the last digit of the bound
            better |= new.resolved & (new.lower_bound >= self.bound * (1 - 1e-11))
        pick = better.reshape(1, -1, *(1,) * len(proof))
        self.proof = tuple(np.where(pick, a, b) for a, b in zip(proof, self.proof, strict=True))


def _told_apart(
    scene: Scene, slip: tuple[np.ndarray, ...], final: Progress, threshold: float | None
) -> tuple[tuple[np.ndarray, ...], float]:
    """Contact states, and the slip up to which contacts count as slipless: as asked for, or what can be resolved."""
    if threshold is not None:
        return _states(scene, slip, final, threshold, asked=True), threshold
    rounding = 1e-12 * scene.lattice.radius * scene.jump if final.slip is None else 0.0
    resolves = max(final.resolution, rounding)
    state = _states(scene, slip, final, resolves, asked=False)
    # a method that establishes the states has rounded its slips in another way
    return state, max(resolves, float(np.nanmax(separate(scene, slip, state).largest_slipless, initial=0.0)))


def _states(
    scene: Scene, slip: tuple[np.ndarray, ...], final: Progress, threshold: float, asked: bool
) -> tuple[np.ndarray, ...]:
    """Contact states by slip and friction, or as the method has established them; then slower ones count as slipless,
    and of faster ones none, only if a threshold was asked for."""
    if final.state is None:
        return classify(scene, slip, final.force, threshold)
    slipping, slipless, undecided = ContactState.SLIPPING, ContactState.SLIPLESS, ContactState.UNDECIDED
    found = []
    for axis, (state, speed) in enumerate(zip(final.state, slip, strict=True)):
        if asked:
            slow, fast = (state == slipping) & (speed <= threshold), (state == slipless) & (speed > threshold)
            state = np.where(slow, slipless, np.where(fast, undecided, state))
        found.append(np.where(scene.idle(axis), ContactState.DRIVEN, state).astype(np.uint8))
    return tuple(found)


def _slips(scene: Scene, final: Progress) -> tuple[np.ndarray, ...]:
    return scene.slips(final.staggered, final.spin_axes) if final.slip is None else final.slip


def _sizes(force: Forces) -> tuple[np.ndarray, ...]:
    return tuple(vector_length(values) for values in force)


def _acting(scene: Scene, final: Progress, slip: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Sizes of the forces in a dynamics at this moment: where contacts hold its own, else those of the law."""
    if scene.law.holds:
        return tuple(
            np.where(of == 0, 0.0, size) for of, size in zip(scene.coefficient, _sizes(final.force), strict=True)
        )
    return tuple(scene.law.force(of, speed) for of, speed in zip(scene.contact, slip, strict=True))


def _with_proven_slips(state: tuple[np.ndarray, ...], judgement: Judgement) -> tuple[np.ndarray, ...]:
    """States (R, *contacts) an axis, with all contacts slipping that are proven to slip at the minimum."""
    proven = [np.stack(of_axis) for of_axis in zip(*(found.proven for found in judgement.states), strict=True)]
    return tuple(
        np.where(slips == SLIPPING, ContactState.SLIPPING, values).astype(np.uint8)
        for slips, values in zip(proven, state, strict=True)
    )


def _judged(scene: Scene, spin: np.ndarray, spin_rounding: np.ndarray, friction: Forces) -> Judgement | None:
    """What the answer proves by itself, whatever the method believes; None for numbers that no arithmetic can judge."""
    samples = Samples(
        scene.lattice.shape, scene.law.name, scene.coefficient, scene.spin_top, scene.spin_bottom, scene.direction,
        scene.normal_force, scene.lattice.radius, spin, spin_rounding, friction,
        scene.named_coefficients.get("viscosity", ()),
    )  # fmt: skip
    return Judgement(samples) if samples.can_be_judged else None


def _proven(scene: Scene, final: Progress, judgement: Judgement | None, state: tuple[np.ndarray, ...]) -> np.ndarray:
    """True (R,) where the verifier proves that these are the states at every minimum.

    It is asked where the method believes so, and where one component makes that cheap.
    """
    one_component = scene.law.is_rate_independent and len(scene.minimum_spin_axes) == 1
    found = np.full(scene.replicas, one_component) if final.resolved is None else np.array(final.resolved)
    if judgement is None or not found.any():
        return np.zeros(scene.replicas, dtype=bool)
    together = one_component or bool(found.all())
    for replica in np.flatnonzero(found):
        states = judgement.states[replica] if together else judgement.one(int(replica)).states[0]
        found[replica] = states.agree([values[replica] for values in state])
    return found
