"""The record of a run: its history, and for a dynamics its spins at chosen simulated times.

The history has one row for each *look*, when the loop of drive.py reads the progress. R is the number of samples.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.scene import Bearing, Progress, Snapshots

MOST_TIMES = 1_000_000
SAME_TIME = 1e-9  # relative distance below which two simulated times are the same


class Times(Protocol):
    """The settings of a run that say at which simulated times it is recorded, as texts that `parse_times` reads."""

    @property
    def record(self) -> str | None:
        """Text of the times at which the history gets a row, such as "0.1,0.2"; None for no times."""

    @property
    def snapshots(self) -> str | None:
        """Text of the times at which all spins are recorded, such as "0.1,0.2"; None for no times."""


@dataclass(frozen=True)
class Recording:
    """The simulated times at which a run is recorded.

    A state is recorded at the end of the first step that reaches a time. Methods that choose the lengths of their steps
    end a step exactly at that time.

    history : times of the rows of the history, ascending; if empty, there is a row each time that the progress is read.
    snapshots : times at which all spins are recorded, ascending.
    """

    history: np.ndarray = field(default_factory=lambda: np.zeros(0))
    snapshots: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, settings: Times) -> "Recording":
        """Return the times that the settings of a run ask for.

        settings : settings of a run, of which the texts `record` and `snapshots` are used, such as "0.1,0.2" or
            "log:1e-4,10,50" (start, stop, count), or None for no times.
        """
        return cls(*(parse_times(text) if text else np.zeros(0) for text in (settings.record, settings.snapshots)))

    def next_time(self, now: float) -> float:
        """Return the first simulated time after `now` at which something is recorded; infinity if there is none."""
        wanted = np.concatenate([self.history, self.snapshots])
        return float(wanted[wanted > now * (1 + SAME_TIME)].min(initial=np.inf))


_SPACING: dict[str, Callable[..., np.ndarray]] = {"linear": np.linspace, "log": np.geomspace}


def parse_times(text: str) -> np.ndarray:
    """Return ascending times from "linear:start,stop,count", "log:start,stop,count" or "t1,t2,...".

    Raises ValueError for anything else, negative times, and more than a million of them; KeyError for another word
    before the colon.

    >>> parse_times("linear:0,1,3")
    array([0. , 0.5, 1. ])
    """
    kind, colon, rest = text.partition(":")
    numbers = [float(word) for word in (rest if colon else text).split(",")]
    if not colon:
        times = np.array(numbers)
    else:
        start, stop, count = numbers
        if not (0 <= start < stop and count == int(count) and 2 <= count <= MOST_TIMES):
            raise ValueError(text)
        if kind == "log" and start == 0:
            raise ValueError(text)
        times = _SPACING[kind](start, stop, int(count))
    if not (np.isfinite(times).all() and (times >= 0).all()):
        raise ValueError(text)
    return np.unique(times)


class Recorder:
    """The history (a table of numbers over the run) and the snapshots (spins at some times), as they grow.

    recording : the simulated times at which something is recorded.
    """

    def __init__(self, scene: Bearing, recording: Recording) -> None:
        """Begin with an empty record.

        scene : what is solved.
        recording : the simulated times that are asked for.
        """
        self._scene, self.recording = scene, recording
        self._columns: dict[str, list[Any]] = {}  # the history: by name of a column its entries, one for each row
        self._snapshot_times: list[float] = []  # simulated times of the snapshots
        self._snapshot_spins: list[np.ndarray] = []  # laboratory spins of each, (R, *N spheres, 3), of discs (R, *N)
        self._last_time = -np.inf  # simulated time of the last state that `take` was given

    def take(self, progress: Progress, bound: np.ndarray, seconds: float) -> None:
        """Add a row to the history and a snapshot of the spins, each if it is due.

        progress : the state now.
        bound : (R samples,), the best lower bound so far.
        seconds : wall time so far.
        """
        if len(self.recording.history) == 0 or self._is_due(progress, self.recording.history):
            self.add_row(progress, bound, seconds)
        if self._is_due(progress, self.recording.snapshots):
            assert progress.time is not None
            self._snapshot_times.append(progress.time)
            self._snapshot_spins.append(self._scene.laboratory_spin(progress.staggered, progress.spin_axes))
        if progress.time is not None:
            self._last_time = progress.time

    def add_row(self, progress: Progress, bound: np.ndarray, seconds: float) -> None:
        """Add a row to the history, unless its last row is of the same iteration already.

        progress : the state now.
        bound : (R samples,), the best lower bound so far.
        seconds : wall time so far.

        Raises FileError if a history that was restored has other columns.
        """
        row = self._row(progress, bound, seconds)
        shapes = {name: np.asarray(values[-1]).shape for name, values in self._columns.items()}
        if shapes and shapes != {name: np.asarray(value).shape for name, value in row.items()}:
            raise FileError("the checkpoint is damaged or was changed: its history has other columns than this run")
        if not self._columns or self._columns["iteration"][-1] != progress.iteration:
            for name, value in row.items():
                self._columns.setdefault(name, []).append(value)

    def _is_due(self, progress: Progress, times: np.ndarray) -> bool:
        """Return True if one of some simulated times was reached since the progress was last read.

        progress : the state now, with its simulated time, None for a method that is no dynamics.
        times : (n,), the simulated times.
        """
        if progress.time is None:
            return False
        reached = progress.time * (1 + SAME_TIME)
        return bool(((times > self._last_time * (1 + SAME_TIME)) & (times <= reached)).any())

    def _row(self, progress: Progress, bound: np.ndarray, seconds: float) -> dict[str, Any]:
        """Return the entries of a row of the history, by name of the column.

        progress : the state now.
        bound : (R samples,), the best lower bound so far.
        seconds : wall time so far.
        """
        scene, minimises_power = self._scene, self._scene.law.minimises == "power"
        row = {
            "iteration": progress.iteration,
            "seconds": seconds,
            "power": progress.objective if minimises_power else scene.power(progress.staggered, progress.spin_axes),
            "lower_bound": bound,
            "largest_balance_residual": progress.largest_balance_residual,
        }
        # what only some methods and laws have
        if not minimises_power:
            row["potential"] = progress.objective
        if progress.time is not None:
            row["time"] = progress.time
        if progress.slipping is not None and self._scene.law.has_friction:
            row["slipping"] = progress.slipping
        if progress.energy is not None:
            energy = progress.energy
            for name in ("kinetic", "spring", "injected", "dissipated"):
                row[f"{name}_energy"] = getattr(energy, name)
            row["energy_residual"] = energy.residual
        return {**row, **progress.columns}

    def history(self) -> dict[str, np.ndarray]:
        """Return the columns of the history by name, all of equal length: (rows,) with one number for all samples, or
        (rows, R samples)."""
        return {name: np.asarray(values) for name, values in self._columns.items()}

    def snapshots(self) -> Snapshots | None:
        """Return the snapshots so far; None if there are none."""
        if not self._snapshot_spins:
            return None
        return Snapshots(np.array(self._snapshot_times), np.stack(self._snapshot_spins))

    def state(self) -> dict[str, np.ndarray]:
        """Return all that was recorded so far, arrays by name, for a checkpoint."""
        found = {f"history/{name}": values for name, values in self.history().items()}
        snapshots = self.snapshots()
        if snapshots is not None:
            found |= {"snapshots/time": snapshots.time, "snapshots/spin": snapshots.spin}
        return found | {"last_time": np.array(self._last_time)}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Take the record from a checkpoint; raise ValueError if its arrays do not fit the scene.

        state : the arrays by name that `state` returned in an earlier call.
        """
        begin = "history/"
        self._columns = {name[len(begin) :]: list(values) for name, values in state.items() if name.startswith(begin)}
        self._snapshot_times = [float(t) for t in state.get("snapshots/time", ())]
        self._snapshot_spins = list(state.get("snapshots/spin", ()))
        self._last_time = float(state["last_time"])
        # a damaged file may hold anything
        if any(np.asarray(values).dtype.kind not in "fiu" for values in state.values() if np.ndim(values)):
            raise ValueError("the history or the snapshots hold values that are not numbers")
        lengths = {len(values) for values in self._columns.values()}
        spins = (
            self._scene.replicas,
            *self._scene.network.shape,
            *(() if self._scene.network.dimension == 2 else (3,)),
        )
        if lengths and (len(lengths) > 1 or 0 in lengths):
            raise ValueError("the history has columns of different lengths, or empty ones")
        if [np.shape(spin) for spin in self._snapshot_spins] != [spins] * len(self._snapshot_times):
            raise ValueError(f"the snapshots must be one array of spins of shape {spins} for each time")
