"""The benchmark of speed: which parts, of which sizes, in which processes; what is missing on this machine."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from math import prod
from multiprocessing.connection import Connection
from typing import Any

from taichi_bearings import runtime
from taichi_bearings.errors import BearingsError, InputError
from taichi_bearings.interrupts import unheard_by_children
from taichi_bearings.options import chosen
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.stages import each, stage

from . import dynamics, kernels, machine, methods, scans
from .baselines import find_compiler
from .peers import find_peers
from .timing import PARTS, Row

Shape = tuple[int, ...]
LARGE = 2.0**18  # bytes: the largest stream beside small lattices


@dataclass(frozen=True)
class Budget:
    """How much is measured. minutes : that it takes about, on two cores. shapes : of the kernels.

    solved : lattices that every method solves, each for at most `seconds`. scanned : lattice -> samples of a round.
    moved : lattices of the dynamics; `steps` of each code in each round. slice_seconds : of a call that is timed.
    """

    minutes: float
    shapes: tuple[Shape, ...]
    precisions: tuple[str, ...]
    solved: tuple[Shape, ...]
    laws: tuple[str, ...]
    seconds: float
    scanned: dict[Shape, int]
    moved: tuple[Shape, ...]
    steps: int
    rounds: int
    slice_seconds: float
    largest_stream: float


QUICK = Budget(
    minutes=2,
    shapes=((8, 8, 8), (16, 16, 16), (32, 32, 32), (32, 32), (256, 256)),
    precisions=("f64",),
    solved=((32, 32), (8, 8, 8)),
    laws=("coulomb",),
    seconds=1.0,
    scanned={(10, 10, 10): 24},
    moved=((16, 16, 16),),
    steps=50,
    rounds=3,
    slice_seconds=0.01,
    largest_stream=2**28,
)
USUAL = replace(
    QUICK,
    minutes=10,
    shapes=(*((n, n, n) for n in (8, 16, 32, 64)), *((n, n) for n in (32, 128, 512, 1024))),
    precisions=("f64", "f32"),
    solved=((32, 32), (10, 10, 10), (16, 16, 16)),
    laws=("coulomb", "viscous"),
    seconds=5.0,
    scanned={(10, 10, 10): 96, (16, 16, 16): 32},
    moved=((32, 32, 32),),
    rounds=5,
    slice_seconds=0.02,
)
FULL = replace(
    USUAL,
    minutes=60,
    shapes=(*((n, n, n) for n in (8, 12, 16, 24, 32, 48, 64, 96, 128)), *((2**k, 2**k) for k in range(5, 13))),
    solved=((32, 32), (256, 256), *((n, n, n) for n in (8, 10, 16, 24, 32))),
    seconds=60.0,
    scanned={(10, 10, 10): 192, (16, 16, 16): 96},
    steps=100,
    rounds=7,
    slice_seconds=0.05,
    largest_stream=2**30,
)
BUDGETS = {"quick": QUICK, "usual": USUAL, "full": FULL}


def only(budget: Budget, shapes: Sequence[str], precision: str | None) -> Budget:
    """The budget with these lattices in every part, if there are any, and this precision. InputError for bad ones."""
    if precision is not None:
        budget = replace(budget, precisions=(RunSettings(precision=precision).precision,))
    if not shapes:
        return budget
    found = tuple(RunSettings(shape=shape).shape for shape in shapes)
    scanned = {shape: budget.scanned.get(shape, min(budget.scanned.values())) for shape in found}
    moved = tuple(shape for shape in found if len(shape) == 3)
    largest = max(LARGE, 2.0**9 * max(prod(shape) for shape in found))
    streams = min(budget.largest_stream, largest)
    return replace(budget, shapes=found, solved=found, scanned=scanned, moved=moved, largest_stream=streams)


@dataclass
class Report:
    """What was measured. notes : what was left out and why. missing : peer -> why, with how to install it."""

    machine: dict[str, Any]
    rows: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)
    interrupted: bool = False

    def take(self, found: Row | str) -> None:
        if isinstance(found, str):
            self.notes += [] if found in self.notes else [found]
        else:
            self.rows.append(found)

    def of(self, part: str) -> list[Row]:
        return [row for row in self.rows if row.part == part]


def chosen_parts(names: str | None) -> tuple[str, ...]:
    """Parts by their names, separated by commas; all of them for None."""
    return chosen("parts", names, PARTS)


def chosen_threads(text: str | None, budget: Budget) -> tuple[int, ...]:
    """Thread counts, separated by commas; for None one and all, and those in between in doubles if there is time.

    InputError for others than this process may use.
    """
    most = runtime.available_threads()
    between = {2**k for k in range(most.bit_length())} if budget is FULL else set()
    try:
        counts = {int(word) for word in text.split(",")} if text is not None else {1, most} | between
    except ValueError:
        raise InputError(f"threads is {text!r}; it must be whole numbers such as 1,2") from None
    if not all(1 <= number <= most for number in counts):
        raise InputError(f"threads is {text!r}; this process may use 1 to {most}")
    return tuple(sorted(counts))


def measure(budget: Budget, parts: Sequence[str], threads: Sequence[int]) -> Report:
    """All that is asked for; Ctrl-C ends it and keeps what was measured until then."""
    report = Report(machine.describe(), missing=_missing(parts, threads))
    try:
        for name, rows in each(list(_work(budget, parts, threads)), "measuring, part"):
            with stage(name):
                try:
                    for found in rows():
                        report.take(found)
                except BearingsError as error:
                    report.take(f"{name} is left out: {error}")
    except KeyboardInterrupt:
        report.interrupted = True
    return report


Rows = Callable[[], Iterator[Row | str]]


def _work(budget: Budget, parts: Sequence[str], threads: Sequence[int]) -> Iterator[tuple[str, Rows]]:
    """What is to be done, by name, each in processes of its own: the compiler's runtime is one a process."""
    for precision in budget.precisions:
        for number in threads:
            if not {"memory", "kernels"}.isdisjoint(parts):
                shapes = budget.shapes if "kernels" in parts else ()
                largest = budget.largest_stream if "memory" in parts else 0
                task = kernels.Task(shapes, precision, number, budget.rounds, budget.slice_seconds, largest)
                yield f"kernels, {precision}, threads {number}", partial(elsewhere, kernels.measure, task)
    most = max(threads)
    if "methods" in parts:
        solves = methods.Task(budget.solved, budget.laws, most, budget.rounds, budget.seconds)
        yield "methods", partial(elsewhere, methods.measure, solves)
    if "scans" in parts:
        for shape, samples in budget.scanned.items():
            name = f"scans of {'x'.join(map(str, shape))}"
            yield (
                name,
                partial(scans.measure, shape, samples, min(3, budget.rounds), min(2, runtime.available_threads())),
            )
    if "dynamics" in parts:
        for shape, number in product(budget.moved, threads):
            steps = dynamics.Task(shape, number, budget.rounds, budget.steps)
            yield f"dynamics, threads {number}", partial(elsewhere, dynamics.measure, steps)


def _missing(parts: Sequence[str], threads: Sequence[int]) -> dict[str, str]:
    found = {}
    if "kernels" in parts and find_compiler() is None:
        found["C sweep"] = "no C compiler was found; apt install gcc, or set CC"
    if not {"methods", "scans"}.isdisjoint(parts):
        found |= find_peers()[1]
    if "dynamics" in parts:
        found |= dynamics.missing(max(threads))
    return found


def elsewhere(measure: Callable[[Any], Iterator[Row | str]], task: Any) -> Iterator[Row | str]:
    """What `measure` yields of a task in a process of its own, as it comes."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with unheard_by_children():
        process = context.Process(target=_serve, args=(theirs, measure, task))
        process.start()
    theirs.close()
    try:
        while (found := ours.recv()) is not None:
            if isinstance(found, BearingsError):
                raise found
            yield found
    except EOFError:
        raise BearingsError("the process that measured ended without a result") from None
    finally:
        process.kill()


def _serve(pipe: Connection, measure: Callable[[Any], Iterator[Row | str]], task: Any) -> None:
    """In that process."""
    try:
        for found in measure(task):
            pipe.send(found)
    except BearingsError as error:
        pipe.send(error)
    pipe.send(None)
