"""What any method returns: where it stands (Progress), how it ended (Status), and the answer (Solution)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import Enum, IntEnum
from typing import Any

import numpy as np

from taichi_bearings.errors import BearingsError
from taichi_bearings.read_only import read_only
from taichi_bearings.runtime import HOST, Runtime
from taichi_bearings.scene.bearing import Bearing

CROSSED_BOUND = 1e-11  # relative amount by which a lower bound may seem to lie above the power


def is_crossed(value: float | None, bound: float | None, gap: float | None) -> bool:
    """True where a lower bound lies above what it bounds by more than rounding; None and not-a-number say nothing."""
    above = value is not None and bound is not None and value > 0 and bound > value * (1 + CROSSED_BOUND)
    return above or (gap is not None and gap < -CROSSED_BOUND)


class Status(Enum):
    """How a run ended. Only CERTIFIED claims the minimum."""

    CERTIFIED = "certified"  # the proven gap is within the tolerance
    STATIONARY = "stationary"  # a dynamics has come to rest: power, slips and torques no longer change
    FINISHED = "finished"  # a dynamics has gone on for the simulated time that was asked for
    STALLED = "stalled"  # the method can get no closer in this precision
    STEP_LIMIT = "step-limit"
    TIME_LIMIT = "time-limit"
    INTERRUPTED = "interrupted"
    NOT_FINITE = "not-finite"

    @property
    def reached(self) -> bool:
        """True if the run did what was asked for."""
        return self in (Status.CERTIFIED, Status.STATIONARY, Status.FINISHED)


class ContactState(IntEnum):
    """One word for a contact, as in ``/contact/<axis>/state``; whether it is proven stands beside it."""

    SLIPLESS = 0  # it slips at no minimum
    SLIPPING = 1  # it slips at every minimum
    UNDECIDED = 2  # slip and friction disagree, and nothing is proven
    DRIVEN = 3  # between two driven spheres, or absent: it takes no part
    TIED = 4  # it slips at some minima and rests at others; only what is proven is called so


SLIPLESS, SLIPPING, UNDECIDED, DRIVEN, TIED = ContactState


@dataclass(frozen=True)
class Energy:
    """Energy balance of a dynamics since its start, (R,) each, energy. Every account is kept from its own data.

    kinetic : of the free spheres. spring : in the elongations of the contacts.
    injected : work of the driven spheres. dissipated : work done on the contacts that is not in their springs.
    at_start : kinetic and spring energy at time 0.
    """

    kinetic: np.ndarray
    spring: np.ndarray
    injected: np.ndarray
    dissipated: np.ndarray
    at_start: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        """(R,) what the balance leaves unexplained, relative to the energy that was turned over."""
        turnover = np.maximum(self.at_start + np.abs(self.injected), np.abs(self.dissipated))
        missing = self.at_start + self.injected - self.dissipated - self.kinetic - self.spring
        return np.asarray(np.divide(missing, turnover, out=np.zeros_like(missing), where=turnover > 0))


@dataclass(frozen=True)
class Snapshots:
    """Spins of a dynamics at some times. time : (S,). spin : laboratory frame, (S, R, *N) or (S, R, *N, 3), 1/time."""

    time: np.ndarray
    spin: np.ndarray


@dataclass(frozen=True)
class Progress:
    """State of a method at one check; everything float64 on the host.

    staggered : (C, R, *N) spins that this check stands for, components as named by spin_axes.
    rest : (C, R, *N), what is to be added to them, of a method that knows more than their rounding, else None.
    force : contact forces (C, R, E), along the spin difference of the contact.
    objective : (R,), what the stationary state minimises (`Scene.objective`); lower_bound : (R,), on its least value;
        energy/time.
    proof : forces like `force` from which lower_bound follows, where these are others.
    time : simulated time of a dynamics, else None.
    energy : balance of a dynamics that keeps one. slipping : (R,), contacts of a dynamics that slip now.
    resolution : slip speed below which the method cannot tell slip from rest, length/time; of all, or (R,).
    largest_balance_residual : (R,), largest torque that is left on a free sphere, force * length.
    at_rest : a dynamics has come to rest.
    exhausted : going on brings it no closer in its precision. halted : a dynamics cannot make another step.
    state : contact states (R, E) that the method itself has established, else None; TIED is its belief.
    slip : slip speeds (R, E) where they are more precise than those of the spins, else None.
    settled : (R,), True where the states are final. states_believed : (R,), where the method takes them for those of
        every minimum; whether they are is for the judgement to prove.
    settles_more : going on would settle more contact states, whatever the gap.
    findings : what else the method has found, by name, (R,) each. columns : the same of this check, for the history.
    falls_to : gap to which the gap falls by like factors in like times at least; 0 if it does not.
    falls_as : power k if the gap falls about as iteration^-k; 0 if it does not.
    ended : (R,), iteration with which each replica was done, of a method that steps them apart.
    """

    iteration: int
    staggered: np.ndarray
    spin_axes: tuple[int, ...]
    force: np.ndarray
    objective: np.ndarray
    lower_bound: np.ndarray
    resolution: float | np.ndarray
    largest_balance_residual: np.ndarray
    rest: np.ndarray | None = None
    proof: np.ndarray | None = None
    time: float | None = None
    energy: Energy | None = None
    slipping: np.ndarray | None = None
    at_rest: bool = False
    exhausted: bool = False
    halted: bool = False
    state: np.ndarray | None = None
    slip: np.ndarray | None = None
    settled: np.ndarray | None = None
    states_believed: np.ndarray | None = None
    settles_more: bool = False
    findings: Mapping[str, np.ndarray] = field(default_factory=dict)
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    falls_to: float = 0.0
    falls_as: float = 0.0
    ended: np.ndarray | None = None

    def where(self, better: np.ndarray, other: "Progress") -> "Progress":
        """This state in the replicas where `better` (R,) is True, and `other` in the rest."""
        if better.all():
            return self
        mixed = {name: _picked(better, axis, getattr(self, name), getattr(other, name)) for name, axis in OF_REPLICAS}
        if isinstance(self.resolution, np.ndarray):
            return replace(self, **mixed, resolution=np.where(better, self.resolution, other.resolution))
        return replace(self, **mixed, resolution=self.resolution if better.any() else other.resolution)


OF_REPLICAS = (
    ("objective", 0), ("largest_balance_residual", 0), ("states_believed", 0), ("state", 0), ("slip", 0),
    ("staggered", 1), ("rest", 1), ("force", 1),
)  # fmt: skip
"""What belongs to a replica in the state of a method, and the axis that counts the replicas."""


def _picked(better: np.ndarray, axis: int, new: Any, old: Any) -> Any:
    """An array of the chosen replicas; None unless both states have it."""
    if new is None or old is None:
        return None
    return np.where(better.reshape(*(1,) * axis, -1, *(1,) * (new.ndim - axis - 1)), new, old)


OF_ALL = ("iteration", "seconds", "time")
"""Columns of a history that are the same for all replicas that are solved together."""


@dataclass(frozen=True)
class Solution:
    """The answer of a run, one entry a replica where an axis R is named.

    scene : what was solved, of all replicas. Of packings N is the number of spheres, `friction` is that
        on the second sphere of each contact, and `findings` has what is said of them alone: `proof`, "proven", or of
        which spins the bound is, where some motions slip by no more than the rounding of the normals, or why there is
        none; `driven_power`, energy/time, what contacts between driven spheres dissipate; `slipless_motions` of the
        free spheres that driven ones reach, None if undecided.
    spin, spin_rounding : laboratory frame, (R, *N) in 2D and (R, *N, 3) in 3D, 1/time; the spins are their sums.
    slip, power_per_contact, force, state : (R, E); force is its magnitude.
    friction : on the upper sphere of each contact, laboratory frame, (R, E, 3); in 2D (R, E),
        the component along z x n (lattice.grid.laboratory_forces). The lower bound follows from it: within the friction
        discs, and in balance where such forces prove as much as others (certificate.certifying_forces).
    state : values of `ContactState`. proven : (R, E), True where the state is proven, and where a contact
        takes no part.
    power : (R,). objective : (R,), what the stationary state minimises: the power, or the potential where no multiple
        of it is the power. lower_bound, gap : (R,), of the objective; BearingsError where a bound lies above it.
    findings : what else the method has found, by name, (R,) each.
    own : of `iterations`, `slip_threshold`, `status` and `seconds` what they are of each replica alone, (R,), where
        that can be told.
    history : columns of equal length; power and lower_bound are (checks, R).
    snapshots : spins of a dynamics at the times asked for.
        Of replicas that were solved one after another all columns and times have the axis R, and those that end sooner
        than the longest stay at their end.
    interrupted : Ctrl-C or SIGTERM was heard, even if too late to change the answer.
    running : device, precision and threads that it was computed with.
    """

    scene: Bearing
    method: str
    status: Status
    iterations: int
    spin: np.ndarray
    spin_rounding: np.ndarray
    slip: np.ndarray
    power_per_contact: np.ndarray
    force: np.ndarray
    friction: np.ndarray
    state: np.ndarray
    proven: np.ndarray
    power: np.ndarray
    objective: np.ndarray
    lower_bound: np.ndarray
    gap: np.ndarray
    largest_balance_residual: np.ndarray
    slip_threshold: float = 0.0
    seconds: float = 0.0
    seconds_compile: float = 0.0
    history: dict[str, np.ndarray] = field(default_factory=dict)
    findings: Mapping[str, np.ndarray] = field(default_factory=dict)
    own: Mapping[str, np.ndarray] = field(default_factory=dict)
    snapshots: Snapshots | None = None
    interrupted: bool = False
    running: Runtime = HOST

    def __post_init__(self) -> None:
        kept = () if self.snapshots is None else (self.snapshots.time, self.snapshots.spin)
        read_only((*(getattr(self, item.name) for item in fields(self)), *kept))
        for value, bound, gap in zip(self.objective, self.lower_bound, self.gap, strict=True):
            if is_crossed(None, None, gap):
                raise BearingsError(
                    f"the lower bound {bound:.17g} lies above the {self.scene.law.minimises} {value:.17g}: one of them "
                    "is wrong, and this is no result; please report it with the command"
                )

    @property
    def unproven(self) -> np.ndarray:
        """(R,), contacts whose state is not proven."""
        return np.asarray((~self.proven).sum(axis=1))

    @property
    def states_proven(self) -> np.ndarray:
        """(R,), True where the state of every contact is proven."""
        return np.asarray(self.proven.all(axis=1))

    @property
    def minimum_is_unique(self) -> list[bool | None]:
        """(R,), True where it is proven that no other slips have the least power, False that others do, else None.

        Of packings True is never said: where several values are imposed, contacts that slip at every minimum may do so
        by several speeds.
        """
        tied = (self.state == ContactState.TIED).any(axis=1)
        proven = self.states_proven & (self.scene.network.lattice is not None)
        return [False if ties else True if known else None for ties, known in zip(tied, proven, strict=True)]

    def sample(self, number: int) -> "Solution":
        """One replica of it as if it had been solved alone; its seconds are its share where its own are not known."""
        scene, one = self.scene, slice(number, number + 1)
        if scene.replicas == 1:
            return self

        of_replicas = {item.name: getattr(self, item.name) for item in fields(self)}
        changes: dict[str, Any] = {n: v[one] for n, v in of_replicas.items() if isinstance(v, np.ndarray)}
        changes |= {
            "scene": scene.sample(number),
            "seconds": self.seconds / scene.replicas,
            "seconds_compile": self.seconds_compile / scene.replicas,
            "history": self._history_of(number),
            "findings": {name: values[one] for name, values in self.findings.items()},
            "own": {},
        }
        changes |= {name: values[one].item() for name, values in self.own.items()}
        if (kept := self.snapshots) is not None:
            time = kept.time if kept.time.ndim == 1 else kept.time[:, number]
            new = np.diff(time, prepend=-1.0) > 0
            changes["snapshots"] = Snapshots(time[new], kept.spin[new][:, one]) if new.any() else None
        return replace(self, **changes)

    def _history_of(self, number: int) -> dict[str, np.ndarray]:
        """(rows,) columns: the rows of the history up to the one at which a replica had ended.

        number : of the replica. Rows of a block come at iterations of its slowest replica; the last one has as its
        iteration the one at which this replica itself ended.
        """
        found = {
            name: v if v.ndim == 1 else v[:, number] if name in OF_ALL else v[:, number : number + 1]
            for name, v in self.history.items()
        }
        if not found:
            return {}
        lived = np.diff(found["iteration"], prepend=-1) > 0
        if "iterations" in self.own:
            last = self.own["iterations"][number]
            lived &= np.append(-1, found["iteration"][:-1]) < last
            found["iteration"] = np.minimum(found["iteration"], last)
        return {name: values[lived] for name, values in found.items()} if lived.any() else {}

    @classmethod
    def joined(cls, ones: Sequence["Solution"], scene: Bearing) -> "Solution":
        """The answers to each sample of a scene, solved one after another, as one."""
        if len(ones) == 1:
            return ones[0]
        first = ones[0]
        arrays = [item.name for item in fields(first) if isinstance(getattr(first, item.name), np.ndarray)]
        changes: dict[str, Any] = {n: np.concatenate([getattr(one, n) for one in ones]) for n in arrays}
        ended, seconds = [one.status for one in ones], [one.seconds for one in ones]
        iterations = np.array([one.iterations for one in ones])
        columns = stacked([{n: v.reshape(len(v)) for n, v in one.history.items()} for one in ones])
        kept = [one.snapshots for one in ones]
        ways = stacked([{} if s is None else {"time": s.time, "spin": s.spin[:, 0]} for s in kept])
        return replace(
            first,
            **changes,
            scene=scene,
            iterations=int(iterations.max()),
            status=next((status for status in ended if not status.reached), first.status),
            seconds=sum(seconds),
            own={"iterations": iterations, "status": np.array(ended, dtype=object), "seconds": np.array(seconds)},
            history={name: values.T for name, values in columns.items()},
            findings={
                name: np.concatenate([one.findings[name] for one in ones])
                for name in first.findings
                if all(name in one.findings for one in ones)
            },
            snapshots=Snapshots(ways["time"].T, np.moveaxis(ways["spin"], 0, 1)) if ways else None,
        )

    def with_sample(self, number: int, one: "Solution", last: "Solution") -> "Solution":
        """The same with another answer to one replica. last : how the search for it went on, and ended."""
        spent = self.seconds + last.seconds
        ended: dict[str, Any] = {"seconds": spent, "status": last.status, "interrupted": last.interrupted}
        if self.scene.replicas == 1:
            return replace(one, **ended)

        def placed(whole: np.ndarray, value: Any) -> np.ndarray:
            changed = np.array(whole)
            changed[number] = value
            return changed

        names = [item.name for item in fields(self) if isinstance(getattr(self, item.name), np.ndarray)]
        changes: dict[str, Any] = {name: placed(getattr(self, name), getattr(one, name)[0]) for name in names}
        changes["own"] = {name: placed(values, getattr(one, name)) for name, values in self.own.items()}
        found = {name: placed(values, one.findings.get(name, [0])[0]) for name, values in self.findings.items()}
        method = last.method if one.method == last.method else self.method
        return replace(self, **changes, **ended, findings=found, method=method)


def stacked(each: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays of each replica with a leading axis; those that end sooner than the longest stay at their end, and those
    that one does not have are not-a-number."""
    found = {}
    for name in {name: None for one in each for name in one}:
        longest = max((one[name] for one in each if name in one), key=len)
        given = [one.get(name, longest[:1] * np.nan) for one in each]
        found[name] = np.stack([np.append(v, np.repeat(v[-1:], len(longest) - len(v), axis=0), axis=0) for v in given])
    return found
