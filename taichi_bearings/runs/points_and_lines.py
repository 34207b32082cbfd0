"""One sample of a stored run as points and lines: every sphere and every contact a row, what is known of it a column.

The interactive 3D page and ParaView draw these.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from taichi_bearings.analysis.domains import RigidDomains
from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.packing import PackingSolution
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import CONTACTS, found_in
from taichi_bearings.runs.figures import at_moment, slips_of, snapshot_threshold
from taichi_bearings.runs.solved import Run
from taichi_bearings.runs.structure_report import ON_CONTACTS, Finding, findings_of
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.stages import stage


@dataclass(frozen=True)
class Moments:
    """The way of a dynamics, without its end. time : (S,). spin : (S, sites, parts). slip, state : (S, contacts).

    state : by slip alone, as friction is not kept with a snapshot: slipping where it is faster than `threshold`.
    """

    time: np.ndarray
    spin: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    threshold: float


@dataclass(frozen=True)
class PointsAndLines:
    """Spheres and contacts of one sample, R = 1.

    Spheres in C order; contacts along x first, then y (, z), each in C order of their lower spheres.
    spheres, contacts : a column (sites, ...) or (contacts,) each, by name.
    path : spheres (L,) along one shortest slipless path, none if there is no such path.
    time : of the end of a dynamics, else None. moments : of its snapshots before the end, if it has any.
    """

    solution: Solution
    domains: RigidDomains
    spheres: dict[str, Finding] = field(repr=False)
    contacts: dict[str, Finding] = field(repr=False)
    path: np.ndarray
    time: float | None
    moments: Moments | None

    @property
    def scene(self) -> Scene:
        return self.solution.scene

    @cached_property
    def ends(self) -> np.ndarray:
        """Lower and upper sphere (contacts, 2) of each contact."""
        return self.scene.lattice.ends.T


def points_and_lines(run: Run, replica: int = 0) -> PointsAndLines:
    """One sample of a run; InputError if it has no such sample, or is not finite."""
    solution = run.sample(replica).solution
    if not all(np.isfinite(values).all() for values in (solution.spin, solution.slip)):
        raise InputError("the spins or slips of the run are not finite; there is nothing to draw")
    structure = structure_of(solution)
    path = np.ravel_multi_index(tuple(structure.network.shortest_path.T), solution.scene.lattice.shape)
    time = float(solution.history["time"][-1]) if "time" in solution.history else None
    with stage("analysing"):
        spheres, contacts = _sphere_columns(solution, structure), _contact_columns(solution, structure)
    moments = _moments(solution, time, run.settings.slip_threshold)
    return PointsAndLines(solution, structure.rigid_domains, spheres, contacts, path, time, moments)


def _sphere_columns(solution: Solution, structure: Structure) -> dict[str, Finding]:
    found, domains = findings_of(structure), structure.rigid_domains
    flat = {name: Finding(found[key].values.ravel(), found[key].units, found[key].description) for name, key in (
        ("domain", "domain"), ("component", "component"), ("betweenness", "betweenness/sphere"),
        ("above_cut", "minimum_cut/above"),
    )}  # fmt: skip
    kinds = "what its rigid domain is locked to: 0 bottom, 1 top, 2 both, 3 mixed, 4 partly, 5 neither"
    return {
        "spin": Finding(_spin_rows(solution.spin)[0], "1/time", "angular velocity in the laboratory frame"),
        **flat,
        "domain_kind": Finding(domains.kind[flat["domain"].values].astype(np.uint8), "1", kinds),
        "driven": Finding(solution.scene.lattice.is_driven.ravel(), "1", "spin is imposed"),
    }


def _spin_rows(spin: np.ndarray) -> np.ndarray:
    """Spins (S, sites, 3) of (S, *N, 3), or in 2D of (S, *N), where they point along z."""
    if spin.shape[-1] == 3 and spin.ndim == 5:
        return spin.reshape(len(spin), -1, 3)
    rows = np.zeros((len(spin), spin[0].size, 3))
    rows[..., 2] = spin.reshape(len(spin), -1)
    return rows


def _contact_columns(solution: Solution, structure: Structure) -> dict[str, Finding]:
    scene = solution.scene
    columns = {"axis": Finding(scene.lattice.axis.astype(np.uint8), "1", "0 along x, 1 along y, 2 along z")}
    columns |= {row.name: Finding(values[0], row.unit, row.text) for row, values in found_in(solution, CONTACTS)}
    proven = bool(solution.states_proven[0]) & (columns["state"].values != ContactState.DRIVEN)
    columns["proven"] = Finding(proven, "1", "the state is proven to be that of every minimum")
    for quantity, (name, values) in zip(scene.law.quantities, scene.named_coefficients.items(), strict=True):
        columns[name] = Finding(values[0], quantity.unit, f"{quantity.name} coefficient")
    for row in ON_CONTACTS:
        name = "on_cut" if row.name == "minimum_cut" else row.name
        columns[name] = Finding(row.of(structure), row.unit, row.text)
    path = structure.network.on_path
    columns["on_path"] = Finding(path, "1", "on one shortest slipless path from bottom to top")
    return columns


def moments_of_packing(result: PackingSolution) -> Moments | None:
    """As of lattices; contacts by their numbers."""
    kept, end = result.snapshots, result.time
    early = np.flatnonzero(kept.time < end) if kept is not None and end is not None else np.array([], dtype=int)
    if kept is None or not len(early):
        return None
    spin = kept.spin[early]
    found = [at_moment(result, one) for one in spin]
    slip, state = np.stack([one.slip for one in found]), np.stack([one.state for one in found])
    rows = spin if result.packing.dimension == 3 else _spin_rows(spin)
    return Moments(kept.time[early], rows, slip, state, found[0].slip_threshold)


def _moments(solution: Solution, end: float | None, slip_threshold: float | None) -> Moments | None:
    """Of the snapshots before the end, whose place the answer of the run takes."""
    kept = solution.snapshots
    early = np.array([], dtype=int) if kept is None or end is None else np.flatnonzero(kept.time < end)
    if kept is None or not len(early):
        return None
    scene, spin = solution.scene, kept.spin[early, 0]
    slip = np.stack([slips_of(scene, one) for one in spin])
    threshold = snapshot_threshold(solution, slip_threshold)
    state = np.where(slip > threshold, ContactState.SLIPPING, ContactState.SLIPLESS)
    state = np.where(scene.idle[0], ContactState.DRIVEN, state).astype(np.uint8)
    return Moments(kept.time[early], _spin_rows(spin), slip, state, threshold)
