"""A solved run of a lattice or of a packing: its settings, what was found, and its numbers by name."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.files.whole_file import write_arrays
from taichi_bearings.quantities import Answered, numbers_of
from taichi_bearings.runs.settings import OF_DRIVEN, SIZES, RunSettings
from taichi_bearings.scene import Bearing, Solution, Status
from taichi_bearings.scene.array_files import short_name
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.scene.scene import of_lattice
from taichi_bearings.scene.solution import stacked

if TYPE_CHECKING:
    from taichi_bearings.analysis.histogram import PowerHistogram

LED_TO_ARRAYS = {"distribution", "viscosity", *SIZES, *OF_DRIVEN}  # keys that are not kept; run.h5 has what they led to


@dataclass(frozen=True)
class Run:
    """A solved run.

    solution : of all its samples. spin : that it started from; None where that lies in its directory, or where a
    packing started from one that has a name. path : of the directory or the file that has the run, if any.
    command : what made it, for the record. interrupted : Ctrl-C or SIGTERM was heard. attributes : of the file that it
    was read from.
    """

    settings: RunSettings
    solution: Solution
    spin: np.ndarray | None = None
    path: Path | None = None
    command: str = ""
    interrupted: bool = False
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_packing(self) -> bool:
        return self.solution.scene.network.lattice is None

    def sample(self, replica: int) -> "Run":
        """The run of one replica; InputError if there is none of this number."""
        if not 0 <= replica < len(self.solution.state):
            raise InputError(f"replica is {replica}; the run has {len(self.solution.state)}, counted from 0")
        solution, spin = self.solution.sample(replica), self.spin
        settings = self.settings.of_replica(solution.scene.seeds[0])
        one = spin if spin is None or self.is_packing else spin[[replica]]
        return replace(self, settings=settings, solution=solution, spin=one)

    @property
    def start(self) -> Any:
        """Spins that it started from, (R, *N) or (R, *N, 3), 1/time."""
        named, path = self.settings.initial, self.path
        if self.spin is not None or self.is_packing:
            return self.spin
        beside = named if named in STARTS or path is None else str((path if path.is_dir() else path.parent) / named)
        return initial_spin(of_lattice(self.solution.scene), beside)

    @cached_property
    def answered(self) -> Answered:
        return Answered(self.solution, self.settings.tolerance, self.settings.duration)

    @property
    def status(self) -> list[Status]:
        """How each replica ended, (R,)."""
        return self.answered.status

    @cached_property
    def numbers(self) -> dict[str, Any]:
        """By name what is known of the answer, and the warnings."""
        from taichi_bearings.runs.caveats import caveats

        return numbers_of(self.answered) | {"warnings": caveats(self.solution, self.settings)}

    @property
    def summary(self) -> dict[str, Any]:
        """The numbers of the run, as in `--json` of `run`; of several replicas lists where they may differ."""
        where = {"coefficients": None, "run": None if self.path is None else str(self.path)}
        if not self.is_packing:
            names = ("arch", "precision", "threads")
            where |= {name: getattr(self.solution.running, name) for name in names}
            where["coefficients"] = self.settings.coefficients
        return self.numbers | self.settings.driving | where

    @property
    def histogram(self) -> "PowerHistogram":
        """Of the power over its slipping contacts, of all replicas."""
        from taichi_bearings.analysis.histogram import count_powers, pool

        found = self.solution
        return pool(count_powers(found.power_per_contact, found.state), found.slip_threshold)

    def self_contained(self, folder: Path, name: str = "run.h5") -> RunSettings:
        """As the function of this name."""
        return self_contained(self.settings, self.solution.scene, self.start, folder, name)


def self_contained(settings: RunSettings, scene: Bearing, spin: Any, folder: Path, name: str = "run.h5") -> RunSettings:
    """Settings whose files lie in the run directory itself, so that it can be moved and run again.

    With checkpoints that must be possible while there is no run.h5 yet. name : of what is that otherwise.
    """
    with_file = settings.checkpoint_every is not None
    if scene.network.lattice is not None:
        scene = of_lattice(scene)
        one = scene.replicas == 1
        if settings.coefficients is not None:
            name = "coefficients.npz" if with_file else name
            settings = replace(settings, coefficients=name)
            parts = [(kind, scene.lattice.by_axis(v[0] if one else v)) for kind, v in scene.named_coefficients.items()]
            arrays = {short_name(f"{kind}/{axis}"): v for kind, of in parts for axis, v in zip("xyz", of, strict=False)}
            if with_file:
                write_arrays(folder / name, arrays)
        spin = None if settings.initial in STARTS else spin[0] if one else spin
    else:
        kept = {key: value for key, value in settings.given.items() if key not in LED_TO_ARRAYS}
        name = "packing.npz" if with_file else name
        if with_file:
            found = stacked([scene.sample(number).arrays() for number in range(scene.replicas)])
            write_arrays(folder / name, {n: v[0] if scene.replicas == 1 else v for n, v in found.items()})
        settings = RunSettings(**{**kept, "packing": name})
    if spin is not None:
        write_arrays(folder / "initial_spin.npz", {"spin": spin})
        settings = replace(settings, initial="initial_spin.npz")
    return settings


def together(ones: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Numbers by name: those of one sample, of several a list each."""
    return dict(ones[0]) if len(ones) == 1 else {key: [one[key] for one in ones] for key in ones[0]}
