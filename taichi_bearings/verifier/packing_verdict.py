"""Does the run of a packing prove what it claims? Everything that its file says, held against its numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from taichi_bearings.verifier.claims import DESCRIPTIONS, STATUSES
from taichi_bearings.verifier.network import Network
from taichi_bearings.verifier.network_bounds import Bounds
from taichi_bearings.verifier.network_states import NetworkStates, network_states
from taichi_bearings.verifier.samples import LAWS, SLIPLESS, SLIPPING, UNPROVEN
from taichi_bearings.verifier.stored_packing import StoredPacking
from taichi_bearings.verifier.ties import MISSED_LIMIT
from taichi_bearings.verifier.verdict import ARITHMETIC, DRIVEN_STATE, EPS, ROUNDED, TORQUE_COST

FOLLOWED = ("cundall-strack", "implicit-cundall-strack", "gradient-descent")  # whose forces are those of now
PACKING_METHODS = ("planar-cut", "interior-point", "linear-solver", *FOLLOWED)
NORMAL_ERROR = 1e-6  # of the length of a normal, and between those of two contacts of the same spheres
CHECKED_OF_PACKINGS = {
    "power", "potential", "lower_bound", "gap", "proof", "law", "spheres", "driven_spheres", "contacts", "slipping",
    "slipless", "undecided", "critical", "unproven", "states_proven", "driven_power", "largest_balance_residual",
    "tolerance", "shape", "scene", "schema", "schema_version", "sha256",
}  # fmt: skip


@dataclass(frozen=True)
class PackingJudgement:
    """What is rigorously true of the spins and the friction of a packing; energy/time, and speeds."""

    bounds: Bounds

    @classmethod
    def of(
        cls, law: str, packing: dict[str, np.ndarray], spin: np.ndarray, friction: np.ndarray
    ) -> PackingJudgement | None:
        """As of `Network`."""
        network = Network.of(law, packing, spin, friction)
        return None if network is None else cls(Bounds.of(network))

    @property
    def network(self) -> Network:
        return self.bounds.network

    @cached_property
    def states(self) -> NetworkStates:
        return network_states(self.bounds)

    @property
    def slip(self) -> np.ndarray:
        """(E,), to the nearest doubles."""
        return self.network.slip.value * self.network.speed_unit

    @property
    def slip_bound(self) -> np.ndarray:
        """(E,), that no slip of any minimum exceeds; infinite where that is not known."""
        return self.states.slip_bound * self.network.speed_unit

    @property
    def driven_power(self) -> float:
        """What contacts between driven spheres dissipate."""
        between = ~self.network.free[self.network.contact].any(axis=1)
        return float(self.network.dissipated(1.0, between).value[0] * self.network.power_unit)

    @property
    def largest_torque(self) -> float:
        """Over the radius, left over on a free sphere, rounded up; force."""
        return self.bounds.largest_torque * self.network.force_unit

    @property
    def counted(self) -> dict[str, int]:
        """Contacts that act, by proven state."""
        proven = self.states.proven[self.network.acts]
        kinds = {"slipless": SLIPLESS, "slipping": SLIPPING, "critical": -1, "tied": -1, "unproven": UNPROVEN}
        return {name: int((proven == kind).sum()) for name, kind in kinds.items()}


def packing_report(run: StoredPacking) -> dict[str, Any]:
    """As `--json` of `verify` has it."""
    judgement = PackingJudgement.of(run.law, run.packing, run.spin, run.friction)
    if judgement is None:
        text = "a number is not finite, or the scales of the packing are too far from one for any arithmetic"
        nothing: list[str] = ["power", "upper_bound", "lower_bound", "gap", "proof", "largest_balance_residual"]
        acts = int((run.reported["state"] != DRIVEN_STATE).sum())
        return {
            **dict.fromkeys(nothing), "balanced": False, "inside_discs": False, "minimum_is_unique": None,
            "states_proven": {"slipless": 0, "slipping": 0, "critical": 0, "tied": 0, "unproven": acts},
            "unproven_because": text, "contradictions": [f"{text}: what is said of it is not proven"],
            "not_checked": ["everything"], "arithmetic": ARITHMETIC,
        }  # fmt: skip
    bounds, states = judgement.bounds, judgement.states
    found = [
        *_packing(run),
        *_arrays(run, judgement),
        *_states(run, states),
        *_summary(run, judgement),
        *_ended(run, bounds),
    ]
    return {
        "power": bounds.power,
        "upper_bound": bounds.upper_bound,
        "lower_bound": bounds.lower_bound,
        "gap": bounds.gap,
        "proof": bounds.proof,
        "balanced": bounds.price <= TORQUE_COST * bounds.upper,
        "inside_discs": bounds.worst <= 1 + ROUNDED,
        "largest_balance_residual": judgement.largest_torque,
        "states_proven": judgement.counted,
        "minimum_is_unique": None,
        "unproven_because": states.reason,
        "contradictions": found,
        "not_checked": _not_checked(run),
        "arithmetic": ARITHMETIC,
    }


def _packing(run: StoredPacking) -> Iterator[str]:
    """What is stored is a packing: unit normals, and each contact once."""
    contact, normal = run.packing["contact"], run.packing["normal"]
    size = np.linalg.norm(normal, axis=1)
    if (bad := np.abs(size - 1) > NORMAL_ERROR).any():
        e = int(np.argmax(bad))
        yield f"the normal of contact {e} has length {size[e]!r}; it must be a unit vector"
    low, high = np.sort(contact, axis=1).T
    outward = np.where((contact[:, 0] == low)[:, None], normal, -normal)
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    same &= np.linalg.norm(outward[order][1:] - outward[order][:-1], axis=1) < NORMAL_ERROR
    if same.any():
        twins = order[int(np.argmax(same)) :][:2]
        yield f"contacts {twins[0]} and {twins[1]} are of the same two spheres, at the same place"


def _arrays(run: StoredPacking, judgement: PackingJudgement) -> Iterator[str]:
    """Spins of driven spheres, slips, powers and forces follow from the packing, the spins and the friction."""
    network, packing = judgement.network, run.packing
    held, imposed = packing["driven"] >= 0, packing["spin"]
    if not (np.abs(run.spin - imposed)[held] <= 4 * EPS * np.abs(imposed)[held]).all():
        yield "the spins of driven spheres are not those imposed"
    slip, power, force, state = (run.reported[name] for name in ("slip", "power", "force", "state"))
    if not (np.abs(slip - judgement.slip) <= ROUNDED * judgement.slip).all():
        yield "slips are not those of the spins"
    first = packing["friction"] * (packing["normal_force"] if network.holds else slip)
    expected = (first + packing["viscosity"] * slip if "viscosity" in packing else first) * slip
    if not (np.abs(power - expected) <= ROUNDED * expected).all():
        yield "powers are not friction or damping times slip"
    friction = run.friction.reshape(len(slip), run.spin.size // len(run.spin))
    size = np.linalg.norm(friction / network.force_unit, axis=1) * network.force_unit
    if friction[~network.acts].any():
        yield "friction acts between driven spheres, or where there is none"
    if friction.shape[1] == 3 and (np.abs((friction * packing["normal"]).sum(axis=1)) > ROUNDED * size).any():
        yield "friction acts along normals"
    if run.attributes.get("method") not in FOLLOWED and not (np.abs(force - size) <= ROUNDED * size).all():
        yield "forces are not those of the friction"
    if not np.isin(state, (SLIPLESS, SLIPPING, UNPROVEN, DRIVEN_STATE)).all():
        yield "states have values other than 0, 1, 2 and 3"
    if ((state == DRIVEN_STATE) != ~network.acts).any():
        yield "states do not name the contacts between driven spheres and those absent"


def _states(run: StoredPacking, states: NetworkStates) -> Iterator[str]:
    """States are not refuted, and what is said to be proven is."""
    state, acts = run.reported["state"], run.reported["state"] != DRIVEN_STATE
    wrong = acts & (
        ((states.proven == SLIPLESS) & (state == SLIPPING)) | ((states.proven == SLIPPING) & (state == SLIPLESS))
    )
    if wrong.any():
        yield f"{int(wrong.sum())} contact states are not those of any minimum"
    known = np.where(acts, states.proven, DRIVEN_STATE)
    if "proven" in run.reported and (false := run.reported["proven"] != known).any():
        yield f"{int(false.sum())} contacts are said to be proven what they are not"


def _summary(run: StoredPacking, judgement: PackingJudgement) -> Iterator[str]:
    """Numbers and words of the summary are those computed anew, and counts are those of the arrays."""
    bounds, state = judgement.bounds, run.reported["state"]
    yield from _bounds_of_slips(run, judgement)
    numbers: dict[str, float] = {
        "power": bounds.power, "lower_bound": bounds.lower_bound, "driven_power": judgement.driven_power,
        "largest_balance_residual": judgement.largest_torque,
    }  # fmt: skip
    if all(LAWS[run.law]):
        numbers["potential"] = bounds.objective
    for name, value in numbers.items():
        said = run.claimed(name)
        if name in run.attributes and not (_is_number(said) and abs(said - value) <= ROUNDED * abs(value)):
            yield f"the {name.replace('_', ' ')} is said to be {said!r}; it is {value!r}"
    if "gap" in run.attributes and not (_is_number(run.claimed("gap")) and abs(run.claimed("gap") - bounds.gap)
                                        <= ROUNDED * abs(bounds.gap) + 4 * EPS):  # fmt: skip
        yield f"the gap is said to be {run.claimed('gap')!r}; what is proven leaves {bounds.gap!r}"
    if bounds.lower_bound > bounds.objective * (1 + 2 * EPS):
        yield "the lower bound is above the power or potential: the numbers contradict themselves"
    held = run.packing["friction"] * run.packing["normal_force"] * judgement.network.holds
    full = (run.reported["force"] >= (1 - MISSED_LIMIT) * held) & judgement.network.holds
    full &= held * run.reported["slip"] <= bounds.objective - bounds.lower_bound
    counts = {
        "spheres": len(run.spin), "driven_spheres": int((run.packing["driven"] >= 0).sum()),
        "contacts": int((state != DRIVEN_STATE).sum()), "slipping": int((state == SLIPPING).sum()),
        "slipless": int((state == SLIPLESS).sum()), "undecided": int((state == UNPROVEN).sum()),
        "critical": int((full & (state == UNPROVEN)).sum()), "unproven": judgement.counted["unproven"],
        "states_proven": judgement.counted["unproven"] == 0,
    }  # fmt: skip
    told: Any
    for name, told in {**counts, "proof": bounds.proof, "shape": None}.items():
        if name in run.attributes and (type(run.claimed(name)), run.claimed(name)) != (type(told), told):
            yield f"{name.replace('_', ' ')}: the summary says {run.claimed(name)!r}, the arrays {told!r}"
    for name, told in (("law", run.law), ("tolerance", run.attributes.get("tolerance"))):
        if name in run.settings and told is not None and run.settings[name] != told:
            yield f"the scene has {name} = {run.settings[name]!r}, and the file {told!r}"


def _bounds_of_slips(run: StoredPacking, judgement: PackingJudgement) -> Iterator[str]:
    if "slip_bound" not in run.reported:
        return
    said, own = run.reported["slip_bound"], judgement.slip_bound
    if not np.isclose(said, own, ROUNDED, 0.0).all():
        yield "bounds of the slip are not those that spins and friction prove"


def _ended(run: StoredPacking, bounds: Bounds) -> Iterator[str]:
    """ "certified" where the gap is within the tolerance, and nowhere else."""
    tolerance, status = run.setting("tolerance", run.attributes.get("tolerance", 1e-8)), run.claimed("status")
    method = run.claimed("method")
    if not 0 < tolerance < 1:
        yield f"the tolerance is {tolerance!r}; it must be between 0 and 1"
    cut_short = run.settings.get("duration") is not None and status in ("step-limit", "time-limit")
    if status not in (allowed := STATUSES if method in FOLLOWED else ("certified", "stalled")):
        yield f"the status is {status!r}; it must be one of {', '.join(allowed)}"
    elif (status == "certified") != (bounds.gap <= tolerance) and not cut_short:
        yield f"the run is said to be {status} to {tolerance!r}; what is proven leaves {bounds.gap!r}"
    if "method" in run.attributes and method not in PACKING_METHODS:
        yield f"the method is {method!r}; it must be one of {', '.join(PACKING_METHODS)}"


def _is_number(value: Any) -> bool:
    return type(value) in (int, float)


def _not_checked(run: StoredPacking) -> list[str]:
    """Names of what is in the file and that nothing is held against: as of lattices."""
    sure = CHECKED_OF_PACKINGS | ({"status"} if run.claimed("status") == "certified" else set())
    found = [name for name in run.attributes if name not in sure]
    found += [f"scene.{key}" for key in run.settings if key not in ("law", "tolerance")]
    given = ["friction", "normal_force", "spin", "driven", *(["viscosity"] if "viscosity" in run.packing else [])]
    given += ["radius", "center", "contact", "normal"]
    return [*found, *run.others, *(f"packing/{name}" for name in given), DESCRIPTIONS]
