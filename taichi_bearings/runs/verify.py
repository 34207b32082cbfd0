"""Checks whether a run file is as it was written, and whether its spins and forces prove what it says.

What a run reports follows from its spins and its friction by a *judgement*: the proof of bounds and contact states in
proof/judgement.py (docs/proofs.md). The file holds both, so the judgement can be made anew at any time, on any machine.
It is compared with what the file says:

* checksums tell what was changed after the file was written;
* power, bounds, gap, status and counts in the attributes are compared with those of the new judgement;
* so are slips, powers, forces and proven states of the contacts, spins of driven spheres, and coefficients drawn from
  seeds.

This finds damage and edits. Whether the proofs themselves are right is tested elsewhere, with methods that share no
code with them.

Letters: R samples, E contacts.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings.errors import FileError
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.plain_files import Json, read_json
from taichi_bearings.proof.contact_state import are_proven
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.proof.rounded_elimination import EPS
from taichi_bearings.quantities import CONTACTS, found_in, numbers_of, plain
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.run_file import file_of, read_claims
from taichi_bearings.runs.torque import under_torque
from taichi_bearings.scene import Bearing, Solution, Status
from taichi_bearings.scene.bearing import vector_length
from taichi_bearings.scene.law import LAWS
from taichi_bearings.scene.solution import DRIVEN, SLIPLESS, SLIPPING, TIED, UNDECIDED
from taichi_bearings.stages import stage
from taichi_bearings.words import counted, shown

ARITHMETIC = (
    "sums of two doubles with a bound on every error; bounds are rounded outwards; curvature by floating-point "
    "elimination with a bound on its error"
)
ROUNDED = 1e-12  # relative difference that numbers may have if they were computed on two machines
OUTWARDS = {
    "power": 1, "potential": 1, "gap": 1, "lower_bound": -1, "yield_torque": 1, "yield_torque_lower_bound": -1,
}  # fmt: skip
"""Bounds, and numbers that follow from them: 1 if rounding may have made them too large, -1 if too small."""
OF_FILE = {"version"}  # attributes that say something about the program, not about the answer
TORQUE_COST = 1e-12  # friction counts as balanced if unbalanced torques lower the bound by no more than this, relative
PROVEN_STATES = {"slipless": SLIPLESS, "slipping": SLIPPING, "tied": TIED, "unproven": UNDECIDED}
OF_STATES = {"contacts", "slipping", "slipless", "undecided", "unproven", "states_proven", "minimum_is_unique"}
"""Numbers that are not compared in files of layout 1, as their states had other codes."""
NOT_PROVABLE = "a number is not finite, or the scales of the scene are too far from one for any arithmetic"


def verify(path: str | Path) -> Json:
    """Check a run, and return the report that `bearings verify --json` prints.

    path : a run directory or its run.h5.

    The report has what is proven, in lists if there are several samples: `power`, the `lower_bound` and `upper_bound`
    of what the stationary state minimises, `gap`, `states_proven` and others. `contradictions` are sentences on what
    the file says and does not prove, and `verified` is True if there are none.

    Raises FileError if the file cannot be read, or for a law that the proofs do not know.
    """
    began, path = time.perf_counter(), Path(path)
    with stage("reading"):
        run, changed = read_claims(path)
    scene = run.solution.scene
    if not scene.law.is_sum:
        known = ", ".join(name for name, law in LAWS.items() if law.is_sum)
        raise FileError(f"{file_of(path)} has the law {scene.law.name!r}; only {known} can be verified")
    with stage("proving"), one_thread():
        anew = NewProof(run)
        report, found = anew.report, [*anew.contradictions()]
    with stage("drawing the coefficients again"):
        found += _seed_contradictions(run)
    found += _summary_contradictions(run, path)
    found += [f"{name} was changed after it was written" for name in changed]
    said = {name: run.attributes.get(name) for name in ("status", "seed")}
    return {
        "verified": not found,
        **report,
        "contradictions": found,
        "arithmetic": ARITHMETIC,
        "unchanged": not changed if "sha256" in run.attributes else None,
        **{name: np.asarray(value).tolist() for name, value in said.items()},
        "law": scene.law.name,
        **_size_of(scene),
        "coefficients": "drawn" if scene.is_drawn else "given",
        "run": str(path),
        "seconds": time.perf_counter() - began,
    }


def _size_of(scene: Bearing) -> Json:
    """Return the size of a scene by name: `shape`, numbers of spheres along each axis of a lattice, None for a packing;
    and the numbers of `spheres` and `contacts`.
    """
    shape, network = scene.facts.get("shape"), scene.network
    return {"shape": shape and list(shape), "spheres": network.spheres, "contacts": network.contacts}


@dataclass(frozen=True)
class NewProof:
    """Bounds and contact states of a run, proven anew from the spins and friction forces in its file.

    run : the run as its file says.
    """

    run: Result

    @cached_property
    def judgement_or_none(self) -> Judgement | None:
        """The proof for all samples. It is None if none can be tried: stored numbers are not finite, or so large or
        small that products over- or underflow.
        """
        stored = self.run.solution
        return Judgement.of(stored.scene, stored.spin, stored.spin_rounding, stored.friction)

    @property
    def judgement(self) -> Judgement:
        """The proof for all samples; an assertion fails if none could be tried."""
        assert self.judgement_or_none is not None
        return self.judgement_or_none

    @cached_property
    def known(self) -> np.ndarray:
        """(samples R, contacts E) contact states that are proven for all minima; DRIVEN for contacts that are absent or
        between driven spheres.
        """
        return np.where(self.judgement.acts, self.judgement.known, DRIVEN)

    @cached_property
    def solution(self) -> Solution:
        """The answer in the file, with all numbers that follow from the new proof in place of those stored.

        If a torque was asked for, it has the findings on the torque as well, unless these would need another solve,
        which a verification does not make.
        """
        stored, scene, new = self.run.solution, self.run.solution.scene, self.judgement
        ended = np.array(stored.own["status"])
        # `Result.ended` says CERTIFIED or RESTRICTED again where the new gap is within the tolerance
        ended[(ended == Status.CERTIFIED) | (ended == Status.RESTRICTED)] = Status.STALLED
        proven = stored.proven & are_proven(stored.state, self.known)
        # the power of contacts between driven spheres is stored beside the rest
        said = {"proof": new.proof, "driven_power": new.driven_power}
        if "cut_is_unique" in stored.findings:  # slips of one component are unique where the minimum cut is
            unique = [s.unique for s in new.states]
            pairs = zip(unique, stored.findings["cut_is_unique"], strict=True)
            said["cut_is_unique"] = np.array([in_file if anew is None else anew for anew, in_file in pairs])
        follows_motion = "time" in stored.history
        found = replace(
            stored,
            slip=new.slip,
            power_per_contact=scene.law.power(scene.material, new.slip),
            force=stored.force if follows_motion else _sizes(stored.friction),
            power=new.power,
            objective=new.objective,
            lower_bound=new.lower_bound,
            gap=new.gap,
            proven=proven,
            largest_balance_residual=stored.largest_balance_residual if follows_motion else new.largest_torque,
            findings={**stored.findings, **{name: v for name, v in said.items() if name in stored.findings}},
            own={**stored.own, "status": ended},
        )
        with_torque = self.run.asked.torque
        try:
            if with_torque is None:
                return found
            return under_torque(found, with_torque, self.run.asked.tolerance, _refuse_to_solve)
        except _NeedsAnother:
            return found

    @cached_property
    def report(self) -> Json:
        """What is proven, by name; each value is a list if there are several samples.

        power, upper_bound, lower_bound, largest_balance_residual : energy/time, and force * length for the last.
        gap : relative gap.
        balanced : True if the torques that are left over lower the bound by no more than TORQUE_COST.
        inside_discs : True if all forces are within the friction limit.
        states_proven : numbers of contacts by kind.
        minimum_is_unique : True, False or None.
        unproven_because : words.
        proof : "proven" if the lower bound holds for all spins, else words that say for which; None without a proof.
        """
        several = self.run.solution.scene.replicas > 1
        found = self._nothing if self.judgement_or_none is None else self._of_samples
        return {name: list(v) if several else v[0] for name, v in found.items()}

    @property
    def _of_samples(self) -> Json:
        """What the new proof says, by name, each a list with one entry for each sample: numbers, truth values, counts
        of proven contact states, and why others are not proven.
        """
        new, may_be_one = self.judgement, self.run.solution.scene.driving.slips_are_unique
        # largest force that still counts as within the friction limit, relative to that
        most = 1 + ROUNDED * new.network.graph.friction_is_rounded
        numbers = {
            name: [plain(v) for v in getattr(new, of)]
            for name, of in {"power": "power", "upper_bound": "upper_bound", "lower_bound": "lower_bound",
                             "gap": "gap", "largest_balance_residual": "largest_torque"}.items()
        }  # fmt: skip
        return numbers | {
            "balanced": (new.price <= TORQUE_COST).tolist(),
            "inside_discs": (new.bounds.worst <= most).tolist(),
            "states_proven": [
                {name: int(((s.known == kind) & acts).sum()) for name, kind in PROVEN_STATES.items()}
                for s, acts in zip(new.states, new.acts, strict=True)
            ],
            "minimum_is_unique": [s.unique if may_be_one else None for s in new.states],
            "unproven_because": [s.reason for s in new.states],
            "proof": new.proof.tolist(),
        }

    @property
    def _nothing(self) -> Json:
        """Entries of the report if no proof can be tried: nothing is proven of any sample."""
        acts = (self.run.solution.state != DRIVEN).sum(axis=1).tolist()
        open_ = dict.fromkeys(("power", "upper_bound", "lower_bound", "gap", "largest_balance_residual"))
        return {name: [None] * len(acts) for name in (*open_, "minimum_is_unique", "proof")} | {
            "balanced": [False] * len(acts),
            "inside_discs": [False] * len(acts),
            "states_proven": [dict.fromkeys(PROVEN_STATES, 0) | {"unproven": number} for number in acts],
            "unproven_because": [NOT_PROVABLE] * len(acts),
        }

    def contradictions(self) -> Iterator[str]:
        """Yield sentences on what the file says and its spins and forces do not prove: numbers and proven states of
        contacts, spins of driven spheres, and numbers in the attributes.
        """
        stored, attributes = self.run.solution, self.run.attributes
        if self.judgement_or_none is None:
            claims_proof = stored.states_proven.any() or (stored.lower_bound > 0).any()
            if claims_proof or {Status.CERTIFIED, Status.RESTRICTED} & set(stored.own["status"]):
                yield f"{NOT_PROVABLE}: what is said of it is not proven"
            return
        yield from self._contacts()
        yield from _driving_contradictions(stored)
        # numbers are compared if they are in the file; in layout 1 some have another meaning
        left_out = OF_STATES if attributes["schema_version"] == 1 else set()
        numbers = numbers_of(replace(self.run, solution=self.solution))
        held = {name: value for name, value in numbers.items() if name not in left_out}
        yield from _contradicted_attributes(attributes, held, stored.scene.replicas)

    def _contacts(self) -> Iterator[str]:
        """Yield sentences on arrays of contacts that do not follow from spins, friction and coefficients, or that claim
        more than is proven.
        """
        stored, new = self.run.solution, dict(found_in(self.solution, JUDGED_CONTACTS))
        wrong = {f"another {row.text} than spins, friction and coefficients give": _differences(row.of(stored), value)
                 for row, value in new.items()}  # fmt: skip
        driven = self.known == DRIVEN
        wrong["friction, though absent or between driven spheres"] = driven & (_sizes(stored.friction) > 0)
        wrong["states that do not name those between driven spheres and those absent"] = driven != (
            stored.state == DRIVEN
        )
        wrong["a state that is said to be proven and is not"] = stored.proven & (stored.state != self.known)
        for what, mask in wrong.items():
            for number in np.flatnonzero(mask.any(axis=1)).tolist():
                many = int(mask[number].sum())
                verb = "has" if many == 1 else "have"
                yield f"{_of_sample(number, len(mask))}{counted(many, 'contact')} {verb} {what}"


def _of_sample(number: int, count: int) -> str:
    """Return the beginning of a sentence on a sample, "sample 3: "; empty if there is only one sample.

    number : number of the sample.
    count : number of samples.
    """
    return f"sample {number}: " if count > 1 else ""


JUDGED_CONTACTS = {name: CONTACTS[name] for name in ("slip", "power", "force")}
"""Quantities of the contacts that follow from spins, friction and coefficients; the force of a dynamics does not."""


class _NeedsAnother(Exception):
    """Raised if the findings on a torque would need another solve, which a verification does not make."""


def _refuse_to_solve(_: object) -> Solution:
    """Raise _NeedsAnother in place of solving a scene, since verifying makes no new solve. The argument is not used."""
    raise _NeedsAnother


def _sizes(friction: np.ndarray) -> np.ndarray:
    """Return the sizes (samples R, contacts E) of friction forces.

    friction : (R, E, 3), or (R, E) for discs, force.
    """
    return np.abs(friction) if friction.ndim == 2 else vector_length(np.moveaxis(friction, -1, 0))


def _differences(said: np.ndarray, true: np.ndarray, in_addition: float = 0.0) -> np.ndarray:
    """Return a mask, in the shape of the arrays, of the numbers that differ by more than rounding.

    said, true : arrays of equal shape to compare. They may differ by ROUNDED times `true`; not-a-number equals only
        not-a-number.
    in_addition : absolute difference that is allowed as well.
    """
    with np.errstate(invalid="ignore"):
        close = np.abs(said - true) <= ROUNDED * np.abs(true) + in_addition
    found: np.ndarray = ~(close | (said == true) | (np.isnan(said) & np.isnan(true)))
    return found


def _driving_contradictions(stored: Solution) -> Iterator[str]:
    """Yield a sentence for each sample whose driven spheres do not have exactly the imposed spins.

    stored : the answer in the file.
    """
    network, expected = stored.scene.network, stored.scene.imposed_spins()
    driven = ~network.free.reshape(network.shape)
    pairs = zip(expected, (stored.spin, stored.spin_rounding), strict=True)
    wrong = np.any([(said != of)[:, driven].reshape(len(said), -1).any(axis=1) for of, said in pairs], axis=0)
    for number in np.flatnonzero(wrong).tolist():
        where = _of_sample(number, len(wrong))
        yield f"{where}the spins of driven spheres are not those that the scene imposes"


def _seed_contradictions(run: Result) -> list[str]:
    """Return sentences on shape, seeds and coefficients in the file of a run that contradict its settings.

    run : the run as its file says. Coefficients that are said to be drawn must be those of their seeds, to the bit
        where every machine draws the same bits.
    """
    scene, found = run.solution.scene, list[str]()
    pairs: dict[str, tuple[Sequence[int], Sequence[int]]] = {"seed": (scene.seeds, run.asked.seeds)}
    pairs["shape"] = scene.facts.get("shape", run.asked.shape), run.asked.shape
    for name, (said, asked) in pairs.items():
        if tuple(said) != tuple(asked):
            found.append(f"the {name} in the file is {list(said)}, but that of its scene is {list(asked)}")
    for name, number, drawn, rounding in scene.drawn_again():
        if not np.allclose(scene.named_coefficients[name][number], drawn, rtol=rounding, atol=0):
            found.append(f"the {name} in the file differs from what seed {scene.seeds[number]} gives")
    return found


def _summary_contradictions(run: Result, path: Path) -> Iterator[str]:
    """Yield sentences on values in summary.json that differ from those in run.h5, of the same run directory.

    run : the run as run.h5 says.
    path : the run directory. Nothing is compared if it is a file, or holds no summary.json.
    """
    beside = path / "summary.json"
    if not beside.is_file():
        return
    summary = read_json(beside)
    if not isinstance(summary, dict):
        yield "summary.json does not hold a JSON object"
        return
    for name in sorted((run.attributes.keys() & summary.keys()) - {"run"}):
        said, stored = summary[name], _as_json(run.attributes[name])
        if said != stored:
            yield f"the {name.replace('_', ' ')} is {shown(said)} in summary.json and {shown(stored)} in run.h5"


def _as_json(value: Any) -> Any:
    """Return the value of an attribute as summary.json has it: None for an empty text or not-a-number.

    value : the value in the HDF5 file.
    """
    plainly = np.asarray(value).tolist()
    listed = [None if v == "" or v != v else v for v in (plainly if isinstance(plainly, list) else [plainly])]
    return listed if isinstance(plainly, list) else listed[0]


def _contradicted_attributes(said: Mapping[str, Any], numbers: Mapping[str, Any], count: int) -> Iterator[str]:
    """Yield sentences on attributes of the file that differ from what the file proves.

    said : the attributes by name.
    numbers : what is proven, by name; lists if there are several samples.
    count : number of samples.
    """
    for name, value in numbers.items():
        if name not in said or name in OF_FILE:
            continue
        several = count > 1 and isinstance(value, list) and name != "shape"
        true = value if several else [value]
        given = list(said[name]) if several and np.ndim(said[name]) == 1 else [said[name]]
        if len(given) != len(true):
            yield f"{name} is said to be {shown(said[name])}; there are {count} samples"
            continue
        for number, pair in enumerate(zip(given, true, strict=True)):
            if not _agrees(name, *pair):
                where = _of_sample(number, len(true))
                yield f"{where}the {name.replace('_', ' ')} is said to be {shown(pair[0])}; it is {pair[1]!r}"


def _agrees(name: str, said: Any, true: Any) -> bool:
    """Return True if the value of an attribute agrees with the true one: in type, and for numbers up to rounding.

    name : name of the attribute.
    said, true : value of the quantity in the file, and the one that was proven anew; None if nothing was proven, which
        files write as "" or not-a-number.

    A bound may be off only to the side on which it still holds: a lower bound may be smaller than the true one, an
    upper bound larger.
    """
    said = said.item() if isinstance(said, np.generic) else said
    if isinstance(said, np.ndarray) and not isinstance(true, list):
        return False
    if true is None:  # "", and not-a-number within lists
        return bool(said == "" or (isinstance(said, float) and np.isnan(said)))
    if isinstance(true, (list, str)):
        return bool(np.array_equal(np.asarray(said), np.asarray(true)))
    is_number = isinstance(said, (int, float)) and (type(said) is type(true) or type(said) is float)
    if not is_number:
        return False
    in_addition = 4 * EPS if name == "gap" else 0.0
    off = (said - true) * OUTWARDS.get(name, 0)
    return off >= 0 and not _differences(np.float64(said), np.float64(true), in_addition)
