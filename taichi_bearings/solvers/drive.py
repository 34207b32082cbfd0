"""The loop that runs every method: it owns the clock, the history, the monitors, the checkpoints and the stopping.

`solve` prepares the method, follows its *course* (class `Course`: the loop from the start, or from a checkpoint, to the
end), and has the answer judged. Lattices are solved with all their samples in one course, and so are minima of
packings; otherwise each sample of a packing has a course of its own, and several courses make their steps together.

Words: a *look* is a point of the course at which the progress of the method is read and judged. Shapes: R samples
(replicas), N spheres, E contacts, C carried spin components.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taichi_bearings import leaving, runtime
from taichi_bearings.errors import DeviceError, FileError, InputError
from taichi_bearings.interrupts import GivenUp, Interrupt, keep, while_wanted
from taichi_bearings.proof.certificate import Forces, relative_gap
from taichi_bearings.scene import Bearing, Progress, Solution, Status
from taichi_bearings.solvers.contacts import Ended
from taichi_bearings.solvers.dynamics import Dynamics
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.recording import Recorder, Recording
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import stage


@dataclass(frozen=True)
class Report:
    """The progress of a run, as it is handed to monitors (functions that are called each time that the progress is
    read).

    progress : the state now.
    objective, gap : (R samples,), of the best state so far: what is minimised, energy/time, and its relative distance
        from the lower bound.
    seconds : wall time since the start; in a resumed run it includes the time before the checkpoint.
    stop : the rule that will end the run.
    """

    progress: Progress
    objective: np.ndarray
    gap: np.ndarray
    seconds: float
    stop: StopRule


Monitor = Callable[[Report], bool | None]
"""A function that is called with the `Report` of each look; if it returns True the run ends as if interrupted."""
# iterations before a minimisation can count as stalled; the gap over an earlier one below which it has fallen
STALL_PATIENCE, STALL_FALL = 20_000, 0.9


@dataclass(frozen=True)
class Checkpoints:
    """Where and how often a run is saved so that a later call can continue it; for methods that can resume.

    every : seconds of wall time between two checkpoints.
    write : function that is called with the arrays of a checkpoint by name.
    resume : the arrays that an earlier call has written and from which to continue; None for a new run.
    """

    every: float
    write: Callable[[dict[str, np.ndarray]], None]
    resume: Mapping[str, np.ndarray] | None = None

    def of_each(self, replicas: int) -> "list[Checkpoints]":
        """Return the checkpoints of each of the samples of a packing. All of them write into the same set of arrays.

        replicas : number of samples. If there are several, the names of a sample's arrays begin with its number and
            "/".
        """
        arrays = dict(self.resume or {})

        def of_sample(begin: str) -> Checkpoints:
            """Return the checkpoints of one sample.

            begin : the text with which the names of its arrays begin.
            """

            def write(state: Mapping[str, np.ndarray]) -> None:
                """Replace the arrays of this sample by `state`, and write those of all samples."""
                arrays.update({begin + name: values for name, values in state.items()})
                self.write(arrays)

            own = {name[len(begin) :]: values for name, values in arrays.items() if name.startswith(begin)}
            return replace(self, write=write, resume=own or None)

        return [self] if replicas == 1 else [of_sample(f"{replica}/") for replica in range(replicas)]


def solve(
    scene: Bearing,
    method: Method,
    spin: np.ndarray,
    stop: StopRule | None = None,
    monitors: Sequence[Monitor] = (),
    slip_threshold: float | None = None,
    recording: Recording | None = None,
    checkpoints: Checkpoints | None = None,
) -> Solution:
    """Run a method on a scene until the stopping rule ends it, and return the answer with all that is proven of it.

    scene : a lattice, or a packing, which takes no slip threshold.
    method : the method with its options, not yet begun.
    spin : (R samples, *N spheres, 3), of discs (R, *N), laboratory spins to start from, 1/time.
    stop : limits and tolerance at which to end; default `StopRule()`.
    monitors : functions that are called with a `Report` each time that the progress is read.
    slip_threshold : slip speed, length/time, up to which a contact counts as slipless. Default: the smallest slip that
        the method can resolve.
    recording : simulated times at which a dynamics is recorded.
    checkpoints : where a method that can resume saves its state.

    Ctrl-C ends the run with status INTERRUPTED and everything reached so far, unless the answer is reached already.
    Before the first step it raises KeyboardInterrupt. Ctrl-C and the limit on time also end the proof of the contact
    states. Raises InputError for a scene that the method cannot solve, DeviceError for a method that needs the CPU.
    """
    minimises_packing = not (scene.driving.samples_step_together or method.options.steps_packings)
    if not minimises_packing and (reason := method.options.refusal(scene)):
        raise InputError(reason)
    if method.options.cpu_only and runtime.current().is_gpu:
        raise DeviceError(f"{method.options.name} runs on the CPU only; use --arch cpu")
    asked = _Asked(stop or StopRule(), monitors, slip_threshold, recording or Recording())
    if scene.driving.samples_step_together or scene.replicas == 1 or minimises_packing:
        return _solved([_Sample(scene, method, spin, checkpoints)], asked)[0]
    return _solve_separately(scene, method, spin, checkpoints, asked)


@dataclass(frozen=True)
class _Asked:
    """What was asked of a solve, the same for all samples.

    stop : limits and tolerance at which to end.
    monitors : functions that are called with a `Report` each time that the progress is read.
    slip_threshold : slip speed, length/time, up to which a contact counts as slipless; None for the smallest slip that
        the method can resolve.
    recording : simulated times at which a dynamics is recorded.
    """

    stop: StopRule
    monitors: Sequence[Monitor]
    slip_threshold: float | None
    recording: Recording


@dataclass(frozen=True)
class _Sample:
    """What one loop solves: a lattice with all its samples, or one sample of a packing.

    scene : the lattice or the sample.
    method : the method that solves it, an object of its own.
    spin : (R samples, *N spheres, 3), of discs (R, *N), spins to start from, 1/time.
    checkpoints : where its state is saved, or None.
    """

    scene: Bearing
    method: Method
    spin: np.ndarray
    checkpoints: Checkpoints | None


def _solve_separately(
    scene: Bearing, method: Method, spin: np.ndarray, checkpoints: Checkpoints | None, asked: _Asked
) -> Solution:
    """Return one answer to all samples of a packing. Each sample is stepped by a method of its own, and its result has
    the same bits as if it were solved alone.

    As many samples are stepped at a time as fit the device. After Ctrl-C the answer has only the samples that were
    begun. If some are missing but can be continued from checkpoints, KeyboardInterrupt is raised instead.

    scene : the packing.
    method : the method, which is copied for each sample.
    spin : (R samples, N spheres, 3), of discs (R, N), spins to start from, 1/time.
    checkpoints : where the state is saved, or None.
    asked : limits, tolerance, monitors and times of recording that were asked for.
    """
    from taichi_bearings.solvers.together import samples_at_once  # and with it the lists of packings

    count, at_once, found, interrupted = scene.replicas, samples_at_once(scene), list[Solution](), False
    written = [None] * count if checkpoints is None else checkpoints.of_each(count)
    for first in range(0, count, at_once):
        numbers = range(first, min(first + at_once, count))
        some = [_Sample(scene.sample(n), copy(method), spin[[n]], written[n]) for n in numbers]
        try:
            with leaving.saving() if found else nullcontext():
                found += _solved(some, asked)
        except KeyboardInterrupt:
            if not found:
                raise
            interrupted = True
        if interrupted or found[-1].interrupted or found[-1].status is Status.INTERRUPTED:
            if len(found) < count and checkpoints is not None:
                raise KeyboardInterrupt
            interrupted = True
            break
    whole = Solution.joined(found, scene.first(len(found)))
    return replace(whole, interrupted=whole.interrupted or interrupted)


def _solved(samples: Sequence[_Sample], asked: _Asked) -> list[Solution]:
    """Return the answers to some samples that are stepped together.

    Each answer gets an equal share of the time of all.

    samples : the scenes, each with its method and its spins to start from.
    asked : limits, tolerance, monitors and times of recording that were asked for.
    """
    began, threshold = time.perf_counter(), asked.slip_threshold
    options = samples[0].method.options
    with Interrupt() as interrupt:
        with stage("preparing"), interrupt.at_once():
            for one in samples:
                one.method.tolerance = asked.stop.tolerance
                one.method.begin(one.scene, one.spin)
        if interrupt.heard:  # nothing is reached yet
            raise KeyboardInterrupt
        courses = [Course(one.method, asked.stop, asked.recording, one.checkpoints, interrupt) for one in samples]
        with leaving.saving():  # what is reached from here on
            seconds = sum(one.method.contacts.seconds_to_solve(options, asked.stop.tolerance) for one in samples)
            with stage("solving", seconds) as solving:
                _follow(courses, [solving.tell, *asked.monitors])
            with stage("proving", samples[0].method.contacts.seconds_to_prove):
                found = [course.answer(threshold) for course in courses]
            keep()
    running = runtime.current() if options.needs_taichi else runtime.HOST
    if options.cpu_only:  # such methods compute in doubles, whatever the precision of the runtime
        running = replace(running, precision="f64")
    share, heard, compiling = len(found), interrupt.heard, courses[0].called - began
    return [
        replace(one, interrupted=heard, running=running, seconds=one.seconds / share, seconds_compile=compiling / share)
        for one in found
    ]


def _follow(courses: Sequence["Course"], monitors: Sequence[Monitor]) -> None:
    """Run the loops of some samples to their ends. All of them make the same number of steps at a time: the least
    number that one of them wants before its progress is read.

    courses : the loops, one for each sample of a packing, or a single one for a lattice.
    monitors : functions that are called with a `Report` each time that the progress of a sample is read.
    """
    advance, drop = courses[0].method.advance, None
    if len(courses) > 1:
        from taichi_bearings.solvers.together import Together

        together = Together([course.method for course in courses])
        advance, drop = together.advance, together.drop
    # `left`: steps that each loop still wants before its progress is read; a loop without an entry has ended
    loops = [course.steps(monitors) for course in courses]
    left = {number: steps for number, loop in enumerate(loops) if (steps := next(loop, None)) is not None}
    while left:
        now = min(left.values())
        with suppress(GivenUp), while_wanted(courses[0].is_ended):
            advance(now)
            runtime.wait()  # else hours of steps could queue up on a GPU, which no limit would end
        for number, steps in list(left.items()):
            more = steps - now if steps > now else next(loops[number], None)
            if more is not None:
                left[number] = more
                continue
            del left[number]
            if drop is not None:
                drop(courses[number].method)


def uninterrupted(solution: Solution) -> Solution:
    """Return the solution; raise KeyboardInterrupt if Ctrl-C was pressed during its run, even if too late to end it."""
    if solution.interrupted:
        raise KeyboardInterrupt
    return solution


def _refuse_unlike(stored: Mapping[str, np.ndarray], fresh: Mapping[str, np.ndarray]) -> None:
    """Raise ValueError if arrays of a checkpoint have other types or shapes than the state of a method.

    stored : the arrays of the checkpoint, by name.
    fresh : the state of the method at the start, with the right types and shapes.
    """
    for name, own in fresh.items():
        if name not in stored:  # the method itself looks for what it needs
            continue
        found, like = stored[name], np.asarray(own)
        if found.dtype.kind != like.dtype.kind or (like.dtype.kind == "f" and found.shape != like.shape):
            raise ValueError(
                f"the array {name} is of type {found.dtype} and shape {found.shape}; it must be of type {like.dtype} "
                f"and shape {like.shape}"
            )


class Course:
    """The loop of :func:`solve` from the start, or from a checkpoint, to the end, for a lattice with all its samples or
    for one sample of a packing.

    It makes steps. From time to time it reads the progress of the method, records it, and judges whether to end.

    status : how it ended.
    last : the progress at the end.
    seconds : wall time that it took, that before a checkpoint included.
    findings : further results of the method at the end, by name, (R samples,) each.
    scene, method : what is solved, and the method that makes the steps.
    stop, recording : when it ends, and the simulated times at which a dynamics is recorded.
    checkpoints : where states are saved; None for nowhere.
    interrupt : tells whether Ctrl-C was pressed.
    target : iteration at which the progress is read next.
    had_ended : True for a minimisation whose checkpoint has the answer already: its process ended before the answer
        was written.
    launch : iterations that are made at a time, so many that they take about half a second.
    began : clock reading, seconds, from which wall time is counted: the start of this call less the wall time that was
        spent before the checkpoint.
    called, written_at : clock readings at the start of this call, and at the last checkpoint.
    best, recorder : the best state so far, and the history.
    """

    status: Status
    last: Progress
    seconds: float
    findings: Mapping[str, np.ndarray]

    def __init__(
        self,
        method: Method,
        stop: StopRule,
        recording: Recording,
        checkpoints: Checkpoints | None,
        interrupt: Interrupt,
    ) -> None:
        """Begin at the start, or where a checkpoint leaves off; raise FileError if that does not fit the method.

        method : one whose `begin` was called.
        stop : limits and tolerance at which to end.
        recording : simulated times at which a dynamics is recorded.
        checkpoints : where the state is saved, and from which to continue; None for none.
        interrupt : tells whether Ctrl-C was pressed.
        """
        self.scene, self.method, self.stop, self.recording = method.scene, method, stop, recording
        self.checkpoints, self.interrupt = checkpoints, interrupt
        self.best, self.recorder = _Best(method), Recorder(method.scene, recording)
        self.target, self.launch = 0, 64  # so few iterations take far less than a second
        self.had_ended = False
        self.began = self.called = self.written_at = time.perf_counter()
        if isinstance(method, Dynamics):
            method.end_at(self.stop.duration, checkpoints is not None)
        resume = checkpoints.resume if checkpoints else None
        if resume is not None and method.resumes:
            try:
                _refuse_unlike(resume, method.state())
                method.restore(resume)
                self.recorder.restore(resume)
                self.best.restore(resume, method.spin_axes)
                self.began = time.perf_counter() - float(resume["elapsed"])
                looked = bool(resume["looked"])
            except (KeyError, ValueError, IndexError, TypeError, OverflowError) as error:
                raise FileError(f"the checkpoint is incomplete or of another scene: {error}") from None
            self.target = method.iteration
            self.had_ended = self.best.keeps_best and bool(resume.get("ended", False))
            # a minimisation goes on, to the next look or to the target that it had; a dynamics that was written after
            # a look is looked at once more, before it goes on
            if isinstance(method, Dynamics) != looked:
                self._aim(method.iteration)
            elif not looked:
                self.target = int(resume["target"])

    @property
    def elapsed(self) -> float:
        """Seconds of wall time, those before a checkpoint included."""
        return time.perf_counter() - self.began

    @property
    def _seconds_of_this_call(self) -> float:
        """Seconds of wall time of this call alone."""
        return time.perf_counter() - self.called

    def steps(self, monitors: Sequence[Monitor]) -> Iterator[int]:
        """Yield how many steps the method has to make next, until the run is done.

        The caller makes these steps, then asks for the next number. Before that is given, the progress is read if it is
        due: it is recorded, reported to the monitors, and judged. At the end `status`, `last`, `seconds` and `findings`
        are set.

        monitors : functions that are called with a `Report`; the run ends if one returns True.
        """
        scene, method, stop, best = self.scene, self.method, self.stop, self.best
        iteration = method.iteration if method.resumes else 0
        if self.had_ended and self._ends_again():
            return
        while True:
            yield from self._launches(self.target - iteration)
            on_the_way = method.resumes and method.iteration < self.target
            if on_the_way:
                self._write(looked=False)  # ended early: resumed from here it has the bits of an undisturbed run
            # read, record and report the progress
            progress = method.progress()
            iteration = progress.iteration
            best.take(progress)
            elapsed = self.elapsed
            self.recorder.take(progress, best.bound, elapsed)
            gap = relative_gap(scene, best.objective, best.bound)
            report = Report(progress, best.objective, gap, elapsed, stop)
            unwanted = [monitor(report) for monitor in monitors].count(True) > 0
            # judge it
            stalled = progress.exhausted or best.has_stalled(iteration, float(gap.max()))
            status = stop.judge(scene, progress, best.objective, best.bound, self._seconds_of_this_call, stalled)
            if status is None and (self.interrupt.heard or unwanted):
                status = Status.INTERRUPTED
            if status is not None:
                if not on_the_way:
                    self._write(looked=True, ended=status in (Status.CERTIFIED, Status.STALLED))
                self._end(status, progress, elapsed)
                return
            self._write_if_due(looked=True)
            self._aim(iteration)

    def _end(self, status: Status, progress: Progress, elapsed: float) -> None:
        """Record the last state in the history, and set the attributes `status`, `last`, `seconds` and `findings`.

        status : how it ended.
        progress : the last state.
        elapsed : seconds of wall time.
        """
        self.recorder.add_row(progress, self.best.bound, elapsed)
        self.status, self.last, self.seconds = status, progress, elapsed
        method = self.method
        self.findings = method.findings(progress) if isinstance(method, Dynamics) else self.best.progress.findings

    def _ends_again(self) -> bool:
        """End the run and return True, if the best state of the checkpoint, which was the answer to an earlier call, is
        the answer to this one too. Its bound follows from its own forces, as some methods have others at each reading.
        """
        best, progress = self.best, self.method.progress()
        best.bound = self.method.proven_by(best.proof)
        gap = relative_gap(self.scene, best.objective, best.bound)
        stalled = progress.exhausted or best.has_stalled(progress.iteration, float(gap.max()))
        now = self._seconds_of_this_call
        status = self.stop.judge(self.scene, progress, best.objective, best.bound, now, stalled)
        if status is not None:
            self._end(status, progress, self.elapsed)
        return status is not None

    def _launches(self, steps: int) -> Iterator[int]:
        """Yield numbers of iterations that add up to `steps`, each about half a second of work; end early where the
        time is over.
        """
        runtime.refuse_changed()  # raises an error if a monitor has started another runtime
        while steps > 0 and not self.is_ended():
            now = min(self.launch, steps)
            began = time.perf_counter()
            yield now
            steps -= now
            took = time.perf_counter() - began
            if took > 1.0:
                self.launch = max(64, self.launch // 2)
            elif took < 0.25 and now == self.launch:
                self.launch *= 2
            if steps > 0:
                self._write_if_due()

    def _aim(self, iteration: int) -> None:
        """Set `target`, the iteration at which the progress is read next.

        For a dynamics it depends on its state alone, not on when the progress was read before. So a resumed run, which
        reads it at other iterations, has the same bits.

        iteration : the one at which it was read now.
        """
        if isinstance(self.method, Dynamics):
            if self.method.time >= self.stop.duration:
                self.target = iteration
                return
            self.method.aim_at(min(self.recording.next_time(self.method.time), self.stop.duration))
        self.target = min(self.method.next_check(iteration), self.stop.iterations)

    def is_ended(self) -> bool:
        """Return True if Ctrl-C was pressed, or the time is over."""
        return self.interrupt.heard or self._seconds_of_this_call >= self.stop.seconds

    def _while_wanted(self) -> AbstractContextManager[None]:
        """Return a context whose work ends with GivenUp by Ctrl-C, or when the time is over."""
        return self.interrupt.at_once(self.stop.seconds - self._seconds_of_this_call)

    def _write_if_due(self, looked: bool = False) -> None:
        """Write a checkpoint if the last one is older than the time between checkpoints.

        looked : True if the present state was recorded and judged already.
        """
        if self.checkpoints is not None and time.perf_counter() - self.written_at >= self.checkpoints.every:
            self._write(looked)

    def _write(self, looked: bool, ended: bool = False) -> None:
        """Write a checkpoint, if the method can resume and checkpoints are wanted.

        looked : True if the present state was recorded and judged already.
        ended : True if it was judged to be the answer, so that a resumed run has to look at it once more.
        """
        if self.checkpoints is None or not self.method.resumes:
            return
        own = {"elapsed": np.array(self.elapsed), "looked": np.array(looked), "target": np.array(self.target)}
        own["ended"] = np.array(ended)
        self.checkpoints.write(self.method.state() | self.recorder.state() | self.best.state() | own)
        self.written_at = time.perf_counter()

    def answer(self, threshold: float | None) -> Solution:
        """Return the answer from the best spins and the best forces, with its proof, history, snapshots and status.

        threshold : slip speed up to which a contact counts as slipless, length/time; None for the slip that the method
            can resolve.
        """
        self.method.give_back()
        found = self.method.contacts.answered(self._ended(threshold))
        return replace(
            found,
            seconds=self.seconds,
            history=self.recorder.history(),
            snapshots=self.recorder.snapshots(),
            findings={**found.findings, **self.findings},
        )

    def _ended(self, threshold: float | None) -> Ended:
        """Return how the run ended. The attributes `last` and `best` are deleted, as their forces take much memory.

        threshold : slip speed up to which a contact counts as slipless, length/time; None for the slip that the method
            can resolve.
        """
        last, best, method = self.last, self.best, self.method
        del self.last, self.best
        final = replace(best.progress, ended=last.ended, findings=self.findings, proof=None)
        return Ended(
            self.status, final, best.bound, best.proof, last.iteration, self.stop, method.options, threshold,
            method.found, self._while_wanted,
        )  # fmt: skip


OF_BEST = (
    "iteration", "staggered", "force", "objective", "lower_bound", "resolution", "largest_balance_residual", "rest",
    "state", "slip", "settled", "states_believed", "ended",
)  # fmt: skip
"""Entries of the best `Progress` of a minimisation that a checkpoint keeps."""


class _Best:
    """The best state so far, and the best lower bound so far, chosen for each sample on its own.

    progress : for a minimisation the states of least objective reached so far; for a dynamics the state now.
    bound : (R samples,), the best lower bound on the objective, energy/time.
    proof : (C components, R, E contacts), contact forces from which that bound follows.
    keeps_best : True for a minimisation.
    """

    def __init__(self, method: Method) -> None:
        """Begin without any state, and with empty forces and bounds.

        method : the one whose states will be compared.
        """
        self.scene, self.method, self.keeps_best = method.scene, method, not isinstance(method, Dynamics)
        self.progress: Progress
        self.proof: Forces = np.zeros(0)  # none yet
        self.bound = np.zeros(0)  # none yet
        self._gap, self._improved_at = np.inf, 0  # the least gap that counted as progress, and its iteration

    @property
    def objective(self) -> np.ndarray:
        """(R samples,), the objective of the best state, energy/time: its power, or its potential for laws whose
        stationary state minimises that.
        """
        return self.progress.objective

    def has_stalled(self, iteration: int, gap: float) -> bool:
        """Return True if a minimisation has not reduced its gap by a tenth in the last four fifths of its iterations.
        Then the precision of its numbers allows no more: the gap of the slowest method falls as 1 / sqrt(iteration), to
        less than half in that time. Smaller falls do not count, as rounding alone brings them about again and again.

        A dynamics never counts as stalled, as it may take long to load its springs.

        iteration : number of the iteration now.
        gap : the largest relative gap of all samples now.
        """
        if gap < STALL_FALL * self._gap:
            self._gap, self._improved_at = gap, iteration
        return self.keeps_best and iteration > max(STALL_PATIENCE, 5 * self._improved_at)

    def take(self, new: Progress) -> None:
        """Compare a new state of the method with the best so far, and store what is better, sample by sample: its lower
        bound with the forces that prove it, and its spins if its objective is less.

        new : the progress of the method.
        """
        first, proof = len(self.bound) == 0, new.force if new.proof is None else new.proof
        if first and self.proof.size:  # restored: what was proven before is proven anew
            self.bound = self.method.proven_by(self.proof)
        elif first:
            self.proof, self.bound = proof, new.lower_bound
        better = new.lower_bound >= self.bound
        if new.states_believed is not None:  # forces that prove states are worth more than the last digit of the bound
            better |= new.states_believed & (new.lower_bound >= self.bound * (1 - 1e-11))
        if better.all():
            self.proof = proof  # whole arrays of forces are not copied
        elif better.any():
            self.proof = np.where(better[:, None], proof, self.proof)
        self.bound = np.where(better, new.lower_bound, self.bound)  # what these forces prove, and no more
        if "progress" not in vars(self) or not self.keeps_best:
            self.progress = new
            return
        better = new.objective <= self.objective  # False for NaN, so a failed step never counts
        if new.settled is not None:  # settled contact states are worth more than the last digit
            better |= new.settled & (new.objective <= self.objective * (1 + 1e-11))
        self.progress = new.where(better, self.progress)

    def state(self) -> dict[str, np.ndarray]:
        """Return by name what a checkpoint needs: the forces that prove the bound and, for a minimisation, the best
        state. The bound itself is computed anew from the forces.
        """
        found = {"proof": self.proof}
        if self.keeps_best and "progress" in vars(self):
            best = {n: np.asarray(v) for n in OF_BEST if (v := getattr(self.progress, n)) is not None}
            found |= {f"best/{n}": v.astype(np.uint8) if v.dtype == bool else v for n, v in best.items()}
            found |= {f"best/findings/{name}": values for name, values in self.progress.findings.items()}
            found["course"] = np.array([self._gap, self._improved_at], dtype=float)
        return found

    def restore(self, state: Mapping[str, np.ndarray], spin_axes: tuple[int, ...]) -> None:
        """Take the best forces and the best state from a checkpoint; raise ValueError if they do not fit the scene.

        state : arrays by name, as :meth:`state` returned them in an earlier call.
        spin_axes : numbers of the axes of the spin components that are computed.
        """
        # the forces that prove the bound
        self.proof = np.array(state["proof"], dtype=float)
        still = np.zeros((len(spin_axes), self.scene.replicas, *self.scene.network.shape))
        if self.proof.shape != self.method.differences(still).shape or not np.isfinite(self.proof).all():
            raise ValueError(
                "the contact forces (array `proof`) must be one finite number for each contact and component of this "
                "scene"
            )
        if not self.keeps_best or "best/staggered" not in state:
            return
        # the best state, refused if an array has another shape or is not finite
        best: dict[str, Any] = {name: np.array(state[f"best/{name}"]) for name in OF_BEST if f"best/{name}" in state}
        begin = "best/findings/"
        findings = {n[len(begin) :]: np.array(values) for n, values in state.items() if n.startswith(begin)}
        each, whole = (self.scene.replicas,), ("objective", "lower_bound", "largest_balance_residual")
        for name, of_scene in (
            ("staggered", still.shape),
            ("force", self.proof.shape),
            *((name, each) for name in whole),
        ):
            if best[name].shape != of_scene:
                raise ValueError(
                    f"the array `{name}` of the best state has the shape {best[name].shape}; this scene has {of_scene}"
                )
            if not np.isfinite(best[name]).all():
                raise ValueError(
                    f"the array `{name}` of the best state holds a number that is infinite or not a number"
                )
        best |= {name: best[name].astype(bool) for name in ("settled", "states_believed") if name in best}
        best["iteration"] = int(best["iteration"])
        self.progress = Progress(spin_axes=spin_axes, findings=findings, **best)
        gap, improved_at = state["course"].tolist()
        self._gap, self._improved_at = gap, int(improved_at)
