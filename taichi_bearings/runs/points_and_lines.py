"""One sample of a stored run as points and lines: every sphere and every contact a row, what is known of it a column.

The interactive 3D page and ParaView draw these, of lattices and of packings.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from taichi_bearings.analysis.packing_structure import PackingStructure
from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import CONTACTS, SPHERES, found_in
from taichi_bearings.runs.figures import moment_of
from taichi_bearings.runs.run_file import PACKING_ARRAYS
from taichi_bearings.runs.solved import Run
from taichi_bearings.runs.structure_report import ON_CONTACTS, Finding, columns_of_structure, findings_of
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.stages import stage

SPIN_WORDS = SPHERES["spin"].unit, SPHERES["spin"].text
DOMAIN_KINDS = "0 bottom, 1 top, 2 both, 3 mixed, 4 partly, 5 neither"
ON_SPHERES = {
    "domain": "domain",
    "component": "component",
    "betweenness": "betweenness/sphere",
    "above_cut": "minimum_cut/above",
}
"""Columns of the spheres of a lattice, and their names in the group /analysis."""


@dataclass(frozen=True)
class Moments:
    """The way of a dynamics, without its end. time : (S,). spin : (S, N, 3). slip, state : (S, E).

    state : by slip alone, as friction is not kept with a snapshot: slipping where it is faster than `threshold`.
    """

    time: np.ndarray
    spin: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    threshold: float


@dataclass(frozen=True)
class PointsAndLines:
    """N spheres and E contacts of one sample in D dimensions.

    Of lattices spheres are in C order; contacts along x first, then y (, z), each in C order of their lower spheres.
    answer, structure : that is shown. center : (N, D), radius : (N,), length. body : (N,) number of the driven body, of
    lattices 0 bottom and 1 top, -1 of free spheres. ends : (E, 2), first (lower) and second sphere of each contact;
    normal : (E, D), from the one to the other.
    spheres, contacts : a column (N, ...) or (E,) each, by name.
    path : spheres along one shortest slipless path, of lattices where there is one.
    time : of the end of a dynamics, else None. moments : of its snapshots before the end, if it has any.
    """

    answer: Any
    structure: Any
    center: np.ndarray
    radius: np.ndarray
    body: np.ndarray
    ends: np.ndarray
    normal: np.ndarray
    spheres: dict[str, Finding] = field(repr=False)
    contacts: dict[str, Finding] = field(repr=False)
    path: np.ndarray
    time: float | None
    moments: Moments | None


def points_and_lines(run: Run, replica: int = 0) -> PointsAndLines:
    """One sample of a run; InputError if it has no such sample, or is not finite."""
    answer = run.sample(replica).solution
    if not all(np.isfinite(values).all() for values in (answer.spin, answer.slip)):
        raise InputError("the spins or slips of the run are not finite; there is nothing to draw")
    time = float(answer.history["time"][-1]) if "time" in answer.history else None
    moments = _moments(answer, time, run.settings.slip_threshold)
    with stage("analysing"):
        return (_of_packing if run.is_packing else _of_lattice)(answer, time, moments)


def _of_packing(solution: Solution, time: float | None, moments: Moments | None) -> PointsAndLines:
    packing, structure = solution.scene[0], PackingStructure.of(solution)
    spheres, contacts = columns_of_structure(structure)
    spheres |= {
        "spin": Finding(_in_space(solution.spin, packing.dimension)[0], *SPIN_WORDS),
        "radius": Finding(np.asarray(packing.radius), *PACKING_ARRAYS["radius"]),
        "driven": Finding(packing.driven, *PACKING_ARRAYS["driven"]),
    }
    if "sphere_betweenness" in spheres:
        spheres["betweenness"] = spheres.pop("sphere_betweenness")
    contacts |= _of_contacts(solution)
    for name, stored in (("coefficient", "friction"), ("viscosity", "viscosity"), ("normal_force", "normal_force")):
        if (values := getattr(packing, stored)) is not None:
            contacts[name] = Finding(values, *PACKING_ARRAYS[stored])
    return PointsAndLines(
        solution, structure, packing.center, np.asarray(packing.radius), packing.driven, packing.contact,
        np.asarray(packing.normal), spheres, contacts, np.zeros(0, dtype=int), time, moments,
    )  # fmt: skip


def _of_lattice(solution: Solution, time: float | None, moments: Moments | None) -> PointsAndLines:
    structure, scene, lattice = structure_of(solution), solution.scene, solution.scene.lattice
    found, domains = findings_of(structure), structure.rigid_domains
    spheres = {"spin": Finding(_in_space(solution.spin, lattice.dimension)[0], *SPIN_WORDS)}
    spheres |= {name: replace(found[key], values=found[key].values.ravel()) for name, key in ON_SPHERES.items()}
    kind = domains.kind[domains.domain.ravel()].astype(np.uint8)
    spheres["domain_kind"] = Finding(kind, "1", f"what its rigid domain is locked to: {DOMAIN_KINDS}")
    spheres["driven"] = Finding(lattice.is_driven.ravel(), "1", "spin is imposed")
    contacts = {"axis": Finding(lattice.axis.astype(np.uint8), "1", "0 along x, 1 along y, 2 along z")}
    contacts |= _of_contacts(solution)
    for quantity, (name, values) in zip(scene.law.quantities, scene.named_coefficients.items(), strict=True):
        contacts[name] = Finding(values[0], quantity.unit, f"{quantity.name} coefficient")
    for row in ON_CONTACTS:
        name = "on_cut" if row.name == "minimum_cut" else row.name
        contacts[name] = Finding(row.of(structure), row.unit, row.text)
    on_path = "on one shortest slipless path from bottom to top"
    contacts["on_path"] = Finding(structure.network.on_path, "1", on_path)
    place = np.argwhere(np.ones(lattice.shape, dtype=bool))
    body = np.where(lattice.is_driven.ravel(), np.where(place[:, -1] == 0, 0, 1), -1)
    path = np.ravel_multi_index(tuple(structure.network.shortest_path.T), lattice.shape)
    return PointsAndLines(
        solution, structure, 2 * lattice.radius * place, np.full(lattice.sites, lattice.radius), body, lattice.ends.T,
        np.eye(lattice.dimension)[lattice.axis], spheres, contacts, path, time, moments,
    )  # fmt: skip


def _of_contacts(answer: Solution) -> dict[str, Finding]:
    """What the table of quantities has of contacts, and of which states are proven."""
    found = {row.name: Finding(v[0], row.unit, row.text) for row, v in found_in(answer, CONTACTS)}
    state = found["state"].values
    proven = np.isin(state, [ContactState.SLIPLESS, ContactState.SLIPPING]) & (found["proven"].values == state)
    return found | {"proven": Finding(proven, "1", "the state is proven to be that of every minimum")}


def _in_space(spin: np.ndarray, dimension: int) -> np.ndarray:
    """Spins (S, N, 3) of (S, ..., 3), or of discs (S, ...), where they point along z."""
    if dimension == 3:
        return spin.reshape(len(spin), -1, 3)
    rows = np.zeros((len(spin), spin[0].size, 3))
    rows[..., 2] = spin.reshape(len(spin), -1)
    return rows


def _moments(answer: Solution, end: float | None, slip_threshold: float | None) -> Moments | None:
    """Of the snapshots before the end, whose place the answer of the run takes."""
    kept = answer.snapshots
    if kept is None or end is None or not (early := np.flatnonzero(kept.time < end)).size:
        return None
    spins, scene = kept.spin[early, 0], answer.scene
    dimension = scene.lattice.dimension if isinstance(scene, Scene) else scene[0].dimension
    found = [moment_of(answer, spin, slip_threshold) for spin in spins]
    slip, state = np.stack([one.slip for one in found]), np.stack([one.state for one in found])
    return Moments(kept.time[early], _in_space(spins, dimension), slip, state, found[0].threshold)
