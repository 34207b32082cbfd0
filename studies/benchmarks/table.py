"""The table of benchmarks: what `bearings benchmark` can measure, and how much of it in its quick, usual and full
form.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

from taichi_bearings import runtime
from taichi_bearings.errors import InputError
from taichi_bearings.options import COUNT, chosen
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.solvers import METHODS

from . import dynamics, growth, kernels, methods, scans, start
from .baselines import find_compiler
from .harness import Benchmark, Measurements, Plan, elsewhere
from .peers import find_peers

SMALL = (((32, 32), "coulomb"), ((8, 8, 8), "coulomb"), ((32, 32), "viscous"))
SCENES = (
    ((10, 10), "coulomb"), ((32, 32), "coulomb"), ((10, 10, 10), "coulomb"), ((16, 16, 16), "coulomb"),
    ((32, 32), "viscous"), ((10, 10, 10), "viscous"),
)  # fmt: skip
LARGE = (((256, 256), "coulomb"), ((24, 24, 24), "coulomb"), ((32, 32, 32), "coulomb"), ((32, 32, 32), "viscous"))
QUICK = Plan(
    shapes=((8, 8, 8), (16, 16, 16), (32, 32, 32), (32, 32), (256, 256)), scenes=SMALL, scanned={(10, 10, 10): 24},
    moved=((16, 16, 16),), grown=(8, 12, 16, 20, 24), rounds=3, seconds=1.0, slice_seconds=0.01,
)  # fmt: skip
USUAL = Plan(
    shapes=(*((n, n, n) for n in (8, 16, 32, 64)), *((n, n) for n in (32, 128, 512, 1024))), scenes=SCENES,
    scanned={(10, 10, 10): 96, (16, 16, 16): 32}, moved=((32, 32, 32),), grown=(8, 12, 16, 20, 24, 32), rounds=5,
    seconds=10.0, slice_seconds=0.02,
    precisions=("f64", "f32"),
)  # fmt: skip
FULL = Plan(
    shapes=(*((n, n, n) for n in (8, 12, 16, 24, 32, 48, 64, 96, 128)), *((2**k, 2**k) for k in range(5, 13))),
    scenes=(*SCENES, *LARGE), scanned={(10, 10, 10): 192, (16, 16, 16): 96}, moved=((32, 32, 32),),
    grown=(8, 12, 16, 20, 24, 32, 40, 48, 64), rounds=7,
    seconds=60.0, slice_seconds=0.05, precisions=("f64", "f32"), steps=100,
)  # fmt: skip
PLANS = {"quick": QUICK, "usual": USUAL, "full": FULL}


def _kernels(plan: Plan) -> Iterator[tuple[str, Callable[[], Measurements]]]:
    """Yield the parts of the benchmark of kernels: for each precision and number of threads in the plan a name and a
    function that yields its rows.
    """
    for precision, threads in product(plan.precisions, plan.threads):
        yield f"{precision}, threads {threads}", partial(elsewhere, kernels.measure, plan, precision, threads)


def _methods(plan: Plan) -> Iterator[tuple[str, Callable[[], Measurements]]]:
    """Yield the parts of the benchmark of methods: for each scene of the plan a name and a function that yields its
    rows.
    """
    for shape, law in plan.scenes:
        settings = RunSettings(shape=shape, law=law, seed=plan.seed, time_limit=plan.seconds, threads=max(plan.threads))
        what = (methods.measure, settings, plan.methods, plan.peers, plan.rounds)
        yield f"of {'x'.join(map(str, shape))} {law}", partial(elsewhere, *what)


def _scans(plan: Plan) -> Iterator[tuple[str, Callable[[], Measurements]]]:
    """Yield the parts of the benchmark of scans: for each lattice of the plan a name and a function that yields its
    rows.
    """
    workers = min(2, runtime.available_threads())
    for shape, samples in plan.scanned.items():
        yield f"of {'x'.join(map(str, shape))}", partial(scans.measure, shape, samples, min(3, plan.rounds), workers)


def _start(plan: Plan) -> Iterator[tuple[str, Callable[[], Measurements]]]:
    """Yield the one part of the benchmark of how long commands take to start: a name, and a function of its rows."""
    yield "of commands", partial(start.measure, min(5, plan.rounds))


def _dynamics(plan: Plan) -> Iterator[tuple[str, Callable[[], Measurements]]]:
    """Yield the parts of the benchmark of dynamics: for each lattice of the plan a name and a function that yields its
    rows.
    """
    for shape in plan.moved:
        yield f"of {'x'.join(map(str, shape))}", partial(elsewhere, dynamics.measure, shape, plan.rounds, plan.steps)


def _growth(plan: Plan) -> Iterator[tuple[str, Callable[[], Measurements]]]:
    """Yield the parts of the benchmark of growth: for each lattice of the plan, small ones first, and each program a
    name and a function that yields its row.
    """
    clarabel = plan.peers and any(peer.name == "clarabel" for peer in find_peers()[0])
    for side, program in product(plan.grown, (growth.OURS, growth.THEIRS)[: 1 + clarabel]):
        what = (growth.measure, side, program, plan.seed, max(plan.threads))
        yield f"{side}x{side}x{side}, {program}", partial(elsewhere, *what)


BENCHMARKS = {
    "kernels": Benchmark(
        "Sweeps, steps and iterations beside NumPy and plain C",
        _kernels,
        missing=lambda: {} if find_compiler() else {"C sweep": "no C compiler was found; apt install gcc, or set CC"},
        figure=kernels.draw_throughput,
    ),
    "methods": Benchmark(
        "Run time against error: time to prove each relative gap, beside conic solvers",
        _methods,
        missing=lambda: find_peers()[1],
        faults=methods.contradictions,
        figure=methods.draw_accuracy,
    ),
    "scans": Benchmark(
        "Samples a second, beside Clarabel",
        _scans,
        missing=lambda: {name: why for name, why in find_peers()[1].items() if name == "clarabel"},
    ),
    "growth": Benchmark(
        "Times and memory of a proven minimum against the size of the cube, beside Clarabel",
        _growth,
        missing=lambda: {name: why for name, why in find_peers()[1].items() if name == "clarabel"},
        findings=growth.words,
        figure=growth.draw_growth,
    ),
    "start": Benchmark("Whole commands that solve a sample of 36 spheres, beside the start of the compiler", _start),
    "dynamics": Benchmark("Time steps on one processor, beside LAMMPS and YADE", _dynamics, missing=dynamics.missing),
}


def planned(
    budget: str | None,
    shape: Sequence[str] = (),
    law: Sequence[str] = (),
    threads: str | None = None,
    precision: str | None = None,
    largest: str | None = None,
    **of_methods: Any,
) -> Plan:
    """Return a plan of what the options of the command ask for. Raises InputError for a bad value.

    budget : "quick", "full" or None for the usual extent.
    shape, law : texts of lattices and names of laws that replace the usual ones; empty to keep these.
    threads : numbers of threads, separated by commas; None for the usual ones.
    precision : "f64" or "f32"; None for the usual ones.
    largest : spheres along an edge of the largest cube of `growth`; None for the usual one.
    of_methods : `seed`, `methods`, `peers` and `time_limit` of the benchmark of methods; None for the defaults.
    """
    plan = PLANS[budget or "usual"]
    if largest is not None:
        side = COUNT.named("largest", largest)
        plan = replace(plan, grown=tuple(sorted({*(one for one in FULL.grown if one < side), side})))
    if precision is not None:
        plan = replace(plan, precisions=(RunSettings(precision=precision).precision,))
    laws = [RunSettings(law=name).law for name in law]
    scenes = tuple(scene for scene in plan.scenes if scene[1] in (laws or ("coulomb", "viscous")))
    # lattices that the user names replace those of all benchmarks that can take them
    if shape:
        found = tuple(RunSettings(shape=text).shape for text in shape)
        scenes = tuple((one, name) for name in laws or ("coulomb",) for one in found)
        scanned = {one: plan.scanned.get(one, min(plan.scanned.values())) for one in found}
        cubes = tuple(one[0] for one in found if len(one) == 3 and len({*one}) == 1)
        moved = tuple(one for one in found if len(one) == 3)
        plan = replace(plan, shapes=found, scanned=scanned, moved=moved, grown=cubes)
    settings = RunSettings(**{key: of_methods[key] for key in ("seed", "time_limit") if of_methods.get(key)})
    return replace(
        plan,
        scenes=scenes,
        seed=settings.seed,
        seconds=settings.time_limit or plan.seconds,
        methods=chosen("methods", of_methods.get("methods"), METHODS),
        peers=bool(of_methods.get("peers", True)),
        threads=chosen_threads(threads, budget == "full"),
    )


def chosen_threads(text: str | None, full: bool) -> tuple[int, ...]:
    """Return numbers of threads, rising.

    text : such numbers separated by commas; None for 1 and all threads that this process may use.
    full : with no text, take the powers of two between them, too.

    Raises InputError for what is no number, or more than this process may use.
    """
    most = runtime.available_threads()
    between = {2**k for k in range(most.bit_length())} if full else set()
    try:
        counts = {int(word) for word in text.split(",")} if text is not None else {1, most} | between
    except ValueError:
        raise InputError(f"threads is {text!r}; it must be whole numbers such as 1,2") from None
    if not all(1 <= number <= most for number in counts):
        raise InputError(f"threads is {text!r}; this process may use 1 to {most}")
    return tuple(sorted(counts))
