"""What any method returns: where it stands (Progress), how it ended (Status), and the answer (Solution).

Letters: R replicas (samples), *N the shape of arrays over the N spheres, E contacts, C spin components, d components of
a slip. replica : one sample of a scene among several that are solved together. objective : what the stationary state
minimises, energy/time: the power, or the dissipation potential of laws whose power is no multiple of that.
gap : relative distance of the objective from its lower bound.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import Enum, IntEnum
from functools import cached_property
from typing import Any

import numpy as np

from taichi_bearings.errors import BearingsError
from taichi_bearings.read_only import read_only
from taichi_bearings.runtime import HOST, Runtime
from taichi_bearings.scene.bearing import Bearing

PROVEN = "proven"  # the finding `proof` of a sample whose lower bound holds for all spins
CROSSED_BOUND = 1e-11  # rounding may put a lower bound above the power by this, relative to the power


def is_crossed(value: float | None, bound: float | None, gap: float | None) -> bool:
    """Return True if a lower bound lies above the value that it should bound, by more than rounding can explain.

    value, bound : energy/time; None or not-a-number if unknown, as for `gap`.
    gap : (value - bound) / value, which is negative if the bound lies above the value.
    """
    above = value is not None and bound is not None and value > 0 and bound > value * (1 + CROSSED_BOUND)
    return above or (gap is not None and gap < -CROSSED_BOUND)


class Status(Enum):
    """How a run ended. Only CERTIFIED claims that the minimum was found, within the tolerance."""

    CERTIFIED = "certified"  # the proven gap is within the tolerance
    RESTRICTED = "restricted"  # as certified, but the lower bound is proven only among spins that are not too fast
    STATIONARY = "stationary"  # a dynamics has come to rest: power, slips and torques no longer change
    FINISHED = "finished"  # a dynamics has gone on for the simulated time that was asked for
    STALLED = "stalled"  # the method can get no closer in this precision
    STEP_LIMIT = "step-limit"  # the largest number of iterations was reached before any of these
    TIME_LIMIT = "time-limit"  # the largest wall time was reached before any of these
    INTERRUPTED = "interrupted"  # by Ctrl-C or SIGTERM
    NOT_FINITE = "not-finite"  # some numbers have become infinite or not-a-number

    @property
    def reached(self) -> bool:
        """True if the run did what was asked for."""
        return self in (Status.CERTIFIED, Status.STATIONARY, Status.FINISHED)


class ContactState(IntEnum):
    """State of a contact, as in ``/contact/<axis>/state`` of run.h5; another array says whether it is proven."""

    SLIPLESS = 0  # it slips at no minimum
    SLIPPING = 1  # it slips at every minimum
    UNDECIDED = 2  # slip and friction disagree, and nothing is proven
    DRIVEN = 3  # between two driven spheres, or absent: it takes no part
    TIED = 4  # it slips at some minima and rests at others; in a Solution this is proven


SLIPLESS, SLIPPING, UNDECIDED, DRIVEN, TIED = ContactState


def counts_of_states(state: np.ndarray) -> np.ndarray:
    """Return how many contacts of each of R samples are in each of the S states, (R, S), in the order of
    `ContactState`.

    state : (R, E), states of E contacts.
    """
    return np.stack([np.bincount(one, minlength=len(ContactState)) for one in state])


@dataclass(frozen=True)
class Energy:
    """Energy balance of a dynamics since its start; each field is an array (samples R,) in units of energy.

    kinetic : kinetic energy of the free spheres.
    spring : energy of the elongated springs at the contacts.
    injected : work of the driven spheres since the start.
    dissipated : work done on the contacts since the start that is not in their springs.
    at_start : kinetic and spring energy at time 0.

    Each is integrated on its own, so that their balance (`residual`) tests the dynamics.
    """

    kinetic: np.ndarray
    spring: np.ndarray
    injected: np.ndarray
    dissipated: np.ndarray
    at_start: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        """(samples R,) error of the balance, at_start + injected - dissipated - kinetic - spring, divided by the larger
        of at_start + abs(injected) and abs(dissipated).
        """
        turnover = np.maximum(self.at_start + np.abs(self.injected), np.abs(self.dissipated))
        missing = self.at_start + self.injected - self.dissipated - self.kinetic - self.spring
        return np.asarray(np.divide(missing, turnover, out=np.zeros_like(missing), where=turnover > 0))


@dataclass(frozen=True)
class Snapshots:
    """Spins of a dynamics at S simulated times.

    time : (snapshots S,), simulated time.
    spin : spins, (S, samples R, spheres *N) of discs or (S, R, *N, 3) of spheres, 1/time.
    """

    time: np.ndarray
    spin: np.ndarray


@dataclass(frozen=True)
class Progress:
    """State of a method at one check of its progress. Numbers are in double precision, on the CPU. Shapes: R samples, E
    contacts, C spin components, d slip components, *N the shape of arrays over the spheres.

    iteration : iterations so far.
    staggered : spins (components C, R, spheres *N) in the form that solvers store: on lattices with signs that
        alternate between neighbours, less those of the bottom, 1/time; in packings radius * spin, length/time.
    spin_axes : numbers of their components.
    rest : (C, R, *N), small numbers to add to them, from a method that knows its spins beyond rounding; else None.
    force : contact forces (slip components d, R, contacts E), along the spin differences of the contacts.
    objective : (R,), energy/time, what is minimised, at these spins.
    lower_bound : (R,), energy/time, proven for the minimum of the objective.
    proof : forces, shaped as `force`, from which lower_bound follows; None if it follows from `force` itself.
    time : simulated time of a dynamics, else None.
    energy : energy balance, of a dynamics that has one.
    slipping : (R,), number of contacts that slip at this moment of a dynamics.
    resolution : slip speed, length/time, below which the method cannot tell slip from rest; one number or (R,).
    largest_balance_residual : (R,), largest unbalanced torque on a free sphere, force * length.
    at_rest : True if a dynamics has come to rest.
    exhausted : True if further iterations bring the method no closer in its precision.
    halted : True if a dynamics cannot make another step.
    state : contact states (R, E) that the method has established, else None; TIED is then a guess of the method.
    slip : slip speeds (R, E), length/time, if they are more precise than those of the spins, else None.
    settled : (R,) mask of the samples whose states are final.
    states_believed : (R,) mask of the samples in which the method takes its contact states for the states at every
        minimum, without a proof.
    settles_more : True if further iterations would settle more contact states, whatever the gap.
    findings : other results of the method, by name, (R,) each.
    columns : numbers of this check for the history, by name, (R,) each.
    falls_to : gap at which the solve ends, if until then it falls by about equal factors in equal times, or infinite if
        the solve ends at the tolerance; 0 if the gap falls in another way.
    gap_of_path : of an interior-point method that proves nothing on its way, the largest relative gap of all samples on
        its central path: no proof, but a measure of what is left to do; else None.
    falls_as : exponent k, if the gap falls about as iteration^-k, else 0.
    ended : (R,), iteration at which each sample was done, of a method that steps them one by one, else None.
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
    gap_of_path: float | None = None
    ended: np.ndarray | None = None

    def where(self, better: np.ndarray, other: "Progress") -> "Progress":
        """Return a state that has the numbers of this one in some samples, and those of `other` in the rest.

        better : (samples R,) mask, True for the samples that are taken from this state.
        other : the other state.
        """
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
"""Fields of Progress that have numbers of each sample, and the axis of their arrays that counts the samples."""


def _picked(better: np.ndarray, axis: int, new: Any, old: Any) -> Any:
    """Return an array with the entries of `new` in the samples where `better` is True, and of `old` in the others; None
    if either array is None.

    better : (samples R,) mask.
    axis : number of the axis of both arrays that counts the samples.
    """
    if new is None or old is None:
        return None
    return np.where(better.reshape(*(1,) * axis, -1, *(1,) * (new.ndim - axis - 1)), new, old)


OF_ALL = ("iteration", "seconds", "time")
"""Columns of a history that are the same for all replicas that are solved together."""


@dataclass(frozen=True)
class Solution:
    """The answer of a run, with one entry for each replica where an axis R is named.

    scene : the bearing that was solved, with all replicas.
    method : name of the method.
    status : how the run ended.
    iterations : number of iterations, the largest of all replicas.
    spin, spin_rounding : laboratory spins, (R, spheres *N) in 2D and (R, *N, 3) in 3D, 1/time, and what their rounding
        leaves out; the sum of both is the spin.
    slip, power_per_contact, force : (R, contacts E): slip speed, length/time; power, energy/time; size of the force.
    friction : force on the upper sphere of each contact of a lattice, or on the second one in a packing, laboratory
        frame, (R, E, 3); in 2D (R, E), the component along z x n, with n the normal from the first to the second
        sphere. These forces prove the lower bound. None exceeds the friction force of its contact, and they are in
        balance where balanced forces prove as much as others.
    state : (R, E), values of `ContactState`.
    proven : (R, E) mask of the contacts whose state is proven, and of those that are absent or between driven spheres.
    power : (R,), energy/time.
    objective : (R,), energy/time.
    lower_bound : (R,), energy/time, on the minimum of the objective.
    gap : (R,). BearingsError is raised if a bound lies above the objective.
    largest_balance_residual : (R,), largest unbalanced torque on a free sphere, force * length.
    slip_threshold : slip speed, length/time, up to which a contact counts as slipless.
    seconds, seconds_compile : wall time, and the part of it in which kernels were compiled.
    history : columns of equal length, by name; power and lower_bound are (checks, R).
    findings : other numbers that the method has found, by name, (R,) each. Packings have `driven_power`, energy/time,
        of the contacts between driven spheres; `slipless_motions`, the number of motions without slip of the free
        spheres that contacts connect to driven ones, None if undecided; and `proof`. That is "proven" if the lower
        bound holds for all spins. Else it says for which spins it holds, as some motions slip by no more than the
        rounding of the normals, or why there is no bound.
    own : `iterations`, `slip_threshold`, `status` and `seconds` of each replica alone, (R,), where these are known; and
        `method` if several methods solved the replicas.
    snapshots : spins of a dynamics at the times that were asked for.
    interrupted : True if Ctrl-C or SIGTERM came, even if too late to change the answer.
    running : device, precision and threads with which it was computed.

    If replicas were solved one after another, all columns of the history and all times have the axis R. Replicas that
    ended sooner than the longest repeat their last row.
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
        """Make all arrays read-only, and raise BearingsError if a lower bound lies above what it bounds."""
        kept = () if self.snapshots is None else (self.snapshots.time, self.snapshots.spin)
        read_only((*(getattr(self, item.name) for item in fields(self)), *kept))
        for value, bound, gap in zip(self.objective, self.lower_bound, self.gap, strict=True):
            if is_crossed(None, None, gap):
                law = self.scene.law
                remedy = "please report it with the command that you ran"
                if not law.is_sum:
                    remedy = f"look whether `potential` or `conjugate` of the law {law.name!r} loses digits"
                raise BearingsError(
                    f"the lower bound {bound:.17g} lies above the {law.minimises} {value:.17g}: one of them is wrong, "
                    f"so this is no result; {remedy}"
                )

    @cached_property
    def counts(self) -> np.ndarray:
        """(samples R, states S), how many contacts of each sample are in each of the states, in the order of
        `ContactState`."""
        return counts_of_states(self.state)

    @property
    def is_restricted(self) -> np.ndarray:
        """(samples R,) mask of the samples whose lower bound is not proven of all spins; the finding `proof` says of
        which. Only packings of spheres have such samples."""
        return np.asarray(self.findings.get("proof", np.full(len(self.power), PROVEN)) != PROVEN)

    @property
    def bound_of_all_spins(self) -> np.ndarray:
        """(samples R,) lower bound on the least objective, energy/time: 0 in samples whose bound is not proven of all
        spins."""
        return np.where(self.is_restricted, 0.0, self.lower_bound)

    @property
    def unproven(self) -> np.ndarray:
        """(samples R,) number of the contacts whose state is not proven."""
        return np.asarray((~self.proven).sum(axis=1))

    @property
    def states_proven(self) -> np.ndarray:
        """(samples R,) mask of the replicas in which the state of every contact is proven."""
        return np.asarray(self.proven.all(axis=1))

    @property
    def minimum_is_unique(self) -> list[bool | None]:
        """A list with one entry for each sample: True if it is proven that all minima have the same slips, False if it
        is proven that they differ, None if neither is proven.

        It is never True for packings: contacts that slip at every minimum may do so at several speeds there.
        """
        tied = (self.state == ContactState.TIED).any(axis=1)
        proven = self.states_proven & self.scene.driving.slips_are_unique
        return [False if ties else True if known else None for ties, known in zip(tied, proven, strict=True)]

    def sample(self, number: int) -> "Solution":
        """Return the answer of one sample, as if it had been solved alone.

        number : number of the sample, from 0.

        Where its own time is not known, it gets an equal share of the time of all.
        """
        scene, one = self.scene, slice(number, number + 1)
        if scene.replicas == 1:
            return self

        values = {item.name: getattr(self, item.name) for item in fields(self)}
        changes: dict[str, Any] = {n: v[one] for n, v in values.items() if isinstance(v, np.ndarray)}
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
            # a sample that ended early repeats its last snapshot
            new = np.diff(time, prepend=-1.0) > 0
            changes["snapshots"] = Snapshots(time[new], kept.spin[new][:, one]) if new.any() else None
        return replace(self, **changes)

    def _history_of(self, number: int) -> dict[str, np.ndarray]:
        """Return the history of one sample up to the check at which it had ended: its columns by name, (checks,) of
        those in OF_ALL and (checks, 1) of others.

        Samples that are solved together have checks at the same iterations. The last one that is returned gets the
        iteration at which this sample itself ended.

        number : number of the sample.
        """
        found = {
            name: v if v.ndim == 1 else v[:, number] if name in OF_ALL else v[:, number : number + 1]
            for name, v in self.history.items()
        }
        if not found:
            return {}
        # leave out repeated rows, and checks after the one at which the sample had ended
        kept = np.diff(found["iteration"], prepend=-1) > 0
        if "iterations" in self.own:
            last = self.own["iterations"][number]
            kept &= np.append(-1, found["iteration"][:-1]) < last
            found["iteration"] = np.minimum(found["iteration"], last)
        return {name: values[kept] for name, values in found.items()} if kept.any() else {}

    @classmethod
    def joined(cls, ones: Sequence["Solution"], scene: Bearing) -> "Solution":
        """Return one answer for a scene whose samples were solved one after another.

        ones : the answer to each sample, in their order.
        scene : the scene with all of these samples.
        """
        if len(ones) == 1:
            return ones[0]
        first = ones[0]
        arrays = [item.name for item in fields(first) if isinstance(getattr(first, item.name), np.ndarray)]
        changes: dict[str, Any] = {n: np.concatenate([getattr(one, n) for one in ones]) for n in arrays}
        # numbers that differ between samples become arrays; histories and snapshots of unequal length are filled up
        ended, seconds = [one.status for one in ones], [one.seconds for one in ones]
        iterations, methods = np.array([one.iterations for one in ones]), [one.method for one in ones]
        differing = {"method": np.array(methods, dtype=object)} if len(set(methods)) > 1 else {}
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
            own={"iterations": iterations, "status": np.array(ended, dtype=object), "seconds": np.array(seconds)}
            | differing,
            history={name: values.T for name, values in columns.items()},
            findings={
                name: np.concatenate([one.findings[name] for one in ones])
                for name in first.findings
                if all(name in one.findings for one in ones)
            },
            snapshots=Snapshots(ways["time"].T, np.moveaxis(ways["spin"], 0, 1)) if ways else None,
        )

    def with_sample(self, number: int, one: "Solution", last: "Solution") -> "Solution":
        """Return a copy of this answer with a new answer in one sample. The seconds of the last solve are added, and
        its status is taken.

        number : number of the sample.
        one : new answer of the sample.
        last : answer of the last solve, from which seconds, status and interruption are taken.
        """
        spent = self.seconds + last.seconds
        ended: dict[str, Any] = {"seconds": spent, "status": last.status, "interrupted": last.interrupted}
        if self.scene.replicas == 1:
            return replace(one, **ended)

        def placed(whole: np.ndarray, value: object) -> np.ndarray:
            """Return a copy of `whole`, (R samples, ...), with `value` as the entry of sample `number`."""
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
    """Return arrays by name, (R samples, ...), in which the arrays of that name of all samples are stacked.

    each : for each sample its arrays by name, (...). Arrays shorter than the longest of their name are filled up with
        their last entry. A sample that lacks an array gets not-a-number.
    """
    found = {}
    for name in {name: None for one in each for name in one}:
        longest = max((one[name] for one in each if name in one), key=len)
        given = [one.get(name, longest[:1] * np.nan) for one in each]
        padded = [np.append(v, np.repeat(v[-1:], len(longest) - len(v), axis=0), axis=0) for v in given]
        found[name] = np.stack(padded)
    return found
