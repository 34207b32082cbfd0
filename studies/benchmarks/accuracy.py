"""Run time against error: every method, and general conic solvers, on the same scenes and by the same ruler.

Each method runs once on each scene, as far as it gets within the time limit; its checks are the points of its curve.
A conic solver gives no checks that the certificate could judge, so it runs once for each tolerance asked for.

* The time is wall time with the set-up of the scene and without compilation: each method first makes a step or two on
  the scene, which compiles its kernels, and then starts afresh. What the first start took longer is its compile time.
* The least power is known to lie between the best lower bound and the best power of all runs; the reference is that
  bound, and the width of the interval is the reference's own gap. (power - reference) / power is thus an upper bound of
  the true error: it never falls below the gap of the reference, and says no more than that where it comes near it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.errors import InputError
from taichi_bearings.options import chosen
from taichi_bearings.proof.certificate import relative_gap
from taichi_bearings.runs.run import build_scene
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve, uninterrupted
from taichi_bearings.solvers.stopping import UNLIMITED, StopRule
from taichi_bearings.stages import each, stage

from .conic import conic_programme
from .peers import TOLERANCES, Peer

TIGHTEST = 1e-14  # asked of every method; rounding ends it earlier
SLACK = 1e-13  # relative rounding of a power; a bound that is higher than a power by more is wrong
ROUND_OFF = float(np.finfo(np.float64).eps)  # the least relative error that double precision can tell
DEFAULT_SCENES = (
    ((10, 10), "coulomb"), ((32, 32), "coulomb"), ((10, 10, 10), "coulomb"), ((16, 16, 16), "coulomb"),
    ((32, 32), "viscous"), ((10, 10, 10), "viscous"),
)  # fmt: skip


@dataclass(frozen=True)
class Entry:
    """One method on one scene. The arrays and lists have one item a checkpoint; power is what the method would return,
    or the potential where the law minimises that.

    settings, statuses : text; a method has one of each, repeated, a peer one for each tolerance.
    """

    method: str
    variant: str
    settings: list[str]
    seconds: np.ndarray
    seconds_compile: float
    power: np.ndarray
    lower_bound: np.ndarray
    iterations: np.ndarray
    statuses: list[str]

    @property
    def name(self) -> str:
        return f"{self.method} ({self.variant})" if self.variant else self.method


@dataclass
class SceneResult:
    """All entries of one scene, and why some methods have none."""

    scene: Scene
    entries: list[Entry] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)

    @property
    def label(self) -> str:
        return f"{'x'.join(map(str, self.scene.lattice.shape))} {self.scene.law}"

    @property
    def reference(self) -> float:
        """The best lower bound of all entries, energy/time."""
        return max(float(entry.lower_bound.max()) for entry in self.entries)

    @property
    def reference_gap(self) -> float:
        """(best power - best lower bound) / best power of all entries: what the reference leaves open."""
        return float(self.errors(np.array([min(float(entry.power.min()) for entry in self.entries)]))[0])

    def errors(self, power: np.ndarray) -> np.ndarray:
        """Upper bounds of (power - least power) / power."""
        return self._relative(power, np.full_like(power, self.reference))

    def gaps(self, entry: Entry) -> np.ndarray:
        """(power - lower bound) / power of each checkpoint, by its own bound alone."""
        return self._relative(entry.power, entry.lower_bound)

    def _relative(self, power: np.ndarray, bound: np.ndarray) -> np.ndarray:
        return np.maximum(relative_gap(self.scene, power, bound), ROUND_OFF)

    def seconds_to(self, entry: Entry, gap: float) -> float | None:
        """Least time in which the entry proved `gap`; None if it never did."""
        reached = entry.seconds[self.gaps(entry) <= gap]
        return float(reached.min()) if len(reached) else None

    def best(self, entry: Entry) -> int:
        """The checkpoint with the smallest proven gap."""
        return int(np.argmin(self.gaps(entry)))

    def contradictions(self) -> list[str]:
        """Entries that prove a bound above the power of another one: a bug in one of them."""
        least = min(self.entries, key=lambda entry: entry.power.min())
        power, bounds = float(least.power.min()), [float(entry.lower_bound.max()) for entry in self.entries]
        return [
            f"{self.label}: {entry.name} proves {bound!r}, {least.name} has {power!r}"
            for entry, bound in zip(self.entries, bounds, strict=True)
            if bound > power * (1 + SLACK)
        ]


def choose_scenes(shapes: Sequence[str], laws: Sequence[str], **others: Any) -> list[RunSettings]:
    """Settings of the scenes to run: every shape with every law (Coulomb if none is named).

    Without a shape, the DEFAULT_SCENES of these laws. others : the settings that all of them share.
    """
    if shapes:
        named: list[tuple[Any, str]] = [(shape, law) for law in laws or ("coulomb",) for shape in shapes]
    else:
        wanted = [RunSettings(law=law).law for law in laws or ("coulomb", "viscous")]
        named = [(shape, law) for shape, law in DEFAULT_SCENES if law in wanted]
    return [RunSettings(shape=shape, law=law, **others) for shape, law in named]


def choose_methods(names: str | None) -> tuple[str, ...]:
    """Methods by their names in METHODS, separated by commas; all of them for None."""
    return chosen("methods", names, METHODS)


def measure_all(
    scenes: Sequence[RunSettings],
    methods: Sequence[str],
    peers: Sequence[Peer],
    say: Callable[[str], None] = lambda line: None,
) -> tuple[list[SceneResult], bool]:
    """Every method and every peer on every scene, each for at most the scene's time limit (a peer: each tolerance).

    say : hears a line before and after each run.
    returns : the results, and True if Ctrl-C ended the study early; what was measured until then is kept.
    """
    results: list[SceneResult] = []
    try:
        for settings in each(scenes, "scene"):
            results.append(SceneResult(build_scene(settings)))
            _measure(results[-1], settings, methods, peers, say)
    except KeyboardInterrupt:
        return [result for result in results if result.entries], True
    return results, False


def _measure(
    result: SceneResult,
    settings: RunSettings,
    methods: Sequence[str],
    peers: Sequence[Peer],
    say: Callable[[str], None],
) -> None:
    def run(name: str, call: Callable[[], Entry]) -> None:
        say(f"{result.label}: {name}")
        try:
            with stage(f"{result.label} by {name}"):
                entry = call()
        except InputError as error:
            result.left_out[name] = str(error)
            say(f"  left out: {error}")
            return
        result.entries.append(entry)
        best = result.best(entry)
        say(f"  gap {result.gaps(entry)[best]:.1e} after {entry.seconds[best]:.3g} s ({entry.statuses[best]})")

    calls: dict[str, Callable[[], Entry]] = {
        name: partial(run_method, result.scene, name, settings) for name in methods
    }
    calls |= {f"{peer.name} ({peer.linear_solver})": partial(run_peer, result.scene, peer, settings) for peer in peers}
    for name, call in each(list(calls.items()), "method"):
        run(name, call)
    if not result.entries:
        raise InputError(f"nothing can solve {result.label}: {'; '.join(result.left_out.values()) or 'no methods'}")


def run_method(scene: Scene, name: str, settings: RunSettings) -> Entry:
    """The history of a method with its default options. Raises InputError for a scene that it cannot solve."""
    options = METHODS[name]()
    if options.needs_taichi:
        runtime.start(settings.arch, settings.precision, settings.threads)
    spin = initial_spin(scene, settings.initial)
    first = uninterrupted(solve(scene, options.build(), spin, StopRule(TIGHTEST, iterations=1)))
    rule = StopRule(TIGHTEST, UNLIMITED, settings.time_limit or np.inf)
    solution = uninterrupted(solve(scene, options.build(), spin, rule))
    finite = np.isfinite(solution.history["power"][:, 0])
    history = {name: column[finite] for name, column in solution.history.items()}
    setup, power, checks = solution.seconds_compile, history[scene.law.minimises][:, 0], int(finite.sum())
    return Entry(
        method=name,
        variant="",
        settings=["default"] * checks,
        seconds=setup + history["seconds"],
        seconds_compile=max(first.seconds_compile - setup, 0.0),
        power=power if options.is_dynamics else np.minimum.accumulate(power),
        lower_bound=history["lower_bound"][:, 0],
        iterations=history["iteration"],
        statuses=[solution.status.value] * checks,
    )


def run_peer(scene: Scene, peer: Peer, settings: RunSettings) -> Entry:
    """A peer at one tolerance after another, until it fails to reach one within the time limit."""
    programme = conic_programme(scene)
    answers, asked = [], []
    seconds = settings.time_limit or np.inf
    for tolerance in TOLERANCES:
        answers.append(peer.solve(programme, tolerance, seconds, settings.threads))
        asked.append(f"{peer.linear_solver} {tolerance:.0e}")
        if not answers[-1].done:
            break
    return Entry(
        method=peer.name,
        variant=peer.linear_solver,
        settings=asked,
        seconds=np.array([answer.seconds for answer in answers]),
        seconds_compile=0.0,
        power=np.array([answer.power for answer in answers]),
        lower_bound=np.array([answer.lower_bound for answer in answers]),
        iterations=np.array([answer.iterations for answer in answers]),
        statuses=[answer.status for answer in answers],
    )
